"""The sections of robot.yaml as they are written: keys, bounds, and what excludes what. Keys that name joints are patterns."""

from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from ..io.validation import NotNegative, Positive, Section, dotted, number, one_of, refusal
from ..io.yaml_text import shown
from ..robot.actuators import ActuatorEntry
from ..robot.body import Base
from ..robot.contact import Contact, ContactKind
from ..robot.tasks import FRAMED, Task, TaskKind
from ..system.controller import PD, PID, PPI
from .common_sections import Bandwidth, ControlSection, DelayMs, DriveSection, LimitsSection, RangesSection
from .per_joint import Angle, Flag, Name, PerJoint, Several, Springs, Stiffness, Weight, Weights, a_list, at_most, list_of, mapping, named
from .robot_scenario import RobotScenarioSection

CONTROLLERS = {"pd": PD, "pid": PID, "ppi": PPI}


class ModelSection(Section):
    """Where the links come from."""

    file: Name = Field(description="a URDF or MJCF, beside this file or in package")
    package: Name | None = Field(None, description="an installed Python package that has the file")
    base: Annotated[Base, one_of(*get_args(Base))] | None = None
    gravity_stiffness: Flag | None = None


class ActuatorSection(Section):
    """What one pattern says of its joints: motor and gearbox, and where its drive differs from the others."""

    motor_inertia: Positive | None = Field(None, description="on the joint side [kg m²]")
    rotor_inertia: Positive | None = Field(None, description="of the rotor itself [kg m²]")
    gear_ratio: Positive | None = None
    stiffness: Stiffness | None = Field(None, description="of the gearbox [N m/rad], rigid for none")
    damping: NotNegative | None = None
    motor_viscous: NotNegative | None = None
    link_viscous: NotNegative | None = None
    bandwidth: Bandwidth | None = None
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
    locked: Annotated[list[Name], BeforeValidator(list_of("joint names or patterns"))] = []

    @model_validator(mode="before")
    @classmethod
    def _patterns(cls, data: Any) -> Any:
        for key, value in mapping(data).items():
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
    weight: Weight = Field(1.0, description="how much its stiffness counts when gains are recommended")

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
        kd = self.kd if self.kv is None else self.kv
        return Task(name=self.name, kind=self.type, frame=self.frame, kp=self.kp, kd=kd, ki=ki, weight=self.weight)


class RobotControlSection(ControlSection):
    """The controller: with its gains in joint space, with those of the tasks in task space."""

    type: Annotated[Literal["pd", "pid", "ppi"], one_of(*CONTROLLERS)] = Field(description="pd, pid or ppi")
    space: Annotated[Literal["joint", "task"], one_of("joint", "task")] = "joint"
    kp: PerJoint | None = None
    kd: PerJoint | None = None
    kv: PerJoint | None = None
    ki: PerJoint | None = None
    rotors: Flag = False
    weight: Weights | None = None

    @model_validator(mode="after")
    def _gains_of_the_type(self) -> "RobotControlSection":
        wanted = CONTROLLERS[self.type].gain_names() if self.space == "joint" else ()
        if self.weight is not None and self.space == "task":
            raise refusal("is for space joint; in task space weights stand with the tasks", key="weight")
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


Postures = Annotated[dict[str, Annotated[dict[str, Angle], BeforeValidator(mapping)]], BeforeValidator(named)]
ContactList = Annotated[
    list[Annotated[ContactSection, BeforeValidator(lambda value: {"frame": value} if isinstance(value, str) else value)]],
    BeforeValidator(lambda value: at_most(list_of("frames", ", or [] for none")(value))),
]


class RobotFile(Section):
    """robot.yaml as it is written."""

    model: ModelSection = Field(description="the file with the links")
    joints: JointsSection = JointsSection()
    drive: DriveSection = Field(description="the current loops and the delay")
    postures: Postures | None = None
    contacts: Annotated[dict[str, ContactList], BeforeValidator(named)] | None = None
    control: RobotControlSection = Field(description="the controller and its gains")
    tasks: Annotated[list[TaskSection], BeforeValidator(lambda value: at_most(a_list(value)))] = Field([])
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
