"""Simulation of a scenario and its judgement: tracking, vibration, divergence or fall, and the linear loop's prediction."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..analysis.margin_record import GainLimit, Margins
from ..design.joint_gains import rounded_down
from ..errors import GainroomError
from ..simulation.oscillation import Vibration
from ..simulation.run_record import Run, joined
from ..simulation.simulation_spec import TORQUE_LIMIT, SimulationSpec
from ..simulation.tracking import Tracking, track
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS
from .analysis import Analysis, analyzed
from .joint import study_joint
from .loop_numbers import margins_of
from .oscillation import Oscillation, oscillation_in, torque_ripple_of
from .progress import Progress, quiet
from .state import state_of
from .verdict import Finding, Verdict

RIPPLE = 0.1
"""Least torque ripple reported, RMS above the reference's frequencies relative to the joint's torque peak."""
MOST_SLIP_LOOKS = 2000
"""Most ticks at which the slip of the feet is computed, which takes longer than simulating them."""

USUAL = REQUIREMENTS["gain_margin"].usual or 2.0
"""Default gain margin of suggested gains, if the file requires none."""
LOWER = (1.0, 0.9, 0.7, 0.5, 0.3, 0.1, 0.03)
"""Shares of the gains with the gain margin, at which gains that meet the other requirements are searched."""
PLAINLY = 1e-2
"""Shortfall (log ratio of a gain or sensitivity, or share of a phase) that sampled margins establish: ten times the error of a sampled
peak."""


class Interrupted(Exception):  # noqa: N818 - asked for, not an error
    """Run interrupted on request; `time` [s] is the simulated time, which the log contains."""

    def __init__(self, time: float) -> None:
        super().__init__(f"interrupted at {time:g} s")
        self.time = time


@dataclass(frozen=True)
class Outcome:
    """Result of `gainroom simulate`, for one joint or a robot.

    gain            factor on all gains
    run             tick by tick
    tracking        by channel, overshoot and settling of links where channels are joints; for a run that ended early only `rms` and
                    `peak`, the others are NaN
    torque_peak, torque_rms   (n,) of the actual torque [N m]
    at_torque_limit (n,) fraction of the ticks at which the demand torque is cut
    slip            (c,) largest displacement of each contact frame from its start [m]; (0,) without contacts
    oscillation     a sustained or growing vibration, otherwise a decaying one; None if there is none
    noise_motion    motion of a joint due to noise and encoder steps where no vibration is sustained, RMS [rad]
    torque_ripple   (n,) RMS of the actual torque above the reference's frequencies [N m]; zeros where the reference is not smooth
    margins         of the linear sampled loop at the gains of the run, the scenario's viscous friction included, at nominal values; None
                    if the gains act on no motion
    """

    spec: SimulationSpec
    gain: float
    run: Run
    tracking: Tracking
    torque_peak: Floats
    torque_rms: Floats
    at_torque_limit: Floats
    slip: Floats
    oscillation: Oscillation | None
    noise_motion: float
    torque_ripple: Floats
    margins: Margins | None

    @property
    def limit(self) -> GainLimit | None:
        """Limit of the common factor on the gains of the run; None if they act on no motion."""
        return None if self.margins is None else self.margins.limit

    @property
    def missed(self) -> tuple[str, ...]:
        """Names of the file's requirements that the linear loop misses at nominal values, largest shortfall first.

        All of them for an unstable loop; a value that is not known does not count as missed.
        """
        asked, found = self.spec.system.requirements, self.margins
        if found is None:
            return ()
        values = {one.name: one.value(found) for one, _ in asked.asked_for}
        missed = [name for name, value in values.items() if not found.stable or (not math.isnan(value) and not asked.met(name, value))]
        short = asked.shortfalls(found)
        return tuple(sorted(missed, key=lambda name: -short[name]))

    def met(self, name: str) -> bool | None:
        """True if a requirement is met; None if it is not required or not known, or the file has ranges, of which a run is one case."""
        if name in self.missed:
            return False
        if self.margins is None or self.spec.system.uncertainty.names:
            return None
        return self.spec.system.requirements.met(name, REQUIREMENTS[name].value(self.margins)) or None

    @cached_property
    def gain_to_try(self) -> float:
        """Factor on the file's gains, rounded down, at which the linear loop has every required margin; NaN: none is known."""
        limit, asked = self.limit, self.spec.system.requirements
        if limit is None or not 0 < limit.gain < math.inf:
            return math.nan
        margin = asked.needed.get("gain_margin", USUAL)
        highest, lowest = self.gain * limit.gain / margin, self.gain * limit.lower_gain * margin
        tried = (rounded_down(share * highest) for share in LOWER if share * highest > lowest)
        others = [name for name in asked.asked if name != "gain_margin"]
        return next((gain for gain in tried if not others or self._meets_all(gain)), math.nan)

    def _meets_all(self, gain: float) -> bool:
        """True if the linear loop with this factor on the file's gains meets the requirements; a plain miss is decided by samples alone."""
        asked, seen = self.spec.system.requirements, self.spec.seen_margins(gain)
        if seen is not None and seen.stable and PLAINLY < asked.shortfall(seen) < math.inf:
            return False
        return asked.met_by(margins_of(self.spec.loop(gain)))

    @property
    def completed(self) -> bool:
        """True if the run reached its end."""
        return self.run.ending == "completed"

    @property
    def duration(self) -> float:
        """Simulated time [s]."""
        return len(self.run.time) * self.run.sample_time

    @property
    def vibration(self) -> Vibration | None:
        """Vibration found, even if it decays or is too small to count."""
        return None if self.oscillation is None else self.oscillation.vibration

    @property
    def vibrates(self) -> bool:
        """True if a vibration grows, or does not decay."""
        return self.oscillation is not None and self.oscillation.lasts

    @property
    def stable(self) -> bool:
        """True if the linear loop is stable at these gains, or they act on no motion."""
        return self.limit is None or self.limit.stable

    @property
    def hidden(self) -> bool:
        """True if the linear loop is unstable but no sustained oscillation is detected."""
        return self.completed and not self.vibrates and not self.stable

    @property
    def sound(self) -> bool:
        """True if the run reached its end without vibration, and the linear loop is stable."""
        return self.completed and not self.vibrates and self.stable

    @cached_property
    def judged(self) -> Analysis | None:
        """Analysis of the file's loop with the gains of the run; None if they act on no motion."""
        system = self.spec.system if self.gain == 1 else self.spec.system.scaled(self.gain)
        if self.margins is None:
            return None
        if system.source.body is None and system.control.kd_path is None:
            return study_joint(system)
        return analyzed(system, [state_of(system, *self.spec.place)])

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict on the file's loop, even if friction and torque limits hide a vibration.

        A run that ends early or vibrates makes it unsafe.
        """
        found = [] if self.judged is None else [*self.judged.verdict.findings]
        if not self.completed:
            found.append(Finding(self.run.ending, "unsafe", {"time_s": self.duration}))
        if self.oscillation is not None and self.oscillation.lasts:
            values = {"frequency_rad_s": self.oscillation.vibration.frequency}
            found.append(Finding("vibrates", "unsafe", values, self.spec.state, self.oscillation.strongest[:1]))
        return Verdict.of(found)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects beside the linear loop that were active in this run."""
        return tuple(name for name in self.spec.effects if name != TORQUE_LIMIT or self.at_torque_limit.any())

    @cached_property
    def rippling(self) -> int | None:
        """Index of the joint with the largest torque ripple; None if it is small."""
        worst = int(np.argmax(self.torque_ripple))
        return worst if self.completed and self.torque_ripple[worst] > RIPPLE * self.torque_peak[worst] else None

    @cached_property
    def leading(self) -> tuple[int, ...]:
        """Indices of the channels by which tracking is judged, largest error first, all in one unit: moving ones, if any."""
        units, reference = self.run.units, self.run.reference
        moved = np.flatnonzero((reference != reference[:1]).any(axis=0))
        among = moved.tolist() if len(moved) else list(range(len(units)))
        return tuple(sorted((k for k in among if units[k] == units[among[0]]), key=lambda k: -self.tracking.peak[k]))

    @property
    def worst_at_end(self) -> int:
        """Index of the leading channel with the largest steady-state error; the first if there is no steady state."""
        return max(self.leading, key=lambda k: np.nan_to_num(abs(self.tracking.steady_state[k])))

    @cached_property
    def others(self) -> tuple[int, ...]:
        """Indices of all other channels, largest error first, in any unit."""
        return tuple(sorted(set(range(len(self.run.units))) - set(self.leading), key=lambda k: -self.tracking.peak[k]))


