"""Whether a system is safe, in one record: every command, page and app shows it, and the exit status follows from it.

A finding alone makes a system unsafe, leaves it open, or says what a safe verdict rests on. Findings hold numbers and names;
report/words.py makes sentences of them.

    unsafe      unstable, or a requirement is missed, somewhere within what the user has stated
    undecided   something that decides is not known; the remedy names the option or key that gives it
    safe        everything that is required holds in every state and case
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from ..system.requirements import REQUIREMENTS
from ..system.system import System

if TYPE_CHECKING:
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


def missed(system: System, name: str, value: float, margins: Any, state: "State", title: str) -> Finding:
    """One requirement that has `value` where `state` is worst, with all `margins` there."""
    from .deciding_joints import deciding_joints_in

    one, needed = REQUIREMENTS[name], system.requirements.needed[name]
    asked = float(f"{one.in_unit(needed):.12g}")  # as it was typed: 30° came back from radians as 29.999999999999996
    values = {one.key: one.in_unit(value), "required": asked, "frequency_rad_s": one.frequency(margins)}
    joints = () if math.isnan(value) or len(system.source.joint_names) == 1 else deciding_joints_in(state, name)
    return Finding(name, "undecided" if math.isnan(value) else "unsafe", values, title, joints)
