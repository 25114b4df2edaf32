"""Torque line from commands to motor torques: delay in the command buffer, torque limits, current loops.

A command given at tick k acts on the current loop from t_k + T to t_{k+1} + T; between those times nothing is integrated, since the
response of the current loop to held commands is exact. Leapfrog steps need the mean torque over t ± h/2 around each step's time t
(mujoco_model.py).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_count, require_finite, require_positive
from ..native import _core
from ..system.drive import Drive
from ..system.linear.arrays import Floats
from ..system.linear.state_space import split_delay


class TorqueLine:
    """Drives of n joints between a controller's ticks and a simulation's steps, with the commands in transit.

    drives        one per joint
    sample_time   between ticks [s]
    substeps      steps of the simulation per tick
    limit         (n,) or one for all: commands are cut to ± this [N m]

    `demand` (n,) is the input of the current loops at the last tick [N m].
    """

    def __init__(self, drives: Sequence[Drive], sample_time: float, substeps: int, limit: ArrayLike = np.inf):
        require_positive("simulation", "sample_time", sample_time, "s")
        require_count("simulation", "substeps", substeps, 1)
        self._limit = np.broadcast_to(np.asarray(limit, dtype=float), (len(drives),)).copy()
        if not np.all(self._limit > 0):
            raise GainroomError(f"simulation: torque limit {self._limit.min():g} N·m must be > 0 or inf")
        size = len(drives)
        ticks, fractions = split_delay([drive.delay for drive in drives], sample_time)
        self._step = sample_time / substeps
        # One product for all: torques, their rates τ̇/ω_c, the commands of this tick and those before → torques and rates at the next
        # tick, ∫τ dt over the parts of this one over the step, commands that have arrived; each (n,).
        self._map = np.zeros((substeps + 4, size, int(ticks.max()) + 4, size))
        for joint, (drive, late, part) in enumerate(zip(drives, ticks, fractions, strict=True)):
            # states, the command before and the command now, as seen behind the delay
            self._map[:-1, joint, [0, 1, 3 + late, 2 + late], joint] = _tick_map(drive, sample_time, substeps, part)
            self._map[-1, joint, 2 + late + (part > 0), joint] = 1.0
        self._map[2:-1] /= self._step
        self._limited = bool(np.isfinite(self._limit).any())
        self._rows, self._size = len(self._map), size
        self._map = self._map.reshape(self._rows * size, -1)
        self.rest(0.0)

    def rest(self, torque: ArrayLike) -> None:
        """Start from a constant past command `torque`, (n,) or one for all [N m]."""
        start = np.broadcast_to(require_finite("simulation", "torque", torque), (self._size,))
        self._signals = np.tile(start, self._map.shape[1] // self._size)
        self._signals[self._size : 2 * self._size] = 0.0
        self._over = start / 2  # ∫τ over the half step before this tick, over the step
        self.demand = start.copy()

    def tick(self, command: Floats) -> Floats:
        """Mean torques (substeps, n) [N m] around the steps of the tick that begins now, on a new `command` (n,)."""
        size, signals = self._size, self._signals
        signals[3 * size :] = signals[2 * size : -size]
        signals[2 * size : 3 * size] = np.minimum(np.maximum(command, -self._limit), self._limit) if self._limited else command
        out = (self._map @ signals).reshape(self._rows, size)
        signals[:size], signals[size : 2 * size] = out[0], out[1]
        out[2] += self._over
        self._over, self.demand = out[-2], out[-1]
        return out[2:-2]

    @property
    def torque(self) -> Floats:
        """Motor torques (n,) at this moment [N m]."""
        return self._signals[: self._size].copy()


def _tick_map(drive: Drive, sample_time: float, substeps: int, fraction: float) -> Floats:
    """Matrix (2 + substeps + 1, 4) from the current loop's state (τ, τ̇/ω_c), the previous and the present command, over one tick.

    Its rows give the state one tick later, then ∫τ dt over the first half step, the full steps between and the last half step.
    """
    step = sample_time / substeps
    middles = (np.arange(substeps) + 0.5) * step
    switch = fraction * sample_time
    edges = np.unique(np.concatenate([[0.0, sample_time], middles, [switch]]))
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-12 * sample_time])]
    state = np.hstack([np.eye(2), np.zeros((2, 2))])
    areas = np.zeros((substeps + 1, 4))
    for start, end in pairwise(edges):
        command = np.eye(4)[2 if (start + end) / 2 < switch else 3]
        moved, area = _held(drive, end - start)
        signal = np.vstack([state, command])
        areas[np.searchsorted(middles, (start + end) / 2)] += area @ signal
        state = moved @ signal
    return np.vstack([state, areas])


def _held(drive: Drive, duration: float) -> tuple[Floats, Floats]:
    """Maps of a command held for `duration` [s], from state and command: (2, 3) to the next state, (3,) to ∫τ dt."""
    if drive.is_ideal:
        return np.array([[0.0, 0, 1], [0, 0, 0]]), np.array([0.0, 0, duration])
    w, damping = drive.bandwidth, drive.damping_ratio
    rates = np.zeros((4, 4))  # of τ, τ̇/ω_c, the command and ∫τ dt; eq. (3) of Jung et al. 2017
    rates[0, 1] = w
    rates[1, :3] = -w, -2 * damping * w, w
    rates[3, 0] = 1.0
    whole = _core.exponential(rates * duration)
    return whole[:2, :3], whole[3, :3]
