"""Diagnosis of a vibrating joint from a recording: the result of `gainroom diagnose`."""

import math
from dataclasses import dataclass
from functools import cached_property

from ..design.joint_gains import Recommendation, recommend_pd
from ..identification.oscillation_search import Search, find_oscillation
from ..identification.outliers import Outliers, without_outliers
from ..identification.record import Record
from ..identification.recorded_oscillation import RecordedOscillation
from ..system.system import System
from .verdict import Finding, Verdict
from .vibration_causes import UNKNOWN, Cause, ranked_causes
from .vibration_prediction import SLOW_LOG, Prediction, predicted_vibration

NAMED = 0.6  # likelihood from which on a cause is named
AT_LIMIT = ("gain_limit", "aliasing")
"""Causes in which the loop is beyond its gain limit."""
MOVED = 0.35  # steps: less of true motion is an encoder between two steps
TOGGLES = 0.9  # steps: less in the readings alone may be that
STRONG = 0.1  # relative to half the torque's range: a larger swing is no small correction
HIDDEN = 1.2  # steps: more in the readings is true motion


@dataclass(frozen=True)
class Diagnosis:
    """Result of `gainroom diagnose`.

    record      examined record, without gaps and outliers
    outliers    rows of it that were left out
    search      oscillation search in it
    causes      most likely first; empty if nothing vibrates
    predicted   None without a joint.yaml
    toggles     True: the encoder alternates between two steps, and the joint hardly moves
    """

    record: Record
    outliers: Outliers
    system: System | None
    search: Search
    causes: tuple[Cause, ...] = ()
    predicted: Prediction | None = None
    toggles: bool = False
    missing: tuple[str, ...] = ()

    @property
    def oscillation(self) -> RecordedOscillation | None:
        """Oscillation found, even if it does not count as vibration."""
        return self.search.oscillation

    @property
    def vibrates(self) -> bool:
        """True if the oscillation grows, is sustained or rings for long, and is no encoder toggling."""
        return self.oscillation is not None and self.oscillation.vibrates and not self.toggles

    @property
    def ran_away(self) -> bool:
        """True if the joint left its set-point, farther and farther to the end of the record, oscillating or not."""
        return self.search.away is not None

    @property
    def verdict(self) -> Verdict:
        """Verdict unsafe if the joint vibrates or ran away in this record; it covers no other motion."""
        found = [Finding("ran_away", "unsafe")] if self.ran_away else []
        if self.vibrates and self.oscillation is not None:
            found.append(Finding("vibrates", "unsafe", {"frequency_rad_s": self.oscillation.vibration.frequency}))
        return Verdict.of(found)

    @property
    def cause(self) -> Cause | None:
        """Most likely cause; None if nothing vibrates, or no cause is likely enough."""
        first = self.causes[0] if self.causes else None
        return first if first is not None and first.name != UNKNOWN and first.likelihood >= NAMED else None

    @property
    def required(self) -> float:
        """Required gain margin as a factor: the file's, otherwise 2."""
        asked = None if self.system is None else self.system.requirements.gain_margin
        return 2.0 if asked is None else float(asked)

    @property
    def factor(self) -> float:
        """Factor on all gains that restores that margin, by the model; NaN: not known.

        A loop at its limit has no margin left, whatever the model says; if the torque limit sustains the vibration, the gains at the limit
        are those that the torque limit leaves.
        """
        if self.predicted is None or not 0 < self.predicted.limit.gain < math.inf:
            return math.nan
        limit = self.predicted.limit.gain
        if self.cause is not None and self.cause.name in AT_LIMIT:
            limit = min(limit, 1.0)
            if self.oscillation is not None and self.oscillation.state == "sustained" and self.predicted.left == self.predicted.left:
                limit = min(limit, self.predicted.left)
        return limit / self.required

    @cached_property
    def recommended(self) -> Recommendation | None:
        """Recommended gains, by the model alone; None without a model, or if no gains meet the requirements."""
        if self.system is None or self.predicted is None or not self.system.requirements.asked:
            return None
        control = self.system.control
        if not control.controller.has_plane:
            return None
        return recommend_pd(
            self.system.source,
            self.system.drives[0],
            self.system.requirements,
            self.system.uncertainty,
            control.feedback,
            self.predicted.loop.sample_time,
            control.controller,
            self.system.objective,
            self.system.bounds,
        )


def diagnose(record: Record, system: System | None = None) -> Diagnosis:
    """Diagnosis of `record`; `system`: of its joint.yaml, one joint, whose loop runs at its own rate, or otherwise at the log's.

    Raises GainroomError if the record holds neither position nor torque, and for a system whose gains measure both sides of the gearbox.
    """
    if system is not None:
        system.control.feedback.require_one("what a recording tells of the loop")
    record, outliers = without_outliers(record.longest_run(), commands=True)
    own = None if system is None else system.control.sample_time
    search = find_oscillation(record, every_tick=own is None or own > SLOW_LOG * record.sample_time)
    missing = tuple(
        name
        for name, there in (
            ("motor_position", record.has("motor_position") or record.has("link_position")),
            ("reference", record.has("reference")),
            ("actual_torque", any(record.has(name) for name in ("target_torque", "demand_torque", "actual_torque"))),
        )
        if not there
    )
    predicted = None if system is None else predicted_vibration(system, record, search.oscillation)
    oscillation = search.oscillation
    if oscillation is None or not oscillation.vibrates:
        return Diagnosis(record, outliers, system, search, (), predicted, missing=missing)
    toggles = _toggles(oscillation, predicted)
    causes = () if toggles else ranked_causes(oscillation, predicted)
    return Diagnosis(record, outliers, system, search, causes, predicted, toggles, missing)


def _toggles(oscillation: RecordedOscillation, predicted: Prediction | None) -> bool:
    """True if readings alternate between two steps while the joint moves less; with a model the motion follows from the torque.

    Without a model, a torque that oscillates regularly, and as strongly as anywhere in the record, counts as moving the joint.
    """
    if oscillation.steps >= HIDDEN or oscillation.step == 0:
        return False
    if predicted is None or math.isnan(predicted.moved):
        strong = not oscillation.irregular and oscillation.effort > STRONG
        return oscillation.steps < TOGGLES and not strong
    return predicted.moved < MOVED * oscillation.step
