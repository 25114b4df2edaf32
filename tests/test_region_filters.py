"""Regions of gains behind velocity filters: contained is what an independent root count calls stable, and max_kd is where that ends.

Random joints of every kind (wide_joints.py) with filters of order 1 and 2. Another draw: GAINROOM_SEED=7; all 400 with `-m population`.
"""

import os
from dataclasses import replace
from math import inf, isinf, isnan
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from independent.delay_roots import UndecidedError
from wide_joints import Case, wide

SEED = int(os.environ.get("GAINROOM_SEED", "1"))
WHOLE, SHARE, BATCH = 400, 20, 10
SHIFT = 1e-6  # relative: the claim to be confirmed


def draw(index: int) -> Case:
    """Every other one continuous, and of those two in five without delay, where the curves run straightest."""
    rng = np.random.default_rng([SEED, index])
    while True:
        case = wide(rng, bool(index % 2))
        if case.low_pass is None or min(case.gains) < 0:
            continue
        if case.sample_time is None and rng.random() < 0.4:
            case = replace(case, joint=replace(case.joint, delay=0.0, bandwidth=inf if rng.random() < 0.5 else case.joint.bandwidth))
        return case


def plane(case: Case) -> tuple[float, float]:
    """The gains in the region's axes."""
    first, *_, last = case.gains
    return (first * case.gains[1], case.gains[1]) if case.kind == "PPI" else (first, last)


def at(case: Case, kp: float, kd: float) -> Case:
    """The same controller at a point of the plane, its ratio of integral gain held."""
    if case.kind == "PD":
        gains = (kp, kd)
    elif case.kind == "PID":
        gains = (kp, case.gains[1] / case.gains[0] * kp, kd)
    else:
        gains = (kp / kd, kd, case.gains[2] / case.gains[1] * kd)
    return replace(case, gains=tuple(float(gain) for gain in gains))


def disagreements(index: int) -> list[str]:
    case, rng = draw(index), np.random.default_rng([SEED, index, 1])
    side: Any = case.joint.feedback
    region = gr.pd_region(*case.parts(), feedback=side, sample_time=case.sample_time, controller=case.controller())
    kp, kd = plane(case)
    found = []

    def unstable(kp: float, kd: float) -> int | None:
        try:
            return at(case, kp, kd).truth().count()
        except UndecidedError:
            return None

    for _ in range(3):
        point = (kp * 10 ** rng.uniform(-3, 3), kd * 10 ** rng.uniform(-3, 3))
        count, inside = unstable(*point), bool(region.contains(*point))
        if count is not None and inside != (count == 0):
            found.append(f"contains {point}: {inside}, with {count} unstable roots")
    top = region.max_kd(kp)
    if isinf(top):
        found += [f"max_kd inf, unstable at {factor:g}" for factor in (1.0, 10.0) if unstable(kp, kd * factor)]
    elif not isnan(top) and top > 0:
        if unstable(kp, top * (1 - SHIFT)):
            found.append(f"unstable just below max_kd {top!r}")
        if unstable(kp, top * (1 + SHIFT)) == 0:
            found.append(f"stable just above max_kd {top!r}")
    return found


@pytest.mark.parametrize("start", range(0, SHARE, BATCH))
def test_share_of_the_population(start):
    wrong = {index: found for index in range(start, start + BATCH) if (found := disagreements(index))}
    assert not wrong, f"population {SEED}: {wrong}"


@pytest.mark.population
@pytest.mark.skipif("'population' not in config.getoption('markexpr')", reason="runs with -m population")
@pytest.mark.parametrize("start", range(0, WHOLE, BATCH))
def test_whole_population(start):
    wrong = {index: found for index in range(start, start + BATCH) if (found := disagreements(index))}
    assert not wrong, f"population {SEED}: {wrong}"


@pytest.mark.parametrize("viscous", [2.3517612e-05, 1e-9, 0.0])
def test_second_order_filter_without_delay(viscous):
    """At the filter's bandwidth position and velocity gains pull in one phase: the boundary is a line there, however little damping."""
    joint = gr.ElasticJoint(0.1418746, 0.00065279940, 2.2088560, 0.0, link_viscous=viscous)
    template = gr.PD(1.0, 1.0, velocity_filter=gr.LowPass(1571.928, 2, 0.64986907))
    region = gr.pd_region(joint, gr.Drive(), controller=template)
    kp = 595.368
    # D(jw) = kp + kd w/(2ζ) meets −1/P(jw), P of two masses without damping
    w, motor, link, stiffness = 1571.928, 0.1418746, 0.00065279940, 2.2088560
    swing = stiffness - link * w**2
    needed = w**2 * (motor * swing + link * stiffness) / swing - kp
    expected = needed * 2 * 0.64986907 / w
    assert not region.contains(kp, 462.978)
    if viscous:
        assert region.max_kd(kp) == pytest.approx(expected, rel=1e-4)  # the viscous torque moves the line by that little
        assert region.contains(kp, 0.99 * expected)
    assert not region.contains(kp, 1.01 * expected)


@pytest.mark.parametrize("index", [91, 101])
def test_roots_are_counted_where_few_turns_of_the_delay_matter(index):
    """The first counts were taken at gains with hundreds of unstable roots, and were two off."""
    if SEED == 1:
        assert not disagreements(index)
