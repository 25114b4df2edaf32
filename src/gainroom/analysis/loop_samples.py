"""Samples of the frequency response of coupled loops, taken in the core with any gains along joints or directions (loop_curves.hpp).

Limbs on a fixed base are uncoupled: each uncoupled group of joints has samples of its own.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..native import _core
from ..system.filters import integrator
from ..system.linear.arrays import Booleans, Floats, Integers
from ..system.linear.state_space import hold, split_delay
from ..system.loop import Loop
from ..system.measured_response import measured_state
from ..system.mode_functions import mode_functions
from .margin_record import GainLimit, Margins, OneLoop
from .stability_boundary import LEAN, TILT, Boundary, first_grid
from .uncoupled_groups import uncoupled_groups

AT_REST = 1e-6
"""Share of the lowest frequency sampled at which loops under gravity are at rest."""

FAST = 1e-2
"""Share of |A| from which on Hessenberg form loses at most about five digits of a response (actuated.hpp)."""


@dataclass(frozen=True)
class Reach:
    """Distance from −1 up to which loci and return ratios are sampled; margins beyond it are reported as infinite.

    factor   > 1, on gains, up or down
    phase    [rad]
    peaks    (slope, offset, ceiling) of |slope S_ii + offset|: below the ceiling it is sampled coarsely
    """

    factor: float = 1.5
    phase: float = 0.3
    peaks: tuple[tuple[float, float, float], ...] = ()

    def wider(self, other: "Reach") -> "Reach":
        """The smallest reach that contains both."""
        return Reach(max(self.factor, other.factor), max(self.phase, other.phase), self.peaks + other.peaks)

    @property
    def peak(self) -> float:
        """Least |S_ii − 1/2| of a peak that is searched."""
        sizes = ((high - abs(offset + slope / 2)) / abs(slope) for slope, offset, high in self.peaks if slope)
        return max(0.05, min(sizes, default=math.inf))


WHOLE = Reach(100.0, math.pi, ((1.0, 0.0, 0.5),))
"""Reach of samples for every margin that a search for gains reports."""


@dataclass(frozen=True)
class LoopsApart:
    """Loops of uncoupled groups of joints, `size` in all: the joints (g,) and the loop of each group."""

    size: int
    loops: tuple[tuple[Integers, "_core.DirectedLoop"], ...]


class SamplesApart:
    """Samples of each group of `loops`, with gains (3, m) of all joints; the methods are those of the core's samples (_core.Look)."""

    def __init__(self, loops: LoopsApart, gains: Floats, reach: Reach, between: bool, smooth: bool) -> None:
        self._size = loops.size
        self._groups = [(joints, _take(loop, gains[:, joints], reach, between, smooth)) for joints, loop in loops.loops]

    @property
    def followed(self) -> bool:
        return all(one.followed for _, one in self._groups)

    @property
    def singular(self) -> bool:
        return any(one.singular for _, one in self._groups)

    @property
    def unstable(self) -> int:
        counts = [one.unstable for _, one in self._groups]
        return sum(counts) if min(counts) >= 0 else min(counts)  # one that cannot be is not made up for by another

    @property
    def samples(self) -> int:
        return sum(one.samples for _, one in self._groups)

    def tell_apart(self, factor: float, phase: float) -> None:
        for _, one in self._groups:
            one.tell_apart(factor, phase)

    def least(self, apart: bool = True) -> tuple[float, float, float, float, float, float]:
        found = [one.least(apart) for _, one in self._groups]
        peak, omega = max((each[4:] for each in found), key=lambda each: each[0])
        factor, one_factor, phase, one_phase = np.min([each[:4] for each in found], axis=0).tolist()
        return factor, one_factor, phase, one_phase, peak, omega

    def peak(self, slope: float, offset: float) -> tuple[float, float]:
        return max((one.peak(slope, offset) for _, one in self._groups), key=lambda each: each[0])

    def delay_crossings(self, longest: float) -> Floats:
        return np.concatenate([one.delay_crossings(longest) for _, one in self._groups])

    def one_loop(self) -> Floats:
        found = np.empty((self._size, 4))
        for joints, one in self._groups:
            found[joints] = one.one_loop()
        return found

    def one_loop_crossings(self, which: int) -> Floats:
        joints, one = self._group_of(which)
        return one.one_loop_crossings(int(np.searchsorted(joints, which)))

    def common_factors(self) -> Floats:
        found = np.array([one.common_factors() for _, one in self._groups])
        return found[np.argmin(found[:, :, 0], axis=0), np.arange(2)]

    def passing_factors(self) -> Floats:
        return np.concatenate([one.passing_factors() for _, one in self._groups])

    def phases(self, locus: bool) -> Floats:
        return self._by_joint(lambda one: one.phases(locus))

    def sensitivities(self) -> Floats:
        return self._by_joint(lambda one: one.sensitivities())

    def _by_joint(self, of: "Callable[[_core.Look], Floats]") -> Floats:
        """Rows (c, 3) that `of` returns for each group, stacked; in column 0 a joint index within the group becomes that of the robot."""
        return np.vstack(
            [np.column_stack([joints[rows[:, 0].astype(int)], rows[:, 1:]]) for joints, one in self._groups for rows in [of(one)]]
        )

    def common_phase(self) -> tuple[float, float]:
        return min((one.common_phase() for _, one in self._groups), key=lambda each: abs(each[0]))

    def crossed(self, lag: float) -> int:
        return sum(one.crossed(lag) for _, one in self._groups)

    def one_loop_count(self, joint: int, change: float, gain: int) -> int:
        joints, one = self._group_of(joint)
        return one.one_loop_count(int(np.searchsorted(joints, joint)), change, gain)

    def _group_of(self, joint: int) -> tuple[Integers, "_core.Look"]:
        return next((joints, one) for joints, one in self._groups if joint in joints)

    def growths(self, gain: int) -> Floats:
        found = np.empty((self._size, 1))
        for joints, one in self._groups:
            found[joints] = one.growths(gain)
        return found

    def crossings(self, gains: Floats, locus: bool, axis: bool, reach: float, until: float = 0.0) -> tuple[Floats, Floats]:
        return self._of_all(gains, lambda one, own: one.crossings(own, locus, axis, reach, until))

    def delays(self, gains: Floats, longest: float) -> tuple[Floats, Floats]:
        return self._of_all(gains, lambda one, own: one.delays(own, longest))

    def peaks(self, gains: Floats, least: float, slope: float, offset: float, until: float = math.inf) -> tuple[Floats, Floats]:
        return self._of_all(gains, lambda one, own: one.peaks(own, least, slope, offset, until))

    def ends(self, gains: Floats, locus: bool, reach: float) -> tuple[Floats, Floats]:
        return self._of_all(gains, lambda one, own: one.ends(own, locus, reach))

    def _of_all(self, gains: Floats, of: "Callable[[LoopSamples, Floats], tuple[Floats, Floats]]") -> tuple[Floats, Floats]:
        """Margins and ω (c, 2) of all groups, and the margins' derivatives by the gains of all joints (c, 2 m)."""
        margins, moves = [], []
        for joints, one in self._groups:
            margin, own = of(one, np.ascontiguousarray(gains[:, joints]))
            whole = np.zeros((len(own), 2, self._size))
            whole[:, :, joints] = own.reshape(len(own), 2, len(joints))
            margins.append(margin)
            moves.append(whole.reshape(len(own), 2 * self._size))
        return np.concatenate(margins), np.concatenate(moves)


