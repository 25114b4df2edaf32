"""What a study or an audit of a robot says in sentences: the answer, and what a user should know or do."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from ..analysis.gain_limit import GainLimit
from ..analysis.margins import to_db
from ..design.robot_gains import GainSet, RobotGains
from ..errors import apart, beside, frequency_in_words, listed
from ..studies.audit import Audit
from ..studies.robot import RobotStudy
from ..studies.state import HELD, State, by_headroom
from ..system.controller import gain_matrix
from ..system.requirements import REQUIREMENTS, title_of
from ..system.system import System
from .joint_text import CONTINUOUS, NOT_EVERYWHERE

SLIGHT = 0.05
"""Damping ratio of a motor on its spring that is proposed for a trial where none was given; gearboxes have more than nothing."""
COUPLED = 0.95
"""Below this share of the tightest joint's own limit, coupling between joints costs something worth saying."""


def sentence(study: RobotStudy) -> str:
    """The answer in one sentence: verdict, room, frequency, joints, and what the coupling costs; more where something is not known."""
    told = [_verdict(study), *_lost_tasks(study), *_unmet(study)]
    if study.unstable_at:
        told[0] = f"{NOT_EVERYWHERE}: unstable in {study.unstable_at}. As stated: {told[0][0].lower()}{told[0][1:]}"
    blind = [state.title for state in study.without_limit]
    if blind:
        told.append(f"In {listed(blind)} only the verdict is known, not how far the gains may go.")
    if study.immobile:
        told.append(f"In {listed([state.title for state in study.immobile])} {study.immobile[0].reason}.")
    return " ".join(told)


def _unmet(study: RobotStudy) -> list[str]:
    """What is asked for and not kept."""
    asked, parts = study.system.requirements, []
    for name, state in study.unmet.items():
        one, needed = REQUIREMENTS[name], asked.needed[name]
        value = one.value(state.margins)
        figures = "not known"
        if not math.isnan(value):
            told = one.text(value, apart(one.in_unit(value), one.in_unit(needed), 3))
            figures = f"{told}{', at most' if one.at_most else ' of'} {one.text(needed)}"
        parts.append(f"{one.named(state.margins)} ({figures}, {state.title})")
    return [f"Not as required: {listed(parts)}."] if parts else []


def _lost_tasks(study: RobotStudy) -> list[str]:
    """That the file's tasks, which are not what is closed, are unstable in some states."""
    lost = study.unstable_tasks
    if not lost:
        return []
    worst = min(lost, key=lambda state: by_headroom(_tasks_limit(state)))
    gain, count = _tasks_limit(worst).gain, len(study.states)
    share = "all" if len(lost) == count else f"{len(lost)} of"
    where = "" if count == 1 else f" in {share} {count} states, worst of all in {worst.title}"
    return [f"But the file's tasks, closed in the joints' place, are UNSTABLE{where}{_at_most(gain)}."]


def _tasks_limit(state: State) -> GainLimit:
    assert state.tasks is not None
    return state.tasks.limit


def _adrift(study: RobotStudy) -> list[str]:
    """Motions that no task holds: the verdict on the tasks counts them as at rest."""
    found: dict[str, list[str]] = {}
    for state in study.states:
        if state.tasks is not None and state.tasks.moves and state.tasks.tasks.free:
            tasks = state.tasks.tasks
            found.setdefault(f"{tasks.free} of the joints' {tasks.motions} motions are held by no task", []).append(state.title)
    return [f"{listed(titles)}: {text}: in task space they drift; add a posture task" for text, titles in found.items()]


def _verdict(study: RobotStudy) -> str:
    worst, count = study.tightest, len(study.states)
    where = f"in posture {worst.posture}, contact {worst.contact}"
    limit = worst.limit
    act = " in which the gains act" if study.immobile else ""
    every = f"{' in the one state' if act else ''}{act}" if count == 1 else f" in all {count} states{act}"
    unstable = sum(not state.limit.stable for state in study.states)
    if not unstable and study.without_limit and not math.isfinite(limit.gain):
        return f"Stable{every}."
    if not unstable and math.isinf(limit.gain):
        return f"Stable{every}: no common factor up to 1000 on these gains makes the modelled robot vibrate."
    at = frequency_in_words(limit.frequency)
    joints = listed(worst.limiting_joints)
    if not unstable:
        return (
            f"Stable{every}: these gains can be multiplied by {limit.gain:.3g} ({to_db(limit.gain):.3g} dB) before the robot vibrates, "
            f"first {where}, at {at}, most of all {joints}{_coupling(worst)}."
        )
    start = f"Unstable{every}" if count == 1 else f"Unstable in {unstable} of {count} states{act}"
    if math.isnan(limit.gain):
        return f"{start}: with these gains the robot vibrates {where}."
    if limit.gain > 0 and math.isfinite(limit.gain):
        return (
            f"{start}: with these gains the robot vibrates; {where} it is stable below {limit.gain:.3g} times them, where {joints} would "
            f"vibrate at {at}{_coupling(worst)}."
        )
    return f"{start}: with these gains the robot does not settle {where}, and no common factor that lowers them makes it stable."


