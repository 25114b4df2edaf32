"""Local search for a structure's parameters: every peak that counts is replaced by a model of second order, and the largest made least.

The cost is the largest of several peaks, and a margin is a curve below 1 at all frequencies; with few parameters the best lie along narrow,
bent ridges, on which tangents alone mislead after a small step. So each peak's height has its slope and its curvature, the peak's shift in
frequency included (the curvature of a maximum: f_xx − f_xω f_ωx / f_ωω), within a radius that shrinks where the models mislead. The model
itself is made least by quadratic programmes of the core over tangents of the models, which cost next to nothing; tangents where a step of
that was not better join the others (a bundle, as in gain_search.py).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from ...native import _core
from ...system.linear.arrays import Booleans, Floats, Integers
from .closed_loop import PRICE, Corners, Curves, curves
from .joint_responses import responses

STEP = 1e-3
"""Step of a coordinate, and of ln ω, for differences: slopes are off by the square of it, curvatures by as much and 1e-9 of round-off."""
FARTHEST = 0.02  # distance, in ln ω, over which a peak that was not met is extrapolated
BAND = 0.35  # ln below the highest peak of the objective from which on peaks have a model
NEAR = -0.5  # ln of a curve over its ceiling from which on its peaks have one
RADIUS, LARGEST, LEAST = 0.3, 1.0, 1e-4
PROMISE = 2e-5  # a step that promises less, in ln, ends the search
STEPS = 40
INNER = 30  # programmes over one model
PULL = 1e-4  # curvature that makes a programme's solution unique


@dataclass(frozen=True)
class Model:
    """Logarithms of peaks as functions of a step, to second order.

    values (p,), slopes (p, n), bends (p, n, n)
    objective   True (p,) for peaks of the objective; else values over their ceilings
    """

    values: Floats
    slopes: Floats
    bends: Floats
    objective: Floats

    def at(self, step: Floats) -> tuple[Floats, Floats]:
        """Values (p,) and slopes (p, n) after a step (n,)."""
        bent = self.bends @ step
        return self.values + (self.slopes + bent / 2) @ step, self.slopes + bent

    def cost(self, values: Floats, reserve: float) -> float:
        """Cost of peaks with these values: the objective, and what exceeds the ceilings."""
        return float(values[self.objective].max()) + PRICE * max(0.0, float(values[~self.objective].max()) + reserve)


@dataclass(frozen=True)
class Polished:
    """End of a local search: coordinates (n,), ln of the objective, ln of the worst ceiling's value over the ceiling."""

    x: Floats
    objective: float
    excess: float


def polished(
    corners: Corners, start: Floats, reserve: float, progress: Callable[[], None] = lambda: None, steps: int = STEPS
) -> Polished | None:
    """Best parameters that a local search reaches from `start`, ceilings kept by `reserve` [ln]; None where `start` is unstable."""
    return descended(lambda x: model_at(corners, x), corners.structure.limits, start, reserve, progress, steps)


def descended(
    model: Callable[[Floats], Model | None],
    limits: tuple[Floats, Floats],
    start: Floats,
    reserve: float,
    progress: Callable[[], None] = lambda: None,
    steps: int = STEPS,
    inner: int = INNER,
) -> Polished | None:
    """Best coordinates between `limits` that a local search by `model` reaches, as of polished; None where there is none at `start`.

    inner   most programmes over one model: of many coordinates more are worth their time
    """
    low, high = limits
    x = np.clip(start, low, high)
    here = model(x)
    if here is None:
        return None
    radius = RADIUS
    for _ in range(steps):
        progress()
        cost = here.cost(here.values, reserve)
        step, promised = _least(here, reserve, np.maximum(-radius, low - x), np.minimum(radius, high - x), inner)
        if promised < PROMISE or radius < LEAST:
            break
        there = model(x + step)
        gained = -math.inf if there is None else cost - there.cost(there.values, reserve)
        if there is not None and gained > 0.1 * promised:
            x, here = x + step, there
            if gained > 0.6 * promised and np.abs(step).max() > 0.9 * radius:
                radius = min(2 * radius, LARGEST)
        else:
            radius = 0.35 * min(radius, float(np.abs(step).max()))
    return Polished(x, float(here.values[here.objective].max()), float(here.values[~here.objective].max()))


