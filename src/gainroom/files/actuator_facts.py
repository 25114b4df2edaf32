"""Published figures of actuators, each with its source, and what they say of a joint's motor and gearbox.

Sources contradict each other: every figure is kept. Of a quantity the figures of the best grade count: the first one is used, and where
they differ, all of them are its range. A measurement of one's own wins over all.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

from ..errors import digits, first_of_many, nearest
from ..io.yaml_text import shown
from ..system.actuator_entry import ActuatorEntry

GRADES = ("identified", "datasheet", "model", "inferred")
"""Grades of figures, the best first: measured on hardware by someone, a maker's document, a public simulation model, from other figures."""
UNITS = {
    "reflected_inertia": "kg·m²",
    "rotor_inertia": "kg·m²",
    "ratio": "",
    "stiffness": "N·m/rad",
    "backlash": "rad",
    "damping": "N·m·s/rad",
    "viscous_friction": "N·m·s/rad",
    "peak_torque": "N·m",
    "rated_torque": "N·m",
    "peak_speed": "rad/s",
    "torque_constant": "N·m/A",
    "mass": "kg",
    "drive_rate": "Hz",
    "command_rate": "Hz",
    "gains_run": "",
    "encoder_step": "rad",
    "encoder_side": "",
    "gearbox": "",
    "torque_sensor": "",
}
"""Units of the quantities; rotor_inertia on the motor's side, all else on the joint's side. damping is that of the gearbox's spring."""
AGREED = 1.02
"""Largest ratio of two figures that are one: they are published with two digits."""


@dataclass(frozen=True)
class Figure:
    """Published figure of one quantity, in the unit of UNITS.

    low, high   equal for a single number; a word in both for what is no number
    date        as the source has it: year, or year and month; "": not known
    said        how the source states it
    set_aside   why it does not count; "": it counts
    """

    low: Any
    high: Any
    source: str
    grade: str
    date: str = ""
    said: str = ""
    set_aside: str = ""

    @property
    def described(self) -> dict[str, Any]:
        """Figure for JSON."""
        value = {"value": self.low} if self.low == self.high else {"low": self.low, "high": self.high}
        return value | {name: getattr(self, name) for name in ("grade", "source", "date", "said", "set_aside") if getattr(self, name)}


@dataclass(frozen=True)
class Used:
    """Value of one quantity that is used, with the range of the figures of its grade, and that grade."""

    value: float
    low: float
    high: float
    grade: str
    source: str

    @property
    def is_range(self) -> bool:
        """True if sources of the same grade differ."""
        return self.high > AGREED * self.low


@dataclass(frozen=True)
class Actuator:
    """Actuator with the figures that are published of it, by quantity."""

    name: str
    title: str
    maker: str
    used_in: tuple[str, ...]
    figures: Mapping[str, tuple[Figure, ...]]

    def word(self, quantity: str) -> str:
        """Word of a quantity that is no number; "" where it is not known."""
        return next((str(one.low) for one in self._best(self.figures.get(quantity, ()))), "")

    def used(self, quantity: str) -> Used | None:
        """Value of a quantity out of the figures; None where nothing is published.

        motor_inertia is that of figures on the joint side, or of rotor inertia and ratio where these are of a better grade.
        """
        best = self._best([*self._inertias()] if quantity == "motor_inertia" else self.figures.get(quantity, ()))
        if not best:
            return None
        first = best[0]
        value = float(first.low) if first.low == first.high else math.sqrt(first.low * first.high)
        low, high = min(float(one.low) for one in best), max(float(one.high) for one in best)
        return Used(value, low, high, first.grade, first.source)

    def _inertias(self) -> Iterator[Figure]:
        """Inertias of the motor on the joint side: published there, and out of rotor and ratio where these are of a better grade.

        A rotor's alone leaves out the gears, which add a few percent.
        """
        reflected = self._best(self.figures.get("reflected_inertia", ()))
        yield from reflected
        for rotor in self._best(self.figures.get("rotor_inertia", ())):
            for ratio in self._best(self.figures.get("ratio", ()))[:1]:
                worse = max(rotor.grade, ratio.grade, key=GRADES.index)
                if all(GRADES.index(worse) < GRADES.index(one.grade) for one in reflected):
                    yield Figure(rotor.low * ratio.low**2, rotor.high * ratio.high**2, rotor.source, worse, rotor.date)

    @staticmethod
    def _best(given: Sequence[Figure]) -> list[Figure]:
        """Figures that count, of the best grade that there is, in their order."""
        counted = [one for one in given if not one.set_aside]
        best = min((GRADES.index(one.grade) for one in counted), default=0)
        return [one for one in counted if one.grade == GRADES[best]]

    def entry(self) -> ActuatorEntry:
        """Actuator entry of a file, with the ranges in which sources differ."""
        found = {name: self.used(name) for name in ("motor_inertia", "stiffness", "damping", "peak_torque")}
        values = {name: one.value for name, one in found.items() if one is not None}
        ranges = {name: (one.low, one.high) for name, one in found.items() if one is not None and one.is_range and name != "peak_torque"}
        if "peak_torque" in values:
            values["effort_limit"] = values.pop("peak_torque")
        return replace(ActuatorEntry(), **values, ranges=ranges, actuator=self.name, published=frozenset(values))

    @property
    def sentence(self) -> str:
        """Sentence on what the figures say, and on which grade that rests."""
        return self.sentence_of(("motor_inertia", "stiffness", "damping"))

    def sentence_of(self, names: Collection[str]) -> str:
        """Sentence on the quantities `names`."""
        parts = []
        for name, unit in (("motor_inertia", UNITS["reflected_inertia"]), ("stiffness", UNITS["stiffness"]), ("damping", UNITS["damping"])):
            one = self.used(name)
            if one is not None and name in names:
                value = f"{digits(one.low, '', 3)} to {digits(one.high, unit, 3)}" if one.is_range else digits(one.value, unit, 3)
                parts.append(f"{name.replace('_', ' ')} {value} ({one.grade})")
        return f"{self.title}: {', '.join(parts)}" if parts else f"{self.title}: neither motor inertia nor stiffness is published"


