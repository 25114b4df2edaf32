"""What vibrates a joint, as text: the answer, the evidence for each cause, and what to change or to record."""

import math
from collections.abc import Callable

from ..errors import frequency_text, listed
from ..identification.clipping import limited_text
from ..identification.outliers import outliers_text
from ..identification.recorded_oscillation import POSITIONS, RecordedOscillation
from ..studies.diagnosis import Diagnosis
from ..studies.vibration_causes import UNKNOWN, Cause, Evidence
from ..system.margin_units import to_db
from .number_format import digits, hertz, motion

NAMES = {
    "gain_limit": "the loop is at its gain limit",
    "stick_slip": "a stick-slip limit cycle of friction",
    "quantisation": "encoder steps or velocity noise",
    "structural_resonance": "a structural resonance that is not in the model",
    "saturation": "torque saturation",
    "external_torque": "a torque from outside, as of a gait or a load",
    "torque_ripple": "torque ripple, cogging or teeth, which come with the turning",
    "backlash": "backlash in the gear",
    "aliasing": "the loop is at its gain limit, and the log shows it at another frequency (aliasing)",
    "outer_loop": "an outer loop: the set-point swings, and is made of the position",
    UNKNOWN: "none of these",
}
"""Causes as they stand in a sentence."""
SHORT = {
    "gain_limit": "gain limit",
    "stick_slip": "stick-slip",
    "quantisation": "encoder steps",
    "structural_resonance": "resonance",
    "saturation": "saturation",
    "external_torque": "external torque",
    "torque_ripple": "torque ripple",
    "backlash": "backlash",
    "aliasing": "aliasing",
    "outer_loop": "outer loop",
}
"""As they stand on a card."""
LIKELY = 0.02
"""Causes of less are shown on demand."""


def sentence(found: Diagnosis) -> str:
    """The answer in two or three short sentences."""
    seen, driven, away = found.oscillation, found.search.driven, found.search.away
    if found.ran_away and not found.vibrates:
        assert away is not None
        return f"Runs away without swinging: the log ends {motion(away.size)} off the set-point. No cause of a vibration explains that."
    if not found.vibrates:
        text = "No vibration."
        if found.toggles and seen is not None:
            text += f" The encoder goes to and fro between two steps at {frequency_text(seen.vibration.frequency)}; the joint hardly moves."
        elif seen is not None:
            text += f" An oscillation at {frequency_text(seen.vibration.frequency)} decays, with a damping ratio of"
            text += f" {digits(seen.vibration.damping_ratio, '', 2)}."
        elif found.search.excited is not None:
            text += f" The joint follows an excitation in target_torque, mainly from {_band(found)}."
        elif found.search.unasked > 0:
            text = f"No vibration is seen, but the set-point is not in the log: the joint swings at {frequency_text(driven)}, by"
            text += f" {motion(found.search.unasked)}, slowly or at a frequency that changes, as commands make joints move."
        elif driven == driven and driven > 0:
            text += f" The joint follows its set-point, whose largest part is at {frequency_text(driven)}."
        return text
    assert seen is not None
    text = f"Vibrates at {frequency_text(seen.vibration.frequency)}, {growth(seen)}, by {size(seen)}. "
    if away is not None:
        text += f"It runs away: the log ends {motion(away.size)} off the set-point. "
    cause = found.cause
    if cause is not None:
        return f"{text}Cause: {NAMES[cause.name]} ({percent(cause)})."
    first, second = found.causes[:2]
    both = " or ".join(f"{NAMES[one.name]} ({percent(one)})" for one in (first, second) if one.name != UNKNOWN)
    return f"{text}Its cause is not known; the likeliest: {both}."


def _band(found: Diagnosis) -> str:
    """Of the excitation in the torque."""
    assert found.search.excited is not None
    return " to ".join(frequency_text(omega) for omega in found.search.excited)


