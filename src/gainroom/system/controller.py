"""Controllers: torque command from position error, u = D (x_d − x).

Every controller here is a sum of four signals, shaped by notches and biquads:

    D(v) = N(v) · Σ G_ab · V(v)^a · I(v)^b,     a, b in {0, 1}

V takes the velocity (filtered or not), I integrates, N is the product of notches and biquads, and the gains G_ab are numbers or n × n
matrices. Continuous: V = s F(s), I = 1/s. Sampled, in δ = (z − 1)/T_s: V = backward difference × F, I = backward Euler; F and N are
mapped by Tustin's rule, exact at their own frequency.

    PD     Kp + Kd V
    PID    Kp + Kd V + Ki I
    P/PI   (Kv + Ki I)(Kp + V)                      Jung et al. 2017, Fig. 13

Another one is a subclass that lists its GAINS; that files may have it, its entry in CONTROLLERS (tests/test_added_once.py).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, one_line, require_finite
from .disturbance_observer import MOST_TICKS, observed_disturbance
from .feedback import SENSORS, Feedback, Sensor
from .filters import FILTERS, Biquad, LowPass, Notch, Ratio, filter_product, filtered_velocity, integrator, value_of
from .linear.arrays import Complexes, Floats
from .linear.lti import factored_from
from .linear.transfer_function import Factored, growth, polynomials_times, ratio
from .modes import Corners

Terms = dict[tuple[int, int], Floats]
"""Gains by (power of V, power of I)."""
ROUND_OFF = 1e-12  # relative to the largest entry of a gain matrix


@dataclass(frozen=True)
class GainKey:
    """One gain of a controller, as named in files, tables and the app.

    name      field of the controller, and key of `control` in files
    unit      unit for a revolute joint
    meaning   description in messages: "the gain on position"
    positive  True: > 0 for a single joint (one of several may have 0); False: >= 0
    of_task   unit for a direction of a task, where tasks have such a controller
    scales    True: the torque grows with it; False: no gain, such as a time constant, which stays where gains are scaled or set to 0
    signed    True: it may have either sign
    needed    False: files may leave it out; it then has the default of its class
    """

    name: str
    unit: str = ""
    meaning: str = "a gain"
    positive: bool = False
    of_task: str = ""
    scales: bool = True
    signed: bool = False
    needed: bool = True


@dataclass(frozen=True)
class Controller:
    """A sum of gain terms with filters; a subclass names its gains and the terms they make. Analysis and design use only this interface.

    kind             name in reports
    GAINS            gains, and time constants and the like, in the order of the signature
    of_tasks         True: task directions may use it
    plane_names      axes of its kp–kd plane in its own gains
    has_plane        True: its gains can move in a kp–kd plane (plane, plane_gains, from_plane)
    damping_name     gain on velocity; held_ratio: ratio of two gains that stays constant in that plane; "": none
    rate_of_error    True: velocity of the error, so that a moving reference counts; False: of the measured position alone
    torque_name      gain on the torque of a single joint's spring; "": none
    of_one_joint     True: files of robots may not name it
    laws             transfer function by sensor, of a law that names its sensors itself; {}: feedback says what gains measure
    """

    kind: ClassVar[str] = "controller"
    GAINS: ClassVar[tuple[GainKey, ...]] = ()
    of_tasks: ClassVar[bool] = False
    plane_names: ClassVar[tuple[str, str]] = ("kp", "kd")
    has_plane: ClassVar[bool] = True
    damping_name: ClassVar[str] = "kd"
    held_ratio: ClassVar[str] = ""
    rate_of_error: ClassVar[bool] = True
    torque_name: ClassVar[str] = ""
    of_one_joint: ClassVar[bool] = False
    laws: ClassVar[Any] = {}

    velocity_filter: LowPass | None = field(default=None, kw_only=True)
    notches: tuple[Notch, ...] = field(default=(), kw_only=True)
    biquads: tuple[Biquad, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        owner = type(self).__name__
        for name, kind in (("notches", Notch), ("biquads", Biquad)):
            given = getattr(self, name)
            object.__setattr__(self, name, tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,))
            _require_all(owner, name, getattr(self, name), kind)
        _require_all(owner, "velocity_filter", () if self.velocity_filter is None else (self.velocity_filter,), LowPass)
        for name in self.gain_names():
            array = require_finite(owner, name, getattr(self, name))
            object.__setattr__(self, name, array if array.ndim else float(array))

    @classmethod
    def gain_names(cls) -> tuple[str, ...]:
        """The names of the gains, in the order of the signature."""
        return tuple(one.name for one in cls.GAINS)

    @classmethod
    def gain_keys(cls) -> tuple[GainKey, ...]:
        """Gain descriptions; names alone for a controller that lists none."""
        return cls.GAINS or tuple(map(GainKey, cls.gain_names()))

    @classmethod
    def scaled_names(cls) -> tuple[str, ...]:
        """Names of the gains alone, without time constants and the like."""
        return tuple(one.name for one in cls.gain_keys() if one.scales)

    def require_size(self, size: int) -> None:
        """Raise GainroomError, naming the gain, if its shape does not fit `size` > 1 joints, or it has a negative eigenvalue.

        Counts of coupled loops rest on L at low frequency, where a negative gain on a motion without other stiffness is not visible.
        """
        for name in self.gain_names():
            gain = gain_matrix(f"{type(self).__name__}: {name}", getattr(self, name), size)
            apart = np.ndim(getattr(self, name)) < 2  # then its eigenvalues are its entries
            if apart or np.array_equal(gain, gain.T):
                lowest = float(np.diagonal(gain).min() if apart else np.linalg.eigvalsh(gain)[0])
                if lowest < 0 and lowest < -1e-9 * np.abs(gain).max():  # far above what round-off leaves of gains in operational space
                    raise GainroomError(f"{type(self).__name__}: {name} with an eigenvalue of {lowest:.4g} must be >= 0 on every joint")

    def terms(self) -> Terms:
        """The gains G_ab, each () or (n, n); terms that vanish are left out."""
        raise NotImplementedError

    def velocity(self, sample_time: float | None) -> Ratio:
        """Velocity V in v as (numerator, denominator). Continuous: s F(s), improper without a filter."""
        return filtered_velocity(self.velocity_filter, sample_time)

    @property
    def filters(self) -> dict[str, Any]:
        """The filters, by argument of the constructor."""
        return {name: getattr(self, name) for name in FILTERS}

    def shaping(self, sample_time: float | None) -> Factored:
        """Product N of notches and biquads in v."""
        return filter_product((*self.notches, *self.biquads), sample_time)

    def corners(self, sample_time: float | None) -> Corners:
        """Rough poles and zeros in s of its filters."""
        shaping = self.shaping(None)
        return Corners(shaping.poles, shaping.zeros)

    def transfer(self, sample_time: float | None) -> Factored:
        """Transfer function D for one joint (n = 1). Raises GainroomError where a gain is a matrix."""
        return self.combine(self.terms(), sample_time)

    def law(self, sensor: Sensor, feedback: Feedback, sample_time: float | None) -> Factored:
        """Transfer function D_i of one joint from what `sensor` measures to the torque command, without its sign; gain 0: none."""
        if sensor == "torque":
            return self.shaping(sample_time) * self.torque_law(sample_time)
        return self.combine(feedback.of_side(sensor, self.terms()), sample_time)

    def torque_law(self, sample_time: float | None) -> Factored:
        """Transfer function from the spring's torque to the torque command, without its sign, and without N; gain 0 where unused."""
        return ratio([0.0], [1.0], sample_time)

    def matrix(self, s: Complexes, v: Complexes, size: int, sample_time: float | None) -> Complexes:
        """Controller matrix D (k, n, n) of `size` joints at complex s (k,), where v (k,) are the same points in this module's variable."""
        return self._sum(self.matrices(size), (size, size), s, v, sample_time)

    def after(self, response: Complexes, s: Complexes, v: Complexes, sample_time: float | None) -> Complexes:
        """Product `response` D (k, n, n): measured response (k, n, n) times controller, at the points of `matrix`."""
        terms = self.matrices(response.shape[-1])
        if all(np.count_nonzero(gain) == np.count_nonzero(np.diagonal(gain)) for gain in terms.values()):
            own = {powers: np.diagonal(gain) for powers, gain in terms.items()}
            return response * self._sum(own, response.shape[-1:], s, v, sample_time)[:, None, :]
        return response @ self._sum(terms, response.shape[1:], s, v, sample_time)

    def _sum(self, terms: Terms, shape: tuple[int, ...], s: Complexes, v: Complexes, sample_time: float | None) -> Complexes:
        """Controller values D (k, …) for gains of `shape` (…)."""
        ratios = self.velocity(sample_time), integrator(sample_time)
        signals = [value_of(ratio, v) if any(powers[k] for powers in terms) else None for k, ratio in enumerate(ratios)]
        total = np.zeros((len(v), *shape), dtype=complex)
        for powers, gain in terms.items():
            parts = [signal**power for signal, power in zip(signals, powers, strict=True) if signal is not None and power]
            total += np.multiply.outer(reduce(np.multiply, parts), gain) if parts else gain
        shaping = self.shaping(sample_time)
        return total if shaping.is_one else (shaping.at(s) * total.T).T

    def matrices(self, size: int) -> Terms:
        """Gain terms as (n, n) matrices, cached because responses are evaluated many times. Raises GainroomError on shapes and powers."""
        if size not in self._sized:
            self._sized[size] = {powers: gain_matrix(f"gain {powers}", gain, size) for powers, gain in self._known(self.terms()).items()}
        return self._sized[size]

    def _known(self, terms: Terms) -> Terms:
        """`terms` unchanged, once checked. Raises GainroomError for a power of V or I that is neither 0 nor 1."""
        if other := [powers for powers in terms if not set(powers) <= {0, 1}]:
            raise GainroomError(f"{type(self).__name__}: a term with powers {other[0]} of V and I must have powers of 0 or 1")
        return terms

    @cached_property
    def _sized(self) -> dict[int, Terms]:
        return {}

    def slowest(self, size: int) -> float:
        """Lowest frequency [rad/s] at which one term overtakes another on some joint; inf with a single term."""
        by_order: dict[int, Floats] = {}
        for (power_v, power_i), gain in self.matrices(size).items():
            by_order[power_v - power_i] = by_order.get(power_v - power_i, 0.0) + np.linalg.norm(gain, axis=1)
        corners = [
            (by_order[low][both] / by_order[high][both]) ** (1 / (high - low))
            for low in by_order
            for high in by_order
            if low < high and np.any(both := (by_order[low] > 0) & (by_order[high] > 0))
        ]
        return min((float(corner.min()) for corner in corners), default=math.inf)

    def combine(self, terms: Terms, sample_time: float | None) -> Factored:
        """Transfer function N · Σ terms with this controller's filters, for scalar gains. Raises GainroomError for matrices."""
        for gain in terms.values():
            if np.size(gain) != 1:
                raise GainroomError(f"{type(self).__name__}: gains of shape {np.shape(gain)} must be single numbers for one joint")
        parts, denominator = self._polynomials(terms, sample_time)
        numerator = sum((float(np.reshape(gain, ())) * part for gain, part in zip(terms.values(), parts, strict=True)), np.zeros(1))
        shaping, found = self.shaping(sample_time), ratio(numerator, denominator, sample_time)
        return found if shaping.is_one else shaping * found

    def apart(self, terms: Terms, sample_time: float | None) -> list[Factored]:
        """Transfer functions D of m independent channels whose gains are `terms`, each (m,), with this controller's filters."""
        parts, denominator = self._polynomials(terms, sample_time)
        numerators = sum((np.multiply.outer(gain, part) for gain, part in zip(terms.values(), parts, strict=True)), np.zeros((1, 1)))
        shared = self.shaping(sample_time) * ratio([1.0], denominator, sample_time)
        return polynomials_times(numerators, shared)

    def _polynomials(self, terms: Terms, sample_time: float | None) -> tuple[Floats, Floats]:
        """Numerator polynomial (terms, k) that each term's gain multiplies, highest power first, and the common denominator."""
        ratios = self.velocity(sample_time), integrator(sample_time)
        most = [max((powers[k] for powers in self._known(terms)), default=0) for k in (0, 1)]
        parts = [reduce(np.convolve, (ratios[k][0 if powers[k] else 1] for k in (0, 1) if most[k]), np.ones(1)) for powers in terms]
        longest = max((len(part) for part in parts), default=1)
        padded = np.zeros((len(parts), longest))
        for row, part in zip(padded, parts, strict=True):
            row[longest - len(part) :] = part
        return padded, reduce(np.convolve, (ratios[k][1] for k in (0, 1) if most[k]), np.ones(1))

    @property
    def held_gain(self) -> str:
        """Numerator of `held_ratio`, the gain that follows the plane; "" where no ratio is held."""
        return self.held_ratio.partition("/")[0]

    @property
    def has_held_gain(self) -> bool:
        """True if its kp–kd plane carries a third gain that is not 0, so that no point of the plane is a plain PD."""
        return bool(self.held_gain) and bool(np.any(getattr(self, self.held_gain)))

    @property
    def lead_rises(self) -> bool:
        """True if arg D(jω) rises with ω on every joint in continuous time: gains >= 0 without filters, no zero in the right half plane."""
        return self.has_plane and not any(self.filters.values())

    @classmethod
    def can_be_asked_for(cls) -> bool:
        """True if every gain of it can be recommended: kp and kd of its plane, and no other whose ratio to them would have to be known."""
        return cls.has_plane and not cls.held_ratio and cls.gain_names() == cls.plane_names

    def on_joint(self, k: int, size: int) -> "Controller":
        """Controller of joint `k` of `size` alone: the diagonal of its gains."""
        return replace(self, **{name: own_gain(getattr(self, name), k, size) for name in self.gain_names()})

    def units(self) -> "dict[str, Controller]":
        """Controllers of a single diagonal gain, kp or kd, of value 1, by name; empty where gains do not act independently."""
        return {}

    def without_kd(self) -> "Controller":
        """Controller with kd = 0 and all other gains. Raises GainroomError where no kd acts independently."""
        if "kd" not in self.gain_names():
            raise GainroomError(f"kd_path: is for controllers with a kd, PD and PID, not for {self.kind}")
        others = replace(self, kd=0.0, velocity_filter=None)  # type: ignore[call-arg] - it has one
        alone = _nonzero(self.kd_alone().terms())
        if not (alone.keys() <= {(1, 0)} and _same(_sum(others.terms(), alone), self.terms())):
            raise GainroomError(f"kd_path: is for controllers whose kd acts by itself, as that of PD and PID; not for {self.kind}")
        return others

    def kd_alone(self) -> "Controller":
        """Controller with kd and its filters alone, every other gain 0; complements `without_kd`."""
        return replace(self, **{name: 0.0 for name in self.scaled_names() if name != "kd"})

    def scaled(self, factor: float) -> "Controller":
        """Controller whose whole output is multiplied by `factor`."""
        return replace(self, **{name: factor * getattr(self, name) for name in self.scaled_names()})

    def plane(self) -> tuple[Terms, Terms]:
        """Terms that kp and kd each multiply when the gains move in the kp–kd plane with the held ratio fixed."""
        raise GainroomError(f"{type(self).__name__} has no kp–kd plane")

    def plane_at(self, s: Complexes, v: Complexes, sample_time: float | None) -> Complexes:
        """Responses (k, 2) that kp and kd of the plane multiply, at the points of `matrix`, with all filters."""
        return np.stack([self._sum(terms, (), s, v, sample_time) for terms in self.plane()], axis=1)

    def signal(self, powers: tuple[int, int], s: Complexes, v: Complexes, sample_time: float | None) -> Complexes:
        """Response (k,) that the gain of these powers of V and I multiplies, at the points of `matrix`, with all filters."""
        return self._sum({powers: np.ones(())}, (), s, v, sample_time)

    def plane_gains(self) -> tuple[float, float]:
        """Coordinates (kp, kd) of this controller in its kp–kd plane."""
        raise GainroomError(f"{type(self).__name__} has no kp–kd plane")

    def from_plane(self, kp: float, kd: float) -> "Controller":
        """Controller at the point (kp, kd) of its kp–kd plane."""
        raise GainroomError(f"{type(self).__name__} has no kp–kd plane")

    def of_pd(self, kp: float, kd: float) -> "Controller":
        """Controller of one joint equivalent to PD gains: of this kind without integral if that exists, otherwise a PD."""
        plain = self.plain_pd(kp, kd)
        if not self.has_plane:
            return plain
        own = (replace(self, **{self.held_gain: 0.0}) if self.held_gain else self).from_plane(kp, kd)
        return own if _same(own.terms(), plain.terms()) and _same_factors(own.shaping(None), plain.shaping(None)) else plain

    def require_consistent(self) -> None:
        """Raise GainroomError if `scaled`, `plane` or `from_plane` give a control law other than `terms`."""
        if not _same(self.scaled(2.0).terms(), _scaled(self.terms(), 2.0)):
            raise GainroomError(f"{type(self).__name__}.scaled: must multiply all terms by the factor")
        own = self.on_joint(
            0, max((np.shape(getattr(self, name))[0] for name in self.gain_names() if np.ndim(getattr(self, name))), default=1)
        )
        if not (own.has_plane and all(own.plane_gains())):
            return
        kp, kd = (2.0 * gain for gain in own.plane_gains())
        if not _same(
            own.from_plane(kp, kd).terms(), _sum(*(_scaled(part, gain) for part, gain in zip(own.plane(), (kp, kd), strict=True)))
        ):
            raise GainroomError(f"{type(self).__name__}.plane: must be what kp and kd multiply in the terms of from_plane(kp, kd)")

    def plain_pd(self, kp: float, kd: float) -> "PD":
        """A PD with this controller's filters."""
        return PD(kp, kd, **self.filters)

    def in_plane(self, kp: float, kd: float, sample_time: float | None) -> Factored:
        """Transfer function D at the point (kp, kd) of the plane."""
        return self.combine(self.plane_terms(kp, kd), sample_time)

    def plane_terms(self, kp: float, kd: float) -> Terms:
        """Terms at the point (kp, kd) of the plane."""
        terms: Terms = {}
        for gain, part in zip((kp, kd), self.plane(), strict=True):
            for powers, share in part.items():
                terms[powers] = terms.get(powers, np.zeros(())) + gain * share
        return _nonzero(terms)


