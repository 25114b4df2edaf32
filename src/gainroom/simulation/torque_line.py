"""From torque commands to the motors' torques: the delay in the command buffer, the current loops, the torque limits.

A command given at tick k acts on the current loop from t_k + T to t_{k+1} + T; between those times nothing is integrated, the current
loop's answer to held commands is exact. Leapfrog steps want the mean torque over t ± h/2 around each step's time t (mujoco_model.py).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Floats
from ..drive import Drive
from ..errors import GainroomError, require_count, require_finite, require_positive
from ._kernels import line_tick


class TorqueLine:
    """The drives of n joints between a controller's ticks and a simulation's steps; remembers the commands under way.

    drives        one per joint
    sample_time   between ticks [s]
    substeps      steps of the simulation per tick
    limit         (n,) or one for all: commands are cut to ± this [N m]
    """

    def __init__(self, drives: Sequence[Drive], sample_time: float, substeps: int, limit: ArrayLike = np.inf):
        require_positive("simulation", "sample_time", sample_time, "s")
        require_count("simulation", "substeps", substeps, 1)
        self._limit = np.broadcast_to(np.asarray(limit, dtype=float), (len(drives),)).copy()
        if not np.all(self._limit > 0):
            raise GainroomError(f"simulation: torque limit {self._limit.min():g} N·m must be > 0 or inf")
        ticks, fractions = zip(*(_split(drive.delay, sample_time) for drive in drives), strict=True)
        self._maps = np.array([_tick_map(drive, sample_time, substeps, part) for drive, part in zip(drives, fractions, strict=True)])
        self._length = max(ticks) + 2  # the newest command, and the one before the oldest that still acts
        self._late = np.array(ticks)
        self._step = sample_time / substeps
        self._means = np.zeros((substeps, len(drives)))
        self.rest(0.0)

    def rest(self, torque: ArrayLike) -> None:
        """As if `torque`, (n,) or one for all [N m], had been asked for since ever."""
        start = np.broadcast_to(require_finite("simulation", "torque", torque), self._late.shape).copy()
        self._commands = np.tile(start, (self._length, 1))
        self._newest = 0
        self._states = np.zeros((len(start), 2))  # τ and τ̇/ω_c of the current loops
        self._states[:, 0] = start
        self._over = start * self._step / 2  # ∫τ over the half step before this tick

    def tick(self, command: Floats) -> Floats:
        """Mean torques (substeps, n) [N m] around the steps of the tick that begins now, on a new `command` (n,).

        The next call overwrites them.
        """
        self._newest = (self._newest + 1) % self._length
        means = self._means
        line_tick(self._maps, self._commands, self._newest, self._late, self._limit, command, self._states, self._over, means, self._step)
        return means

    @property
    def torque(self) -> Floats:
        """(n,) the motors' torque at this moment [N m]."""
        return self._states[:, 0].copy()


def _split(delay: float, sample_time: float) -> tuple[int, float]:
    """Whole ticks and the rest as a part of a tick; 4.0 ms / 0.5 ms is not a whole number in floating point."""
    ticks = int(np.floor(delay / sample_time + 1e-9))
    return ticks, max(delay / sample_time - ticks, 0.0)


def _tick_map(drive: Drive, sample_time: float, substeps: int, fraction: float) -> Floats:
    """(2 + substeps + 1, 4) from the current loop's state (τ, τ̇/ω_c), the command before and the command now.

    To the state one tick later, then ∫τ dt over the first half step, the full steps between and the last half step.
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
    """What a command held for `duration` does: (2, 3) to the next state and (3,) to ∫τ dt, from state and command."""
    from scipy.linalg import expm

    if drive.is_ideal:
        return np.array([[0.0, 0, 1], [0, 0, 0]]), np.array([0.0, 0, duration])
    w, damping = drive.bandwidth, drive.damping_ratio
    rates = np.zeros((4, 4))  # of τ, τ̇/ω_c, the command and ∫τ dt; eq. (3) of Jung et al. 2017
    rates[0, 1] = w
    rates[1, :3] = -w, -2 * damping * w, w
    rates[3, 0] = 1.0
    whole = expm(rates * duration)
    return whole[:2, :3], whole[3, :3]
