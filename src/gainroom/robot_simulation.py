"""A whole robot's scenario, played in MuJoCo: how well it tracks, and whether it stays up."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .arrays import Complexes, Floats
from .errors import GainroomError
from .limits import GainLimit
from .messages import printable
from .robot.ground import Footing, footings
from .robot.patterns import select
from .robot_spec import RobotSpec
from .robot_states import STRONG, strongest_first
from .robot_study import limit_of, moves
from .robot_words import listed
from .simulation.oscillation import SHORTEST, Vibration, parts_in, vibration
from .simulation.response import Tracking, track
from .simulation.robot_result import RobotRun, joined_runs
from .simulation.robot_run import stream_robot
from .simulation.robot_setup import RobotSetup, Unit, channel_units, hold, robot_setup
from .simulation.trajectories import Spline
from .simulation_spec import refuse_long_run
from .simulation_study import NOTICED as STEPS
from .simulation_study import Interrupted, doubling, frequency_in_words, keeps_up, lasts, prediction_in_words, that_rings

if TYPE_CHECKING:
    from .robot.model import RobotModel

MOST_TICKS = 200_000
"""Of one run, which is kept whole: 100 s at 2 kHz."""
SMALL = 0.01
"""[m, rad] of a move where none is given."""
NOTICED = 1e-5
"""[m, rad] a smaller vibration is none."""
SEEN = 1e-6
"""[m, rad] smaller errors are not told in the sentence."""
TINY = 1e-7
"""[m, rad] smaller errors are shown as 0."""
SLOPING = math.radians(1.0)
"""A flat foot's ground that slopes by more is told [rad]."""
UNEVEN = 1e-3
"""Feet that stand higher than others by more are told [m]."""
LATE = 0.75
"""Of the run: a move that ends later leaves too little to look at."""
LOOKS = 2000
"""Ticks at most at which the feet are looked at, which takes longer than to simulate them."""


@dataclass(frozen=True)
class RobotPlay:
    """What `gainroom simulate` tells of a robot.

    gain          factor on all gains
    moved_until   [s] when the reference comes to rest; 0 where it never moves
    tracking      by channel [m, rad]; of a run that ended early only `rms` and `peak`, the others are NaN
    torque_peak, torque_rms   (n,) of the actual torque [N m]
    slip          (c,) furthest that each contact frame was from where it started, looked at `LOOKS` times [m]
    vibration     the strongest after the reference came to rest; of a run that ended early that of its second half, where the linear
                  loop is unstable; None where nothing rings
    parts         (n,) complex: the motors' parts in that vibration, the largest 1; None without one
    swing         of the motor that swings most, at the end of it [rad]; NaN without one
    stuck         names of the channels that are told to move, and that nothing can move in this state
    limit         what the linear sampled loop predicts, as a factor on the gains played; None where the gains move nothing
    sentence, warnings   in words
    """

    spec: RobotSpec
    gain: float
    moved_until: float
    run: RobotRun
    tracking: Tracking
    torque_peak: Floats
    torque_rms: Floats
    slip: Floats
    vibration: Vibration | None
    parts: Complexes | None
    swing: float
    stuck: tuple[str, ...]
    limit: GainLimit | None
    sentence: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def completed(self) -> bool:
        """It lasted to its end."""
        return self.run.ending == "completed"

    @property
    def lasted(self) -> float:
        """[s] that were played."""
        return len(self.run.time) * self.run.setup.sample_time

    @property
    def moving(self) -> bool:
        """Whether anything is told to move."""
        return self.moved_until > 0

    @property
    def linear(self) -> bool:
        """Nothing rubs, limits or lets go that could hold a vibration at its size."""
        setup = self.run.setup
        return not (np.any(setup.coulomb) or np.any(np.isfinite(setup.torque_limit)) or setup.encoder_step or setup.ground is not None)

    @property
    def vibrates(self) -> bool:
        """So that anyone would see it, by more than encoders' steps make, and not dying away."""
        found, least = self.vibration, max(NOTICED, STEPS * self.run.setup.encoder_step)
        return found is not None and found.amplitude > least and lasts(found, self.linear)

    @property
    def sound(self) -> bool:
        """It stayed up, and does not vibrate."""
        return self.completed and not self.vibrates

    @cached_property
    def units(self) -> tuple[Unit, ...]:
        """(m,) "m" or "rad", of each channel."""
        return channel_units(self.run.setup)

    @cached_property
    def leading(self) -> tuple[int, ...]:
        """The channels that tell how well it tracks, the one that is furthest off first, all in one unit: those that are moved, if any."""
        reference = self.run.reference
        moved = np.flatnonzero((reference != reference[:1]).any(axis=0))
        among = moved.tolist() if len(moved) else list(range(len(self.units)))
        return tuple(sorted((k for k in among if self.units[k] == self.units[among[0]]), key=lambda k: -self.tracking.peak[k]))

    @cached_property
    def others(self) -> tuple[int, ...]:
        """All other channels, the one that is furthest off first, whatever its unit."""
        return tuple(sorted(set(range(len(self.units))) - set(self.leading), key=lambda k: -self.tracking.peak[k]))

    @cached_property
    def footings(self) -> tuple[Footing, ...]:
        """What the feet stand on; empty where they are held."""
        setup = self.run.setup
        return footings(setup.body, setup.q, setup.contacts) if setup.ground is not None and setup.gravity else ()

    def parts_strongest_first(self) -> list[int]:
        """The joints that take part in the vibration, the strongest first."""
        if self.parts is None:
            return []
        return [k for k in strongest_first(self.parts).tolist() if abs(self.parts[k]) >= STRONG]


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
        refuse_long_run(spec.scenario.duration, setup.sample_time, MOST_TICKS)
        way = moves_of(spec, setup)
    except GainroomError as error:
        raise GainroomError(f"{spec.robot.name}: {error}") from error
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
        raise GainroomError(f"{spec.robot.name}: the first torques are not finite: the gains are too large to compute with")
    return _told(spec, gain, run)


