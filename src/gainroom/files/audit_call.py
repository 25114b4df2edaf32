"""Audit of a model and its gains: in every reading that they leave open, for the command line and for programs."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import GainroomError, first_of_many
from ..io.atomic import text_as_file
from ..robot.formats.in_memory import as_file
from ..robot.formats.model_files import load_model
from ..robot.formats.model_names import locate
from ..studies.audit import Audit, ReadAs, audit as judge, least_of, required_of, with_drives
from ..studies.progress import Progress, quiet
from ..system.requirements import Requirements
from ..system.system import System
from .audit_options import JOINT_VALUES, Audited, AuditOptions, audited
from .readings import HOST, damping_readings, drive_reading
from .typed_requirements import further_requirements

PerJoint = float | Mapping[str, float] | None
"""Number of all joints, or numbers by name or pattern."""
Words = str | Sequence[str] | Mapping[str, str] | None
"""Word of all joints, or words by name or pattern."""


def audit(
    model: Any,
    gains: Any = None,
    *,
    delay: float,
    rate: float | None = None,
    stiffness: PerJoint = None,
    damping: PerJoint = None,
    motor_inertia: PerJoint = None,
    gearbox: Words = None,
    actuator: Words = None,
    bandwidth: float | None = None,
    base: str | None = None,
    contact: str | Sequence[str] = (),
    balance: str | None = None,
    posture: str | Mapping[str, float] = (),  # type: ignore[assignment] - none
    joint_damping: str | None = None,
    gains_run: str | None = None,
    drive_rate: float | None = None,
    drive_delay: float | None = None,
    require: Mapping[str, float | None] | None = None,
    progress: Progress = quiet,
) -> Audit:
    """Audit of the gains that a robot already has: whether they are safe. Numbers are those of `gainroom audit`, options its own in SI.

    model      a path, PACKAGE:FILE or a name of robot_descriptions; an MjModel, an MjSpec or a pinocchio.Model
    gains      a path; by joint's name or pattern {"kp": …, "kd": …} or (kp, kd); arrays (kp, kd), each (n,) in the order of the model's
               joints or one number; None: the model's own actuators
    delay      from measurement to torque [s]; rate of the controller [Hz], None: not known
    stiffness, damping, motor_inertia   of all joints, or by name or pattern [N m/rad], [N m s/rad], [kg m²]
    gearbox, actuator   type, and name in `gainroom actuators`, of all joints, or by name or pattern
    bandwidth  of the current loops [rad/s]
    base       "fixed" or "floating"; balance   who damps sway, "joints" or "controller"
    contact    frames on the ground; posture: joint positions by name or pattern [rad; m if prismatic], or a keyframe's name
    joint_damping   what the model's own damping of joints is, "controller" or "friction"
    gains_run  where kp and kd run, "host", "drive" or "split"; drive_rate, drive_delay   of those on the drive [Hz], [s]
    require    limits by their names in a file, such as {"gain_margin_db": 8, "peak_sensitivity": None}; None for a limit: not required

    Returns the record: `verdict`, `joints`, `to_dict()`; in a notebook it shows as a card. Raises GainroomError, one line.
    """
    options = AuditOptions(
        1e3 * _number("delay", delay),
        rate_hz=rate,
        bandwidth=bandwidth,
        base=base,
        balance=balance,
        joint_damping=joint_damping,
        gains_run=gains_run,
        drive_rate_hz=drive_rate,
        drive_delay_ms=None if drive_delay is None else 1e3 * _number("drive_delay", drive_delay),
        contacts=(contact,) if isinstance(contact, str) else tuple(contact),
        posture=_posture(posture),
        gearboxes=_words(gearbox),
        actuators=_words(actuator),
        **_of_joints(stiffness=stiffness, damping=damping, motor_inertia=motor_inertia),
    )
    limits = [f"{name}={'none' if value is None else value}" for name, value in (require or {}).items()]
    asked = further_requirements(None, None, None, limits)
    with as_file(model) as file, _gains_as_file(file, gains, base) as own:
        found = audited(file, own, options)
        required = required_of(None, {**further_requirements(None, None, None, found.options.required), **asked})
        result = read_in_every_way(file, own, found, required, progress)
    names = {} if file == str(model) else {file: Path(file).stem}
    names |= {} if own is None or isinstance(gains, str | Path) else {str(own): "gains"}
    return replace(result, system=_renamed(result.system, names))


def read_in_every_way(model: str, gains: Path | None, found: Audited, required: Requirements, progress: Progress) -> Audit:
    """Audit of `found`, or of each reading of it."""

    def judged(one: Audited) -> Audit:
        return replace(judge(one.system, required, progress), joint_damping=one.options.joint_damping)

    damped = damping_readings(model, gains, found)
    if damped:
        result = least_of([ReadAs(one.option, one.meaning, judged(one.asked)) for one in damped])
        asked = next(each.asked for each, one in zip(damped, result.readings, strict=True) if one.audit.every is result.every)
        return replace(result, of=asked)

    def drives() -> ReadAs | None:
        there = drive_reading(model, gains, found)
        return None if there is None else ReadAs(there.option, there.meaning, judged(there.asked))

    return replace(with_drives(judged(found), drives, *HOST), of=found)


def _of_joints(**values: PerJoint) -> dict[str, Any]:
    """Options of JOINT_VALUES: of all joints, and by pattern."""
    assert tuple(values) == JOINT_VALUES
    alike = {name: value if value is None else _number(name, value) for name, value in values.items() if not isinstance(value, Mapping)}
    some = ((name, each) for name, each in values.items() if isinstance(each, Mapping))
    by_pattern = ((name, str(pattern), _number(f"{name} of {pattern!r}", value)) for name, each in some for pattern, value in each.items())
    return {**alike, "of_joints": tuple(by_pattern)}


def _number(owner: str, value: Any) -> float:
    """Number of an argument. Raises GainroomError for what is none."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise GainroomError(f"{owner}: {value!r} must be a number") from None


