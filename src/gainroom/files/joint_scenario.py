"""Section `scenario` of joint.yaml: reference, disturbances, and hardware effects beyond the linear model."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import GainroomError, Together
from ..io.validation import Flag, NotNegative, Positive, PositiveOrInfinite, Refusals, Section, number, refusal, relation, typed
from ..simulation import Chirp, Friction, Multisine, Scenario, Spline, Step, Trajectory
from ..simulation.simulation_spec import JointSimulation
from ..system.linear.arrays import Floats
from ..system.system import System
from .logs import read_log
from .system_sections import FrequencySection, rad_per_s

FURTHEST_REFERENCE = 1000.0  # [rad] that a reference may reach; a run has diverged at ten times as much
LONGEST_RUN = 3600.0  # [s]
MOST_SINES = 200
SAME_TICK = 1e-3  # relative: what the rows of a torque file may be apart otherwise than the controller's ticks

Angle = Annotated[float, number(least=-FURTHEST_REFERENCE, most=FURTHEST_REFERENCE)]
Size = Annotated[float, number(least=0, most=FURTHEST_REFERENCE)]
Torque = Annotated[float, number(least=-1e12)]
Instant = Annotated[float, number(least=0, most=LONGEST_RUN)]
Duration = Annotated[float, number(above=0, most=LONGEST_RUN)]
Frequencies = Annotated[list[Positive], Field(min_length=1, max_length=MOST_SINES)]


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**31:
        raise refusal(f"{value!r} must be a whole number >= 0")
    return value


Seed = Annotated[int, BeforeValidator(_whole)]


def _typed(value: object) -> str:
    """Value as the user would type it."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _as_typed(section: Section, key: str, omega: float) -> str:
    """Frequency `omega` [rad/s] as key, value and unit that the user gave."""
    return f"{key}: {omega:g} rad/s" if getattr(section, key) is not None else f"{key}_hz: {omega / (2 * math.pi):g} Hz"


class ReferenceSection(FrequencySection):
    """Base class of the sections of references."""

    base: Angle = 0.0

    def trajectory(self) -> Trajectory:
        """Trajectory of the reference [rad] over time [s]."""
        raise NotImplementedError

    def fastest_as_typed(self, fastest: float) -> str:
        """Highest frequency [rad/s] of an oscillating reference, as `key: value unit`."""
        raise NotImplementedError


class HoldSection(ReferenceSection):
    """Constant reference."""

    type: Literal["hold"]

    def trajectory(self) -> Trajectory:
        return Step(0.0, base=self.base)


class StepSection(ReferenceSection):
    """Step reference from `base` to `base` + `by`."""

    type: Literal["step"]
    by: Angle = Field(description="how far it goes [rad]")
    start: Instant = 0.0

    def trajectory(self) -> Trajectory:
        return Step(self.by, self.start, self.base)


class MoveSection(ReferenceSection):
    """Reference from `base` to `base` + `by` along a spline, from rest to rest."""

    type: Literal["cubic", "quintic"]
    by: Angle = Field(description="how far it goes [rad]")
    duration: Duration = Field(description="the duration of the move [s], a number > 0")
    start: Instant = 0.0

    def trajectory(self) -> Trajectory:
        return Spline.move(self.by, self.duration, self.start, 3 if self.type == "cubic" else 5, self.base)


class ChirpSection(ReferenceSection):
    """Sine reference whose frequency sweeps from `first` to `last`."""

    EITHER = ("first", "last")

    type: Literal["chirp"]
    amplitude: Size = Field(description="the amplitude [rad], a number >= 0")
    first: Positive | None = None
    first_hz: Positive | None = None
    last: Positive | None = None
    last_hz: Positive | None = None
    duration: Duration = Field(description="the duration of the sweep [s], a number > 0")
    start: Instant = 0.0

    def trajectory(self) -> Trajectory:
        return Chirp(self.amplitude, self.omega("first"), self.omega("last"), self.duration, start=self.start, base=self.base)

    def fastest_as_typed(self, fastest: float) -> str:
        return _as_typed(self, "last" if self.omega("last") == fastest else "first", fastest)


