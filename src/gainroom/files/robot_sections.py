"""Sections of robot.yaml as they are written: keys, bounds, and mutual exclusions. Keys that name joints are patterns."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, SerializeAsAny

from ..errors import listed
from ..io.validation import SEPARATELY, Flag, Name, NotNegative, Positive, Refusals, Section, made_when_read, number, refusal, relation
from ..io.yaml_text import shown
from ..robot.body import Base
from ..robot.contact import Contact, ContactKind
from ..robot.gearbox_types import DIRECT, TYPES
from ..robot.tasks import FRAMED, Task, TaskKind
from ..system.actuator_entry import ActuatorEntry
from ..system.controller import CONTROLLERS, GainKey
from .joint_references import entry_of_file
from .robot_scenario import Angle, PerJoint, RobotScenarioSection, Several, Springs, Weight
from .system_sections import (
    Bandwidth,
    ControlSection,
    DampingRatio,
    DelayMs,
    GainBoundsSection,
    GearboxSection,
    Stiffness,
    SystemFile,
    UncertaintySection,
    control_section,
)

MOST_NAMES = 50
"""Maximum number of postures, contact states or tasks in one file."""


class PayloadSection(Section):
    """Payload of the robot: a point mass."""

    frame: Name = Field(description="the name of the frame at whose origin it is")
    mass: Annotated[float, number(least=0, most=1e5, unit="kg")] = Field(description="its mass [kg], a number >= 0")


class ModelSection(Section):
    """Section `model`: file of the links."""

    file: Name = Field(description="the URDF or MJCF, beside this file, or in package")
    package: Name | None = Field(None, description="an installed Python package that has the file")
    base: Base | None = None
    gravity_stiffness: Flag | None = None
    payload: PayloadSection | None = None


class ActuatorSection(GearboxSection):
    """Actuator of the joints of one pattern: motor, gearbox, and a drive that differs from the others; or a reference to a joint.yaml."""

    file: Name | None = None
    stiffness: Stiffness | None = None
    gearbox: Literal[(*TYPES, DIRECT)] | None = Field(None, description="its type, in place of stiffness and damping: a range, or direct")  # type: ignore[valid-type]
    effort_limit: Positive | None = Field(None, description="the limit of its torque [N m], a number > 0; no margin depends on it")
    bandwidth: Bandwidth | None = None
    damping_ratio: DampingRatio | None = None
    delay_ms: DelayMs | None = None

    @classmethod
    def allowed(cls) -> str:
        return (
            f"{super().allowed()}: every key here but locked, the list of joints that do not move, passive, of those without a motor, and "
            "driven, of those with one that the model has not, is default or a joint's name or pattern"
        )

    @relation
    def _file_alone(self) -> Refusals:
        if self.file is not None and (others := self.model_fields_set - {"file"}):
            yield refusal(f"has no meaning beside {min(others)}: give {min(others)} in a pattern of its own further down", key="file")

    @relation
    def _type_or_numbers(self) -> Refusals:
        for key in ("stiffness", "damping"):
            if self.gearbox is not None and key in self.model_fields_set:
                yield refusal(f"has no meaning beside {key}: a type is a range of both; give either", key="gearbox")

    def entry(self, folder: Path, owner: str) -> ActuatorEntry:  # type: ignore[override] - a robot's may name a file
        """Actuator entry in SI; a referenced file is in `folder`. Raises GainroomError if it cannot be read."""
        if self.file is not None:
            return entry_of_file(self.file, folder, f"{owner}.file")
        return super().entry() if self.delay_ms is None else replace(super().entry(), delay=1e-3 * self.delay_ms)


LISTS = ("locked", "passive", "driven")
"""Keys of `joints` that are not patterns of joint names."""


class JointsSection(Section):
    """Section `joints`: `default` and patterns with their data, and the joints that do not move."""

    entries: dict[str, ActuatorSection] = Field(default_factory=dict)
    locked: list[Name] = Field(default_factory=list)
    passive: list[Name] = Field(default_factory=list)
    driven: list[Name] = Field(default_factory=list)

    @classmethod
    def allowed(cls) -> str:
        return f"must be a section of default, joints' names or patterns, and {listed(LISTS)}"

    @classmethod
    def prepared(cls, data: dict[str, Any]) -> dict[str, Any]:
        lists = {key: value for key, value in data.items() if key in LISTS}
        return {"entries": {key: value for key, value in data.items() if key not in LISTS}, **lists}


class JointBoundsSection(GainBoundsSection):
    """Section of `gain_bounds` for the joints of one pattern."""

    @classmethod
    def allowed(cls) -> str:
        return f"{super().allowed()}: every key of gain_bounds is default or a joint's name or pattern"


class ContactSection(Section):
    """Contact frame on the ground."""

    frame: Name = Field(description="the name of a frame of the model")
    type: ContactKind = "flat"
    stiffness: Springs | None = None
    damping: Several | None = None

    def contact(self) -> Contact:
        """Contact in SI. Raises GainroomError if its numbers do not fit its type."""
        return Contact(self.frame, self.type, self.stiffness, self.damping)


class TaskSection(Section):
    """Task of the operational space, PD (kp, kd) or P/PI (kp, kv, ki)."""

    name: Name = Field(description="its name in tables, of your choice")
    type: TaskKind = Field(description="what it holds: com, position, orientation or posture")
    frame: Name | None = None
    kp: Several = Field(description="its stiffness [1/s²], with kv [1/s]; a number >= 0, or one per direction")
    kd: Several | None = Field(None, description="[1/s]")
    kv: Several | None = None
    ki: Several | None = None
    weight: Weight = Field(1.0, description="how much its stiffness counts when gains are recommended")

    @relation
    def _one_law(self) -> Refusals:
        if self.is_given("kd") == self.is_given("kv"):
            yield refusal("give either kd (PD), or kv and ki (P/PI)")
        if self.is_given("kd") and self.is_given("ki"):
            yield refusal("is for P/PI: give kv in place of kd", key="ki")

    @relation
    def _one_frame(self) -> Refusals:
        if (self.type in FRAMED) != self.is_given("frame"):
            yield refusal(
                f"is missing: the name of the frame of a task of type {self.type}"
                if not self.is_given("frame")
                else f"has no meaning for type {self.type}",
                key="frame",
            )

    def task(self) -> Task:
        """Task in SI."""
        ki = self.ki if self.kv is None or self.ki is not None else 0.0
        kd = self.kd if self.kv is None else self.kv
        return Task(name=self.name, kind=self.type, frame=self.frame, kp=self.kp, kd=kd, ki=ki, weight=self.weight)


class RobotControlSection(ControlSection):
    """Section `control`: gains of the joints in joint space; in task space the tasks have the gains."""

    ALLOWED: ClassVar[str] = ", or one per joint's name or pattern"

    space: Literal["joint", "task"] = "joint"
    rotors: Flag = False
    weight: PerJoint[Weight] | None = None

    @classmethod
    def gain_type(cls, keys: Sequence[GainKey]) -> Any:
        return PerJoint[NotNegative]

    @classmethod
    def may_not_be_zero(cls, key: GainKey) -> bool:
        return False

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Gains of the type; () in task space."""
        return super().gain_names if self.space == "joint" else ()

    @relation
    def _of_the_space(self) -> Refusals:
        if self.space == "task":
            for name in (*self.known_gains(), "weight"):
                if self.is_given(name):
                    yield refusal(f"is for space joint; in task space {name} stands with the tasks", key=name)
            if not CONTROLLERS[self.type].of_tasks:
                kinds = [name for name, one in CONTROLLERS.items() if one.of_tasks]
                yield refusal(f"{self.type} has no meaning in task space: {', or '.join(kinds)}", key="type")