def simulate_study(
    spec: SimulationSpec,
    gain: float = 1.0,
    rows: Callable[[Run], None] = lambda part: None,
    progress: Progress = quiet,
    interrupted: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Simulation of the scenario with all gains times `gain`, and its judgement.

    rows          called with every part of the run as it is computed, for a log
    progress      called with ticks done, ticks in all, ""
    interrupted   called between parts; True stops the run

    Raises Interrupted, and GainroomError where the hardware does not fit the loop, or MuJoCo is missing or cannot simulate the robot.
    """
    parts, done = [], 0
    for part in spec.stream(gain):
        rows(part)
        parts.append(part)
        done += len(part.time)
        progress(done, max(done, spec.ticks), "")
        if interrupted():
            raise Interrupted(done * spec.sample_time)
    run = joined(parts)
    if not len(run.time):
        raise GainroomError("the first torques are not finite: the gains are too large to compute with")
    loop = spec.loop(gain)
    margins = margins_of(loop) if loop.acts else None
    oscillation, noise_motion = oscillation_in(spec, gain, run, None if margins is None else margins.limit)
    torque, nothing = run.actual_torque, np.zeros(len(run.joint_names))
    return Outcome(
        spec,
        gain,
        run,
        _tracking(spec, run),
        np.abs(torque).max(axis=0),
        np.sqrt(np.mean(torque**2, axis=0)),
        np.mean(np.abs(run.demand_torque) >= spec.torque_limit, axis=0),
        run.rows(slice(None, None, max(1, len(run.time) // MOST_SLIP_LOOKS))).slip.max(axis=0),
        oscillation,
        noise_motion,
        nothing if spec.is_exact else torque_ripple_of(run, spec.moves_until),
        margins,
    )


def _tracking(spec: SimulationSpec, run: Run) -> Tracking:
    """Tracking performance of a run: of a move up to a later disturbance; an oscillating reference is no move."""
    found, nothing = (
        track(run, spec.disturbed_from if spec.disturbed_from > spec.moves_until else np.inf, run.links),
        np.full(len(run.channels), np.nan),
    )
    if spec.fastest > 0 or run.ending != "completed":
        found = replace(found, overshoot=nothing, settling_time=nothing)
    return replace(found, steady_state=nothing) if spec.never_rests or run.ending != "completed" else found
