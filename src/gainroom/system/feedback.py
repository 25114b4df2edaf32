"""Which encoder each gain measures: that of the motor, or that of the link behind the gearbox; of a single joint one per gain.

With both encoders the loop still has one torque, and is broken there: one return ratio L = (P_L D_L + P_M D_M) C e^{−sT}, where D_L and D_M
are what the gains make of either position.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from ..errors import GainroomError, one_line

Side = Literal["motor", "link"]
SIDES: tuple[Side, ...] = get_args(Side)
POSITION_KEYS = ("kp", "ki")
"""Gains on position and on its integral: they measure the same encoder."""
MISFIT = "feedback per gain is for single joints"
"""What is said where several joints are given a side per gain."""


@dataclass(frozen=True)
class Feedback:
    """Encoders of the gains.

    position   side of the gearbox that gains on position and on its integral measure
    velocity   side that velocity, and with it the integral of velocity, is made from
    damping    name of the gain on velocity, in files and messages
    """

    position: Side
    velocity: Side
    damping: str = field(default="kd", compare=False)

    @classmethod
    def of(cls, given: "GivenFeedback", damping: str = "kd") -> "Feedback":
        """Encoders from "motor", "link", or a mapping from kp and the controller's gain on velocity to one of these.

        The integral's gain ki is as kp where it is left out. Two equal sides are the same as one word. Raises GainroomError for other
        input.
        """
        if isinstance(given, Feedback):
            return given
        if isinstance(given, str) and given in SIDES:
            return cls(given, given)  # type: ignore[arg-type] - one of SIDES
        if not isinstance(given, Mapping):
            raise GainroomError(f"feedback {one_line(repr(given), 60)} must be 'motor' or 'link', or a side per gain: {_example(damping)}")
        keys = (*POSITION_KEYS, damping)
        problems = [f"feedback.{one_line(str(key), 40)}: must be one of {', '.join(keys)}" for key in given if key not in keys]
        wrong = [key for key in keys if key in given and given[key] not in SIDES]
        problems += [f"feedback.{key}: {one_line(repr(given[key]), 40)} must be motor or link" for key in wrong]
        problems += [f"feedback.{key} is missing: motor or link" for key in ("kp", damping) if key not in given]
        if not problems and given.get("ki", given["kp"]) != given["kp"]:
            problems = [f"feedback.ki: {given['ki']!r} must be as kp, {given['kp']!r}: both measure one encoder"]
        if problems:
            raise GainroomError(*problems)
        return cls(given["kp"], given[damping], damping)

    def __str__(self) -> str:
        return f"kp {self.position}, {self.damping} {self.velocity}" if self.mixed else self.position

    @property
    def mixed(self) -> bool:
        """True if the gains measure both sides."""
        return self.position != self.velocity

    @property
    def motor(self) -> bool:
        """True if all gains measure the motor's side."""
        return self.position == self.velocity == "motor"

    @property
    def link(self) -> bool:
        """True if all gains measure the link's side."""
        return self.position == self.velocity == "link"

    @property
    def where(self) -> str:
        """The sides measured, for sentences: "the motor side", "both sides (kp link, kd motor)"."""
        return f"both sides ({self})" if self.mixed else f"the {self} side"

    @property
    def place(self) -> str:
        """Where the encoder is, for tables: "motor side of the gearbox", or the side per gain."""
        return f"{self} side of the gearbox" if not self.mixed else f"both sides of the gearbox: {self}"

    @property
    def written(self) -> str | dict[str, str]:
        """The value in files: a side, or a side per gain."""
        return {"kp": self.position, self.damping: self.velocity} if self.mixed else self.position

    @property
    def sides(self) -> tuple[Side, ...]:
        """The sides that gains measure, the motor's first."""
        return tuple(side for side in SIDES if side in (self.position, self.velocity))

    def side_of(self, powers: tuple[int, int]) -> Side:
        """The side that the term with these powers of velocity and integral measures (system/controller.py)."""
        return self.velocity if powers[0] else self.position

    def require_one(self, what: str) -> None:
        """Raise GainroomError if the gains measure both sides, for which `what` is not known."""
        if self.mixed:
            raise GainroomError(f"feedback: {what} is not known where gains measure both sides ({self}): give motor or link")


GivenFeedback = Side | Mapping[str, Any] | Feedback
"""What callers may give: one side for all gains, or one per gain."""


def feedback_of(given: GivenFeedback, controller: Any) -> Feedback:
    """Encoders of the gains of `controller`, a Controller, an LTI system, or None for tasks.

    Raises GainroomError as Feedback.of, and for two sides where the controller has no gains to measure one each.
    """
    found = Feedback.of(given, getattr(controller, "damping_name", "kd"))
    if found.mixed and not getattr(controller, "has_plane", False):
        raise GainroomError(f"feedback: {found}: must be motor or link for a controller without kp and kd of its own")
    return found


def _example(damping: str) -> str:
    return f"{{kp: link, {damping}: motor}}"
