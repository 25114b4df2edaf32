"""The gains of one joint that are good in all of a robot's states, against counts of the roots at random gains."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from gainroom.analysis.margins import margins
from gainroom.analysis.part_region_every_state import RegionInEveryState
from gainroom.analysis.stability import is_stable
from gainroom.cli.example import example_texts
from gainroom.files.robot_yaml import parse_robot
from gainroom.system.loop import Loop
from gainroom.system.loop_part import LoopPart
from gainroom.system.requirements import Requirements
from gainroom.system.system import System

pytest.importorskip("pinocchio")
TEXT = example_texts()["biped"].replace("sample_rate_hz: 2000", "#")
MARGIN = 2.0
SAMPLED = TEXT.replace("kd: 100.0 ", "sample_rate_hz: 1000\n  kd: 100.0 ")
CASCADE = TEXT.replace("type: pd", "type: ppi").replace("kp: 2000.0 ", "kp: 20.0 ").replace("kd: 100.0 ", "ki: 20.0\n  kv: 100.0 ")
CASES = [
    (TEXT, "left_knee", (9000.0, 900.0)),
    (SAMPLED, "right_ankle_pitch", (9000.0, 700.0)),
    (CASCADE, "left_hip_roll", (9000.0, 900.0)),
]


def holds(outlines: tuple[np.ndarray, ...], point: tuple[float, float], window: tuple[float, float]) -> list[bool]:
    """Whether the point, and points 1 % of the picture around it, lie within: near an edge not all agree."""
    places = [np.array(point) + 0.01 * np.array(window) * np.array(step) for step in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
    return [sum(Outline(outline).contains_point(place) for outline in outlines) % 2 == 1 for place in places]


STATES = [("stand", "double"), ("stand", "left"), ("crouch", "flight")]
SHARE, WHOLE = (14, STATES), (25, None)
"""Draws of gains and states of the robot, None: all of its eight: every time, and by -m population."""


def system_and_models(text: str, states: list[tuple[str, str]] | None) -> tuple[System, list[Any]]:
    system = parse_robot(text, "biped.yaml")
    return system, [system.source.linearize(*place) for place in states or system.source.states]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "states"), [SHARE, pytest.param(*WHOLE, marks=pytest.mark.population)], ids=["share", "all"])
@pytest.mark.parametrize(("text", "joint", "window"), CASES)
def test_random_gains_are_good_in_every_state_where_the_outlines_say_so(
    text: str, joint: str, window: tuple[float, float], count: int, states: list[tuple[str, str]] | None
):
    """Stable: the certified count in all states. Margin: counts at factors, not all seen by the picture, on all gains, and on these."""
    system, models = system_and_models(text, states)
    k, size = system.source.joint_names.index(joint), models[0].size
    loops = [system.loop(model) for model in models]
    together = RegionInEveryState([(loop, LoopPart.of_joint(loop, k)) for loop in loops], window)
    stable, safe = together.stable(), together.required(Requirements(gain_margin=MARGIN))
    own = system.control.controller
    draw, counts, looked = np.random.default_rng(4), [0, 0], 0

    def good(kp: float, kd: float, common: float, mine: float) -> bool:
        moved = own.on_joint(k, size).from_plane(kp, kd).scaled(mine)
        gains = {name: np.broadcast_to(getattr(own, name), size).astype(float) for name in own.gain_names()}
        for name in gains:
            gains[name][k] = getattr(moved, name)
        return all(is_stable(system.loop(model, replace(own, **gains)).scaled(common)) for model in models)

    for kp, kd in (draw.uniform(0.03, 1, (count, 2)) * window).tolist():
        here, kept = holds(stable, (kp, kd), window), holds(safe, (kp, kd), window)
        own_gains = good(kp, kd, 1.0, 1.0)
        if len(set(here)) == 1:  # else nearer to an edge than the picture is exact
            assert here[0] == own_gains, (kp, kd)
            counts[0] += here[0]
            looked += 1
        if len(set(kept)) == 1:
            ends = (0.505, 0.7, 1.5, 1.98)
            truth = own_gains and all(good(kp, kd, factor, 1.0) and good(kp, kd, 1.0, factor) for factor in ends)
            assert kept[0] == truth, (kp, kd)
            counts[1] += kept[0]
    assert looked > 0.6 * count
    assert 2 <= counts[1] <= counts[0] < looked


@pytest.mark.slow
@pytest.mark.parametrize(("count", "states"), [SHARE, pytest.param(*WHOLE, marks=pytest.mark.population)], ids=["share", "all"])
@pytest.mark.parametrize(("text", "joint", "window"), CASES[:2])
def test_the_sensitivity_of_every_loop_in_every_state(
    text: str, joint: str, window: tuple[float, float], count: int, states: list[tuple[str, str]] | None
):
    """The truth: |((I + L)⁻¹)_jj| of all joints on a dense grid, of loops that are built with the random gains themselves."""
    system, models = system_and_models(text, states)
    k, size = system.source.joint_names.index(joint), models[0].size
    together = RegionInEveryState([(loop, LoopPart.of_joint(loop, k)) for loop in map(system.loop, models)], window)
    needed = 5.0  # of the file's gains it is 3.9
    found = together.required(Requirements(peak_sensitivity=needed), others=True)
    omega = np.geomspace(0.3, 3100.0 if "sample_rate" in text else 6000.0, 4000)
    own = system.control.controller
    draw, counts = np.random.default_rng(9), [0, 0]
    for kp, kd in (draw.uniform(0.02, 1, (count, 2)) * window).tolist():
        here = holds(found, (kp, kd), window)
        gains = {name: np.broadcast_to(getattr(own, name), size).astype(float) for name in own.gain_names()}
        gains["kp"][k], gains["kd"][k] = kp, kd
        loops = [system.loop(model, replace(own, **gains)) for model in models]
        if len(set(here)) > 1:
            continue
        peaks = (np.abs(np.diagonal(np.linalg.inv(np.eye(size) + loop.response(omega)), axis1=1, axis2=2)).max() for loop in loops)
        truth = all(is_stable(loop) for loop in loops) and max(peaks) < needed
        assert here[0] == truth, (kp, kd)
        counts[int(truth)] += 1
    assert min(counts) >= 2


def turns(values: np.ndarray) -> np.ndarray:
    """Of numbers (k, …) along k, in turns around 0."""
    return np.angle(values[1:] / values[:-1]).sum(axis=0) / (2 * np.pi)


def keeps(values: np.ndarray, factors: np.ndarray) -> bool:
    """Nyquist: whether the product of 1 + c λ over the values λ (k, n) goes as often around 0 with every c as with c = 1.

    Half a turn tells: a root that crosses the boundary changes the count by one, the ends of the grid move it by far less.
    """
    counts = np.array([turns((1 + c * values).prod(axis=1)) for c in (1.0, *factors)])
    return bool(np.abs(counts - counts[0]).max() < 0.5)


ASKED = Requirements(gain_margin=MARGIN, phase_margin=np.radians(9.0), peak_sensitivity=5.0)  # of the file's gains: 15.3 dB, 10.6°, 3.9


ALONE = [("phase_margin", 0), ("gain_margin", 1), *(pytest.param(*pair, marks=pytest.mark.population) for pair in (
    ("phase_margin", 1), ("phase_margin", 2), ("gain_margin", 0), ("gain_margin", 2)
))]  # fmt: skip
"""One requirement by itself, and a case: each in one case every time."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "case"), [("", 0), ("", 1), ("", 2), *ALONE])
def test_every_requirement_of_every_loop_and_of_all_together(name: str, case: int):
    """The truth: Nyquist's criterion on a dense grid at factors and phases, of L's eigenvalues and of each loop's own return ratio."""
    (text, joint, window), asked = CASES[case], ASKED.only(name) if name else ASKED
    system, models = system_and_models(text, STATES)
    k, size = system.source.joint_names.index(joint), models[0].size
    together = RegionInEveryState([(loop, LoopPart.of_joint(loop, k)) for loop in map(system.loop, models)], window)
    found = together.required(asked, others=True)
    omega = np.geomspace(0.3, 3100.0 if "sample_rate" in text else 6000.0, 1500)
    angle = asked.phase_margin or 0.0
    factors = np.append(np.exp(1j * np.linspace(-angle, angle, 12)), np.geomspace(1 / MARGIN, MARGIN, 12) if asked.gain_margin else [])
    own = system.control.controller

    def truth(kp: float, kd: float) -> bool:
        gains = {name: np.broadcast_to(getattr(own, name), size).astype(float) for name in own.gain_names()}
        moved = own.on_joint(k, size).from_plane(kp, kd)
        for name in gains:
            gains[name][k] = getattr(moved, name)

        def good(loop: Loop) -> bool:
            if not is_stable(loop):
                return False
            response = loop.response(omega)
            single = np.diagonal(np.linalg.inv(np.eye(size) + response), axis1=1, axis2=2)
            low = not asked.peak_sensitivity or np.abs(single).max() < asked.peak_sensitivity
            apart = all(keeps(1 / single[:, [j]] - 1, factors) for j in range(size))
            return low and apart and keeps(np.linalg.eigvals(response), factors)

        return all(good(system.loop(model, replace(own, **gains))) for model in models)

    for kp, kd in (np.random.default_rng(12).uniform(0.02, 1, (10, 2)) * window).tolist():
        here = holds(found, (kp, kd), window)
        if len(set(here)) == 1:
            assert here[0] == truth(kp, kd), (kp, kd)
        else:  # an edge of the picture is near: one of the truth is no farther than the picture is exact beside it
            steps = [(0, 0), (2, 0), (-2, 0), (0, 2), (0, -2), (2, 2), (2, -2), (-2, 2), (-2, -2)]
            near = (truth(kp + 0.01 * a * window[0], kd + 0.01 * b * window[1]) for a, b in steps)
            first = next(near)
            assert any(other != first for other in near), (kp, kd)


def test_a_vibration_in_which_the_joint_has_no_say():
    """One leg stands, the other's hip is dragged: the standing leg's 7.7° of phase leave nothing of 8°, and do not take from 7.5°."""
    system = parse_robot(CASCADE, "biped.yaml")
    loop = system.loop(system.source.linearize("stand", "right"))
    part = LoopPart.of_joint(loop, system.source.joint_names.index("left_hip_roll"))
    assert np.degrees(margins(loop).phase_margin) == pytest.approx(7.7, abs=0.1)  # certified; of the file's gains
    together = RegionInEveryState([(loop, part)], (9000.0, 900.0))
    assert together.required(Requirements(phase_margin=np.radians(8.0)), others=True) == ()
    assert together.required(Requirements(phase_margin=np.radians(7.5)), others=True) != ()
