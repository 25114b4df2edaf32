"""Sections of a system's file, of one joint or of a whole robot: motor and gearbox, drive, control, limits, ranges."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, create_model

from ..errors import GainroomError, Together, UnjudgedError, listed
from ..io.validation import (
    Name,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    Refusals,
    Section,
    items,
    made_when_read,
    number,
    refusal,
    relation,
)
from ..io.yaml_text import shown
from ..system.actuator_entry import ActuatorEntry
from ..system.controller import CONTROLLERS, Controller, GainKey
from ..system.drive import Drive
from ..system.feedback import MISFIT
from ..system.filters import Biquad, LowPass, Notch
from ..system.gain_bounds import BOUNDS
from ..system.gain_path import GainPath, samples_in_common
from ..system.linear.arrays import Floats
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.uncertainty import Uncertainty
from .actuator_facts import Actuator, actuators, unknown_actuator

PERCENTAGE = re.compile(r"(?:±|\+/-)?\s*([0-9]{1,3}(?:\.[0-9]{0,9})?)\s*%")
MAX_TICKS, MAX_DELAY = 1000, 1.0
"""Maximum delay [ticks], as a sampled loop has one state per tick of delay; and without a rate [s], as loci turn once per 2π/ω of it."""

DELAY_MS = number(least=0, most=10_000, unit="ms")
DELAY_TICKS = number(least=0, most=MAX_TICKS, unit="ticks")
RATE = number(least=1, most=1e6, unit="Hz")
SampleRate = Annotated[float, RATE]
DelayMs = Annotated[float, DELAY_MS]
DelayTicks = Annotated[float, DELAY_TICKS]
Bandwidth = Annotated[float, number(above=0, most=1e6, infinite=True, unit="rad/s")]
"""Bandwidth of a current loop [rad/s]: the fastest have 1e5; a far faster one is ideal, .inf."""
DampingRatio = Annotated[float, number(above=0, most=100)]
Stiffness = Annotated[PositiveOrInfinite, BeforeValidator(lambda value: math.inf if value == "rigid" else value)]


def interval(end: BeforeValidator) -> BeforeValidator:
    """Validator of an interval: 20%, or [low, high] with low <= high, both ends valid under `end`."""

    def check(value: object) -> str | list[float]:
        if isinstance(value, str) and (match := PERCENTAGE.fullmatch(value)):
            if float(match[1]) >= 100:
                raise refusal(f"{shown(value)} must be less than 100%")
            return f"{match[1]}%"
        if not isinstance(value, list) or len(value) != 2:
            raise refusal(f"{shown(value)} must be [low, high], or a percentage such as 20%")
        low, high = items(value, end)
        if low > high:
            raise refusal(f"{value} must be [low, high] with low <= high")
        return [low, high]

    return BeforeValidator(check)


PositiveInterval = Annotated[str | list[float], interval(number(above=0))]
NotNegativeInterval = Annotated[str | list[float], interval(number(least=0))]
DelayMsInterval = Annotated[str | list[float], interval(DELAY_MS)]
DelayTicksInterval = Annotated[str | list[float], interval(DELAY_TICKS)]


class GearboxSection(Section):
    """Motor and gearbox."""

    actuator: Name | None = Field(None, description="a name of `gainroom actuators`, whose published figures stand for what is not given")
    motor_inertia: Positive | None = Field(None, description="on the joint side [kg m²]")
    rotor_inertia: Positive | None = Field(None, description="of the rotor itself [kg m²]")
    gear_ratio: Positive | None = None
    damping: NotNegative = 0.0
    motor_viscous: NotNegative = 0.0
    link_viscous: NotNegative = 0.0

    @relation
    def _known_actuator(self) -> Refusals:
        if self.actuator is not None and self.actuator not in actuators():
            yield refusal(unknown_actuator(self.actuator), key="actuator")

    @property
    def facts(self) -> Actuator | None:
        """Published figures of the actuator that is named. Raises UnjudgedError where its name is wrong."""
        if self.actuator is None:
            return None
        if self.actuator not in actuators():
            raise UnjudgedError("actuator")
        return actuators()[self.actuator]

    def entry(self, keys: Sequence[str] = ()) -> ActuatorEntry:
        """Actuator entry in SI with the given values, of `keys` alone where they are named, completed by published figures."""
        names = set(keys or ActuatorEntry.__dataclass_fields__) - {"actuator"}
        own = ActuatorEntry(**self.model_dump(include=names, exclude_unset=True))
        return own if self.facts is None else own.over(self.facts.entry())


class DriveSection(Section):
    """Section `drive`: current loop and delay."""

    bandwidth: Bandwidth = Field(description="the bandwidth of the current loop [rad/s], a number > 0, or .inf for an ideal one")
    damping_ratio: DampingRatio = 0.9
    delay_ms: DelayMs | None = None
    delay_ticks: DelayTicks | None = None
    sample_rate_hz: SampleRate | None = None
    delay_includes_sampling: bool = Field(False, description="true: the delay contains the loop's hold and velocity difference")
    jitter_ms: Annotated[float, number(least=0, most=1000, unit="ms")] = 0.0
    encoder_resolution: Annotated[float, number(least=0, most=1, unit="rad")] = 0.0
    torque_noise: NotNegative | None = None
    command_delay_ms: DelayMs = 0.0
    clock: Literal["continuous"] | None = Field(None, description="continuous: the loop has no rate, on purpose")

    @relation
    def _one_delay(self) -> Refusals:
        given = self.is_given("delay_ms"), self.is_given("delay_ticks")
        if not any(given):
            what = "the delay from the command of a torque to the torque [ms], a number >= 0; or give delay_ticks with sample_rate_hz"
            yield refusal(f"is missing: {what}", key="delay_ms")
        if all(given):
            yield refusal("give either delay_ms or delay_ticks, not both")

    @property
    def delay_key(self) -> str:
        """Key that gives the delay."""
        return "drive.delay_ticks" if self.delay_ms is None else "drive.delay_ms"

    def drive(self, tick: float | None) -> Drive:
        """Drive in SI; `tick` [s]. Raises GainroomError as `delay`."""
        self.require_right()
        return Drive(self.bandwidth, self.damping_ratio, self.delay(tick), self.encoder_resolution, self.torque_noise)

    def delay(self, tick: float | None) -> float:
        """Delay [s]; `tick` [s]. Raises GainroomError for a delay in ticks without a tick."""
        if self.delay_ticks is None:
            return 1e-3 * (self.delay_ms or 0.0)
        if self.delay_ms is not None:
            raise UnjudgedError
        if tick is None:
            raise GainroomError(
                f"drive.delay_ticks: {self.delay_ticks} needs sample_rate_hz (in drive, or in control where the "
                "loop is to be studied as sampled), or give delay_ms"
            )
        return self.delay_ticks * tick


class FrequencySection(Section):
    """Section with frequencies, each in rad/s under its key, one of EITHER, or in Hz under key_hz."""

    EITHER: ClassVar[tuple[str, ...]] = ()

    @relation
    def _one_of_each(self) -> Refusals:
        for key in self.EITHER:
            if self.is_given(key) == self.is_given(f"{key}_hz"):
                yield refusal(f"give either {key} [rad/s] or {key}_hz")

    def omega(self, key: str) -> float:
        """Frequency under a key [rad/s]."""
        return rad_per_s(getattr(self, key), getattr(self, f"{key}_hz"))

    def require_below(self, key: str, owner: str, nyquist: float) -> None:
        """Raise GainroomError unless the frequency is below half the sample rate [rad/s]; the message uses the unit that was typed."""
        if self.omega(key) >= nyquist:
            hertz = getattr(self, f"{key}_hz")
            typed = f": {getattr(self, key):g} rad/s" if hertz is None else f"_hz: {hertz:g} Hz"
            half = f"{nyquist:.6g} rad/s" if hertz is None else f"{nyquist / (2 * math.pi):g} Hz"
            raise GainroomError(f"{owner}.{key}{typed} must be below half the sample rate, {half}")


def rad_per_s(angular: float | None, hertz: float | None) -> float:
    """Frequency [rad/s] of one given in rad/s or in Hz."""
    return 2 * math.pi * (hertz or 0.0) if angular is None else angular


class LowPassSection(FrequencySection):
    """Low-pass filter on the velocity."""

    EITHER = ("bandwidth",)

    bandwidth: Positive | None = Field(None, description="[rad/s]")
    bandwidth_hz: Positive | None = None
    order: Literal[1, 2] = 1
    damping_ratio: DampingRatio | None = None

    @relation
    def _damped(self) -> Refusals:
        if self.damping_ratio is not None and self.order == 1:
            yield refusal("is for order 2 only", key="damping_ratio")

    def low_pass(self) -> LowPass:
        """Filter in rad/s."""
        optional = self.model_dump(include={"damping_ratio"}, exclude_none=True)
        return LowPass(bandwidth=self.omega("bandwidth"), order=self.order, **optional)


class NotchSection(FrequencySection):
    """Notch in the controller's output."""

    EITHER = ("frequency",)

    frequency: Positive | None = Field(None, description="[rad/s]")
    frequency_hz: Positive | None = None
    width: Annotated[float, number(above=0, most=100)] | None = None
    depth: Annotated[float, number(least=0, most=1)] | None = None

    def notch(self) -> Notch:
        """Notch in rad/s."""
        return Notch(frequency=self.omega("frequency"), **self.model_dump(include={"width", "depth"}, exclude_none=True))


