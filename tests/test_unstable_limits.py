"""Limits of loops that are unstable as they stand: the highest gains below that are stable, with no stable ones between (own roots).

Of ordinary chains of joints with gains at and beyond their limit, which have one below it whatever the factor is.
"""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.proved_limit import proved_limit
from independent.loci.limit import limit_from_loci
from independent.machine import unstable
from machines import between, chain, limbs

FACTORS = (1.0, 1 + 1e-9, 1.001, 1 / 0.9, 2.0, 4.0, 37.0)
"""Of the limit. 1.0 puts the loop on the boundary, where a count says anything; so do 2 and 4 at factors that are round numbers."""


def chain_of_joints(seed: int, sample_time: float | None = None) -> gr.Loop:
    """4 or 12 joints in a row, links of 0.1 to 10 kg m² apart, 4 Hz on every motor; every other one with a delay of each joint's own."""
    rng = np.random.default_rng([seed, 17])
    n = (4, 4, 12)[seed % 3]
    mass = np.zeros((n, n))
    for i, size in enumerate(between(rng, 0.1, 10, n)):
        moved = np.where(np.arange(n) <= i, rng.uniform(0.3, 1, n), 0.0)
        mass += size * np.outer(moved, moved)
    motor, stiffness = between(rng, 0.1, 3, n), between(rng, 1e3, 3e4, n)
    plant = gr.Plant(np.linalg.inv(mass), motor, stiffness, 0.01 * np.sqrt(stiffness * motor))
    kp = motor * (2 * math.pi * 4) ** 2
    delays = rng.uniform(1e-3, 4e-3, n) if seed % 2 and sample_time is None else np.full(n, 2e-3)
    return gr.build_loop(plant, [gr.Drive(4000.0, 0.9, float(delay)) for delay in delays], gr.PD(kp, 0.05 * kp), sample_time=sample_time)


def wrong_factors(seed: int, sample_time: float | None) -> list[str]:
    loop = chain_of_joints(seed, sample_time)
    limit = gr.gain_limit(loop).gain
    wrong = []
    for factor in FACTORS:
        for way in (gr.gain_limit, *([limit_from_loci] if seed % 3 < 2 else [])):
            found = way(loop.scaled(limit * factor))
            right = found.certified and abs(found.gain * factor - 1) < 2e-6  # both ends of a certificate lie 1e-6 beside
            if not right or (found.stable and factor > 1 + 2e-6):
                wrong.append(f"{seed}: {factor} times the limit: {found}")
    return wrong


@pytest.mark.parametrize("sample_time", [None, 1e-3])
def test_gains_beyond_the_limit_have_the_same_limit(sample_time):
    assert not [wrong for seed in (0, 1) for wrong in wrong_factors(seed, sample_time)]


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 1e-3])
def test_gains_beyond_the_limit_of_many_chains_have_the_same_limit(sample_time):
    assert not [wrong for seed in range(2, 32) for wrong in wrong_factors(seed, sample_time)]


def nearest_is_wrong(pair) -> str:
    """Where the limit of an unstable loop is not what the independent roots say, at it and at many factors up to 1."""
    found = gr.gain_limit(pair.loop)
    if found.stable or found.gain == 0:
        return f"{pair.kind}: {found}"
    apart = 1 - found.gain
    inside, *between_them = [found.gain * (1 - 1e-4), *(found.gain + apart * np.append(1e-4, np.linspace(0.02, 1, 25)))]
    counts = [unstable(pair.machine.scaled(factor)) for factor in (inside, *between_them)]
    return "" if counts[0] == 0 and all(counts[1:]) else f"{pair.kind}: {found.gain}: {counts}"


def unstable_ones(draw, numbers):
    """Pairs at 1.2 to 30 times their limit; loops without a limit are left out."""
    for number in numbers:
        pair = draw(3, number)
        try:
            limit = gr.gain_limit(pair.loop)
        except gr.GainroomError:  # as some wide draws are: other tests say which
            continue
        if limit.stable and math.isfinite(limit.gain):
            yield pair.scaled(limit.gain * float(between(np.random.default_rng(number), 1.2, 30)))


@pytest.mark.slow
@pytest.mark.parametrize("draw", [limbs, chain])
def test_nearest_stable_gains_below(draw):
    found = [nearest_is_wrong(pair) for pair in unstable_ones(draw, range(12))]
    assert len(found) > 4
    assert not any(found), [one for one in found if one]


@pytest.mark.population
@pytest.mark.parametrize("draw", [limbs, chain])
@pytest.mark.parametrize("start", range(12, 212, 20))
def test_nearest_stable_gains_below_many(draw, start):
    assert not [wrong for pair in unstable_ones(draw, range(start, start + 20)) if (wrong := nearest_is_wrong(pair))]


def test_an_unstable_chain_is_proved():
    """Followed from the crossing on, without a look at loci: two chains, one with delays of each joint's own."""
    for seed in (0, 1):
        loop = chain_of_joints(seed)
        limit = gr.gain_limit(loop).gain
        found = proved_limit(loop.scaled(3 * limit))
        assert found is not None
        assert not found.stable
        assert found.gain == pytest.approx(1 / 3, rel=1e-9)  # the same crossing, polished to the last digits
