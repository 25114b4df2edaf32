"""Rigid joints beside elastic ones under sampled control: the limit against the ticks' own matrix, and against stiff gearboxes.

The matrix is written down here: the equations of motion with W⁻¹, each current loop as two states, scipy's matrix exponential over the two
parts of a tick, and commands that wait in a queue.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import gainroom as gr
from gainroom.analysis.proved_limit import proved_limit

SIZE, STEP, BANDWIDTH, RATIO = 4, 5e-4, 3000.0, 0.7
TICKS = 2.3  # of delay


def drawn(seed: int) -> tuple[gr.Plant, np.ndarray, np.ndarray]:
    """One to three of four joints are rigid; kp and kd."""
    rng = np.random.default_rng([77, seed])
    mixing = rng.normal(size=(SIZE, SIZE))
    rigid = rng.permutation(SIZE) < 1 + seed % (SIZE - 1)
    stiffness = np.where(rigid, np.inf, rng.uniform(3e3, 2e4, SIZE))
    damping = np.where(rigid, 0.0, rng.uniform(2, 10, SIZE))
    plant = gr.Plant(mixing @ mixing.T + 0.3 * np.eye(SIZE), rng.uniform(0.2, 2, SIZE), stiffness, damping)
    return plant, rng.uniform(20, 60, SIZE), rng.uniform(0.5, 3, SIZE)


def mechanics(plant: gr.Plant) -> tuple[np.ndarray, np.ndarray]:
    """Continuous A, with torque commands as constant states at its end, and which states the motors' positions are (n, states)."""
    elastic = np.flatnonzero(np.isfinite(plant.stiffness))
    n, moving = SIZE, SIZE + len(elastic)  # links, then the motors of elastic joints
    mass = np.diag(np.concatenate([np.where(np.isfinite(plant.stiffness), 0.0, plant.motor_inertia), plant.motor_inertia[elastic]]))
    mass[:n, :n] += np.linalg.inv(plant.link_inverse_inertia)
    twist, motors = np.zeros((len(elastic), moving)), np.eye(n, moving)
    for row, joint in enumerate(elastic):
        twist[row, [n + row, joint]] = 1.0, -1.0
        motors[joint, [n + row, joint]] = 1.0, 0.0
    inverse, whole = np.linalg.inv(mass), 2 * moving + 3 * n
    a = np.zeros((whole, whole))
    position, speed, torque = slice(0, moving), slice(moving, 2 * moving), slice(2 * moving, 2 * moving + n)
    rising, command = slice(2 * moving + n, 2 * moving + 2 * n), slice(2 * moving + 2 * n, whole)
    a[position, speed] = np.eye(moving)
    a[speed, position] = -inverse @ twist.T @ np.diag(plant.stiffness[elastic]) @ twist
    a[speed, speed] = -inverse @ twist.T @ np.diag(plant.damping[elastic]) @ twist
    a[speed, torque] = inverse @ motors.T
    a[torque, rising] = np.eye(n)
    a[rising, torque], a[rising, rising], a[rising, command] = (
        part * np.eye(n) for part in (-(BANDWIDTH**2), -2 * RATIO * BANDWIDTH, BANDWIDTH**2)
    )
    return a, np.hstack([motors, np.zeros((n, whole - n - moving))])


def spectral_radius(plant: gr.Plant, kp: np.ndarray, kd: np.ndarray) -> float:
    """Of one tick: states, the positions measured a tick ago, the last three commands, each of which acts 2.3 ticks later."""
    a, motors = mechanics(plant)
    n, states = SIZE, len(a) - SIZE
    part = TICKS % 1
    early, late = expm(a * part * STEP), expm(a * (1 - part) * STEP)
    total = states + 4 * n
    rows = np.eye(total)
    measured, before = motors @ rows[:states], rows[states : states + n]
    commands = [-(kp + kd / STEP)[:, None] * measured + (kd / STEP)[:, None] * before]
    commands += [rows[states + k * n : states + (k + 1) * n] for k in (1, 2, 3)]
    middle = early[:states, :states] @ rows[:states] + early[:states, states:] @ commands[3]
    after = late[:states, :states] @ middle + late[:states, states:] @ commands[2]
    return float(np.abs(np.linalg.eigvals(np.vstack([after, measured, *commands[:3]]))).max())


def loop(plant: gr.Plant, kp: np.ndarray, kd: np.ndarray) -> gr.Loop:
    return gr.build_loop(plant, gr.Drive(BANDWIDTH, RATIO, TICKS * STEP), gr.PD(kp, kd), sample_time=STEP)


@pytest.mark.parametrize("seed", range(6))
def test_the_limit_is_where_the_ticks_own_matrix_loses_stability(seed):
    plant, kp, kd = drawn(seed)
    limit = gr.gain_limit(loop(plant, kp, kd))
    assert limit.stable
    assert proved_limit(loop(plant, kp, kd)) is not None
    for share, stable in ((0.01, True), (0.5, True), (1 - 1e-5, True), (1 + 1e-5, False)):
        factor = share * limit.gain
        radius = spectral_radius(plant, factor * kp, factor * kd)
        assert (radius < 1) == stable


@pytest.mark.parametrize("seed", range(3))
def test_stiffer_and_stiffer_gearboxes_lead_to_the_rigid_joint(seed):
    """What is left falls with 1/K, from 1e8 N m/rad on."""
    plant, kp, kd = drawn(seed)
    exact = gr.gain_limit(loop(plant, kp, kd)).gain
    away = []
    for stiffness in (1e8, 1e9):
        nearly = replace(
            plant,
            stiffness=np.where(plant.elastic, plant.stiffness, stiffness),
            damping=np.where(plant.elastic, plant.damping, 1e-5 * stiffness),
        )
        away.append(abs(gr.gain_limit(loop(nearly, kp, kd)).gain / exact - 1))
    assert away[0] < 1e-3
    assert away[1] < 0.2 * away[0] + 1e-8
