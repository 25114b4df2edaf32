"""Gains of coupled loops, raised one by one until none can be raised further without breaking a requirement in some case.

A direction is a joint, or one of a task. Beginning with gains that hold in every case, the softest direction is raised first, by its
stiffness relative to what it is measured by, with as much damping as it takes; whatever cannot be raised is left, and the others go on.
So all are equally stiff as far as they can be, and what one cannot use others may. Steps become smaller until RAISE.

Directions that are alike (the legs of a biped) are raised together, and one by one only where that gains anything. Steps are told by
screen.py; after each round every case is looked at with kept.py, and where the screen erred the round is done again with that case, or
only as far as it holds. What is returned has been checked so, and so has that no direction can be raised.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import Booleans, Floats, Integers
from .errors import GainroomError
from .kept import Kept
from .screen import Case, Gains, Screen, misses

RAISE = 1.05
"""No stiffness can be raised by this factor, whether its damping stays or rises as much."""
STEPS = (4.0, 2.0, 1.4, 1.18, 1.05)
TOGETHER = 1.012  # the last step of directions that are alike: then one of them alone hardly ever gains RAISE
ALONE = 1.04  # the last step of every direction: with what the screen allows for doubt less than RAISE
DAMPINGS = (0.0, 0.5, 1.0, -0.5)  # powers of the factor on a stiffness that are tried as the factor on its damping
ONES = 8  # rounds in which what was found is looked at again


@dataclass(frozen=True)
class Raised:
    """Gains of which none can be raised.

    gains    (3, m)
    kept     what each case keeps, in the order of the cases
    margin   per direction which requirement breaks if it is raised: a field of Requirements, "stability", or "" where nothing limits it
    case     and the case in which it does, by its index; −1: none
    """

    gains: Gains
    kept: tuple[Kept, ...]
    margin: tuple[str, ...]
    case: tuple[int, ...]


@dataclass
class _State:
    """Where a search is."""

    gains: Gains
    active: list[int]


def stiffer(gains: Gains, which: Sequence[int], factor: float, power: float, cascade: Booleans) -> Gains:
    """`gains` with the stiffness of some directions times `factor`, and their damping times factor^power.

    The stiffness of a P/PI direction is kp·kv, its damping kv, and ki goes with the stiffness.
    """
    found, columns = gains.copy(), list(which)
    damping = factor**power
    found[0, columns] *= np.where(cascade[columns], factor / damping, factor)
    found[1, columns] *= damping
    found[2, columns] *= factor
    return found


def raised_gains(
    cases: Sequence[Case],
    start: Gains,
    unit: Floats,
    groups: Sequence[Sequence[int]],
    most: float,
    progress: Callable[[], None] = lambda: None,
) -> Raised:
    """The gains that are reached from `start`, which holds in every case.

    unit     (m,) what the stiffness of each direction is measured by: equal shares of it are equally stiff
    groups   the directions that may be raised, those that are alike together
    most     times `unit`: beyond this nothing limits a stiffness

    Raises GainroomError without cases or requirements, and where `start` does not hold.
    """
    if not cases or not any(case.required.asked for case in cases):
        raise GainroomError("raised_gains needs at least one case and one requirement")
    kept = [case.kept(start) for case in cases]
    if not _all_meet(cases, kept):
        raise GainroomError("raised_gains needs gains to begin with that keep what is required")
    search = _Search(cases, unit, most, progress)
    state = _State(start, [int(np.argmax([one.shortfall(case.required) for one, case in zip(kept, cases, strict=True)]))])
    singles = [[j] for group in groups for j in group]
    search.round(state, groups, STEPS)
    if len(singles) > len(groups):
        search.round(state, groups, (TOGETHER,))
    search.round(state, singles, (ALONE,))
    return search.proved(state, [j for group in groups for j in group])


def _all_meet(cases: Sequence[Case], kept: Sequence[Kept]) -> bool:
    return all(one.meets(case.required) for one, case in zip(kept, cases, strict=True))


class _Search:
    def __init__(self, cases: Sequence[Case], unit: Floats, most: float, progress: Callable[[], None]) -> None:
        self._cases, self._unit, self._most, self._progress = cases, unit, most, progress
        self._cascade = cases[0].cascade

    def round(self, state: _State, groups: Sequence[Sequence[int]], steps: Sequence[float]) -> None:
        """Raise by each factor of `steps`, the softest first, until nothing can be; with the last, begin anew as long as anything was."""
        while True:
            found = self._climbed(state, groups, steps)
            worst = self._broken(found)
            if worst is None:
                state.gains = found
                return
            if worst in state.active:
                state.gains = self._as_far_as_it_holds(state.gains, found)
                return
            state.active.append(worst)  # and once more from where the round began

    def _climbed(self, state: _State, groups: Sequence[Sequence[int]], steps: Sequence[float]) -> Gains:
        """As far as the screens of the active cases allow."""
        gains = state.gains
        screens = [Screen(self._cases[k], gains, self._cases[k].samples(gains), steps[0]) for k in state.active]
        for factor in steps:
            for screen in screens:
                screen.expect(factor)
            moved = True
            while moved:
                gains, moved = self._once(screens, gains, groups, factor)
                moved = moved and factor == steps[-1]
        return gains

    def _once(self, screens: Sequence[Screen], gains: Gains, groups: Sequence[Sequence[int]], factor: float) -> tuple[Gains, bool]:
        """Every group raised as often as that is allowed, and whether any was."""
        moved, left = False, list(groups)
        while left:
            group = min(left, key=lambda group: self._stiffness(gains, group))
            found = self._raised(screens, gains, group, factor)
            self._progress()
            if found is None:
                left.remove(group)
            else:
                gains, moved = found, True
        return gains, moved

    def _stiffness(self, gains: Gains, group: Sequence[int]) -> float:
        kp, kd, _ = gains[:, list(group)]
        return float((np.where(self._cascade[list(group)], kd * kp, kp) / self._unit[list(group)]).min())

    def _raised(self, screens: Sequence[Screen], gains: Gains, group: Sequence[int], factor: float) -> Gains | None:
        """With a group raised by `factor`, where that is allowed with any damping."""
        if self._stiffness(gains, group) * factor > self._most:
            return None
        for power in DAMPINGS:
            found, done = stiffer(gains, group, factor, power, self._cascade), []
            if len(group) > 1 and not all(screen.allows(j, found) for screen in screens for j in group):
                continue  # what one of them may not, all together hardly ever may
            for j in group:
                if not all(screen.allows(j, found) for screen in screens):
                    break
                for screen in screens:
                    screen.take(j, found)
                done.append(j)
            if len(done) == len(group):
                for screen in screens:
                    screen.settle()
                return found
            for j in done:
                for screen in screens:
                    screen.take(j, gains)
        return None

    def _broken(self, gains: Gains) -> int | None:
        """The case that misses its requirement most; None where all are kept."""
        missed = [(kept.shortfall(case.required), self._cases.index(case)) for case, kept in misses(self._cases, gains, self._progress)]
        return max(missed)[1] if missed else None

    def _as_far_as_it_holds(self, inside: Gains, outside: Gains) -> Gains:
        """Between gains that hold in every case and gains that do not, by halves."""
        way = np.divide(outside, inside, out=np.ones_like(inside), where=inside != 0)
        low, high = 0.0, 1.0
        while high - low > 0.1:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._broken(inside * way**middle) is None else (low, middle)
        return inside * way**low

    def proved(self, state: _State, free: Sequence[int]) -> Raised:
        """Every direction raised by RAISE breaks something; where one does not, it is raised and all are looked at again."""
        gains, cases = state.gains, self._cases
        order = [*state.active, *(k for k in range(len(cases)) if k not in state.active)]
        why: dict[int, tuple[str, int]] = {}
        for _ in range(ONES * len(free)):
            left = [j for j in free if j not in why]
            if not left:
                break
            j = min(left, key=lambda j: self._stiffness(gains, [j]))
            if self._stiffness(gains, [j]) * RAISE > self._most:
                why[j] = "", -1
                continue
            for power in (0.0, 1.0):
                found = stiffer(gains, [j], RAISE, power, self._cascade)
                broken = self._first_broken(found, order)
                if broken is None:
                    gains, why = found, {}
                    break
                why.setdefault(j, broken)
                order.remove(broken[1])
                order.insert(0, broken[1])
        size = gains.shape[1]
        told = [why.get(j, ("", -1)) for j in range(size)]
        return Raised(gains, tuple(case.kept(gains) for case in cases), tuple(name for name, _ in told), tuple(k for _, k in told))

    def _first_broken(self, gains: Gains, order: Sequence[int]) -> tuple[str, int] | None:
        """What is broken first, and the case; None where nothing is."""
        for case, kept in misses([self._cases[k] for k in order], gains, self._progress):
            return kept.missed(case.required), self._cases.index(case)
        return None


def alike(keys: Sequence[Hashable], free: Integers) -> list[list[int]]:
    """Directions `free` in groups that have the same key."""
    found: dict[Hashable, list[int]] = {}
    for j in free.tolist():
        found.setdefault(keys[j], []).append(j)
    return list(found.values())
