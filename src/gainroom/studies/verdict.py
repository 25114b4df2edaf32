"""Verdict on a system, safe, unsafe or undecided, in one record: every command and page shows it, the exit status follows.

A finding alone makes a system unsafe, leaves it open, or qualifies a safe verdict. Findings hold numbers and names; report/words.py makes
sentences of them. Findings are made by `verdict_of` in analysis.py from the margins of every state (state.py), compared with Requirements
(system/requirements.py); audit.py and gain_paths.py add theirs. `judged` below turns them into the verdict, whose `level` is the word.

    unsafe      unstable, or a requirement is missed, somewhere within the user's statements
    undecided   missing data decides; the remedy names the option or key that gives it
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
"""Exit statuses; 2 is reserved for wrong input or usage."""
RISING: tuple[Level, ...] = ("safe", "undecided", "unsafe")


@dataclass(frozen=True)
class Reading:
    """Possible value of missing data, as text, and the level of the system with it."""

    text: str
    level: Level


@dataclass(frozen=True)
class Finding:
    """One finding of a study.

    code     "unstable", "topples", "unstable_in_range", name of a requirement that is missed or not known, of missing data, or of a
             qualification of the verdict
    level    of a system of which this alone is known
    values   numbers by name, in the units that the names say
    state    posture and contact state; "" for a joint, and if all are meant
    joints   names of the joints concerned, the most affected first
    remedy   option or key that decides, or gives more
    readings   for missing data that decides: some readings that differ
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
        """JSON form of the finding."""
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
    """Verdict on a system with all findings, deciding ones first."""

    findings: tuple[Finding, ...]

    @classmethod
    def of(cls, findings: Iterable[Finding]) -> "Verdict":
        """Verdict of `findings`, sorted by level, each level in the order given."""
        return cls(tuple(sorted(findings, key=lambda one: -RISING.index(one.level))))

    @property
    def level(self) -> Level:
        """Level of the worst finding."""
        return RISING[max((RISING.index(one.level) for one in self.findings), default=0)]

    @property
    def deciding(self) -> tuple[Finding, ...]:
        """Findings without which the verdict would be better; () for a safe one."""
        return () if self.level == "safe" else tuple(one for one in self.findings if one.level == self.level)

    @property
    def status(self) -> int:
        """Exit status."""
        return STATUS[self.level]

    @property
    def facts(self) -> dict[str, Any]:
        """JSON keys of the verdict."""
        return {"verdict": self.level, "findings": [one.facts for one in self.findings]}

    def with_findings(self, *more: Finding) -> "Verdict":
        """Verdict with further findings, which may make it worse and never better."""
        return Verdict.of((*self.findings, *more))

    def open(self, *why: Finding) -> "Verdict":
        """Verdict in which missing data, `why`, may turn unsafe findings into safe ones: these become undecided."""
        reopened = (replace(one, level="undecided") if one.level == "unsafe" else one for one in self.findings)
        return Verdict.of((*why, *reopened))


@dataclass(frozen=True)
class Read:
    """Decision over all readings of missing data: the level they agree on, or the readings that differ.

    level      unsafe in all, safe in all, or undecided
    deciding   readings that show that missing data decides, by its code; {} if none does
    """

    level: Level
    deciding: Mapping[str, tuple[Reading, ...]] = field(default_factory=dict)


def judged(system: System, remedies: Mapping[str, str], findings: Iterable[Finding], read: Callable[[Level], Read]) -> Verdict:
    """Verdict from the findings on a system and its missing data.

    remedies   option or key that gives missing data, by the code of the finding
    read       function from the computed level to the decision over all readings (readings.py)
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
"""Codes of data that a source may lack, beside the rate."""


def missed(required: Requirements, name: str, value: float, **where: Any) -> Finding:
    """Finding of one requirement with its worst `value` [SI]; NaN leaves the verdict undecided, without joints.

    where   `frequency` [rad/s], `state`, `joints`, and `postures`, the number that miss it; as far as they are known
    """
    one, known = REQUIREMENTS[name], not math.isnan(value)
    asked = float(f"{one.in_unit(required.needed[name]):.12g}")  # as it was typed: 30° came back from radians as 29.999999999999996
    values = {one.key: one.in_unit(value), "required": asked, "frequency_rad_s": where.get("frequency", math.nan)}
    values |= {"postures": where["postures"]} if "postures" in where else {}
    return Finding(name, "unsafe" if known else "undecided", values, where.get("state", ""), where.get("joints", ()) if known else ())
