"""Arrivals of commands, from the demand torque, which is the newest target that has reached the drive.

Command j leaves at tick j and would arrive D_j ticks later; the drive follows the newest that is there, so what is seen of command j is
X_j = min_i (D_{j+i} + i): a later command that comes first takes its place. With independent delays the survival functions obey
S_X(x) = Π_i S_D(x − i), hence S_D(x) = S_X(x)/S_X(x − 1). The demand is logged once a tick, so D and X are seen rounded up.
"""

from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Booleans, Floats, Integers
from .record import Record

LEAST_MATCHED = 0.8  # of the demand's changes: with fewer, the demand is not the target some ticks later
LEAST_ARRIVALS = 5
COMMON = 0.003  # of the arrivals: rarer ones join the next kind
RARE = 0.005  # of the arrivals: later ones are repeated values taken for each other, and their ratio of survivals is noise


@dataclass(frozen=True)
class Arrivals:
    """Delays of single commands, from the target torque to the demand torque.

    row       (e,) rows in which the target changes
    ticks     (e,) observed delays X, rounded up: rows until the demand shows that change, or a newer one
    values, probability   (l,) distribution of the delay D that a command would have if no later one overtook it, rounded up [ticks]
    """

    row: Integers
    ticks: Integers
    values: Integers
    probability: Floats

    @property
    def first(self) -> int:
        """Delay [ticks] of the first kind of arrival; each further kind is one tick later; rare delays count with the nearest kind."""
        return int(self._common[0])

    @property
    def shares(self) -> Floats:
        """Shares (q,) of D, by kind."""
        first, last = self._common
        shares = np.zeros(last - first + 1)
        np.add.at(shares, np.clip(self.values, first, last) - first, self.probability)
        return shares

    @property
    def _common(self) -> tuple[int, int]:
        first = last = int(np.argmax(self.probability))
        while first > 0 and self.probability[first - 1] >= COMMON:
            first -= 1
        while last + 1 < len(self.probability) and self.probability[last + 1] >= COMMON:
            last += 1
        return int(self.values[first]), int(self.values[last])

    def changes(self, target: Floats, command: Floats) -> Floats:
        """Changes (m, q) of the `command` (m,) that acts in each row, by kind of arrival; `target` (m,) decides the share of each."""
        first, count = self.first, len(self.shares)
        changes = np.zeros((len(command), count))
        np.add.at(changes, (self.row + self.ticks, np.clip(self.ticks - first, 0, count - 1)), np.diff(target)[self.row - 1])
        changes[:, int(np.argmax(self.shares))] += np.diff(command, prepend=command[0]) - changes.sum(axis=1)
        return changes

    @property
    def mean(self) -> float:
        """Mean of D rounded up [ticks]."""
        return float(self.values @ self.probability)

    @property
    def deviation(self) -> float:
        """Standard deviation of D rounded up [ticks]."""
        return float(np.sqrt(self.probability @ (self.values - self.mean) ** 2))


def arrivals(record: Record, longest: int) -> Arrivals | None:
    """Arrivals of the target's changes in the demand, up to `longest` ticks late; None if the demand does not repeat the target."""
    target, demand = record.channels["target_torque"], record.channels["demand_torque"]
    tolerance = 1e-6 * float(np.ptp(target)) + 1e-12
    starts = _changes(target, tolerance) & ~record.fresh
    shows = np.flatnonzero(_changes(demand, tolerance) & (record.run_length > longest))
    if len(shows) < LEAST_ARRIVALS or not starts.any():
        return None
    newest = _newest(target, demand, starts, shows, longest, tolerance)
    found = newest >= 0
    if found.mean() < LEAST_MATCHED or found.sum() < LEAST_ARRIVALS:
        return None
    return _collected(record, starts, shows[found], newest[found], longest)


def arrivals_of_ages(record: Record, age: Integers) -> Arrivals | None:
    """Arrivals from the age (m,) [ticks] of the command that acts in each row; None if too few changes arrive."""
    target = record.channels["target_torque"]
    starts = _changes(target, 1e-6 * float(np.ptp(target)) + 1e-12) & ~record.fresh
    newest = np.maximum(np.arange(len(age)) - age, 0)
    # A command that is the target's last change or a repetition of it: both show that change.
    last_change = np.maximum.accumulate(np.where(starts, np.arange(len(age)), -1))[newest]
    longest = int(age.max())
    shows = np.flatnonzero((np.diff(last_change, prepend=-1) != 0) & (last_change >= 0) & (record.run_length > longest))
    if len(shows) < LEAST_ARRIVALS:
        return None
    return _collected(record, starts, shows, last_change[shows], longest)


def _collected(record: Record, starts: Booleans, shows: Integers, newest: Integers, longest: int) -> Arrivals | None:
    """Arrivals from rows in which the demand shows the target's change of row `newest`."""
    newest = np.maximum.accumulate(newest)
    leaving = np.flatnonzero(starts & (record.run_length > longest))  # what arrived sooner was not looked at
    place = np.searchsorted(newest, leaving)  # the first change of the demand that shows this command or a newer one
    seen = place < len(newest)
    leaving, place = leaving[seen], place[seen]
    ticks = shows[place] - leaving
    fits = (ticks <= longest) & (record.ticks[shows[place]] - record.ticks[leaving] == ticks)
    if fits.sum() < LEAST_ARRIVALS:
        return None
    leaving, ticks = leaving[fits], ticks[fits]
    values, probability = _without_overtaking(ticks)
    return Arrivals(leaving, ticks, values, probability)


def _changes(values: Floats, tolerance: float) -> Booleans:
    return np.concatenate([[False], np.abs(np.diff(values)) > tolerance])


def _newest(target: Floats, demand: Floats, starts: Booleans, shows: Integers, longest: int, tolerance: float) -> Integers:
    """Row of the change of the target that the demand shows in each row of `shows`; −1 if none fits.

    Where several fit, as in a target that repeats itself, it is the one whose lag fits most often, and of those the shortest.
    """
    lags = range(min(longest, int(shows[-1])) + 1)
    seen = demand[shows]

    def fits(lag: int) -> Booleans:
        places = np.maximum(shows - lag, 0)
        return (shows >= lag) & starts[places] & (np.abs(seen - target[places]) <= tolerance)

    count = np.zeros(len(shows), dtype=int)
    for lag in lags:
        count += fits(lag)
    single = count == 1
    voters = single if single.any() else np.ones(len(shows), dtype=bool)
    votes = np.array([np.count_nonzero(fits(lag) & voters) for lag in lags])
    usual = float(np.average(lags, weights=votes)) if single.any() else float(np.argmax(votes >= 0.2 * votes.max()))
    newest, found = np.full(len(shows), -1), np.zeros(len(shows), dtype=bool)
    for lag in sorted(lags, key=lambda lag: abs(lag - usual)):
        new = fits(lag) & ~found
        newest[new], found = shows[new] - lag, found | new
    return newest


def _without_overtaking(ticks: Integers) -> tuple[Integers, Floats]:
    """Values (q,) [ticks] and probabilities of D, from observed `ticks` X (e,), by S_D(x) = S_X(x)/S_X(x − 1) of the module."""
    values = np.arange(ticks.min(), ticks.max() + 1)
    survival = np.array([np.mean(ticks > value) for value in values])
    before = np.concatenate([[1.0], survival[:-1]])
    alone = np.where(survival > max(RARE, 2 / len(ticks)), survival / np.maximum(before, RARE), 0.0)
    alone = np.minimum.accumulate(alone)
    return values, -np.diff(np.concatenate([[1.0], alone]))
