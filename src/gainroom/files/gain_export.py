"""Export of gains into the formats of other programs: the text of a file, which is read back before it is returned."""

import datetime
import math
import re
import shlex
import textwrap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import GainroomError, first_of_many, listed, printable
from ..io.yaml_text import read_text, shown
from ..robot.formats.model_files import joint_order, load_model
from .edited_text import written
from .export_forms import FORMS, OF_WHOLE_FILES, refuse_integral
from .export_forms.form import ExportedGains, ExportForm
from .gain_context import context_flags, without_flag
from .gain_files import gains_of, parse_file
from .gain_formats.gain_record import ACTUATOR, Gain, GainFile, Origin

KEYS = ("kp", "kd", "ki", "motor_inertia", "effort_limit")
"""Numbers of one joint that an export has in JSON."""
AGREEMENT = 1e-8
"""Relative tolerance of gains that are read back, through MuJoCo's compiler and gears."""

PARTS = {
    "motor_inertia": ("the motors' inertia", "--motor-inertia"),
    "stiffness": ("the gearboxes' stiffness", "--stiffness"),
    "damping": ("the gearboxes' damping", "--damping"),
    "effort_limit": ("limits of the torque", ""),
    "link_viscous": ("the links' friction", ""),
    "motor_viscous": ("the motors' friction and back-EMF", ""),
    "actuator": ("the actuators' names", "--actuator"),
}
"""Properties of an actuator that a file of gains may hold: title and option of `gainroom audit`; "": no option has it."""
WITHOUT_OPTION = {
    "effort_limit": "no margin depends on them, set them there",
    "link_viscous": "only yaml holds it",
    "motor_viscous": "only yaml holds it",
}
MOST_IN_PATTERN = 150
"""Maximum length of the names in one pattern [characters]."""
LINE = 120
"""Maximum length of a line of flags in a comment [characters]."""


@dataclass(frozen=True)
class Export:
    """Text of an exported file, and the text that it replaces.

    gains   as the file has them
    flags   of audit, which say what the form has no place for
    notes   what it does not hold
    """

    text: str
    before: str
    gains: Mapping[str, Gain]
    flags: tuple[str, ...]
    notes: tuple[str, ...]

    def facts(self, difference: str) -> dict[str, Any]:
        """The exported gains in JSON: each joint's numbers, the file's text, notes, and the flags to audit it with.

        difference   the lines in which the text differs from the file that it replaces
        """
        return {
            "joints": [{"name": name} | {key: getattr(gain, key) for key in KEYS} for name, gain in self.gains.items()],
            "difference": difference,
            "text": self.text,
            "audit_with": list(self.flags),
            "notes": list(self.notes),
        }


def export_gains(file: GainFile, form: str, onto: Path | None, model: Path | None, version: str, today: datetime.date) -> Export:
    """Export of the gains of `file` in a format of FORMS.

    onto    an existing file whose gains are replaced, the rest of it stays
    model   whose joints patterns are matched with; None: the names in `file`, or the MJCF `onto`

    Raises GainroomError where the form cannot hold the gains, or would not be read back as they are.
    """
    kind = _form(form, onto)
    model = model or (onto if kind.is_model else None)
    file = file if model is None else file.in_order(joint_order(model))
    names = _joint_names(file, model)
    gains = _by_joint(file, names)
    refuse_integral(gains, kind, f"--to {form}")
    goal = ExportedGains(gains, file.origin, _posture(file, names))
    before = "" if onto is None else _model_text(onto) if kind.is_model else read_text(onto)
    header = _header(file, version, today)
    text = _written(kind, onto, before, goal, header)
    found = _read_back(text, kind, onto)
    flags, notes = _not_held(found, goal)
    notes += [] if kind.notes is None else kind.notes(goal, text, onto)
    notes += [] if kind.is_model else _damping_notes(found, goal)
    if flags:  # which stand in its comment, too
        lines = textwrap.wrap(f"audit it with: {shlex.join(flags)}", LINE, break_long_words=False, break_on_hyphens=False)
        text = _written(kind, onto, before, goal, [*header, *(printable(f"  {line}") for line in lines)])
    back = _back(_read_back(text, kind, onto), gains)
    _require_same(back, gains, form)
    return Export(text, before, back, tuple(flags), (*file.notes_for(names), *notes))


def _written(form: ExportForm, onto: Path | None, before: str, goal: ExportedGains, header: Sequence[str]) -> str:
    """Text of the whole file."""
    if onto is not None:
        assert form.onto is not None
        return form.onto(before, onto, goal, header)
    assert form.written is not None
    return form.written(goal, header)


