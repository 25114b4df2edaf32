"""The gains (kp, kd) of one part of a controller with which the sensitivities of all loops, one at a time, stay below what is asked for.

With D = D_0 + δ l rᵀ, δ = δ_p A + δ_d B the change of the part's own transfer function, (I + L)⁻¹ changes by a matrix of rank one
(Sherman and Morrison 1950). With S = (I + G D_0)⁻¹ and g = G l the sensitivity of loop j becomes S_jj − δ (S g)_j (rᵀ S)_j / f,
f = 1 + δ rᵀ S g. Its numerator over f and f itself are linear in kd, so |a S_jj + b| > M is a quadratic inequality in kd at each frequency.
Sampled, not certified.
"""

import math

import numpy as np

from ..linear.arrays import Complexes, Floats
from ..system.loop import Loop
from ..system.loop_part import LoopPart
from ..system.requirements import SensitivityBound
from .coupled_margins import sensitivity
from .excluded_region import union_of
from .part_plane import PartPlane
from .part_requirements import rest
from .stability_boundary import in_blocks


class OtherLoops:
    """Every loop's sensitivity along the samples of a plane of the same loop and part."""

    def __init__(self, loop: Loop, part: LoopPart, plane: PartPlane) -> None:
        assert loop.parts is not None
        controller, size = loop.parts.controller, loop.size

        def at(omega: Floats) -> Complexes:
            s = 1j * omega
            v = loop.variable(s)
            actuated = loop.gain * loop.actuated_at(s)
            whole = sensitivity(loop, controller.after(actuated, s, v, loop.sample_time))
            moved, out = actuated @ part.left, part.right @ whole
            into, through = np.einsum("kij,kj->ki", whole, moved), (out * moved).sum(axis=1)
            own = part.own.plane_at(s, v, loop.sample_time)
            return np.column_stack([np.diagonal(whole, axis1=1, axis2=2), into * out, own, through])

        values = in_blocks(at, plane.omega, size)
        self._plane = plane
        self._single, self._product = values[:, :size], values[:, size : 2 * size]
        self._kp, self._kd, self._through = values[:, -3], values[:, -2], values[:, -1]

    def columns(self, bound: SensitivityBound, needed: float, kps: Floats) -> list[Floats]:
        """For each kp (m,): the kd that keep `bound` in every loop, as open intervals (p, 2), sorted."""
        plane, a = self._plane, bound.slope
        start = (kps[:, None] - plane.kp) * self._kp - plane.kd * self._kd  # δ at kd = 0, (m, k)
        bottom = 1 + start * self._through, self._kd * self._through
        found: list[tuple[Floats, Floats, Floats]] = []
        with np.errstate(divide="ignore", invalid="ignore"):
            for single, product in zip((a * self._single + bound.offset).T, a * self._product.T, strict=True):
                top = single * bottom[0] - start * product, single * bottom[1] - self._kd * product
                square = np.abs(top[1]) ** 2 - (needed * np.abs(bottom[1])) ** 2
                middle = (top[0] * np.conj(top[1])).real - needed**2 * (bottom[0] * np.conj(bottom[1])).real
                constant = np.abs(top[0]) ** 2 - (needed * np.abs(bottom[0])) ** 2
                found += _above(square, middle, constant)
        column, low, high = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return [rest(out) for out in union_of(column.astype(int), low, high, len(kps))]


def _above(square: Floats, middle: Floats, constant: Floats) -> list[tuple[Floats, Floats, Floats]]:
    """Where square x² + 2 middle x + constant > 0: line (m, k) by its first index, low and high end."""
    square = np.broadcast_to(square, constant.shape)
    inner = middle**2 - square * constant
    root = np.sqrt(np.maximum(inner, 0))
    ends = np.sort(np.stack([(-middle - root) / square, (-middle + root) / square]), axis=0)
    between, outside, always = (square < 0) & (inner > 0), (square > 0) & (inner > 0), (square > 0) & (inner <= 0)
    lines = np.broadcast_to(np.arange(len(constant))[:, None], constant.shape)

    def taken(which: Floats, low: Floats | float, high: Floats | float) -> tuple[Floats, Floats, Floats]:
        return lines[which], np.broadcast_to(low, constant.shape)[which], np.broadcast_to(high, constant.shape)[which]

    return [
        taken(between, ends[0], ends[1]),
        taken(outside, -math.inf, ends[0]),
        taken(outside, ends[1], math.inf),
        taken(always, -math.inf, math.inf),
    ]
