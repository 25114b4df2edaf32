"""Biquads in a controller: against scipy's Tustin rule, against notches, and a loop's margins against the same law as an LTI."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import gainroom as gr
from gainroom.cli import main
from gainroom.files.joint_yaml import parse_joint
from gainroom.studies.joint import study_joint

TICK = 5e-4
JOINT = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0, 0.3, 0.7)
DRIVE = gr.Drive(4000.0, 0.9, 2.5e-3)
BIQUAD = gr.Biquad(300.0, 0.6, 500.0, 0.7)


def tustin(one: gr.Biquad, tick: float = TICK) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator in z by scipy, with a rate at which Tustin's rule keeps the pole frequency."""
    num = [1 / one.zero_frequency**2, 2 * one.zero_damping / one.zero_frequency, 1.0]
    den = [1 / one.pole_frequency**2, 2 * one.pole_damping / one.pole_frequency, 1.0]
    return signal.bilinear(num, den, one.pole_frequency / (2 * math.tan(one.pole_frequency * tick / 2)))


@pytest.mark.parametrize(
    "one", [BIQUAD, gr.Biquad(900.0, 0.05, 300.0, 1.2), gr.Biquad(5000.0, 0.0, 2500.0, 0.3), gr.Biquad(30.0, 2.0, 6000.0, 0.1)]
)
def test_response_is_that_of_scipy(one):
    omega = np.geomspace(1.0, 0.999 * math.pi / TICK, 400)
    _, expected = signal.freqz(*tustin(one), worN=omega * TICK)
    found = gr.PD(1.0, 0.0, biquads=one).transfer(TICK).response(omega)
    # scipy's coefficients in z lose (ω₂ T_s)² = 0.02 of their digits near z = 1; a zero on the axis is absolute
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("tick", [None, TICK, 2e-3])
def test_gain_is_one_at_rest_and_exact_at_the_poles(tick):
    w = BIQUAD.pole_frequency
    s = 1j * w
    at_poles = (s * s + 2 * 0.6 * 300.0 * s + 300.0**2) / 300.0**2 / 2j / 0.7
    found = gr.PD(1.0, 0.0, biquads=(BIQUAD,)).transfer(tick).response(np.array([1e-9, w]))
    assert found == pytest.approx([1.0, at_poles], rel=1e-11)


@pytest.mark.parametrize("tick", [None, TICK])
@pytest.mark.parametrize(("width", "depth"), [(0.5, 0.1), (1.3, 0.0), (0.2, 2.5)])
def test_notch_is_a_biquad_of_equal_frequencies(tick, width, depth):
    notch, biquad = gr.Notch(330.0, width, depth), gr.Biquad(330.0, depth * width / 2, 330.0, width / 2)
    for one, other in zip(notch.polynomials(tick), biquad.polynomials(tick), strict=True):
        assert one == pytest.approx(other, rel=1e-14)  # a few products


@pytest.mark.parametrize("tick", [None, TICK])
def test_biquads_multiply_and_their_order_does_not_matter(tick):
    others = gr.Biquad(300.0, 0.2, 200.0, 0.5), gr.Notch(500.0)
    omega = np.geomspace(1.0, 6000.0, 50)
    expected = np.ones(50, complex)
    for one in (BIQUAD, others[0]):
        expected = expected * gr.PD(1.0, 0.0, biquads=one).transfer(tick).response(omega)
    expected = expected * gr.PD(1.0, 0.0, notches=others[1]).transfer(tick).response(omega)
    for pair in ((BIQUAD, others[0]), (others[0], BIQUAD)):
        found = gr.PD(1.0, 0.0, biquads=pair, notches=(others[1],)).transfer(tick).response(omega)
        assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("feedback", ["motor", "link"])
@pytest.mark.parametrize(("kp", "kd"), [(900.0, 25.0), (150.0, 6.0)])
def test_margins_are_those_of_the_same_law_as_an_lti(feedback, kp, kd):
    """kp + kd (1 − 1/z)/T_s, times scipy's biquad."""
    num, den = tustin(BIQUAD)
    law = signal.dlti(np.polymul([kp + kd / TICK, -kd / TICK], num), np.polymul([1.0, 0.0], den), dt=TICK)
    place = {"feedback": feedback, "sample_time": TICK}
    found = gr.margins(gr.build_loop(JOINT, DRIVE, gr.PD(kp, kd, biquads=(BIQUAD,)), **place))
    expected = gr.margins(gr.build_loop(JOINT, DRIVE, gr.Compensator(law), **place))
    assert found.stable == expected.stable
    assert found.limit.gain == pytest.approx(expected.limit.gain, rel=1e-9)
    for name in ("gain_margin", "phase_margin", "delay_margin", "peak_sensitivity"):
        one, other = getattr(found, name), getattr(expected, name)
        assert one == pytest.approx(other, rel=1e-9, nan_ok=True), (
            name
        )  # roots of a polynomial in z of degree 4, near 1, lose half of their digits


