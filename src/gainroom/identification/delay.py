"""Delay of the torque, from target, demand and actual torque: Fig. 6 of Jung et al. 2017, without a ruler.

With the demand logged, the arrival of every command is read to the tick (arrivals.py); the actual torque, through the current loop that is
fitted with it, says when within the tick (arrival_law.py, arrival_fit.py), and what else it allows (allowed_delays.py). Without the demand
both come from the actual torque alone.

How sharp that is has a bound. Of 200 virtual joints' logs with 1 % of torque noise the Cramér-Rao bound of the delay's standard error,
beside an unknown current loop, is above 0.05 ticks in 63: excitation that is slow beside the current loop shows the sum of delay and lag,
and no unbiased estimator tells the delay there to 0.1 ticks. Such logs are `confounded`, and their intervals say how far it may be off.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Booleans, Floats, Integers
from .allowed_delays import UNLIKELY, Allowed, allowed_delays, gaussian, spread_over
from .arrival_fit import ArrivalLikelihood, Fit, decoded
from .arrival_law import Phase, Spread, Unseen, acting
from .arrivals import Arrivals, arrivals, arrivals_of_ages
from .current_loop import DAMPING, Data, Response, rough_response
from .estimate import FREEDOM, Estimate, covariance, interval, log_interval, quantile
from .excited_part import most_excited
from .fast_loop import FAST, FastLoop, fast_loop
from .record import Record, slow_rows

LONGEST = 0.1  # [s] that a delay is looked for
ACTIVE, BEYOND, LIMITED = 0.02, 1.05, 0.02  # of the largest command; of the largest torque; of the rows: overshoot and noise take 0.5 %
LEAST_CHANGES = 8  # of the target
UNKNOWN_TICKS = 0.15  # half-width of the delay's interval: more, and the log does not tell it from the current loop's lag
WHOLE_TICK = 1.5  # ticks between the ends of a delay that a fast loop hides: more, and it is slow excitation that does
UNKNOWN_LAG = 0.5  # ticks of half-width: more, and the log tells nothing
DECODINGS = 8
SETTLED = 3  # rows behind a gap before errors count: the current loop's state is unknown there
GUESSED = 0.35  # of the jitter's deviation: error of a delay whose arrivals are guessed
FITTED_ROWS = 40_000  # of a long log, the most excited: the delay is then known to a thousandth of a tick
SHARP, EDGE = 0.04, 0.1  # ticks: a fit that tells the delay to half of this, and is not this near a tick's edge, has no other beside it
JITTER = 0.25  # ticks: with a larger deviation commands may overtake each other, which the law without a demand torque does not know
SPEEDS = (1.0, 2.0)  # ω_c T_s from which the search starts again
DECODED = 1.0  # what decoding must gain per row in squared errors and log variance, as it may choose among histories
RARE = 0.01  # probability of a delay below which it does not count in the range of delays
FLOOR = 0.004  # ticks: no log is better than its clock, and no current loop is of second order to the last
LOOP_FLOOR = 0.01  # of bandwidth and damping ratio, likewise
WITHIN = 0.25  # of the deviation within a tick: error of a mean whose law is not even
STRANGE = 4.0  # deviations of the damping ratio from the usual: such a loop makes up for something else
UNEVEN = 2.0  # times the expected error where the target changes most: there is jitter that the fit has not found


@dataclass(frozen=True)
class Jitter:
    """Spread of the delays of single commands.

    deviation     standard deviation [s]; NaN where the log does not say
    ticks, probability   (l,) the law of the delay rounded up to ticks; empty without a demand torque
    """

    deviation: float
    ticks: Integers
    probability: Floats


@dataclass(frozen=True)
class TorqueDelay:
    """Delay and current loop identified from the torques.

    delay           T, from target to demand torque, mean over commands [s]
    ticks           the same in ticks
    effective       T as a loop feels it: the mean age of the command that acts [s]; shorter where commands overtake each other
    jitter          of single commands
    lag             delay + 2ζ/ω_c, from target to actual torque of a slow command [s]; None without actual torque
    bandwidth       ω_c [rad/s], damping_ratio ζ, gain actual/demand of the current loop; None without actual torque
    confounded      the log does not tell delay and current loop apart: `delay` is bounded, only `lag` is measured
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
    confounded: bool
    sample_time: float
    noise: float | None
    channels: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    @property
    def jitter_width(self) -> float:
        """Width of the range of the delays of single commands [s], as `drive.jitter_ms` has it; NaN where the log does not say.

        That of an even law with the same deviation, or from the first to the last tick that is not RARE, whichever is wider.
        """
        law = self.jitter
        usual = law.ticks[law.probability >= RARE]
        return max(math.sqrt(12) * law.deviation, self.sample_time * float(np.ptp(usual)) if len(usual) else 0.0)


