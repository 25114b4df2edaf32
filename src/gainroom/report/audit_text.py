"""Audit as text: verdict, reasons, advice, and warnings with remedies; and its presentation."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import __version__
from ..analysis.margin_record import PathMargins
from ..errors import apart, at_frequency, beside, listed
from ..files.actuator_facts import actuators
from ..files.audit_options import GIVEN, Audited, named_actuators
from ..files.gain_context import gain_context
from ..io.as_typed import as_typed
from ..studies.audit import Audit
from ..studies.critical_joints import joints_that_miss
from ..studies.factors import typed_factor
from ..studies.safe_gains import GainsToUse
from ..studies.state import HELD, USUAL_RATE
from ..studies.verdict import Verdict
from ..system.margin_units import to_db
from ..system.plausibility import doubts_first
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS
from .columns import alike_rows, definitions, facts, shared_row
from .gains_to_use import gain_file, posture_lines
from .gearboxes import gearbox_assumptions, over_range, range_facts, worst_gearboxes
from .margin_columns import margin_value, required_facts, requirement
from .next_commands import search_and_audit
from .number_format import digits, model_facts, model_text, path_facts
from .page import Advice
from .presentation import Legend, Part, Presentation, TextTable, closing, do_this, folded, warned_first
from .robot_columns import AUDITED_JOINT, audited_joints, audited_states, joint_caption, legend
from .robot_text import free_joints, unconfirmed
from .words import SOFTER, UNSAFE_NOT_KNOWN, UNSTABLE, headline, in_simulator, motor_inertias, unsafe_joints, without_motors

if TYPE_CHECKING:
    from ..studies.audited_workspace import AuditedWorkspace
    from ..studies.simulator_audit import SimulatorAudit

FEW_LINES = 4
"""Most lines of a gain file in the short answer; for more, the table has the factors."""
FEW_JOINTS = 4
"""Most joints in the short answer: those with the least headroom."""
ELSEWHERE = ("gain_margin", "delay_margin")
"""Requirements whose least margins have their own JSON keys."""
SLIGHT = 0.05
"""Damping ratio of a motor on its spring proposed as a first guess if none is given."""
HIGH_RATIO = 30.0
"""Gear ratio up to which published actuators of legs have planetary gears, in one or two stages; from 50 on they have harmonic ones."""
FEW_OWN = 2
"""Most joints with individual factors that are named one by one."""


def audit_sentence(result: Audit) -> str:
    """Verdict and reason, in one text."""
    return f"{verdict(result)} {reason(result)}"


def verdict(result: Audit) -> str:
    """Verdict text: safe or not, the first failure, its state and joints. It contains no gain to use."""
    over, unsafe = over_range(result), sum(joint.safe is False for joint in result.joints)
    if result.doubts:
        return headline(result)
    readings = _readings(result) if result.readings else ""
    if result.open:
        return headline(result, over, readings)
    if result.stable or result.verdict.level != "unsafe":
        text = headline(result, over)
    else:
        text = f"{UNSTABLE}{over} with {_given(result)} of delay{_mainly(result)}.{without_motors(result)}"
    return " ".join(filter(None, [text, unsafe_joints(unsafe, len(result.joints)) if unsafe and not result.sway_is_open else "", readings]))


def _readings(result: Audit) -> str:
    """Sentence on the ambiguous option, with the meaning and result of each of its values."""
    flag = result.readings[0].option.split()[0]
    each = [f"{one.option.removeprefix(flag).strip()} ({one.meaning}): {_unsafe(one.audit)}" for one in result.readings]
    return f"{flag} is not given: {'; '.join(each)}."


def _unsafe(found: Audit) -> str:
    """Clause with the number of unsafe joints, and the factor at which vibration starts."""
    limit = found.tightest.limit
    start = "nothing makes it vibrate" if math.isinf(limit.gain) else f"vibration starts at {digits(limit.gain, '×', 4)} these gains"
    joints = unsafe_joints(sum(joint.safe is False for joint in found.joints), len(found.joints)).rstrip(".")
    if all(joint.safe is not False for joint in found.joints) and any(joint.safe is None for joint in found.joints):
        joints = UNSAFE_NOT_KNOWN
    joints = f"{joints[0].lower()}{joints[1:]}"
    return f"{joints}, {start if limit.gain > 0 else 'no lower gains are stable'}"


def _given(result: Audit) -> str:
    return digits(1e3 * result.system.delay, "ms", 3)


def _mainly(result: Audit) -> str:
    """Clause with the contact states that fail and the main joints; an audit has one posture."""
    short = sum(not result.enough_in(state) for state in result.states)
    every = f" in {'both' if short == 2 else f'all {short}'} states, worst" if short == len(result.states) else ""
    where = f"{every} in {result.tightest.contact}" if len(result.states) > 1 else ""
    return where + (f", mainly {listed(result.limiting_joints, most=2)}" if result.limiting_joints else "")


def reason(result: Audit) -> str:
    """Sentences with the factor and the delay at which these gains vibrate: limits, which leave no margin."""
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
    """Clause with the reading that all numbers belong to; "" without readings."""
    return next((f" With {one.option}:" for one in result.readings if one.audit.every is result.every), "")


def besides(result: Audit) -> list[str]:
    """Clauses on requirements other than the gain margin that are missed, with the required value and the state."""
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
    """Clause with the least value of a requirement, the required value, and the state."""
    state = result.worst[one.name]
    shown = margin_value(result.required, one.name, result.value_in(state, one), False, 3)
    where = f" in {state.contact}" if len(result.states) > 1 else ""
    return f"{one.label} {shown} ({one.sign} {one.text(needed)}){at_frequency(one.frequency(state.counted))}{where}"


def audit_scale(result: Audit) -> float | None:
    """Factor on all gains that makes unsafe ones safe, rounded down; None if none is known, and for safe gains."""
    scale = result.scale
    return None if result.safe or math.isnan(scale) else typed_factor(scale)


def _no_lower_gains(result: Audit) -> str:
    """Sentences on why no lower gains help with undamped gearboxes, and a first guess: a twentieth of the critical damping."""
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
    """Clause with the factor on kp alone, or on kd alone, at which vibration starts."""
    factors = {"kp": (paths.others, paths.lower_others), "kd": (paths.kd, paths.lower_kd)}
    name, (upper, lower) = min(factors.items(), key=lambda one: min(one[1][0], 1 / one[1][1] if one[1][1] > 0 else math.inf))
    if lower * upper > 1:
        return f"Vibration starts where {name} alone falls to {digits(lower, '×', 3)} ({to_db(lower):.3g} dB)"
    return f"Vibration starts at {digits(upper, '×', 3)} {name} alone ({to_db(upper):.3g} dB)"


def audit_warnings(result: Audit) -> tuple[str, ...]:
    """Warnings of an audit, each with its remedy: deciding ones first, then how the files were understood."""
    system, found = result.system, []
    if system.control.sample_time is None and not result.safe and result.to_use is None:  # else verdict and advice say what a rate costs
        found.append("continuous model: hold and velocity difference of a loop cost about one tick; give --rate-hz")
    lost = [joint for joint in result.joints if joint.gain_limit < 1] if result.stable else []
    if lost:
        limits = listed([f"{joint.name} (stable only below {digits(joint.gain_limit, '×', 3)} its gains)" for joint in lost], most=3)
        found.append(f"with all other joints switched off {limits} would vibrate: do not run {'it' if len(lost) == 1 else 'one'} by itself")
    damped = dict(zip(system.source.joint_names, system.source.actuators.motor_viscous.tolist(), strict=True))  # by a motor's back-EMF
    bare = [joint.name for joint in result.joints if joint.kp > 0 and joint.kd == 0 and not damped[joint.name]] if not result.safe else []
    if bare:
        found.append(f"{listed(bare)}: kd is 0, so that no gain damps {'it' if len(bare) == 1 else 'them'}: give kd")
    if result.immobile:
        contacts = listed([state.contact for state in result.immobile])
        found.append(f"{contacts}: {HELD} in this contact state, so there is no verdict; check the contacts")
    others = [text for text in system.warnings if text not in result.doubts]  # which the verdict says
    return tuple(doubts_first([*found, *free_joints(system), *unconfirmed(result.states), *others]))


def what_to_do(
    result: Audit, call: str = "gainroom audit MODEL --delay-ms MS", written: Path | None = None, most: int | None = None
) -> Advice:
    """Advice with safe gains, or the command that finds some; for safe gains the data still missing.

    call      the command of this audit
    written   the robot.yaml that it writes
    most      most lines of a file of gains to use; a longer one is replaced by how to get it; None: any number
    """
    actuators, found = result.system.source.actuators, result.to_use
    if result.doubts:
        return Advice(
            "Correct the model, masses in kg, lengths in m and inertias in kg·m², and audit again; the numbers below are of it as it is."
        )
    if result.open:
        calls = [_with_option(call, one.option) for one in result.readings]
        return Advice("Find out which of these it is, and audit again:", calls)
    if any(one.code == "topples_with_weight" for one in result.verdict.deciding) and result.verdict.level == "undecided":
        return Advice("Where a controller above the joints holds the robot up, say so:", [f"{call} --balance controller"])
    if result.safe:
        return _to_decide(result, call)
    if result.sway_is_open:
        return Advice("Say who has to damp the sway, and audit again:", [f"{call} --balance {who}" for who in ("joints", "controller")])
    if found is not None and result.system.source.unknown.get("motor_inertia_unknown"):
        return _inertia_first(result, found)
    if found is not None and found is not result.ready_to_use:
        return _not_yet(result, found, call)
    if found is not None:
        there = " everywhere in the range that was looked at" if result.over is not None else ""
        rigid = ", with rigid gearboxes," if result.assumed_rigid.all() else ""
        lines = _gain_file(result, found)
        shown = most is None or len(lines) <= most
        file = "As a file for `--gains` and `export`:"
        if not shown:
            file = "As a file: `--verbose`, or `gainroom export` of what `--json` prints."
        heading = f"{_multiply(result, found)}; then{rigid} {_required(result)}{there}. {file}"
        return Advice(heading, lines if shown else ())
    if result.tightest.limit.gain == 0 and np.any(actuators.damping[np.isfinite(actuators.stiffness)] == 0):
        return Advice("Measure the gearboxes' damping, and audit again with `--damping`.")
    tried = "below 1" if result.has_kd_path or result.assumed_rigid.any() else "up to 3"
    none = f"No common factor {tried} on the gains was found that gives all margins."
    if result.has_kd_path:
        return Advice(f"{none} Gains whose kd closes on another clock are not searched: lower kp or kd, and audit again.")
    if result.system.source.unknown.get("motor_inertia_unknown"):
        return Advice(f"{none} {MOTORS_FIRST}: others would be searched for other motors.")
    if (given := _assumed(result))[0]:
        asked = f"Before others are searched, audit again with {listed(given[0])}, such as:"
        return Advice(f"{none} {asked}", [f"{call}{given[1]}"], [ELASTIC_FAIL] if result.assumed_rigid.any() else [])
    if result.over is not None:
        measure = "A wide range may leave no gains: measure the gearboxes (`gainroom identify stiffness`)."
        return Advice(f"{none} Search joint by joint over the range, and audit what is found:", _searched(call, written), [measure])
    return Advice(f"{none} Search joint by joint, and audit what is found:", _searched(call, written))


def _with_option(call: str, option: str) -> str:
    """Audit command with the option of one reading; gains on the drive have no rate on the host."""
    return f"{re.sub(r' --rate-hz [^ ]+', '', call) if '--gains-run drive' in option else call} {option}"


ELASTIC_FAIL = "Gains that are found with rigid gearboxes may fail on elastic ones."
MOTORS_FIRST = (
    "Give the motors' inertias (rotor inertia × gear ratio²), as `motor_inertia` of each joint in the file of gains or with "
    "`--motor-inertia`, and audit again"
)


def _inertia_first(result: Audit, found: GainsToUse[Audit]) -> Advice:
    """Advice to give the motor inertias first, with the gains that hold for the assumed ones."""
    multiply = _multiply(result, found)
    what = motor_inertias(result)
    without = f"Where they are really {what}: {multiply[0].lower()}{multiply[1:]}; then {_required(result)}."
    folded = f"With motor inertias of {what}, {_factors(result, found)}, the others as they are:"
    return Advice(f"{MOTORS_FIRST}.", (), [without], (folded, _gain_file(result, found)))


def _searched(call: str, written: Path | None = None) -> list[str]:
    """Commands that search gains joint by joint, and audit those."""
    found = [] if written else [f"{call} --write-robot robot.yaml"]
    return [*found, *search_and_audit(call, str(written or "robot.yaml"))]


def _gain_file(result: Audit, found: GainsToUse[Audit]) -> list[str]:
    """Lines of a gain file: gains to use, known actuator data that the model does not contain, and a posture not typed by the user."""
    source = result.system.source
    actuators = result.given_actuators
    inertia = actuators["motor_inertia"]
    own = np.where((inertia > 0) & (inertia != source.body.armature), inertia, math.nan)
    rubbed = source.actuators.motor_viscous
    beside_gains = {"motor_inertia": own, "motor_viscous": np.where(rubbed > 0, rubbed, math.nan)}
    lines = gain_file(source.joint_names, {**found.gains, **actuators, **beside_gains})
    angles = {} if result.tightest.posture == GIVEN else {name: angle for name, angle in result.angles.items() if angle}
    beside = [f"joint_damping: {result.joint_damping}"] * (result.joint_damping is not None)
    beside += posture_lines(angles) if angles else []
    return [*beside, "gains:", *(f"  {line}" for line in lines)] if beside else lines


def _to_decide(result: Audit, call: str) -> Advice:
    """Advice for gains that are safe under assumptions: options for rate and gearboxes; "may stay" if nothing is assumed."""
    given, options = _assumed(result)
    if not given:
        return Advice("These gains may stay.")
    remarks = [SOFTER] if result.assumed_rigid.any() else []
    return Advice(f"Audit again with {listed(given)}, such as:", [f"{call}{options}"], remarks)


def _assumed(result: Audit) -> tuple[list[str], str]:
    """Names of assumed data (rate, gearboxes), and options that state them, to append to the command."""
    rigid, options, given = result.assumed_rigid, "", []
    if result.system.rate_is_missing:
        given, options = ["your loop's rate"], f" --rate-hz {USUAL_RATE:.0f}"
    if rigid.any():
        given.append("your gearboxes (their type, `direct` where there are none, or `--stiffness` and `--damping`)")
        if rigid.all():
            options += f" --gearbox {_likely_gearbox(result)}"
    return given, options


def _likely_gearbox(result: Audit) -> str:
    """Type of gearbox for a command to start from: that of most of the joints' actuators, as far as it is published."""
    names = named_actuators(result.of.sections).values() if result.of is not None else ()
    ratios = [used.value for name in names if (used := actuators()[name].used("ratio")) is not None]
    return "planetary" if ratios and np.median(ratios) < HIGH_RATIO else "harmonic"


