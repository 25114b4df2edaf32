"""Structures of a controller whose parameters are searched: laws u = −Σ K_i y_i of a parameter vector.

    pd, pid          kp + kd D + ki I on the position, D = (1 − z⁻¹)/T_s, I = T_s/(1 − z⁻¹), with n biquads on all of it
    split            kd D F in the drive, at a rate and delay of its own, kp on the host
    torque_feedback  F (kd D y + (ktau + kstau D) τ) beside kp y, τ the spring's torque; kd and τ in the drive where so asked

F is a low-pass of first order. A pid is a P/PI: the feedback of both is the same.

Parameters are searched in ln where they are positive, so that a step means the same whatever their size.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...system.controller import PD, PID, Controller, TorqueFeedback
from ...system.feedback import feedback_of
from ...system.filters import Biquad, LowPass
from ...system.gain_path import GainPath
from ...system.linear.arrays import Complexes, Floats
from ...system.system import System
from .joint_responses import DRIVE, HOST

NYQUIST = 0.95
"""Highest frequency of a filter, as a share of half its rate."""
BIQUAD = ("zero_frequency", "zero_damping", "pole_frequency", "pole_damping")
"""Parameters of a biquad, in the order of the filter's own."""
START_KD = 0.35  # times inertia over lag: what delay alone allows a rigid joint, about


@dataclass(frozen=True)
class Parameter:
    """One parameter of a structure, with the range in which the search starts; positive ones are searched in ln.

    least, most   limits of the search, none of them meant to be reached but that of filters at half the rate
    """

    name: str
    unit: str
    low: float
    high: float
    least: float = 0.0
    most: float = math.inf

    @property
    def positive(self) -> bool:
        """True if the parameter is searched in ln."""
        return self.low > 0

    def encoded(self, value: float) -> float:
        """Coordinate of a value in the search."""
        return math.log(value) if self.positive else value / self.high


@dataclass(frozen=True)
class Law:
    """Response K (batch, m) from one sensor to the command on one path, u = −K y."""

    path: str
    sensor: str
    response: Complexes


