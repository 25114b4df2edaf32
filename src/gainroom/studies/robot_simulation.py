"""A whole robot's scenario, played in MuJoCo."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..analysis.gain_limit import GainLimit
from ..errors import GainroomError, named
from ..linear.arrays import Floats
from ..robot.name_patterns import select
from ..robot.spec import RobotSpec
from ..simulation.response import Tracking, track
from ..simulation.robot_result import RobotRun, joined_runs
from ..simulation.robot_run import stream_robot
from ..simulation.robot_setup import RobotSetup, hold, robot_setup
from ..simulation.spec import refuse_odd_run
from ..simulation.trajectories import Spline
from .joint_simulation import Interrupted
from .robot import limit_of, moves
from .robot_outcome import RobotPlay
from .robot_outcome_text import sentence, warnings
from .robot_vibration import chatter, listen

if TYPE_CHECKING:
    from ..robot.model import RobotModel

MOST_TICKS = 200_000
"""Of one run, which is kept whole: 100 s at 2 kHz."""
SMALL = 0.01
"""[m, rad] of a move where none is given."""
LOOKS = 2000
"""Ticks at most at which the feet are looked at, which takes longer than to simulate them."""


def setup_of(spec: RobotSpec) -> RobotSetup:
    """The robot as its scenario has it. Raises GainroomError where the simulation cannot have it so."""
    played = spec.scenario
    setup = robot_setup(
        spec,
        played.posture,
        played.contact,
        coulomb=played.coulomb,
        torque_limit=played.torque_limit,
        encoder_step=played.resolution,
        ground=played.ground,
    )
    viscous = setup.actuators.motor_viscous + played.viscous
    return replace(setup, actuators=replace(setup.actuators, motor_viscous=viscous))


def moves_of(spec: RobotSpec, setup: RobotSetup) -> Floats:
    """(m,) how far each channel moves. Raises GainroomError where `by` does not fit."""
    played, size = spec.scenario, setup.body.size
    if spec.control.space == "joint":
        chosen = range(size) if played.joint is None else select(played.joint, setup.body.joint_names, "scenario.move.joint")
        usual = np.zeros(1) if setup.contacts else np.array([SMALL])  # joints of closed legs cannot all move as one likes
        return _placed(size, list(chosen), usual if played.by is None else np.array(played.by))
    counts = [size if task.kind == "posture" else 3 for task in setup.stack]
    moved = 0 if played.task is None else [task.name for task in setup.stack].index(played.task)
    first, count = sum(counts[:moved]), counts[moved]
    usual = np.full(count, SMALL) if setup.stack[moved].kind == "posture" else np.array([SMALL, 0.0, 0.0])
    return _placed(sum(counts), list(range(first, first + count)), usual if played.by is None else np.array(played.by))


def _placed(total: int, places: list[int], by: Floats) -> Floats:
    if len(by) not in (1, len(places)):
        raise GainroomError(f"scenario.move.by: {len(by)} numbers must be one, or {len(places)}")
    moves = np.zeros(total)
    moves[places] = by
    return moves


def play_robot(
    spec: RobotSpec,
    gain: float = 1.0,
    rows: Callable[[RobotRun], None] = lambda part: None,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
    stopped: Callable[[], bool] = lambda: False,
) -> RobotPlay:
    """Play the file's scenario with all gains times `gain`; `rows` takes the parts as they come.

    Raises GainroomError for continuous control and where MuJoCo is missing or cannot simulate it, Interrupted once `stopped` says so.
    """
    with named(spec.robot.name):
        return _play(spec, gain, rows, progress, stopped)


def _play(
    spec: RobotSpec,
    gain: float,
    rows: Callable[[RobotRun], None],
    progress: Callable[[int, int, str], None],
    stopped: Callable[[], bool],
) -> RobotPlay:
    setup = setup_of(spec)
    refuse_odd_run(spec.scenario.duration, setup.sample_time, MOST_TICKS)
    way = moves_of(spec, setup)
    played, offsets = spec.scenario, hold(setup, spec.scenario.duration)
    time = setup.sample_time * np.arange(len(offsets))
    offsets = Spline.move(way, played.move_duration, order=5).position(time)
    parts, done = [], 0
    for part in stream_robot(setup, offsets, gain=gain):
        rows(part)
        parts.append(part)
        done += len(part.time)
        progress(done, len(offsets), "")
        if stopped():
            raise Interrupted(done * setup.sample_time)
    run = joined_runs(parts)
    if not len(run.time):
        raise GainroomError("the first torques are not finite: the gains are too large to compute with")
    return _told(spec, gain, run)


def _told(spec: RobotSpec, gain: float, run: RobotRun) -> RobotPlay:
    torque, told = run.actual_torque, bool((run.reference != run.reference[:1]).any())
    moved = spec.scenario.move_duration if told else 0.0
    robot = replace(spec.robot, actuators=run.setup.actuators)  # with the scenario's viscous friction, which is linear
    model = robot.linearize(spec.scenario.posture, spec.scenario.contact)
    limit = _limit(spec, model, gain)
    play = RobotPlay(
        spec,
        gain,
        moved,
        run,
        _tracking(run),
        np.abs(torque).max(axis=0),
        np.sqrt(np.mean(torque**2, axis=0)),
        run.rows(slice(None, None, max(1, len(run.time) // LOOKS))).slip.max(axis=0),
        None,
        chatter(run, moved),
        _stuck(spec, model, run),
        limit,
    )
    play = replace(play, heard=listen(run, moved, limit, play.linear))
    return replace(play, sentence=sentence(play), warnings=(*spec.warnings, *warnings(play)))


def _tracking(run: RobotRun) -> Tracking:
    found = track(run)
    if run.ending == "completed":
        return found
    nothing = np.full(len(run.channels), np.nan)
    return replace(found, steady_state=nothing, overshoot=nothing, settling_time=nothing)


def _limit(spec: RobotSpec, model: "RobotModel", gain: float) -> GainLimit | None:
    """Of the linear loop in the scenario's posture and contact state, with viscous friction but without Coulomb's and the ground's."""
    loop = spec.loop(model).scaled(gain)
    return limit_of(loop) if moves(loop) else None


def _stuck(spec: RobotSpec, model: "RobotModel", run: RobotRun) -> tuple[str, ...]:
    """Directions of tasks, such as the centre of mass in flight."""
    if spec.control.space == "joint":
        return ()
    told = (run.reference != run.reference[:1]).any(axis=0)
    return tuple(run.channels[k] for k in np.flatnonzero(told & ~spec.robot.tasks(model, spec.control.rotors).movable).tolist())
