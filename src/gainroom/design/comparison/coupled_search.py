"""Search for the parameters of several joints together, each with the same structure, that make the peak of σ_max(q/d) least.

Local searches (local_search.py) begin at the file's gains, in the box of every joint's parameters, and at the optimum of a smaller
structure; first on the Schatten norm of a low order, which is smooth, then of higher ones, at last on σ_max itself.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...system.linear.arrays import Floats
from .compared_joint import Spot
from .coupled_joints import COMPLIANCE, DELAY, SENSITIVITY, CoupledJoints
from .joint_responses import DRIVE, HOST
from .local_search import Polished, descended
from .structure_search import COARSE, KEPT, RESERVE, Problem, rank
from .structures import BIQUAD, Structure

DENSE = 2.0
"""Density of the grid of frequencies of the last searches; what is said of their end is refined or proved."""
SMOOTH, SHARP = (16.0, 100.0), (100.0, 1000.0, math.inf)
"""Orders of the norm in the first searches, and in those that follow the best of them to the end."""
STEPS, LAST = 20, 40
"""Steps of a search with one order, and of each of the last."""
PROGRAMMES = 400
"""Most programmes over one model: of 12 coordinates 300 reach its optimum, and 30 a tenth of that, in 0.03 s."""
KEPT_ENDS = 2
"""First searches that are followed to the end."""
SHARES = (0.5, 0.5), (0.75, 0.4), (0.5, 0.2)
"""Starts of kp and kd, as shares of their ranges in ln."""
PASSED = (1.0, 0.5)
"""Starts of a low-pass, likewise."""
LAGS = (0.0, 0.1, 0.2)
"""Starts of the frequencies of biquads, likewise."""
LAG = 0.9, 1.0, 0.5
"""Pole's frequency over the zero's, and both dampings, of a biquad where a search begins: it lags below its frequency."""
FURTHER = 0.2
"""Share by which each further biquad starts higher, as two alike would stay alike."""
SLOW = 0.05
"""Integral gain over kp [1/s] where a search begins."""
HARDER = 4
"""Searches with a larger reserve where the exact peaks are above the ceilings."""
ROUND_OFF = 1e-7
"""Relative excess of a peak over its ceiling that is round-off, a hundredth of what makes the ceiling's last digit."""


@dataclass(frozen=True)
class Peak:
    """Highest value of a curve, its frequency [rad/s], and the spot; `proved`: no frequency has more, by peak_gain.py."""

    value: float
    frequency: float
    spot: Spot
    proved: bool


@dataclass(frozen=True)
class Together:
    """Parameters found for joints together.

    coupled   joints and structure, at the spots of the search
    x         coordinates (N,)
    peaks     by kind: of the ceilings as shares of them, and σ_max(q/d) [rad/(N m)]
    noise     largest rms torque of a motor's noise, over its ceiling if there is one, else [N m]
    gap       ln of the second best end's objective over the best's; NaN where only one kept the ceilings
    """

    coupled: CoupledJoints
    x: Floats
    peaks: Mapping[int, Peak]
    noise: float
    gap: float

    @property
    def holds(self) -> bool:
        """True if every ceiling is kept."""
        return self.excess <= 1 + ROUND_OFF

    @property
    def excess(self) -> float:
        """Largest share of a ceiling that is taken."""
        noise = self.noise if self.coupled.problem.ceilings.torque_noise is not None else 0.0
        return max(self.peaks[SENSITIVITY].value, self.peaks[DELAY].value, noise)

    @property
    def by_joint(self) -> list[dict[str, float]]:
        """Parameters of every joint, by field."""
        every = zip(self.coupled.structures, self.coupled.of_joints(self.x), strict=True)
        return [structure.by_field(own) for structure, own in every]


def searched_together(
    problem: Problem, structure: Structure, smaller: Together | None, spots: Sequence[Spot], progress: Callable[[], None] = lambda: None
) -> Together | None:
    """Best parameters of `structure` in every joint, ceilings kept at all `spots`, the first of them leading; None: none was stable.

    smaller   optimum of a PD, where the search begins; None: at the file's gains, and in the ranges of the parameters
    """
    coarse = CoupledJoints(problem, structure, spots[:1], COARSE)
    begun = [_led(coarse, start, SMOOTH, STEPS, RESERVE, progress) for start in _starts(coarse, smaller)]
    fine = CoupledJoints(problem, structure, spots, DENSE)
    best = sorted((one for one in begun if one is not None), key=rank)[:KEPT_ENDS]
    ends = [end for one in best if (end := _led(fine, one.x, SHARP, LAST, RESERVE, progress)) is not None]
    if smaller is not None and structure.biquads and not structure.integral and structure.velocity == HOST:
        plain = _beginning(fine, smaller, 1.0, 0.0, (1.0, 1.0, 1.0))  # biquads that do nothing: no worse than without
        ends.append(Polished(plain, *fine.worst(plain)))
    ends = sorted(ends, key=rank)
    if not ends:
        return None
    kept = [one.objective for one in ends if one.excess <= KEPT]
    gap, reserve = kept[1] - kept[0] if len(kept) > 1 else math.nan, RESERVE
    found = _found(fine, ends[0].x, gap, spots)
    for _ in range(HARDER):
        if found.holds or ends[0].excess > KEPT:
            break
        reserve += math.log(found.excess)
        again = _led(fine, found.x, SHARP[1:], LAST, reserve, progress)
        found = found if again is None else _found(fine, again.x, gap, spots)
    return found


