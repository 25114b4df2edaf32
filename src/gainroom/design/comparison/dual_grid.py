"""A peak of the link's compliance below which no linear controller on one sensor comes, and the certificate that anybody can recompute.

For weights w_0 ≥ 0 of mean 1 over the circle, w_1, w_2 ≥ 0 and ν ≥ 0, every controller that meets the ceilings has

    max |q/d|² ≥ mean(w_0 |q/d|² + w_1 (|S|²/Ms² − 1) + w_2 (|T|² |1 − e^(−jωτ)|² − 1)) + ν (noise²/n² − 1)

because no bracket is positive. The closed loops are H_i = A_i + B_i Q with a stable Q (closed_maps), so the right-hand side is at least its
minimum over Q, which is one least-squares problem: with R = Σ w |B|² = |Φ|², Φ and 1/Φ stable, and c = Σ w B̄ A,

    Σ w |A + B Q|² = Σ w |A|² − |c|²/R + |Φ Q + c/Φ̄|²

and Φ Q, being stable, can cancel the stable part of c/Φ̄ only. What is left is the bound: mean(Σ w |A|² − |c|²/R) + ‖unstable part of
c/Φ̄‖². It holds whatever the weights; how good it is depends on them. They ascend: where the minimiser exceeds a ceiling, weight grows.

On a computer the circle is 2·points samples, offset by half a step, and Φ comes from the cepstrum, the Fourier series of log R. Samples
mean what the circle means only where nothing happens between them: weights are piecewise linear with knots at least APART steps from each
other, never spikes. The error then falls with the square of the step, so that of the doubled grid is about a third of the difference
between both; the value of a certificate is the lower of the two less the whole difference.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...system.linear.arrays import Complexes, Floats, Integers
from .ceilings import Ceilings
from .closed_maps import HeldByPD, Stabilised, cosines, later, sines
from .exact_joint import ExactJoint

APART = 3.9
"""Steps of the grid that knots of the weights are at least apart: hats of 4 steps, less round-off."""
ROUND_OFF = 1e-12
"""Share of the terms, whose difference is the bound, that counts as round-off: responses are exact to some 1e-13."""


@dataclass(frozen=True)
class DualGrid:
    """Maps in units of their ceilings on half a circle, fixed and free (maps, points), and the hats that weights are made of.

    omega (points,) [rad/s]; frequency (knots,) [rad/s] of the knots; below, share (points,): the knot below each point, and how far the
    point is towards the next one, 0 to 1.
    """

    fixed: Complexes
    free: Complexes
    omega: Floats
    frequency: Floats

    @classmethod
    def of(
        cls, held: Stabilised | HeldByPD, joint: ExactJoint, ceilings: Ceilings, sensor: str, frequency: Floats, points: int
    ) -> "DualGrid":
        omega = math.pi * (np.arange(points) + 0.5) / points / joint.sample_time
        maps, noise = held.halves(points), ceilings.noise_of(sensor)
        scaled = [(maps.compliance, 1.0), (maps.sensitivity, 1 / ceilings.peak_sensitivity)]
        scaled += [(maps.complementary, ceilings.delay_weight(omega))] + ([] if noise is None else [(maps.noise[0], noise)])
        fixed, free = np.array([one.fixed * by for one, by in scaled]), np.array([one.free[:, 0] * by for one, by in scaled])
        return cls(fixed, free, omega, frequency)

    @cached_property
    def below(self) -> Integers:
        return np.clip(np.searchsorted(self.frequency, self.omega, side="right") - 1, 0, len(self.frequency) - 2)

    @cached_property
    def share(self) -> Floats:
        return (self.omega - self.frequency[self.below]) / np.diff(self.frequency)[self.below]

    def spread(self, table: Floats) -> Floats:
        """Weights (k, points) of a table (k, knots): linear between knots."""
        return table[:, self.below] * (1 - self.share) + table[:, self.below + 1] * self.share

    @cached_property
    def masses(self) -> Floats:
        """Mean of each knot's hat (knots,)."""
        return self._gathered(np.ones(len(self.below))) / len(self.below)

    def means(self, values: Floats) -> Floats:
        """Mean of values (points,) under each knot's hat (knots,)."""
        return self._gathered(values) / (self.masses * len(self.below))

    def _gathered(self, values: Floats) -> Floats:
        first = np.bincount(self.below, values * (1 - self.share), len(self.frequency))
        return first + np.bincount(self.below + 1, values * self.share, len(self.frequency))

    def all_weights(self, table: Floats, noise_weight: float) -> Floats:
        """Weights of every map (maps, points): those of the table, and of the noise one for all frequencies."""
        spread = self.spread(table)
        return spread if len(self.fixed) == len(table) else np.vstack([spread, np.full((1, spread.shape[1]), noise_weight)])

    def bound(self, table: Floats, noise_weight: float) -> float:
        """Bound [rad/(N m)] that a table of weights proves."""
        weights = self.all_weights(table, noise_weight)
        least, _ = least_squares(weights, self.fixed, self.free)
        penalties = weights[1:].mean(axis=1).sum()
        terms = (weights * (self.fixed.real**2 + self.fixed.imag**2)).sum(axis=0).mean() + penalties
        return math.sqrt(max(least - penalties - ROUND_OFF * terms, 0.0) / weights[0].mean())


def least_squares(weights: Floats, fixed: Complexes, free: Complexes) -> tuple[float, Complexes]:
    """Minimum over stable Q of the mean over the circle of Σ w |A + B Q|², and the minimiser Q (points,).

    weights, fixed, free (maps, points) at the middles of equal parts of the upper half circle; the lower half is their conjugate.
    """
    points = weights.shape[1]
    energy = (weights * (free.real**2 + free.imag**2)).sum(axis=0)
    cross = (weights * (free.conj() * fixed)).sum(axis=0)
    rest = (weights * (fixed.real**2 + fixed.imag**2)).sum(axis=0) - (cross.real**2 + cross.imag**2) / energy
    cepstrum = cosines(np.log(energy), 2) / (2 * points)
    outer = np.sqrt(energy) * np.exp(-0.5j * sines(later(cepstrum), 3))  # log Φ: half the mean, and all that is causal
    whitened = cross / outer.conj()
    even, odd = cosines(whitened.real, 2) / (2 * points), sines(whitened.imag, 2) / (2 * points)
    odd = np.concatenate([[0.0], odd[:-1]])
    stable, unstable = even - odd, even + odd  # series in z⁻ⁿ and zⁿ
    answer = (cosines(stable, 3) + stable[0]) / 2 - 0.5j * sines(later(stable), 3)
    return float(rest.mean() + (unstable[1:] ** 2).sum()), -answer / outer