class BiquadSection(FrequencySection):
    """Biquad in the controller's output."""

    EITHER = ("zero_frequency", "pole_frequency")

    zero_frequency: Positive | None = Field(None, description="[rad/s]")
    zero_frequency_hz: Positive | None = None
    zero_damping: Annotated[float, number(least=0, most=100)] = Field(description="the damping ratio of the zeros, a number from 0 to 100")
    pole_frequency: Positive | None = Field(None, description="[rad/s]")
    pole_frequency_hz: Positive | None = None
    pole_damping: DampingRatio = Field(description="the damping ratio of the poles, a number > 0")

    def biquad(self) -> Biquad:
        """Biquad in rad/s."""
        return Biquad(self.omega("zero_frequency"), self.zero_damping, self.omega("pole_frequency"), self.pole_damping)


class GainPathSection(Section):
    """Section `kd_path`: loop of kd on the drive, if it is not closed with the other gains."""

    delay_ms: DelayMs = Field(description="the delay of kd's own loop, measurement to torque [ms], a number >= 0")
    sample_rate_hz: SampleRate = Field(description="the rate at which kd runs [Hz], a number >= 1")

    def path(self) -> GainPath:
        """Path in SI."""
        return GainPath(delay=1e-3 * self.delay_ms, sample_time=1 / self.sample_rate_hz)


