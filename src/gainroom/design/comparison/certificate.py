"""The certificate of a bound: weights, and all else that a recomputation needs, in one small JSON object (theory: dual_grid)."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import GainroomError
from ...system.linear.arrays import Floats
from ...system.linear.state_space import StateSpace
from .ceilings import Ceilings
from .closed_maps import stabilised
from .dual_grid import APART, DualGrid
from .exact_joint import SENSORS, ExactJoint

AGREEMENT = 4e-3  # relative, of the values on both grids
WEIGHTED = ("compliance", "sensitivity", "delay_reserve")
FORMAT = "gainroom bound 1"
MEMBERS = ("format", "value", "sensor", "joint", "ceilings", "points", "frequency", "weights", "noise_weight")


@dataclass(frozen=True)
class Certificate:
    """Weights that prove that no linear controller on `sensor` brings the peak of |q/d| below `value` [rad/(N m)].

    frequency (k,) [rad/s] from 0 to half the sample rate: knots of the weights, linear between them; weights (3, k): of WEIGHTED, the
    latter two in (rad/(N m))²; noise_weight: ν, likewise; points: of half a circle, on the coarser of two grids.
    """

    joint: ExactJoint
    ceilings: Ceilings
    sensor: str
    frequency: Floats
    weights: Floats
    noise_weight: float
    points: int
    value: float

    def __post_init__(self) -> None:
        half_rate = math.pi / self.joint.sample_time
        if self.sensor not in SENSORS:
            raise GainroomError(f"certificate: {self.sensor!r} is no sensor; there are {', '.join(SENSORS)}")
        if len(self.frequency) < 2 or self.weights.shape != (len(WEIGHTED), len(self.frequency)):
            raise GainroomError(f"certificate: weights {self.weights.shape} must be (3, {len(self.frequency)}), one per frequency")
        if not np.all(np.isfinite(self.weights)) or np.any(self.weights < 0) or not self.weights[0].any():
            raise GainroomError("certificate: weights must be finite and ≥ 0, and those of compliance not all 0")
        if not 0 <= self.noise_weight < math.inf or (self.noise_weight > 0 and self.ceilings.torque_noise is None):
            raise GainroomError(f"certificate: noise_weight {self.noise_weight:g} must be finite and ≥ 0, and 0 without a ceiling of noise")
        if self.frequency[0] != 0 or not math.isclose(self.frequency[-1], half_rate, rel_tol=1e-9):
            raise GainroomError(f"certificate: frequency must run from 0 to half the sample rate, {half_rate:g} rad/s")
        if not np.all(np.diff(self.frequency) >= APART * half_rate / self.points):
            raise GainroomError(f"certificate: frequencies must be {APART:g} steps of {half_rate / self.points:g} rad/s apart, or more")

    @cached_property
    def values(self) -> tuple[float, float]:
        """Bounds [rad/(N m)] as computed on a grid of `points` and on the doubled one."""
        held = stabilised(self.joint, (self.sensor,))

        def bound(points: int) -> float:
            grid = DualGrid.of(held, self.joint, self.ceilings, self.sensor, self.frequency, points)
            with np.errstate(all="ignore"):  # weights that somebody else wrote may overflow: such values do not agree
                return grid.bound(self.weights, self.noise_weight)

        return bound(self.points), bound(2 * self.points)

    @property
    def agreement(self) -> float:
        """Relative difference of the two values."""
        first, second = self.values
        return abs(first - second) / max(second, 1e-300)

    def check(self) -> float:
        """Value proved [rad/(N m)], computed anew on both grids. Raises GainroomError where it is below what is claimed, or they differ."""
        first, second = self.values
        if not self.agreement <= AGREEMENT:
            raise GainroomError(f"certificate: {first:.6g} and {second:.6g} rad/(N m) on the doubled grid do not agree")
        proved = max(min(first, second) - abs(first - second), 0.0)
        if not self.value <= proved * (1 + 1e-9):  # another machine's round-off
            raise GainroomError(f"certificate: claims {self.value:.9g} rad/(N m), but its weights prove {proved:.9g}")
        return proved

    def to_json(self) -> str:
        """Certificate as one JSON object: all that a recomputation needs, the joint as x⁺ = x + T_s (a x + b [u, d]), y = c x."""
        space = self.joint.state_space
        rows = {name: space.c[SENSORS.index(name)].tolist() for name in dict.fromkeys(("link", self.sensor))}
        noise = self.ceilings.torque_noise
        held = {} if self.joint.held is None else {"held": list(self.joint.held)}
        return json.dumps(
            {
                "format": FORMAT,
                "value": self.value,
                "sensor": self.sensor,
                "joint": {"sample_time": self.joint.sample_time, "a": space.a.tolist(), "b": space.b.tolist(), "c": rows, **held},
                "ceilings": {
                    "delay_reserve": self.ceilings.delay_reserve,
                    "peak_sensitivity": self.ceilings.peak_sensitivity,
                    "torque_noise": noise,
                    "sensor_noise": None if noise is None else self.ceilings.sensor_noise[self.sensor],
                },
                "points": self.points,
                "frequency": self.frequency.tolist(),
                "weights": dict(zip(WEIGHTED, self.weights.tolist(), strict=True)),
                "noise_weight": self.noise_weight,
            }
        )

    @classmethod
    def from_json(cls, text: str) -> "Certificate":
        """Certificate as to_json wrote it. Raises GainroomError for anything else; what it claims is judged by `check` alone."""
        try:
            given = json.loads(text)
        except ValueError as error:
            raise GainroomError(f"certificate: is no JSON: {error}") from error
        found = _members(
            given, "certificate", ("format", "value", "sensor", "joint", "ceilings", "points", "frequency", "weights", "noise_weight")
        )
        if found["format"] != FORMAT:
            raise GainroomError(f"certificate: format {found['format']!r} must be {FORMAT!r}")
        sensor, points = found["sensor"], found["points"]
        if sensor not in SENSORS:
            raise GainroomError(f"certificate: {sensor!r} is no sensor; there are {', '.join(SENSORS)}")
        if type(points) is not int or not 2**10 <= points <= 2**20:
            raise GainroomError(f"certificate: points {points!r} must be a whole number from 2^10 to 2^20")
        named = isinstance(found["joint"], dict) and "held" in found["joint"]
        joint = _members(found["joint"], "joint", ("sample_time", "a", "b", "c", *(("held",) if named else ())))
        rows = _members(joint["c"], "c", tuple(dict.fromkeys(("link", sensor))))
        a = _numbers(joint["a"], "a", None)
        size = len(a)
        if not 1 <= size <= 300:
            raise GainroomError(f"certificate: a has {size} rows, not 1 to 300")
        c = np.full((len(SENSORS), size), np.nan)
        for name, row in rows.items():
            c[SENSORS.index(name)] = _numbers(row, f"c of {name}", (size,))
        space = StateSpace(a.reshape(size, -1), _numbers(joint["b"], "b", (size, 2)), c, np.zeros((len(SENSORS), 2)))
        if space.a.shape != (size, size):
            raise GainroomError(f"certificate: a must be square, not {space.a.shape}")
        bounds = _members(found["ceilings"], "ceilings", ("delay_reserve", "peak_sensitivity", "torque_noise", "sensor_noise"))
        quiet = bounds["torque_noise"] is None
        ceilings = Ceilings(
            _number(bounds["delay_reserve"], "delay_reserve"),
            _number(bounds["peak_sensitivity"], "peak_sensitivity"),
            None if quiet else _number(bounds["torque_noise"], "torque_noise"),
            {} if quiet else {sensor: _number(bounds["sensor_noise"], "sensor_noise")},
        )
        frequency = _numbers(found["frequency"], "frequency", None)
        weights = _members(found["weights"], "weights", WEIGHTED)
        table = np.array([_numbers(weights[name], f"weights of {name}", frequency.shape) for name in WEIGHTED])
        sample_time = _number(joint["sample_time"], "sample_time")
        if sample_time <= 0 or frequency.ndim != 1:
            raise GainroomError("certificate: sample_time must be > 0, and frequency a list of numbers")
        noise_weight, value = _number(found["noise_weight"], "noise_weight"), _number(found["value"], "value")
        held = None
        if named:
            kp, kd = _numbers(joint["held"], "held", (2,)).tolist()
            held = (kp, kd)
        return cls(ExactJoint(space, sample_time, held), ceilings, sensor, frequency, table, noise_weight, points, value)


def _members(given: Any, what: str, names: Sequence[str]) -> Mapping[str, Any]:
    """Members of a JSON object that has all of `names` and no others."""
    if not isinstance(given, dict) or set(given) != set(names):
        raise GainroomError(f"certificate: {what} must be an object with exactly {', '.join(names)}")
    return given


def _number(given: Any, what: str) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
        raise GainroomError(f"certificate: {what} {given!r} must be a finite number")
    return float(given)


def _numbers(given: Any, what: str, shape: tuple[int, ...] | None) -> Floats:
    """Array of finite numbers, of the shape where one is given."""
    try:
        array = np.array(given)
    except ValueError as error:
        raise GainroomError(f"certificate: {what} must be a list of numbers") from error
    if array.dtype.kind not in "if" or array.ndim == 0 or not np.all(np.isfinite(array)) or (shape is not None and array.shape != shape):
        wanted = "" if shape is None else f" of shape {shape}"
        raise GainroomError(f"certificate: {what} must be a list of finite numbers{wanted}")
    return array.astype(float)