@dataclass(frozen=True)
class KnownRobot:
    """Robot whose joints' actuators are published.

    joints   actuator by pattern of joint names, of every joint that it moves; None: not published
    has      joints that tell it from others
    named    pattern that the model's own name, file or folder has, where joints are called alike on others; "": not needed
    source   of this
    """

    title: str
    joints: Mapping[str, str | None]
    has: Sequence[str]
    source: str
    named: str = ""

    def of_joints(self, names: Sequence[str]) -> dict[str, str]:
        """Actuator by joint, of those of `names` that a pattern matches."""
        found = {name: actuator for name in names for pattern, actuator in self.joints.items() if re.fullmatch(pattern, name)}
        return {name: actuator for name, actuator in found.items() if actuator is not None}

    def is_of(self, names: Sequence[str], every: Sequence[str], called: Sequence[str]) -> bool:
        """True if all of `names` are its joints, and `every` and `called`, as recognised has them, tell it from others."""
        all_its = all(any(re.fullmatch(pattern, name) for pattern in self.joints) for name in names)
        word = rf"(?<![a-z0-9])({self.named})(?![a-z0-9])"
        return all_its and set(self.has) <= {*every} and (not self.named or any(re.search(word, name, re.IGNORECASE) for name in called))


def recognised(names: Sequence[str], every: Sequence[str], called: Sequence[str]) -> KnownRobot | None:
    """Known robot with joints `names` of a model; None where none is, or several are.

    every    all joints of the model
    called   names of the model, its file and its folder
    """
    found = [robot for robot in known_robots() if robot.is_of(names, every, called)]
    return found[0] if len(found) == 1 else None


@cache
def actuators() -> dict[str, Actuator]:
    """Every actuator by name."""
    return {name: _actuator(name, data) for name, data in json.loads(_text("actuators.json")).items()}


@cache
def known_robots() -> tuple[KnownRobot, ...]:
    """Robots whose actuators are known."""
    return tuple(KnownRobot(**one) for one in json.loads(_text("robots.json")))


def _text(name: str) -> str:
    return (files("gainroom") / "files" / "actuators" / name).read_text("utf-8")


def unknown_actuator(name: str) -> str:
    """Message about a name that no actuator has."""
    return f"{shown(name)} is no actuator of `gainroom actuators`{nearest(name, [*actuators()], 'actuator')}"


def _actuator(name: str, data: Mapping[str, Any]) -> Actuator:
    figures = {quantity: tuple(map(_figure, given)) for quantity, given in data["figures"].items()}
    return Actuator(name, data["title"], data["maker"], tuple(data.get("used_in") or ()), figures)


def _figure(data: Mapping[str, Any]) -> Figure:
    low, high = (data.get(end, data.get("value")) for end in ("low", "high"))
    more = {name: str(data[name]) for name in ("date", "said", "set_aside") if data.get(name)}
    return Figure(low, high, data["source"], data["grade"], **more)


def grades_of(names: Iterable[str]) -> str:
    """Grades of the motor inertias of the actuators `names`, one per joint, all published: "datasheet (23 joints), inferred (6)"."""
    counts = Counter(used.grade for name in names if (used := actuators()[name].used("motor_inertia")) is not None)
    first, *others = [f"{grade} ({counts[grade]}{{}})" for grade in GRADES if counts[grade]]
    return ", ".join([first.format(" joints" if sum(counts.values()) > 1 else " joint"), *(each.format("") for each in others)])


def published_notes(entries: Sequence[ActuatorEntry], names: Sequence[str]) -> list[str]:
    """Sentences on joints whose motors and gearboxes are those of published figures; `entries` and `names` of the joints, (n,)."""
    joints: dict[tuple[str, frozenset[str]], list[str]] = {}
    for name, entry in zip(names, entries, strict=True):
        if entry.actuator is not None and (taken := entry.published - {"effort_limit"}):
            joints.setdefault((entry.actuator, taken), []).append(name)
    return [f"{first_of_many(where)}: {actuators()[actuator].sentence_of(taken)}" for (actuator, taken), where in joints.items()]
