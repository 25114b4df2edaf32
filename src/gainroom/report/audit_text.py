"""The result of an audit in sentences: the verdict, what to do, why, and warnings with remedies."""

import math

import numpy as np

from ..analysis.margin_record import PathMargins
from ..errors import beside, frequency_text, listed
from ..studies.analysis import typed_factor
from ..studies.audit import Audit, GainsToUse
from ..studies.state import HELD
from ..system.requirements import REQUIREMENTS, Requirements, to_db
from .gains_to_use import gain_file
from .gearbox_range import over_range, worst_gearboxes
from .joint_text import BARE
from .margin_columns import requirement, short_text
from .needed_stiffness import if_stiff
from .number_format import digits
from .robot_text import free_joints, unconfirmed
from .what_to_do import Advice

SLIGHT = 0.05
"""Damping ratio of a motor on its spring proposed as a first guess where none is given."""


def audit_sentence(result: Audit) -> str:
    """Verdict and reason, in one text."""
    return f"{verdict(result)} {reason(result)}"


def verdict(result: Audit) -> str:
    """Whether the gains are safe, and what fails first, where, and in which joints. No number in it is one to use."""
    over, worst, count = over_range(result), result.tightest, sum(not joint.safe for joint in result.joints)
    if not worst.limit.stable:
        return f"Not safe{over}: unstable with {_given(result)} of delay{_mainly(result)}. {_count(count, result)}"
    unknown = [state.contact for state in result.states if math.isnan(state.limit.gain)]
    if unknown:
        return f"Not safe{over}: stable, but the gain limit in {listed(unknown)} is not known. {_count(count, result)}"
    if result.safe:
        return f"Safe{in_continuous_time(result)}{_slowest(result)}{over}{if_stiff(result)}{hardly_damped(result)}"
    short = missed_besides(result) or _short_of_gain(result)
    return f"Not safe{over}: {short}. {_count(count, result)}"


def in_continuous_time(result: Audit) -> str:
    """That the answer is for continuous time; "" where the loop's rate is known."""
    return " in continuous time" if result.system.control.sample_time is None else ""


def _slowest(result: Audit) -> str:
    """The rate below which safe gains have less than the required gain margin, estimated, where the loop's rate is not known."""
    kept = math.nan if result.system.control.sample_time is not None else result.delay_with_margin
    rate = f"a loop slower than about {digits(1 / kept, 'Hz', 3)}" if 0 < kept < math.inf else ""
    return f" ({rate} leaves less than {to_db(result.margin):.3g} dB)" if rate else ""


def hardly_damped(result: Audit, whose: str = "the gains") -> str:
    """That gains with all that is required leave little damping, where nothing is required of it; "" where they do not."""
    one, state = REQUIREMENTS["peak_sensitivity"], result.worst["peak_sensitivity"]
    value, omega = one.value(state.margins), one.frequency(state.margins)
    if one.name in result.further.needed or not value > BARE:
        return ""
    at = f" at {frequency_text(omega)}" if math.isfinite(omega) else ""
    return f" But {whose} hardly damp the motion{at}: Ms {one.text(value)}, where 2 is usual; audit with --peak-sensitivity 2 before use."


def _short_of_gain(result: Audit) -> str:
    """The gain margin that is too small: of all gains together, of one path, or of a joint by itself."""
    worst, asked = result.tightest, Requirements(gain_margin=result.margin)
    paths, at = worst.margins.paths, ""
    value, whose = worst.limit.gain, ""
    if math.isfinite(worst.limit.frequency):
        at = f" at {frequency_text(worst.limit.frequency)}"
    if paths is not None and paths.headroom < value:
        value, whose, at = paths.headroom, " of kp or kd by itself,", ""
    elif result.enough_gain_in(worst):
        first = result.by_headroom[0]
        return f"{short_text(asked, {'gain_margin': first.gain_limit})} of {first.name} by itself"
    return f"{short_text(asked, {'gain_margin': value})}{whose}{at}{_mainly(result)}"


def _given(result: Audit) -> str:
    return f"{1e3 * result.system.delay:.3g} ms"


def _mainly(result: Audit) -> str:
    """Where, and in which joints: an audit has one posture."""
    short = sum(not result.enough_in(state) for state in result.states)
    every = f" in {'both' if short == 2 else f'all {short}'} states, worst" if short == len(result.states) else ""
    where = f"{every} in {result.tightest.contact}" if len(result.states) > 1 else ""
    return where + (f", mainly {listed(result.limiting_joints, most=2)}" if result.limiting_joints else "")


