"""A coupled loop in the core, by its modes: the first common factor on all gains, from 1 on, that puts a root on the boundary, proved.

Known for gains of joints or of directions, with encoders on the motors' side (native/include/gainroom/exclusion.hpp, coupled_limit.hpp).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np

from ..native import _core
from ..system.assembly import current_loop
from ..system.controller import gain_matrix
from ..system.linear.arrays import Complexes, Floats, Integers, distinct
from ..system.linear.state_space import split_delay
from ..system.linear.transfer_function import Factored, growth
from ..system.loop import Loop
from ..system.mode_functions import mode_functions
from ..system.modes import Modes
from .equal_modes import SHIFT, common_mode, null_vectors
from .gain_directions import gain_directions
from .margin_record import NUDGE

NARROWEST = 1e-4  # relative width of an interval that the core does not halve further
FINEST, MOST, LOOKS = 1e-9, 200, 60  # intervals decided by eigenvectors of L: least relative width, most samples each, most of them
MOST_TWOFOLD = 3  # channels of asymmetric gains up to which the proof is tried: of more, samples of loci are quicker
COUPLED = 1e-9  # vᵀ v' of two eigenvectors below which it is round-off
FACTORS = (3.0, 2.7)
"""Largest ratio of the ends of the first intervals of frequency; units are chosen in the middle of each.

