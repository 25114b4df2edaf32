"""The results of a study or an audit of a robot in sentences: the answer, and warnings with remedies."""

import math
from collections.abc import Iterable

import numpy as np

from ..analysis.gain_limit import GainLimit
from ..analysis.margin_record import PathMargins
from ..errors import beside, frequency_text, listed
from ..studies.audit import Audit
from ..studies.robot import RobotStudy
from ..studies.state import HELD, State, task_headroom
from ..system.controller import gain_matrix
from ..system.requirements import REQUIREMENTS, to_db
from ..system.system import System
from .gearbox_range import over_range, worst_gearboxes
from .joint_text import CONTINUOUS, NOT_EVERYWHERE, failing, lost_at_usual_rate
from .needed_stiffness import if_stiff
from .number_format import digits
from .recommended_gains_text import weight_warnings

SLIGHT = 0.05
"""Damping ratio of a motor on its spring proposed as a first guess where none is given."""
EXACT_ROBOT = "stiffness, damping, inertia and delay are taken as exact; give uncertainty: for gains that hold over a range"
COUPLED = 0.95
"""Coupling is reported where the limit is below this part of the tightest joint's own."""


def sentence(study: RobotStudy) -> str:
    """Verdict, unmet requirements, gain limit with frequency, state and joints, cost of coupling; more where something is not known."""
    parts = [_verdict(study), *_lost_tasks(study)]
    if study.unstable_case:
        parts[0] = f"{NOT_EVERYWHERE}: unstable in {study.unstable_case}."
    unlimited = [state.title for state in study.without_limit]
    if unlimited:
        parts.append(f"In {listed(unlimited)} only the verdict is known, not the gain limit.")
    if study.immobile:
        parts.append(f"In {listed([state.title for state in study.immobile])} {study.immobile[0].reason}.")
    return " ".join(parts)


def _lost_tasks(study: RobotStudy) -> list[str]:
    """A sentence where the file's tasks, which its controller does not close, are unstable in some states."""
    lost = study.unstable_tasks
    if not lost:
        return []
    worst = min(lost, key=task_headroom)
    count = len(study.states)
    some = "all" if len(lost) == count else f"{len(lost)} of"
    where = "" if count == 1 else f" in {some} {count} states, worst in {worst.title}"
    return [f"The file's tasks, closed in place of the joints' gains, are UNSTABLE{where}{_at_most(worst.task_limit)}."]


def _uncontrolled(study: RobotStudy) -> list[str]:
    """Motions that no task controls: the verdict on the tasks counts them as at rest."""
    found: dict[str, list[str]] = {}
    for state in study.states:
        if state.tasks is not None and state.tasks.moves and state.tasks.tasks.free:
            tasks = state.tasks.tasks
            found.setdefault(f"the tasks leave {tasks.free} of {tasks.motions} joint motions uncontrolled", []).append(state.title)
    return [f"In {listed(titles)} {text}, so they drift. Add a posture task." for text, titles in found.items()]


def _verdict(study: RobotStudy) -> str:
    worst, count = study.tightest, len(study.states)
    limit, where = worst.limit, f"in {worst.title}"
    act = " in which the gains act" if study.immobile else ""
    every = f"{' in the one state' if act else ''}{act}" if count == 1 else f" in all {count} states{act}"
    unstable = sum(not state.limit.stable for state in study.states)
    at, joints = frequency_text(limit.frequency), listed(worst.limiting_joints)
    if not unstable:
        start = f"Stable{every}{failing(study)}."
        if study.without_limit and not math.isfinite(limit.gain):
            return start
        if math.isinf(limit.gain):
            return f"{start} No common factor up to 1000 on these gains makes the modelled robot vibrate."
        nominally = "Nominally, vibration" if study.system.uncertainty.names else "Vibration"
        return f"{start} {nominally} starts at {limit.gain:.3g} × these gains, at {at} {where}, mainly {joints}.{_coupling(worst)}"
    start = f"Unstable{every}" if count == 1 else f"Unstable in {unstable} of {count} states{act}"
    if math.isnan(limit.gain):
        return f"{start}: the robot vibrates {where}."
    if limit.gain > 0 and math.isfinite(limit.gain):
        return (
            f"{start}. Scaled together, these gains are stable only below {limit.gain:.3g} ×, with no margin there; vibration starts at "
            f"{at} {where}, mainly {joints}.{_coupling(worst)}"
        )
    return f"{start}: no lower gains in the same ratio are stable {where}."


def _coupling(state: State) -> str:
    """The cost of coupling: the limit of the tightest joint alone, where that is higher."""
    alone = min((row.single_joint_limit for row in state.joints if not math.isnan(row.single_joint_limit)), default=math.nan)
    return f" One joint alone suggests {alone:.3g} ×; coupling lowers it." if state.limit.gain < COUPLED * alone else ""


