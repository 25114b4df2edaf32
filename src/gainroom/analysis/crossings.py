"""Every crossing and every peak of scalar responses, certified between the sampled points; many loops at once, in numpy.

L(v) = gain Π(v − zeros)/Π(v − poles) e^{−jωT} is a product, so d log L/dω is a sum of one simple term per root. Between *breakpoints*
(the frequencies where some term has an extremum) each term is monotone, hence its range on an interval is given by its two ends, and
the sum of ranges bounds the slopes of log|L| and arg L on the whole interval. Intervals are bisected until those bounds decide them:
an interval holds no crossing, or the slope has one sign and it holds at most one, which bracketed Newton then polishes; no peak inside
can be more than 1 % above the best one found. Nothing is interpolated, and nothing between two points can be missed; where rounding
stops the bisection, `certified` comes back False.

The loops are in `_batch.py`, the walk with its bounds in `_walk.py`, the peaks in `_peaks.py`. `_scan.py` holds the same walk compiled,
for one loop at a time, and polishes peaks with secants where `_peaks.py` only takes steps; tests compare the two.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..linear.arrays import Booleans, Complexes, Floats, Integers
from ..linear.transfer_function import Factored
from ._batch import Batch, neutral_floor, prepared
from ._peaks import find_peaks, objective
from ._walk import Nodes, bisect, bounds, first_nodes, intervals, jumps, log_size, resolve_turns, turn_between, unwrap, values_between

FLOOR = 1e-3  # in continuous time the walk ends where |L| stays below; lower until it cannot come back to the nearest crossing found
MANY = 1000  # crossings of which those found are left alone; of fewer, it costs less to look at all again
LOWEST_FLOOR = 1e-9  # crossings below are left out: which of them comes first is not known


@dataclass(frozen=True)
class Scan:
    """What one loop's response does along the whole stability boundary.

    gains        (g, 2): ω of every |L| = 1, arg L there by continuity from small s > 0
    phases       (p, 3): ω of every arg L = π (mod 2π), |L| there, sign of the phase slope (0 at an end of the boundary)
    peaks        (3, 2): ω and minimum of |1+L|, |1+L|/|L|, 2|1+L|/|1−L|; zeros when not requested
    half_turns   change of arg(1+L) along the upper half of the contour, divided by π
    certified    False where rounding or the work limit stopped the proof
    """

    gains: Floats
    phases: Floats
    peaks: Floats
    half_turns: float
    certified: bool


def scan_many(loops: list[Factored], with_peaks: bool = True, floor: float = FLOOR) -> list[Scan]:
    """Scan every loop; all must have the same sample time."""
    batch, start_phase, integrators = prepared(loops, floor)
    nodes, turned = resolve_turns(batch, first_nodes(batch))
    unwrap(batch, nodes, start_phase - integrators * math.pi / 2, integrators == 0)
    nodes, decided = bisect(batch, nodes, _undecided_crossing)
    decided &= turned
    gains, phases = _crossings(batch, nodes)
    scans = []
    peaks = np.zeros((len(loops), 3, 2))
    if with_peaks:
        peaks, sure = find_peaks(batch, nodes)
        decided &= sure
    for m in range(len(loops)):
        own = np.flatnonzero(nodes.owner == m)
        first, last = own[0], own[-1]
        mine = gains[0] == m
        gain_rows = np.stack([gains[1][mine], gains[2][mine]], axis=1)
        outside = bool(integrators[m] > 0 or (integrators[m] == 0 and abs(nodes.value[first]) > 1))
        ends_at_boundary = batch.sample_time > 0 or loops[m].relative_degree == 0
        half_turns = half_encirclements(start_phase[m], outside, ends_at_boundary, float(nodes.phase[last]), gain_rows)
        phase_rows = [row for row in zip(*phases, strict=True) if row[0] == m]
        rows = [row[1:] for row in phase_rows]
        if integrators[m] == 0 and nodes.value[first].real < 0:
            rows.insert(0, (0.0, abs(nodes.value[first]), 0.0))
        if batch.sample_time > 0 and nodes.value[last].real < 0:
            rows.append((nodes.omega[last], abs(nodes.value[last]), 0.0))
        phase_table = np.array(rows, dtype=float).reshape(-1, 3)
        if (lower := next_floor(loops[m], phase_table, floor)) is not None:
            scans.append(scan_many([loops[m]], with_peaks, lower)[0])
            continue
        scans.append(finished(loops[m], Scan(gain_rows, phase_table, peaks[m], half_turns, bool(decided[m])), with_peaks))
    return scans


def next_floor(loop: Factored, phases: Floats, floor: float) -> float | None:
    """Down to where the walk has to go once more, so that no L < 0 lies nearer to −1 from above than those found; None where none can."""
    neutral = loop.relative_degree == 0
    nearest = float(np.max(phases[phases[:, 1] < 1, 1], initial=0.0))
    reached = float(neutral_floor(np.array(loop.gain), floor)) if neutral else floor
    if loop.sample_time is not None or nearest >= reached or floor <= LOWEST_FLOOR:
        return None
    return max(0.0 if neutral else nearest, 1e-3 * floor, LOWEST_FLOOR)


def finished(loop: Factored, scan: Scan, with_peaks: bool) -> Scan:
    """`scan` without crossings too small to affect the first one, and with the end at ω = ∞ of a loop with as many zeros as poles."""
    if loop.sample_time is not None:
        return scan
    phases, peaks = scan.phases[scan.phases[:, 1] >= LOWEST_FLOOR], scan.peaks
    if loop.relative_degree == 0 and (loop.delay > 0 or loop.gain < 0):
        # L tends to its gain, or with a delay to a circle: as near to −|gain| as one likes, at frequencies as high as one likes
        phases = np.vstack([phases, [math.inf, abs(loop.gain), 0.0]])
        lowest = np.array([objective(kind, np.array([complex(-abs(loop.gain))]))[0] for kind in range(3)])
        if with_peaks:
            peaks = np.where((lowest < peaks[:, 1])[:, None], np.stack([np.full(3, math.inf), lowest], axis=1), peaks)
    return replace(scan, phases=phases, peaks=peaks)


def _half_turns(phase: Floats) -> Floats:
    """Number of odd multiples of π below `phase`, up to a constant."""
    return np.floor((phase - math.pi) / (2 * math.pi))


def _undecided_crossing(batch: Batch, nodes: Nodes, left: Integers) -> Booleans:
    """True where an interval may hold a crossing without a slope of one sign."""
    width = nodes.omega[left + 1] - nodes.omega[left]
    steep_low, steep_high = bounds(batch, nodes, left, "real")
    log_low, log_high = values_between(width, log_size(nodes.value[left]), log_size(nodes.value[left + 1]), steep_low, steep_high)
    turn_low, turn_high = bounds(batch, nodes, left, "imag")
    phase_low, phase_high = values_between(width, nodes.phase[left], nodes.phase[left + 1], turn_low, turn_high)
    odd_multiple = _half_turns(phase_high) >= np.ceil((phase_low - math.pi) / (2 * math.pi))
    return ((steep_low < 0) & (steep_high > 0) & (log_low <= 0) & (log_high >= 0)) | ((turn_low < 0) & (turn_high > 0) & odd_multiple)


def _crossings(batch: Batch, nodes: Nodes) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Polished crossings of all loops: (owner, ω, arg L) of |L| = 1, and (owner, ω, |L|, slope sign) of arg L = π (mod 2π)."""
    left = intervals(nodes)
    jump = jumps(batch, nodes, left)
    rooted, inside_large, left = left[jump != 0], jump[jump != 0] < 0, left[jump == 0]
    large = log_size(nodes.value) > 0
    unity = left[large[left] != large[left + 1]]
    omega, value = _polish(batch, nodes, unity, log_size, "real")
    # |L| is 0 at a zero on the boundary and infinite at a pole, however large or small just beside it
    beside = np.concatenate([rooted[large[rooted] != inside_large], rooted[large[rooted + 1] != inside_large] + 1])
    found = (
        np.append(nodes.owner[unity], nodes.owner[beside]),
        np.append(omega, nodes.omega[beside]),
        np.append(nodes.phase[unity] + turn_between(nodes.value[unity], value), nodes.phase[beside]),
    )
    order = np.lexsort((found[1], found[0]))
    gains = tuple(column[order] for column in found)
    # L < 0 at an end of the boundary is itself a crossing, listed by the caller
    ends = (nodes.omega[left] == 0) & (nodes.value[left].real < 0)
    if batch.sample_time > 0:
        ends |= (nodes.omega[left + 1] == batch.high[nodes.owner[left]]) & (nodes.value[left + 1].real < 0)
    odd = left[(_half_turns(nodes.phase[left]) != _half_turns(nodes.phase[left + 1])) & ~ends]
    omega, value = _polish(batch, nodes, odd, lambda value: np.angle(-value), "imag")
    rising = np.where(nodes.phase[odd + 1] > nodes.phase[odd], 1.0, -1.0)
    return gains, (nodes.owner[odd], omega, np.abs(value), rising)


