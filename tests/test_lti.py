"""Systems of python-control and scipy.signal read into loops."""

import numpy as np
import pytest
import scipy.signal

import gainroom as gr
from refusals import assert_refused

NUMERATOR, DENOMINATOR = [2.0, 5.0, 30.0], [1.0, 6.0, 40.0, 90.0]
OMEGA = np.array([0.1, 2.0, 6.0, 25.0])


def scipy_system(form: str, step: float | None):
    given = () if step is None else (step,)
    if step is None:
        system = scipy.signal.TransferFunction(NUMERATOR, DENOMINATOR)
    else:
        numerator, denominator, _ = scipy.signal.cont2discrete((NUMERATOR, DENOMINATOR), *given)
        system = scipy.signal.TransferFunction(numerator.ravel(), denominator, dt=step)
    return {"tf": lambda: system, "zpk": system.to_zpk, "ss": system.to_ss}[form]()


def control_system(form: str, step: float | None):
    control = pytest.importorskip("control")
    system = control.tf(NUMERATOR, DENOMINATOR)
    if step is not None:
        system = control.sample_system(system, step)
    return {"tf": lambda: system, "ss": lambda: control.ss(system), "zpk": lambda: control.zpk(system.zeros(), system.poles(), 1.0)}[form]()


def expected_response(step: float | None) -> np.ndarray:
    s = 1j * OMEGA
    if step is None:
        return np.polyval(NUMERATOR, s) / np.polyval(DENOMINATOR, s)
    numerator, denominator, _ = scipy.signal.cont2discrete((NUMERATOR, DENOMINATOR), step)
    z = np.exp(s * step)
    return np.polyval(numerator.ravel(), z) / np.polyval(denominator, z)


@pytest.mark.parametrize("step", [None, 0.02], ids=["continuous", "discrete"])
@pytest.mark.parametrize("form", ["tf", "zpk", "ss"])
def test_scipy(form, step):
    loop = gr.loop_from(scipy_system(form, step))
    assert loop.sample_time == step
    # polynomials in z about 1: (z − 1)³ near 1e-8 costs that many digits at the lowest frequency
    assert loop.response(OMEGA) == pytest.approx(expected_response(step), rel=1e-12 if step is None else 1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("step", [None, 0.02], ids=["continuous", "discrete"])
@pytest.mark.parametrize("form", ["tf", "ss"])
def test_control(form, step):
    loop = gr.loop_from(control_system(form, step))
    assert loop.sample_time == step
    assert loop.response(OMEGA) == pytest.approx(expected_response(step), rel=1e-12 if step is None else 1e-8)


@pytest.mark.parametrize("step", [None, 0.02], ids=["continuous", "discrete"])
def test_delay_is_exact(step):
    delay = 0.06
    plain = gr.loop_from(scipy_system("tf", step)).response(OMEGA)
    assert gr.loop_from(scipy_system("tf", step), delay=delay).response(OMEGA) == pytest.approx(
        plain * np.exp(-1j * OMEGA * delay), rel=1e-12
    )


@pytest.mark.parametrize("step", [None, 0.02], ids=["continuous", "discrete"])
def test_every_form_has_the_same_margins(step):
    found = [gr.margins(gr.loop_from(scipy_system(form, step), delay=0.08)) for form in ("tf", "zpk", "ss")]
    for other in found[1:]:
        assert other.stable == found[0].stable
        for name in ("gain_margin", "phase_crossover", "delay_margin", "peak_sensitivity", "disk_margin"):
            assert getattr(other, name) == pytest.approx(getattr(found[0], name), rel=1e-8)  # as the responses above


def test_state_space_and_roots_carry_the_delay():
    """The closed-loop roots of the discrete loop are the zeros of z^k D(z) + N(z)."""
    step, ticks = 0.02, 3
    numerator, denominator, _ = scipy.signal.cont2discrete((NUMERATOR, DENOMINATOR), step)
    closed = np.polyadd(np.concatenate([denominator, np.zeros(ticks)]), numerator.ravel())
    expected = np.sort(np.abs(np.roots(closed)))[::-1]
    roots = gr.rightmost_roots(gr.loop_from(scipy_system("tf", step), delay=ticks * step), count=len(expected)).roots
    assert np.sort(np.exp(roots.real * step))[::-1] == pytest.approx(expected, rel=1e-9)


def test_unstable_poles_are_counted():
    assert gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, -1.0])).unstable_poles == 1
    assert gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, -2.0, 5.0])).unstable_poles == 2
    assert gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, 0.0, 0.0])).unstable_poles == 0  # on the axis: not counted
    assert gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, -1.1], dt=0.1)).unstable_poles == 1
    assert gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, -1.0], dt=0.1)).unstable_poles == 0
    assert gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, -1.0]), unstable_poles=0).unstable_poles == 0