def reason(result: Audit) -> str:
    """At which factor and at which delay these gains vibrate: limits, which leave no margin."""
    worst, where = result.tightest, worst_gearboxes(result)
    limit, delay = worst.limit, "The delay limit is not known."
    if math.isfinite(result.delay_limit):
        delay = f"With these gains vibration starts at {1e3 * result.delay_limit:.3g} ms of delay (given: {_given(result)})."
        delay = "These gains are unstable without delay, too." if result.delay_limit == 0 else delay
    elif math.isinf(result.delay_limit):
        delay = "No delay makes these gains vibrate."
    if not limit.stable:
        lost = (
            f"The present ones stop vibrating only below {limit.gain:.3g} ×, where no margin is left."
            if limit.gain > 0
            else _no_lower_gains(result)
        )
        lost = "Whether lower gains are stable is not known." if math.isnan(limit.gain) else lost
        return f"{where} {lost} {delay}".strip()
    if any(math.isnan(state.limit.gain) for state in result.states):
        return f"{where} {delay}".strip()
    at = f", at {limit.frequency / (2 * math.pi):.3g} Hz" if math.isfinite(limit.frequency) else ""
    about = f"{at}{_mainly(result)}" if result.safe or missed_besides(result) else ""
    factors, levels = (limit.gain, result.margin), (to_db(limit.gain), to_db(result.margin))
    factor, level = (f"{pair[0]:.3g}" if result.enough_gain_in(worst) else beside(*pair) for pair in (factors, levels))
    start = f"Vibration starts at {factor} × these gains ({level} dB){about}"
    start = "No common factor on all gains makes it vibrate" if math.isinf(limit.gain) else start
    if worst.margins.paths is not None and worst.margins.paths.headroom < limit.gain:
        start = _weakest_path(worst.margins.paths)
    return f"{where} {start}. {delay}".strip()


def what_to_do(result: Audit) -> Advice:
    """Gains that are safe, or how to find some; of safe ones on what that rests. Its lines are all gains to use."""
    actuators = result.system.source.actuators
    if result.safe:
        rate = "" if result.system.control.sample_time is not None else "Give the loop's rate with `--rate-hz`. "
        if not result.assumed_rigid.any():
            return Advice(f"{rate or 'These gains may stay.'}".rstrip())
        known = "Look up what your gearboxes have" if result.needed is not None else "Give what is known of your gearboxes"
        return Advice(
            f"{rate}{known}, and audit again with `--stiffness` and `--damping`, or `--gearbox`: on softer ones these gains may not stay."
        )
    found = result.to_use
    if found is not None:
        rate = " Any rate leaves less: audit with `--rate-hz` before use." if result.system.control.sample_time is None else ""
        again = " Audit them over the range again, where other gearboxes may be the worst." if result.over is not None else ""
        text = f"{_multiply(result, found)}; then {_required(result)}.{rate}{again}{hardly_damped(found.audited, 'they')}"
        return Advice(text, gain_file(result.system.source.joint_names, found.gains))
    if result.tightest.limit.gain == 0 and np.any(actuators.damping[np.isfinite(actuators.stiffness)] == 0):
        return Advice("Measure the gearboxes' damping, and audit again with `--damping`.")
    start = ""
    if not math.isnan(result.gain_scale):
        start = f"No common factor gives all margins: × {result.gain_scale:.3g} the gain margin alone. Lower kp more than kd. "
    return Advice(f"{start}Audit with `--write-robot robot.yaml`: `gainroom robot robot.yaml` then searches gains joint by joint.")


def _multiply(result: Audit, found: GainsToUse) -> str:
    """Which gains by which factor, with the values of the joint that has the least headroom."""
    names = result.system.source.joint_names
    first = next(joint.name for joint in result.by_headroom if joint.name in found.joints)
    of_first = ", ".join(f"{name} {values[names.index(first)]:.4g}" for name, values in found.gains.items() if name != "ki")
    count, left = len(found.joints), len(names) - len(found.joints)
    if not left:
        return f"Multiply all gains by {found.factor:.4g} ({first} {of_first})"
    if count == 1:
        return f"Multiply the gains of {first} by {found.factor:.4g} ({of_first}) and leave the others"
    return f"Multiply the gains of {count} joints by {found.factor:.4g} ({first} {of_first}) and leave the other {left}"


def _required(result: Audit) -> str:
    """What gains to use have, as a clause: "gain margin ≥ 6 dB and delay margin ≥ 1 ms hold in continuous time"."""
    asked = Requirements(gain_margin=result.margin)
    parts = [f"gain margin {requirement(asked, 'gain_margin', 3)}"]
    parts += [f"delay margin ≥ {digits(1e3 * result.delay_margin, 'ms', 3)}"] if result.delay_margin > 0 else []
    parts += [f"{one.heading} {requirement(result.further, one.name, 3)}" for one, _ in result.further.asked_for]
    return f"{listed(parts)} {'hold' if len(parts) > 1 else 'holds'}{in_continuous_time(result)}"


