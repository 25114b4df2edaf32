"""How finely loci are sampled, and loci on the stability boundary one frequency at a time."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gainroom.analysis import stability_boundary
from gainroom.system.linear.arrays import Complexes, Floats
from gainroom.system.loop import Loop


@dataclass(frozen=True)
class Resolution:
    """How finely loci are sampled, and which numbers count as round-off."""

    turn: float = 1.5  # [rad] of a delay between samples where loci reach −1: more may hide a whole turn
    highest: float = 1e3  # of the factors that are searched
    smooth: float = 0.12  # largest relative move of an eigenvalue between samples near the negative real axis
    detour: float = 0.5  # of its angle to that axis: a turn that stays smaller does not reach the axis in between
    growth: float = 0.7  # largest change of ln|λ| between samples
    large: float = 1e3  # eigenvalues beyond this belong to integrators
    undamped: float = 1e-8  # damping ratio below which a resonance counts as undamped
    tilt: float = 1e-9  # damping ratio, negative, of points that take the place of the boundary there
    lean: float = 1e-3  # of its frequency, to either side, up to where they do
    huge: float = 1e9  # eigenvalues beyond this drown the small ones in round-off
    nothing: float = 1e-150  # eigenvalues smaller than this are zero
    noise: float = 1e-10  # of the largest eigenvalue: smaller ones are no better than round-off
    # of a fall, about 1: from two integrators and a memory, 3, to a velocity alone, -1; beyond is round-off
    steepest: float = 2.5
    blurred: float = 0.01  # of a locus: round-off that makes 0.5 of its fall over a step of `beside`
    astray: float = 0.02  # deviation of the order of a fall from a whole number; more is round-off
    # part of its size up to which what is imaginary of a locus near ω = 0 is taken for the distance to 0
    real: float = 0.3
    per_decade: int = 6
    # size of what integrators make of the lowest samples: no locus crosses the unit circle further down
    outside: float = 10.0
    beside: float = 1.02  # a step so short, from the lowest sample, that the nearest locus is the same, or falls alike
    # half-widths of a resonance that are sampled: about its pole a locus is a circle, of which no step is more than a quarter then, and
    # leaves its chord by 0.21 of that; near a zero it is all but straight, as long as no pole is near
    around: Floats = field(default_factory=lambda: np.array([-1.0, 0.0, 1.0]))
    lowest: float = 1e-12  # of the highest frequency
    closest: float = 1e-10  # relative distance of samples at which refinement stops
    most: int = 12_000  # samples of large matrices; of small ones more, up to as many entries
    at_once: int = 40000


LOCI = Resolution()


class Boundary(stability_boundary.Boundary):
    """The stability boundary of a loop, with searches along it."""

    def blurred(self, omega: Floats) -> Floats:
        """(k,) how far (I + L)⁻¹ may be off by round-off at low omega (k,): one motion's share of L drowns beside a much larger one."""
        core = self.core(omega)
        size = np.linalg.norm(core, axis=(1, 2))
        least = np.linalg.svd(np.eye(core.shape[1]) + core, compute_uv=False)[:, -1]
        with np.errstate(divide="ignore"):
            return round_off(self.loop, omega) * np.maximum(1.0, size / least**2)

    def crossings(self, omega: Floats, wanted: Complexes, height: Callable[[Complexes], Floats]) -> tuple[Floats, Complexes]:
        """Where `height` of the loci that are at `wanted` (k,) at `omega` (k,) is zero, by secants: ω and λ.

        A locus is followed by its vector: near-equal legs have loci that lie closer together than they move in one step. The caller
        checks what has been reached.
        """
        values, vectors = self.eigen(omega)
        rows = np.arange(len(omega))
        which = np.argmin(np.abs(values - wanted[:, None]), axis=1)
        value, mode = values[rows, which], vectors[rows, :, which]
        before, first = omega, height(value)
        omega = np.where(omega == self.last, omega, omega * (1 - 1e-6))
        top = math.inf if self.last is None else self.last
        for _ in range(40):
            moving = np.flatnonzero(omega != before)
            if not len(moving):
                break
            values, vectors = self.eigen(omega[moving])
            which = np.argmax(np.abs(np.einsum("ki,kij->kj", mode[moving].conj(), vectors)), axis=1)
            value[moving], mode[moving] = values[rows[: len(moving)], which], vectors[rows[: len(moving)], :, which]
            now = height(value)
            rise, run = now - first, omega - before
            step = np.divide(now * run, rise, out=np.zeros(len(omega)), where=rise != 0)
            step[(np.abs(step) <= 1e-14 * omega) | (omega == before)] = 0.0
            first = np.where(omega == before, first, now)
            before, omega = omega, np.clip(omega - step, 0.5 * omega, np.minimum(2 * omega, top))
        return omega, value


def round_off(loop: Loop, omega: Floats) -> Floats:
    """Bound (k,) on the relative round-off of `actuated_at` at jω; largest where a sampled mechanism drifts."""
    if loop.sample_time is None or loop.size == 1:
        return np.full(len(omega), np.finfo(float).eps)
    held = loop.held
    shifted = loop.variable(1j * omega)[:, None, None] * np.eye(len(held.a)) - held.a
    inverse = np.linalg.inv(shifted)
    back = np.abs(inverse)
    spread = np.abs(held.c) @ (back @ (np.abs(shifted) @ (back @ np.abs(held.b))))  # Skeel's bound: no unit of a state matters
    return np.finfo(float).eps * spread.max(axis=(1, 2)) / np.maximum(np.abs(held.c @ inverse @ held.b).max(axis=(1, 2)), 1e-300)
