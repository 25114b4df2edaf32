"""The largest scale of gains: against single joints where nothing couples, and against its own definition where everything does."""

import itertools
from dataclasses import replace
from math import inf, nan, pi

import numpy as np
import pytest

import gainroom as gr
from draws import draw_plant
from gainroom.coupled import joint_margins
from gainroom.coupled_gains import largest_scale
from gainroom.io.numbers import margin_value
from gainroom.kept import Kept, kept_by

DRIVE = gr.Drive(4000.0, 0.9, 2e-3)
REQUIRED = gr.Requirements.usual()


def scalable(plant, kp, kd, delay=2e-3):
    return lambda scale: gr.build_loop(plant, gr.Drive(4000.0, 0.9, delay), gr.PD(scale**2 * kp, scale * kd))


@pytest.mark.parametrize("gains", [(200.0, 10.0), (3000.0, 40.0), (900.0, 45.0)])
def test_one_joint_keeps_its_margins(gains):
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), DRIVE, gr.PD(*gains))
    kept, exact = kept_by(loop), gr.margins(loop)
    lower = 1 / exact.lower_gain_margin if exact.lower_gain_margin else inf
    # both polished; the peak by narrowing to a millionth of its width, on which it is flat
    assert kept.gain_margin == pytest.approx(min(exact.gain_margin, lower), rel=1e-9)
    assert kept.phase_margin == pytest.approx(abs(exact.phase_margin), rel=1e-9)
    assert kept.peak_sensitivity == pytest.approx(exact.peak_sensitivity, rel=1e-7)


@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("seed", range(3))
def test_coupled_joints_keep_the_least_of_all_their_margins(seed, sample_time):
    """Against the polished uniform margins, and against each loop's own return ratio on a dense grid."""
    rng = np.random.default_rng([44, seed])
    size = int(rng.integers(3, 7))
    loop = gr.build_loop(draw_plant(rng, size), DRIVE, gr.PD(rng.uniform(30, 90, size), rng.uniform(1, 4, size)), sample_time=sample_time)
    whole = joint_margins(loop)
    assert whole.stable
    kept = kept_by(loop)
    omega = np.geomspace(0.1, 6000.0, 200_000)
    sensitivity = np.diagonal(np.linalg.inv(np.eye(size) + loop.response(omega)), axis1=1, axis2=2)
    own = 1 / sensitivity - 1
    rows, joints = np.nonzero((np.abs(own[:-1]) > 1) != (np.abs(own[1:]) > 1))
    phases = np.abs(np.angle(-own[rows, joints]))
    rows, joints = np.nonzero(((own.imag[:-1] > 0) != (own.imag[1:] > 0)) & (own.real[1:] < 0))
    factors = np.exp(np.abs(np.log(-own.real[rows, joints])))
    lower = 1 / whole.limit.lower_gain if whole.limit.lower_gain else inf
    # the grid's steps are 5.5e-5 of ω, over which a phase near a resonance turns by some thousandths
    assert kept.phase_margin == pytest.approx(min(whole.phase_margin, phases.min(initial=inf)), rel=5e-3)
    assert kept.phase_margin <= whole.phase_margin * (1 + 1e-9)
    assert kept.gain_margin == pytest.approx(min(whole.limit.gain, lower, factors.min(initial=inf)), rel=5e-3)
    assert kept.gain_margin <= min(whole.limit.gain, whole.others_closed.min()) * (1 + 1e-9)
    assert kept.peak_sensitivity == pytest.approx(np.abs(sensitivity).max(), rel=1e-4)
    assert kept.peak_sensitivity >= np.abs(sensitivity).max() * (1 - 1e-9)


def test_an_unstable_loop_keeps_nothing():
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), DRIVE, gr.PD(2000.0, 300.0))
    assert not kept_by(loop).stable
    assert not kept_by(loop).meets(REQUIRED)


@pytest.mark.parametrize("seed", range(4))
def test_just_above_the_scale_a_requirement_breaks(seed):
    rng = np.random.default_rng([41, seed])
    size = int(rng.integers(2, 5))
    kp, kd = rng.uniform(30, 90, size), rng.uniform(1, 4, size)
    cases = [scalable(draw_plant(rng, size), kp, kd, delay) for delay in (2e-3, 3e-3)]
    found = largest_scale(cases, REQUIRED)
    assert found.scale > 0
    assert all(kept_by(case(found.scale)).meets(REQUIRED) for case in cases)
    assert not all(kept_by(case(1.022 * found.scale)).meets(REQUIRED) for case in cases)
    assert not kept_by(cases[found.binding](1.022 * found.scale)).meets(REQUIRED)


def test_more_cases_never_allow_more():
    rng = np.random.default_rng(42)
    cases = [scalable(draw_plant(rng, 3), 60.0, 3.0) for _ in range(4)]
    scales = [largest_scale(cases[:count], REQUIRED).scale for count in (1, 2, 3, 4)]
    assert all(later <= earlier * 1.02 for earlier, later in itertools.pairwise(scales))
    assert scales[-1] == pytest.approx(min(largest_scale([case], REQUIRED).scale for case in cases), rel=0.021)  # each to 2 %


@pytest.mark.parametrize("accuracy", [0.02, 0.5])
def test_what_is_safe_in_all_cases_is_allowed_in_each(monkeypatch: pytest.MonkeyPatch, accuracy: float):
    """However coarsely every search stops."""
    monkeypatch.setattr("gainroom.coupled_gains.ACCURACY", accuracy)
    rng = np.random.default_rng(43)
    cases = [scalable(draw_plant(rng, 3), 60.0, 3.0) for _ in range(4)]
    safe = largest_scale(cases, REQUIRED)
    for group in ([0], [1], [2, 3], [3, 0]):
        own = largest_scale([cases[k] for k in group], REQUIRED, start=safe.scale, known=safe.scale)
        assert own.scale >= safe.scale
        assert all(kept.meets(REQUIRED) for kept in own.kept)
        assert [kept_by(cases[k](own.scale)) for k in group] == list(own.kept)


def test_what_no_scale_meets():
    required = gr.Requirements(phase_margin=0.95 * pi)
    assert largest_scale([scalable(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), 2000.0, 30.0)], required).scale == 0


@pytest.mark.parametrize("name", ["gain_margin", "phase_margin", "peak_sensitivity"])
def test_met_to_round_off_and_no_further(name: str):
    """A margin that misses its requirement by less than 1e-6 of it is met, one that misses it by more is not and does not read as if."""
    asked = REQUIRED
    needed = getattr(asked, name)
    worse = 1.0 if name == "peak_sensitivity" else -1.0  # towards what is not allowed
    for miss, met in ((0.9e-6, True), (1.2e-6, False), (2e-5, False)):
        value = needed * (1 + worse * miss)
        kept = replace(Kept(True, 10.0, 2.0, 1.2), **{name: value})
        assert asked.met(name, value) is met
        assert kept.meets(asked) is met
        shown = margin_value(asked, name, value, met, 3)
        assert (shown == margin_value(asked, name, needed, True, 3)) is met
    assert asked.met(name, nan) is False
    assert gr.Requirements(**{other: getattr(asked, other) for other in asked.asked if other != name}).met(name, needed) is None