def _not_yet(result: Audit, found: GainsToUse[Audit], call: str) -> Advice:
    """Advice if gains with the required margins are known, but not the loop's rate."""
    factors, extra = _factors(result, found), found.audited.least_extra_delay
    margin = to_db(found.audited.tightest.limit.gain)
    lost = f"; at rates below about {digits(1 / extra, 'Hz', 3)} these gains, too, may vibrate" if 0 < extra < math.inf else ""
    leave = "leave" if found.factor is None else "leaves"
    why = f"Without a rate, {factors} {leave} gain margin {margin:.3g} dB in continuous time, less at any real rate{lost}."
    folded = f"Not yet to use: {factors}, the others as they are; found in continuous time:"
    return Advice(
        "Give the loop's rate and audit again, such as:", [f"{call} --rate-hz {USUAL_RATE:.0f}"], [why], (folded, _gain_file(result, found))
    )


def _by_factor(result: Audit, found: GainsToUse[Audit]) -> dict[float, list[str]]:
    """Joints whose gains are lowered, by factor, the least first."""
    names, groups = result.system.source.joint_names, dict[float, list[str]]()
    for name, factor in sorted(zip(names, found.factors.tolist(), strict=True), key=lambda one: one[1]):
        if name in found.joints:
            groups.setdefault(factor, []).append(name)
    return groups


