"""The outcome of a simulation in sentences: the answer, and what a user should know or do."""

import math

from ..analysis.gain_limit import GainLimit
from ..errors import beside, frequency_in_words, listed, printable
from ..simulation.spec import SimulationSpec
from ..studies.oscillation import EXACT, MUJOCO
from ..studies.simulation import Outcome
from .number_format import digits, frequency, gain_factor, milli, settling

SMALLEST_ERROR = 1e-6
"""[m, rad] smaller errors are not distinguished in a sentence."""
PERIODS_SHOWN = 3
"""Of a vibration that a run must hold to show whether it lasts."""
SHOWN_BY_ALL = 10.0
"""Vibrations above it are shown by every run worth the name [Hz], where the linear loop has no frequency to compare with."""
SLOPING = math.radians(1.0)
"""A flat foot's ground that slopes by more is reported [rad]."""
UNEVEN = 1e-3
"""Feet that stand higher than others by more are reported [m]."""


TRACKING = ("RMS", "peak", "steady state", "overshoot", "settles in")
"""Titles of tracking_cells."""


def floor_of(outcome: Outcome) -> float:
    """[m, rad] smaller errors are shown as 0."""
    return 1e-9 if outcome.spec.is_exact else 1e-7


def tracking_cells(outcome: Outcome, channel: int) -> tuple[str, ...]:
    """How one channel tracks, in thousandths of its unit, percent and seconds."""
    found = outcome.tracking
    errors = (milli(float(values[channel]), floor_of(outcome)) for values in (found.rms, found.peak, found.steady_state))
    return *errors, digits(100 * float(found.overshoot[channel]), "%", 3), settling(float(found.settling_time[channel]))


def sentence(outcome: Outcome) -> str:
    """The answer in one sentence."""
    run, found = outcome.run, outcome.oscillation if outcome.vibrates else None
    at = "" if found is None else frequency_in_words(found.found.frequency)
    if not outcome.completed:
        name = printable(run.channels[outcome.leading[0]])
        text = f"{run.reason[0].upper()}{run.reason[1:]}, {name} {_size(outcome, outcome.leading[0], 'peak')} off its reference"
        text += f", vibrating at {at}" if at else ""
    elif found is not None:
        how = "irregularly, in the mean at" if found.irregular else "at"
        size = f"{1e3 * found.swing:.3g} mrad"
        text = f"Vibrates {how} {at}, {growth_text(outcome)}, mainly {printable(found.strongest[0])} by {size}"
    elif outcome.hidden:
        text = f"No lasting vibration is seen, but {_excess(outcome.limit)}: unstable; {_hiding(outcome)}"
    else:
        text = f"No vibration: {_errors(outcome)}"
    return f"{text}; {prediction(outcome.limit)}."


def growth_text(outcome: Outcome) -> str:
    """How a vibration goes on."""
    found = outcome.oscillation
    assert found is not None
    if found.moving:
        return "while it moves"
    if found.sustained:
        return "sustained"
    rate = found.found.growth_rate
    return f"{'doubling' if rate > 0 else 'halving'} every {math.log(2) / abs(rate):.3g} s"


def vibration_text(outcome: Outcome) -> tuple[str, str]:
    """Frequency and growth of what was found; of what does not count, why."""
    found = outcome.oscillation
    if found is None:
        return "none", ""
    growth = "sustained" if found.sustained else digits(found.found.growth_rate, "1/s", 3)
    growth += ", irregular" if found.irregular else ", while it moves" if found.moving else ""
    return frequency(found.found.frequency), growth if found.lasts else f"{growth}: {not_counted(outcome)}"


def limit_text(limit: GainLimit | None) -> tuple[str, str]:
    """Where the linear loop begins to vibrate: frequency, and factor on the gains of the run."""
    if limit is None:
        return "none", "the gains move nothing"
    return frequency(limit.frequency), "at all gains" if limit.gain <= 0 else f"from {gain_factor(limit.gain)} × these gains on"