def size(seen: RecordedOscillation) -> str:
    """The amplitude at the end, in the unit of its channel."""
    value = seen.vibration.amplitude
    if seen.side not in POSITIONS:
        return digits(value, "rad/s" if "velocity" in seen.side else "N·m", 3)
    return motion(value)


def growth(seen: RecordedOscillation) -> str:
    """Whether it is sustained, or its doubling or halving time."""
    if seen.state == "sustained":
        return "sustained, without a single frequency" if seen.irregular else "sustained"
    rate = seen.vibration.growth_rate
    return f"{seen.state}, {'doubling' if rate > 0 else 'halving'} every {digits(math.log(2) / abs(rate), 's', 2)}"


def percent(cause: Cause) -> str:
    """Its likelihood."""
    share = 100 * cause.likelihood
    return f"{'more than 99' if share > 99 else 'less than 1' if share < 1 else f'{share:.0f}'} % likely"


def _hz(evidence: Evidence) -> tuple[str, str]:
    return hertz(evidence.value), hertz(evidence.expected)


TEXTS: dict[str, Callable[[Evidence], str]] = {
    "frequency": lambda one: "at {}; the model's loop vibrates at {}".format(*_hz(one)),
    "gain_margin": lambda one: f"gain margin by the model {digits(one.value, '', 3)} ({digits(to_db(one.value), 'dB', 3)})",
    "response": lambda one: (
        f"position over torque is {digits(math.exp(one.value), '', 3)} × off the model's, in amplitude and phase together"
        if one.value > 0.25
        else "position over torque is as in the model"
    ),
    "steps": lambda one: (
        "the amplitude is far beyond the encoder's steps"
        if math.isinf(one.value)
        else f"amplitude of {digits(one.value, '', 3)} steps of the encoder"
    ),
    "standing": lambda one: (
        "no position to see whether the joint stands still"
        if math.isnan(one.value)
        else f"stands still {100 * one.value:.0f} % of each period"
    ),
    "crossover": lambda one: "at {}; the loop's crossover is at {}".format(*_hz(one)),
    "clipped": lambda one: (
        "no torque to see whether it is clipped" if math.isnan(one.value) else f"torque at its limit {100 * one.value:.0f} % of the time"
    ),
    "grew_unclipped": lambda one: "it grew before the torque came to its limit",
    "lower_frequency": lambda one: "at {}; clipped, the model's loop vibrates at {} or slower".format(*_hz(one)),
    "lower_gain": lambda one: "by the model no lower gain, as clipping makes it, is unstable",
    "irregular": lambda one: "without a single frequency, as noise and steps are",
    "growth": lambda one: "it grows or decays" if one.weight < 0 and one.expected == 0 else "its amplitude neither grows nor decays",
    "rings": lambda one: (
        f"rings with a damping ratio of {digits(one.value, '', 2)}; in the model nothing rings with less than {digits(one.expected, '', 2)}"
    ),
    "power": lambda one: (
        "the controller brakes the motion, and does not drive it"
        if one.value < 0
        else "the controller drives the motion, and does not brake it"
    ),
    "unstable": lambda one: f"it grows, where the loop of the model is stable by a factor of {digits(one.value, '', 3)}",
    "odd_harmonics": lambda one: (
        f"odd harmonics of {digits(100 * one.value, '%', 2)} and hardly any even ones"
        if one.weight > 0
        else "no harmonics, which a gap would make"
    ),
    "integral": lambda one: "the set-point rests and the controller has no integral: nothing builds up torque",
    "answers": lambda one: "the set-point swings as a law of the measured position" if one.value else "the set-point follows no position",
    "turning": lambda one: (
        "the joint does not turn steadily"
        if math.isnan(one.value)
        else "its frequency does not go with the speed"
        if math.isnan(one.expected)
        else f"frequency and speed go together: {digits(2 * math.pi * one.value, '', 3)} periods per turn of the joint"
    ),
    "whole_order": lambda one: f"{digits(one.value, '', 4)} periods per turn of the motor, at one speed",
    "softened": lambda one: (
        f"position over torque is that of a gear with {100 * one.value:.0f} % of its stiffness, as a gap leaves it"
        if one.weight > 0
        else "position over torque is not that of a spring behind a gap"
    ),
    "alias": lambda one: (
        "the loop is no faster than the log"
        if math.isnan(one.value)
        else f"the log's rate also shows {hertz(one.value)} there; the model's loop vibrates at {hertz(one.expected)}"
    ),
    "alias_response": lambda one: (
        f"position over torque at that frequency is {digits(math.exp(one.value), '', 3)} × off the model's"
        if one.value > 0.25
        else "position over torque at that frequency is as in the model"
    ),
}
"""By name of an evidence."""


