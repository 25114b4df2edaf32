"""The best linear controller that is known for a joint under ceilings, of any structure: a cone programme in the free response Q.

All closed loops are affine in Q (closed_maps), and peaks and noise of them are convex. Q is a sum of stable functions (Takenaka, Malmquist;
Kautz) with poles from dead beat to slow, and about the joint's resonances, so that what is found can be reached; what lies between it and
the bound (bound.py) is not known. With several sensors it is seen, not certified: the bound is of one.

The solver is Clarabel (Goulart and Chen, arXiv:2405.12762; Apache-2.0), an optional dependency.
"""

import importlib
import importlib.util
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import GainroomError
from ...system.linear.arrays import Complexes, Floats, Integers
from .ceilings import Ceilings
from .closed_maps import AffineMap, ClosedMaps, stabilised
from .exact_joint import ExactJoint

FUNCTIONS = 80  # per sensor
POLES = (0.0, 0.8, 0.93, 0.98, 0.995)  # in turn, and then of every resonance
RADII = (0.97, 0.995)  # of pairs of poles at the frequency of a resonance
RESONANT = 0.9  # radius beyond which a pole of the joint is one
POINTS = 2**15  # of half a circle, on which a result is judged: 50 of them within the width of the sharpest pole of Q
ROUNDS = 12  # of adding points where a ceiling is exceeded
INSIDE = 2e-3  # relative: how far below its ceilings a result is sought, so that none is exceeded between points
ENDED = ("Solved", "AlmostSolved", "InsufficientProgress")  # where the solver has a point, which is judged by what it reaches
HELD = 2e-3  # relative: of the objective between the points that are held


@dataclass(frozen=True)
class BestKnown:
    """A controller on `sensors` whose peak of |q/d| is `value` [rad/(N m)], and how much of the ceilings it needs.

    omega (k,) [rad/s]; controller (k, sensors): responses K_i of u = −Σ K_i y_i; torque_noise [N m]: None without sensor noise;
    delay_share: peak of |T| |1 − e^(−jωτ)|, at most 1.
    """

    value: float
    sensors: tuple[str, ...]
    omega: Floats
    controller: Complexes
    peak_sensitivity: float
    delay_share: float
    torque_noise: float | None


def best_known(joint: ExactJoint, ceilings: Ceilings, sensors: tuple[str, ...] = ("motor",)) -> BestKnown:
    """Best controller found on `sensors`. Raises GainroomError where clarabel is missing, or finds none."""
    require_solver()
    programme = _Programme.of(joint, ceilings, sensors)
    held = np.unique(np.concatenate([np.geomspace(1, POINTS, 120), np.linspace(1, POINTS, 40)]).astype(int) - 1)
    q, peak = programme.solved(held)
    for _ in range(ROUNDS):
        beyond = np.unique(np.concatenate([*programme.exceeded(q, peak)]))
        if not len(beyond):
            break
        held = np.union1d(held, beyond)
        q, peak = programme.solved(held)
    found = programme.judged(ceilings, sensors, q)
    noisy = ceilings.torque_noise is not None and (found.torque_noise or 0.0) > ceilings.torque_noise
    if found.peak_sensitivity > ceilings.peak_sensitivity or found.delay_share > 1 or noisy:
        raise GainroomError(f"no controller on {' and '.join(sensors)} was found that keeps the ceilings between the frequencies tried")
    return found


def require_solver() -> None:
    """Raise GainroomError where clarabel is missing."""
    if importlib.util.find_spec("clarabel") is None:
        raise GainroomError("the best known controller needs clarabel: pip install 'gainroom[compare]'")