def not_counted(outcome: Outcome) -> str:
    """Why a vibration that was found is none that counts."""
    found = outcome.oscillation
    assert found is not None
    if found.found.amplitude <= found.least:
        return f"too small to count, {1e3 * found.found.amplitude:.2g} of {1e3 * found.least:.2g} mrad"
    return "decays"


def _size(outcome: Outcome, channel: int, number: str) -> str:
    """A number of the tracking error, with its unit."""
    value, unit = abs(getattr(outcome.tracking, number)[channel]), f"m{outcome.run.units[channel]}"
    return f"{1e3 * value:.3g} {unit}" if value >= SMALLEST_ERROR else f"less than {1e3 * SMALLEST_ERROR:g} {unit}"


def _errors(outcome: Outcome) -> str:
    """Largest error and steady-state error of what leads, each of the channel that has it; and of the rest."""
    found, names = outcome.tracking, [printable(name) for name in outcome.run.channels]
    first, last = outcome.leading[0], outcome.worst_at_end
    text = f"{names[first]} stays within {_size(outcome, first, 'peak')} of its reference"
    if math.isnan(found.steady_state[last]):
        return text
    text += " and ends " if first == last else f", and {names[last]} ends furthest off, by "
    text += _size(outcome, last, "steady_state") + (" off" if first == last else "")
    if outcome.others and found.peak[outcome.others[0]] > MUJOCO.least:
        text += f"; {names[outcome.others[0]]}, held, deviates by {_size(outcome, outcome.others[0], 'peak')}"
    return text


def _excess(limit: GainLimit | None) -> str:
    """How far the gains are beyond what is stable."""
    if limit is not None and 0 < limit.gain < math.inf:
        return f"these gains are {beside(1 / limit.gain, 1)} times the limit"
    return "the linear loop is not stable"


def _hiding(outcome: Outcome) -> str:
    """What keeps it from being seen."""
    hiding = [name for name in outcome.effects if name in ("friction", "noise", "encoder steps", "the torque limit")]
    text = f"{listed(hiding, 'or')} may hide it, or the run is too short" if hiding else "the run is too short, or too quiet, to show it"
    return text if outcome.chattering is None else f"{text}; {_chatter(outcome, outcome.chattering)}"


def _chatter(outcome: Outcome, joint: int) -> str:
    run = outcome.run
    return f"the torque of {printable(run.joint_names[joint])} shakes by {outcome.chatter[joint]:.3g} {run.torque_units[joint]} RMS"


def prediction(limit: GainLimit | None) -> str:
    """What the linear loop says, to set against what was seen."""
    if limit is None:
        return "these gains move nothing in this state"
    if math.isnan(limit.gain):
        return f"the linear loop is {'stable' if limit.stable else 'unstable'}, how far its gains may go is not known"
    if math.isinf(limit.gain):
        return "no factor on these gains makes the linear loop vibrate"
    if limit.gain <= 0:
        return "no lower gains make the linear loop stable"
    if limit.frequency == 0:
        return f"the linear loop topples, without swinging, at {beside(limit.gain, 1)} times these gains"
    return f"the linear loop begins to vibrate at {beside(limit.gain, 1)} times these gains, at {frequency_in_words(limit.frequency)}"