def _words(given: Words) -> tuple[str, ...]:
    """Words as options take them: WORD, or PATTERN=WORD."""
    if isinstance(given, Mapping):
        return tuple(f"{pattern}={word}" for pattern, word in given.items())
    return (given,) if isinstance(given, str) else tuple(given or ())


def _posture(given: str | Mapping[str, float] | Sequence[str]) -> tuple[str, ...]:
    if isinstance(given, Mapping):
        return tuple(f"{pattern}={_number(f'posture of {pattern!r}', angle)!r}" for pattern, angle in given.items())
    return (given,) if isinstance(given, str) else tuple(given)


@contextmanager
def _gains_as_file(model: str, gains: Any, base: Any) -> Iterator[Path | None]:
    """Gains as a file, where they are in memory one whose folder no message names; None for the model's own."""
    if gains is None or isinstance(gains, str | Path):
        yield None if gains is None else Path(gains)
        return
    plain = _by_name(gains) if isinstance(gains, Mapping) else _in_order(gains, load_model(locate(model), base, for_names=True).joint_names)
    with text_as_file(yaml.safe_dump(plain, sort_keys=False, allow_unicode=True), "gains.yaml", "gains") as path:
        yield path


def _by_name(gains: Mapping[Any, Any]) -> dict[str, dict[str, float | str]]:
    """Gains by joint's name or pattern, from mappings or pairs (kp, kd)."""
    found: dict[str, dict[str, float | str]] = {}
    for name, own in gains.items():
        try:
            given = own if isinstance(own, Mapping) else dict(zip(("kp", "kd"), own, strict=True))
            found[str(name)] = {str(key): value if isinstance(value, str) else float(value) for key, value in given.items()}
        except (TypeError, ValueError):
            raise GainroomError(f"gains: {name!r}: {own!r} must be {{'kp': …, 'kd': …}} or (kp, kd)") from None
    return found


def _in_order(gains: Any, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Gains of joints in the model's order, from arrays (kp, kd)."""
    try:
        kp, kd = (np.broadcast_to(np.asarray([each], dtype=float)[0], len(names)).tolist() for each in gains if each is not None)
    except (TypeError, ValueError):
        form = f"a path, {{pattern: {{'kp': …, 'kd': …}}}}, or (kp, kd) with one number or {len(names)} each, one per joint"
        raise GainroomError(f"gains: must be {form}: {first_of_many(names)}") from None
    return {name: {"kp": one, "kd": other} for name, one, other in zip(names, kp, kd, strict=True)}


def _renamed(system: System, names: Mapping[str, str]) -> System:
    """System with other names of files in what it says."""

    def renamed(text: str) -> str:
        for path, name in names.items():
            text = text.replace(path, name)
        return text

    said = {key: tuple(map(renamed, getattr(system, key))) for key in ("assumptions", "warnings")}
    return replace(system, source=replace(system.source, name=renamed(system.source.name)), **said)
