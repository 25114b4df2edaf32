"""Margins of one state over its uncertainty: the cases examined, and the worst of them. Between cases nothing is proved."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from ..analysis.margin_record import Margins, worst_of
from ..system.linear.arrays import rank
from ..system.requirement import Requirement
from ..system.requirements import Requirements, reported
from ..system.system import StateCase, System
from ..system.uncertainty import Place, share_of
from .loop_numbers import extra_delay

JUST_BEYOND = 1e-3
"""Relative excess over a delay from which a loop vibrates, at which it is examined so that it is unstable."""


@dataclass(frozen=True)
class Worst:
    """Worst margins of a loop over the uncertainty.

    margins      every margin in the examined case in which it is smallest
    at           case, as text, in which each requirement has its worst value; "" at the nominal values
    unstable_at  first unstable case, as text; "": none was found, or the gains are nominally unstable
    """

    margins: Margins
    at: Mapping[str, str] = field(default_factory=dict)
    unstable_at: str = ""

    @classmethod
    def of(cls, cases: Sequence[tuple[str, Margins]], asked: Requirements) -> "Worst":
        """Worst of `cases`, given as text and margins, the nominal one ("") first; `asked`: what is required."""
        (_, nominal), *others = cases
        unstable = next((name for name, found in others if not found.stable), "") if nominal.stable else ""

        def least(requirement: Requirement) -> str:
            return min(cases, key=lambda case: unknown_first((-1 if requirement.at_most else 1) * requirement.value(case[1])))[0]

        every = reported(asked, len(nominal.one_loop.gain_margin) > 1, nominal)
        return cls(worst_of([found for _, found in cases]), {one.name: least(one) for one in every}, unstable)

    def with_delay_margin(self, value: float, place: str) -> "Worst":
        """Worst with the delay margin [s] of the corners, `value` at `place` (text); unchanged if `value` is NaN."""
        if math.isnan(value):
            return self
        return replace(self, margins=replace(self.margins, delay_margin=value), at={**self.at, "delay_margin": place})


def unknown_first(margin: float) -> float:
    """Sort key of margins: NaN (not known) first; values equal within round-off keep their order."""
    return -math.inf if math.isnan(margin) else rank(margin)


def uncertain_cases(system: System, posture: str, contact: str, extra: "ExtraDelays | None") -> Iterator[StateCase]:
    """Cases of a state at every corner of the uncertainty, at places between, and at the delays in the range from which a corner vibrates.

    These are the first such delays after the shortest, certified as delay margins are; for drives with one common range (`extra`, else
    None).
    """
    yield from (case for case in system.cases_of(posture, contact, inside=True) if case.place)
    if extra is None or not extra.range:
        return
    which = system.uncertainty.names.index("delay")
    low, high = extra.range
    for corner, value in extra.at.items():
        lost = low + (1 + JUST_BEYOND) * value
        if lost < high:
            yield system.case_at((*corner[:which], share_of(low, high, lost), *corner[which + 1 :]), posture, contact)


@dataclass(frozen=True)
class ExtraDelays:
    """Extra delay at which a state vibrates, over the corners of the uncertainty.

    range   (low, high) of all drives' delay [s]; None: it is known, or not the same for all
    at      extra delay [s] by corner; with a range only corners of the shortest delay: one longer by d leaves less by d
    """

    range: tuple[float, float] | None
    at: Mapping[Place, float]

    @classmethod
    def of(cls, system: System, posture: str, contact: str) -> "ExtraDelays":
        uncertain, ends = system.uncertainty, system.uncertainty.delay_range
        which = uncertain.names.index("delay") if ends else -1
        corners = [corner for corner in uncertain.corners if not ends or corner[which] == 0]
        cases = [system.case_at(corner, posture, contact) for corner in corners]
        return cls(ends, {corner: extra_delay(case.system.loop(case.model)) for corner, case in zip(corners, cases, strict=True)})

    def least(self, system: System) -> tuple[float, Place]:
        """Least extra delay of all corners [s], and the corner."""
        corner = min(self.at, key=lambda corner: unknown_first(self.at[corner]))
        if not self.range:
            return self.at[corner], corner
        which = system.uncertainty.names.index("delay")
        low, high = self.range
        return self.at[corner] - (high - low), (*corner[:which], 1.0, *corner[which + 1 :])