@dataclass(frozen=True)
class PD(Controller):
    """PD controller: kp [N m/rad], kd [N m s/rad], each a number, (n,) or (n, n)."""

    kp: Any
    kd: Any
    kind = "PD"
    GAINS = (
        GainKey("kp", "N·m/rad", "the gain on position", positive=True, of_task="1/s²"),
        GainKey("kd", "N·m·s/rad", "the gain on velocity", of_task="1/s"),
    )
    of_tasks = True

    def terms(self) -> Terms:
        return _nonzero({(0, 0): self.kp, (1, 0): self.kd})

    def units(self) -> dict[str, Controller]:
        return {"kp": replace(self, kp=1.0, kd=0.0), "kd": replace(self, kp=0.0, kd=1.0)}

    def plane(self) -> tuple[Terms, Terms]:
        return _nonzero({(0, 0): 1.0}), _nonzero({(1, 0): 1.0})

    def plane_gains(self) -> tuple[float, float]:
        return self.kp, self.kd

    def from_plane(self, kp: float, kd: float) -> "PD":
        return replace(self, kp=kp, kd=kd)


@dataclass(frozen=True)
class PID(Controller):
    """PID controller: kp [N m/rad], ki [N m/(rad s)], kd [N m s/rad], each a number, (n,) or (n, n)."""

    kp: Any
    ki: Any
    kd: Any
    kind = "PID"
    GAINS = (PD.GAINS[0], GainKey("ki", "N·m/(rad·s)", "the gain on the integral"), PD.GAINS[1])
    held_ratio = "ki/kp"

    def terms(self) -> Terms:
        return _nonzero({(0, 0): self.kp, (1, 0): self.kd, (0, 1): self.ki})

    def units(self) -> dict[str, Controller]:
        return {"kp": replace(self, kp=1.0, ki=0.0, kd=0.0), "kd": replace(self, kp=0.0, ki=0.0, kd=1.0)}

    def plane(self) -> tuple[Terms, Terms]:
        """Terms of kp and kd in the kp–kd plane, with ki/kp held."""
        return _nonzero({(0, 0): 1.0, (0, 1): _ratio("PID", "ki/kp", self.ki, self.kp)}), _nonzero({(1, 0): 1.0})

    def plane_gains(self) -> tuple[float, float]:
        return self.kp, self.kd

    def from_plane(self, kp: float, kd: float) -> "PID":
        return replace(self, kp=kp, ki=_ratio("PID", "ki/kp", self.ki, self.kp) * kp, kd=kd)


