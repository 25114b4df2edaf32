"""Results of a robot study or audit as sentences: the answer, and warnings with remedies."""

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from ..analysis.margin_record import GainLimit
from ..errors import at_frequency, digits, frequency_text, listed
from ..studies.analysis import THIS_STATE
from ..studies.state import State, task_headroom
from ..system.controller import gain_matrix
from ..system.plausibility import NO_DATA, NO_STIFFNESS, doubts_first
from ..system.system import System
from .joint_text import (
    CONTINUOUS,
    at_usual_rate_text,
    lost_at_usual_rate,
    undamped_link_feedback,
    vibration_starts,
)
from .margin_columns import short_text
from .number_format import rounded_up
from .words import LEVELS, UNSTABLE, headline

if TYPE_CHECKING:
    from ..studies.robot import RobotStudy

EXACT_ROBOT = "stiffness, damping, inertia and delay are taken as exact; give uncertainty: for gains that hold over a range"
COUPLED = 0.95
"""Ratio of the limit to the tightest joint's own below which coupling is reported."""


def sentence(study: "RobotStudy") -> str:
    """Verdict, unmet requirements, gain limit with frequency, state and joints, cost of coupling, and limitations, as text.

    A study that lacks some of the robot's states (Analysis.examined) begins with its scope, unless one of them is unstable.
    """
    parts = [_so_far(study, _verdict(study)), *_lost_tasks(study), *_weak_tasks(study)]
    unlimited = [state.title for state in study.without_limit]
    if unlimited:
        parts.append(f"In {listed(unlimited)} only the verdict is known, not the gain limit.")
    if study.immobile:
        parts.append(f"In {listed([state.title for state in study.immobile])} {study.immobile[0].reason}.")
    return " ".join(parts)


def _so_far(study: "RobotStudy", text: str) -> str:
    """Verdict `text` that begins with the examined states, "So far, in …:", and leaves "Safe" out; unchanged if all are examined.

    Unchanged also if a state is unstable: the robot then is not safe, whatever the others are.
    """
    if not study.examined or not study.stable:
        return text
    text = text.removeprefix(f"{LEVELS['safe']}: ")
    return f"{'In' if study.examined == THIS_STATE else 'So far, in'} {study.examined}: {text[0].lower()}{text[1:]}"


def _lost_tasks(study: "RobotStudy") -> list[str]:
    """Sentence on tasks, not closed by the file's controller, that are unstable in some states; [] otherwise."""
    lost = study.unstable_tasks
    if not lost:
        return []
    worst = min(lost, key=task_headroom)
    count = len(study.states)
    some = "all" if len(lost) == count else f"{len(lost)} of"
    where = "" if count == 1 else f" in {some} {count} states, worst in {worst.title}"
    return [f"The file's tasks, closed in place of the joints' gains, are UNSTABLE{where}{_at_most(worst.task_limit)}."]


def _weak_tasks(study: "RobotStudy") -> list[str]:
    """Sentence on such tasks that are stable, but with less gain margin than required; [] otherwise."""
    state = study.weakest_tasks
    if state is None or state.task_limit is None:
        return []
    limit = state.task_limit
    at = at_frequency(limit.frequency, ", ")
    short = short_text(study.system.requirements, {"gain_margin": limit.gain})
    return [f"If you run the file's task-space gains instead (control.space: task): {short} in {state.title}{at}."]


def _uncontrolled(study: "RobotStudy") -> list[str]:
    """Sentences on motions that no task controls: the verdict on the tasks counts them as at rest."""
    found: dict[str, list[str]] = {}
    for state in study.states:
        if state.tasks is not None and state.tasks.moves and state.tasks.tasks.free:
            tasks = state.tasks.tasks
            found.setdefault(f"the tasks leave {tasks.free} of {tasks.motions} joint motions uncontrolled", []).append(state.title)
    return [f"In {listed(titles)} {text}, so they drift. Add a posture task." for text, titles in found.items()]


def _verdict(study: "RobotStudy") -> str:
    worst, count = study.tightest, len(study.states)
    limit, where = worst.limit, f"in {worst.title}"
    act = " in which the gains act" if study.immobile else ""
    act += " examined so far" if study.examined and count > 1 else ""
    every = "" if study.examined else f"{' in the one state' if act else ''}{act}" if count == 1 else f" in all {count} states{act}"
    every += " without the robot's weight" if study.topples else ""
    unstable = sum(not state.limit.stable for state in study.states)
    if unstable and study.verdict.level == "undecided":
        return headline(study, every)
    at, joints = frequency_text(limit.frequency), listed(worst.limiting_joints)
    if not unstable:
        start = headline(study, every)
        if study.unstable_case:
            return start
        if study.without_limit and not math.isfinite(limit.gain):
            return start
        if math.isinf(limit.gain):
            return f"{start} No common factor up to 1000 on these gains makes the modelled robot vibrate.{at_usual_rate_text(study)}"
        begins = "Nominally, vibration starts" if study.system.uncertainty.names else vibration_starts(study)
        limited = f"{begins} at {digits(limit.gain, '×', 3)} these gains, at {at} {where}, mainly {joints}.{_coupling(worst)}"
        return f"{start} {limited}{at_usual_rate_text(study)}"
    every = f" in {worst.title}" if study.examined else every
    start = f"{UNSTABLE}{every}" if count == 1 else f"{UNSTABLE} in {unstable} of {count} states{act}"
    if study.softest is not None:
        least = digits(rounded_up(study.softest.lower_gain), "×", 3)
        return f"{start}: too soft to hold the robot against gravity, which in {study.softest.title} takes more than {least} these gains."
    if worst.loop.topples:
        higher = "" if worst.toppled_below is None else "; no higher gains in the same ratio were found that hold it and do not vibrate"
        return f"{start}: too soft to hold the robot against gravity {where}{higher}."
    if math.isnan(limit.gain):
        return f"{start}: the robot vibrates {where}."
    if limit.gain > 0 and math.isfinite(limit.gain):
        return (
            f"{start}. Scaled together, these gains are stable only below {digits(limit.gain, '×', 3)}, with no margin there; vibration "
            f"starts at {at} {where}, mainly {joints}.{_coupling(worst)}"
        )
    return f"{start}: no lower gains in the same ratio are stable {where}."