def _least(model: Model, reserve: float, low: Floats, high: Floats, inner: int) -> tuple[Floats, float]:
    """Step (n,) between `low` and `high` with about the least cost of the model, and by how much that is less."""
    size = len(low)
    step, radius = np.zeros(size), float(np.maximum(high, -low).max())
    values, slopes = model.at(step)
    first = cost = model.cost(values, reserve)
    rows, offsets = slopes, values  # tangents, as functions of the step from the present one
    bend, pull = np.full(size + 1, PULL), np.r_[np.zeros(size), 1.0]
    kinds = model.objective
    for _ in range(inner):
        base = float(values[model.objective].max())
        programme = np.c_[rows, -1.0 * kinds]
        aim = np.where(kinds, offsets - base, offsets + reserve)
        least, most = np.maximum(low - step, -radius), np.minimum(high - step, radius)
        found, _ = _core.quadratic_programme(bend, pull, programme, aim, PRICE, np.r_[least, -5.0], np.r_[most, 5.0])
        move = found[0, :size]
        expected = rows @ move + offsets
        worst = float(expected[kinds].max()) + PRICE * max(0.0, float(expected[~kinds].max()) + reserve)
        promised = cost - worst
        if promised < 0.3 * PROMISE or radius < LEAST:
            break
        new, turned = model.at(step + move)
        gained = cost - model.cost(new, reserve)
        if gained > 0.1 * promised:
            step, values, cost = step + move, new, cost - gained
            rows, offsets, kinds = turned, new, model.objective
            radius = 2 * radius if gained > 0.6 * promised else radius
        else:
            radius = 0.6 * float(np.abs(move).max())
            behind = np.where(model.objective, values[model.objective].max(), values[~model.objective].max())
            rows = np.concatenate([rows, turned])
            offsets = np.concatenate([offsets, np.minimum(new - turned @ move, behind)])  # what is known here is not contradicted
            kinds = np.concatenate([kinds, model.objective])
    return step, first - cost


def model_at(corners: Corners, x: Floats) -> Model | None:
    """Model at the coordinates x (n,) over all corners; None where they are unstable at one."""
    structure, joint, objective = corners.structure, corners.joints[0], corners.objective
    around, first, second = _differences(len(x))
    with np.errstate(all="ignore"):
        here = curves(structure, x[None], joint, corners.every, corners.ceilings)
        if not corners.are_stable(x, here.returned[0]):
            return None
        parts: list[tuple[Floats, bool]] = []  # logarithms (batch, p) at x + `around`, and whether of the objective
        if not objective.is_peak or here.noise is not None:
            whole = curves(structure, x + STEP * around, joint, corners.every, corners.ceilings)
            for k, weights in enumerate(corners.weights):
                own = slice(k * len(weights), (k + 1) * len(weights))
                if whole.noise is not None:
                    parts.append((0.5 * np.log(whole.noise[:, own] @ weights)[:, None], False))
                if not objective.is_peak:
                    value = objective.value(np.abs(whole.compliance[:, own]), corners.omega[k], weights)
                    parts.append((np.log(value)[:, None], True))
        found = [_model(values[:, :, None], first, second, np.zeros(1, dtype=bool), of) for values, of in parts]
        kind, rows, at, inner = tops(corners.omega, _logs(here, objective.is_peak), objective.below)
        beside = np.exp(STEP * np.array([0.0, 1.0, -1.0]))
        there = responses(corners.joints, (at[:, None] * beside).ravel(), np.repeat(rows, 3))
        near = curves(structure, x + STEP * around, joint, there, corners.ceilings)
        for k, values in enumerate(_logs(near, objective.is_peak)):
            own = kind == k
            found.append(_model(values.reshape(len(around), -1, 3)[:, own], first, second, inner[own], k == 2))
    model = Model(*(np.concatenate(part) for part in zip(*found, strict=True)))
    return model if all(np.isfinite(one).all() for one in vars(model).values()) else None


@cache
def _differences(size: int) -> tuple[Floats, Integers, Integers]:
    """Steps (b, n) at which second differences are taken: 0, then ± each coordinate, then pairs; and the pairs' coordinates."""
    first, second = np.triu_indices(size, 1)
    unit = np.eye(size)
    return np.vstack([np.zeros(size), unit, -unit, unit[first] + unit[second]]), first, second