@dataclass(frozen=True)
class Structure:
    """A structure of gains and filters.

    key        in files and results
    position   sensor of the position, "motor" or "link"
    integral   True: with ki
    biquads    number of biquads on the whole command
    velocity   path that kd runs on
    torque     path of the torque feedback; "": none
    ranges     of the parameters, by field; those of biquads with its index (zero_frequency_0)
    """

    key: str
    position: str = "motor"
    integral: bool = False
    biquads: int = 0
    velocity: str = HOST
    torque: str = ""
    ranges: Mapping[str, Parameter] = field(default_factory=dict, compare=False)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sensors that the laws read."""
        return (self.position, *(("torque",) if self.torque else ()))

    @property
    def in_drive(self) -> bool:
        """True if part of the law runs in the drive."""
        return DRIVE in (self.velocity, self.torque)

    @property
    def where(self) -> str:
        """Places where the law runs, in words: "host", "host, kd in the drive"."""
        parts = [name for name, path in (("kd", self.velocity), ("τ_J", self.torque)) if path == DRIVE]
        return f"host, {' and '.join(parts)} in the drive" if parts else "host"

    @property
    def filtered(self) -> bool:
        """True if velocity, and the spring's torque, pass a low-pass."""
        return self.in_drive or bool(self.torque)

    @property
    def integrators(self) -> int:
        """Poles of the law at z = 1."""
        return int(self.integral)

    def scaled_to(self, system: System, path: GainPath | None) -> "Structure":
        """Structure with the ranges of its parameters on the joint of `system`."""
        joint, step = system.source, system.control.sample_time
        assert step is not None
        lag = system.delay + step
        soft = math.isfinite(joint.stiffness) and joint.resonance < 1 / lag  # the load is off where the delay limits
        inertia = joint.motor_inertia if soft else joint.motor_inertia + joint.link_inertia
        kd = START_KD * inertia / lag
        rate, quick = step, lag
        ranges: dict[str, Parameter] = {}
        if self.velocity == DRIVE:
            assert path is not None
            rate, quick = path.sample_time, path.delay + path.sample_time
            most = 1.2 * START_KD * inertia / quick
            ranges["kp"] = Parameter("kp", "N·m/rad", kd, 400 * kd)
            ranges["kd"] = Parameter("kd", "N·m·s/rad", 0.2 * kd, most)
        else:
            ranges["kp"] = Parameter("kp", "N·m/rad", kd, 120 * kd)
            ranges["kd"] = Parameter("kd", "N·m·s/rad", 0.2 * kd, 12 * kd)
        if self.integral:
            ranges["ki"] = Parameter("ki", "N·m/(rad·s)", 0.1 * kd, 600 * kd)
        if self.filtered:
            most = NYQUIST * math.pi / rate
            ranges["bandwidth"] = Parameter("bandwidth", "rad/s", min(0.5 / lag, 0.1 * most), min(5 / lag, most), most=most)
            if self.velocity == DRIVE:
                ranges["bandwidth"] = Parameter("bandwidth", "rad/s", 0.15 / lag, min(2 / quick, most), most=most)
        if self.torque:
            ranges["ktau"] = Parameter("ktau", "", -1.0, 1.0, -math.inf)
            ranges["kstau"] = Parameter("kstau", "s", -8 * lag, 8 * lag, -math.inf)
        most = NYQUIST * math.pi / step
        for k in range(self.biquads):
            low, high = 0.025 / lag, min(3.75 / lag, most)
            ranges[f"zero_frequency_{k}"] = Parameter("zero_frequency", "rad/s", low, high, most=most)
            ranges[f"zero_damping_{k}"] = Parameter("zero_damping", "", 0.04, 2.0, 0.01, 20.0)
            ranges[f"pole_frequency_{k}"] = Parameter("pole_frequency", "rad/s", low, high, most=most)
            ranges[f"pole_damping_{k}"] = Parameter("pole_damping", "", 0.05, 2.5, 0.04, 20.0)
        return replace(self, ranges=ranges)

    # the search's coordinates

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of the coordinates."""
        return tuple(self.ranges.values())

    def coordinates(self, values: Mapping[str, float]) -> Floats:
        """Coordinates (n,) of parameters by field."""
        return np.array([one.encoded(values[name]) for name, one in self.ranges.items()])

    def by_field(self, x: Floats) -> dict[str, float]:
        """Parameters of coordinates (n,), by field."""
        return dict(zip(self.ranges, self.values(x).tolist(), strict=True))

    @property
    def box(self) -> tuple[Floats, Floats]:
        """Coordinates (n,), (n,) between which the search starts."""
        ends = [(one.encoded(one.low), one.encoded(one.high)) for one in self.parameters]
        return np.array([low for low, _ in ends]), np.array([high for _, high in ends])

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """Coordinates (n,), (n,) that the search never leaves."""
        low = [math.log(one.least) if one.positive and one.least > 0 else -math.inf for one in self.parameters]
        high = [one.encoded(one.most) if math.isfinite(one.most) else math.inf for one in self.parameters]
        return np.array(low), np.array(high)

    def values(self, x: Floats) -> Floats:
        """Parameters (…, n) [SI] at coordinates x (…, n)."""
        positive = np.array([one.positive for one in self.parameters])
        scale = np.array([1.0 if one.positive else one.high for one in self.parameters])
        return np.where(positive, np.exp(np.where(positive, x, 0.0)), scale * x)

    def laws(self, x: Floats, omega: Floats, sample_times: Mapping[str, float]) -> list[Law]:
        """Laws of the coordinates x (batch, n) at omega (m,) [rad/s]."""
        value = dict(zip(self.ranges, self.values(np.atleast_2d(x)).T[:, :, None], strict=True))
        late = {path: np.exp(-1j * omega * step) for path, step in sample_times.items()}
        slope = {path: (1 - late[path]) / step for path, step in sample_times.items()}
        shape: Any = 1.0
        for k in range(self.biquads):
            zero, zero_damping, pole, pole_damping = (value[f"{name}_{k}"] for name in BIQUAD)
            shape = shape * biquad_response(zero, zero_damping, pole, pole_damping, late[HOST], sample_times[HOST])
        passed = {}
        if self.filtered:
            for path in {self.velocity, *([self.torque] if self.torque else [])}:
                passed[path] = low_pass_response(value["bandwidth"], late[path], sample_times[path])
        on_host = value["kp"] + (value["ki"] * sample_times[HOST] / (1 - late[HOST]) if self.integral else 0.0)
        rate = value["kd"] * slope[self.velocity] * (passed[self.velocity] if self.filtered else 1.0)
        found = []
        if self.velocity == HOST:
            found.append(Law(HOST, self.position, shape * (on_host + rate)))
        else:
            found += [Law(HOST, self.position, shape * on_host * np.ones_like(late[HOST])), Law(DRIVE, self.position, rate)]
        if self.torque:
            fed = (value["ktau"] + value["kstau"] * slope[self.torque]) * passed[self.torque]
            found.append(Law(self.torque, "torque", fed))
        return found

    def unstable_poles(self, x: Floats) -> Floats:
        """Number (batch,) of poles of the laws outside the unit circle: none, every filter is stable."""
        return np.zeros(len(np.atleast_2d(x)))

    def system(self, x: Floats, system: System, path: GainPath | None) -> System:
        """`system` with the controller of the coordinates x (n,)."""
        found = self.by_field(x)
        biquads = tuple(Biquad(*(found[f"{name}_{k}"] for name in BIQUAD)) for k in range(self.biquads))
        filters: dict[str, Any] = {"velocity_filter": LowPass(found["bandwidth"]) if self.filtered else None}
        if biquads:
            filters["biquads"] = biquads
        gains = {name: found[name] for name in ("kp", "ki", "kd", "ktau", "kstau") if name in found}
        kind = TorqueFeedback if self.torque else PID if self.integral else PD
        sides: Any = {"kp": self.position, "kd": self.position, "ktau": "torque"} if self.torque else self.position
        return closed_with(system, kind(**gains, **filters), sides, path if self.velocity == DRIVE else None)


def closed_with(system: System, controller: Controller, feedback: Any, path: GainPath | None = None) -> System:
    """`system` with a controller, its sensors, and the drive's path of its kd."""
    control = replace(system.control, controller=controller, feedback=feedback_of(feedback, controller), kd_path=path)
    return replace(system, control=control)