class MultisineSection(ReferenceSection):
    """Sum of sines for the whole run."""

    EITHER = ("frequencies",)

    type: Literal["multisine"]
    amplitude: Size = Field(description="the amplitude of each sine [rad], a number >= 0")
    frequencies: Frequencies | None = None
    frequencies_hz: Frequencies | None = None
    start: Instant = 0.0
    seed: Seed = 0

    def trajectory(self) -> Trajectory:
        frequencies = self.frequencies or [rad_per_s(None, value) for value in self.frequencies_hz or []]
        return Multisine(frequencies, self.amplitude, self.seed, start=self.start, base=self.base)

    def fastest_as_typed(self, fastest: float) -> str:
        return _as_typed(self, "frequencies", fastest)


REFERENCES = {
    "hold": HoldSection,
    "step": StepSection,
    "cubic": MoveSection,
    "quintic": MoveSection,
    "chirp": ChirpSection,
    "multisine": MultisineSection,
}
Reference = Annotated[Any, typed(REFERENCES, beside="those of that type")]


class DisturbanceSection(Section):
    """Torque on the link from outside, from a given time on."""

    torque: Torque = Field(description="the torque on the link [N·m]")
    start: Instant = 0.0


class FrictionSection(Section):
    """Friction of one side, on the joint side of the gearbox."""

    coulomb: NotNegative = 0.0
    static: NotNegative | None = None
    stribeck_velocity: Positive = 0.1
    viscous: NotNegative = 0.0
    bristle_stiffness: PositiveOrInfinite = math.inf
    bristle_damping: NotNegative = 0.0

    @relation
    def _physical(self) -> Refusals:
        try:
            self.friction()
        except GainroomError as error:
            yield from (refusal(text.removeprefix("friction: ")) for text in error.problems)

    def friction(self) -> Friction:
        """Friction parameters for the simulated testbed."""
        return Friction(**self.model_dump())


class FrictionsSection(Section):
    """Friction of both sides."""

    motor: FrictionSection | None = None
    link: FrictionSection | None = None


class ScenarioSection(Section):
    """Section `scenario` as a whole."""

    duration: Duration = 2.0
    reference: Reference = MoveSection(type="cubic", by=0.1, duration=0.5)
    feedforward: Annotated[str, Field(min_length=1, max_length=4096)] | None = Field(None, description="a log's target_torque")
    disturbance: DisturbanceSection | None = None
    noise: Annotated[float, number(least=0, most=1)] = 0.0
    torque_noise: NotNegative = 0.0
    seed: Seed = 0
    friction: FrictionsSection = FrictionsSection()
    gravity: Torque = 0.0
    hanging_at: Angle = 0.0
    torque_limit: PositiveOrInfinite = math.inf
    motor_resolution: Annotated[float, number(least=0, most=1)] = 0.0
    link_resolution: Annotated[float, number(least=0, most=1)] = 0.0
    jitter_ms: NotNegative = 0.0
    whole_ticks: Flag = False

    @relation
    def _reference_within_the_run(self) -> Refusals:
        yield from self._late("reference", getattr(self.reference, "start", 0.0))

    @relation
    def _disturbance_within_the_run(self) -> Refusals:
        yield from self._late("disturbance", self.disturbance.start if self.disturbance else 0.0)

    def _late(self, name: str, start: float) -> Refusals:
        if start >= self.duration:
            yield refusal(f"{start:g} s must be before the run ends: scenario.duration is {self.duration:g} s", key=f"{name}.start")

    def under(self, torque: Path) -> "ScenarioSection":
        """Scenario of the joint held at 0 under the torque in a file, for that file's duration."""
        others = self.model_dump(exclude_unset=True, exclude={"duration", "reference"})
        return ScenarioSection.model_validate(others | {"feedforward": str(torque.absolute())})

    def spec(self, joint: System, folder: Path = Path()) -> JointSimulation:
        """Simulation of the joint under this scenario, in SI; `folder`: of the file. Raises GainroomError if they contradict each other."""
        with Together() as together:
            in_time = together.step(lambda: self._refuse_late(joint))
            found = together.step(lambda: self._reference(joint))
            tick, name = joint.control.sample_time, self.feedforward
            torques = together.step(lambda: None if name is None or tick is None else _torque_of(folder / name, tick))
            self.require_right()
            in_time()
            reference, forward, duration, disturbance = found(), torques(), self.duration, self.disturbance
            torque = 0.0 if disturbance is None else Step(disturbance.torque, disturbance.start)
            if forward is not None and tick is not None:
                if "duration" not in self.model_fields_set:
                    duration = (len(forward) - 1) * tick
                if "reference" not in self.model_fields_set:
                    reference = Step(0.0)
            forward = 0.0 if forward is None else forward
            scenario = Scenario(reference, duration, feedforward=forward, link_torque=torque, noise=self.noise, seed=self.seed)
            scenario = replace(scenario, torque_noise=self.torque_noise)
            return JointSimulation.of(joint, scenario, self._hardware(), self._described(duration))

    def _refuse_late(self, joint: System) -> None:
        if 1e-3 * self.jitter_ms > joint.delay:
            raise GainroomError(f"scenario.jitter_ms: {self.jitter_ms:g} must be <= the drive's delay, {1e3 * joint.delay:g} ms")

    def _reference(self, joint: System) -> Trajectory:
        """Trajectory of the reference. Raises GainroomError if it is too fast for the joint's sample rate."""
        highest = math.inf if joint.control.sample_time is None else math.pi / joint.control.sample_time
        self.reference.require_right()
        reference = self.reference.trajectory()
        if reference.fastest >= highest:
            raise GainroomError(
                f"scenario.reference.{self.reference.fastest_as_typed(reference.fastest)} must be below half the sample rate, "
                f"{highest:.6g} rad/s ({highest / (2 * math.pi):g} Hz)"
            )
        return reference

    def _described(self, duration: float) -> dict[str, str]:
        """Texts of the reference, and of every key that is not at its default; `duration` [s] as given."""
        data = self.model_dump(exclude_defaults=True)
        held = self.feedforward is not None and "reference" not in self.model_fields_set
        reference = {"type": "hold"} if held else self.reference.model_dump(exclude_none=True)
        data = {"duration": duration, "reference": reference, **data}
        for side, friction in data.pop("friction", {}).items():
            data[f"friction.{side}"] = friction
        words = {name: value if isinstance(value, dict) else {"": value} for name, value in data.items()}
        return {name: ", ".join(_with_unit(name, key, value) for key, value in each.items()) for name, each in words.items()}

    def _hardware(self) -> dict[str, Any]:
        """Parameters of the hardware effects beyond the linear loop."""
        names = ("gravity", "torque_limit", "motor_resolution", "link_resolution", "whole_ticks")
        found = {name: getattr(self, name) for name in names if getattr(self, name) != type(self).model_fields[name].default}
        if self.gravity:
            found["hanging_at"] = self.hanging_at
        if self.jitter_ms:
            found["jitter"] = 1e-3 * self.jitter_ms
        for side in ("motor", "link"):
            section = getattr(self.friction, side)
            if section is not None:
                found[f"{side}_friction"] = section.friction()
        return found


