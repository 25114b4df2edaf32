"""Diagnosis as text: answer, evidence for each cause, and changes or recordings advised."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import frequency_text, listed
from ..identification.clipping import limited_text
from ..identification.outliers import outliers_text
from ..identification.recorded_oscillation import POSITIONS, RecordedOscillation
from ..studies.diagnosis import AT_LIMIT, Diagnosis
from ..studies.vibration_causes import UNKNOWN, Cause, Evidence
from ..system.margin_units import to_db
from .log_text import logged_facts, logged_remarks
from .number_format import digits, hertz, motion, typed_gains
from .presentation import Part, Presentation, closing
from .words import NOT_SAFE

if TYPE_CHECKING:
    from ..files.logs import LoggedJoint

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
"""Causes in sentences, by name."""
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
"""Causes on cards, by name."""
LIKELY = 0.02
"""Likelihood below which causes are displayed on demand only."""
NOTCH_ABOVE = 2 * math.pi * 10.0  # [rad/s] without a model: slower, a notch is in the band in which the loop works
NO_MARGIN = "How much margin is left, a log without vibration does not tell: `gainroom joint FILE` does."
UNTIL_KNOWN = "Halve kp and kd before the next run."
RECORDS = {
    "motor_position": "the position (motor_position)",
    "reference": "the set-point (reference): without it a commanded oscillation looks like a vibration",
    "actual_torque": "the torque (target_torque, actual_torque): without it clipping, sticking and the joint's response are not seen",
}


def sentence(found: Diagnosis) -> str:
    """Answer of a diagnosis in two or three short sentences."""
    seen, driven, away = found.oscillation, found.search.driven, found.search.away
    if found.ran_away and not found.vibrates:
        assert away is not None
        ends = f"the log ends {motion(away.size)} off the set-point"
        return f"{NOT_SAFE}: runs away without swinging; {ends}. No cause of a vibration explains that."
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
    text = f"{NOT_SAFE}: vibrates at {frequency_text(seen.vibration.frequency)}, {growth(seen)}, by {size(seen)}. "
    if away is not None:
        text += f"It runs away: the log ends {motion(away.size)} off the set-point. "
    cause = found.cause
    if cause is not None:
        return f"{text}Cause: {NAMES[cause.name]} ({percent(cause)})."
    first, second = found.causes[:2]
    both = " or ".join(f"{NAMES[one.name]} ({percent(one)})" for one in (first, second) if one.name != UNKNOWN)
    return f"{text}Its cause is not known; the likeliest: {both}."


def _band(found: Diagnosis) -> str:
    """Frequency band of the excitation in the torque, as text."""
    assert found.search.excited is not None
    return " to ".join(frequency_text(omega) for omega in found.search.excited)


def size(seen: RecordedOscillation) -> str:
    """Amplitude at the end, in the unit of its channel."""
    value = seen.vibration.amplitude
    if seen.side not in POSITIONS:
        return digits(value, "rad/s" if "velocity" in seen.side else "N·m", 3)
    return motion(value)


def growth(seen: RecordedOscillation) -> str:
    """State of an oscillation: sustained, or its doubling or halving time."""
    if seen.state == "sustained":
        return "sustained, without a single frequency" if seen.irregular else "sustained"
    rate = seen.vibration.growth_rate
    return f"{seen.state}, {'doubling' if rate > 0 else 'halving'} every {digits(math.log(2) / abs(rate), 's', 2)}"


def percent(cause: Cause) -> str:
    """Likelihood of a cause in percent."""
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
"""Sentences on evidence, by its name."""


def evidence_text(one: Evidence) -> str:
    """Sentence on one observation, with its measured and expected values."""
    return TEXTS[one.name](one)


def strength(one: Evidence) -> str:
    """Sign and strength of one observation, for or against a cause."""
    return ("+" if one.weight > 0 else "−") * min(4, max(1, round(abs(one.weight))))


def ranked(found: Diagnosis, everything: bool = True) -> list[Cause]:
    """Displayed causes, the likeliest first: all with evidence, or the likely ones."""
    shown = [one for one in found.causes if one.name != UNKNOWN and (one.evidence or one.likelihood >= LIKELY)]
    return shown if everything else [one for index, one in enumerate(shown) if index == 0 or one.likelihood >= LIKELY]


def evidence_lines(found: Diagnosis, everything: bool) -> list[str]:
    """Lines with each cause and its evidence, for (+) and against (−), the strongest first."""
    lines = []
    for cause in ranked(found, everything):
        lines.append(f"{NAMES[cause.name][0].upper()}{NAMES[cause.name][1:]}: {percent(cause)}")
        strongest = sorted(cause.evidence, key=lambda one: -abs(one.weight))
        lines += [] if strongest else ["  nothing in the log speaks for or against it"]
        lines += [f"  {strength(one):4}  {evidence_text(one)}" for one in strongest]
    left = len(ranked(found)) - len(ranked(found, everything))
    return [*lines, f"{left} causes of less than {100 * LIKELY:.0f} % (--verbose)"] if left else lines


def warnings(found: Diagnosis) -> list[str]:
    """Limitations of the answer."""
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
"""Causes under which torque and position at the observed frequency do not follow the joint's controller."""
SCALED = (*AT_LIMIT, "quantisation")
"""Causes that a factor on all gains removes, by the model."""


