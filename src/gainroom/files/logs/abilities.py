"""What a log can tell: which questions its channels answer, and what is missing for the others."""

from collections.abc import Iterable
from dataclasses import dataclass

Way = tuple[tuple[str, ...], ...]
"""Groups of channels; one of each group is needed."""
TORQUES = ("actual_torque", "demand_torque", "target_torque")
POSITIONS = ("motor_position", "link_position")
QUESTIONS: dict[str, tuple[Way, ...]] = {
    "identify delay": (
        (("target_torque",), ("actual_torque", "demand_torque")),
        (("reference",), POSITIONS),
    ),
    "identify joint": ((("target_torque", "actual_torque"), ("motor_position",)),),
    "identify gains": ((("reference",), POSITIONS, TORQUES[::-1]),),
    "identify stiffness": ((TORQUES, ("motor_position",)),),
    "diagnose": ((("motor_position", "link_position", "motor_velocity", "link_velocity", *TORQUES, "joint_torque", "current"),),),
}
"""By question the ways to answer it, the better one first. Without torque the command's delay and the loop's can seldom be separated."""


@dataclass(frozen=True)
class Ability:
    """Whether a log of some channels answers a question.

    channels   those that answer it; empty where it cannot
    missing    groups of which one channel each would be needed beside what there is; empty where it can
    confounded True where only the second way is open
    """

    question: str
    channels: tuple[str, ...]
    missing: tuple[tuple[str, ...], ...]
    confounded: bool = False

    @property
    def possible(self) -> bool:
        """Whether it can."""
        return not self.missing


def abilities(channels: Iterable[str]) -> tuple[Ability, ...]:
    """One per question, of a log that has these channels of a joint."""
    there = set(channels)
    return tuple(_ability(question, ways, there) for question, ways in QUESTIONS.items())


def _ability(question: str, ways: tuple[Way, ...], there: set[str]) -> Ability:
    for number, way in enumerate(ways):
        chosen = [next((name for name in group if name in there), "") for group in way]
        if all(chosen):
            return Ability(question, tuple(chosen), (), confounded=number > 0)
    return Ability(question, (), tuple(group for group in ways[0] if not there.intersection(group)))
