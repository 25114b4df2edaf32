"""One joint to be played: its loop, what hardware has around it, and what happens to it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import GainroomError
from ..system.joint_spec import JointSpec
from ..system.loop import Loop
from . import Friction, Scenario, Testbed
from .response import LAST
from .scenario import MOST_TICKS

NO_RATE = "control.sample_rate_hz: is missing: a simulation goes tick by tick; add the controller's rate [Hz]"
LATE = 0.75
"""Of the run: what happens later leaves too little to look at."""


FEWEST_TICKS = 20
"""Of one run: in fewer nothing can be told of a vibration, which takes ten ticks or so to turn once."""
PERIODS = 3
"""Of a vibration that a run must hold to show whether it lasts."""


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


@dataclass(frozen=True)
class SimulationSpec:
    """A joint, its hardware and a scenario. SI units.

    hardware    arguments of simulation.Testbed beside the loop; empty: the linear loop, stepped exactly
    moves_until    [s] when the reference comes to rest
    disturbed_from [s] when the torque from outside sets in; 0 where there is none
    own_frequency  [rad/s] about the highest in the reference itself
    swings         the reference is a chirp or a multisine, which goes nowhere
    described      what the file says of the scenario, key by key, for a page
    """

    joint: JointSpec
    scenario: Scenario
    hardware: Mapping[str, Any] = field(default_factory=dict)
    moves_until: float = 0.0
    disturbed_from: float = 0.0
    own_frequency: float = 0.0
    swings: bool = False
    described: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.joint.sample_time is None:
            raise GainroomError(NO_RATE)
        refuse_odd_run(self.scenario.duration, self.sample_time, MOST_TICKS)
        self.system()

    @property
    def sample_time(self) -> float:
        """T_s [s]."""
        assert self.joint.sample_time is not None
        return self.joint.sample_time

    @property
    def ticks(self) -> int:
        """Of the whole run, about."""
        return round(self.scenario.duration / self.sample_time)

    @property
    def last_event(self) -> float:
        """[s] after which nothing changes from outside any more."""
        return max(self.moves_until, self.disturbed_from)

    @property
    def moves_late(self) -> bool:
        """Too little of the run is left to look at when the reference has come to rest."""
        return self.moves_until > LATE * self.scenario.duration

    @property
    def swings_on(self) -> bool:
        """The reference still swings in what the steady state is averaged over: there is none."""
        return self.swings and self.moves_until > (1 - LAST) * self.scenario.duration

    @property
    def is_linear(self) -> bool:
        """Nothing but the linear loop: viscous friction at most, no other friction, gravity, limit, encoder steps or jitter."""
        return all(isinstance(value, Friction) and value.is_viscous for value in self.hardware.values())

    @property
    def rubs(self) -> bool:
        """There is friction that is not linear."""
        return any(isinstance(value, Friction) and not value.is_viscous for value in self.hardware.values())

    @property
    def encoder_step(self) -> float:
        """Of the side that is fed back [rad]; 0: exact."""
        return float(self.hardware.get(f"{self.joint.feedback}_resolution", 0.0))

    def loop(self, gain: float = 1.0) -> Loop:
        """The sampled loop with all gains times `gain`, the scenario's viscous friction part of the joint."""
        joint = self.joint.joint
        rubbing = {
            f"{side}_viscous": getattr(joint, f"{side}_viscous") + self.hardware.get(f"{side}_friction", Friction()).viscous
            for side in ("motor", "link")
        }
        return replace(self.joint, joint=replace(joint, **rubbing)).loop().scaled(gain)

    def system(self, gain: float = 1.0) -> Loop | Testbed:
        """What is played. Raises GainroomError where loop and hardware do not go together."""
        if self.is_linear:
            return self.loop(gain)
        return Testbed(self.joint.loop().scaled(gain), **self.hardware)  # which adds viscous friction itself
