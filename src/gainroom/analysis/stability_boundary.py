"""The stability boundary of a loop of any number of joints, and the eigenvalues of L on it, one frequency at a time."""

import math
from collections.abc import Callable

import numpy as np

from ..system.linear.apart import inverses
from ..system.linear.arrays import Complexes, Floats, distinct
from ..system.loop import Loop
from .equal_modes import common_mode, equal_to

HIGHEST = 1e3
"""Largest factor on gains that is searched."""
UNDAMPED = 1e-8
"""Damping ratio below which a resonance counts as undamped."""
TILT = 1e-9
"""Negative damping ratio of the points that replace the boundary beside an undamped resonance: slower growth is not counted."""
LEAN = 1e-3
"""Half-width of the tilted stretch beside such a resonance, relative to its frequency."""
PER_DECADE = 6
"""First samples per order of magnitude of ω."""
AROUND = np.array([-1.0, 0.0, 1.0])
"""Offsets of the first samples at a resonance, in half-widths: about its pole a locus is a circle, each step at most a quarter of it, and
leaves its chord by 0.21 of that; near a zero it is all but straight, as long as no pole is near."""
AT_ONCE = 40_000
"""Entries of matrices of different frequencies that are held at a time."""


class Boundary:
    """The stability boundary of a loop, and the loci on it one frequency at a time. `last` [rad/s]: half the sample rate; None: no end."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.last = None if loop.sample_time is None else math.pi / loop.sample_time
        # A resonance without damping is a pole on the boundary, which the loci pass at infinity: beside it the boundary leans to the right,
        # and roots that grow slower than TILT are not counted.
        corners = loop.corner_frequencies.every
        centers = corners.imag[(corners.imag > 0) & (np.abs(corners.real) < UNDAMPED * corners.imag)]
        if self.last is not None:  # those above half the sample rate are aliased below it
            centers = np.abs((centers + self.last) % (2 * self.last) - self.last)
        self.leaning = distinct(centers[centers > 0])  # [rad/s]
        self.undamped = bool(len(self.leaning))

    def points(self, omega: Floats) -> Complexes:
        """Points s (k,) of the boundary at `omega` (k,): jω, tilted to the right beside undamped resonances."""
        return omega * (1j + TILT * self.leans(omega)) if self.undamped else 1j * omega

    def leans(self, omega: Floats) -> Floats:
        """Tilt of the boundary to the right at `omega` (k,), as a share (k,) of TILT."""
        away = np.abs(np.subtract.outer(omega, self.leaning) / self.leaning)
        return np.clip(1 - away.min(axis=1, initial=np.inf) / LEAN, 0.0, 1.0)

    def core(self, omega: Floats) -> Complexes:
        """Return ratio L (k, r, r) at `omega` (k,) on the subspace that the gains see."""
        return self.loop.core(self.points(omega))

    def eigen(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """Eigenvalues (k, r) and vectors (k, r, r) of the core of L at omega (k,), computed once for frequencies that are the same."""
        each = distinct(omega)
        values, vectors = np.linalg.eig(self.core(each))
        place = np.searchsorted(each, omega)
        return values[place], vectors[place]

    def mode(self, omega: float, value: complex) -> Complexes:
        """Mode shape (n,), measured positions, of the locus at `value` and those equal to it at `omega`; the largest part 1."""
        (values,), (vectors,) = self.eigen(np.array([omega]))
        equal = vectors[:, equal_to(values[np.argmin(np.abs(values - value))], values)]
        return common_mode(self.loop.lifted(complex(self.points(np.array([omega]))[0]), equal))


def in_blocks(function: Callable[[Floats], Complexes], omega: Floats, size: int) -> Complexes:
    """`function` (k,) → (k, …), which needs a few matrices (size, size) for each ω, over any number of them in bounded memory."""
    rows = max(1, AT_ONCE // size**2)
    if len(omega) <= rows:
        return function(omega)
    return np.concatenate([function(omega[k : k + rows]) for k in range(0, len(omega), rows)])


def longest_delay(loop: Loop) -> float:
    """Largest delay [s] of any joint, with the hold of a sampled loop; 0 where it is not known. Below its inverse loci turn by < 1 rad."""
    if loop.delays is not None:
        return float(loop.delays.max(initial=0.0))
    return 0.0 if loop.parts is None else max(drive.delay for drive in loop.parts.drives) + (loop.sample_time or 0.0)


def first_grid(loop: Loop, last: float | None) -> Floats:
    """First frequencies [rad/s]: every order of magnitude, every resonance on its own scale, and several samples per turn of the delay."""
    corners = loop.corner_frequencies
    longest = longest_delay(loop)
    sizes = np.abs(corners.every)
    sizes = np.append(sizes[sizes > 0], 1 / longest if longest else [])
    low, high = (0.1 * sizes.min(), 3 * sizes.max()) if len(sizes) else (0.1, 10.0)
    high = high if last is None else last
    low = min(low, 1e-2 * high)
    grid = [np.geomspace(low, high, max(8, round(PER_DECADE * math.log10(high / low))))]
    for roots, around in ((corners.poles, AROUND), (corners.zeros, np.zeros(1))):
        center = roots.imag[roots.imag > 0]
        width = np.maximum(np.abs(roots.real[roots.imag > 0]), 1e-6 * center)
        if last is not None:  # resonances above half the sample rate are aliased below it
            center = np.abs((center + last) % (2 * last) - last)
        grid.append((center[:, None] + width[:, None] * around).ravel())
    omega = distinct(np.concatenate(grid))
    omega = omega[(omega >= low) & (omega <= high)]
    return omega[np.append(True, np.diff(omega) > 1e-7 * omega[1:])]


def sensitivity(loop: Loop, returned: Complexes) -> Complexes:
    """Sensitivity (I + L)⁻¹ (k, n, n) for L = `returned`, computed on the subspace that gains act on: the rest would add round-off."""
    seen = loop.seen
    if seen.shape[1] == loop.size:
        return inverted(np.eye(loop.size) + returned)
    unseen = np.eye(loop.size) - seen @ seen.T
    back = inverted(np.eye(seen.shape[1]) + seen.T @ returned @ seen)
    return unseen + (seen - unseen @ returned @ seen) @ back @ seen.T


def inverted(matrices: Complexes) -> Complexes:
    """Inverses of `matrices` (k, n, n); pseudo-inverses where one is singular to round-off."""
    try:
        return inverses(matrices)
    except np.linalg.LinAlgError:  # integrators have drowned the rest in round-off, which shows: nothing settles there
        return np.linalg.pinv(matrices)
