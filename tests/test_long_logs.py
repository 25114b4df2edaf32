"""Long logs: the part that says most is found, time is short and memory does not grow with the log."""

import json
import subprocess
import sys
import time as clock
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.files.logs import open_log
from gainroom.identification.excited_part import MostExcited, most_excited
from gainroom.identification.joint import identify_joint
from gainroom.identification.record import Record
from gainroom.simulation import Friction, Scenario, Testbed, simulate
from identified import holds, multisine, soft_loop

TICK, JOINT, DRIVE = 5e-4, gr.ElasticJoint(0.2, 0.8, 1e4, 2.0), gr.Drive(3000.0, 0.8, 2.3 * 5e-4)
TORQUES = ("target_torque", "actual_torque", "motor_position")
MEASURED = """
import json, sys
from pathlib import Path
from gainroom.files.logs import read_joint
from gainroom.identification import identify_delay, identify_joint
logged = read_joint(Path(sys.argv[1]))
delay, found = identify_delay(logged.record), identify_joint(logged.record)
joint = {name: [found.parameters[name].low, found.parameters[name].high] for name in ("motor_inertia", "link_inertia", "stiffness")}
print(json.dumps({
    "peak": 1024 * int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]),
    "delay": [delay.ticks.low, delay.ticks.high], "joint": joint,
    "used": found.used, "notes": list(logged.log.notes),
}))
"""


def excited(seconds: float, link: bool = False, seed: int = 1) -> dict[str, np.ndarray]:
    """Columns at 2 kHz: a multisine of torque on slow motion, with friction, weight, encoders and a noisy torque."""
    rng, count = np.random.default_rng(seed), int(seconds / TICK)
    time = np.arange(count) * TICK
    torque = 10 * multisine(rng, time, np.geomspace(5, 80, 60))
    bed = Testbed(
        soft_loop(JOINT, DRIVE, 1.0, 0.7, TICK),
        motor_friction=Friction(1.0, 1.2, 0.05),
        link_friction=Friction(0.2),
        gravity=2.0,
        motor_resolution=7.7e-6,
        link_resolution=7.7e-6,
        substep=TICK / 4,
    )
    reference = 0.4 * np.sin(2 * np.pi * 0.2 * time)[:, None]
    run = simulate(bed, Scenario(reference, (count - 1) * TICK, feedforward=torque[:, None], noise=5e-6, seed=seed))
    columns = {"target_torque": run.target_torque[:, 0], "motor_position": run.motor_reading[:, 0]}
    columns["actual_torque"] = run.actual_torque[:, 0] + 0.1 * rng.standard_normal(count)
    return columns | ({"link_position": run.link_reading[:, 0]} if link else {})


def written(path: Path, columns: dict[str, np.ndarray], before: float, after: float) -> Path:
    """A log with rest [s] before and after its motion; written in pieces."""
    rng, start = np.random.default_rng(0), 0.0

    def add(values: dict[str, np.ndarray]) -> None:
        nonlocal start
        count = len(values["target_torque"])
        writer.write({"time": start + TICK * np.arange(count)} | {name: column[:, None] for name, column in values.items()})
        start += TICK * count

    def rest(seconds: float, values: dict[str, float]) -> None:
        for count in np.diff([*range(0, int(seconds / TICK), 100_000), int(seconds / TICK)]).tolist():
            still = {name: np.full(count, value) for name, value in values.items()}
            still["actual_torque"] = still["actual_torque"] + 0.1 * rng.standard_normal(count)
            add(still)

    with open_log(path, ("joint",), TORQUES) as writer:
        rest(before, {name: float(columns[name][0]) for name in TORQUES})
        add({name: columns[name] for name in TORQUES})
        rest(after, {name: float(columns[name][-1]) for name in TORQUES})
    return path


def measured(path: Path) -> dict:
    """The answers of a process of its own, and its peak memory [bytes]; getrusage would count what the process that starts it has."""
    run = subprocess.run([sys.executable, "-c", MEASURED, str(path)], capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


def assert_right(answer: dict) -> None:
    """Three intervals that hold for one log, made wider to 99.9 %."""
    truth = {"motor_inertia": JOINT.motor_inertia, "link_inertia": JOINT.link_inertia, "stiffness": JOINT.stiffness}
    for name, value in truth.items():
        low, high = answer["joint"][name]
        assert abs(value - (low + high) / 2) < 0.85 * (high - low)
        assert high - low < 0.02 * value
    low, high = answer["delay"]
    assert abs(DRIVE.delay / TICK - (low + high) / 2) < 0.85 * (high - low)
    assert high - low < 0.2


def test_the_most_excited_part_is_where_the_command_changes_most():
    rng, torque = np.random.default_rng(0), np.zeros(5000)
    torque[3100:3600] = rng.standard_normal(500)
    found = most_excited(Record(np.arange(5000) * TICK, {"target_torque": torque, "motor_position": torque}, TICK), 500)
    assert found.time[0] == pytest.approx(3100 * TICK, abs=1.1 * TICK)
    assert len(found.time) == 500


def test_a_log_in_blocks_gives_the_same_part_to_a_block():
    rng, torque = np.random.default_rng(0), np.zeros(50_000)
    torque[31_000:36_000] = rng.standard_normal(5000)
    best, time = MostExcited(5000), np.arange(50_000) * TICK
    for first in range(0, 50_000, 1000):
        part = slice(first, first + 1000)
        best.add(time[part], {"target_torque": torque[part], "motor_position": -torque[part]})
    found, channels = best.part()
    assert best.seen == 50_000
    assert len(found) <= 6000
    assert found[0] <= 31_000 * TICK
    assert found[-1] >= 35_999 * TICK
    assert np.array_equal(channels["motor_position"], -channels["target_torque"])


@pytest.mark.slow
def test_a_long_log_says_which_part_was_used(tmp_path):
    """Ten minutes with 20 s of motion; 0.6 GiB are enough, most of which are libraries."""
    answer = measured(written(tmp_path / "log.parquet", excited(20.0), 300.0, 280.0))
    assert answer["peak"] < 0.6 * 2**30
    assert answer["used"][0] <= 300.0 < 319.9 <= answer["used"][1]
    assert "of 600 s the part from" in answer["notes"][-1]
    assert_right(answer)


@pytest.mark.population
@pytest.mark.timeout(1800)
def test_an_hour_streams_through_a_gibibyte(tmp_path, capsys):
    """1 h at 2 kHz, 7.2 million rows, one minute of motion."""
    answer = measured(written(tmp_path / "log.parquet", excited(60.0), 2000.0, 1540.0))
    with capsys.disabled():
        print(f"\n1 h, 2 kHz: peak memory {answer['peak'] / 2**20:.0f} MiB; {answer['notes'][-1]}")
    assert answer["peak"] < 2**30
    assert_right(answer)


@pytest.mark.population
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("link", [False, True])
def test_a_minute_is_identified_in_five_seconds(link, capsys):
    """60 s at 2 kHz on one core, by processor time: what is compiled is there."""
    columns = excited(60.0, link)
    log = Record(np.arange(len(columns["target_torque"])) * TICK, columns, TICK)
    identify_joint(log)
    before = clock.process_time()
    found = identify_joint(log)
    spent = clock.process_time() - before
    with capsys.disabled():
        print(f"\n60 s, 2 kHz, {1 + link} encoders: {spent:.2f} s")
    assert spent < 5
    assert holds(found.parameters["stiffness"], JOINT.stiffness)