def advice(found: Diagnosis) -> list[str]:
    """Sentences of advice: changes that end the vibration, each with its size, or signals to record until its cause is known."""
    if found.ran_away and not found.vibrates:
        return [
            "Look at the signs of position, torque and gains, at the units of kp and kd, and at what the joint ran into or was pushed by."
        ]
    if not found.vibrates:
        return [f"Record {RECORDS['reference']}." if found.search.unasked > 0 else NO_MARGIN]
    cause = found.cause
    return [*(_remedies(found, cause) if cause is not None else [UNTIL_KNOWN]), *_to_record(found)]


def _remedies(found: Diagnosis, cause: Cause) -> list[str]:
    seen, predicted, factor = found.oscillation, found.predicted, found.factor
    assert seen is not None
    margin = f"{digits(to_db(found.required), 'dB', 3)} of gain margin"
    lower = f"multiply all gains of the log by {digits(factor, '', 2)} to have {margin}" if factor < 1 else ""
    if cause.name in AT_LIMIT:
        alias = predicted.alias if predicted is not None and cause.name == "aliasing" else None
        folded = [] if alias is None else [f"It vibrates at about {hertz(alias.frequency)}: log every tick of the controller to see it."]
        use = found.recommended
        texts = [f"Lower the gains: {lower}." if lower else "Lower kp and kd together; how far is not known without --joint joint.yaml."]
        if use is not None:
            at_once = f" At once, without them: {lower} alone." if lower else ""
            texts = [f"Use {typed_gains(use.controller)}, which meet the requirements of the file.{at_once}"]
        if seen.clipped > 0.05:
            texts.append("The torque limit only bounds the amplitude; raising it makes the vibration larger.")
        if predicted is not None and predicted.limit.gain > 1:
            texts.append("The model says that these gains are still stable: identify the joint and its delay again (gainroom identify).")
        return texts + folded
    if cause.name == "quantisation":
        remedy = f"Lower the gain on velocity: {lower}" if lower else "Lower kd"
        return [f"{remedy}; or filter the velocity (velocity_filter), or use the finer encoder. Lowering kp alone does not help."]
    if cause.name == "stick_slip":
        texts = ["Compensate the friction by a feed-forward torque, or lower ki, or let the integral rest once the error is small."]
        if predicted is not None and predicted.limit.gain > 2 * found.required:
            most = digits(predicted.limit.gain / found.required, "", 3)
            texts.append(f"On a slow move more kd and kp help: the model allows {most} × these gains with {margin}.")
        return texts
    if cause.name == "saturation":
        texts = ["Bound the integral while the torque is at its limit (anti-windup), lower ki, or take smaller or slower steps."]
        if predicted is not None and 0 < predicted.limit.lower_gain < 1:
            least = digits(predicted.limit.lower_gain, "", 2)
            texts.append(f"By the model the loop is unstable once clipping leaves less than {least} of its gain.")
        return texts
    return OTHER_REMEDIES.get(cause.name, _structural)(found, seen)


def _structural(found: Diagnosis, seen: RecordedOscillation) -> list[str]:
    predicted, omega = found.predicted, seen.vibration.frequency
    crossover = predicted.crossover if predicted is not None and predicted.crossover > 0 else NOTCH_ABOVE / 2
    notch = "; or put a notch there" if omega > 2 * crossover else ""  # nearer, it takes the phase that the loop lives on
    texts = [f"Find what swings at {hertz(omega)} (mounting, link, cable, tool) and stiffen or damp it{notch}."]
    if seen.state == "decaying":
        return [*texts, "It decays by itself: the gains do not drive it, and lowering them does not end it."]
    return [
        *texts,
        "Lower gains stop the loop from driving it. The model does not have it and cannot say how far: halve them, and record again.",
    ]


def _external(found: Diagnosis, seen: RecordedOscillation) -> list[str]:
    return [
        f"Find what pushes at {hertz(seen.vibration.frequency)} (a gait, a person, a machine, another joint). The loop is stable: lower "
        "gains make the motion larger, and no filter or notch ends it.",
        "A feed-forward torque for what is known of it, or stiffer gains within the margin, make it smaller.",
    ]


