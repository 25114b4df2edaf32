"""Results for one joint as sentences, for terminal and page."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..design.joint_gains import COST_ACCURACY
from ..errors import QUANTITIES, at_frequency, case_text, frequency_text, listed
from ..studies.analysis import Analysis
from ..system.margin_units import to_db
from ..system.plausibility import unusual_values
from ..system.requirements import title_of
from ..system.system import System
from .margin_columns import lacking, short_text
from .number_format import digits, own_gains, quantity
from .words import AT_USUAL, UNSTABLE, headline, lower_gains

if TYPE_CHECKING:
    from ..design.joint_gains import Recommendation
    from ..design.uncertainty_cost import KnownExactly
    from ..studies.joint import JointStudy

CONTINUOUS = (
    "continuous model: a real controller's hold and velocity difference cost about one more tick of delay, unless the delay contains "
    "them; set control.sample_rate_hz for the sampled answer"
)
"""Warning about continuous time, for a joint and for a robot."""


def lost_at_usual_rate(study: Analysis) -> list[str]:
    """Warning that gains stable in continuous time would be unstable in a usual sampled loop; [] otherwise."""
    state = study.unstable_at_usual_rate
    if state is None:
        return []
    where = f" (in {state.title})" if len(study.states) > 1 else ""
    return [
        f"in a loop at {AT_USUAL} the present gains would be unstable{where}: give control.sample_rate_hz, or "
        "drive.delay_includes_sampling where the delay contains hold and velocity difference"
    ]


EXACT = "stiffness, damping and delay are taken as exact; give uncertainty: for gains that hold over a range"
RULE = "10 Hz rule: kp = J ω², kd = 2 ζ J ω with ω = 2π·10 rad/s, ζ = 2, J the motor inertia."


def sentence(study: "JointStudy") -> str:
    """Verdict, unmet requirements, and gain limit with its frequency, as text; an unstable case of the uncertainty comes first."""
    if study.unstable_at:
        return f"{headline(study)}{_instead(study)}"
    limit, worst = study.limit, study.in_range.margins.limit
    at = f", at {frequency_text(limit.frequency)}"
    if study.margins.stable:
        text = headline(study)
        if math.isinf(limit.gain):
            return f"{text} No common factor on these gains makes the modelled joint vibrate.{at_usual_rate_text(study)}"
        if study.system.uncertainty.names:
            there = at_frequency(worst.frequency, ", at ")
            nominal = f"nominally at {digits(limit.gain, '×', 3)}{at}"
            starts = f"Vibration starts at {digits(worst.gain, '×', 3)} these gains in the worst case{there}; {nominal}."
            return " ".join(filter(None, [text, starts, lower_gains(worst)]))
        starts = f"{vibration_starts(study)} at {digits(limit.gain, '×', 3)} these gains ({to_db(limit.gain):.3g} dB){at}."
        return " ".join(filter(None, [text, starts, lower_gains(limit)])) + at_usual_rate_text(study)
    if limit.gain > 0 and math.isfinite(limit.gain):
        return (
            f"{UNSTABLE}. Scaled together, these gains are stable only below {digits(limit.gain, '×', 3)}, with no margin "
            f"there{at}.{_instead(study)}"
        )
    if math.isnan(limit.gain):
        return f"{UNSTABLE}. Whether lower gains in the same ratio are stable is not known.{_instead(study)}"
    return f"{UNSTABLE}. No lower gains in the same ratio are stable.{_instead(study)}"


def _instead(study: "JointStudy") -> str:
    if study.recommended is None:
        return ""
    return f" Use {', '.join(f'{name} {digits(value)}' for name, value, _ in own_gains(study.recommended.controller))}."


def cause(study: "JointStudy") -> str:
    """Sentence on what sets the gain limit; "" if there is no limit."""
    return _cause(study.limit.gain, study.without).strip() if 0 < study.limit.gain < math.inf else ""


def vibration_starts(study: Analysis) -> str:
    """Beginning of the sentence on the gain limit, which differs between continuous time and a sampled loop."""
    return "In continuous time vibration starts" if study.system.rate_is_missing else "Vibration starts"


def at_usual_rate_text(study: Analysis) -> str:
    """Sentence on requirements that the present gains miss in a usual sampled loop; "" if none is known."""
    missed = short_text(study.system.requirements, study.missed_at_usual_rate)
    return f" At a rate of {AT_USUAL}, for example, these gains have {missed}." if missed else ""


def _cause(gain: float, without: dict[str, float]) -> str:
    """Sentence on what sets the limit, from its rise when one influence is removed."""
    rises = {name: to_db(limit / gain) for name, limit in without.items()}
    changes = ", ".join(f"{_change(rises[name])} without {name}" for name in ("delay", "elasticity") if name in rises)
    strong = [name for name in ("delay", "elasticity") if rises.get(name, 0.0) > 3.0]
    cause = "Delay and elasticity together set" if len(strong) == 2 else "Motor inertia and current loop set"
    cause = f"{strong[0].capitalize()} sets" if len(strong) == 1 else cause
    return f" {cause} the limit: {changes}." if changes else f" {cause} the limit."


def _change(rise: float) -> str:
    """Rise of the gain limit [dB] as text."""
    if math.isinf(rise):
        return "no limit" if rise > 0 else "never stable"
    return f"{abs(rise):.3g} dB {'more' if rise >= 0 else 'less'}"


def recommended_text(recommended: "Recommendation") -> str:
    """Sentences on what limits the recommended gains, and how stiff the link, or how large kp, would be without each requirement."""
    without = {name: f"without the {title_of(name)}" for name in recommended.costs}
    worst = ", ".join(quantity(name, value) for name, value in recommended.worst_case.items())
    parts = [f"Recommended gains are limited by the {recommended.held_back_by()}" + (f" (worst case: {worst})." if worst else ".")]
    felt = ", ".join(f"{digits(value, 'N·m/rad')} {without[name]}" for name, value in recommended.felt.items())
    largest = made_largest(recommended)
    if felt:
        parts.append(f"The {largest} would be {felt}.")
    idle = [f"the {title_of(name)}" for name in without if name not in recommended.felt]
    if idle:
        parts.append(f"Without {' or '.join(idle)} alone it would be the same." if felt else f"No requirement costs any {largest}.")
    return " ".join([*parts, f"Checked: {recommended.certificate}."])


def made_largest(recommended: "Recommendation") -> str:
    """What recommended gains make largest: "dynamic stiffness of the link", or "largest kp" by its name on the controller's plane."""
    kp_name, _ = recommended.controller.plane_names
    return "dynamic stiffness of the link" if recommended.objective == "dynamic_stiffness" else f"largest {kp_name}"