@dataclass(frozen=True)
class PPI(Controller):
    """Cascade u = (kv + ki/s)(kp (x_d − x) − ẋ): kp [1/s], kv [N m s/rad], ki [N m/rad]: numbers, (n,) or (n, n)."""

    kp: Any
    kv: Any
    ki: Any = 0.0
    kind = "P/PI"
    GAINS = (
        GainKey("kp", "1/s", "the gain on position", positive=True, of_task="1/s"),
        GainKey("kv", "N·m·s/rad", "the gain on velocity", positive=True, of_task="1/s"),
        GainKey("ki", "N·m/rad", "the gain on the integral", of_task="1/s²"),
    )
    of_tasks = True
    plane_names = ("kv·kp", "kv")
    damping_name = "kv"
    held_ratio = "ki/kv"
    rate_of_error = False

    def terms(self) -> Terms:
        outer_kv, outer_ki = _product(self.kv, self.kp), _product(self.ki, self.kp)
        return _nonzero({(0, 0): outer_kv, (1, 0): self.kv, (0, 1): outer_ki, (1, 1): self.ki})

    def on_joint(self, k: int, size: int) -> Controller:
        """Controller of joint `k` alone; the equivalent PID where gains are matrices, whose products mix joints."""
        if all(np.ndim(getattr(self, name)) < 2 for name in self.gain_names()):
            return super().on_joint(k, size)
        return self.as_pid_on_joint(k, size)

    def as_pid_on_joint(self, k: int, size: int) -> PID:
        """PID equivalent to the diagonal of `terms` on joint `k` of `size`: velocity times integral of one error is its position."""
        own = {powers: own_gain(gain, k, size) for powers, gain in self.terms().items()}
        kp, ki, kd = own.get((0, 0), 0.0) + own.get((1, 1), 0.0), own.get((0, 1), 0.0), own.get((1, 0), 0.0)
        return PID(kp, ki, kd, **self.filters)

    def scaled(self, factor: float) -> "PPI":
        return replace(self, kv=self.kv * factor, ki=self.ki * factor)

    def plane(self) -> tuple[Terms, Terms]:
        """Terms of the kp–kd plane: its kp is kv·kp and its kd is kv (torque per position and velocity), with ki/kv held."""
        share = _ratio("PPI", "ki/kv", self.ki, self.kv)
        return _nonzero({(0, 0): 1.0, (0, 1): share}), _nonzero({(1, 0): 1.0, (1, 1): share})

    def plane_gains(self) -> tuple[float, float]:
        return self.kv * self.kp, self.kv

    def from_plane(self, kp: float, kd: float) -> "PPI":
        return replace(self, kp=_ratio("PPI", "kp/kd", kp, kd), kv=kd, ki=_ratio("PPI", "ki/kv", self.ki, self.kv) * kd)


