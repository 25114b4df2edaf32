"""joint.yaml: one joint, its drive, its controller and what is asked of them, checked and turned into a JointSpec.

Everything is SI and radians except where a key's name carries another unit (delay_ms, sample_rate_hz, gain_margin_db).
"""

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from .controller import PD, PID, PPI, LowPass, Notch
from .drive import Drive
from .errors import GainroomError
from .io.checked import NotNegative, Positive, PositiveOrInfinite, Section, number, one_of, refusal, validate
from .io.yaml_text import parse_yaml, read_text, shown
from .plant import ElasticJoint
from .recommend import Requirements, Uncertainty
from .study import JointSpec

PERCENTAGE = re.compile(r"(?:±|\+/-)?\s*([0-9]{1,3}(?:\.[0-9]{0,9})?)\s*%")
MAX_TICKS = 1000
"""A sampled loop carries one state per tick of delay."""

SampleRate = Annotated[float, number(least=1, most=1e6)]
DELAY_MS = number(least=0, most=10_000)
DELAY_TICKS = number(least=0, most=MAX_TICKS)
DelayMs = Annotated[float, DELAY_MS]
DelayTicks = Annotated[float, DELAY_TICKS]


def load_joint(path: Path) -> JointSpec:
    """The joint that a joint.yaml describes.

    Raises GainroomError, one line that names the file, the key, the value and what is allowed.
    """
    return parse_joint(read_text(path), str(path))


def parse_joint(text: str, source: str) -> JointSpec:
    """As load_joint, for the text of a file that messages call `source`."""
    data = parse_yaml(text, source)
    if data is None:
        raise GainroomError(f"{source}: is empty; `gainroom example testbed` prints a file to start from")
    file = validate(JointFile, data, source)
    try:
        return file.spec()
    except GainroomError as error:
        raise GainroomError(f"{source}: {error}") from error


def interval(end: BeforeValidator) -> BeforeValidator:
    """A check: 20%, or [low, high] with low <= high, both ends as `end` allows."""

    def check(value: object) -> str | list[float]:
        if isinstance(value, str) and (match := PERCENTAGE.fullmatch(value)):
            if float(match[1]) >= 100:
                raise refusal(f"{shown(value)} must be less than 100%")
            return f"{match[1]}%"
        if not isinstance(value, list) or len(value) != 2:
            raise refusal(f"{shown(value)} must be [low, high], or a percentage such as 20%")
        low, high = (end.func(bound) for bound in value)  # type: ignore[call-arg]
        if low > high:
            raise refusal(f"{value} must be [low, high] with low <= high")
        return [low, high]

    return BeforeValidator(check)


PositiveInterval = Annotated[str | list[float], interval(number(above=0))]
NotNegativeInterval = Annotated[str | list[float], interval(number(least=0))]
DelayMsInterval = Annotated[str | list[float], interval(DELAY_MS)]
DelayTicksInterval = Annotated[str | list[float], interval(DELAY_TICKS)]


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


class DriveSection(Section):
    """Current loop and delay."""

    bandwidth: PositiveOrInfinite = Field(description="of the current loop [rad/s], .inf for an ideal one")
    damping_ratio: Annotated[float, number(above=0, most=100)] = 0.9
    delay_ms: DelayMs | None = None
    delay_ticks: DelayTicks | None = None
    sample_rate_hz: SampleRate | None = None

    @model_validator(mode="after")
    def _one_delay(self) -> "DriveSection":
        if (self.delay_ms is None) == (self.delay_ticks is None):
            raise refusal("give either delay_ms, or delay_ticks with sample_rate_hz (0 where there is no delay)")
        return self


class LowPassSection(Section):
    """A low-pass filter on the velocity."""

    bandwidth: Positive | None = Field(None, description="[rad/s]")
    bandwidth_hz: Positive | None = None
    order: Annotated[int, one_of(1, 2)] = 1
    damping_ratio: Annotated[float, number(above=0, most=100)] | None = None

    @model_validator(mode="after")
    def _one_bandwidth(self) -> "LowPassSection":
        if (self.bandwidth is None) == (self.bandwidth_hz is None):
            raise refusal("give either bandwidth [rad/s] or bandwidth_hz")
        if self.damping_ratio is not None and self.order == 1:
            raise refusal("is for order 2 only", key="damping_ratio")
        return self

    def low_pass(self) -> LowPass:
        """In rad/s."""
        optional = {} if self.damping_ratio is None else {"damping_ratio": self.damping_ratio}
        return LowPass(bandwidth=_rad_per_s(self.bandwidth, self.bandwidth_hz), order=self.order, **optional)


