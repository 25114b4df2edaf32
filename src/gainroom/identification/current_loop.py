"""Current loop in a log: from commands that arrive to the torque that the drive measures.

C = ω_c²/(s² + 2ζω_c s + ω_c²), eq. (3) of Jung et al. 2017. Here are its closed form, and a rough fit with one delay for all commands;
when within their ticks commands arrive is fitted from there on (arrival_law.py, arrival_fit.py).
"""

from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Booleans, Floats, Integers
from .excited_part import busiest

SETTLED = 16.0  # time constants: e^-16 = 1e-7 of a change is left
LONGEST_TAIL = 2000  # ticks of a step response
SPEED, DAMPING = (np.log(1.5), 1.0), (np.log(0.8), 0.25)  # mean and deviation of log ω_c T_s and log ζ: decide only where the log does not
STARTS = 3  # of the rough search
ROUGH_ROWS = 10_000  # of a long log, for the start of the search


@dataclass(frozen=True)
class Response:
    """Response of a current loop: delay D [ticks], ω_c T_s and ζ."""

    delay: float
    speed: float
    damping: float

    def tail(self) -> int:
        """Number of ticks until a change has settled."""
        slowest = self.speed * (self.damping - np.sqrt(max(self.damping**2 - 1, 0.0)))
        return int(min(np.ceil(max(self.delay, 0.0) + SETTLED / slowest) + 2, LONGEST_TAIL))

    def kernel(self) -> Floats:
        """Response l ticks after a unit change (l,)."""
        return np.where((lags := np.arange(self.tail()) - self.delay) > 0, held(self.speed, self.damping, np.maximum(lags, 0.0))[0], 0.0)


def held(speed: float, damping: float, ticks: Floats | float) -> tuple[Floats, Floats, Floats]:
    """Response to a unit command after `ticks`, any shape: c, ċ/ω_c, c̈/ω_c², in closed form."""
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
class Data:
    """Command (m,), measured torque (m,), and number (m,) of rows since the last gap, `run_length`."""

    command: Floats
    torque: Floats
    run_length: Integers

    def part(self, rows: int) -> "Data":
        """Part of `rows` rows in which the command changes most."""
        if rows >= len(self.command):
            return self
        part = busiest(np.abs(np.diff(self.command, prepend=self.command[0])), rows)
        return Data(self.command[part], self.torque[part], np.minimum(self.run_length[part], np.arange(rows)))

    def usable(self, tail: int) -> Booleans:
        """Rows (m,) whose whole past within `tail` ticks is known."""
        return self.run_length >= tail


def rough_response(data: Data, lowest: float, highest: float) -> Response:
    """Least-squares response with one constant delay between `lowest` and `highest` [ticks], on a part of a long log.

    Raises GainroomError where no row shows what came of a command.
    """
    part = data.part(ROUGH_ROWS)
    found = [_refined(part, start) for start in _starts(part, lowest, highest)]
    return min(found, key=lambda pair: pair[1])[0]


def _starts(data: Data, lowest: float, highest: float) -> list[Response]:
    """Best points of a coarse grid around the lag with the largest correlation of command and torque, one for each speed."""
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
    """Share of the torque's power that the command `lag` ticks before does not explain."""
    rows = np.flatnonzero(data.usable(lag))
    x, y = data.command[rows - lag], data.torque[rows]
    x, y = x - x.mean(), y - y.mean()
    power = float(x @ x) * float(y @ y)
    return 1 - float(x @ y) ** 2 / power if power > 0 else np.nan


def _predicted(data: Data, response: Response) -> Floats:
    """Unit-gain response to the command (m,)."""
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
