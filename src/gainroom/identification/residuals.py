"""What is left of a fit, and whether it says that the model is wrong."""

from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Floats
from .frequency_response import FrequencyResponse
from .prediction import Signals

LAGS = 60  # ticks of autocorrelation
MOST_REPEATED = 0.8  # correlation of the residual with itself some ticks before: more, and rows are copies of others
NOTHING_LEFT = 1e-4  # of the motion left: a simulated log without noise, in which round-off follows the torque
MOST_EXPLAINED = 0.3  # of the residual's power, by the torque: more, and the model misses what the torque does


@dataclass(frozen=True)
class Residuals:
    """Of the motor's (or the only measured) position, one step ahead, in units of their expected deviation.

    values            (m,)
    autocorrelation   (l,) at lags 1, 2, … ticks; of white noise within ± `chance`
    chance            two standard errors
    left              their deviation over that of the second difference of the position
    explained         share of the residual's power, over the frequencies that the torque excites, that is coherent with the torque: what
                      the model should have explained; 0 to 1, near 0 for the right model
    adequate          `explained` is below MOST_EXPLAINED, and no autocorrelation beyond MOST_REPEATED; or next to nothing is left
    """

    values: Floats
    autocorrelation: Floats
    chance: float
    left: float
    explained: float
    adequate: bool

    @property
    def follows(self) -> bool:
        """True where more of it than MOST_EXPLAINED follows the torque."""
        return self.explained >= MOST_EXPLAINED


def residual_tests(errors: Floats, variances: Floats, signals: Signals, measured: FrequencyResponse) -> Residuals:
    """From all prediction errors and their variances (m · o,)."""
    from scipy.signal import coherence, welch

    outputs = signals.positions.shape[1]
    values = (errors / np.sqrt(variances))[::outputs]
    skipped = len(values) // 20
    good = values[skipped:]
    centred = np.clip(good - good.mean(), -5 * good.std(), 5 * good.std())
    power = float(centred @ centred)
    lags = np.array([float(centred[lag:] @ centred[:-lag]) / power for lag in range(1, LAGS + 1)])
    length = int(min(len(centred) // 20, 4 / signals.sample_time))
    options = {"fs": 1 / signals.sample_time, "nperseg": length}
    frequency, shared = coherence(signals.torque[skipped:], centred, **options)
    _, spectrum = welch(centred, **options)
    segments = 2 * len(centred) / length - 1
    real = np.clip((shared - 1 / segments) / (1 - 1 / segments), 0.0, 1.0)  # coherence of unrelated signals is about 1/segments
    excited = np.interp(2 * np.pi * frequency, measured.omega, measured.excited.astype(float), left=0.0, right=0.0) > 0.5
    total = float(spectrum[excited].sum())
    explained = float((real * spectrum)[excited].sum() / total) if total > 0 else 0.0
    left = float(np.std(errors[::outputs][skipped:]) / np.std(np.diff(signals.positions[:, 0], 2)))
    if left < NOTHING_LEFT:
        explained, lags = 0.0, 0.0 * lags
    adequate = explained < MOST_EXPLAINED and float(np.abs(lags).max()) < MOST_REPEATED
    return Residuals(values, lags, 2 / len(centred) ** 0.5, left, explained, adequate)
