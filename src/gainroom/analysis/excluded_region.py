"""Gains that a margin excludes, on lines kp = const, as intervals of kd.

A margin keeps L(jω) out of a set: a gain margin out of the segment [−g, −1/g], a phase margin out of the arc |L| = 1, |arg(−L)| ≤ φ, a
sensitivity ceiling out of the disk |1 + L| < 1/Ms. On a line kp = const, and at one ω, the kd for which L lies in the set are points or
an interval in closed form (a linear or quadratic equation); over all ω they sweep intervals. Their ends lie where ω enters or leaves
the set, or where kd(ω) has an extremum; both are polished, so the intervals are exact, not gridded.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..linear.arrays import Booleans, Complexes, Floats, Integers
from .gain_plane import Curve, GainPlane

Piece = tuple[Integers, Floats, Floats]
"""Column, one end and the other end of intervals of kd."""
Events = tuple[Integers, Floats, Floats]
"""Column, ω and kd."""


@dataclass(frozen=True)
class Branch:
    """(kp, A, B) → (kd, inside): one solution kd of the set's equation, and whether L is then in the set; arrays of any one shape."""

    solve: Callable[[Floats, Complexes, Complexes], tuple[Floats, Booleans]]
    paired: bool = False  # the equation is quadratic and this is one of two solutions

    def __call__(self, kp: Floats, a: Complexes, b: Complexes) -> tuple[Floats, Booleans]:
        return self.solve(kp, a, b)


def excluded(plane: GainPlane, omega: Floats, name: str, value: float, kps: Floats, window: Floats, polish: bool = True) -> list[Floats]:
    """The kd that one requirement excludes, for each kp of `kps` (m,): disjoint sorted intervals (p, 2); everything: (−inf, inf).

    name, value   a field of Requirements
    omega         (k,) grid that resolves the plane
    window        (m, 2) the kd of interest; what lies outside is not worked out to the last digit
    polish        False: ends as good as the grid, for a first search
    """
    a, b = plane.a.response(omega), plane.b.response(omega)
    pieces: list[Piece] = []
    if name == "gain_margin":
        events = _events(plane, [-value, -1.0, -1 / value], kps, polish)
        pieces += _sweep(plane, omega, a, b, _segment(value), events, kps, window, polish) + _at_ends(_ends(plane), value, kps)
    elif name == "phase_margin":
        touching = _existence(plane, omega, a, b, kps, 50 if polish else 8)
        ends = _events(plane, [-np.exp(1j * value), -np.exp(-1j * value)], kps, polish)
        column, place, kd = (np.concatenate(pair) for pair in zip(touching, ends, strict=True))
        for sign in (-1.0, 1.0):
            pieces += _sweep(plane, omega, a, b, _arc(value, sign), (column, place, kd), kps, window, polish)
    else:
        pieces += _disk(plane, omega, a, b, 1 / value, kps, polish)
    column, low, high = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return _union(column.astype(int), np.minimum(low, high), np.maximum(low, high), len(kps))


def _circle(kp: Floats, a: Complexes, b: Complexes, center: float, radius: float, sign: float) -> tuple[Floats, Booleans]:
    """The kd, one of two, with |center + kp A + kd B| = radius, and where it exists."""
    with np.errstate(invalid="ignore"):  # on a pole of A and B nothing is defined, and nothing exists
        rest = center + kp * a
        across = rest * b.conj()
        size = np.abs(b) ** 2
        discriminant = size * radius**2 - across.imag**2  # not half² − size (|rest|² − radius²), which cancels
        real = discriminant >= 0
        return (-across.real + sign * np.sqrt(np.where(real, discriminant, 0.0))) / size, real


def _segment(gain_margin: float) -> Branch:
    """L real, in [−g, −1/g]."""

    def solve(kp: Floats, a: Complexes, b: Complexes) -> tuple[Floats, Booleans]:
        with np.errstate(divide="ignore", invalid="ignore"):
            kd = -kp * a.imag / b.imag
            value = kp * a.real + kd * b.real
        return kd, np.isfinite(kd) & (value >= -gain_margin) & (value <= -1 / gain_margin)

    return Branch(solve)


