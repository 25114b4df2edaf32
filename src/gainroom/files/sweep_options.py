"""Plan of a sweep from the options of `gainroom sweep`: postures, contact states and draws."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import GainroomError, Together, all_of, first_of_many, nearest, refuse_all
from ..robot.body import RigidBody
from ..robot.held_followers import on_a_tree
from ..robot.name_patterns import compile_pattern
from ..robot.robot import Robot
from ..studies.sweep.plan import SweepPlan, drawn
from ..studies.sweep.postures import Postures, followed, gridded, sampled
from ..system.linear.arrays import Floats
from ..system.system import System

if TYPE_CHECKING:
    from .logs import Log

POSITIONS = ("link_position", "motor_position")
"""Channels of a log that form a posture, the preferred one first."""


@dataclass(frozen=True)
class SweepOptions:
    """Options of `gainroom sweep` as typed.

    samples      None: the default, where nothing else is asked for
    grid         JOINT=LOW:HIGH:POINTS each, ranges JOINT=LOW:HIGH; JOINT is a name or a pattern
    trajectory   a log with positions of joints
    contacts     names; empty: all of the robot's
    posture      where joints stand that are not swept; "": in the first
    """

    samples: int | None = None
    grid: Sequence[str] = ()
    ranges: Sequence[str] = ()
    trajectory: Path | None = None
    contacts: Sequence[str] = ()
    draws: int = 0
    seed: int = 0
    posture: str = ""


SAMPLES = 10_000


def sweep_plan(system: System, options: SweepOptions) -> SweepPlan:
    """Plan of the sweep. Raises GainroomError for options that contradict each other, or the robot."""
    if not isinstance(system.source, Robot):
        raise GainroomError(f"{system.source.name}: a sweep needs a robot: a robot.yaml, or a model")
    known, system = system.warnings, on_a_tree(system)
    robot, held = system.source, tuple(text for text in system.warnings if text not in known)
    robot.body.require_tree(f"{robot.name}: sweep")
    contacts = tuple(dict.fromkeys(options.contacts)) or tuple(robot.contacts)
    with Together() as together:
        consistent = together.step(lambda: refuse_all(_contradictions(options, robot, contacts)))
        path = options.trajectory
        found = together.step(lambda: (_postures(robot, options), ()) if path is None else _logged(robot, path, options.posture))
        draws = together.step(lambda: drawn(system, options.draws, max(options.seed, 0)))
        consistent()
        postures, notes = found()
        return SweepPlan(system, postures, contacts, draws(), options.seed, notes=(*held, *notes))


def _contradictions(options: SweepOptions, robot: Robot, contacts: Sequence[str]) -> Iterator[str]:
    """Messages about options that exclude each other, or that name what the robot does not have."""
    ways = {"--samples": options.samples is not None, "--grid": bool(options.grid), "--trajectory": options.trajectory is not None}
    asked = [name for name, given in ways.items() if given]
    if len(asked) > 1:
        yield f"{' and '.join(asked)}: only one of them can be given"
    if options.ranges and (options.grid or options.trajectory is not None):
        yield f"--range goes with --samples, not with {next(name for name in asked if name != '--samples')}"
    if options.seed < 0:
        yield f"--seed {options.seed} must be >= 0"
    for name in contacts:
        if name not in robot.contacts:
            yield f"--contact: {name!r} is not one of this robot's{nearest(name, tuple(robot.contacts), 'contact')}"


def _logged(robot: Robot, path: Path, posture: str) -> tuple[Postures, tuple[str, ...]]:
    """Postures of a log, and notes about the rows and joints that were left out."""
    from .logs import read_log

    body, log, notes = robot.body, read_log(path), []
    columns = _positions(log, path)
    found = followed(body, standing(robot, posture), columns, str(path))
    if log.quality.cut:
        cut = f"{log.quality.cut} of {log.quality.rows} rows are left out"
        notes.append(f"{path}: {cut}: a number is missing or not finite, or their time does not rise")
    missing = [name for name in body.joint_names if name not in columns]
    if missing:
        where = posture or next(iter(robot.postures))
        notes.append(f"{path}: no positions of {first_of_many(missing)}; there as in posture {where}")
    return found, tuple(notes)


def _postures(robot: Robot, options: SweepOptions) -> Postures:
    body = robot.body
    with Together() as together:
        base = together.step(lambda: standing(robot, options.posture))
        grid = together.step(lambda: _by_joint("--grid", options.grid, body, 3))
        typed = together.step(lambda: _by_joint("--range", options.ranges, body, 2))
        ranges = {name: (values[0], values[1]) for name, values in typed().items()}
        if options.grid:
            return gridded(body, base(), {name: (values[0], values[1], _points(values[2])) for name, values in grid().items()})
        return sampled(body, base(), SAMPLES if options.samples is None else options.samples, ranges, max(options.seed, 0))


def standing(robot: Robot, posture: str = "") -> Floats:
    """Joint positions (n,) of a posture by name, "" for the first. Raises GainroomError for an unknown name."""
    if posture and posture not in robot.postures:
        raise GainroomError(f"--posture: {posture!r} is not one of this robot's{nearest(posture, tuple(robot.postures), 'posture')}")
    found = robot.postures[posture] if posture else next(iter(robot.postures.values()))
    return robot.body.angles(robot.body.configuration(dict(found.angles)))


def _positions(log: "Log", path: Path) -> dict[str, Floats]:
    """Positions (k,) by joint in a log [rad; m if prismatic]. Raises GainroomError if there are none."""
    found: dict[str, Floats] = {}
    for joint, channels in log.joints.items():
        for name in POSITIONS:
            if name in channels and joint not in found:
                found[joint] = np.asarray(channels[name], dtype=float)
    if not found:
        raise GainroomError(f"{path}: no positions of joints: columns such as motor_position_NAME or link_position_NAME")
    return found


def _by_joint(option: str, texts: Sequence[str], body: RigidBody, size: int) -> Mapping[str, list[float]]:
    """Numbers by joint of options JOINT=…; of two for one joint the later one wins."""
    expected = "JOINT=LOW:HIGH" + (":POINTS" if size == 3 else "")

    def read(text: str) -> dict[str, list[float]]:
        pattern, equals, rest = text.rpartition("=")
        parts = rest.split(":")
        try:
            values = [float(part) for part in parts]
        except ValueError:
            values = []
        if not equals or not pattern or len(values) != size or not all(map(math.isfinite, values)):
            raise GainroomError(f"{option}: {text[:60]!r} must be {expected}, in rad (m if prismatic)")
        if values[0] >= values[1]:
            raise GainroomError(f"{option}: {text[:60]!r}: low must be below high")
        matches = compile_pattern(pattern, option)
        names = [name for name in body.joint_names if name == pattern or matches.fullmatch(name)]
        if not names:
            raise GainroomError(f"{option}: {pattern!r} matches no joint{nearest(pattern, body.joint_names, 'joint')}")
        return dict.fromkeys(names, values)

    return {name: values for part in all_of(partial(read, text) for text in texts) for name, values in part.items()}


def _points(value: float) -> int:
    if value != int(value) or value < 2:
        raise GainroomError(f"--grid: {value:g} points must be a whole number, 2 or more")
    return int(value)