def uncertainty_cost_text(study: "JointStudy", ranked: bool) -> str:
    """Sentences on the gain that the uncertainty costs; `ranked`: also what to measure better, which takes longer. "" if not applicable."""
    exact, cost = study.exact, study.cost
    if exact is None or cost is None:
        return ""
    if cost < COST_ACCURACY:
        return "The uncertainty costs nothing."
    largest = made_largest(exact)
    part = "all" if study.recommended is None else f"{100 * cost:.0f} %"
    text = f"The uncertainty costs {part} of the {largest}: with exact parameters it would be {digits(exact.value, 'N·m/rad')}."
    if not ranked or study.uncertainty_cost is None:
        return text
    (first, *others), half = study.uncertainty_cost.known, study.uncertainty_cost.half
    if not gains_by(study, first):
        ranges = listed([_range_text(study, one.name) for one in (first, *others)])
        return f"{text} No quantity alone would raise it if it were known exactly: several of these ranges have to be narrower: {ranges}."
    start = f"{text} Measure the {_range_text(study, first.name)} better{' first' * bool(others)}"
    exact = f"{digits(first.value, 'N·m/rad')} ({rise_text(study, first)}) if it were surely the nominal one"
    to_half = f"surely {_ends(half.name, half.low, half.high)}, half of that range"
    if gains_by(study, half):
        best = f"the {largest} would be {digits(half.value, 'N·m/rad')} ({rise_text(study, half)}) if it were {to_half}, and {exact}"
    else:
        best = f"to be {to_half}, would not be enough; the {largest} would be {exact}"
    rest = "; ".join(f"with the {_range_text(study, one.name)} known exactly: {rise_text(study, one)}" for one in others)
    return f"{start}: {best}{f'; {rest}' * bool(rest)}."


