"""Kinds of files, and messages about a file of the wrong kind."""

import re
import shlex
from pathlib import Path
from typing import Any, Literal

from ..errors import GainroomError, Together
from ..io.yaml_text import parse_yaml, read_text

Kind = Literal["joint", "robot", "model", "other"]
PLACES = {
    "joint": "it describes one joint: gainroom joint {0}",
    "robot": "it describes a whole robot: gainroom robot {0}",
    "model": "it is a robot's model (URDF or MJCF), which a robot.yaml names, model: {{file: {0}}}; to judge gains on it, and to write a "
    "robot.yaml with --write-robot robot.yaml: gainroom audit {0} --delay-ms 2{1}",
}
"""Descriptions of the kinds of file with the command that takes each, as format strings: {0} the file's name, {1} further options."""


def is_xml(text: str) -> bool:
    """True if a text is XML, well-formed or not."""
    return re.match(r"\s*<[?!A-Za-z]", text) is not None


def kind_of(data: Any) -> Kind:
    """Kind of the parsed content of a YAML file, by the names of its sections."""
    if not isinstance(data, dict):
        return "other"
    joint, robot = "joint" in data, not data.keys().isdisjoint(("model", "joints"))
    return "other" if joint == robot else "joint" if joint else "robot"


def kind_of_file(path: Path) -> Kind:
    """Kind of a file. Raises GainroomError if it cannot be read."""
    text = read_text(path)
    return "model" if is_xml(text) else kind_of(parse_yaml(text, str(path)))


def parse_as(kind: Literal["joint", "robot"], text: str, source: str, example: str, together: Together) -> Any:
    """Data of a YAML text that must be a joint.yaml or a robot.yaml; `example` is one to start from, `together` as in parse_yaml.

    Raises GainroomError.
    """
    data = None if is_xml(text) else parse_yaml(text, source, together=together)
    found = "model" if is_xml(text) else kind_of(data)
    if found not in (kind, "other"):
        raise wrong_kind(source, f"{kind}.yaml", found)
    if data is None:
        raise GainroomError(f"{source}: is empty; `gainroom example {example}` prints a file to start from")
    return data


def wrong_kind(source: str, wanted: str, found: Kind) -> GainroomError:
    """Error about a file of another kind than `wanted`."""
    gains = " --gains gains.yaml" if source.endswith(".urdf") else ""  # an MJCF may hold its own
    return GainroomError(f"{source}: must be a {wanted}; {PLACES[found].format(shlex.quote(source), gains)}")
