"""Gains as arrays with an order of joints, as Unitree's programs have them: `kps: [100, …]` and `kds: [2, …]`.

They stand in YAML or JSON (unitree_rl_gym's deploy), in Python lists, in C or C++ arrays, or one per line in plain text. The order of the
joints is in the file (`joint_names`, or an enumeration in C), or is the model's, which a note then says.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ...errors import GainroomError, all_of, first_of_many, nearest, refuse_all
from ...io.validation import checked
from ...io.yaml_text import shown
from .gain_record import NOT_NEGATIVE, Gain, GainFile

KP = ("kp", "kps", "p_gains", "kp_gains", "joint_stiffness", "joint_kp", "stiffness")
KD = ("kd", "kds", "d_gains", "kd_gains", "joint_damping", "joint_kd", "damping")
ORDERS = ("joint_names", "joint_order", "joints", "dof_names", "joint_name", "motor_names", "joint_sequence")
INDICES = ("joint2motor_idx", "leg_joint2motor_idx")
"""Keys of the indices of an array's numbers.

joint_ids_map of unitree_rl_lab is not among them: its stiffness and damping are in the motors' order already.
"""
MOST_JOINTS = 500
NO_GAINS = re.compile(r"rand|rang|scal|nois|ratio|factor|mult|limit|min|max|delta")
"""Parts of names that begin like kp's but hold no gains: stiffness_range, rand_kp."""
ENDING = re.compile(r"_?(joint|motor|dof)$")
"""Endings in which a name of the order and a joint's name may differ."""


@dataclass(frozen=True)
class ArrayNames:
    """Joint order of an array: by name (or several names for one joint), else by index in the model, else the model's own order."""

    names: tuple[tuple[str, ...], ...] = ()
    places: tuple[int, ...] = ()
    key: str = ""

    @classmethod
    def of(cls, data: Mapping[str, Any], enumerated: Mapping[int, tuple[str, ...]]) -> "ArrayNames":
        """Joint order in a file's keys; `enumerated` are joint names by number, as an enumeration has them.

        Places count only if there is one for each gain.
        """
        count = next((len(value) for key, value in data.items() if is_gain_array(key) and isinstance(value, list | tuple)), 0)
        for key, value in data.items():
            if key.lower() in ORDERS and isinstance(value, list | tuple) and value and all(isinstance(each, str) for each in value):
                return cls(tuple((each,) for each in value), (), key)
        for key, value in data.items():
            whole = isinstance(value, list | tuple) and value and all(type(each) is int and each >= 0 for each in value)
            if key.lower() in INDICES and whole and len(value) == count:
                return cls((), tuple(value), key)
        if enumerated and sorted(enumerated) == list(range(len(enumerated))):
            return cls(tuple(enumerated[k] for k in range(len(enumerated))), (), "the enumeration of joints")
        return cls()


