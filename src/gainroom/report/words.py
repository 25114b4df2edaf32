"""Every sentence about whether a system is safe: nothing else in the package says so in words.

A headline names the verdict, what decides it with its numbers and places, and, where something is not known, what gives it.
"""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

from ..errors import apart, at_frequency, frequency_text, listed
from ..studies.state import USUAL_RATE
from ..system.requirements import REQUIREMENTS

if TYPE_CHECKING:
    from ..studies.analysis import Analysis
    from ..studies.simulation import Outcome
    from ..studies.simulator_audit import SimulatorAudit
    from ..studies.sweep.summary import SweepSummary
    from ..studies.swept_margins import WorstStates
    from ..studies.two_paths import PathStudy
    from ..studies.verdict import Finding, Level, Verdict

LEVELS: "Mapping[Level, str]" = {"safe": "Safe", "unsafe": "Not safe", "undecided": "Not decided"}
NOT_SAFE = LEVELS["unsafe"]
UNSTABLE = f"{NOT_SAFE}: unstable"
AT_USUAL = f"{USUAL_RATE / 1e3:g} kHz"
SOFTER = "On softer gearboxes these gains may not be safe."
MOST_NAMES = 3
"""Names of joints or links in a sentence, at most."""


def headline(study: "Analysis", where: str = "", reading: str = "") -> str:
    """The verdict on a system that is stable at its nominal values, or not decided: a sentence or two.

    where     in which states and gearboxes it is safe, as text with a blank before
    reading   what is known of each way to read what may be read in two ways, a sentence
    """
    level = study.verdict.level
    if level == "undecided":
        return _undecided(study, where, reading)
    if level == "safe":
        return f"{LEVELS[level]}{where}: {_all_met(study)}.{_left_to_a_controller(study)}"
    if not study.stable:
        return f"{UNSTABLE}.{without_motors(study)}"
    if study.unstable_case:
        return f"{LEVELS[level]}: stable nominally, but not everywhere in the uncertainty ranges: unstable {_case(study)}."
    other = [OTHERS[one.code] for one in study.verdict.deciding if one.code in OTHERS]
    if not study.unmet:
        return f"{LEVELS[level]}{where}: {listed(other)}."
    there = where if len(study.states) == 1 else ""
    rest = f"{_nominally(study)}{_of_sway(study)}{without_motors(study)}"
    return f"{stable_but(_known_to_fail(study), _time(study))}{there}{_failing(study)}.{rest}"


OTHERS = {
    "unsafe_in_gearbox_range": "somewhere in the range too little is left of what is required",
    "unsafe_at_usual_rates": "at every usual rate of the loop too little is left of what is required",
}
"""Reasons beside a system's own states why it is unsafe, by a finding's code."""


def without_motors(study: "Analysis") -> str:
    """A sentence where an unsafe verdict was computed with motors without inertia, as it was not given; "" elsewhere."""
    found = [one for one in study.verdict.findings if one.code == "motor_inertia_unknown"]
    return f" Motor inertias, which are not given, count as {motor_inertias(study)} here ({found[0].remedy})." if found else ""


def motor_inertias(study: "Analysis") -> str:
    """The value, as text, of motor inertias that nobody gave: 0 on rigid gearboxes, a share of what they move on elastic ones."""
    from ..robot.actuators import LIKELY  # of robots, which a joint does without

    actuators, share = study.system.source.actuators, f"{LIKELY:g} × what they move"
    guessed = actuators.guessed[actuators.without_inertia]
    return share if guessed.all() else f"0 (elastic joints: {share})" if guessed.any() else "0"


def stable_but(count: int, time: str = "") -> str:
    """The begin of the verdict on a stable loop of which `count` ≥ 1 requirements fail; `time`: " in continuous time"."""
    return f"{NOT_SAFE}: stable{time}, but {count} requirement{'s fail' if count > 1 else ' fails'}"


def safe_means(asked: str, beside: bool = False) -> str:
    """The legend of a column "safe"; `asked`: the gain margin; `beside`: each margin stands beside it, marked where it misses."""
    return "safe: none is missed" if beside else f"safe: {asked} or more, and all else that is required"


def unsafe_joints(count: int, of: int) -> str:
    """The number of joints whose gains are not safe, a sentence."""
    return f"{count} of {of} joints {'is' if count == 1 else 'are'} not safe." if count else "No joint is unsafe."


