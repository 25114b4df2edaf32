"""The multi-loop disk margin: how much the gains and phases of n coupled loops may change, all at once and independently.

Each loop is multiplied by its own complex factor f_i = (2 + δ_i)/(2 − δ_i). With S = (I + L)⁻¹ and T = I − S the loops are lost first at
max|δ_i| = α = 2 / max_ω μ(S − T), μ the structured singular value for n complex factors (Seiler, Packard and Gahinet 2020, skew 0); for
n = 1 this is min 2|1 + L|/|1 − L|. μ is bounded from above by σ_max of D (S − T) D⁻¹ and from below by δ that do lose the loops (_mu.py).

The highest σ_max is found by sampling and polishing. Then intervals of ω are divided until on each of them, for some D, it provably stays
within TOLERANCE of that. The core does both (disk_peak.hpp, disk_modes.hpp).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError
from ..native import _core
from ..system.linear.arrays import Complexes, Floats, distinct
from ..system.loop import Loop
from ._disk_modes import opened_at_torques
from ._mu import balanced, from_below, largest, scaled
from .stability import scan_loop

TOLERANCE = _core.DISK_TOLERANCE  # share of the reported peak by which a peak between the sampled frequencies may exceed it
SCALAR_TOLERANCE = 1 / 0.99 - 1  # likewise for one joint, whose peak comes from the scan (crossings.py)
SAMPLES, CHECKS = 60, 12  # frequencies from which the search for the peak of S − T starts, and at which the modes are checked
DROWNED = 1e13  # condition number of I + L from which its inverse is round-off: where it matters it is above 1e14, else below 1e11
MOST_INTERVALS = 5_000  # bound of time
LARGEST_RISE, LEAST_DISTANCE = (0.05, 1e-6)  # neighbouring samples of a response: largest relative step of σ_max, least distance

Response = Callable[[Floats], Complexes]


@dataclass(frozen=True)
class MultiLoopDisk:
    """Multi-loop disk margin: the least size of simultaneous complex factors (2 + δ_i)/(2 − δ_i), one per loop, that lose n loops.

    margin        α, the least 2/σ_max(D (S − T) D⁻¹) over frequency, each with its best D: no δ with max|δ_i| < α loses the loops.
                  At most 2 (factors from 0 to ∞), as a loop that fades at high frequency cannot do better. Gains of all loops may lie
                  anywhere in [(2 − α)/(2 + α), (2 + α)/(2 − α)], or phases in ±2 atan(α/2), independently of each other
    lower_margin  proved lower bound of α between the sampled frequencies; 0 where nothing is proved
    upper_margin  max|δ_i| of `factors`: the true margin at `frequency` is in [margin, upper_margin]; equal for n ≤ 3
    frequency     of the peak [rad/s]; 0 and inf can be
    scaling       (n,) diagonal of D there, geometric mean 1
    factors       (n,) complex: multiplied by these, the loops have a root at j·frequency; inf where a δ_i is 2
    certified     margin and lower_margin are within TOLERANCE of each other (1 % for one loop), proved up to rounding
    gap           share by which the peak of σ_max may be higher than found; inf where nothing is proved
    """

    margin: float
    lower_margin: float
    upper_margin: float
    frequency: float
    scaling: Floats
    factors: Complexes
    certified: bool
    gap: float


def disk_margin(loop: Loop) -> MultiLoopDisk:
    """The multi-loop disk margin of a stable loop of n ≥ 1 joints; of an unstable one the numbers mean nothing, so ask `is_stable` first.

    The factors multiply the torques of the motors. Where every gain of the controller is a number or diagonal, factors on the measured
    positions (where `loop.response` opens the loops) have the same margin; for full gain matrices they have another (`disk_margin_of`).
    One joint has the margin of its scan (`margins`).

    Certified for loops built from parts, with exact delays or sampled, ω → 0 and ω → ∞ included: proved in real arithmetic, evaluated in
    doubles, not rounded outwards. What is proved is that σ_max stays below the peak (1 + gap); that D is the best one is not part of it,
    and does not have to be: any D gives a margin that holds. `certified` is False where the work limit stopped the proof, for callables,
    and where the modes of the loops closed without delay (some may be defective) do not give back S − T, which is then sampled.

    Raises numpy.linalg.LinAlgError where the slowest motions, such as those of integrators, leave nothing but round-off of themselves or of
    the others at rest.
    """
    if loop.size == 1:
        return _of_one(loop)
    opened = opened_at_torques(loop)
    modes = opened.modes()
    omega = modes.frequencies(SAMPLES)
    if modes.lost or _drowned(np.eye(loop.size) + loop.response(omega[omega > 0][:1])[0]):
        raise np.linalg.LinAlgError("the slowest motions are lost in round-off")
    if not opened.agrees(modes, omega[SAMPLES // CHECKS :: SAMPLES // CHECKS]):
        return disk_margin_of(opened.response, omega[1:])
    (height, place, x), bound = modes.core.search(omega, MOST_INTERVALS)
    if not len(x):
        raise np.linalg.LinAlgError("S − T is not finite")
    at_peak = np.eye(loop.size, dtype=complex) if math.isinf(place) else modes.matrices(np.array([place]))[0]
    return _result(at_peak, height, place, x[:, 0], max(bound / height - 1, 0.0))


def _drowned(matrix: Complexes) -> bool:
    """True if round-off leaves hardly a digit of the inverse of `matrix`, by Bauer's condition number, invariant to units of rows."""
    spread = np.abs(np.linalg.eigvals(np.abs(np.linalg.inv(matrix)) @ np.abs(matrix))).max()
    return bool(spread > DROWNED)


