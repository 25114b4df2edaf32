"""Sentences about safety: the only module that states in words whether a system is safe.

A headline names the verdict, what decides it with its numbers and places, and, for missing data, the option or key that gives it.
"""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

from ..errors import apart, at_frequency, digits, frequency_text, listed
from ..studies.state import USUAL_RATE
from ..system.requirements import REQUIREMENTS

if TYPE_CHECKING:
    from ..analysis.margin_record import GainLimit
    from ..studies.analysis import Analysis
    from ..studies.gain_paths import PathStudy
    from ..studies.simulation import Outcome
    from ..studies.simulator_audit import SimulatorAudit
    from ..studies.sweep.summary import SweepSummary
    from ..studies.swept_margins import WorstStates
    from ..studies.verdict import Finding, Level, Verdict

LEVELS: "Mapping[Level, str]" = {"safe": "Safe", "unsafe": "Not safe", "undecided": "Not decided"}
NOT_SAFE = LEVELS["unsafe"]
UNSTABLE = f"{NOT_SAFE}: unstable"
UNSAFE_NOT_KNOWN = "Which joints are unsafe is not known"
DASH = "; safe –: not known, as the robot misses what was not measured of this joint"
"""Legend of a dash under "safe"."""
AT_USUAL = f"{USUAL_RATE / 1e3:g} kHz"
SOFTER = "On softer gearboxes these gains may not be safe."
LEAST_LOWER = 0.1
"""Factor on all gains from which on a limit of lower gains is told: 20 dB below, only a ramp passes it."""
MOST_NAMES = 3
"""Most names of joints or links in a sentence."""


def lower_gains(limit: "GainLimit") -> str:
    """Sentence on lower gains at which a loop, stable as it is, vibrates, too; "" where there are none from LEAST_LOWER on."""
    if not limit.stable or not limit.lower_gain >= LEAST_LOWER or not limit.lower_frequency > 0:
        return ""
    below = f"below {digits(limit.lower_gain, '×', 2)} these, at {frequency_text(limit.lower_frequency)}"
    return f"Lower gains vibrate, too, {below}: neither halve nor ramp them."


def headline(study: "Analysis", where: str = "", reading: str = "") -> str:
    """Verdict on a system that is stable at its nominal values, or undecided: a sentence or two.

    where     states and gearboxes for which it is safe, as text with a leading blank
    reading   result of each reading of ambiguous input, a sentence
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
    rest = f"{_nominally(study)}{_of_sway(study) or _hardly_damped(study)}{without_motors(study)}"
    return f"{stable_but(_known_to_fail(study), _time(study))}{there}{_failing(study)}.{rest}"


OTHERS = {
    "unsafe_in_gearbox_range": "somewhere in the range too little is left of what is required",
    "unsafe_at_usual_rates": "at every usual rate of the loop too little is left of what is required",
}
"""Reasons for an unsafe verdict beyond the system's own states, by the code of the finding."""


def without_motors(study: "Analysis") -> str:
    """Sentence that an unsafe verdict was computed with assumed motor inertias; "" if they are given."""
    found = [one for one in study.verdict.findings if one.code == "motor_inertia_unknown"]
    return f" Motor inertias, which are not given, count as {motor_inertias(study)} here ({found[0].remedy})." if found else ""


def motor_inertias(study: "Analysis") -> str:
    """Assumed motor inertias as text: 0 on rigid gearboxes, a share of what they move on elastic ones."""
    from ..robot.actuators import LIKELY  # of robots, which a joint does without

    actuators, share = study.system.source.actuators, f"{LIKELY:g} × what they move"
    guessed = actuators.guessed[actuators.without_inertia]
    return share if guessed.all() else f"0 (elastic joints: {share})" if guessed.any() else "0"


def stable_but(count: int, time: str = "") -> str:
    """Beginning of the verdict on a stable loop that fails `count` ≥ 1 requirements; `time`: " in continuous time"."""
    return f"{NOT_SAFE}: stable{time}, but {count} requirement{'s fail' if count > 1 else ' fails'}"


def safe_means(asked: str, beside: bool = False) -> str:
    """Legend of a column "safe"; `asked`: the gain margin; `beside`: each margin has its own column, marked if missed."""
    return "safe: none is missed" if beside else f"safe: {asked} or more, and all else that is required"


