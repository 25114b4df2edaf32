"""A robot's played scenario in words: one sentence, and what a user should know or do."""

import math

from ..errors import frequency_in_words, listed, printable
from ..linear.arrays import Floats
from ..simulation.spec import LATE, PERIODS
from .joint_simulation import prediction_in_words
from .robot_outcome import RobotPlay
from .robot_vibration import ENCODER_STEPS, NOTICED, in_words

SEEN = 1e-6
"""[m, rad] smaller errors are not told in the sentence."""
TINY = 1e-7
"""[m, rad] smaller errors are shown as 0."""
SLOPING = math.radians(1.0)
"""A flat foot's ground that slopes by more is told [rad]."""
SLOW = 10.0
"""Vibrations above it are shown by every run worth the name [Hz]; a shorter one is told."""
UNEVEN = 1e-3
"""Feet that stand higher than others by more are told [m]."""


def sentence(play: RobotPlay) -> str:
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
    return f"the torque of {printable(play.run.joint_names[joint])} shakes by {play.chatter[joint]:.3g} {play.torque_units[joint]} RMS"


def warnings(play: RobotPlay) -> list[str]:
    """What a user should know or do, each with the remedy."""
    told, limit = [], play.limit
    slowest = PERIODS / play.spec.scenario.duration
    if play.completed and not play.vibrates and slowest > SLOW:
        told.append(f"a run of {play.spec.scenario.duration:g} s shows no vibration below {slowest:.3g} Hz: lengthen scenario.duration")
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


def uncounted(play: RobotPlay) -> str:
    """Why what was heard is no vibration that counts."""
    found = play.vibration
    assert found is not None
    size = max(NOTICED, ENCODER_STEPS * play.run.setup.encoder_step)
    if found.amplitude <= size:
        return f"too small to count, {1e3 * found.amplitude:.2g} of {1e3 * size:.2g} mrad"
    return "dies away"
