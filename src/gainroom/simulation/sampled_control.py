"""A controller that runs: the D(z) of controller.py, tick by tick, on several channels at once."""

import numpy as np

from ..arrays import Floats
from ..controller import PPI, Controller, gain_matrix
from ..errors import GainroomError
from ..factored import ratio
from ..statespace import StateSpace, realize
from ._kernels import filter_tick, sum_terms

Signal = Floats
"""(m,) one number per channel."""


class SampledControl:
    """A controller with gains per channel, and its filters; remembers what filters and integrators hold.

    controller    gains: numbers, (m,) or (m, m)
    channels      m
    sample_time   [s]

    P/PI takes the velocity of the measured value alone, as Fig. 13 of Jung et al. 2017 draws it; all others that of the error.
    """

    def __init__(self, controller: Controller, channels: int, sample_time: float):
        shaping = controller.shaping(sample_time)
        if shaping.relative_degree < 0:
            raise GainroomError("controller: more zeros than poles cannot run")
        terms = {powers: gain_matrix(f"gain {powers}", gain, channels) for powers, gain in controller.terms().items()}
        nothing = np.zeros((channels, channels))
        self._gains = np.array([terms.get(powers, nothing) for powers in ((0, 0), (1, 0), (0, 1), (1, 1))])
        self._of_error = not isinstance(controller, PPI)
        self._velocity = _Filter(realize(ratio(*controller.velocity(sample_time), sample_time)), channels, sample_time)
        self._shaping = _Filter(realize(shaping), channels, sample_time) if len(shaping.poles) else None
        self._integral, self._sample_time = np.zeros(channels), sample_time

    def rest(self, error: Signal, value: Signal) -> None:
        """As if `error` and measured `value` had stood still since ever; integrators are empty."""
        self._velocity.rest(error if self._of_error else -value)
        self._integral[:] = 0.0
        if self._shaping is not None:
            self._shaping.rest(self._gains[0] @ error)

    def tick(self, error: Signal, value: Signal) -> Signal:
        """Output (m,) on this tick's error x_d − x and measured value x."""
        velocity = self._velocity.tick(error if self._of_error else -value)
        output = np.empty(len(velocity))
        sum_terms(self._gains, error, velocity, self._integral, self._sample_time, output)
        return output if self._shaping is None else self._shaping.tick(output)


class _Filter:
    """One scalar system in δ = (z − 1)/T_s on every channel."""

    def __init__(self, system: StateSpace, channels: int, sample_time: float):
        self._a = np.eye(len(system.a)) + sample_time * system.a
        self._b = sample_time * system.b[:, 0]
        self._c, self._d = system.c[0].copy(), float(system.d[0, 0])
        self._still = -np.linalg.pinv(system.a) @ system.b  # state in which a constant input leaves it
        self._state = np.zeros((len(system.a), channels))

    def rest(self, value: Signal) -> None:
        self._state = self._still * value

    def tick(self, value: Signal) -> Signal:
        output = np.empty(len(value))
        filter_tick(self._a, self._b, self._c, self._d, self._state, value, output)
        return output
