"""Margins that are proved without being worked out: against roots of the whole equations, and never beyond margins that are worked out."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.limbs import limbs_of
from gainroom.analysis.proved_limit import keeps_margins, provable
from gainroom.system.plant import Plant
from independent.machine import unstable
from machines import Pair, limbs

SHARE = 10
DRIVE = gr.Drive(4000.0, 0.9, 2e-3)


def proved(loop: gr.Loop, gain: float, delay: float) -> bool:
    """Of every limb, as robots on a fixed base are looked at."""
    found = [limb for _, limb in limbs_of(loop)] or [loop]
    modes = [provable(limb) for limb in found]
    return all(modal is not None and keeps_margins(limb, modal, gain, delay) for limb, modal in zip(found, modes, strict=True))


def stable(pair: Pair, gain: float, delay: float, rng: np.random.Generator) -> bool:
    """By the roots of the whole machine: any factor of its own on each joint up to `gain`, and by themselves delays up to `delay`."""
    factors = [np.full(pair.machine.size, factor) for factor in (1.0, 1 / gain, gain)]
    factors += [np.where(np.arange(pair.machine.size) == k, factor, 1.0) for k in range(pair.machine.size) for factor in (1 / gain, gain)]
    factors += list(gain * rng.uniform(0.05, 1.0, (6, pair.machine.size)))
    machines = [pair.machine.delayed(share * delay) for share in (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)]
    for one in factors:
        scaled = pair.machine
        for joint, factor in enumerate(one.tolist()):
            scaled = scaled.with_joint_scaled(joint, factor)
        machines.append(scaled)
    return not any(unstable(machine) for machine in machines)


def drawn(count: int) -> list[tuple[Pair, gr.Margins]]:
    """Stable continuous robots of limbs, and their margins as they are worked out."""
    found, number = [], 0
    while len(found) < count:
        pair = limbs(515, number)
        number += 1
        if pair.loop.sample_time is None and not unstable(pair.machine):
            found.append((pair, gr.margins(pair.loop)))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("count", [SHARE, pytest.param(200, marks=pytest.mark.population)])
def test_what_is_proved_holds_and_mostly_it_is_proved(count: int):
    """At 0.9 of the margins: 6 of 10 are proved, at least, or the proof saves nothing; all of them have no unstable root anywhere."""
    rng, shown = np.random.default_rng(5), 0
    for pair, margins in drawn(count):
        gain, delay = max(1.0, min(0.9 * margins.least_gain_margin, 20.0)), min(0.9 * margins.delay_margin, 5e-3)
        if proved(pair.loop, gain, delay):
            shown += 1
            assert stable(pair, gain, delay, rng)
    assert shown >= 0.6 * count


@pytest.mark.slow
@pytest.mark.parametrize("count", [SHARE, pytest.param(200, marks=pytest.mark.population)])
def test_nothing_is_proved_beyond_a_margin(count: int):
    """A root is on the boundary at the margin itself: 1e-6 beyond it, which is more than margins are off by, there is nothing to prove."""
    for pair, margins in drawn(count):
        beyond = 1 + 1e-6
        for gain in (margins.limit.gain, margins.one_loop.gain_margin.min()):
            assert not (math.isfinite(gain) and proved(pair.loop, beyond * gain, 0.0))
        assert not (math.isfinite(margins.delay_margin) and proved(pair.loop, 1.0, beyond * margins.delay_margin))


def resonant(gain: float) -> gr.Loop:
    """Two joints with lightly damped gearboxes, whose resonance stands out of the rest of L."""
    plant = Plant(np.array([[1.0, 0.2], [0.2, 1.5]]), np.array([0.2, 0.3]), np.array([4e5, 5e5]), np.array([4.0, 5.0]))
    return gr.build_loop(plant, DRIVE, gr.PD(gain * 200.0, gain * 20.0))


def test_delays_that_turn_a_resonance_more_than_once():
    """At 1.4 times the factor with which it reaches −1 it is stable with half a period more delay, and again four periods later.

    In between it passes −1: stable at both ends says nothing. At a quarter of that factor the resonance is below 1, at any delay.
    """
    limit = gr.gain_limit(resonant(1.0))
    period = 2 * math.pi / limit.frequency
    large, small = (resonant(share * limit.gain).delayed(period / 2) for share in (1.4, 0.35))
    assert gr.is_stable(large)
    assert gr.is_stable(large.delayed(4 * period))
    assert not gr.is_stable(large.delayed(period / 2))
    assert not proved(large, 1.0, 4 * period)
    assert gr.margins(small).delay_margin > 4 * period
    assert proved(small, 1.0, 4 * period)


def test_what_no_proof_is_known_for():
    plant, law = Plant(np.array([[1.0, 0.2], [0.2, 1.5]]), np.array([0.2, 0.3]), np.array(1e4), np.array(5.0)), gr.PD(100.0, 10.0)
    assert proved(gr.build_loop(plant, DRIVE, law), 1.5, 5e-4)
    sampled = gr.build_loop(plant, DRIVE, law, sample_time=5e-4)
    assert proved(sampled, 1.5, 0.0)
    assert not proved(sampled, 1.5, 5e-4)
    hanging = Plant(plant.link_inverse_inertia, plant.motor_inertia, plant.stiffness, plant.damping, gravity_stiffness=np.diag([5.0, 5.0]))
    assert not proved(gr.build_loop(hanging, DRIVE, law), 1.5, 5e-4)
    assert not proved(gr.build_loop(plant, DRIVE, gr.PD(np.array([[100.0, 5.0], [5.0, 100.0]]), 10.0)), 1.5, 5e-4)