def _one_side(value: object) -> object:
    """`value` unless it is a side per gain, which only a single joint has."""
    if isinstance(value, dict):
        raise refusal(f"{shown(value)} must be motor or link: {MISFIT}")
    return value


OneSide = Annotated[Literal["motor", "link"], BeforeValidator(_one_side)]


Types = dict[str, type[Controller]]


class KindSection(Section):
    """Kind of a controller, what it measures and how often."""

    type: str = Field(description="the kind of controller")
    feedback: OneSide = Field(description="the side of the gearbox that the encoder is on, motor or link")
    sample_rate_hz: SampleRate | None = None


class FiltersSection(Section):
    """Filters of a controller."""

    velocity_filter: LowPassSection | None = None
    notches: list[NotchSection] = Field([], max_length=20)
    biquads: list[BiquadSection] = Field([], max_length=20)

    def filters(self) -> dict[str, Any]:
        """Filter arguments of every controller's constructor."""
        low_pass = None if self.velocity_filter is None else self.velocity_filter.low_pass()
        notches, biquads = tuple(one.notch() for one in self.notches), tuple(one.biquad() for one in self.biquads)
        return {"velocity_filter": low_pass, "notches": notches, "biquads": biquads}

    def require_below(self, nyquist: float, velocity: float) -> None:
        """Raise GainroomError for a filter above half the rate at which it runs; `velocity` [rad/s] is half of that of kd."""
        with Together() as together:
            if (low_pass := self.velocity_filter) is not None:
                together.step(lambda: low_pass.require_below("bandwidth", "control.velocity_filter", velocity))
            for name, sections in (("notches", self.notches), ("biquads", self.biquads)):
                for index, section in enumerate(sections):
                    for key in section.EITHER:
                        place = f"control.{name}[{index}]"
                        together.step(lambda one=section, key=key, at=place: one.require_below(key, at, min(nyquist, velocity)))


