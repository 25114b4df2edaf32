"""A whole robot's scenario, played in MuJoCo: how well it tracks, and whether it stays up."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .arrays import Floats
from .errors import GainroomError
from .robot.patterns import select
from .robot_spec import RobotSpec
from .simulation.oscillation import SHORTEST, Vibration, vibration
from .simulation.robot_result import RobotRun, joined_runs
from .simulation.robot_run import stream_robot
from .simulation.robot_setup import RobotSetup, hold, robot_setup
from .simulation.trajectories import Spline
from .simulation_study import Interrupted

SMALL = 0.01
"""[m, rad] of a move where none is given."""
NOTICED = 1e-5
"""[m, rad] a smaller vibration is none."""


@dataclass(frozen=True)
class RobotPlay:
    """What `gainroom simulate` tells of a robot; rms, peak and steady_state (m,) of the error by channel [m, rad]."""

    run: RobotRun
    rms: Floats
    peak: Floats
    steady_state: Floats
    vibration: Vibration | None
    sentence: str

    @property
    def vibrates(self) -> bool:
        """After the move, so that anyone would see it, and growing."""
        found = self.vibration
        return found is not None and found.growth_rate > 0 and found.amplitude > NOTICED

    @property
    def sound(self) -> bool:
        """It stayed up, and does not vibrate."""
        return self.run.ending == "completed" and not self.vibrates


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
    setup = setup_of(spec)
    try:
        moves = moves_of(spec, setup)
    except GainroomError as error:
        raise GainroomError(f"{spec.robot.name}: {error}") from error
    played, offsets = spec.scenario, hold(setup, spec.scenario.duration)
    time = setup.sample_time * np.arange(len(offsets))
    offsets = Spline.move(moves, played.move_duration, order=5).position(time)
    parts, done = [], 0
    for part in stream_robot(setup, offsets, gain=gain):
        rows(part)
        parts.append(part)
        done += len(part.time)
        progress(done, len(offsets), "")
        if stopped():
            raise Interrupted(done * setup.sample_time)
    return _told(joined_runs(parts), played.move_duration)


def _told(run: RobotRun, moved: float) -> RobotPlay:
    after = run.error[run.time >= moved]
    found = None
    if run.ending == "completed" and len(after) >= SHORTEST:
        found = vibration(after, run.setup.sample_time)
    peak = np.abs(run.error).max(axis=0, initial=0.0)
    steady = run.steady_error() if run.ending == "completed" else np.full(peak.shape, np.nan)
    rms = np.sqrt(np.mean(run.error**2, axis=0)) if len(run.error) else peak
    play = RobotPlay(run, rms, peak, steady, found, "")
    return replace(play, sentence=_sentence(play))


def _sentence(play: RobotPlay) -> str:
    run = play.run
    if run.ending != "completed":
        return f"{run.reason[0].upper()}{run.reason[1:]}."
    worst = int(np.argmax(play.peak))
    peak, last = 1e3 * play.peak[worst], 1e3 * abs(play.steady_state[worst])
    off = f"{run.channels[worst]!r} is up to {peak:.3g} mm or mrad off, {last:.3g} in the end"
    if play.vibrates and play.vibration is not None:
        return f"Vibrates at {play.vibration.frequency:.4g} rad/s, and it grows; {off}."
    return f"Tracks and does not vibrate: {off}."
