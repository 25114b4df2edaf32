"""Detection of rows in which a torque was limited: it is constant while its law changes, at a bound, a bound of its rate, or a dead zone.

Such rows tell nothing of the law. A bound shows as runs of rows that hardly differ, that no row beside them exceeds, and that are entered
with a bend: a smooth extremum of height h over a run's half is 9 h lower a run's length beside it, a clipped one far more. A torque
that is held from command to command stands, too, but at other levels each time.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Booleans, Floats
from .record import Record, resolution

FLAT = 4  # rows at least in a run
QUIET = 0.05  # quantile of the range over so many rows that is taken for noise
OVER_NOISE = 3.0  # noise and resolution that a run may span
BEND = 15.0  # times a run's span that the torque changes by over its length beside it; 9 at a smooth extremum, with what noise adds
BESIDE = 10.0  # lengths of a run, either side, that nothing may exceed it in
TOP, MOVED_LEVEL, SAME_LEVEL = 0.01, 0.1, 1e-4  # of the torque's range: above a run that nothing exceeds; from run to run at a bound that
# moves, as with temperature; and at one among commands that are held, of which some are alike by chance
AGREE = 2  # other runs that are at a bound among commands that are held
HELD = 0.3  # of the rows in runs beside those at a bound: more, and commands are held, whose levels are then to be the same
LONG = 10  # rows: a single run this long is a bound
LEAST_SHARE = 0.003  # of the rows at a bound
PASSES = 4  # of a dead zone, or of a bound that is touched shortly
MOST_VALUES = 30  # of a signal that goes to and fro between a few steps
LEAST_STEPS = 4.0  # of the encoder that the joint moves in a run: at rest a torque stands of itself


@dataclass(frozen=True)
class Limited:
    """Rows in which a torque was limited.

    channel    whose rows these are
    rows       (m,) True where it was
    low, high  [N m] its bounds, the median of one that moves; NaN where none was reached
    kinds      "bound", "rate" (its change per row is bounded), "dead zone"
    """

    channel: str
    rows: Booleans
    low: float = math.nan
    high: float = math.nan
    kinds: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """Share of the rows that were limited."""
        return float(np.mean(self.rows))

    @property
    def bounded(self) -> bool:
        """True where the torque itself reached a bound."""
        return "bound" in self.kinds


def limited_rows(record: Record, channel: str) -> Limited:
    """Rows of a torque `channel` that were limited, in a record without gaps."""
    torque = record.channels[channel]
    moved = _moved(record)
    upper, high = _at_bound(torque, moved)
    lower, low = _at_bound(-torque, moved)
    if upper.any() != lower.any():  # of a torque that one bound cuts, rows at its other end are taken for cut where they are many
        side, end = (lower, -float(torque.min())) if upper.any() else (upper, float(torque.max()))
        ends = (-torque if side is lower else torque) >= end - 1e-9 * float(np.ptp(torque))
        if ends.sum() >= PASSES and ends.mean() > LEAST_SHARE:
            upper, lower = upper | (ends if side is upper else False), lower | (ends if side is lower else False)
            high, low = (end, low) if side is upper else (high, end)
    faster, _ = _at_bound(np.diff(torque, prepend=torque[0]), moved)
    slower, _ = _at_bound(-np.diff(torque, prepend=torque[0]), moved)
    dead = _dead(torque, moved)
    found = {"bound": upper | lower, "rate": faster | slower, "dead zone": dead}
    kinds = tuple(name for name, rows in found.items() if rows.mean() > LEAST_SHARE)
    rows = np.any([found[name] for name in kinds], axis=0) if kinds else np.zeros(len(torque), dtype=bool)
    return Limited(channel, rows, -low, high, kinds)


def limited_text(limited: Limited, consequence: str) -> list[str]:
    """Warning that rows with a limited torque have the `consequence`; [] if there are none."""
    if not limited.kinds:
        return []
    bounds = [f"{value:.3g}" for value in (limited.low, limited.high) if math.isfinite(value)]
    at = f"stands at its limit of {' and '.join(bounds)} N·m"
    names = {"bound": at, "rate": "changes at its largest rate", "dead zone": "is 0 in a dead zone"}
    kinds = " or ".join(names[kind] for kind in limited.kinds)
    return [f"{limited.channel} {kinds} in {100 * limited.share:.2g} % of the rows, which {consequence}"]


def _moved(record: Record) -> Floats:
    """Motion (m,) while a controller's law goes on: the position, in encoder steps; a ramp if none is logged."""
    for name in ("motor_position", "link_position"):
        if record.has(name):
            position = record.channels[name]
            step = resolution(position)
            return position / step if step else 1e9 * position / max(float(np.ptp(position)), 1e-300)
    return LEAST_STEPS * np.arange(len(record.time), dtype=float)


