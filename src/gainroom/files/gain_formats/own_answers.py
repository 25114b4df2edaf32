"""Reader of the answers of `gainroom robot --json` and `gainroom audit --json`: recommended, audited or proposed gains."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...errors import GainroomError, first_of_many, listed, nearest
from ...io.validation import checked, number, require_one_of
from ...io.yaml_text import shown
from ...robot.gearbox_types import TYPES
from ...system.requirements import REQUIREMENTS, Requirements
from ..actuator_facts import actuators as known_actuators, unknown_actuator
from ..gain_context import read_gain_context
from ..typed_requirements import unusual_limits
from .gain_record import ACTUATOR, ANGLE, GAINS_RUN, JOINT_DAMPING, NOT_NEGATIVE, Gain, GainFile, Origin, postures_of

EVERYWHERE = "everywhere"
AUDITED = "audited"
"""Name of an audit's posture."""
PATH = {"rate_hz": "sample_rate_hz", "delay_ms": "delay_ms"}
"""Keys of a kd_path by the second half of the option's name, drive_…."""
MOST_BYTES = 16 << 20
NUMBER = number()
MARGINS = {
    "gain_margin_db": "gain margin ≥ {:.3g} dB",
    "phase_margin_deg": "phase margin ≥ {:.3g}°",
    "peak_sensitivity": "Ms ≤ {:.3g}",
    "delay_margin_ms": "delay margin ≥ {:.3g} ms",
}
OF_ROBOT = {"states", "recommended", "unstable_at"}
OF_AUDIT = {"states", "joints", "delay_limit_ms"}
"""Keys that identify an audit's answer."""


@dataclass(frozen=True)
class AnsweredGains(GainFile):
    """Gains by joint name; an answer has no patterns."""

    @property
    def own_names(self) -> tuple[str, ...]:
        return tuple(self.gains)

    def matched(self, joint_names: Sequence[str]) -> list[list[Gain]]:
        for name in self.gains:
            if name not in joint_names:
                raise GainroomError(f"{self.source}: gains.{shown(name)} matches no joint{nearest(name, tuple(joint_names), 'joint')}")
        return [[self.gains[name]] if name in self.gains else [] for name in joint_names]


def answer_in(text: str) -> dict[str, Any] | None:
    """Data of an answer of gainroom in a text; None if the text is none. JSON is read by Python's own reader, in linear time."""
    if not text.lstrip().startswith("{"):
        return None
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return None
    is_ours = isinstance(data, dict) and (data.keys() >= OF_ROBOT or data.keys() >= OF_AUDIT)
    return data if is_ours else None


def read_answer(data: Mapping[str, Any], source: str, contact: str = "", to_use: bool = False) -> GainFile:
    """Gains in an answer; of several recommended sets the one for `contact`, else the one that is safe everywhere.

    to_use   of an audit whose gains are not safe those to use in their place, where it has some; none that fail at the usual rate

    Raises GainroomError.
    """
    postures, system = postures_of(read_gain_context(data.get("system"), source, "system"))
    damping = data.get("joint_damping")
    require_one_of(f"{source}: joint_damping {shown(damping)}", damping, JOINT_DAMPING)
    if "recommended" in data:
        usual = data.get("at_usual_rate")
        if to_use and isinstance(usual, dict) and usual.get("requirements_met") is False:
            raise GainroomError(
                f"{source}: recommended: was found for continuous time and would fail at the usual rate, by at_usual_rate; state "
                "control.sample_rate_hz in the robot's file, and export the new answer of `gainroom robot`"
            )
        gains, margins = _recommended(data, source, contact or EVERYWHERE)
        form = "gainroom robot --json"
    else:
        if contact:
            raise GainroomError(f"{source}: is an audit, whose gains are the same in all contact states; leave --contact out")
        gains = {name: _gain(entry, f"{source}: joints.{shown(name)}") for name, entry in _named(data, "joints", source).items()}
        for name in _said_rigid(data, "joints", source) & gains.keys():
            gains[name] = replace(gains[name], stiffness=math.inf)
        limit = data.get("gain_limit")
        margins = f"vibration starts at {limit:.3g} × these gains" if isinstance(limit, int | float) else ""
        instead = data.get("to_use") if to_use else None
        if isinstance(instead, dict):
            if instead.get("ready") is not True:  # an older answer does not say
                raise GainroomError(
                    f"{source}: to_use: the audit says not to use these gains yet, as the loop's rate or a motor's inertia is not known, "
                    "or they would hardly damp the motion; do what `gainroom audit` says first, then export its new answer"
                )
            for name, entry in _named(instead, "joints", f"{source}: to_use").items():
                actuator = {key: getattr(gains[name], key) if name in gains else None for key in ACTUATOR}
                new = _gain({**entry, **actuator}, f"{source}: to_use.joints.{shown(name)}")
                named = gains[name].actuator if name in gains else None
                gains[name] = replace(new, stiffness=actuator["stiffness"], actuator=named)  # it may be rigid
            margins = f"safe by the audit of {_required_text(data)}, in place of unsafe gains"
            if data.get("rigid_gearboxes"):
                margins += f"; with rigid gearboxes of {first_of_many(tuple(map(str, data['rigid_gearboxes'])))}: audit them with yours"
        form = "gainroom audit --json"
        postures = postures or _posture(data, source)
    actuators = _named(data, "actuators", source) if "actuators" in data else {}
    delays = [checked(f"{source}: actuators.{shown(name)}.delay_ms", each.get("delay_ms"), NUMBER) for name, each in actuators.items()]
    delays += [] if (delay := _number(data, "delay_ms", source)) is None else [delay]
    for name in gains.keys() & actuators.keys():
        actuator = {key: actuators[name].get(key) for key in ACTUATOR}
        gains[name] = _gain({**vars(gains[name]), **actuator}, f"{source}: actuators.{shown(name)}")
    for name in _said_rigid(data, "actuators", source) & gains.keys():
        gains[name] = replace(gains[name], stiffness=math.inf)
    place = _place(data, max(delays, default=None), source)
    whole = "recommended" in data
    place |= {"gearboxes": _gearboxes(data, source), "required": _required(data)}
    origin = Origin(str(data.get("robot") or ""), margins=margins, joint_damping=damping, whole_kd=whole, system=system, **place)
    return AnsweredGains(source, form, gains, postures=postures, origin=origin)


