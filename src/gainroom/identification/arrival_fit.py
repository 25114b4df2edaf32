"""Maximum-likelihood fit of the current loop and of the moments at which commands arrive."""

from copy import copy
from dataclasses import dataclass

import numpy as np

from ..native import _core
from ..system.linear.arrays import Booleans, Floats, Integers
from .arrival_law import STILL, Law
from .current_loop import DAMPING, SPEED, Data, Response, held
from .likelihood import MOST_ITERATIONS, maximize

UNKNOWN = 3.0  # times the torque's deviation: what is known of the current loop behind a gap
AGES = 2  # ticks to either side of the usual age that a decoded command may have
UNUSUAL = 1.0  # squared errors that one tick from the usual age costs: decides where the command rests
PINNED, PINNED_STEPS = 1e12, 6
FASTEST = 10.0  # radians per tick, of a current loop that a search starts from
QUIETEST, LAW = -16.0, 1e-3  # log of the least noise over the torque's deviation; and what no law of a current loop is better than
MOVED = 1e-5  # of the law's parameters, for differences


@dataclass(frozen=True)
class Fit:
    """Fitted current loop.

    point        (7,) parameters
    means        (4,) mean of D, mean age of the command that comes to act, deviations of D [ticks]; see Law.means
    slopes       (4, p) of them by the parameters
    speed, damping   ω_c T_s and ζ
    gain, offset, noise   of the measured torque: gain · τ + offset, and its standard deviation [N m]
    variances    two (p, p) of the law's parameters (2,), log ω_c, log ζ, gain, offset in units of the torque's deviation: by blocks of
                 time, and by equal predictions, whose rounding errors repeat
    sharp        (p, p) the same where the noise is as the model has it
    explained    share of the torque's variance
    cost         minus twice the log likelihood
    evidence     the cost where all parameters but the law's first are not chosen but summed over (Laplace's approximation)
    uneven       mean of e²/v over the tenth of rows where the command changes most, over that of the others or over 1, whichever is more
    """

    point: Floats
    means: Floats
    slopes: Floats
    speed: float
    damping: float
    gain: float
    offset: float
    noise: float
    variances: tuple[Floats, Floats]
    sharp: Floats
    explained: float
    cost: float
    evidence: float
    uneven: float

    def error(self, direction: Floats) -> float:
        """Standard error of a combination (p,) of the parameters: the larger of the two estimates."""
        return float(max(direction @ variance @ direction for variance in self.variances) ** 0.5)


