"""Limits under a trace of friction: a pole next to an integrator moves no boundary by more than its own size.

Against a closed form, against the joint without friction, and against the independent count of roots. Another draw: GAINROOM_SEED=7.
"""

import os
from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from independent.machine import Machine, unstable
from machines import Pair, between, paired
from test_region_filters import wrong_claims
from wide_joints import Case, wide

SEED = int(os.environ.get("GAINROOM_SEED", "1"))
WHOLE, SHARE, BATCH = 300, 8, 10
TRACES = [1e-18, 1e-12, 1e-8, 1e-6, 5.004e-6, 1e-5]  # [N·m·s/rad]


def draw(index: int) -> Case:
    """A joint of wide_joints.py with motor and link friction, one or both, of 1e-12 to 1e-2 N·m·s/rad; most of them with an integrator."""
    rng = np.random.default_rng([SEED, index, 77])
    case = wide(rng, bool(rng.random() < 0.5))
    while min(case.gains) < 0 or (case.kind == "PD" and rng.random() < 0.7):
        case = wide(rng, bool(rng.random() < 0.5))
    trace, where = 10 ** rng.uniform(-12, -2), rng.integers(3)
    motor, link = trace * (where != 1), trace * rng.uniform(0.1, 3) * (where > 0)
    return replace(case, joint=replace(case.joint, motor_viscous=motor, link_viscous=link))


def disagreements(start: int) -> dict[int, list[str]]:
    return {
        index: found for index in range(start, start + BATCH) if (found := wrong_claims(draw(index), np.random.default_rng([SEED, index])))
    }


@pytest.mark.slow
def test_a_share_of_regions_is_what_the_count_says():
    assert not disagreements(SHARE)


@pytest.mark.population
@pytest.mark.parametrize("start", range(0, WHOLE, BATCH))
def test_regions_are_what_the_count_says(start):
    assert not disagreements(start)


@pytest.mark.parametrize("friction", [*TRACES, 1e-2, 1.0])
@pytest.mark.parametrize("kp", [1e-12, 1e-3, 1.0, 1e6])
def test_rigid_joint_with_an_integrator(friction, kp):
    """J s³ + (f + kd) s² + kp s + ki, by Routh: kd > J ki/kp − f, whatever kp is."""
    inertia, ratio = 1.7, 0.4
    joint = gr.ElasticJoint(0.5 * inertia, 0.5 * inertia, motor_viscous=friction)
    region = gr.pd_region(joint, gr.Drive(np.inf), controller=gr.PID(1.0, ratio, 1.0))
    (interval,) = region.columns([kp])[0]
    assert interval == pytest.approx([inertia * ratio - friction, np.inf], rel=1e-9)  # round-off times the condition of two lines


SAMPLED = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3), gr.PID(160.0, 200.0, 6.0)
SOFT = gr.ElasticJoint(0.0408, 0.025, 13.9, 0.0151), gr.Drive(2000.0, 0.9, 2e-3), gr.PID(18.5, 69.3, 2.47)


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "drive", "control"), [SAMPLED, SOFT], ids=["stiff", "soft"])
@pytest.mark.parametrize("friction", TRACES)
def test_a_trace_of_friction_changes_a_trace(friction, joint, drive, control):
    """Limits on kp and kd move with friction by about as much as friction adds to kd: f of 1 N·m·s/rad, at sensitivities far below 1e3."""
    without, with_it = (
        gr.pd_region(each, drive, sample_time=1e-3, controller=control) for each in (joint, replace(joint, motor_viscous=friction))
    )
    slack = 1e3 * friction + 1e-11
    assert with_it.max_kp() == pytest.approx(without.max_kp(), rel=slack)
    for kp in (0.1 * control.kp, control.kp, 2 * control.kp):
        assert with_it.columns([kp])[0] == pytest.approx(without.columns([kp])[0], rel=slack)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [1e-12, 1e-6])
def test_gains_are_recommended_as_without_friction(friction):
    joint, drive, control = SAMPLED
    without, with_it = (
        gr.recommend_pd(each, drive, sample_time=1e-3, controller=control) for each in (joint, replace(joint, motor_viscous=friction))
    )
    assert without is not None
    assert with_it is not None
    assert with_it.stiffness == pytest.approx(without.stiffness, rel=5e-3)  # of a flat top, in few digits
    assert (with_it.kp, with_it.kd) == pytest.approx((without.kp, without.kd), rel=0.03)