def in_simulator(verdict: str, simulated: "SimulatorAudit | None") -> str:
    """An audit's verdict, as that of the robot alone where the simulator does not hold the gains."""
    if simulated is None or simulated.limit.stable:
        return verdict
    return f"On the robot: {verdict} These gains are unstable in the simulator: see below."


def _undecided(study: "Analysis", where: str, reading: str) -> str:
    """The verdict that is not decided: what is not known and what gives it, then what holds, or fails, as it was computed without."""
    why = [REASONS[one.code](one) for one in study.verdict.deciding if one.code in REASONS]
    unknown = [name for name, state in study.unmet.items() if math.isnan(study.least(state, name))]
    why += [f"the {REQUIREMENTS[name].title}{_in_state(study, name)} is not known" for name in unknown]
    lost = study.unstable_at_usual_rate
    if lost is not None:
        there = f" in {lost.title}" if len(study.states) > 1 else ""
        why.append(f"in a loop at {AT_USUAL} these gains would be unstable{there}")
    start = f"{LEVELS['undecided']}: {'; '.join(filter(None, [reading.rstrip('.'), *why]))}."
    if not study.system.requirements.asked and study.stable:
        return f"{start} The gains are stable{where}."
    return f"{start} {_as_computed(study)}{_otherwise(study)}"


def _otherwise(study: "Analysis") -> str:
    """A sentence with the verdict under the other value of what was assumed: "With …: not safe."; "" where no other value was examined."""
    unsafe = not study.stable_in_range or bool(_known_to_fail(study))
    told = dict.fromkeys(  # what two unknowns decide together is told once
        f"with {one.readings[-1].text}: {LEVELS[one.readings[-1].level].lower()}"
        for one in study.verdict.findings
        if one.code in ASSUMED and one.readings and (unsafe or one.code != "rate_unknown")
    )
    return f" {'; '.join(told)}.".replace(" w", " W", 1) if told else ""


def _as_computed(study: "Analysis") -> str:
    """The numbers that do not decide, a sentence."""
    codes = {one.code for one in study.verdict.findings}
    assumed = [text(study) for code, text in ASSUMED.items() if code in codes]
    as_read = f"{' and '.join(assumed)}".capitalize() if assumed else "As it was read"
    if not study.stable:
        return f"{as_read} the gains are unstable."
    if study.unstable_case:
        return f"{as_read} the gains are unstable {_case(study)}."
    if study.sway_is_open:
        return f"If the joints have to: {_failing(study).lstrip(', :')}. If a controller above them does: {_all_met(study.balanced)}."
    if _known_to_fail(study):
        return f"{as_read}: {_failing(study).lstrip(', :')}.{_nominally(study)}"
    if study.unmet:
        return f"{as_read} all that is known is met."
    return f"{as_read} {_all_met(study)}."


ASSUMED: "Mapping[str, Callable[[Analysis], str]]" = {
    "rate_unknown": lambda study: "in continuous time",
    "gearbox_unknown": lambda study: "with rigid gearboxes",
    "motor_inertia_unknown": lambda study: f"with motor inertias of {motor_inertias(study)}",
}
"""Assumptions that a system was computed with, by a finding's code."""
REASONS: "Mapping[str, Callable[[Finding], str]]" = {
    "rate_unknown": lambda one: f"the loop's rate is not given, and any rate costs margin ({one.remedy})",
    "gearbox_unknown": lambda one: f"the stiffness of {_gearboxes(one)} is not given ({one.remedy})",
    "motor_inertia_unknown": lambda one: f"the inertia of {_whose(one, 'the motors', 'the motor of')} is not given ({one.remedy})",
    "implausible": lambda one: "; ".join(one.joints),
    "sway": lambda one: f"{_swaying(one)}, and who has to damp that is not said ({one.remedy}: joints or controller)",
    "topples_with_weight": lambda one: (
        f"with its weight the robot topples on these gains in {one.state}, and whether that is compensated is not said ({one.remedy})"
    ),
    "nothing_required": lambda one: f"no margin is required ({one.remedy})",
}
"""Reasons why nothing is decided, by a finding's code."""


def _swaying(one: "Finding") -> str:
    """The sway in a clause: "the base sways on its contacts at 0.63 Hz in stand/left, damping ratio 0.078"."""
    ratio = one.values["damping_ratio"]
    damped = "" if math.isnan(ratio) else f", damping ratio {ratio:.2g}"
    topples = ", and topples with its weight" if one.values["topples_with_weight"] else ""
    return f"the base sways on its contacts{at_frequency(one.values['frequency_rad_s'])} in {one.state}{damped}{topples}"


