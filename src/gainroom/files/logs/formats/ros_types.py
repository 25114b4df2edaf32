"""Where the numbers are in a message of ROS: its definition, and its bytes, in CDR (ROS 2) or one after the other (ROS 1).

rosbags parses the definitions. It would also write and run a program for each; the definition comes with the file, so here the bytes are
read by walking along it. Definitions of the usual messages come with rosbags; those of control_msgs stand below, for bags older than
ROS 2 Iron, which hold none. Format: OMG, Common Data Representation (CORBA 3.0, 15.3).
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from ....errors import GainroomError
from ..table import library

CONTROL_MSGS = {
    "control_msgs/msg/JointTrajectoryControllerState": """\
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
""",
    "control_msgs/msg/DynamicJointState": """\
std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
""",
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/JointControllerState": """\
std_msgs/Header header
float64 set_point
float64 process_value
float64 process_value_dot
float64 error
float64 time_step
float64 command
float64 p
float64 i
float64 d
float64 i_clamp
bool antiwindup
""",
}
"""Up to the last field that is read."""
PRIMITIVES = {
    "bool": "?",
    "byte": "B",
    "octet": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
MOST_DEFINITION = 1 << 18
"""Characters: a definition with all it contains has some thousand."""
MOST_ENTRIES = 500
"""Numbers in an array that are columns: a robot's joints. Longer ones are pictures, maps or points, and passed over."""
MOST_FIELDS = 20_000
"""Of one message."""
DEEPEST = 16

Types = Mapping[str, Any]


@cache
def _usual() -> Types:
    """Message definitions that are known without the file."""
    typesys = library("rosbags", "rosbags.typesys").typesys
    known = dict(typesys.get_typestore(typesys.Stores.LATEST).fielddefs)
    for name, text in CONTROL_MSGS.items():
        known |= typesys.get_types_from_msg(text, name)
    return known


def types_of(name: str, encoding: str, text: str) -> Types:
    """Definitions that a message of type `name` needs, from its file's own text where it has one. Raises GainroomError."""
    if len(text) > MOST_DEFINITION:
        raise GainroomError(f"definition of {len(text)} characters must have at most {MOST_DEFINITION}")
    typesys = library("rosbags", "rosbags.typesys").typesys
    from_text = lambda: typesys.get_types_from_msg(text, name)  # noqa: E731
    parse = {"ros1msg": from_text, "ros2msg": from_text, "ros2idl": lambda: typesys.get_types_from_idl(text)}
    known = {**_usual(), **(parse[encoding]() if text.strip() and encoding in parse else {})}
    if name not in known:
        raise GainroomError(f"type {name} is not known, and the file does not define it")
    return known


@dataclass
class Layout:
    """Positions of the numbers in one message; the same for every message with the same bytes in `fixed`.

    numbers   path → offset and type
    names     path of a list of texts → the texts
    fixed     (start, end) of the bytes that decide it: lengths, and names
    """

    order: str
    numbers: dict[str, tuple[int, str]] = field(default_factory=dict)
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)


def layout_of(data: bytes, name: str, types: Types, dense: bool = False) -> Layout:
    """Layout of a message of type `name`; `dense`: of ROS 1. Raises GainroomError, ValueError, KeyError or struct.error for other data."""
    if not dense and (len(data) < 4 or data[0] != 0 or data[1] not in (0, 1)):
        raise GainroomError(f"a message of type {name} is not in plain CDR")
    walk = _Walk(data, types, dense)
    walk.message(name, "", 0)
    return walk.layout


class _Walk:
    """Position in a message while it is read; `place` counts from behind its header of four bytes (ROS 1: no header, no gaps)."""

    def __init__(self, data: bytes, types: Types, dense: bool) -> None:
        self._data, self._types, self._place, self._fields = data, types, 0, 0
        self._dense, self._start = dense, 0 if dense else 4
        self.layout = Layout("<" if dense or data[1] else ">", fixed=[(0, self._start)])

    def _next(self, letter: str, count: int = 1) -> int:
        """Offset of the next `count` values of a type; the position is then behind them."""
        size = struct.calcsize("=" + letter)
        place = -(-self._place // size) * size if count and not self._dense else self._place
        self._place = place + size * count
        if self._place + self._start > len(self._data):
            raise ValueError("a message ends too early")
        return place + self._start

    def _length(self) -> int:
        offset = self._next("I")
        self.layout.fixed.append((offset, offset + 4))
        return struct.unpack_from(f"{self.layout.order}I", self._data, offset)[0]

    def _text(self, wide: bool) -> tuple[int, int]:
        length = self._length()
        start = self._next("H" if wide else "B", length)
        return start, start + length

    def message(self, name: str, path: str, depth: int) -> None:
        if depth > DEEPEST or name not in self._types:
            raise GainroomError(f"type {name} is {'nested too deep' if depth > DEEPEST else 'not defined'}")
        fields = self._types[name][1]
        for each, node in fields:
            self._node(node, f"{path}.{each}" if path else each, depth)

    def _node(self, node: Any, path: str, depth: int) -> None:
        self._fields += 1
        if self._fields > MOST_FIELDS:
            raise GainroomError(f"a message has more than {MOST_FIELDS} fields")
        kind, what = node[0].name, node[1]
        if kind == "NAME":
            self.message(what, path, depth + 1)
        elif kind == "BASE":
            self._base(what[0], path)
        else:
            entry, size = what
            self._array(entry, size if kind == "ARRAY" else self._length(), path, depth)

    def _base(self, base: str, path: str) -> None:
        if base in ("string", "wstring"):
            self._text(base == "wstring")
        else:
            letter = PRIMITIVES[base]
            self.layout.numbers[path] = (self._next(letter), letter)

    def _array(self, entry: Any, count: int, path: str, depth: int) -> None:
        base = entry[1][0] if entry[0].name == "BASE" else ""
        if base in PRIMITIVES:
            letter = PRIMITIVES[base]
            start, size = self._next(letter, count), struct.calcsize("=" + letter)
            if count <= MOST_ENTRIES:
                self.layout.numbers.update({f"{path}[{k}]": (start + k * size, letter) for k in range(count)})
        elif base == "string" and count <= MOST_ENTRIES:
            spans = [self._text(False) for _ in range(count)]
            self.layout.fixed += spans
            texts = (self._data[start:end].rstrip(b"\0").decode("utf-8", "replace") for start, end in spans)
            self.layout.names[path] = tuple(texts)
        else:
            for k in range(count):
                self._node(entry, f"{path}[{k}]", depth)