def _polish(batch: Batch, nodes: Nodes, left: Integers, function: Callable[[Complexes], Floats], part: str) -> tuple[Floats, Complexes]:
    """Roots of a monotone function of L in the intervals `left`, by Newton with bisection as the fallback: (ω, L)."""
    owner, low, high = nodes.owner[left], nodes.omega[left].copy(), nodes.omega[left + 1].copy()
    rising = function(nodes.value[left]) <= 0
    omega = 0.5 * (low + high)
    value = np.zeros(len(left), dtype=complex)
    open_ = np.arange(len(left))  # intervals whose root is not yet found
    for _ in range(80):
        at = omega[open_]
        value[open_], terms = batch.evaluate(owner[open_], at)
        f, slope = function(value[open_]), getattr(terms, part).sum(axis=1) - (batch.delay[owner[open_]] if part == "imag" else 0.0)
        below = (f <= 0) == rising[open_]
        low[open_], high[open_] = np.where(below, at, low[open_]), np.where(below, high[open_], at)
        step = at - np.divide(f, slope, out=np.full(len(f), np.inf), where=slope != 0)
        done = (f == 0) | (np.abs(step - at) <= 1e-15 * at)
        inside = (step > low[open_]) & (step < high[open_])
        omega[open_] = np.where(done, at, np.where(inside, step, 0.5 * (low[open_] + high[open_])))
        if done.all():
            break
        if len(open_) > MANY:
            open_ = open_[~done]
    return omega, value


def half_encirclements(start_phase: float, outside: bool, ends_at_boundary: bool, last_phase: float, gains: Floats) -> float:
    """Change of arg(1+L) along the upper half of the contour, divided by π.

    While |L| > 1, arg(1+L) = arg L + arg(1+1/L); while |L| < 1 it cannot turn around. So the gain crossings alone fix it.
    """
    turned, mark = 0.0, start_phase if outside else 0.0
    for phase in gains[:, 1]:
        half = float(np.angle(np.exp(1j * phase))) / 2  # arg(1 + e^{j phase})
        turned += (phase - half if outside else half) - mark
        mark = half if outside else phase - half
        outside = not outside
    end = math.pi * round(last_phase / math.pi) if outside and ends_at_boundary else 0.0
    return (turned + end - mark) / math.pi
