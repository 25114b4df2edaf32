"""Rival models of two masses and a spring, and the decision which of them explains a log better.

    backlash      the spring acts beyond a gap to either side
    stiffening    its torque grows with the cube of the twist, too
    load change   the link's inertia is another from some moment on
    torque limit  a command, beyond some torque, is not what the joint got
    second mode   the link is two masses, the second on a spring of its own

Whatever the spring is, the centre of mass moves as the torque pushes it: c̈ = τ/(J_M + J_L). So the twist is (q − c) (J_M + J_L)/J_L,
without a model of the spring and without following it over time, and the torque of the spring is what the twist explains of τ − J_M q̈:
the curve that a bench would measure. All but the whole inertia and a rival's own number are linear in that. Two masses of the link are a
sum of their modes while the motor stands. Models are compared by the Whittle likelihood with a free noise spectrum by bands. What is
found names a cause and its size; it gives no parameters of the joint.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Complexes, Floats
from .torque_balance import Spectra

EXPLAINS = 0.75  # of the residual's power, in the geometric mean over frequencies: a rival that leaves more is not named
NEARLY = 0.8  # of the logarithm of what the best rival explains: another that explains as much is named beside it
HIGHEST = 2.5  # times the highest excited frequency: up to there a twist's harmonics are taken
LOW = 1.0, 0.5  # times the lowest excited frequency: from there on a twist is taken; what friction and weight make below it is none
REFITS = 3  # of the noise spectrum
SEARCHED = np.geomspace(0.2, 3.0, 21)  # times the torque over the acceleration of slow motion, which is about the whole inertia
LOWEST = 1 / 3  # of the lines, which are taken for slow motion
GAPS = np.array([0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.8])  # times the twist's deviation
RATIOS = np.array([0.4, 0.6, 0.75, 0.9, 1.1, 1.33, 1.7, 2.5])  # of the whole inertia after over before
LEAST_RATIO = 0.1  # of the link's inertia: less is no load
ABOUT = np.array([0.5, 0.63, 0.8, 1.0, 1.25, 1.6, 2.0])  # times that of the log as a whole
MOMENTS = np.linspace(0.15, 0.85, 8)  # of the record
LIMITS = np.linspace(0.3, 0.995, 14)  # quantiles of the command's size
ROUNDS, SHRINK = 6, 0.5  # of the search from the best of these
LEAST_SHARE = 0.03  # of the whole inertia, that motor and link have at least
FRICTION = slice(0, 3)  # columns of what friction acts along


@dataclass(frozen=True)
class Rival:
    """Rival model that explains more of a log.

    name     "backlash", "stiffening", "load change", "torque limit" or "second mode"
    left     of the residual's power of two masses on a spring, in the geometric mean over frequencies
    values   of backlash `gap` to either side [rad]; of stiffening `growth` of the slope at the largest `twist` [rad], relative; of a change
             `ratio` of the link's inertia after over before, and `moment` [s]; of a limit `torque` [N m]; of a second
             mode `first` and `second` resonance [rad/s]
    """

    name: str
    left: float
    values: Mapping[str, float]

    @property
    def text(self) -> str:
        """Description of the rival with its values, for a sentence."""
        v = self.values
        if self.name == "backlash":
            return f"backlash of about ± {1e3 * v['gap']:.2g} mrad"
        if self.name == "stiffening":
            return f"a gear that stiffens, by {100 * v['growth']:.2g} % at a twist of {1e3 * v['twist']:.2g} mrad"
        if self.name == "load change":
            return f"a load that changes at {v['moment']:.3g} s, to {v['ratio']:.2g} times the link's inertia"
        if self.name == "torque limit":
            return f"a torque limit at {v['torque']:.3g} N·m, which target_torque does not show"
        return f"a second mode: resonances at {v['first'] / 2 / math.pi:.3g} and {v['second'] / 2 / math.pi:.3g} Hz"


@dataclass(frozen=True)
class _Found:
    """Fit: its cost, its point in the search, and factors of the columns: the motor's inertia, then friction, then the spring's."""

    cost: float
    point: tuple[float, ...]
    factors: Floats


NONE = _Found(math.inf, (), np.zeros(0))


class _Log:
    """Log, and the fit of its torque by columns."""

    def __init__(self, spectra: Spectra, torque: Floats, lowest: float = 1.0) -> None:
        self.spectra, self.torque = spectra, torque
        self.acceleration, self.dry = spectra.accelerated(1.0), np.zeros(spectra.count)
        angle = spectra.signals.motion.angle  # all of it: what an inertia that is a little off leaves goes along it, too
        self.fixed = spectra.seen(np.vstack([self.acceleration, spectra.signals.motion.along.T[FRICTION], np.sin(angle), np.cos(angle)]))
        self.counts = np.diff(spectra.bands)
        slow = slice(0, max(int(LOWEST * len(spectra.lines)), 1))
        self.whole = float(np.linalg.norm(spectra.seen(torque)[slow]) / np.linalg.norm(self.fixed[0, slow]))
        omega = spectra.omega
        square = np.where(omega >= lowest * spectra.lines[0], -(omega**2), -np.inf)
        self.integrated = 1 / square / (1 + (omega / (HIGHEST * spectra.lines[-1])) ** 8)

    @staticmethod
    def _factors(matrix: Complexes, wanted: Complexes, weight: Floats) -> Floats:
        rows = np.vstack([(matrix * weight[:, None]).real, (matrix * weight[:, None]).imag])
        scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        return np.linalg.lstsq(rows / scale, np.append((weight * wanted).real, (weight * wanted).imag), rcond=1e-9)[0] / scale

    def fitted(self, columns: Floats, point: tuple[float, ...], torque: Floats | None = None) -> _Found:
        """Weighted least-squares fit of a torque (m,), by default the log's, by the motor's columns and `columns` (c, m).

        Its cost is the mean over frequency lines of ln of the unexplained share of power, band by band.
        """
        wanted = self.spectra.seen(self.torque if torque is None else torque)
        matrix = np.vstack([self.fixed, self.spectra.seen(columns)]).T
        factors, powers = np.zeros(matrix.shape[1]), np.ones(len(self.counts))
        for _ in range(REFITS):
            factors = self._factors(matrix, wanted, np.repeat(1 / np.sqrt(np.maximum(powers, 1e-300)), self.counts))
            powers = np.add.reduceat(np.abs(wanted - matrix @ factors) ** 2, self.spectra.bands[:-1]) / self.counts
        shares = powers * self.counts / np.add.reduceat(np.abs(wanted) ** 2, self.spectra.bands[:-1])
        return _Found(float(self.counts @ np.log(np.maximum(shares, 1e-300))) / len(wanted), point, factors)

    def moved(self, inertia: Floats | float, torque: Floats | None = None) -> Floats:
        """Position (m,) of the motor relative to the centre of mass of an `inertia`, over the frequencies that twist."""
        pushed = ((self.torque if torque is None else torque) - self.dry) / inertia
        rest = self.acceleration - (pushed - pushed.mean())
        padded = np.fft.rfft(np.append(rest, np.zeros(len(rest))))
        return np.fft.irfft(padded * self.integrated, 2 * len(rest))[: len(rest)]

    def sprung(self, moved: Floats, *spring: Floats) -> Floats:
        """Columns (c, m): those of the `spring`, and the rate of `moved` (m,) for its damping."""
        return np.vstack([*spring, np.gradient(moved, self.spectra.tick)])


def _sound(found: _Found, inertia: float) -> _Found:
    """Fit `found`; NONE if motor or link would have hardly any inertia, or the stiffness were not positive."""
    motor = found.factors[0]
    fair = LEAST_SHARE * inertia < motor < (1 - LEAST_SHARE) * inertia and found.factors[6] > 0
    return found if fair else NONE


def _searched(model: Callable[..., _Found], grid: list[tuple[float, ...]], sizes: tuple[float, ...]) -> _Found:
    """Fit of least cost: the best of `grid`, improved one parameter at a time by shrinking steps of its logarithm, at first `sizes`."""
    best = min((model(*point) for point in grid), key=lambda found: found.cost)
    steps = np.array(sizes)
    for _ in range(ROUNDS if best.point else 0):
        moves = [side * step for step in np.diag(steps) for side in (-1.0, -0.4, 0.4, 1.0)]
        found = min((model(*(np.array(best.point) * np.exp(move))) for move in moves), key=lambda found: found.cost)
        best, steps = (found, steps) if found.cost < best.cost else (best, SHRINK * steps)
    return best


def rivals_of(spectra: Spectra, torque: Floats, commanded: Callable[[Floats], Floats] | None, begin: float = 0.0) -> list[Rival]:
    """Models that explain the `torque` (m,) much better than two masses and a spring, the best first.

    commanded   from a command (m,) to the torque that acts; None: the torque itself was measured
    begin       [s] the first row's moment
    """
    found: list[tuple[Rival, float]] = []
    for lowest in LOW:
        log = _Log(spectra, torque, lowest)
        inertias = (log.whole * SEARCHED).tolist()
        base = _linear(log, inertias)
        log.dry = max(float(base.factors[1]), 0.0) * spectra.signals.motion.along[:, 0]  # which pushes the centre of mass, too
        base = _linear(log, inertias)
        kinds = [_backlash(log, inertias), _stiffening(log, inertias)]
        if lowest == LOW[0]:
            kinds += [_load_change(log, base, begin), None if commanded is None else _torque_limit(log, inertias, commanded)]
        found += [(rival, rival.left - base.cost) for rival in kinds if rival is not None]
    log = _Log(spectra, torque)
    if (rival := _second_mode(log)) is not None:
        found.append((rival, rival.left))
    named = [Rival(rival.name, math.exp(gained), rival.values) for rival, gained in found if gained < math.log(EXPLAINS)]
    named = sorted(named, key=lambda rival: rival.left)
    named = [rival for k, rival in enumerate(named) if rival.name not in [better.name for better in named[:k]]]
    return [rival for rival in named if math.log(rival.left) < NEARLY * math.log(named[0].left)]


def rivals_text(rivals: Sequence[Rival]) -> str:
    """Models that explain a log better, for a warning; "" if none of the known ones does."""
    if not rivals:
        return ""
    less = 100 * (1 - rivals[0].left)
    return f"{' or '.join(rival.text for rival in rivals)} explains the log better: {less:.2g} % less is left"


def _linear(log: _Log, inertias: list[float]) -> _Found:
    """Fit of two masses and a spring."""

    def model(inertia: float) -> _Found:
        moved = log.moved(inertia)
        return log.fitted(log.sprung(moved, moved), (inertia,))

    return _searched(model, [(inertia,) for inertia in inertias], (0.1,))


def _backlash(log: _Log, inertias: list[float]) -> Rival | None:
    def model(inertia: float, gap: float) -> _Found:
        moved = log.moved(inertia)
        return _sound(log.fitted(log.sprung(moved, moved - np.clip(moved, -gap, gap)), (inertia, gap)), inertia)

    grid = [(inertia, gap) for inertia in inertias for gap in (float(np.std(log.moved(inertia))) * GAPS).tolist()]
    best = _searched(model, grid, (0.06, 0.2))
    return None if not best.point else Rival("backlash", best.cost, {"gap": best.point[1] * _twisted(best)})


def _twisted(found: _Found) -> float:
    """Twist over the motor's motion relative to the centre of mass."""
    return found.point[0] / (found.point[0] - found.factors[0])


