"""The characteristic loci of coupled loops along the stability boundary: the eigenvalues λ of L(jω), sampled and followed.

det(I + z L(jω)) = 0 exactly where an eigenvalue equals −1/z. So the loci tell where any common factor z puts a root on the boundary: a
gain where they cross the negative real axis, a phase or a delay where they cross the unit circle; and their turns around −1/z count the
unstable roots (Nyquist, MacFarlane and Postlethwaite 1977). L is sampled once, as finely as the loci need, for all of these.

Between neighbouring samples an eigenvalue moves by a small part of its distance from the negative real axis, or of itself. That is a
check, not a proof as for one joint (crossings.py); what is reported is polished, and counted on both sides.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .arrays import Booleans, Complexes, Floats, Integers
from .errors import GainroomError
from .loop import Loop
from .stability import unstable_roots

SMOOTH = 0.12  # largest relative move of an eigenvalue between samples near the negative real axis
DETOUR = 0.5  # of its distance from that axis: a move that stays shorter does not reach the axis in between
LARGE = 1e3  # eigenvalues beyond this belong to integrators
FLOOR = 1e-3  # eigenvalues smaller than this are not followed: gains could rise by 60 dB there
UNDAMPED = 1e-8  # damping ratio below which a resonance counts as undamped
NOISE = 1e-10  # of the largest eigenvalue: smaller ones are no better than round-off
PER_DECADE = 6
AROUND = np.array([-6.0, -1.5, 0.0, 1.5, 6.0])  # half-widths of a resonance that are sampled
CLOSEST = 1e-10  # relative distance of samples at which refinement stops
MOST = 30_000


@dataclass(frozen=True)
class Steps:
    """Every eigenvalue from one sample to the next. All arrays (k − 1, n).

    start, end   λ at both samples, paired by nearness
    """

    start: Complexes
    end: Complexes


class Sweep:
    """Samples of the loci of a loop, refined on demand. `omega` (k,) [rad/s] rising, `loci` (k, r), r <= n of them."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.last = None if loop.sample_time is None else math.pi / loop.sample_time
        bends = loop.bends
        # A resonance without damping is a pole on the boundary, which the loci pass at infinity: their turns do not tell on which side.
        self.undamped = bool(np.any((bends.imag > 0) & (np.abs(bends.real) < UNDAMPED * bends.imag)))
        self.omega = _first_grid(loop, self.last)
        self.loci = self._eigenvalues(self.omega)
        self._pairs = _pairing(self.loci[:-1], self.loci[1:])
        self._reach_ends()
        for _ in range(60):
            rough = self._rough()
            if not len(rough) or len(self.omega) > MOST:
                break
            self.add(_middle(self.omega[rough], self.omega[rough + 1]))

    def add(self, omega: Floats) -> None:
        """Take samples at more frequencies."""
        fresh = np.setdiff1d(omega, self.omega)
        if self.last is not None:
            fresh = fresh[fresh <= self.last]
        if not len(fresh):
            return
        place = np.searchsorted(self.omega, fresh)
        values = self._eigenvalues(fresh)
        omega = np.insert(self.omega, place, fresh)
        kept = np.isin(omega[:-1], self.omega[:-1]) & np.isin(omega[1:], self.omega[1:])  # both ends known, and nothing between them
        self.loci = np.insert(self.loci, place, values, axis=0)
        pairs = np.empty((len(omega) - 1, self.loci.shape[1]), dtype=int)
        pairs[kept] = self._pairs[np.searchsorted(self.omega, omega[:-1][kept])]
        pairs[~kept] = _pairing(self.loci[:-1][~kept], self.loci[1:][~kept])
        self.omega, self._pairs = omega, pairs

    def steps(self) -> Steps:
        """The loci from sample to sample."""
        return Steps(self.loci[:-1], np.take_along_axis(self.loci[1:], self._pairs, axis=1))

    def unstable(self, gain: float) -> int:
        """Unstable closed-loop roots with every gain multiplied by `gain`, as far as the gains move them.

        With an undamped resonance the roots themselves are counted, those that no gain moves among them.
        """
        if self.undamped:
            return unstable_roots(self.loop.scaled(gain))
        target, steps = -1 / gain, self.steps()
        for _ in range(60):
            close = np.any(_passes(steps, target), axis=1) & (np.diff(self.omega) > CLOSEST * self.omega[1:])
            if not close.any():
                break
            places = np.flatnonzero(close)
            self.add(_middle(self.omega[places], self.omega[places + 1]))
            steps = self.steps()
        one = 1 + gain * self.loci[0]
        integrators = round(-float(np.sum(np.log(np.abs(1 + gain * self.loci[1]) / np.abs(one)))) / math.log(self.omega[1] / self.omega[0]))
        turned = float(np.sum(np.angle((1 + gain * steps.end) * (1 + gain * steps.start).conj())))
        if self.last is None:
            turned -= float(np.sum(np.angle(1 + gain * self.loci[-1])))  # from the last sample to infinity, where L is 0
        return round(self.loop.unstable_poles + integrators / 2 - turned / math.pi)

    def eigen(self, omega: float) -> tuple[Complexes, Complexes]:
        """Eigenvalues (r,) and vectors (r, r) of the core of L(jω)."""
        return np.linalg.eig(self.loop.core(np.array([omega]))[0])

    def crossing(self, omega: float, wanted: complex, height: Callable[[complex], float]) -> tuple[float, complex, Complexes]:
        """Where `height` of the locus that is at `wanted` at `omega` is zero, by a secant: ω, λ and its vector, the largest part 1.

        A locus is followed by its vector: near-equal legs have loci that lie closer together than they move in one step. The caller
        checks what has been reached.
        """
        values, vectors = self.eigen(omega)
        k = int(np.argmin(np.abs(values - wanted)))
        value, mode = complex(values[k]), vectors[:, k]
        before, first, omega = omega, height(value), omega if omega == self.last else omega * (1 - 1e-6)
        for _ in range(40):
            if omega == before:
                break
            values, vectors = self.eigen(omega)
            k = int(np.argmax(np.abs(mode.conj() @ vectors)))
            value, mode = complex(values[k]), vectors[:, k]
            slope = (height(value) - first) / (omega - before)
            step = height(value) / slope if slope else 0.0
            if abs(step) <= 1e-14 * omega:
                break
            before, first = omega, height(value)
            omega = min(max(omega - step, 0.5 * omega), 2 * omega, math.inf if self.last is None else self.last)
        mode = self.loop.lifted(omega, mode)
        return omega, value, mode / mode[np.argmax(np.abs(mode))]

    def _eigenvalues(self, omega: Floats) -> Complexes:
        values = self.loop.core(omega)
        if not np.all(np.isfinite(values)):
            raise GainroomError("loop: the return ratio is not finite on the stability boundary")
        return np.linalg.eigvals(values)

    def _reach_ends(self) -> None:
        """Down to where integrators rule, up to where the loci have become small."""
        for _ in range(40):
            sizes = np.abs(self.loci[:2])
            follows = (sizes[0] > max(1e-9, NOISE * sizes[0].max())) & (np.abs(sizes[1] - sizes[0]) > 1e-3 * sizes[0])
            if not np.any(follows & (sizes[0] < 1e4)) or self.omega[0] < 1e-9 * self.omega[-1]:
                break
            self.add(self.omega[0] / np.array([4.0, 16.0]))
        while self.last is None and np.abs(self.loci[-1]).max() > FLOOR and self.omega[-1] < 1e12 * self.omega[0]:
            self.add(self.omega[-1] * np.array([1.5, 2.0]))

    def _rough(self) -> Integers:
        """Intervals on which a locus moves so far, and so near the negative real axis, that where it crosses is in doubt."""
        steps = self.steps()
        size = np.maximum(np.abs(steps.start), np.abs(steps.end))
        distance = np.minimum(_from_axis(steps.start), _from_axis(steps.end))
        move = np.abs(steps.end - steps.start)
        # Far beyond −1 the loci of integrators fall along straight lines, on which a step of a decade loses nothing.
        turn = np.where(size > LARGE, np.abs(np.angle(steps.end * steps.start.conj())) * size, move)
        seen = size > np.maximum(FLOOR, NOISE * size.max(axis=1, keepdims=True))
        rough = np.any((move > DETOUR * distance) & (turn > SMOOTH * size) & seen, axis=1)
        return np.flatnonzero(rough & (np.diff(self.omega) > CLOSEST * self.omega[1:]))


