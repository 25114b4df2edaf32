"""Recommended gains of uncertain joints hold between the cases that were looked at, and what is called proved is true.

Another population: GAINROOM_SEED=7 pytest -m population tests/test_uncertain_joints.py. A share runs in every test run, all 260 with
`-m population`. How many were proved, only searched, or have no gains is printed (-s).
"""

import os
from collections import Counter
from dataclasses import replace
from math import inf, isinf, pi, sqrt

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import qmc

import gainroom as gr
from gainroom.analysis.box_loops import BoxLoop
from gainroom.analysis.range_proof import prove
from gainroom.design.joint_gains import recommend_pd
from gainroom.studies.joint import study_joint
from gainroom.system.requirements import Requirements
from gainroom.system.system import System
from uncertain_joints import MET, Uncertain, draw_uncertain, worst_found

SEED = int(os.environ.get("GAINROOM_SEED", "1"))
WHOLE, SHARE, BATCH = 260, 4, 20


def test_the_places_inside_are_scipy_s_halton_sequence():
    """The same digits, for one quantity to all five."""
    ranges = dict.fromkeys(gr.Uncertainty.__dataclass_fields__, (1.0, 2.0))
    while ranges:
        found = gr.Uncertainty(**ranges).inside(40)
        assert found[0] == (0.5,) * len(ranges)
        assert np.array_equal(found[1:], qmc.Halton(len(ranges), scramble=False).random(41)[1:])
        ranges.popitem()


def draw(number: int, seed: int = SEED) -> tuple[Uncertain, np.random.Generator]:
    rng = np.random.default_rng([seed, number])
    return draw_uncertain(rng), rng


def judged(number: int, seed: int = SEED, inner: int = 200) -> tuple[str, float]:
    """What is said of the recommended gains, and the least slack that an independent search finds."""
    case, rng = draw(number, seed)
    found = case.recommended()
    if found is None:
        return "none", inf
    least, _ = worst_found(lambda shares: case.slacks(found.controller, shares), len(case.ranges), rng, inner, polished=1 + (inner > 100))
    return "proved" if found.proved else "searched", min(least.values())


def assert_kept(numbers: range, inner: int = 200) -> None:
    found = {number: judged(number, inner=inner) for number in numbers}
    print(f"\nseed {SEED}, joints {numbers}: {dict(Counter(word for word, _ in found.values()))}")
    broken = {number: one for number, one in found.items() if one[1] < -MET}
    assert not broken, f"seed {SEED}: requirement missed by {broken}"


@pytest.mark.slow
def test_share_of_the_population():
    assert_kept(range(SHARE), inner=40)


@pytest.mark.population
@pytest.mark.parametrize("start", range(0, WHOLE, BATCH))
def test_whole_population(start):
    assert_kept(range(start, min(start + BATCH, WHOLE)))


@pytest.mark.slow
@pytest.mark.parametrize("number", [41, 48])
def test_the_worst_joint_lies_between_the_cases_looked_at(number):
    """Corners, centre and filling alone missed these by 10 % and 5 % in Ms: sampled, stiffness and inertias uncertain."""
    word, least = judged(number, seed=1, inner=60)
    assert word == "proved"
    assert least >= -MET


