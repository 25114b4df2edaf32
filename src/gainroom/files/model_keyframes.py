"""Keyframes of an MJCF, and of the scenes beside it: public models keep them in the scene that includes the robot."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from ..errors import GainroomError
from ..robot.formats.model_files import includes, keyframes

MOST_SCENES = 20
"""Maximum number of files beside a model that are searched for keyframes."""


class Keyframe(NamedTuple):
    """Keyframe: its file, and angles of joints by name [rad; m if prismatic]."""

    file: Path
    angles: Mapping[str, float]


def model_keyframes(path: Path) -> dict[str, Keyframe]:
    """Keyframes by name, the model's own first; a URDF has none. Raises GainroomError if the model's cannot be read."""
    found = {name: Keyframe(path, angles) for name, angles in keyframes(path).items()}
    for scene in sorted(path.parent.glob("*scene*.xml"))[:MOST_SCENES]:
        with contextlib.suppress(GainroomError):  # another robot's scene may be anything
            if includes(scene, path):
                for name, angles in keyframes(scene).items():
                    found.setdefault(name, Keyframe(scene, angles))
    return found