def identify_delay(record: Record, longest: float = LONGEST) -> TorqueDelay:
    """Delay, jitter and current loop from target and demand or actual torque, or all three.

    longest   [s] the longest delay that is looked for

    Raises GainroomError where the channels are missing, where the target hardly changes, and where the log does not tell the delay; the
    message says what to record.
    """
    record.need("delay", "target_torque")
    record = most_excited(record, FITTED_ROWS)
    target = record.channels["target_torque"]
    record.first_of("delay", "demand_torque", "actual_torque")
    most = int(np.ceil(longest / record.sample_time))
    changes = int(np.count_nonzero(np.abs(np.diff(target)) > 1e-6 * np.ptp(target)))
    if changes < LEAST_CHANGES:
        raise GainroomError(
            f"delay: target_torque changes {changes} times; at least {LEAST_CHANGES} changes are needed: record torque steps or a multisine"
        )
    seen = arrivals(record, most) if record.has("demand_torque") else None
    late = f"of a controller that runs faster the delay is up to {500 * record.sample_time:.3g} ms longer"
    warnings = slow_rows(record.sample_time, f"a command is taken as held from row to row: {late}")
    if record.has("demand_torque") and seen is None:
        warnings.append("demand_torque is not target_torque some ticks later (filtered, limited or scaled): it is left out")
    if not record.has("actual_torque"):
        if seen is None:
            raise GainroomError("delay: demand_torque does not repeat target_torque, and there is no actual_torque: record actual_torque")
        return _from_demand(record, seen, warnings)
    _require_no_limit(target, record.channels["actual_torque"])
    try:
        return _from_actual(record, seen, most, warnings)
    except np.linalg.LinAlgError as error:
        raise GainroomError(
            "delay: no delay and current loop make actual_torque of target_torque: look for a limit on the torque or on its rate, and at "
            "signs, units and joint of the columns"
        ) from error


def _require_no_limit(target: Floats, actual: Floats) -> None:
    """Raise GainroomError if a torque limit cuts the command: the remaining torque does not lag as the command does.

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
    """Delay to whole ticks: a command that is seen at a tick arrived at any time since the tick before."""
    tick, late = record.sample_time, _arrival_error(seen, len(record.time))
    ticks = Estimate(seen.mean - 0.5, seen.mean - 1 - 2 * late, seen.mean + 2 * late)
    age = float(seen.ticks.mean())
    effective = Estimate(age - 0.5, age - 1 - 2 * late, age + 2 * late)
    warning = "demand_torque alone shows arrivals to the tick; actual_torque would show when within the tick"
    jitter = Jitter(seen.deviation * tick, seen.values, seen.probability)
    channels = ("target_torque", "demand_torque")
    return TorqueDelay(
        ticks.scaled(tick), ticks, effective.scaled(tick), jitter, None, None, None, None, True, tick, None, channels, (*warnings, warning)
    )


def _arrival_error(seen: Arrivals, rows: int) -> float:
    """Standard error of the mean delay [ticks] of a log of so many rows."""
    delays = seen.first + np.arange(len(seen.shares))
    influence = np.zeros(rows)
    values = delays[np.clip(seen.ticks - seen.first, 0, len(delays) - 1)]
    influence[seen.row] = (values - values.mean()) / len(values)
    return covariance(influence[:, None])[0, 0] ** 0.5


def _from_actual(record: Record, seen: Arrivals | None, most: int, warnings: list[str]) -> TorqueDelay:
    """Delay from the actual torque; without a demand torque, commands that overtake each other are decoded from it."""
    target, torque = record.channels["target_torque"], record.channels["actual_torque"]
    if seen is None:
        fits = _without_demand(record, Data(target, torque, record.run_length), most)
        return _result(record, fits, ("target_torque", "actual_torque"), warnings)
    data = Data(record.channels["demand_torque"], torque, record.run_length)
    fits = _with_arrivals(record, seen, data)
    return _result(record, fits, ("target_torque", "demand_torque", "actual_torque"), warnings)


@dataclass(frozen=True)
class _Found:
    """Likeliest fit under a law, the other delays allowed under it if the fit is not sharp, and the arrivals behind it."""

    fit: Fit
    allowed: Allowed | None
    likelihood: ArrivalLikelihood
    seen: Arrivals | None = None

    def fast(self) -> FastLoop | None:
        """Delays allowed for a current loop of any speed; None if they do not exceed the fit's interval."""
        sharp = self.allowed is None
        return None if sharp and self.fit.speed < FAST else fast_loop(self.likelihood, self.fit, sharp)


