"""A coupled loop in the core, by its modes: which common factor on all gains first puts a root on the boundary, proved without loci.

Known for gains on the diagonal, with encoders on the motors' side (native/include/gainroom/exclusion.hpp, coupled_limit.hpp).
"""

from collections.abc import Sequence
from dataclasses import dataclass
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

NARROWEST = 1e-4  # relative width of an interval that is not halved further
NUDGE = 1e-6  # relative: how far below a crossing the proof goes
FINEST, MOST, HALVINGS = 1e-9, 200, 6  # where eigenvectors have to be looked at: relative width, samples, halvings
FACTOR = 3.0  # from end to end of the intervals that are begun with, at most: units are chosen in the middle of each


@dataclass(frozen=True)
class ModalLoop:
    """A coupled loop in the core.

    modes     of its plant
    corners   (k,) rad/s: resonances, and half of the way to half the sample rate; intervals begin there
    bends     (k,) rad/s: the corner frequencies of its laws
    leads     (n,) [s] by how much more each joint's law leads than all lags at ω = 0: d arg/dω there
    turns     (n,) [s] the sum of the sizes of all that leads and lags
    last      half the sample rate [rad/s]; None: continuous
    passive   the motors give out no energy at any frequency, Re(jω P) >= 0: without gravity and without a hold between
    """

    core: "_core.ModalLoop"
    modes: Modes
    corners: Floats
    bends: Floats
    leads: Floats
    turns: Floats
    last: float | None
    passive: bool

    @classmethod
    def of(cls, loop: Loop) -> "ModalLoop | None":
        """None where no proof is known.

        With link-side feedback, gain matrices, joints without gain, different drives of a sampled loop, and controllers that are not stable
        by themselves, as with integrators.
        """
        parts, step = loop.parts, loop.sample_time
        if parts is None or loop.size == 1 or parts.feedback != "motor" or loop.gain <= 0:
            return None
        gains = [gain_matrix("gain", gain, loop.size) for gain in parts.controller.terms().values()]
        if any(np.count_nonzero(gain) != np.count_nonzero(np.diagonal(gain)) for gain in gains):
            return None
        modes, drives = parts.plant.modes, parts.drives
        if modes is None:
            return None
        laws = _Laws.of(parts.controller.on_joints(loop.size, step), loop.gain)
        if np.any(laws.gains <= 0) or np.any(growth(laws.poles, step) >= 0):
            return None
        corners, first, delays = np.abs(modes.poles.imag), drives[0], np.array([drive.delay for drive in drives])
        core = mode_functions(parts)
        if core is None:
            return None
        if step is None:
            currents = {drive: current_loop(drive) for drive in set(drives)}
            laws = laws.times([currents[drive] for drive in drives])
            late, lag = delays, 0.0
        else:
            whole, part = split_delay(delays, step)
            late, corners = whole * step, np.append(corners, 0.5 * np.pi / step)
            lag = (0.5 + float(part[0])) * step + (0.0 if first.is_ideal else 2 * first.damping_ratio / first.bandwidth)
        core.set_laws(laws.zeros, laws.poles, laws.counts, laws.gains, late)
        leads, turns = laws.turns()
        return cls(
            core,
            modes,
            distinct(corners),
            distinct(np.abs(np.concatenate([laws.zeros, laws.poles]))),
            leads - late - lag,
            turns + late + lag,
            None if step is None else np.pi / step,
            step is None and parts.plant.gravity_stiffness is None,
        )

    def lowest_crossings(self, highest: float, low: float, high: float) -> "list[Crossing] | None":
        """Where factors on all gains below `highest` put a root at jω, low <= ω <= `high`; the first is the lowest, which is proved.

        None where that could not be proved; empty where there is none, which is proved then.
        """
        proved, places, vectors, undecided = self.core.limit(self._grid(low, high), highest, NUDGE, NARROWEST, self.passive)
        below = float(places[0, 1]) * (1 - NUDGE) if len(places) else highest
        if not proved and not all(self._excluded(start, end, below, HALVINGS) for start, end in undecided.tolist()):
            return None
        _, laws = self.core.responses(np.ascontiguousarray(places[:, 0]))
        return [Crossing(omega, gain, growth, mode) for (omega, gain, growth), mode in zip(places.tolist(), vectors * laws, strict=True)]

    def response(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """x P (k, n, n) and d = x/c (k, n) at omega (k,), as in modal_loop.hpp."""
        functions, laws = self.core.responses(omega)
        shapes = self.modes.shapes
        return functions[:, :1, None] * self.modes.rigid + (shapes.T * functions[:, None, 1:]) @ shapes, laws

    def _excluded(self, low: float, high: float, gain: float, halvings: int) -> bool:
        """Whether gains up to `gain` put no root at jω in [low, high], seen in the eigenvectors of L in the middle; else of both halves."""
        middle = float(np.sqrt(low * high))
        basis = self._basis(middle, gain)
        if not np.all(np.isfinite(basis)):
            return False
        if self.core.excluded(low, high, gain, basis, FINEST, MOST):
            return True
        return halvings > 0 and all(self._excluded(start, end, gain, halvings - 1) for start, end in ((low, middle), (middle, high)))

    def _basis(self, omega: float, gain: float) -> Complexes:
        """(n, n) vectors in rows that make x P and diag(d) diagonal, each turned so that d and x P + d/gain lie about the real axis."""
        mobility, laws = self.response(np.array([omega]))
        root = 1 / np.sqrt(laws[0])
        values, vectors = np.linalg.eig(-root[:, None] * mobility[0] * root)
        vectors = root[:, None] * vectors
        own = np.einsum("ik,i,ik->k", vectors, laws[0], vectors)
        with np.errstate(all="ignore"):
            sides = own / np.abs(own) + own * (1 / gain - values) / np.abs(own * (1 / gain - values))
            return np.ascontiguousarray((vectors * np.sqrt(sides.conj() / np.abs(sides))).T)

    def _grid(self, low: float, high: float) -> Floats:
        """From `low` to `high` in steps no longer than FACTOR, with every corner."""
        grid = np.geomspace(low, high, 2 + int(np.log(high / low) / np.log(FACTOR)))
        grid = distinct(np.concatenate([grid, self.corners[(self.corners > low) & (self.corners < high)]]))
        grid = grid[np.append(np.diff(grid) > NARROWEST * grid[1:], True)]
        grid[0] = low
        return grid


class Crossing(NamedTuple):
    """A root on the boundary at jω with all gains times `gain`; `growth`: > 0 where it goes unstable above; mode (n,) of positions."""

    omega: float
    gain: float
    growth: float
    mode: Complexes


@dataclass(frozen=True)
class _Laws:
    """The laws of n joints: all zeros and all poles in a row, counts (n, 2) of them, gains (n,)."""

    zeros: Complexes
    poles: Complexes
    counts: Integers
    gains: Floats

    @classmethod
    def of(cls, laws: Sequence[Factored], factor: float = 1.0) -> "_Laws":
        """With all gains times `factor`."""
        return cls(
            np.concatenate([law.zeros for law in laws]).astype(complex),
            np.concatenate([law.poles for law in laws]).astype(complex),
            np.array([[len(law.zeros), len(law.poles)] for law in laws]),
            factor * np.array([law.gain for law in laws]),
        )

    def times(self, others: Sequence[Factored]) -> "_Laws":
        """Joint by joint multiplied."""
        other = _Laws.of(others)
        zeros, poles = (
            np.concatenate([own, more])[np.argsort(np.concatenate([self._owners(k), other._owners(k)]), kind="stable")]
            for k, (own, more) in enumerate([(self.zeros, other.zeros), (self.poles, other.poles)])
        )
        return _Laws(zeros, poles, self.counts + other.counts, self.gains * other.gains)

    def turns(self) -> tuple[Floats, Floats]:
        """(n,) d arg/dω at ω = 0 [s], and the same with all zeros and poles of one sign; infinite where one is there."""
        size = len(self.gains)
        with np.errstate(divide="ignore", invalid="ignore"):
            zeros, poles = 1 / self.zeros, 1 / self.poles
        leads = np.bincount(self._owners(1), poles.real, size) - np.bincount(self._owners(0), zeros.real, size)
        turns = np.bincount(self._owners(0), np.abs(zeros), size) + np.bincount(self._owners(1), np.abs(poles), size)
        none = ~np.isfinite(turns)
        return np.where(none, -np.inf, leads), np.where(none, np.inf, turns)

    def _owners(self, kind: int) -> Integers:
        """Whose each zero (0) or pole (1) is."""
        return np.repeat(np.arange(len(self.gains)), self.counts[:, kind])