class NotchSection(Section):
    """A notch in the controller's output."""

    frequency: Positive | None = Field(None, description="[rad/s]")
    frequency_hz: Positive | None = None
    width: Annotated[float, number(above=0, most=100)] | None = None
    depth: Annotated[float, number(least=0, most=1)] | None = None

    @model_validator(mode="after")
    def _one_frequency(self) -> "NotchSection":
        if (self.frequency is None) == (self.frequency_hz is None):
            raise refusal("give either frequency [rad/s] or frequency_hz")
        return self

    def notch(self) -> Notch:
        """In rad/s."""
        optional = self.model_dump(include={"width", "depth"}, exclude_none=True)
        return Notch(frequency=_rad_per_s(self.frequency, self.frequency_hz), **optional)


class ControlSection(Section):
    """What the three controllers share."""

    feedback: Annotated[Literal["motor", "link"], one_of("motor", "link")] = Field(description="the side the encoder is on, motor or link")
    sample_rate_hz: SampleRate | None = None
    velocity_filter: LowPassSection | None = None
    notches: list[NotchSection] = Field([], max_length=20)

    def controller(self) -> PD | PID | PPI:
        """The controller with its filters."""
        raise NotImplementedError

    def filters(self) -> dict[str, Any]:
        """What every controller's constructor takes beside the gains."""
        low_pass = None if self.velocity_filter is None else self.velocity_filter.low_pass()
        return {"velocity_filter": low_pass, "notches": tuple(section.notch() for section in self.notches)}


class PDSection(ControlSection):
    """kp + kd s."""

    type: Literal["pd"]
    kp: Positive = Field(description="[N m/rad]")
    kd: NotNegative = Field(description="[N m s/rad]")

    def controller(self) -> PD:
        """The controller with its filters."""
        return PD(kp=self.kp, kd=self.kd, **self.filters())


class PIDSection(ControlSection):
    """kp + ki/s + kd s."""

    type: Literal["pid"]
    kp: Positive = Field(description="[N m/rad]")
    ki: NotNegative = Field(description="[N m/(rad s)]")
    kd: NotNegative = Field(description="[N m s/rad]")

    def controller(self) -> PID:
        """The controller with its filters."""
        return PID(kp=self.kp, ki=self.ki, kd=self.kd, **self.filters())


class PPISection(ControlSection):
    """(kv + ki/s)(kp + s), the P/PI cascade."""

    type: Literal["ppi"]
    kp: Positive = Field(description="of the position loop [1/s]")
    kv: Positive = Field(description="of the velocity loop [N m s/rad]")
    ki: NotNegative = Field(description="of the velocity loop [N m/rad]")

    def controller(self) -> PPI:
        """The controller with its filters."""
        return PPI(kp=self.kp, kv=self.kv, ki=self.ki, **self.filters())


def check_type(value: object) -> object:
    """The controller's type comes first: it decides which other keys there are."""
    if not isinstance(value, dict):
        raise refusal(f"{shown(value)} must be a section with the keys type, feedback and the gains of that type")
    if "type" not in value:
        raise refusal("is missing: pd, pid or ppi", key="type")
    if value["type"] not in ("pd", "pid", "ppi"):
        raise refusal(f"{shown(value['type'])} must be pd, pid or ppi", key="type")
    return value


Control = Annotated[PDSection | PIDSection | PPISection, Field(discriminator="type"), BeforeValidator(check_type)]


class LimitsSection(Section):
    """Required margins; a margin that is not named is not required."""

    gain_margin_db: Annotated[float, number(above=0, most=100)] | None = None
    phase_margin_deg: Annotated[float, number(above=0, most=120)] | None = None
    peak_sensitivity: Annotated[float, number(above=1, most=1000)] | None = None

    def requirements(self) -> Requirements:
        """As factor and rad."""
        decibels, degrees = self.gain_margin_db, self.phase_margin_deg
        return Requirements(
            gain_margin=None if decibels is None else 10 ** (decibels / 20),
            phase_margin=None if degrees is None else math.radians(degrees),
            peak_sensitivity=self.peak_sensitivity,
        )