def _number(data: Mapping[str, Any], key: str, owner: str) -> float | None:
    """Number of an answer; None if it has none."""
    return None if data.get(key) is None else checked(f"{owner}: {key}", data[key], NOT_NEGATIVE)


def _place(data: Mapping[str, Any], delay: float | None, source: str) -> dict[str, Any]:
    """Location of the gains with rates and delays, as fields of Origin; where the answer does not name it, its numbers do."""
    rate, command = _number(data, "sample_rate_hz", source), _number(data, "command_delay_ms", source)
    path = data.get("kd_path")
    inferred = "split" if isinstance(path, dict) else "drive" if command else None
    place = data.get("gains_run", inferred)
    require_one_of(f"{source}: gains_run {shown(place)}", place, GAINS_RUN)
    if place == "drive":
        return {"gains_run": place, "delay_ms": command, "drive_rate_hz": rate, "drive_delay_ms": delay}
    found = {"gains_run": place, "delay_ms": delay, "sample_rate_hz": rate}
    if place == "split":
        own = path if isinstance(path, dict) else {}
        drive = {f"drive_{name}": _number(own, key, f"{source}: kd_path") for name, key in PATH.items()}
        return found | drive
    return found


def _posture(data: Mapping[str, Any], source: str) -> dict[str, dict[str, float]]:
    """Audited posture by joint, if some joint is not at 0."""
    angles = data.get("posture")
    if not isinstance(angles, dict):
        return {}
    found = {re.escape(str(name)): checked(f"{source}: posture.{shown(name)}", angle, ANGLE) for name, angle in angles.items()}
    return {AUDITED: found} if any(found.values()) else {}


def _said_rigid(data: Mapping[str, Any], key: str, source: str) -> set[str]:
    """Joints under a `key` whose gearboxes the user called rigid; the value null means either that or unknown."""
    if not isinstance(data.get("rigid_gearboxes"), list) or key not in data:
        return set()
    unknown = {str(name) for name in data["rigid_gearboxes"]} | _in_ranges(data, source).keys()
    return {name for name, entry in _named(data, key, source).items() if "stiffness" in entry and entry["stiffness"] is None} - unknown


def _in_ranges(data: Mapping[str, Any], source: str) -> dict[str, dict[str, Any]]:
    """Joints of an audit whose gearboxes have ranges, by name."""
    ranged = data.get("gearbox_range")
    return _named(ranged, "joints", f"{source}: gearbox_range") if isinstance(ranged, dict) else {}


def _gearboxes(data: Mapping[str, Any], source: str) -> tuple[str, ...]:
    """Types of those gearboxes, each as --gearbox takes it. Raises GainroomError."""
    found = []
    for name, entry in _in_ranges(data, source).items():
        require_one_of(f"{source}: gearbox_range.joints.{shown(name)}.type", entry.get("type"), tuple(TYPES))
        found.append(f"{re.escape(name)}={entry['type']}")
    return tuple(found)