def _range_text(study: "JointStudy", name: str) -> str:
    """Uncertain quantity with its range as text: "delay (2 to 3 ms)"."""
    low, high = getattr(study.system.uncertainty, name)
    return f"{name.replace('_', ' ')} ({_ends(name, float(low), float(high))})"


def _ends(name: str, low: float, high: float) -> str:
    """Range in the displayed unit: "2 to 3 ms"."""
    scale, unit = QUANTITIES[name]
    return f"{digits(scale * low)} to {digits(scale * high, unit)}"


def gains_by(study: "JointStudy", known: "KnownExactly") -> bool:
    """True if exact knowledge of a quantity raises what the recommended gains make largest."""
    return known.value > 0 and (study.recommended is None or known.value >= (1 + COST_ACCURACY) * study.recommended.value)


def rise_text(study: "JointStudy", known: "KnownExactly") -> str:
    """Rise of what the recommended gains make largest, as text: "22 % more", "2.4 times as much", "nothing more"; "instead of none"."""
    if not gains_by(study, known):
        return "nothing more"
    if study.recommended is None:
        return "instead of none"
    rise = known.value / study.recommended.value
    return f"{100 * (rise - 1):.0f} % more" if rise < 2 else f"{digits(rise, '', 3)} times as much"


def warnings(study: "JointStudy") -> tuple[str, ...]:
    """Warnings that change the decision, each with its remedy; those that weaken the verdict first, as only the first are always shown."""
    system, found = study.system, study.margins
    joint, control = system.source, system.control
    texts = list(unusual_values(system))
    if not found.certified:
        texts.append("a crossing or peak could not be certified: treat these margins as estimates and report the input")
    texts += lost_at_usual_rate(study)
    if _drifts(system):
        cause = "kp is 0" if "kp" in control.controller.gain_names() else "the controller gives no torque against a constant error"
        texts.append(f"{cause}: no torque holds the joint's position, so it drifts; the verdict covers its other motions; give it kp")
    if not study.range_proved:
        texts.append("these gains are stable in every case examined within the uncertainty ranges; in between it is not proved")
    if study.system.rate_is_missing and study.at_usual_rate is None:
        texts.append(CONTINUOUS)
    if control.feedback.link and joint.damping == 0 and not math.isinf(joint.stiffness):
        texts.append(undamped_link_feedback(study, "this joint"))
    if study.recommended is None and math.isinf(study.max_kp) and not study.prevented_by:
        texts.append(nothing_limits())
    elif study.recommended is None and system.requirements.asked:
        texts.append(no_gains(system, study.prevented_by))
    return tuple(texts)


def undamped_link_feedback(study: Analysis, what: str) -> str:
    """Warning about link-side encoders without gearbox damping; `what` vibrates: at almost all gains only if no state is stable at any."""
    hopeless = any(not state.limit.stable and state.limit.gain == 0 for state in study.states)
    vibrates = f"{what} vibrates at almost any gain" if hopeless else f"only the lag of delay and drive damps the resonance of {what}"
    return (
        f"with the encoder on the link and no gearbox damping, {vibrates}: feed back the motor's velocity (feedback: motor), or measure "
        "the damping"
    )


