"""Delay reserve: the extra delay τ up to which small gain proves a loop stable, by a ceiling of the complementary sensitivity.

An extra delay τ turns L into L + L (e^{−jωτ} − 1). A loop that is stable stays so, for every constant delay up to τ, if for all ω

    |T(jω)| · |1 − e^{−jωτ}| ≤ 1,     T = L/(1 + L),     with the factor 2 beyond ωτ = π.

Unlike the delay margin the ceiling is convex in the closed loop, so that controllers of any structure can be held to it
(comparison/bound.py). Where |L| = 1 it *is* a delay margin of τ: |T| = 1/(2 sin φ/2) there, and the factor is 2 sin ωτ/2; the reserve
is no more than the margin. Sampled, a fraction of a tick is not exactly a phase.
The largest τ is the least over ω of (2/ω) arcsin 1/(2 |T|) where |T| ≥ ½; elsewhere any delay is allowed.

**Several loops**, each with an extra delay of its own up to τ: |T| is σ_max of U⁻¹ T U, as in jitter_margin.py.

**kd on a path of its own**, one joint: Σ_p |L_p S| |1 − e^{−jωτ_p}| ≤ 1, each path's τ_p the same share of its own delay, τ that of the
other gains. Each path is a hold and a delay in continuous time there, aliases left out.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import GainroomError
from .jitter_margin import Heights, ScalarPeak, sampled_peak, speed
from .linear.arrays import Complexes, Floats
from .linear.transfer_function import Factored
from .loop import Loop
from .measured_response import unsampled_scalar

HALVINGS = 60  # of an interval of ωτ, to its last digit


def turned(angle: Floats) -> Floats:
    """Size of 1 − e^(−j angle) for the worst lag up to `angle` [rad]: 2 beyond π."""
    return 2 * np.sin(np.minimum(angle, math.pi) / 2)


@dataclass(frozen=True)
class DelayReserve:
    """Delay reserve of a stable loop.

    width       τ [s], the extra delay up to which stability is proved; inf: any
    frequency   that bounds it [rad/s]; NaN where τ is inf
    certified   True: between the frequencies evaluated |T| is proved to cost no more than 0.1 % of τ. Of several loops, and of two paths,
                it is sampled
    units       (n,) U of several loops
    """

    width: float
    frequency: float
    certified: bool
    units: Floats


def delay_reserve(loop: Loop) -> DelayReserve:
    """Delay reserve of a stable loop of n ≥ 1 joints, with its width τ in s; computed once per loop.

    Stability is not checked: for an unstable loop the result has no meaning. Raises GainroomError if kd closes on a path of its own in
    several joints, or beside a drive without delay.
    """
    if "delay reserve" not in loop.measurements:
        peak = _ReservePeak.of(loop).found() if loop.kd_path is None and loop.scalar is not None else sampled_peak(*_heights(loop))
        place = peak.omega if peak.height > 0 else math.nan
        loop.measurements["delay reserve"] = DelayReserve(_width(peak.height), place, peak.certified, peak.units)
    return loop.measurements["delay reserve"]


def reserve_about(loop: Loop, known: DelayReserve) -> float:
    """Reserve τ [s] of a loop whose gains are close to those of the loop that `known` was computed for, exact to first order in the change.

    |T| is evaluated at `known.frequency` alone; where that is not finite, or |T| is below ½ there, the whole search is repeated.
    """
    if math.isfinite(known.frequency):
        single = loop.kd_path is None and loop.scalar is not None
        heights = _ReservePeak.of(loop) if single else replace(_heights(loop)[0], units=known.units)
        height = float(heights.at(np.array([known.frequency]))[0])
        if height > 0:
            return 1 / height
    return delay_reserve(loop).width


def response_of_paths(loop: Loop, omega: Floats) -> Complexes:
    """Return ratio (k,) at omega (k,) [rad/s] of one joint whose kd closes on a path of its own, as its delay reserve has it."""
    closed = _TwoPaths(loop, np.ones(1)).without_aliases(omega).sum(axis=1)
    return closed / (1 - closed)


def _width(height: float) -> float:
    """τ [s] of a peak `height` [1/s] of the inverse; inf for 0, NaN for NaN."""
    return math.nan if math.isnan(height) else math.inf if height == 0 else 1 / height


def _inverse(omega: Floats | float, complementary: Floats | float) -> Floats:
    """1/τ [1/s] that |T| allows at omega [rad/s]: ω/(2 arcsin 1/(2 |T|)); 0 where |T| < ½, where any delay is allowed."""
    size = np.asarray(complementary, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(size >= 0.5, omega / (2 * np.arcsin(np.minimum(0.5 / size, 1.0))), 0.0)


@dataclass(frozen=True)
class _ReservePeak(ScalarPeak):
    """The peak of 1/τ, as |T| of one joint allows it at each frequency, by the branch and bound of ScalarPeak."""

    @classmethod
    def of(cls, loop: Loop) -> "_ReservePeak":
        assert loop.scalar is not None
        return cls(loop.scalar.reduced, None, None)

    def at(self, omega: Floats) -> Floats:
        """1/τ (k,) [1/s] at omega (k,) [rad/s]; 0 where it cannot be evaluated (NaN)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = self.loop.at(1j * omega)
            size = np.abs(value / (1 + value))
        return np.nan_to_num(_inverse(omega, size), nan=0.0, posinf=0.0)

    def _bound(self, low: Floats, high: Floats) -> Floats:
        plain, _ = self.without_aliases(low, high)
        with np.errstate(divide="ignore", over="ignore"):
            return _inverse(high, plain / speed(low, self._time))

    def _at_the_end(self) -> tuple[float, float]:
        time = self._time
        if time is not None:
            return float(self.at(np.array([math.pi / time]))[0]), math.pi / time
        size = abs(self.loop.gain)
        if self.loop.relative_degree > 0:
            size = 0.0
        elif self.loop.delay > 0:
            size = size / (1 - size) if size < 1 else math.inf
        else:
            size = abs(self.loop.gain / (1 + self.loop.gain)) if self.loop.gain != -1 else math.inf
        return (math.inf if size >= 0.5 else 0.0), math.inf

    def _below(self, first: float) -> float:
        return float(_inverse(first, self.most_below(first)[0]))

    def _above(self, last: float) -> float:
        return math.inf if self._time is None and self.most_above(last) >= 0.5 else 0.0


