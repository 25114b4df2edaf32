"""Start-up times of commands as a user meets them: whole processes with processor time and peak memory, the first with empty caches."""

import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from threading import Timer

import numpy as np

from .measure import Spread
from .table import Table

ROUNDS = 10
MEMORY = 400.0  # [MB] limit
PATIENCE = 90.0  # [s]
G1 = "example-robot-data:g1_29dof_rev_1_0.urdf"
REFLECTED = {  # rotor inertias at the joints that a public training stack has for this robot [kg m²]
    ".*_(elbow|shoulder_pitch|shoulder_roll|shoulder_yaw|wrist_roll)_joint": 0.00361,
    ".*_(hip_pitch|hip_yaw)_joint|waist_yaw_joint": 0.010178,
    ".*_(hip_roll|knee)_joint": 0.025102,
    ".*_(wrist_pitch|wrist_yaw)_joint": 0.00425,
    ".*_(ankle_pitch|ankle_roll)_joint|waist_(pitch|roll)_joint": 0.007219,
}
FREQUENCY = 2 * np.pi * 10  # [rad/s] kp = J ω², kd = 4 J ω, as there


def run(seed: int) -> Table:
    """One row per command; `seed` is not used."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        joint, biped, page = (str(folder / one) for one in ("joint.yaml", "biped.yaml", "page.html"))
        for path, example in ((joint, "testbed"), (biped, "biped")):
            text = files("gainroom").joinpath("files", "examples", f"{example}.yaml").read_text(encoding="utf-8")
            Path(path).write_text(text, encoding="utf-8")
        Path(folder / "sampled.yaml").write_text(_sampled(Path(biped).read_text(encoding="utf-8")), encoding="utf-8")
        # a cache of bytecode that begins empty, as on a fresh installation
        fresh = dict(os.environ, PYTHONPYCACHEPREFIX=f"{folder}/bytecode")
        fresh.pop("PYTHONDONTWRITEBYTECODE", None)  # or it stays empty
        rows = [
            _row("gainroom joint FILE, without any bytecode", ["joint", joint], fresh, 1, None),
            _row("gainroom joint FILE", ["joint", joint], fresh, ROUNDS, 0.5),
            _row("gainroom joint FILE --report", ["joint", joint, "--report", page], fresh, ROUNDS, 1.2),
            _row("gainroom --help", ["--help"], fresh, ROUNDS, 0.3),
        ]
        if find_spec("pinocchio"):
            rows.append(_row("gainroom robot, biped", ["robot", biped], fresh, 1, 5.0))
            rows.append(_row("gainroom robot, biped, 2 kHz", ["robot", str(folder / "sampled.yaml")], fresh, 1, 8.0))
            gains, robot = folder / "gains.yaml", folder / "g1.yaml"
            gains.write_text(_gains(), encoding="utf-8")
            robot.write_text(g1_robot(), encoding="utf-8")
            audit = ["audit", G1, "--delay-ms", "2", "--gains", str(gains)]
            rows.append(_row("gainroom audit, G1", audit, fresh, ROUNDS, 1.0))
            rows.append(_row("gainroom robot, G1 in 3 states", ["robot", str(robot)], fresh, 1, 10.0))
    notes = [
        f"Whole processes, {ROUNDS} each, after one that fills the cache of bytecode; robots once, for {PATIENCE:g} s at most (inf: not",
        "done then). pip writes bytecode as it installs, so that the very first run is like any other; only a checkout's has none.",
        "The processor's time, user and system, wanders less than the clock's on a shared machine. Memory: peak of the largest process,",
        "where it is more than the benchmark's own, which a process inherits; robots have one process per core.",
    ]
    return Table("Command line", rows, notes)


def _row(name: str, arguments: list[str], environment: dict[str, str], rounds: int, limit: float | None) -> dict:
    if rounds > 1:
        _run(arguments, environment)
    runs = np.array([_run(arguments, environment) for _ in range(rounds)])
    return {
        "command": name,
        **Spread(runs[:, 0]).cells("s", limit),
        "processor [s]": float(np.median(runs[:, 1])),
        "memory [MB]": None if np.isnan(runs[:, 2]).any() else float(np.max(runs[:, 2])),
        "at most [MB]": MEMORY if name.startswith("gainroom robot") else None,
    }


def _run(arguments: list[str], environment: dict[str, str]) -> tuple[float, float, float]:
    """Clock time [s], processor time [s] and peak memory [MB] of one process; a status of 2 (bad call) is an error of the benchmark.

    A process inherits the peak of the one that starts it: what is not above this one's own is not known, NaN.
    """
    script = Path(sys.executable).with_name("gainroom")
    command = [str(script)] if script.exists() else [sys.executable, "-m", "gainroom"]
    with tempfile.TemporaryFile() as output:
        start = time.perf_counter()
        process = subprocess.Popen([*command, *arguments], env=environment, stdout=output, stderr=subprocess.STDOUT)
        timer = Timer(PATIENCE, process.terminate)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        taken = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if taken >= PATIENCE:
            return math.inf, math.inf, _memory(usage)
        if process.returncode not in (0, 1):
            output.seek(0)
            said = output.read().decode(errors="replace").strip()
            raise RuntimeError(f"gainroom {' '.join(arguments)} ended with status {process.returncode}: {said[-500:]}")
    return taken, usage.ru_utime + usage.ru_stime, _memory(usage)


def _memory(usage: resource.struct_rusage) -> float:
    inherited = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return usage.ru_maxrss / 1024 if usage.ru_maxrss > inherited else math.nan


def _sampled(text: str) -> str:
    """An example's robot.yaml with a control rate."""
    from yaml import safe_dump, safe_load

    robot = safe_load(text)
    robot["control"]["sample_rate_hz"] = 2000
    return safe_dump(robot)


def _gains() -> str:
    lines = [
        f'  "{joints}": {{kp: {inertia * FREQUENCY**2:.4f}, kd: {4 * inertia * FREQUENCY:.4f}, motor_inertia: {inertia}}}'
        for joints, inertia in REFLECTED.items()
    ]
    return "\n".join(["gains:", *lines, ""])


def g1_robot() -> str:
    """robot.yaml of the G1 standing, with elastic gearboxes of one kind."""
    from yaml import safe_dump

    inertias = {joints: {"motor_inertia": inertia} for joints, inertia in REFLECTED.items()}
    return safe_dump(
        {
            "model": {"file": G1, "base": "floating"},
            "joints": {"default": {"stiffness": 3000.0, "damping": 1.0}, **inertias},
            "drive": {"bandwidth": 4000.0, "damping_ratio": 0.9, "delay_ms": 2.0},
            "postures": {"stand": {".*_hip_pitch_joint": -0.3, ".*_knee_joint": 0.6, ".*_ankle_pitch_joint": -0.3}},
            "contacts": {
                "double": ["left_ankle_roll_link", "right_ankle_roll_link"],
                "left": ["left_ankle_roll_link"],
                "flight": [],
            },
            "control": {"type": "pd", "space": "joint", "feedback": "motor", "kp": 20.0, "kd": 1.0},
            "limits": {"gain_margin_db": 6.0, "phase_margin_deg": 30.0, "peak_sensitivity": 2.0},
        }
    )
