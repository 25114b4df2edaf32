"""What each gain measures: the motor's position, that of the link behind the gearbox, or the torque of the gearbox's spring.

Of a single joint gains may measure several of them. The loop still has one torque, and is broken there: one return ratio
L = Σ P_i D_i C e^{−sT}, where D_i is what the gains make of the quantity i, and P_i the plant's response to torque in it.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from ..errors import GainroomError, one_line
from .linear.arrays import Floats

Side = Literal["motor", "link"]
SIDES: tuple[Side, ...] = get_args(Side)
Sensor = Literal["motor", "link", "torque"]
SENSORS: tuple[Sensor, ...] = get_args(Sensor)
POSITION_KEYS = ("kp", "ki")
"""Gains on position and on its integral: they measure the same encoder."""
MISFIT = "feedback per gain is for single joints"
"""What is said where several joints are given a side per gain."""


@dataclass(frozen=True)
class Feedback:
    """Sensors of the gains.

    position   side of the gearbox that gains on position and on its integral measure
    velocity   side that velocity, and with it the integral of velocity, is made from
    damping    name of the gain on velocity, in files and messages; "" of a law that names its sensors itself, without gains
    torque     name of the gain on the spring's torque, in files and messages; "": none measures it
    """

    position: Side
    velocity: Side
    damping: str = field(default="kd", compare=False)
    torque: str = ""

    @classmethod
    def of(cls, given: "GivenFeedback", damping: str = "kd", torque: str = "") -> "Feedback":
        """Sensors from "motor", "link", or a mapping from kp and the controller's gain on velocity to one of these.

        torque   name of the controller's gain on the spring's torque, which a mapping has to name; "": it has none

        The integral's gain ki is as kp where it is left out. Two equal sides are the same as one word. Raises GainroomError for other
        input.
        """
        if isinstance(given, Feedback):
            return given
        if isinstance(given, str) and given in SIDES:
            if not torque:
                return cls(given, given)  # type: ignore[arg-type] - one of SIDES
            raise GainroomError(f"feedback.{torque} is missing: torque; give {{kp: {given}, {damping}: {given}, {torque}: torque}}")
        if not isinstance(given, Mapping):
            either = f"a side per gain: {_example(damping)}"
            allowed = f"'motor' or 'link', or {either}" if not torque else f"{either[:-1]}, {torque}: torque}}"
            raise GainroomError(f"feedback {one_line(repr(given), 60)} must be {allowed}")
        keys = (*POSITION_KEYS, damping)
        every = (*keys, torque) if torque else keys
        problems = [f"feedback.{one_line(str(key), 40)}: must be one of {', '.join(every)}" for key in given if key not in every]
        wrong = [key for key in keys if key in given and given[key] not in SIDES]
        problems += [f"feedback.{key}: {one_line(repr(given[key]), 40)} must be motor or link" for key in wrong]
        problems += [f"feedback.{key} is missing: motor or link" for key in ("kp", damping) if key not in given]
        if torque and torque not in given:
            problems.append(f"feedback.{torque} is missing: torque")
        elif torque and given[torque] != "torque":
            problems.append(f"feedback.{torque}: {one_line(repr(given[torque]), 40)} must be torque")
        if not problems and given.get("ki", given["kp"]) != given["kp"]:
            problems = [f"feedback.ki: {given['ki']!r} must be as kp, {given['kp']!r}: both measure one encoder"]
        if problems:
            raise GainroomError(*problems)
        return cls(given["kp"], given[damping], damping, torque)

    @classmethod
    def of_law(cls, sensors: Collection[Sensor]) -> "Feedback":
        """Sensors of a law that names them itself; one without a position counts the motor's among them."""
        sides: list[Side] = [side for side in SIDES if side in sensors] or ["motor"]
        return cls(sides[0], sides[-1], "", "torque" if "torque" in sensors else "")

    def __str__(self) -> str:
        if not self.mixed:
            return self.position
        if not self.damping:
            return " and ".join(self.sensors)
        return f"kp {self.position}, {self.damping} {self.velocity}{f', {self.torque} torque' if self.torque else ''}"

    @property
    def both(self) -> bool:
        """True if the gains measure both sides."""
        return self.position != self.velocity

    @property
    def mixed(self) -> bool:
        """True if the gains measure more than one quantity."""
        return self.both or bool(self.torque)

    @property
    def motor(self) -> bool:
        """True if all gains measure the motor's side."""
        return not self.mixed and self.position == "motor"

    @property
    def link(self) -> bool:
        """True if all gains measure the link's side."""
        return not self.mixed and self.position == "link"

    @property
    def where(self) -> str:
        """The quantities measured, for sentences: "the motor side", "both sides (kp link, kd motor)"."""
        if self.torque:
            return f"{'both sides' if self.both else f'the {self.position} side'} and the spring's torque"
        return f"both sides ({self})" if self.mixed else f"the {self} side"

    @property
    def place(self) -> str:
        """Where the sensors are, for tables: "motor side of the gearbox", or what each gain measures."""
        if self.torque:
            return f"{'both sides' if self.both else f'{self.position} side'} of the gearbox, and its torque: {self}"
        return f"{self} side of the gearbox" if not self.mixed else f"both sides of the gearbox: {self}"

    @property
    def written(self) -> str | dict[str, str]:
        """The value in files: a side, or a sensor per gain."""
        torque = {self.torque: "torque"} if self.torque else {}
        return {"kp": self.position, self.damping: self.velocity, **torque} if self.mixed else self.position

    @property
    def without_torque(self) -> "Feedback":
        """Sensors of gains on positions alone, on one side where a law named its sensors itself."""
        return Feedback(self.position, self.velocity, self.damping) if self.damping else Feedback(self.position, self.position)

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The quantities that gains measure, in the order of SENSORS."""
        return (*self.sides, "torque") if self.torque else self.sides

    @property
    def sides(self) -> tuple[Side, ...]:
        """The sides that gains measure, the motor's first."""
        return tuple(side for side in SIDES if side in (self.position, self.velocity))

    @property
    def seen(self) -> Floats:
        """Matrix from the readings of `sensors` of one joint to the signals of its controller, sampled (assembly.py, controller_state)."""
        signals = (self.position, self.velocity, "torque") if self.torque else (self.position, self.velocity)
        return np.array([[float(sensor == signal) for sensor in self.sensors] for signal in signals])

    def side_of(self, powers: tuple[int, int]) -> Side:
        """The side that the term with these powers of velocity and integral measures (system/controller.py)."""
        return self.velocity if powers[0] else self.position

    def of_side(self, side: Sensor, terms: Mapping[tuple[int, int], Any]) -> dict[tuple[int, int], Any]:
        """`terms` of a controller with 0 in place of those that do not measure `side`."""
        return {powers: gain if self.side_of(powers) == side else np.zeros(()) for powers, gain in terms.items()}

    def require_one(self, what: str) -> None:
        """Raise GainroomError if the gains measure more than one quantity, for which `what` is not known."""
        if self.mixed:
            raise GainroomError(f"feedback: {what} is not known where gains measure {self.where}: give motor or link")


GivenFeedback = Side | Mapping[str, Any] | Feedback
"""What callers may give: one side for all gains, or one per gain."""


def feedback_of(given: GivenFeedback, controller: Any) -> Feedback:
    """Sensors of the gains of `controller`, a Controller, an LTI system, or None for tasks.

    A Feedback of other gains keeps what it says of positions. Raises GainroomError as Feedback.of, and for two sides where the controller
    has no gains to measure one each.
    """
    if not isinstance(controller, type) and (laws := getattr(controller, "laws", None)):
        return Feedback.of_law(laws)
    torque = getattr(controller, "torque_name", "")
    if isinstance(given, Feedback) and given.torque != torque and not torque:
        given = given.without_torque
    found = Feedback.of(given, getattr(controller, "damping_name", "kd"), torque)
    if torque and not found.torque:
        raise GainroomError(f"feedback.{torque} is missing: torque")
    if found.both and not (torque or getattr(controller, "has_plane", False)):
        raise GainroomError(f"feedback: {found}: must be motor or link for a controller without kp and kd of its own")
    return found


def _example(damping: str) -> str:
    return f"{{kp: link, {damping}: motor}}"