def _factors(result: Audit, found: GainsToUse[Audit]) -> str:
    """Factors on the gains with their joints, as text: "× 0.42 on ankle and × 0.83 on knee"."""
    groups, every = _by_factor(result, found), len(found.joints) == len(result.joints)
    if len(groups) > 2:
        return f"× {min(groups):.4g} to {max(groups):.4g} on {'all' if every else len(found.joints)} joints (each its own)"
    joints = {factor: "all joints" if len(group) == len(result.joints) else listed(group, most=3) for factor, group in groups.items()}
    return " and ".join(f"× {factor:.4g} on {group}" for factor, group in joints.items())


def _multiply(result: Audit, found: GainsToUse[Audit]) -> str:
    """Instruction to multiply gains: "Multiply the gains of ankle by 0.557 (kp 54.98, kd 3.498) and leave the others".

    New values are given for the joint with the least headroom, or for each joint if at most FEW_OWN have individual factors.
    """
    first = next(joint.name for joint in result.joints_tightest_first if joint.name in found.joints)
    of_first, count = _values(result, found, first), len(found.joints)
    left = len(result.joints) - count
    groups = _by_factor(result, found)
    unchanged = sum(joint.safe is False and joint.name not in found.joints for joint in result.joints)
    others = f" and leave the other{f' {left}' if count > 1 else 's'}" if left else ""
    others += (
        f", of which {unchanged} that {'fail' if unchanged > 1 else 'fails'} now {'have' if unchanged > 1 else 'has'} enough then"
        if unchanged
        else ""
    )
    if count == 1:
        return f"Multiply the gains of {first} by {found.factor:.4g} ({of_first}){others}"
    whose = f"the gains of {count} joints" if left else "all gains"
    unsafe = sum(joint.safe is False and joint.name in found.joints for joint in result.joints)
    which = (
        f", {unsafe} short of a margin and {count - unsafe} that are images of those or would vibrate then,"
        if left and count > unsafe
        else ""
    )
    if len(groups) == 1:
        return f"Multiply {whose} by {found.factor:.4g} ({first} {of_first}){which}{others}"
    if len(groups) == count <= FEW_OWN:
        each = listed([f"{name} by {factor:.4g} ({_values(result, found, name)})" for factor, (name,) in groups.items()])
        return f"Multiply the gains of {each}{which}{others}"
    least, most = min(groups), max(groups)
    return f"Multiply {whose} by {least:.4g} to {most:.4g}, each by its own ({first} {of_first}){which}{others}"