def _told(spec: RobotSpec, gain: float, run: RobotRun) -> RobotPlay:
    torque, told = run.actual_torque, bool((run.reference != run.reference[:1]).any())
    moved = spec.scenario.move_duration if told else 0.0
    seen = run.rows(slice(round(moved / run.setup.sample_time) if run.ending == "completed" else len(run.time) // 2, None))
    found = that_rings(vibration(seen.error, run.setup.sample_time), NOTICED) if len(seen.time) >= SHORTEST else None
    robot = replace(spec.robot, actuators=run.setup.actuators)  # with the scenario's viscous friction, which is linear
    model = robot.linearize(spec.scenario.posture, spec.scenario.contact)
    limit, parts, swing = _limit(spec, model, gain), None, math.nan
    if run.ending != "completed" and (limit is None or limit.stable):
        found = None  # what swings as the robot topples is no vibration
    if found is not None:
        parts = parts_in(seen.motor_position, run.setup.sample_time, found)
        largest = complex(parts[np.argmax(np.abs(parts))])
        parts, swing = parts / largest, abs(largest)
    play = RobotPlay(
        spec,
        gain,
        moved,
        run,
        _tracking(run),
        np.abs(torque).max(axis=0),
        np.sqrt(np.mean(torque**2, axis=0)),
        run.rows(slice(None, None, max(1, len(run.time) // LOOKS))).slip.max(axis=0),
        found,
        parts,
        swing,
        _stuck(spec, model, run),
        limit,
    )
    return replace(play, sentence=_sentence(play), warnings=(*spec.warnings, *_warnings(play)))


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


def _sentence(play: RobotPlay) -> str:
    """The answer in one sentence."""
    run, found, first = play.run, play.tracking, play.leading[0]
    shakes = play.vibration if play.vibrates else None
    name = printable(run.channels[first])

    def error(channel: int, values: Floats) -> str:
        value, unit = abs(values[channel]), f"m{play.units[channel]}"
        return f"{1e3 * value:.3g} {unit}" if value >= SEEN else f"less than {1e3 * SEEN:g} {unit}"

    if not play.completed:
        text = f"{run.reason[0].upper()}{run.reason[1:]}, {name} {error(first, found.peak)} off its reference"
        if shakes is not None and run.ending == "diverged":
            text += f", vibrating at {frequency_in_words(shakes.frequency)}"
    elif shakes is not None:
        most = printable(run.joint_names[play.parts_strongest_first()[0]])
        growth = "keeping up" if not play.linear and keeps_up(shakes) else doubling(shakes)
        text = f"Vibrates at {frequency_in_words(shakes.frequency)}, {growth}, {most} most of all by {1e3 * play.swing:.3g} mrad"
    else:
        opening = "Does not vibrate" if play.stuck else "Tracks and does not vibrate"
        text = f"{opening}: {name} stays within {error(first, found.peak)} of its reference"
        text += f" and ends {error(first, found.steady_state)} off"
        if play.others and found.peak[play.others[0]] > NOTICED:
            text += f", {printable(run.channels[play.others[0]])}, held, strays by {error(play.others[0], found.peak)}"
    predicted = "these gains move nothing in this state" if play.limit is None else prediction_in_words(play.limit)
    return f"{text}; {predicted}."


def _warnings(play: RobotPlay) -> list[str]:
    """What a user should know or do, each with the remedy."""
    told, limit = [], play.limit
    if play.completed and play.moved_until > LATE * play.spec.scenario.duration:
        told.append(
            "the move ends late in the run or not at all: lengthen scenario.duration for a steady state, and to see whether it vibrates"
        )
    if play.stuck:
        told.append(f"nothing can move {listed(play.stuck)} in this posture and contact state: take another state, or move another task")
    told += _ground_warnings(play)
    if limit is None:
        return told
    if limit.stable and not play.completed:
        told.append("the linear loop is stable: it is the move, the feet or friction that end it so, not gains that are too high")
    elif limit.stable and not play.sound:
        told.append("the linear loop is stable: ground, friction or a large motion keep this up; take one away at a time")
    if not limit.stable and play.sound:
        told.append("the linear loop is unstable all the same: friction hides it, or the run is too short, lengthen scenario.duration")
    return told


def _ground_warnings(play: RobotPlay) -> list[str]:
    """Where it is not one level floor."""
    told, steepest = [], max((footing.slope for footing in play.footings), default=0.0)
    if steepest > SLOPING:
        frames = listed([footing.frame for footing in play.footings if footing.slope > steepest - SLOPING])
        told.append(
            f"the ground slopes by {math.degrees(steepest):.3g}° under {frames}, as the contact frames do in this posture: "
            "for a level floor turn the feet until they are level"
        )
    highest = max(play.footings, key=lambda footing: footing.height, default=None)
    if highest is not None and highest.height > UNEVEN:
        lowest = min(play.footings, key=lambda footing: footing.height)
        told.append(
            f"the feet stand at different heights: {highest.frame} {1e3 * highest.height:.3g} mm above {lowest.frame}: "
            "for one floor change the posture until they are level"
        )
    return told
