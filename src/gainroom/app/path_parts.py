"""Parts of the page on a joint whose kd closes on a path of its own: while gains are dragged stability alone, at rest what `joint` says.

Its margins take a second or more, stability 20 ms. The plane of gains is sampled: which are stable, and no more.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..analysis.gain_region import traced
from ..analysis.multirate import Multirate
from ..errors import at_frequency
from ..report.gain_advice import NOTHING
from ..report.gain_paths import sentence, warnings
from ..report.margin_columns import margin_value, requirement
from ..report.number_format import hertz
from ..report.over_time import LOAD
from ..report.words import tone
from ..simulation import Scenario, simulate
from ..simulation.testbed import Testbed
from ..simulation.trajectories import Step
from ..studies.gain_paths import PathStudy
from ..system.delay_reserve import response_of_paths
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS
from ..system.system import System
from .bench import advised, drawn_line, drawn_response, rounded

APPROXIMATE = "both paths together, each a hold and a delay, without aliases; margins are of the exact loop"
"""Model of the open loop of two rates in its picture, in words."""
SAMPLED_ALONE = "areas: sampled, stable at the nominal values, no margins; no gains are recommended where kd has a path of its own"
LINES, SAMPLED = 29, 25
"""Lines of one kp in the plane, and values of kd tried on each."""
HALVINGS = 8
"""Halvings between the last stable kd and the next."""
FIRST = 1e-3
"""Least gains of the plane as shares of the largest."""
TIMES, SHORTEST, LONGEST = 8.0, 0.2, 4.0
"""Time constants of the slowest eigenvalue that a step is followed, and bounds of that [s]."""
POINTS, STEP_POINTS = 400, 500


def one_path(system: System) -> System:
    """`system` with all gains on the host: of frequencies and gains of its order."""
    return replace(system, control=replace(system.control, kd_path=None))


def stability(system: System) -> dict[str, Any]:
    """Verdict part while gains are dragged: stable or not at the nominal values, and nothing else yet."""
    stable = Multirate(system.loop()).unstable() == 0
    text = "Stable at the nominal values; margins follow when the gains rest." if stable else "Unstable: do not run these gains."
    return {
        "basis": "nominal", "sentence": text, "tone": "bare" if stable else "bad", "rows": [], "stable": stable, "stable_in_range": stable,
        "met": None, "unmet": [], "numbers": {}, "worst": {},
    }  # fmt: skip


def verdict(study: PathStudy, basis: str) -> dict[str, Any]:
    """Verdict part with the requirements at their worst, as `gainroom joint` has them; of two paths some margins are not known."""
    asked = study.system.requirements.needed
    return {
        "basis": basis,
        "sentence": sentence(study),
        "tone": tone(study.verdict),
        "rows": [_row(study, name) for name, (value, _) in study.worst.items() if name in asked or not math.isnan(value)],
        "stable": study.stable,
        "stable_in_range": study.stable_in_range,
        "met": study.requirements_met,
        "unmet": list(study.unmet),
        "numbers": {},
        "worst": {REQUIREMENTS[name].key: REQUIREMENTS[name].in_unit(value) for name, (value, _) in study.worst.items()},
    }


def _row(study: PathStudy, name: str) -> dict[str, Any]:
    one, (value, case), met, asked = REQUIREMENTS[name], study.worst[name], study.met(name), study.system.requirements
    nominal = one.value(study.nominal[0].margins)
    return {
        "title": one.label,
        "worst": margin_value(asked, name, value, met, 3) if study.stable_in_range else "unstable",
        "nominal": margin_value(asked, name, nominal, None, 3) if study.stable else "unstable",
        "required": requirement(asked, name, 3),
        "met": met if study.stable_in_range else False if name in asked.needed else None,
        "omega": at_frequency(one.frequency(case.margins), "", hertz),
        "where": case.text,
        "to_use": "",
        "name": name,
    }


def use(study: PathStudy) -> dict[str, Any]:
    """Notes below the pictures; no gains are recommended."""
    return {**advised(NOTHING, [*warnings(study), SAMPLED_ALONE]), "point": None, "gains": None, "rule": None}


def plane(system: System, window: tuple[float, float]) -> dict[str, Any]:
    """Outlines of the stable gains up to `window` (kp, kd), sampled."""
    kp, kd = window
    controller = system.control.controller
    base = Multirate(system.with_controller(controller.from_plane(kp, kd)).loop())
    kps = np.linspace(FIRST, 1.0, LINES)
    columns = [_stable(base, float(share)) * kd for share in kps]
    outlines = traced(kp * kps, columns)
    drawn = {"stable": [drawn_line(outline) for outline in outlines], "required": [], "edge": [], "lines": [], "heights": []}
    return drawn | {"window": window, "last": True}


def _stable(base: Multirate, kp: float) -> Floats:
    """Intervals (p, 2) of the factor on kd, up to 1, with which the loop is stable, kp's factor `kp`; their ends are halved to."""

    def stable(kd: float) -> bool:
        return base.unstable(kp, kd) == 0

    kds = np.linspace(FIRST, 1.0, SAMPLED)
    inside = [stable(kd) for kd in kds.tolist()]
    ends: list[float] = [float(kds[0])] if inside[0] else []
    for k in range(len(kds) - 1):
        if inside[k] == inside[k + 1]:
            continue
        good, bad = (float(kds[k]), float(kds[k + 1])) if inside[k] else (float(kds[k + 1]), float(kds[k]))
        for _ in range(HALVINGS):
            middle = 0.5 * (good + bad)
            good, bad = (middle, bad) if stable(middle) else (good, middle)
        ends.append(good)
    return np.array([*ends, *([1.0] if inside[-1] else [])]).reshape(-1, 2)


def open_loop(system: System, span: tuple[float, float]) -> dict[str, Any]:
    """Bode and Nyquist plots of both paths together, see APPROXIMATE."""
    assert system.control.sample_time is not None
    omega = np.geomspace(span[0], math.pi / system.control.sample_time, POINTS)
    value = response_of_paths(system.loop(), omega)
    phase = np.degrees(np.unwrap(np.angle(value)))
    return drawn_response(omega, value, phase - 360 * math.ceil(phase[0] / 360 - 1e-9))


def step(system: System) -> dict[str, Any]:
    """Link and motor after a step of the reference, and under a load on the link: the linear loop, stepped tick by tick."""
    loop = system.loop()
    base = Multirate(loop)
    slowest = float(np.abs(base.values()).max())
    growth = math.log(slowest) / base.lifted.period
    end = min(max(TIMES / max(abs(growth), 1e-9), SHORTEST), LONGEST)
    bed = Testbed(loop)
    trials = ((1.0, 0.0), (0.0, 1.0))  # height of the reference, load
    moved, pushed = (simulate(bed, Scenario(Step(up), end, reference_velocity=False, link_torque=load)) for up, load in trials)
    count = min(len(moved.time), len(pushed.time))
    pick = slice(None, count, max(1, count // STEP_POINTS))
    curves = (("reference", moved, 1.0), ("disturbance", pushed, 1e3 * LOAD))
    drawn = {"ms": rounded(1e3 * moved.time[pick])}
    for name, run, scale in curves:
        drawn |= {name: rounded(scale * run.link_position[pick, 0]), f"{name}_motor": rounded(scale * run.motor_position[pick, 0])}
    return drawn | {"growth": growth, "hz": math.nan, "added": f"{LOAD:g} N·m on the link", "unit": "mrad"}
