"""joint.yaml: one joint, its drive, its controller and what is asked of them, checked and turned into a JointSpec.

Everything is SI and radians except where a key's name carries another unit (delay_ms, sample_rate_hz, gain_margin_db).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator

from ..errors import GainroomError, named
from ..io.validation import NotNegative, Positive, PositiveOrInfinite, Section, refusal, typed, validate
from ..io.yaml_text import read_text
from ..system.controller import PD, PID, PPI
from ..system.drive import Drive
from ..system.joint_spec import JointSpec
from ..system.plant import ElasticJoint
from ..system.requirements import Requirements
from ..system.uncertainty import Uncertainty
from .common_sections import (
    ControlSection,
    DriveSection,
    LimitsSection,
    PositiveInterval,
    RangesSection,
    delay_of,
    refuse_long_delay,
    refuse_quick_filters,
    refuse_seized_gearbox,
    spread,
    tick_of,
)
from .file_types import parse_as

if TYPE_CHECKING:
    from ..simulation.spec import SimulationSpec
    from .joint_scenario import ScenarioSection


def load_joint(path: Path) -> JointSpec:
    """The joint that a joint.yaml describes.

    Raises GainroomError, one line that names the file, the key, the value and what is allowed.
    """
    return parse_joint(read_text(path), str(path))


def parse_joint(text: str, source: str) -> JointSpec:
    """As load_joint, for the text of a file that messages call `source`."""
    file = _file(text, source)
    if file.scenario != {}:
        _scenario(file, source)
    with named(source):
        return file.spec()


def load_simulation(path: Path) -> "SimulationSpec":
    """As load_joint: the joint with its scenario, the usual one where the file has none."""
    return parse_simulation(read_text(path), str(path))


def parse_simulation(text: str, source: str) -> "SimulationSpec":
    """As load_simulation, for the text of a file that messages call `source`."""
    file = _file(text, source)
    scenario = _scenario(file, source)
    from ..simulation.spec import NO_RATE

    with named(source):
        if file.control.sample_rate_hz is None:  # else a delay in ticks would ask for another remedy
            raise GainroomError(NO_RATE)
        return scenario.spec(file.spec())


def _file(text: str, source: str) -> "JointFile":
    return validate(JointFile, parse_as("joint", text, source, "testbed"), source)


def _scenario(file: "JointFile", source: str) -> "ScenarioSection":
    """Its section, checked; only here is the simulation loaded."""
    from .joint_scenario import ScenarioSection

    return validate(ScenarioSection, file.scenario, source, "scenario")


class JointSection(Section):
    """Two inertias and the gearbox between them."""

    motor_inertia: Positive | None = Field(None, description="on the joint side [kg m²]")
    rotor_inertia: Positive | None = Field(None, description="of the rotor itself [kg m²]")
    gear_ratio: Positive | None = None
    link_inertia: PositiveOrInfinite = Field(description="the load's inertia [kg m²], .inf where it is locked")
    stiffness: PositiveOrInfinite = Field(description="of the gearbox [N m/rad], .inf for a rigid joint")
    damping: NotNegative = 0.0
    motor_viscous: NotNegative = 0.0
    link_viscous: NotNegative = 0.0

    @model_validator(mode="after")
    def _one_motor(self) -> "JointSection":
        given = (self.motor_inertia is not None, self.rotor_inertia is not None, self.gear_ratio is not None)
        if given not in ((True, False, False), (False, True, True)):
            raise refusal("give either motor_inertia (joint side), or rotor_inertia with gear_ratio")
        return self

    def joint(self) -> ElasticJoint:
        """In SI, on the joint side."""
        others = self.model_dump(exclude={"motor_inertia", "rotor_inertia", "gear_ratio"})
        if self.motor_inertia is not None:
            return ElasticJoint(motor_inertia=self.motor_inertia, **others)
        return ElasticJoint.from_motor(self.rotor_inertia or 0.0, self.gear_ratio or 0.0, **others)


class JointControlSection(ControlSection):
    """What the three controllers share."""

    def controller(self) -> PD | PID | PPI:
        """The controller with its filters."""
        raise NotImplementedError


class PDSection(JointControlSection):
    """kp + kd s."""

    type: Literal["pd"]
    kp: Positive = Field(description="[N m/rad]")
    kd: NotNegative = Field(description="[N m s/rad]")

    def controller(self) -> PD:
        """The controller with its filters."""
        return PD(kp=self.kp, kd=self.kd, **self.filters())


class PIDSection(JointControlSection):
    """kp + ki/s + kd s."""

    type: Literal["pid"]
    kp: Positive = Field(description="[N m/rad]")
    ki: NotNegative = Field(description="[N m/(rad s)]")
    kd: NotNegative = Field(description="[N m s/rad]")

    def controller(self) -> PID:
        """The controller with its filters."""
        return PID(kp=self.kp, ki=self.ki, kd=self.kd, **self.filters())


class PPISection(JointControlSection):
    """(kv + ki/s)(kp + s), the P/PI cascade."""

    type: Literal["ppi"]
    kp: Positive = Field(description="of the position loop [1/s]")
    kv: Positive = Field(description="of the velocity loop [N m s/rad]")
    ki: NotNegative = Field(description="of the velocity loop [N m/rad]")

    def controller(self) -> PPI:
        """The controller with its filters."""
        return PPI(kp=self.kp, kv=self.kv, ki=self.ki, **self.filters())


Control = Annotated[
    PDSection | PIDSection | PPISection,
    Field(discriminator="type"),
    typed("pd", "pid", "ppi", beside="feedback and the gains of that type"),
]


class UncertaintySection(RangesSection):
    """The shared ranges, and the load's."""

    link_inertia: PositiveInterval | None = None

    def uncertainty(self, joint: ElasticJoint, delay: float, tick: float | None) -> Uncertainty:
        """In SI, around `joint` and `delay` [s]; `tick` [s]. Raises GainroomError where they do not fit."""
        key, given, unit = self.delay_range(tick)
        return Uncertainty(
            delay=spread(key, given, delay, unit),
            stiffness=spread("stiffness", self.stiffness, joint.stiffness),
            link_inertia=spread("link_inertia", self.link_inertia, joint.link_inertia),
            motor_inertia=spread("motor_inertia", self.motor_inertia, joint.motor_inertia),
            damping=spread("damping", self.damping, joint.damping),
        )