class ControlSection(FiltersSection, KindSection):
    """Section `control`: its type, the side of its encoders, its filters; `control_section` adds the gains of all types."""

    ALLOWED: ClassVar[str] = ""
    """Allowed values of a gain, for messages."""
    ONE_JOINT: ClassVar[bool] = False
    """True: of a single joint, which has types of its own."""

    kd_path: GainPathSection | None = None

    @classmethod
    def types(cls) -> "Types":
        """Controllers by `type`."""
        return {name: one for name, one in CONTROLLERS.items() if cls.ONE_JOINT or not one.of_one_joint}

    @classmethod
    def known_gains(cls) -> tuple[str, ...]:
        """Gains of all types."""
        return tuple(dict.fromkeys(name for one in cls.types().values() for name in one.gain_names()))

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Gains of the type."""
        return CONTROLLERS[self.type].gain_names()

    @property
    def asks(self) -> bool:
        """True if gains are left out on purpose, where they are what is asked for."""
        return False

    @relation
    def _gains_of_the_type(self) -> Refusals:
        if not self.gain_names or self.asks:  # of tasks, or none
            return
        names = ", ".join(self.gain_names)
        given = [name for name in self.known_gains() if self.is_given(name)]
        missing = [key.name for key in CONTROLLERS[self.type].gain_keys() if key.needed and key.name not in given]
        damping, rates = CONTROLLERS[self.type].damping_name, {one.damping_name for one in self.types().values()}
        meant = set()
        for name in given:
            if name not in self.gain_names:
                other = damping if name in rates and damping in missing else ""
                meant.add(other)
                yield refusal(
                    f"is not a gain of type {self.type}, which has {names}{f'; did you mean {other}?' if other else ''}", key=name
                )
        for key in CONTROLLERS[self.type].gain_keys():
            if key.name in missing and key.name not in meant:
                yield refusal(f"is missing: {self.described(key)}; type {self.type} has {names}", key=key.name)
            elif key.name in given and self.may_not_be_zero(key) and self.is_right(key.name) and getattr(self, key.name) == 0:
                yield refusal("0 must be > 0", key=key.name)

    @relation
    def _both_sampled(self) -> Refusals:
        if self.kd_path is None:
            return
        if self.sample_rate_hz is None:
            yield refusal("is missing: the rate of the other gains [Hz], which kd_path needs", key="sample_rate_hz")
        if "kd" not in self.gain_names:
            yield refusal(f"has no meaning for type {self.type}, which has no kd", key="kd_path")

    def gain_path(self) -> GainPath | None:
        """Path of kd. Raises GainroomError if the two sample rates have no short common period, or for too long a delay."""
        if self.kd_path is None or self.sample_rate_hz is None:
            return None
        path = self.kd_path.path()
        try:
            samples_in_common(1 / self.sample_rate_hz, path.sample_time)
        except GainroomError as error:
            raise GainroomError(f"control.{str(error).replace('kd_path:', 'kd_path.sample_rate_hz:', 1)}") from error
        refuse_long_delay(path.delay, path.sample_time, "control.kd_path.delay_ms")
        return path

    @classmethod
    def gain_type(cls, keys: Sequence[GainKey]) -> Any:
        """Type that validates a gain read from a file, such as NotNegative or PerJoint[NotNegative].

        keys   the gain's key in each controller that has one of this name
        """
        raise NotImplementedError

    @classmethod
    def may_not_be_zero(cls, key: GainKey) -> bool:
        """True if a gain must be > 0."""
        return key.positive

    @classmethod
    def described(cls, key: GainKey) -> str:
        """Description of a gain that is missing, for messages."""
        unit, above = f" [{key.unit}]" if key.unit else "", "" if key.signed else " > 0" if cls.may_not_be_zero(key) else " >= 0"
        return f"{key.meaning}{unit}, a number{above}{cls.ALLOWED}"

    def controller(self, gains: Mapping[str, Any]) -> Controller:
        """Controller of the type with `gains` and the filters. Raises GainroomError, with keys and values, for what its class refuses."""
        self.require_right()
        filters = self.filters()
        try:
            found = CONTROLLERS[self.type](**gains, **filters)
            found.require_consistent()
        except GainroomError as error:
            raise GainroomError(*(_placed(problem, gains) for problem in error.problems)) from error
        return found

    def require_filters_below(self, nyquist: float) -> None:
        """Raise GainroomError for a filter above half the rate at which it runs; `nyquist` [rad/s] is that of all gains but kd."""
        self.require_below(nyquist, nyquist if self.kd_path is None else math.pi * self.kd_path.sample_rate_hz)


def _placed(problem: str, gains: Mapping[str, Any]) -> str:
    """Problem of a controller's class, which knows no file: behind keys and values of the gains that it names, or of all."""
    named = [name for name in gains if re.search(rf"\b{re.escape(name)}\b", problem)] or [*gains]
    values = ", ".join(f"control.{name} {shown(np.asarray(gains[name]).tolist())}" for name in named)
    return f"{values}: {problem}" if values else f"control: {problem}"


