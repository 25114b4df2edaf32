"""The delay of the torque, from target, demand and actual torque: Fig. 6 of Jung et al. 2017, without its ruler.

With the demand logged, the arrival of every command is read to the tick (arrivals.py); the actual torque, through the current loop that is
fitted with it, says when within the tick (current_loop.py). Without the demand both come from the actual torque alone.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GainroomError
from ..linear.arrays import Floats, Integers
from .arrivals import Arrivals, arrivals, arrivals_of_ages
from .current_loop import Data, Fit, Response, decoded, fit_arrivals, rough_response
from .estimate import FREEDOM, Estimate, covariance, interval, log_interval, quantile
from .excited_part import most_excited
from .record import Record

LONGEST = 0.1  # [s] that a delay is looked for
ACTIVE, BEYOND, LIMITED = 0.02, 1.05, 0.02  # of the largest command; of the largest torque; of the rows: overshoot and noise take 0.5 %
SLOW_TICK = 1.25e-3  # [s] between rows from which on the controller may well run faster than its log
LEAST_CHANGES = 8  # of the target
UNKNOWN_TICKS = 0.15  # half-width of the delay's interval: more, and the log does not tell it from the current loop's lag
UNKNOWN_LAG = 0.5  # ticks of half-width: more, and the log tells nothing
DECODINGS = 8
GUESSED_FROM = 0.15  # ticks of deviation
GUESSED = 0.35  # of the jitter's deviation: error of a delay whose arrivals are guessed
FITTED_ROWS = 40_000  # of a long log, the most excited: the delay is then known to a thousandth of a tick
JITTER = 0.35  # ticks: a larger deviation is not a delay's place within one tick
EDGE, NEIGHBOURS = 0.1, 3  # ticks from the ends of its tick at which a delay may belong to the next; how many are compared
JITTERED = 0.05  # ticks of deviation: with less the first search ends at the top
SPEEDS = (1.0, 2.0)  # ω_c T_s from which the search starts again
ALIKE = 2.0  # of minus twice the log likelihood: a log does not tell fits apart that differ by less
DECODED = 1.0  # what decoding must gain per row in squared errors and log variance, as it may choose among histories
FLOOR = 0.004  # ticks: no log is better than its clock, and no current loop is of second order to the last
LOOP_FLOOR = 0.01  # of bandwidth and damping ratio, likewise
WITHIN = 0.25  # of the deviation within a tick: error of a mean whose law is taken to second order
UNEVEN = 2.0  # times the expected error where the target changes most: there is jitter that the fit has not found


@dataclass(frozen=True)
class Jitter:
    """How much the delays of single commands differ.

    deviation     standard deviation [s]; NaN where the log does not say
    ticks, probability   (l,) the law of the delay rounded up to ticks; empty without a demand torque
    """

    deviation: float
    ticks: Integers
    probability: Floats


@dataclass(frozen=True)
class TorqueDelay:
    """What the torques say.

    delay           T, from target to demand torque, mean over commands [s]
    ticks           the same in ticks
    effective       T as a loop feels it: the mean age of the command that acts [s]; shorter where commands overtake each other
    jitter          of single commands
    lag             delay + 2ζ/ω_c, from target to actual torque of a slow command [s]; None without actual torque
    bandwidth       ω_c [rad/s], damping_ratio ζ, gain actual/demand of the current loop; None without actual torque
    told            True where delay and current loop are told apart; False: `delay` is bounded, only `lag` is measured
    sample_time     [s]
    noise           of the actual torque [N m]; None without it
    channels        the torques it rests on
    warnings        what the reader should know
    """

    delay: Estimate
    ticks: Estimate
    effective: Estimate
    jitter: Jitter
    lag: Estimate | None
    bandwidth: Estimate | None
    damping_ratio: Estimate | None
    gain: Estimate | None
    told: bool
    sample_time: float
    noise: float | None
    channels: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def identify_delay(record: Record, longest: float = LONGEST) -> TorqueDelay:
    """Delay, jitter and current loop from target and demand or actual torque, or all three.

    longest   [s] the longest delay that is looked for

    Raises GainroomError where the channels are missing, where the target hardly changes, and where the log does not tell the delay; the
    message says what to record.
    """
    record.need("delay", "target_torque")
    record = most_excited(record, FITTED_ROWS)
    target = record.channels["target_torque"]
    if not record.has("demand_torque") and not record.has("actual_torque"):
        record.need("delay", "demand_torque")
    most = int(np.ceil(longest / record.sample_time))
    changes = int(np.count_nonzero(np.abs(np.diff(target)) > 1e-6 * np.ptp(target)))
    if changes < LEAST_CHANGES:
        raise GainroomError(
            f"delay: target_torque changes {changes} times; at least {LEAST_CHANGES} changes are needed: record torque steps or a multisine"
        )
    seen = arrivals(record, most) if record.has("demand_torque") else None
    warnings = []
    if record.sample_time > SLOW_TICK:
        warnings.append(
            f"rows come every {1e3 * record.sample_time:.3g} ms, and a command is taken as held from row to row: of a controller that runs "
            f"faster the delay is up to {500 * record.sample_time:.3g} ms longer; log every tick"
        )
    if record.has("demand_torque") and seen is None:
        warnings.append("demand_torque is not target_torque some ticks later (filtered, limited or scaled): it is left out")
    if not record.has("actual_torque"):
        if seen is None:
            raise GainroomError("delay: demand_torque does not repeat target_torque, and there is no actual_torque: record actual_torque")
        return _from_demand(record, seen, warnings)
    _require_no_limit(target, record.channels["actual_torque"])
    return _from_actual(record, seen, most, warnings)


def _require_no_limit(target: Floats, actual: Floats) -> None:
    """Raise GainroomError where a torque limit cuts the command: what is left of it does not lag as the command does.

    Sizes are compared, whatever the delay: the largest commands, scaled as the median one is, against the largest torque.
    """
    asked, made = np.abs(target), np.abs(actual)
    active = asked > ACTIVE * asked.max()
    scale = min(float(np.median(made[active]) / np.median(asked[active])), 1.0)  # noise makes small torques larger
    share = float(np.mean(scale * asked > BEYOND * made.max()))
    if share > LIMITED:
        raise GainroomError(
            f"delay: actual_torque stays below {made.max():.4g} N·m while target_torque asks for more in {100 * share:.0f} % of the rows: "
            "a torque limit hides the delay; record smaller torques"
        )


def _from_demand(record: Record, seen: Arrivals, warnings: list[str]) -> TorqueDelay:
    """Whole ticks only: a command that is seen at a tick arrived at any time since the tick before."""
    tick, late = (
        record.sample_time,
        covariance(_arrival_influence(seen, len(record.time), seen.first + np.arange(len(seen.shares)))[:, None])[0, 0] ** 0.5,
    )
    ticks = Estimate(seen.mean - 0.5, seen.mean - 1 - 2 * late, seen.mean + 2 * late)
    age = float(seen.ticks.mean())
    effective = Estimate(age - 0.5, age - 1 - 2 * late, age + 2 * late)
    warning = "demand_torque alone shows arrivals to the tick; actual_torque would show when within the tick"
    jitter = Jitter(seen.deviation * tick, seen.values, seen.probability)
    channels = ("target_torque", "demand_torque")
    return TorqueDelay(
        ticks.scaled(tick), ticks, effective.scaled(tick), jitter, None, None, None, None, False, tick, None, channels, (*warnings, warning)
    )


def _arrival_influence(seen: Arrivals, rows: int, delays: Floats) -> Floats:
    """(m,) of the mean delay, by row; `delays` (q,) by kind [ticks]."""
    influence = np.zeros(rows)
    values = delays[np.clip(seen.ticks - seen.first, 0, len(delays) - 1)]
    influence[seen.row] = (values - values.mean()) / len(values)
    return influence


def _from_actual(record: Record, seen: Arrivals | None, most: int, warnings: list[str]) -> TorqueDelay:
    """The fit of the actual torque; without a demand torque the commands that acted are decoded from it first."""
    target, torque = record.channels["target_torque"], record.channels["actual_torque"]
    if seen is None:
        data = Data(target, torque, record.run_length)
        rough = rough_response(data, 0.0, float(most))
        fit, seen = _without_demand(record, data, rough)
        channels: tuple[str, ...] = ("target_torque", "actual_torque")
    else:
        data = Data(record.channels["demand_torque"], torque, record.run_length)
        fit = _fitted(record, data, seen, rough_response(data, -1.0, 0.0))
        channels = ("target_torque", "demand_torque", "actual_torque")
    return _result(record, seen, fit, channels, warnings)


def _fitted(record: Record, data: Data, seen: Arrivals, start: Response) -> Fit:
    """The likeliest of searches from several moments and speeds: beside a jitter or near a tick's edge the likelihood has several tops."""
    changes = seen.changes(record.channels["target_torque"], data.command)
    found = fit_arrivals(data, changes, start)
    if found.deviations.max() < JITTERED and np.all(np.abs(found.places - 0.5) < 0.5 - EDGE):
        return found
    others = (fit_arrivals(data, changes, replace(start, delay=-0.5, speed=speed)) for speed in SPEEDS)
    return min((found, *others), key=lambda fit: fit.cost)