def test_biquad_changes_a_loop_and_closing_it_in_joints_apart_keeps_them():
    """Two equal joints without coupling, sampled in the core, have the margins of one."""
    law = gr.PD(900.0, 25.0, biquads=(BIQUAD,))
    alone = gr.margins(gr.build_loop(JOINT, DRIVE, law, sample_time=TICK))
    plain = gr.margins(gr.build_loop(JOINT, DRIVE, gr.PD(900.0, 25.0), sample_time=TICK))
    assert abs(alone.peak_sensitivity / plain.peak_sensitivity - 1) > 0.05
    both = gr.Plant(np.eye(2) / 0.8, *(np.full(2, value) for value in (0.2, 1e4, 1.0, 0.3, 0.7)))
    found = gr.margins(gr.build_loop(both, (DRIVE, DRIVE), law, sample_time=TICK))
    assert found.gain_margin == pytest.approx(alone.gain_margin, rel=1e-6)


def test_recommended_gains_with_a_biquad_keep_the_requirements():
    """The default requirements, found in the kp–kd plane of the controller with its biquad."""
    law = gr.PD(1.0, 1.0, biquads=(BIQUAD,))
    found = gr.recommend_pd(JOINT, DRIVE, controller=law, sample_time=TICK)
    assert found is not None
    margins = gr.margins(gr.build_loop(JOINT, DRIVE, gr.PD(found.kp, found.kd, biquads=(BIQUAD,)), sample_time=TICK))
    assert margins.stable
    assert margins.peak_sensitivity <= 2.0 * (1 + 1e-6)


CONDITIONAL = """\
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 10000.0, damping: 1.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
control:
  type: pd
  kp: 3631.6
  kd: 568.14
  feedback: motor
  sample_rate_hz: 2000
  biquads: [{zero_frequency: 117.63, zero_damping: 0.26323, pole_frequency: 66.993, pole_damping: 0.04}]
limits: {peak_sensitivity: 2}
"""


def test_gains_below_which_a_loop_vibrates_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A biquad's resonance needs gain: at nominal values the loop is unstable below some 0.4 of the gains, as a count of its roots says."""
    path = tmp_path / "joint.yaml"
    path.write_text(CONDITIONAL, "utf-8")
    assert main(["joint", str(path)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    match = re.search(r"Lower gains vibrate, too, below ([\d.]+) × these, at ([\d.]+) Hz", told)
    assert match is not None
    loop, limit = parse_joint(CONDITIONAL, "joint.yaml").loop(), float(match[1])
    assert gr.is_stable(loop.scaled(1.1 * limit))
    roots = gr.rightmost_roots(loop.scaled(0.9 * limit)).roots
    assert roots[0].real > 0
    assert abs(roots[0].imag) / (2 * np.pi) == pytest.approx(float(match[2]), rel=0.1)  # a tenth off the limit


def test_gains_that_the_search_does_not_beat_may_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Where recommended gains have a softer link than the present ones, nobody is told that they are the stiffest."""
    system = parse_joint(CONDITIONAL, "joint.yaml")
    study = study_joint(system)
    assert study.recommended is not None
    ours, theirs = study.margins.dynamic_stiffness, study.recommended.worst.dynamic_stiffness
    path = tmp_path / "joint.yaml"
    path.write_text(CONDITIONAL, "utf-8")
    main(["joint", str(path)])
    told = " ".join(capsys.readouterr().out.split())
    assert ("no stiffer ones were found" in told) == (ours > theirs)
    assert ("The stiffest that meet the requirements" in told) == (ours <= theirs)


def test_simulate_says_whether_gains_to_try_are_lower_or_higher(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "joint.yaml"
    path.write_text(CONDITIONAL.replace("3631.6", "1800").replace("568.14", "280"), "utf-8")
    main(["simulate", str(path)])
    told = " ".join(capsys.readouterr().out.split())
    match = re.search(r"To see what (lower|higher) gains do, repeat this run with ([\d.]+) ×", told)
    assert match is not None
    assert match[1] == ("higher" if float(match[2]) > 1 else "lower")
    assert float(match[2]) > 1
