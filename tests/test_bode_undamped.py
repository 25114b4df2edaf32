"""Bode figure of a joint whose spring has no damping: its pole lies on the frequencies that are drawn."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.report.bode import response


@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_the_phase_goes_on_beyond_a_resonance_without_damping(damping: float):
    """By hand: the poles and zeros of two masses turn the phase by −180° or 180°; beyond both L is that of the motor alone."""
    joint, delay = gr.ElasticJoint(0.448, 0.35, 900.0, damping), 3e-3
    loop = gr.build_loop(joint, gr.Drive(delay=delay), gr.PD(640.0, 37.0))
    resonance = math.sqrt(900 * (1 / 0.448 + 1 / 0.35))
    omega, size, phase = response(loop, 1.0, 50 * resonance)
    assert np.all(np.isfinite(np.concatenate([omega, size, phase])))
    assert omega[-1] == pytest.approx(50 * resonance)
    s = 1j * omega[-1]
    rigid = (640 + 37 * s) / (0.448 * s * s) * np.exp(-s * delay)
    assert size[-1] == pytest.approx(20 * math.log10(abs(rigid)), abs=0.02)  # the spring's share is 1/50² there
    assert math.cos(math.radians(phase[-1]) - np.angle(rigid)) == pytest.approx(1.0, abs=1e-4)
    before, after = (phase[np.searchsorted(omega, at * resonance)] + math.degrees(at * resonance * delay) for at in (0.95, 1.05))
    assert abs(after - before) == pytest.approx(180, abs=15)  # kd turns it by a few degrees more between these
