"""What to change against a vibration, by how much, or what to record to learn its cause."""

import math
from collections.abc import Callable

from ..identification.recorded_oscillation import RecordedOscillation
from ..studies.diagnosis import AT_LIMIT, Diagnosis
from ..studies.vibration_causes import Cause
from ..system.margin_units import to_db
from .number_format import digits, hertz, typed_gains

NOTCH_ABOVE = 2 * math.pi * 10.0  # [rad/s] without a model: slower, a notch is in the band in which the loop works
NO_MARGIN = "How much margin is left, a log without vibration does not tell: `gainroom joint FILE` does."
UNTIL_KNOWN = "Halve kp and kd before the next run."
RECORDS = {
    "motor_position": "the position (motor_position)",
    "reference": "the set-point (reference): without it a commanded oscillation looks like a vibration",
    "actual_torque": "the torque (target_torque, actual_torque): without it clipping, sticking and the joint's response are not seen",
}


def advice(found: Diagnosis) -> list[str]:
    """What to change and by how much, or what to record."""
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
"""By cause."""


def _to_record(found: Diagnosis) -> list[str]:
    """What would show the cause, where it is not known."""
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
