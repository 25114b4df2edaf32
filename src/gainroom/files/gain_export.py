"""Gains into other people's forms: the text of a file, read back before anybody sees it."""

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import GainroomError, first_of_many, printable
from ..io.yaml_text import read_text, shown
from ..robot.formats.model_files import joint_order, load_model
from .gain_files import gains_of, parse_file
from .gain_formats.export_text import arrays_text, isaac_lab_text, legged_gym_text, mjlab_text, plain_text, ros2_control_text
from .gain_formats.gain_record import ACTUATOR, Gain, GainFile
from .gain_formats.mjcf_export import mjcf_text
from .gain_formats.ros2_control import ros2_control_onto

AGREEMENT = 1e-8
"""Relative, of gains that are read back: written with ten digits, and through MuJoCo's compiler."""

EXTRA = ("ki", *ACTUATOR)
"""Fields of Gain beside kp and kd."""
Written = Callable[[Mapping[str, Gain], Sequence[str], float | None], str]


@dataclass(frozen=True)
class Form:
    """A form that gains are written in.

    ending    of its files
    written   the text of a whole file; None: only an existing file can take them
    onto      whether an existing file can take them
    keeps     fields of EXTRA that it holds
    """

    ending: str
    written: Written | None
    onto: bool = False
    keeps: tuple[str, ...] = ()


FORMS = {
    "yaml": Form(".yaml", plain_text, keeps=EXTRA),
    "ros2_control": Form(".yaml", ros2_control_text, True, ("ki",)),
    "mjcf": Form(".xml", None, True),
    "mjlab": Form(".py", mjlab_text, keeps=("motor_inertia", "effort_limit")),
    "isaaclab": Form(".py", isaac_lab_text, keeps=("motor_inertia", "effort_limit")),
    "legged_gym": Form(".py", legged_gym_text),
    "arrays": Form(".yaml", arrays_text),
}


@dataclass(frozen=True)
class Export:
    """A file's text, and what was there before; notes: what the form does not hold."""

    text: str
    before: str
    gains: Mapping[str, Gain]
    notes: tuple[str, ...]


def export_gains(file: GainFile, form: str, onto: Path | None, model: Path | None, version: str, today: datetime.date) -> Export:
    """The gains of `file` in a form of FORMS.

    onto    an existing file whose gains are replaced, the rest of it stays
    model   whose joints patterns are matched with; None: the names in `file`, or the MJCF `onto`

    Raises GainroomError where the form cannot hold the gains, or would not be read back as they are.
    """
    kind = _form(form, onto)
    model = model or (onto if form == "mjcf" else None)
    file = file if model is None else file.in_order(joint_order(model))
    names = _joint_names(file, model)
    gains = _by_joint(file, names)
    notes = [*file.notes_for(names), *_left_out(gains, form, kind)]
    header = _header(file, version, today)
    dropped = {key: 0.0 if key == "ki" else None for key in EXTRA if key not in kind.keeps}
    kept = {name: replace(gain, **dropped) for name, gain in gains.items()}
    before = "" if onto is None else read_text(onto) if form != "mjcf" else _model_text(onto)
    if onto is not None and form == "mjcf":
        text = mjcf_text(before, onto, kept, header)
    elif onto is not None:
        text = ros2_control_onto(before, str(onto), kept, header)
    else:
        assert kind.written is not None
        text = kind.written(kept, header, file.origin.sample_rate_hz)
    _require_same(parse_file(text, onto or Path(f"export{kind.ending}")), kept, form)
    return Export(text, before, kept, tuple(notes))


def _form(form: str, onto: Path | None) -> Form:
    if form not in FORMS:
        raise GainroomError(f"--to {shown(form)}: must be one of {', '.join(FORMS)}")
    if onto is not None and not FORMS[form].onto:
        able = ", ".join(name for name, each in FORMS.items() if each.onto)
        raise GainroomError(f"--onto {onto}: a file of the form {form} is written as a whole; only {able} can take gains into a file")
    if onto is None and FORMS[form].written is None:
        raise GainroomError(f"--to {form}: needs --onto FILE, the {form.upper()} whose actuators get the gains")
    return FORMS[form]


def _model_text(path: Path) -> str:
    from ..io.bounded_text import bounded_text
    from ..robot.formats.xml_text import MAX_BYTES

    return bounded_text(path, MAX_BYTES, "a robot file")


def _joint_names(file: GainFile, model: Path | None) -> tuple[str, ...]:
    """The model's joints, else those that the file names."""
    if model is not None:
        return load_model(model, for_names=True).every_joint
    names = file.own_names
    if not names:
        raise GainroomError(f"{file.source}: names its joints by patterns, or not at all: give --model, the robot's URDF or MJCF")
    return names


def _by_joint(file: GainFile, names: Sequence[str]) -> dict[str, Gain]:
    """The gains of each joint that has some, in the joints' order."""
    found = gains_of(file, names)  # refuses what no joint has, and gains that are all zero
    matched = file.matched(names)
    gains = {}
    for k in range(len(names)):
        if found.given[k]:
            gains[names[k]] = replace(matched[k][-1], **{key: found.actuators[k].get(key) for key in ACTUATOR})
    return gains


def _left_out(gains: Mapping[str, Gain], form: str, kind: Form) -> list[str]:
    """What the form cannot hold: an integral gain is refused, as the answer would be another without it."""
    with_ki = [name for name, gain in gains.items() if gain.ki]
    if with_ki and "ki" not in kind.keeps:
        able = ", ".join(name for name, each in FORMS.items() if "ki" in each.keeps)
        raise GainroomError(f"--to {form}: holds no integral gain, which {first_of_many(with_ki)} have; {able} do")
    notes = []
    if "motor_inertia" not in kind.keeps and any(gain.motor_inertia for gain in gains.values()):
        notes.append("the motors' inertia has no place in this form: audit takes it from the model's armature, or from --motor-inertia")
    if "stiffness" not in kind.keeps and any(gain.stiffness for gain in gains.values()):
        notes.append("the gearboxes' stiffness and damping have no place in this form: audit takes them from --stiffness and --damping")
    return notes


def _header(file: GainFile, version: str, today: datetime.date) -> list[str]:
    """What is known of the gains, a line each; the first begins as the exports' readers know it, the others with two spaces."""
    origin = file.origin
    lines = [f"gains by gainroom {version}, {today.isoformat()}, from {file.source} ({file.form})"]
    if origin.robot:
        lines.append(f"  model: {Path(origin.robot).name}")
    delay = "not said in that file" if origin.delay_ms is None else f"{origin.delay_ms:g} ms"
    lines.append(f"  delay: {delay}" + (f"; controller at {origin.sample_rate_hz:g} Hz" if origin.sample_rate_hz else ""))
    lines.append(f"  margins: {origin.margins or 'not known; gainroom audit computes them'}")
    return [printable(line)[:300] for line in lines]


def _require_same(found: GainFile, wanted: Mapping[str, Gain], form: str) -> None:
    """Raise GainroomError where the text would be read as other gains."""
    names = tuple(dict.fromkeys((*wanted, *found.own_names)))
    by_joint = _by_joint(found, names)
    for name, gain in wanted.items():
        back = by_joint.get(name)
        for key in ("kp", "kd", "ki"):
            one, other = getattr(gain, key), getattr(back, key) if back else 0.0
            if abs(one - other) > AGREEMENT * abs(one):
                raise GainroomError(f"--to {form}: joint {shown(name)} would have {key} {other:g} instead of {one:g} in this file")