def _stiffening(log: _Log, inertias: list[float]) -> Rival | None:
    def model(inertia: float) -> _Found:
        moved = log.moved(inertia)
        return _sound(log.fitted(log.sprung(moved, moved, moved**3), (inertia,)), inertia)

    best = _searched(model, [(inertia,) for inertia in inertias], (0.1,))
    if not best.point or best.factors[7] <= 0:
        return None
    largest = float(np.quantile(np.abs(log.moved(best.point[0])), 0.99))
    growth = 3 * best.factors[7] / best.factors[6] * largest**2
    return Rival("stiffening", best.cost, {"growth": growth, "twist": largest * _twisted(best)})


def _load_change(log: _Log, base: _Found, begin: float) -> Rival | None:
    """Rival whose load changes; each part has a spring torque of its own, as the twist is known up to (J_M + J_L)/J_L."""
    rows = np.arange(log.spectra.count)

    def model(inertia: float, ratio: float, moment: float) -> _Found:
        before = rows < moment
        moved = log.moved(inertia * np.where(before, 1.0, ratio))
        found = log.fitted(np.vstack([log.sprung(moved * part, moved * part) for part in (before, ~before)]), (inertia, ratio, moment))
        return _sound(found, inertia * min(ratio, 1.0)) if found.factors[8] > 0 else NONE

    about = base.point[0] * ABOUT
    grid = [(inertia, ratio, share * len(rows)) for inertia in about.tolist() for ratio in RATIOS.tolist() for share in MOMENTS.tolist()]
    best = _searched(model, grid, (0.12, 0.12, 0.1))
    if not best.point:
        return None
    inertia, ratio, moment = best.point
    motor = float(best.factors[0])
    changed = (inertia * ratio - motor) / (inertia - motor)
    if not LEAST_RATIO < changed < 1 / LEAST_RATIO:
        return None
    return Rival("load change", best.cost, {"ratio": changed, "moment": begin + moment * log.spectra.tick})


