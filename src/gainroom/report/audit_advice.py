"""What to do after an audit: gains to use, what is still to be known, or the command that finds gains."""

import math
import re
from pathlib import Path

import numpy as np

from ..errors import listed
from ..files.audit_options import GIVEN
from ..studies.audit import Audit
from ..studies.lowered_gains import GainsToUse
from ..studies.state import USUAL_RATE
from ..system.margin_units import to_db
from .gains_to_use import gain_file, posture_lines
from .margin_columns import requirement
from .number_format import digits
from .page import Advice
from .words import SOFTER

FEW_OWN = 2
"""Joints with a factor of their own that are named one by one."""


def what_to_do(
    result: Audit, call: str = "gainroom audit MODEL --delay-ms MS", written: Path | None = None, most: int | None = None
) -> Advice:
    """Gains that are safe, or the command that finds some; of safe ones what is still to be known.

    call      the command of this audit
    written   the robot.yaml that it writes
    most      lines that a file of gains to use may have, else how to get it stands in its place; None: any number
    """
    actuators, found = result.system.source.actuators, result.to_use
    if result.doubts:
        return Advice(
            "Correct the model, masses in kg, lengths in m and inertias in kg·m², and audit again; the numbers below are of it as it is."
        )
    if result.open:
        calls = [_with_option(call, one.option) for one in result.readings]
        return Advice("Find out which of these it is, and audit again:", calls)
    if result.safe:
        return _to_decide(result, call)
    if result.sway_is_open:
        return Advice("Say who has to damp the sway, and audit again:", [f"{call} --balance {who}" for who in ("joints", "controller")])
    if found is not None and found is not result.ready_to_use:
        return _not_yet(result, found, call)
    if found is not None and result.system.source.unknown.get("motor_inertia_unknown"):
        return _inertia_first(result, found)
    if found is not None:
        there = " with every gearbox of the range that was looked at" if result.over is not None else ""
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
    none = "No common factor on the gains was found that gives all margins."
    if result.has_two_paths:
        return Advice(f"{none} Gains whose kd closes on another clock are not searched: lower kp or kd, and audit again.")
    if result.over is not None:
        measure = "Measure the gearboxes (`gainroom identify stiffness`), as a wide range may leave no gains; for one point in the range"
        return Advice(f"{none} {measure} search joint by joint:", _searched(call, written), [AGAIN])
    return Advice(f"{none} Search joint by joint:", _searched(call, written), [AGAIN])


def _with_option(call: str, option: str) -> str:
    """The command with one of the readings; gains on the drive have no rate on the host."""
    return f"{re.sub(r' --rate-hz [^ ]+', '', call) if '--gains-run drive' in option else call} {option}"


def _inertia_first(result: Audit, found: GainsToUse[Audit]) -> Advice:
    """Where gains with the required margins are known, as motors without inertia need them."""
    how = "Give the motors' inertias (rotor inertia × gear ratio²), as `motor_inertia` of each joint in the file of gains or with"
    multiply = _multiply(result, found)
    without = f"Where they are really 0: {multiply[0].lower()}{multiply[1:]}; then {_required(result)}."
    folded = f"With motor inertia 0, {_factors(result, found)}, the others as they are:"
    return Advice(f"{how} `--motor-inertia`, and audit again.", (), [without], (folded, _gain_file(result, found)))


def _searched(call: str, written: Path | None = None) -> list[str]:
    """The commands that search gains joint by joint."""
    found = [] if written else [f"{call} --write-robot robot.yaml"]
    return [*found, f"gainroom robot {written or 'robot.yaml'}"]


AGAIN = "Then audit the gains that `gainroom robot` finds, with `--gains` and the same options."
"""After a search."""