def _model(values: Floats, first: Integers, second: Integers, shifts: Floats, objective: bool) -> tuple[Floats, Floats, Floats, Floats]:
    """Values, slopes, curvatures and kind of p peaks from values (b, p, 3 or 1) at x + `around` and at, above and below their frequency.

    shifts   True (p,) for peaks between frequencies, which move
    """
    count = values.shape[1]
    middle = values[..., 0]
    size = (len(middle) - 1 - len(first)) // 2
    top, up, down, pairs = middle[0], middle[1 : 1 + size], middle[1 + size : 1 + 2 * size], middle[1 + 2 * size :]
    slopes = (up - down).T / (2 * STEP)
    bends = np.zeros((count, size, size))
    diagonal = np.arange(size)
    bends[:, diagonal, diagonal] = (up + down - 2 * top).T / STEP**2
    mixed = (pairs - up[first] - up[second] + top).T / STEP**2
    bends[:, first, second] = bends[:, second, first] = mixed
    if values.shape[2] == 3:
        above, below = values[..., 1], values[..., 2]
        slanted = ((above - below)[1 : 1 + size] - (above - below)[1 + size : 1 + 2 * size]).T / (4 * STEP**2)
        top, moved = followed(np.stack([top, above[0], below[0]]), slanted, shifts)
        bends += moved
    return top, slopes, bends, np.full(count, objective)


def followed(values: Floats, slanted: Floats, shifts: Booleans) -> tuple[Floats, Floats]:
    """Values (p,) at peaks that move with a step, and what that adds to their curvatures (p, n, n).

    values (3, p) at a peak's frequency, and STEP above and below it in ln ω; slanted (p, n) derivatives of the slopes by ln ω
    shifts   True (p,) for peaks between frequencies, which move
    """
    top, above, below = values
    bent = (above + below - 2 * top) / STEP**2
    moves = shifts & (bent < -1e-3)
    share = np.where(moves, -1 / np.where(moves, bent, 1.0), 0.0)
    inclined = (above - below) / (2 * STEP)
    met = np.where(np.abs(inclined * share) < FARTHEST, inclined**2 * share / 2, 0.0)  # at the peak, if it was not met
    return top + met, share[:, None, None] * slanted[:, :, None] * slanted[:, None, :]


def _logs(found: Curves, with_objective: bool) -> list[Floats]:
    """Logarithms (batch, m) of the curves whose peaks count: sensitivity, delay, and compliance if `with_objective`."""
    logs = [np.log(found.sensitivity), np.log(np.maximum(found.delay, 1e-9))]
    return [*logs, np.log(np.abs(found.compliance))] if with_objective else logs


def tops(omega: Floats, logs: list[Floats], below: float) -> tuple[Integers, Integers, Floats, Floats]:
    """Curve, corner and frequency (p,) of the highest peaks of the curves `logs` (1, corners · m) at omega (corners, m).

    The frequency is that of the top of a parabola in ln ω; of the compliance, the third curve, up to `below`. Last, True (p,) for peaks
    between frequencies, which are not at either end.
    """
    count, place = len(omega), np.log(omega)
    values = np.stack([one.reshape(count, -1) for one in logs])  # (curves, corners, m)
    floors = np.full((len(logs), count, 1), NEAR)
    if len(logs) == 3:
        values[2][omega > below] = -np.inf
        floors[2] = values[2].max() - BAND
    floors[:2] = np.minimum(floors[:2], values[:2].max(axis=(1, 2))[:, None, None])  # of each ceiling at least the highest
    rises = np.ones(values.shape, dtype=bool)
    rises[..., 1:] &= values[..., 1:] >= values[..., :-1]
    rises[..., :-1] &= values[..., :-1] >= values[..., 1:]
    kind, corner, k = np.nonzero(rises & (values >= floors))
    middle = np.clip(k, 1, omega.shape[1] - 2)
    left, right = (place[corner, middle + side] - place[corner, middle] for side in (-1, 1))
    top = values[kind, corner, middle]
    low, high = (values[kind, corner, middle - 1] - top) / left, (values[kind, corner, middle + 1] - top) / right
    bend = (high - low) / (right - left)
    shift = -(high - bend * right) / (2 * bend)
    inner = (bend < 0) & (k == middle) & np.isfinite(shift)
    at = np.exp(place[corner, k] + np.where(inner, np.clip(shift, left, right), 0.0))
    capped = (kind == 2) & (at > below)
    return kind, corner, np.where(capped, below, at), inner & ~capped
