"""The drive: current loop and pure delay from target torque to motor torque.

τ_m = C(s) e^{−sT} τ_d,    C = ω_c² / (s² + 2 ζ ω_c s + ω_c²)          Jung et al. 2017, eq. (3)
"""

import math
from dataclasses import dataclass

from ..errors import require_positive


@dataclass(frozen=True)
class Drive:
    """One joint's motor drive, or one drive used on every joint.

    bandwidth       ω_c of the current loop; inf: ideal [rad/s]
    damping_ratio   ζ of the current loop
    delay           T, from target torque to demand torque [s]
    resolution      step of the encoder that the loop is closed with, on the joint side [rad]; 0: not known. No margin depends on it
    torque_noise    standard deviation of the noise of the sensor of the spring's torque [N m]; None: not known
    """

    bandwidth: float = math.inf
    damping_ratio: float = 0.9
    delay: float = 0.0
    resolution: float = 0.0
    torque_noise: float | None = None

    def __post_init__(self) -> None:
        require_positive("drive", "bandwidth", self.bandwidth, "rad/s", infinite=True)
        require_positive("drive", "damping_ratio", self.damping_ratio)
        require_positive("drive", "delay", self.delay, "s", zero=True)
        require_positive("drive", "resolution", self.resolution, "rad", zero=True)
        if self.torque_noise is not None:
            require_positive("drive", "torque_noise", self.torque_noise, "N·m", zero=True)

    @property
    def is_ideal(self) -> bool:
        """True when the current loop is taken as infinitely fast."""
        return math.isinf(self.bandwidth)