def disk_margin_of(response: Response, omega: Floats) -> MultiLoopDisk:
    """Multi-loop disk margin of any return ratio ω (k,) → L (k, n, n) or (k,), from samples at `omega` (k,) [rad/s]; not certified.

    The samples are refined, and the peak is polished. Serves factors at another place (`loop.response`: on the measured positions) and
    loops from elsewhere. Frequencies below the first and above the last ω are not examined. Raises GainroomError where the response is not
    finite or has another shape.
    """

    def matrices(points: Floats) -> Complexes:
        value = np.asarray(response(points), dtype=complex)
        if value.ndim == 1:
            value = value[:, None, None]
        if value.ndim != 3 or value.shape[0] != len(points) or value.shape[1] != value.shape[2] or not np.all(np.isfinite(value)):
            raise GainroomError(f"disk margin: the response of shape {value.shape} must be finite, of shape ({len(points)}, n, n)")
        return 2 * np.linalg.inv(np.eye(value.shape[1]) + value) - np.eye(value.shape[1])

    points = distinct(np.asarray(omega, dtype=float))
    if len(points) < 3 or not np.all(np.isfinite(points)) or points[0] < 0:
        raise GainroomError("disk margin: omega must hold at least three finite frequencies >= 0")
    while True:
        values = matrices(points)
        heights = np.log(largest(scaled(values, balanced(values))))
        rough = (np.abs(np.diff(heights)) > LARGEST_RISE) & (np.diff(points) > LEAST_DISTANCE * points[1:])
        if not rough.any() or len(points) > MOST_INTERVALS:
            break
        points = np.sort(np.append(points, 0.5 * (points[1:] + points[:-1])[rough]))
    height, place, x = _core.disk_peak(points, values, lambda one: matrices(np.array([one]))[0])
    return _result(matrices(np.array([place]))[0], height, place, x[:, 0], math.inf)


def _of_one(loop: Loop) -> MultiLoopDisk:
    """Disk margin of one joint: α = min 2|1 + L|/|1 − L|, lost with the factor −1/L."""
    scan = scan_loop(loop)
    omega, least = scan.peaks[2].tolist()
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = -1 / loop.response(omega)
    margin, gap = min(least, 2.0), SCALAR_TOLERANCE if scan.certified else math.inf
    return MultiLoopDisk(margin, margin / (1 + gap), least, omega, np.ones(1), factor, scan.certified, gap)


def _result(matrix: Complexes, height: float, omega: float, x: Floats, gap: float) -> MultiLoopDisk:
    """Disk margin from S − T (n, n) at its peak `omega` [rad/s].

    height   σ_max there, scaled by D = diag(e^x); elsewhere it may be (1 + gap) times as high
    """
    lower, phases = from_below(scaled(matrix[None], x[None])[0], height)
    radius = 2 / lower if lower > 0 else math.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        # M diag(q) has an eigenvalue β with |β| = `lower`, so δ = 2 q/β makes det(I − M diag(δ)/2) vanish
        values = np.linalg.eigvals(matrix * phases)
        delta = 2 * phases / values[np.argmax(np.abs(values))]
        factors = (2 + delta) / (2 - delta)
    margin, proved = min(2 / height, 2.0), min(2 / (height * (1 + gap)), 2.0)
    return MultiLoopDisk(margin, proved, max(radius, margin), omega, np.exp(x), factors, gap <= TOLERANCE * (1 + 1e-9), gap)