@dataclass(frozen=True)
class OrderedGains(GainFile):
    """Gains in an order of joints; `what` names the arrays in messages; `of_model`: see in_order."""

    ordered: tuple[Gain, ...] = ()
    order: ArrayNames = ArrayNames()
    what: str = ""
    of_model: tuple[str, ...] = ()
    others: tuple["OrderedGains", ...] = ()
    """Arrays of the other parts of the robot, whose joints are named."""

    def in_order(self, order: Sequence[str]) -> "OrderedGains":
        return replace(self, of_model=tuple(order), others=tuple(each.in_order(order) for each in self.others))

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of the order, if each joint has one."""
        parts = [self.order.names, *(each.order.names for each in self.others)]
        known = all(names and all(len(each) == 1 for each in names) for names in parts)
        return tuple(each[0] for names in parts for each in names) if known else ()

    def matched(self, joint_names: Sequence[str]) -> list[list[Gain]]:
        result: list[list[Gain]] = [[] for _ in joint_names]
        parts, wrong = [self, *(each for each in self.others if not each.is_beyond(joint_names))], []
        for part, places in zip(parts, all_of(partial(part._places, joint_names) for part in parts), strict=True):
            for number, (place, gain) in enumerate(zip(places, part.ordered, strict=True)):
                if result[place]:
                    wrong.append(f"{self.source}: {part.order.key}: entry {number} is joint {shown(joint_names[place])} once more")
                result[place] = [gain]
        refuse_all(wrong)
        return result

    def is_beyond(self, joint_names: Sequence[str]) -> bool:
        """True if a model has none of these joints, because the arrays belong to another part of the robot."""
        if self.order.places:
            return min(self.order.places) >= len(joint_names)
        keys = set(map(_key, joint_names))
        return not any(_key(name) in keys for names in self.order.names for name in names)

    def notes_for(self, joint_names: Sequence[str]) -> tuple[str, ...]:
        beyond = [each.what for each in self.others if each.is_beyond(joint_names)]
        notes = [f"{self.source}: {what} are of joints that the model does not have, and do not count" for what in beyond]
        return (*self._order_notes(joint_names), *notes)

    def _order_notes(self, joint_names: Sequence[str]) -> tuple[str, ...]:
        if self.order.names:
            return self.notes
        taken = first_of_many([joint_names[place] for place in self._places(joint_names)])
        reason = "it names no joints" if not self.order.places else f"{self.order.key} has numbers of motors, no names"
        note = f"{self.source}: {reason}, so the order is taken to be the model's ({taken}): if it is another, give joint_names"
        return (*self.notes, note)

    def _places(self, joint_names: Sequence[str]) -> list[int]:
        count = len(self.ordered)
        if self.order.names:
            return all_of(partial(self._place, names, joint_names) for names in self.order.names)
        places = list(self.order.places) or list(range(count))
        if self.order.places and max(places) >= len(joint_names):
            raise GainroomError(
                f"{self.source}: {self.order.key}: {max(places)} must be below {len(joint_names)}, the number of the model's joints"
            )
        if not self.order.places and count != len(joint_names):
            raise GainroomError(
                f"{self.source}: {self.what} have {count} numbers, and the model has {len(joint_names)} joints: name theirs in joint_names "
                f"({first_of_many(joint_names)})"
            )
        order = [name for name in self.of_model if name in joint_names]
        return [joint_names.index(order[place]) for place in places] if len(order) == len(joint_names) else places

    def _place(self, names: Sequence[str], joint_names: Sequence[str]) -> int:
        """Index of the joint with one of these names, else of the only joint with a similar name: hip_pitch, HipPitch, hip_pitch_joint."""
        for name in names:
            if name in joint_names:
                return joint_names.index(name)
        keys = [_key(name) for name in joint_names]
        for name in names:
            if keys.count(_key(name)) == 1:
                return keys.index(_key(name))
        raise GainroomError(
            f"{self.source}: {self.order.key}: {shown(names[0])} is no joint of the model{nearest(names[0], joint_names, 'joint')}"
        )


def _key(name: str) -> str:
    """Name without case, underscores and the ending that some robots' joints have."""
    return re.sub(r"[^a-z0-9]", "", ENDING.sub("", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name[:200]).lower()))


def is_gain_array(name: object) -> bool:
    """True if a name is one of those that arrays of kp have."""
    return isinstance(name, str) and name.lower() in KP


def has_arrays(data: Mapping[str, Any]) -> bool:
    """True if a file's data hold arrays of kp."""
    return any(is_gain_array(key) and isinstance(value, list | tuple) for key, value in data.items())


def read_arrays(data: Mapping[str, Any], order: ArrayNames, source: str, lines: Mapping[str, int] | None = None) -> OrderedGains:
    """Gains from the arrays of kp and kd among a file's keys; `lines`: line of each key, for messages. Raises GainroomError."""
    keys = all_of(partial(_key_of, data, known, title, source) for known, title in ((KP, "kp"), (KD, "kd")))
    parts = (partial(_other, data, part, source, lines or {}) for part in _other_parts(data))
    found, *others = all_of([partial(_pair, data, keys, order, source, lines or {}), *parts])
    if others and not (order.names or order.places):
        raise GainroomError(
            f"{source}: {found.what} and {others[0].what} are of different joints, and nothing names those of the first: give joint_names"
        )
    return replace(found, others=tuple(others))


