"""Residuals of a fit, and the decision if they show the model to be wrong."""

from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Floats
from .frequency_response import FrequencyResponse
from .prediction import Signals
from .torque_balance import Balance

LAGS = 60  # ticks of autocorrelation
MOST_REPEATED = 0.8  # correlation of the residual with itself some ticks before: more, and rows are copies of others
NOTHING_LEFT = 1e-4  # of the motion left: a simulated log without noise, in which round-off follows the torque
MOST_EXPLAINED = 0.3  # of the residual's power, by the torque: more, and the model misses what the torque does
COPIED, LONGEST_COPIES = 0.05, 10  # of the largest step of other rows; rows from copy to copy
# Unexplained share of the torque's power in a third octave: right models left 0.9 % at most, with friction of a third of the torque, and
# wrong ones that moved a parameter by a fifth 1.4 % at least (simulations of two kinds, resonances of 5 to 60 Hz).
MOST_LEFT, LITTLE_LEFT = 0.012, 0.006


@dataclass(frozen=True)
class Residuals:
    """Residuals of the motor's (or the only measured) position, one step ahead, in units of their expected deviation; and of the torque.

    values            (m,)
    autocorrelation   (l,) at lags 1, 2, … ticks; of white noise within ± `chance`
    chance            two standard errors
    left              their deviation over that of the second difference of the position
    explained         share of the residual's power, over the frequencies that the torque excites, that is coherent with the torque: what
                      the model should have explained; 0 to 1, near 0 for the right model
    balance           share of the torque's power that the joint's motion does not take, by third octaves (torque_balance.py)
    copies            every second to tenth position is a copy of the one before, which no small residual excuses
    """

    values: Floats
    autocorrelation: Floats
    chance: float
    left: float
    explained: float
    balance: Balance
    copies: bool = False

    @property
    def adequate(self) -> bool:
        """True if no band's unexplained torque exceeds MOST_LEFT, and the residuals neither follow the torque nor repeat.

        Of a residual that is small beside the torque (LITTLE_LEFT), anything may be explained: it moves no parameter.
        """
        small = self.balance.most < LITTLE_LEFT
        return not self.copies and (small or (self.balance.most < MOST_LEFT and not self.follows and not self.repeats))

    @property
    def follows(self) -> bool:
        """True if a larger share of the residuals than MOST_EXPLAINED follows the torque."""
        return self.explained >= MOST_EXPLAINED

    @property
    def repeats(self) -> bool:
        """True if rows are nearly copies of others."""
        return float(np.abs(self.autocorrelation).max()) >= MOST_REPEATED


def residual_tests(errors: Floats, variances: Floats, signals: Signals, measured: FrequencyResponse, balance: Balance) -> Residuals:
    """Tests of all prediction errors with their variances (m · o,), and of the unexplained torque."""
    outputs = signals.positions.shape[1]
    values = (errors / np.sqrt(variances))[::outputs]
    skipped = len(values) // 20
    centred = _centred(values[skipped:])
    power = float(centred @ centred)
    lags = np.array([float(centred[lag:] @ centred[:-lag]) / power for lag in range(1, LAGS + 1)])
    explained = explained_share(errors, variances, signals, measured)
    left = float(np.std(errors[::outputs][skipped:]) / np.std(np.diff(signals.positions[:, 0], 2)))
    if left < NOTHING_LEFT:
        explained, lags = 0.0, 0.0 * lags
    return Residuals(values, lags, 2 / len(centred) ** 0.5, left, explained, balance, _copied(signals.positions[:, 0]))


def _copied(position: Floats) -> bool:
    """True if `position` (m,) stands still at every second, …, or tenth row while it moves at the others."""
    steps = np.abs(np.diff(position))
    for period in range(2, LONGEST_COPIES + 1):
        sizes = steps[: len(steps) // period * period].reshape(-1, period).mean(axis=0)
        if sizes.min() < COPIED * sizes.max():
            return True
    return False


def explained_share(errors: Floats, variances: Floats, signals: Signals, measured: FrequencyResponse) -> float:
    """Share of the power of the first position's errors, over the frequencies that the torque excites, that is coherent with the torque."""
    from scipy.signal import coherence, welch

    values = (errors / np.sqrt(variances))[:: signals.positions.shape[1]]
    skipped = len(values) // 20
    centred = _centred(values[skipped:])
    length = int(min(len(centred) // 20, 4 / signals.sample_time))
    options = {"fs": 1 / signals.sample_time, "nperseg": length}
    frequency, shared = coherence(signals.torque[skipped:], centred, **options)
    _, spectrum = welch(centred, **options)
    segments = 2 * len(centred) / length - 1
    real = np.clip((shared - 1 / segments) / (1 - 1 / segments), 0.0, 1.0)  # coherence of unrelated signals is about 1/segments
    excited = np.interp(2 * np.pi * frequency, measured.omega, measured.excited.astype(float), left=0.0, right=0.0) > 0.5
    total = float(spectrum[excited].sum())
    return float((real * spectrum)[excited].sum() / total) if total > 0 else 0.0


def _centred(values: Floats) -> Floats:
    """Values without their mean, and without deviations beyond five standard deviations."""
    return np.clip(values - values.mean(), -5 * values.std(), 5 * values.std())
