"""Gains in place of unsafe ones: those of some joints, or of all, lowered by one factor, and certified as they are typed."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from ..system.requirement import enough
from ..system.system import System
from .factors import typed_factor
from .loop_numbers import limit_of
from .state import State, limiting_joints

MOST_DIGITS = 7
"""Of a gain that is typed."""
GROWTHS = 5
"""Times that joints are added to those whose gains are lowered."""
HARDLY_MORE = 1.1
"""Power of the common factor to which the others may go so that a joint keeps its gains. To first order joints raise a limit by what they
take part in it: one that takes a tenth part or less costs the others no more than this."""
ALIKE = 1e-4
"""Relative: limits of mirrored joints, which differ by round-off and by how near they are followed."""
MOST_TRIED = 40
"""Joints that are tried one by one, a look at every state each."""


class AuditOfGains(Protocol):
    """What gains in place of others are made from: an audit (audit.py), which asks for them."""

    @property
    def system(self) -> System: ...
    @property
    def states(self) -> tuple[State, ...]: ...
    @cached_property
    def joints(self) -> tuple[Any, ...]: ...
    @property
    def gain_names(self) -> tuple[str, ...]: ...
    @property
    def margin(self) -> float: ...
    @property
    def safe(self) -> bool: ...
    @property
    def has_two_paths(self) -> bool: ...
    @cached_property
    def scale(self) -> float: ...
    def enough_together_in(self, state: State) -> bool: ...
    def loops_at(self, lowered: Booleans, factor: float) -> Iterator[Loop]: ...
    def seen_factor(self, lowered: Booleans, most: float) -> float: ...
    def seen_at(self, lowered: Booleans, factor: float) -> bool: ...
    def of_gains(self, gains: Mapping[str, Floats]) -> Self: ...


SomeAudit = TypeVar("SomeAudit", bound=AuditOfGains)


@dataclass(frozen=True)
class GainsToUse(Generic[SomeAudit]):
    """Gains in place of unsafe ones, certified as they are typed.

    factor   on the gains of `joints`; all others stay
    gains    (n,) by name, rounded to the digits that are typed
    audited  their audit: safe
    """

    factor: float
    joints: tuple[str, ...]
    gains: Mapping[str, Floats]
    audited: SomeAudit


def gains_to_use(result: SomeAudit) -> GainsToUse[SomeAudit] | None:
    """The gains of some joints, or else of all, lowered by one factor; None where none are known to be safe.

    The factor has three digits, the gains four or as many more as leave them safe.
    """
    names = result.system.source.joint_names
    exact = {name: np.array([getattr(joint, name) for joint in result.joints]) for name in result.gain_names}
    for lowered, found in _lowered(result):
        factor = typed_factor(found)
        for count in range(4, MOST_DIGITS + 1) if factor > 0 else ():
            typed = {
                name: np.array([float(f"{value:.{count}g}") for value in (np.where(lowered, factor, 1.0) * values).tolist()])
                for name, values in exact.items()
            }
            audited = result.of_gains(typed)
            if audited.safe:
                return GainsToUse(factor, tuple(name for name, low in zip(names, lowered, strict=True) if low), typed, audited)
            if not lowered.all():  # its factor was found, not proved: more digits would not mend it
                break
    return None


def _lowered(result: AuditOfGains) -> Iterator[tuple[Booleans, float]]:
    """Sets of joints (n,), each with the largest factor found on their gains alone; NaN: none was found.

    First those that are short of the gain margin, then all unsafe ones, each with the joints that vibrate once they are lowered; last all.
    Of the first two sets first those joints that must be lowered.
    """
    names, limits = result.system.source.joint_names, np.array([joint.limit for joint in result.joints])
    vibrating = {name for state in result.states if not result.enough_together_in(state) for name in state.limiting_joints}
    short, tried = (limits < result.margin) | np.isin(names, list(vibrating)), []
    for lowered in () if result.has_two_paths else (short, np.array([not joint.safe for joint in result.joints])):
        most = min(1.0, float(np.min(limits[lowered], initial=math.inf)) / result.margin)
        for _ in range(GROWTHS if most > 0 else 0):
            found = map(limit_of, result.loops_at(lowered, most))
            more = {name for limit in found if not enough(limit.gain, result.margin) for name in limiting_joints(limit, names)}
            if not np.any(np.isin(names, list(more)) & ~lowered):
                break
            lowered = lowered | np.isin(names, list(more))
        if most > 0 and lowered.any() and not lowered.all() and lowered.tolist() not in tried:
            tried.append(lowered.tolist())
            factor = result.seen_factor(lowered, most)
            yield from _without_carried(result, lowered, factor)
            yield lowered, factor
    yield np.ones(len(names), dtype=bool), result.scale


def _without_carried(result: AuditOfGains, lowered: Booleans, factor: float) -> Iterator[tuple[Booleans, float]]:
    """The joints of `lowered` (n,) without those that others only carry along, where there are some, with their own largest factor.

    A joint is carried along where the others, lowered by hardly more than `factor`, have what is required while its gains stay. Joints that
    are alike, as left and right ones are, keep their gains together or not at all.
    """
    if not (0 < factor < 1 and np.count_nonzero(lowered) <= MOST_TRIED):
        return
    fewer, least = lowered, factor**HARDLY_MORE
    for first in sorted(np.flatnonzero(lowered).tolist(), key=lambda k: -result.joints[k].limit):
        group = np.array([_alike(result.joints[first], joint) for joint in result.joints])
        without = fewer & ~group
        if fewer[first] and without.any() and result.seen_at(without, least):
            fewer = without
    if np.any(fewer != lowered):
        found = result.seen_factor(fewer, 1.0)
        yield fewer, found if found >= least else least


def _alike(one: Any, other: Any) -> bool:
    """Whether two audited joints have the same gains and the same limit, as a robot's mirrored ones do."""
    return (one.kp, one.kd, one.ki) == (other.kp, other.kd, other.ki) and math.isclose(one.limit, other.limit, rel_tol=ALIKE)
