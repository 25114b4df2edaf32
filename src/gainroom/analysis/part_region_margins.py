"""The gains (kp, kd) of one part of a controller with which its own loop, all others closed, keeps the required margins.

That loop is L = kp A + kd B, so what a requirement excludes is found on lines kp = const as for one joint (excluded_region.py), here from
the samples of a PartRegion: a picture, not certified. A gain margin is that of stability at scaled gains.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..system.excluded_sets import Branch, Segment, on_circle
from ..system.linear.arrays import Complexes, Floats
from ..system.requirements import Requirements
from .excluded_region import Piece, union_of
from .part_region import PartRegion

FINER = 6  # points per sample of the plane, by linear interpolation
SCALES = 9  # factors on the gains at which stability is checked for a gain margin


@dataclass(frozen=True)
class SampledLines:
    """Lines kp = const, kps (m,), in the gain plane of a return ratio kp A + kd B known at samples: A and B (k,)."""

    a: Complexes
    b: Complexes
    kps: Floats

    def swept(self, branches: Sequence[Branch], ends: Sequence[complex]) -> list[Piece]:
        """Intervals of kd for which L is on the curve, from sample to sample."""
        found = []
        for branch in branches:
            kd, inside = branch(self.kps[:, None], self.a[None], self.b[None])
            column, k = np.nonzero(inside[:, 1:] & inside[:, :-1])
            found.append((column, kd[column, k], kd[column, k + 1]))
        return found

    def at_ends(self, low: float, high: float) -> list[Piece]:
        """No intervals: a gain margin is that of stability at scaled gains (required_columns)."""
        return []

    def shadow(self, center: float, radius: float) -> list[Piece]:
        """Intervals of kd for which |L − center| < radius."""
        sides = [on_circle(self.kps[:, None], self.a[None], self.b[None], -center, radius, sign) for sign in (-1.0, 1.0)]
        column, k = np.nonzero(sides[0][1])
        return [(column, sides[0][0][column, k], sides[1][0][column, k])]


def required_columns(plane: PartRegion, requirements: Requirements, kps: Floats) -> list[Floats]:
    """Intervals of kd (p, 2), open and sorted, that keep every required margin, one array per kp of `kps` (m,).

    Raises GainroomError as PartRegion.columns.
    """
    left = plane.columns(kps)
    lines = SampledLines(*_own_loop(plane), kps)
    for one, needed in requirements.asked_for:
        shape = one.excluded(needed)
        if isinstance(shape, Segment):
            for factor in np.geomspace(1 / shape.factor, shape.factor, SCALES).tolist():
                left = [overlap(mine, other / factor) for mine, other in zip(left, plane.columns(kps * factor), strict=True)]
        elif shape is not None:
            column, low, high = (np.concatenate(parts) for parts in zip(*shape.on(lines), strict=True))
            barred = union_of(column.astype(int), np.minimum(low, high), np.maximum(low, high), len(kps))
            left = [overlap(mine, rest(out)) for mine, out in zip(left, barred, strict=True)]
    return left


def unread(requirements: Requirements) -> tuple[str, ...]:
    """Titles of those requirements that are not about one loop alone: no picture of its gains shows them."""
    return tuple(one.title for one, needed in requirements.asked_for if one.excluded(needed) is None)


def _own_loop(plane: PartRegion) -> tuple[Complexes, Complexes]:
    """Coefficients A and B of the part's return ratio kp A + kd B, at the plane's samples and between them."""
    closed = 1 - plane.kp * plane.a - plane.kd * plane.b
    place = np.arange((len(plane.omega) - 1) * FINER + 1) / FINER
    known: Any = np.arange(len(plane.omega))
    return np.interp(place, known, plane.a / closed), np.interp(place, known, plane.b / closed)


def rest(out: Floats) -> Floats:
    """Complement of disjoint sorted intervals (p, 2)."""
    ends = np.concatenate([[-math.inf], out.ravel(), [math.inf]]).reshape(-1, 2)
    return ends[ends[:, 1] > ends[:, 0]]


def overlap(one: Floats, other: Floats) -> Floats:
    """Intersection of two sets of sorted intervals, each (p, 2)."""
    low, high = np.maximum(one[:, None, 0], other[None, :, 0]).ravel(), np.minimum(one[:, None, 1], other[None, :, 1]).ravel()
    found = np.stack([low, high], axis=1)[high > low]
    return found[np.argsort(found[:, 0])]
