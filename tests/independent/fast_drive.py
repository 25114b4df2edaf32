"""Torques of a drive whose current loop may be of any speed: exact from row to row by scipy's matrix exponential.

Nothing here knows a likelihood. A command leaves at a row, arrives `delay` ticks later and is held; the loop is
τ̈ = ω² (u − τ) − 2ζω τ̇, and of infinite bandwidth τ = u. A command that arrives at a row's very moment acts there in an ideal loop.
"""

import math

import numpy as np
from scipy.linalg import expm


def torque(target: np.ndarray, delay: float, speed: float, damping: float = 0.8) -> np.ndarray:
    """(m,) the torque in each row of a held target (m,); delay [ticks] > 0, speed ω_c T_s [rad per tick], inf: ideal."""
    late = math.ceil(delay - 1e-12)
    sent = np.concatenate([np.full(late + 1, target[0]), target])  # the command of the row before counts from sent[late]
    after, before = sent[1 : len(target) + 1], sent[: len(target)]  # what acts at the row, and what acted until `rest` before it
    if math.isinf(speed):
        return after.copy()
    early, rest = _held(speed, damping, 1 - (late - delay)), _held(speed, damping, late - delay)
    state, made = np.array([target[0], 0.0]), np.empty(len(target))
    for k in range(len(target)):
        made[k] = state[0] if k == 0 else made[k]
        if k + 1 < len(target):
            for (move, push), command in ((early, before[k + 1]), (rest, after[k + 1])):
                state = move @ state + push * command
            made[k + 1] = state[0]
    return made


def _held(speed: float, damping: float, ticks: float) -> tuple[np.ndarray, np.ndarray]:
    system = np.array([[0, 1, 0], [-(speed**2), -2 * damping * speed, speed**2], [0, 0, 0]])
    moved = expm(system * max(ticks, 0.0))
    return moved[:2, :2], moved[:2, 2]


def multisine(count: int, highest: float, rng: np.random.Generator, lines: int = 60) -> np.ndarray:
    """(count,) of unit standard deviation; from `highest`/100 to `highest` [cycles per tick]."""
    frequencies = np.geomspace(highest / 100, highest, lines)
    phases = rng.uniform(0, 2 * np.pi, lines)
    values = np.sin(2 * np.pi * np.outer(np.arange(count), frequencies) + phases).sum(axis=1)
    return values / values.std()


def steps(count: int, rng: np.random.Generator, held: int = 15) -> np.ndarray:
    """(count,) of a new level every `held` rows."""
    return rng.uniform(-1.7, 1.7, count // held + 1).repeat(held)[:count]