def _coupling(state: State) -> str:
    """What the joints cost each other, against the tightest of them alone."""
    alone = min((row.single_joint_limit for row in state.joints if not math.isnan(row.single_joint_limit)), default=math.nan)
    if state.limit.gain < COUPLED * alone:
        return f"; joint by joint it would be {alone:.3g}: the coupling costs the rest"
    return ""


def warnings(study: RobotStudy) -> tuple[str, ...]:
    """What a user should know or do, each with the remedy."""
    system = study.system
    found = _unstable(study)
    found += [f"{state.title}: the tasks' gains are unstable{_at_most(_tasks_limit(state).gain)}" for state in study.unstable_tasks]
    found += _still(study)
    found += [f"{state.title}: {text}" for state in study.states if state.tasks is not None for text in state.tasks.tasks.warnings]
    found += _adrift(study)
    found += [*unconfirmed(study.states), *free_joints(system), *_weightless(study), *_gains_to_use(study)]
    found += [*_undamped(study), *system.warnings]
    if system.control.sample_time is None and system.delay > 0:
        found.append(CONTINUOUS)
    if not system.uncertainty.names:
        found.append("stiffness, damping, inertia and delay are taken as exact; give uncertainty: for gains that hold over a range")
    return tuple(dict.fromkeys(found))


def unconfirmed(states: Iterable[State]) -> list[str]:
    """A warning that names the states in which a limit or margin is not certified."""
    names = [state.title for state in states if not state.margins.certified]
    if not names:
        return []
    return [
        f"{listed(names)}: a limit or margin is not certified, as its roots could not be counted on both sides: treat it as an estimate"
    ]


def _unstable(study: RobotStudy) -> list[str]:
    limit = study.tightest.limit
    if limit.stable or not 0 < limit.gain < math.inf:
        return []
    return [f"these gains are unstable: multiply all of them by less than {limit.gain:.3g}"]


def _still(study: RobotStudy) -> list[str]:
    """The states without a verdict, and those whose verdict has no limit."""
    found = []
    if study.immobile:
        remedy = "lock those joints, or check the contacts"
        if study.system.control.space == "task":
            remedy = "control it in joint space or with a posture task, or leave it out"
        reason = study.immobile[0].reason
        titles = listed([state.title for state in study.immobile])
        found.append(f"{titles}: {reason} in this contact state: no verdict and no limit there; {remedy}")
    blind = [state.title for state in study.without_limit]
    if blind:
        found.append(
            f"{listed(blind)}: the verdict is counted from the roots, but the loci could not be followed to a limit, so how far the gains "
            "may go is not known; give undamped joints their damping, and gains of like size to joints that work together"
        )
    return found


def free_joints(system: System) -> list[str]:
    """Joints that nothing brings back: the verdict counts their drift as at rest."""
    if system.control.controller is None:
        return []
    kept = np.zeros(system.source.body.size)
    for powers, gain in system.control.controller.terms().items():
        if powers in ((0, 0), (0, 1), (1, 1)):
            kept += np.abs(np.diagonal(gain_matrix("gain", gain, len(kept))))
    names = [name for name, some in zip(system.source.joint_names, kept.tolist(), strict=True) if not some]
    if not names:
        return []
    several = len(names) > 1
    return [
        f"{listed(names)}: kp is 0: {'these joints are' if several else 'this joint is'} free and drift{'' if several else 's'}, whatever "
        f"the verdict on the others; give {'them' if several else 'it'} kp, or lock {'them' if several else 'it'}"
    ]


def _weightless(study: RobotStudy) -> list[str]:
    """What leaving gravity out means for a robot that stands."""
    robot = study.system.source
    if robot.gravity or robot.body.base == "fixed" or not any(robot.contacts.values()):
        return []
    return ["gravity is left out: on its feet the robot keeps less at low frequencies, and may topple; set model.gravity_stiffness: true"]


def _gains_to_use(study: RobotStudy) -> list[str]:
    """Recommended gains that do not keep what is required with the robot's weight, or that there are not."""
    told = []
    for gains in study.recommended:
        if gains.unweighed:
            why = "as contacts there leave the base free to move; take a foot as flat and rigid"
            told.append(f"gains to use: the weight is left out in {listed(list(gains.unweighed))}, {why}")
        for name, one in {"every state": gains.everywhere, **gains.per_contact}.items():
            if one is None or not one.without_weight or (one is not gains.everywhere and name in _same(gains)):
                continue
            text = (
                f"gains to use, {gains.space} space, {name}: with the robot's weight none were found that keep what is required (the "
                f"nearest: {one.nearest}); those that are told keep it without the weight, as where it is compensated, and "
            )
            lost = f"the robot topples on them in {listed(list(one.topples))}: a controller of its balance has to hold it up"
            told.append(text + (lost if one.topples else "hold the robot up"))
    return told


