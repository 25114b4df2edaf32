"""Simulation specification: a sampled system, its hardware effects, and the scenario."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.margin_record import Margins
from ..errors import GainroomError
from ..system.linear.state_space import split_delay
from ..system.loop import Loop
from ..system.plausibility import unusual_values
from ..system.system import System
from . import Friction, Scenario, Testbed
from .oscillation import rows_after
from .run import BLOCK, simulate, stream
from .run_record import LOGGED, STEADY_SHARE, Run
from .scenario import MOST_TICKS
from .trajectories import Held, Late, Trajectory

if TYPE_CHECKING:
    from ..robot.ground import Footing

NO_RATE = "control.sample_rate_hz is missing: the controller's rate [Hz], a number >= 1, as a simulation goes tick by tick"
LATE_SHARE = 0.75
"""Latest end of the reference's motion, as a share of the run: later leaves too little of it at rest."""
FEWEST_TICKS = 20
"""Fewest ticks of one run: one period of a vibration takes about ten."""
TORQUE_LIMIT = "the torque limit"
PORTION = 0.25
"""Longest simulated time between two updates of progress and interruption [s]."""


@dataclass(frozen=True, kw_only=True)
class SimulationSpec:
    """Data to simulate and judge one run, of a joint (JointSimulation) or a robot (robot_simulation.py). SI units.

    system           the whole file
    kind             "linear", "testbed" or "mujoco"
    duration, sample_time   [s]
    joint_names      (n,)
    signals          signals of LOGGED that a log of the run has
    moves_until      time at which the reference comes to rest [s]
    disturbed_from   start of a disturbance torque [s]; 0: none
    fastest          the highest frequency of an oscillating reference [rad/s]; 0 for a move
    noise, encoder_step   standard deviation and resolution of the measured position [rad]; 0: exact
    torque_limit     (n,) or one for all [N m]; inf: none
    is_linear        True: no effect that could bound a vibration's amplitude
    effects          names of the effects beside the linear loop, noise included: they may hide a vibration, or bound its amplitude
    link_decay       decay rate of a link behind an immobile motor, B/2J_L [1/s]
    contact_frames   (c,) names
    warnings         what a user should check before simulating
    """

    system: System
    kind: str
    duration: float
    sample_time: float
    joint_names: tuple[str, ...]
    signals: tuple[str, ...] = LOGGED
    moves_until: float
    disturbed_from: float = 0.0
    fastest: float = 0.0
    noise: float = 0.0
    encoder_step: float = 0.0
    torque_limit: ArrayLike = np.inf
    is_linear: bool
    effects: tuple[str, ...]
    link_decay: float = 0.0
    contact_frames: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def ticks(self) -> int:
        """Number of ticks of the whole run."""
        return round(self.duration / self.sample_time)

    @property
    def last_event(self) -> float:
        """Time of the last change of reference or disturbance [s]."""
        return max(self.moves_until, self.disturbed_from)

    @property
    def moves_late(self) -> bool:
        """True if too little of the run is left when the reference has come to rest."""
        return self.moves_until > LATE_SHARE * self.duration

    @property
    def never_rests(self) -> bool:
        """True if the reference still oscillates in the window of the steady-state error."""
        return self.fastest > 0 and self.moves_until > (1 - STEADY_SHARE) * self.duration

    @property
    def is_exact(self) -> bool:
        """True if stepping is exact, so that a run may be continued to judge it."""
        return self.kind != "mujoco"

    @property
    def immovable(self) -> tuple[str, ...]:
        """Names of channels that should move and cannot."""
        return ()

    @property
    def adds_viscous_friction(self) -> bool:
        """True if the scenario has viscous friction beside the joints' own."""
        return False

    @cached_property
    def footings(self) -> "tuple[Footing, ...]":
        """Ground under each foot; empty for fixed contacts and without feet."""
        return ()

    def stream(self, gain: float) -> Iterator[Run]:
        """Run with all gains times `gain`, part by part. Raises GainroomError where hardware and loop do not go together."""
        raise NotImplementedError

    @property
    def place(self) -> tuple[str, str]:
        """Names of posture and contact state; a joint's are ""."""
        return "", ""

    @property
    def state(self) -> str:
        """Posture and contact state as text; "" for a joint."""
        return "/".join(filter(None, self.place))

    def loop(self, gain: float = 1.0) -> Loop:
        """Sampled linear loop with all gains times `gain`, including the scenario's viscous friction."""
        raise NotImplementedError

    def seen_margins(self, gain: float) -> Margins | None:
        """Required margins of that loop, from the core in milliseconds; None: computing all of them takes no longer."""
        return None

    def at_rest(self, run: Run) -> slice:
        """Rows after the last change of reference or disturbance."""
        raise NotImplementedError

    def continued(self, gain: float, ticks: int, moving: bool) -> Run:
        """Run from its start, `ticks` longer; `moving`: the reference continues, otherwise it is held. Only if `is_exact`."""
        raise NotImplementedError