Postures = dict[str, Annotated[dict[str, Angle], SEPARATELY]]
ContactStates = dict[
    str,
    Annotated[
        list[Annotated[ContactSection, BeforeValidator(lambda value: {"frame": value} if isinstance(value, str) else value)]],
        Field(max_length=MOST_NAMES),
        SEPARATELY,
    ],
]


RobotControl = Annotated[SerializeAsAny[RobotControlSection], made_when_read(lambda: control_section(RobotControlSection), optional=False)]


class RobotFile(SystemFile[RobotControl, UncertaintySection]):
    """File robot.yaml as it is written."""

    model: ModelSection = Field(description="the section of the robot's model, such as {file: robot.urdf}")
    joints: JointsSection = JointsSection()
    postures: Postures | None = Field(None, min_length=1, max_length=MOST_NAMES)
    contacts: ContactStates | None = Field(None, min_length=1, max_length=MOST_NAMES)
    gain_bounds: dict[str, JointBoundsSection] | None = None
    groups: list[Annotated[list[Name], Field(min_length=1)]] | None = None
    balance: Literal["joints", "controller"] | None = Field(None, description="who damps the sway of a floating base on its contacts")
    tasks: list[TaskSection] = Field([], max_length=MOST_NAMES)
    scenario: RobotScenarioSection = RobotScenarioSection()

    @relation
    def _one_task_of_a_name(self) -> Refusals:
        names = [task.name if task.is_right("name") else None for task in self.tasks]
        for index, name in enumerate(names):
            if name is not None and name in names[:index]:
                yield refusal(f"{shown(name)} is the name of two tasks", key=f"tasks[{index}].name")

    @relation
    def _scenario_of_its_names(self) -> Refusals:
        tasks = tuple(task.name for task in self.tasks)
        yield from self.scenario.refuse_unknown(tuple(self.postures or ("zero",)), tuple(self.contacts or ("free",)), tasks)

    @relation
    def _move_of_its_space(self) -> Refusals:
        yield from self.scenario.refuse_other_space(self.control.space)

    @relation
    def _gains_of_joints(self) -> Refusals:
        for key in ("gain_bounds", "groups"):
            if self.control.space == "task" and self.is_given(key):
                yield refusal("is for space joint: gains of tasks are those of their directions, not of joints", key=key)

    @relation
    def _rotors_of_tasks(self) -> Refusals:
        if not self.tasks and self.control.rotors:
            yield refusal("is for tasks: whether their model counts the motors' inertia", key="control.rotors")

    @relation
    def _tasks_in_task_space(self) -> Refusals:
        if self.control.space == "task":
            if not self.tasks:
                yield refusal("task needs tasks", key="control.space")
            cascades = [shown(task.name) for task in self.tasks if task.kv is not None]
            if cascades and self.control.type == "pd":
                yield refusal(f"pd, but task {cascades[0]} has kv; give ppi, or kd in the task", key="control.type")
