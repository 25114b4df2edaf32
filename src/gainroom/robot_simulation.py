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
from .robot.body import is_slide
from .robot.ground import Footing, footings
from .robot.patterns import select
from .robot_spec import RobotSpec
from .robot_states import STRONG, strongest_first
from .robot_study import limit_of, moves
from .robot_vibration import NOTICED, Heard, chatter, in_words, listen, shows
from .robot_words import listed
from .simulation.oscillation import Vibration
from .simulation.response import Tracking, track
from .simulation.robot_result import RobotRun, joined_runs
from .simulation.robot_run import stream_robot
from .simulation.robot_setup import RobotSetup, Unit, channel_units, hold, robot_setup
from .simulation.trajectories import Spline
from .simulation_spec import refuse_long_run
from .simulation_study import NOTICED as STEPS
from .simulation_study import Interrupted, frequency_in_words, prediction_in_words

if TYPE_CHECKING:
    from .robot.model import RobotModel

MOST_TICKS = 200_000
"""Of one run, which is kept whole: 100 s at 2 kHz."""
SMALL = 0.01
"""[m, rad] of a move where none is given."""
CHATTER = 0.1
"""Of a joint's torque peak: torque beyond the reference's frequencies that is told, RMS."""
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
    heard         the vibration that lasts, after the move or while it moves, else the one that dies away; None where nothing rings
    chatter       (n,) RMS of the actual torque beyond the reference's frequencies [N m]
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
    heard: Heard | None
    chatter: Floats
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
    def vibration(self) -> Vibration | None:
        """What was heard, also what dies away or is too small to count."""
        return None if self.heard is None else self.heard.found

    @property
    def parts(self) -> Complexes | None:
        """(n,) complex: the motors' parts in that vibration, the largest 1; None without one."""
        return None if self.heard is None else self.heard.parts

    @property
    def vibrates(self) -> bool:
        """So that anyone would see it, by more than encoders' steps make, and not dying away."""
        return self.heard is not None and shows(self.heard, self.run.setup.encoder_step, self.linear)

    @property
    def stable(self) -> bool:
        """What the linear loop says at these gains; True where they move nothing."""
        return self.limit is None or self.limit.stable

    @property
    def sound(self) -> bool:
        """It stayed up, does not vibrate, and the linear loop is stable."""
        return self.completed and not self.vibrates and self.stable

    @cached_property
    def chattering(self) -> int | None:
        """The joint whose torque shakes most, where that is much of it."""
        worst = int(np.argmax(self.chatter))
        return worst if self.completed and self.chatter[worst] > CHATTER * self.torque_peak[worst] else None

    @property
    def hiding(self) -> tuple[str, ...]:
        """What the file has that can keep an unstable loop from vibrating."""
        setup = self.run.setup
        found = {
            "friction": np.any(setup.coulomb),
            "the torque limit": np.any(np.isfinite(setup.torque_limit)),
            "encoder steps": setup.encoder_step > 0,
        }
        return tuple(name for name, there in found.items() if there)

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

    @property
    def left_most(self) -> int:
        """Of those, the one whose steady-state error is the largest; the first where there is no steady state."""
        return max(self.leading, key=lambda k: np.nan_to_num(abs(self.tracking.steady_state[k])))

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


def uncounted(play: RobotPlay) -> str:
    """Why what was heard is no vibration that counts."""
    found = play.vibration
    assert found is not None
    size = max(NOTICED, STEPS * play.run.setup.encoder_step)
    if found.amplitude <= size:
        return f"too small to count, {1e3 * found.amplitude:.2g} of {1e3 * size:.2g} mrad"
    return "dies away"


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
    run, shakes = play.run, play.heard if play.vibrates else None
    at = "" if shakes is None else frequency_in_words(shakes.found.frequency)
    if not play.completed:
        name = printable(run.channels[play.leading[0]])
        text = f"{run.reason[0].upper()}{run.reason[1:]}, {name} {_size(play, play.leading[0], play.tracking.peak)} off its reference"
        text += f", vibrating at {at}" if at else ""
    elif shakes is not None:
        most = printable(run.joint_names[play.parts_strongest_first()[0]])
        text = f"Vibrates at {at}, {in_words(shakes, play.linear)}, {most} most of all by {1e3 * shakes.swing:.3g} mrad"
    elif not play.stable:
        text = _hidden(play)
    else:
        text = f"Does not vibrate: {_errors(play)}"
    predicted = "these gains move nothing in this state" if play.limit is None else prediction_in_words(play.limit)
    return f"{text}; {predicted}."


def _size(play: RobotPlay, channel: int, values: Floats) -> str:
    """Of an error, with its unit."""
    value, unit = abs(values[channel]), f"m{play.units[channel]}"
    return f"{1e3 * value:.3g} {unit}" if value >= SEEN else f"less than {1e3 * SEEN:g} {unit}"


def _errors(play: RobotPlay) -> str:
    """Largest error and steady-state error of what leads, each of the channel that has it; and of the rest."""
    found, names = play.tracking, [printable(name) for name in play.run.channels]
    first, last = play.leading[0], play.left_most
    text = f"{names[first]} stays within {_size(play, first, found.peak)} of its reference"
    text += " and ends " if first == last else f", and {names[last]} ends furthest off, by "
    text += _size(play, last, found.steady_state) + (" off" if first == last else "")
    if play.others and found.peak[play.others[0]] > NOTICED:
        text += f", {names[play.others[0]]}, held, strays by {_size(play, play.others[0], found.peak)}"
    return text


def _hidden(play: RobotPlay) -> str:
    """Of a run that shows no vibration although the linear loop is unstable."""
    limit = play.limit
    assert limit is not None
    times = f", {1 / limit.gain:.3g} times the limit" if 0 < limit.gain < 1 else ""
    why = (
        f"{listed(play.hiding)} {'hides' if len(play.hiding) == 1 else 'can hide'} it"
        if play.hiding
        else "the run may be too short to show it"
    )
    text = f"No lasting vibration is seen, but the linear loop is unstable at these gains{times}: {why}"
    if play.chattering is not None:
        text += f", and {_shaking(play, play.chattering)}"
    return text


def _shaking(play: RobotPlay, joint: int) -> str:
    unit = "N·m" if not is_slide(play.run.setup.body.joints[joint]) else "N"
    return f"the torque of {printable(play.run.joint_names[joint])} shakes by {play.chatter[joint]:.3g} {unit} RMS"


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
    if play.chattering is not None and not play.vibrates:
        remedy = "finer encoders, a velocity filter or a lower kd calm it" if play.run.setup.encoder_step else "a lower kd calms it"
        told.append(f"{_shaking(play, play.chattering)} beyond the frequencies of the move: {remedy}")
    if limit is None:
        return told
    if limit.stable and not play.completed:
        told.append("the linear loop is stable: it is the move, the feet or friction that end it so, not gains that are too high")
    elif limit.stable and not play.sound:
        told.append("the linear loop is stable: ground, friction or a large motion keep this up; take one away at a time")
    if not limit.stable and play.vibrates and not play.completed:
        told.append("it vibrates before the end, as the linear loop predicts: lower all gains first, then look at what else ends the run")
    if not limit.stable and play.completed and not play.vibrates:
        told.append("a robot may vibrate at these gains whatever this run shows: lower all gains, or shorten the delay")
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