@dataclass(frozen=True)
class TorqueFeedback(Controller):
    """PD controller of one joint with feedback of its spring's torque: u = −(kp + kd V) y − F (ktau + kstau D) τ_J.

    kp [N m/rad], kd [N m s/rad] as PD; ktau [-] and kstau [s] of either sign act on the torque, behind the velocity's filter F, D its
    difference. After Albu-Schäffer, Ott and Hirzinger 2007, A unified passivity-based control framework for flexible joint robots.
    """

    kp: Any
    kd: Any
    ktau: Any
    kstau: Any = 0.0
    kind = "PD with torque feedback"
    GAINS = (
        *PD.GAINS,
        GainKey("ktau", "", "the gain on the spring's torque", signed=True),
        GainKey("kstau", "s", "the gain on the rate of the spring's torque", signed=True, needed=False),
    )
    has_plane = False
    torque_name = "ktau"
    of_one_joint = True

    def terms(self) -> Terms:
        return _nonzero({(0, 0): self.kp, (1, 0): self.kd})

    def torque_law(self, sample_time: float | None) -> Factored:
        num, den = (np.ones(1), np.ones(1)) if self.velocity_filter is None else self.velocity_filter.polynomials(sample_time)
        if self.kstau == 0:
            return ratio(self.ktau * num, den, sample_time)
        # ktau + kstau D with D = s, or v/(1 + T_s v)
        rate, late = ([self.kstau, self.ktau], [1.0])
        if sample_time is not None:
            rate, late = [self.kstau + self.ktau * sample_time, self.ktau], [sample_time, 1.0]
        return ratio(np.convolve(rate, num), np.convolve(late, den), sample_time)


