"""What is known of a robot's played scenario: the run, how well it tracks, what vibrates, and what the linear loop predicts."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..analysis.gain_limit import GainLimit
from ..linear.arrays import Complexes, Floats
from ..robot.ground import Footing, footings
from ..robot.spec import RobotSpec
from ..simulation.oscillation import Vibration
from ..simulation.response import Tracking
from ..simulation.robot_result import RobotRun
from ..simulation.robot_setup import Unit, channel_units
from .robot_record import STRONG, strongest_first
from .robot_vibration import Heard, shows

CHATTER = 0.1
"""Of a joint's torque peak: torque beyond the reference's frequencies that is told, RMS."""


@dataclass(frozen=True)
class RobotPlay:
    """What `gainroom simulate` tells of a robot.

    gain          factor on all gains
    moved_until   [s] when the reference comes to rest; 0 where it never moves
    tracking      by channel [m, rad]; of a run that ended early only `rms` and `peak`, the others are NaN
    torque_peak, torque_rms   (n,) of the actual torque [N m]
    slip          (c,) furthest that each contact frame was from where it started, looked at some thousand times [m]
    heard         the vibration that lasts, after the move or while it moves, else the one that dies away; None where nothing rings
    chatter       (n,) RMS of the actual torque beyond the reference's frequencies [N m]
    stuck         names of the channels that are told to move, and that nothing can move in this state
    limit         what the linear sampled loop predicts, as a factor on the gains played; None where the gains move nothing
    sentence, warnings   in words
    """

    spec: RobotSpec
    gain: float
    moved_until: float
    run: RobotRun
    tracking: Tracking
    torque_peak: Floats
    torque_rms: Floats
    slip: Floats
    heard: Heard | None
    chatter: Floats
    stuck: tuple[str, ...]
    limit: GainLimit | None
    sentence: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def completed(self) -> bool:
        """It lasted to its end."""
        return self.run.ending == "completed"

    @property
    def lasted(self) -> float:
        """[s] that were played."""
        return len(self.run.time) * self.run.setup.sample_time

    @property
    def moving(self) -> bool:
        """Whether anything is told to move."""
        return self.moved_until > 0

    @property
    def linear(self) -> bool:
        """Nothing rubs, limits or lets go that could hold a vibration at its size."""
        setup = self.run.setup
        return not (np.any(setup.coulomb) or np.any(np.isfinite(setup.torque_limit)) or setup.encoder_step or setup.ground is not None)

    @property
    def vibration(self) -> Vibration | None:
        """What was heard, also what dies away or is too small to count."""
        return None if self.heard is None else self.heard.found

    @property
    def parts(self) -> Complexes | None:
        """(n,) complex: the motors' parts in that vibration, the largest 1; None without one."""
        return None if self.heard is None else self.heard.parts

    @property
    def vibrates(self) -> bool:
        """So that anyone would see it, by more than encoders' steps make, and not dying away."""
        return self.heard is not None and shows(self.heard, self.run.setup.encoder_step, self.linear)

    @property
    def stable(self) -> bool:
        """What the linear loop says at these gains; True where they move nothing."""
        return self.limit is None or self.limit.stable

    @property
    def sound(self) -> bool:
        """It stayed up, does not vibrate, and the linear loop is stable."""
        return self.completed and not self.vibrates and self.stable

    @cached_property
    def chattering(self) -> int | None:
        """The joint whose torque shakes most, where that is much of it."""
        worst = int(np.argmax(self.chatter))
        return worst if self.completed and self.chatter[worst] > CHATTER * self.torque_peak[worst] else None

    @property
    def hiding(self) -> tuple[str, ...]:
        """What the file has that can keep an unstable loop from vibrating."""
        setup = self.run.setup
        found = {
            "friction": np.any(setup.coulomb),
            "the torque limit": np.any(np.isfinite(setup.torque_limit)),
            "encoder steps": setup.encoder_step > 0,
        }
        return tuple(name for name, there in found.items() if there)

    @cached_property
    def units(self) -> tuple[Unit, ...]:
        """(m,) "m" or "rad", of each channel."""
        return channel_units(self.run.setup)

    @cached_property
    def torque_units(self) -> tuple[str, ...]:
        """(n,) of each joint's torque, which of one that slides is a force."""
        return tuple("N" if slides else "N·m" for slides in self.run.setup.body.slides.tolist())

    @cached_property
    def leading(self) -> tuple[int, ...]:
        """The channels that tell how well it tracks, the one that is furthest off first, all in one unit: those that are moved, if any."""
        reference = self.run.reference
        moved = np.flatnonzero((reference != reference[:1]).any(axis=0))
        among = moved.tolist() if len(moved) else list(range(len(self.units)))
        return tuple(sorted((k for k in among if self.units[k] == self.units[among[0]]), key=lambda k: -self.tracking.peak[k]))

    @property
    def left_most(self) -> int:
        """Of those, the one whose steady-state error is the largest; the first where there is no steady state."""
        return max(self.leading, key=lambda k: np.nan_to_num(abs(self.tracking.steady_state[k])))

    @cached_property
    def others(self) -> tuple[int, ...]:
        """All other channels, the one that is furthest off first, whatever its unit."""
        return tuple(sorted(set(range(len(self.units))) - set(self.leading), key=lambda k: -self.tracking.peak[k]))

    @cached_property
    def footings(self) -> tuple[Footing, ...]:
        """What the feet stand on; empty where they are held."""
        setup = self.run.setup
        return footings(setup.body, setup.q, setup.contacts) if setup.ground is not None and setup.gravity else ()

    def parts_strongest_first(self) -> list[int]:
        """The joints that take part in the vibration, the strongest first."""
        if self.parts is None:
            return []
        return [k for k in strongest_first(self.parts).tolist() if abs(self.parts[k]) >= STRONG]
