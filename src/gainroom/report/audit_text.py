"""The result of an audit in sentences: the verdict, why, and warnings with remedies."""

import math

import numpy as np

from ..analysis.margin_record import PathMargins
from ..errors import apart, at_frequency, beside, listed
from ..studies.audit import Audit
from ..studies.deciding_joints import joints_that_miss
from ..studies.factors import typed_factor
from ..studies.state import HELD
from ..system.margin_units import to_db
from ..system.plausibility import doubts_first
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS
from .gearboxes import over_range, worst_gearboxes
from .margin_columns import margin_value
from .number_format import digits
from .robot_text import free_joints, unconfirmed
from .words import UNSTABLE, headline, unsafe_joints

PEAK = REQUIREMENTS["peak_sensitivity"]
SLIGHT = 0.05
"""Damping ratio of a motor on its spring proposed as a first guess where none is given."""


def audit_sentence(result: Audit) -> str:
    """Verdict and reason, in one text."""
    return f"{verdict(result)} {reason(result)}"


def verdict(result: Audit) -> str:
    """Whether the gains are safe, and what fails first, where, and in which joints. No number in it is one to use."""
    over, unsafe = over_range(result), sum(not joint.safe for joint in result.joints)
    if result.doubts:
        return headline(result)
    readings = _readings(result) if result.readings else ""
    if result.open:
        return headline(result, over, readings)
    if result.stable or result.verdict.level != "unsafe":
        text = headline(result, over)
    else:
        text = f"{UNSTABLE}{over} with {_given(result)} of delay{_mainly(result)}."
    return " ".join(filter(None, [text, unsafe_joints(unsafe, len(result.joints)) if unsafe and not result.sway_is_open else "", readings]))


def _readings(result: Audit) -> str:
    """The flag that nobody gave, and what each of its values means and gives."""
    flag = result.readings[0].option.split()[0]
    each = [f"{one.option.removeprefix(flag).strip()} ({one.meaning}): {_unsafe(one.audit)}" for one in result.readings]
    return f"{flag} is not given: {'; '.join(each)}."


def _unsafe(found: Audit) -> str:
    """How many joints are not safe, and where vibration starts."""
    limit = found.tightest.limit
    start = "nothing makes it vibrate" if math.isinf(limit.gain) else f"vibration starts at {digits(limit.gain, '×', 4)} these gains"
    joints = unsafe_joints(sum(not joint.safe for joint in found.joints), len(found.joints)).rstrip(".")
    joints = f"{joints[0].lower()}{joints[1:]}"
    return f"{joints}, {start if limit.gain > 0 else 'no lower gains are stable'}"


def _given(result: Audit) -> str:
    return digits(1e3 * result.system.delay, "ms", 3)


def _mainly(result: Audit) -> str:
    """Where, and in which joints: an audit has one posture."""
    short = sum(not result.enough_in(state) for state in result.states)
    every = f" in {'both' if short == 2 else f'all {short}'} states, worst" if short == len(result.states) else ""
    where = f"{every} in {result.tightest.contact}" if len(result.states) > 1 else ""
    return where + (f", mainly {listed(result.limiting_joints, most=2)}" if result.limiting_joints else "")


def reason(result: Audit) -> str:
    """At which factor and at which delay these gains vibrate: limits, which leave no margin."""
    worst, where = result.tightest, f"{_read_as(result)}{worst_gearboxes(result)}"
    limit, delay = worst.limit, "The delay limit is not known."
    if math.isfinite(result.delay_limit):
        least = apart(result.delay_limit, result.system.delay, 3)
        delay = f"With these gains vibration starts at {1e3 * result.delay_limit:.{least}g} ms of delay (given: {_given(result)})."
        delay = "These gains are unstable without delay, too." if result.delay_limit == 0 else delay
    elif math.isinf(result.delay_limit):
        delay = "No delay makes these gains vibrate."
    if not limit.stable:
        lost = (
            f"The present ones stop vibrating only below {digits(limit.gain, '×', 3)}, where no margin is left."
            if limit.gain > 0
            else _no_lower_gains(result)
        )
        lost = "Whether lower gains are stable is not known." if math.isnan(limit.gain) else lost
        return f"{where} {lost} {delay}".strip()
    if any(math.isnan(state.limit.gain) for state in result.states):
        return f"{where} {delay}".strip()
    about = f"{at_frequency(limit.frequency, ', at ')}{_mainly(result)}" if all(map(result.enough_together_in, result.states)) else ""
    factors, levels = (limit.gain, result.margin), (to_db(limit.gain), to_db(result.margin))
    factor, level = (f"{pair[0]:.3g}" if result.enough_together_in(worst) else beside(*pair) for pair in (factors, levels))
    factor = factor if factor != "1" else beside(limit.gain, 1.0)
    start = f"Vibration starts at {factor} × these gains ({level} dB){about}"
    start = "No common factor up to 1000 on all gains makes it vibrate" if math.isinf(limit.gain) else start
    if worst.margins.paths is not None and worst.margins.paths.headroom < limit.gain:
        start = _weakest_path(worst.margins.paths)
    return f"{where} {start}. {delay}".strip()


