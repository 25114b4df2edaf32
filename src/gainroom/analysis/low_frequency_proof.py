"""Return difference of coupled loops as ω → 0, for factors on all gains between two bounds: roots at 0, no others near, turn of det F.

With e_i = 1/c_i a root at jω makes F/x = P + u diag(e_i) singular, u the inverse of the factor. Free motions have P = −M₀/ω² + P₀ + ….
With M₀ N = 0 and Rᵀ M₀ R = 1 the coordinates T = [N, √x R] take F/x to

    diag(Nᵀ (P₀ + u D₀) N, −1)    as ω → 0,    D₀ = diag(e_i(0)), 0 where there is an integrator,

which is real and symmetric. Where it keeps its signs S for all u between, the real part of S Tᵀ F T/x stays positive for a while. All terms
are analytic within R, the lowest corner frequency, and have MOST times their size at most within R/2: the remainder of one after its power
ωᵐ⁻¹ is no more than MOST (2ε)ᵐ/(1 − 2ε) of it at ω = εR (Cauchy). Even powers are real, odd ones imaginary; two leading ones, which grow
with ω, are below √2 times the size of their sum, known at εR up to such a rest. Where signs are alike the real part counts, which lies
between what it is at 0 and at εR; where they differ the imaginary one does. Roots pass 0 itself where a sign changes.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..system.linear.arrays import Complexes, Floats, Integers
from .margin_record import NUDGE
from .modal_loop import ModalLoop

MOST = 20.0  # largest growth of a term within R/2. A mode: 4, a law: e; hold, current loop and delay grow less. None above 2 is known
TWICE = 1 + math.sqrt(2)  # remainders of a term at εR, taken √2 times, and below it, taken once
TRIES = np.geomspace(0.1, 1e-8, 15)  # ε that are tried, the largest first
HELD, FREE = 1e-11, 1e-8  # relative to the largest rigid mobility: up to HELD a direction is held, from FREE on it moves freely
SPARE = 0.1  # least value of the normalised quantity that has to be positive


class Static(NamedTuple):
    """All gains times `gain` let a root pass 0: gravity topples the mechanism, or no longer does; mode (n,) of positions."""

    gain: float
    mode: Floats


@dataclass(frozen=True)
class LowFrequencyProof:
    """Result of the proof at low frequency: `low` [rad/s], up to which no root crosses but at 0, and the turn of arg det F up to there.

    turned: [rad] at the factor 1
    poles: number of poles of det(I + L) at 0
    static: the first factor at which a root passes 0; factors beyond it are not examined. None: there is none
    """

    low: float
    turned: float
    poles: int
    static: Static | None


def low_frequency_proof(modal: ModalLoop, stop: float) -> LowFrequencyProof | None:
    """Proof that no root crosses at low ω > 0 for factors from 1 to `stop`, which may be less than 1; None where it fails."""
    values, orders = modal.laws.at_rest()
    if np.any(orders < 0) or np.any(orders > 1) or np.any(values.real <= 0) or np.any(np.abs(values.imag) > 1e-9 * values.real):
        return None
    corner, modes = _lowest_corner(modal), modal.modes
    if modal.folds > 1:
        return _all_free(modal, stop, corner, values.real, orders)
    sizes = np.where(orders > 0, corner, 1.0) / values.real  # |e| up to `corner`
    units = 1 / np.sqrt(sizes)  # units of torque
    masses, vectors = np.linalg.eigh(units[:, None] * modes.rigid * units)
    free = masses > FREE * masses[-1]
    if np.any(masses[~free] > HELD * masses[-1]):
        return None
    held, moving = vectors[:, ~free], vectors[:, free] / np.sqrt(masses[free])
    still = modes.at_rest
    shapes, resting = modes.shapes * units, np.where(orders > 0, 0.0, 1.0)
    known = _diagonal(held.T @ ((shapes.T * still) @ shapes).real @ held, held.T @ (resting[:, None] * held))
    if known is None:
        return None
    give, spring = known[1:]
    axes, count = np.hstack([held @ known[0], moving]), len(give)
    static, static_mode = _static(give, spring, stop), None
    if static is not None:
        k, gain = static
        if abs(gain - 1) <= 2 * NUDGE:
            return None
        stop = gain * (1 - NUDGE if stop > 1 else 1 + NUDGE)
        torques = axes[:, k] * units
        mode = torques * sizes * resting if modal.torque is None else modal.plant.compliance @ (modal.torque @ torques)
        static_mode = Static(gain, mode / mode[np.argmax(np.abs(mode))])
    signs = np.append(np.sign(give + spring), -np.ones(moving.shape[1]))
    at_zero = np.diag(np.append(np.zeros(count), -np.ones(moving.shape[1])))
    along = np.abs(shapes @ axes)
    size, law_size = (along.T * np.abs(still)) @ along, np.abs(axes).T @ np.abs(axes)
    like = signs[:count, None] == signs[:count]
    for share in TRIES:
        low = corner * share
        misses = TWICE * MOST * (2 * share) ** np.arange(2, 5) / (1 - 2 * share)  # remainders after ω, ω² and ω³
        mobility, laws, scale = _parts(modal, low, axes * units[:, None], count)
        weights = misses[0] * scale[:, None] * scale
        weights[:count, :count] = np.where(like, misses[2], misses[1])
        spare = 1.0
        for u in (1.0, 1 / stop):
            form = mobility + u * laws
            missed = math.sqrt(2) * np.abs(form - at_zero) - misses[0] * at_zero
            missed[:count, :count] = np.where(like, 0.0, np.abs(form[:count, :count].imag))
            missed += weights * (size + u * law_size)
            root = 1 / np.sqrt(np.append(np.abs(give + u * spring), np.ones(moving.shape[1])))
            even = (root[:, None] * np.where(signs[:, None] == signs, (signs[:, None] * form).real, 0.0) * root)[:count, :count]
            least = min(1.0, float(np.linalg.eigvalsh(even).min(initial=1.0)))  # at 0 it is 1, and in between, by ω²
            spare = min(spare, least - float((root[:, None] * missed * root).sum(axis=1).max()))
        if spare > SPARE:
            turned = float(np.angle(np.linalg.eigvals(signs[:, None] * (mobility + laws))).sum())
            return LowFrequencyProof(float(low), turned, 2 * moving.shape[1] + int(orders.sum()), static_mode)
    return None


def _all_free(modal: ModalLoop, stop: float, corner: float, values: Floats, orders: Integers) -> LowFrequencyProof | None:
    """Low-frequency proof where F is not symmetric and every channel moves freely: Y M₀ X is regular, and −(Y M₀ X)⁻¹ F near 1."""
    size = len(values) // 2
    rigid, orders = (modal.modes.rigid[:size, :size] - 1j * modal.modes.rigid[:size, size:]).real, orders[:size]
    laws = np.where(orders > 0, corner, 1.0) / values[:size]
    try:
        back = np.linalg.inv(rigid)
    except np.linalg.LinAlgError:
        return None
    first, second = np.abs(modal.modes.shapes[:, :size]), np.abs(modal.modes.shapes[:, size:])
    springs = (first.T * np.abs(modal.modes.at_rest)) @ (first + second)
    for share in TRIES:
        low = corner * share
        curved = MOST * (2 * share) ** 2 / (1 - 2 * share)
        missed = np.abs(back) @ (MOST * low**2 * (springs + np.diag(max(1.0, 1 / stop) * laws)))
        if 1 - curved - max(float(missed.sum(axis=0).max()), float(missed.sum(axis=1).max())) > SPARE:
            mobility, inverse_laws = (one[0] for one in modal.response(np.array([low])))
            form = mobility[:size, :size] - 1j * mobility[:size, size:] + np.diag(inverse_laws[:size])
            return LowFrequencyProof(float(low), float(np.angle(np.linalg.eigvals(-back @ form)).sum()), 2 * size + int(orders.sum()), None)
    return None


def _lowest_corner(modal: ModalLoop) -> float:
    """Radius R [rad/s] within which all terms are analytic; sampled, a pole's distance from z = 1 counts, and at most 1/T."""
    poles = np.concatenate([modal.modes.poles, modal.modes.partners])
    away = np.abs(poles)
    if modal.last is not None:
        step = np.pi / modal.last
        away = np.append(np.minimum(away, np.abs(np.expm1(poles * step)) / step), 1 / step)
    return float(1 / max(1 / away.min(initial=np.inf), float((modal.laws.finite_turns()[1] + modal.late + modal.turning).max())))


