"""Numbers with their uncertainty: estimates, and covariances that hold for residuals that are coloured, uneven or repeated.

An estimator that solves Σ_k ψ_k(p) = 0 has the error −(Σ ∂ψ_k/∂p)⁻¹ Σ ψ_k to first order; the terms of that sum are its influences. Their
sum's variance is estimated from sums over blocks of time that are longer than the residual's memory (batch means), so that nothing need
be assumed about colour or about noise that comes and goes (White 1980; Newey and West 1987; Ljung, System Identification, sec. 9.4).
"""

import math
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Floats, Integers

BLOCKS = 40  # of time: enough for a t quantile of 2.02, long enough to hold the residual's memory
FREEDOM = BLOCKS - 1  # degrees of freedom of a covariance from so many blocks
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """Value with its 95 % interval [low, high], in the unit of its quantity, and its standard error."""

    value: float
    low: float
    high: float
    standard_error: float = math.nan

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return (self.high - self.low) / 2

    def scaled(self, factor: float) -> "Estimate":
        """Estimate in another unit, factor > 0."""
        return Estimate(factor * self.value, factor * self.low, factor * self.high, factor * self.standard_error)


def interval(value: float, standard_error: float, freedom: float = math.inf) -> Estimate:
    """Estimate `value` ± the 97.5 % quantile of Student's t with so many degrees of freedom times `standard_error`."""
    half = quantile(freedom) * standard_error
    return Estimate(float(value), float(value - half), float(value + half), float(standard_error))


def log_interval(value: float, standard_error: float, freedom: float = math.inf) -> Estimate:
    """Estimate of a quantity > 0 whose logarithm has the `standard_error`: low and high are factors away from the value."""
    factor = math.exp(min(quantile(freedom) * standard_error, 700.0))
    return Estimate(float(value), float(value / factor), float(value * factor), float(value * standard_error))


def quantile(freedom: float) -> float:
    """Quantile of Student's t, two-sided, at CONFIDENCE."""
    from scipy.special import ndtri, stdtrit  # scipy.stats, which calls these, takes half a second to load

    tail = (1 + CONFIDENCE) / 2
    return float(ndtri(tail) if math.isinf(freedom) else stdtrit(max(freedom, 1.0), tail))


def covariance(influence: Floats, clusters: Integers | None = None, blocks: int = BLOCKS) -> Floats:
    """Covariance (p, p) of the sum of influences (m, p), by batch means over `blocks` of time, or robust to `clusters` (m,), labels from 0.

    With `blocks` < BLOCKS and m ≥ 4 BLOCKS it is scaled by (t of blocks − 1 over t of FREEDOM)², so that intervals with FREEDOM degrees of
    freedom keep their coverage. Shorter records use m/4 blocks, at least 2, and clusters their own number, unscaled.
    """
    if clusters is None:
        blocks = max(2, min(blocks, len(influence) // 4))
        few = (quantile(blocks - 1) / quantile(FREEDOM)) ** 2 if blocks < BLOCKS and len(influence) >= 4 * BLOCKS else 1.0
        edges = np.linspace(0, len(influence), blocks + 1).astype(int)[:-1]
        sums = few**0.5 * np.add.reduceat(influence, edges, axis=0)
    else:
        sums = np.zeros((int(clusters.max()) + 1, influence.shape[1]))
        np.add.at(sums, clusters, influence)
    count = len(sums)
    return sums.T @ sums * (count / max(count - 1, 1))


PARAMETERS = {
    "motor_inertia": "kg·m²",
    "link_inertia": "kg·m²",
    "inertia": "kg·m²",
    "stiffness": "N·m/rad",
    "damping": "N·m·s/rad",
    "viscous": "N·m·s/rad",
    "coulomb": "N·m",
    "link_coulomb": "N·m",
    "weight_sine": "N·m",
    "weight_cosine": "N·m",
    "delay": "s",
    "resonance": "rad/s",
    "antiresonance": "rad/s",
}
"""Units of the parameters. `inertia` is the sum of both sides, of a rigid joint; friction is the motor's except `link_coulomb`."""
