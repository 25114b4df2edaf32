"""Reader of files of gains; each format has a module in gain_formats, or is read by its form of export.

Files are read as data, within bounds; nothing in them is run. What is in no known form is refused in one line.
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError, Together
from ..io.bounded_text import bounded_text
from ..io.validation import dotted
from ..io.yaml_text import MAX_BYTES, parse_yaml, read_text, shown
from ..system.linear.arrays import Booleans, Floats
from .export_forms import FORMS
from .export_forms.sampled_law import with_sampled_law
from .file_types import kind_of, wrong_kind
from .gain_formats.actuator_configs import read_actuator_configs
from .gain_formats.array_text import read_array_text
from .gain_formats.gain_record import ACTUATOR, GainFile, GainSection, Origin
from .gain_formats.gain_sets import read_set
from .gain_formats.mjcf_actuators import XML
from .gain_formats.moteus import is_dump, read_dump
from .gain_formats.onnx_metadata import read_onnx
from .gain_formats.own_answers import MOST_BYTES as ANSWER_BYTES, answer_in, read_answer

PYTHON = (".py", ".pyi")
DATA = (".yaml", ".yml", ".json")
C_CODE = (".h", ".hh", ".hpp", ".hxx", ".c", ".cc", ".cpp", ".cxx", ".ino")
TEXT = (".txt", ".cfg", ".conf", ".config", ".log")
UNKNOWN = (
    "holds no gains in a known form: joint or pattern → {kp, kd}, at the top or under gains; or a ros2_control file with p, i, d under "
    "each joint's name; or an MJCF with position actuators; or kps and kds, one number per joint; or "
    "control: {stiffness, damping} by part of the joints' names"
)


@dataclass(frozen=True)
class JointGains:
    """Gains of n joints, each (n,), units as Gain; 0 where a joint has none.

    actuators   of each joint what the file names of ACTUATOR
    named       (n,) actuators that the file names; "" where it names none
    origin      where the file says that they run, and at which rate
    postures    that the file names: by name, angles by joint
    unread_postures   those that are not understood: by name, why
    """

    kp: Floats
    kd: Floats
    ki: Floats
    actuators: tuple[Mapping[str, float], ...]
    named: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    origin: Origin = field(default=Origin())
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    unread_postures: Mapping[str, str] = field(default_factory=dict)

    @property
    def given(self) -> Booleans:
        """(n,) True where a joint has gains."""
        return (self.kp > 0) | (self.kd > 0)

    @property
    def motor_inertia(self) -> Floats:
        """(n,) [kg m²], NaN where the file names none."""
        return np.array([each.get("motor_inertia", np.nan) for each in self.actuators])


def read_gains(path: Path, contact: str = "", to_use: bool = False) -> GainFile:
    """Gains in a file, whose ending decides the language and whose content the format; FILE:NAME chooses one of several sets.

    NAME is one of several robots in a Python file, or the keys that lead to one of several sets in a YAML or JSON file.

    contact   of the sets that gainroom robot recommends the one for this contact state, not the one that is safe in all
    to_use    for export: of what gainroom audit wrote of unsafe gains those to use in their place, not those that were audited; and a
              joint.yaml has gains, too

    Raises GainroomError, one line that names the file, the key or the line, the value and what is allowed.
    """
    file, _, name = str(path).rpartition(":")
    if Path(file).suffix.lower() in PYTHON:
        return read_actuator_configs(read_text(Path(file)), file, name, Path(file).parent)
    if name and Path(file).suffix.lower() in DATA and not path.exists():
        return parse_gains(_as_yaml(bounded_text(Path(file), MAX_BYTES, "a configuration file"), file), file, name)
    ending = path.suffix.lower()
    if ending == ".onnx":
        return read_onnx(path)
    if ending in XML:
        return parse_file("", path)
    most, what = (ANSWER_BYTES, "an answer of gainroom's") if ending == ".json" else (MAX_BYTES, "a configuration file")
    return parse_file(bounded_text(path, most, what), path, contact, to_use)


def parse_file(text: str, path: Path, contact: str = "", to_use: bool = False) -> GainFile:
    """Gains in the text of a file.

    `path` names the file in messages and decides its format by its ending; an MJCF is read from there if the text is "". Otherwise as
    read_gains.
    """
    return with_sampled_law(_parsed(text, path, contact, to_use), text)


def _parsed(text: str, path: Path, contact: str, to_use: bool) -> GainFile:
    """Gains in the text of a file, without the filters that an export may hold."""
    ending = path.suffix.lower()
    for form in FORMS.values():
        if form.read is not None and (found := form.read(text, path)) is not None:
            return found
    if ending in PYTHON:
        return read_actuator_configs(text, str(path), folder=path.parent)
    answer = answer_in(text)
    if answer is not None:
        return read_answer(answer, str(path), contact, to_use)
    if contact:
        raise GainroomError(f"{path}: is no answer of gainroom robot --json; --contact chooses among the sets of one")
    if is_dump(text):
        return read_dump(text, str(path))
    if ending in (*C_CODE, *TEXT):
        return read_array_text(text, str(path), ending in C_CODE)
    return parse_gains(_as_yaml(text, str(path)), str(path), to_use=to_use)


def _as_yaml(text: str, source: str) -> str:
    """Text as YAML: JSON is YAML except for tabs, and has none inside its strings."""
    return text.replace("\t", " ") if source.lower().endswith(".json") else text


def parse_gains(text: str, source: str, chosen: str = "", to_use: bool = False) -> GainFile:
    """Gains in YAML or JSON text, which messages call `source`; otherwise as read_gains."""
    with Together() as together:
        data = parse_yaml(text, source, of_others=True, together=together)
        if not isinstance(data, dict):
            raise GainroomError(f"{source}: {'is empty' if data is None else UNKNOWN}")
        if "drive" in data and (found := kind_of(data)) != "other":
            if found == "joint" and to_use:
                from .joint_gains import joint_gains  # loads what judges a joint

                return joint_gains(text, data, source)
            raise wrong_kind(source, "file of gains", found)
        if "gains" in data and not data["gains"]:
            raise GainroomError(f"{source}: gains: is empty; must hold joint or pattern → {{kp, kd}}, one or more")
        return read_set(data, source, chosen, f"{UNKNOWN}{_begins(data)}")


def gains_of(file: GainFile, joint_names: Sequence[str]) -> JointGains:
    """Gains of the file for the joints of a model.

    Raises GainroomError for a joint that the model does not have, for a pattern that matches nothing, and where no joint has gains.
    """
    columns = {name: np.zeros(len(joint_names)) for name in ("kp", "kd", "ki")}
    actuators: list[dict[str, float]] = [{} for _ in joint_names]
    named = [""] * len(joint_names)
    for k, matches in enumerate(file.matched(joint_names)):
        if matches:
            for name, column in columns.items():
                column[k] = getattr(matches[-1], name)
            for match in matches:
                named[k] = match.actuator or named[k]
                actuators[k] |= {key: value for key in ACTUATOR if (value := getattr(match, key)) is not None}
    found = JointGains(
        **columns,
        actuators=tuple(actuators),
        named=tuple(named),
        notes=file.notes_for(joint_names),
        origin=file.origin,
        postures=file.postures_for(joint_names),
        unread_postures=file.unread_postures,
    )
    if not np.any(found.given):
        raise GainroomError(f"{file.source}: all gains are zero")
    return found


def _begins(data: dict[str, Any]) -> str:
    """End of a message about a file without known gains: its first entry."""
    path, value = (), data
    while isinstance(value, dict) and value:
        key, value = next(iter(value.items()))
        path = (*path, key)
    if not path:
        return ""
    close = difflib.get_close_matches(path[-1].lower(), GainSection.model_fields, 1, cutoff=0.5)
    hint = f", did you mean {close[0]}?" if close and path[-1] not in close else ""
    return f"; found {dotted(*path)}: {shown(value)}{hint}"
