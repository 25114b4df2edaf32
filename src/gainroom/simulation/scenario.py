"""Scenario of a simulation: initial state, reference and disturbances of a loop, evaluated tick by tick."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import GainroomError, require_count, require_finite, require_positive
from ..system.feedback import Feedback, Side
from ..system.linear.arrays import Floats
from ..system.linear.state_space import split_delay
from ..system.loop import Loop
from .trajectories import Step, Trajectory

MOST_TICKS = 2_000_000
"""Most ticks of a run held in memory, over all joints together: about 150 MB."""
MOST_STREAMED_TICKS = 1e12
"""Most ticks of any run, years at 1 kHz: tick numbers stay exact in a double."""
DIVERGED = 1e4  # [rad] further than any joint turns, and far from where a double overflows


@dataclass(frozen=True)
class Start:
    """State at t = 0: positions [rad] and velocities [rad/s] of both sides, each a number or (n,).

    None: positions equal the reference before t = 0, velocities are 0. Until t = 0 everything rests there; current loops and delay lines
    hold no torque, integrators are empty. A velocity given here acts like an impact.
    """

    motor_position: Any = None
    link_position: Any = None
    motor_velocity: Any = None
    link_velocity: Any = None


@dataclass(frozen=True)
class Scenario:
    """Scenario of one run.

    reference           x_d [rad]: a Trajectory, a number, or (k, n) values, one row per tick (held before the first, after the last)
    duration            [s]; `simulate` takes at most MOST_TICKS ticks over all joints, `stream` yields any number in parts
    reference_velocity  True: velocity gains act on the velocity error, D (x_d − x) as in eq. (4) of Jung et al. 2017; False: on the
                        measured velocity only; None: False for the P/PI cascade, as its Fig. 13, True for every other controller
    feedforward         torque added to the target torque [N m]; eq. (4)'s d
    motor_torque, link_torque   external torques on either side of the gearbox, held from tick to tick [N m]
    noise               standard deviation of the measured position [rad], a number or (n,)
    torque_noise        standard deviation of the measured torque of a spring [N m]
    seed                of the noise
    start               initial state, see Start
    limit               joint position [rad] beyond which the run has diverged and ends

    Torques as reference: a Trajectory, a number, or (k, n) values.
    """

    reference: Any
    duration: float
    reference_velocity: bool | None = None
    feedforward: Any = 0.0
    motor_torque: Any = 0.0
    link_torque: Any = 0.0
    noise: Any = 0.0
    torque_noise: float = 0.0
    seed: int = 0
    start: Start = field(default_factory=Start)
    limit: float = DIVERGED

    def __post_init__(self) -> None:
        require_positive("scenario", "duration", self.duration, "s")
        require_positive("scenario", "limit", self.limit, "rad", infinite=True)
        require_count("scenario", "seed", self.seed, 0)
        if np.any(require_finite("scenario", "noise", self.noise) < 0):
            raise GainroomError(f"scenario: noise {self.noise!r} must be >= 0 rad")
        require_positive("scenario", "torque_noise", self.torque_noise, "N·m", zero=True)
        for name in ("reference", "feedforward", "motor_torque", "link_torque"):
            value = getattr(self, name)
            if isinstance(value, Trajectory):
                continue
            value = require_finite("scenario", name, value)
            if value.ndim > 2 or value.size == 0:
                raise GainroomError(f"scenario: {name} of shape {value.shape} must be a Trajectory, a number, or (ticks, n) values")
            object.__setattr__(self, name, Step(0.0, base=value) if value.ndim == 0 else value.reshape(len(value), -1))


@dataclass(frozen=True)
class Inputs:
    """Inputs of the loop at k successive ticks, each (k, n).

    reference   compared with the measured position by position gains [rad]
    motion      compared with the measured position by the controller's differences [rad]
    feedforward, motor_torque, link_torque   [N m]
    noise       (k, n) added to the measured position [rad]; where gains of one joint measure both sides (k, 2), of position and velocity
    torque_noise    (k,) added to the measured torque of one joint's spring [N m]
    """

    reference: Floats
    motion: Floats
    feedforward: Floats
    motor_torque: Floats
    link_torque: Floats
    noise: Floats
    torque_noise: Floats


def noise_by_side(noise: Floats, feedback: Feedback) -> dict[Side, Floats]:
    """Noise (k, n) of each encoder that gains measure, from `noise` of Inputs."""
    size = noise.shape[1] // len(feedback.sides)
    return {feedback.position: noise[:, :size], feedback.velocity: noise[:, -size:]}


class ScenarioInputs:
    """Inputs of a scenario in the order of time, block after block."""

    def __init__(self, scenario: Scenario, loop: Loop) -> None:
        assert loop.parts is not None
        assert loop.sample_time is not None
        self.scenario, self.size, self.sample_time = scenario, loop.size, loop.sample_time
        self._form = loop.parts.plant.mechanism()
        if scenario.duration / self.sample_time > MOST_STREAMED_TICKS:
            raise GainroomError(
                f"scenario: duration {scenario.duration:g} s must be at most {MOST_STREAMED_TICKS:g} ticks of {self.sample_time:g} s, "
                f"{MOST_STREAMED_TICKS * self.sample_time:g} s"
            )
        whole, fraction = split_delay(scenario.duration, self.sample_time)
        self.ticks = int(whole) + (1 if fraction > 0 else 0)
        self.before = self._at(scenario.reference, "reference", -1, 1)[0]
        follows = scenario.reference_velocity
        self._follows = loop.parts.controller.rate_of_error if follows is None else follows
        self._random = np.random.default_rng([scenario.seed, 0])
        self._noise = self._per_joint("noise", scenario.noise)
        self._encoders = len(loop.parts.feedback.sides)
        self._torque_noise = scenario.torque_noise if loop.parts.feedback.torque else 0.0
        self._torque_random = np.random.default_rng([scenario.seed, 2])

    def start(self) -> Floats:
        """Initial coordinates η of the plant, then their rates (plant.mechanism).

        Raises GainroomError if motors and links cannot have these positions or velocities together (a rigid joint; links in a closed
        chain).
        """
        given, states = self.scenario.start, []
        sides = np.vstack([self._form.motor_position, self._form.link_position])
        for name, usual in (("position", self.before), ("velocity", 0.0)):
            values = []
            for side in ("motor", "link"):
                value = getattr(given, f"{side}_{name}")
                values.append(self._per_joint(f"start.{side}_{name}", usual if value is None else value))
            both = np.concatenate(values)
            coordinates = np.linalg.lstsq(sides, both, rcond=None)[0]
            if not np.allclose(sides @ coordinates, both, rtol=0, atol=1e-9 * max(1.0, np.abs(both).max())):
                raise GainroomError(f"scenario: start.motor_{name} and start.link_{name} are not possible together for this plant")
            states.append(coordinates)
        return np.concatenate(states)

    def block(self, first: int, count: int) -> Inputs:
        """Inputs of ticks `first` to `first` + `count`; blocks must follow one another, since noise is drawn in sequence."""
        scenario = self.scenario
        reference = self._at(scenario.reference, "reference", first, count)
        torques = {name: self._at(getattr(scenario, name), name, first, count) for name in ("feedforward", "motor_torque", "link_torque")}
        noise = np.zeros((count, self.size * self._encoders))
        if self._noise.any():
            noise = np.tile(self._noise, self._encoders) * self._random.standard_normal(noise.shape)
        # Differences of a constant are zero: taking the past off leaves the velocity, and filters that start empty are at rest.
        motion = reference - self.before if self._follows else np.zeros_like(reference)
        torque_noise = np.zeros(count)
        if self._torque_noise:
            torque_noise = self._torque_noise * self._torque_random.standard_normal(count)
        return Inputs(reference, motion, noise=noise, torque_noise=torque_noise, **torques)

    def _at(self, signal: Any, name: str, first: int, count: int) -> Floats:
        if isinstance(signal, Step) and not signal.height.any():
            values = signal.base[None]  # most disturbances are none
        elif isinstance(signal, Trajectory):
            values = signal.position((first + np.arange(count)) * self.sample_time)
        else:
            values = signal[np.clip(first + np.arange(count), 0, len(signal) - 1)]
        if values.shape[1] not in (1, self.size):
            raise GainroomError(f"scenario: {name} for {values.shape[1]} joints does not fit a loop of {self.size}")
        return np.broadcast_to(values, (count, self.size))

    def _per_joint(self, name: str, value: Any) -> Floats:
        value = require_finite("scenario", name, value)
        if value.shape not in ((), (1,), (self.size,)):
            raise GainroomError(f"scenario: {name} of shape {value.shape} must be a number or {self.size} numbers")
        return np.broadcast_to(value, (self.size,)).astype(float)
