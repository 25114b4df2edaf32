"""Gains that are too soft for the weight: how many motions topple is known from stiffness alone, whatever delays and filters do."""

from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from draws import seeds
from gainroom.design.margin_slopes import Case
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


def case_of(pair) -> Case:
    parts = pair.loop.parts

    def loop(gains):
        return pair.loop.regained(gr.PD(gains[0], gains[1]))

    size = parts.plant.size
    return Case("", loop, np.eye(size), np.eye(size), np.zeros(size, dtype=bool), gr.Requirements(gain_margin=2.0))


@pytest.mark.parametrize("number", seeds(SHARE, ALL))
def test_what_topples_is_counted_by_stiffness_alone(number):
    several = 0
    for factor in (1.0, 0.3, 0.1, 0.01):
        pair = swinging(number, factor)
        gains = np.array([np.diagonal(pair.machine.gains[powers]) for powers in ((0, 0), (1, 0))] + [np.zeros(pair.machine.size)])
        count, truth = pair.loop.parts.plant.toppled(gains[0]), unstable(pair.machine)
        assert count is not None
        assert topples(pair.machine) == (count % 2 == 1)
        assert truth >= count
        if pair.machine.sample_time is None:  # and each of them by a root on the real axis
            found = roots(pair.machine)
            assert np.count_nonzero((found.real > 0) & (np.abs(found.imag) < 1e-6 * np.abs(found))) >= count
        case = case_of(pair)
        if case.topples(gains):
            assert truth > 0
            assert not case.stable(gains)
        several = max(several, count)
    if number in (0, 1, 2):
        assert several > 0  # these draws do topple


def test_a_pendulum_topples_below_its_own_stiffness():
    """m g l above the joint: kp must exceed it by what the gearbox in series takes, 1/kp + 1/K < 1/(m g l)."""
    weight, gearbox = 20.0, 100.0
    plant = gr.Plant(np.array([[1.0]]), 0.1, gearbox, 0.5, gravity_stiffness=np.array([[-weight]]))
    least = 1 / (1 / weight - 1 / gearbox)
    assert plant.toppled(np.array([0.999 * least])) == 1
    assert plant.toppled(np.array([1.001 * least])) == 0
    assert plant.toppling == 1
    for factor, stable in ((0.99, False), (1.01, True)):  # the same of all roots
        loop = gr.build_loop(plant, gr.Drive(3000.0, 0.9, 1e-3), gr.PD(factor * least, 10.0))
        assert gr.margins(loop).stable == stable


def test_no_gains_hold_what_the_gearboxes_do_not():
    plant = gr.Plant(np.eye(2), 0.1, 10.0, 0.5, gravity_stiffness=np.diag([-20.0, 5.0]))
    assert plant.toppled(np.array([1e9, 1e9])) == 1


@pytest.mark.parametrize(("side", "law"), [("link", "pd"), ("motor", "matrix")])
def test_what_is_not_symmetric_is_left_to_a_look(side, law):
    """Encoders on the links, and gains along directions that are not the joints."""
    plant = gr.Plant(np.eye(2), 0.1, 100.0, 0.5, gravity_stiffness=np.diag([-20.0, 5.0]))
    loop = gr.build_loop(plant, gr.Drive(3000.0, 0.9, 1e-3), gr.PD(np.ones(2), np.ones(2)), feedback=side)
    along = np.eye(2) if law == "pd" else np.array([[1.0, 0.0], [1.0, 1.0]])
    case = Case("", lambda gains: loop.regained(gr.PD(*gains[:2])), along, np.linalg.inv(along), np.zeros(2, dtype=bool), gr.Requirements())
    assert not case.topples(np.array([[1.0, 1.0], [1.0, 1.0], [0.0, 0.0]]))
