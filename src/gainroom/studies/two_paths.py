"""A joint or robot whose kd closes on a path of its own: every state, nominal, at every corner of the uncertainty and at places between.

Gain maps, largest gains, recommended ones and curves over frequency are of loops with one path, and are not made for these.
"""

import math
from dataclasses import dataclass
from functools import cached_property

from ..analysis.margin_record import GainLimit, Margins
from ..errors import GainroomError, computable
from ..system.requirements import REQUIREMENTS
from ..system.system import System
from .analysis import KEYS, read_as, unstable
from .deciding_joints import deciding_joints_in
from .progress import Progress, quiet
from .state import State, path_headroom
from .verdict import Finding, Verdict, judged, missed


@dataclass(frozen=True)
class PathCase:
    """One state at one place in the uncertainty.

    state        in its posture and contact state
    title        those; "" of a joint
    place        as text; "" for the nominal case
    delay_limit  [s] of the other gains' path, kd's as it is; NaN where it is not known, 0 where no delay there is short enough
    """

    state: State
    title: str
    place: str
    margins: Margins
    delay_limit: float

    @property
    def limit(self) -> GainLimit:
        """Of the common factor on all gains."""
        return self.margins.limit

    @property
    def text(self) -> str:
        """For messages; "" for the nominal case of a joint."""
        return ", ".join(filter(None, (self.title, self.place)))


@dataclass(frozen=True)
class PathStudy:
    """All cases, of each state the nominal one first."""

    system: System
    cases: tuple[PathCase, ...]

    @property
    def nominal(self) -> tuple[PathCase, ...]:
        """One per state."""
        return tuple(case for case in self.cases if not case.place)

    @cached_property
    def tightest(self) -> PathCase:
        """The nominal case with the least headroom."""
        return min(self.nominal, key=lambda case: path_headroom(case.margins))

    @property
    def stable(self) -> bool:
        """At the nominal values."""
        return all(case.limit.stable for case in self.nominal)

    @property
    def unstable_at(self) -> str:
        """The first case that is unstable, as text, where the nominal values are not; "" where there is none."""
        return next((case.text for case in self.cases if not case.limit.stable), "") if self.stable else ""

    @property
    def stable_in_range(self) -> bool:
        """In every case; between them it is not proved."""
        return self.stable and not self.unstable_at

    @cached_property
    def worst(self) -> dict[str, tuple[float, PathCase]]:
        """By requirement, the least of what it bounds, and where; NaN, of the first case, where that is not known."""

        def least(name: str) -> tuple[float, PathCase]:
            one = REQUIREMENTS[name]
            found = [(one.value(case.margins), case) for case in self.cases]
            unknown = next((pair for pair in found if math.isnan(pair[0])), None)
            return unknown or (max if one.at_most else min)(found, key=lambda pair: pair[0])

        return {name: least(name) for name in REQUIREMENTS}

    def met(self, name: str) -> bool | None:
        """Whether a requirement is met in every case; None where it is not asked for, or not known."""
        value = self.worst[name][0]
        return None if math.isnan(value) or not self.stable_in_range else self.system.requirements.met(name, value)

    @property
    def unmet(self) -> tuple[str, ...]:
        """The requirements that are known to be missed in some case."""
        return tuple(name for name in REQUIREMENTS if self.met(name) is False)

    @property
    def unknown(self) -> tuple[str, ...]:
        """The requirements that are asked for and not known of two paths; none of an unstable system."""
        asked = self.system.requirements.needed if self.stable_in_range else ()
        return tuple(name for name in asked if math.isnan(self.worst[name][0]))

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict as on systems with one path."""
        found = [unstable(case.state, case.text) for case in self.nominal if not case.limit.stable]
        found += [Finding("unstable_in_range", "unsafe", state=self.unstable_at)] if self.unstable_at else []
        for name in (*self.unmet, *self.unknown):
            value, case = self.worst[name]
            omega = REQUIREMENTS[name].frequency(case.margins)
            joints = deciding_joints_in(case.state, name) if len(self.system.source.joint_names) > 1 else ()
            found.append(missed(self.system.requirements, name, value, frequency=omega, state=case.text, joints=joints))
        if self.stable_in_range and self.system.uncertainty.names and not self.unmet:
            found.append(Finding("range_sampled", "safe"))
        uncertified = [case.title for case in self.nominal if not case.margins.certified]
        if uncertified:
            found.append(Finding("not_certified", "safe", state=", ".join(filter(None, uncertified))))
        return judged(self.system, KEYS, found, lambda level: read_as(self.system, found, [case.state for case in self.nominal], level))

    @property
    def requirements_met(self) -> bool | None:
        """None where all that is known is met, and something is not known or uncertain."""
        if not self.stable_in_range or self.unmet:
            return False
        return None if self.unknown or self.system.uncertainty.names else True


def study_two_paths(system: System, progress: Progress = quiet) -> PathStudy:
    """Every state and case of a system whose kd closes on a path of its own. Raises GainroomError where no case can be computed."""
    every, found = list(system.cases(inside=True)), []
    for index, case in enumerate(every):
        progress(index, len(every), case.title)
        state = State(case.system, case.posture, case.contact, case.model, largest_gains=False)
        name = state.title if case.posture else ""
        with computable(system.source.name + (f": {case.title}" if name else "")):
            if state.moves:
                found.append(PathCase(state, name, case.place, state.margins, state.delay_limit))
    progress(len(every), len(every), "")
    if not found:
        raise GainroomError(f"{system.source.name}: its gains act on no motion in any state, so there is nothing to study")
    return PathStudy(system, tuple(found))
