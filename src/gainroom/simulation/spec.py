"""What is simulated: a system on its controller's ticks, what hardware has around it, and what happens to it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError
from ..system.joint_spec import JointSpec
from ..system.loop import Loop
from . import Friction, Scenario, Testbed
from .oscillation import rows_after
from .record import LOGGED, STEADY_SHARE, Run
from .run import BLOCK, simulate, stream
from .scenario import MOST_TICKS
from .trajectories import Held

if TYPE_CHECKING:
    from ..robot.ground import Footing

NO_RATE = "control.sample_rate_hz: is missing: a simulation goes tick by tick; add the controller's rate [Hz]"
LATE_SHARE = 0.75
"""Of the run: what happens later leaves too little to look at."""
FEWEST_TICKS = 20
"""Of one run: in fewer a vibration cannot be seen, which takes ten ticks or so to turn once."""
TORQUE_LIMIT = "the torque limit"
PORTION = 0.25
"""[s] simulated between two looks at progress and interruption, where a block of ticks would be longer."""


@dataclass(frozen=True, kw_only=True)
class SimulationSpec:
    """What one run needs to be made and to be judged: of a joint here, of a robot in robot_simulation.py. SI units.

    kind             "linear", "testbed" or "mujoco"
    duration, sample_time   [s]
    joint_names      (n,)
    signals          those of LOGGED that a log of the run has
    moves_until      [s] when the reference comes to rest
    disturbed_from   [s] when a torque from outside sets in; 0 where there is none
    fastest          the highest frequency of a reference that swings [rad/s]; 0 of one that goes somewhere
    noise, encoder_step   [rad] standard deviation, and resolution, of what is fed back; 0: exact
    torque_limit     (n,) or one for all [N m]; inf: none
    is_linear        nothing is there that could hold a vibration at its size
    effects          names of what there is beside the linear loop, and of noise: they may hide a vibration, or hold one at its size
    link_decay       [1/s] how fast a link comes to rest behind a motor that stands, B/2J_L
    contact_frames   (c,) names
    warnings         what a user should look at before anything is simulated
    """

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
        """Of the whole run, about."""
        return round(self.duration / self.sample_time)

    @property
    def last_event(self) -> float:
        """[s] after which nothing changes from outside any more."""
        return max(self.moves_until, self.disturbed_from)

    @property
    def moves_late(self) -> bool:
        """Too little of the run is left to look at when the reference has come to rest."""
        return self.moves_until > LATE_SHARE * self.duration

    @property
    def swings_on(self) -> bool:
        """The reference still swings in what the steady state is averaged over: there is none."""
        return self.fastest > 0 and self.moves_until > (1 - STEADY_SHARE) * self.duration

    @property
    def is_exact(self) -> bool:
        """Stepped without an integrator's error, and quickly: judged to the last digit, also by simulating on."""
        return self.kind != "mujoco"

    @property
    def immovable(self) -> tuple[str, ...]:
        """Channels that are to move and that nothing can move here."""
        return ()

    @cached_property
    def footings(self) -> "tuple[Footing, ...]":
        """What feet stand on; empty where they are held, and without feet."""
        return ()

    def stream(self, gain: float) -> Iterator[Run]:
        """The run with all gains times `gain`, part by part. Raises GainroomError where hardware and loop do not go together."""
        raise NotImplementedError

    def loop(self, gain: float = 1.0) -> Loop:
        """The sampled linear loop with all gains times `gain`, the scenario's viscous friction part of it."""
        raise NotImplementedError

    def at_rest(self, run: Run) -> slice:
        """The rows in which nothing changes from outside any more."""
        raise NotImplementedError

    def continued(self, gain: float, ticks: int, moving: bool) -> Run:
        """The same from its start, and `ticks` further; `moving`: the reference goes on, else it is held. Where `is_exact`."""
        raise NotImplementedError