@dataclass(frozen=True)
class _Programme:
    """Maps in units of their ceilings at POINTS angles: compliance in units of `unit` [rad/(N m)], then S and T, then torque noises.

    basis (POINTS, FUNCTIONS); columns (sensors,): what a coefficient of each sensor's Q is multiplied by.
    """

    omega: Floats
    maps: ClosedMaps
    peaks: tuple[AffineMap, ...]
    noises: tuple[AffineMap, ...]
    unit: float
    basis: Complexes
    columns: Floats

    @classmethod
    def of(cls, joint: ExactJoint, ceilings: Ceilings, sensors: tuple[str, ...]) -> "_Programme":
        angles = math.pi * (np.arange(POINTS) + 0.5) / POINTS
        omega = angles / joint.sample_time
        maps = stabilised(joint, sensors).halves(POINTS)
        unit = float(np.abs(maps.compliance.fixed).max())
        share = ceilings.delay_weight(omega)
        peaks = (
            _times(maps.compliance, np.array([1 / unit])),
            _times(maps.sensitivity, np.array([1 / (ceilings.peak_sensitivity * (1 - INSIDE))])),
            _times(maps.complementary, share / (1 - INSIDE)),
        )
        shares = [ceilings.noise_of(name) for name in sensors]
        noises = tuple(_times(one, np.array([by / (1 - INSIDE)])) for one, by in zip(maps.noise, shares, strict=True) if by is not None)
        columns = 1 / np.sqrt((np.abs(peaks[1].free) ** 2).mean(axis=0))
        return cls(omega, maps, peaks, noises, unit, _basis(np.exp(1j * angles), _poles(joint)), columns)

    def _linear(self, one: AffineMap, held: Integers | slice) -> Complexes:
        """Derivative (held, sensors · FUNCTIONS) of a map with respect to the coefficients."""
        scaled = one.free[held] * self.columns
        return (scaled[:, :, None] * self.basis[held][:, None, :]).reshape(len(scaled), -1)

    @cached_property
    def _noise(self) -> Floats:
        """Rows (k, sensors · FUNCTIONS + 1) whose product with (coefficients, 1) has the norm of the torque noise: as few as unknowns."""
        linear = np.concatenate([self._linear(one, slice(None)) for one in self.noises]) / math.sqrt(POINTS)
        fixed = np.concatenate([one.fixed for one in self.noises]) / math.sqrt(POINTS)
        both = np.column_stack([np.vstack([linear.real, linear.imag]), np.concatenate([fixed.real, fixed.imag])])
        return np.asarray(np.linalg.qr(both, mode="r"))

    def solved(self, held: Integers) -> tuple[Complexes, float]:
        """Q (POINTS, sensors) of the least peak at the points `held` with all ceilings kept there, and that peak in units of `unit`."""
        import scipy.sparse

        clarabel: Any = importlib.import_module("clarabel")
        unknowns = len(self.columns) * FUNCTIONS
        rows, right, cones = [], [], []
        for number, one in enumerate(self.peaks):
            block, side = np.zeros((len(held), 3, unknowns + 1)), np.zeros((len(held), 3))
            linear, fixed = self._linear(one, held), one.fixed[held]
            block[:, 1, :-1], block[:, 2, :-1] = -linear.real, -linear.imag
            side[:, 1], side[:, 2] = fixed.real, fixed.imag
            if number == 0:
                block[:, 0, -1] = -1.0  # |compliance| ≤ the last unknown
            else:
                side[:, 0] = 1.0
            rows.append(block.reshape(-1, unknowns + 1))
            right.append(side.ravel())
            cones += [clarabel.SecondOrderConeT(3)] * len(held)
        if self.noises:
            short = self._noise
            rows.append(np.vstack([np.zeros((1, unknowns + 1)), np.column_stack([-short[:, :-1], np.zeros(len(short))])]))
            right.append(np.concatenate([[1.0], short[:, -1]]))
            cones.append(clarabel.SecondOrderConeT(len(short) + 1))
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads = False, 1
        cost = np.zeros(unknowns + 1)
        cost[-1] = 1.0
        nothing = scipy.sparse.csc_matrix((unknowns + 1, unknowns + 1))
        table = scipy.sparse.csc_matrix(np.vstack(rows))
        solution = clarabel.DefaultSolver(nothing, cost, table, np.concatenate(right), cones, settings).solve()
        if str(solution.status) not in ENDED:
            raise GainroomError(f"no controller was found that keeps the ceilings; the cone programme ended as {solution.status}")
        found = np.array(solution.x)
        coefficients = found[:-1].reshape(len(self.columns), FUNCTIONS) * self.columns[:, None]
        return self.basis @ coefficients.T, float(found[-1])

    def exceeded(self, q: Complexes, peak: float) -> Iterator[Integers]:
        """Points at local peaks of a response beyond its ceiling, one array per ceiling."""
        for one, most in zip(self.peaks, (peak * (1 + HELD), 1 + INSIDE / 2, 1 + INSIDE / 2), strict=True):
            size = np.pad(np.abs(one.of(q)), 1)
            top = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:]) & (size[1:-1] > most)
            yield np.flatnonzero(top)

    def judged(self, ceilings: Ceilings, sensors: tuple[str, ...], q: Complexes) -> BestKnown:
        """The controller that Q makes, and what it reaches at POINTS frequencies."""
        maps = self.maps
        sensitivity = maps.sensitivity.of(q)
        torques = [one.of(q) for one in maps.noise]
        noise = None
        if set(sensors) <= set(ceilings.sensor_noise):
            parts = [ceilings.sensor_noise[name] ** 2 * (np.abs(one) ** 2).mean() for name, one in zip(sensors, torques, strict=True)]
            noise = math.sqrt(sum(parts))
        share = np.abs(maps.complementary.of(q)) * ceilings.delay_weight(self.omega)
        controller = np.array(torques).T / sensitivity[:, None]
        peak = float(np.abs(maps.compliance.of(q)).max())
        return BestKnown(peak, sensors, self.omega, controller, float(np.abs(sensitivity).max()), float(share.max()), noise)


def _times(one: AffineMap, by: Floats) -> AffineMap:
    return AffineMap(one.fixed * by, one.free * by[:, None])


def _poles(joint: ExactJoint) -> list[complex]:
    """Poles of Q that are taken in turn; of a pair the upper one."""
    own = 1 + joint.sample_time * np.linalg.eigvals(joint.state_space.a)
    # The rigid pole at 1 is double, and splits by the root of round-off.
    angles = np.angle(own[(own.imag > 1e-6) & (np.abs(own) > RESONANT)])
    return [*POLES, *(radius * np.exp(1j * angle) for angle in angles for radius in RADII)]


def _basis(z: Complexes, poles: Sequence[complex]) -> Complexes:
    """Stable functions (k, FUNCTIONS) at z (k,), of norms near 1 and nearly orthogonal, the first of them constant."""
    found, product = [np.ones_like(z)], np.ones_like(z)
    for pole in itertools.cycle(poles):
        if len(found) >= FUNCTIONS:
            break
        denominator, image = z - pole, 1 - np.conj(pole) * z
        size = math.sqrt(1 - abs(pole) ** 2)
        if np.imag(pole):
            denominator, image = denominator * (z - np.conj(pole)), image * (1 - pole * z)
            size *= math.sqrt(2) * abs(np.imag(pole))  # of either of the two, where the pole is near the circle
            found.append(size * product * z / denominator)
        found.append(size * product / denominator)
        product = product * image / denominator
    return np.array(found[:FUNCTIONS]).T