@dataclass(frozen=True)
class DisturbanceObserver(Controller):
    """PD controller with a disturbance observer, sampled: u = −(C + Q J D²)/(1 − Q z^−n) y, C = kp + kd D, D = (1 − z⁻¹)/T_s.

    What torque the motor of nominal inertia J [kg m²] would need for the motion y, less the torque sent n = delay_ticks ticks ago, is the
    disturbance, and sent against it behind the low-pass filter Q of order 2, both poles at `bandwidth` [rad/s]. n counts the whole ticks
    of the drive's delay, and one for the hold. After Ohnishi, Shibata and Murakami 1996, Motion control for advanced mechatronics.
    """

    kp: Any
    kd: Any
    nominal_inertia: Any
    bandwidth: Any
    delay_ticks: Any
    kind = "PD with disturbance observer"
    GAINS = (
        *PD.GAINS,
        GainKey("nominal_inertia", "kg·m²", "the inertia that the disturbance observer takes the motor to have", positive=True),
        GainKey("bandwidth", "rad/s", "the bandwidth of the disturbance observer", positive=True, scales=False, needed=False),
        GainKey("delay_ticks", "ticks", "the delay that the disturbance observer takes torques to have", scales=False, needed=False),
    )
    has_plane = False
    of_one_joint = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(np.size(getattr(self, name)) != 1 for name in self.gain_names()) or min(self.kp, self.bandwidth) <= 0:
            raise GainroomError("DisturbanceObserver: its values must be single numbers, kp > 0 N·m/rad and bandwidth > 0 rad/s")
        _refuse_velocity_filter(self)
        if self.delay_ticks != round(self.delay_ticks) or not 0 <= self.delay_ticks <= MOST_TICKS:
            raise GainroomError(f"DisturbanceObserver: delay_ticks {self.delay_ticks:g} must be a whole number from 0 to {MOST_TICKS}")

    def terms(self) -> Terms:
        """Gain kp; what it multiplies is in `shaping`."""
        return _nonzero({(0, 0): self.kp})

    def shaping(self, sample_time: float | None) -> Factored:
        if sample_time is None:
            raise GainroomError("DisturbanceObserver: needs a sample rate: it is a difference equation with whole ticks of delay")
        law = observed_disturbance(self.kp, self.kd, self.nominal_inertia, self.bandwidth, int(self.delay_ticks), sample_time)
        return law.scaled(1 / self.kp) * super().shaping(sample_time)

    def corners(self, sample_time: float | None) -> Corners:
        return _corners_in_s(self.shaping(sample_time))