def _from_axis(value: Complexes) -> Floats:
    """Distance from the negative real axis."""
    return np.where(value.real < 0, np.abs(value.imag), np.abs(value))


def _pairing(before: Complexes, after: Complexes) -> Integers:
    """(k, n) which eigenvalue `after` continues each one `before`: the nearest, or the nearest as a whole where two claim the same."""
    from scipy.optimize import linear_sum_assignment

    distance = np.abs(before[:, :, None] - after[:, None, :])
    pairs = np.argmin(distance, axis=2)
    size = before.shape[1]
    for k in np.flatnonzero(np.any(np.sort(pairs, axis=1) != np.arange(size), axis=1)):
        pairs[k] = linear_sum_assignment(distance[k])[1]
    return pairs


def _passes(steps: Steps, target: float) -> Booleans:
    """True where a step passes `target` at less than a third of its own length: which side it passes is not to be told from its ends."""
    move = steps.end - steps.start
    length = np.maximum(np.abs(move), 1e-150)
    along = np.clip(((target - steps.start) * move.conj()).real / length**2, 0.0, 1.0)
    return np.abs(steps.start + along * move - target) < 0.33 * length


def _middle(low: Floats, high: Floats) -> Floats:
    return np.where(high > 4 * low, np.sqrt(low * high), 0.5 * (low + high))


def _first_grid(loop: Loop, last: float | None) -> Floats:
    """Every order of magnitude, every resonance on its own scale, and several samples per turn of the delay."""
    bends = loop.bends
    longest = float(loop.delays.max(initial=0.0)) if loop.delays is not None else 0.0
    sizes = np.append(np.abs(bends)[np.abs(bends) > 0], 1 / longest if longest else [])
    low, high = (0.1 * sizes.min(), 3 * sizes.max()) if len(sizes) else (0.1, 10.0)
    high = high if last is None else last
    low = min(low, 1e-2 * high)
    grid = [np.geomspace(low, high, max(8, round(PER_DECADE * math.log10(high / low))))]
    center = bends.imag[bends.imag > 0]
    width = np.maximum(np.abs(bends.real[bends.imag > 0]), 1e-6 * center)
    grid.append((center[:, None] + width[:, None] * AROUND).ravel())
    omega = np.unique(np.concatenate(grid))
    omega = omega[(omega >= low) & (omega <= high)]
    return omega[np.append(True, np.diff(omega) > 1e-7 * omega[1:])]
