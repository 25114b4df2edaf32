"""Gravity makes links swing as slowly as it likes, and where nothing resists that, the pole lies on the stability boundary.

No pole may be taken for a free motion and passed unseen: roots are counted by independent/machine.py.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import gainroom as gr
from independent.loci.first_crossing import slope
from independent.machine import Machine, unstable
from machines import between, paired

EVERY_TIME = {(1, 1e-4), (2, 1e-4), (3, 1e-2), (9, 1e-6), (1, 1e-8), (2, 1e-10)}
"""Of which four were called stable, or refused, while slow swings passed for free motions."""


def swinging(number: int, slow: float) -> Machine:
    """Joints of which the links swing in one direction `slow` times as stiffly as in others, and topple in some."""
    rng = np.random.default_rng([number, 11])
    size = int(rng.integers(2, 5))
    mixing = rng.normal(size=(size, size)) + 1.5 * np.eye(size)
    directions = np.linalg.qr(rng.normal(size=(size, size)))[0]
    pulls = rng.choice([-1.0, 1.0], size) * between(rng, 0.5, 3.0, size)
    pulls[0] = slow
    inertia, delay = between(rng, 0.05, 2.0, size), float(rng.uniform(1e-3, 4e-3))
    kd = inertia * rng.uniform(0.05, 0.4, size) / (delay + 5e-4)
    kp = kd * between(rng, 5.0, 60.0, size)
    stiffness = between(rng, 2e3, 5e4, size)
    return Machine(
        mixing @ mixing.T, inertia, stiffness, between(rng, 0.01, 0.3, size) * np.sqrt(stiffness * inertia), np.zeros(size), np.zeros(size),
        directions @ (pulls[:, None] * directions.T), None, np.full(size, 3000.0), np.full(size, 0.9), np.full(size, delay),
        {(0, 0): np.diag(kp), (1, 0): np.diag(kd)}, None, None, "motor", 5e-4 if number % 2 else None,
    )  # fmt: skip


def lost_beside_the_slowest(machine: Machine, kp) -> bool:
    """Whether round-off of L(0) = (1/G + 1/K) kp, as large as its largest eigenvalue, hides others by more than the 1e-6 that certificates
    tell apart. How it falls, and so whether such a limit is found or refused, is up to the processor."""
    at_rest = np.linalg.eigvals((np.linalg.inv(machine.gravity) + np.diag(1 / machine.stiffness)) * kp)
    return np.finfo(float).eps * np.abs(at_rest).max() > 1e-6 * np.abs(at_rest).min()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "slow"),
    [
        pytest.param(number, slow, marks=[] if (number, slow) in EVERY_TIME else pytest.mark.population)
        for number in range(1, 10)
        for slow in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
    ],
)
def test_roots_and_both_sides_of_the_limit(number, slow):
    machine = swinging(number, slow)
    kp, kd = (np.diagonal(machine.gains[powers, 0]) for powers in (0, 1))
    pair = paired(machine, gr.PD(kp, kd), "swinging")
    refused = []
    for factor in (0.05, 1.0, 20.0):
        try:
            found, count = gr.joint_margins(pair.loop.scaled(factor)), unstable(machine.scaled(factor))
        except gr.GainroomError as error:
            refused.append(str(error))
            continue
        assert found.stable == (count == 0)
        assert found.unstable_roots == count
        if count == 0 and found.limit.gain < 1e3:
            assert unstable(machine.scaled(factor * found.limit.gain * (1 - 1e-5))) == 0  # certified to 1e-6
            assert unstable(machine.scaled(factor * found.limit.gain * (1 + 1e-5))) > 0
    assert not refused or lost_beside_the_slowest(machine, kp)
    assert all("round-off hides where the gains hold them" in text for text in refused)


def test_loci_on_the_imaginary_axis_have_slopes():
    """Neither infinite nor without a number, as warnings are errors here; one that has come to 0 has none to go by."""
    on_axis, beside = np.array([1j, -2e-300j, 0]), np.array([1e-12 + 1j, -3 + 1e-3j])
    assert np.isfinite(slope(on_axis)).all()
    assert np.array_equal(np.sign(slope(on_axis)), [1, -1, 0])
    assert np.array_equal(slope(beside), beside.imag / beside.real)


@pytest.mark.parametrize("number", range(12))
def test_what_topples_by_itself(number):
    machine = replace(swinging(number, (-1.0) ** (number // 2) * 0.1), sample_time=None)
    plant = paired(machine, gr.PD(1.0, 1.0), "swinging").loop.parts.plant
    assert plant.toppling == unstable(machine.scaled(0.0))


@pytest.mark.parametrize("number", range(6))
def test_sharp_resonances_are_exact(number):
    """Equal limbs of which some joints hardly damp: their modes are not those of the undamped mechanism, by more than they are wide."""
    rng = np.random.default_rng([number, 12])
    mixing = rng.normal(size=(2, 2)) + 1.5 * np.eye(2)
    inverse_inertia = np.kron(np.eye(2), mixing @ mixing.T) + 1e-3
    inertia, stiffness = (np.tile(between(rng, low, high, 2), 2) for low, high in ((0.05, 2.0), (2e3, 5e4)))
    damping = 0.01 * np.sqrt(stiffness * inertia) * rng.permutation([1.0, 1e-2, 1e-4, 1e-6])
    plant = gr.Plant(inverse_inertia, inertia, stiffness, damping)
    form = plant.mechanism()
    joined = np.block([[np.zeros_like(form.mass), np.eye(len(form.mass))], [-form.stiffness, -form.damping]])
    masses = np.block([[np.eye(len(form.mass)), np.zeros_like(form.mass)], [np.zeros_like(form.mass), form.mass]])
    exact = scipy.linalg.eigvals(joined, masses)
    found = plant.corners().poles
    for pole in exact[(exact.imag > 1.0) & (-exact.real < 0.01 * exact.imag)]:
        assert np.abs(found - pole).min() < 0.5 * -pole.real  # a sample there is within the resonance


@pytest.mark.parametrize("number", range(12))
def test_what_drifts_and_topples_is_among_the_corners(number):
    """Joints with friction to ground, apart from each other: every pole is one of the four of a joint."""
    rng = np.random.default_rng([number, 13])
    size = 3
    motor, link = between(rng, 0.05, 2.0, size), between(rng, 0.1, 20.0, size)
    stiffness, gravity = between(rng, 1e3, 1e5, size), between(rng, 1e-3, 50.0, size) * np.array([-1.0, 1.0, 0.0])
    friction = between(rng, 1e-2, 30.0, size)
    free = gr.Plant(np.diag(1 / link), motor, stiffness, 0.0, link_viscous=friction, gravity_stiffness=np.diag(gravity))
    corners = free.corners().every
    found = corners[corners.imag == 0].real
    for joint in range(size):
        m, j, k, g, c = motor[joint], link[joint], stiffness[joint], gravity[joint], friction[joint]
        exact = np.roots(np.polyadd(np.polymul([m, 0, k], [j, c, k + g]), [-k * k]))
        slow = exact[(np.abs(exact.imag) < 1e-9 * np.abs(exact)) & (np.abs(exact) > 1e-9) & (np.abs(exact) < 1e-2 * np.sqrt(k / m))]
        for pole in slow.real:  # which the spring does not see
            assert np.abs(found - pole).min() < 0.05 * abs(pole)
