"""The sections of robot.yaml as they are written: keys, bounds, and what excludes what. Keys that name joints are patterns."""

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from .config_sections import ControlSection, DelayMs, DriveSection, LimitsSection, RangesSection
from .controller import PD, PID, PPI
from .io.checked import NotNegative, Positive, PositiveOrInfinite, Section, dotted, number, one_of, refusal
from .io.yaml_text import shown
from .robot.actuators import ActuatorEntry
from .robot.body import Base
from .robot.contact import Contact, ContactKind
from .robot.ground import Ground, Sole
from .robot.patterns import DEFAULT
from .robot.tasks import FRAMED, Task, TaskKind

MOST_NAMES = 50
"""Postures, contact states or tasks in one file."""
CONTROLLERS = {"pd": PD, "pid": PID, "ppi": PPI}


def _word(value: object) -> str:
    if not isinstance(value, str) or not value or len(value) > 200:
        raise refusal(f"{shown(value)} must be a name")
    return value


def _rigid(value: object) -> object:
    return math.inf if value == "rigid" else value


def _each(end: BeforeValidator) -> BeforeValidator:
    """A check: a number, or a list of them, each as `end` allows."""

    def check(value: object) -> float | list[float]:
        if isinstance(value, list) and value:
            return [end.func(item) for item in value]  # type: ignore[call-arg]
        return end.func(value)  # type: ignore[call-arg]

    return BeforeValidator(check)


def _of(kind: type | tuple[type, ...], words: str) -> Callable[[Any], Any]:
    """A check: a value of this type."""

    def check(value: Any) -> Any:
        if not isinstance(value, kind):
            raise refusal(f"{shown(value)} must be {words}")
        return value

    return check


_flag, _mapping, _list = _of(bool, "true or false"), _of(dict, "a section"), _of(list, "a list")


def _per_joint(value: Any) -> Any:
    """One value for all joints, or one per pattern."""
    return value if isinstance(value, dict) else {DEFAULT: value}


def _ground(value: Any) -> Any:
    """false: none; true: ordinary ground."""
    if isinstance(value, bool):
        return {} if value else None
    return _of((dict, type(None)), "true, false or a section")(value)


def _list_of(what: str, empty: str = "") -> Callable[[Any], Any]:
    """A check: a list; one thing by itself is refused with the list that was meant."""

    def check(value: Any) -> Any:
        if isinstance(value, str):
            raise refusal(f"{shown(value)} must be a list of {what}: [{shown(value)}]{empty}")
        return _of(list, f"a list of {what}{empty}")(value)

    return check


def _at_most(value: Any) -> Any:
    if len(value) > MOST_NAMES:
        raise refusal(f"{len(value)} entries must be at most {MOST_NAMES}")
    return value


def _named(value: Any) -> Any:
    """A section with one entry or more, each under a name."""
    if not _mapping(value):
        raise refusal("is empty; give at least one, or leave the section out")
    return _at_most(value)


Name = Annotated[str, BeforeValidator(_word)]
Flag = Annotated[bool, BeforeValidator(_flag)]
Angle = Annotated[float, number(least=-1e4, most=1e4)]
Stiffness = Annotated[float, number(above=0, infinite=True), BeforeValidator(_rigid)]
PerJoint = Annotated[dict[str, NotNegative], BeforeValidator(_per_joint)]
Several = Annotated[float | list[float], _each(number(least=0))]
Springs = Annotated[float | list[float], _each(number(above=0, infinite=True))]


class ModelSection(Section):
    """Where the links come from."""

    file: Name = Field(description="a URDF or MJCF, beside this file or in package")
    package: Name | None = Field(None, description="an installed Python package that has the file")
    base: Annotated[Base, one_of(*get_args(Base))] | None = None
    gravity_stiffness: Flag = False