def _torque_limit(log: _Log, inertias: list[float], commanded: Callable[[Floats], Floats]) -> Rival | None:
    command = log.spectra.signals.torque
    sizes = np.quantile(np.abs(command), LIMITS).tolist()
    best: tuple[_Found, float] = NONE, 0.0
    for low, high in ((-1.0, 1.0), (-math.inf, 1.0), (-1.0, math.inf)):

        def model(inertia: float, limit: float, low: float = low, high: float = high) -> _Found:
            made = commanded(np.clip(command, low * limit, high * limit))
            moved = log.moved(inertia, made)
            return _sound(log.fitted(log.sprung(moved, moved), (inertia, limit), made), inertia)

        found = _searched(model, [(inertia, limit) for inertia in inertias[::2] for limit in sizes], (0.1, 0.05))
        best = (found, found.point[1]) if found.point and found.cost < best[0].cost else best
    return Rival("torque limit", best[0].cost, {"torque": best[1]}) if best[0].point else None


def _second_mode(log: _Log) -> Rival | None:
    """Rival with a second mode, with its cost relative to one mode."""
    spectra = log.spectra
    grid = [(omega, ratio) for omega in np.geomspace(0.7 * spectra.lines[0], spectra.lines[-1], 30).tolist() for ratio in (0.01, 0.06)]

    def mode(omega: float, ratio: float) -> Floats:
        s = 1j * spectra.omega
        return spectra.accelerated((omega**2 + 2 * ratio * omega * s) / (omega**2 + 2 * ratio * omega * s + s**2))

    def one(omega: float, ratio: float) -> _Found:
        found = log.fitted(mode(omega, ratio)[None], (omega, ratio))
        return found if found.factors[0] > 0 and found.factors[6] > 0 else NONE

    first = _searched(one, grid, (0.08, 0.5))
    if not first.point:
        return None
    best, other = first, first.point
    for _ in range(3):  # each in turn
        held = mode(*best.point)

        def two(omega: float, ratio: float, held: Floats = held) -> _Found:
            found = log.fitted(np.vstack([held, mode(omega, ratio)]), (omega, ratio))
            return found if np.all(found.factors[[0, 6, 7]] > 0) else NONE

        other = best.point
        best = _searched(two, grid, (0.08, 0.5))
        if not best.point:
            return None
    motor, *links = best.factors[[0, 6, 7]].tolist()
    squares = np.array([other[0], best.point[0]]) ** 2
    # J_M + Σ J_k ω_k²/(ω_k² − ω²) = 0 where the free joint resonates; in x = ω², times both (ω_k² − x).
    polynomial = motor * np.poly(squares)
    for k in range(2):
        polynomial += np.append(0.0, links[k] * squares[k] * np.array([-1.0, squares[1 - k]]))
    resonances = np.sqrt(np.sort(np.abs(np.roots(polynomial))))
    return Rival("second mode", best.cost - first.cost, {"first": float(resonances[0]), "second": float(resonances[1])})