@dataclass(frozen=True)
class Compensator(Controller):
    """Scalar LTI system used as controller on every joint; `system` is any LTI that gainroom.loop_from accepts, except a callable.

    motor, link, torque   in place of `system`: sampled LTI systems of one joint by what they measure, the motor's or the link's position
                          or the torque of the spring, whose outputs are added
    """

    system: Any = None
    gain: Any = 1.0
    motor: Any = field(default=None, kw_only=True)
    link: Any = field(default=None, kw_only=True)
    torque: Any = field(default=None, kw_only=True)
    kind = "LTI"
    GAINS = (GainKey("gain", meaning="the factor on all of it", needed=False),)
    has_plane = False
    of_one_joint = True

    def __post_init__(self) -> None:
        for name in ("system", *SENSORS):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, factored_from(getattr(self, name)))
        if (self.system is None) != bool(self.laws):
            raise GainroomError("Compensator: needs either system, or motor, link and torque, one or more of them")
        if len({one.sample_time for one in self.laws.values()}) > 1:
            raise GainroomError("Compensator: motor, link and torque must have the same sample time")
        if self._is_apart:
            self._require_together()
        super().__post_init__()
        _refuse_velocity_filter(self)

    @property
    def laws(self) -> dict[Sensor, Factored]:  # type: ignore[override] - of the instance
        """Transfer function by sensor, where they were given so."""
        return {sensor: getattr(self, sensor) for sensor in SENSORS if getattr(self, sensor) is not None}

    @property
    def _is_apart(self) -> bool:
        """True if it has more than the law of one position."""
        return bool(self.laws) and Feedback.of_law(self.laws).mixed

    def _require_together(self) -> None:
        """Raise GainroomError for what several laws cannot be together."""
        for sensor, law in self.laws.items():
            if law.sample_time is None or law.delay or law.relative_degree < 0:
                raise GainroomError(f"Compensator: {sensor} must be sampled and have no more zeros than poles, and no delay but poles at 0")
        lasting = [pole for law in self.laws.values() for pole in law.poles[growth(law.poles, law.sample_time) >= 0].tolist()]
        own = [set(law.poles.tolist()) for law in self.laws.values()]
        for pole in set(lasting):
            if sum(pole in poles for poles in own) > 1:
                step = next(iter(self.laws.values())).sample_time
                at = 1 + pole * (step or 0.0)
                shown = f"{at.real:g}" if not at.imag else f"{at:g}"
                raise GainroomError(
                    f"Compensator: {' and '.join(self.laws)} share the pole {shown}, which does not decay: two memories that sum up the "
                    "same torque drift apart unseen; leave it to one of them"
                )

    def terms(self) -> Terms:
        return _nonzero({(0, 0): self.gain})

    def law(self, sensor: Sensor, feedback: Feedback, sample_time: float | None) -> Factored:
        if not self._is_apart:
            return super().law(sensor, feedback, sample_time)
        if sensor not in self.laws:
            return ratio([0.0], [1.0], sample_time)
        return self._at_rate(self.laws[sensor], sample_time).scaled(self.gain) * super().shaping(sample_time)

    def shaping(self, sample_time: float | None) -> Factored:
        if self._is_apart:
            return super().shaping(sample_time)
        own = self.system or next(iter(self.laws.values()))
        return self._at_rate(own, sample_time) * super().shaping(sample_time)

    def corners(self, sample_time: float | None) -> Corners:
        laws = self.laws.values() if self._is_apart else [self.shaping(sample_time)]
        each = [_corners_in_s(law) for law in laws]
        return Corners(*(np.concatenate([getattr(one, name) for one in each]) for name in ("poles", "zeros")))

    @staticmethod
    def _at_rate(system: Factored, sample_time: float | None) -> Factored:
        if system.sample_time != sample_time:
            raise GainroomError(f"controller: sample time {system.sample_time} must equal the loop's sample_time {sample_time}")
        return system