def control_section(base: type[ControlSection]) -> type[ControlSection]:
    """Section `base` with its types and their gains as keys."""
    return _control_section(base, tuple(base.types().items()))


@cache
def _control_section(base: type[ControlSection], controllers: tuple[tuple[str, type[Controller]], ...]) -> type[ControlSection]:
    keys: dict[str, list[GainKey]] = {}
    for _, one in controllers:
        for key in one.gain_keys():
            keys.setdefault(key.name, []).append(key)
    kinds = tuple(name for name, _ in controllers)
    fields: dict[str, Any] = {"type": (Literal[kinds], Field(description=f"the kind of controller, {listed(kinds, 'or', len(kinds))}"))}
    fields |= {name: (base.gain_type(every) | None, None) for name, every in keys.items()}
    return create_model(base.__name__, __base__=base, **fields)


def limits_section() -> type[Section]:
    """Section `limits`: required margins, one key per requirement; a margin that is not named is not required."""
    return _limits_section(tuple(REQUIREMENTS.values()))


@cache
def _limits_section(requirements: tuple[Requirement, ...]) -> type[Section]:
    fields: dict[str, Any] = {}
    for one in requirements:
        value: Any = Annotated[float, number(above=one.in_unit(one.low), most=one.most)]
        fields[one.key] = value | None, None
    return create_model("LimitsSection", __base__=Section, **fields)