def refuse_odd_run(duration: float, sample_time: float, most: int) -> None:
    """Raise GainroomError where `duration` [s] is more than `most` ticks of `sample_time` [s], or too few to tell anything."""
    ticks = round(duration / sample_time)
    if ticks < FEWEST_TICKS:
        raise GainroomError(
            f"scenario.duration: {duration:g} s is too short to tell anything: "
            f"it must be at least {FEWEST_TICKS} ticks of {sample_time:g} s, {FEWEST_TICKS * sample_time:g} s"
        )
    if ticks > most:
        raise GainroomError(f"scenario.duration: {duration:g} s are {ticks} ticks of {sample_time:g} s, of which a run has at most {most}")


@dataclass(frozen=True, kw_only=True)
class JointSimulation(SimulationSpec):
    """A joint, its hardware and a scenario.

    hardware    arguments of simulation.Testbed beside the loop; empty: the linear loop, stepped exactly
    described   what the file says of the scenario, key by key, for a page
    """

    joint: JointSpec
    scenario: Scenario
    hardware: Mapping[str, Any]
    described: Mapping[str, str]

    @classmethod
    def of(cls, joint: JointSpec, scenario: Scenario, hardware: Mapping[str, Any], described: Mapping[str, str]) -> "JointSimulation":
        """`scenario` with Trajectories. Raises GainroomError for a continuous joint, and where the hardware does not fit the loop."""
        if joint.sample_time is None:
            raise GainroomError(NO_RATE)
        refuse_odd_run(scenario.duration, joint.sample_time, MOST_TICKS)
        frictions = [value for value in hardware.values() if isinstance(value, Friction)]
        noise, step = float(scenario.noise), float(hardware.get(f"{joint.feedback}_resolution", 0.0))
        linear = all(isinstance(value, Friction) and value.is_viscous for value in hardware.values())
        there = {
            "friction": not all(friction.is_viscous for friction in frictions),
            "noise": noise > 0,
            "encoder steps": step > 0,
            TORQUE_LIMIT: "torque_limit" in hardware,
            "gravity": "gravity" in hardware,
            "jitter": "jitter" in hardware,
            "the rounding of delays to whole ticks": "whole_ticks" in hardware,
        }
        spec = cls(
            kind="linear" if linear else "testbed",
            duration=scenario.duration,
            sample_time=joint.sample_time,
            joint_names=(joint.joint.name,),
            moves_until=scenario.reference.end,
            disturbed_from=scenario.link_torque.end,
            fastest=scenario.reference.fastest,
            noise=noise,
            encoder_step=step,
            torque_limit=hardware.get("torque_limit", np.inf),
            is_linear=linear,
            effects=tuple(name for name, given in there.items() if given),
            link_decay=joint.joint.damping / (2 * joint.joint.link_inertia),
            warnings=joint.unusual(),
            joint=joint,
            scenario=scenario,
            hardware=hardware,
            described=described,
        )
        spec.system()
        return spec

    def loop(self, gain: float = 1.0) -> Loop:
        joint = self.joint.joint
        viscous = {
            f"{side}_viscous": getattr(joint, f"{side}_viscous") + self.hardware.get(f"{side}_friction", Friction()).viscous
            for side in ("motor", "link")
        }
        return replace(self.joint, joint=replace(joint, **viscous)).loop().scaled(gain)

    def system(self, gain: float = 1.0) -> Loop | Testbed:
        """What is simulated. Raises GainroomError where loop and hardware do not go together."""
        if self.is_linear:
            return self.loop(gain)
        return Testbed(self.joint.loop().scaled(gain), **self.hardware)  # which adds viscous friction itself

    def stream(self, gain: float) -> Iterator[Run]:
        return stream(self.system(gain), self.scenario, max(1, min(BLOCK, round(PORTION / self.sample_time))))

    def at_rest(self, run: Run) -> slice:
        """Where too little is left by then, the last half."""
        return rows_after(run, self.last_event)

    def continued(self, gain: float, ticks: int, moving: bool) -> Run:
        reference = self.scenario.reference if moving else Held(self.scenario.reference, self.duration)
        return simulate(self.system(gain), replace(self.scenario, reference=reference, duration=self.duration + ticks * self.sample_time))