def _arc(phase_margin: float, sign: float) -> Branch:
    """|L| = 1 and |arg(−L)| ≤ φ."""

    def solve(kp: Floats, a: Complexes, b: Complexes) -> tuple[Floats, Booleans]:
        kd, real = _circle(kp, a, b, 0.0, 1.0, sign)
        with np.errstate(invalid="ignore"):
            return kd, real & (np.abs(np.angle(-(kp * a + kd * b))) <= phase_margin)

    return Branch(solve, paired=True)


def _events(plane: GainPlane, targets: list[complex], kps: Floats, polish: bool) -> Events:
    """Where L passes the ends of the set."""
    found = [Curve.of(plane, target).crossings("kp", kps, polish) for target in targets]
    column, omega, kd = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return column, omega, kd


def _sweep(
    plane: GainPlane,
    omega: Floats,
    a: Complexes,
    b: Complexes,
    branch: Branch,
    events: Events,
    kps: Floats,
    window: Floats,
    polish: bool,
) -> list[Piece]:
    """Intervals of kd that one branch sweeps while L is in the set: between samples of ω, cut at every event between them."""
    kd, inside = branch(kps[:, None], a[None, :], b[None, :])
    cut = np.zeros((len(kps), len(omega) - 1), dtype=bool)
    place = np.clip(np.searchsorted(omega, events[1]) - 1, 0, len(omega) - 2)
    cut[events[0], place] = True
    whole = inside[:, 1:] & inside[:, :-1] & ~cut
    column, k = np.nonzero(whole)
    pieces = [(column, kd[column, k], kd[column, k + 1])]
    pieces.append(_around_events(plane, omega, branch, events, place, cut, kps))
    if polish:  # where kd(ω) turns back inside the set
        near = (kd >= window[:, :1]) & (kd <= window[:, 1:])
        column, k = np.nonzero(whole[:, 1:] & whole[:, :-1] & near[:, 1:-1] & (np.diff(kd)[:, 1:] * np.diff(kd)[:, :-1] < 0))
        sign = np.where(kd[column, k + 1] > kd[column, k], 1.0, -1.0)
        _, height = _maximum(plane, lambda *at: sign * branch(*at)[0], kps[column], omega[k], omega[k + 1], omega[k + 2])
        pieces.append((column, kd[column, k + 1], sign * height))
    return pieces


def _around_events(plane: GainPlane, omega: Floats, branch: Branch, events: Events, place: Integers, cut: Booleans, kps: Floats) -> Piece:
    """The stretches between samples and events, and from event to event, on which L is in the set, however narrow in ω.

    With a small kp the crossing frequency hardly depends on kd: a whole segment is swept between two samples.
    """
    column, k = np.nonzero(cut)
    columns = np.concatenate([events[0], column, column])
    places = np.concatenate([place, k, k])
    points = np.concatenate([events[1], omega[k], omega[k + 1]])
    kd, _ = branch(kps[columns], plane.a.response(points), plane.b.response(points))
    # An event knows its kd to the last digit; on the other branch of a circle it is just one more point.
    own = events[2]
    mine = np.abs(own - kd[: len(own)]) <= 1e-3 * np.abs(own) if branch.paired else np.ones(len(own), dtype=bool)
    kd[: len(own)] = np.where(mine, own, kd[: len(own)])
    order = np.lexsort((points, places, columns))
    columns, places, points, kd = columns[order], places[order], points[order], kd[order]
    middle = 0.5 * (points[1:] + points[:-1])
    _, inside = branch(kps[columns[1:]], plane.a.response(middle), plane.b.response(middle))
    kept = inside & (columns[1:] == columns[:-1]) & (places[1:] == places[:-1])
    return columns[1:][kept], kd[:-1][kept], kd[1:][kept]


