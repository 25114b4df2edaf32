"""Text of a joint.yaml with the controller that a comparison found, its limits with the ceilings that it keeps, and the box that it holds.

Of a robot.yaml the gains of the one joint are others; its limits are those of all joints, and stay.
"""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..design.comparison.compared_joint import ComparedJoint
from ..errors import GainroomError, listed, named
from ..io.as_typed import as_typed
from ..robot.name_patterns import DEFAULT, select_all
from ..studies.comparison import Comparison, ComparisonSettings, Row, compared_joint
from ..studies.coupled_comparison import compared_joints
from ..system.controller import Compensator, type_of
from ..system.filters import FILTERS
from ..system.requirements import REQUIREMENTS
from ..system.system import System
from ..system.uncertainty import Uncertainty
from .compare_section import CompareSection
from .edited_text import Keys, edited, plain, with_section
from .file_types import kind_of_file
from .joint_yaml import load_comparison, parse_comparison
from .law_section import law_written
from .robot_yaml import load_robot_system, parse_robot

UNITS = {"delay": ("delay_ms", 1e3)}
"""Keys of `uncertainty` that differ from the name of the quantity, and their units per SI."""


def load_compared(path: Path, joint: str | None = None, state: str | None = None) -> tuple[System, ComparisonSettings, ComparedJoint]:
    """Joint of a joint.yaml, or a joint of a robot.yaml, None the softest: as its file describes it, what is compared, and where.

    joint   a pattern that matches several joints: all of them together, in one `state`, "posture/contact", None: where one is softest

    Raises GainroomError, one line that names the file.
    """
    if kind_of_file(path) != "robot":
        if state is not None:
            raise GainroomError(f"--state {state}: is of several joints of a robot.yaml")
        given, settings = load_comparison(path)
        with named(str(path)):
            return given, settings, compared_joint(given, joint)
    system = load_robot_system(path)
    with named(str(path)):
        names = system.source.joint_names
        (found,) = [()] if joint is None else select_all([joint], names, "--joint", all_match=False)
        if state is not None and len(found) < 2:
            raise GainroomError(f"--state {state}: is of several joints together; one joint is compared in all states")
        if len(found) > 1:
            posture, _, contact = (state or "").partition("/")
            one = compared_joints(system, found, None if state is None else (posture, contact))
        else:
            one = compared_joint(system, names[found[0]] if found else joint)
    given = one.alone if system.uncertainty.names else replace(one.alone, uncertainty=Uncertainty())
    return given, CompareSection.model_validate({}).settings(given), one


def compared_text(found: Comparison, row: Row, text: str, source: str, version: str) -> str:
    """The joint.yaml `text`, which messages call `source`, with the controller of `row`. It is read again before it is handed back."""
    assert row.controller is not None
    result = text
    for key, section in (("control", control_section(row.controller)), ("limits", _limits(found, row))):
        result = with_section(result, source, key, section)
    boxed = found.system.uncertainty
    if not parse_comparison(text, source)[0].uncertainty.names:
        keys = {name: UNITS.get(name, (name, 1.0)) for name in boxed.names}
        ranges = {key: [_seven(unit * float(end)) for end in getattr(boxed, name)] for name, (key, unit) in keys.items()}
        result = edited(result, source, {("uncertainty",): ranges}, plain)
    ceilings = "Ms, delay reserve and torque noise"
    head = f"# Controller {row.structure}, found by gainroom compare {version}: the stiffest at equal {ceilings} in this box.\n"
    if missed := [f"{one.title} {one.text(value)}" for one, _, value in row.missed(found.system.requirements)]:
        head += f"# Of this file's limits it misses: {listed(missed)}, which a comparison does not hold controllers to.\n"
    parse_comparison(head + result, "the joint.yaml to be written")
    return head + result


def compared_robot_text(found: Comparison, row: Row, text: str, source: str, version: str) -> str:
    """The robot.yaml `text`, which messages call `source`, with the gains of `row` in its joint. It is read again before it is returned."""
    joint = found.joint.name
    assert row.robot is not None
    values: dict[Keys, Any] = {("control", key): value for key, value in gains_section(joint, row.robot).items()}
    result = edited(text, source, values, plain)
    head = f"# Gains of {joint}: {row.structure}, found by gainroom compare {version}, all other joints closed by theirs.\n"
    parse_robot(head + result, "the robot.yaml to be written", Path(source).parent)
    return head + result


def gains_section(joint: str, robot: System) -> dict[str, Any]:
    """Keys of `control` in a robot.yaml that hold the gains of `robot`, with its type: those that most joints have as default."""
    controller, names = robot.control.controller, robot.source.joint_names
    found: dict[str, Any] = {"type": type_of(controller)}
    for key in controller.gain_names():
        values = [_seven(value) for value in np.broadcast_to(getattr(controller, key), len(names))]
        others = [value for name, value in zip(names, values, strict=True) if name != joint] or values
        usual = Counter(others).most_common(1)[0][0]
        own = {re.escape(name): value for name, value in zip(names, values, strict=True) if value != usual}
        found[key] = {DEFAULT: usual, **own} if own else usual
    return found


def control_section(system: System) -> dict[str, Any]:
    """Section `control` of a joint.yaml for the controller of `system`."""
    control, controller = system.control, system.control.controller
    found: dict[str, Any] = {"type": type_of(controller)}
    if isinstance(controller, Compensator):
        laws = controller.laws or {control.feedback.position: controller.system}
        found |= {sensor: law_written(law.scaled(float(controller.gain))) for sensor, law in laws.items()}
    else:
        found |= {key: _seven(getattr(controller, key)) for key in controller.gain_names()}
        found["feedback"] = control.feedback.written
    for name in FILTERS:
        filters = getattr(controller, name)
        if filters:
            found[name] = [_numbers(one) for one in filters] if isinstance(filters, tuple) else _numbers(filters)
    if control.sample_time is not None:
        found["sample_rate_hz"] = _seven(1 / control.sample_time)
    if control.kd_path is not None:
        path = control.kd_path
        found["kd_path"] = {"delay_ms": _seven(1e3 * path.delay), "sample_rate_hz": _seven(1 / path.sample_time)}
    return found


def _numbers(one: Any) -> dict[str, float]:
    """Numbers of a filter, by key; a damping ratio that an order of 1 has not is left out."""
    found = {name: getattr(one, name) for name in one.__dataclass_fields__}
    if found.get("order") == 1:
        found = {name: value for name, value in found.items() if name not in ("order", "damping_ratio")}
    return {name: value if isinstance(value, int) else _seven(value) for name, value in found.items()}


def _seven(value: Any) -> float:
    return float(f"{float(value):.7g}")


def _limits(found: Comparison, row: Row) -> dict[str, float]:
    """The ceilings that the controller keeps everywhere in the box, and all other limits of the file."""
    held = {"peak_sensitivity": found.ceilings.peak_sensitivity}
    if row.controller is not None and row.controller.control.kd_path is None:  # of two paths each has a reserve of its own
        held["delay_reserve"] = found.ceilings.delay_reserve
    asked = {one.name: needed for one, needed in found.system.requirements.asked_for} | held
    return {REQUIREMENTS[name].key: as_typed(REQUIREMENTS[name].in_unit(needed)) for name, needed in asked.items()}
