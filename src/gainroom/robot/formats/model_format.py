"""What a file format of robots does. A new format is a file beside this one with a subclass, and its line in FORMATS of model_files.py."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar
from xml.etree.ElementTree import Element

from ..assemble import Description
from ..body import Base


class ModelFormat:
    """A format of XML files, known by its root element. Methods get that element, and the path for messages and files named inside.

    title       as messages call it
    has_base    whether a file itself says if its base is fixed or floating
    """

    title: ClassVar[str]
    has_base: ClassVar[bool] = False

    def describe(self, root: Element, path: Path, base: Base | None) -> Description:
        """The robot in the file; base None: as the file has it. Raises GainroomError, one line that names the file."""
        raise NotImplementedError

    def keyframes(self, root: Element, path: Path) -> Mapping[str, Mapping[str, float]]:
        """By name, the postures in the file: joint positions by name [rad; m if prismatic]. Raises GainroomError."""
        return {}

    def position_gains(self, root: Element, path: Path) -> Mapping[str, tuple[float, float]]:
        """(kp, kd) by joint name [N m/rad, N m s/rad] of the actuators in the file that feed position back. Raises GainroomError."""
        return {}