def _existence(plane: GainPlane, omega: Floats, a: Complexes, b: Complexes, kps: Floats, rounds: int) -> Events:
    """Where the line of all L at one kp just touches the unit circle, |kp Im(Ā B)| = |B|: beyond, no kd gives |L| = 1."""

    def reach(a: Complexes, b: Complexes) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.abs(b) / np.abs((a.conj() * b).imag)

    exists = reach(a, b) >= np.abs(kps)[:, None]
    column, k = np.nonzero(exists[:, 1:] != exists[:, :-1])
    starts = exists[column, k + 1]
    low, high = omega[k].copy(), omega[k + 1].copy()
    for _ in range(rounds if len(k) else 0):
        middle = 0.5 * (low + high)
        now = reach(plane.a.response(middle), plane.b.response(middle)) >= np.abs(kps[column])
        go_low = now == starts
        high, low = np.where(go_low, middle, high), np.where(go_low, low, middle)
    edge_a, edge_b = plane.a.response(low), plane.b.response(low)
    return column, low, -kps[column] * (edge_a * edge_b.conj()).real / np.abs(edge_b) ** 2


def _disk(plane: GainPlane, omega: Floats, a: Complexes, b: Complexes, radius: float, kps: Floats, polish: bool) -> list[Piece]:
    """Intervals of kd for which |1 + L| < radius at some ω."""
    (lower, real), (upper, _) = (_circle(kps[:, None], a[None, :], b[None, :], 1.0, radius, sign) for sign in (-1.0, 1.0))
    column, k = np.nonzero(real)
    pieces = [(column, lower[column, k], upper[column, k])]
    # From one sample to the next the interval moves and sweeps what lies between, unless it leaves through infinity (a zero of B).
    column, k = np.nonzero(real[:, 1:] & real[:, :-1] & ((lower[:, 1:] > upper[:, :-1]) | (upper[:, 1:] < lower[:, :-1])))
    start, end = np.minimum(lower[column, k], lower[column, k + 1]), np.maximum(upper[column, k], upper[column, k + 1])
    halfway = 0.5 * (omega[k] + omega[k + 1])
    between, exists = _circle(kps[column], plane.a.response(halfway), plane.b.response(halfway), 1.0, radius, 1.0)
    swept = exists & (between > start) & (between <= end)
    pieces.append((column[swept], start[swept], end[swept]))
    if not polish:
        return pieces
    column, point = _narrow_shadows(plane, omega, a, b, radius, kps)
    cell = np.searchsorted(omega, point) - 1
    at_point = kps[column], plane.a.response(point), plane.b.response(point)
    low_end, high_end = (_circle(*at_point, 1.0, radius, sign)[0] for sign in (-1.0, 1.0))
    pieces.append((column, low_end, high_end))
    for sign, kd in ((-1.0, lower), (1.0, upper)):

        def farthest(kp: Floats, a: Complexes, b: Complexes, sign: float = sign) -> Floats:
            kd, real = _circle(kp, a, b, 1.0, radius, sign)
            return np.where(real, sign * kd, -np.inf)  # beside the disk's shadow nothing is reached

        reach = np.where(real, sign * kd, -np.inf)
        top, k = np.nonzero((reach[:, 1:-1] >= reach[:, :-2]) & (reach[:, 1:-1] > reach[:, 2:]))
        owner = np.append(top, column)
        low, middle, high = np.append(omega[k], omega[cell]), np.append(omega[k + 1], point), np.append(omega[k + 2], omega[cell + 1])
        _, height = _maximum(plane, farthest, kps[owner], low, middle, high)
        pieces.append((owner, np.append(kd[top, k + 1], low_end if sign < 0 else high_end), sign * height))
    return pieces