UNITS = {
    **dict.fromkeys(("duration", "start"), "s"),
    **dict.fromkeys(("base", "by", "amplitude", "noise", "hanging_at", "motor_resolution", "link_resolution"), "rad"),
    **dict.fromkeys(("first", "last", "frequencies", "stribeck_velocity"), "rad/s"),
    **dict.fromkeys(("first_hz", "last_hz", "frequencies_hz"), "Hz"),
    **dict.fromkeys(("torque", "gravity", "torque_limit", "torque_noise", "coulomb", "static"), "N·m"),
    **dict.fromkeys(("viscous", "bristle_damping"), "N·m·s/rad"),
    "bristle_stiffness": "N·m/rad",
    "jitter_ms": "ms",
}
"""Units of the scenario's keys, as shown to users."""


def _with_unit(name: str, key: str, value: Any) -> str:
    """Text of key and value of the section `name`, with its unit; key "" for a section that is a single value."""
    return " ".join(filter(None, [key, _typed(value), UNITS.get(key or name, "")]))


def _torque_of(path: Path, tick: float) -> Floats:
    """Target torque of a log [N m], (k, 1), one row per tick of `tick` [s]. Raises GainroomError."""
    log = read_log(path).joint()
    if "target_torque" not in log.channels:
        raise GainroomError(f"{path}: has no target_torque, which scenario.feedforward needs")
    spans = np.diff(log.time)
    if len(spans) and float(np.abs(spans - tick).max()) > SAME_TICK * tick + 1e-9 * abs(float(log.time[-1])):
        raise GainroomError(
            f"{path}: its rows are {spans.min():.6g} to {spans.max():.6g} s apart; a feed-forward torque needs a row for every tick of the "
            f"controller, {tick:.6g} s (control.sample_rate_hz: {1 / tick:.6g})"
        )
    if len(log.time) * tick > LONGEST_RUN:
        raise GainroomError(f"{path}: lasts {len(log.time) * tick:g} s, and a run at most {LONGEST_RUN:g} s")
    return log.channels["target_torque"][:, None]
