"""What several coupled loops keep before they vibrate: all together, and each with the others closed."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .arrays import Booleans, Complexes, Floats, Integers
from .controller import PD, PID, gain_matrix
from .errors import GainroomError
from .limits import GainLimit, coupled_limit
from .loop import Loop
from .sweep import MOST, Sweep, in_blocks

Curves = Callable[[Floats], Complexes]
"""ω (k,) → (k, m): m scalar responses."""
RELATIVE_MOVE = 0.25  # of a curve between samples, near the negative real axis
FAINTEST = 1e-6  # of a curve's largest value: where it is smaller it is not followed, and what it would limit counts as without limit


@dataclass(frozen=True)
class JointMargins:
    """Margins of n coupled loops.

    limit          of the common factor on all gains (see GainLimit)
    phase_margin   [rad] the smallest common phase, of either sign, that makes them vibrate, at `phase_frequency` [rad/s]
    delay_margin   [s] the smallest extra delay in all of them, at `delay_frequency`; in sampled time a fraction of a tick counts as the
                   phase that it costs
    others_closed  (n,) largest factor on one joint's gains while all other loops stay as they are; inf: none
    largest_kp, largest_kd   (n,) largest diagonal gains of one joint, the other gains as they are [N m/rad], [N m s/rad]; None where
                   the controller is neither PD nor PID
    The last three and both margins are NaN for unstable loops.
    """

    limit: GainLimit
    phase_margin: float
    phase_frequency: float
    delay_margin: float
    delay_frequency: float
    others_closed: Floats
    largest_kp: Floats | None
    largest_kd: Floats | None

    @property
    def stable(self) -> bool:
        """At the gains as they are."""
        return self.limit.stable


def joint_margins(loop: Loop) -> JointMargins:
    """All margins of a loop built with build_loop, n >= 1. Raises GainroomError for callables and for gains that are all zero."""
    if loop.parts is None:
        raise GainroomError("joint_margins needs a loop built with build_loop; use margins for a scalar return ratio")
    sweep = Sweep(loop)
    limit = coupled_limit(sweep)
    if not limit.stable:
        nothing = np.full(loop.size, math.nan)
        return JointMargins(limit, math.nan, math.nan, math.nan, math.nan, nothing, nothing, nothing)
    crossings = _unit_crossings(sweep)
    phase = min(crossings, key=lambda one: abs(_signed(one[1])), default=None)
    delay = min(crossings, key=lambda one: _positive(one[1]) / one[0], default=None)
    factors, largest_kp, largest_kd = _one_at_a_time(sweep)
    return JointMargins(
        limit,
        abs(_signed(phase[1])) if phase else math.inf,
        phase[0] if phase else math.nan,
        _positive(delay[1]) / delay[0] if delay else math.inf,
        delay[0] if delay else math.nan,
        factors,
        largest_kp,
        largest_kd,
    )


def _positive(value: complex) -> float:
    """The lag [rad] in [0, 2π) that turns λ on the unit circle to −1."""
    return (float(np.angle(value)) + math.pi) % (2 * math.pi)


def _signed(value: complex) -> float:
    lag = _positive(value)
    return lag - 2 * math.pi if lag > math.pi else lag


def _unit_crossings(sweep: Sweep) -> list[tuple[float, complex]]:
    """(ω, λ) of every crossing of the unit circle by a locus."""
    steps = sweep.steps()
    low, high = np.log(np.maximum(np.abs(steps.start), 1e-300)), np.log(np.maximum(np.abs(steps.end), 1e-300))
    k, branch = np.nonzero((low > 0) != (high > 0))
    share = low[k, branch] / (low[k, branch] - high[k, branch])
    omega = sweep.omega[k] * (sweep.omega[k + 1] / sweep.omega[k]) ** share
    turned = np.angle(steps.end[k, branch] * steps.start[k, branch].conj())
    wanted = np.exp(1j * (np.angle(steps.start[k, branch]) + share * turned))
    omega, value, _ = sweep.crossings(omega, wanted, lambda value: np.log(np.abs(value)))
    reached = np.abs(np.abs(value) - 1) < 1e-9
    return list(zip(omega[reached].tolist(), value[reached].tolist(), strict=True))


def _one_at_a_time(sweep: Sweep) -> tuple[Floats, Floats | None, Floats | None]:
    """Largest factor on one joint's gains, then its largest diagonal kp and kd where there are such, all other gains as they are.

    A factor 1 + δ on joint i's gains adds δ T_ii to the determinant of the return difference, relative to itself, T = (I + L)⁻¹ L; a
    change δ of one of its diagonal gains adds δ times (I + L)⁻¹ P C e^{−sT} at (i, i), times what that gain multiplies.
    """
    loop = sweep.loop
    assert loop.parts is not None
    controller, size, sample_time = loop.parts.controller, loop.size, loop.sample_time
    units = []
    if isinstance(controller, PD | PID):
        others = {"ki": 0.0} if isinstance(controller, PID) else {}
        units = [replace(controller, kp=kp, kd=kd, **others) for kp, kd in ((1.0, 0.0), (0.0, 1.0))]

    def curves(omega: Floats) -> Complexes:
        s = 1j * omega
        v = loop.variable(s)
        actuated = loop.actuated_response(omega)
        law = loop.gain * controller.matrix(s, v, size, sample_time)
        sensitive = np.linalg.solve(np.eye(size) + actuated @ law, actuated)
        own = np.diagonal(sensitive, axis1=1, axis2=2)
        alone = [own * unit.matrix(s, v, 1, sample_time)[:, 0] for unit in units]
        return np.hstack([np.einsum("kij,kji->ki", sensitive, law), *alone])

    rooms = room(sweep, curves).reshape(-1, size)
    if not units:
        return 1 + rooms[0], None, None
    kp, kd = (np.diagonal(gain_matrix(name, getattr(controller, name), size)) * loop.gain for name in ("kp", "kd"))
    return 1 + rooms[0], kp + rooms[1], kd + rooms[2]


def room(sweep: Sweep, curves: Curves) -> Floats:
    """(m,) the smallest δ > 0 with 1 + δ c(jω) = 0 for each curve c: where it first meets the negative real axis; inf where none does."""
    size = sweep.loop.size

    def curves_in_blocks(omega: Floats) -> Complexes:
        return in_blocks(curves, omega, size)

    omega, values = _resolved(sweep, curves_in_blocks)
    least = _least(values)
    crosses = ((values.imag[1:] > 0) != (values.imag[:-1] > 0)) & ((values.real[1:] < 0) | (values.real[:-1] < 0))
    room = np.full(values.shape[1], math.inf)
    if sweep.last is not None:
        at_end = curves(np.array([sweep.last]))[0].real
        room = np.where(at_end < -least, -1 / np.minimum(at_end, -least), room)
    rows, joints = np.nonzero(_foremost(values, crosses))
    value = on_axis(curves, joints, (omega[rows], values[rows, joints]), (omega[rows + 1], values[rows + 1, joints]))
    for joint, found in zip(joints.tolist(), value.tolist(), strict=True):
        if found.real < -least[joint]:
            room[joint] = min(room[joint], -1 / found.real)
    return room


def _least(values: Complexes) -> Floats:
    """(m,) below which a curve is not followed: gains have units, so it is measured by the curve itself."""
    return np.maximum(FAINTEST * np.abs(values).max(axis=0), 1e-300)


def _foremost(values: Complexes, crosses: Booleans) -> Booleans:
    """Of the steps (k − 1, m) that cross the real axis, those that may hold a curve's leftmost crossing."""
    spread = 1 + RELATIVE_MOVE  # how far beyond its ends a step may reach
    left = spread * np.minimum(values.real[:-1], values.real[1:])
    surely = np.where(crosses, np.maximum(values.real[:-1], values.real[1:]) / spread, 0.0).min(axis=0, initial=0.0)
    return crosses & (left <= surely)