def joints(index: int) -> Pair:
    """Two to four coupled joints, sampled, under PID or P/PI with filters; friction of 1e-12 to 1e-3 N·m·s/rad on motors, links or both."""
    rng = np.random.default_rng([SEED, index, 78])
    n, step = int(rng.integers(2, 5)), float(rng.choice([2.5e-4, 1e-3, 2e-3]))
    mixing = rng.normal(size=(n, n))
    w = np.eye(n) * between(rng, 0.3, 3) + 0.2 * mixing @ mixing.T
    inertia, stiffness = between(rng, 0.3, 3, n), between(rng, 1e3, 5e4, n)
    if rng.random() < 0.2:
        stiffness[0] = np.inf
    damping = np.where(np.isfinite(stiffness), between(rng, 1e-3, 1e-2) * np.sqrt(stiffness * inertia), 0.0)
    trace, where = 10 ** rng.uniform(-12, -3), rng.integers(3)
    motor, link = trace * rng.uniform(0.3, 3, n) * (where != 1), trace * rng.uniform(0.3, 3, n) * (where > 0)
    delay = np.full(n, step * rng.uniform(0.3, 4))
    corner = between(rng, 0.3, 3) * 0.1 / (delay[0] + 3e-3)
    kd = (inertia + 1 / np.diagonal(w)) * corner * rng.uniform(0.5, 1.5, n)
    kp, rate = 0.3 * corner * kd, corner * between(rng, 1e-3, 0.1)
    low_pass = (300.0, int(rng.integers(1, 3)), 0.7) if rng.random() < 0.4 else None
    filters = {} if low_pass is None else {"velocity_filter": gr.LowPass(*low_pass)}
    if rng.random() < 0.5:
        gains = {(0, 0): np.diag(kp), (1, 0): np.diag(kd), (0, 1): np.diag(rate * kp)}
        control = gr.PID(kp, rate * kp, kd, **filters)
    else:
        gains = {(0, 0): np.diag(kp), (1, 0): np.diag(kd), (0, 1): np.diag(rate * kp), (1, 1): np.diag(rate * kd)}
        control = gr.PPI(kp / kd, kd, rate * kd, **filters)
    machine = Machine(
        w, inertia, stiffness, damping, motor, link, None, None, np.full(n, 3000.0), np.full(n, 0.9), delay, gains, low_pass, None, "motor",
        step,
    )  # fmt: skip
    return paired(machine, control, f"{n} joints, {trace:.1g} N·m·s/rad")


def wrong_limits(index: int) -> list[str]:
    """A limit is where roots of the independent closed loop pass: 1e-4 of it moves them by far more than the round-off of eigenvalues."""
    pair = joints(index)
    found, stable = gr.gain_limit(pair.loop), unstable(pair.machine) == 0
    claims = [("stable", 1.0, found.stable), ("is_stable", 1.0, gr.is_stable(pair.loop))]
    for name, limit, way in (("limit", found.gain, 1), ("lower limit", found.lower_gain, -1)):
        if 0 < limit < np.inf:
            claims += [(name, limit * (1 - 1e-4 * way), True), (name, limit * (1 + 1e-4 * way), False)]
    if stable:
        margins = gr.margins(pair.loop)
        claims += [("margins", 1.0, margins.stable), ("certified", 1.0, margins.certified)]
    return [f"{pair.kind}: {name} at {factor}" for name, factor, told in claims if told is not (unstable(pair.machine.scaled(factor)) == 0)]


@pytest.mark.slow
def test_limits_of_some_coupled_joints_are_where_roots_pass():
    assert not [wrong for index in range(8) for wrong in wrong_limits(index)]


@pytest.mark.population
@pytest.mark.parametrize("start", range(8, 308, 20))
def test_limits_of_coupled_joints_are_where_roots_pass(start):
    assert not [wrong for index in range(start, start + 20) for wrong in wrong_limits(index)]
