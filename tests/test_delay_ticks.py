"""Delays at and around whole ticks: nothing jumps there, and what is claimed is confirmed by the independent sampled closed loop."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

import gainroom as gr
from gainroom.simulation.torque_line import TorqueLine
from gainroom.system.linear.state_space import split_delay
from independent import margins, sampled
from independent.joint import PDJoint
from joint_truths import EXAMPLE, TICK, build, parts

NEAR = [sign * 10.0**-k for k in range(4, 15) for sign in (-1, 1)]  # relative distances from a whole number of ticks
JOINTS = {
    "example": EXAMPLE,
    "ideal current loop": replace(EXAMPLE, bandwidth=inf, kp=500.0, kd=15.0),
    "rigid": PDJoint(0.2, 0.8, inf, 0.0, kp=500.0, kd=15.0, bandwidth=4000),
    "link side": replace(EXAMPLE, feedback="link", kp=40.0, kd=0.9, damping=20.0),
    "lightly damped, link side": replace(EXAMPLE, feedback="link", kp=1.0, kd=0.01, damping=1e-2, bandwidth=1000.0),
}
SHIFT = 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", JOINTS)
@pytest.mark.parametrize("ticks", [1, 2, 5])
def test_gain_margin_is_continuous_and_true(name, ticks):
    joint = replace(JOINTS[name], delay=ticks * TICK)
    limit = gr.gain_limit(build(joint, TICK)).gain
    assert 0 < limit < inf
    for near in NEAR:
        late = replace(joint, delay=joint.delay * (1 + near))
        found = gr.gain_limit(build(late, TICK)).gain
        assert found == pytest.approx(limit, rel=100 * abs(near) + 1e-9)  # a delay changes a limit some ten times less than that
        assert sampled.is_stable(late.scaled(found * (1 - SHIFT)), TICK)
        assert not sampled.is_stable(late.scaled(found * (1 + SHIFT)), TICK)


@pytest.mark.parametrize("name", JOINTS)
@pytest.mark.parametrize("near", [0.0, *NEAR])
def test_the_response_is_that_of_the_closed_loop_matrix(name, near):
    """From zeros and poles and from states, against one solve per frequency with the independent matrices."""
    joint = replace(JOINTS[name], delay=3 * TICK * (1 + near))
    loop = build(joint, TICK)
    omega = np.geomspace(1.0, 6000.0, 40)
    expected = margins.response(joint, omega, TICK)
    assert loop.response(omega) == pytest.approx(expected, rel=1e-7)  # the independent matrices lose 9 digits on a roll-off of 1/s⁶
    v = np.expm1(1j * omega * TICK) / TICK
    assert loop.open_loop is not None
    assert loop.open_loop.at(v)[:, 0, 0] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("name", ["example", "rigid"])
@pytest.mark.parametrize("near", [0.0, *NEAR])
def test_delay_margin_that_ends_near_whole_ticks(name, near):
    """The delay that is lost, and the delay margin of a loop that is given less than it."""
    start = JOINTS[name]
    whole = start.delay + gr.margins(build(start, TICK)).delay_margin
    joint = replace(start, delay=TICK * np.floor(whole / TICK) * (1 + near))
    found = gr.margins(build(joint, TICK)).delay_margin
    assert joint.delay + found == pytest.approx(whole, rel=1e-9)


@pytest.mark.parametrize("near", NEAR)
def test_a_share_that_rounds_to_a_tick_is_one(near):
    for ticks in (1, 3, 17, 4000):
        whole, fraction = split_delay(ticks * TICK * (1 + near), TICK)
        assert 0 <= fraction < 1
        assert whole + fraction == pytest.approx(ticks * (1 + near), rel=2e-12)


@pytest.mark.parametrize("near", NEAR)
def test_torques_in_simulation_are_continuous_in_the_delay(near):
    """A command's step response through delay and current loop, three substeps to a tick."""
    drive = parts(EXAMPLE)[1]

    def torques(delay: float) -> np.ndarray:
        line = TorqueLine([replace(drive, delay=delay)], TICK, 3)
        return np.concatenate([line.tick(np.ones(1)) for _ in range(9)])

    assert torques(2 * TICK * (1 + near)) == pytest.approx(torques(2 * TICK), abs=30 * abs(near) + 1e-11)  # ω_c times two ticks is 4