CONTROLLERS: dict[str, type[Controller]] = {
    "pd": PD,
    "pid": PID,
    "ppi": PPI,
    "torque_feedback": TorqueFeedback,
    "dob": DisturbanceObserver,
    "lti": Compensator,
}
"""Controllers that files may name, by `control.type`."""


def type_of(controller: Controller) -> str:
    """`control.type` of a controller in files; its class name where files have no such type."""
    known = (name for name, one in CONTROLLERS.items() if type(controller) is one)
    return next(known, type(controller).__name__.lower())


def _corners_in_s(law: Factored) -> Corners:
    """Poles and zeros in s of a law; of a sampled one without those at z = 0, which are delays."""
    time = law.sample_time
    if time is None:
        return Corners(law.poles, law.zeros)
    poles, zeros = (np.log([z for z in 1 + time * roots if abs(z) > 1e-6]) / time for roots in (law.poles, law.zeros))
    return Corners(poles.astype(complex), zeros.astype(complex))


def gain_matrix(name: str, gain: ArrayLike, size: int) -> Floats:
    """`gain` as an (n, n) matrix: a number or an (n,) vector goes on the diagonal."""
    gain = np.asarray(gain, dtype=float)
    if gain.ndim == 2 and gain.shape == (size, size):
        return gain
    if gain.ndim == 0 or gain.shape == (size,):
        matrix = np.zeros((size, size))
        matrix.reshape(-1)[:: size + 1] = gain
        return matrix
    raise GainroomError(f"{name} of shape {gain.shape} must be a number, ({size},) or ({size}, {size})")


