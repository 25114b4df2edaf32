"""Local search for a structure's parameters: sequential quadratic programming over the peaks of its curves.

As in gain_search.py every peak that counts is replaced by its tangent and the quadratic programme of the core solved, within a radius that
shrinks where the tangents mislead; here the unknowns are any parameters, the cost is itself the largest of several peaks (the epigraph of a
maximum), and a margin is a curve below 1 at all frequencies. A peak's height is taken at the top of the parabola through its three highest
samples, where the curve is evaluated again; its slope is that of the curve there, the frequency held, as a maximum's slope is.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...native import _core
from ...system.linear.arrays import Floats
from .closed_loop import PRICE, Corners, Curves, curves, is_stable
from .joint_responses import quadrature

STEP = 1e-5  # of a coordinate, for slopes: central differences are then off by 1e-10, and by as much in round-off
BAND = 0.35  # ln below the highest peak of the objective from which on peaks have a tangent
NEAR = -0.7  # ln of a curve over its ceiling from which on its peaks have one
MOST_PEAKS = 10
RADIUS, LARGEST, LEAST = 0.2, 0.8, 1e-5
PROMISE = 1e-6  # a step that promises less, in ln, ends the search
STEPS = 80
PULL = 1e-4  # curvature that makes the programme's solution unique


@dataclass(frozen=True)
class Tangents:
    """Tangents at some parameters.

    objective, slopes    ln of the peaks of the objective (p,), and their slopes (p, n)
    ceilings, pulls      ln of what is held below its ceiling, over the ceiling (c,), and slopes (c, n)
    """

    objective: Floats
    slopes: Floats
    ceilings: Floats
    pulls: Floats

    def cost(self, reserve: float) -> float:
        """Cost of the parameters: ln of the objective and of what exceeds the ceilings."""
        return float(self.objective.max()) + PRICE * max(0.0, float(self.ceilings.max()) + reserve)


@dataclass(frozen=True)
class Polished:
    """End of a local search: coordinates (n,), ln of the objective, ln of the worst ceiling's value over the ceiling."""

    x: Floats
    objective: float
    excess: float


def polished(corners: Corners, start: Floats, reserve: float, progress: Callable[[], None] = lambda: None) -> Polished | None:
    """Best parameters that a local search reaches from `start`, ceilings kept by `reserve` [ln]; None where `start` is unstable."""
    low, high = corners.structure.limits
    x, size = np.clip(start, low, high), len(start)
    here = tangents(corners, x)
    if here is None:
        return None
    radius = RADIUS
    for _ in range(STEPS):
        progress()
        base, cost = float(here.objective.max()), here.cost(reserve)
        rows = np.vstack([np.c_[here.slopes, -np.ones(len(here.slopes))], np.c_[here.pulls, np.zeros(len(here.pulls))]])
        values = np.concatenate([here.objective - base, here.ceilings + reserve])
        moved = False
        while radius > LEAST:
            least, most = np.maximum(-radius, low - x), np.minimum(radius, high - x)
            bend, pull = np.full(size + 1, PULL), np.r_[np.zeros(size), 1.0]
            found, _ = _core.quadratic_programme(bend, pull, rows, values, PRICE, np.r_[least, -3.0], np.r_[most, 3.0])
            step = found[0, :size]
            expected = here.slopes @ step + here.objective, here.pulls @ step + here.ceilings
            promised = cost - float(expected[0].max()) - PRICE * max(0.0, float(expected[1].max()) + reserve)
            if promised < PROMISE:
                break
            there = tangents(corners, x + step)
            gained = -math.inf if there is None else cost - there.cost(reserve)
            if there is not None and gained > 0.1 * promised:
                x, here, moved = x + step, there, True
                if gained > 0.6 * promised and np.abs(step).max() > 0.99 * radius:
                    radius = min(1.8 * radius, LARGEST)
                break
            radius = 0.4 * min(radius, float(np.abs(step).max()))
        if not moved:
            break
    return Polished(x, float(here.objective.max()), float(here.ceilings.max()))


