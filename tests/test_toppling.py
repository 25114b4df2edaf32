"""Gains that are too soft for the weight: how many motions topple is known from stiffness alone, whatever delays and filters do."""

from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from draws import seeds
from gainroom.analysis.stability import unstable_roots
from gainroom.design.margin_slopes import GainCase
from independent.machine import roots, topples, unstable
from machines import between, limbs, paired

SHARE, ALL = 24, 400


def swinging(number: int, factor: float):
    """`limbs` whose joints are pulled back and apart by gravity, and its gains times `factor`; `number` % 4 == 3: sampled."""
    rng, pair = np.random.default_rng([31, number]), limbs(2017, number)
    size, kp = pair.machine.size, np.diagonal(pair.machine.gains[0, 0])
    slope = rng.normal(size=(size, size)) / np.sqrt(size)
    machine = replace(pair.machine, gravity=between(rng, 0.03, 3.0) * (slope + slope.T) * float(kp.mean())).scaled(factor)
    kp, kd = (np.diagonal(machine.gains[powers]) for powers in ((0, 0), (1, 0)))
    return paired(machine, gr.PD(kp, kd), "")


def case_of(pair) -> GainCase:
    parts = pair.loop.parts

    def loop(gains):
        return pair.loop.regained(gr.PD(gains[0], gains[1]))

    size = parts.plant.size
    return GainCase("", loop, np.eye(size), np.eye(size), np.zeros(size, dtype=bool), gr.Requirements(gain_margin=2.0))


@pytest.mark.slow
@pytest.mark.parametrize("number", seeds(SHARE, ALL))
def test_what_topples_is_counted_by_stiffness_alone(number):
    several = 0
    for factor in (1.0, 0.3, 0.1, 0.01):
        pair = swinging(number, factor)
        gains = np.array([np.diagonal(pair.machine.gains[powers]) for powers in ((0, 0), (1, 0))] + [np.zeros(pair.machine.size)])
        count, truth = pair.loop.parts.plant.toppled(np.diag(gains[0])), unstable(pair.machine)
        assert count is not None
        assert topples(pair.machine) == (count % 2 == 1)
        assert truth >= count
        if pair.machine.sample_time is None:  # and each of them by a root on the real axis
            found = roots(pair.machine)
            assert np.count_nonzero((found.real > 0) & (np.abs(found.imag) < 1e-6 * np.abs(found))) >= count
        if pair.loop.topples:
            assert truth > 0
            assert not gr.is_stable(pair.loop)
            assert unstable_roots(pair.loop) == truth
            assert not case_of(pair).stable(gains)
        several = max(several, count)
    if number in (0, 1, 2):
        assert several > 0  # these draws do topple


def test_roots_are_counted_where_gains_are_far_too_soft():
    """What topples is 50 times slower than every resonance here: sampling that begins above it counts 3."""
    pair = swinging(204, 0.01)
    assert unstable_roots(pair.loop) == unstable(pair.machine) == 2


@pytest.mark.parametrize("number", range(8))
def test_a_factor_on_all_gains_counts(number):
    """A loop whose gains are scaled is the loop with those gains, up and down."""
    pair = swinging(number, 0.1)
    for factor in (0.01, 0.1, 1.0, 3.0, 10.0, 100.0):
        gains = [factor * np.diagonal(pair.machine.gains[powers]) for powers in ((0, 0), (1, 0))]
        assert pair.loop.scaled(factor).topples == pair.loop.regained(gr.PD(*gains)).topples
        assert pair.loop.scaled(factor).scaled(1 / factor).topples == pair.loop.topples


def test_a_pendulum_topples_below_its_own_stiffness():
    """m g l above the joint: kp must exceed it by what the gearbox in series takes, 1/kp + 1/K < 1/(m g l)."""
    weight, gearbox = 20.0, 100.0
    plant = gr.Plant(np.array([[1.0]]), 0.1, gearbox, 0.5, gravity_stiffness=np.array([[-weight]]))
    least = 1 / (1 / weight - 1 / gearbox)
    assert plant.toppled(np.array([[0.999 * least]])) == 1
    assert plant.toppled(np.array([[1.001 * least]])) == 0
    assert plant.toppling == 1
    for factor, stable in ((0.99, False), (1.01, True)):  # the same of all roots
        loop = gr.build_loop(plant, gr.Drive(3000.0, 0.9, 1e-3), gr.PD(factor * least, 10.0))
        assert gr.margins(loop).stable == stable


def test_no_gains_hold_what_the_gearboxes_do_not():
    plant = gr.Plant(np.eye(2), 0.1, 10.0, 0.5, gravity_stiffness=np.diag([-20.0, 5.0]))
    assert plant.toppled(1e9 * np.eye(2)) == 1


def test_gains_of_several_joints_are_a_matrix():
    """A spring between two joints that both topple holds them apart, not up."""
    plant = gr.Plant(np.eye(2), 0.1, 100.0, 0.5, gravity_stiffness=np.diag([-20.0, -20.0]))
    for kp, count in ((np.diag([30.0, 30.0]), 0), (30.0 * np.array([[1.0, -1.0], [-1.0, 1.0]]), 1)):
        loop = gr.build_loop(plant, gr.Drive(3000.0, 0.9, 1e-3), gr.PD(kp, 5.0 * np.eye(2)))
        assert plant.toppled(kp) == count
        assert loop.topples == (count > 0)
        assert (unstable_roots(loop) > 0) == (count > 0)


@pytest.mark.parametrize(
    ("side", "law"),
    [
        ("link", gr.PD(np.ones(2), np.ones(2))),
        ("motor", gr.PD(np.array([[1.0, 0.5], [0.0, 1.0]]), np.eye(2))),
        ("motor", gr.PID(np.ones(2), np.ones(2), np.ones(2))),
    ],
)
def test_where_stiffness_alone_does_not_tell(side, law):
    """Encoders on the links, gains that are not symmetric, and integrators, which are as stiff as it takes."""
    plant = gr.Plant(np.eye(2), 0.1, 100.0, 0.5, gravity_stiffness=np.diag([-20.0, 5.0]))
    assert not gr.build_loop(plant, gr.Drive(3000.0, 0.9, 1e-3), law, feedback=side).topples