The second is tried where the proof fails with the first, as round-off may make it.
"""


@dataclass(frozen=True)
class ModalLoop:
    """A coupled loop in the core.

    plant     modes of the plant
    modes     modes of the plant as the channels see and move them
    corners   (k,) rad/s: resonances, and half of the way to half the sample rate; intervals begin there
    law_corners   (k,) rad/s: the corner frequencies of its laws
    leads     (n,) [s] lead of each joint's law less all lags at ω = 0: d arg/dω there
    turns     (n,) [s] sum of the sizes of all leads and lags in d arg/dω
    last      half the sample rate [rad/s]; None: continuous
    passive   the motors give out no energy at any frequency, Re(jω P) >= 0: without a hold between. Gravity takes and gives none either
    torque    X (n, r) where the channels are not all joints: those that have gains, or directions (gain_directions.py); None: they are all
    folds     2 where every channel is there twice, as F is not symmetric (exclusion.hpp): then det F is squared; else 1
    laws      the laws whose inverses are d; late (n,) [s]: the delays behind them
    turning   [s] part of `turns` due to hold, current loop and fraction of a tick, where sampled
    """

    core: "_core.ModalLoop"
    plant: Modes
    modes: Modes
    laws: "Laws"
    late: Floats
    turning: float
    corners: Floats
    law_corners: Floats
    leads: Floats
    turns: Floats
    last: float | None
    passive: bool
    torque: Floats | None
    folds: int

    @classmethod
    def of(cls, loop: Loop) -> "ModalLoop | None":
        """Modal form of a coupled loop; None for a loop of which no proof is known.

        No proof is known for link-side feedback, friction to ground, gains without directions (gain_directions.py), different drives of a
        sampled loop or with coupled gains, and controllers that are unstable by themselves but for integrators.
        """
        parts, step = loop.parts, loop.sample_time
        if parts is None or loop.size == 1 or not parts.feedback.motor or loop.gain <= 0:
            return None
        plant, drives, torque, twofold = parts.plant.modes, parts.drives, None, False
        terms = {powers: gain_matrix("gain", gain, loop.size) for powers, gain in parts.controller.terms().items()}
        if plant is None or not terms:
            return None
        modes = plant
        gains = {powers: np.diagonal(gain) for powers, gain in terms.items()}
        counts = {powers: np.count_nonzero(own) for powers, own in gains.items()}
        if any(np.count_nonzero(terms[powers]) != count for powers, count in counts.items()):
            directions = gain_directions(terms, parts.plant.units)
            if directions is None or any(drive != drives[0] for drive in drives):
                return None
            gains, twofold = directions.gains, not directions.symmetric
            if twofold and directions.torque.shape[1] > MOST_TWOFOLD:
                return None
            modes = modes.twofold(directions.measured, directions.torque) if twofold else modes.along(directions.measured)
            torque, drives = directions.torque, (drives[0],) * len(modes.rigid)
        elif max(counts.values()) < loop.size and 0 < np.count_nonzero(acting := np.any(list(gains.values()), axis=0)) < loop.size:
            torque = np.eye(loop.size)[:, acting]
            modes, gains = plant.along(torque.T), {powers: gain[acting] for powers, gain in gains.items()}
            drives = tuple(drive for drive, acts in zip(drives, acting, strict=True) if acts)
        channels = parts.controller.apart(gains, step)
        if len(shared := channels[0].poles):  # by all of them
            if np.any((growth(shared, step) >= 0) & (shared != 0)):
                return None
            if np.any(shared == 0):
                channels = [law.reduced for law in channels]
        behind: list[Factored] = []
        if step is None:
            currents = {drive: current_loop(drive) for drive in set(drives)}
            behind = [currents[drive] for drive in drives]
        laws = Laws.of(channels * (2 if twofold else 1), loop.gain, behind)
        if np.any(laws.gains <= 0):
            return None
        corners, first, delays = np.abs(modes.poles.imag), drives[0], np.array([drive.delay for drive in drives])
        core = mode_functions(parts, modes, twofold)
        if core is None:
            return None
        if step is None:
            late, lag, turning = delays, 0.0, 0.0
        else:
            whole, part = split_delay(delays, step)
            late, corners = whole * step, np.append(corners, 0.5 * np.pi / step)
            hold = (0.5 + float(part[0])) * step
            lag, turning = (hold, hold) if first.is_ideal else (hold + 2 * ratio / first.bandwidth for ratio in (first.damping_ratio, 1.0))
        core.set_laws(laws.zeros, laws.poles, laws.counts, laws.gains, late)
        leads, turns = laws.turns()
        return cls(
            core,
            plant,
            modes,
            laws,
            np.asarray(late),
            turning,
            distinct(corners),
            distinct(np.abs(np.concatenate([laws.zeros, laws.poles]))),
            leads - late - lag,
            turns + late + turning,
            None if step is None else np.pi / step,
            step is None and not twofold,
            torque,
            2 if twofold else 1,
        )

    def crossings(self, start: float, stop: float, low: float, high: float, counting: bool = False) -> "ProvedCrossings | None":
        """Factors on all gains between `start` (0: from rest) and `stop` that put a root at jω, low <= ω <= `high`; nearest first, proved.

        None where the proof failed. No crossings in the result: it is proved that there are none.
        """
        tried = (self._crossings(self._grid(low, high, factor), start, stop, counting) for factor in FACTORS)
        return next((found for found in tried if found is not None), None)

    def _crossings(self, grid: Floats, start: float, stop: float, counting: bool) -> "ProvedCrossings | None":
        """Crossings as of `crossings`, from the intervals of ω between neighbours in `grid` (k + 1,); None where the proof failed."""
        bases = self._rigid_bases(grid)
        proved, places, vectors, undecided, turns = self.core.limit(grid, start, stop, NUDGE, NARROWEST, self.passive, counting, bases)
        way = math.copysign(1.0, stop - start)
        before = float(places[0, 1]) * (1 - NUDGE) ** way if len(places) else stop
        more = 0.0 if proved else self._excluded(undecided, start, before, counting)
        if more is None:
            return None
        turned = turns[0] + more
        found = [Crossing(omega, gain, growth, vector) for (omega, gain, growth), vector in zip(places.tolist(), vectors, strict=True)]
        return ProvedCrossings(found, turned / self.folds, turns[1] / self.folds, turns[2])

    def mode(self, crossing: "Crossing", loop: Loop) -> Complexes:
        """Mode shape (n,) of a crossing: measured positions of `loop`, the largest part 1, of all joints that vibrate at that factor."""
        (mobility,), (laws,) = self._unfolded(np.array([crossing.omega]))
        size, root = len(laws), np.sqrt(np.abs(laws))
        there = np.diag(laws / np.abs(laws)) + crossing.gain * (1 - SHIFT) * mobility / (root[:, None] * root)
        vectors = null_vectors(there) / root[:, None]
        if vectors.shape[1] < 2:  # the one that was found is known to more digits
            vectors = crossing.vector.reshape(self.folds, size).T @ np.array([[1.0], [1j]])[: self.folds]
        if self.torque is None:
            return common_mode(vectors * laws[:, None])
        return common_mode(loop.actuated_at(np.array([1j * crossing.omega]))[0] @ (self.torque @ vectors))

    def response(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """x P (k, n, n) and d = x/c (k, n) at omega (k,), as in modal_loop.hpp."""
        functions, laws = self.core.responses(omega)
        shapes = self.modes.shapes
        return functions[:, :1, None] * self.modes.rigid + (shapes.T * functions[:, None, 1:]) @ shapes, laws

    def _unfolded(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """x P (k, n, n) and d (k, n) at `omega` (k,), each channel once, also where F is not symmetric and its channels are doubled."""
        mobility, laws = self.response(omega)
        size = laws.shape[1] // self.folds
        return mobility if self.folds == 1 else mobility[:, :size, :size] - 1j * mobility[:, :size, size:], laws[:, :size]

    def _excluded(self, undecided: Floats, start: float, stop: float, counting: bool) -> float | None:
        """Turn of arg det F [rad] over intervals of ω (k, 2) where no factor from `start` to `stop` puts a root at jω; None: undecided.

        Each interval is judged in the eigenvectors of L in its middle; what stays undecided is halved.
        """
        turned, open_ones = 0.0, [(low, high) for low, high in undecided.tolist()]
        for _ in range(LOOKS):
            if not open_ones:
                return turned
            low, high = open_ones.pop()
            middle = math.sqrt(low * high)
            basis = self._bases(np.array([middle]), start, stop)[0]
            excluded, more = (False, 0.0)
            if np.all(np.isfinite(basis)):
                excluded, more = self.core.excluded(low, high, min(start, stop), max(start, stop), basis, FINEST, MOST, counting)
            if excluded:
                turned += more
            elif high - low > FINEST * high:
                open_ones += [(low, middle), (middle, high)]
            else:
                return None
        return None

    def _bases(self, omega: Floats, start: float, stop: float) -> Complexes:
        """(k, n, n) vectors in rows that make x P and diag(d) diagonal at omega (k,).

        They are turned so that x P + diag(d)/g lies about the real axis for both ends g.
        """
        mobility, laws = self._unfolded(omega)
        root = 1 / np.sqrt(laws)
        values, right = np.linalg.eig(-root[:, :, None] * mobility * root[:, None])
        right = _apart(right) if self.folds == 1 else right
        with np.errstate(all="ignore"):
            left = right if self.folds == 1 else np.linalg.inv(right).swapaxes(1, 2)
            own = np.sum(left * right, axis=1)
            ends = [own if gain == 0 else own * (1 / gain - values) for gain in (start, stop)]
            sides = ends[0] / np.abs(ends[0]) + ends[1] / np.abs(ends[1])
            turn = np.sqrt(sides.conj() / np.abs(sides))
            left, right = ((root[:, :, None] * one * turn[:, None]).swapaxes(1, 2) for one in (left, right))
        return np.ascontiguousarray(right) if self.folds == 1 else _in_pairs(left, right)

    def _rigid_bases(self, grid: Floats) -> Complexes:
        """Bases (k, n, n) as `_bases`, of Y M₀ X and diag(|d|) in the middle of each interval, if F is not symmetric; else (0, n, n).

        Mostly real, and what L is as long as nothing resonates.
        """
        size = len(self.modes.rigid) // self.folds
        if self.folds == 1:
            return np.empty((0, size, size), dtype=complex)
        omega = np.sqrt(grid[1:] * grid[:-1])
        rigid = self.modes.rigid[:size, :size] - 1j * self.modes.rigid[:size, size:]
        root = 1 / np.sqrt(np.abs(self.core.responses(omega)[1][:, :size]))
        right = np.linalg.eig(root[:, :, None] * np.real(rigid) * root[:, None])[1]
        left, right = ((root[:, :, None] * one).swapaxes(1, 2) for one in (np.linalg.inv(right).swapaxes(1, 2), right))
        return _in_pairs(left, right)

    def _grid(self, low: float, high: float, factor: float) -> Floats:
        """Frequencies [rad/s] from `low` to `high`, each at most `factor` times the one before, with every corner frequency."""
        grid = 10.0 ** np.linspace(np.log10(low), np.log10(high), 2 + int(math.log(high / low) / math.log(factor)))
        grid[0], grid[-1] = low, high
        grid = distinct(np.concatenate([grid, self.corners[(self.corners > low) & (self.corners < high)]]))
        wide = np.ones(len(grid), dtype=bool)
        np.greater(grid[1:] - grid[:-1], NARROWEST * grid[1:], out=wide[:-1])
        grid = grid[wide]
        grid[0] = low
        return grid


class Crossing(NamedTuple):
    """Crossing of the boundary at jω, ω = `omega`, with all gains times `gain`; `growth` > 0: unstable above it; F x = 0 for `vector` x."""

    omega: float
    gain: float
    growth: float
    vector: Complexes


class ProvedCrossings(NamedTuple):
    """Crossings along a range of factors, and the turn of arg det F, F = x P + diag(d), at the factor 1 from the lowest ω to `end`.

    Above `end` I + L stays near I, and arg det(I + L) goes from `tail` to 0.
    """

    crossings: list[Crossing]
    turned: float
    tail: float
    end: float


def _apart(vectors: Complexes) -> Complexes:
    """Eigenvectors (k, n, n) of symmetric matrices, in columns, with vᵀ v' = 0 also for equal eigenvalues, as of equal limbs."""
    with np.errstate(all="ignore"):
        for one in range(1, vectors.shape[2]):
            before = vectors[:, :, :one]
            own = np.sum(before**2, axis=1)
            shares = np.einsum("kij,ki->kj", before, vectors[:, :, one]) / own
            shares[np.abs(shares) < COUPLED] = 0.0
            vectors[:, :, one] -= np.einsum("kij,kj->ki", before, shares)
    return vectors


