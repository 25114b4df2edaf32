"""From messages of one topic, in JSON or CDR, to numbers by path: `position[l_knee]`, `data`, `header.stamp.sec`."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....errors import GainroomError, one_line
from ....system.linear.arrays import Floats
from ..guessing import channel_of
from ..units import UNITS
from .ros_types import MOST_ENTRIES, Types, layout_of

NAMES = ("name", "joint_names", "names", "joints", "dof_names")
"""Fields with the names of the entries of the arrays beside them."""
INTERFACE = re.compile(r"(.*\.)?interface_values\[([0-9]+)\]\.values\[([0-9]+)\]")
"""DynamicJointState: values by joint and interface."""
DEEPEST = 8


@dataclass(frozen=True)
class Part:
    """Messages of one topic that have the same numbers: `key` tells them apart, as two publishers do that each know some joints.

    labels   by path: the field and the joint; "" where there is none
    """

    key: tuple[str, ...]
    labels: Mapping[str, tuple[str, str]]


Rows = tuple[Part, Floats, Floats]
"""A part, its numbers (k, columns) in the order of its labels, and places of its messages in the batch (k,)."""


class Decoder:
    """Decoder of the messages of one topic into rows of numbers."""

    def decode(self, batch: Sequence[bytes]) -> list[Rows]:
        """Rows of numbers in a batch of messages. Raises GainroomError, or whatever error damaged bytes lead to."""
        raise NotImplementedError

    def seconds(self, part: Part, numbers: Floats, zero: float) -> Floats | None:
        """Time stamps (k,) in the messages themselves, less `zero` [s]; None if they have none."""
        raise NotImplementedError


def labelled(paths: Sequence[str], names: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, str]]:
    """New path → field and joint, in the order of `paths`: entries of an array as long as the list of names are called by these."""
    joints = next((texts for path, texts in names.items() if path.rsplit(".", 1)[-1] in NAMES and len(set(texts)) == len(texts)), ())
    lengths: dict[str, int] = {}
    for path in paths:
        if path.endswith("]"):
            lengths[path[: path.rindex("[")]] = lengths.get(path[: path.rindex("[")], 0) + 1
    found: dict[str, tuple[str, str]] = {}
    for path in paths:
        field, _, index = path.removesuffix("]").rpartition("[")
        dynamic = INTERFACE.fullmatch(path)
        if dynamic and joints and int(dynamic[2]) < len(joints):
            interfaces = names.get(f"{dynamic[1] or ''}interface_values[{dynamic[2]}].interface_names", ())
            word = interfaces[int(dynamic[3])] if int(dynamic[3]) < len(interfaces) else dynamic[3]
            found[f"{word}[{joints[int(dynamic[2])]}]"] = (word, joints[int(dynamic[2])])
        elif path.endswith("]") and joints and lengths[field] == len(joints):
            found[f"{field}[{joints[int(index)]}]"] = (field, joints[int(index)])
        else:
            found[path] = (path, "")
    if len(found) < len(paths):
        raise GainroomError("a message names the same number twice")
    return found


class RosDecoder(Decoder):
    """Decoder of messages of ROS 2, or of ROS 1 if dense. Messages with the same layout are read together, as columns of bytes."""

    def __init__(self, name: str, types: Types, dense: bool) -> None:
        self._name, self._types, self._dense = name, types, dense

    def decode(self, batch: Sequence[bytes]) -> list[Rows]:
        found: list[Rows] = []
        sizes = np.array([len(data) for data in batch])
        for size in sorted(set(sizes.tolist())):
            places = np.flatnonzero(sizes == size)
            table = np.frombuffer(b"".join([batch[k] for k in places.tolist()]), np.uint8).reshape(len(places), size)
            while len(places):
                layout = layout_of(table[0].tobytes(), self._name, self._types, self._dense)
                fixed = np.concatenate([np.arange(start, end) for start, end in layout.fixed])
                same = (table[:, fixed] == table[0, fixed]).all(axis=1)
                labels = labelled([*layout.numbers], layout.names)
                numbers = np.empty((int(same.sum()), len(labels)))
                for k, (offset, letter) in enumerate(layout.numbers.values()):
                    kind = np.dtype(layout.order + letter)
                    numbers[:, k] = np.ascontiguousarray(table[same, offset : offset + kind.itemsize]).view(kind)[:, 0]
                found.append((Part(tuple(labels), labels), numbers, places[same]))
                table, places = table[~same], places[~same]
        return found

    def seconds(self, part: Part, numbers: Floats, zero: float) -> Floats | None:
        order = [*part.labels]
        for prefix in ("header.stamp.", "stamp."):
            if f"{prefix}sec" in part.labels and f"{prefix}nanosec" in part.labels:
                sec, nanosec = (numbers[:, order.index(f"{prefix}{name}")] for name in ("sec", "nanosec"))
                # As times of recording are: one moment on two topics is one number, and what is commanded there is what holds.
                return ((sec - zero) * 1e9 + nanosec) / 1e9 if sec.any() or nanosec.any() else None
        return None


class JsonDecoder(Decoder):
    """Decoder of JSON messages: objects with numbers, also in objects and lists inside them."""

    def decode(self, batch: Sequence[bytes]) -> list[Rows]:
        parts: dict[tuple[str, ...], tuple[list[list[float]], list[int], dict[str, tuple[str, ...]]]] = {}
        for place, data in enumerate(batch):
            try:
                content = json.loads(data.decode())
            except (ValueError, RecursionError) as error:
                raise GainroomError(f"a message is not JSON: {one_line(error, 80)}") from error
            if not isinstance(content, dict):
                raise GainroomError("a message is not a JSON object")
            numbers: dict[str, float] = content
            names: dict[str, tuple[str, ...]] = {}
            if not {float}.issuperset(map(type, content.values())):  # those that are flat take a fifth of the time
                numbers = {}
                _flatten(content, "", numbers, names, 0)
            key = (*numbers, *(text for texts in names.values() for text in texts)) if names else tuple(numbers)
            rows, places, _ = parts.setdefault(key, ([], [], names))
            rows.append([*numbers.values()])
            places.append(place)
        found = []
        for key, (rows, places, names) in parts.items():
            count = len(rows[0])
            labels = labelled(key[:count], names)
            found.append((Part(tuple(labels), labels), np.array(rows, dtype=float).reshape(len(rows), count), np.array(places)))
        return found

    def seconds(self, part: Part, numbers: Floats, zero: float) -> Floats | None:
        for k, path in enumerate(part.labels):
            guess = channel_of(path)
            if guess is not None and guess.channel == "time":
                factor = UNITS["time"].get(guess.unit or "s", 1.0)
                return (numbers[:, k] - zero / factor) * factor
        return None


def _flatten(content: object, path: str, numbers: dict[str, float], names: dict[str, tuple[str, ...]], depth: int) -> None:
    if isinstance(content, bool | int | float):
        try:
            numbers[path] = float(content)
        except OverflowError:
            numbers[path] = np.nan
    elif isinstance(content, dict) and depth < DEEPEST:
        for key, value in content.items():
            _flatten(value, f"{path}.{key}" if path else key, numbers, names, depth + 1)
    elif isinstance(content, list) and len(content) <= MOST_ENTRIES and depth < DEEPEST:
        if content and all(isinstance(item, str) for item in content):
            names[path] = tuple(content)
        else:
            for k, value in enumerate(content):
                _flatten(value, f"{path}[{k}]", numbers, names, depth + 1)
