"""Export of gains into an MJCF: the actuators of the joints are changed, and the rest of the text stays as it is.

A <motor> becomes a <position>; a joint without an actuator gets one. What MuJoCo makes of defaults and classes is asked of MuJoCo, and
where that is another armature or limit of the torque than was known of a joint, the joint itself gets it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ...errors import GainroomError, first_of_many
from ...io.yaml_text import shown
from ...robot.formats.mjcf import joint_and_actuators
from ...robot.formats.mjcf_file import ActuatorElement, compile_mjcf
from ...robot.formats.model_files import position_gains
from ...robot.formats.xml_text import parse_xml
from ..gain_formats.gain_record import Gain, GainFile
from ..gain_formats.mjcf_actuators import XML, read_mjcf
from .form import ExportedGains, ExportForm, number_text

SERVOS = ("position", "intvelocity", "pid")
COMMENT = re.compile(r"\n?[ \t]*<!-- gains by gainroom\b.*?-->", re.DOTALL)
ATTRIBUTE = r"\s+{0}\s*=\s*(\"[^\"]*\"|'[^']*')"
INDENT = "  "
ROUND_OFF = 1e-12
"""Relative tolerance of sums and products of a few doubles."""


@dataclass
class Tag:
    """Position of an element in a text [bytes]: start tag from `start` to `end`, and begin of its end tag; 0: it is empty."""

    name: str
    start: int
    end: int = 0
    close: int = 0


@dataclass
class _Places:
    """Parser that records the positions of joints and actuators."""

    content: bytes
    root: Tag | None = None
    sections: list[Tag] = field(default_factory=list)
    actuators: list[Tag] = field(default_factory=list)
    joints: dict[str, Tag] = field(default_factory=dict)
    controls: list[str] = field(default_factory=list)
    open: list[Tag] = field(default_factory=list)

    def find(self) -> "_Places":
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._begin
        self.parser.EndElementHandler = self._finish
        self.parser.Parse(self.content, True)
        return self

    def _begin(self, name: str, attributes: dict[str, str]) -> None:
        start = self.parser.CurrentByteIndex
        tag = Tag(name, start, _end_of_tag(self.content, start))
        path = [each.name for each in self.open]
        if not path:
            self.root = tag
        elif len(path) == 1 and name == "actuator":
            self.sections.append(tag)
        elif len(path) == 2 and path[1] == "actuator":
            self.actuators.append(tag)
        elif name == "joint" and "name" in attributes and path[1:2] == ["worldbody"]:
            self.joints[attributes["name"]] = tag
        elif name == "key" and "ctrl" in attributes:
            self.controls.append(attributes.get("name", "without a name"))
        self.open.append(tag)

    def _finish(self, name: str) -> None:
        tag = self.open.pop()
        if self.content[tag.end - 2 : tag.end] != b"/>":
            tag.close = self.parser.CurrentByteIndex


def mjcf_text(text: str, path: Path, goal: ExportedGains, header: Sequence[str]) -> str:
    """Text of the MJCF read from `path`, with these gains; joint damping that kd includes is removed from the joints.

    Raises GainroomError where its actuators cannot take the gains.
    """
    text = _with_gains(COMMENT.sub("", text), path, goal.gains, goal.origin.joint_damping is not None)
    text = _with_joints(text, path, goal.gains, goal.origin.joint_damping)
    places = _Places(text.encode()).find()
    assert places.root is not None
    note = "".join(f"\n{INDENT}{'     ' if k else '<!-- '}{line.replace('--', '- -')}" for k, line in enumerate(header))
    return _edited(text, [(places.root.end, places.root.end, f"{note} -->")])


def joint_values(text: str, path: Path, name: str) -> dict[str, float]:
    """Armature or damping of each joint of an MJCF with one degree of freedom, of the joint and its actuators together [SI]."""
    model = compile_mjcf(parse_xml(text, str(path)), path).model
    return {joint: joint_and_actuators(model, name, k) for k, joint in enumerate(model.names["joint"])}


def _with_joints(text: str, path: Path, gains: Mapping[str, Gain], joint_damping: str | None) -> str:
    """Text with motor inertia, torque limits and damping of joints whose present values differ."""
    places = _Places(text.encode()).find()
    model = compile_mjcf(parse_xml(text, str(path)), path).model
    limits = position_gains(path, text).joints
    edits = []
    for k, name in enumerate(model.names["joint"]):
        if name not in gains or name not in places.joints:
            continue
        gain, changes = gains[name], {}
        total, own = joint_and_actuators(model, "armature", k), float(model.dof_armature[model.jnt_dofadr[k]])
        if gain.motor_inertia and abs(total - gain.motor_inertia) > ROUND_OFF * total and gain.motor_inertia >= total - own:
            changes["armature"] = number_text(gain.motor_inertia - (total - own))
        effort = gain.effort_limit
        if effort and name in limits and limits[name].effort_limit != effort:
            changes |= {"actuatorfrcrange": f"{number_text(-effort)} {number_text(effort)}", "actuatorfrclimited": "true"}
        damping = {"controller": 0.0, "friction": gain.link_viscous or 0.0}.get(joint_damping or "")
        if damping is not None and damping != float(model.dof_damping[model.jnt_dofadr[k]]):
            changes["damping"] = number_text(damping)
        tag = places.joints[name]
        edits += [(tag.start, tag.end, _with(places.content[tag.start : tag.end].decode(), changes))] * bool(changes)
    return _edited(text, edits)


def _edited(text: str, edits: Sequence[tuple[int, int, str]]) -> str:
    """Text with parts of it [bytes] replaced."""
    content = text.encode()
    for start, end, replacement in sorted(edits, reverse=True):
        content = content[:start] + replacement.encode() + content[end:]
    return content.decode()


def _with_gains(text: str, path: Path, gains: Mapping[str, Gain], damped_elsewhere: bool) -> str:
    """Text with the gains on the actuators, and the torque limit where one actuator alone moves a joint.

    damped_elsewhere   what their own `damping` is counts in kd, or on the joints
    """
    content = text.encode()
    compiled = compile_mjcf(parse_xml(text, str(path)), path)
    elements, own_damping = compiled.elements, getattr(compiled.model, "actuator_damping", np.zeros(0))  # since MuJoCo 3.5
    places = _Places(content).find()
    if len(elements) != len(places.actuators):
        raise GainroomError(f"{path}: some of its actuators stand in an included file; export onto a file with all of them")
    edits: list[tuple[int, int, str]] = []
    missing = []
    for joint, gain in gains.items():
        mine = [k for k, element in enumerate(elements) if element.joint == joint]
        if not mine:
            missing.append(joint)
            continue
        limit = gain.effort_limit if len(mine) == 1 else None
        for k, (kp, kd) in _shared(joint, [elements[k] for k in mine], mine, places.actuators, gain, path):
            undamped = damped_elsewhere and k < len(own_damping) and np.any(own_damping[k])
            mine_now = Gain(kp, kd, effort_limit=limit)
            edits += _rewritten(places, places.actuators[k], elements[k], mine_now, path, {"damping": "0.0"} if undamped else {})
    if missing:
        edits.append(_inserted(places, missing, gains, path))
    return _edited(text, edits)


def _shared(
    joint: str, elements: Sequence[ActuatorElement], indices: Sequence[int], tags: Sequence[Tag], gain: Gain, path: Path
) -> list[tuple[int, tuple[float, float]]]:
    """Gains of each of a joint's actuators: a servo gets both, or a servo kp and a <velocity> actuator kd."""
    names = [tags[k].name for k in indices]
    if len(indices) == 1:
        return [(indices[0], (gain.kp, gain.kd))]
    if sorted(names) == ["position", "velocity"]:
        servo = names.index("position")
        return [(indices[servo], (gain.kp, 0.0)), (indices[1 - servo], (0.0, gain.kd))]
    raise GainroomError(
        f"{path}: joint {shown(joint)} has several actuators ({first_of_many(names)}); leave one, or a position and a velocity"
    )


