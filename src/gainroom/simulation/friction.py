"""Friction of a motor or a link: Coulomb, Stribeck and viscous, or LuGre with its bristles.

Sliding steadily at velocity v the torque against the motion is, in either model,

    F(v) = F_C + (F_S − F_C) e^{−(v/v_s)²}    (+ viscous · v)

Without bristles the contact sticks at v = 0 and carries up to F_S. With bristles (Canudas de Wit, Olsson, Åström and
Lischinsky, A new model for control of systems with friction, 1995) it is a spring there:

    τ = σ_0 z + σ_1 ż + viscous · v,    ż = v − σ_0 |v| / F(v) · z
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_positive
from ..system.linear.arrays import Floats


@dataclass(frozen=True)
class Friction:
    """Friction at one contact, on the joint side of the gearbox.

    coulomb            F_C, sliding fast [N m]
    static             F_S ≥ F_C, breakaway torque; None: equal to coulomb [N m]
    stribeck_velocity  v_s, over which F_S falls to F_C [rad/s]
    viscous            [N m s/rad], in addition to the joint's own
    bristle_stiffness  σ_0 [N m/rad]; inf: no bristles, ideal sticking
    bristle_damping    σ_1 [N m s/rad]

    Raises GainroomError where a value is not physical.
    """

    coulomb: float = 0.0
    static: float | None = None
    stribeck_velocity: float = 0.1
    viscous: float = 0.0
    bristle_stiffness: float = math.inf
    bristle_damping: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (("coulomb", "N·m"), ("viscous", "N·m·s/rad"), ("bristle_damping", "N·m·s/rad")):
            require_positive("friction", name, getattr(self, name), unit, zero=True)
        require_positive("friction", "stribeck_velocity", self.stribeck_velocity, "rad/s")
        require_positive("friction", "bristle_stiffness", self.bristle_stiffness, "N·m/rad", infinite=True)
        if self.static is None:
            object.__setattr__(self, "static", self.coulomb)
        elif require_positive("friction", "static", self.static, "N·m", zero=True) < self.coulomb:
            raise GainroomError(f"friction: static {self.static:g} N·m must be >= coulomb {self.coulomb:g} N·m")
        if self.coulomb == 0 and self.breakaway > 0:
            raise GainroomError(f"friction: coulomb must be > 0 where static is {self.breakaway:g} N·m")
        if self.bristle_damping > 0 and math.isinf(self.bristle_stiffness):
            raise GainroomError("friction: bristle_damping needs a finite bristle_stiffness")

    @property
    def breakaway(self) -> float:
        """Breakaway torque F_S [N m]."""
        return self.coulomb if self.static is None else float(self.static)

    @property
    def is_viscous(self) -> bool:
        """True if there is no stiction: the friction is linear."""
        return self.coulomb == 0  # then F_S and the bristles' torque are 0 too

    def torque(self, velocity: ArrayLike) -> Floats:
        """Friction torque at constant `velocity` [rad/s], any shape; 0 at rest, where it balances the load."""
        v = np.asarray(velocity, dtype=float)
        dry = self.coulomb + (self.breakaway - self.coulomb) * np.exp(-((v / self.stribeck_velocity) ** 2))
        return np.sign(v) * dry + self.viscous * v

    def law(self) -> Floats:
        """Parameters (F_C, F_S, v_s, σ_0, σ_1) for the kernel; viscous friction belongs to the plant."""
        return np.array([self.coulomb, self.breakaway, self.stribeck_velocity, self.bristle_stiffness, self.bristle_damping])