def _read_as(result: Audit) -> str:
    """Of which reading all numbers are, where there are some."""
    return next((f" With {one.option}:" for one in result.readings if one.audit.every is result.every), "")


def besides(result: Audit) -> list[str]:
    """What there is too little of besides the gain margin, each beside what is required, and where."""
    parts = []
    for one, needed in result.required.asked_for:
        state = result.worst[one.name]
        value = result.value_in(state, one)
        if one.name == "gain_margin" or one.met(needed, value):
            continue
        joints = joints_that_miss(state, one, needed)
        mainly = f", mainly {listed(joints, most=2)}" if 0 < len(joints) < len(result.joints) else ""
        parts.append(f"the {one.title} is not known" if math.isnan(value) else f"{_beside_required(result, one, needed)}{mainly}")
    return parts


def _beside_required(result: Audit, one: Requirement, needed: float) -> str:
    """The least that is left of a requirement, beside what is asked for, and where."""
    state = result.worst[one.name]
    shown = margin_value(result.required, one.name, result.value_in(state, one), False, 3)
    where = f" in {state.contact}" if len(result.states) > 1 else ""
    return f"{one.label} {shown} ({one.sign} {one.text(needed)}){at_frequency(one.frequency(state.counted))}{where}"


def audit_scale(result: Audit) -> float | None:
    """The factor on all gains that makes unsafe ones safe, rounded down; None where none is known, and for safe gains."""
    scale = result.scale
    return None if result.safe or math.isnan(scale) else typed_factor(scale)


def _no_lower_gains(result: Audit) -> str:
    """Why no lower gains help where gearboxes have no damping, and a first guess: a twentieth of the critical damping."""
    actuators = result.system.source.actuators
    bare = np.isfinite(actuators.stiffness) & (actuators.damping == 0)
    if not np.any(bare):
        return "No uniform gain reduction stabilises this robot."
    guess = 2 * SLIGHT * np.sqrt(np.median(actuators.stiffness[bare] * actuators.motor_inertia[bare]))
    return (
        "With gearbox damping at 0 no uniform gain reduction stabilises this robot. Measure the damping; "
        f"--damping {guess:.1g} ({100 * SLIGHT:.0f} % of critical) is a first guess."
    )


def _weakest_path(paths: PathMargins) -> str:
    """At which factor on kp alone, or on kd alone, vibration starts."""
    factors = {"kp": (paths.others, paths.lower_others), "kd": (paths.kd, paths.lower_kd)}
    name, (upper, lower) = min(factors.items(), key=lambda one: min(one[1][0], 1 / one[1][1] if one[1][1] > 0 else math.inf))
    if lower * upper > 1:
        return f"Vibration starts where {name} alone falls to {digits(lower, '×', 3)} ({to_db(lower):.3g} dB)"
    return f"Vibration starts at {digits(upper, '×', 3)} {name} alone ({to_db(upper):.3g} dB)"


def audit_warnings(result: Audit) -> tuple[str, ...]:
    """Warnings of an audit, each with its remedy: what decides first, then how the files were understood."""
    system, found = result.system, []
    if system.control.sample_time is None and not result.safe and result.to_use is None:  # else verdict and advice say what a rate costs
        found.append("continuous model: hold and velocity difference of a loop cost about one tick; give --rate-hz")
    lost = [joint for joint in result.joints if joint.gain_limit < 1] if result.stable else []
    if lost:
        limits = listed([f"{joint.name} (stable only below {digits(joint.gain_limit, '×', 3)} its gains)" for joint in lost], most=3)
        found.append(f"with all other joints switched off {limits} would vibrate: do not run {'it' if len(lost) == 1 else 'one'} by itself")
    bare = [joint.name for joint in result.joints if joint.kp > 0 and joint.kd == 0] if not result.safe else []
    if bare:
        found.append(f"{listed(bare)}: kd is 0, so that no gain damps {'it' if len(bare) == 1 else 'them'}: give kd")
    if result.immobile:
        contacts = listed([state.contact for state in result.immobile])
        found.append(f"{contacts}: {HELD} in this contact state, so there is no verdict; check the contacts")
    others = [text for text in system.warnings if text not in result.doubts]  # which the verdict says
    return tuple(doubts_first([*found, *free_joints(system), *unconfirmed(result.states), *others]))