def _pair(data: Mapping[str, Any], keys: Sequence[str], order: ArrayNames, source: str, lines: Mapping[str, int]) -> OrderedGains:
    kp, kd = all_of(partial(_array, data, key, source, lines) for key in keys)
    count, wrong = len(order.names) or len(order.places), []
    if len(kp) != len(kd):
        wrong.append(f"{source}: {keys[0]} has {len(kp)} numbers and {keys[1]} {len(kd)}; they must have one per joint")
    if count and count != len(kp):
        wrong.append(f"{source}: {order.key} has {count} entries and {keys[0]} {len(kp)} numbers; they must have one per joint")
    refuse_all(wrong)
    gains = tuple(Gain(*pair) for pair in zip(kp, kd, strict=True))
    return OrderedGains(source, "Kp and Kd arrays", {}, ordered=gains, order=order, what=f"{keys[0]} and {keys[1]}")


def part_of(name: str) -> tuple[str, str] | None:
    """Part of the robot ("" for all of it) and kind of an array by its name: kp, kd or joints; None for any other name."""
    word = name.lower()[:200]
    found = None if word in (*KP, *KD, *ORDERS) else _PART.fullmatch(word)
    key = found["what"] if found else word
    if key not in (*KP, *KD, *ORDERS) or (NO_GAINS.search(word) and key not in ORDERS):
        return None
    return (found["before"] or found["behind"] or "") if found else "", "kp" if key in KP else "kd" if key in KD else "joints"


_PART = re.compile(
    rf"(?:(?P<before>\w{{1,60}}?)_)?(?P<what>{'|'.join(sorted((*KP, *KD, *ORDERS), key=len, reverse=True))})(?:_(?P<behind>\w{{1,60}}))?"
)


def _other_parts(data: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Keys of kp and kd for each named part of the robot: arm_kps, kp_arm. Arrays of the whole robot are not among them."""
    parts: dict[str, dict[str, str]] = {}
    for key, value in data.items():
        found = part_of(key)
        if found and found[0] and found[1] != "joints" and isinstance(value, list | tuple):
            parts.setdefault(found[0], {})[found[1]] = key
    return {name: keys for name, keys in parts.items() if len(keys) == 2}


def _other(data: Mapping[str, Any], part: str, source: str, lines: Mapping[str, int]) -> OrderedGains:
    """Arrays of another part of the robot, which must name their joints. Raises GainroomError."""
    keys = [_other_parts(data)[part][what] for what in ("kp", "kd")]
    named = next((key for key in data if part_of(key) == (part, "joints")), None)
    placed = next((key for key in data if key.lower() == f"{part}_{INDICES[0]}"), None)
    order_key = named or placed or ""
    orders = {ORDERS[0] if named else INDICES[0]: data.get(order_key)}
    order = ArrayNames.of({"kp": data[keys[0]], **orders}, {})
    if not (order.names or order.places):
        raise GainroomError(f"{source}: {' and '.join(keys)} are gains of further joints, and nothing names these: give {part}_joint_names")
    return _pair(data, keys, replace(order, key=order_key), source, lines)


def _key_of(data: Mapping[str, Any], keys: Sequence[str], title: str, source: str) -> str:
    found = [key for key in data if key.lower() in keys]
    if not found:
        raise GainroomError(f"{source}: an array of {title} is missing: {', '.join(keys[:3])}, with one number per joint")
    if len(found) > 1:
        raise GainroomError(f"{source}: holds more than one array of {title}: {first_of_many(found)}; leave one")
    return found[0]


def _array(data: Mapping[str, Any], key: str, source: str, lines: Mapping[str, int]) -> list[float]:
    value = data[key]
    where = f"{source}: line {lines[key]}: {key}" if key in lines else f"{source}: {key}"
    if not isinstance(value, list | tuple) or not value or len(value) > MOST_JOINTS:
        raise GainroomError(f"{where}: {shown(value)} must be a list of one number per joint, at most {MOST_JOINTS}")
    return all_of(partial(checked, f"{where}[{k}]", each, NOT_NEGATIVE) for k, each in enumerate(value))