def _led(
    coupled: CoupledJoints, start: Floats, orders: Sequence[float], steps: int, reserve: float, progress: Callable[[], None]
) -> Polished | None:
    """End of local searches with one order after the other, its objective and excess by σ_max; None where `start` is unstable."""
    x = start
    for order in orders:
        found = descended(lambda x, order=order: coupled.model(x, order), coupled.limits, x, reserve, progress, steps, PROGRAMMES)
        if found is None:
            return None
        x = found.x
    return Polished(x, *coupled.worst(x))


def _starts(coupled: CoupledJoints, smaller: Together | None) -> Iterator[Floats]:
    """Coordinates (N,) at which searches begin."""
    if smaller is None:
        own, opened = coupled.structures, coupled.joints[0].opened
        terms, joints = opened.parts.controller.matrices(opened.parts.plant.size), list(opened.joints)
        if (0, 0) in terms and (1, 0) in terms:
            kp, kd = (np.diagonal(terms[powers])[joints] for powers in ((0, 0), (1, 0)))
            if np.all(kp > 0) and np.all(kd > 0):
                yield _joined(own, [{"kp": stiff, "kd": damped} for stiff, damped in zip(kp.tolist(), kd.tolist(), strict=True)])
        for share in SHARES:
            yield _joined(own, [{name: _at_share(one, name, at) for name, at in zip(("kp", "kd"), share, strict=True)} for one in own])
        return
    structure = coupled.structure
    for passed in PASSED if structure.velocity == DRIVE else (1.0,):
        for share in LAGS if structure.biquads else (0.0,):
            yield _beginning(coupled, smaller, passed, share, LAG)


def _beginning(coupled: CoupledJoints, smaller: Together, passed: float, share: float, lag: tuple[float, float, float]) -> Floats:
    """Coordinates (N,) with the kp and kd of `smaller`, a low-pass and biquads at these shares of their ranges."""
    ratio, zero_damping, pole_damping = lag
    found = []
    for one, values in zip(coupled.structures, smaller.by_joint, strict=True):
        own = {"ki": SLOW * values["kp"], **values}
        if one.filtered:
            own["bandwidth"] = _at_share(one, "bandwidth", passed)
        for k in range(one.biquads):
            at = _at_share(one, f"zero_frequency_{k}", min(1.0, share + FURTHER * k))
            numbers = (at, zero_damping, ratio * at, pole_damping)
            own |= {f"{name}_{k}": number for name, number in zip(BIQUAD, numbers, strict=True)}
        found.append(own)
    return _joined(coupled.structures, found)


def _at_share(structure: Structure, name: str, share: float) -> float:
    one = structure.ranges[name]
    return one.low ** (1 - share) * one.high**share


def _joined(structures: Sequence[Structure], values: Sequence[Mapping[str, Any]]) -> Floats:
    return np.concatenate([one.coordinates(own) for one, own in zip(structures, values, strict=True)])


def _found(fine: CoupledJoints, x: Floats, gap: float, spots: Sequence[Spot]) -> Together:
    """The rounded parameters, as people see them and type them in, where these are stable, and their exact peaks."""
    near = fine.rounded(x)
    x = near if fine.root(near) < 1 else x
    return Together(fine, x, peaks_of(fine, x, spots), fine.noise(x), gap)


def peaks_of(
    coupled: CoupledJoints, x: Floats, spots: Sequence[Spot], kinds: Sequence[int] = (SENSITIVITY, DELAY, COMPLIANCE)
) -> dict[int, Peak]:
    """Exact peaks of stable joints over the spots of `coupled`, by kind."""
    found: dict[int, Peak] = {}
    for kind in kinds:
        every = [(*coupled.peak(x, kind, k), k) for k in range(len(spots))]
        value, frequency, _, k = max(every)
        found[kind] = Peak(value, frequency, spots[k], all(proved for *_, proved, _ in every))
    return found
