"""Peaks of the links' compliance along directions as functions of the gains, and their derivatives by every gain.

A load of 1 along direction j, E_jᵀ of the joints, moves that direction by c_j. Without gains the links yield by C₀ to loads, and motors'
torques τ act on them by ρ and on the motors by ρ and σ (analysis/link_compliance.py). Gains put τ = −G X Δ y on the motors: y = E θ, or E q
with encoders at the links; G the torque delivered per command, Δ = diag(d_j) the law of each direction. So

    c = A − B Δ (I + L Δ)⁻¹ D,   A = E C₀ Eᵀ,   B = E C₀ ρ G X,   L = E (ρ C₀ ρ + σ) G X,   D = E ρ C₀ Eᵀ

(encoders at the links: L = B, D = A), of which only Δ depends on gains: the rest is computed once for the frequencies that are evaluated.
At a peak of |c_j| its shift in frequency changes nothing to first order, so that its slopes are

    d ln |c_j| = Re(dc_j/c_j),   dc_j = −Σ_m [B (I + Δ L)⁻¹]_jm [(I + L Δ)⁻¹ D]_mj dd_m

For joints with gains of their own C = R (s² + RᵀYR)⁻¹ Rᵀ is simpler: dc_j = −Σ_m C_jm² (dY/dE)_m dE_m, dY/dE = (k/(J_m s² + E + k))².
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ..analysis.dynamic_stiffness import peaks
from ..analysis.link_compliance import LinkCompliance, held
from ..system.linear.arrays import Booleans, Complexes, Floats, Integers, diagonals, distinct
from ..system.loop import Loop
from ..system.modes import undamped

PER_DECADE = 40  # frequencies per decade: a parabola through three of 1/c finds a peak to a few percent of its width
BESIDE = np.array([-0.008, 0.0, 0.008])  # relative frequencies about the modes on the gains, with motors locked, and free
REST = (0.01, 0.1)  # lowest frequency, and that from which on all are looked at, relative to the slowest mode
ABOVE = 3.0  # highest frequency, relative to the highest elastic mode and to the lag's
SHARE = 0.5  # of a direction's highest peak, above which a peak has a tangent of its own
ROUNDS = 3  # most samples at a peak
SETTLED = 0.2  # change of ln of a gain up to which the frequencies of before are looked at
IMMOBILE = 1e-9  # mobility, relative to the largest, below which no load moves a direction
GEAR = 0.2
"""Sum of |∂ ln p/∂ ln gain| over all gains below which a gearbox limits a peak p: no gain moves it, its damping B alone does."""
PD_POWERS = {(0, 0): (1, 0), (1, 0): (0, 1), (0, 1): (1, 0)}
CASCADE_POWERS = {(0, 0): (1, 0), (1, 0): (0, 1), (0, 1): (2, -1), (1, 1): (1, 0)}
"""Powers of the factors on stiffness and on damping (margin_slopes.moved) in each gain term, of a PD and of a P/PI."""


@dataclass(frozen=True)
class SoftPeaks:
    """Peaks of the links' compliance: direction (p,), frequency (p,) [rad/s], ln of the height (p,), and its slopes (p, 2, m).

    Slopes by ln of each direction's stiffness, and of its damping, as margin_slopes.Slopes has them.
    """

    direction: Integers
    omega: Floats
    height: Floats
    slope: Floats

    def joined(self, other: "SoftPeaks") -> "SoftPeaks":
        """These peaks and those of `other`."""
        return SoftPeaks(*(np.concatenate([getattr(one, each.name) for one in (self, other)]) for each in fields(self)))

    @property
    def gear_limited(self) -> Booleans:
        """Mask (p,), True for peaks whose height no gain changes by more than GEAR: the gearbox alone limits them."""
        return np.abs(self.slope).sum(axis=(1, 2)) < GEAR

    def softest(self, size: int) -> tuple[Floats, Floats, Booleans]:
        """Highest peak of each of `size` directions: dynamic stiffness (m,), frequency (m,) [rad/s], whether a gearbox limits it (m,).

        NaN, and False, where a direction has no peak: no load moves it.
        """
        (stiffness, omega), geared = np.full((2, size), math.nan), np.zeros(size, bool)
        rising = np.argsort(self.height)
        highest = dict(zip(self.direction[rising].tolist(), rising.tolist(), strict=True))
        some, k = list(highest), list(highest.values())
        stiffness[some], omega[some], geared[some] = np.exp(-self.height[k]), self.omega[k], self.gear_limited[k]
        return stiffness, omega, geared


@dataclass(frozen=True)
class _Open:
    """Responses at frequencies omega (k,) [rad/s] that do not depend on gains.

    signals      (k,) response from position to torque command for a gain of 1, by powers of velocity and integral (controller.py)
    sent         (k, n) motor torque per torque command; used if the directions are the joints
    a, b, loop, d   (k, m, m) A, B, L and D of the module; None if the directions are the joints
    """

    omega: Floats
    signals: dict[tuple[int, int], Complexes]
    sent: Complexes
    a: Complexes | None = None
    b: Complexes | None = None
    loop: Complexes | None = None
    d: Complexes | None = None

    @classmethod
    def at_each(cls, omega: Floats, parts: "Sequence[_Open]") -> "_Open":
        """Responses at `omega` (p,) [rad/s], picked from `parts`, which contain each of these frequencies."""
        every = np.concatenate([one.omega for one in parts])
        order = np.argsort(every, kind="stable")
        rows = order[np.searchsorted(every, omega, sorter=order)]

        def taken(values: Sequence[Complexes]) -> Complexes:
            return np.concatenate(values)[rows] if len(values) > 1 else values[0][rows]

        names = ("sent",) if parts[0].a is None else ("sent", "a", "b", "loop", "d")
        signals = {powers: taken([one.signals[powers] for one in parts]) for powers in parts[0].signals}
        return cls(omega, signals, **{name: taken([getattr(one, name) for one in parts]) for name in names})


class DirectedCompliance:
    """Compliance along directions as a function of their gains (3, m): kp, kd and ki, of a P/PI kp, kv and ki.

    loop               with any gains; kd on the path of the other gains
    torque, jacobian   X (n, m), E (m, n); identity matrices where directions are joints
    cascade            (m,) True for directions that are P/PI
    """

    def __init__(self, loop: Loop, torque: Floats, jacobian: Floats, cascade: Booleans) -> None:
        assert loop.parts is not None
        loop.require_one_path("compliance by gains")
        self._links, self._template = LinkCompliance.of(loop), loop.parts.controller
        self._torque, self._jacobian, self.cascade = torque, jacobian, cascade
        eye = np.eye(len(torque))
        self._joints = np.array_equal(torque, eye) and np.array_equal(jacobian, eye) and not cascade.any()
        self._powers = tuple(self._template.terms())
        self._more = np.zeros(0)
        self._grid: list[tuple[Floats, _Open]] = []  # gains, and samples at frequencies that suit them

    @cached_property
    def moved(self) -> Booleans:
        """Mask (m,) of the directions along which a load moves the links."""
        mobility = ((self._jacobian @ self._root) ** 2).sum(axis=1)
        return mobility > IMMOBILE * mobility.max(initial=0.0)

    def search_near(self, omega: Floats) -> None:
        """Adds frequencies around `omega` [rad/s] to those at which peaks are searched from now on."""
        self._more = np.concatenate([self._more, *(omega * (1 + beside) for beside in BESIDE / 4)])
        self._grid.clear()

    def held(self, gains: Floats) -> Booleans:
        """Mask (m,) of the directions that a load moves and a stiffness holds."""
        return self.moved & (gains[0] > 0)

    def peaks(self, gains: Floats, share: float = SHARE, above: float = 0.0) -> SoftPeaks:
        """Peaks with these gains, whose loop is stable, that reach `share` of each direction's highest.

        above   frequency [rad/s] of a sway that something else holds: peaks below it are left out, and each joint yields at rest by its
                own gain and gearbox alone, 1/kp + 1/K
        """
        held, parts = self.held(gains), [self._sampled(gains)]
        if above > 0:
            parts[0] = _Open.at_each(parts[0].omega[parts[0].omega > above], parts)

        def response(omega: Floats) -> Complexes:
            if omega is not parts[0].omega:
                parts.append(self._open(omega))
            return self._along(parts[-1], gains) * held

        found = peaks(response, parts[0].omega, share, ROUNDS)
        slope = self._sloped(_Open.at_each(found.omega, parts), found.joint, gains)
        moving = SoftPeaks(found.joint, found.omega, np.log(found.height), slope)
        return moving.joined(self._resting(gains, held)) if above > 0 else moving

    def _resting(self, gains: Floats, held: Booleans) -> SoftPeaks:
        """Compliance of each joint `held` at rest, the others locked."""
        joints, parts = np.flatnonzero(held), self._links.parts
        own = 1 / gains[0, joints]
        yielding = parts.plant.elastic[joints] & parts.feedback.motor
        springs = np.where(yielding, 1 / parts.plant.stiffness[joints], 0.0)
        slope = np.zeros((len(joints), 2, gains.shape[1]))
        slope[np.arange(len(joints)), 0, joints] = -own / (own + springs)
        return SoftPeaks(joints, np.zeros(len(joints)), np.log(own + springs), slope)

    def along(self, omega: Floats, gains: Floats) -> Complexes:
        """Compliance c (k, m) along each direction at omega (k,)."""
        return self._along(self._open(omega), gains)

    def slopes(self, omega: Floats, direction: Integers, gains: Floats) -> Floats:
        """Slopes (p, 2, m) of ln |c| of one direction at each frequency, omega (p,), by ln of stiffness and of damping."""
        return self._sloped(self._open(omega), direction, gains)

    def _along(self, at: _Open, gains: Floats) -> Complexes:
        law = self._law(at, self._terms(gains))
        if at.a is None or at.b is None or at.loop is None or at.d is None:
            s = 1j * at.omega
            return self._links.on(s, self._links.stiffness(s, at.sent * law), whole=False)
        closed = at.loop * law[:, None, :]
        diagonals(closed)[:] += 1
        felt = law[:, :, None] * np.linalg.solve(closed, at.d)
        return np.diagonal(at.a, axis1=1, axis2=2) - np.einsum("kij,kji->ki", at.b, felt)

    def _sloped(self, at: _Open, direction: Integers, gains: Floats) -> Floats:
        """Slopes (p, 2, m) of ln |c| of one direction at each frequency."""
        rows, terms = np.arange(len(at.omega)), self._terms(gains)
        law = self._law(at, terms)
        if at.a is None or at.b is None or at.loop is None or at.d is None:
            s = 1j * at.omega
            whole = self._links.on(s, self._links.stiffness(s, at.sent * law)).reshape(len(s), law.shape[1], law.shape[1])
            row = whole[rows, direction]
            hold = np.abs(held(s, self._links.parts.sample_time))[:, None]  # in C, of which the product has two
            changes = -(row**2) * self._links.passed(s, at.sent * law) * at.sent / (row[rows, direction][:, None] * hold)
        else:
            closed = at.loop * law[:, None, :]
            diagonals(closed)[:] += 1
            seen = np.linalg.solve(closed, at.d[rows, :, direction][:, :, None])[:, :, 0]
            acting = at.b[rows, direction]
            own = at.a[rows, direction, direction] - (acting * law * seen).sum(axis=1)
            # B (I + ΔL)⁻¹ = B − (BΔ)(I + LΔ)⁻¹ L
            felt = np.linalg.solve(closed.swapaxes(1, 2), (acting * law)[:, :, None])[:, :, 0]
            changes = -(acting - np.einsum("pi,pij->pj", felt, at.loop)) * seen / own[:, None]
        slope = np.empty((len(rows), 2, len(self.cascade)))
        for k in (0, 1):
            slope[:, k] = (changes * self._law(at, {powers: self._power(powers, k) * gain for powers, gain in terms.items()})).real
        return slope

    def _law(self, at: _Open, terms: dict[tuple[int, int], Floats]) -> Complexes:
        """Transfer function d_j (k, m) of each direction's controller, with gain `terms` (m,) by powers of velocity and integral."""
        return sum((at.signals[powers][:, None] * gain for powers, gain in terms.items()), np.zeros((1, len(self.cascade)), dtype=complex))

    def _power(self, powers: tuple[int, int], k: int) -> Floats:
        """Exponent (m,) with which a factor on the stiffness (k 0) or damping (k 1) enters the gain term `powers` of each direction."""
        of_pd, of_cascade = (table.get(powers, (0, 0))[k] for table in (PD_POWERS, CASCADE_POWERS))
        return np.where(self.cascade, of_cascade, of_pd)

    def _terms(self, gains: Floats) -> dict[tuple[int, int], Floats]:
        """Gain (m,) of each term that the controller has, by its powers of velocity and integral (controller.py)."""
        kp, kd, ki = gains
        cascade = self.cascade
        every = {
            (0, 0): np.where(cascade, kp * kd, kp),
            (1, 0): kd,
            (0, 1): np.where(cascade, ki * kp, ki),
            (1, 1): np.where(cascade, ki, 0.0),
        }
        return {powers: every[powers] for powers in self._powers}

    def _open(self, omega: Floats) -> _Open:
        s, parts = 1j * omega, self._links.parts
        step, links = parts.sample_time, self._links
        v = s if step is None else np.expm1(s * step) / step
        signals = {powers: self._template.signal(powers, s, v, step) for powers in self._powers}
        sent = links.delivered(s, parts.delays, step)
        if self._joints:
            return _Open(omega, signals, sent)
        loads, share, own = links.open(s)
        seen = self._jacobian @ loads
        a = seen @ self._jacobian.T
        torque = sent[:, :, None] * self._torque
        by_motors = share[:, :, None] * torque
        hold = np.abs(held(s, step))[:, None, None]
        b = seen @ by_motors
        if parts.feedback.link:
            return _Open(omega, signals, sent, a, b, b / hold, a)
        turned = (self._jacobian * share[:, None, :]) @ loads
        loop = (turned @ by_motors) / hold + self._jacobian @ (own[:, :, None] * torque)
        return _Open(omega, signals, sent, a, b, loop, turned @ self._jacobian.T / hold)

    def _sampled(self, gains: Floats) -> _Open:
        """Responses at the frequencies of `_frequencies` for these gains, or for similar gains if these were sampled before."""
        if self._grid:
            before, moving = self._grid[0][0], gains > 0
            if np.array_equal(moving, before > 0) and np.abs(np.log(gains[moving] / before[moving])).max(initial=0.0) < SETTLED:
                return self._grid[0][1]
        self._grid[:] = [(gains, self._open(self._frequencies(gains)))]
        return self._grid[0][1]

    def _frequencies(self, gains: Floats) -> Floats:
        """Frequencies (k,) [rad/s], rising, at which peaks are searched: a wide grid from far below the slowest mode, denser at modes.

        Modes are the undamped ones with the motors held by `gains`, and those on the gearboxes; frequencies of `search_near` are added.
        """
        stiff = (self._torque * self._terms(gains)[0, 0]) @ self._jacobian
        plant = self._links.parts.plant
        springs = np.linalg.solve(np.eye(len(stiff)) + stiff * np.where(plant.elastic, 1 / plant.stiffness, 0.0), stiff)
        held = undamped(self._mass, self._root.T @ springs @ self._root + self._beside)[0]
        squares = held[held > IMMOBILE * held.max(initial=0.0)]
        slowest = math.sqrt(float(squares.min(initial=self._highest**2)))
        first, last = REST[1] * min(slowest, self._highest), min(self._highest, self._links.fastest)
        wide = np.geomspace(first, last, max(2, math.ceil(PER_DECADE * math.log10(last / first))))
        modes = np.concatenate([np.sqrt(squares), self._elastic])
        beside = (modes[:, None] * (1 + BESIDE)).ravel()
        grid = np.concatenate([[REST[0] / REST[1] * first], wide, beside, self._more])
        return distinct(grid[(grid <= last) & (grid > 0)])

    @cached_property
    def _root(self) -> Floats:
        return self._links.parts.plant.hung[0]

    @cached_property
    def _mass(self) -> Floats:
        """Mass matrix (r, r) of links and motors in the coordinates ξ of the links, q = R ξ."""
        root = self._root
        return np.eye(root.shape[1]) + root.T @ (self._links.parts.plant.motor_inertia[:, None] * root)

    @cached_property
    def _beside(self) -> Floats:
        """Stiffness matrix (r, r) of gravity and of springs under contacts, in the coordinates ξ of the links."""
        plant, (root, rest) = self._links.parts.plant, self._links.parts.plant.hung
        found = np.zeros((root.shape[1],) * 2)
        if plant.gravity_stiffness is not None:
            found += root.T @ plant.gravity_stiffness @ root
        if plant.compliance is not None:
            found += rest.T @ (plant.compliance.stiffness[:, None] * rest)
        return found

    @cached_property
    def _elastic(self) -> Floats:
        """Undamped natural frequencies [rad/s] of links and motors on gearboxes: free, and with the positions that gains act on held."""
        plant = self._links.parts.plant
        if not plant.elastic.any():
            return np.zeros(0)
        form = plant.mechanism()
        seen = self._jacobian @ (form.link_position if self._links.parts.feedback.link else form.motor_position)
        _, sizes, turn = np.linalg.svd(seen)
        rest = turn[int(np.count_nonzero(sizes > IMMOBILE * sizes.max(initial=0.0))) :].T
        found = [undamped(form.mass, form.stiffness)[0], undamped(rest.T @ form.mass @ rest, rest.T @ form.stiffness @ rest)[0]]
        every = np.concatenate(found)
        return np.sqrt(every[every > IMMOBILE * every.max(initial=0.0)])

    @cached_property
    def _highest(self) -> float:
        """Frequency [rad/s] above which no peak is searched: the loops' lag ends them, and links on their gearboxes vibrate no faster."""
        parts = self._links.parts
        lag = max(drive.delay + 2 * drive.damping_ratio / drive.bandwidth for drive in parts.drives) + (parts.sample_time or 0.0)
        return ABOVE * max(float(self._elastic.max(initial=0.0)), 1 / lag if lag else 1.0)
