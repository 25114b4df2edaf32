"""One joint, studied: verdict, margins, limits, region, recommended gains, and a sentence that says what limits it."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_limit import GainLimit, gain_limit
from ..analysis.gain_region import PDRegion, pd_region
from ..analysis.margins import Margins, margins, to_db
from ..analysis.range_proof import prove
from ..analysis.stability import is_stable
from ..design.joint_gains import FILLING, Recommendation, recommend_pd, value_of
from ..errors import case_in_words, frequency_in_words
from ..system.controller import PD, PID, PPI
from ..system.joint_spec import JointSpec
from ..system.loop import Loop, build_loop
from ..system.requirements import Requirements
from ..system.uncertainty import Case

RULE_FREQUENCY = 2 * math.pi * 10.0  # [rad/s] of the rule that reinforcement-learning teams copy: kp = J ω², kd = 2 ζ J ω
RULE_DAMPING = 2.0
NOT_EVERYWHERE = "Stable as stated, but not everywhere in the stated ranges"
CONTINUOUS = (
    "continuous model: a real controller's hold and velocity difference cost about one more tick of delay; "
    "set control.sample_rate_hz for the sampled answer"
)
"""A warning, for a joint and for a robot."""


@dataclass(frozen=True)
class Rule:
    """The 10 Hz rule's gains on this joint and the margins they have."""

    kp: float
    kd: float
    margins: Margins


@dataclass(frozen=True)
class JointStudy:
    """What `gainroom joint` tells.

    loop, margins, limit   of the gains as given
    region, required_region   stable PD gains; those that keep the requirements
    max_kp                 largest stable kp over all kd
    max_kd                 largest stable kd at the given kp; None for controllers without a kp–kd plane
    recommended            None where nothing is required or no gains keep it
    rule                   the 10 Hz rule on this joint
    unstable_at            the first case within the uncertainty where the gains as given are unstable, by quantity, SI; empty: none found,
                           or nothing is uncertain, or they are unstable as stated
    range_proved           what is said of the whole uncertainty is proved; False: no unstable case was found, but there may be one
    without                gain limit with an influence taken away: "delay", "elasticity", "delay and elasticity"
    sentence, warnings     in words
    """

    spec: JointSpec
    loop: Loop
    margins: Margins
    limit: GainLimit
    region: PDRegion
    required_region: PDRegion
    max_kp: float
    max_kd: float | None
    recommended: Recommendation | None
    rule: Rule
    unstable_at: dict[str, float]
    range_proved: bool
    without: dict[str, float]
    sentence: str
    warnings: tuple[str, ...]

    @property
    def stable_in_range(self) -> bool:
        """Stable as stated, and no unstable case found within the uncertainty; `range_proved` says whether there can be none."""
        return self.margins.stable and not self.unstable_at


def study_joint(spec: JointSpec) -> JointStudy:
    """Everything about one joint."""
    loop = spec.loop()
    found, limit = margins(loop), gain_limit(loop)
    template = spec.controller if spec.controller.has_plane else PD(1.0, 1.0)
    place = {"feedback": spec.feedback, "sample_time": spec.sample_time, "controller": template}
    region = pd_region(spec.joint, spec.drive, **place)
    asked = {name: getattr(spec.requirements, name) for name in spec.requirements.asked}
    recommended = recommend_pd(spec.joint, spec.drive, spec.requirements, spec.uncertainty, **place) if asked else None
    without = _without(spec)
    unstable_at, proved = _unstable_at(spec) if found.stable else ({}, True)
    study = JointStudy(
        spec=spec,
        loop=loop,
        margins=found,
        limit=limit,
        region=region,
        required_region=pd_region(spec.joint, spec.drive, **asked, **place),
        max_kp=region.max_kp(),
        max_kd=region.max_kd(spec.controller.plane_gains()[0]) if template is spec.controller else None,
        recommended=recommended,
        rule=_rule(spec, template),
        unstable_at=unstable_at,
        range_proved=proved,
        without=without,
        sentence=_sentence(found, limit, without, unstable_at),
        warnings=(),
    )
    return replace(study, warnings=_warnings(study))


def _rule(spec: JointSpec, template: PD | PID | PPI) -> Rule:
    """The rule uses the reflected motor inertia alone; a joint without one falls back on the load's."""
    inertia = spec.joint.motor_inertia or spec.joint.link_inertia
    kp, kd = inertia * RULE_FREQUENCY**2, 2 * RULE_DAMPING * inertia * RULE_FREQUENCY
    controller = PD(kp, kd, velocity_filter=template.velocity_filter, notches=template.notches)
    return Rule(kp, kd, margins(build_loop(spec.joint, spec.drive, controller, spec.feedback, spec.sample_time)))


def _unstable_at(spec: JointSpec) -> tuple[dict[str, float], bool]:
    """A case, by quantity, in which the gains as given are unstable, or none; and whether that is proved.

    Looked at are one quantity at an end, then the cases of a recommendation, then what comes up while the whole uncertainty is proved.
    """
    uncertain = spec.uncertainty
    if not uncertain.names:
        return {}, True
    screened = [*uncertain.corners, *uncertain.inside(FILLING)]
    for shape, place in (*((end, (0.0,)) for end in uncertain.ends()), *((uncertain, place) for place in screened)):
        if not is_stable(_at(spec, shape.case(spec.joint, spec.drive, place)).loop()):
            return {name: value_of(shape.case(spec.joint, spec.drive, place), name) for name in shape.names}, True
    proof = prove(
        spec.joint, spec.drive, uncertain, spec.controller, Requirements(), spec.feedback, spec.sample_time,
        judge=lambda values: not is_stable(_at(spec, uncertain.case(spec.joint, spec.drive, uncertain.place(values))).loop()),
    )  # fmt: skip
    if proof.broken:
        case = uncertain.case(spec.joint, spec.drive, uncertain.place(proof.worst))
        return {name: value_of(case, name) for name in uncertain.names}, True
    return {}, proof.holds


