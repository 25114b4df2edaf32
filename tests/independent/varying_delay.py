"""A sampled joint whose commands each have a delay of their own, simulated exactly: for many sequences of delays at once.

Time goes in parts of a tick, on which all delays lie; within a step the motion is that of a constant torque (matrix exponential).
A command that a later one has overtaken is dropped.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.linalg import expm

from .joint import PDJoint

PARTS = 4
"""Steps per tick."""


@dataclass(frozen=True)
class Sampled:
    """`joint` under PD every `tick` [s], its velocity a backward difference; the joint's delay is a whole number of steps."""

    joint: PDJoint
    tick: float

    @property
    def steps(self) -> int:
        """Steps of constant delay."""
        return round(PARTS * self.joint.delay / self.tick)

    @property
    def ticks(self) -> int:
        """Ticks of a run in each third of which the link swings once on its gearbox, with the motor held; 900 at least."""
        swing = (self.joint.stiffness / self.joint.link_inertia) ** 0.5
        return max(900, int(3 * 2 * pi / swing / self.tick))

    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """x ↦ Φ x + Γ v over a step; x: motor, link, their velocities, torque and its rate; v: the command that acts."""
        one = self.joint
        spring, damper, wide = one.stiffness, one.damping, one.bandwidth
        a, b = np.zeros((6, 6)), np.zeros((6, 1))
        a[0, 2] = a[1, 3] = a[4, 5] = 1.0
        a[2] = np.array([-spring, spring, -damper, damper, 1.0, 0.0]) / one.motor_inertia
        a[3] = np.array([spring, -spring, damper, -damper, 0.0, 0.0]) / one.link_inertia
        a[5, 4], a[5, 5], b[5, 0] = -(wide**2), -2 * one.damping_ratio * wide, wide**2
        both = expm(np.block([[a, b], [np.zeros((1, 7))]]) * self.tick / PARTS)
        return both[:6, :6], both[:6, 6]


def growth(loop: Sampled, delays: Callable[[int, np.ndarray], np.ndarray], count: int, ticks: int, seed: int) -> np.ndarray:
    """Largest torque of the last third of a run of `ticks` over that of the first, for each of `count` sequences of delays.

    delays   (k, torque commands (k + 1, count) so far) → steps (count,) by which command k comes late, or early if negative
    """
    one, (phi, gamma), base = loop.joint, loop.matrices(), loop.steps
    state = np.random.default_rng(seed).normal(size=(6, count))
    state[4:] = 0.0
    state[2:4] *= 2 * pi * 10
    torque, arrival = np.zeros((ticks, count)), np.full((ticks, count), -1, dtype=np.int64)
    newest, before = np.full(count, -1), state[0].copy()
    acting, column = np.zeros(count), np.arange(count)
    furthest = 0
    for k in range(ticks):
        torque[k] = -one.kp * state[0] - one.kd * (state[0] - before) / loop.tick
        before = state[0].copy()
        late = base + delays(k, torque[: k + 1])
        assert late.min() >= 0
        arrival[k] = PARTS * k + late
        furthest = max(furthest, int(late.max()))
        for step in range(PARTS * k, PARTS * (k + 1)):
            for j in range(max(0, k - furthest // PARTS - 1), k + 1):
                newest = np.where((arrival[j] <= step) & (newest < j), j, newest)
            acting = np.where(newest >= 0, torque[newest, column], 0.0)
            state = phi @ state + gamma[:, None] * acting
    third = ticks // 3
    size = np.abs(torque)
    return size[-third:].max(axis=0) / size[:third].max(axis=0)


def adversaries(width: int, period: float, lag: int = 0) -> tuple[Callable[[int, np.ndarray], np.ndarray], int]:
    """Sequences of delays in [−lag, width − lag] steps that excite an oscillation of `period` ticks, and their number.

    Constant at either end; square waves of one and two cycles per oscillation and near; and greedy: a command comes late when its step has
    the sign that the torque had some part of the oscillation ago, so that what is missing pushes at the same phase of every cycle.
    """
    waves = period * np.array([0.25, 0.45, 0.5, 0.55, 0.9, 1.0, 1.1, 2.0])
    lags = np.maximum(np.round(period * np.arange(10) / 10), 0).astype(int)

    def delays(k: int, torque: np.ndarray) -> np.ndarray:
        step = torque[k] - torque[k - 1] if k else torque[k]
        late = np.zeros(20, dtype=bool)
        late[1] = True
        late[2:10] = k % waves < waves / 2
        for place, ago in enumerate(lags):
            late[10 + place] = step[10 + place] * torque[max(k - ago, 0), 10 + place] > 0
        return np.where(late, width, 0) - lag

    return delays, 20


def drawn(width: int, count: int, ticks: int, seed: int, lag: int = 0) -> Callable[[int, np.ndarray], np.ndarray]:
    """Random sequences of delays in [−lag, width − lag] steps: a third uniform, a third at either end, a third that stays for a while."""
    rng = np.random.default_rng(seed)
    third = count // 3
    uniform = rng.integers(0, width + 1, (ticks, third))
    ends = width * rng.integers(0, 2, (ticks, third))
    kept = rng.integers(0, width + 1, (ticks, count - 2 * third))
    stays = rng.random(kept.shape) < rng.uniform(0.5, 0.98, kept.shape[1])
    for k in range(1, ticks):
        kept[k] = np.where(stays[k], kept[k - 1], kept[k])
    every = np.hstack([uniform, ends, kept]) - lag
    return lambda k, torque: every[k]


def random_loop(rng: np.random.Generator) -> Sampled:
    """Resonance 3 to 100 Hz, delay 0.5 to 10 ms, inertia ratio 0.1 to 30, 1 to 8 ticks of delay, PD gains that suit the delay."""
    motor = 10 ** rng.uniform(-2, 0)
    link = motor * 10 ** rng.uniform(-1, np.log10(30))
    swing = 2 * pi * 10 ** rng.uniform(np.log10(3), 2)
    reduced = motor * link / (motor + link)
    delay = 10 ** rng.uniform(np.log10(0.5e-3), -2)
    steps = int(rng.integers(PARTS, 8 * PARTS + 1))
    tick = PARTS * delay / steps
    fast = rng.uniform(0.15, 0.45) / (delay + tick)
    inertia = motor + min(link, motor)
    joint = PDJoint(
        motor_inertia=motor,
        link_inertia=link,
        stiffness=reduced * swing**2,
        damping=2 * rng.uniform(0.005, 0.05) * reduced * swing,
        kp=inertia * fast**2,
        kd=2 * rng.uniform(0.3, 1.0) * inertia * fast,
        delay=delay,
        bandwidth=rng.uniform(1500.0, 5000.0),
    )
    return Sampled(joint, tick)