def _with_arrivals(record: Record, seen: Arrivals, data: Data, used: Booleans | None = None) -> list[_Found]:
    """Fits under each law for arrivals that are known to the tick; data.command is the command that acts."""
    target, rough = record.channels["target_torque"], rough_response(data, -1.0, 0.0)
    start = replace(rough, delay=seen.mean + rough.delay)
    used = data.run_length >= SETTLED if used is None else used
    phase = _fitted(ArrivalLikelihood(data, Phase(seen, target, data), used), start, seen)
    if len(seen.shares) == 1:
        return [phase]
    law = Spread(seen, target, data)
    spread = _fitted(ArrivalLikelihood(data, law, used), start, seen)
    low, high = law.bounds
    return [phase, spread] if low <= spread.fit.point[0] <= high else [phase]


def _fitted(likelihood: ArrivalLikelihood, start: Response, seen: Arrivals | None = None) -> _Found:
    """Likeliest result of searches from several speeds with equal lag; and, if it is not sharp, the other likely delays."""
    best = likelihood.best(start)
    if quantile(FREEDOM) * best.error(best.slopes[0]) < SHARP and abs(best.means[0] - np.rint(best.means[0])) > EDGE:
        return _Found(best, None, likelihood, seen)
    lag = start.delay + 2 * start.damping / start.speed
    others = [likelihood.best(Response(lag - 2 * start.damping / speed, speed, start.damping)) for speed in SPEEDS]
    tops = [best, *others]
    best = min(tops, key=lambda fit: fit.cost)
    return _Found(best, allowed_delays(likelihood, tops), likelihood, seen)


def _without_demand(record: Record, data: Data, most: int) -> list[_Found]:
    """Fits of one law for all commands; if commands overtake each other, those that acted are decoded, if that is likelier."""
    rough = rough_response(data, 0.0, float(most))
    used = data.run_length >= SETTLED + int(np.ceil(max(rough.delay, 0.0)))
    single = best = [_fitted(ArrivalLikelihood(data, Unseen(data), used), rough)]
    fit = single[0].fit
    for _ in range(DECODINGS if fit.means[2] > JITTER else 0):
        age = decoded(data, best[0].fit)
        seen = arrivals_of_ages(record, age)
        if seen is None:
            break
        acted = acting(data, np.arange(len(age)) - age)
        found = sorted(_with_arrivals(record, seen, acted, used), key=lambda each: each.fit.cost)
        if found[0].fit.cost > best[0].fit.cost - 1e-3 * len(age) and best is not single:
            break
        best = found
    return best if best[0].fit.cost < fit.cost - DECODED * len(record.time) else single


def _result(record: Record, fits: list[_Found], channels: tuple[str, ...], warnings: list[str]) -> TorqueDelay:
    tick = record.sample_time
    found = min(fits, key=lambda each: each.fit.evidence)
    fit, seen = found.fit, found.seen
    late = 0.0 if seen is None else _arrival_error(seen, len(record.time))
    deviation = float(fit.means[2])
    # Without a demand torque the command that acted is guessed; guesses repeat themselves, so their errors are not in the covariance.
    guessed = GUESSED * deviation if "demand_torque" not in channels and seen is not None else 0.0
    sampled = float(np.hypot(late, FLOOR))
    late = float(np.hypot(late, max(guessed, WITHIN * float(fit.means[3]), FLOOR)))
    current = 2 * fit.damping / fit.speed
    towards = np.array(fit.slopes[0])
    towards[2:4] += -current, current
    lag = interval(float(fit.means[0]) + current, float(np.hypot(fit.error(towards), sampled)), FREEDOM)
    alike = [each for each in fits if each.fit.evidence < fit.evidence + UNLIKELY]
    fast = [each for each in (other.fast() for other in alike) if each is not None]
    any_speed = any(math.isinf(each.speeds[1]) for each in fast)
    _require_determined(fit, None if any_speed else lag, record)
    # Bounds that are certain without any fit: a command arrives in the tick before the demand shows it, and not before it leaves.
    certain = seen is not None and "demand_torque" in channels
    low, high = (seen.mean - 1 - 2 * late, seen.mean + 2 * late) if certain and seen is not None else (0.0, max(lag.high, fit.means[0]))
    if fast:
        lag, high = _lag_of_fast(lag, fast, sampled), max([high, *(each.high[0] + 2 * late for each in fast)])
    ticks, effective = (_within(_of_fast(fast, k, late) if fast else _over_laws(alike, k, late), low, high) for k in (0, 1))
    strange = abs(math.log(fit.damping) - DAMPING[0]) > STRANGE * DAMPING[1]
    wrong = min([fit.uneven, *(each.uneven for each in fast)]) >= UNEVEN or strange or (seen is None and deviation > JITTER)
    confounded = not (ticks.half_width < UNKNOWN_TICKS and not wrong)
    if wrong or (ticks.half_width > UNKNOWN_LAG and not any_speed):  # what is left would rest on how fast current loops usually are
        ticks, effective = (Estimate(each.value, low, high, np.inf) for each in (ticks, effective))
    if any_speed and ticks.high - ticks.low < WHOLE_TICK:
        warnings.append(
            f"the current loop may be faster than the log's rows show: every delay from {ticks.low:.3g} to {ticks.high:.3g} ticks makes "
            "the same torques; take the longest, or log more often than once per tick"
        )
    elif confounded:
        warnings.append(
            f"the log does not tell the delay from the current loop's lag: it is between {ticks.low:.3g} and {ticks.high:.3g} ticks; "
            "record torque steps, or a multisine up to a tenth of the tick rate"
        )
    errors = [fit.error(direction) for direction in np.eye(6)]
    speeds = _speeds(fit, errors[2], fast)
    if guessed:
        warnings.append(
            f"the delays of single commands differ by {deviation:.2g} ticks (standard deviation) and no demand_torque says which; "
            "record demand_torque for a sharper delay"
        )
    return TorqueDelay(
        delay=ticks.scaled(tick),
        ticks=ticks,
        effective=effective.scaled(tick),
        jitter=Jitter(
            deviation * tick, *((seen.values, seen.probability) if seen is not None else (np.zeros(0, dtype=np.int64), np.zeros(0)))
        ),
        lag=lag.scaled(tick),
        bandwidth=speeds.scaled(1 / tick),
        damping_ratio=log_interval(fit.damping, math.hypot(errors[3], LOOP_FLOOR), FREEDOM),
        gain=interval(fit.gain, errors[4], FREEDOM),
        confounded=confounded,
        sample_time=tick,
        noise=fit.noise,
        channels=channels,
        warnings=tuple(warnings),
    )


