"""Compared controllers pushed in simulation: what vibrates, and what does not."""

import numpy as np
import pytest

import gainroom as gr
from compared_joints import bench
from gainroom.studies.compared_runs import CASES, PUSH, pushed
from gainroom.system.system import System


def held(kp: float, kd: float) -> System:
    """The testbed with a PD."""
    system = bench()
    return System.of_joint(system.source, system.drives[0], gr.PD(kp, kd), sample_time=system.control.sample_time)


def test_a_push_moves_the_link_by_its_stiffness_and_friction_at_most():
    """In the end gearbox and gain give way in series; dry friction carries a part of the push, and the first swing goes further."""
    system = held(400.0, 16.0)
    every = pushed(system, 1.0)
    assert [one.case for one in every] == list(CASES)
    for one in every:
        stiffness = CASES[one.case][0] * 1e4
        rest = PUSH / 400.0 + PUSH / stiffness
        least = (PUSH - 1.0) / 400.0 + PUSH / stiffness
        assert least < one.peak < 2 * rest
        assert not one.vibrates


def test_gains_beyond_the_limit_vibrate_and_only_those():
    """1.3 times the limit of the least stable case makes that one vibrate, 0.7 times none, friction or not."""
    system = held(1600.0, 70.0)
    limits = {}
    for case, (stiffness, load, later) in CASES.items():
        joint = gr.ElasticJoint(0.2, load * 0.8, stiffness * 1e4, 1.0)
        loop = gr.build_loop(joint, gr.Drive(4000.0, 0.9, system.delay + later), gr.PD(1600.0, 70.0), sample_time=5e-4)
        limits[case] = gr.gain_limit(loop).gain
    least = min(limits, key=limits.__getitem__)
    for factor, vibrates in ((0.7, False), (1.3, True)):
        gain = factor * limits[least]
        (found,) = pushed(held(gain * 1600.0, gain * 70.0), 0.1, [least])
        assert found.vibrates == vibrates


def test_an_encoder_without_steps_is_refused():
    system = bench()
    drive = gr.Drive(4000.0, 0.9, system.delay)
    exact = System.of_joint(system.source, drive, gr.PD(400.0, 16.0), sample_time=5e-4)
    with pytest.raises(gr.GainroomError, match="encoder_resolution"):
        pushed(exact, 1.0)
    assert np.isfinite(pushed(held(400.0, 16.0), 1.0, ["nominal"])[0].peak)
