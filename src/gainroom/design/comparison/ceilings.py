"""Ceilings of every controller of a comparison: sensitivity, delay reserve and torque noise, each convex in the closed loop."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ...errors import GainroomError, require_positive
from ...system.delay_reserve import turned
from ...system.linear.arrays import Floats
from .exact_joint import SENSORS


@dataclass(frozen=True)
class Ceilings:
    """Ceilings of S = 1/(1 + L), T = 1 − S and the torque command, with L broken at the motor torque.

    |S| ≤ peak_sensitivity; |T| |1 − e^(−jωτ)| ≤ 1 up to ωτ = π and 2 |T| ≤ 1 beyond, with τ = delay_reserve [s]: stable for every further
    delay up to τ; rms torque command ≤ torque_noise [N m], None: no ceiling, where each sensor adds white noise of the standard deviation
    sensor_noise[its name] per sample (an encoder: step/√12).
    """

    delay_reserve: float
    peak_sensitivity: float = 2.0
    torque_noise: float | None = None
    sensor_noise: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_positive("ceilings", "delay_reserve", self.delay_reserve, "s", zero=True)
        if not 1 < self.peak_sensitivity < math.inf:
            raise GainroomError(f"ceilings: peak_sensitivity = {self.peak_sensitivity:g} must be > 1 and finite")
        if self.torque_noise is not None:
            require_positive("ceilings", "torque_noise", self.torque_noise, "N m")
        for name, value in self.sensor_noise.items():
            if name not in SENSORS:
                raise GainroomError(f"ceilings: {name!r} is no sensor; there are {', '.join(SENSORS)}")
            require_positive("ceilings", f"sensor_noise of {name}", value, zero=True)

    def delay_weight(self, omega: Floats) -> Floats:
        """Factor on |T| in the ceiling of the delay reserve, at omega [rad/s]."""
        return turned(omega * self.delay_reserve)

    def noise_of(self, sensor: str) -> float | None:
        """Standard deviation of a sensor's noise as a share of torque_noise [1/(N m)]; None where torque noise has no ceiling."""
        if self.torque_noise is None:
            return None
        if sensor not in self.sensor_noise:
            raise GainroomError(f"torque_noise is bounded, but sensor_noise has no entry for the sensor {sensor!r}")
        return self.sensor_noise[sensor] / self.torque_noise