def _required(data: Mapping[str, Any]) -> tuple[str, ...]:
    """Limits that the answer required other than the usual ones, each as --require takes it; () if it names none."""
    required = data.get("required")
    if not isinstance(required, dict):
        return ()
    asked = {one.name: one.in_si(value) for one in REQUIREMENTS.values() if isinstance(value := required.get(one.key), int | float)}
    return unusual_limits(Requirements(**asked))


def _required_text(data: Mapping[str, Any]) -> str:
    """Requirements of an audit, as text."""
    required = data.get("required")
    found = required if isinstance(required, dict) else {}
    parts = [text.format(found[key]) for key, text in MARGINS.items() if isinstance(found.get(key), int | float)]
    return ", ".join(parts) or "its requirements"


def _recommended(data: Mapping[str, Any], source: str, contact: str) -> tuple[dict[str, Gain], str]:
    """Recommended gains per joint for a contact state, and their margins as text."""
    spaces = data["recommended"] or []
    joint = [each for each in spaces if isinstance(each, dict) and each.get("space") == "joint"] if isinstance(spaces, list) else []
    if not joint:
        raise GainroomError(f"{source}: recommended: holds no gains per joint" + (", only of tasks" if spaces else ""))
    names, sets = joint[0].get("names"), joint[0].get("sets")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or not isinstance(sets, list):
        raise GainroomError(f"{source}: recommended: names and sets must be lists")
    found = {str(each.get("contact")): each for each in sets if isinstance(each, dict)}
    if contact not in found:
        known = first_of_many(tuple(found)) or "none"
        raise GainroomError(f"{source}: recommended: no gains were found for {shown(contact)}; contact states with gains: {known}")
    one = found[contact]
    columns: dict[str, Any] = {key: one[key] for key in ("kp", "kd", "ki") if one.get(key) is not None}
    for key, column in columns.items():
        if not isinstance(column, list) or len(column) != len(names):
            raise GainroomError(f"{source}: recommended: {contact}: {key} must be a list of {len(names)} numbers")
    gains = {}
    for k, name in enumerate(names):
        values = {key: column[k] for key, column in columns.items()}
        if values.get("kp") is not None:  # null: nothing can move this joint in any state of the set
            gains[name] = _gain(values, f"{source}: recommended: {contact}: {shown(name)}")
    if not gains:
        raise GainroomError(f"{source}: recommended: {contact}: no joint has gains")
    parts = [text.format(one[key]) for key, text in MARGINS.items() if isinstance(one.get(key), int | float)]
    where = "in every state" if contact == EVERYWHERE else f"in contact state {contact}"
    return gains, f"{', '.join(parts)} {where}{_weight_text(one)}" if parts else ""


def _weight_text(one: Mapping[str, Any]) -> str:
    """Restriction of a set's margins, as text: the weight of a standing robot is left out."""
    if one.get("without_weight") is not True:
        return ""
    topples, text = one.get("topples"), " without the robot's weight"
    if isinstance(topples, list) and topples:
        text += f"; with it the robot topples in {listed([str(each) for each in topples])}: a balance controller must prevent that"
    return text


def _named(data: Mapping[str, Any], key: str, source: str) -> dict[str, dict[str, Any]]:
    """List of sections with a name each, as a mapping by name."""
    entries = data.get(key)
    if not isinstance(entries, list) or not all(isinstance(each, dict) and isinstance(each.get("name"), str) for each in entries):
        raise GainroomError(f"{source}: {key}: must be a list of sections with a name each")
    return {each["name"]: each for each in entries}


def _gain(values: Mapping[str, Any], owner: str) -> Gain:
    kp, kd, ki = (checked(f"{owner}.{key}", values.get(key) or 0.0, NOT_NEGATIVE) for key in ("kp", "kd", "ki"))
    name, published = values.get("actuator"), values.get("published")
    if name is not None and name not in known_actuators():
        raise GainroomError(f"{owner}.actuator: {unknown_actuator(str(name))}")
    left = published if name is not None and isinstance(published, list) else []
    given = {key: value for key in ACTUATOR if key not in left and (value := values.get(key)) is not None and value != math.inf}
    actuator: dict[str, Any] = {key: checked(f"{owner}.{key}", value, NOT_NEGATIVE) or None for key, value in given.items()}
    return Gain(kp, kd, ki, **actuator, actuator=name)
