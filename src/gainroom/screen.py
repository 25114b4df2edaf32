"""How far one gain of many may go, told quickly: the responses of coupled loops on a fixed grid, changed by one direction at a time.

Gains act along directions: joints, or those of tasks. L = P X Δ E with P from torque to position, X (n, m) from direction to torque,
E (m, n) from position to direction, Δ = diag(d_j(s)) what the gains make of each. A change δ of d_j alone changes all else by rank one:

    det(I + z L') = det(I + z L) (1 + δ h),   h = z (E (I + z L)⁻¹ P X)_jj,        S' = S − δ u w / (1 + δ h),
    u = (S P X)_j,  w = (E S)_j   at z = 1

So from loops that keep a margin, those with a changed d_j keep it, too, where δ h stays off the ray (−∞, −1] for the margin's own z: then
no root reaches the boundary anywhere on the way. What a grid says is not certified; it says what to look at (kept.py).
"""

import cmath
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from .arrays import Booleans, Complexes, Floats, Integers
from .controller import PD, PID, PPI, integrator
from .forbidden import Requirements
from .kept import Kept, kept_at_most, kept_where
from .loop import Loop

Gains = Floats
"""(3, m): kp, kd and ki of every direction; of a P/PI one kp, kv and ki."""
FAR = 0.3  # of its size, or of 1: the largest move of a closed loop's response between samples
FAINT = 3.0
MOVE = 0.1  # of a sensitivity, near what is allowed: above HIGH times that
HIGH = 0.75
CLOSEST = 1e-6  # relative distance of samples at which refinement stops
PER_DECADE = 30  # samples to begin with
THINNED = 3  # every so many of the samples that a full look took
MOST = 4000  # samples
NEARLY = 0.95  # of the way to where a margin is lost: beyond it what samples say is in doubt, and what is lost unseen is lost for good
REAL = 0.1  # share of imaginary part that a value at the end of the boundary may have and still count as real


@dataclass(frozen=True, eq=False)
class Case:
    """One state of a machine, in which gains have to keep something.

    title      for messages
    loop       gains (3, m) → the loop
    torque, jacobian   X (n, m), E (m, n)
    cascade    (m,) True for directions that are P/PI
    required   what has to be kept; nothing: stability alone
    """

    title: str
    loop: Callable[[Gains], Loop]
    torque: Floats
    jacobian: Floats
    cascade: Booleans
    required: Requirements
    _known: dict[bytes, Kept] = field(default_factory=dict, repr=False, compare=False)
    _samples: list[Floats] = field(default_factory=list, repr=False, compare=False)

    def kept(self, gains: Gains) -> Kept:
        """What the loop with these gains keeps; looked at once."""
        key = gains.tobytes()
        if key not in self._known:
            self._known[key], omega = kept_where(self.loop(gains))
            self._samples[:] = [omega]
        return self._known[key]

    def holds(self, gains: Gains) -> bool:
        """Whether that is all that is required."""
        return self.kept(gains).meets(self.required)

    def samples(self, gains: Gains) -> Floats:
        """Where to look [rad/s]: what the last look took."""
        if not self._samples:
            self.kept(gains)
        return self._samples[0]

    def missed_at_a_glance(self, gains: Gains) -> Kept | None:
        """What is kept at most, where a quick look sees that it is less than required; else None, which says nothing."""
        known = self._known.get(gains.tobytes()) or kept_at_most(self.loop(gains), self.samples(gains), self.required)
        return None if known.meets(self.required) else known


def misses(cases: Sequence[Case], gains: Gains, progress: Callable[[], None]) -> Iterator[tuple[Case, Kept]]:
    """Cases that miss what is required, with what they keep at most; nothing where all keep it. Where quick looks see some, those alone."""
    seen = False
    for case in cases:
        kept = case.missed_at_a_glance(gains)
        progress()
        if kept is not None:
            seen = True
            yield case, kept
    for case in () if seen else cases:
        kept = case.kept(gains)
        progress()
        if not kept.meets(case.required):
            yield case, kept


@dataclass(frozen=True)
class _Grid:
    """Per frequency: (V, I, N) (k, 3); h's matrix of every target (k, z, m, m); P X (k, n, m), empty where X = 1; S_ii (k, n)."""

    shape: Complexes
    mobility: Complexes
    reached: Complexes
    own: Complexes

    def inserted(self, places: Integers, more: "_Grid") -> "_Grid":
        """With more frequencies before `places`."""
        return _Grid(*(np.insert(getattr(self, name), places, getattr(more, name), axis=0) for name in self.__dataclass_fields__))