def _rewritten(
    places: _Places, tag: Tag, element: ActuatorElement, gain: Gain, path: Path, more: Mapping[str, str]
) -> list[tuple[int, int, str]]:
    """Edits that give an actuator these gains, a limit, and `more`; arguments on the joint's side, attributes before the gear."""
    source = places.content[tag.start : tag.end].decode()
    kp, kd = gain.kp / element.gear**2, gain.kd / element.gear**2
    limits = {} if gain.effort_limit is None else force_limits(gain.effort_limit / abs(element.gear))
    source = _with(source, {**limits, **more})
    if tag.name in SERVOS:
        source = _with(source, {"kp": number_text(kp), "kv": number_text(kd), "dampratio": None})
    elif tag.name == "velocity":
        source = _with(source, {"kv": number_text(kd)})
    elif tag.name == "general" and element.is_affine and element.stiffness:
        scale = element.gain / element.stiffness  # the input's own scale stays
        offset = element.offset * kp / element.stiffness
        prm = {"gainprm": number_text(scale * kp), "biasprm": f"{number_text(offset)} {number_text(-kp)} {number_text(-kd)}"}
        source = _with(source, {"gaintype": "fixed", "biastype": "affine", **prm})
    elif tag.name == "motor":
        bounded = element.control_range and not element.force_limited and not limits
        limits = {"forcerange": element.control_range, "forcelimited": "true"} if bounded else {}
        changes = {"kp": number_text(kp), "kv": number_text(kd), "ctrlrange": None, "ctrllimited": "false", **limits}
        source = _with(re.sub(r"^<motor\b", "<position", source), changes)
        if tag.close:
            ending = places.content[tag.close :].index(b">") + tag.close + 1
            return [(tag.start, tag.end, source), (tag.close, ending, "</position>")]
    else:
        raise GainroomError(f"{path}: joint {shown(element.joint)}: <{tag.name}> takes no kp and kd; make it a <position>")
    return [(tag.start, tag.end, source)]


