"""Steps of coupled loops whose joints have different delays, against transforms, one joint by itself and the order of the method."""

import numpy as np
import pytest

import gainroom as gr
from gainroom.simulation.step_response import _delayed, _responding, step_response
from gainroom.system.loop_part import LoopPart

INERTIA = np.array([[3.0, 1.1, 0.4], [1.1, 2.0, 0.6], [0.4, 0.6, 1.2]])
DELAYS = [(2e-3, 3.3e-3, 5e-3), (2e-3, 0.0, 2.71e-3), (1e-3, 1e-3, 1e-3)]


def coupled(delays: tuple[float, ...], inertia: np.ndarray = INERTIA) -> gr.Loop:
    """Three elastic joints, link inertias coupled."""
    size = len(inertia)
    plant = gr.Plant(
        link_inverse_inertia=np.linalg.inv(inertia),
        motor_inertia=np.full(size, 0.3),
        stiffness=np.array([4e3, 3e3, 2e3])[:size],
        damping=np.full(size, 2.0),
    )
    return gr.build_loop(plant, [gr.Drive(3000.0, 0.8, delay) for delay in delays], gr.PD(np.array([600.0, 400, 200])[:size], 30.0))


def laplace_inverse(value_at, time: float) -> float:
    """f(t) of F(s) by the damped Fourier series (Dubner and Abate 1968); its error is e^{−16} and the series' tail."""
    span, shift = 4.0, 16 / 8.0
    s = shift + 1j * np.pi / span * np.arange(1 << 17)
    terms = (value_at(s) * np.exp(1j * s.imag * time)).real
    return float(np.exp(shift * time) / span * (terms.sum() - terms[0] / 2))


PLACES = [(delays, joint) for delays in DELAYS for joint in (0, 2)]
"""All with -m population; every time each set of delays, and both joints."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delays", "joint"), [pair if k in (0, 3, 4) else pytest.param(*pair, marks=pytest.mark.population) for k, pair in enumerate(PLACES)]
)
def test_it_is_the_inverse_transform_of_the_closed_loop(delays: tuple[float, ...], joint: int):
    """x = (I + G D)⁻¹ G, with G and D from the formulas of one drive and one PD, not from states."""
    loop = coupled(delays)
    found = step_response(loop, 0.25, LoopPart.of_joint(loop, joint))
    assert found.change < 1e-3
    gains = (600.0, 400.0, 200.0)

    def closed(s: np.ndarray) -> np.ndarray:
        """Reference to measured position, then torque command to it, of the joint; s (k,)."""
        own = np.zeros((len(s), 3, 3), complex)
        for k, stiffness in enumerate((4e3, 3e3, 2e3)):
            own[:, k, k] = stiffness + 2.0 * s
        links = s[:, None, None] ** 2 * INERTIA + own
        motors = np.zeros_like(own)
        motors[:, range(3), range(3)] = 0.3 * s[:, None] ** 2
        plant = np.linalg.inv(motors + own - own @ np.linalg.inv(links) @ own)
        drive = 3000.0**2 / (s**2 + 2 * 0.8 * 3000.0 * s + 3000.0**2)
        plant = plant * (drive[:, None] * np.exp(-s[:, None] * np.array(delays)))[:, None, :]
        controller = np.zeros_like(own)
        for k, kp in enumerate(gains):
            controller[:, k, k] = kp + 30.0 * s
        return (np.linalg.inv(np.eye(3) + plant @ controller) @ plant)[:, joint, joint]

    for time in (0.03, 0.08, 0.2):
        k = int(np.argmin(np.abs(found.time - time)))
        moment = float(found.time[k])
        assert found.disturbance[k] == pytest.approx(laplace_inverse(lambda s: closed(s) / s, moment), abs=2e-6)  # of 2e-3
        truth = laplace_inverse(lambda s: closed(s) * (gains[joint] + 30.0 * s) / s, moment)
        assert found.reference[k] == pytest.approx(truth, abs=2e-3)  # the series' tail, and the halved step's own error


def test_apart_each_joint_moves_as_by_itself():
    """Without coupling the others' delays are none of its own."""
    both, alone = coupled((2e-3, 3.3e-3), np.diag([3.0, 2.0])), coupled((2e-3,), np.diag([3.0]))
    found = step_response(both, 0.2, LoopPart.of_joint(both, 0))
    truth = step_response(alone, 0.2)
    assert np.allclose(found.reference, np.interp(found.time, truth.time, truth.reference), atol=2e-3)  # both steps are halved to 3e-4


@pytest.mark.parametrize("delays", DELAYS)
def test_the_error_falls_with_the_square_of_the_step(delays: tuple[float, ...]):
    """Delays that are no whole number of steps, too."""
    loop = coupled(delays)
    part = LoopPart.of_joint(loop, 0)
    system, least = _responding(loop, part), min(delay for delay in delays if delay)

    def last(late: int) -> float:
        return float(_delayed(system, part.left, np.array(delays), least / late, 60 * late)[0][-1])

    exact = last(512)
    errors = [abs(last(late) - exact) for late in (8, 16, 32, 64)]
    assert errors[-1] < 1e-5
    assert errors[0] / errors[-1] > 4**3 / 2  # three halvings; where straight lines meet their corners differs
