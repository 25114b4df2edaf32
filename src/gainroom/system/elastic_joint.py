"""One elastic joint: the plant for n = 1, and a source of plants for a System."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, require_positive
from .linear.arrays import Booleans, Floats
from .plant import Plant


@dataclass(frozen=True)
class ElasticJoint:
    """One motor, one gearbox, one load.

    motor_inertia   reflected to the joint side: rotor inertia × gear ratio² [kg m²]
    link_inertia    load inertia; inf: output locked [kg m²]
    stiffness       of the gearbox; inf: rigid [N m/rad]
    damping         of the gearbox [N m s/rad]
    motor_viscous, link_viscous   viscous friction to ground on either side [N m s/rad]

    Raises GainroomError where a value is not physical.
    """

    motor_inertia: float
    link_inertia: float
    stiffness: float = math.inf
    damping: float = 0.0
    motor_viscous: float = 0.0
    link_viscous: float = 0.0
    name: str = "joint"

    def __post_init__(self) -> None:
        owner = f"joint '{self.name}'"
        require_positive(owner, "stiffness", self.stiffness, "N·m/rad", infinite=True)
        if self.stiffness == math.inf and self.link_inertia == math.inf:
            raise GainroomError(f"{owner}: stiffness inf with link_inertia inf (output locked) leaves nothing to move; one must be finite")
        require_positive(owner, "motor_inertia", self.motor_inertia, "kg·m²", zero=math.isinf(self.stiffness))
        require_positive(owner, "link_inertia", self.link_inertia, "kg·m²", infinite=not math.isinf(self.stiffness))
        require_positive(owner, "damping", self.damping, "N·m·s/rad", zero=True)
        require_positive(owner, "motor_viscous", self.motor_viscous, "N·m·s/rad", zero=True)
        require_positive(owner, "link_viscous", self.link_viscous, "N·m·s/rad", zero=True)

    @classmethod
    def from_motor(cls, rotor_inertia: float, gear_ratio: float, link_inertia: float, **others: float) -> "ElasticJoint":
        """The joint of a rotor [kg m²] behind a gearbox: motor_inertia = rotor_inertia × gear_ratio²; `others` as for ElasticJoint."""
        require_positive("joint", "rotor_inertia", rotor_inertia, "kg·m²")
        require_positive("joint", "gear_ratio", gear_ratio)
        return cls(motor_inertia=rotor_inertia * gear_ratio**2, link_inertia=link_inertia, **others)  # type: ignore[arg-type]

    @property
    def antiresonance(self) -> float:
        """√(K/J_L) [rad/s]: the load oscillates against a fixed motor. inf for a rigid joint."""
        return math.sqrt(self.stiffness / self.link_inertia)

    @property
    def resonance(self) -> float:
        """√(K (1/J_M + 1/J_L)) [rad/s]: motor and load oscillate against each other, undamped. inf for a rigid joint."""
        if math.isinf(self.stiffness):
            return math.inf
        return math.sqrt(self.stiffness * (1 / self.motor_inertia + 1 / self.link_inertia))

    # A joint is a source of plants (system.py): a robot of one joint in one state.
    states: ClassVar[tuple[tuple[str, str], ...]] = (("", ""),)
    body: ClassVar[None] = None
    stack: ClassVar[tuple[()]] = ()
    prismatic: ClassVar[Booleans] = np.zeros(1, dtype=bool)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint name (1,)."""
        return (self.name,)

    @property
    def unknown(self) -> Mapping[str, tuple[str, ...]]:
        """Quantities without data: none, a joint is described completely."""
        return {}

    @property
    def quantities(self) -> Mapping[str, Floats]:
        """Inertias, gearbox and friction by name, each (1,)."""
        return {name: np.array([value]) for name, value in vars(self).items() if name != "name"}

    def with_quantities(self, **values: ArrayLike) -> "ElasticJoint":
        """Joint with `values` replaced, by name."""
        return replace(self, **{name: float(np.reshape(value, ())) for name, value in values.items()})

    def linearize(self, posture: str | None = None, contact: str | None = None, weight: bool = False) -> Plant:
        """Plant of this joint; arguments are those of PlantSource, a joint has one state without names."""
        return self.plant()

    def tasks(self, model: Plant, rotors: bool = False) -> NoReturn:
        """Raise GainroomError: a single joint has no tasks."""
        raise GainroomError(f"{self.name}: there are no tasks")

    def plant(self) -> Plant:
        """This joint as a plant of n = 1."""
        return Plant(
            link_inverse_inertia=np.array([[1 / self.link_inertia]]),
            motor_inertia=np.array([self.motor_inertia]),
            stiffness=np.array([self.stiffness]),
            damping=np.array([self.damping]),
            motor_viscous=np.array([self.motor_viscous]),
            link_viscous=np.array([self.link_viscous]),
            joint_names=(self.name,),
        )