class UncertaintySection(Section):
    """Ranges, each [low, high] or a percentage to either side; the limits then hold for every case inside."""

    delay_ms: DelayMsInterval | None = None
    delay_ticks: DelayTicksInterval | None = None
    stiffness: PositiveInterval | None = None
    link_inertia: PositiveInterval | None = None
    motor_inertia: PositiveInterval | None = None
    damping: NotNegativeInterval | None = None

    @model_validator(mode="after")
    def _one_delay(self) -> "UncertaintySection":
        if self.delay_ms is not None and self.delay_ticks is not None:
            raise refusal("give either delay_ms or delay_ticks, not both")
        return self

    def uncertainty(self, joint: ElasticJoint, delay: float, tick: float | None) -> Uncertainty:
        """In SI, around `joint` and `delay` [s]; `tick` [s]. Raises GainroomError where they do not fit."""
        if self.delay_ticks is not None and tick is None:
            raise GainroomError("uncertainty.delay_ticks: needs control.sample_rate_hz or drive.sample_rate_hz")
        key, unit = ("delay_ms", 1e-3) if self.delay_ticks is None else ("delay_ticks", tick or 0.0)
        return Uncertainty(
            delay=_interval(key, getattr(self, key), delay, unit),
            stiffness=_interval("stiffness", self.stiffness, joint.stiffness),
            link_inertia=_interval("link_inertia", self.link_inertia, joint.link_inertia),
            motor_inertia=_interval("motor_inertia", self.motor_inertia, joint.motor_inertia),
            damping=_interval("damping", self.damping, joint.damping),
        )


class JointFile(Section):
    """joint.yaml as it is written."""

    joint: JointSection = Field(description="the inertias and the gearbox")
    drive: DriveSection = Field(description="the current loop and the delay")
    control: Control = Field(description="the controller and its gains")
    limits: LimitsSection | None = None
    uncertainty: UncertaintySection = UncertaintySection()

    def spec(self) -> JointSpec:
        """In SI units. Raises GainroomError where sections contradict each other."""
        joint = self.joint.joint()
        tick = self._tick()
        sampled = self.control.sample_rate_hz is not None
        delay = self._delay(tick)
        if sampled and tick is not None and delay > MAX_TICKS * tick:
            raise GainroomError(f"drive: the delay of {delay / tick:g} ticks must be <= {MAX_TICKS} ticks")
        return JointSpec(
            joint=joint,
            drive=Drive(bandwidth=self.drive.bandwidth, damping_ratio=self.drive.damping_ratio, delay=delay),
            controller=self.control.controller(),
            feedback=self.control.feedback,
            sample_time=tick if sampled else None,
            requirements=Requirements.usual() if self.limits is None else self.limits.requirements(),
            uncertainty=self.uncertainty.uncertainty(joint, delay, tick),
        )

    def _tick(self) -> float | None:
        """The sample time [s], from whichever section has the rate."""
        mine, drives = self.control.sample_rate_hz, self.drive.sample_rate_hz
        if mine is not None and drives is not None and mine != drives:
            raise GainroomError(f"drive.sample_rate_hz: {drives} must equal control.sample_rate_hz {mine}, or be left out")
        rate = mine if mine is not None else drives
        return None if rate is None else 1 / rate

    def _delay(self, tick: float | None) -> float:
        """T [s], from milliseconds or ticks."""
        if self.drive.delay_ticks is None:
            return 1e-3 * (self.drive.delay_ms or 0.0)
        if tick is None:
            raise GainroomError(
                f"drive.delay_ticks: {self.drive.delay_ticks} needs sample_rate_hz (in drive, or in control where the "
                "loop is to be studied as sampled), or give delay_ms"
            )
        return self.drive.delay_ticks * tick


def _rad_per_s(angular: float | None, hertz: float | None) -> float:
    return 2 * math.pi * (hertz or 0.0) if angular is None else angular


def _interval(key: str, given: str | list[float] | None, nominal: float, unit: float = 1.0) -> tuple[float, float] | None:
    """(low, high) in SI of [low, high] in `unit`, or of a percentage around `nominal`."""
    if given is None:
        return None
    if not math.isfinite(nominal):
        raise GainroomError(f"uncertainty.{key}: has no meaning around a value of .inf")
    if isinstance(given, str):
        part = float(given.removesuffix("%")) / 100
        return nominal * (1 - part), nominal * (1 + part)
    low, high = (end * unit for end in given)
    if not low * (1 - 1e-9) <= nominal <= high * (1 + 1e-9):
        raise GainroomError(f"uncertainty.{key}: {given} must contain the file's own value, {nominal / unit:g}")
    return low, high