def warnings(outcome: Outcome) -> tuple[str, ...]:
    """What a user should know or do, each with the remedy."""
    spec, limit, texts = outcome.spec, outcome.limit, list(outcome.spec.warnings)
    slowest = PERIODS_SHOWN / spec.duration  # [Hz] that the run can show
    fast = limit.frequency / (2 * math.pi) if limit is not None and limit.frequency > 0 else SHOWN_BY_ALL
    if outcome.completed and not outcome.vibrates and slowest > fast:
        texts.append(f"a run of {spec.duration:g} s shows no vibration below {slowest:.3g} Hz: lengthen scenario.duration")
    if outcome.completed and spec.moves_late and not spec.fastest:
        texts.append("the reference comes to rest late or not at all: lengthen scenario.duration for a steady state worth the name")
    texts += _place_warnings(spec)
    if outcome.chattering is not None and not outcome.vibrates:
        remedy = "finer encoders, a velocity filter or a lower kd damp it" if spec.encoder_step else "a lower kd damps it"
        texts.append(f"{_chatter(outcome, outcome.chattering)} beyond the frequencies of the move: {remedy}")
    texts += _verdict_warnings(outcome)
    if outcome.at_torque_limit.any():
        texts.append(_limit_warning(outcome))
    if outcome.sound and outcome.shaking > EXACT.least:
        causes = [name for name in spec.effects if name in ("noise", "encoder steps")]
        texts.append(f"no vibration lasts, but the joint shakes from {listed(causes)}: {1e3 * outcome.shaking:.3g} mrad RMS")
    if spec.kind == "linear":
        texts.append("linear run, without dry friction, gravity, torque limit or encoder steps: the scenario section of the file adds them")
    return tuple(texts)


def _verdict_warnings(outcome: Outcome) -> list[str]:
    """Where run and linear loop do not say the same."""
    if outcome.hidden:
        why = ", and without what may hide it," if outcome.effects else ""
        return [f"it may vibrate at these gains whatever this run shows: lower all gains; a longer run{why} may show it"]
    if outcome.limit is None or outcome.sound:
        return []
    if not outcome.stable:
        fell = "it vibrates before the end, as the linear loop predicts: lower all gains first, then look at what else ends the run"
        return [fell] if outcome.vibrates and outcome.run.ending == "fell" else []
    if not outcome.completed:
        return ["the linear loop is stable: it is the move, the feet or friction that end it so, not gains that are too high"]
    causes = [*outcome.effects, *([] if outcome.spec.is_exact else ["a large motion"])]
    if len(causes) == 1:
        return [f"the linear loop is stable: {causes[0]} must be what sustains this vibration, or a link that rings on by itself"]
    return [f"the linear loop is stable: {listed(causes, 'or')} must be what sustains this vibration; change one at a time"]


def _limit_warning(outcome: Outcome) -> str:
    """How often the torque limit cuts, and what passes it all the same."""
    worst = int(outcome.at_torque_limit.argmax())
    share, peak = outcome.at_torque_limit[worst], outcome.torque_peak[worst]
    whose = "" if len(outcome.torque_peak) == 1 else f" of {printable(outcome.run.joint_names[worst])}"
    beyond = f"; the current loop overshoots it to {peak:.4g} {outcome.run.torque_units[worst]}" if overshoots(outcome) else ""
    often = f"{100 * share:.2g} %" if share >= 1e-3 else "less than 0.1 %"
    return f"the torque limit cuts the demand torque{whose} {often} of the time{beyond}"


def overshoots(outcome: Outcome) -> bool:
    """The actual torque passes the limit, which cuts what the current loop is asked for, not what it makes of that."""
    return bool((outcome.torque_peak > outcome.spec.torque_limit).any())


def _place_warnings(spec: SimulationSpec) -> list[str]:
    """Of what the scenario cannot have, and of ground that is not one level floor."""
    texts = []
    if spec.immovable:
        texts.append(
            f"nothing can move {listed(spec.immovable)} in this posture and contact state: take another state, or move another task"
        )
    steepest = max((footing.slope for footing in spec.footings), default=0.0)
    if steepest > SLOPING:
        frames = listed([footing.frame for footing in spec.footings if footing.slope > steepest - SLOPING])
        texts.append(
            f"the ground slopes by {math.degrees(steepest):.3g}° under {frames}, as the contact frames do in this posture: "
            "for a level floor turn the feet until they are level"
        )
    highest = max(spec.footings, key=lambda footing: footing.height, default=None)
    if highest is not None and highest.height > UNEVEN:
        lowest = min(spec.footings, key=lambda footing: footing.height)
        texts.append(
            f"the feet stand at different heights: {highest.frame} {1e3 * highest.height:.3g} mm above {lowest.frame}: "
            "for one floor change the posture until they are level"
        )
    return texts