def held_back(found: GainSet, names: Sequence[str]) -> str:
    """What keeps the softest joint or direction from more: itself, the margin, and the state."""
    margin = title_of(found.margin[found.softest]) if found.margin else ""
    weight = ", without the weight" if found.without_weight else ""
    return f"{names[found.softest]}: {margin}, {found.binding}{weight}" if margin else f"nothing that was found{weight}"


def _same(gains: RobotGains) -> list[str]:
    """Contact states whose set is the one for all."""
    safe = gains.everywhere
    return [name for name, one in gains.per_contact.items() if safe is not None and one is not None and one.kp is safe.kp]


def _undamped(study: RobotStudy) -> list[str]:
    """What springs without damping mean for the answer."""
    actuators = study.system.source.actuators
    if not np.any(np.isfinite(actuators.stiffness) & (actuators.damping == 0)):
        return []
    if study.system.control.feedback == "link":
        return [
            "link-side feedback on undamped elastic joints: whether their resonances settle hangs on the lag of delay and drive alone, "
            "and without lag they never do: measure damping, or close the loops on the motor side"
        ]
    if any(not state.limit.stable and state.limit.gain == 0 for state in study.states):
        return [
            "undamped elastic joints ring for ever where no gain reaches them, and vibrate where the lag of delay and drive turns torque "
            "against their motion, at any gain: measure damping and give it"
        ]
    return []


def _at_most(gain: float) -> str:
    if math.isnan(gain):
        return "; how far they would have to be lowered is not known"
    return f"; they may be scaled by {gain:.3g} at most" if gain > 0 else ", and no factor that lowers them makes them stable"


def audit_sentence(result: Audit) -> str:
    """The answer in one sentence."""
    worst, count = result.tightest, sum(not joint.safe for joint in result.joints)
    limit = worst.limit
    delays = f"it vibrates from {1e3 * result.delay_limit:.3g} ms of delay" if math.isfinite(result.delay_limit) else "no delay does"
    delays = "without delay, too" if result.delay_limit == 0 else delays
    delays = "from which delay is not known" if math.isnan(result.delay_limit) else delays
    given = f"{1e3 * result.system.delay:.3g} ms"
    if not limit.stable:
        room = (
            f"multiply them by less than {limit.gain:.3g}"
            if limit.gain > 0
            else f"no lower gains in the same ratio help{_try_damping(result)}"
        )
        room = "whether lower gains help is not known" if math.isnan(limit.gain) else room
        return f"Not safe: the robot vibrates with these gains at {given} of delay ({delays}); {room}; {_count(count, result)}."
    unknown = [state.contact for state in result.states if math.isnan(state.limit.gain)]
    if unknown:
        return f"Not safe: it is stable, but how far these gains may go in {listed(unknown)} is not known; {_count(count, result)}."
    at = f" at {limit.frequency / (2 * math.pi):.3g} Hz" if math.isfinite(limit.frequency) else ""
    factors, levels = (limit.gain, result.margin), (to_db(limit.gain), to_db(result.margin))
    enough = result.enough_in(worst)
    factor, level = (f"{pair[0]:.3g}" if enough else beside(*pair) for pair in (factors, levels))
    room = f"all gains can be multiplied by {factor} ({level} dB) before it vibrates{at}"
    room = "no common factor on all gains makes it vibrate" if math.isinf(limit.gain) else room
    asked = f"{result.margin:.3g} ({to_db(result.margin):.2g} dB)"
    if not result.safe:
        short = f"but a joint by itself has less than the {asked} asked for" if enough else f"less than the {asked} asked for"
        return f"Not safe: {room}, {short}; {delays}; {_count(count, result)}."
    return f"Safe: {room}; {delays}, and has {given}."


def _try_damping(result: Audit) -> str:
    """Why no lower gains help where gearboxes were given no damping, and a number to try: a twentieth of the critical damping."""
    actuators = result.system.source.actuators
    bare = np.isfinite(actuators.stiffness) & (actuators.damping == 0)
    if not np.any(bare):
        return ""
    try_it = 2 * SLIGHT * np.sqrt(np.median(actuators.stiffness[bare] * actuators.motor_inertia[bare]))
    return (
        " while the gearboxes' damping is taken as 0: measure it, or try a little: "
        f"--damping {try_it:.1g} is {100 * SLIGHT:.0f} % of critical"
    )


def _count(unsafe: int, result: Audit) -> str:
    return f"{unsafe} of {len(result.joints)} joints {'is' if unsafe == 1 else 'are'} not safe"


def audit_warnings(result: Audit) -> tuple[str, ...]:
    """What was assumed, and what a user should do about it."""
    system = result.system
    warnings = list(system.warnings)
    if system.control.sample_time is None:
        warnings.append("continuous model: hold and velocity difference of a real controller cost about one more tick; give --rate-hz")
    if result.immobile:
        contacts = listed([state.contact for state in result.immobile])
        warnings.append(f"{contacts}: {HELD} in this contact state: nothing is judged there; check the contacts")
    return (*warnings, *free_joints(system), *unconfirmed(result.states))
