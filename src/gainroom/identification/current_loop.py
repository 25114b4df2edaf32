"""The current loop as a log shows it: from commands that arrive to the torque that the drive measures.

C = ω_c²/(s² + 2ζω_c s + ω_c²), eq. (3) of Jung et al. 2017. A command that is first seen in row k arrived φ of a tick before it,
0 <= φ <= 1; for commands that took c ticks (rounded up) φ has a mean φ_c and a deviation σ_c, which are fitted, as is the noise: a Kalman
filter predicts the torque row by row (current_loop.hpp). Nothing is approximated between ticks but that φ's deviation is taken to
second order.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError
from ..linear.arrays import Booleans, Floats, Integers
from ..native import _core
from .excited_part import busiest
from .likelihood import maximize

SETTLED = 16.0  # time constants: e^-16 = 1e-7 of a change is left
LONGEST_TAIL = 2000  # ticks of a step response
SPEED, DAMPING = (np.log(1.5), 1.0), (np.log(0.8), 0.25)  # mean and deviation of log ω_c T_s and log ζ: decide only where the log does not
STARTS = 3  # of the rough search
DEVIATION = (np.log(0.02), 2.0)  # of log σ_c
WITHIN = (0.5, 0.5)  # of φ_c
ROUGH_ROWS = 10_000  # of a long log, for the start of the search
UNKNOWN = 3.0  # times the torque's deviation: what is known of the current loop behind a gap
AGES = 2  # ticks to either side of the usual age that a decoded command may have
UNUSUAL = 1.0  # squared errors that one tick from the usual age costs: decides where the command rests


@dataclass(frozen=True)
class Response:
    """Delay D [ticks], ω_c T_s and ζ."""

    delay: float
    speed: float
    damping: float

    def tail(self) -> int:
        """Ticks until a change has settled."""
        slowest = self.speed * (self.damping - np.sqrt(max(self.damping**2 - 1, 0.0)))
        return int(min(np.ceil(max(self.delay, 0.0) + SETTLED / slowest) + 2, LONGEST_TAIL))

    def kernel(self) -> Floats:
        """What a unit change does l ticks later (l,)."""
        return np.where((lags := np.arange(self.tail()) - self.delay) > 0, held(self.speed, self.damping, np.maximum(lags, 0.0))[0], 0.0)


def held(speed: float, damping: float, ticks: Floats | float) -> tuple[Floats, Floats, Floats]:
    """What a unit command does that has been there for `ticks`, any shape: c, ċ/ω_c, c̈/ω_c², by its closed form."""
    root = np.sqrt(complex(damping**2 - 1))
    if abs(root) < 1e-5:
        root = 1e-5 + 0j  # two poles as one: the differences below keep eleven digits
    first, second = -damping + root, -damping - root
    early, late = np.exp(first * speed * ticks), np.exp(second * speed * ticks)
    apart = second - first
    return (
        (1 - (second * early - first * late) / apart).real,
        (-(early - late) / apart).real,
        (-(first * early - second * late) / apart).real,
    )


@dataclass(frozen=True)
class Tick:
    """The current loop over one tick: transition (2, 2) of (τ, τ̇/ω_c), what a command held all the tick does (2,)."""

    transition: Floats
    full: Floats

    @classmethod
    def of(cls, speed: float, damping: float) -> "Tick":
        """Exactly."""
        position, rate, acceleration = (float(value) for value in held(speed, damping, np.ones(1)[0]))
        # c(t) is what a command of 1 does from rest; a state (τ, τ̇/ω) decays as e^{Ft}, whose columns follow from c and its derivatives.
        transition = np.array([[1 - position, rate], [-rate, acceleration]])
        return cls(transition, np.array([position, rate]))


@dataclass(frozen=True)
class Data:
    """Command (m,), measured torque (m,) and where the last `run_length` (m,) rows are without a gap."""

    command: Floats
    torque: Floats
    run_length: Integers

    def part(self, rows: int) -> "Data":
        """So many rows in which the command changes most."""
        if rows >= len(self.command):
            return self
        part = busiest(np.abs(np.diff(self.command, prepend=self.command[0])), rows)
        return Data(self.command[part], self.torque[part], np.minimum(self.run_length[part], np.arange(rows)))

    def usable(self, tail: int) -> Booleans:
        """(m,) rows whose whole past within `tail` ticks is known."""
        return self.run_length >= tail


@dataclass(frozen=True)
class Fit:
    """A fitted current loop.

    response     ω_c T_s and ζ; its delay is that of the mean arrival behind the rows' commands
    places       (q,) φ_c, how long before its row a command arrives [ticks]; by the kind of arrival
    deviations   (q,) σ_c [ticks]
    gain, offset, noise   of the measured torque: gain · τ + offset, and its standard deviation [N m]
    variances    two (p, p) of φ_c (q,), log σ_c (q,), log ω_c, log ζ, gain, offset in units of the torque's deviation: by blocks of time,
                 and by equal predictions, whose rounding errors repeat
    explained    share of the torque's variance
    cost         mean of e²/v + log v
    uneven       mean of e²/v over the tenth of rows where the command changes most, over that of the others; 1 where the fit is right
    """

    speed: float
    damping: float
    places: Floats
    deviations: Floats
    gain: float
    offset: float
    noise: float
    variances: tuple[Floats, Floats]
    explained: float
    cost: float
    uneven: float

    def error(self, direction: Floats) -> float:
        """Standard error of a combination (p,) of the parameters: the larger of both."""
        return float(max(direction @ variance @ direction for variance in self.variances) ** 0.5)


def fit_arrivals(data: Data, changes: Floats, start: Response) -> Fit:
    """Current loop and moments of arrival by maximum likelihood.

    data      its command is what acts at each row: the demand torque, or what `decoded` makes of the target
    changes   (m, q) of the command in each row, by kind of arrival
    start     its delay is minus the first φ
    """
    kinds = changes.shape[1]
    scale = float(np.std(data.torque)) or 1.0
    rough = np.concatenate([np.full(kinds, -start.delay), np.full(kinds, DEVIATION[0])])
    first = np.concatenate([rough, [np.log(start.speed), np.log(start.damping), 1.0, 0.0, np.log(0.02)]])
    mean, deviation = np.array(
        [WITHIN] * kinds + [DEVIATION] * kinds + [SPEED, DAMPING, (1.0, np.inf), (0.0, np.inf), (0.0, np.inf)],
    ).T
    used = (data.run_length >= 5).astype(float)

    def split(point: Floats) -> tuple[Floats, Floats, float, float, float, float, float]:
        speed, damping = np.exp(np.clip(point[2 * kinds : 2 * kinds + 2], [-4, -2.5], [4.5, 2.0]))
        gain, offset, noise = point[2 * kinds + 2], scale * point[2 * kinds + 3], scale * np.exp(np.clip(point[2 * kinds + 4], -16, 3))
        spread = np.exp(np.clip(point[kinds : 2 * kinds], -9, 0.5))
        return point[:kinds], spread, float(speed), float(damping), float(gain), float(offset), float(noise)

    def predict(point: Floats) -> tuple[Floats, Floats]:
        places, spread, speed, damping, gain, offset, noise = split(point)
        tick = Tick.of(speed, damping)
        parts, slope = _parts(speed, damping, places, spread)
        error, variance = np.empty(len(changes)), np.empty(len(changes))
        fresh = data.run_length == 0
        _core.predict_torque(
            *(data.command, changes, data.torque, fresh, tick.transition, tick.full, parts, slope, spread, gain, offset, noise),
            *((UNKNOWN * scale) ** 2, error, variance),
        )
        return error, variance

    found = maximize(predict, first, used, np.stack([mean, 1 / deviation**2]))
    places, spread, speed, damping, gain, offset, noise = split(found.parameters)
    predicted = data.torque - found.errors
    _, clusters = np.unique(np.rint(predicted / (1e-6 * scale)), return_inverse=True)
    variances = found.variance[:-1, :-1], found.variance_by(clusters)[:-1, :-1]
    rows = used > 0
    explained = 1 - float(np.var(found.errors[rows]) / np.var(data.torque[rows]))
    return Fit(
        speed,
        damping,
        places,
        spread,
        gain,
        offset,
        noise,
        variances,
        explained,
        found.cost,
        _uneven(changes, found.errors**2 / found.variances, rows),
    )


def _uneven(changes: Floats, squares: Floats, rows: Booleans) -> float:
    size = np.abs(changes).sum(axis=1)
    size = np.maximum(size, np.concatenate([[0.0], size[:-1]]))[rows]  # and in the row after
    most = size >= np.quantile(size, 0.9)
    return float(np.mean(squares[rows][most]) / max(np.mean(squares[rows][~most]), 1e-300)) if 0 < most.sum() < len(most) else 1.0


def _parts(speed: float, damping: float, places: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """What a change adds one row early, in its row and one row late (3, q, 2), arriving `places` (q,) before its row; its slope (q, 2).

    Between 0 and 1 it does so in its row alone; an estimate of 0 or 1 is free to err to both sides.
    """
    _, rate, acceleration = held(speed, damping, places)
    slope = speed * np.column_stack([rate, acceleration])
    # What is expected of an uncertain moment differs from what comes of its mean by half its variance times the second derivative.
    curvature = speed**2 * np.column_stack([acceleration, -rate - 2 * damping * acceleration])
    early, inside = np.column_stack(held(speed, damping, np.maximum(places - 1, 0.0))[:2]), np.clip(places, 0.0, 1.0)
    whole = np.column_stack(held(speed, damping, inside)[:2])
    late = np.column_stack(held(speed, damping, 1 + np.minimum(places, 0.0))[:2]) - np.column_stack(
        held(speed, damping, np.ones(len(places)))[:2]
    )
    return np.stack([early, whole + 0.5 * spread[:, None] ** 2 * curvature, late]), slope


def rough_response(data: Data, lowest: float, highest: float) -> Response:
    """Least squares with one constant delay between `lowest` and `highest` [ticks], on a part of a long log.

    Raises GainroomError where no row shows what came of a command.
    """
    part = data.part(ROUGH_ROWS)
    found = [_refined(part, start) for start in _starts(part, lowest, highest)]
    return min(found, key=lambda pair: pair[1])[0]


def decoded(data: Data, response: Response, fit: Fit) -> Integers:
    """Ages (m,) [ticks] of the commands that acted, where data.command is the target: the likeliest history under both."""
    usual = int(np.ceil(response.delay - 1e-6))
    first, last = max(usual - AGES, 0), usual + AGES
    tick, (position, rate, _) = Tick.of(response.speed, response.damping), held(response.speed, response.damping, usual - response.delay)
    age = np.zeros(len(data.command), dtype=np.int64)
    part = np.array([float(position), float(rate)])
    _core.decode(data.command, data.torque, tick.transition, tick.full, part, fit.gain, fit.offset, fit.noise, first, last, UNUSUAL, age)
    return age


def _starts(data: Data, lowest: float, highest: float) -> list[Response]:
    """The best of a coarse grid around the lag at which command and torque correlate most, one for each speed."""
    lags = np.arange(max(int(lowest), 0), int(np.ceil(highest)) + 2)
    costs = np.array([_lagged_cost(data, int(lag)) for lag in lags])
    if not np.isfinite(costs).any():
        raise GainroomError("delay: the target torque does not change while the log shows what comes of it")
    best, found = float(lags[int(np.nanargmin(costs))]), []
    for speed in (0.4, 1.0, 2.0, 4.0):
        cases = [
            Response(float(np.clip(best + shift, lowest, highest)), speed, damping)
            for shift in (-5.0, -3.5, -2.5, -1.7, -1.0, -0.3, 0.4)
            for damping in (0.6, 1.0)
        ]
        found.append(min((_linear(data, case)[2], k, case) for k, case in enumerate(cases)))
    return [case for _, _, case in sorted(found)[:STARTS]]


def _lagged_cost(data: Data, lag: int) -> float:
    """What is left of the torque when it is the command `lag` ticks ago, as a share."""
    rows = np.flatnonzero(data.usable(lag))
    x, y = data.command[rows - lag], data.torque[rows]
    x, y = x - x.mean(), y - y.mean()
    power = float(x @ x) * float(y @ y)
    return 1 - float(x @ y) ** 2 / power if power > 0 else np.nan


def _predicted(data: Data, response: Response) -> Floats:
    """Unit response to the command (m,)."""
    kernel = response.kernel()
    taps = np.diff(kernel, prepend=0.0)
    taps[-1] += 1 - kernel[-1]
    return np.convolve(data.command - data.command[0], taps)[: len(data.command)] + data.command[0]


def _linear(data: Data, response: Response) -> tuple[float, float, float, Floats]:
    """Gain, offset, mean square and residual (r,) at a response."""
    rows = data.usable(response.tail())
    if rows.sum() < 20:
        return 1.0, 0.0, np.inf, np.zeros(0)
    columns = np.column_stack([_predicted(data, response)[rows], np.ones(int(rows.sum()))])
    (gain, offset), *_ = np.linalg.lstsq(columns, data.torque[rows], rcond=None)
    rest = data.torque[rows] - columns @ np.array([gain, offset])
    return float(gain), float(offset), float(np.mean(rest**2)), rest


def _refined(data: Data, start: Response) -> tuple[Response, float]:
    """The least-squares response near `start`, and minus twice its log likelihood."""
    from scipy.optimize import least_squares

    rows = data.usable(Response(start.delay + 3, 0.3, 1.0).tail())
    if rows.sum() < 20:
        rows = data.usable(start.tail() + 3)
    noise = max(_linear(data, start)[2], 1e-18) ** 0.5

    def residual(parameters: Floats) -> Floats:
        columns = np.column_stack([_predicted(data, _bounded(parameters)), np.ones(len(data.command))])[rows]
        solution, *_ = np.linalg.lstsq(columns, data.torque[rows], rcond=None)
        prior = [(value - mean) / deviation for value, (mean, deviation) in zip(parameters[1:], (SPEED, DAMPING), strict=True)]
        return np.append((data.torque[rows] - columns @ solution) / noise, prior)

    first = np.array([start.delay, np.log(start.speed), np.log(start.damping)])
    best = least_squares(residual, first, diff_step=1e-5, x_scale=np.full(3, 0.1), max_nfev=30)
    square, prior = noise**2 * float(np.sum(best.fun[:-2] ** 2)), float(np.sum(best.fun[-2:] ** 2))
    return _bounded(best.x), int(rows.sum()) * float(np.log(square / rows.sum())) + prior


def _bounded(parameters: Floats) -> Response:
    return Response(
        float(parameters[0]), float(np.clip(np.exp(parameters[1]), 0.02, 60.0)), float(np.clip(np.exp(parameters[2]), 0.1, 6.0))
    )
