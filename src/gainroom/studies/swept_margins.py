"""All margins where a sweep found the lowest gain limits: a sweep looks at the gain limit alone, and other requirements may fail first."""

from dataclasses import dataclass, field

from ..errors import GainroomError
from ..sweep.summary import SweepSummary
from ..system.requirements import REQUIREMENTS
from .state import State, state_of

MOST = 6
"""Contact states, those with the lowest limits."""


@dataclass(frozen=True)
class WorstStates:
    """The worst posture of each contact state, the lowest limit first, with its draw's values.

    unmet   requirements that are missed there, by name, each with the state that misses it most
    """

    states: tuple[State, ...] = ()
    unmet: dict[str, State] = field(default_factory=dict)


def worst_states(found: SweepSummary) -> WorstStates:
    """Those that can be linearised."""
    ordered = sorted((one.worst[0] for one in found.contacts if one.worst), key=lambda one: one.gain)
    states = []
    for one in ordered[:MOST]:
        try:
            states.append(state_of(one.system(found.plan), one.name, found.plan.contacts[one.contact], ("margins",)))
        except GainroomError:
            continue
    unmet: dict[str, State] = {}
    for requirement, needed in found.plan.system.requirements.asked_for:
        missing = [state for state in states if not requirement.met(needed, requirement.value(state.margins))]
        if missing:
            name = requirement.name
            unmet[name] = max(missing, key=lambda state, one=requirement, least=needed: one.shortfall(least, one.value(state.margins)))
    return WorstStates(tuple(states), unmet)


def value_of(name: str, state: State) -> float:
    """What the requirement `name` bounds, in a state."""
    return REQUIREMENTS[name].value(state.margins)