def _ripple(found: Diagnosis, seen: RecordedOscillation) -> list[str]:
    order = seen.turning.order if seen.turning is not None else math.nan
    ratio = found.predicted.order if found.predicted is not None else math.nan
    of_motor = f", {digits(ratio, '', 3)} per turn of the motor" if ratio == ratio else ""
    return [
        f"It comes with the turning: {digits(2 * math.pi * order, '', 3)} periods per turn of the joint{of_motor}. Compensate it "
        "by a table over the motor's angle (cogging, current offsets), or look at gear and bearings. The loop is stable: lower gains "
        "make it larger.",
        "A notch does not help: the frequency goes with the speed.",
    ]


def _backlash(found: Diagnosis, seen: RecordedOscillation) -> list[str]:
    return [
        "Take up the gap: preload the gear, or replace what is worn. gainroom identify joint measures it on a log with excitation.",
        "Until then lower kd and kp: with the link loose the motor alone is the load, which takes less gain. A notch does not help, as the "
        "frequency goes with the amplitude.",
    ]


def _outer(found: Diagnosis, seen: RecordedOscillation) -> list[str]:
    return [
        f"Look at what makes the set-point (policy, admittance, planner): at {hertz(seen.vibration.frequency)} it answers the joint's own "
        "motion, too late or too strongly. Lower its gain, or its delay; kp and kd of the joint are not the cause.",
    ]


OTHER_REMEDIES: dict[str, Callable[[Diagnosis, RecordedOscillation], list[str]]] = {
    "external_torque": _external,
    "torque_ripple": _ripple,
    "backlash": _backlash,
    "outer_loop": _outer,
}
"""Functions that give the remedies of a cause, by its name."""


def _to_record(found: Diagnosis) -> list[str]:
    """Sentences that ask for recordings that would distinguish the possible causes; none if the cause is known."""
    if found.cause is not None:
        return []
    texts = [f"Record {RECORDS[name]}." for name in found.missing]
    if found.system is None:
        texts.append(
            "Give the joint's file (--joint joint.yaml): a loop at its limit and a structural resonance look alike without a model."
        )
    elif not texts:
        texts.append(
            "Record again with all gains halved: a loop at its limit is then quiet, a structural resonance rings at the same frequency."
        )
    return texts


@dataclass(frozen=True)
class DiagnosisPresentation(Presentation):
    """Presentation of a diagnosis; `log`: name of the log."""

    found: Diagnosis
    logged: "LoggedJoint"
    log: str

    def facts(self) -> dict[str, Any]:
        found, seen, predicted = self.found, self.found.oscillation, self.found.predicted
        return {
            **found.verdict.facts,
            "sentence": sentence(found),
            "vibrates": found.vibrates,
            "ran_away": found.ran_away,
            "vibration": None
            if seen is None or found.toggles
            else {
                "frequency_rad_s": seen.vibration.frequency,
                "growth_rate": seen.vibration.growth_rate,
                "state": seen.state,
                "amplitude": seen.vibration.amplitude,
                "channel": seen.side,
                "encoder_step": seen.step,
                "clipped": seen.clipped,
                "standing": seen.standing,
                "odd_harmonics": seen.odd,
                "even_harmonics": seen.even,
                "irregular": seen.irregular,
                "from": float(found.record.time[seen.rows][0]),
                "to": float(found.record.time[seen.rows][-1]),
            },
            "excitation_rad_s": None if found.search.excited is None else list(found.search.excited),
            "cause": None if found.cause is None else found.cause.name,
            "causes": [
                {
                    "cause": one.name,
                    "likelihood": one.likelihood,
                    "evidence": [vars(each) | {"text": evidence_text(each)} for each in one.evidence],
                }
                for one in found.causes
            ],
            "predicted": None
            if predicted is None
            else {
                "stable": predicted.limit.stable,
                "gain_limit": predicted.limit.gain,
                "frequency_rad_s": predicted.frequency,
                "growth_rate": predicted.growth,
            },
            "gain_factor": found.factor if found.vibrates and found.cause is not None and found.cause.name in SCALED else None,
            "advice": advice(found),
            "warnings": [*warnings(found), *logged_remarks(self.logged)],
            "log": logged_facts(self.logged),
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        evidence = evidence_lines(self.found, everything=verbose)
        yield [
            sentence(self.found),
            *(f"→ {text}" for text in advice(self.found)),
            *(["", *evidence] if evidence else []),
            *([""] if self.files.get("Report") else []),
            *closing(self.files, warnings(self.found), notes=logged_remarks(self.logged)),
        ]
