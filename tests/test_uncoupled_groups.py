"""Limbs that do not feel each other are looked at one by one: what is seen is what is seen of all together, wherever their joints stand."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.analysis.loop_samples import WHOLE, LoopsApart, directed_loop, joint_loops, margins_of_samples, take_samples
from gainroom.analysis.uncoupled_groups import uncoupled_groups
from gainroom.studies.loop_numbers import first_factor
from independent.loci.coupled_margins import coupled_margins
from independent.machine import Machine, unstable
from machines import between, paired

SIZES = (3, 1, 4)
STEP = 5e-4


def drawn(number: int, factor: float = 1.0):
    """Limbs of SIZES, their joints mixed up; every other one sampled, with gravity every third time."""
    rng = np.random.default_rng([number, 5])
    owner = rng.permutation(np.repeat(np.arange(len(SIZES)), SIZES))
    size, apart = len(owner), owner[:, None] != owner
    mixing = np.where(apart, 0.0, rng.normal(size=(size, size)) + 1.5 * np.eye(size))
    w = mixing @ mixing.T
    pulls = np.where(apart, 0.0, rng.normal(size=(size, size)))
    delay, inertia = float(rng.uniform(1e-3, 4e-3)), between(rng, 0.05, 2.0, size)
    crossover = rng.uniform(0.02, 0.1, size) / (delay + STEP)
    kd = factor * inertia * crossover
    kp = kd * crossover * between(rng, 0.1, 0.4, size)
    stiffness = between(rng, 2e3, 5e4, size)
    gravity = 0.05 * kp.min() * (pulls + pulls.T) / size if number % 3 == 0 else None
    machine = Machine(
        w, inertia, stiffness, between(rng, 0.1, 0.3, size) * np.sqrt(stiffness * inertia), np.zeros(size), np.zeros(size), gravity,
        None, np.full(size, 3000.0), np.full(size, 0.9), np.full(size, delay),
        {(0, 0): np.diag(kp), (1, 0): np.diag(kd)}, None, None, "motor", STEP if number % 2 else None,
    )  # fmt: skip
    return paired(machine, gr.PD(kp, kd), "apart"), np.array([kp, kd, np.zeros(size)]), owner


def together(loop):
    eye = np.eye(loop.size)
    return directed_loop(loop, eye, eye, np.zeros(loop.size, dtype=bool))


@pytest.mark.slow
@pytest.mark.parametrize("number", range(12))
def test_margins_and_roots(number):
    for factor in (1.0, 60.0):
        pair, gains, owner = drawn(number, factor)
        found = uncoupled_groups(pair.loop)
        assert sorted(joints.tolist() for joints, _ in found) == sorted(np.flatnonzero(owner == k).tolist() for k in range(len(SIZES)))
        loops = joint_loops(pair.loop)
        assert isinstance(loops, LoopsApart)
        seen, count = take_samples(loops, gains, WHOLE), unstable(pair.machine)
        assert seen.followed
        assert seen.unstable == count
        assert (count > 0) == (factor > 1)
        if count:
            continue
        exact, margins = coupled_margins(pair.loop), margins_of_samples(seen, pair.machine.size)
        both_ways = min(exact.limit.gain, 1 / max(exact.limit.lower_gain, 1e-300))
        assert_allclose(margins.limit.gain, both_ways, rtol=1e-6)  # polished on both sides
        assert_allclose(margins.common_phase_margin, exact.common_phase_margin, rtol=1e-6)
        assert_allclose(margins.peak_sensitivity, exact.peak_sensitivity, rtol=1e-3)  # peaks of both are where samples told them to be
        whole = take_samples(together(pair.loop), gains, WHOLE)
        assert_allclose(*(one.delay_crossings(np.inf)[:, 0].min(initial=np.inf) for one in (seen, whole)), rtol=1e-5)
        assert_allclose(first_factor(pair.loop), exact.limit.gain, rtol=1e-6)


@pytest.mark.parametrize("number", range(6))
def test_what_moves_them_is_the_same(number):
    pair, gains, _ = drawn(number)
    one, all_of_it = take_samples(joint_loops(pair.loop), gains, WHOLE), take_samples(together(pair.loop), gains, WHOLE)
    other = gains * np.random.default_rng(number).uniform(0.97, 1.03, gains.shape)
    assert one.unstable == 0
    for asked in (
        lambda seen: seen.crossings(other, True, True, 1.0),
        lambda seen: seen.crossings(other, False, True, 1.0),
        lambda seen: seen.crossings(other, True, False, 1.0),
        lambda seen: seen.delays(other, 0.01),
        lambda seen: seen.ends(other, True, 1.0),
    ):
        (margins, moves), (right, right_moves) = asked(one), asked(all_of_it)
        order, right_order = np.argsort(margins[:, 0]), np.argsort(right[:, 0])
        assert_allclose(margins[order], right[right_order], rtol=1e-5, atol=1e-9)  # followed to 1e-6 of a crossing
        assert_allclose(moves[order], right_moves[right_order], atol=1e-3 * np.abs(right_moves).max(initial=1e-9))


def test_what_is_coupled_stays_whole():
    pair, _, _ = drawn(0)
    plant = pair.loop.parts.plant
    touching = replace(plant, link_inverse_inertia=plant.link_inverse_inertia + 1e-3)
    whole = gr.build_loop(touching, pair.loop.parts.drives, pair.loop.parts.controller, "motor")
    assert uncoupled_groups(whole) == []
    full = gr.PD(np.ones((8, 8)), np.ones(8))
    assert uncoupled_groups(gr.build_loop(plant, pair.loop.parts.drives, full, "motor")) == []