def _coupling(state: State) -> str:
    """Sentence on the cost of coupling: the limit of the tightest joint with all other loops open, if it is higher; "" otherwise."""
    alone = min((limit for limit in state.limits_others_open.tolist() if not math.isnan(limit)), default=math.nan)
    if not state.limit.gain < COUPLED * alone:
        return ""
    return f" With all other loops open the tightest joint allows {digits(alone, '×', 3)}; coupling lowers it."


def warnings(study: "RobotStudy") -> tuple[str, ...]:
    """Warnings that change the decision, each with its remedy."""
    system, in_tasks = study.system, study.system.control.space == "task"
    found = [f"{state.title}: the tasks' gains are unstable{_at_most(state.task_limit)}" for state in study.unstable_tasks]
    found += [*lost_at_usual_rate(study), *_immobile(study)]
    found += _uncontrolled(study) if in_tasks else []
    found += [*unconfirmed(study.states), *free_joints(system), *_toppling(study)]
    found += _of_weights(study, own_space=True)
    found += [text for text in system.assumptions if text.startswith((NO_DATA, NO_STIFFNESS))]
    found += [*_undamped(study), *system.warnings]
    found += [CONTINUOUS] if study.system.rate_is_missing and study.recommended_at_usual_rate is None else []
    return tuple(doubts_first(list(dict.fromkeys(found))))


def notes(study: "RobotStudy") -> tuple[str, ...]:
    """Further notes for the user."""
    system, in_tasks = study.system, study.system.control.space == "task"
    found = _unstable(study)
    found += [f"{state.title}: {text}" for state in study.states if state.tasks is not None for text in state.tasks.tasks.warnings]
    found += [] if in_tasks else _uncontrolled(study)
    found += _of_weights(study, own_space=False)
    found += _weightless(study)
    found += [CONTINUOUS] if study.system.rate_is_missing and study.recommended_at_usual_rate is not None else []
    found += [] if system.uncertainty.names else [EXACT_ROBOT]
    return tuple(dict.fromkeys(found))


def _of_weights(study: "RobotStudy", own_space: bool) -> list[str]:
    """Warnings about the weight under recommended gains in the file's own space, or in others."""
    from .recommended_gains import weight_warnings  # loads the search for gains, which audits do without

    space = study.system.control.space
    return [text for gains in study.recommended for text in weight_warnings(gains) if (gains.space == space) is own_space]


def unconfirmed(states: Iterable[State]) -> list[str]:
    """Warning with the states in which a limit or margin is not certified; [] if all are."""
    names = [state.title for state in states if not state.margins.certified]
    if not names:
        return []
    return [f"{listed(names)}: a limit or margin is an estimate: its roots could not be counted on both sides, so it is not certified"]


def _unstable(study: "RobotStudy") -> list[str]:
    limit = study.tightest.limit
    if limit.stable or not 0 < limit.gain < math.inf:
        return []
    return [f"these gains are unstable: multiply all of them by less than {digits(limit.gain, '', 3)}"]


def _immobile(study: "RobotStudy") -> list[str]:
    """Warnings about states without a verdict, and states whose verdict has no limit."""
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
    """Warning about joints without a restoring torque: the verdict counts their drift as at rest."""
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


def _toppling(study: "RobotStudy") -> list[str]:
    """Warning that the weight, which is not included, topples the robot on the file's gains; [] otherwise, and if a controller holds it."""
    if not study.topples or study.system.balance == "controller":
        return []
    return [
        f"with its weight the robot topples on these gains in {listed(study.topples)}: a balance controller must prevent that; "
        "model.gravity_stiffness: true counts the weight, false says that it is compensated"
    ]


def _weightless(study: "RobotStudy") -> list[str]:
    """Warning that gravity is left out for a standing robot; [] otherwise."""
    robot = study.system.source
    if study.topples or robot.gravity or robot.body.base == "fixed" or not any(robot.contacts.values()):
        return []
    return ["gravity is left out: a standing robot has less margin at low frequencies, and may topple; set model.gravity_stiffness: true"]


def _undamped(study: "RobotStudy") -> list[str]:
    """Warnings about springs without damping."""
    actuators = study.system.source.actuators
    if not np.any(np.isfinite(actuators.stiffness) & (actuators.damping == 0)):
        return []
    if study.system.control.feedback.link:
        return [undamped_link_feedback(study, "the robot")]
    if any(not state.limit.stable and state.limit.gain == 0 for state in study.states):
        return [
            "undamped elastic joints oscillate without decay where no gain acts on them, and vibrate at any gain where the lag of delay "
            "and drive destabilises them: measure damping and give it"
        ]
    return []


def _at_most(limit: GainLimit | None) -> str:
    if limit is None or math.isnan(limit.gain):
        return "; their gain limit is not known"
    return f"; scale them below {digits(limit.gain, '×', 3)}" if limit.gain > 0 else "; no lower gains in the same ratio are stable"
