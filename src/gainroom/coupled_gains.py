"""Gains for several coupled loops: how far a shape of gains can be scaled while every requirement holds, in every case.

A shape is a controller for each scale σ > 0; here only the stiffness grows with it, for several dampings in turn, and the stiffest result
is taken. A case is a posture, a contact state and a place in the uncertainty. The largest σ is bracketed and bisected on the case that
stands in the way; the others are screened with the answer, and any that breaks a requirement takes its place.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import Complexes, Floats
from .errors import GainroomError
from .forbidden import Requirements
from .loop import Loop
from .sweep import MOST, Sweep, in_blocks

Case = Callable[[float], Loop]
"""σ → the loop with gains of that scale."""
SMALLEST, LARGEST = 1e-4, 1e4  # of the scales that are tried
ACCURACY = 0.02  # relative, of the scale; the answer is rounded towards the safe side


@dataclass(frozen=True)
class Kept:
    """What one coupled loop keeps: all loops together, and each with the others closed.

    gain_margin       the smallest factor > 1, up or down, on all gains or on those of one loop, that makes it vibrate
    phase_margin      [rad] the same for a phase
    peak_sensitivity  the largest |S_ii| of S = (I + L)⁻¹, the peak sensitivity of loop i with the others closed
    """

    stable: bool
    gain_margin: float
    phase_margin: float
    peak_sensitivity: float

    def meets(self, required: Requirements) -> bool:
        """Whether every requirement holds."""
        return self.stable and all(required.met(name, getattr(self, name)) for name in required.asked)


@dataclass(frozen=True)
class Scaled:
    """The largest scale that keeps the requirements in every case.

    scale     σ; 0 where none on the ladder keeps them
    binding   index of the case that stands in the way
    kept      what each case keeps at that scale, in the order of the cases
    """

    scale: float
    binding: int
    kept: tuple[Kept, ...]


def kept_by(loop: Loop) -> Kept:
    """What a coupled loop keeps, from its loci and from each loop's return ratio with the others closed.

    Interpolated between samples that are refined until neighbours differ little: good to a part in a thousand, not to the last digit.
    """
    sweep = Sweep(loop)
    if sweep.unstable(1.0) > 0:
        return Kept(False, math.nan, math.nan, math.nan)
    try:
        sensitivity = _sensitivity(sweep)
    except np.linalg.LinAlgError:  # a root on the boundary, to the last digit
        return Kept(False, math.nan, math.nan, math.nan)
    single = 1 / np.where(sensitivity == 0, 1e-300, sensitivity) - 1  # ℓ_i of loop i with the others closed: 1 + ℓ_i = 1/S_ii
    steps = sweep.steps()
    starts = (steps.start, single[:-1])
    ends = (steps.end, single[1:])
    factor = min(_nearest_factor(start, end) for start, end in zip(starts, ends, strict=True))
    if loop.parts is not None and loop.parts.plant.gravity_stiffness is not None:
        factor = min(factor, *(_factor_at_rest(values) for values in (sweep.at_rest(), single[0])))
    phase = min(_nearest_phase(start, end) for start, end in zip(starts, ends, strict=True))
    return Kept(True, factor, phase, float(np.abs(sensitivity).max()))


def _sensitivity(sweep: Sweep) -> Complexes:
    """The diagonal of (I + L)⁻¹ (k, n) along the boundary, refined around its peaks."""
    loop, omega = sweep.loop, sweep.omega

    def diagonal(omega: Floats) -> Complexes:
        response = loop.response(omega).reshape(len(omega), loop.size, loop.size)
        return np.diagonal(np.linalg.inv(np.eye(loop.size) + response), axis1=1, axis2=2)

    values = in_blocks(diagonal, omega, loop.size)
    for _ in range(10):
        move = np.abs(np.diff(values, axis=0)).max(axis=1)
        rough = np.flatnonzero((move > 0.1) & (np.diff(omega) > 1e-7 * omega[1:]))
        if not len(rough) or len(omega) > MOST:
            break
        middle = 0.5 * (omega[rough] + omega[rough + 1])
        values = np.insert(values, rough + 1, in_blocks(diagonal, middle, loop.size), axis=0)
        omega = np.insert(omega, rough + 1, middle)
    return values


def _nearest_factor(start: Complexes, end: Complexes) -> float:
    """The smallest max(g, 1/g) at which a step crosses −1/g."""
    crosses = (start.imag > 0) != (end.imag > 0)
    start, end = start[crosses], end[crosses]
    value = (start + start.imag / (start.imag - end.imag) * (end - start)).real
    return float(np.exp(np.abs(np.log(-value[value < 0])).min(initial=math.inf)))


def _factor_at_rest(values: Complexes | Floats) -> float:
    """The smallest max(g, 1/g) with −1/g among the values at ω → 0 that are real: there gravity topples."""
    real = np.real(values[np.abs(np.imag(values)) < 0.01 * np.abs(values)])
    return float(np.exp(np.abs(np.log(-real[real < 0])).min(initial=math.inf)))


def _nearest_phase(start: Complexes, end: Complexes) -> float:
    """The smallest |arg(−L)| at which a step crosses the unit circle [rad]."""
    low, high = np.log(np.maximum(np.abs(start), 1e-300)), np.log(np.maximum(np.abs(end), 1e-300))
    crosses = (low > 0) != (high > 0)
    share = low[crosses] / (low[crosses] - high[crosses])
    start, end = start[crosses], end[crosses]
    lag = np.angle(-start) + share * np.angle(end * start.conj())  # size and direction change evenly where curves are powers of ω
    return float(np.abs(np.angle(np.exp(1j * lag))).min(initial=math.inf))


def largest_scale(
    cases: Sequence[Case],
    required: Requirements,
    progress: Callable[[], None] = lambda: None,
    start: float = 1.0,
    first: int = 0,
    known: float = 0.0,
) -> Scaled:
    """The largest scale of gains that keeps `required` in every case. `progress` is called after every loop that is looked at.

    start, first   a guess at the scale, and at the case that stands in the way
    known          a scale that is known to keep them in every case: the answer is not smaller

    Assumes that a smaller scale is safer, as it is for PD gains around a plant without gravity; the answer itself is checked in every case.
    Raises GainroomError without cases or requirements.
    """
    if not cases or not required.asked:
        raise GainroomError("largest_scale needs at least one case and one requirement")

    def look(case: Case, scale: float) -> Kept:
        found = kept_by(case(scale))
        progress()
        return found

    binding, scale = first, _largest_of_one(lambda scale: look(cases[first], scale).meets(required), start, known)
    for _ in range(3 * len(cases)):
        if scale == 0:
            return Scaled(0.0, binding, ())
        kept = [look(case, scale) for case in cases]
        broken = [k for k, one in enumerate(kept) if not one.meets(required)]
        if not broken:
            return Scaled(scale, binding, tuple(kept))
        binding = max(broken, key=lambda k: (not kept[k].stable, kept[k].peak_sensitivity))
        case = cases[binding]
        scale = _largest_of_one(lambda scale, case=case: look(case, scale).meets(required), scale / (1 + ACCURACY), known)
    return Scaled(known, binding, tuple(look(case, known) for case in cases)) if known else Scaled(0.0, binding, ())


def _largest_of_one(holds: Callable[[float], bool], start: float, known: float) -> float:
    """The largest scale at which `holds`, within ACCURACY below it and >= `known`, at which it is known to; 0 where none does."""
    inside, outside, step = known or None, None, 1.0
    if start > known:
        inside, outside = (start, None) if holds(start) else (inside, start)
    while inside is None or outside is None:
        step *= 1.5  # a poor guess is left behind quickly
        trial = step * inside if inside is not None else (outside or start) / step
        if not SMALLEST < trial < LARGEST:
            return inside or 0.0
        if holds(trial):
            inside = trial
        else:
            outside = trial
    while outside / inside > 1 + ACCURACY:
        middle = math.sqrt(inside * outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside
