"""The gains (kp, kd) of one part of a controller with which every other loop, all others closed, keeps the required margins.

With D = D_0 + δ l rᵀ, δ = δ_p A + δ_d B the change of the part's own transfer function, (I + L)⁻¹ changes by a matrix of rank one
(Sherman and Morrison 1950). With S = (I + G D_0)⁻¹ and g = G l the sensitivity of loop j becomes S_jj − δ (S g)_j (rᵀ S)_j / f,
f = 1 + δ rᵀ S g: a quotient u/w of two numbers that are linear in kd at each frequency. The return ratio of loop j is 1/S_jj − 1, so

    |a S_jj + b| > M                                    a quadratic inequality in kd at each frequency: a disk
    the return ratio is on the unit circle              Re S_jj = ½, a quadratic equation; its phase from −1 is 2 arccot |2 Im S_jj|: an arc
    it is on the real axis                              Im S_jj = 0, a quadratic equation: a segment

and the kd for which its sign changes from one sample to the next, where that is within the arc or segment, are excluded. Sampled, not
certified.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..system.excluded_sets import Arc, Segment
from ..system.linear.arrays import Booleans, Complexes, Floats, Integers
from ..system.loop import Loop
from ..system.loop_part import LoopPart
from ..system.requirement import Requirement
from ..system.requirements import SensitivityBound
from .excluded_region import Piece, union_of
from .part_region import PartRegion
from .part_region_margins import rest
from .stability_boundary import in_blocks, sensitivity

BETWEEN = 8  # parts of the window in kd, each searched for an arc or segment by itself
HALVED = 12  # halvings towards the end of an excluded interval
Inside = Callable[[Complexes], Floats]


class Quotient(NamedTuple):
    """S_jj = (u_0 + kd u_1)/(w_0 + kd w_1), each broadcast to (m, k): lines kp = const by frequencies."""

    u_0: Complexes
    u_1: Complexes
    w_0: Complexes
    w_1: Complexes

    def at(self, kd: Floats) -> Complexes:
        """Sensitivity S_jj (m, k) at gains `kd`."""
        return (self.u_0 + kd * self.u_1) / (self.w_0 + kd * self.w_1)

    def sampled(self, *places: Integers) -> "Quotient":
        """Quotient at index arrays `places`: lines and frequencies."""
        shape = self.u_0.shape
        return Quotient(*(np.broadcast_to(each, shape)[places] for each in self))

    def where_real(self, turned: complex, level: float) -> tuple[Floats, Floats, Floats]:
        """Coefficients (a, b, c) of a kd² + b kd + c = 0, true where Re(turned S_jj) = level."""

        def product(u: Complexes, w: Complexes) -> Floats:
            return (turned * u * w.conj()).real

        square = product(self.u_1, self.w_1) - level * np.abs(self.w_1) ** 2
        linear = product(self.u_0, self.w_1) + product(self.u_1, self.w_0) - 2 * level * (self.w_0 * self.w_1.conj()).real
        return square, linear, product(self.u_0, self.w_0) - level * np.abs(self.w_0) ** 2


class OtherLoops:
    """Sensitivities S_jj of all loops as functions of (kp, kd) of one part, at the samples of `plane`; gains up to `window`."""

    def __init__(self, loop: Loop, part: LoopPart, plane: PartRegion, window: tuple[float, float]) -> None:
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
        self._plane, self._top = plane, 2 * window[1]
        self._single, self._product = values[:, :size], values[:, size : 2 * size]
        self._kp, self._kd, self._through = values[:, -3], values[:, -2], values[:, -1]

    def columns(self, one: Requirement, needed: float, kps: Floats) -> list[Floats]:
        """For each kp (m,): the kd that keep `one` in every loop, as open intervals (p, 2), sorted."""
        plane, shape = self._plane, one.excluded(needed)
        start = (kps[:, None] - plane.kp) * self._kp - plane.kd * self._kd  # δ at kd = 0, (m, k)
        bottom = 1 + start * self._through, self._kd * self._through
        found: list[Piece] = []
        with np.errstate(all="ignore"):
            for single, product in zip(self._single.T, self._product.T, strict=True):
                loop = Quotient(single * bottom[0] - start * product, single * bottom[1] - self._kd * product, *bottom)
                if isinstance(one, SensitivityBound):
                    found += _above(loop, one, needed)
                elif isinstance(shape, Arc):
                    found.append(_crossed(loop, (1.0, 0.5), partial(_turned, 2 * math.tan(0.5 * shape.angle)), self._top))
                elif isinstance(shape, Segment):
                    found.append(_crossed(loop, (-1j, 0.0), partial(_scaled, math.log(shape.factor)), self._top))
        if not found:
            return [np.array([[-math.inf, math.inf]])] * len(kps)
        column, low, high = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return [rest(out) for out in union_of(column.astype(int), low, high, len(kps))]


def _above(loop: Quotient, one: SensitivityBound, needed: float) -> list[Piece]:
    """Intervals of kd in which |a S_jj + b| > needed at one frequency: index of the line (m,), low and high end."""
    a, b = one.slope, one.offset
    top, bottom = (a * loop.u_0 + b * loop.w_0, a * loop.u_1 + b * loop.w_1), (loop.w_0, loop.w_1)
    square = np.abs(top[1]) ** 2 - (needed * np.abs(bottom[1])) ** 2
    middle = (top[0] * np.conj(top[1])).real - needed**2 * (bottom[0] * np.conj(bottom[1])).real
    constant = np.abs(top[0]) ** 2 - (needed * np.abs(bottom[0])) ** 2
    square = np.broadcast_to(square, constant.shape)
    inner = middle**2 - square * constant
    root = np.sqrt(np.maximum(inner, 0))
    ends = np.sort(np.stack([(-middle - root) / square, (-middle + root) / square]), axis=0)
    between, outside, always = (square < 0) & (inner > 0), (square > 0) & (inner > 0), (square > 0) & (inner <= 0)
    return [
        _taken(between, ends[0], ends[1]),
        _taken(outside, -math.inf, ends[0]),
        _taken(outside, ends[1], math.inf),
        _taken(always, -math.inf, math.inf),
    ]


def _crossed(loop: Quotient, equation: tuple[complex, float], inside: Inside, top: float) -> Piece:
    """The kd from 0 to `top` for which Re(turned S_jj) − level changes its sign from one sample to the next with inside(S_jj) > 0."""
    turned, level = equation
    a, b, c = loop.where_real(*equation)
    a = np.broadcast_to(a, c.shape)
    root = np.sqrt(b**2 - 4 * a * c)  # NaN where nothing is met
    stable = b + np.where(b < 0, -1.0, 1.0) * root  # the sum that does not cancel
    roots = np.clip(np.nan_to_num(np.stack([-stable / (2 * a), -2 * c / stable]), nan=0.0), 0.0, top)
    met: Any = ((roots > 0) & (roots < top)).any(axis=0)
    line, k = np.nonzero(met[:, 1:] | met[:, :-1] | ((c[:, 1:] > 0) != (c[:, :-1] > 0)))
    between = np.linspace(0, top, BETWEEN + 1)[:, None] + np.zeros(len(line))  # a set may be long, where this part hardly moves the loop
    ends = np.sort(np.concatenate([roots[:, line, k], roots[:, line, k + 1], between]), axis=0)
    both = loop.sampled(line, k), loop.sampled(line, k + 1)

    def changes(kd: Floats, places: tuple[Any, ...]) -> tuple[Floats, Any]:
        """`inside` at the sign change on the straight line between neighbouring samples, and True where there is one."""
        first, then = (one.sampled(*places).at(kd) for one in both)
        before, after = (turned * first).real - level, (turned * then).real - level
        share = np.clip(np.nan_to_num(before / (before - after)), 0.0, 1.0)
        return inside(first + (then - first) * share), (before > 0) != (after > 0)

    wide: Any = ends[1:] > ends[:-1]
    row, place = np.nonzero(wide)
    low, high = ends[row, place], ends[row + 1, place]
    which: Any = changes(0.5 * (low + high), (place,))[1]
    low, high, place = low[which], high[which], place[which]
    first, then = (np.asarray(changes(kd, (place,))[0] > 0) for kd in (low, high))
    held, out = np.where(first, low, high), np.where(first, high, low)
    for _ in range(HALVED):
        middle = 0.5 * (held + out)
        kept = changes(middle, (place,))[0] > 0
        held, out = np.where(kept, middle, held), np.where(kept, out, middle)
    some = first | then
    return line[place][some], np.where(first, low, held)[some], np.where(then, high, held)[some]


def _turned(size: float, value: Complexes) -> Floats:
    """Positive where the return ratio, on the unit circle, is less than 2 arctan(size / 2) from −1."""
    return np.abs(value.imag) * size - 1


def _scaled(size: float, value: Complexes) -> Floats:
    """Positive where the return ratio, on the real axis, is −e^x with |x| < size."""
    ratio = 1 - (1 / value).real
    return np.where(ratio > 0, size - np.abs(np.log(np.abs(ratio))), -1e3)


def _taken(which: Booleans, low: Floats | float, high: Floats | float) -> Piece:
    lines: Integers = np.broadcast_to(np.arange(len(which))[:, None], which.shape)
    return lines[which], np.broadcast_to(low, which.shape)[which], np.broadcast_to(high, which.shape)[which]