class ActuatorSection(Section):
    """What one pattern says of its joints: motor and gearbox, and where its drive differs from the others."""

    motor_inertia: Positive | None = Field(None, description="on the joint side [kg m²]")
    rotor_inertia: Positive | None = Field(None, description="of the rotor itself [kg m²]")
    gear_ratio: Positive | None = None
    stiffness: Stiffness | None = Field(None, description="of the gearbox [N m/rad], rigid for none")
    damping: NotNegative | None = None
    motor_viscous: NotNegative | None = None
    link_viscous: NotNegative | None = None
    bandwidth: PositiveOrInfinite | None = None
    damping_ratio: Annotated[float, number(above=0, most=100)] | None = None
    delay_ms: DelayMs | None = None

    def entry(self) -> ActuatorEntry:
        """In SI."""
        values = self.model_dump(exclude={"delay_ms"})
        return ActuatorEntry(**values, delay=None if self.delay_ms is None else 1e-3 * self.delay_ms)


class JointsSection(BaseModel):
    """`default` and patterns with their data, and the joints that do not move."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    entries: dict[str, ActuatorSection] = {}
    locked: Annotated[list[Name], BeforeValidator(_list_of("joint names or patterns"))] = []

    @model_validator(mode="before")
    @classmethod
    def _patterns(cls, data: Any) -> Any:
        for key, value in _mapping(data).items():
            if key != "locked" and not isinstance(value, dict):
                keys = ", ".join(ActuatorSection.model_fields)
                raise refusal(
                    f"{shown(value)} must be a section with keys among {keys}: every key here but locked, the list of joints that do not "
                    "move, is default or a joint's name or pattern",
                    key=dotted(key),
                )
        return {"entries": {key: value for key, value in data.items() if key != "locked"}, "locked": data.get("locked", [])}


class ContactSection(Section):
    """One frame on the ground."""

    frame: Name = Field(description="the frame's name")
    type: Annotated[ContactKind, one_of(*get_args(ContactKind))] = "flat"
    stiffness: Springs | None = None
    damping: Several | None = None

    def contact(self) -> Contact:
        """In SI. Raises GainroomError where numbers do not fit the type."""
        return Contact(self.frame, self.type, self.stiffness, self.damping)


class TaskSection(Section):
    """One task of the operational space, PD (kp, kd) or P/PI (kp, kv, ki)."""

    name: Name = Field(description="for the tables")
    type: Annotated[TaskKind, one_of(*get_args(TaskKind))] = Field(description="com, position, orientation or posture")
    frame: Name | None = None
    kp: Several = Field(description="[1/s²], with kv [1/s]; a number, or one per direction")
    kd: Several | None = Field(None, description="[1/s]")
    kv: Several | None = None
    ki: Several | None = None

    @model_validator(mode="after")
    def _one_law(self) -> "TaskSection":
        if (self.kd is None) == (self.kv is None):
            raise refusal("give either kd (PD), or kv and ki (P/PI)")
        if self.kd is not None and self.ki is not None:
            raise refusal("is for P/PI: give kv in place of kd", key="ki")
        if (self.type in FRAMED) != (self.frame is not None):
            raise refusal(f"{'is missing: ' if self.frame is None else 'has no meaning for '}type {self.type}", key="frame")
        return self

    def task(self) -> Task:
        """In SI."""
        ki = self.ki if self.kv is None or self.ki is not None else 0.0
        return Task(name=self.name, kind=self.type, frame=self.frame, kp=self.kp, kd=self.kd if self.kv is None else self.kv, ki=ki)


class RobotControlSection(ControlSection):
    """The controller: with its gains in joint space, with those of the tasks in task space."""

    type: Annotated[Literal["pd", "pid", "ppi"], one_of(*CONTROLLERS)] = Field(description="pd, pid or ppi")
    space: Annotated[Literal["joint", "task"], one_of("joint", "task")] = "joint"
    kp: PerJoint | None = None
    kd: PerJoint | None = None
    kv: PerJoint | None = None
    ki: PerJoint | None = None
    rotors: Flag = False

    @model_validator(mode="after")
    def _gains_of_the_type(self) -> "RobotControlSection":
        wanted = CONTROLLERS[self.type].gain_names() if self.space == "joint" else ()
        for name in ("kp", "kd", "kv", "ki"):
            given = getattr(self, name) is not None
            if given and self.space == "task":
                raise refusal("is for space joint; in task space the gains stand with the tasks", key=name)
            if given and name not in wanted:
                raise refusal(f"is not a gain of type {self.type}, which has {', '.join(wanted)}", key=name)
            if not given and name in wanted:
                raise refusal(f"is missing: type {self.type} has {', '.join(wanted)}; a number, or one per pattern", key=name)
        if self.space == "task" and self.type == "pid":
            raise refusal("pid has no meaning in task space: pd, or ppi", key="type")
        return self


Postures = Annotated[dict[str, Annotated[dict[str, Angle], BeforeValidator(_mapping)]], BeforeValidator(_named)]
ContactList = Annotated[
    list[Annotated[ContactSection, BeforeValidator(lambda value: {"frame": value} if isinstance(value, str) else value)]],
    BeforeValidator(lambda value: _at_most(_list_of("frames", ", or [] for none")(value))),
]


Metres = Annotated[float, number(least=-1e3, most=1e3)]
Limits = Annotated[dict[str, PositiveOrInfinite], BeforeValidator(_per_joint)]
Moves = Annotated[float | list[float], _each(number(least=-1e3, most=1e3))]


class RobotMoveSection(Section):
    """A task or joints, moved from rest to rest along a quintic."""

    task: Name | None = None
    joint: Name | None = None
    by: Moves = Field(description="how far [m, rad]; a number, or one per direction")
    duration: Annotated[float, number(above=0, most=3600)] = 1.0

    @model_validator(mode="after")
    def _one(self) -> "RobotMoveSection":
        if (self.task is None) == (self.joint is None):
            raise refusal("give either task or joint")
        return self


class RobotFrictionSection(Section):
    """On the motors' side, a number or one per pattern."""

    coulomb: PerJoint = Field(default_factory=dict)
    viscous: PerJoint = Field(default_factory=dict)


