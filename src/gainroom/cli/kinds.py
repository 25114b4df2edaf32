"""Which of the two descriptions a command that takes both has been given."""

from pathlib import Path
from typing import Literal


def kind_of(file: Path) -> Literal["joint", "robot"]:
    """By its sections; what cannot be told is refused as a joint's. Raises GainroomError where it cannot be read, or is a model."""
    from ..files.file_types import kind_of_file, wrong_kind

    found = kind_of_file(file)
    if found == "model":
        raise wrong_kind(str(file), "joint.yaml or robot.yaml", found)
    return "robot" if found == "robot" else "joint"