def boxes(loop: BoxLoop, rng: np.random.Generator, scaled: bool, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random boxes of one random relative width."""
    width = 10 ** rng.uniform(-4, -0.3)
    shares = rng.random((count, len(loop.names)))
    low = loop.low + (loop.high - loop.low) * shares * (1 - width)
    high = low + (loop.high - loop.low) * width
    top = loop.nyquist or 2e4
    ends = (0.1, 3.0) if scaled else (1e-3 * top, 0.9 * top)
    start = np.exp(rng.uniform(*np.log(ends), count))
    return np.column_stack([start, low]), np.column_stack([start * (1 + width * rng.random(count)), high])


@pytest.mark.parametrize("number", range(40))
def test_sectors_contain_the_loop(number):
    """L of build_loop, which knows nothing of boxes, lies in the sector of every box that holds its joint and frequency."""
    case, rng = draw(number, seed=5)
    loop = BoxLoop(case.joint, case.drive, case.uncertainty, case.controller, case.feedback, case.sample_time)
    assert loop.boundable
    scaled = number % 2 == 0 and not isinf(case.joint.stiffness)
    low, high = boxes(loop, rng, scaled, 10)
    sectors = loop.at(low, high, scaled)
    inside = 0
    for k in range(len(low)):
        point = rng.uniform(low[k], high[k])
        values = {**loop.nominal, **dict(zip(loop.names, point[1:].tolist(), strict=True))}
        drive = replace(case.drive, delay=values.pop("delay"))
        joint = replace(case.joint, **values)
        omega = point[0] * (sqrt(joint.stiffness * (1 / joint.motor_inertia + 1 / joint.link_inertia)) if scaled else 1.0)
        if omega > (loop.nyquist or inf):
            continue
        built = gr.build_loop(joint, drive, case.controller, feedback=case.feedback, sample_time=case.sample_time)
        value = built.response(omega)[0]
        size, tolerance = np.log(np.abs(value)), 1e-7  # what sampled zeros lose far below the sample rate
        assert sectors.log_low[k] - tolerance <= size <= sectors.log_high[k] + tolerance
        middle, reach = (sectors.phase_low[k] + sectors.phase_high[k]) / 2, (sectors.phase_high[k] - sectors.phase_low[k]) / 2
        assert abs(np.angle(value * np.exp(-1j * middle))) <= reach + tolerance
        inside += 1
    assert inside or scaled


def test_narrow_boxes_have_narrow_sectors():
    """Width of the sector falls with the square of what the mean value leaves out: a box 100 times narrower is 100 times narrower."""
    case, _ = draw(3, seed=5)
    loop = BoxLoop(case.joint, case.drive, case.uncertainty, case.controller, case.feedback, case.sample_time)
    middle = np.append(0.3 * (loop.nyquist or 300.0), 0.5 * (loop.low + loop.high))[None]
    wide, narrow = (loop.at(middle * (1 - width), middle * (1 + width), False) for width in (1e-4, 1e-6))
    assert 0 < narrow.phase_high - narrow.phase_low < 0.02 * (wide.phase_high - wide.phase_low)


TESTBED = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2.5e-3)
RANGES = gr.Uncertainty(delay=(2e-3, 3e-3), stiffness=(8e3, 12e3), link_inertia=(0.4, 4.0))


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("name", ["gain_margin", "phase_margin", "peak_sensitivity"])
def test_nothing_false_is_proved(name, sample_time):
    """Gains that keep a requirement with 0.2 % to spare are proved to; ask for 1 % more than they have, and they are not."""
    asked = Requirements(**{name: getattr(Requirements.usual(), name)})
    found = recommend_pd(*TESTBED, asked, RANGES, sample_time=sample_time)
    assert found is not None
    assert found.proved
    worst = {"gain_margin": found.worst.gain_headroom, "phase_margin": abs(found.worst.phase_margin),
             "peak_sensitivity": found.worst.peak_sensitivity}[name]  # fmt: skip
    more = Requirements(**{name: worst * (0.99 if name == "peak_sensitivity" else 1.01)})
    proof = prove(*TESTBED, RANGES, found.controller, more, sample_time=sample_time, most=20_000)
    assert not proof.holds


def hidden_window() -> tuple[System, float]:
    """A joint whose gains are unstable only for stiffnesses within 1 % of one, between the cases looked at; and that stiffness."""
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 0.3), gr.Drive(4000.0, 0.9, 8e-3)

    def limit(stiffness: float) -> float:
        return gr.gain_limit(gr.build_loop(replace(joint, stiffness=stiffness), drive, gr.PD(60.0, 4.0))).gain

    least = minimize_scalar(limit, bounds=(1.5e4, 3e4), method="bounded", options={"xatol": 1.0})
    worst, gain = float(least.x), 1.00005 * float(least.fun)  # the limit rises by 0.1 % within 3 % to either side
    # a range in which it lies at 0.53, between the places 1/2 and 9/16 of a filling of 16
    ends = worst / 1.8**0.53, worst * 1.8**0.47
    controller, ranges = gr.PD(60.0 * gain, 4.0 * gain), gr.Uncertainty(stiffness=ends)
    return System.of_joint(replace(joint, stiffness=ends[0]), drive, controller, "motor", uncertainty=ranges), worst


def test_an_instability_inside_the_ranges_is_found():
    spec, worst = hidden_window()
    study = study_joint(spec)
    assert study.margins.stable
    assert not study.stable_in_range
    found = study.unstable_at["stiffness"]
    assert found == pytest.approx(worst, rel=0.02)
    assert not gr.is_stable(spec.with_values(stiffness=found).loop())


def test_stable_gains_are_proved_stable_in_the_ranges():
    study = study_joint(System.of_joint(*TESTBED, gr.PD(100.0, 5.0), "motor", 5e-4, uncertainty=RANGES))
    assert study.stable_in_range
    assert study.range_proved


def test_work_that_runs_out_is_said():
    proof = prove(*TESTBED, RANGES, gr.PD(100.0, 8.0), Requirements.usual(), most=10)
    assert not proof.holds
    assert not proof.broken


def test_places_and_values_are_inverse():
    ranges = gr.Uncertainty(delay=(0.0, 2e-3), stiffness=(1e3, 8e3), damping=(1.0, 1.0))
    assert ranges.place({"delay": 5e-4, "stiffness": 2e3, "damping": 1.0}) == pytest.approx((0.25, 1 / 3, 0.0))
    joint, drive = ranges.case(*TESTBED, ranges.place({"delay": 5e-4, "stiffness": 2e3}))
    assert (joint.stiffness, drive.delay) == pytest.approx((2e3, 5e-4))
    assert 2 * pi * joint.damping == pytest.approx(2 * pi)
