"""Which kind of file a command has been given."""

from pathlib import Path
from typing import Literal


def kind_of(file: Path) -> Literal["joint", "robot"]:
    """By its sections: `model` makes it a robot's. Raises GainroomError where it cannot be read."""
    from ..io.yaml_text import parse_yaml, read_text

    data = parse_yaml(read_text(file), str(file))
    return "robot" if isinstance(data, dict) and "model" in data and "joint" not in data else "joint"
