"""Numbers that are not finite, not real or not physical are refused by name, wherever they come in."""

from math import inf, nan
from typing import Any

import numpy as np
import pytest
import scipy.signal

import gainroom as gr
from gainroom.system.linear.transfer_function import Factored
from refusals import assert_refused

JOINT, DRIVE = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
NONE = np.zeros(0, complex)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: scipy.signal.ZerosPolesGain([], [nan], 1.0), ["poles", "finite"]),
        (lambda: scipy.signal.ZerosPolesGain([], [-inf], 1.0), ["poles", "finite"]),
        (lambda: scipy.signal.ZerosPolesGain([nan], [-1.0, -2.0], 1.0), ["zeros", "finite"]),
        (lambda: scipy.signal.ZerosPolesGain([], [-1.0], nan), ["gain", "finite"]),
        (lambda: scipy.signal.ZerosPolesGain([], [-1.0], 1.0 + 2j), ["gain", "real"]),
        (lambda: scipy.signal.ZerosPolesGain([], [-1.0 + 2j], 1.0), ["poles", "conjugate"]),
        (lambda: scipy.signal.TransferFunction([1.0, nan], [1.0, 2.0, 1.0]), ["coefficients", "finite"]),
        (lambda: scipy.signal.TransferFunction([1.0], [1.0, 2.0 + 1j]), ["coefficients", "real"]),
        (lambda: scipy.signal.StateSpace([[-1.0 + 1j]], [[1.0]], [[1.0]], [[0.0]]), ["A", "real"]),
        (lambda: scipy.signal.StateSpace([[nan]], [[1.0]], [[1.0]], [[0.0]]), ["A", "finite"]),
        (lambda: Factored(NONE, np.array([complex(nan)]), 1.0), ["poles", "finite"]),
        (lambda: Factored(NONE, np.array([-1.0 + 0j]), inf), ["gain", "finite"]),
    ],
)
def test_systems(make, words):
    """As a loop and as a controller."""
    system = make()
    assert_refused(lambda: gr.loop_from(system), words)
    assert_refused(lambda: gr.Compensator(system), words)
    assert_refused(lambda: gr.build_loop(JOINT, DRIVE, system), words)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: gr.PD(np.array([100.0 + 1j, 50.0]), [5.0, 5.0]), ["PD", "kp", "real"]),
        (lambda: gr.PID(1.0, nan, 1.0), ["PID", "ki", "finite"]),
        (lambda: gr.PPI(1.0, 1.0, np.complex128(1j)), ["PPI", "ki", "real"]),
        (lambda: gr.PD(1.0, 1.0, velocity_filter=5.0), ["velocity_filter", "5.0", "LowPass"]),  # type: ignore[arg-type]
        (lambda: gr.PD(1.0, 1.0, notches=5), ["notches", "5", "Notch"]),  # type: ignore[arg-type]
        (lambda: gr.PD(1.0, 1.0, notches=("x",)), ["notches", "x", "Notch"]),  # type: ignore[arg-type]
        (lambda: gr.PD(1.0, 1.0, notches=(None,)), ["notches", "None", "Notch"]),  # type: ignore[arg-type]
        (lambda: gr.PD(1.0, 1.0, biquads=(gr.Notch(9.0),)), ["biquads", "Notch(", "must be a Biquad"]),  # type: ignore[arg-type]
        (lambda: gr.LowPass(10.0, order=True), ["order", "1 or 2"]),
        (lambda: gr.LowPass(nan), ["bandwidth", "> 0"]),
        (lambda: gr.Notch(10.0, depth=nan), ["depth", ">= 0"]),
        (lambda: gr.Compensator(5), ["int", "LTI"]),
        (lambda: gr.Compensator(lambda s: 1 / s), ["function", "LTI"]),
        (lambda: gr.ElasticJoint(1.0, inf), ["link_inertia", "locked", "stiffness", "finite"]),
    ],
)
def test_controllers_and_joints(make, words):
    assert_refused(make, words)


@pytest.mark.slow
def test_any_lti_is_a_compensator():
    """What build_loop takes for a controller, Compensator takes too."""
    control = pytest.importorskip("control")
    system = control.tf([3.0, 200.0], [1e-3, 1.0])
    plain, wrapped = (gr.margins(gr.build_loop(JOINT, DRIVE, one)) for one in (system, gr.Compensator(system)))
    assert plain == wrapped
    assert gr.margins(gr.build_loop(JOINT, DRIVE, gr.Compensator(system, gain=0.5))).gain_margin == pytest.approx(2 * plain.gain_margin)


COUPLED = gr.Plant(np.array([[1.0, 0.2], [0.2, 1.5]]), np.full(2, 0.3), np.full(2, 1e4), np.ones(2))


@pytest.mark.parametrize(
    "controller",
    [
        gr.PD([100.0, -50.0], [5.0, 5.0]),
        gr.PD([100.0, 50.0], [5.0, -5.0]),
        gr.PD(-1.0, 1.0),
        gr.PD(np.array([[1.0, 2.0], [2.0, 1.0]]), 1.0),
        gr.PID([1.0, 1.0], [1.0, -1.0], [1.0, 1.0]),
    ],
)
def test_negative_gains_on_coupled_joints(controller):
    """One negative position gain tips a joint over at any factor; it had been certified stable up to one."""
    assert_refused(lambda: gr.build_loop(COUPLED, DRIVE, controller), [type(controller).__name__, ">= 0"])


def test_negative_gains_on_one_joint_are_counted():
    assert not gr.is_stable(gr.build_loop(JOINT, DRIVE, gr.PD(-10.0, 5.0)))


@pytest.mark.parametrize("given", [None, "loop", 3.0, gr.PD(1.0, 2.0), gr.PD, JOINT])
@pytest.mark.parametrize("function", [gr.margins, gr.joint_margins, gr.is_stable, gr.gain_limit, gr.rightmost_roots, gr.closed_loop])
def test_what_is_no_loop(function: Any, given: object):
    """Named as it was given, at its beginning at least, with what makes a loop."""
    assert_refused(lambda: function(given), [function.__name__, repr(given)[:40], "must be a Loop", "build_loop"])
