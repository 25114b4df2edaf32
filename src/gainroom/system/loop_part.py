"""One channel of a loop's controller, of one joint or one direction of a task, with all other channels closed."""

from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError
from .controller import Controller
from .linear.arrays import Floats
from .loop import Loop


@dataclass(frozen=True)
class LoopPart:
    """Channel left (n,) `own` right (n,)ᵀ of the controller of n joints.

    left    torques (n,) that one unit of its output makes
    right   combination (n,) of measured positions that it acts on
    own     its gains, as a controller of one joint
    """

    left: Floats
    right: Floats
    own: Controller

    @classmethod
    def of_joint(cls, loop: Loop, k: int) -> "LoopPart":
        """Channel of joint `k`, for gains on the diagonal. Raises GainroomError for a loop without parts."""
        if loop.parts is None:
            raise GainroomError("a part of a loop needs one built with build_loop")
        unit = np.eye(loop.size)[k]
        return cls(unit, unit, loop.parts.controller.on_joint(k, loop.size) if loop.size > 1 else loop.parts.controller)