def tangents(corners: Corners, x: Floats) -> Tangents | None:
    """Tangents at the coordinates x (n,) over all corners; None where they are unstable at one."""
    size, structure, ceilings = len(x), corners.structure, corners.ceilings
    around = x + STEP * np.vstack([np.zeros(size), np.eye(size), -np.eye(size)])
    objective, slopes, held, pulls = [], [], [], []

    def add(values: Floats, to: list[Floats], sloped: list[Floats]) -> None:
        """Adds values (2n + 1, p) at `around`."""
        to.append(values[0])
        sloped.append(((values[1 : size + 1] - values[size + 1 :]) / (2 * STEP)).T)

    with np.errstate(all="ignore"):
        for joint, responses in zip(corners.joints, corners.sampled, strict=True):
            omega = responses.omega
            whole = corners.objective.is_peak and ceilings.torque_noise is None
            found = curves(structure, x[None] if whole else around, joint, responses, ceilings)
            first = found.at(0)
            if not is_stable(structure, x[None], joint, omega, first.returned)[0] or not np.isfinite(first.returned).all():
                return None
            weights = quadrature(omega)
            if found.noise is not None:
                add(0.5 * np.log(found.noise @ weights)[:, None], held, pulls)
            if not corners.objective.is_peak:
                add(np.log(corners.objective.value(np.abs(found.compliance), omega, weights))[:, None], objective, slopes)
            tops = _tops(omega, _logs(first, corners.objective.is_peak), corners.objective.below)
            at, kind = np.concatenate(tops), np.repeat(np.arange(len(tops)), [len(one) for one in tops])
            near = curves(structure, around, joint, joint.at(at), ceilings)
            logs = _logs(near, corners.objective.is_peak)
            for k, values in enumerate(logs):
                add(values[:, kind == k], *((objective, slopes) if k == 2 else (held, pulls)))
    found = Tangents(np.concatenate(objective), np.vstack(slopes), np.concatenate(held), np.vstack(pulls))
    return found if all(np.isfinite(one).all() for one in vars(found).values()) else None


def _logs(found: Curves, with_objective: bool) -> list[Floats]:
    """Logarithms (batch, m) of the curves whose peaks count: sensitivity, delay, and compliance if `with_objective`."""
    logs = [np.log(found.sensitivity), np.log(np.maximum(found.delay, 1e-9))]
    return [*logs, np.log(np.abs(found.compliance))] if with_objective else logs


def _tops(omega: Floats, logs: list[Floats], below: float) -> list[Floats]:
    """Frequencies of the highest peaks of each curve (1, m) of _logs: the top of a parabola in ln ω; of the compliance up to `below`."""
    found, place = [], np.log(omega)
    for k, one in enumerate(logs):
        values = one[0] if k < 2 else np.where(omega <= below, one[0], -np.inf)
        floor = NEAR if k < 2 else values.max() - BAND
        inner = (values >= np.r_[-np.inf, values[:-1]]) & (values >= np.r_[values[1:], -np.inf]) & (values > floor)
        rows = np.flatnonzero(inner)
        rows = rows[np.argsort(-values[rows], kind="stable")][:MOST_PEAKS]
        if k < 2 and not len(rows):
            rows = np.array([int(np.argmax(values))])
        middle = np.clip(rows, 1, len(omega) - 2)
        left, right = place[middle - 1] - place[middle], place[middle + 1] - place[middle]
        low, high = (values[middle - 1] - values[middle]) / left, (values[middle + 1] - values[middle]) / right
        bend = (high - low) / (right - left)
        slope = high - bend * right
        shift = np.where((bend < 0) & (rows == middle), -slope / (2 * bend), 0.0)
        shift = np.clip(np.nan_to_num(shift), left, right)
        top = np.where(rows == middle, np.exp(place[middle] + shift), omega[rows])
        found.append(np.minimum(top, below) if k == 2 else top)
    return found