def _of_sway(study: "Analysis") -> str:
    """A sentence where what is missed is the sway of the base, which the joints are said to damp."""
    names = [REQUIREMENTS[name].title for name in study.swaying]
    found = [one for one in study.verdict.findings if one.code == "sway"]
    if not names or not found:
        return ""
    whose = "This is no vibration"
    if len(names) < len(study.unmet):
        whose = f"{listed(names)} {'are' if len(names) > 1 else 'is'} missed by sway alone, which is no vibration".capitalize()
    return f" {whose}: {_swaying(found[0])}."


def _left_to_a_controller(study: "Analysis") -> str:
    """A sentence where a safe verdict rests on a controller that damps sway."""
    found = [one for one in study.verdict.findings if one.code == "sway"]
    return f" A controller above the joints has to damp this: {_swaying(found[0])}." if found else ""


def _gearboxes(one: "Finding") -> str:
    return _whose(one, "the gearboxes", "the gearbox of")


def _whose(one: "Finding", many: str, single: str) -> str:
    """The joints by name where they are few: "the gearbox of knee", "the gearboxes"."""
    names = one.joints
    return f"{single} {names[0]}" if len(names) == 1 else f"{many} of {listed(names)}" if len(names) <= MOST_NAMES else many


def _all_met(study: "Analysis") -> str:
    """A clause that every requirement is met, in which cases, and which has the least to spare."""
    examined = "" if study.requirements_met else " examined"
    least = tightest(study)
    return f"every requirement is met{in_the_worst_case(study, examined)}{f'; the tightest is {least}' if least else ''}"


def tightest(study: "Analysis") -> str:
    """The requirement with the least to spare: "phase margin 30° (≥ 30°)"; "" where none is asked for."""
    name, asked = study.decisive, study.system.requirements
    if not name:
        return ""
    one = REQUIREMENTS[name]
    return f"{one.heading} {one.text(study.least(study.worst[name], name))} ({one.sign} {one.text(asked.needed[name])})" + _in_state(
        study, name
    )


def _in_state(study: "Analysis", name: str) -> str:
    return f" in {study.worst[name].title}" if len(study.states) > 1 else ""


def _case(study: "Analysis") -> str:
    """The case in the ranges in which gains are unstable: "at delay 3 ms", of a robot "in stand/left (delay 3 ms)"."""
    return f"{'in' if study.states[0].posture else 'at'} {study.unstable_case}"


def _time(study: "Analysis") -> str:
    return " in continuous time" if study.system.rate_is_missing else ""


def in_the_worst_case(study: "Analysis", proved: str = "") -> str:
    """The ranges over which a margin is the worst; "" where the file has none."""
    names = [name.replace("_", " ") for name in study.system.uncertainty.names]
    return f" in the worst case of uncertain {listed(names)}{proved}" if names else ""


def _nominally(study: "Analysis") -> str:
    """Requirements that fail at nominal values, too, of those that fail in the worst case, a sentence; "" where nothing is uncertain."""
    if not study.system.uncertainty.names:
        return ""
    asked = study.system.requirements
    fail = [
        REQUIREMENTS[name].heading
        for name in study.unmet
        if any(asked.met(name, REQUIREMENTS[name].value(state.counted)) is False for state in study.states)
    ]
    if len(fail) == len(study.unmet):
        return " Nominally, too."
    return f" Nominally {listed(fail)} {'fail' if len(fail) > 1 else 'fails'}, too." if fail else " Nominally none fails."


def _known_to_fail(study: "Analysis") -> int:
    """The number of requirements that fail; those whose margin is not known are not counted."""
    return sum(not math.isnan(study.least(state, name)) for name, state in study.unmet.items())


Tone = Literal["good", "warn", "bare", "bad"]
SHAKES = ("unstable", "topples", "unstable_in_range", "unstable_in_simulator", "vibrates", "ran_away", "diverged", "fell")
"""Findings, by code, that make a system unsafe and are no margin."""


def tone(verdict: "Verdict") -> Tone:
    """The look of a verdict on every page: safe, not decided, short of a requirement, unstable."""
    if verdict.level != "unsafe":
        return "good" if verdict.level == "safe" else "warn"
    return "bad" if any(one.code in SHAKES for one in verdict.deciding) else "bare"