def _at(spec: JointSpec, case: Case) -> JointSpec:
    return replace(spec, joint=case[0], drive=case[1])


def _without(spec: JointSpec) -> dict[str, float]:
    """Gain limits of the same controller with influences taken away, as in Fig. 9 of Jung et al. 2017."""
    rigid, instant = {"stiffness": math.inf, "damping": 0.0}, {"delay": 0.0}
    changes = {"delay": ({}, instant), "elasticity": (rigid, {}), "delay and elasticity": (rigid, instant)}
    if math.isinf(spec.joint.stiffness) or math.isinf(spec.joint.link_inertia):
        changes = {"delay": ({}, instant)}
    if spec.drive.delay == 0:
        changes = {name: change for name, change in changes.items() if name == "elasticity"}
    result = {}
    for name, (joint, drive) in changes.items():
        changed = replace(spec, joint=replace(spec.joint, **joint), drive=replace(spec.drive, **drive))
        result[name] = gain_limit(changed.loop()).gain
    return result


def _no_gains(spec: JointSpec) -> str:
    """That nothing can be recommended, and what would help."""
    controller, uncertain = spec.controller, bool(spec.uncertainty.names)
    kind, remedies = controller.kind if controller.has_plane else "PD", ["relax limits", "shorten the delay"]
    if controller.held_ratio and controller.ki != 0:
        kind = f"{kind} gains with this file's {controller.held_ratio}, which is held,"
        remedies.insert(0, "lower ki")
    if uncertain:
        remedies.insert(-1, "shrink uncertainty")
    kept = "were found that keep the required margins in every stated case" if uncertain else "keep the required margins"
    return f"no {kind if kind.endswith(',') else kind + ' gains'} {kept}: {', '.join(remedies[:-1])}, or {remedies[-1]}"


def _sentence(found: Margins, limit: GainLimit, without: dict[str, float], unstable_at: dict[str, float]) -> str:
    """The answer in one sentence: verdict, room, frequency, cause; first of all, where within the uncertainty it does not hold."""
    as_stated = _as_stated(found, limit, without)
    if not unstable_at:
        return as_stated
    return f"{NOT_EVERYWHERE}: unstable at {case_in_words(unstable_at)}. As stated, {as_stated.removeprefix('Stable: ')}"


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


def _drifts(spec: JointSpec) -> bool:
    """Whether the controller gives no torque against a standing error of the joint's position."""
    control = spec.controller.combine(spec.controller.terms(), spec.sample_time).reduced
    return control.gain == 0 or bool(np.any(control.zeros == 0))


def _warnings(study: JointStudy) -> tuple[str, ...]:
    """What a user should know or do, each with the remedy."""
    spec, found = study.spec, study.margins
    warnings = list(spec.unusual())
    if not found.stable and 0 < study.limit.gain < math.inf:
        instead = "" if study.recommended is None else ", or use the recommended ones"
        warnings.append(f"these gains are unstable: multiply all of them by less than {study.limit.gain:.3g}{instead}")
    if _drifts(spec):
        cause = "kp is 0" if "kp" in spec.controller.gain_names() else "the controller gives no torque against a standing error"
        warnings.append(f"{cause}: nothing holds the joint's position; it drifts, whatever the verdict on its other motions; give it kp")
    if study.unstable_at:
        instead = "lower these gains, or state narrower ranges" if study.recommended is None else "use the recommended gains"
        warnings.append(f"these gains are unstable within the stated ranges, at {case_in_words(study.unstable_at)}: {instead}")
    if not study.range_proved:
        warnings.append("within the stated ranges these gains are stable wherever they were looked at; in between it is not proved")
    if spec.sample_time is None and spec.drive.delay > 0:
        warnings.append(CONTINUOUS)
    if spec.feedback == "link" and spec.joint.damping == 0 and not math.isinf(spec.joint.stiffness):
        warnings.append(
            "link-side feedback on an undamped elastic joint: whether its resonance settles hangs on the lag of delay and drive alone, "
            "and without lag it never does: measure damping, or close the loop on the motor side"
        )
    if math.isinf(study.max_kp):
        warnings.append("nothing in this model limits kp: no gains are recommended; give the drive's delay and bandwidth")
    elif spec.requirements.asked and study.recommended is None:
        warnings.append(_no_gains(spec))
    if study.max_kd is None:
        warnings.append("the gain map, the largest gains and the recommendation are for a plain PD, as this controller has no kp–kd plane")
    if not spec.uncertainty.names:
        warnings.append("stiffness, damping and delay are taken as exact; give uncertainty: for gains that hold over a range")
    if not found.certified:
        warnings.append("a crossing or peak could not be certified: treat these margins as estimates and report the input")
    return tuple(warnings)