def on_axis(curves: Curves, joints: Integers, low: tuple[Floats, Complexes], high: tuple[Floats, Complexes]) -> Complexes:
    """The real values of curves between samples (ω, c) on two sides of the real axis, by the Illinois method."""
    (left, value), (right, other) = low, high
    first, second = value.imag, other.imag
    moved_left, moved_right = np.zeros(len(joints), dtype=bool), np.zeros(len(joints), dtype=bool)
    for _ in range(20 if len(joints) else 0):
        share = np.divide(first, first - second, out=np.full(len(joints), 0.5), where=first != second)
        omega = left + share * (right - left)
        value = curves(omega)[np.arange(len(joints)), joints]
        if np.all(np.abs(value.imag) <= 1e-14 * np.abs(value)):
            break
        same = (value.imag > 0) == (first > 0)
        left, right = np.where(same, omega, left), np.where(same, right, omega)
        # An end that stays for a second time counts half: else it might stay for ever
        first = np.where(same, value.imag, np.where(moved_right, 0.5 * first, first))
        second = np.where(same, np.where(moved_left, 0.5 * second, second), value.imag)
        moved_left, moved_right = same, ~same
    return value


def _resolved(sweep: Sweep, curves: Curves) -> tuple[Floats, Complexes]:
    """Samples of the curves fine enough where they come near the negative real axis."""
    omega = sweep.omega
    values = curves(omega)
    for _ in range(12):
        start, end = values[:-1], values[1:]
        size = np.maximum(np.abs(start), np.abs(end))
        near = (np.minimum(start.real, end.real) < 0) & (np.minimum(np.abs(start.imag), np.abs(end.imag)) < size)
        rough = np.any(near & (np.abs(end - start) > RELATIVE_MOVE * size) & (size > _least(values)), axis=1)
        rough &= np.diff(omega) > 1e-9 * omega[1:]
        if not rough.any() or len(omega) > MOST:
            break
        spots = np.flatnonzero(rough)
        middle = 0.5 * (omega[spots] + omega[spots + 1])
        values, omega = np.insert(values, spots + 1, curves(middle), axis=0), np.insert(omega, spots + 1, middle)
    return omega, values