def _values(result: Audit, found: GainsToUse[Audit], joint: str) -> str:
    """Gains to use of one joint: "kp 41.45, kd 2.638"."""
    k = result.system.source.joint_names.index(joint)
    return ", ".join(f"{name} {values[k]:.4g}" for name, values in found.gains.items() if name != "ki")


def _required(result: Audit) -> str:
    """Clause that the required margins hold: "gain margin ≥ 6 dB and delay margin ≥ 1 ms hold"."""
    parts = [f"{one.heading} {requirement(result.required, one.name, 3)}" for one, _ in result.required.asked_for] or ["stability"]
    return f"{listed(parts)} {'hold' if len(parts) > 1 else 'holds'}"


@dataclass(frozen=True)
class AuditPresentation(Presentation):
    """Presentation of an audit.

    of          the robot as it was read
    simulated   results in the simulator, and `swept` of the whole workspace; None if not asked for: then it is not loaded
    """

    result: Audit
    of: Audited
    simulated: "SimulatorAudit | None" = None
    swept: "AuditedWorkspace | None" = None

    @property
    def verdict(self) -> Verdict:
        """Verdict on the robot, with those of simulator and workspace if asked for."""
        return self.result.verdict_with(self.simulated, self.swept)

    def facts(self) -> dict[str, Any]:
        result, system, control = self.result, self.result.system, self.result.system.control
        every = (REQUIREMENTS[name] for name in result.worst if name not in ELSEWHERE)
        least = {one.key: one.in_unit(one.value(result.worst[one.name].counted)) for one in every}
        return {
            "robot": system.source.name,
            "gainroom": __version__,
            **self.verdict.facts,
            "safe": self.verdict.level == "safe",
            "decided": result.decided,
            "sentence": audit_sentence(result),
            "requirements_met": result.safe,
            "unmet": list(result.missed),
            "required": required_facts(result.required),
            "balance": system.balance or None,
            "scale": audit_scale(result),
            "to_use": _to_use_facts(result),
            **model_facts(control.sample_time),
            "delay_ms": 1e3 * max(drive.delay for drive in system.drives),
            "command_delay_ms": 1e3 * control.command_delay,
            "kd_path": path_facts(control.kd_path),
            "gains_run": self.of.options.gains_run,
            "joint_damping": self.of.options.joint_damping,
            "margin_db": as_typed(to_db(result.margin)),
            "stable": all(state.limit.stable for state in result.states),
            "gain_limit": result.tightest.limit.gain,
            "limit_frequency_rad_s": result.tightest.limit.frequency,
            "delay_limit_ms": 1e3 * result.delay_limit,
            "delay_margin_ms": 1e3 * result.least_extra_delay if result.stable else math.nan,
            **least,
            "path_gain_limits": _path_facts(result),
            "limiting_joints": list(result.limiting_joints),
            "posture": result.angles,
            "base": system.source.body.base,
            "system": gain_context(self.of.sections, system),
            "joints": [facts(AUDITED_JOINT, joint) | self.of.actuator_facts(joint.name) for joint in result.joints],
            "states": [facts(audited_states(result.enough_in), state) for state in result.states + result.immobile],
            **self._further_facts(),
            "gearbox_range": range_facts(result),
            "readings": _reading_facts(result),
            "rigid_gearboxes": [joint.name for joint, rigid in zip(result.joints, result.assumed_rigid.tolist(), strict=True) if rigid],
            "assumptions": [*system.assumptions, *gearbox_assumptions(result)],
            "warnings": list(audit_warnings(result)),
        }

    def _further_facts(self) -> dict[str, Any]:
        """JSON of simulator and workspace; None for each that was not asked for."""
        found: dict[str, Any] = {"simulator": None, "workspace": None}
        if self.simulated is not None:
            from .simulator_text import simulator_facts

            found["simulator"] = simulator_facts(self.simulated)
        if self.swept is not None:
            from .workspace import audited_facts

            found["workspace"] = audited_facts(self.swept)
        return found

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        result = self.result
        do = what_to_do(result, self.call, self.files.get("Robot"), None if verbose else FEW_LINES)
        answer, assumed = self._answer(do)
        assumed = (*result.system.assumptions, *gearbox_assumptions(result), *assumed)
        doubts, warned = warned_first(audit_warnings(result), verbose)
        posture = f"Posture: {result.states[0].posture}; {result.system.source.body.base} base"
        if verbose:
            yield [*doubts, *answer, "", *_all_there_is(result), *folded(do), posture, *closing(self.files, warned, assumed)]
            return
        motors = f"; {self.of.motors}" if self.of.motors else ""
        how = f"{_rigid(result)}; {self.of.options.where_gains_run} (--gains-run){motors}. {len(assumed)} assumptions: --verbose."
        for count in range(FEW_JOINTS, 0, -1):
            yield [*doubts, *answer, *_tightest_joints(result, count), *closing(self.files, warned), posture + how]

    def _answer(self, do: Advice) -> tuple[list[Part], tuple[str, ...]]:
        """Parts with verdict, advice, reason and further questions; and the simulator's assumptions."""
        result, swept = self.result, self.swept
        answer, there, more, assumed = in_simulator(verdict(result), self.simulated), do_this(do), [], ()
        if self.simulated is not None:
            from .simulator_text import simulator_assumptions, simulator_sentence

            more, assumed = ["", simulator_sentence(self.simulated)], simulator_assumptions(self.simulated)
        if swept is not None:
            from .workspace import advice_there, in_workspace, workspace_text

            answer, more = in_workspace(answer, swept), [*more, "", workspace_text(swept, advised=not result.safe)]
            there = do_this(replace(advice_there(swept), remarks=())) if result.safe and not swept.safe else there
        return [answer, *there, reason(result), *more], assumed


