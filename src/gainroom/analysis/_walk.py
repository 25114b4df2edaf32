"""A walk along the stability boundary: points on it, and what bounds log|L| and arg L between them. See crossings.py."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..linear.arrays import Booleans, Complexes, Floats, Integers
from ._batch import TINY, Batch, breakpoints, centers, rates

MAX_ROUNDS = 60  # of bisection
MAX_NODES = 300_000  # of all loops of one call together: bounds memory and time


@dataclass
class Nodes:
    """Points on the boundary, sorted by loop and frequency."""

    owner: Integers
    omega: Floats
    value: Complexes
    terms: Complexes
    phase: Floats

    def take(self, index: Integers) -> "Nodes":
        return Nodes(self.owner[index], self.omega[index], self.value[index], self.terms[index], self.phase[index])

    def merged(self, other: "Nodes") -> "Nodes":
        """Both sets of nodes, sorted."""
        joined = [np.concatenate([getattr(self, name), getattr(other, name)]) for name in ("owner", "omega", "value", "terms", "phase")]
        return Nodes(*joined).take(np.lexsort((joined[1], joined[0])))


def first_nodes(batch: Batch) -> Nodes:
    """Both ends, the breakpoints between, and a coarse ladder that saves rounds of bisection."""
    points = breakpoints(batch)
    inner = (points > batch.low[:, None]) & (points < batch.high[:, None])
    owner, column = np.nonzero(inner)
    everyone = np.arange(len(batch.gain))
    outermost = np.max(np.where(inner, points, 0.0), axis=1)
    ladder = np.minimum(np.maximum(outermost, batch.low)[:, None] * 2.0 ** np.arange(1, 40), batch.high[:, None])
    steps = (ladder < batch.high[:, None]) & (ladder > batch.low[:, None])
    owners = np.concatenate([everyone, everyone, owner, np.nonzero(steps)[0]])
    omega = np.concatenate([batch.low, batch.high, points[owner, column], ladder[steps]])
    order = np.lexsort((omega, owners))
    owners, omega = owners[order], omega[order]
    keep = np.append(True, (np.diff(owners) != 0) | (np.diff(omega) > 0))
    value, terms = batch.evaluate(owners[keep], omega[keep])
    return Nodes(owners[keep], omega[keep], value, terms, np.zeros(np.count_nonzero(keep)))


def intervals(nodes: Nodes) -> Integers:
    """Index of the left node of each interval."""
    return np.flatnonzero(nodes.owner[1:] == nodes.owner[:-1])


def bounds(batch: Batch, nodes: Nodes, left: Integers, part: str) -> tuple[Floats, Floats]:
    """Lowest and highest slope of log|L| (part 'real') or of arg L ('imag') on each interval."""
    first, second = getattr(nodes.terms[left], part), getattr(nodes.terms[left + 1], part)
    low, high = np.minimum(first, second).sum(axis=1), np.maximum(first, second).sum(axis=1)
    if part == "imag":
        low, high = low - batch.delay[nodes.owner[left]], high - batch.delay[nodes.owner[left]]
    return low, high


def values_between(width: Floats, end_a: Floats, end_b: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Range of a quantity on each interval from its two ends and its slope's range."""
    lowest = np.maximum(end_a + low * width, end_b - high * width)
    highest = np.minimum(end_a + high * width, end_b - low * width)
    lowest, highest = np.where(low >= 0, end_a, lowest), np.where(low >= 0, end_b, highest)
    return np.where(high <= 0, end_b, lowest), np.where(high <= 0, end_a, highest)


def is_gap(nodes: Nodes, left: Integers) -> Booleans:
    """True for the narrow interval around a root on the boundary."""
    return nodes.omega[left + 1] - nodes.omega[left] <= 8 * TINY * nodes.omega[left + 1]


def _middle(low: Floats, high: Floats) -> Floats:
    """Where to bisect: geometric on a wide interval, arithmetic on a narrow one."""
    return np.where((low > 0) & (high > 4 * low), np.sqrt(low * high), 0.5 * (low + high))


