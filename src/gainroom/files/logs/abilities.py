"""Questions that a log can answer: those for which it has the channels and rows, and what is missing for the others.

Only the presence of motion is checked here; each identification itself decides if the motion suffices.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from ...identification.record import SHORTEST

Way = tuple[tuple[str, ...], ...]
"""Groups of channels; one channel of each group is needed."""
TORQUES = ("actual_torque", "demand_torque", "target_torque")
POSITIONS = ("motor_position", "link_position")
QUESTIONS: dict[str, tuple[Way, ...]] = {
    "identify delay": ((("target_torque",), ("actual_torque", "demand_torque")), (("reference",), POSITIONS)),
    "identify joint": ((("target_torque", "actual_torque"), ("motor_position",)),),
    "identify gains": ((("reference",), POSITIONS, TORQUES[::-1]),),
    "identify stiffness": ((TORQUES, ("motor_position",)),),
    "diagnose": ((("motor_position", "link_position", "motor_velocity", "link_velocity", *TORQUES, "joint_torque", "current"),),),
}
"""Channels that answer each question, the better way first. Without torque, command delay and loop delay can seldom be separated."""
MAY_REST = {"identify gains": ("reference",)}
"""Channels that may be constant: a controller acts on the difference to its set-point."""


@dataclass(frozen=True)
class Ability:
    """Answer to one question about a log: possible or not with its channels.

    channels   those that answer it; empty where it cannot
    missing    groups of which one channel each would be needed beside what there is; empty where it can
    confounded True where only the second way is open
    resting    those of `missing` that are there and never change
    too_few    True where there are fewer rows than any identification takes
    """

    question: str
    channels: tuple[str, ...]
    missing: tuple[tuple[str, ...], ...]
    confounded: bool = False
    resting: tuple[str, ...] = ()
    too_few: bool = False

    @property
    def possible(self) -> bool:
        """True if nothing is missing."""
        return not self.missing and not self.too_few


def abilities(channels: Iterable[str], resting: Iterable[str] = (), rows: int | None = None) -> tuple[Ability, ...]:
    """Answers to all questions for a log that has these channels of a joint.

    resting   those of them that never change
    rows      how many there are; None: enough
    """
    there, still = set(channels), set(resting)
    too_few = rows is not None and rows < SHORTEST
    return tuple(_ability(question, ways, there, still - {*MAY_REST.get(question, ())}, too_few) for question, ways in QUESTIONS.items())


def _ability(question: str, ways: tuple[Way, ...], there: set[str], resting: set[str], too_few: bool) -> Ability:
    usable = there - resting
    for number, way in enumerate(ways):
        chosen = [next((name for name in group if name in usable), "") for group in way]
        if all(chosen):
            return Ability(question, tuple(chosen), (), confounded=number > 0, too_few=too_few)
    missing = tuple(group for group in ways[0] if not usable.intersection(group))
    still = tuple(name for group in missing for name in group if name in there)
    return Ability(question, (), missing, resting=still, too_few=too_few)