def evidence_text(one: Evidence) -> str:
    """With what was measured and expected."""
    return TEXTS[one.name](one)


def strength(one: Evidence) -> str:
    """For or against."""
    return ("+" if one.weight > 0 else "−") * min(4, max(1, round(abs(one.weight))))


def ranked(found: Diagnosis, everything: bool = True) -> list[Cause]:
    """The causes that are shown, the likeliest first: all that there is evidence for or against, or the likely ones."""
    shown = [one for one in found.causes if one.name != UNKNOWN and (one.evidence or one.likelihood >= LIKELY)]
    return shown if everything else [one for index, one in enumerate(shown) if index == 0 or one.likelihood >= LIKELY]


def evidence_lines(found: Diagnosis, everything: bool) -> list[str]:
    """Each cause and under it what speaks for it (+) and against it (−), the strongest first."""
    lines = []
    for cause in ranked(found, everything):
        lines.append(f"{NAMES[cause.name][0].upper()}{NAMES[cause.name][1:]}: {percent(cause)}")
        strongest = sorted(cause.evidence, key=lambda one: -abs(one.weight))
        lines += [] if strongest else ["  nothing in the log speaks for or against it"]
        lines += [f"  {strength(one):4}  {evidence_text(one)}" for one in strongest]
    left = len(ranked(found)) - len(ranked(found, everything))
    return [*lines, f"{left} causes of less than {100 * LIKELY:.0f} % (--verbose)"] if left else lines


def warnings(found: Diagnosis) -> list[str]:
    """What limits the answer."""
    texts = outliers_text(found.outliers, found.record.time)
    if "reference" in found.missing:
        texts.append("without the set-point (reference) a commanded oscillation cannot be distinguished from a vibration")
    if found.search.blind > 0:
        texts.append(f"the set-point moves all the time: below {hertz(found.search.blind)} it may hide a vibration")
    if found.search.excited is not None:
        texts.append(f"from {_band(found)} the excitation may hide a vibration: record without it to see one there")
    predicted, seen = found.predicted, found.oscillation
    if predicted is not None and predicted.limited is not None and found.vibrates:
        texts += limited_text(predicted.limited, "tell no gains and are left out where gains are compared")
    if predicted is not None and predicted.applied != 1:
        texts.append(f"the gains in the log are {digits(predicted.applied, '', 3)} times those of the file; the model here has them")
    compared = found.vibrates and seen is not None and not seen.irregular and not (found.cause and found.cause.name in OTHER_LAW)
    if predicted is not None and compared and abs(_log(predicted.control)) > 0.3:
        texts.append("the controller in the log is not that of the file: compare with gainroom identify gains")
    if not found.vibrates and predicted is not None and not predicted.limit.stable:
        texts.append("by the model these gains are unstable, though this log does not show it: check the file's gains and delay")
    if found.missing and found.vibrates:
        texts.append(f"the log lacks {listed([*found.missing])}")
    return texts


def _log(value: complex) -> float:
    return math.log(abs(value)) if value == value and abs(value) > 0 else 0.0


OTHER_LAW = ("aliasing", "outer_loop")
"""Causes with which torque and position at the frequency seen are not those of the joint's controller."""
