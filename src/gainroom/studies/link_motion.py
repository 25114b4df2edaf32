"""Motion of a robot's links over time: after a step of a joint's reference, and under a load on its link, all other loops closed."""

import math
from dataclasses import dataclass

from ..analysis.characteristic import roots_within
from ..analysis.dynamic_stiffness import ELASTIC, highest_mode
from ..simulation.step_response import SETTLE, StepResponse, step_response
from ..system.loop_part import LoopPart
from .state import State

LONGEST = 5.0
"""Longest time [s] over which a link is followed: the sway of a robot that stands may take minutes."""


@dataclass(frozen=True)
class LinkMotion:
    """Step responses of the joints of one state.

    title      the state
    joints     names of the joints that move
    responses  one for each
    """

    title: str
    joints: tuple[str, ...]
    responses: tuple[StepResponse, ...]


def link_motion(state: State) -> LinkMotion | None:
    """Motion of the links of a state; None where it is unstable, or gains are no joint's own (tasks, two paths, none)."""
    if not (state.moves and state.limit.stable) or state.system.control.space == "task" or state.loop.kd_path is not None:
        return None
    slowest = float(roots_within(state.loop, ELASTIC * highest_mode(state.loop)).real.max(initial=-math.inf))
    if not -math.inf < slowest < 0:
        return None
    end = min(SETTLE / -slowest, LONGEST)
    size, names = state.model.size, state.model.joint_names
    held = [k for k in range(size) if 0 < state.margins.links.stiffness[k] < math.inf]
    responses = [step_response(state.loop, end, LoopPart.of_joint(state.loop, k), slowest) for k in held]
    return LinkMotion(state.title, tuple(names[k] for k in held), tuple(responses))