def _gain_file(result: Audit, found: GainsToUse[Audit]) -> list[str]:
    """The gains to use, with all that is known of the joints' actuators but what the model says itself, and a posture not typed."""
    source = result.system.source
    inertia = source.actuators.motor_inertia
    own = np.where((inertia > 0) & (inertia != source.body.armature), inertia, math.nan)
    lines = gain_file(source.joint_names, {**found.gains, "motor_inertia": own, **result.given_gearboxes})
    angles = {} if result.tightest.posture == GIVEN else {name: angle for name, angle in result.angles.items() if angle}
    beside = [f"joint_damping: {result.joint_damping}"] * (result.joint_damping is not None)
    beside += posture_lines(angles) if angles else []
    return [*beside, "gains:", *(f"  {line}" for line in lines)] if beside else lines


def _to_decide(result: Audit, call: str) -> Advice:
    """What is still to be known of gains that are safe if it is as assumed."""
    rigid, options, given = result.assumed_rigid, "", []
    if result.system.control.sample_time is None:
        given, options = ["your loop's rate"], f" --rate-hz {USUAL_RATE:.0f}"
    if rigid.any():
        given.append("your gearboxes (their type, or `--stiffness` and `--damping`)")
        if rigid.all():
            known = np.any(result.system.source.actuators.motor_inertia > 0)
            options += " --gearbox harmonic" if known else " --stiffness 10000 --damping 10"
    if not given:
        return Advice("These gains may stay.")
    remarks = [SOFTER] if rigid.any() else []
    return Advice(f"Audit again with {listed(given)}, such as:", [f"{call}{options}"], remarks)


def _not_yet(result: Audit, found: GainsToUse[Audit], call: str) -> Advice:
    """Advice where gains with the required margins are known, but not the loop's rate."""
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
    """The joints whose gains are lowered, by the factor on them, the least first."""
    names, groups = result.system.source.joint_names, dict[float, list[str]]()
    for name, factor in sorted(zip(names, found.factors.tolist(), strict=True), key=lambda one: one[1]):
        if name in found.joints:
            groups.setdefault(factor, []).append(name)
    return groups


def _factors(result: Audit, found: GainsToUse[Audit]) -> str:
    """Which factors on which gains: "× 0.42 on ankle and × 0.83 on knee"."""
    groups, every = _by_factor(result, found), len(found.joints) == len(result.joints)
    if len(groups) > 2:
        return f"× {min(groups):.4g} to {max(groups):.4g} on {'all' if every else len(found.joints)} joints (each its own)"
    joints = {factor: "all joints" if len(group) == len(result.joints) else listed(group, most=3) for factor, group in groups.items()}
    return " and ".join(f"× {factor:.4g} on {group}" for factor, group in joints.items())


def _multiply(result: Audit, found: GainsToUse[Audit]) -> str:
    """Which gains by which factor, with the values of the joint that has the least headroom, or of each of few."""
    first = next(joint.name for joint in result.joints_tightest_first if joint.name in found.joints)
    of_first, count = _values(result, found, first), len(found.joints)
    left = len(result.joints) - count
    groups = _by_factor(result, found)
    kept = sum(not joint.safe and joint.name not in found.joints for joint in result.joints)
    others = f" and leave the other{f' {left}' if count > 1 else 's'}" if left else ""
    others += f", of which {kept} that {'fail' if kept > 1 else 'fails'} now {'have' if kept > 1 else 'has'} enough then" if kept else ""
    if count == 1:
        return f"Multiply the gains of {first} by {found.factor:.4g} ({of_first}){others}"
    whose = f"the gains of {count} joints" if left else "all gains"
    unsafe = sum(not joint.safe and joint.name in found.joints for joint in result.joints)
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
    """A joint's gains to use: "kp 41.45, kd 2.638"."""
    k = result.system.source.joint_names.index(joint)
    return ", ".join(f"{name} {values[k]:.4g}" for name, values in found.gains.items() if name != "ki")


def _required(result: Audit) -> str:
    """What gains to use have, as a clause: "gain margin ≥ 6 dB and delay margin ≥ 1 ms hold"."""
    parts = [f"{one.heading} {requirement(result.required, one.name, 3)}" for one, _ in result.required.asked_for] or ["stability"]
    return f"{listed(parts)} {'hold' if len(parts) > 1 else 'holds'}"