def notes(study: "JointStudy") -> tuple[str, ...]:
    """Further notes for the user."""
    texts, system, found = [], study.system, study.margins
    if not found.stable and 0 < study.limit.gain < math.inf:
        instead = "" if study.recommended is None else ", or use the recommended ones"
        texts.append(f"these gains are unstable: multiply all of them by less than {digits(study.limit.gain, '', 3)}{instead}")
    if study.unstable_at:
        instead = "lower these gains, or give narrower ranges" if study.recommended is None else "use the recommended gains"
        texts.append(f"these gains are unstable within the uncertainty ranges, at {case_text(study.unstable_at)}: {instead}")
    if study.system.rate_is_missing and study.at_usual_rate is not None:
        texts += [*_recommended_without_rate(study), CONTINUOUS]
    if not system.control.controller.has_plane:
        texts.append("the gain map, the largest gains and the recommendation are for a plain PD, as this controller has no kp–kd plane")
    return (*texts, *([] if system.uncertainty.names else [EXACT]))


def _recommended_without_rate(study: "JointStudy") -> list[str]:
    """Note that gains recommended for continuous time fail in a usual sampled loop; [] otherwise."""
    usual = study.at_usual_rate
    if usual is None or usual.requirements_met is not False:
        return []
    has = lacking(study.system.requirements, usual.in_range.margins)
    instead = f"; at_usual_rate has gains for {AT_USUAL}, which is assumed" if usual.recommended is not None else ""
    return [f"control.sample_rate_hz is not given: recommended is for continuous time, and at {AT_USUAL} those gains {has}{instead}"]


def _drifts(system: System) -> bool:
    """True if the controller gives no torque against a constant position error."""
    controller = system.control.controller
    control = controller.combine(controller.terms(), system.control.sample_time).reduced
    return control.gain == 0 or bool(np.any(control.zeros == 0))


def nothing_limits() -> str:
    """Warning without recommended gains, as the model has no delay."""
    return "nothing in this model limits kp: no gains are recommended; give the drive's delay and bandwidth"


def no_gains(system: System, prevented_by: Sequence[str]) -> str:
    """Warning without recommended gains, with remedies; `prevented_by`: the bounds that are the reason."""
    controller, uncertain = system.control.controller, bool(system.uncertainty.names)
    kind, remedies = controller.kind if controller.has_plane else "PD", ["relax limits", "shorten the delay"]
    if system.control.feedback.link and math.isfinite(system.source.stiffness):
        remedies.append("feed the motor's velocity back (feedback: {kp: link, kd: motor})")
    if controller.has_held_gain:
        kind = f"{kind} gains with this file's {controller.held_ratio}, held constant,"
        remedies.insert(0, f"lower {controller.held_gain}")
    if uncertain:
        ranges = [
            f"{name.replace('_', ' ')} {_ends(name, *map(float, getattr(system.uncertainty, name)))}" for name in system.uncertainty.names
        ]
        remedies.insert(-1, f"narrow a range of uncertainty ({', '.join(ranges)})")
    met = "were found that meet the requirements in every case" if uncertain else "meet the requirements"
    if prevented_by:
        bounds, verb = (
            listed([f"{name} {_bound(system, name)}" for name in prevented_by]),
            "prevents" if len(prevented_by) == 1 else "prevent",
        )
        met += f", as {bounds} of gain_bounds {verb} it"
        remedies.insert(0, f"change {listed(prevented_by, 'or')}")
    return f"no {kind if kind.endswith(',') else kind + ' gains'} {met}: {', '.join(remedies[:-1])}, or {remedies[-1]}"


def _bound(system: System, name: str) -> str:
    """Bound of a joint's gains with its unit."""
    return digits(float(getattr(system.bounds, name)), "N·m/rad" if name.startswith("kp") else "N·m·s/rad")