class GainBoundsSection(Section):
    """Section `gain_bounds` of one joint, or of a robot's joints of one pattern: bounds of recommended gains."""

    kp_min: NotNegative | None = Field(None, description="[N·m/rad]")
    kp_max: Positive | None = Field(None, description="[N·m/rad]")
    kd_min: NotNegative | None = Field(None, description="[N·m·s/rad]")
    kd_max: Positive | None = Field(None, description="[N·m·s/rad]")

    @relation
    def _least_below_most(self) -> Refusals:
        for gain in ("kp", "kd"):
            least, most = (f"{gain}_{end}" for end in ("min", "max"))
            if self.is_given(least) and self.is_given(most) and self.is_right(least) and self.is_right(most):
                low, high = getattr(self, least), getattr(self, most)
                if low > high:
                    yield refusal(f"{low:g} must be <= {most} {high:g}", key=least)

    @property
    def given(self) -> dict[str, float]:
        """Bounds by name, those that are given."""
        return {name: value for name in BOUNDS if (value := getattr(self, name)) is not None}


class UncertaintySection(Section):
    """Ranges, each [low, high] or a percentage to either side; the limits then hold for every case inside."""

    delay_ms: DelayMsInterval | None = None
    delay_ticks: DelayTicksInterval | None = None
    stiffness: PositiveInterval | None = None
    motor_inertia: PositiveInterval | None = None
    damping: NotNegativeInterval | None = None

    @relation
    def _one_delay(self) -> Refusals:
        if self.is_given("delay_ms") and self.is_given("delay_ticks"):
            yield refusal("give either delay_ms or delay_ticks, not both")

    def uncertainty(self, nominal: Mapping[str, ArrayLike], tick: Callable[[], float | None]) -> Uncertainty:
        """Uncertainty in SI.

        `nominal`: values by name of Uncertainty, a number or one for each of n joints, as far as known; `tick` returns the sample time [s].

        Raises GainroomError where a range does not contain the nominal value, and where ticks have no length.
        """
        units: dict[str, Callable[[], float | None]] = {"delay_ms": lambda: 1e-3, "delay_ticks": tick}
        found = {}

        def add(key: str) -> None:
            given, name = getattr(self, key), "delay" if key in units else key
            if given is None:
                return
            if (unit := units.get(key, lambda: 1.0)()) is None:
                raise GainroomError("uncertainty.delay_ticks: needs control.sample_rate_hz or drive.sample_rate_hz")
            if name not in nominal:
                raise UnjudgedError(name)
            found[name] = _around(key, given, np.asarray(nominal[name], dtype=float), unit)

        with Together() as together:
            for key in type(self).model_fields:
                together.step(lambda key=key: add(key))
            return Uncertainty(**found)


def _around(key: str, given: str | list[float], nominal: Floats, unit: float) -> tuple[Floats, Floats]:
    """Interval (low, high) in SI from [low, high] in `unit`, or from a percentage around `nominal`, () or (n,); infinity stays."""
    finite = np.isfinite(nominal)
    if not finite.any():
        raise GainroomError(f"uncertainty.{key} has no meaning around a value of .inf")
    if isinstance(given, str):
        part = float(given.removesuffix("%")) / 100
        return nominal * (1 - part), nominal * (1 + part)
    low, high = (end * unit for end in given)
    outside = finite & ~((low * (1 - 1e-9) <= nominal) & (nominal <= high * (1 + 1e-9)))
    if outside.any():
        raise GainroomError(f"uncertainty.{key}: {given} must contain the file's own value, {nominal[outside][0] / unit:g}")
    return np.where(finite, low, np.inf), np.where(finite, high, np.inf)


Control = TypeVar("Control", bound=ControlSection)
Ranges = TypeVar("Ranges", bound=UncertaintySection)


