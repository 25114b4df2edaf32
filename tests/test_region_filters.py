"""Regions of gains behind velocity filters: contained is what an independent root count calls stable, and max_kd and max_kp
are where that ends.

Random joints of every kind (wide_joints.py) with filters of order 1 and 2. Another draw: GAINROOM_SEED=7; all 400 with `-m population`.
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from math import inf, isfinite, isinf, isnan, nan
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from independent.delay_roots import UndecidedError
from wide_joints import Case, wide

SEED = int(os.environ.get("GAINROOM_SEED", "1"))
WHOLE, SHARE, BATCH = 400, 10, 10
SHIFT = 1e-6  # relative: the claim to be confirmed


def draw(seed: int, index: int) -> Case:
    """Every other one continuous, and of those two in five without delay, where the curves run straightest."""
    rng = np.random.default_rng([seed, index])
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


def is_stable(case: Case, kp: float, kd: float) -> bool | None:
    """By the independent count; None where it cannot tell."""
    try:
        return at(case, kp, kd).truth().count() == 0
    except UndecidedError:
        return None


def claims(region: gr.PDRegion, case: Case, rng: np.random.Generator) -> Iterator[tuple[str, float, float, bool]]:
    """(what is claimed, kp, kd, whether that point is stable then)."""
    kp, kd = plane(case)
    for _ in range(3):
        point = kp * 10 ** rng.uniform(-3, 3), kd * 10 ** rng.uniform(-3, 3)
        yield "contains", *point, bool(region.contains(*point))
    low, high = uppermost(region, kp)
    assert high == region.max_kd(kp) or isnan(high)
    if isfinite(high) and high > 0:
        yield "max_kd", kp, high - SHIFT * min(high, high - low), True
        yield "max_kd", kp, high * (1 + SHIFT), False
    if isinf(high):  # without limit, though not from 0 on
        for factor in (1 + SHIFT, 10.0, 1e5):
            yield "no limit to kd", kp, max(low, kd) * factor, True
    if low > 1e-12 * kd:  # below, it is rounding of 0
        yield "where the uppermost kd begin", kp, low * (1 - SHIFT), False
    yield from claims_of_max_kp(region, kd)


def claims_of_max_kp(region: gr.PDRegion, kd: float) -> Iterator[tuple[str, float, float, bool]]:
    """A kd is stable just below it, and just above it neither that one is nor any other."""
    top = region.max_kp()
    if isinf(top):
        low, high = uppermost(region, 0.5 * region.ladder[-1])
        yield "no limit to kp", 0.5 * region.ladder[-1], 2 * max(low, kd) if isinf(high) else 0.5 * (low + high), True
    elif top > 0:
        low, high = uppermost(region, top * (1 - SHIFT))
        inside = 2 * max(low, kd) if isinf(high) else 0.5 * (low + high)
        yield "max_kp", top * (1 - SHIFT), inside, True
        for factor in (0.01, 0.5, 0.99, 1.0, 1.01, 2.0, 100.0):
            yield "max_kp", top * (1 + SHIFT), inside * factor, False


def uppermost(region: gr.PDRegion, kp: float) -> tuple[float, float]:
    """The uppermost interval of kd at this kp; NaN where there is none."""
    intervals = region.columns([kp])[0]
    return (float(intervals[-1, 0]), float(intervals[-1, 1])) if len(intervals) else (nan, nan)


def disagreements(index: int, seed: int = SEED) -> list[str]:
    return wrong_claims(draw(seed, index), np.random.default_rng([seed, index, 1]))


def wrong_claims(case: Case, rng: np.random.Generator) -> list[str]:
    side: Any = case.joint.feedback
    region = gr.pd_region(*case.parts(), feedback=side, sample_time=case.sample_time, controller=case.controller())
    told = [(what, kp, kd, stable, is_stable(case, kp, kd)) for what, kp, kd, stable in claims(region, case, rng)]
    return [f"{what}: kp {kp!r}, kd {kd!r}: {stable}" for what, kp, kd, stable, truth in told if truth not in (None, stable)]


@pytest.mark.parametrize("start", range(0, SHARE, BATCH))
def test_share_of_the_population(start):
    wrong = {index: found for index in range(start, start + BATCH) if (found := disagreements(index))}
    assert not wrong, f"population {SEED}: {wrong}"


@pytest.mark.population
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


@pytest.mark.slow
@pytest.mark.parametrize("index", [91, 101, 187, 397])
def test_roots_are_counted_where_few_turns_of_the_delay_matter(index):
    """Counted first at gains with hundreds of unstable roots, where rounding and the grid blur them, the counts are two off."""
    assert not disagreements(index, seed=1)


@pytest.mark.parametrize("index", [97, 305])
def test_the_largest_kp_is_stable(index):
    """97: beside a notch of depth 0 the boundary runs to infinity between two samples, and kp had no limit. 305: so large a kp, against a
    negative kd, that roots had crossed at frequencies beyond those looked at."""
    assert not disagreements(index, seed=1)


@pytest.mark.parametrize("index", [207, 315])
def test_gains_without_an_upper_limit_may_have_a_lower_one(index):
    """Filters of order 1 without delay or current loop: kd is stable from a first value on, and then to any height."""
    case = draw(1, index)
    side: Any = case.joint.feedback
    region = gr.pd_region(*case.parts(), feedback=side, controller=case.controller())
    kp, kd = plane(case)
    low, high = uppermost(region, kp)
    assert high == inf
    assert 2 * kd < low
    assert not disagreements(index, seed=1)


def with_two_notches(index: int, apart: float) -> Case:
    """A joint of any kind under two notches of depth 0 whose frequencies differ by the share `apart`."""
    rng = np.random.default_rng([1, index, 77])
    while True:
        case = wide(rng, bool(index % 2))
        if case.notches and min(case.gains) >= 0:
            frequency, width, _ = case.notches[0]
            return replace(case, notches=((frequency, width, 0.0), (frequency * (1 - apart), 0.3, 0.0)))


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.0, 1e-15, 1e-12, 1e-9, 3e-9, 1e-6])
def test_two_notches_of_depth_0_at_one_frequency(apart):
    """Between their zeros lies no sample: taken for two simple ones, kp had no limit beside them."""
    wrong = {}
    for index in range(4):
        case = with_two_notches(index, apart)
        if found := wrong_claims(case, np.random.default_rng([1, index, 1])):
            wrong[index] = found
    assert not wrong