def refuse_odd_run(duration: float, sample_time: float, most: int) -> None:
    """Raise GainroomError if `duration` [s] is more than `most` ticks of `sample_time` [s], or fewer than FEWEST_TICKS."""
    ticks = round(duration / sample_time)
    if ticks < FEWEST_TICKS:
        raise GainroomError(
            f"scenario.duration: {duration:g} s is too short: "
            f"it must be at least {FEWEST_TICKS} ticks of {sample_time:g} s, {FEWEST_TICKS * sample_time:g} s"
        )
    if ticks > most:
        raise GainroomError(f"scenario.duration: {duration:g} s are {ticks} ticks of {sample_time:g} s, of which a run has at most {most}")


def _end_of(torque: Any, sample_time: float) -> float:
    """Time [s] from which on a Trajectory, or values tick by tick, are constant."""
    return torque.end if isinstance(torque, Trajectory) else (len(torque) - 1) * sample_time


@dataclass(frozen=True, kw_only=True)
class JointSimulation(SimulationSpec):
    """Joint with its hardware and a scenario.

    hardware    arguments of simulation.Testbed beside the loop; empty: the linear loop, stepped exactly
    described   the file's scenario as text, by key
    identified  identified Coulomb friction of motor and link [N m]; it is not simulated
    """

    scenario: Scenario
    hardware: Mapping[str, Any]
    described: Mapping[str, str]
    identified: tuple[float, float] | None = None

    @classmethod
    def of(cls, system: System, scenario: Scenario, hardware: Mapping[str, Any], described: Mapping[str, str]) -> "JointSimulation":
        """Simulation of `scenario` with Trajectories.

        Raises GainroomError for a continuous joint, and where the hardware does not fit the loop.
        """
        joint, feedback, sample_time = system.source, system.control.feedback, system.control.sample_time
        if sample_time is None:
            raise GainroomError(NO_RATE)
        refuse_odd_run(scenario.duration, sample_time, MOST_TICKS)
        frictions = [value for value in hardware.values() if isinstance(value, Friction)]
        noise, step = float(scenario.noise), max(float(hardware.get(f"{side}_resolution", 0.0)) for side in feedback.sides)
        linear = all(isinstance(value, Friction) and value.is_viscous for value in hardware.values())
        there = {
            "friction": not all(friction.is_viscous for friction in frictions),
            "noise": noise > 0 or (bool(feedback.torque) and scenario.torque_noise > 0),
            "encoder steps": step > 0,
            TORQUE_LIMIT: "torque_limit" in hardware,
            "gravity": "gravity" in hardware,
            "jitter": "jitter" in hardware,
            "the rounding of delays to whole ticks": "whole_ticks" in hardware,
        }
        spec = cls(
            kind="linear" if linear else "testbed",
            duration=scenario.duration,
            sample_time=sample_time,
            joint_names=joint.joint_names,
            moves_until=max(scenario.reference.end, _end_of(scenario.feedforward, sample_time)) + system.control.command_delay,
            disturbed_from=scenario.link_torque.end,
            fastest=scenario.reference.fastest,
            noise=noise,
            encoder_step=step,
            torque_limit=hardware.get("torque_limit", np.inf),
            is_linear=linear,
            effects=tuple(name for name, given in there.items() if given),
            link_decay=joint.damping / (2 * joint.link_inertia),
            warnings=unusual_values(system),
            system=system,
            scenario=scenario,
            hardware=hardware,
            described=described,
        )
        spec.simulated()
        return spec

    @property
    def coulomb(self) -> tuple[float, float] | None:
        """Coulomb friction of motor and link [N m], of the scenario, otherwise as identified; None if neither is known."""
        sides = [self.hardware.get(f"{side}_friction") for side in ("motor", "link")]
        if sides == [None, None]:
            return self.identified
        motor, link = (0.0 if side is None else side.coulomb for side in sides)
        return motor, link

    @property
    def scenario_effects(self) -> tuple[str, ...]:
        """Names of the scenario's additions to the file's linear loop: `effects`, and viscous friction too."""
        return tuple(dict.fromkeys([*(["friction"] if self.adds_viscous_friction else []), *self.effects]))

    @property
    def adds_viscous_friction(self) -> bool:
        return any(isinstance(value, Friction) and value.viscous > 0 for value in self.hardware.values())

    def loop(self, gain: float = 1.0) -> Loop:
        joint = self.system.source
        viscous = {
            f"{side}_viscous": getattr(joint, f"{side}_viscous") + self.hardware.get(f"{side}_friction", Friction()).viscous
            for side in ("motor", "link")
        }
        return self.system.with_values(**viscous).loop().scaled(gain)

    def simulated(self, gain: float = 1.0) -> Loop | Testbed:
        """Loop or testbed that is simulated. Raises GainroomError where loop and hardware do not go together."""
        if self.is_linear:
            return self.loop(gain)
        return Testbed(self.system.loop().scaled(gain), **self.hardware)  # which adds viscous friction itself

    def stream(self, gain: float) -> Iterator[Run]:
        block = max(1, min(BLOCK, round(PORTION / self.sample_time)))
        for part in stream(self.simulated(gain), self._arriving(self.scenario), block):
            yield self._as_asked(part, self.scenario)

    def _arriving(self, scenario: Scenario) -> Scenario:
        """`scenario` as it reaches the controller: set-points and their feedforward torque delayed by the command delay."""
        delay = self.system.control.command_delay
        if delay == 0:
            return scenario
        whole, fraction = split_delay(delay, self.sample_time)
        ticks = int(whole) + (1 if fraction > 0 else 0)  # a torque that arrives between two ticks is read at the second
        late = {}
        for name in ("reference", "feedforward"):
            given = getattr(scenario, name)
            shifted = Late(given, delay) if isinstance(given, Trajectory) else np.vstack([np.repeat(given[:1], ticks, axis=0), given])
            late[name] = shifted
        return replace(scenario, **late)

    def _as_asked(self, run: Run, scenario: Scenario) -> Run:
        """Run whose reference is the commanded one, before the command delay."""
        return run if self.system.control.command_delay == 0 else replace(run, reference=scenario.reference.position(run.time))

    def at_rest(self, run: Run) -> slice:
        """Rows after the last event; the last half if too little is left by then."""
        return rows_after(run, self.last_event)

    def continued(self, gain: float, ticks: int, moving: bool) -> Run:
        reference = self.scenario.reference if moving else Held(self.scenario.reference, self.duration)
        scenario = replace(self.scenario, reference=reference, duration=self.duration + ticks * self.sample_time)
        return self._as_asked(simulate(self.simulated(gain), self._arriving(scenario)), scenario)