class ArrivalLikelihood:
    """Likelihood of the measured torque under one law of arrivals.

    Parameters (7,): the law's two, log ω_c T_s, log ζ, gain, offset and log noise.
    """

    def __init__(self, data: Data, law: Law, used: Booleans) -> None:
        """Likelihood of `data`, the measured torque, under `law`, the commands; rows `used` (m,) count, equal for all compared fits."""
        self.data, self.law, self.used = data, law, used
        self.scale, self.quietest = float(np.std(data.torque)) or 1.0, QUIETEST
        mean, deviation = np.array([SPEED, DAMPING, (1.0, np.inf), (0.0, np.inf), (0.0, np.inf)]).T
        self.prior = np.hstack([law.prior, np.stack([mean, 1 / deviation**2])])

    def of_any_speed(self, error: float = 0.0) -> "ArrivalLikelihood":
        """Likelihood without prior knowledge of speeds and jitter, for delays that only such knowledge would distinguish.

        error   of the law, over the torque's deviation
        """
        free = copy(self)
        free.law = copy(self.law)
        free.law.stillest = STILL
        free.prior, free.quietest = self.prior.copy(), float(np.log(error)) if error else QUIETEST
        free.prior[1, 1:3] = 0.0
        return free

    def uneven(self, point: Floats) -> float:
        """Unevenness at `point`, as Fit.uneven."""
        errors, variances = self.predict(point)
        return _uneven(self.law.known(point[:2]).changes, errors**2 / variances, self.used)

    def start(self, near: Response) -> Floats:
        """Starting point of a response, whose delay is D's mean; if the law cannot have that delay, of a response with the same lag."""
        law = self.law.start(near.delay)
        slow = max(near.delay + 2 * near.damping / near.speed - float(self.law.means(law)[0]), 2 * near.damping / FASTEST)
        return np.concatenate([law, [np.log(2 * near.damping / slow), np.log(near.damping), 1.0, 0.0, np.log(0.02)]])

    def loop(self, point: Floats) -> tuple[float, float, float, float, float]:
        """Speed, damping, gain, offset and noise at a point."""
        speed, damping = np.exp(np.clip(point[2:4], [-4, -2.5], [4.5, 2.0]))
        offset, noise = self.scale * point[5], self.scale * np.exp(np.clip(point[6], self.quietest, 3))
        return float(speed), float(damping), float(point[4]), float(offset), float(noise)

    def predict(self, point: Floats) -> tuple[Floats, Floats]:
        """Errors and variances (m,) of the predictions."""
        speed, damping, gain, offset, noise = self.loop(point)
        read, windows = self.law.windows(point[:2])
        known = self.law.known(point[:2])
        with np.errstate(over="ignore", invalid="ignore"):  # an arrival far beyond its row, which no search accepts
            moments = [window.moments(speed, damping) for window in windows]
        error, variance = np.empty(len(self.data.torque)), np.empty(len(self.data.torque))
        _core.predict_torque(
            *(known.data.command, known.changes, self.data.torque, known.data.run_length == 0, _tick(speed, damping, read)),
            *(np.stack([part for part, _ in moments]), np.stack([noises for _, noises in moments])),
            *(gain, offset, noise, (UNKNOWN * self.scale) ** 2, error, variance),
        )
        return error, variance

    def best(self, near: Response) -> Fit:
        """Fit of largest likelihood in the search that starts at the response `near`."""
        found = maximize(self.predict, self.start(near), self.used.astype(float), self.prior)
        law_point = found.parameters[:2]
        slopes = np.zeros((4, len(found.parameters) - 1))
        for k, step in enumerate(MOVED * np.eye(2)):
            slopes[:, k] = (self.law.means(law_point + step) - self.law.means(law_point - step)) / (2 * MOVED)
        predicted = self.data.torque - found.errors
        _, clusters = np.unique(np.rint(predicted / (1e-6 * self.scale)), return_inverse=True)
        used = self.used
        return Fit(
            found.parameters,
            self.law.means(law_point),
            slopes,
            *self.loop(found.parameters),
            (found.variance[:-1, :-1], found.variance_by(clusters)[:-1, :-1]),
            np.linalg.pinv(found.information + np.diag(self.prior[1]), hermitian=True, rcond=1e-14)[:-1, :-1],
            1 - float(np.var(found.errors[used]) / np.var(self.data.torque[used])),
            found.cost * float(used.sum()),
            found.cost * float(used.sum()) + self._sharpness(found.information),
            _uneven(self.law.known(law_point).changes, found.errors**2 / found.variances, used),
        )

    def maximum(self, start: Floats, held: tuple[int, float] | None = None, iterations: int = MOST_ITERATIONS) -> tuple[Floats, float]:
        """Likeliest point near `start`, and its cost (minus twice the log likelihood); `held`: a parameter's index and fixed value."""
        prior, start = self.prior.copy(), start.copy()
        if held is not None:
            place, value = held
            prior[:, place], start[place] = (value, PINNED), value
        found = maximize(self.predict, start, self.used.astype(float), prior, iterations)
        return found.parameters, found.cost * float(self.used.sum())

    def pinned(self, point: Floats, value: float) -> tuple[Floats, float]:
        """Likeliest point near `point` with the first parameter equal to `value`, and its `Fit.evidence`: larger is less likely."""
        prior, start = self.prior.copy(), point.copy()
        prior[:, 0], start[0] = (value, PINNED), value
        found = maximize(self.predict, start, self.used.astype(float), prior, PINNED_STEPS)
        beside = float(self.prior[1, 0] * (value - self.prior[0, 0]) ** 2)
        return found.parameters, found.cost * float(self.used.sum()) + beside + self._sharpness(found.information)

    def _sharpness(self, information: Floats) -> float:
        """Difference of `Fit.evidence` and the cost: log determinant of the information on all parameters but the first and the noise."""
        known = self.prior[1, self.prior[1] > 0]
        return float(np.linalg.slogdet((information + np.diag(self.prior[1]))[1:-1, 1:-1])[1] - np.log(known).sum())


def decoded(data: Data, fit: Fit) -> Integers:
    """Ages (m,) [ticks] of the commands that acted, where data.command is the target: the likeliest history under both."""
    delay = float(fit.means[0])
    usual = int(np.ceil(delay - 1e-6))
    first, last = max(usual - AGES, 0), usual + AGES
    tick, (position, rate, _) = _tick(fit.speed, fit.damping, 1.0), held(fit.speed, fit.damping, usual - delay)
    age, part = np.zeros(len(data.command), dtype=np.int64), np.array([float(position), float(rate)])
    moves = np.ascontiguousarray(tick[:2, :2]), np.ascontiguousarray(tick[:2, 2])
    _core.decode(data.command, data.torque, *moves, part, fit.gain, fit.offset, fit.noise, first, last, UNUSUAL, age)
    return age


def _tick(speed: float, damping: float, read: float) -> Floats:
    """Transition (3, 3) of τ, τ̇/ω and the held command: rows of τ and τ̇/ω at the tick's end, and of τ `read` of a tick in."""
    # c(t) is what a command of 1 does from rest; a state (τ, τ̇/ω) decays as e^{Ft}, whose columns follow from c and its derivatives.
    (position, there), (rate, there_rate), (acceleration, _) = held(speed, damping, np.array([1.0, read]))
    return np.array([[1 - position, rate, position], [-rate, acceleration, rate], [1 - there, there_rate, there]])


def _uneven(changes: Floats, squares: Floats, rows: Booleans) -> float:
    size = np.abs(changes).sum(axis=1)
    size = np.maximum(size, np.concatenate([[0.0], size[:-1]]))[rows]  # and in the row after
    most = size >= np.quantile(size, 0.9)
    return float(np.mean(squares[rows][most]) / max(np.mean(squares[rows][~most]), 1.0)) if 0 < most.sum() < len(most) else 1.0
