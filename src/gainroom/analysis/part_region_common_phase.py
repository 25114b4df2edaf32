"""The gains (kp, kd) of one part of a controller with which all loops together survive any one phase, from a lag to a lead.

With a phase ψ in all loops at once the closed loop has det(I + e^{jψ} L(jω)); of rank one as in part_region.py, it is 0 for one pair of
gains at each (ω, ψ). What the pairs of |ψ| ≤ φ cover is excluded: as ψ goes from 0, where the loop is stable, no root comes to the boundary
anywhere else. Their net of triangles is cut by lines kp = const. Sampled, not certified.
"""

import math

import numpy as np

from ..system.linear.arrays import Booleans, Complexes, Floats
from ..system.loop import Loop
from ..system.loop_part import LoopPart
from .excluded_region import union_of
from .part_region import PartRegion
from .part_region_margins import rest
from .stability_boundary import in_blocks, sensitivity

PHASES = 6  # steps between the largest lag and the largest lead


class CommonPhase:
    """Gains (kp, kd) of one part excluded by a common phase of up to ±`angle` [rad] in all loops, at the samples of `plane`.

    `loop` and `part` are those of the plane; gains up to `window` (kp, kd). A vibration on which the part does not act, such as that of
    another leg in the air, belongs to no pair of gains: for all gains it is near one (ω, ψ). It is found as a zero of det(I + e^{jψ} L)
    with the present gains: the argument of the determinant turns by 2π around the cell of (ω, ψ) that contains it. If the triangles of
    that cell do not contain the present gains, all gains are excluded.
    """

    def __init__(self, loop: Loop, part: LoopPart, plane: PartRegion, angle: float, window: tuple[float, float]) -> None:
        assert loop.parts is not None
        controller = loop.parts.controller
        turns = np.exp(1j * np.linspace(-angle, angle, PHASES + 1))

        def at(omega: Floats) -> Complexes:
            s = 1j * omega
            v = loop.variable(s)
            actuated = loop.gain * loop.actuated_at(s)
            returned = controller.after(actuated, s, v, loop.sample_time)
            moved = actuated @ part.left
            through = [turn * np.einsum("i,kij,kj->k", part.right, sensitivity(loop, turn * returned), moved) for turn in turns]
            own = part.own.plane_at(s, v, loop.sample_time)
            signs = np.stack([np.linalg.slogdet(np.eye(loop.size) + turn * returned)[0] for turn in turns], axis=1)
            both = own[:, :, None] * np.stack(through, axis=1)[:, None]
            return np.concatenate([both, signs[:, None]], axis=1).reshape(len(s), -1)

        values = in_blocks(at, plane.omega, loop.size).reshape(len(plane.omega), 3, -1)
        a, b, sign = values[:, 0], values[:, 1], values[:, 2]
        determinant = a.real * b.imag - a.imag * b.real
        with np.errstate(all="ignore"):
            net = np.stack([plane.kp - b.imag / determinant, plane.kd + a.imag / determinant, np.sign(determinant)])
        corners = net[:, :-1, :-1], net[:, 1:, :-1], net[:, :-1, 1:], net[:, 1:, 1:]
        halves = _cells(corners[0], corners[1], corners[2]), _cells(corners[3], corners[1], corners[2])
        here = np.array([plane.kp, plane.kd])
        self._none = bool((_turns(sign).ravel() & ~(_holds(halves[0], here) | _holds(halves[1], here))).any())
        self._corners = np.concatenate(halves, axis=2)
        kp, kd, side = self._corners
        seen = (kp.min(axis=0) <= window[0]) & (kp.max(axis=0) >= 0) & (kd.min(axis=0) <= 2 * window[1]) & (kd.max(axis=0) >= 0)
        seen &= np.isfinite(kp).all(axis=0) & np.isfinite(kd).all(axis=0) & (np.abs(side.sum(axis=0)) == 3)  # not by way of infinity
        self._corners = self._corners[:2, :, seen]

    def columns(self, kps: Floats) -> list[Floats]:
        """For each kp (m,), rising: the kd that survive every phase, as open intervals (p, 2), sorted."""
        if self._none:
            return [np.empty((0, 2))] * len(kps)
        kp, kd = self._corners
        first, last = np.searchsorted(kps, kp.min(axis=0)), np.searchsorted(kps, kp.max(axis=0), "right")
        which = np.repeat(np.arange(kp.shape[1]), last - first)
        column = np.arange(len(which)) - np.repeat(np.cumsum(last - first) - (last - first), last - first) + first[which]
        low, high = np.full(len(which), math.inf), np.full(len(which), -math.inf)
        for one, other in ((0, 1), (1, 2), (2, 0)):
            start, end = kp[one, which], kp[other, which]
            with np.errstate(all="ignore"):
                share = (kps[column] - start) / (end - start)
            cut = np.where((share >= 0) & (share <= 1), kd[one, which] + share * (kd[other, which] - kd[one, which]), math.nan)
            low, high = np.fmin(low, cut), np.fmax(high, cut)
        met = low <= high
        return [rest(out) for out in union_of(column[met], low[met], high[met], len(kps))]


def _cells(*corners: Floats) -> Floats:
    """Triangles (d, 3 corners, count) from three arrays (d, …) of corners, the same place in each making one triangle."""
    return np.stack([corner.reshape(len(corner), -1) for corner in corners], axis=1)


def _turns(sign: Complexes) -> Booleans:
    """Mask (k − 1, p − 1) of cells around which a complex number of size 1, given at their corners (k, p), turns once."""

    def change(one: Complexes, other: Complexes) -> Floats:
        return np.angle(other / one)

    down, across = change(sign[:-1], sign[1:]), change(sign[:, :-1], sign[:, 1:])
    return np.abs(down[:, :-1] + across[1:] - down[:, 1:] - across[:-1]) > math.pi


def _holds(triangles: Floats, point: Floats) -> Booleans:
    """Mask (count,) of triangles (d, 3 corners, count) with `point` (2,) strictly inside, by their first two coordinates (kp, kd)."""
    way = triangles[:2] - point[:, None, None]
    with np.errstate(all="ignore"):
        sides = np.sign([way[0, k] * way[1, k - 1] - way[1, k] * way[0, k - 1] for k in range(3)])
    return np.abs(sides.sum(axis=0)) == 3
