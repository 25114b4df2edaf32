"""Plan of a sweep: tasks that any process may compute, in any order, with the same result."""

import hashlib
import json
import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...errors import GainroomError
from ...robot.robot import Robot
from ...system.linear.arrays import Floats
from ...system.system import System
from ...system.uncertainty import NOMINAL, Place
from .limits import Limits, StateLimits
from .postures import Postures, sobol

CHUNK, LONG_CHUNK, LONG = 4096, 65536, 1 << 24
"""Postures per task, and per task of a sweep of more than LONG: a second of work, and at 10⁹ postures not too many files."""
MOST_DRAWS = 10_000


class SweepTask(NamedTuple):
    """Postures `first` to `stop` of one draw and contact state, all as indices; `part`: index of this piece of the postures."""

    draw: int
    contact: int
    part: int
    first: int
    stop: int

    @property
    def size(self) -> int:
        """Number of postures."""
        return self.stop - self.first


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """All postures, in every contact state, with every draw.

    places   places in the system's uncertainty: NOMINAL first, then the draws
    chunk    postures of a task, but for the last; 0: chosen by their number
    notes    parts of the robot, or of the log that the postures come from, that were left out
    """

    system: System
    postures: Postures
    contacts: tuple[str, ...]
    places: tuple[Place, ...] = (NOMINAL,)
    seed: int = 0
    chunk: int = 0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.chunk:
            object.__setattr__(self, "chunk", LONG_CHUNK if self.postures.count > LONG else CHUNK)
        for contact in self.contacts:
            StateLimits(self.system, contact)  # raises

    @property
    def robot(self) -> Robot:
        """Robot of the system."""
        return self.system.source  # type: ignore[return-value]

    @property
    def parts(self) -> int:
        """Number of pieces that the postures are cut into."""
        return math.ceil(self.postures.count / self.chunk)

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.places) * len(self.contacts) * self.parts

    @property
    def states(self) -> int:
        """Number of limits in all."""
        return len(self.places) * len(self.contacts) * self.postures.count

    def task(self, number: int) -> SweepTask:
        """Task with index `number`, 0 to `tasks` − 1."""
        rest, part = divmod(number, self.parts)
        draw, contact = divmod(rest, len(self.contacts))
        first = part * self.chunk
        return SweepTask(draw, contact, part, first, min(first + self.chunk, self.postures.count))

    def computed(self, task: SweepTask) -> Limits:
        """Limits of a task, bit-identical wherever it is computed."""
        return self._of(task.draw, task.contact).limits(self.postures.at(task.first, task.stop))

    def at(self, draw: int, contact: int) -> StateLimits:
        """Limit computation for one draw and contact state."""
        return self._of(draw, contact)

    def _of(self, draw: int, contact: int) -> StateLimits:
        known = self._known
        if getattr(known, "of", None) != (draw, contact):
            known.of, known.limits = (draw, contact), StateLimits(self.system.at(self.places[draw]), self.contacts[contact])
        return known.limits

    @cached_property
    def _known(self) -> threading.local:
        """Cache of the limit computation used last, per thread: the core works for one thread at a time."""
        return threading.local()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_known"}

    @cached_property
    def identity(self) -> dict[str, str]:
        """Identity of the sweep: digests of everything that its results depend on, by part."""
        from ... import __version__

        first = self.postures.at(0, min(self.postures.count, 64))  # as this machine's libraries make them
        postures = (self.postures.kind, self.postures.count, self.chunk, _canonical(self.postures), _canonical(first))
        return {
            "version": __version__,
            "robot": _digest((_canonical(self.system.source), _canonical(self.system.drives), _canonical(self.system.control))),
            "postures": _digest(postures),
            "contacts": _digest(self.contacts),
            "draws": _digest(_canonical([self.system.at(place).source.quantities for place in self.places] + [list(self.places)])),
        }


def drawn(system: System, draws: int, seed: int = 0) -> tuple[Place, ...]:
    """Places NOMINAL and `draws` points spread evenly over the uncertainty. Raises GainroomError if nothing is uncertain."""
    if not 0 <= draws <= MOST_DRAWS:
        raise GainroomError(f"sweep: {draws} draws; from 0 to {MOST_DRAWS} are possible")
    names = system.uncertainty.names
    if draws and not names:
        raise GainroomError(f"{system.source.name}: draws need an `uncertainty` section")
    return (NOMINAL, *map(tuple, sobol(len(names), 0, draws, seed + 1).tolist())) if draws else (NOMINAL,)


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:20]


def _canonical(value: Any) -> Any:
    """JSON-like form of a value that depends on its numbers alone, not on the file or its location."""
    if isinstance(value, Robot):  # without names of files, and what does not enter a limit
        parts = (value.actuators, value.contacts, value.stack, value.gravity, value.body)
        return ["Robot", *map(_canonical, parts)]
    if hasattr(value, "saveToString"):  # a model of Pinocchio's
        return hashlib.sha256(_model(value)).hexdigest()
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__name__, *(_canonical(getattr(value, one.name)) for one in fields(value) if one.name not in NAMES)]
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        return [list(array.shape), str(array.dtype), hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()]
    if isinstance(value, Mapping):
        return [[str(key), _canonical(one)] for key, one in sorted(value.items())]
    if isinstance(value, list | tuple | set | frozenset):
        return [_canonical(one) for one in (sorted(value) if isinstance(value, set | frozenset) else value)]
    if isinstance(value, float):
        return value.hex()
    return value if value is None or isinstance(value, str | int | bool) else repr(value)


NAMES = ("source", "notes", "bones", "unknown", "effort_limit")
"""Fields about origin, drawing and authorship, on which no limit depends."""


def _model(model: Any) -> bytes:
    """Bytes of everything in a Pinocchio model that rigid-body terms depend on."""
    parts: list[Floats] = [np.asarray(model.parents, dtype=float)]
    for joint in range(model.njoints):
        inertia, placement = model.inertias[joint], model.jointPlacements[joint]
        parts += [np.array([inertia.mass]), np.asarray(inertia.lever), np.asarray(inertia.inertia), np.asarray(placement.homogeneous)]
    frames = [(frame.name, int(frame.parentJoint), np.asarray(frame.placement.homogeneous).tobytes()) for frame in model.frames]
    kinds = [joint.shortname() for joint in model.joints]
    named = repr([list(model.names), kinds, [(name, parent) for name, parent, _ in frames]]).encode()
    return named + b"".join(np.ascontiguousarray(part, dtype=float).tobytes() for part in parts) + b"".join(last for *_, last in frames)