def unsafe_joints(count: int, of: int) -> str:
    """Sentence with the number of joints whose gains are not safe."""
    return f"{count} of {of} joints {'is' if count == 1 else 'are'} not safe." if count else "No joint is unsafe."


def in_simulator(verdict: str, simulated: "SimulatorAudit | None") -> str:
    """Verdict of an audit, restricted to the robot if the simulator does not hold the gains."""
    if simulated is None or simulated.limit.stable:
        return verdict
    return f"On the robot: {verdict} These gains are unstable in the simulator: see below."


def _undecided(study: "Analysis", where: str, reading: str) -> str:
    """Undecided verdict: missing data and what gives it, then what holds or fails under the assumptions."""
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
    """Sentence with the verdict under another value of an assumption: "With …: not safe."; "" if none was examined."""
    unsafe = not study.stable_in_range or bool(_known_to_fail(study))
    verdicts = dict.fromkeys(  # what two unknowns decide together is told once
        f"with {one.readings[-1].text}: {LEVELS[one.readings[-1].level].lower()}"
        for one in study.verdict.findings
        if one.code in ASSUMED and one.readings and (unsafe or one.code != "rate_unknown")
    )
    return f" {'; '.join(verdicts)}.".replace(" w", " W", 1) if verdicts else ""


def _as_computed(study: "Analysis") -> str:
    """Sentence with the numbers that do not decide."""
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
"""Assumptions under which a system was computed, by the code of the finding."""
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
"""Reasons for an undecided verdict, by the code of the finding."""


def _swaying(one: "Finding") -> str:
    """Clause on the sway: "the base sways on its contacts at 0.63 Hz in stand/left, damping ratio 0.078"."""
    ratio = one.values["damping_ratio"]
    damped = "" if math.isnan(ratio) else f", damping ratio {ratio:.2g}"
    topples = ", and topples with its weight" if one.values["topples_with_weight"] else ""
    return f"the base sways on its contacts{at_frequency(one.values['frequency_rad_s'])} in {one.state}{damped}{topples}"


def _of_sway(study: "Analysis") -> str:
    """Sentence that the base's sway misses requirements, if the joints are stated to damp it; "" otherwise."""
    names = [REQUIREMENTS[name].title for name in study.swaying]
    found = [one for one in study.verdict.findings if one.code == "sway"]
    if not names or not found:
        return ""
    whose = "This is no vibration"
    if len(names) < len(study.unmet):
        whose = f"{listed(names)} {'are' if len(names) > 1 else 'is'} missed by sway alone, which is no vibration".capitalize()
    return f" {whose}: {_swaying(found[0])}."


def _hardly_damped(study: "Analysis") -> str:
    """Sentence that the gains miss phase margin and Ms at slow swings, and would without any lag of the loop, too; "" otherwise.

    Without its lag the loop is turned by φ = ω·lag at each frequency: the phase margin grows by φ, and |1 + L| by no more than |L| φ, with
    |L| ≤ 1 + |1 + L|.
    """
    if not study.unmet or study.unmet.keys() - {"phase_margin", "peak_sensitivity"} or study.system.uncertainty.names:
        return ""
    turned, slowest = 0.0, math.inf
    for name, state in study.unmet.items():
        omega = REQUIREMENTS[name].frequency(study.worst_in(state).margins)
        value, needed, turn = study.least(state, name), study.system.requirements.needed[name], omega * study.system.lag
        missed = value + turn < needed if name == "phase_margin" else (1 + turn) / value + turn < 1 / needed
        if not missed:
            return ""
        turned, slowest = max(turned, turn), min(slowest, omega)
    lost = digits(math.degrees(turned), "°", 2)
    return f" This is no vibration of the delay, which costs {lost} there: these gains hardly damp a swing at {frequency_text(slowest)}."


def _left_to_a_controller(study: "Analysis") -> str:
    """Sentence that a safe verdict rests on a controller that damps sway; "" otherwise."""
    found = [one for one in study.verdict.findings if one.code == "sway"]
    return f" A controller above the joints has to damp this: {_swaying(found[0])}." if found else ""


def _gearboxes(one: "Finding") -> str:
    return _whose(one, "the gearboxes", "the gearbox of")


def _whose(one: "Finding", many: str, single: str) -> str:
    """Joints by name if they are few: "the gearbox of knee", "the gearboxes"."""
    names = one.joints
    return f"{single} {names[0]}" if len(names) == 1 else f"{many} of {listed(names)}" if len(names) <= MOST_NAMES else many


