"""The stable gains (kp, kd) of one part of a controller, one joint or one direction of a task, all other gains as they are.

Of a P/PI cascade kp is kv·kp and kd is kv, with ki/kv held: its plane (system/controller.py), as for one joint.

With D = D_0 + δ_p D_a + δ_d D_b, D_a and D_b of rank one with the same directions, det(I + L) is multiplied by f = 1 + δ_p a + δ_d b, with
a = tr((I + L)⁻¹ P C D_a) and b likewise. f(jω) = 0 are two real equations linear in the gains, one point per ω (D-decomposition; Neimark
1949; Ackermann 2002, ch. 4); the roots of the gains as they are have been counted, and every crossing changes that count by two.

Sampled, not certified: a picture of where gains can go. Certified margins of gains come from analysis/margins.py.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Booleans, Complexes, Floats, Integers, distinct
from ..system.loop import Loop
from ..system.loop_part import LoopPart
from .gain_plane import refined
from .gain_region import traced
from .stability import unstable_roots
from .stability_boundary import in_blocks, sensitivity

PER_DECADE = 60
LARGEST_STEP = 0.1  # largest step between samples, relative to the gains of the picture
ROUNDS, MOST = 9, 6000  # rounds of refinement, and samples at which it ends
BELOW = 1e-3  # lowest frequency sampled, relative to the lowest corner frequency
COLUMNS = 56


@dataclass(frozen=True)
class PartRegion:
    """Return difference of one part, f = 1 + δ_p a + δ_d b, along the stability boundary, around its present gains (kp, kd).

    omega   (k,) rising [rad/s]
    a, b    (k,) change of f per change of kp and of kd
    count   unstable roots with the present gains
    last    half the sample rate [rad/s]; None: continuous
    """

    omega: Floats
    a: Complexes
    b: Complexes
    kp: float
    kd: float
    count: int
    last: float | None

    @classmethod
    def of(cls, loop: Loop, part: LoopPart, window: tuple[float, float]) -> "PartRegion":
        """Plane of the gains (kp, kd) of `part` of a loop's controller, sampled finely enough for gains up to `window`.

        Raises GainroomError for a part without a kp–kd plane, and where the ratio that is held there divides by 0.
        """
        assert loop.parts is not None
        controller, left, right, own = loop.parts.controller, part.left, part.right, part.own
        kp, kd = own.plane_gains()

        def at(omega: Floats) -> Complexes:
            s = 1j * omega
            v = loop.variable(s)
            actuated = loop.gain * loop.actuated_at(s)
            returned = controller.after(actuated, s, v, loop.sample_time)
            through = ((right @ sensitivity(loop, returned))[:, None] @ actuated @ left)[:, 0]
            return through[:, None] * own.plane_at(s, v, loop.sample_time)

        def sampled(omega: Floats) -> Complexes:
            return in_blocks(at, omega, loop.size)

        def rough(omega: Floats, values: Complexes) -> Booleans:
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = 1 / values[:, 0]
                scale = np.abs(values[:, 1]) * np.abs(inverse) * window[1] + window[0]
                small = np.minimum(np.abs(inverse[1:]), np.abs(inverse[:-1]))
                return np.abs(np.diff(inverse)) > LARGEST_STEP * np.maximum(small, np.minimum(scale[1:], scale[:-1]))

        grid = _grid(loop)
        omega, values = refined(grid, sampled(grid), sampled, rough, ROUNDS, MOST)
        last = None if loop.sample_time is None else math.pi / loop.sample_time
        return cls(omega, values[:, 0], values[:, 1], kp, kd, unstable_roots(loop), last)

    def ratio(self, kp: float, kd: float) -> Complexes:
        """Return ratio L_part (k,) at `omega` of the part with gains (kp, kd), all other loops closed: 1 + L_part = f/f(kp = kd = 0)."""
        return (kp * self.a + kd * self.b) / (1 - self.kp * self.a - self.kd * self.b)

    @cached_property
    def curve(self) -> tuple[Floats, Floats, Floats]:
        """Stability boundary kp, kd (k,), where f(jω) = 0, and the determinant (k,) of its two equations.

        The sign of the determinant tells on which side of the curve there are more unstable roots.
        """
        determinant = self.a.real * self.b.imag - self.a.imag * self.b.real
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.kp - self.b.imag / determinant, self.kd + self.a.imag / determinant, determinant

    @cached_property
    def static(self) -> float:
        """Gain kp with a root at s = 0: below it the loop is unstable, as one real root is then positive."""
        rest = float(self.a[0].real)
        return self.kp - 1 / rest if rest else -math.inf

    def columns(self, kps: Floats) -> list[Floats]:
        """Stable kd for each kp (m,), as open intervals (p, 2), sorted, the last one perhaps to ∞.

        Raises GainroomError where a single root is unstable at rest with the present gains: then the count says nothing of other gains.
        """
        if self.count % 2 or self.kp < self.static:
            raise GainroomError("with these gains a joint falls over at rest, so there is no map of stable gains: raise kp")
        place, kd, change, _ = self._met(True, kps)
        _, kp, moved, _ = self._met(False, np.array([self.kd]))
        found = []
        for m, value in enumerate(kps.tolist()):
            between = (kp > min(value, self.kp)) & (kp < max(value, self.kp))
            here = self.count + (1 if value > self.kp else -1) * int(moved[between].sum())
            mine = np.flatnonzero(place == m)
            mine = mine[np.argsort(kd[mine])]
            ends = np.concatenate([[-math.inf], kd[mine], [math.inf]])
            below = here - int(change[mine][kd[mine] < self.kd].sum())
            counts = below + np.append(0, np.cumsum(change[mine]))
            free = (counts == 0) & (ends[1:] > ends[:-1]) & (value > self.static)
            found.append(np.stack([ends[:-1], ends[1:]], axis=1)[free])
        return found

    def outlines(self, window: tuple[float, float], columns: Callable[[Floats], list[Floats]] | None = None) -> tuple[Floats, ...]:
        """Closed polylines (m, 2), columns kp and kd, within kp, kd ≥ 0 and twice `window`.

        columns   (kps) → intervals of kd that are surrounded; None: the stable ones
        """
        low = max(0.0, self.static)
        ends = low + (window[0] - low) * 0.5 * (1 - np.cos(np.linspace(0, math.pi, COLUMNS)))
        kps = distinct(np.append(np.clip(ends, low + 1e-6 * window[0], None), self.kp + 1e-9 * window[0]))
        kps = kps[kps <= 1.0001 * window[0]]
        found = [np.clip(one, 0.0, 2 * window[1]) for one in (columns or self.columns)(kps)]
        return traced(kps, [one[one[:, 1] > one[:, 0]] for one in found])

    def edge(self, kps: Floats) -> tuple[Floats, Floats, Floats]:
        """kp, kd and ω [rad/s] (k,) where the stable columns at these kp end: the gains that vibrate, and how fast."""
        place, kd, _, omega = self._met(True, kps)
        ends = [set(column.ravel().tolist()) for column in self.columns(kps)]
        kept = np.array([value in ends[m] for m, value in zip(place.tolist(), kd.tolist(), strict=True)], dtype=bool)
        return kps[place[kept]], kd[kept], omega[kept]

    def _met(self, upright: bool, values: Floats) -> tuple[Integers, Floats, Integers, Floats]:
        """Crossings of the stability boundary with lines kp = value (`upright`), or kd = value.

        Returns index into values, the other gain, change of the root count as that gain grows, ω [rad/s].
        """
        kp, kd, determinant = self.curve
        along, other = (kp, kd) if upright else (kd, kp)
        low, high = along[:-1], along[1:]
        sound = np.isfinite(low) & np.isfinite(high) & (np.sign(determinant[1:]) == np.sign(determinant[:-1]))
        meets = sound & ((low <= values[:, None]) != (high <= values[:, None]))
        index, k = np.nonzero(meets)
        share = (values[index] - low[k]) / (high[k] - low[k])
        rising = np.sign(high[k] - low[k]) * np.sign(determinant[k])
        change = (-2 * rising if upright else 2 * rising).astype(int)
        found = other[k] + share * (other[k + 1] - other[k])
        omega = self.omega[k] + share * (self.omega[k + 1] - self.omega[k])
        if self.last is None:
            return index, found, change, omega
        # A root at z = −1: one line, on which f(−1) = 0; which way it moves is seen from the sample next to it.
        a, b = float(self.a[-1].real), float(self.b[-1].real)
        own, cross = (self.kp, self.kd) if upright else (self.kd, self.kp)
        here, there = (a, b) if upright else (b, a)
        if there == 0:
            return index, found, change, omega
        delta = -(1 + (values - own) * here) / there
        near_a, near_b = self.a[-2], self.b[-2]
        near = (1 + (values - own) * near_a + delta * near_b) if upright else (1 + (values - own) * near_b + delta * near_a)
        slope = near.imag / (math.pi * (1 - self.omega[-2] / self.last))
        more = np.where(there / slope > 0, 1, -1)
        ends = np.full(len(values), self.last)
        return np.append(index, np.arange(len(values))), np.append(found, cross + delta), np.append(change, more), np.append(omega, ends)


def _grid(loop: Loop) -> Floats:
    """Frequencies [rad/s] from far below every corner to where the picture's gains have no effect, denser at resonances."""
    assert loop.parts is not None
    corners = np.abs(loop.corner_frequencies.every)
    corners = corners[corners > 0]
    delay = max(drive.delay for drive in loop.parts.drives)
    slowest = min(float(corners.min(initial=math.inf)), 1 / delay if delay else math.inf, 1e3)
    fastest = max(float(corners.max(initial=0.0)), 1 / delay if delay else 0.0, 1.0)
    low, high = BELOW * slowest, max(4 * fastest, 8 * math.pi / delay if delay else 30 * fastest)
    if loop.sample_time is not None:
        high = math.pi / loop.sample_time
    parts = [np.geomspace(low, high, round(PER_DECADE * math.log10(high / low)))]
    for root in loop.corner_frequencies.every[loop.corner_frequencies.every.imag > 0]:
        parts.append(root.imag + max(abs(root.real), 1e-4 * root.imag) * np.sinh(np.linspace(-5, 5, 15)))
    if delay:
        parts.append(np.arange(low, high, 0.3 / delay))
    omega = distinct(np.concatenate(parts))
    omega = omega[(omega >= low) & (omega <= high)]
    return omega if loop.sample_time is None else distinct(np.concatenate([omega[omega < high * (1 - 1e-6)], [high * (1 - 1e-6), high]]))
