"""Safe gains in place of unsafe ones: those of some joints, or of all, each lowered as little as needed, certified as rounded.

Where no lower gains are safe, as where a soft joint has too little damping, all are raised as little as needed.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from typing_extensions import Self

from ..robot.mirror_names import image_groups
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from ..system.requirement import enough
from ..system.system import System
from ..system.uncertainty import Place
from .factors import raised_factor, typed_factor
from .loop_numbers import limit_of
from .state import State, limiting_joints
from .worst_place import OverRange

MOST_DIGITS = 7
"""Most digits of a rounded gain."""
GROWTHS = 5
"""Most times that joints are added to the set whose gains are lowered."""
HARDLY_MORE = 1.1
"""Power of the common factor to which other joints may be lowered so that one joint keeps its gains, or more of them.

To first order joints raise a limit by their participation: one with a tenth or less costs the others no more than this.
"""
ALIKE = 1e-4
"""Relative difference of the limits of mirrored joints, by round-off and the accuracy of following them."""
WORTH = 1.05
"""Least geometric mean of individual factors relative to the common one: for less the common one is simpler."""
LEAST_RISE = 1.02
"""First trial of a joint's individual factor relative to the others': a joint that cannot have it stays with them."""
NEARLY_ALIKE = 0.02
"""Relative difference of the limits of joints that get the same factor: left and right ones of a real robot's model differ by as much."""
ROUNDS = 10
"""Most rounds in which gains are lowered at the worst places of a range, which change with the gains."""
HELD = 4
"""Number of places kept from one round to the next, its worst ones."""
RAISES = (1.2, 1.5, 2.0, 3.0)
"""Factors above 1 that are tried on all gains."""
MOST_TRIED = 40
"""Most joints that are tried one by one, each with one evaluation of every state."""


class AuditOfGains(Protocol):
    """Interface to an Audit (audit.py) as far as safe gains are derived from it."""

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
    def has_kd_path(self) -> bool: ...
    @property
    def assumed_rigid(self) -> Booleans: ...
    @cached_property
    def scale(self) -> float: ...
    def enough_together_in(self, state: State) -> bool: ...
    def loops_at(self, lowered: Booleans, factor: float) -> Iterator[Loop]: ...
    def seen_factor(self, lowered: Booleans, most: float) -> float: ...
    def seen_at(self, lowered: Booleans, factor: float) -> bool: ...
    def seen_with(self, factors: Floats) -> bool: ...
    def of_gains(self, gains: Mapping[str, Floats]) -> Self: ...
    def over_range(self, gains: Mapping[str, Floats]) -> Self: ...
    def held_at(self, places: Sequence[Place]) -> Self: ...
    @property
    def over(self) -> OverRange | None: ...


SomeAudit = TypeVar("SomeAudit", bound=AuditOfGains)


@dataclass(frozen=True)
class GainsToUse(Generic[SomeAudit]):
    """Safe gains in place of unsafe ones, certified as rounded.

    factors  (n,) on the gains of each joint; 1: unchanged
    joints   names of the joints whose gains change
    gains    (n,) by name, rounded
    audited  audit of these gains: safe
    """

    factors: Floats
    joints: tuple[str, ...]
    gains: Mapping[str, Floats]
    audited: SomeAudit

    @property
    def factor(self) -> float | None:
        """Common factor on the gains of `joints`; None if factors differ."""
        changed = set(self.factors[self.factors != 1].tolist())
        return changed.pop() if len(changed) == 1 else None


def gains_to_use(result: SomeAudit) -> GainsToUse[SomeAudit] | None:
    """Safe gains: those of some joints, or otherwise of all, each lowered as little as needed; None if none are known.

    Factors have three digits, gains four or as many more as needed to keep them safe.
    """
    names = result.system.source.joint_names
    exact = {name: np.array([getattr(joint, name) for joint in result.joints]) for name in result.gain_names}
    every = np.ones(len(names), dtype=bool)
    lowered_sets = ((lowered, _each_its_own(result, lowered, typed_factor(found))) for lowered, found in _lowered(result))
    for lowered, candidates in itertools.chain(lowered_sets, ((every, (factor * every,)) for factor in _raised_together(result))):
        for factors in candidates:
            for count in range(4, MOST_DIGITS + 1):
                typed = {
                    name: np.array([float(f"{value:.{count}g}") for value in (factors * values).tolist()]) for name, values in exact.items()
                }
                audited = result.of_gains(typed)
                if audited.safe:
                    return GainsToUse(factors, tuple(name for name, one in zip(names, factors, strict=True) if one != 1), typed, audited)
                if not lowered.all() or np.ptp(factors) > 0:  # they were found, not proved: more digits would not mend them
                    break
    return None


def gains_over_range(result: SomeAudit) -> GainsToUse[SomeAudit] | None:
    """Safe gains at every place of a range that is tried; None if none are known.

    Gains that hold at the worst places may fail at others: these are then added, all at once.
    """
    over = result.over
    for _ in range(ROUNDS):
        assert over is not None
        result = result.held_at(over.unsafe(HELD))
        found = gains_to_use(result)
        if found is None:
            return None
        audited = result.over_range(found.gains)
        if audited.safe:
            return GainsToUse(found.factors, found.joints, found.gains, audited)
        over = audited.over
    return None