def _all_met(study: "Analysis") -> str:
    """Clause that every requirement is met, with the cases and the tightest one."""
    examined = "" if study.requirements_met else " examined"
    least = tightest(study)
    return f"every requirement is met{in_the_worst_case(study, examined)}{f'; the tightest is {least}' if least else ''}"


def tightest(study: "Analysis") -> str:
    """Tightest requirement: "phase margin 30° (≥ 30°)"; "" if none is asked for."""
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
    """Case in the ranges in which gains are unstable: "at delay 3 ms", for a robot "in stand/left (delay 3 ms)"."""
    return f"{'in' if study.states[0].posture else 'at'} {study.unstable_case}"


def _time(study: "Analysis") -> str:
    return " in continuous time" if study.system.rate_is_missing else ""


def in_the_worst_case(study: "Analysis", proved: str = "") -> str:
    """Clause on the ranges over which a margin is the worst; "" without ranges."""
    names = [name.replace("_", " ") for name in study.system.uncertainty.names]
    return f" in the worst case of uncertain {listed(names)}{proved}" if names else ""


def _nominally(study: "Analysis") -> str:
    """Sentence on requirements that fail at nominal values, too, among those that fail in the worst case; "" without uncertainty."""
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
    """Number of requirements that fail; unknown margins are not counted."""
    return sum(not math.isnan(study.least(state, name)) for name, state in study.unmet.items())


Tone = Literal["good", "warn", "bare", "bad"]
SHAKES = ("unstable", "topples", "unstable_in_range", "unstable_in_simulator", "vibrates", "ran_away", "diverged", "fell")
"""Codes of findings that make a system unsafe and are no margin."""


def tone(verdict: "Verdict") -> Tone:
    """Tone of a verdict on every page: safe, undecided, short of a requirement, unstable."""
    if verdict.level != "unsafe":
        return "good" if verdict.level == "safe" else "warn"
    return "bad" if any(one.code in SHAKES for one in verdict.deciding) else "bare"


def _failing(study: "Analysis") -> str:
    """Unmet requirements: ": phase margin 26.1° (≥ 30°) at 2.88 Hz, Ms 2.28 (≤ 2) at 77.4 Hz"; "" if there are none."""
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
    """Verdict on a nominally stable system whose kd has a separate path."""
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
    """Verdict on the file's loop after a run without vibration, with a trailing blank; "" if the gains act on no motion."""
    study = outcome.judged
    if study is None:
        return ""
    where = f" in {outcome.spec.state}" if outcome.spec.state else ""
    if not study.stable and outcome.verdict.level == "unsafe":
        return f"{UNSTABLE}{where} without the friction of the scenario. "
    return f"{headline(study, where)} "


def swept_banner(found: "SweepSummary") -> str:
    """Banner of a sweep with unstable gains: number of postures."""
    unstable = sum(one.unstable for one in found.contacts)
    return f"NOT SAFE: unstable in {f'all {found.count}' if unstable == found.count else f'{unstable} of {found.count}'} postures"


def swept_headline(found: "SweepSummary", worst: "WorstStates", lowest_limit: str, missed: str) -> list[str]:
    """Verdict on a sweep; `lowest_limit`: its sentence, `missed`: on other requirements that fail."""
    from ..studies.swept_margins import swept_verdict  # loads the stores of sweeps

    verdict = swept_verdict(found, worst)
    why = [REASONS[one.code](one) for one in verdict.deciding if one.code in REASONS and verdict.level == "undecided"]
    start = f"{LEVELS[verdict.level]}{': ' + '; '.join(why) if why else ''}. "
    if verdict.level == "safe" and not worst.everywhere and worst.requirements:
        others = listed([one.requirement.title for one in worst.requirements])
        start = f"{LEVELS['safe']} where judged: {others} in {worst.count} of {found.count} postures. "
    first, second = (missed, lowest_limit) if found.margin_held and missed else (lowest_limit, missed)
    return [text for text in (start + first, second) if text]


def path_worst(study: "PathStudy", name: str) -> str:
    """Worst value of a requirement, its case, and the required value."""
    one, (value, case) = REQUIREMENTS[name], study.worst[name]
    where = f" at {case.text}" if case.text else ""
    return f"{one.text(value)}{where} ({one.sign} {one.text(study.system.requirements.needed[name])})"