def low_pass_response(bandwidth: Floats, late: Complexes, step: float) -> Complexes:
    """Response (batch, m) of ω/(s + ω) by Tustin's rule exact at ω = `bandwidth` (batch, 1), at z⁻¹ = `late` (m,)."""
    a = np.tan(bandwidth * step / 2)
    return a * (1 + late) / ((1 + a) - (1 - a) * late)


def biquad_response(zero: Floats, zero_damping: Floats, pole: Floats, pole_damping: Floats, late: Complexes, step: float) -> Complexes:
    """Response (batch, m) of a biquad (system/filters.py) at z⁻¹ = `late` (m,); the numbers (batch, 1)."""
    c = pole / np.tan(pole * step / 2)
    above = _quadratic(c, zero, zero_damping, late) * (pole / zero) ** 2
    return above / _quadratic(c, pole, pole_damping, late)


def _quadratic(c: Floats, frequency: Floats, damping: Floats, late: Complexes) -> Complexes:
    """Polynomial s² + 2ζω s + ω² with s = c (1 − z⁻¹)/(1 + z⁻¹), times (1 + z⁻¹)²."""
    middle, square = 2 * damping * frequency * c, frequency**2
    return (c * c + middle + square) + ((2 * (square - c * c)) + (c * c - middle + square) * late) * late