def _failing(study: "Analysis") -> str:
    """The unmet requirements: ": phase margin 26.1° (≥ 30°) at 2.88 Hz, Ms 2.28 (≤ 2) at 77.4 Hz"; "" where there is none."""
    if not study.unmet:
        return ""
    parts, several, joints = [], len(study.states) > 1, {one.code: one.joints for one in study.verdict.findings if one.code in study.unmet}
    alike = len(set(joints.values())) == 1 and bool(next(iter(joints.values())))
    shared = len({id(state) for state in study.unmet.values()}) == 1
    for name, state in study.unmet.items():
        one, needed = REQUIREMENTS[name], study.system.requirements.needed[name]
        value, omega = study.least(state, name), one.frequency(study.worst_in(state).margins)
        shown = one.text(value, 3 if math.isnan(value) else apart(one.in_unit(value), one.in_unit(needed), 3))
        title = one.titled(study.worst_in(state).margins, len(study.system.source.joint_names) > 1, short=True)
        places = [*joints.get(name, ())[:1]] if not alike else []
        places += [frequency_text(omega)] if math.isfinite(omega) else []
        at = f" at {', '.join(places)}" if places else ""
        where = f" in {state.title}" if several and not shared else ""
        parts.append(f"{title} {shown} ({one.sign} {one.text(needed)}){where}{at}")
    worst = f", worst in {next(iter(study.unmet.values())).title}" if several and shared else ""
    worst += in_the_worst_case(study)
    mainly = f", mainly at {listed(next(iter(joints.values())), most=2)}" if alike else ""
    return f"{worst}: {('; ' if several or any(joints.values()) else ', ').join(parts)}{mainly}"


def path_headline(study: "PathStudy") -> str:
    """The verdict on a system that is stable at its nominal values and whose kd closes on a path of its own."""
    level = study.verdict.level
    fails = [f"{REQUIREMENTS[name].title} {path_worst(study, name)}" for name in study.unmet]
    if study.unstable_at:
        return f"{LEVELS['unsafe']}: stable nominally, but unstable at {study.unstable_at}."
    if level == "unsafe":
        return f"{stable_but(len(fails))}: {', '.join(fails)}."
    if level == "safe":
        return f"{LEVELS[level]}: every requirement is met."
    why = [REASONS[one.code](one) for one in study.verdict.deciding if one.code in REASONS]
    why += [f"{listed([REQUIREMENTS[name].title for name in study.unknown])} not known"] if study.unknown else []
    return f"{LEVELS[level]}: {'; '.join(why)}. The gains are stable{f', but {listed(fails)}' if fails else ''}."


def run_headline(outcome: "Outcome") -> str:
    """The verdict on the file's loop behind a run without vibration, with a blank behind; "" where the gains act on no motion."""
    study = outcome.judged
    if study is None:
        return ""
    where = f" in {outcome.spec.state}" if outcome.spec.state else ""
    if not study.stable and outcome.verdict.level == "unsafe":
        return f"{UNSTABLE}{where} without the friction of the scenario. "
    return f"{headline(study, where)} "


def swept_banner(found: "SweepSummary") -> str:
    """Over the page of a sweep in which gains are unstable: in how many postures."""
    unstable = sum(one.unstable for one in found.contacts)
    return f"NOT SAFE: unstable in {f'all {found.count}' if unstable == found.count else f'{unstable} of {found.count}'} postures"


def swept_headline(found: "SweepSummary", worst: "WorstStates", said: str, missed: str) -> list[str]:
    """The verdict on a sweep, in sentences; `said`: the lowest gain limit and where it is, `missed`: which other requirements fail."""
    from ..studies.swept_margins import swept_verdict  # loads the stores of sweeps

    verdict = swept_verdict(found, worst)
    why = [REASONS[one.code](one) for one in verdict.deciding if one.code in REASONS and verdict.level == "undecided"]
    start = f"{LEVELS[verdict.level]}{': ' + '; '.join(why) if why else ''}. "
    if verdict.level == "safe" and not worst.everywhere and worst.requirements:
        others = listed([one.requirement.title for one in worst.requirements])
        start = f"{LEVELS['safe']} where judged: {others} in {worst.count} of {found.count} postures. "
    first, second = (missed, said) if found.margin_held and missed else (said, missed)
    return [text for text in (start + first, second) if text]


def path_worst(study: "PathStudy", name: str) -> str:
    """The least of what a requirement bounds, where, and what is asked for."""
    one, (value, case) = REQUIREMENTS[name], study.worst[name]
    where = f" at {case.text}" if case.text else ""
    return f"{one.text(value)}{where} ({one.sign} {one.text(study.system.requirements.needed[name])})"
