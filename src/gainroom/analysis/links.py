"""Dynamic stiffness of the links of any loop, with its verdict."""

from ..system.loop import Loop, require_loop
from .dynamic_stiffness import DynamicStiffness, stiffness_of
from .stability import is_stable


def dynamic_stiffness(loop: Loop) -> DynamicStiffness:
    """Dynamic stiffness of the links of `loop`, from build_loop, and its least damping ratio; NaN where the loop is unstable.

    Raises GainroomError for a loop given as a transfer function: it has no link.
    """
    require_loop("dynamic_stiffness", loop)
    return stiffness_of(loop, is_stable(loop))