def test_callable_takes_its_own_pole_count():
    loop = gr.loop_from(lambda s: 3 / (s - 1), unstable_poles=1)
    found = gr.margins(loop)
    assert found.stable
    assert not found.certified
    assert found.lower_gain_margin == pytest.approx(1 / 3, rel=1e-9)
    assert not gr.is_stable(gr.loop_from(lambda s: 0.5 / (s - 1), unstable_poles=1))


def test_an_lti_system_is_a_controller():
    """A lead filter from scipy closes the loop like the same PD behind a low-pass."""
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    lead = scipy.signal.TransferFunction([30.0 * 900 + 2000.0, 2000.0 * 900], [1.0, 900.0])
    found = gr.build_loop(joint, drive, lead)
    expected = gr.build_loop(joint, drive, gr.PD(2000.0, 30.0, velocity_filter=gr.LowPass(900.0)))
    omega = np.array([1.0, 40.0, 490.0, 3000.0])
    assert found.response(omega) == pytest.approx(expected.response(omega), rel=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: gr.loop_from(3.0), ["float", "python-control or scipy.signal LTI", "callable"]),
        (lambda: gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, 1.0]), delay=-1.0), ["delay", "-1", ">= 0"]),
        (lambda: gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, 0.5], dt=True)), ["dt", "True", "seconds"]),
        (
            lambda: gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, 0.5], dt=0.1), delay=0.25),
            ["delay", "0.25", "whole number", "0.1"],
        ),
        (lambda: gr.loop_from(scipy.signal.TransferFunction([1.0, 0.0], [1.0])), ["more zeros than poles"]),
        (lambda: gr.loop_from(scipy.signal.TransferFunction([2.0, 1.0], [1.0, 4.0]), delay=0.1), ["L(∞)", "2", "< 1"]),
        (lambda: gr.loop_from(scipy.signal.StateSpace(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))), ["2 inputs", "2 outputs"]),
        (
            lambda: gr.build_loop(
                gr.ElasticJoint(1.0, 1.0), gr.Drive(), scipy.signal.TransferFunction([1.0], [1.0, 0.5], dt=0.1), sample_time=0.2
            ),
            ["sample time 0.1", "0.2"],
        ),
    ],
)
def test_errors(make, words):
    assert_refused(make, words)


def test_control_mimo_is_refused():
    control = pytest.importorskip("control")
    with pytest.raises(gr.GainroomError, match="one"):
        gr.loop_from(control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))))
    with pytest.raises(gr.GainroomError, match="one"):
        gr.loop_from(control.tf([[[1.0], [1.0]], [[1.0], [2.0]]], [[[1.0, 1.0], [1.0, 2.0]], [[1.0, 1.0], [1.0, 3.0]]]))


def test_a_measured_response_is_refused():
    """Splines through it go anywhere beyond its last frequency: this stable loop was called unstable."""
    control = pytest.importorskip("control")
    omega = np.geomspace(0.1, 1e4, 300)
    for smooth in (True, False):
        measured = control.frd(300.0 / (1j * omega * (1j * omega + 30.0)), omega, smooth=smooth)
        with pytest.raises(gr.GainroomError, match="known at its own frequencies alone"):
            gr.loop_from(measured)


def test_control_unspecified_sample_time_is_refused():
    control = pytest.importorskip("control")
    with pytest.raises(gr.GainroomError, match="dt"):
        gr.loop_from(control.tf([1.0], [1.0, 0.5], True))