def _read_back(text: str, form: ExportForm, onto: Path | None) -> GainFile:
    """Gains of a written text as `audit` reads them, with what it takes from that file as the model."""
    path = onto or Path(f"export{form.ending}")
    try:
        found = parse_file(text, path)
    except GainroomError as error:
        raise GainroomError(
            f"--to {form.name}: what it writes is not read back as `audit` reads gains (its form's `read`, files/gain_files.py): {error}"
        ) from error
    return found if form.completed is None else form.completed(found, text, path)


def _back(found: GainFile, wanted: Mapping[str, Gain]) -> dict[str, Gain]:
    """Gains of the wanted joints in a file that may have others too."""
    by_joint = _by_joint(found, tuple(dict.fromkeys((*wanted, *found.own_names))))
    return {name: by_joint.get(name, Gain(0.0)) for name in wanted}


def _posture(file: GainFile, names: Sequence[str]) -> dict[str, float]:
    """Angles of joints that are not at 0 in the only posture of a file, as `audit` takes it; none if the file has several postures."""
    if len(file.postures) != 1:
        return {}
    ((title, patterns),) = file.postures.items()
    plain = {pattern: re.sub(r"\\(.)", r"\1", pattern) for pattern in patterns}
    own = [name for pattern, name in plain.items() if pattern == re.escape(name) or re.fullmatch(r"[\w/:-]+", pattern)]
    angles = file.postures_for(tuple(dict.fromkeys((*names, *own)))).get(title, {})
    return {name: angle for name, angle in angles.items() if angle}


def _form(form: str, onto: Path | None) -> ExportForm:
    if form not in FORMS:
        raise GainroomError(f"--to {shown(form)}: must be one of {', '.join((*FORMS, *OF_WHOLE_FILES))}")
    if onto is not None and FORMS[form].onto is None:
        able = ", ".join(name for name, each in FORMS.items() if each.onto is not None)
        raise GainroomError(f"--onto {onto}: a file of the form {form} is written as a whole; only {able} can take gains into a file")
    if onto is None and FORMS[form].written is None:
        raise GainroomError(f"--to {form}: needs --onto FILE, the {FORMS[form].title} whose actuators get the gains")
    return FORMS[form]


def _model_text(path: Path) -> str:
    from ..io.bounded_text import bounded_text
    from ..robot.formats.xml_text import MAX_BYTES

    return bounded_text(path, MAX_BYTES, "a robot file")


def _joint_names(file: GainFile, model: Path | None) -> tuple[str, ...]:
    """Joint names of the model, else those in the file."""
    if model is not None:
        return load_model(model, for_names=True).every_joint
    names = file.own_names
    if not names:
        raise GainroomError(f"{file.source}: names its joints by patterns, or not at all: give --model, the robot's URDF or MJCF")
    return names


def _by_joint(file: GainFile, names: Sequence[str]) -> dict[str, Gain]:
    """Gains of each joint that has some, in the joints' order."""
    found = gains_of(file, names)  # refuses what no joint has, and gains that are all zero
    matched = file.matched(names)
    gains = {}
    for k in range(len(names)):
        if found.given[k]:
            gains[names[k]] = replace(matched[k][-1], **{key: found.actuators[k].get(key) for key in ACTUATOR})
    return gains


def _header(file: GainFile, version: str, today: datetime.date) -> list[str]:
    """Header lines with the origin of the gains; the first begins as the readers of exports expect it, the others with two spaces."""
    origin = file.origin
    lines = [f"gains by gainroom {version}, {today.isoformat()}, from {file.source} ({file.form})"]
    if origin.robot:
        lines.append(f"  model: {Path(origin.robot).name}")
    lines.append(f"  delay: {_delays(origin)}" + (f"; controller at {origin.sample_rate_hz:g} Hz" if origin.sample_rate_hz else ""))
    lines.append(f"  margins: {origin.margins or 'not known; gainroom audit computes them'}")
    return [printable(line)[:300] for line in lines]


def _delays(origin: Origin) -> str:
    """Delays of the loops in which the gains run, from measurement to torque, as text."""
    host = "not said in that file" if origin.delay_ms is None else f"{origin.delay_ms:g} ms"
    if origin.drive_delay_ms is None:
        return host
    drive = f"{origin.drive_delay_ms:g} ms in the drive" + (f" at {origin.drive_rate_hz:g} Hz" if origin.drive_rate_hz else "")
    return f"{drive}; of set-points {host}" if origin.gains_run == "drive" else f"{drive} for kd; {host} for kp"


