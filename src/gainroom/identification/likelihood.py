"""Maximum likelihood from one-step prediction errors, by Fisher scoring, with a covariance that does not trust the noise model.

A model predicts row k from what came before with an error e_k and its variance v_k; with Gaussian errors minus twice the log likelihood is
Σ (e_k²/v_k + log v_k). The information is Σ e'e'ᵀ/v + ½ v'v'ᵀ/v² (primes: derivatives by the parameters), so first derivatives are enough.
Where the log came from a closed loop the estimate has no bias from it as long as the model of the noise is right: the error of a
one-step prediction is independent of all that the controller has done before (Ljung, System Identification, secs. 8.4 and 13.4).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Floats, Integers
from .estimate import covariance

Prediction = Callable[[Floats], tuple[Floats, Floats]]
"""Parameters (p,) → errors (m,) and their variances (m,)."""
STEP = 1e-5  # of differences; parameters are of order one or logarithms
MOST_ITERATIONS = 25
SETTLED = 0.05  # of a standard error: what the last step may still move
LEAST_GAIN = 0.02  # of minus twice the log likelihood: less is not worth a further step
DAMPING = 1e-3


@dataclass(frozen=True)
class Maximum:
    """Maximum of the likelihood.

    parameters     (p,)
    variance       (p, p) of their errors, from the scores' sums over blocks of time (estimate.py)
    information    (p, p) inverse variance where the noise model is exact
    influence      (m, p) what each row adds to the error
    cost           mean of e²/v + log v
    errors, variances   (m,) at the maximum
    converged      False where the last step was still large
    prior          (p, p) the part of the variance that is the prior's
    """

    parameters: Floats
    variance: Floats
    information: Floats
    influence: Floats
    cost: float
    errors: Floats
    variances: Floats
    converged: bool
    prior: Floats

    def variance_of(self, blocks: int) -> Floats:
        """Variance (p, p) from so many blocks of time."""
        return covariance(self.influence, blocks=blocks) + self.prior

    def variance_by(self, clusters: Integers) -> Floats:
        """Variance (p, p) if rows of one cluster (m,) may share their error, as roundings of a repeating signal do."""
        return covariance(self.influence, clusters) + self.prior


def maximize(predict: Prediction, start: Floats, used: Floats, prior: Floats, iterations: int = MOST_ITERATIONS) -> Maximum:
    """Maximum near `start` (p,).

    used    (m,) weight of each row, 0: left out
    prior   (2, p) mean and information of independent Gaussian knowledge; information 0: none

    Raises numpy.linalg.LinAlgError where nothing is predicted at the start, or beside a point that the search comes to.
    """
    point, damping, converged = np.array(start, dtype=float), DAMPING, False
    error, var = predict(point)
    cost = _cost(error, var, used, prior, point)
    if not math.isfinite(cost):
        raise np.linalg.LinAlgError("no prediction")
    for _ in range(iterations):
        slopes = _slopes(predict, point, error, var)
        total = slopes.information(used) + np.diag(prior[1])
        gradient = slopes.score(used).sum(axis=1) - prior[1] * (point - prior[0])
        scale = np.sqrt(np.maximum(np.diag(total), 1e-12))
        while True:
            step = np.linalg.lstsq(total / np.outer(scale, scale) + damping * np.eye(len(point)), gradient / scale, rcond=None)[0] / scale
            step = np.clip(step, -1.0, 1.0)
            trial_error, trial_var = predict(point + step)
            trial = _cost(trial_error, trial_var, used, prior, point + step)
            if trial <= cost:
                break
            damping *= 10
            if damping > 1e8:
                break
        if damping > 1e8:
            converged = True  # nothing nearby is better
            break
        gained = (cost - trial) * used.sum()
        point, error, var, cost, damping = point + step, trial_error, trial_var, trial, max(damping / 10, 1e-9)
        if float(np.abs(step * scale).max()) < SETTLED or gained < LEAST_GAIN:
            converged = True
            break
    slopes = _slopes(predict, point, error, var)
    information = slopes.information(used)
    inverse = np.linalg.pinv(information + np.diag(prior[1]), hermitian=True, rcond=1e-14)
    influence = slopes.score(used).T @ inverse
    before = inverse @ np.diag(prior[1]) @ inverse
    return Maximum(point, covariance(influence) + before, information, influence, cost, error, var, converged, before)


def _cost(error: Floats, var: Floats, used: Floats, prior: Floats, point: Floats) -> float:
    """Cost per row, with the prior; inf if a prediction is not finite."""
    with np.errstate(all="ignore"):
        value = float((used @ (error**2 / var + np.log(var)) + prior[1] @ (point - prior[0]) ** 2) / used.sum())
    return value if np.isfinite(value) else np.inf


@dataclass(frozen=True)
class _Slopes:
    """Errors and variances (m,), and their derivatives (p, m) by the parameters in units of √v and of v."""

    error: Floats
    var: Floats
    errors: Floats
    variances: Floats

    def score(self, used: Floats) -> Floats:
        """Score (p, m) of each row: derivatives of half the log likelihood's terms."""
        relative = self.error / np.sqrt(self.var)
        return -(used * relative) * self.errors - (0.5 * used * (1 - relative**2)) * self.variances

    def information(self, used: Floats) -> Floats:
        """Information matrix (p, p)."""
        return (self.errors * used) @ self.errors.T + 0.5 * (self.variances * used) @ self.variances.T


def _slopes(predict: Prediction, point: Floats, error: Floats, var: Floats) -> _Slopes:
    errors, variances = np.empty((len(point), len(error))), np.empty((len(point), len(error)))
    deviation = np.sqrt(var)
    for k in range(len(point)):
        moved = point.copy()
        moved[k] += STEP
        above = predict(moved)
        if not np.isfinite(above[0]).all():
            raise np.linalg.LinAlgError("no prediction beside the point")
        errors[k], variances[k] = (above[0] - error) / (STEP * deviation), (above[1] - var) / (STEP * var)
    return _Slopes(error, var, errors, variances)
