"""Sections that files share, one joint's or a whole robot's: drive, control, filters, limits, ranges; checked, then turned into SI."""

import math
import re
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from ..errors import GainroomError
from ..io.validation import Positive, Section, number, one_of, refusal
from ..io.yaml_text import shown
from ..system.controller import LowPass, Notch
from ..system.requirements import Requirements

PERCENTAGE = re.compile(r"(?:±|\+/-)?\s*([0-9]{1,3}(?:\.[0-9]{0,9})?)\s*%")
MOST_DAMPED = 1e4  # damping ratio of motor and spring: beyond it nothing is left of the spring
MAX_TICKS = 1000
"""A sampled loop carries one state per tick of delay."""

RATE = number(least=1, most=1e6, unit="Hz")
SampleRate = Annotated[float, RATE]
DELAY_MS = number(least=0, most=10_000, unit="ms")
DELAY_TICKS = number(least=0, most=MAX_TICKS, unit="ticks")
BANDWIDTH = number(above=0, most=1e6, infinite=True, unit="rad/s")
"""Of a current loop: the quickest have 1e5 rad/s; what is far quicker than that is ideal, .inf."""
DelayMs = Annotated[float, DELAY_MS]
Bandwidth = Annotated[float, BANDWIDTH]
DelayTicks = Annotated[float, DELAY_TICKS]


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


class DriveSection(Section):
    """Current loop and delay."""

    bandwidth: Bandwidth = Field(description="of the current loop [rad/s], .inf for an ideal one")
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
        return LowPass(bandwidth=rad_per_s(self.bandwidth, self.bandwidth_hz), order=self.order, **optional)


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
        return Notch(frequency=rad_per_s(self.frequency, self.frequency_hz), **optional)


class ControlSection(Section):
    """What the three controllers share."""

    feedback: Annotated[Literal["motor", "link"], one_of("motor", "link")] = Field(description="the side the encoder is on, motor or link")
    sample_rate_hz: SampleRate | None = None
    velocity_filter: LowPassSection | None = None
    notches: list[NotchSection] = Field([], max_length=20)

    def filters(self) -> dict[str, Any]:
        """What every controller's constructor takes beside the gains."""
        low_pass = None if self.velocity_filter is None else self.velocity_filter.low_pass()
        return {"velocity_filter": low_pass, "notches": tuple(section.notch() for section in self.notches)}


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


class RangesSection(Section):
    """Ranges, each [low, high] or a percentage to either side; the limits then hold for every case inside."""

    delay_ms: DelayMsInterval | None = None
    delay_ticks: DelayTicksInterval | None = None
    stiffness: PositiveInterval | None = None
    motor_inertia: PositiveInterval | None = None
    damping: NotNegativeInterval | None = None

    @model_validator(mode="after")
    def _one_delay(self) -> "RangesSection":
        if self.delay_ms is not None and self.delay_ticks is not None:
            raise refusal("give either delay_ms or delay_ticks, not both")
        return self

    def delay_range(self, tick: float | None) -> tuple[str, str | list[float] | None, float]:
        """The key of the delay's range, what it holds, and its unit [s]; `tick` [s]. Raises GainroomError where ticks have no length."""
        if self.delay_ticks is None:
            return "delay_ms", self.delay_ms, 1e-3
        if tick is None:
            raise GainroomError("uncertainty.delay_ticks: needs control.sample_rate_hz or drive.sample_rate_hz")
        return "delay_ticks", self.delay_ticks, tick


def tick_of(control: ControlSection, drive: DriveSection) -> float | None:
    """The sample time [s], from whichever section has the rate. Raises GainroomError where they disagree."""
    mine, drives = control.sample_rate_hz, drive.sample_rate_hz
    if mine is not None and drives is not None and mine != drives:
        raise GainroomError(f"drive.sample_rate_hz: {drives} must equal control.sample_rate_hz {mine}, or be left out")
    rate = mine if mine is not None else drives
    return None if rate is None else 1 / rate


def delay_of(drive: DriveSection, tick: float | None) -> float:
    """T [s], from milliseconds or ticks. Raises GainroomError where ticks have no length."""
    if drive.delay_ticks is None:
        return 1e-3 * (drive.delay_ms or 0.0)
    if tick is None:
        raise GainroomError(
            f"drive.delay_ticks: {drive.delay_ticks} needs sample_rate_hz (in drive, or in control where the "
            "loop is to be studied as sampled), or give delay_ms"
        )
    return drive.delay_ticks * tick


def refuse_quick_filters(control: ControlSection, tick: float | None) -> None:
    """Raise GainroomError where a filter lies above half the sample rate of a sampled loop; `tick` None: continuous."""
    if tick is None:
        return
    low_pass = control.velocity_filter
    typed = {} if low_pass is None else {"velocity_filter.bandwidth": (low_pass.bandwidth, low_pass.bandwidth_hz)}
    typed |= {f"notches[{k}].frequency": (notch.frequency, notch.frequency_hz) for k, notch in enumerate(control.notches)}
    for key, (angular, hertz) in typed.items():
        if rad_per_s(angular, hertz) * tick >= math.pi:
            told = f"_hz: {hertz:g} Hz" if angular is None else f": {angular:g} rad/s"
            half = f"{0.5 / tick:g} Hz" if angular is None else f"{math.pi / tick:.6g} rad/s"
            raise GainroomError(f"control.{key}{told} must be below half the sample rate, {half}")


def refuse_long_delay(delay: float, tick: float | None, owner: str = "drive") -> None:
    """Raise GainroomError where a sampled loop would carry too many ticks of delay; `tick` None: continuous."""
    if tick is not None and delay > MAX_TICKS * tick:
        raise GainroomError(f"{owner}: the delay of {delay / tick:g} ticks must be <= {MAX_TICKS} ticks")


def refuse_seized_gearbox(motor_inertia: float, stiffness: float, damping: float) -> None:
    """Raise GainroomError where a gearbox's damping holds motor and link together as if it were rigid, at any frequency that counts."""
    most = 2 * MOST_DAMPED * math.sqrt(stiffness * motor_inertia) if math.isfinite(stiffness) else math.inf
    if damping > most > 0:
        raise GainroomError(
            f"joint.damping: {damping:g} must be <= {most:g} ({MOST_DAMPED:g} times the critical damping of motor and spring); look for a "
            "wrong unit, or give stiffness .inf for a rigid gearbox"
        )


def rad_per_s(angular: float | None, hertz: float | None) -> float:
    """[rad/s], of a frequency that was given as that or in Hz."""
    return 2 * math.pi * (hertz or 0.0) if angular is None else angular


def spread(key: str, given: str | list[float] | None, nominal: float, unit: float = 1.0) -> tuple[float, float] | None:
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