def _heights(loop: Loop) -> tuple[Heights, float | None]:
    """1/τ of a loop that is sampled in frequency, and the shortest sample time [s] up to half of whose rate it is."""
    if loop.kd_path is None:
        return _Reserves.of(loop), loop.sample_time
    assert loop.sample_time is not None
    return _TwoPaths.of(loop), min(loop.sample_time, loop.kd_path.sample_time)


@dataclass(frozen=True)
class _Reserves(Heights):
    """1/τ that σ_max of the complementary sensitivity of several loops allows, or |T| of one given as a callable."""

    @property
    def _unsampled(self) -> None:  # type: ignore[override] - a delay of held torques needs no aliases
        return None

    def scaled(self, omega: Floats, matrices: Complexes) -> Floats:
        """1/τ (k,) [1/s] of complementary sensitivities `matrices` (k, n, n) in the units of this object."""
        return _inverse(omega, super().scaled(omega, matrices) / speed(omega, self.loop.sample_time))


@dataclass(frozen=True)
class _TwoPaths(_Reserves):
    """1/τ of one joint whose kd closes on a path of its own, τ of the drive's path."""

    @classmethod
    def of(cls, loop: Loop) -> "_TwoPaths":
        """Two paths of a loop. Raises GainroomError of several joints, and beside a drive without delay."""
        assert loop.parts is not None
        if loop.size > 1:
            raise GainroomError(f"kd_path: the delay reserve is known of one joint, not of {loop.size}")
        if not loop.parts.drives[0].delay > 0:
            raise GainroomError("kd_path: the delay reserve is a share of each path's delay, and the drive has none")
        return cls(loop, np.ones(1))

    @cached_property
    def _paths(self) -> tuple[tuple[Factored, float, float], ...]:
        """Controller, sample time [s] and delay [s] of each path."""
        parts, path = self.loop.parts, self.loop.kd_path
        assert parts is not None
        assert path is not None
        assert parts.sample_time is not None
        others, kd = parts.controller.without_kd(), parts.controller.kd_alone()
        host = others.transfer(parts.sample_time), parts.sample_time, parts.drives[0].delay
        return host, (kd.transfer(path.sample_time), path.sample_time, path.delay)

    @cached_property
    def _plant(self) -> Factored:
        assert self.loop.parts is not None
        return replace(unsampled_scalar(self.loop.parts), delay=0.0)

    def without_aliases(self, omega: Floats) -> Complexes:
        """Shares L_p S (k, 2) of the paths at omega (k,) [rad/s]."""
        plant, returned = self._plant.response(omega), list[Any]()
        for control, step, delay in self._paths:
            held = np.sinc(omega * step / (2 * math.pi)) * np.exp(-1j * omega * (delay + step / 2))
            returned.append(self.loop.gain * plant * held * control.at(1j * omega))
        return np.stack(returned, axis=1) / (1 + np.sum(returned, axis=0))[:, None]

    def scaled(self, omega: Floats, matrices: Complexes) -> Floats:
        """1/τ (k,) [1/s] at omega (k,) at which Σ_p |L_p S| |1 − e^(−jωτ_p)| is 1, from shares `matrices` (k, 2); 0 where it never is."""
        size = np.abs(matrices)
        (*_, first), (*_, second) = self._paths
        rates = np.array([1.0, second / first])
        low, high = np.zeros(len(omega)), np.full(len(omega), math.pi / min(rate for rate in rates.tolist() if rate > 0))
        reached = (size * turned(high[:, None] * rates)).sum(axis=1) >= 1
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            kept = (size * turned(middle[:, None] * rates)).sum(axis=1) <= 1
            low, high = np.where(kept, middle, low), np.where(kept, high, middle)
        return np.where(reached, omega / np.maximum(low, np.finfo(float).tiny), 0.0)