def _not_held(found: GainFile, goal: ExportedGains) -> tuple[list[str], list[str]]:
    """Flags with which audit gets the part of `goal` that the written file, read back as `found`, does not hold; and notes about it."""
    back = _back(found, goal.gains)
    flags: list[str] = []
    missing: list[str] = []
    notes: list[str] = []
    for key, (title, option) in PARTS.items():
        lost = {
            name: value for name, gain in goal.gains.items() if (value := getattr(gain, key)) and not _same(value, getattr(back[name], key))
        }
        if lost and option:
            missing.append(title)
            flags += _flags(option, lost, goal.gains)
        elif lost and not (key == "link_viscous" and goal.origin.joint_damping == "friction"):
            notes.append(f"{title} have no place in this form, or not for {first_of_many(tuple(lost))}: {WITHOUT_OPTION[key]}")
    there, origin = found.origin, goal.origin
    if origin.joint_damping == "friction" != there.joint_damping:
        missing.append("the links' friction")
        flags += ["--joint-damping", "friction"]
    if origin.sample_rate_hz is not None and there.sample_rate_hz != origin.sample_rate_hz:
        missing.append("the controller's rate" + (f" ({there.sample_rate_hz:g} Hz in the file)" if there.sample_rate_hz else ""))
        flags += ["--rate-hz", written(origin.sample_rate_hz)]
    if origin.gains_run is not None and there.gains_run != origin.gains_run:
        missing.append("where the gains run")
        flags += ["--gains-run", origin.gains_run]
        drive = {"--drive-rate-hz": origin.drive_rate_hz, "--drive-delay-ms": origin.drive_delay_ms}
        flags += [text for option, value in drive.items() if value is not None for text in (option, written(value))]
    lost = {key: each for key, each in origin.system.items() if there.system.get(key) != each}
    more, whose = context_flags(lost)
    flags += more
    missing += whose
    if left := without_flag(lost, whose):
        notes.append(f"{listed(left, most=9)} have no place in this form, and no option: only yaml holds them")
    if origin.gearboxes:
        missing.append("the gearboxes' types")
        flags += [text for each in origin.gearboxes for text in ("--gearbox", each)]
    if origin.required:
        missing.append("what was required")
        flags += [text for each in origin.required for text in ("--require", each)]
    if goal.posture and _posture(found, (*goal.posture,)) != goal.posture:
        missing.append("the posture")
        flags += _flags("--posture", goal.posture)
    if missing:
        notes.insert(
            0, f"{listed(missing)} {'have' if len(missing) > 1 else 'has'} no place in this form: audit it with {shlex.join(flags)}"
        )
    return flags, notes


def _damping_notes(found: GainFile, goal: ExportedGains) -> list[str]:
    """Note on gains whose kd has the joints' own damping in it, where the file, read back as `found`, does not say so."""
    if goal.origin.joint_damping != "controller" or found.origin.joint_damping == "controller":
        return []
    counted = "kd has the joints' own damping of the model in it already"
    return [f"{counted}: audit it without --joint-damping, and set that damping to 0 where a simulator runs these gains"]


def _same(one: float | str, other: float | str | None) -> bool:
    """True if two gains agree to AGREEMENT, or two names are one."""
    if isinstance(one, str) or isinstance(other, str):
        return one == other
    return other is not None and (one == other or abs(one - other) <= AGREEMENT * abs(one))


def _flags(option: str, values: Mapping[str, Any], every: Collection[str] = ()) -> list[str]:
    """Flags of an option for joints by name, joints with equal values together; a number alone if `every` joint has it."""
    groups: dict[float | str, list[str]] = {}
    for name, value in values.items():
        groups.setdefault(value, []).append(name)
    if len(groups) == 1 and len(values) == len(every):
        return [option, _typed(next(iter(groups)))]
    result = []
    for value, names in groups.items():
        while names:
            count = max(1, sum(1 for k in range(len(names)) if len("|".join(map(re.escape, names[: k + 1]))) <= MOST_IN_PATTERN))
            chosen, names = names[:count], names[count:]
            result += [option, f"{chosen[0] if count == 1 else '|'.join(map(re.escape, chosen))}={_typed(value)}"]
    return result


def _typed(value: float | str) -> str:
    """Number or name as text for a command-line option."""
    if isinstance(value, str):
        return value
    return "inf" if math.isinf(value) else written(value)


def _require_same(back: Mapping[str, Gain], wanted: Mapping[str, Gain], form: str) -> None:
    """Raise GainroomError if the text would be read as other gains."""
    for name, gain in wanted.items():
        for key in ("kp", "kd", "ki"):
            one, other = getattr(gain, key), getattr(back[name], key)
            if abs(one - other) > AGREEMENT * abs(one):
                raise GainroomError(f"--to {form}: joint {shown(name)} would have {key} {other:g} instead of {one:g} in this file")