class Screen:
    """One case at gains that hold there, along the boundary; the grid follows what the gains do to the responses."""

    def __init__(self, case: Case, gains: Gains, omega: Floats, most: float) -> None:
        """omega   (k,) [rad/s] rising: where to begin; `most`: the largest factor on a gain that is going to be asked for."""
        self.case = case
        self._loop, self._gains, self._most = case.loop(gains), gains, most
        self._plain = np.array_equal(case.torque, np.eye(len(case.torque)))  # every direction is a joint
        required = case.required
        targets: list[complex] = [1.0]
        if required.gain_margin is not None:
            targets += [required.gain_margin, 1 / required.gain_margin]
        if required.phase_margin is not None:
            targets += [cmath.exp(1j * required.phase_margin), cmath.exp(-1j * required.phase_margin)]
        self._targets: Complexes = np.array(targets, dtype=complex)
        spread = np.geomspace(omega[0], omega[-1], max(2, round(PER_DECADE * math.log10(omega[-1] / omega[0]))))
        self._first = np.union1d(np.union1d(omega[::THINNED], omega[-1:]), spread[1:-1])
        self._afresh()

    def _afresh(self) -> None:
        """The grid anew: peaks have moved on, and left their samples behind."""
        self.omega = self._first
        self._grid = self._at(self.omega)
        self._refine()
        self._enough = 2 * len(self.omega)

    @property
    def full(self) -> bool:
        """No more samples are taken: what happens between them is not known."""
        return len(self.omega) > MOST

    def _at(self, omega: Floats) -> "_Grid":
        """Everything at more frequencies."""
        loop, case = self._loop, self.case
        controller = loop.parts.controller if loop.parts is not None else None
        assert isinstance(controller, PD | PID | PPI)
        s = 1j * omega
        v = loop.variable(s)
        velocity, integral = (
            np.polyval(num, v) / np.polyval(den, v) for num, den in (controller.velocity(loop.sample_time), integrator(loop.sample_time))
        )
        shape = np.array([velocity, integral, controller.shaping(loop.sample_time).at(s)]).T
        law = self._law(shape, self._gains)
        reached = loop.actuated_at(s)
        seen = reached if self._plain else case.jacobian @ (reached := reached @ case.torque)
        eye = np.eye(seen.shape[1])
        mobility = np.stack([z * np.linalg.solve(eye + z * seen * law[:, None, :], seen) for z in self._targets], axis=1)
        if self._plain:
            return _Grid(shape, mobility, np.zeros((len(omega), 0)), 1 - np.einsum("kjj->kj", mobility[:, 0]) * law)
        sensed = case.jacobian - mobility[:, 0] @ (law[:, :, None] * case.jacobian)  # E S
        return _Grid(shape, mobility, reached, 1 - np.einsum("kij,kj,kji->ki", reached, law, sensed))

    def expect(self, most: float) -> None:
        """From now on no gain is asked for that is more than `most` times as large as it is."""
        self._most = most
        self._refine()

    def _refine(self) -> None:
        """Samples between those from which T_jj of any target, or S_ii, moves far where that matters.

        A gain times g meets the boundary only where |T_jj| is 1/(g − 1) or more.
        """
        for _ in range(16):
            grid = self._grid
            value = np.einsum("kzjj->kzj", grid.mobility) * self._law(grid.shape, self._gains)[:, None, :]
            size = np.maximum(np.abs(value[1:]), np.abs(value[:-1]))
            rough = (np.abs(np.diff(value, axis=0)) > FAR * np.maximum(size, min(1 / (self._most - 1), FAINT))).any(axis=(1, 2))
            moved, size = np.abs(np.diff(grid.own, axis=0)), np.abs(grid.own)
            high = np.maximum(size[1:], size[:-1]) > HIGH * (self.case.required.peak_sensitivity or math.inf)
            rough |= (moved > np.where(high, MOVE, FAR)).any(axis=1)
            rough &= np.diff(self.omega) > CLOSEST * self.omega[1:]
            if not rough.any() or self.full:
                return
            places = np.flatnonzero(rough)
            middle = 0.5 * (self.omega[places] + self.omega[places + 1])
            self._grid = grid.inserted(places + 1, self._at(middle))
            self.omega = np.insert(self.omega, places + 1, middle)

    def _law(self, shape: Complexes, gains: Gains) -> Complexes:
        """d (k, m) of directions with `gains` (3, m)."""
        kp, kd, ki = gains
        velocity, integral, shaping = shape.T[:, :, None]
        return shaping * np.where(self.case.cascade, (kd + ki * integral) * (kp + velocity), kp + kd * velocity)

    def allows(self, j: int, gains: Gains) -> bool:
        """Whether direction `j` may have its part (3,) of `gains`."""
        if self.full:
            return False
        change = self._delta(j, gains)[:, None] * self._grid.mobility[:, :, j, j]
        return not (_meets_ray(change, self._targets.imag == 0) or self._single_loops_break(self._changed_own(j, gains)))

    def take(self, j: int, gains: Gains) -> None:
        """From now on direction `j` has its part of `gains`; `settle` when that is sure."""
        own, delta, grid = self._changed_own(j, gains), self._delta(j, gains), self._grid
        share = delta[:, None] / (1 + delta[:, None] * grid.mobility[:, :, j, j])  # (k, z)
        column, row = grid.mobility[:, :, :, j].copy(), grid.mobility[:, :, j, :].copy()
        grid.mobility[:] -= (share[:, :, None] * column)[:, :, :, None] * row[:, :, None, :]
        grid.own[:] = own
        self._gains = self._gains.copy()
        self._gains[:, j] = gains[:, j]

    def settle(self) -> None:
        """After what has been taken stays: samples where peaks have come to."""
        self._refine()
        if len(self.omega) > self._enough:
            self._afresh()

    def _delta(self, j: int, gains: Gains) -> Complexes:
        """(k,) how d_j changes."""
        return (self._law(self._grid.shape, gains) - self._law(self._grid.shape, self._gains))[:, j]

    def _changed_own(self, j: int, gains: Gains) -> Complexes:
        """S_ii (k, n) with the part of `gains` in direction `j`."""
        grid, delta = self._grid, self._delta(j, gains)
        column, row, law = grid.mobility[:, 0, :, j], grid.mobility[:, 0, j, :], self._law(grid.shape, self._gains)
        share = delta / (1 + delta * column[:, j])
        if self._plain:
            sensed = -row * law  # (E S)_j = E_j − (E S P X)_j Δ E
            sensed[:, j] += 1
            return grid.own - share[:, None] * column * sensed
        sensed = self.case.jacobian[j] - (row * law) @ self.case.jacobian
        reached = grid.reached[:, :, j] - np.einsum("kij,kj->ki", grid.reached, law * column)  # (S P X)_j
        return grid.own - share[:, None] * reached * sensed

    def _single_loops_break(self, own: Complexes) -> bool:
        """Whether any loop by itself misses what is required."""
        required = self.case.required
        if required.peak_sensitivity is not None and np.abs(own).max() > required.peak_sensitivity:
            return True
        if required.gain_margin is None and required.phase_margin is None:
            return False
        value = 1 / np.where(own == 0, 1e-300, own) - 1
        if required.gain_margin is not None and _meets_segment(value, required.gain_margin):
            return True
        return required.phase_margin is not None and _meets_arc(value, required.phase_margin)


