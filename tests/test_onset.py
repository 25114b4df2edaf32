"""The gain at which simulated loops begin to vibrate is the gain that is computed without simulating."""

import math

import numpy as np
import pytest

import gainroom as gr
from draws import draw_plant
from gainroom.simulation.onset import find_onset, linear_onset, linear_vibration
from gainroom.simulation.oscillation import Vibration
from refusals import assert_refused

TICK = 5e-4
JOINT = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0)


def sampled(controller, joint: gr.ElasticJoint | gr.Plant = JOINT, ticks: float = 4.348, feedback: str = "motor") -> gr.Loop:
    return gr.build_loop(joint, gr.Drive(4000.0, 0.9, ticks * TICK), controller, feedback, TICK)


@pytest.mark.slow
@pytest.mark.parametrize(
    "loop",
    [
        sampled(gr.PD(1600.0, 60.0)),
        sampled(gr.PD(1600.0, 95.0)),
        sampled(gr.PID(900.0, 500.0, 30.0, velocity_filter=gr.LowPass(900.0), notches=(gr.Notch(490.0),)), ticks=5),
        sampled(gr.PPI(20.0, 30.0, 150.0)),
        sampled(gr.PD(60.0, 3.0), gr.ElasticJoint(0.2, 0.8, 1e4, 20.0), feedback="link"),
        sampled(gr.PD(900.0, 25.0), gr.ElasticJoint(0.2, 0.8)),
    ],
    ids=["stable", "unstable", "PID with filters", "PPI", "link", "rigid"],
)
def test_one_joint_vibrates_from_its_limit_on(loop):
    """Asked for is a thousandth; the bracket is a millionth wide, and growth of 1e-6 of ω is told from none."""
    limit, onset = gr.gain_limit(loop), linear_onset(loop)
    assert onset.gain == pytest.approx(limit.gain, rel=2e-6)
    assert onset.frequency == pytest.approx(limit.frequency, rel=1e-5)
    assert onset.stable < onset.gain < onset.growing or onset.growing < onset.gain < onset.stable


@pytest.mark.parametrize("ticks", [4.0, 4.348, 5.0])
def test_the_largest_kd_of_the_testbed(ticks):
    """At the paper's Kp 1600, against the region's boundary in closed form."""

    def shaken(kd: float) -> Vibration | None:
        return linear_vibration(sampled(gr.PD(1600.0, kd), ticks=ticks))

    region = gr.pd_region(JOINT, gr.Drive(4000.0, 0.9, ticks * TICK), sample_time=TICK)
    assert find_onset(shaken, 50.0, 120.0).gain == pytest.approx(region.max_kd(1600.0), rel=2e-6)


@pytest.mark.slow
def test_coupled_joints_vibrate_from_their_limit_on():
    rng = np.random.default_rng(1)
    plant = draw_plant(rng, 3)
    loop = sampled(gr.PD(np.diag(rng.uniform(200, 800, 3)), np.diag(rng.uniform(5, 20, 3)) + rng.normal(size=(3, 3))), plant)
    limit, onset = gr.gain_limit(loop), linear_onset(loop, tolerance=1e-5)
    assert onset.gain == pytest.approx(limit.gain, rel=2e-5)
    assert onset.frequency == pytest.approx(limit.frequency, rel=1e-4)


def test_any_curve_through_zero_is_followed():
    """Growth g³ − 2, straight nowhere, and cut off below: 2^(1/3) between both ends, whichever is larger."""

    def shaken(gain: float) -> Vibration | None:
        rate = gain**3 - 2
        return None if rate < -1.5 else Vibration(7.0, rate, 1.0)

    for ends, curve in (((0.1, 9.0), shaken), ((9.0, 0.1), lambda gain: shaken(1 / gain))):
        found = find_onset(curve, *ends, tolerance=1e-9)
        assert found.gain == pytest.approx(2 ** (1 / 3) if ends[0] < ends[1] else 2 ** (-1 / 3), rel=1e-9)
        assert found.frequency == 7.0
        assert found.runs < 60


def test_running_away_without_swinging_counts_as_growth():
    """Negative stiffness: no oscillation at all."""
    found = linear_vibration(sampled(gr.PD(-2000.0, 20.0)))
    assert found is not None
    assert found.growth_rate == math.inf


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: find_onset(lambda gain: Vibration(1.0, 1.0, 1.0), 1.0, 2.0), ["decay at 1", "grow at 2"]),
        (lambda: linear_onset(sampled(gr.PD(100.0, 5.0), gr.ElasticJoint(0.2, 0.8, 1e4), feedback="link")), ["grows at every factor"]),
        (lambda: linear_onset(sampled(gr.PD(1.0, 1.0)), duration=0.0), ["duration 0"]),
    ],
)
def test_what_has_no_onset_is_refused(make, words):
    assert_refused(make, words)
