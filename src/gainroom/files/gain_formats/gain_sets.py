"""Sets of gains in a YAML or JSON file, at any depth: one of them is read, the only one or that with the chosen keys.

A set is a mapping with arrays of gains, with plain gains by joint, with `stiffness` and `damping` by part of a joint's name, with actuators
as Isaac Lab writes them, with a section `moteus`, or a controller of ros2_control.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import GainroomError, first_of_many, nearest
from ...io.validation import dotted
from ...io.yaml_text import Tagged, shown
from .actuator_configs import TARGETS, has_groups, read_actuator_data
from .gain_arrays import INDICES, KD, KP, ORDERS, ArrayNames, has_arrays, read_arrays
from .gain_record import GainFile
from .legged_gym import has_parts, read_parts
from .moteus import read_moteus
from .plain import is_plain, is_plain_gain, read_plain
from .ros2_control import MANAGER, TERMS, read_ros2_control

OF_GAINS = {*KP, *KD, *TARGETS, "gains", "actuators", "moteus"}
VALUES = {*KP, *KD, *ORDERS, *INDICES, *TARGETS, *TERMS, "ki", "armature"}
"""Keys that gains consist of, at any depth: a value behind a tag is not skipped there, nor is one that contains OF_GAINS."""

Path = tuple[str, ...]


@dataclass(frozen=True)
class GainSet:
    """Mapping that holds gains: the keys that lead to it, its parent, and its reader.

    order   the orders of joints that stand around it
    """

    path: Path
    data: dict[str, Any]
    around: Mapping[str, Any]
    order: Mapping[str, Any]
    read: Callable[["GainSet", str], GainFile] | None

    @property
    def name(self) -> str:
        """Name by which the set is chosen."""
        return ".".join(self.path) or "."


def read_set(data: dict[str, Any], source: str, chosen: str, unknown: str) -> GainFile:
    """Gains of the only set in a file's data, or of the `chosen` one; `unknown` is the message about a file without gains.

    Raises GainroomError, with the sets' names where one must be chosen.
    """
    found = list(_sets(data))
    _refuse_tags(data, source, ())
    if not found and is_plain(data) and not chosen:
        return read_plain(data, source)
    each = _one(found, source, chosen)
    if each is not None and chosen.rpartition(".")[2] == "gains" and isinstance(each.data.get("gains"), dict):
        return read_plain({"gains": each.data["gains"]}, f"{source}: {dotted(*each.path)}" if each.path else source)
    if each is not None and each.read is not None:
        return each.read(each, f"{source}: {dotted(*each.path)}" if each.path else source)
    if each is not None and chosen:
        keys = next(each.path[:k] for k in range(len(each.path) + 1) if ".".join(each.path[:k]) == chosen)
        data = {key: value for key, value in data.items() if key.endswith(MANAGER)} | _only(data, keys)
    return read_ros2_control(data, source, unknown)


def _one(found: Sequence[GainSet], source: str, chosen: str) -> GainSet | None:
    """Chosen set, or the only one; None if there is none. Controllers of ros2_control count as one set."""
    names = list(dict.fromkeys(each.name if each.read is not None else each.path[0] if each.path else "." for each in found))
    if chosen:
        fitting = [each for each in found if chosen in (each.name, ".".join((*each.path, "gains")))] or [
            each for each in found if each.name.startswith(f"{chosen}.")
        ]
        if not fitting:
            raise GainroomError(f"{source}: {shown(chosen)} holds no gains{nearest(chosen, names, 'set') if names else ''}")
        found = fitting
    if len(found) > 1 and any(each.read is not None for each in found):
        raise GainroomError(f"{source}: holds gains in {len(names)} places; name one, {source}:{names[0]} ({first_of_many(names)})")
    return found[0] if found else None


def _sets(data: Any, path: Path = (), around: Mapping[str, Any] | None = None, order: Mapping[str, Any] | None = None) -> Iterator[GainSet]:
    """All sets of the data: of nested ones the outermost, except that keys beside arrays are searched too."""
    if isinstance(data, list):
        for place, each in enumerate(data):
            if isinstance(each, dict):
                yield from _sets(each, (*path, str(place)), {}, order)
        return
    if not isinstance(data, dict):
        return
    order = {**(order or {}), **{key: value for key, value in data.items() if key.lower() in (*ORDERS, *INDICES)}}
    reader = _reader(data, path)
    if reader is not None:
        yield GainSet(path, data, around or {}, order, reader)
    elif "p" in data and not isinstance(data["p"], dict | list):
        yield GainSet(path, data, around or {}, order, None)
    if reader is None or reader in BESIDE_OTHERS:
        for key, each in data.items():
            if reader is not None and key in BESIDE_OTHERS[reader]:
                continue
            if reader is _arrays and is_plain_gain({key: each}):
                yield GainSet((*path, key), {key: each}, data, order, _plain)
            yield from _sets(each, (*path, key), data, order)


def _reader(data: dict[str, Any], path: Path) -> Callable[[GainSet, str], GainFile] | None:
    """Reader of a mapping that is a set; None if it is none, or belongs to ros2_control."""
    if "moteus" in data:
        return lambda each, source: read_moteus({"moteus": each.data["moteus"]} if path else each.data, source)
    if has_groups(data):
        return _groups
    if is_plain_gain(data) and ("gains" in data or not has_arrays(data)):
        return _plain
    if has_arrays(data):
        return _arrays
    if has_parts(data, path[-1] if path else ""):
        return _parts
    return None


def _plain(each: GainSet, source: str) -> GainFile:
    return read_plain(each.data, source)


def _groups(each: GainSet, source: str) -> GainFile:
    return read_actuator_data(each.data, source)


def _parts(each: GainSet, source: str) -> GainFile:
    return read_parts(each.data, each.around, source)


def _arrays(each: GainSet, source: str) -> GainFile:
    return read_arrays(each.data, ArrayNames.of({**each.order, **each.data}, {}), source)


BESIDE_OTHERS: dict[Any, tuple[str, ...]] = {_arrays: (), _groups: ("actuators", "articulation"), _parts: ("stiffness", "damping")}
"""Keys that may stand beside the own keys of a set, by its reader."""


def _only(data: Any, path: Path) -> Any:
    """Data reduced to the values on a path."""
    if not path:
        return data
    if isinstance(data, list):
        return [_only(data[int(path[0])], path[1:])]
    beside = {name: value for name, value in data.items() if not isinstance(value, dict | list)}
    return beside | {path[0]: _only(data[path[0]], path[1:])}


def _refuse_tags(data: Any, source: str, path: Path) -> None:
    """Raise GainroomError for gains behind a tag that is not read."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        here = (*path, str(key))
        matters = any(each.lower() in VALUES for each in here) or here[-1].lower() in OF_GAINS
        if isinstance(value, Tagged) and (matters or OF_GAINS & {each.lower() for each in value.keys}):
            what = f"what has the tag {shown(value.tag)} is not read, and gains may stand there; write it without a tag"
            raise GainroomError(f"{source}: line {value.line}: {dotted(*here)}: {what}")
        _refuse_tags(value, source, here)