class JointFile(Section):
    """joint.yaml as it is written."""

    joint: JointSection = Field(description="the inertias and the gearbox")
    drive: DriveSection = Field(description="the current loop and the delay")
    control: Control = Field(description="the controller and its gains")
    limits: LimitsSection | None = None
    uncertainty: UncertaintySection = UncertaintySection()
    scenario: Any = Field(default_factory=dict, description="what happens to the joint: a ScenarioSection")

    def spec(self) -> JointSpec:
        """In SI units. Raises GainroomError where sections contradict each other."""
        joint = self.joint.joint()
        tick = tick_of(self.control, self.drive)
        sampled = self.control.sample_rate_hz is not None
        delay = delay_of(self.drive, tick)
        refuse_long_delay(delay, tick if sampled else None)
        refuse_seized_gearbox(joint.motor_inertia, joint.stiffness, joint.damping)
        refuse_quick_filters(self.control, tick if sampled else None)
        return JointSpec(
            joint=joint,
            drive=Drive(bandwidth=self.drive.bandwidth, damping_ratio=self.drive.damping_ratio, delay=delay),
            controller=self.control.controller(),
            feedback=self.control.feedback,
            sample_time=tick if sampled else None,
            requirements=Requirements.usual() if self.limits is None else self.limits.requirements(),
            uncertainty=self.uncertainty.uncertainty(joint, delay, tick),
            typed=self.joint.model_dump(include={"rotor_inertia", "gear_ratio"}, exclude_none=True),
        )