def warnings(study: RobotStudy) -> tuple[str, ...]:
    """What changes the decision, each with its remedy."""
    system, in_tasks = study.system, study.system.control.space == "task"
    found = [f"{state.title}: the tasks' gains are unstable{_at_most(state.task_limit)}" for state in study.unstable_tasks]
    found += [*lost_at_usual_rate(study), *_immobile(study)]
    found += _uncontrolled(study) if in_tasks else []
    found += [*unconfirmed(study.states), *free_joints(system)]
    found += [text for gains in study.recommended for text in weight_warnings(gains) if gains.space == system.control.space]
    found += [*_not_found(study), *_undamped(study), *system.warnings]
    found += [CONTINUOUS] if study.rate_is_missing and study.at_usual_rate is None else []
    return tuple(dict.fromkeys(found))


def notes(study: RobotStudy) -> tuple[str, ...]:
    """What else a user should know."""
    system, in_tasks = study.system, study.system.control.space == "task"
    found = _unstable(study)
    found += [f"{state.title}: {text}" for state in study.states if state.tasks is not None for text in state.tasks.tasks.warnings]
    found += [] if in_tasks else _uncontrolled(study)
    found += [text for gains in study.recommended for text in weight_warnings(gains) if gains.space != system.control.space]
    found += _weightless(study)
    found += [CONTINUOUS] if study.rate_is_missing and study.at_usual_rate is not None else []
    found += [] if system.uncertainty.names else [EXACT_ROBOT]
    return tuple(dict.fromkeys(found))


def _not_found(study: RobotStudy) -> list[str]:
    """A warning where no gains for every state were found."""
    missing = [gains for gains in study.recommended if gains.space == study.system.control.space and gains.everywhere is None]
    return [f"no gains were found that meet the requirements in every state; nearest: {gains.nearest['']}" for gains in missing]


def unconfirmed(states: Iterable[State]) -> list[str]:
    """A warning that names the states in which a limit or margin is not certified."""
    names = [state.title for state in states if not state.margins.certified]
    if not names:
        return []
    return [f"{listed(names)}: a limit or margin is an estimate: its roots could not be counted on both sides, so it is not certified"]


def _unstable(study: RobotStudy) -> list[str]:
    limit = study.tightest.limit
    if limit.stable or not 0 < limit.gain < math.inf:
        return []
    return [f"these gains are unstable: multiply all of them by less than {limit.gain:.3g}"]


def _immobile(study: RobotStudy) -> list[str]:
    """The states without a verdict, and those whose verdict has no limit."""
    found = []
    if study.immobile:
        remedy = "lock those joints, or check the contacts"
        if study.system.control.space == "task":
            remedy = "control it in joint space or with a posture task, or leave it out"
        reason = study.immobile[0].reason
        titles = listed([state.title for state in study.immobile])
        found.append(f"{titles}: {reason} in this contact state: no verdict and no limit there; {remedy}")
    unlimited = [state.title for state in study.without_limit]
    if unlimited:
        found.append(
            f"{listed(unlimited)}: the verdict is counted from the roots, but the loci could not be followed, so the gain limit is not "
            "known; give undamped joints their damping, and similar gains to joints that work together"
        )
    return found


def free_joints(system: System) -> list[str]:
    """Joints without a restoring torque: the verdict counts their drift as at rest."""
    if system.control.controller is None:
        return []
    stiffness = np.zeros(system.source.body.size)
    for powers, gain in system.control.controller.terms().items():
        if powers in ((0, 0), (0, 1), (1, 1)):
            stiffness += np.abs(np.diagonal(gain_matrix("gain", gain, len(stiffness))))
    names = [name for name, some in zip(system.source.joint_names, stiffness.tolist(), strict=True) if not some]
    if not names:
        return []
    several = len(names) > 1
    return [
        f"{listed(names)}: kp is 0: {'these joints are' if several else 'this joint is'} free and drift{'' if several else 's'}; the "
        f"verdict covers the others; give {'them' if several else 'it'} kp, or lock {'them' if several else 'it'}"
    ]


def _weightless(study: RobotStudy) -> list[str]:
    """A warning where gravity is left out for a standing robot."""
    robot = study.system.source
    if robot.gravity or robot.body.base == "fixed" or not any(robot.contacts.values()):
        return []
    return ["gravity is left out: a standing robot has less margin at low frequencies, and may topple; set model.gravity_stiffness: true"]


def _undamped(study: RobotStudy) -> list[str]:
    """Warnings about springs without damping."""
    actuators = study.system.source.actuators
    if not np.any(np.isfinite(actuators.stiffness) & (actuators.damping == 0)):
        return []
    if study.system.control.feedback == "link":
        return [
            "link-side feedback on undamped elastic joints: their resonances decay only by the lag of delay and drive, and not without "
            "lag: measure damping, or close the loops on the motor side"
        ]
    if any(not state.limit.stable and state.limit.gain == 0 for state in study.states):
        return [
            "undamped elastic joints oscillate without decay where no gain acts on them, and vibrate at any gain where the lag of delay "
            "and drive destabilises them: measure damping and give it"
        ]
    return []


