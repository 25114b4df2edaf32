"""Channels of a robot whose gains the page drags: its joints, or the directions of its tasks, each with a controller of its own."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..files.edited_text import Keys
from ..report.gains_to_use import patterns, robot_gains
from ..report.number_format import own_gains
from ..system.controller import Controller, type_of
from ..system.system import System
from .edits import at_point
from .messages import View


@dataclass(frozen=True)
class Channel:
    """Channel: a joint, or a direction of a task, by its index among the names; `own`: its gains, as a controller of one joint."""

    name: str
    place: int
    own: Controller

    @property
    def point(self) -> tuple[float, float]:
        """Point of these gains in the gain map."""
        return self.own.plane_gains()

    @property
    def held(self) -> Controller:
        """Controller with the gains that are constant over the map."""
        return self.own.from_plane(1.0, 1.0)


class Channels:
    """Channels of one file."""

    def __init__(self, system: System) -> None:
        control, source = system.control, system.source
        self.of_tasks = control.space == "task"
        self._units = ("1/s²", "1/s") if self.of_tasks else ("N·m/rad", "N·m·s/rad")
        if self.of_tasks:
            tasks = source.tasks(source.linearize(), control.rotors)
            ends = np.searchsorted(tasks.owners, np.arange(len(source.stack) + 1)).tolist()
            self.names: tuple[str, ...] = tasks.directions
            self._rows = [slice(start, end) for start, end in itertools.pairwise(ends)]
            self._file: tuple[Controller, ...] = tuple(system.filtered(tasks.of_direction(k)) for k in range(len(self.names)))
        else:
            self.names, self._rows = source.joint_names, []
            self._file = tuple(control.controller.on_joint(k, len(self.names)) for k in range(len(self.names)))
        if not all(own.has_plane for own in self._file):
            raise GainroomError(
                f"control.type: {type_of(control.controller)} has no kp–kd plane to move in; `gainroom robot` judges its gains"
            )

    def described(self) -> dict[str, Any]:
        """Description of each channel for the page: names and units of its gains and of its map's axes, and the file's point."""
        each = list(zip(self.names, self._file, strict=True))
        return {
            "channels": self.names,
            "gains": {name: [{"name": gain, "unit": unit} for gain, _, unit in own_gains(own, self.of_tasks)] for name, own in each},
            "axes": {name: own.plane_names for name, own in each},
            "units": self._units,
            "points": self.points(self._file),
        }

    def disturbance(self, system: System, k: int) -> tuple[str, str, float]:
        """Load on the links in the second response: its text, the unit of the response, and the number of these units per m or rad."""
        if not self.of_tasks:
            load, unit = ("1 N on the link", "µm") if system.source.prismatic[k] else ("1 N·m on the link", "µrad")
            return load, unit, 1e6
        task = system.source.stack[next(place for place, rows in enumerate(self._rows) if rows.start <= k < rows.stop)]
        unit = "m" if task.kind in ("com", "position") else "rad"
        return f"what would move the links by 1 {unit}/s²", f"m{unit}", 1e3

    def points(self, own: Sequence[Controller]) -> dict[str, tuple[float, float]]:
        """Point of each channel in its map; empty for no controllers."""
        return {name: one.plane_gains() for name, one in zip(self.names, own, strict=False)}

    def named(self, own: Sequence[Controller]) -> dict[str, dict[str, float]]:
        """Gains by channel and name; empty for no controllers."""
        return {name: {gain: float(value) for gain, value, _ in own_gains(one)} for name, one in zip(self.names, own, strict=False)}

    def place(self, view: View) -> int:
        """Index of the view's channel. Raises GainroomError for a channel that this robot does not have."""
        if view.joint is not None and view.joint not in self.names:
            raise GainroomError(f"joint {view.joint[:60]!r} is not one of this robot's")
        return 0 if view.joint is None else self.names.index(view.joint)

    def gains(self, view: View) -> tuple[Controller, ...]:
        """Controller of every channel: the file's gains, replaced by the view's, and those by the view's point."""
        own = list(self._file)
        for name, given in view.gains.items():
            if name not in self.names or not isinstance(given, Mapping):
                raise GainroomError(f"gains: {name[:60]!r} is not a joint or task direction of this robot with gains by name")
            k = self.names.index(name)
            if strange := given.keys() - set(own[k].gain_names()):
                raise GainroomError(f"gains: {name[:60]!r} has {', '.join(own[k].gain_names())}, not {min(strange)}")
            values: dict[str, Any] = {**given}
            if any(getattr(own[k], gain) != value for gain, value in values.items()):  # most are the file's, at every move of the pointer
                own[k] = replace(own[k], **values)
        if view.point is not None:
            k = self.place(view)
            own[k] = at_point(own[k], view.point)
        return tuple(own)

    def channel(self, view: View) -> Channel:
        """Channel that is dragged."""
        k = self.place(view)
        return Channel(self.names[k], k, self.gains(view)[k])

    def applied(self, system: System, view: View) -> System:
        """System with the view's gains."""
        own, source = self.gains(view), system.source
        if not self.of_tasks:
            return system.with_controller(replace(system.control.controller, **_columns(own)))
        stack = tuple(task.regained(own[rows]) for task, rows in zip(source.stack, self._rows, strict=True))
        return replace(system, source=replace(source, stack=stack))

    def changes(self, view: View) -> dict[Keys, Any]:
        """Changes of the file's gains by the view, by key."""
        own, found = self.gains(view), {}
        if not self.of_tasks:
            for key, values in _changed(own, self._file):
                groups: dict[float, list[str]] = {}
                for name, value in zip(self.names, values.tolist(), strict=True):
                    groups.setdefault(value, []).append(name)
                by_pattern = {pattern: value for value, group in groups.items() for pattern in patterns(group, self.names)}
                found["control", key] = by_pattern if len(groups) > 1 else float(values[0])
            return found
        for place, rows in enumerate(self._rows):
            for key, values in _changed(own[rows], self._file[rows]):
                found["tasks", place, key] = values.tolist()
        return found

    def lines(self, view: View) -> str:
        """Lines of the view's gains as typed into the file."""
        space = "task" if self.of_tasks else "joint"
        return "".join(f"{line}\n" for line in robot_gains(self.names, self.gains(view), space))


def _columns(own: Sequence[Controller]) -> dict[str, Any]:
    """Columns (m,) of each gain of all controllers."""
    return {name: np.array([float(getattr(one, name)) for one in own]) for name in own[0].gain_names()}


def _changed(own: Sequence[Controller], old: Sequence[Controller]) -> list[tuple[str, Any]]:
    before = _columns(old)
    return [(key, values) for key, values in _columns(own).items() if not np.array_equal(values, before[key])]
