"""Record that every reader of a gain format returns: gains by joint name or pattern, in SI on the joint side."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field

from ...errors import first_of_many
from ...io.validation import SEPARATELY, Name, NotNegative, Positive, Refusals, Section, number, refusal, relation
from ...io.yaml_text import shown
from ...robot.name_patterns import DEFAULT, assign, select_all
from ..actuator_facts import actuators, unknown_actuator
from ..system_sections import Stiffness

NOT_NEGATIVE = number(least=0)
ANGLE = number(least=-1e4, most=1e4)
GAINS_RUN = ("host", "drive", "split")
JOINT_DAMPING = ("controller", "friction")
"""Meanings of the joint damping in a model file: a part of the controller's kd, or friction of the links."""
ACTUATOR = ("motor_inertia", "effort_limit", "stiffness", "damping", "link_viscous", "motor_viscous")
"""Properties of a joint's actuator that a file of gains may hold, by their keys in a robot.yaml."""


@dataclass(frozen=True)
class Gain:
    """Gains of one joint [N m/rad], [N m s/rad], [N m/(rad s)].

    Where the file names them also its reflected motor inertia [kg m²], the limit of its torque [N m], stiffness [N m/rad] and damping
    [N m s/rad] of its gearbox, the viscous friction of its link and of its motor [N m s/rad], and the actuator, a name in
    actuator_facts.py.
    """

    kp: float
    kd: float = 0.0
    ki: float = 0.0
    motor_inertia: float | None = None
    effort_limit: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    link_viscous: float | None = None
    motor_viscous: float | None = None
    actuator: str | None = field(default=None, kw_only=True)


class GainSection(Section):
    """Entry of a plain file for one joint or pattern."""

    MEANT: ClassVar[Mapping[str, str]] = {"kv": "kd (kv is a gain of P/PI control)", "p": "kp", "d": "kd", "i": "ki"}

    kp: NotNegative = Field(description="the gain on position [N·m/rad], a number >= 0")
    kd: NotNegative = Field(0.0, description="[N m s/rad]")
    ki: NotNegative = Field(0.0, description="[N m/(rad s)]")
    motor_inertia: Positive | None = Field(None, description="on the joint side [kg m²]")
    effort_limit: Positive | None = Field(None, description="[N m]")
    stiffness: Stiffness | None = Field(None, description="of the gearbox [N m/rad]")
    damping: NotNegative | None = Field(None, description="of the gearbox [N m s/rad]")
    link_viscous: NotNegative | None = Field(None, description="of the link [N m s/rad]")
    motor_viscous: NotNegative | None = Field(None, description="of the motor, on the joint side [N m s/rad]")
    actuator: Name | None = Field(None, description="a name of `gainroom actuators`, whose published figures stand for what is not given")

    @relation
    def _known_actuator(self) -> Refusals:
        if self.actuator is not None and self.actuator not in actuators():
            yield refusal(unknown_actuator(self.actuator), key="actuator")


def as_pair(value: object) -> object:
    """[kp, kd] as a section."""
    if isinstance(value, list):
        if len(value) != 2:
            raise refusal(f"{shown(value)} must be [kp, kd], or a section with kp and kd")
        return dict(zip(("kp", "kd"), value, strict=True))
    return value


AnyGain = Annotated[GainSection, BeforeValidator(as_pair), SEPARATELY]
"""Gains of a joint or pattern in YAML or JSON."""


@dataclass(frozen=True)
class Origin:
    """Origin of gains, as far as their file tells it.

    robot            its file
    delay_ms         the largest of its drives; of gains that run on the drive that of set-points
    sample_rate_hz   of the controller; of gains that run on the drive None
    margins          as text
    gains_run        where they run: "host", "drive" or "split" (kd on the drive); None: not said
    drive_rate_hz, drive_delay_ms   of the loop that runs on the drive
    joint_damping    what of JOINT_DAMPING the model's own damping was taken for, which is in these kd or link_viscous; None: not said
    system           context of the gains, see gain_context.py
    whole_kd         no damping of the model is to be added to these kd
    gearboxes        types of those that lie in ranges, as --gearbox takes them
    required         limits that they were judged by, each as --require takes it, where those are not the usual
    converted        sentences on gains that the file has in other units
    """

    robot: str = ""
    delay_ms: float | None = None
    sample_rate_hz: float | None = None
    margins: str = ""
    gains_run: str | None = None
    drive_rate_hz: float | None = None
    drive_delay_ms: float | None = None
    joint_damping: str | None = None
    whole_kd: bool = False
    gearboxes: tuple[str, ...] = ()
    required: tuple[str, ...] = ()
    converted: tuple[str, ...] = ()
    system: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class GainFile:
    """Gains by joint name or pattern, in the file's order.

    form    the format's title
    notes   what was left out, or how something was understood
    postures          that the file names: by name, angles by joint or pattern [rad; m if prismatic]
    unread_postures   those that are not understood: by name, why
    """

    source: str
    form: str
    gains: Mapping[str, Gain]
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict, kw_only=True)
    unread_postures: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    origin: Origin = field(default=Origin(), kw_only=True)

    @property
    def own_names(self) -> tuple[str, ...]:
        """Joints that the file names one by one; () if it has patterns."""
        names = tuple(name for name in self.gains if name != DEFAULT)
        return names if len(names) == len(self.gains) and not any(re.search(r"[^\w\- ./:]|\.[*+?]", name) for name in names) else ()

    def in_order(self, order: Sequence[str]) -> "GainFile":
        """These gains for a model whose file has its joints in this `order`; it matters for gains in arrays. (): the model's own order."""
        return self

    def matched(self, joint_names: Sequence[str]) -> list[list[Gain]]:
        """Gains of each joint of a model, with the winning one first. Raises GainroomError for joints that the model does not have."""
        return assign(self.gains, joint_names, f"{self.source}: gains")

    def postures_for(self, joint_names: Sequence[str]) -> Mapping[str, Mapping[str, float]]:
        """Postures of the file by name: angles of those joints of a model that they name [rad; m if prismatic]."""
        found = {title: _angles_of(angles, joint_names, f"{self.source}: {title}")[0] for title, angles in self.postures.items()}
        return {title: angles for title, angles in found.items() if angles}

    def notes_for(self, joint_names: Sequence[str]) -> tuple[str, ...]:
        """Notes about these gains on a model with these joints."""
        notes = []
        for title, angles in self.postures.items():
            _, others = _angles_of(angles, joint_names, f"{self.source}: {title}")
            if others:
                without = f"{self.source}: {title}: the model has no joint for {first_of_many([shown(name) for name in others])}"
                notes.append(f"{without}; {'the other angles count' if len(others) < len(angles) else 'no angle counts'}")
        return (*self.notes, *notes)


def postures_of(system: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Postures by name in the context of gains, and the other sections, which keep the postures if there are several."""
    postures = dict(system.get("postures") or {})
    rest = {key: value for key, value in system.items() if key != "postures" or len(postures) > 1}
    return {name: angles for name, angles in postures.items() if len(postures) > 1 or any(angles.values())}, rest


def _angles_of(angles: Mapping[str, float], joint_names: Sequence[str], owner: str) -> tuple[dict[str, float], list[str]]:
    """Angles of a model's joints by name, later patterns before earlier ones, and the patterns without a match. Raises GainroomError."""
    places = select_all(angles, joint_names, owner, all_match=False)  # the file may be of more joints than the model has
    pairs = zip(places, angles.values(), strict=True)
    found = {joint_names[k]: angle for matched, angle in pairs for k in matched}
    return found, [pattern for pattern, matched in zip(angles, places, strict=True) if not matched]