def _narrow_shadows(plane: GainPlane, omega: Floats, a: Complexes, b: Complexes, radius: float, kps: Floats) -> tuple[Integers, Floats]:
    """Column and ω of frequencies, between samples, at which the line of all L at one kp comes closest to −1, and nearer than `radius`."""

    def nearness(kp: Floats, a: Complexes, b: Complexes) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            return -np.abs(((1 + kp * a) * b.conj()).imag) / np.abs(b)

    column, point, _ = Curve.of(plane, -1.0).crossings("kp", kps, True)
    near = nearness(kps[:, None], a[None, :], b[None, :])
    owner, k = np.nonzero((near[:, 1:-1] >= near[:, :-2]) & (near[:, 1:-1] > near[:, 2:]) & (near[:, 1:-1] < -radius))
    touching, height = _maximum(plane, nearness, kps[owner], omega[k], omega[k + 1], omega[k + 2])
    owner, touching = owner[height > -radius], touching[height > -radius]
    column, point = np.append(column, owner), np.append(point, touching)
    inside = (point > omega[0]) & (point < omega[-1])
    return column[inside], point[inside]


def _maximum(
    plane: GainPlane, function: Callable[[Floats, Complexes, Complexes], Floats], kp: Floats, low: Floats, middle: Floats, high: Floats
) -> tuple[Floats, Floats]:
    """(ω, value) of the largest function(kp, A, B) in (low, high), by golden section from a first guess.

    The maximum is flat: ω to 1e-9 gives the value to the last digits.
    """

    def height(omega: Floats) -> Floats:
        return function(kp, plane.a.response(omega), plane.b.response(omega))

    best = height(middle)
    for _ in range(40 if len(middle) else 0):
        right = high - middle > middle - low
        trial = middle + 0.381966011250105 * np.where(right, high - middle, low - middle)
        value = height(trial)
        better = value > best
        end = np.where(better, middle, trial)  # a better trial takes the middle's place; otherwise it is the end on its own side
        low, high = np.where(better == right, end, low), np.where(better == right, high, end)
        middle, best = np.where(better, trial, middle), np.where(better, value, best)
    return middle, best


def _ends(plane: GainPlane) -> list[tuple[float, float]]:
    """(A, B), real, at ω = 0 (where finite) and at the Nyquist frequency."""
    ends = []
    if not np.any(plane.a.poles == 0):
        ends.append(0.0)
    if plane.last is not None:
        ends.append(plane.last)
    return [(float(plane.a.response(w).real), float(plane.b.response(w).real)) for w in ends]


def _at_ends(ends: list[tuple[float, float]], gain_margin: float, kps: Floats) -> list[Piece]:
    """kd for which L, real at an end of the boundary, lies in the segment."""
    pieces = []
    for a, b in ends:
        column = np.arange(len(kps))
        if b == 0:
            caught = (kps * a >= -gain_margin) & (kps * a <= -1 / gain_margin)
            column = column[caught]
            pieces.append((column, np.full(len(column), -np.inf), np.full(len(column), np.inf)))
        else:
            pieces.append((column, (-gain_margin - kps * a) / b, (-1 / gain_margin - kps * a) / b))
    return pieces


def _union(column: Integers, low: Floats, high: Floats, count: int) -> list[Floats]:
    """Disjoint sorted intervals per column."""
    order = np.lexsort((low, column))
    column, low, high = column[order], low[order], high[order]
    bounds = np.searchsorted(column, np.arange(count + 1))
    result = []
    for m in range(count):
        mine_low, mine_high = low[bounds[m] : bounds[m + 1]], high[bounds[m] : bounds[m + 1]]
        if not len(mine_low):
            result.append(np.empty((0, 2)))
            continue
        reach = np.maximum.accumulate(mine_high)
        fresh = np.append(True, mine_low[1:] > reach[:-1] + 1e-12 * np.abs(reach[:-1]))
        starts = np.flatnonzero(fresh)
        result.append(np.stack([mine_low[starts], reach[np.append(starts[1:] - 1, len(reach) - 1)]], axis=1))
    return result
