"""One joint to be played: its loop, what hardware has around it, and what happens to it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .errors import GainroomError
from .loop import Loop
from .simulation import Scenario, Testbed
from .study import JointSpec

MOST_TICKS = 2_000_000
"""Of one run, which is kept whole."""


def refuse_long_run(duration: float, sample_time: float, most: int) -> None:
    """Raise GainroomError where `duration` [s] is more than `most` ticks of `sample_time` [s]."""
    ticks = round(duration / sample_time)
    if ticks > most:
        raise GainroomError(f"scenario.duration: {duration:g} s are {ticks} ticks of {sample_time:g} s, of which a run has at most {most}")


@dataclass(frozen=True)
class SimulationSpec:
    """A joint, its hardware and a scenario. SI units.

    hardware    arguments of simulation.Testbed beside the loop; empty: the linear loop, stepped exactly
    moves_until    [s] when the reference comes to rest
    own_frequency  [rad/s] about the highest in the reference itself
    swings         the reference is a chirp or a multisine, which goes nowhere
    described      what the file says of the scenario, key by key, for a page
    """

    joint: JointSpec
    scenario: Scenario
    hardware: Mapping[str, Any] = field(default_factory=dict)
    moves_until: float = 0.0
    own_frequency: float = 0.0
    swings: bool = False
    described: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.joint.sample_time is None:
            raise GainroomError("control.sample_rate_hz: is missing: a simulation goes tick by tick; add the controller's rate [Hz]")
        refuse_long_run(self.scenario.duration, self.sample_time, MOST_TICKS)
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
    def moves_late(self) -> bool:
        """Too little of the run is left to look at when the reference has come to rest."""
        return self.moves_until > 0.75 * self.scenario.duration

    @property
    def is_linear(self) -> bool:
        """Nothing but the linear loop: no friction, gravity, limit, encoder steps or jitter."""
        return not self.hardware

    def loop(self, gain: float = 1.0) -> Loop:
        """The sampled loop with all gains times `gain`."""
        return self.joint.loop().scaled(gain)

    def system(self, gain: float = 1.0) -> Loop | Testbed:
        """What is played. Raises GainroomError where loop and hardware do not go together."""
        loop = self.loop(gain)
        return loop if self.is_linear else Testbed(loop, **self.hardware)
