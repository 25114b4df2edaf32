"""Regions of gains under a trace of friction: a pole next to an integrator moves no boundary by more than its own size.

Against a closed form, against the joint without friction, and against the independent count of roots. Another draw: GAINROOM_SEED=7.
"""

import os
from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
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


@pytest.mark.parametrize("friction", [1e-12, 1e-6])
def test_gains_are_recommended_as_without_friction(friction):
    joint, drive, control = SAMPLED
    without, with_it = (
        gr.recommend_pd(each, drive, sample_time=1e-3, controller=control) for each in (joint, replace(joint, motor_viscous=friction))
    )
    assert without is not None
    assert with_it is not None
    assert (with_it.kp, with_it.kd) == (without.kp, without.kd)  # both rounded to the digits that are given