def _at_most(limit: GainLimit | None) -> str:
    if limit is None or math.isnan(limit.gain):
        return "; their gain limit is not known"
    return f"; scale them below {limit.gain:.3g} ×" if limit.gain > 0 else "; no lower gains in the same ratio are stable"


def audit_sentence(result: Audit) -> str:
    """Verdict, gain limit and delay limit beside what is required and given."""
    worst, count = result.tightest, sum(not joint.safe for joint in result.joints)
    limit, given = worst.limit, f"{1e3 * result.system.delay:.3g} ms"
    over, where = over_range(result), worst_gearboxes(result)
    delay = "The delay limit is not known."
    if math.isfinite(result.delay_limit):
        delay = f"With these gains vibration starts at {1e3 * result.delay_limit:.3g} ms of delay (given: {given})."
        delay = "These gains are unstable without delay, too." if result.delay_limit == 0 else delay
    elif math.isinf(result.delay_limit):
        delay = "No delay makes these gains vibrate."
    mainly = f" in {worst.contact}" if len(result.states) > 1 else ""  # an audit has one posture
    mainly += f", mainly {listed(result.limiting_joints, most=2)}" if result.limiting_joints else ""
    if not limit.stable:
        remedy = f"Scale all gains below {limit.gain:.3g} ×." if limit.gain > 0 else _no_lower_gains(result)
        remedy = "Whether lower gains are stable is not known." if math.isnan(limit.gain) else remedy
        lost = f"{over}.{where} Unstable" if over else ": unstable"
        return f"Not safe{lost} with {given} of delay{mainly}. {remedy} {delay} {_count(count, result)}"
    unknown = [state.contact for state in result.states if math.isnan(state.limit.gain)]
    if unknown:
        return f"Not safe{over}: stable, but the gain limit in {listed(unknown)} is not known. {_count(count, result)}"
    at = f", at {limit.frequency / (2 * math.pi):.3g} Hz" if math.isfinite(limit.frequency) else ""
    factors, levels = (limit.gain, result.margin), (to_db(limit.gain), to_db(result.margin))
    enough = result.enough_gain_in(worst)
    factor, level = (f"{pair[0]:.3g}" if enough else beside(*pair) for pair in (factors, levels))
    start = f"Vibration starts at {factor} × these gains ({level} dB){at}{mainly}"
    start = "No common factor on all gains makes it vibrate" if math.isinf(limit.gain) else start
    if worst.margins.paths is not None and worst.margins.paths.headroom < limit.gain:
        start = _weakest_path(worst.margins.paths)
    if result.safe:
        return f"Safe{over}{if_stiff(result)}{where} {start}. {delay}"
    if short := missed_besides(result):
        return f"Not safe{over}: {short}.{where} {start}. {delay} {_count(count, result)}"
    required = f"{result.margin:.3g} × ({to_db(result.margin):.2g} dB) required"
    short = f"{required}, and a joint by itself has less" if enough else required
    return f"Not safe{over}.{where} {start}; {short}. {delay} {_count(count, result)}"


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
            parts.append(f"{one.label} {one.text(value)}" + (f" at {frequency_text(omega)}" if math.isfinite(omega) else ""))
            options.append(option)
    return f"Not required: {', '.join(parts)} ({', '.join(options)})." if parts else ""


def audit_scale(result: Audit) -> float | None:
    """The factor on all gains that makes unsafe ones safe, rounded down; None where none is known, and for safe gains."""
    scale = result.scale
    return None if result.safe or math.isnan(scale) else math.floor(1000 * scale) / 1000 if scale > 0.01 else scale


def audit_advice(result: Audit) -> list[str]:
    """What to do, in a sentence; nothing where gains are safe, or no remedy is known."""
    scale, joints = audit_scale(result), result.by_headroom
    if scale is None and not (result.safe or math.isnan(result.gain_scale)):
        return [f"No common factor gives all margins: × {result.gain_scale:.3g} the gain margin alone. Lower kp more than kd."]
    if scale is None:
        return []
    first = joints[0]
    gains = f"{first.name} kp {scale * first.kp:.4g}, kd {scale * first.kd:.4g}"
    time = " in continuous time" if result.system.control.sample_time is None else ""
    return [f"Use: all gains × {scale:.4g} ({gains}); then the margin holds{time}."]


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
    """Warnings of an audit, each with its remedy."""
    system = result.system
    warnings = list(system.warnings)
    if system.control.sample_time is None:
        extra = result.least_extra_delay
        lost = f", so that below about {digits(1 / extra, 'Hz', 2)} the present gains vibrate" if 0 < extra < math.inf else ""
        warnings.append(
            f"continuous model: hold and velocity difference of a real controller cost about one more tick{lost}; give --rate-hz"
        )
    if result.immobile:
        contacts = listed([state.contact for state in result.immobile])
        warnings.append(f"{contacts}: {HELD} in this contact state, so there is no verdict; check the contacts")
    return (*warnings, *free_joints(system), *unconfirmed(result.states))