def missed_besides(result: Audit) -> str:
    """What gains with enough gain margin have too little of, each beside what is required; "" where that is nothing."""
    if "gain_margin" in result.missed:
        return ""
    parts = []
    if "delay_margin" in result.missed:
        extra, needed = 1e3 * result.least_extra_delay, 1e3 * result.delay_margin
        parts.append(
            "the delay margin is not known" if math.isnan(extra) else f"delay margin {beside(extra, needed)} ms (≥ {needed:.3g} ms)"
        )
    for name, state in result.worst.items():
        if name in result.missed and name != "gain_margin":
            one, needed = REQUIREMENTS[name], result.further.needed[name]
            omega = one.frequency(state.margins)
            at = f" at {frequency_text(omega)}" if math.isfinite(omega) else ""
            parts.append(f"{one.label} {one.text(one.value(state.margins))} ({one.sign} {one.text(needed)}){at}")
    return listed(parts)


def unjudged(result: Audit) -> str:
    """The least phase margin and the peak sensitivity where nothing is required of them; "" where all is, or they are not known."""
    parts, options = [], []
    for name, option in (("phase_margin", "--phase-margin-deg"), ("peak_sensitivity", "--peak-sensitivity")):
        one, state = REQUIREMENTS[name], result.worst[name]
        value = one.value(state.margins)
        if result.further.needed.get(name) is None and math.isfinite(value):
            omega = one.frequency(state.margins)
            after = None if result.to_use is None else one.value(result.to_use.audited.worst[name].margins)
            then = f" (to use: {one.text(after)})" if after is not None and math.isfinite(after) else ""
            parts.append(f"{one.heading} {one.text(value)}" + (f" at {frequency_text(omega)}" if math.isfinite(omega) else "") + then)
            options.append(option)
    return f"Not required: {', '.join(parts)}; {', '.join(options)}." if parts else ""


def audit_scale(result: Audit) -> float | None:
    """The factor on all gains that makes unsafe ones safe, rounded down; None where none is known, and for safe gains."""
    scale = result.scale
    return None if result.safe or math.isnan(scale) else typed_factor(scale)


def _no_lower_gains(result: Audit) -> str:
    """Why no lower gains help where gearboxes have no damping, and a first guess: a twentieth of the critical damping."""
    actuators = result.system.source.actuators
    bare = np.isfinite(actuators.stiffness) & (actuators.damping == 0)
    if not np.any(bare):
        return "No lower gains in the same ratio are stable."
    guess = 2 * SLIGHT * np.sqrt(np.median(actuators.stiffness[bare] * actuators.motor_inertia[bare]))
    return (
        "With gearbox damping at 0 no lower gains in the same ratio are stable. Measure the damping; "
        f"--damping {guess:.1g} ({100 * SLIGHT:.0f} % of critical) is a first guess."
    )


def _weakest_path(paths: PathMargins) -> str:
    """At which factor on kp alone, or on kd alone, vibration starts."""
    factors = {"kp": (paths.others, paths.lower_others), "kd": (paths.kd, paths.lower_kd)}
    name, (upper, lower) = min(factors.items(), key=lambda one: min(one[1][0], 1 / one[1][1] if one[1][1] > 0 else math.inf))
    if lower * upper > 1:
        return f"Vibration starts where {name} alone falls to {lower:.3g} × ({to_db(lower):.3g} dB)"
    return f"Vibration starts at {upper:.3g} × {name} alone ({to_db(upper):.3g} dB)"


def _count(unsafe: int, result: Audit) -> str:
    return f"{unsafe} of {len(result.joints)} joints {'is' if unsafe == 1 else 'are'} not safe."


def audit_warnings(result: Audit) -> tuple[str, ...]:
    """Warnings of an audit, each with its remedy: what decides first, then how the files were understood."""
    system, found = result.system, []
    if system.control.sample_time is None:
        found.append(f"continuous model: {_lost(result)}; give --rate-hz")
    if result.immobile:
        contacts = listed([state.contact for state in result.immobile])
        found.append(f"{contacts}: {HELD} in this contact state, so there is no verdict; check the contacts")
    return (*found, *free_joints(system), *unconfirmed(result.states), *system.warnings)


def _lost(result: Audit) -> str:
    """At which rate one tick of delay makes safe gains, or those to use in place of others, vibrate."""
    found, whose = (result, "these gains") if result.to_use is None else (result.to_use.audited, "the gains to use")
    extra = found.least_extra_delay
    if not 0 < extra < math.inf:
        return "hold and velocity difference of a loop cost about one tick"
    return f"a loop slower than about {digits(1 / extra, 'Hz', 3)}, which costs a tick, makes {whose} vibrate"