class SystemFile(Section, Generic[Control, Ranges]):
    """File that describes a system, one joint or a robot."""

    drive: DriveSection = Field(description="the section of current loop and delay, such as {bandwidth: 4000, delay_ms: 2}")
    control: Control = Field(description="the section of the controller: type, feedback, its gains, and sample_rate_hz")
    limits: Annotated[Any, made_when_read(limits_section)] = None
    objective: Literal["dynamic_stiffness", "largest_kp"] = Field(
        "dynamic_stiffness", description="what recommended gains make largest: the link's dynamic stiffness, or kp"
    )
    uncertainty: Ranges = Field(default_factory=dict, validate_default=True)  # type: ignore[assignment] - {} as a section

    @relation
    def _bounds_of_its_gains(self) -> Refusals:
        """Refusal of `gain_bounds` for a type of controller without kp and kd."""
        names, kind = ("kp", "kd"), self.control.type
        if self.is_given("gain_bounds") and not set(names) <= {*CONTROLLERS[kind].gain_names()}:
            kinds = [name for name, one in self.control.types().items() if set(names) <= {*one.gain_names()}]
            yield refusal(
                f"are of kp [N·m/rad] and kd [N·m·s/rad], which type {kind} has not; {' and '.join(kinds)} have", key="gain_bounds"
            )

    def tick(self) -> float | None:
        """Sample time [s], from the section with the rate. Raises GainroomError if two sections disagree."""
        control, drive = self.control.sample_rate_hz, self.drive.sample_rate_hz
        if control is not None and drive is not None and control != drive:
            raise GainroomError(f"drive.sample_rate_hz: {drive} must equal control.sample_rate_hz {control}, or be left out")
        rate = drive if control is None else control
        return None if rate is None else 1 / rate

    def sample_time(self) -> float | None:
        """Sample time of the controller [s]; None: continuous. Raises GainroomError for a filter above half the sample rate."""
        if self.control.sample_rate_hz is None:
            return None
        with Together() as together:
            together.step(self._refuse_sampling_twice)
            together.step(self._refuse_clock)
            self.control.require_filters_below(math.pi * self.control.sample_rate_hz)
            return 1 / self.control.sample_rate_hz

    def _refuse_sampling_twice(self) -> None:
        if self.drive.delay_includes_sampling:
            raise GainroomError(
                "drive.delay_includes_sampling: must be false with control.sample_rate_hz: a sampled loop adds its own hold and velocity "
                "difference to the delay, so that they would count twice"
            )

    def _refuse_clock(self) -> None:
        if self.drive.clock is not None:
            raise GainroomError("drive.clock: must be left out with control.sample_rate_hz: a loop with a rate is not continuous")

    def requirements(self) -> Requirements:
        """Requirements of the file, or the usual ones if it has none; a drive's jitter asks for a jitter margin of at least as much."""
        given = {one.name: (one, getattr(self.limits, one.key)) for one in REQUIREMENTS.values()} if self.limits is not None else {}
        needed = {name: one.in_si(value) for name, (one, value) in given.items() if value is not None}
        needed = dict(Requirements.usual().needed) if self.limits is None else needed
        if self.drive.jitter_ms > 0:
            needed["jitter_margin"] = max(1e-3 * self.drive.jitter_ms, needed.get("jitter_margin", 0.0))
        return Requirements(**needed)


def refuse_two_paths(control: ControlSection, two_paths: bool) -> None:
    """Raise GainroomError if kd has a path of its own, unless `two_paths`: the caller supports it."""
    if control.kd_path is not None and not two_paths:
        raise GainroomError(
            "control.kd_path: is known to `gainroom joint`, `robot` and `audit`, and of one joint to `simulate`, `verify` and `app`, "
            "not here; leave it out: one rate and delay for all gains"
        )


def refuse_long_delay(delay: float, sample_time: float | None, owner: str) -> None:
    """Raise GainroomError for a delay that no loop of a robot has; `sample_time` None: continuous.

    owner   the key or option that says so, and of which joint
    """
    longest = MAX_DELAY if sample_time is None else MAX_TICKS * sample_time
    if delay > longest:
        ticks = "without a rate" if sample_time is None else f"{MAX_TICKS} ticks at {1 / sample_time:g} Hz"
        raise GainroomError(f"{owner}: {1e3 * delay:g} ms must be <= {1e3 * longest:g} ms, {ticks}")
