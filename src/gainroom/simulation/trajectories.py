"""Reference signals as functions of time: step, spline, chirp, multisine; each for n joints, and constant outside its own time."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_count, require_finite, require_positive
from ..system.linear.arrays import Floats

NANOSECOND = 1e-9  # the 600th tick of 0.5 ms is at 0.3 s, also where its product is rounded down


class Trajectory:
    """Function of time t [s] (k,) with values (k, n) in rad, or N m for a torque."""

    @property
    def size(self) -> int:
        """Number n of joints; 1 goes with any number of joints."""
        raise NotImplementedError

    @property
    def end(self) -> float:
        """Time [s] from which on it is constant; inf: never."""
        raise NotImplementedError

    @property
    def fastest(self) -> float:
        """Highest frequency of an oscillating signal [rad/s]; 0 for a move."""
        return 0.0

    def position(self, time: ArrayLike) -> Floats:
        """Value (k, n) at `time` (k,)."""
        raise NotImplementedError


@dataclass(frozen=True)
class Step(Trajectory):
    """Step from `base` to `base` + `height` at `start` [s]; both numbers or (n,). With height 0: a constant."""

    height: Any = 1.0
    start: float = 0.0
    base: Any = 0.0

    def __post_init__(self) -> None:
        _start("step", self)
        _complete(self, "step", "height", "base")

    @property
    def size(self) -> int:
        return len(self.height)

    @property
    def end(self) -> float:
        return self.start if self.height.any() else 0.0

    def position(self, time: ArrayLike) -> Floats:
        return self.base + self.height * (_column(time) >= self.start - NANOSECOND)


@dataclass(frozen=True)
class Spline(Trajectory):
    """Spline through points at given times, starting and ending at rest.

    times    (p,) [s], rising
    points   (p,) or (p, n)
    order    3: cubic, 5: quintic; a quintic starts and ends without acceleration too
    pause    come to rest at every point; else pass them with as many continuous derivatives as the order allows

    Between two points these are the usual 3τ² − 2τ³ and 10τ³ − 15τ⁴ + 6τ⁵.
    """

    times: Any
    points: Any
    order: int = 3
    pause: bool = False

    def __post_init__(self) -> None:
        times = require_finite("spline", "times", self.times)
        points = require_finite("spline", "points", self.points)
        points = points[:, None] if points.ndim == 1 else points
        if times.ndim != 1 or len(times) < 2 or np.any(np.diff(times) <= 0):
            raise GainroomError(f"spline: times {times.tolist()} must be two or more, rising")
        if points.ndim != 2 or len(points) != len(times):
            raise GainroomError(f"spline: points of shape {np.shape(self.points)} must be one row for each of {len(times)} times")
        if self.order not in (3, 5):
            raise GainroomError(f"spline: order {self.order!r} must be 3 or 5")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "_curve", self._interpolated())

    @classmethod
    def move(cls, by: ArrayLike, duration: float, start: float = 0.0, order: int = 3, base: ArrayLike = 0.0) -> "Spline":
        """Move from `base` to `base` + `by` (numbers or (n,)) in `duration` [s], from `start` [s] on."""
        require_positive("spline", "duration", duration, "s")
        begin, way = np.broadcast_arrays(np.atleast_1d(require_finite("spline", "base", base)), require_finite("spline", "by", by))
        return cls((start, start + duration), np.stack([begin, begin + way]), order)

    @property
    def size(self) -> int:
        return self.points.shape[1]

    @property
    def end(self) -> float:
        return float(self.times[-1])

    def _interpolated(self) -> Any:
        from scipy.interpolate import BPoly, make_interp_spline

        zero = range(1, (self.order + 1) // 2)  # derivatives that are 0 at rest
        if self.pause:
            rows = np.stack([self.points, *(np.zeros_like(self.points) for _ in zero)], axis=1)
            return BPoly.from_derivatives(self.times, rows)
        rest = [(derivative, np.zeros(self.size)) for derivative in zero]
        return make_interp_spline(self.times, self.points, k=self.order, bc_type=(rest, rest))  # type: ignore[arg-type]

    def position(self, time: ArrayLike) -> Floats:
        return self._curve(np.clip(_column(time)[:, 0], self.times[0], self.times[-1]))  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Chirp(Trajectory):
    """Chirp amplitude · sin φ(t), its frequency swept from `first` to `last` [rad/s] in `duration` [s]; then it stops in place.

    amplitude   a number or (n,); all joints move in phase
    sweep       "linear": ω changes by the same amount every second; "exponential": by the same factor
    """

    amplitude: Any
    first: float
    last: float
    duration: float
    sweep: str = "linear"
    start: float = 0.0
    base: Any = 0.0

    def __post_init__(self) -> None:
        for name, unit in (("first", "rad/s"), ("last", "rad/s"), ("duration", "s")):
            require_positive("chirp", name, getattr(self, name), unit)
        if self.sweep not in ("linear", "exponential"):
            raise GainroomError(f"chirp: sweep {self.sweep!r} must be 'linear' or 'exponential'")
        _start("chirp", self)
        _complete(self, "chirp", "amplitude", "base")

    @property
    def size(self) -> int:
        return len(self.amplitude)

    @property
    def end(self) -> float:
        return self.start + self.duration

    @property
    def fastest(self) -> float:
        return max(self.first, self.last)

    def position(self, time: ArrayLike) -> Floats:
        t = np.clip(_column(time) - self.start, 0.0, self.duration)
        growth = math.log(self.last / self.first) / self.duration
        if self.sweep == "linear" or growth == 0:
            phase = (self.first + (self.last - self.first) / self.duration * t / 2) * t
        else:
            phase = self.first * np.expm1(growth * t) / growth
        return self.base + self.amplitude * np.sin(phase)


@dataclass(frozen=True)
class Multisine(Trajectory):
    """Multisine Σ amplitude_m · sin(ω_m t + φ_m) from `start` [s] on, with phases drawn from `seed`, different for every joint.

    frequencies   ω (m,) [rad/s]
    amplitudes    a number, (m,), or (m, n)
    joints        n, where the shape of the amplitudes does not give it

    The sum begins at 0, so that the loop is not excited by a jump: its value at `start` is subtracted.
    """

    frequencies: Any
    amplitudes: Any
    seed: int = 0
    joints: int = 1
    start: float = 0.0
    base: Any = 0.0

    def __post_init__(self) -> None:
        require_count("multisine", "seed", self.seed, 0)
        require_count("multisine", "joints", self.joints, 1)
        _start("multisine", self)
        frequencies = np.atleast_1d(require_finite("multisine", "frequencies", self.frequencies))
        if frequencies.ndim != 1 or np.any(frequencies <= 0):
            raise GainroomError(f"multisine: frequencies {frequencies.tolist()} must be > 0 rad/s, in one row")
        amplitudes = require_finite("multisine", "amplitudes", self.amplitudes)
        amplitudes = amplitudes[:, None] if amplitudes.ndim == 1 else amplitudes
        columns = amplitudes.shape[1] if amplitudes.ndim == 2 and amplitudes.shape[1] > 1 else self.joints
        try:
            amplitudes = np.broadcast_to(amplitudes, (len(frequencies), columns))
        except ValueError as error:
            raise GainroomError(
                f"multisine: amplitudes of shape {np.shape(self.amplitudes)} must be a number or one row for each of "
                f"{len(frequencies)} frequencies"
            ) from error
        object.__setattr__(self, "frequencies", frequencies)
        object.__setattr__(self, "amplitudes", amplitudes)
        object.__setattr__(self, "base", _values("multisine", "base", self.base, columns))
        phases = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, amplitudes.shape)
        object.__setattr__(self, "_phases", phases)

    @property
    def size(self) -> int:
        return self.amplitudes.shape[1]

    @property
    def end(self) -> float:
        return math.inf

    @property
    def fastest(self) -> float:
        return float(self.frequencies.max())

    def position(self, time: ArrayLike) -> Floats:
        phases = self._phases  # type: ignore[attr-defined]
        angle = self.frequencies[:, None] * np.maximum(_column(time) - self.start, 0.0)[:, :, None] + phases
        return self.base + (self.amplitudes * (np.sin(angle) - np.sin(phases))).sum(axis=1)


@dataclass(frozen=True)
class _Moving(Trajectory):
    """Modification of another trajectory, `moving`."""

    moving: Trajectory

    @property
    def size(self) -> int:
        return self.moving.size


@dataclass(frozen=True)
class Held(_Moving):
    """Trajectory `moving` until `stop` [s], then constant."""

    stop: float

    @property
    def end(self) -> float:
        return min(self.stop, self.moving.end)

    def position(self, time: ArrayLike) -> Floats:
        return self.moving.position(np.minimum(_column(time)[:, 0], self.stop))


@dataclass(frozen=True)
class Late(_Moving):
    """Trajectory `moving`, delayed by `delay` [s]."""

    delay: float

    @property
    def end(self) -> float:
        return self.moving.end + self.delay

    @property
    def fastest(self) -> float:
        return self.moving.fastest

    def position(self, time: ArrayLike) -> Floats:
        return self.moving.position(np.asarray(time, dtype=float) - self.delay)


def _column(time: ArrayLike) -> Floats:
    """Column (k, 1) of `time` (k,)."""
    return np.atleast_1d(np.asarray(time, dtype=float))[:, None]


def _start(owner: str, signal: Any) -> None:
    if require_finite(owner, "start", signal.start).ndim:
        raise GainroomError(f"{owner}: start {signal.start!r} must be one number")


def _complete(signal: Any, owner: str, *names: str) -> None:
    """Broadcast the named values to (n,) arrays of one length."""
    values = [np.atleast_1d(require_finite(owner, name, getattr(signal, name))) for name in names]
    size = max(len(value) for value in values)
    for name, value in zip(names, values, strict=True):
        object.__setattr__(signal, name, _values(owner, name, value, size))


def _values(owner: str, name: str, value: ArrayLike, size: int) -> Floats:
    value = np.atleast_1d(require_finite(owner, name, value))
    if value.shape not in ((1,), (size,)):
        raise GainroomError(f"{owner}: {name} of shape {value.shape} must be a number or {size} numbers")
    return np.broadcast_to(value, (size,))
