"""Where the characteristic loci cannot meet the negative real axis, whatever the plant: a passive mechanism under PD of enough lead.

Measured at the motors, the mechanism's mobility X = jω P_M gives out no energy: Re(y* X y) ≥ 0. With gains on the diagonal alone
L = X Y, Y = diag(b_i), b_i = C_i e^{−jωT_i} D_i/(jω). An eigenvalue λ ≠ 0 of X Y with X Y x = λ x and y = Y x fulfils

    y* X y = λ y* Y⁻¹ y,    so  arg λ = arg(y* X y) − arg(y* Y⁻¹ y).

The second angle lies between the −ψ_i, ψ_i = arg b_i, as long as these span less than 180°. So arg λ is in [−90° + min ψ_i, 90° + max ψ_i]:
where all −90° < ψ_i < 90°, not on the negative real axis. (Joints without gain drop out with their rows and columns; y* X y = 0 is λ = 0.)
For PD this is every frequency at which the lead atan(ω kd/kp) outweighs what current loop and delay lag. To the right of jω, where the
boundary leans (loci.py), the mechanism is passive too.
"""

import numpy as np

from ..system.controller import gain_matrix
from ..system.linear.arrays import Floats
from ..system.loop import Loop

PER_DECADE = 40  # of the frequencies at which lead and lag are compared


def passive_intervals(loop: Loop, low: float, high: float) -> Floats:
    """(k, 2) the spans of [low, high] rad/s in which no eigenvalue of L(jω) is real and negative, whatever W is; none where not known.

    Known for continuous loops with motor-side feedback, PD, PID or PPI without filters, with diagonal gains >= 0, without gravity.
    """
    parts = loop.parts
    if (
        parts is None
        or parts.sample_time is not None
        or parts.feedback != "motor"
        or parts.plant.gravity_stiffness is not None
        or not parts.controller.lead_rises
    ):
        return np.zeros((0, 2))
    gains = [gain_matrix("gain", gain, loop.size) for gain in parts.controller.terms().values()]
    if any(np.count_nonzero(gain) != np.count_nonzero(np.diagonal(gain)) or np.any(gain < 0) for gain in gains):
        return np.zeros((0, 2))
    omega = np.geomspace(low, high, max(2, round(PER_DECADE * np.log10(high / low))))
    s = 1j * omega
    law = np.diagonal(parts.controller.matrix(s, s, loop.size, None), axis1=1, axis2=2)
    driven = np.any(law, axis=0)
    lead = np.unwrap(np.angle(loop.gain * law[:, driven] / s[:, None]), axis=0)
    bandwidth = np.array([drive.bandwidth for drive in parts.drives])[driven]
    damping = np.array([drive.damping_ratio for drive in parts.drives])[driven]
    ratio = omega[:, None] / bandwidth
    delays = parts.delays[driven]
    lag = np.arctan2(2 * damping * ratio, 1 - ratio * ratio) + omega[:, None] * delays
    # The zeros of D lie to the left, so the lead only rises, and the lag only grows: within a step both stay between their ends.
    least, most = lead[:-1] - lag[1:], lead[1:] - lag[:-1]
    passive = np.all((least > -np.pi / 2) & (most < np.pi / 2), axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], passive, [False]])))
    return omega[edges].reshape(-1, 2)