class SoleSection(Section):
    """The rectangle of one foot that touches the ground."""

    length: Positive = Field(Sole.length, description="along x of the frame [m]")
    width: Positive = Field(Sole.width, description="along y [m]")
    center: Annotated[list[Metres], BeforeValidator(_list), Field(min_length=2, max_length=2)] = Field([0.0, 0.0])

    def sole(self) -> Sole:
        """In SI."""
        return Sole(length=self.length, width=self.width, center=(self.center[0], self.center[1]))


class GroundSection(Section):
    """Ground that feet may slip on and leave."""

    friction: Positive = Ground.friction
    soles: Annotated[dict[str, SoleSection], BeforeValidator(_mapping)] = Field({}, description="by contact frame")


class RobotScenarioSection(Section):
    """What `gainroom simulate` plays."""

    posture: Name | None = None
    contact: Name | None = None
    duration: Annotated[float, number(above=0, most=3600)] = 2.0
    move: RobotMoveSection | None = None
    friction: RobotFrictionSection = RobotFrictionSection()
    torque_limit: Limits = Field(default_factory=dict)
    resolution: Annotated[float, number(least=0, most=1)] = 0.0
    ground: Annotated[GroundSection | None, BeforeValidator(_ground)] = None


class RobotFile(Section):
    """robot.yaml as it is written."""

    model: ModelSection = Field(description="the file with the links")
    joints: JointsSection = JointsSection()
    drive: DriveSection = Field(description="the current loops and the delay")
    postures: Postures | None = None
    contacts: Annotated[dict[str, ContactList], BeforeValidator(_named)] | None = None
    control: RobotControlSection = Field(description="the controller and its gains")
    tasks: Annotated[list[TaskSection], BeforeValidator(lambda value: _at_most(_list(value)))] = Field([])
    limits: LimitsSection | None = None
    uncertainty: RangesSection = RangesSection()
    scenario: RobotScenarioSection = RobotScenarioSection()

    @model_validator(mode="after")
    def _tasks_fit(self) -> "RobotFile":
        names = [task.name for task in self.tasks]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise refusal(f"{shown(name)} is the name of two tasks", key=f"tasks[{index}].name")
        if self.control.rotors and not self.tasks:
            raise refusal("is for tasks: whether their model counts the motors' inertia", key="control.rotors")
        if self.control.space == "task":
            if not self.tasks:
                raise refusal("task needs tasks", key="control.space")
            cascades = [task.name for task in self.tasks if task.kv is not None]
            if cascades and self.control.type == "pd":
                raise refusal(f"pd, but task {shown(cascades[0])} has kv; give ppi, or kd in the task", key="control.type")
        return self
