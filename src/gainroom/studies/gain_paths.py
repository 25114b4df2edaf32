"""Study of a joint or robot whose kd has a separate path: every state, nominal, at every corner of the uncertainty and between.

Gain maps, largest gains, recommended ones and curves over frequency exist for loops with one path only.
"""

import math
from dataclasses import dataclass
from functools import cached_property

from ..analysis.margin_record import GainLimit, Margins
from ..errors import GainroomError, computable
from ..system.requirements import REQUIREMENTS, reported
from ..system.system import System
from .analysis import KEYS, read_as, unstable
from .critical_joints import critical_joints_in
from .progress import Progress, quiet
from .state import State, path_headroom
from .verdict import Finding, Verdict, judged, missed


@dataclass(frozen=True)
class PathCase:
    """One state at one place in the uncertainty.

    state        posture and contact state with its system
    title        posture and contact state as text; "" for a joint
    place        as text; "" for the nominal case
    delay_limit  total delay of the other gains' path, kd's unchanged [s]; NaN: not known, 0: no delay is short enough
    """

    state: State
    title: str
    place: str
    margins: Margins
    delay_limit: float

    @property
    def limit(self) -> GainLimit:
        """Limit of the common factor on all gains."""
        return self.margins.limit

    @property
    def text(self) -> str:
        """Title of the state and the case of the uncertainty, joined by a comma, for messages; "" for a joint at its nominal values."""
        return ", ".join(filter(None, (self.title, self.place)))


@dataclass(frozen=True)
class PathStudy:
    """Results in all cases; the nominal case of each state comes first."""

    system: System
    cases: tuple[PathCase, ...]

    @property
    def nominal(self) -> tuple[PathCase, ...]:
        """Nominal cases, one per state."""
        return tuple(case for case in self.cases if not case.place)

    @cached_property
    def tightest(self) -> PathCase:
        """Nominal case with the least headroom."""
        return min(self.nominal, key=lambda case: path_headroom(case.margins))

    @property
    def stable(self) -> bool:
        """True if stable at the nominal values."""
        return all(case.limit.stable for case in self.nominal)

    @property
    def unstable_at(self) -> str:
        """First unstable case, as text, if the nominal ones are stable; "" if there is none."""
        return next((case.text for case in self.cases if not case.limit.stable), "") if self.stable else ""

    @property
    def stable_in_range(self) -> bool:
        """True if stable in every case; between cases it is not proved."""
        return self.stable and not self.unstable_at

    @cached_property
    def worst(self) -> dict[str, tuple[float, PathCase]]:
        """Worst value of each requirement, by name, and its case; NaN, of the first case, if it is not known."""

        def least(name: str) -> tuple[float, PathCase]:
            one = REQUIREMENTS[name]
            found = [(one.value(case.margins), case) for case in self.cases]
            unknown = next((pair for pair in found if math.isnan(pair[0])), None)
            return unknown or (max if one.at_most else min)(found, key=lambda pair: pair[0])

        return {
            one.name: least(one.name) for one in reported(self.system.requirements, self.cases[0].margins.one_loop.gain_margin.size > 1)
        }

    def met(self, name: str) -> bool | None:
        """True if a requirement is met in every case; None if it is not required or not known."""
        value = self.worst[name][0]
        return None if math.isnan(value) or not self.stable_in_range else self.system.requirements.met(name, value)

    @property
    def unmet(self) -> tuple[str, ...]:
        """Names of requirements known to be missed in some case."""
        return tuple(name for name in self.worst if self.met(name) is False)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of requirements that are asked for but not known for two paths; () for an unstable system."""
        asked = self.system.requirements.needed if self.stable_in_range else ()
        return tuple(name for name in asked if math.isnan(self.worst[name][0]))

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict, made as for systems with one path."""
        found = [unstable(case.state, case.text) for case in self.nominal if not case.limit.stable]
        found += [Finding("unstable_in_range", "unsafe", state=self.unstable_at)] if self.unstable_at else []
        for name in (*self.unmet, *self.unknown):
            value, case = self.worst[name]
            omega = REQUIREMENTS[name].frequency(case.margins)
            joints = critical_joints_in(case.state, name) if len(self.system.source.joint_names) > 1 else ()
            found.append(missed(self.system.requirements, name, value, frequency=omega, state=case.text, joints=joints))
        if self.stable_in_range and self.system.uncertainty.names and not self.unmet:
            found.append(Finding("range_sampled", "safe"))
        uncertified = [case.title for case in self.nominal if not case.margins.certified]
        if uncertified:
            found.append(Finding("not_certified", "safe", state=", ".join(filter(None, uncertified))))
        return judged(self.system, KEYS, found, lambda level: read_as(self.system, found, [case.state for case in self.nominal], level))

    @property
    def requirements_met(self) -> bool | None:
        """True if all requirements are met; None if no known one is missed, but something is not known or uncertain."""
        if not self.stable_in_range or self.unmet:
            return False
        return None if self.unknown or self.system.uncertainty.names else True


def study_gain_paths(system: System, progress: Progress = quiet) -> PathStudy:
    """Study of every state and case of a system whose kd has a separate path. Raises GainroomError if no case can be computed."""
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
