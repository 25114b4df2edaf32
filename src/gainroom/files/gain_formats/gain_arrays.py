"""Gains as arrays with an order of joints, as Unitree's programs have them: `kps: [100, …]` and `kds: [2, …]`.

They stand in YAML or JSON (unitree_rl_gym's deploy), in Python lists, in C or C++ arrays, or one per line in plain text. The order of the
joints is in the file (`joint_names`, or an enumeration in C), or is the model's, which a note then says.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...errors import GainroomError, first_of_many, nearest
from ...io.validation import checked
from ...io.yaml_text import shown
from .gain_record import NOT_NEGATIVE, Gain, GainFile

KP = ("kp", "kps", "p_gains", "kp_gains", "joint_stiffness", "joint_kp", "stiffness")
KD = ("kd", "kds", "d_gains", "kd_gains", "joint_damping", "joint_kd", "damping")
ORDERS = ("joint_names", "joint_order", "joints", "dof_names", "joint_name", "motor_names", "joint_sequence")
INDICES = ("joint2motor_idx", "leg_joint2motor_idx")
"""Places of an array's numbers. (joint_ids_map of unitree_rl_lab is none: its stiffness and damping are in the motors' order already.)"""
MOST_JOINTS = 500
ENDING = re.compile(r"_?(joint|motor|dof)$")
"""What the names of an order may have or lack at their end."""


@dataclass(frozen=True)
class ArrayNames:
    """Whose numbers an array has: of joints by name (or several names for one), else by place in the model, else all in its order."""

    names: tuple[tuple[str, ...], ...] = ()
    places: tuple[int, ...] = ()
    key: str = ""

    @classmethod
    def of(cls, data: Mapping[str, Any], enumerated: Mapping[int, tuple[str, ...]]) -> "ArrayNames":
        """As a file's keys say it; `enumerated`: names by number, as an enumeration has them. Places count where there is one per gain."""
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
    """Gains in an order of joints; `what` are the arrays, as messages call them; `of_model`: see in_order."""

    ordered: tuple[Gain, ...] = ()
    order: ArrayNames = ArrayNames()
    what: str = ""
    of_model: tuple[str, ...] = ()

    def in_order(self, order: Sequence[str]) -> "OrderedGains":
        return replace(self, of_model=tuple(order))

    @property
    def own_names(self) -> tuple[str, ...]:
        """The order's names, where each joint has one."""
        return tuple(names[0] for names in self.order.names) if all(len(names) == 1 for names in self.order.names) else ()

    def matched(self, joint_names: Sequence[str]) -> list[list[Gain]]:
        places = self._places(joint_names)
        result: list[list[Gain]] = [[] for _ in joint_names]
        for number, (place, gain) in enumerate(zip(places, self.ordered, strict=True)):
            if result[place]:
                raise GainroomError(f"{self.source}: {self.order.key}: entry {number} is joint {shown(joint_names[place])} once more")
            result[place] = [gain]
        return result

    def notes_for(self, joint_names: Sequence[str]) -> tuple[str, ...]:
        if self.order.names:
            return self.notes
        taken = first_of_many([joint_names[place] for place in self._places(joint_names)])
        reason = "it names no joints" if not self.order.places else f"{self.order.key} has numbers of motors, no names"
        note = f"{self.source}: {reason}, so the order is taken to be the model's ({taken}): if it is another, give joint_names"
        return (*self.notes, note)

    def _places(self, joint_names: Sequence[str]) -> list[int]:
        count = len(self.ordered)
        if self.order.names:
            return [self._place(names, joint_names) for names in self.order.names]
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
        """Of the joint with one of these names, else of the one joint that is nearly called so: hip_pitch, HipPitch, hip_pitch_joint."""
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
    """A name without case, underscores and the ending that some robots' joints have."""
    return re.sub(r"[^a-z0-9]", "", ENDING.sub("", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name[:200]).lower()))


def is_gain_array(name: str) -> bool:
    """Whether a name is one of those that arrays of kp have."""
    return name.lower() in KP


def has_arrays(data: Mapping[str, Any]) -> bool:
    """Whether a file's data hold arrays of kp."""
    return any(is_gain_array(key) and isinstance(value, list | tuple) for key, value in data.items())


def read_arrays(data: Mapping[str, Any], order: ArrayNames, source: str, lines: Mapping[str, int] | None = None) -> OrderedGains:
    """The arrays of kp and kd among a file's keys; `lines`: of the keys, where there is no better place. Raises GainroomError."""
    kp_key, kp = _array(data, KP, "kp", source, lines)
    kd_key, kd = _array(data, KD, "kd", source, lines)
    if len(kp) != len(kd):
        raise GainroomError(f"{source}: {kp_key} has {len(kp)} numbers and {kd_key} {len(kd)}; they must have one per joint")
    for what, count in ((order.key, len(order.names)), (order.key, len(order.places))):
        if count and count != len(kp):
            raise GainroomError(f"{source}: {what} has {count} entries and {kp_key} {len(kp)} numbers; they must have one per joint")
    gains = tuple(Gain(*pair) for pair in zip(kp, kd, strict=True))
    return OrderedGains(source, "Kp and Kd arrays", {}, ordered=gains, order=order, what=f"{kp_key} and {kd_key}")


def _array(
    data: Mapping[str, Any], keys: Sequence[str], title: str, source: str, lines: Mapping[str, int] | None
) -> tuple[str, list[float]]:
    found = [key for key in data if key.lower() in keys]
    if not found:
        raise GainroomError(f"{source}: an array of {title} is missing: {', '.join(keys[:3])}, with one number per joint")
    if len(found) > 1:
        raise GainroomError(f"{source}: holds more than one array of {title}: {first_of_many(found)}; leave one")
    key, value = found[0], data[found[0]]
    where = f"{source}: line {lines[key]}: {key}" if lines and key in lines else f"{source}: {key}"
    if not isinstance(value, list | tuple) or not value or len(value) > MOST_JOINTS:
        raise GainroomError(f"{where}: {shown(value)} must be a list of one number per joint, at most {MOST_JOINTS}")
    return key, [checked(f"{where}[{k}]", each, NOT_NEGATIVE) for k, each in enumerate(value)]