def _runs(values: Floats) -> tuple[list[tuple[int, int]], float]:
    """First row and the one behind the last of every run of at least FLAT rows that hardly differ, and the noise of `values` (m,)."""
    windows = np.lib.stride_tricks.sliding_window_view(values, FLAT)
    span = windows.max(axis=1) - windows.min(axis=1)
    noise = max(OVER_NOISE * float(np.quantile(span, QUIET)), 1e-7 * float(np.ptp(values)))
    flat = np.zeros(len(values), dtype=bool)
    for k in range(FLAT):
        flat[k : len(values) - FLAT + 1 + k] |= span <= noise
    begins = flat & ~np.concatenate([[False], flat[:-1] & (np.abs(np.diff(values)) <= noise)])  # a held command jumps from run to run
    ends = flat & np.append(begins[1:] | ~flat[1:], True)
    return list(zip(np.flatnonzero(begins).tolist(), (np.flatnonzero(ends) + 1).tolist(), strict=True)), noise


def _enters_sharply(values: Floats, first: int, last: int, step: float) -> bool:
    """True if `values` (m,) enter or leave the run more steeply than a smooth extremum would."""
    length = last - first
    part = values[first:last]
    span = max(float(np.ptp(part)), step)
    before, behind = values[max(first - length, 0) : first], values[last : last + length]
    change = max((abs(float(beside.min()) - float(part.mean())) for beside in (before, behind) if len(beside)), default=0.0)
    return change > BEND * span and change > 0


def _at_bound(values: Floats, moved: Floats) -> tuple[Booleans, float]:
    """Rows (m,) in which `values` are at an upper bound, and the bound; NaN if there is none."""
    rows, size, step = np.zeros(len(values), dtype=bool), float(np.ptp(values)), resolution(values)
    if size == 0:
        return rows, math.nan
    runs, noise = _runs(values)
    at, beside = [], 0
    for first, last in runs:
        length = last - first
        level = float(np.median(values[first:last]))
        around = values[max(int(first - BESIDE * length), 0) : int(last + BESIDE * length)]
        topmost = around.max() <= level + max(TOP * size, np.ptp(values[first:last]))
        if (
            topmost
            and level > np.median(values)
            and np.ptp(moved[first:last]) >= LEAST_STEPS
            and _enters_sharply(values, first, last, step)
        ):
            at.append((first, last, level))
        else:
            beside += length
    held = beside > HELD * len(values)
    same = SAME_LEVEL if held else MOVED_LEVEL
    levels = np.array([level for *_, level in at])
    bounds = []
    for k, (first, last, level) in enumerate(at):
        near = np.delete(levels, k) if held else np.delete(levels, k)[max(k - 2, 0) : k + 2]
        alike = int(np.count_nonzero(np.abs(near - level) <= same * size))
        if (last - first >= LONG and not held) or alike >= (AGREE if held else 1):
            rows[first:last] = True
            bounds.append(((first + last) / 2, level))
    if rows.mean() <= LEAST_SHARE:
        return _at_top(values)
    bound = np.interp(np.arange(len(values)), *np.transpose(bounds))
    return rows | (values >= bound - noise), float(np.median(values[rows]))  # shorter runs, too


def _at_top(values: Floats) -> tuple[Booleans, float]:
    """Rows at the largest value, and that value, of a fast vibration, whose runs are too short to be judged by themselves.

    A smooth signal has more rows just below its largest value than at it, and one of few steps is at any value often.
    """
    top, size = float(values.max()), float(np.ptp(values))
    rows = values >= top - 1e-9 * size
    runs = int(np.count_nonzero(np.diff(rows.astype(int), prepend=0) == 1))
    below = int(np.count_nonzero(values > top - TOP * size)) - int(rows.sum())
    cut = runs >= PASSES and rows.sum() >= 2 * runs and below < rows.sum() / 3 and rows.mean() > LEAST_SHARE
    return (rows, top) if cut and len(np.unique(values)) > MOST_VALUES else (np.zeros_like(rows), math.nan)


def _dead(values: Floats, moved: Floats) -> Booleans:
    """Rows (m,) in which `values` are 0 while the joint moves, entered with a bend: a dead zone."""
    rows = np.zeros(len(values), dtype=bool)
    size = float(np.ptp(values))
    inner = [(a, b, float(np.median(values[a:b]))) for a, b in _runs(values)[0] if a > 0 and b < len(values)]
    others = sum(b - a for a, b, level in inner if 1e-6 * size < abs(level) < 0.5 * np.abs(values).max())
    runs = [(a, b) for a, b, level in inner if abs(level) <= 1e-6 * size and np.ptp(moved[a:b]) >= LEAST_STEPS]
    rounded = others > sum(b - a for a, b in runs)
    for first, last in runs if len(runs) >= PASSES and not rounded else ():
        rows[first:last] = True
    return rows
