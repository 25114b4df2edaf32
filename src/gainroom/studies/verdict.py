"""Whether a system is safe, in one record: every command, page and app shows it, and the exit status follows from it.

A finding alone makes a system unsafe, leaves it open, or says what a safe verdict rests on. Findings hold numbers and names;
report/words.py makes sentences of them.

    unsafe      unstable, or a requirement is missed, somewhere within what the user has stated
    undecided   something that decides is not known; the remedy names the option or key that gives it
    safe        everything that is required holds in every state and case
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..system.requirements import REQUIREMENTS
from ..system.system import System

if TYPE_CHECKING:
    from .analysis import Analysis
    from .state import State

Level = Literal["safe", "undecided", "unsafe"]
STATUS: Mapping[Level, int] = {"safe": 0, "unsafe": 1, "undecided": 3}
"""Exit statuses; 2 says that the input or the call is wrong."""
RISING: tuple[Level, ...] = ("safe", "undecided", "unsafe")


@dataclass(frozen=True)
class Finding:
    """One thing that was found.

    code     "unstable", "topples", "unstable_in_range", the name of a requirement that is missed or not known, of something unknown, or of
             what a verdict rests on
    level    of a system of which this alone is known
    values   numbers by name, in the units that the names say
    state    posture and contact state; "" of a joint, and where all are meant
    joints   whose they are, the first the most
    remedy   option or key that decides, or gives more
    """

    code: str
    level: Level
    values: Mapping[str, float] = field(default_factory=dict)
    state: str = ""
    joints: tuple[str, ...] = ()
    remedy: str = ""

    @property
    def facts(self) -> dict[str, Any]:
        """What --json prints."""
        return {
            "code": self.code,
            "level": self.level,
            **self.values,
            "state": self.state,
            "joints": list(self.joints),
            "remedy": self.remedy,
        }


@dataclass(frozen=True)
class Verdict:
    """Whether a system is safe, and all that was found, what decides first."""

    findings: tuple[Finding, ...]

    @classmethod
    def of(cls, findings: Iterable[Finding]) -> "Verdict":
        """With the findings that decide first, each level in the order given."""
        return cls(tuple(sorted(findings, key=lambda one: -RISING.index(one.level))))

    @property
    def level(self) -> Level:
        """That of the worst finding."""
        return RISING[max((RISING.index(one.level) for one in self.findings), default=0)]

    @property
    def deciding(self) -> tuple[Finding, ...]:
        """The findings without which the verdict would be a better one; none of a safe one."""
        return () if self.level == "safe" else tuple(one for one in self.findings if one.level == self.level)

    @property
    def status(self) -> int:
        """The exit status."""
        return STATUS[self.level]

    @property
    def facts(self) -> dict[str, Any]:
        """The keys of --json."""
        return {"verdict": self.level, "findings": [one.facts for one in self.findings]}

    def with_findings(self, *more: Finding) -> "Verdict":
        """With some more, which may make it worse and never better."""
        return Verdict.of((*self.findings, *more))

    def open(self, *why: Finding) -> "Verdict":
        """The same where something that is not known, `why`, may turn what is unsafe into safe: that is not decided either."""
        told = (replace(one, level="undecided") if one.level == "unsafe" else one for one in self.findings)
        return Verdict.of((*why, *told))


def verdict_of(study: "Analysis") -> Verdict:
    """Of a system analysed."""
    found = (*found_unstable(study), *found_missed(study), *rests_on(study))
    return judged(study.system, study.remedies, found, lambda: _unsafe_with_motors(study))


def judged(
    system: System, remedies: Mapping[str, str], findings: Iterable[Finding], unsafe_with_motors: Callable[[], bool] = lambda: False
) -> Verdict:
    """From what was found of a system, and what of it is not known.

    remedies   what gives that, by the finding's code
    unsafe_with_motors   whether it is unsafe, too, where motors that nobody described have the inertia of motors of that size
    """
    found, unknown = Verdict.of(findings), dict(system.source.unknown)
    if system.rate_is_missing:
        found = found.with_findings(Finding("rate_unknown", "undecided", remedy=remedies["rate_unknown"]))
    if gearboxes := unknown.get("gearbox_unknown"):
        found = found.with_findings(Finding("gearbox_unknown", "undecided", joints=gearboxes, remedy=remedies["gearbox_unknown"]))
    if doubts := unknown.get("implausible"):
        found = found.open(Finding("implausible", "undecided", joints=doubts))
    # An inertia that counts as 0 mostly lowers limits: what is safe without it rests on that, what is not may be safe.
    if motors := unknown.get("motor_inertia_unknown"):
        why = Finding("motor_inertia_unknown", "safe", joints=motors, remedy=remedies["motor_inertia_unknown"])
        lowered = found.level == "unsafe" and not unsafe_with_motors()
        found = found.open(replace(why, level="undecided")) if lowered else found.with_findings(why)
    return found


def _unsafe_with_motors(study: "Analysis") -> bool:
    """Whether gains are unsafe, too, where motors of unknown inertia have that of the links they move: few have more."""
    from .analysis import analyze

    actuators = study.system.source.actuators
    with np.errstate(divide="ignore"):
        loads = np.max([1 / np.maximum(np.diagonal(state.model.link_inverse_inertia), 0.0) for state in study.states], axis=0)
    known = np.where(np.isfinite(loads), loads, actuators.motor_inertia.max(initial=1.0))
    inertia = np.where(actuators.without_inertia, known, actuators.motor_inertia)
    return analyze(study.system.with_values(motor_inertia=inertia)).verdict.level == "unsafe"


def found_unstable(study: "Analysis") -> Iterator[Finding]:
    """States in which the gains are unstable; where none is at the nominal values, the case in the ranges in which one is."""
    for state in study.states:
        limit = state.limit
        if not limit.stable:
            values = {"gain_limit": limit.gain, "lower_gain_limit": limit.lower_gain, "limit_frequency_rad_s": limit.frequency}
            code = "topples" if state.loop.topples else "unstable"
            yield Finding(code, "unsafe", values, study.title_of(state), state.limiting_joints)
    if study.unstable_case:
        yield Finding("unstable_in_range", "unsafe", {}, study.unstable_case)


def found_missed(study: "Analysis") -> Iterator[Finding]:
    """Requirements that a stable system misses, what is missed most first; one that is not known leaves the verdict open."""
    for name, state in study.unmet.items():
        yield missed(study.system, name, study.least(state, name), study.worst_in(state).margins, state, study.title_of(state))
    if study.stable and not study.system.requirements.asked:
        yield Finding("nothing_required", "undecided", remedy=study.remedies["limits"])


def missed(system: System, name: str, value: float, margins: Any, state: "State", title: str) -> Finding:
    """One requirement that has `value` where `state` is worst, with all `margins` there."""
    from .deciding_joints import deciding_joints_in

    one, needed = REQUIREMENTS[name], system.requirements.needed[name]
    values = {one.key: one.in_unit(value), "required": one.in_unit(needed), "frequency_rad_s": one.frequency(margins)}
    joints = () if math.isnan(value) or len(system.source.joint_names) == 1 else deciding_joints_in(state, name)
    return Finding(name, "undecided" if math.isnan(value) else "unsafe", values, title, joints)


def rests_on(study: "Analysis") -> Iterator[Finding]:
    """What a verdict does not cover, or was looked at and not proved."""
    if study.stable_in_range and not study.unmet and study.requirements_met is None:
        yield Finding("range_sampled", "safe")
    if study.immobile:
        yield Finding("immobile", "safe", state=", ".join(state.title for state in study.immobile))
    uncertified = [state.title for state in study.states if not state.margins.certified]
    if uncertified:
        yield Finding("not_certified", "safe", state=", ".join(filter(None, uncertified)))
