"""Reference, noise and disturbance responses of a scalar loop."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError
from .linear.arrays import Complexes
from .loop import Loop, require_loop


@dataclass(frozen=True)
class ClosedLoop:
    """Closed-loop responses at omega [rad/s] (k,), by eq. (4) of Jung et al. 2017.

    x = L/(1+L) x_d − L/(1+L) n + C P e^{−sT}/(1+L) d
    """

    loop: Loop

    def reference(self, omega: ArrayLike) -> Complexes:
        """Response from reference to measured position (k,)."""
        value = self.loop.response(omega)
        return value / (1 + value)

    def noise(self, omega: ArrayLike) -> Complexes:
        """Response from measurement noise to the true position on the measured side (k,)."""
        return -self.reference(omega)

    def disturbance(self, omega: ArrayLike) -> Complexes:
        """Response from a torque added to the command to measured position (k,) [rad/(N m)]."""
        assert self.loop.actuated is not None
        return self.loop.actuated.response(np.atleast_1d(omega)) / (1 + self.loop.response(omega))


def closed_loop(loop: Loop) -> ClosedLoop:
    """Reference, noise and disturbance responses of a scalar loop. Raises GainroomError for several joints and for callables."""
    require_loop("closed_loop", loop)
    if loop.scalar is None:
        raise GainroomError("closed_loop needs a loop of one joint built with build_loop or from an LTI system")
    loop.require_one_side("one measured position")
    return ClosedLoop(loop)