def _to_use_facts(result: Audit) -> dict[str, Any] | None:
    """JSON of the gains to use: factor (null: individual), joints it applies to, readiness, and every joint's gains as rounded.

    None for safe gains, and if none are known.
    """
    found = result.to_use
    if found is None:
        return None
    names = result.system.source.joint_names
    columns = {**found.gains, "factor": found.factors}
    gains = [{"name": name, **{key: float(values[k]) for key, values in columns.items()}} for k, name in enumerate(names)]
    return {"factor": found.factor, "scaled": list(found.joints), "ready": result.ready_to_use is not None, "joints": gains}


def _path_facts(result: Audit) -> dict[str, Any] | None:
    paths = result.tightest.margins.paths
    return None if paths is None else {"kp": [paths.lower_others, paths.others], "kd": [paths.lower_kd, paths.kd]}


def _reading_facts(result: Audit) -> list[dict[str, Any]]:
    return [
        {
            "option": one.option,
            "meaning": one.meaning,
            "safe": one.audit.safe,
            "gain_limit": one.audit.tightest.limit.gain,
            "unsafe_joints": [joint.name for joint in one.audit.joints if joint.safe is False],
        }
        for one in result.readings
    ]


def _tightest_joints(result: Audit, count: int) -> list[Part]:
    """Table of the `count` joints with the least headroom, and a note on the rest."""
    limit_key = "limit_others_closed" if result.stable else "gain_limit"  # what joints are judged by
    limit_key = "" if result.stable and "gain_margin" in result.required.asked else limit_key  # which has a column of its own
    columns = [
        one
        for one in audited_joints(result)
        if one.key == limit_key or one.key not in ("motor_inertia", "gain_limit", "limit_others_closed")
    ]
    every = TextTable.of("", columns, result.joints_tightest_first)
    groups = alike_rows(every.rows)
    left = [result.joints_tightest_first[k] for group in groups[count:] for k in group]
    failing = sum(joint.safe is False for joint in left)
    of_them = f", {failing} of which fail" if failing else ""
    others = f"{len(left)} more joint{'s' * (len(left) > 1)}{of_them}: --verbose. " if left else ""
    joints = replace(every, rows=[shared_row(every.rows, group) for group in groups[:count]])
    return [joints, Legend([joints], lambda headings: others + legend(result, headings))]


def _all_there_is(result: Audit) -> list[Part]:
    """Tables of every contact state and joint."""
    control, columns = result.system.control, audited_states(result.enough_in)
    title = f"All joints together ({model_text(control.sample_time, control.kd_path)})"
    states = TextTable.of(title, columns, result.states + result.immobile)
    drops = ("motor inertia", "one loop", "alone")
    joints = TextTable.of("Joint by joint, in the worst state", audited_joints(result), result.joints, drops).sharing
    return [
        states,
        Legend([states], lambda headings: definitions(columns, headings)),
        "",
        joints,
        Legend([joints], lambda headings: joint_caption(result, headings)),
    ]


def _rigid(result: Audit) -> str:
    """Clause with the number of gearboxes assumed rigid; "" if all stiffnesses are given."""
    rigid = result.assumed_rigid.tolist()
    count = sum(rigid)
    which = "" if all(rigid) else f"{count} of {len(rigid)} "
    return f"; {which}gearboxes assumed rigid (--stiffness, --damping)" if count else ""