def _meets_ray(value: Complexes, is_real: Booleans) -> bool:
    """Whether curves (k, z) cross the real axis left of −1, or end there, or do so nearly."""
    rows, columns = np.nonzero(((value.imag[1:] > 0) != (value.imag[:-1] > 0)) & (np.minimum(value.real[1:], value.real[:-1]) < -NEARLY))
    start, end = value[rows, columns], value[rows + 1, columns]
    if np.any(start.real + start.imag / (start.imag - end.imag) * (end.real - start.real) < -NEARLY):
        return True
    ends = value[[0, -1]]
    return bool(np.any((ends.real < -NEARLY) & (np.abs(ends.imag) < REAL * np.abs(ends.real)) & is_real))


def _meets_segment(value: Complexes, margin: float) -> bool:
    """Whether curves (k, n) cross the real axis within [−g, −1/g], or end there."""
    real, imag = value.real, value.imag
    turn = (imag[1:] > 0) != (imag[:-1] > 0)
    rows, columns = np.nonzero(turn & (np.minimum(real[1:], real[:-1]) < 0))
    first, then = imag[rows, columns], imag[rows + 1, columns]
    place = real[rows, columns] + first / (first - then) * (real[rows + 1, columns] - real[rows, columns])
    if np.any((place > -margin) & (place < -1 / margin)):
        return True
    ends = value[[0, -1]]
    inside = (ends.real > -margin) & (ends.real < -1 / margin) & (np.abs(ends.imag) < 1e-2 * np.abs(ends.real))
    return bool(inside.any())


def _meets_arc(value: Complexes, margin: float) -> bool:
    """Whether curves (k, n) cross the unit circle at less than `margin` [rad] from −1."""
    size = np.log(np.maximum(np.abs(value), 1e-300))
    rows, columns = np.nonzero((size[1:] > 0) != (size[:-1] > 0))
    low, high = size[rows, columns], size[rows + 1, columns]
    start, end = value[rows, columns], value[rows + 1, columns]
    lag = np.angle(-start) + low / (low - high) * np.angle(end * start.conj())
    return bool(np.any(np.abs(np.angle(np.exp(1j * lag))) < margin))
