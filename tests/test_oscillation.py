"""Frequency and growth of known exponentials, clean and in noise; nothing found where nothing oscillates."""

import math

import numpy as np
import pytest

from gainroom.simulation.oscillation import vibration, windows
from refusals import assert_refused

TICK = 5e-4
TIME = TICK * np.arange(2000)


def wave(frequency: float, growth: float, amplitude: float = 1.0, phase: float = 0.3) -> np.ndarray:
    return amplitude * np.exp(growth * TIME) * np.cos(frequency * TIME + phase)


@pytest.mark.parametrize("growth", [-20.0, -0.01, 0.0, 0.3, 25.0])
@pytest.mark.parametrize("frequency", [12.0, 150.0, 494.0, 3000.0, 6200.0])
def test_clean_exponential_beside_others(frequency, growth):
    """With a fast decay, an offset and a slow settling beside it; rounding of 1e-16 over a thousand samples is all the error there is."""
    rest = 3.0 + 0.5 * np.exp(-4.0 * TIME) + wave(0.37 * frequency + 90.0, -60.0, 2.0)
    found = vibration(wave(frequency, growth) + rest, TICK)
    assert found is not None
    assert found.frequency == pytest.approx(frequency, abs=1e-5)
    assert found.growth_rate == pytest.approx(growth, abs=1e-5)
    assert found.amplitude == pytest.approx(math.exp(growth * TIME[-1]), rel=1e-5)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("frequency", "level"), [(494.0, 0.1), (494.0, 1.0), (60.0, 0.3), (2500.0, 0.5)])
def test_exponential_in_noise(frequency, level, seed):
    """Cramér and Rao: no estimator's standard deviation is below √(24/N³) σ/A per sample (frequency and rate of a sustained sine)."""
    noise = level * np.random.default_rng(seed).normal(size=len(TIME))
    found = vibration(wave(frequency, 0.0) + noise, TICK)
    assert found is not None
    bound = math.sqrt(24 / len(TIME) ** 3) * level / TICK
    assert found.frequency == pytest.approx(frequency, abs=6 * bound)
    assert found.growth_rate == pytest.approx(0.0, abs=6 * bound)


def test_which_grows_is_found_before_which_fades():
    """The stronger one has almost died when the run ends."""
    found = vibration(wave(800.0, -8.0, 5.0) + wave(300.0, 2.0, 0.1), TICK)
    assert found is not None
    assert found.frequency == pytest.approx(300.0, abs=1e-4)


def test_the_one_that_grows_is_found_while_it_is_weak():
    """A million times smaller than one that fades, and still the one that will matter."""
    signal = wave(800.0, -1.0, 5.0) + wave(300.0, 2.0, 1e-6)
    strongest, growing = vibration(signal, TICK), vibration(signal, TICK, growing=True)
    assert strongest is not None
    assert growing is not None
    assert strongest.frequency == pytest.approx(800.0, abs=1e-6)
    assert growing.frequency == pytest.approx(300.0, abs=1e-3)
    assert growing.growth_rate == pytest.approx(2.0, abs=1e-3)


def test_several_signals_share_one_vibration():
    """Joints that swing together with other amplitudes, one of them not at all."""
    found = vibration(np.stack([wave(400.0, 1.0, 0.2), 0 * TIME + 7.0, wave(400.0, 1.0, 3.0, 2.0)], axis=1), TICK)
    assert found is not None
    assert found.frequency == pytest.approx(400.0, abs=1e-6)
    assert found.amplitude == pytest.approx(3.0 * math.exp(TIME[-1]), rel=1e-6)


def test_the_unit_does_not_matter():
    signal = wave(400.0, 1.0) + 0.1 * np.random.default_rng(0).normal(size=len(TIME))
    one, other = vibration(signal, TICK), vibration(1e-7 * signal, TICK)
    assert one is not None
    assert other is not None
    assert other.frequency == pytest.approx(one.frequency, rel=1e-9)
    assert other.amplitude == pytest.approx(1e-7 * one.amplitude, rel=1e-6)


@pytest.mark.parametrize(
    "signal",
    [
        np.zeros(2000),
        np.full(2000, -3.0),
        2.0 * TIME,
        np.exp(-5 * TIME),
        np.cos(3.0 * TIME),  # half a period
        np.exp(12 * TIME),
        np.ones(5),
    ],
    ids=["nothing", "constant", "ramp", "decay", "less than a period", "growth", "five samples"],
)
def test_nothing_oscillates(signal):
    assert vibration(signal, TICK) is None


def test_noise_is_no_vibration():
    """The strongest of all frequencies explains 2 ln N variances in one run of two; 4 times that in none of a hundred thousand."""
    for seed in range(25):
        assert vibration(1.0 + np.random.default_rng([7, seed]).normal(size=1500), TICK) is None


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: vibration(np.ones(100), 0.0), ["sample_time", "> 0"]),
        (lambda: vibration(np.full(100, np.nan), TICK), ["signal", "finite"]),
        (lambda: vibration(np.ones((4, 4, 4)), TICK), ["(4, 4, 4)"]),
    ],
)
def test_bad_calls_are_refused(make, words):
    assert_refused(make, words)


@pytest.mark.parametrize("count", [26, 100, 1000, 4001, 8999])
def test_windows_are_of_one_length_and_overlap_by_half(count):
    """Eight of a long motion, whose nine halves fill it but for less than one; none reaches beyond its end."""
    found = windows(count)
    lengths = {window.stop - window.start for window in found}
    assert len(lengths) == 1
    half = lengths.pop() // 2
    assert [window.start for window in found] == [half * k for k in range(len(found))]
    assert count - half < found[-1].stop <= count or len(found) >= 8
    assert found[-1].stop <= count
    assert windows(25) == []
