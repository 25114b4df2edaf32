"""The fastest growing vibration out of signals made of known exponentials."""

import numpy as np
import pytest

from gainroom.errors import GainroomError
from gainroom.simulation.growth import fastest_growth

TICK = 5e-4
TIME = TICK * np.arange(540)


def recording(parts, channels=8, seed=0):
    """Σ amplitude · e^{rate t} cos(ω t + phase), every part with its own shape over the channels."""
    draw = np.random.default_rng(seed)
    total = np.zeros((len(TIME), channels))
    for amplitude, rate, omega in parts:
        shape, phase = draw.normal(size=channels), draw.uniform(0, 6, channels)
        total += amplitude * np.exp(rate * TIME)[:, None] * np.cos(omega * TIME[:, None] + phase) * shape
    return total


@pytest.mark.parametrize("rate", [-3.0, -0.05, 0.05, 8.0])
def test_one_among_many(rate):
    """Beside stronger ones that die, a near twin, and drift."""
    parts = [(1.0, -40.0, 230.0), (0.3, -0.5 - abs(rate), 100.0), (1.0, rate - 12.0, 523.0), (0.05, rate, 519.0)]
    drift = np.outer(TIME, np.linspace(-1, 1, 8)) + 0.3
    found = fastest_growth(recording(parts) + drift, TICK)
    assert found is not None
    assert found.rate == pytest.approx(rate, abs=1e-3)
    assert found.frequency == pytest.approx(519.0, abs=1e-3)


def test_what_is_too_weak_or_too_slow_is_not_counted():
    strong, weak, slow = (1.0, -2.0, 400.0), (1e-5, 1.0, 700.0), (0.5, 3.0, 20.0)
    found = fastest_growth(recording([strong, weak, slow]), TICK)
    assert found is not None
    assert found.frequency == pytest.approx(400.0, abs=1e-3)
    assert fastest_growth(np.zeros((100, 3)), TICK) is None
    assert fastest_growth(recording([(1.0, 0.0, 3.0)]), TICK) is None


def test_refusals():
    with pytest.raises(GainroomError, match="k >= 60"):
        fastest_growth(np.ones((20, 3)), TICK)
    with pytest.raises(GainroomError, match="finite"):
        fastest_growth(np.full((100, 3), np.nan), TICK)