def _with(source: str, changes: Mapping[str, str | None]) -> str:
    """Start tag with attributes changed, added, or (None) left out."""
    for name, value in changes.items():
        pattern = re.compile(ATTRIBUTE.format(name))
        if value is None:
            source = pattern.sub("", source)
        elif pattern.search(source):
            source = pattern.sub(f' {name}="{value}"', source)
        else:
            source = re.sub(r"\s*(/?>)$", rf' {name}="{value}"\1', source)
    return source


def _inserted(places: _Places, missing: Sequence[str], gains: Mapping[str, Gain], path: Path) -> tuple[int, int, str]:
    """Edit that adds new actuators after the existing ones."""
    if places.controls:
        raise GainroomError(
            f"{path}: joints without an actuator: {first_of_many(missing)}; add them, or leave ctrl out of the keyframe "
            f"{shown(places.controls[0])}, which counts actuators"
        )
    from xml.sax.saxutils import quoteattr  # loads urllib, http and ssl

    lines = []
    for joint in missing:
        kp, kd, limit = number_text(gains[joint].kp), number_text(gains[joint].kd), gains[joint].effort_limit
        tag = f'<position joint={quoteattr(joint)} kp="{kp}" kv="{kd}" gear="1"/>'
        lines.append(f"{INDENT * 2}{_with(tag, {} if limit is None else force_limits(limit))}\n")
    whole = [section for section in places.sections if section.close]
    if whole:
        at = places.content.rindex(b"<", 0, whole[-1].close + 1)
        line = places.content.rfind(b"\n", 0, at) + 1
        own_line = not places.content[line:at].strip()
        return (line, line, "".join(lines)) if own_line else (at, at, "\n" + "".join(lines) + INDENT)
    assert places.root is not None
    at = places.root.close
    return (at, at, f"{INDENT}<actuator>\n{''.join(lines)}{INDENT}</actuator>\n")


def _end_of_tag(content: bytes, start: int) -> int:
    """Index behind the start tag at `start`: one past its first > outside quotes."""
    quote = 0
    for place in range(start, len(content)):
        byte = content[place]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b"\"'":
            quote = byte
        elif byte == ord(">"):
            return place + 1
    return len(content)


def force_limits(effort: float) -> dict[str, str]:
    """Attributes of an MJCF's actuator that limit its force in both directions."""
    return {"forcerange": f"{number_text(-effort)} {number_text(effort)}", "forcelimited": "true"}


def actuator_section(goal: ExportedGains, header: Sequence[str]) -> str:
    """Text of an `<actuator>` section, to be pasted."""
    from xml.sax.saxutils import quoteattr  # loads urllib, http and ssl

    lines = []
    for name, gain in goal.gains.items():
        attributes = {"joint": name, "kp": number_text(gain.kp), "kv": number_text(gain.kd)}
        if gain.effort_limit is not None:
            attributes |= force_limits(gain.effort_limit)
        lines.append(f"  <position {' '.join(f'{key}={quoteattr(value)}' for key, value in attributes.items())}/>\n")
    return f"<!-- {' '.join(header).replace('--', '- -')} -->\n<actuator>\n{''.join(lines)}</actuator>\n"


def _read(text: str, path: Path) -> GainFile | None:
    """Gains of its actuators; the file at `path` is read if the text is ""."""
    return read_mjcf(path, text) if path.suffix.lower() in XML else None


def _with_armature(found: GainFile, text: str, path: Path) -> GainFile:
    """Gains with the motors' inertia, which is armature there."""
    inertia = joint_values(text, path, "armature")
    return replace(found, gains={name: replace(gain, motor_inertia=inertia.get(name)) for name, gain in found.gains.items()})


def _notes(goal: ExportedGains, text: str, onto: Path | None) -> list[str]:
    """Notes on what stands in the model: armature, and damping that kd has in it already."""
    notes = []
    if any(gain.motor_inertia for gain in goal.gains.values()):
        notes.append("the motors' inertia is the joints' armature there, which audit takes from its MODEL: audit this file itself")
    if goal.origin.joint_damping == "controller" and onto is not None:
        left = [name for name, value in joint_values(text, onto, "damping").items() if value and name in goal.gains]
        included = "kd has the joints' own damping of the model in it already, which stands in an included file"
        notes += [f"{included} for {first_of_many(left)}: set it to 0 there"] * bool(left)
    return notes


MJCF = ExportForm(
    *("mjcf", "MJCF", "actuators of a model", ".xml", None, mjcf_text),
    pasted=actuator_section,
    read=_read,
    completed=_with_armature,
    notes=_notes,
    is_model=True,
)