def _in_pairs(left: Complexes, right: Complexes) -> Complexes:
    """(k, 2r, 2r) the z of exclusion.hpp from the rows y of `left` and x of `right` (k, r, r), made of like size."""
    balance = np.sqrt(np.linalg.norm(right, axis=2) / np.linalg.norm(left, axis=2))[:, :, None]
    even, odd = left * balance + right / balance, 1j * (left * balance - right / balance)
    return np.concatenate([np.concatenate([even, odd], axis=2), np.concatenate([odd, -even], axis=2)], axis=1) / 2


@dataclass(frozen=True)
class Laws:
    """Controllers of n joints as zeros, poles and gains: all zeros and poles joined, their counts (n, 2) by joint, gains (n,)."""

    zeros: Complexes
    poles: Complexes
    counts: Integers
    gains: Floats

    @classmethod
    def of(cls, laws: Sequence[Factored], factor: float, behind: Sequence[Factored]) -> "Laws":
        """Laws of n joints with all gains times `factor`, each followed by the filter of `behind`, if there are any."""
        parts = [laws, behind] if behind else [laws]
        in_turn = [one for of_one in zip(*parts, strict=True) for one in of_one]
        return cls(
            np.concatenate([one.zeros for one in in_turn]).astype(complex, copy=False),
            np.concatenate([one.poles for one in in_turn]).astype(complex, copy=False),
            np.sum([[[len(one.zeros), len(one.poles)] for one in part] for part in parts], axis=0),
            reduce(np.multiply, [[one.gain for one in part] for part in parts], factor),
        )

    def turns(self) -> tuple[Floats, Floats]:
        """Phase slope d arg/dω of each law at ω = 0 (n,) [s], and the sum of its parts' sizes (n,) [s]; infinite with roots at 0."""
        leads, turns = self.finite_turns()
        if self.zeros.all() and self.poles.all():
            return leads, turns
        none = self._sum(1.0 * (self.zeros == 0), 1.0 * (self.poles == 0), 1) > 0
        return np.where(none, -np.inf, leads), np.where(none, np.inf, turns)

    def finite_turns(self) -> tuple[Floats, Floats]:
        """Phase slope d arg/dω of each law at ω = 0 (n,) [s] by its roots that are not 0, and the sum of the parts' sizes (n,) [s]."""
        zeros, poles = (np.divide(1.0, roots, out=np.zeros_like(roots), where=roots != 0) for roots in (self.zeros, self.poles))
        return self._sum(-zeros.real, poles.real, 1), self._sum(np.abs(zeros), np.abs(poles), 1)

    def at_rest(self) -> tuple[Complexes, Integers]:
        """Limit of each law c vᵏ at v = 0 (n,), and k (n,): c is 0 there where k < 0, and has integrators where k > 0."""
        zeros, poles = (np.log(np.where(roots == 0, 1, -roots)) for roots in (self.zeros, self.poles))
        orders = -self._sum(1.0 * (self.zeros == 0), 1.0 * (self.poles == 0), -1)
        return self.gains * np.exp(self._sum(zeros, poles, -1)), orders.astype(int)

    def turned(self, omega: float, step: float | None) -> Floats:
        """Turn of arg c [rad] of each law (n,) from ω = 0+ to `omega` [rad/s]."""

        def turns(roots: Complexes) -> Floats:
            if step is None:
                ends = (np.arctan2(at - roots.imag, np.abs(roots.real)) for at in (omega, 0.0))
                return np.sign(-roots.real) * np.subtract(*ends)
            z, turn = 1 + step * roots, np.exp(1j * omega * step)
            inside = np.abs(z) <= 1
            ends = [np.angle(np.where(inside, 1 - z / one, 1 - one / np.where(z == 0, 1, z))) for one in (turn, 1.0)]
            return np.where(roots == 0, omega * step / 2, np.where(inside, omega * step, 0.0) + ends[0] - ends[1])

        return self._sum(turns(self.zeros), turns(self.poles), -1)

    def _sum(self, zeros: Floats, poles: Floats, sign: int) -> Floats:
        """Sums (n,) over each law's zeros plus `sign` times the sum over its poles."""
        parts = np.concatenate([zeros, sign * poles])
        total = np.zeros(len(self.gains), dtype=np.result_type(parts, float))
        np.add.at(total, self._owners, parts)
        return total

    @cached_property
    def _owners(self) -> Integers:
        """Index of the law (joint) of each zero, and of each pole."""
        return np.concatenate([np.repeat(np.arange(len(self.gains)), counts) for counts in self.counts.T])