Directed = _core.DirectedLoop | LoopsApart
LoopSamples = _core.Look | SamplesApart


def take_samples(loop: Directed, gains: Floats, reach: Reach, between: bool = False, smooth: bool = True) -> LoopSamples:
    """Samples of the loop with gains (3, m), kp, kd and ki of every direction (kp, kv, ki of a P/PI), as far as `reach` asks.

    `between`: on other samples than without it, halfway between its first ones; `smooth`: False for a root count alone.
    """
    if isinstance(loop, LoopsApart):
        return SamplesApart(loop, gains, reach, between, smooth)
    return _take(loop, gains, reach, between, smooth)


def _take(loop: "_core.DirectedLoop", gains: Floats, reach: Reach, between: bool, smooth: bool) -> "_core.Look":
    return _core.Look(loop, np.ascontiguousarray(gains), reach.factor, reach.phase, reach.peak, between, smooth)


def lag_about(loop: Directed, gains: Floats, omega: float) -> tuple[float, float]:
    """Common phase lag [rad] with which the locus nearest to −1 at `omega` [rad/s] passes through −1, and the frequency [rad/s] of that.

    NaN, both, if the locus cannot be followed.
    """
    if isinstance(loop, LoopsApart):
        found = [lag_about(one, gains[:, joints], omega) for joints, one in loop.loops]
        return min(found, key=lambda each: math.inf if math.isnan(each[0]) else abs(each[0]))
    return loop.lag_about(np.ascontiguousarray(gains), omega)


