"""What the terminal and the page say of one joint, in sentences."""

import math

import numpy as np

from ..analysis.margin_record import GainLimit, Margins
from ..analysis.margins import to_db
from ..errors import case_in_words, frequency_in_words
from ..studies.joint import JointStudy
from ..system.plausibility import unusual_values
from ..system.system import System

NOT_EVERYWHERE = "Stable as stated, but not everywhere in the stated ranges"
CONTINUOUS = (
    "continuous model: a real controller's hold and velocity difference cost about one more tick of delay; "
    "set control.sample_rate_hz for the sampled answer"
)
"""A warning, for a joint and for a robot."""


def sentence(study: JointStudy) -> str:
    """The answer in one sentence: verdict, room, frequency, cause; first of all, where within the uncertainty it does not hold."""
    as_stated = _as_stated(study.margins, study.limit, study.without)
    if not study.unstable_at:
        return as_stated
    return f"{NOT_EVERYWHERE}: unstable at {case_in_words(study.unstable_at)}. As stated, {as_stated.removeprefix('Stable: ')}"


def _as_stated(found: Margins, limit: GainLimit, without: dict[str, float]) -> str:
    """Verdict, room, frequency and cause at the stated values."""
    at = frequency_in_words(limit.frequency)
    if found.stable and math.isinf(limit.gain):
        return "Stable: no common factor on these gains makes the modelled joint vibrate."
    if found.stable:
        text = f"Stable: these gains can be multiplied by {limit.gain:.3g} ({to_db(limit.gain):.3g} dB) before the joint vibrates at {at}"
        return text + _cause(limit.gain, without) + "."
    if limit.gain > 0 and math.isfinite(limit.gain):
        text = (
            f"Unstable: with these gains the joint vibrates; it is stable below {limit.gain:.3g} times them, where it would vibrate at {at}"
        )
        return text + _cause(limit.gain, without) + "."
    return "Unstable: with these gains the joint does not settle, and no common factor that lowers them makes it stable."


def _cause(gain: float, without: dict[str, float]) -> str:
    """What sets the limit, from how far it rises when one influence is taken away."""
    rises = {name: to_db(limit / gain) for name, limit in without.items()}
    told = ", ".join(f"{_change(rises[name])} without {name}" for name in ("delay", "elasticity") if name in rises)
    strong = [name for name in ("delay", "elasticity") if rises.get(name, 0.0) > 3.0]
    if len(strong) == 2:
        return f"; delay and elasticity together set the limit ({told})"
    if strong:
        return f"; the {strong[0]} sets the limit ({told})"
    return f"; motor inertia and current loop set the limit ({told})" if told else "; motor inertia and current loop set the limit"


def _change(rise: float) -> str:
    """A rise of the gain limit [dB] in words."""
    if math.isinf(rise):
        return "no limit" if rise > 0 else "never stable"
    return f"{abs(rise):.3g} dB {'more' if rise >= 0 else 'less'}"


def warnings(study: JointStudy) -> tuple[str, ...]:
    """What a user should know or do, each with the remedy."""
    system, found = study.system, study.margins
    joint, control = system.source, system.control
    said = list(unusual_values(system))
    if not found.stable and 0 < study.limit.gain < math.inf:
        instead = "" if study.recommended is None else ", or use the recommended ones"
        said.append(f"these gains are unstable: multiply all of them by less than {study.limit.gain:.3g}{instead}")
    if _drifts(system):
        cause = "kp is 0" if "kp" in control.controller.gain_names() else "the controller gives no torque against a standing error"
        said.append(f"{cause}: nothing holds the joint's position; it drifts, whatever the verdict on its other motions; give it kp")
    if study.unstable_at:
        instead = "lower these gains, or state narrower ranges" if study.recommended is None else "use the recommended gains"
        said.append(f"these gains are unstable within the stated ranges, at {case_in_words(study.unstable_at)}: {instead}")
    if not study.range_proved:
        said.append("within the stated ranges these gains are stable wherever they were looked at; in between it is not proved")
    if control.sample_time is None and system.delay > 0:
        said.append(CONTINUOUS)
    if control.feedback == "link" and joint.damping == 0 and not math.isinf(joint.stiffness):
        said.append(
            "link-side feedback on an undamped elastic joint: whether its resonance settles hangs on the lag of delay and drive alone, "
            "and without lag it never does: measure damping, or close the loop on the motor side"
        )
    if math.isinf(study.max_kp):
        said.append("nothing in this model limits kp: no gains are recommended; give the drive's delay and bandwidth")
    elif system.requirements.asked and study.recommended is None:
        said.append(_no_gains(system))
    if study.max_kd is None:
        said.append("the gain map, the largest gains and the recommendation are for a plain PD, as this controller has no kp–kd plane")
    if not system.uncertainty.names:
        said.append("stiffness, damping and delay are taken as exact; give uncertainty: for gains that hold over a range")
    if not found.certified:
        said.append("a crossing or peak could not be certified: treat these margins as estimates and report the input")
    return tuple(said)


def _drifts(system: System) -> bool:
    """Whether the controller gives no torque against a standing error of the joint's position."""
    controller = system.control.controller
    control = controller.combine(controller.terms(), system.control.sample_time).reduced
    return control.gain == 0 or bool(np.any(control.zeros == 0))


def _no_gains(system: System) -> str:
    """That nothing can be recommended, and what would help."""
    controller, uncertain = system.control.controller, bool(system.uncertainty.names)
    kind, remedies = controller.kind if controller.has_plane else "PD", ["relax limits", "shorten the delay"]
    if controller.held_ratio and controller.ki != 0:
        kind = f"{kind} gains with this file's {controller.held_ratio}, which is held,"
        remedies.insert(0, "lower ki")
    if uncertain:
        remedies.insert(-1, "shrink uncertainty")
    kept = "were found that keep the required margins in every stated case" if uncertain else "keep the required margins"
    return f"no {kind if kind.endswith(',') else kind + ' gains'} {kept}: {', '.join(remedies[:-1])}, or {remedies[-1]}"