def _without_demand(record: Record, data: Data, rough: Response) -> tuple[Fit, Arrivals]:
    """One delay for all commands; where its fit finds that they differ, the commands that acted are decoded, and the likelier of both."""
    rows, whole = np.arange(len(data.command)), int(np.ceil(rough.delay - 1e-6))
    tried: dict[int, tuple[Fit, Arrivals]] = {}
    while whole >= 0 and whole not in tried and len(tried) < NEIGHBOURS:
        seen = arrivals_of_ages(record, np.full(len(rows), whole))
        if seen is None:
            raise GainroomError("delay: actual_torque does not show when the target's changes arrive: record torque steps")
        start = Response(rough.delay - whole, rough.speed, rough.damping)
        tried[whole] = fit, _ = _fitted(record, _acting(data, rows - whole), seen, start), seen
        whole += 1 if fit.places[0] < EDGE else -1 if fit.places[0] > 1 - EDGE else 0
    least = min(fit.cost for fit, _ in tried.values())
    alike = [pair for pair in tried.values() if pair[0].cost <= least + ALIKE / len(rows)]
    best = max(alike, key=lambda pair: pair[0].error(np.eye(len(pair[0].variances[0]))[0]))  # of those, the least sure
    fit, seen = single = best
    for _ in range(DECODINGS if fit.deviations[0] > JITTER else 0):
        age = decoded(data, Response(seen.mean - float(seen.shares @ fit.places), fit.speed, fit.damping), fit)
        found = arrivals_of_ages(record, age)
        if found is None:
            break
        start = Response(-0.5, fit.speed, fit.damping)
        fit, seen = _fitted(record, _acting(data, rows - age), found, start), found
        if fit.cost > best[0].cost - 1e-3 and best[0] is not single[0]:
            break
        best = fit, seen
    return best if best[0].cost < single[0].cost - DECODED else single