def _speeds(fit: Fit, error: float, fast: list[FastLoop]) -> Estimate:
    """Estimate of ω_c T_s; high is inf if the log does not bound it."""
    usual = log_interval(fit.speed, math.hypot(error, LOOP_FLOOR), FREEDOM)
    if not fast:
        return usual
    low, high = min(usual.low, *(each.speeds[0] for each in fast)), max(usual.high, *(each.speeds[1] for each in fast))
    return Estimate(usual.value, low, high, usual.standard_error)


def _of_fast(fast: list[FastLoop], which: int, late: float) -> Estimate:
    """Estimate of one of Fit.means, over all delays that the laws allow for any current loop."""
    low, high = min(each.low[which] for each in fast) - 2 * late, max(each.high[which] for each in fast) + 2 * late
    return Estimate(float(np.mean([each.mean[which] for each in fast])), low, high, (high - low) / 2 / quantile(FREEDOM))


def _lag_of_fast(lag: Estimate, fast: list[FastLoop], late: float) -> Estimate:
    low, high = min(each.lag[0] for each in fast) - 2 * late, max(each.lag[1] for each in fast) + 2 * late
    return Estimate(float(np.clip(lag.value, low, high)), low, high, lag.standard_error)


def _over_laws(alike: list[_Found], which: int, late: float) -> Estimate:
    """Estimate of one of Fit.means: of the likeliest law if its fit is sharp, else over all delays that the laws allow."""
    best = min(alike, key=lambda each: each.fit.evidence)
    if len(alike) == 1 and best.allowed is None:
        return interval(float(best.fit.means[which]), float(np.hypot(best.fit.error(best.fit.slopes[which]), late)), FREEDOM)
    allowed = [each.allowed or gaussian(each.fit) for each in alike]
    value, low, high = spread_over(allowed, which, late)
    return Estimate(value, low, high, (high - low) / 2 / quantile(FREEDOM))


def _within(estimate: Estimate, low: float, high: float) -> Estimate:
    """Estimate restricted to known bounds."""
    value, lower, upper = np.clip([estimate.value, estimate.low, estimate.high], low, high).tolist()
    if not lower < upper:  # they contradict each other: what is certain stands
        lower, upper = low, high
    return Estimate(value, lower, upper, estimate.standard_error)


def _require_determined(fit: Fit, lag: Estimate | None, record: Record) -> None:
    """Raise GainroomError where the fit does not determine the delay."""
    if fit.explained < 0.5:
        raise GainroomError(
            f"delay: a delay and a current loop explain {100 * max(fit.explained, 0):.0f} % of actual_torque's variance, less than half: "
            "look at signs, units and joint of the columns"
        )
    if lag is not None and not lag.half_width < UNKNOWN_LAG:
        raise GainroomError(
            f"delay: the log tells it to ± {lag.half_width:.2g} ticks only; record torque steps or a multisine with frequencies up to a "
            f"tenth of the tick rate, {0.1 / record.sample_time:.4g} Hz"
        )