def own_gain(gain: ArrayLike, k: int, size: int) -> float:
    """Diagonal entry of a gain for joint `k` of `size`; 0 where task matrices hold round-off alone, on joints that no task moves."""
    own = float(gain_matrix("gain", gain, size)[k, k])
    return own if np.ndim(gain) < 2 or abs(own) > ROUND_OFF * np.abs(gain).max() else 0.0


def _refuse_velocity_filter(controller: Controller) -> None:
    """Raise GainroomError for a filter of the velocity where the controller makes none of its own."""
    if controller.velocity_filter is not None:
        raise GainroomError(f"{type(controller).__name__}: velocity_filter: acts on nothing here, as its law has no velocity of its own")


def _require_all(owner: str, name: str, values: tuple[Any, ...], kind: type) -> None:
    """Raise GainroomError unless all of `values` are of a kind of filter."""
    if strange := [value for value in values if not isinstance(value, kind)]:
        raise GainroomError(f"{owner}: {name} {one_line(repr(strange), 80)} must be a {kind.__name__}")


def _ratio(owner: str, name: str, above: Any, below: Any) -> float:
    if np.ndim(above) or np.ndim(below):
        raise GainroomError(f"{owner}: {name} must be a ratio of single numbers")
    if below == 0 and above != 0:
        raise GainroomError(f"{owner}: {name} = {above:g}/0 cannot be held")
    return above / below if above else 0.0


def _product(left: Any, right: Any) -> Any:
    """Matrix product of two gains, each a number, a diagonal (n,) or (n, n)."""
    if np.ndim(right) < 2:
        return left * right
    return left @ right if np.ndim(left) == 2 else np.reshape(left, (-1, 1)) * right


def _scaled(terms: Mapping[tuple[int, int], Any], factor: float) -> Terms:
    return {powers: factor * np.asarray(gain, dtype=float) for powers, gain in terms.items()}


def _sum(one: Terms, other: Terms) -> Terms:
    return {powers: one.get(powers, np.zeros(())) + other.get(powers, np.zeros(())) for powers in one.keys() | other.keys()}


def _same(one: Terms, other: Terms) -> bool:
    """True if two control laws are equal within round-off."""
    nothing = np.zeros(())
    return all(
        np.allclose(one.get(powers, nothing), other.get(powers, nothing), rtol=1e-12, atol=0.0) for powers in one.keys() | other.keys()
    )


def _same_factors(one: Factored, other: Factored) -> bool:
    """True if two transfer functions have the same zeros, poles, gain and delay."""
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("zeros", "poles", "gain", "delay"))


def _nonzero(terms: dict[tuple[int, int], Any]) -> Terms:
    return {powers: np.asarray(gain, dtype=float) for powers, gain in terms.items() if np.any(gain) or not np.size(gain)}
