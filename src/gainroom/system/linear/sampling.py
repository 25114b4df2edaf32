"""Exact sampling of a scalar transfer function behind a zero-order hold and a fraction of a tick of delay.

The formulas, and why they need 96 digits, are in native/include/gainroom/sampling.hpp.
"""

import numpy as np

from ...errors import GainroomError
from ...native import _core
from .transfer_function import Factored

FASTEST = 50.0  # growth rate of a pole times the tick: e^50 exceeds what a double resolves, let alone what a controller can hold


def sample(system: Factored, sample_time: float, fraction: float = 0.0) -> Factored:
    """`system` (continuous, strictly proper, its delay left aside) sampled at T_s [s] with `fraction` in [0, 1) of a tick of delay.

    Raises GainroomError if a pole grows by more than e^50 within a tick, or if the coefficients span too many orders of magnitude.
    """
    rate = float(np.max(system.poles.real, initial=0.0))
    if rate * sample_time > FASTEST:
        raise GainroomError(f"loop: grows by itself at {rate:.3g}/s, too fast to be sampled every {1e3 * sample_time:g} ms")
    zeros, poles, gain = _core.sample(system.zeros, system.poles, system.gain, sample_time, fraction)
    if not len(poles):
        raise GainroomError(f"loop: cannot be sampled every {1e3 * sample_time:g} ms: its values are too many orders of magnitude apart")
    return Factored(zeros, poles, gain, 0.0, sample_time)
