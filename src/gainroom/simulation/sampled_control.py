"""A controller that runs: D(z), tick by tick, on several channels at once."""

import numpy as np

from ..system.assembly import controller_state
from ..system.controller import Controller
from ..system.linear.arrays import Floats


class SampledControl:
    """A controller with gains per channel, and its filters; with the states of filters and integrators.

    controller    gains: numbers, (m,) or (m, m)
    channels      m
    sample_time   [s]

    P/PI takes the velocity of the measured value alone, as Fig. 13 of Jung et al. 2017 draws it; all others that of the error.
    """

    def __init__(self, controller: Controller, channels: int, sample_time: float):
        system = controller_state(controller, channels, sample_time)
        # (state, error, motion) → (next state, output), in one product
        self._step = np.block([[np.eye(len(system.a)) + sample_time * system.a, sample_time * system.b], [system.c, system.d]])
        self._of_error = controller.rate_of_error
        self._state = np.zeros(len(system.a))
        self._from = np.zeros(channels)

    def rest(self, error: Floats, value: Floats) -> None:
        """Start from rest at `error` and measured `value`, each (m,): velocity starts at 0, filters and integrators are empty."""
        self._state[:] = 0.0
        self._from = error if self._of_error else -value

    def tick(self, error: Floats, value: Floats) -> Floats:
        """Output (m,) on this tick's error x_d − x and measured value x."""
        motion = (error if self._of_error else -value) - self._from
        moved = self._step @ np.concatenate([self._state, error, motion])
        self._state = moved[: len(self._state)]
        return moved[len(self._state) :]
