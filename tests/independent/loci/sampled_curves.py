"""Curves that are known at samples: as many as they need; their crossings and peaks, interpolated between samples and polished."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gainroom.analysis.gain_plane import refined as refined
from gainroom.system.linear.arrays import Booleans, Complexes, Floats, Integers

ROUNDS = 60  # of points about a peak
LEVEL = 1e-7  # of a height: among points that differ by less a parabola is right to the square of it
UNEVEN, SAME, REACH = 0.1, 1e-3, 3.0  # see polished_peaks: shares of the distances between points; times the nearer one or the move
ROUNDED = 1e-15  # of ω: points nearer to each other are one

TURNS = 1.0
"""In ln of a value: a curve that turns back farther from a line does not come to it between samples."""
ROUND_OFF = 1e-7
"""In ln of a value that an inverse of I + L has made: where both ends of a step are nearer to a line they may be there by round-off."""
SHORT = 3.0
"""Times as far beyond a line as it comes, had it gone on: then a curve may pass the line three times instead of once."""

Curves = Callable[[Floats], Complexes]
"""ω (k,) → (k, m): m scalar responses."""


def meets_axis(start: Complexes, end: Complexes) -> tuple[Integers, Integers, Floats, Floats]:
    """Steps (k, m) that cross the negative real axis: row, column, which share of ω in, and where, interpolated."""
    rows, columns = np.nonzero((start.imag > 0) != (end.imag > 0))
    start, end = start[rows, columns], end[rows, columns]
    share = start.imag / (start.imag - end.imag)
    value = (start + share * (end - start)).real
    found = value < 0
    return rows[found], columns[found], share[found], value[found]


def meets_circle(start: Complexes, end: Complexes) -> tuple[Integers, Integers, Floats, Floats]:
    """Steps (k, m) that cross the unit circle: row, column, which share of ln ω in, and arg(−λ) there, interpolated."""
    low, high = (np.log(np.maximum(np.abs(value), 1e-300)) for value in (start, end))
    rows, columns = np.nonzero((low > 0) != (high > 0))
    low, high, start, end = (each[rows, columns] for each in (low, high, start, end))
    share = low / (low - high)
    lag = np.angle(-start) + share * np.angle(end * start.conj())  # size and direction change evenly where curves are powers of ω
    return rows, columns, share, np.angle(np.exp(1j * lag))


def height(value: Complexes) -> Floats:
    """ln|λ|: zero on the unit circle."""
    return np.log(np.maximum(np.abs(value), 1e-300))


def side(value: Complexes) -> Floats:
    """arg(−λ): zero on the negative real axis."""
    return np.angle(-value)


def with_ends(samples: NDArray[Any]) -> NDArray[Any]:
    """(k + 2, …) of samples (k, …): one more at both ends, which is not known."""
    return np.pad(samples, ((1, 1), *((0, 0),) * (samples.ndim - 1)), constant_values=np.nan)


def may_pass_unseen(values: Complexes, omega: Floats, off: Callable[[Complexes], Floats]) -> Booleans:
    """(c,) where a curve may pass a line twice more between two samples than they show.

    values, omega   (4, c) of the sample before each step, of both its ends, and of the one after; NaN where there is none
    off             how far values are from the line, with the sign of their side: `height` or `side`

    With both ends on one side it may where it would pass the line on that step if it went on as it came, or went as it goes on; and beside
    a sample that is nearer to the line than those before and after, where it moves further, in ln, than it has room. With the ends on two
    sides it may where it would come SHORT times as far behind the line.
    """
    away, move, width = off(values), np.abs(values[2] - values[1]), np.diff(omega, axis=0)
    room, same = np.abs(away), away[1] * away[2] > 0
    found = np.zeros(values.shape[1], dtype=bool)
    for beyond, near, other, beside in ((0, 1, 2, 0), (3, 2, 1, 2)):
        turns = (away[beyond] * away[near] > 0) & (room[near] <= np.minimum(room[beyond], room[other]))
        ahead = np.sign(away[near]) * (away[near] + (away[near] - away[beyond]) * width[1] / width[beside])  # < 0 behind the line
        unseen = np.where(same, (turns & (move > room[near] * np.abs(values[near]))) | (ahead < 0), ahead < -SHORT * room[other])
        found |= (room[near] < TURNS) & unseen
    return found


def passed_unseen(omega: Floats, values: Complexes, off: Callable[[Complexes], Floats], seen: Booleans | bool = True) -> Booleans:
    """(k − 1,) the steps between samples at ω (k,) on which one of the curves (k, m) may, of those `seen` (k − 1, m); not by round-off."""
    room = np.abs(off(values))
    rows, columns = np.nonzero(seen & (np.maximum(room[:-1], room[1:]) > ROUND_OFF))
    around = rows + np.arange(4)[:, None]
    found = np.zeros(len(omega) - 1, dtype=bool)
    found[rows[may_pass_unseen(with_ends(values)[around, columns], with_ends(omega)[around], off)]] = True
    return found


def on_axis(curves: Curves, joints: Integers, low: tuple[Floats, Complexes], high: tuple[Floats, Complexes]) -> tuple[Floats, Complexes]:
    """ω and the real values there of curves between samples (ω, c) on two sides of the real axis, by the Illinois method."""
    (left, value), (right, other) = low, high
    first, second = value.imag, other.imag
    omega, value = left.copy(), value.copy()
    moved_left, moved_right = np.zeros(len(joints), dtype=bool), np.zeros(len(joints), dtype=bool)
    rest = np.arange(len(joints))
    for _ in range(20):
        if not len(rest):
            break
        share = np.divide(first, first - second, out=np.full(len(first), 0.5), where=first != second)
        place = left + share * (right - left)
        found = curves(place)[np.arange(len(place)), joints[rest]]
        omega[rest], value[rest] = place, found
        same = (found.imag > 0) == (first > 0)
        left, right = np.where(same, place, left), np.where(same, right, place)
        # An end that stays for a second time counts half: else it might stay for ever
        first = np.where(same, found.imag, np.where(moved_right, 0.5 * first, first))
        second = np.where(same, np.where(moved_left, 0.5 * second, second), found.imag)
        off = (np.abs(found.imag) > 1e-14 * np.abs(found)) & (right - left > ROUNDED * right)
        rest, left, right, first, second = (part[off] for part in (rest, left, right, first, second))
        moved_left, moved_right = same[off], ~same[off]
    return omega, value


def peaks(sizes: Floats, least: Floats) -> tuple[Integers, Integers]:
    """Samples (k, n) above `least` (n,) that are no lower than those beside them: row, neither the first nor the last, and column."""
    inner = sizes[1:-1]
    rows, columns = np.nonzero((inner >= sizes[:-2]) & (inner >= sizes[2:]) & (inner > least))
    return rows + 1, columns


def polished_peaks(
    omega: Floats, sizes: Floats, rows: Integers, columns: Integers, at: Callable[[Floats, Integers], Floats]
) -> tuple[Floats, Floats]:
    """ω and height (k,) of peaks seen in samples: again and again where the parabola through three points about each has its top.

    A parabola tells little with one of its points far off, as on a peak that is steep on one side, and nothing new with its top on the
    middle one, where that may be by chance: then the point farther off comes nearer. Where two rounds do not halve the distance between the
    outer ones, the longer part is halved. A peak is found where three points are level.

    at   ω (c,), columns (c,) → heights (c,)
    """
    place, height = (np.array([part[rows + k] for k in (-1, 0, 1)]) for part in (omega, sizes))
    height = height[:, np.arange(len(rows)), columns]
    top_place, top_height = place[1].copy(), height[1].copy()
    rest = np.arange(len(rows))
    before = np.full((2, len(rows)), np.inf)  # widths two rounds ago, and one
    for _ in range(ROUNDS):
        if not len(rest):
            break
        middle, top = place[1], _top_of_parabola(place, height)
        left, right = np.diff(place, axis=0)
        near, far, move = np.minimum(left, right), np.maximum(left, right), np.abs(top - middle)
        level = height[1] - height.min(axis=0) <= LEVEL * height[1]
        uneven = near < UNEVEN * far
        step = np.clip(REACH * np.where(uneven, np.maximum(near, move), move), SAME * far, 0.5 * far)
        aside = ~level & (uneven | (move < SAME * near))
        width = left + right
        slow = ~level & (width > 0.5 * before[0])
        step = np.where(slow, 0.5 * far, step)
        top = np.where(aside | slow, middle + np.copysign(step, right - left), top)
        before = np.where(slow, np.inf, [before[1], width])
        found = at(top, columns[rest])
        off = ~(level & (np.abs(found - height[1]) <= LEVEL * height[1])) & (width > ROUNDED * middle)
        higher, after = found > height[1], top > middle
        for part, new in ((place, top), (height, found)):
            low, middle, high = part.copy()
            part[0] = np.where(higher, np.where(after, middle, low), np.where(after, low, new))
            part[1] = np.where(higher, new, middle)
            part[2] = np.where(higher, np.where(after, high, middle), np.where(after, new, high))
        top_place[rest], top_height[rest] = place[1], height[1]
        rest, place, height, before = rest[off], place[:, off], height[:, off], before[:, off]
    return top_place, top_height


def _top_of_parabola(place: Floats, height: Floats) -> Floats:
    """(k,) where the parabolas through three points, (3, k), of which the middle one is highest, have their tops."""
    (low, middle, high), (before, after) = place, np.diff(height, axis=0) / np.maximum(np.diff(place, axis=0), 1e-300)
    bend = before - after
    share = np.divide(before, bend, out=np.full(len(bend), 0.5), where=bend > 0)
    return np.clip(0.5 * (low + middle) + 0.5 * (high - low) * share, low, high)