def _diagonal(give: Floats, spring: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Axes X (n, n) and the diagonals (n,) of Xᵀ give X and Xᵀ spring X: both symmetric matrices are diagonal in them.

    None if neither matrix is positive definite and `spring` is not 0.
    """
    if not np.any(spring):
        values, axes = np.linalg.eigh(give) if len(give) else (np.zeros(0), give)
        return axes, values, np.zeros(len(give))
    for first, second, swapped in ((spring, give, False), (give, spring, True)):
        sizes = np.linalg.eigvalsh(first)
        if sizes[0] > 1e-9 * sizes[-1]:
            back = np.linalg.inv(np.linalg.cholesky(first))
            values, axes = np.linalg.eigh(back @ second @ back.T)
            ones = np.ones(len(give))
            return (back.T @ axes, ones, np.maximum(values, 0.0)) if swapped else (back.T @ axes, values, ones)
    return None


def _static(give: Floats, spring: Floats, stop: float) -> tuple[int, float] | None:
    """Index of the diagonal entry give + u spring that vanishes first as 1/u goes from 1 to `stop`, and that 1/u; None: none does."""
    passing = [(float(-b / a), k) for k, (a, b) in enumerate(zip(give.tolist(), spring.tolist(), strict=True)) if a < 0 < b]
    ahead = [one for one in passing if min(1.0, stop) <= one[0] <= max(1.0, stop)]
    if not ahead:
        return None
    gain, k = min(ahead, key=lambda one: abs(math.log(one[0])))
    return k, gain


def _parts(modal: ModalLoop, low: float, axes: Floats, count: int) -> tuple[Complexes, Complexes, Floats]:
    """Tᵀ P T and Tᵀ diag(e) T at `low`, and the scale of T's columns there: √x of those that move."""
    functions, laws = modal.core.responses(np.array([low]))
    x = low**2 if modal.last is None else (2 * modal.last / np.pi * np.sin(0.5 * np.pi * low / modal.last)) ** 2
    scale = np.append(np.ones(count), np.full(len(axes) - count, np.sqrt(x)))
    shapes, axes = modal.modes.shapes @ axes * scale, axes * scale
    mobility = (shapes.T * (functions[0, 1:] / x)) @ shapes
    mobility[count:, count:] += functions[0, 0] * np.eye(len(axes) - count)
    return mobility, (axes.T * (laws[0] / x)) @ axes, scale