def _raised_together(result: AuditOfGains) -> Iterator[float]:
    """The least factor above 1 on all gains that is safe, within 1 % and of three digits, by samples; none if RAISES contain none."""
    if result.has_kd_path or result.assumed_rigid.any():  # elastic gearboxes, which nobody has excluded, may not bear higher gains
        return
    every, most, held = np.ones(len(result.joints), dtype=bool), min(state.limit.gain for state in result.states) / result.margin, 1.0
    for factor in RAISES:
        if not factor < most:
            return
        if result.seen_at(every, factor):
            break
        held = factor
    else:
        return
    while factor > 1.01 * held:
        middle = math.sqrt(held * factor)
        held, factor = (held, middle) if result.seen_at(every, middle) else (middle, factor)
    yield math.ceil(1000 * factor) / 1000


def _each_its_own(result: AuditOfGains, lowered: Booleans, factor: float) -> Iterator[Floats]:
    """Candidate factors (n,) on the gains of the joints `lowered` (n,), for which the common `factor` is safe; none if it is not known.

    Individual factors come first: each is raised from the common one as far as the others allow. If that gains little, as when all joints
    vibrate together, they are raised from slightly below the common one: a joint that hardly matters then keeps most of its gains, and the
    others give up little. The common factor comes last.
    """
    if not factor > 0:
        return
    common = np.where(lowered, factor, 1.0)
    for start in (factor, typed_factor(factor**HARDLY_MORE)) if 1 < np.count_nonzero(lowered) <= MOST_TRIED else ():
        own = _raised(result, lowered, start)
        if np.prod(own) > WORTH ** np.count_nonzero(lowered) * np.prod(common):
            yield own
            break
    yield common


def _raised(result: AuditOfGains, lowered: Booleans, factor: float) -> Floats:
    """Factors (n,) raised in turn from a safe one on the joints `lowered` (n,), least participating joints first.

    Mirror images, and joints with nearly equal limits, get one factor.
    """
    own, left = np.where(lowered, factor, 1.0), lowered.copy()
    for first in sorted(np.flatnonzero(lowered).tolist(), key=lambda k: -result.joints[k].limit):
        group = left & _images(result, first, NEARLY_ALIKE)
        left &= ~group

        def holds(raised: float, group: Booleans = group, others: Floats = own) -> bool:
            return result.seen_with(np.where(group, raised, others))

        if group.any() and holds(min(LEAST_RISE * factor, 1.0)):
            own = np.where(group, typed_factor(raised_factor(holds, min(LEAST_RISE * factor, 1.0))), own)
    return own


def _lowered(result: AuditOfGains) -> Iterator[tuple[Booleans, float]]:
    """Sets of joints (n,) to be lowered, each with the largest safe factor found on their gains alone; NaN: none was found.

    First joints short of the gain margin, then all unsafe ones, each with the joints that vibrate once these are lowered; last all joints.
    Each of the first two sets is preceded by the subset that must be lowered.
    """
    names, limits = result.system.source.joint_names, np.array([joint.limit for joint in result.joints])
    vibrating = {name for state in result.states if not result.enough_together_in(state) for name in state.limiting_joints}
    short, tried = (limits < result.margin) | np.isin(names, list(vibrating)), []
    for some in () if result.has_kd_path else (short, np.array([joint.safe is False for joint in result.joints])):
        lowered = _with_images(result, some)
        most = min(1.0, float(np.min(limits[lowered], initial=math.inf)) / result.margin)
        for _ in range(GROWTHS if most > 0 else 0):
            found = map(limit_of, result.loops_at(lowered, most))
            more = {name for limit in found if not enough(limit.gain, result.margin) for name in limiting_joints(limit, names)}
            if not np.any(np.isin(names, list(more)) & ~lowered):
                break
            lowered = _with_images(result, lowered | np.isin(names, list(more)))
        if most > 0 and lowered.any() and not lowered.all() and lowered.tolist() not in tried:
            tried.append(lowered.tolist())
            factor = result.seen_factor(lowered, most)
            yield from _without_needless(result, lowered, factor)
            yield lowered, factor
    yield np.ones(len(names), dtype=bool), result.scale


def _without_needless(result: AuditOfGains, lowered: Booleans, factor: float) -> Iterator[tuple[Booleans, float]]:
    """Mask (n,) of `lowered` without the joints that need not be lowered, and its largest safe factor; nothing if all must be.

    A joint need not be lowered if the others, lowered by slightly more than `factor`, meet the requirements while its gains stay. Mirror
    images keep their gains together or not at all.
    """
    if not (0 < factor < 1 and np.count_nonzero(lowered) <= MOST_TRIED):
        return
    fewer, least = lowered, factor**HARDLY_MORE
    for first in sorted(np.flatnonzero(lowered).tolist(), key=lambda k: -result.joints[k].limit):
        group = _images(result, first)
        without = fewer & ~group
        if fewer[first] and without.any() and result.seen_at(without, least):
            fewer = without
    if np.any(fewer != lowered):
        found = result.seen_factor(fewer, 1.0)
        yield fewer, found if found >= least else least


def _images(result: AuditOfGains, first: int, near: float = ALIKE) -> Booleans:
    """Joints (n,) with the gains of joint `first` that are its mirror images by name, or have the same limit."""
    one, of = result.joints[first], image_groups(result.system.source.joint_names)
    same = [(one.kp, one.kd, one.ki) == (other.kp, other.kd, other.ki) for other in result.joints]
    alike = [of[k] == of[first] or math.isclose(one.limit, other.limit, rel_tol=near) for k, other in enumerate(result.joints)]
    return np.array(same) & np.array(alike)


def _with_images(result: AuditOfGains, lowered: Booleans) -> Booleans:
    """Joints (n,) together with their mirror images, whose gains are lowered together: limbs that take turns have the same gains."""
    of, with_images = np.array(image_groups(result.system.source.joint_names)), lowered.copy()
    for first in np.flatnonzero(lowered).tolist():
        with_images |= _images(result, first, near=0.0) & (of == of[first])
    return with_images
