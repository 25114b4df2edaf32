"""A system analysed: every state with its margins, joints and tasks, and which requirements are met in all of them.

One record for one joint and for a robot: a joint is a system of one state. Each study (joint.py, robot.py, audit.py) is this and what it
adds.
"""

import math
from dataclasses import dataclass

from ..errors import GainroomError
from ..system.requirements import REQUIREMENTS
from ..system.system import System
from .state import Progress, State, by_headroom, state_of, unknown_first


@dataclass(frozen=True)
class Analysis:
    """A system and all its states, in the source's order."""

    system: System
    every: tuple[State, ...]

    @property
    def states(self) -> tuple[State, ...]:
        """Those in which the gains move something: one or more."""
        return tuple(state for state in self.every if state.moves)

    @property
    def immobile(self) -> tuple[State, ...]:
        """The others: no loop is closed there, so there is no verdict and no limit."""
        return tuple(state for state in self.every if not state.moves)

    @property
    def tightest(self) -> State:
        """The state with the least headroom."""
        return min(self.states, key=lambda state: by_headroom(state.limit))

    @property
    def tightest_by_contact(self) -> tuple[State, ...]:
        """Of each contact state the posture with the least headroom, in the source's order."""
        contacts = dict.fromkeys(state.contact for state in self.states)
        groups = ([state for state in self.states if state.contact == contact] for contact in contacts)
        return tuple(min(group, key=lambda state: by_headroom(state.limit)) for group in groups)

    @property
    def stable(self) -> bool:
        """In every state in which the gains move something."""
        return all(state.limit.stable for state in self.states)

    @property
    def without_limit(self) -> list[State]:
        """The states of which the verdict alone is known."""
        return [state for state in self.states if math.isnan(state.limit.gain)]

    def least(self, state: State, name: str) -> float:
        """What the requirement `name` bounds, in one state."""
        return REQUIREMENTS[name].value(state.margins)

    @property
    def worst(self) -> dict[str, State]:
        """By name of a requirement, the state that has least left of it; one of which that is not known comes first.

        Of mirrored states, which differ by round-off, the first.
        """

        def left(state: State, name: str) -> float:
            value = self.least(state, name) * (-1 if REQUIREMENTS[name].at_most else 1)
            return float(f"{unknown_first(value):.9g}")

        return {name: min(self.states, key=lambda state, name=name: left(state, name)) for name in REQUIREMENTS}

    @property
    def unmet(self) -> dict[str, State]:
        """The requirements that are not met in every state, each with the worst one; empty for an unstable system."""
        asked = self.system.requirements
        missed = {name: state for name, state in self.worst.items() if asked.met(name, self.least(state, name)) is False}
        return missed if self.stable else {}

    @property
    def requirements_met(self) -> bool | None:
        """Stable, and every requirement met in every state; None where that is not known over the uncertainty."""
        return self.stable and not self.unmet


def analyze(system: System, progress: Progress | None = None, numbers: tuple[str, ...] = ("margins",)) -> Analysis:
    """Every state of a system, its `numbers` (properties of State) computed now, all others when they are asked for.

    progress   is given (states done, states in all, the next one's name)

    Raises GainroomError for a state that cannot be linearised, where its numbers are too far apart to compute with, and where the gains
    move nothing in any state.
    """
    report = progress or (lambda done, total, what: None)
    names, found = system.source.states, []
    for index, (posture, contact) in enumerate(names):
        report(index, len(names), f"state {posture}, {contact}")
        found.append(state_of(system, posture, contact, numbers))
    report(len(names), len(names), "")
    if not any(state.moves for state in found):
        raise GainroomError(f"{system.source.name}: {found[0].reason} in any posture and contact state, so there is nothing to study")
    return Analysis(system, tuple(found))