def margins_of_samples(samples: LoopSamples, size: int, apart: bool = True) -> Margins:
    """Gain and phase margins and peak sensitivity of `size` joints from samples; the other margins are NaN.

    `apart`: also those of loci that nearly meet. Gains: the lesser of the factors up and down stands under both names, and the least over
    all loops for each. Where loci cannot be followed all margins are unknown, so that no requirement is met. inf: beyond the reach of the
    samples.
    """
    if not samples.followed or samples.unstable != 0:
        return Margins.unknown(GainLimit.unknown(size, stable=not samples.singular and samples.unstable <= 0))
    common, single, phase, one_phase, peak, omega = samples.least(apart)
    if not samples.followed:  # counting roots took too many samples
        return Margins.unknown(GainLimit.unknown(size))
    factor, every = math.exp(common), np.full(size, math.exp(single))
    limit = replace(GainLimit.unknown(size), gain=factor, lower_gain=1 / factor)
    one_loop = OneLoop(every, 1 / every, np.full(size, one_phase), np.zeros(size, dtype=bool))
    return Margins(limit, one_loop, phase_margin=phase, peak_sensitivity=peak, peak_sensitivity_frequency=omega)


def joint_loops(loop: Loop, cascade: bool = False) -> Directed:
    """Loop in the core with the joints as directions, or one such loop per group of joints if groups are uncoupled.

    cascade   True: the gains are those of a P/PI
    """

    def directed(loop: Loop, by_modes: bool) -> "_core.DirectedLoop":
        return directed_loop(loop, np.eye(loop.size), np.eye(loop.size), np.full(loop.size, cascade), by_modes)

    apart = uncoupled_groups(loop)
    return LoopsApart(loop.size, tuple((joints, directed(limb, False)) for joints, limb in apart)) if apart else directed(loop, True)


def directed_loop(
    loop: Loop, torque: Floats, jacobian: Floats, cascade: Booleans, by_modes: bool = True, by_direction: bool = False, own: bool = True
) -> "_core.DirectedLoop":
    """Loop in the core without its gains, from a loop of parts: L = P C e^{−sT} X Δ E, X (n, m) = torque, E (m, n) = jacobian.

    by_modes       P as a sum over modes, where that is exact: worth finding them where the plant is large, or sampled many times
    by_direction   one loop at a time is one of the m directions, (I + E P C e^{−sT} X Δ)⁻¹ its sensitivities, in place of a joint
    own            directions that are the joints are taken as such
    """
    assert loop.parts is not None
    plant, drives, time = loop.parts.plant, loop.parts.drives, loop.sample_time
    joints = own and torque.shape[0] == torque.shape[1] and np.array_equal(torque, np.eye(len(torque))) and np.array_equal(jacobian, torque)
    nothing = np.zeros((0, 0))
    modes = mode_functions(loop.parts) if by_modes else None
    found = _core.DirectedLoop(loop.size, *((nothing, nothing) if joints else (torque, jacobian)), cascade.astype(np.int64), by_direction)
    if time is None:
        gravity, soft, (root, hung) = plant.gravity_stiffness, plant.compliance, plant.hung
        found.set_plant(
            plant.link_inverse_inertia,
            np.array([plant.motor_inertia, plant.stiffness, plant.damping, plant.motor_viscous, plant.link_viscous]),
            np.ascontiguousarray(root),
            nothing if gravity is None else gravity,
            np.ascontiguousarray(hung),
            np.zeros((2, 0)) if soft is None else np.array([soft.stiffness, soft.damping]),
            np.array([[drive.bandwidth, drive.damping_ratio, drive.delay] for drive in drives]).T.copy(),
            loop.parts.feedback.motor,
        )
    else:
        if modes is not None:  # by which all is known along the boundary
            held = _core_form(nothing, np.zeros((0, loop.size)), np.zeros((loop.size, 0)))
        else:  # motors' positions as states of their own: as sums of links and twists they lose digits in Hessenberg form
            fraction = split_delay(loop.parts.delays, time)[1]
            state = hold(measured_state(loop.parts, twists=False), fraction * time, time)
            held = _core_form(state.a, state.b, state.c)
        found.set_held(*held, loop.ticks * time, time)
    controller, boundary = loop.parts.controller, Boundary(loop)
    if modes is not None:
        found.set_modes(modes)
    shaping = controller.shaping(time)
    found.set_law(*controller.velocity(time), *integrator(time), shaping.zeros, shaping.poles, shaping.gain)
    settles = AT_REST if plant.gravity_stiffness is not None else 0.0
    found.set_boundary(first_grid(loop, boundary.last), boundary.leaning, TILT, LEAN, loop.unstable_poles, settles)
    return found


def _core_form(a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats, float]:
    """State space A, B, C, then the same in balanced Hessenberg form, then the least |v| [1/s] from which that form is exact enough."""
    from scipy.linalg import hessenberg, matrix_balance

    if not len(a):
        return a, b, c, a, b, c, 0.0
    balanced, (scale, _) = matrix_balance(a, permute=False, separate=True)
    form, turn = hessenberg(balanced, calc_q=True)
    return a, b, c, form, turn.T @ (b / scale[:, None]), (c * scale) @ turn, FAST * float(np.linalg.norm(a, 2))
