"""One state over what is not known exactly: at which places it is looked at, and the worst of them. Between them nothing is proved."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..analysis.margin_record import Margins, worst_of
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS
from ..system.system import StateCase, System
from ..system.uncertainty import share_of
from .loop_numbers import extra_delay

JUST_BEYOND = 1e-3
"""Relative: where a loop that vibrates from some extra delay on is looked at, so that it is unstable."""


@dataclass(frozen=True)
class Worst:
    """A loop over the uncertainty.

    margins      every margin in the case in which it is smallest, of those that were looked at
    at           by requirement, the case in which what it bounds is worst, as text; "" at the nominal values
    unstable_at  the first case in which the gains are unstable, as text; "": none was found, or they are at the nominal values
    """

    margins: Margins
    at: Mapping[str, str] = field(default_factory=dict)
    unstable_at: str = ""

    @classmethod
    def of(cls, cases: Sequence[tuple[str, Margins]]) -> "Worst":
        """Cases by their text, the nominal one ("") first."""
        (_, nominal), *others = cases
        unstable = next((name for name, found in others if not found.stable), "") if nominal.stable else ""

        def least(requirement: Requirement) -> str:
            return min(cases, key=lambda case: unknown_first((-1 if requirement.at_most else 1) * requirement.value(case[1])))[0]

        return cls(worst_of([found for _, found in cases]), {name: least(one) for name, one in REQUIREMENTS.items()}, unstable)


def unknown_first(margin: float) -> float:
    """Sorts margins: one that is not known (NaN) comes before the least."""
    return -math.inf if math.isnan(margin) else margin


def uncertain_cases(system: System, posture: str, contact: str) -> Iterator[StateCase]:
    """A state at every corner of the uncertainty, at places between, and at delays within the range from which a corner vibrates.

    These are the first ones after the shortest, certified as delay margins are; of drives that have one range.
    """
    yield from (case for case in system.cases_of(posture, contact, inside=True) if case.place)
    uncertain = system.uncertainty
    if uncertain.delay is None or any(np.ptp(end) > 0 for end in uncertain.delay):
        return
    low, high = (float(np.min(end)) for end in uncertain.delay)
    which = uncertain.names.index("delay")
    for corner in uncertain.corners:
        if corner[which] > 0:
            continue
        case = system.case_at(corner, posture, contact)
        lost = low + (1 + JUST_BEYOND) * extra_delay(case.system.loop(case.model))
        if lost < high:
            yield system.case_at((*corner[:which], share_of(low, high, lost), *corner[which + 1 :]), posture, contact)
