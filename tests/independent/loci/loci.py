"""The characteristic loci of coupled loops along the stability boundary: the eigenvalues λ of L(jω), sampled and followed.

det(I + z L(jω)) = 0 exactly where an eigenvalue equals −1/z. So the loci show where any common factor z puts a root on the boundary: a
gain where they cross the negative real axis, a phase or a delay where they cross the unit circle; and their turns around −1/z count the
unstable roots (Nyquist, MacFarlane and Postlethwaite 1977). L is sampled once, as finely as the loci need, for all of these.

Between neighbouring samples an eigenvalue turns by a part of its angle to the negative real axis, or moves by a small part of itself. That
is a check, not a proof as for one joint (crossings.py); what is reported is polished, and counted on both sides.

A limit alone needs few samples: loci too small to matter are excluded by a norm.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gainroom.analysis.stability_boundary import first_grid, in_blocks, longest_delay
from gainroom.errors import GainroomError
from gainroom.native import _core
from gainroom.system.linear.arrays import Booleans, Complexes, Floats, Integers, distinct
from gainroom.system.loop import Loop

from .resolution import LOCI, Boundary, round_off
from .sampled_curves import TURNS, may_pass_unseen, side, with_ends


@dataclass(frozen=True)
class Steps:
    """Every eigenvalue from one sample to the next. All arrays (k − 1, n).

    start, end   λ at both samples, paired by nearness
    """

    start: Complexes
    end: Complexes


class Sweep:
    """Samples of the loci of a loop, refined on demand. `omega` (k,) [rad/s] rising, `loci` (k, r), r <= n of them.

    highest    of the requested factors: eigenvalues smaller than 1/highest are not followed
    for_limit  what a limit needs and no more: those smaller ones are set to 0
    """

    def __init__(self, loop: Loop, highest: float = LOCI.highest, for_limit: bool = False) -> None:
        self.loop, self.highest, self._for_limit = loop, highest, for_limit
        self.boundary = Boundary(loop)
        self.last, self.undamped = self.boundary.last, self.boundary.undamped
        grid = first_grid(loop, self.last)
        self._longest = longest_delay(loop)
        self.first = float(grid[0])  # lower than all corner frequencies of the loci
        self.omega = distinct(np.append(grid, LOCI.beside * grid[:1]))
        self.largest = 0.0
        self._lowest = (math.nan, np.zeros(0))
        self._bottom = False  # True where round-off hides what is further down
        self.loci = self._eigenvalues(self.omega)
        self._pairs = _core.paired(self.loci[:-1], self.loci[1:])
        self._reach_ends()
        self._refine(self._rough)
        self.show_crossings(side)

    @property
    def lag(self) -> float:
        """[s] of the slowest joint's delay, hold and current loop together."""
        drives = [] if self.loop.parts is None else self.loop.parts.drives
        return self._longest + max((2 * drive.damping_ratio / drive.bandwidth for drive in drives), default=0.0)

    @property
    def full(self) -> bool:
        """No more samples are taken: the loci of this loop cannot be followed."""
        return len(self.omega) > max(LOCI.most, 30 * LOCI.most // self.loop.size**2)

    def add(self, omega: Floats) -> None:
        """Take samples at more frequencies."""
        fresh = distinct(omega[omega > 0])
        if self.last is not None:
            fresh = fresh[fresh <= self.last]
        place = np.searchsorted(self.omega, fresh)
        unknown = np.append(self.omega, math.inf)[place] != fresh
        fresh, place = fresh[unknown], place[unknown]
        if not len(fresh) or self.full:
            return
        values = self._eigenvalues(fresh)
        split = np.zeros(len(self.omega) + 1, dtype=bool)  # intervals of before, with what lies outside on either side
        split[place] = True
        is_new = np.zeros(len(self.omega) + len(fresh), dtype=bool)
        is_new[place + np.arange(len(fresh))] = True
        unchanged = ~is_new[:-1] & ~is_new[1:]
        self.omega, self.loci = _merged(is_new, self.omega, fresh), _merged(is_new, self.loci, values)
        pairs = np.empty((len(self.omega) - 1, self.loci.shape[1]), dtype=int)
        pairs[unchanged] = self._pairs[~split[1:-1]]
        rows = np.flatnonzero(~unchanged)
        pairs[rows] = _core.paired(self.loci[rows], self.loci[rows + 1])
        self._pairs = pairs

    def steps(self, rows: Integers | None = None) -> Steps:
        """The loci from sample to sample, of all, or from those at `rows`."""
        rows = np.arange(len(self._pairs)) if rows is None else rows
        return Steps(self.loci[rows], self.loci[rows[:, None] + 1, self._pairs[rows]])

    def at_rest(self) -> Floats:
        """The loci that settle as ω → 0, which are real there: gravity holds the joints, or makes them topple, against these."""
        plant = None if self.loop.parts is None else self.loop.parts.plant
        if plant is None or plant.gravity_stiffness is None:
            return np.zeros(0)
        here, settled = self._eigenvalues(1e-6 * self.omega[:1])[0], self.loci[0][np.abs(self._falls()) < 0.5]
        return here[np.any(np.abs(np.abs(here[:, None]) - np.abs(settled)) < 0.1 * np.abs(settled), axis=1)].real

    def mode_at_rest(self, value: complex) -> Complexes:
        """The measured positions (n,) of the locus that settles at `value`, the largest part 1."""
        return self.boundary.mode(1e-6 * float(self.omega[0]), value)

    def _refine(self, rough: Callable[[Integers], Booleans]) -> None:
        """Halve intervals that are `rough`, which tells of those that begin at some samples, until none is; what was not rough stays so."""
        rows = np.arange(len(self._pairs))
        for _ in range(60):
            rows = rows[rough(rows)]
            rows = rows[self.omega[rows + 1] - self.omega[rows] > LOCI.closest * self.omega[rows + 1]]
            if not len(rows) or self.full:
                break
            middle = _middle(self.omega[rows], self.omega[rows + 1])
            self.add(middle)
            right = np.searchsorted(self.omega, middle)
            rows = distinct(np.concatenate([right - 1, right]))

    def show_crossings(self, off: Callable[[Complexes], Floats]) -> None:
        """Halve intervals on which a locus may pass a line unseen (may_pass_unseen), until samples show all its crossings."""
        for _ in range(60):
            pairs, steps = self._pairs, self.steps()
            size = np.maximum(np.abs(steps.start), np.abs(steps.end))
            room = np.minimum(np.abs(off(steps.start)), np.abs(off(steps.end)))
            seen = (room < TURNS) & (size * self.highest > 1) & (size < LOCI.large)  # larger ones no factor that is searched brings to −1
            seen &= room * size > LOCI.noise * np.maximum(size.max(axis=1, keepdims=True), 1.0)
            rows, columns = np.nonzero(seen)
            came, goes = np.zeros((2, *self.loci.shape), dtype=int)  # which locus each is a sample before, and after
            came[np.arange(1, len(came))[:, None], pairs] = np.arange(pairs.shape[1])
            goes[:-1] = pairs
            around, loci = rows + np.arange(4)[:, None], with_ends(self.loci)
            branches = came[rows, columns], columns, goes[rows, columns], goes[rows + 1, goes[rows, columns]]
            found = distinct(rows[may_pass_unseen(loci[around, branches], with_ends(self.omega)[around], off)])
            found = found[self.omega[found + 1] - self.omega[found] > LOCI.closest * self.omega[found + 1]]
            if not len(found) or self.full:
                return
            self.add(_middle(self.omega[found], self.omega[found + 1]))

    def unstable(self, gain: float, phase: float = 0.0, delay: float = 0.0) -> int:
        """Unstable closed-loop roots with L multiplied by gain e^{−j(phase + ω delay)}, as far as the gains move them.

        gain <= highest. `phase` [rad] in [−π, π] turns every locus alike, which no loop of real gains does: then the number is only the
        difference of the turns about −1 from those without it, and may be negative. `delay` [s] in continuous time.
        """
        self._reach_down(gain)

        def doubtful(rows: Integers) -> Booleans:
            steps, omega = self.steps(rows), self.omega[rows]
            before = steps.start * _factor(omega, gain, phase, delay)[:, None]
            after = steps.end * _factor(self.omega[rows + 1], gain, phase, delay)[:, None]
            # A delay turns a locus further between samples than its ends show, where it is large enough to reach −1.
            width = self.omega[rows + 1] - omega
            winds = (width * delay > 0.3) | (width * self._longest > LOCI.turn)
            winds &= np.maximum(np.abs(before), np.abs(after)).max(axis=1) > 0.5
            return winds | np.any(passes(before, after), axis=1)

        self._refine(doubtful)
        factor, steps = _factor(self.omega, gain, phase, delay), self.steps()
        before, after = 1 + steps.start * factor[:-1, None], 1 + steps.end * factor[1:, None]
        turned = float(np.sum(np.angle(after * before.conj())))
        # From ω = 0+ to the first sample: integrators point along their own value there, times e^{−j phase}/jᵏ; what settles is real.
        orders = np.maximum(np.round(self._falls()), 0.0)
        own = self.loci[0] * 1j**orders
        own = np.where(np.abs(own.imag) < LOCI.real * np.abs(own), np.sign(own.real), own)
        settled = np.sign((1 + gain * self.loci[0]).real)
        turned += float(np.sum(np.angle(before[0] * np.where(orders > 0, (own * np.exp(-1j * phase)).conj() * 1j**orders, settled))))
        turned -= phase * np.count_nonzero(orders > 0)
        if self.last is None:
            turned -= float(np.sum(np.angle(1 + factor[-1] * self.loci[-1])))  # from the last sample to infinity, where L is 0
        elif phase:
            turned -= float(np.sum(np.angle((1 + factor[-1] * self.loci[-1]) * np.sign((1 + gain * self.loci[-1]).real))))
        return round(self.loop.unstable_poles + float(orders.sum()) / 2 - turned / math.pi)

    @cached_property
    def _slowest(self) -> float:
        """A tenth of the lowest frequency [rad/s] at which one gain takes over from another; inf where there is but one."""
        return 0.1 * self.loop.parts.controller.slowest(self.loop.size) if self.loop.parts is not None else math.inf

    def _reach_down(self, gain: float) -> None:
        """Down to where double integrators rule at this gain too, and to where settled loci are clearly on one side of −1/gain."""
        for _ in range(20):
            falls, one = self._falls(), 1 + gain * self.loci[0]
            orders, known = np.round(falls), falls != 0  # what is lost in round-off would be no better further down
            unsettled = (orders > 1) & (gain * np.abs(self.loci[0]) < 100)
            unsettled |= known & (orders == 0) & (np.abs(one.imag) > 0.1 * np.abs(one.real))
            if not unsettled.any() or self._bottom or self.omega[0] < LOCI.lowest * self.omega[-1]:
                break
            self._further_down(lambda falls, orders=orders: (orders > 0) & (np.abs(falls - np.round(falls)) > LOCI.astray))

    def _further_down(self, lost: Callable[[Floats], Booleans]) -> None:
        """Take samples further down, unless round-off has `lost` a locus there: it would turn every count."""
        above, lowest = (self.omega, self.loci, self._pairs, self._lowest), self.omega[0] / 16
        self.add(np.array([lowest, LOCI.beside * lowest, 4 * lowest]))
        if np.any(lost(self._falls())):
            self.omega, self.loci, self._pairs, self._lowest = above
            self._bottom = True

    @property
    def _blurred(self) -> Booleans:
        """(r,) loci whose fall at the lowest sample may be round-off.

        Where gains take over from each other, zeros without much damping bend loci as steeply: there only what is small beside the
        round-off of the largest one is lost.
        """
        size = np.abs(self.loci[0])
        noise = float(round_off(self.loop, self.omega[:1])[0]) * size.max()
        return (noise > LOCI.blurred * size) | (self.omega[0] < self._slowest)

    def _falls(self) -> Floats:
        """(r,) how each locus falls at the lowest sample, as 1/ωᵏ: k; 0 where it is lost in round-off."""
        if self._lowest[0] != self.omega[0]:
            self.add(LOCI.beside * self.omega[:1])
            size, after = np.abs(self.loci[0]), np.abs(self.loci[1][self._pairs[0]])
            known = (size > max(1e-9, LOCI.noise * size.max())) & (after > 0)
            falls = np.log(np.divide(size, after, out=np.ones(len(size)), where=known)) / math.log(self.omega[1] / self.omega[0])
            self._lowest = float(self.omega[0]), falls
        return self._lowest[1]

    def _eigenvalues(self, omega: Floats) -> Complexes:
        return in_blocks(self._eigenvalues_of, omega, self.loop.size)

    def _eigenvalues_of(self, omega: Floats) -> Complexes:
        matrices = self.boundary.core(omega)
        sizes = np.abs(matrices)
        bound = np.minimum(sizes.sum(axis=1).max(axis=1), sizes.sum(axis=2).max(axis=1))
        if not np.all(np.isfinite(bound)):
            raise GainroomError(
                "loop: it cannot be computed, as its response is not finite: look for values that are many orders of magnitude off"
            )
        self.largest = max(self.largest, float(bound.max()))
        if not self._for_limit:
            return np.linalg.eigvals(matrices)
        values = np.zeros(matrices.shape[:2], dtype=complex)
        matters = bound * self.highest >= 0.5  # of the others none comes near −1/highest
        values[matters] = np.linalg.eigvals(matrices[matters])
        return values

    def _reach_ends(self) -> None:
        """Down to where integrators rule, up to where the loci have become small."""
        for _ in range(40):
            falls = self._falls()
            settled = np.all(np.abs(falls - np.round(falls)) < 0.05) and self.omega[0] < self._slowest
            settled &= self._for_limit or not np.any((falls > 0.5) & (np.abs(self.loci[0]) < LOCI.outside))
            if settled or self._bottom or np.abs(self.loci[0]).max() > LOCI.huge or self.omega[0] < 1e3 * LOCI.lowest * self.omega[-1]:
                break
            self._further_down(lambda falls: (np.abs(falls - 1) > LOCI.steepest) & self._blurred)
        while self.last is None and np.abs(self.loci[-1]).max() * self.highest > 1 and self.omega[-1] < 1e12 * self.omega[0]:
            self.add(self.omega[-1] * np.array([1.5, 2.0]))

    def _rough(self, rows: Integers) -> Booleans:
        """True where a locus moves so far between samples, and so near the negative real axis, that where it crosses is in doubt."""
        steps = self.steps(rows)
        size = np.maximum(np.abs(steps.start), np.abs(steps.end))
        away = math.pi - np.maximum(np.abs(np.angle(steps.start)), np.abs(np.angle(steps.end)))
        turned, grown = np.abs(np.angle(steps.end * steps.start.conj())), np.abs(_size(steps.end) - _size(steps.start))
        move = np.abs(steps.end - steps.start)
        # Far beyond −1 the loci of integrators fall along straight lines, on which a step of a decade loses nothing.
        far = np.where(size > LOCI.large, turned * size, move) > LOCI.smooth * size
        seen = size > np.maximum(1 / self.highest, LOCI.noise * size.max(axis=1, keepdims=True))
        return np.any(((turned > LOCI.detour * away) | (grown > LOCI.growth)) & far & seen, axis=1)


def _merged(is_new: Booleans, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Rows `old` and `new`, the new ones where `is_new`."""
    merged = np.empty((len(is_new), *old.shape[1:]), dtype=old.dtype)
    merged[is_new], merged[~is_new] = new, old
    return merged


def _factor(omega: Floats, gain: float, phase: float, delay: float) -> Complexes:
    """(k,) what multiplies the loci at ω (k,)."""
    return gain * np.exp(-1j * (phase + omega * delay))


def _size(value: Complexes) -> Floats:
    """ln|λ|."""
    return np.log(np.maximum(np.abs(value), LOCI.nothing))


def passes(start: Complexes, end: Complexes) -> Booleans:
    """True where a step passes −1 at less than a third of its own length: its ends do not show on which side."""
    move = end - start
    length = np.maximum(np.abs(move), 1e-150)
    along = np.clip(((-1 - start) * move.conj()).real / length**2, 0.0, 1.0)
    return np.abs(1 + start + along * move) < 0.33 * length


def _middle(low: Floats, high: Floats) -> Floats:
    return np.where(high > 4 * low, np.sqrt(low * high), 0.5 * (low + high))