def resolve_turns(batch: Batch, nodes: Nodes) -> tuple[Nodes, Booleans]:
    """Bisect until arg L provably turns by less than π on every interval, so that it can be unwrapped; per loop whether it was reached."""
    decided = np.ones(len(batch.gain), dtype=bool)
    for attempt in range(MAX_ROUNDS):
        left = intervals(nodes)
        low, high = bounds(batch, nodes, left, "imag")
        width = nodes.omega[left + 1] - nodes.omega[left]
        split = left[(np.maximum(-low, high) * width > 2.5) & ~is_gap(nodes, left)]
        if not len(split):
            break
        if attempt == MAX_ROUNDS - 1 or len(nodes.omega) + len(split) > MAX_NODES:
            decided[nodes.owner[split]] = False
            break
        owner, omega = nodes.owner[split], _middle(nodes.omega[split], nodes.omega[split + 1])
        nodes = nodes.merged(Nodes(owner, omega, *batch.evaluate(owner, omega), np.zeros(len(split))))
    return nodes, decided


def jumps(batch: Batch, nodes: Nodes, left: Integers) -> Floats:
    """Change of arg L across each interval from roots on the boundary inside it, which the contour passes on their right; 0 without any."""
    result = np.zeros(len(left))
    nearest, (_, on_axis) = centers(batch), rates(batch)
    for k in np.flatnonzero(is_gap(nodes, left)):
        m, low, high = nodes.owner[left[k]], nodes.omega[left[k]], nodes.omega[left[k] + 1]
        inside = (nearest[m] >= low) & (nearest[m] <= high) & on_axis[m] & (batch.roots[m] != 0)
        result[k] = math.pi * np.sum(batch.signs[m, inside])
    return result


def turn_between(value_a: Complexes, value_b: Complexes) -> Floats:
    return np.angle(value_b * value_a.conj())


def unwrap(batch: Batch, nodes: Nodes, limit: Floats, exact_start: Booleans) -> None:
    """Fill in arg L by continuity along each loop's nodes, from its limit at ω → 0+."""
    left = intervals(nodes)
    turn = np.zeros(len(nodes.omega))
    turn[left + 1] = turn_between(nodes.value[left], nodes.value[left + 1])
    jump = jumps(batch, nodes, left)
    leap = left[jump != 0] + 1
    turn[leap] = jump[jump != 0] + np.angle(np.exp(1j * (turn[leap] - jump[jump != 0])))
    first = np.flatnonzero(np.append(True, np.diff(nodes.owner) != 0))
    offset = np.angle(nodes.value[first] * np.exp(-1j * limit))
    turn[first] = limit + np.where(exact_start, 0.0, offset)
    total = np.cumsum(turn)
    before = np.append(0.0, total[first[1:] - 1])
    nodes.phase = total - np.repeat(before, np.diff(np.append(first, len(nodes.omega))))


def log_size(value: Complexes) -> Floats:
    return np.log(np.maximum(np.abs(value), 1e-300))


def bisect(batch: Batch, nodes: Nodes, undecided: Callable[[Batch, Nodes, Integers], Booleans]) -> tuple[Nodes, Booleans]:
    """Bisect until no interval is undecided: the nodes, and per loop whether that was reached."""
    decided = np.ones(len(batch.gain), dtype=bool)
    fresh = np.ones(len(nodes.omega), dtype=bool)  # only intervals with a new end need another look
    split = np.empty(0, dtype=int)
    for _ in range(MAX_ROUNDS):
        left = intervals(nodes)
        left = left[fresh[left] | fresh[left + 1]]
        left = left[~is_gap(nodes, left)]
        split = left[undecided(batch, nodes, left)]
        if not len(split):
            return nodes, decided
        if len(nodes.omega) + len(split) > MAX_NODES:
            break
        owner, omega = nodes.owner[split], _middle(nodes.omega[split], nodes.omega[split + 1])
        value, terms = batch.evaluate(owner, omega)
        added = Nodes(owner, omega, value, terms, nodes.phase[split] + turn_between(nodes.value[split], value))
        order = np.lexsort((np.append(nodes.omega, omega), np.append(nodes.owner, owner)))
        fresh = np.append(np.zeros(len(nodes.omega), dtype=bool), np.ones(len(omega), dtype=bool))[order]
        nodes = nodes.merged(added)
    decided[nodes.owner[split]] = False
    return nodes, decided
