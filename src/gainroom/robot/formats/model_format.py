"""What a file format of robots does. A new format is a file beside this one with a subclass, and its line in FORMATS of model_files.py."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar
from xml.etree.ElementTree import Element

from ..assemble import Description
from ..body import Base

INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast", "discrete")
"""As an MJCF calls them; discrete: since MuJoCo 4."""


@dataclass(frozen=True)
class Stepping:
    """Settings with which a simulator steps the model in a file.

    timestep    [s]
    integrator  MuJoCo's name of it
    disabled    MuJoCo's option.disableflags
    unnamed     of timestep and integrator what the file does not name, so that it is MuJoCo's default
    armature    whether the file says what armature the joints have, 0 where it names none
    """

    timestep: float = 2e-3
    integrator: str = "Euler"
    disabled: int = 0
    unnamed: tuple[str, ...] = ("timestep", "integrator")
    armature: bool = False


@dataclass(frozen=True)
class ActuatorGain:
    """Feedback gains of a joint's actuators [N m/rad, N m s/rad, N m/(rad s)], and the limit of their torque [N m]; None: no limit."""

    kp: float = 0.0
    kd: float = 0.0
    ki: float = 0.0
    effort_limit: float | None = None


@dataclass(frozen=True)
class ActuatorGains:
    """Actuator gains by joint name; notes: actuators that were left out, and properties of others that do not count."""

    joints: Mapping[str, ActuatorGain] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


class ModelFormat:
    """Format of XML model files, recognised by its root element. Methods get that element, and the path for messages and files named in it.

    title       as messages call it
    has_base    whether a file itself says if its base is fixed or floating
    """

    title: ClassVar[str]
    has_base: ClassVar[bool] = False

    def describe(self, root: Element, path: Path, base: Base | None) -> Description:
        """Description of the robot in the file; base None: as the file has it. Raises GainroomError, one line that names the file."""
        raise NotImplementedError

    def joint_order(self, root: Element) -> tuple[str, ...]:
        """Joint names in the order of the file; () if the model has them in that order."""
        return ()

    def keyframes(self, root: Element, path: Path) -> Mapping[str, Mapping[str, float]]:
        """Postures in the file by name: joint positions by joint name [rad; m if prismatic]. Raises GainroomError."""
        return {}

    def position_gains(self, root: Element, path: Path) -> ActuatorGains:
        """Gains of the actuators in the file that feed position or velocity back. Raises GainroomError."""
        return ActuatorGains()

    def stepping(self, root: Element, path: Path) -> Stepping:
        """Settings with which MuJoCo steps the model. Raises GainroomError."""
        return Stepping()
