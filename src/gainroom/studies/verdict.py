"""The verdict on a system, safe, unsafe or undecided, in one record: every command and page shows it, the exit status follows.

A finding alone makes a system unsafe, leaves it open, or says what a safe verdict rests on. Findings hold numbers and names;
report/words.py makes sentences of them.

    unsafe      unstable, or a requirement is missed, somewhere within what the user has stated
    undecided   something that decides is not known; the remedy names the option or key that gives it
    safe        everything that is required holds in every state and case
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import System

Level = Literal["safe", "undecided", "unsafe"]
STATUS: Mapping[Level, int] = {"safe": 0, "unsafe": 1, "undecided": 3}
"""Exit statuses; 2 says that the input or the call is wrong."""
RISING: tuple[Level, ...] = ("safe", "undecided", "unsafe")


@dataclass(frozen=True)
class Reading:
    """A value of what is not known, as text, and what the system is with it."""

    text: str
    level: Level


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
    readings   of what is not known and decides: some that differ
    """

    code: str
    level: Level
    values: Mapping[str, float] = field(default_factory=dict)
    state: str = ""
    joints: tuple[str, ...] = ()
    remedy: str = ""
    readings: tuple[Reading, ...] = ()

    @property
    def facts(self) -> dict[str, Any]:
        """The finding as --json prints it."""
        return {
            "code": self.code,
            "level": self.level,
            **self.values,
            "state": self.state,
            "joints": list(self.joints),
            "remedy": self.remedy,
            **({"readings": [{"reading": one.text, "verdict": one.level} for one in self.readings]} if self.readings else {}),
        }


@dataclass(frozen=True)
class Verdict:
    """The verdict on a system, with all that was found, what decides first."""

    findings: tuple[Finding, ...]

    @classmethod
    def of(cls, findings: Iterable[Finding]) -> "Verdict":
        """A verdict with the findings that decide first, each level in the order given."""
        return cls(tuple(sorted(findings, key=lambda one: -RISING.index(one.level))))

    @property
    def level(self) -> Level:
        """The level of the worst finding."""
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
        """The verdict with some more findings, which may make it worse and never better."""
        return Verdict.of((*self.findings, *more))

    def open(self, *why: Finding) -> "Verdict":
        """The verdict where something that is not known, `why`, may turn what is unsafe into safe: that is not decided either."""
        told = (replace(one, level="undecided") if one.level == "unsafe" else one for one in self.findings)
        return Verdict.of((*why, *told))


@dataclass(frozen=True)
class Read:
    """A decision from all readings of what is not known: the level they agree on, or the readings that differ.

    level      unsafe in all, safe in all, or not decided
    deciding   by code of what is not known, the readings that show that it decides; {} where nothing does
    """

    level: Level
    deciding: Mapping[str, tuple[Reading, ...]] = field(default_factory=dict)


def judged(system: System, remedies: Mapping[str, str], findings: Iterable[Finding], read: Callable[[Level], Read]) -> Verdict:
    """The verdict from what was found of a system, and what of it is not known.

    remedies   what gives that, by the finding's code
    read       the readings of the system (readings.py), given what it is as it was computed
    """
    found, unknown = Verdict.of(findings), system.source.unknown

    def why(code: str, level: Level = "undecided", readings: tuple[Reading, ...] = ()) -> Finding:
        return Finding(code, level, joints=unknown.get(code, ()), remedy=remedies.get(code, ""), readings=readings)

    if not system.requirements.asked:
        found = found.with_findings(why("nothing_required"))
    if "implausible" in unknown:
        found = found.open(why("implausible"))
    codes = [*(["rate_unknown"] if system.rate_is_missing else []), *(code for code in UNKNOWN if code in unknown)]
    if not codes:
        return found
    if found.level == "undecided":  # by something else, so nothing was looked at
        return found.with_findings(*map(why, codes))
    whole = read(found.level)
    if whole.level == "unsafe" and found.level != "unsafe":
        found = found.with_findings(Finding("unsafe_at_usual_rates", "unsafe"))
    if whole.level == "safe" and "gearbox_unknown" in codes:
        found = found.with_findings(Finding("range_sampled", "safe"))
    decides = [why(code, "undecided", whole.deciding[code]) for code in codes if code in whole.deciding]
    others = [why(code, "safe") for code in codes if code not in whole.deciding]
    return (found.open(*decides) if decides else found).with_findings(*others)


UNKNOWN = ("gearbox_unknown", "motor_inertia_unknown")
"""Codes of what a source may leave open, beside the rate."""


def missed(required: Requirements, name: str, value: float, **where: Any) -> Finding:
    """One requirement that has `value` [SI] at the worst; not known (NaN) it leaves the verdict open, and nobody is it.

    where   `frequency` [rad/s], `state`, `joints`, and `postures`, in how many it is missed; as far as they are known
    """
    one, known = REQUIREMENTS[name], not math.isnan(value)
    asked = float(f"{one.in_unit(required.needed[name]):.12g}")  # as it was typed: 30° came back from radians as 29.999999999999996
    values = {one.key: one.in_unit(value), "required": asked, "frequency_rad_s": where.get("frequency", math.nan)}
    values |= {"postures": where["postures"]} if "postures" in where else {}
    return Finding(name, "unsafe" if known else "undecided", values, where.get("state", ""), where.get("joints", ()) if known else ())