def _acting(data: Data, rows: Integers) -> Data:
    """The command of those rows, where data.command is the target; behind a gap it is not known until one from behind the gap acts."""
    age = np.arange(len(rows)) - rows
    return Data(data.command[np.maximum(rows, 0)], data.torque, np.maximum(data.run_length - age, 0))


def _result(record: Record, seen: Arrivals, fit: Fit, channels: tuple[str, ...], warnings: list[str]) -> TorqueDelay:
    tick, count = record.sample_time, len(fit.places)
    shares, ticks_of = seen.shares, seen.first + np.arange(count)
    value, age = seen.mean - float(shares @ fit.places), float(seen.ticks.mean()) - float(shares @ fit.places)
    late = covariance(_arrival_influence(seen, len(record.time), ticks_of - fit.places)[:, None])[0, 0] ** 0.5
    towards = np.zeros(2 * count + 4)
    towards[:count] = shares
    spread = ticks_of - fit.places
    deviation = float(np.sqrt(max(shares @ (spread**2 + fit.deviations**2) - (shares @ spread) ** 2, 0.0)))
    # Which command acted when is guessed without a demand torque; guesses repeat themselves, so their errors are not in the covariance.
    guessed = GUESSED * deviation if "demand_torque" not in channels and deviation > GUESSED_FROM else 0.0
    sampled = float(np.hypot(late, FLOOR))
    late = float(np.hypot(late, max(guessed, WITHIN * float(shares @ fit.deviations), FLOOR)))
    error = float(np.hypot(fit.error(towards), late))
    current = 2 * fit.damping / fit.speed
    towards[2 * count : 2 * count + 2] = current, -current
    lag = interval(value + current, float(np.hypot(fit.error(towards), sampled)), FREEDOM)
    _require_told(fit, lag, record)
    # What is certain without any fit: a command arrives in the tick before the demand shows it, and not before it leaves.
    low, high = (seen.mean - 1 - 2 * late, seen.mean + 2 * late) if "demand_torque" in channels else (0.0, max(lag.high, value))
    told = quantile(FREEDOM) * error < UNKNOWN_TICKS and fit.uneven < UNEVEN
    wide = 0.0 if told else np.inf
    ticks, effective = _within(interval(value, error + wide, FREEDOM), low, high), _within(interval(age, error + wide, FREEDOM), low, high)
    if not told:
        warnings.append(
            f"the log does not tell the delay from the current loop's lag: it is between {ticks.low:.3g} and {ticks.high:.3g} ticks; "
            "record torque steps, or a multisine up to a tenth of the tick rate"
        )
    if guessed:
        warnings.append(
            f"the delays of single commands differ by {deviation:.2g} ticks (standard deviation) and no demand_torque says which; "
            "record demand_torque for a sharper delay"
        )
    errors = [fit.error(direction) for direction in np.eye(2 * count + 4)]
    return TorqueDelay(
        delay=ticks.scaled(tick),
        ticks=ticks,
        effective=effective.scaled(tick),
        jitter=Jitter(deviation * tick, seen.values, seen.probability),
        lag=lag.scaled(tick),
        bandwidth=log_interval(fit.speed / tick, math.hypot(errors[2 * count], LOOP_FLOOR), FREEDOM),
        damping_ratio=log_interval(fit.damping, math.hypot(errors[2 * count + 1], LOOP_FLOOR), FREEDOM),
        gain=interval(fit.gain, errors[2 * count + 2], FREEDOM),
        told=told,
        sample_time=tick,
        noise=fit.noise,
        channels=channels,
        warnings=tuple(warnings),
    )


def _within(estimate: Estimate, low: float, high: float) -> Estimate:
    """`estimate` where it is known to lie between two bounds."""
    value, lower, upper = np.clip([estimate.value, estimate.low, estimate.high], low, high).tolist()
    if not lower < upper:  # they contradict each other: what is certain stands
        lower, upper = low, high
    return Estimate(value, lower, upper, estimate.standard_error)


def _require_told(fit: Fit, lag: Estimate, record: Record) -> None:
    """Raise GainroomError where the fit does not determine the delay."""
    if fit.explained < 0.5:
        raise GainroomError(
            f"delay: a delay and a current loop explain {100 * max(fit.explained, 0):.0f} % of actual_torque's variance, less than half: "
            "look at signs, units and joint of the columns"
        )
    if not lag.half_width < UNKNOWN_LAG:
        raise GainroomError(
            f"delay: the log tells it to ± {lag.half_width:.2g} ticks only; record torque steps or a multisine with frequencies up to a "
            f"tenth of the tick rate, {0.1 / record.sample_time:.4g} Hz"
        )
