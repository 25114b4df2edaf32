"""Export of the joints of a joint.yaml or robot.yaml as actuators of a trainer that have their delay, their rate and their gearbox.

What such an actuator cannot hold is refused: a policy would be trained on another joint, and nobody would see it.
"""

import datetime
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError, first_of_many, printable
from ..system.controller import PD, gain_matrix, type_of
from ..system.filters import FILTERS
from ..system.linear.arrays import Floats
from ..system.system import System
from ..trainers.elastic_delayed import DAMPING_RATIO
from .export_forms.actuator_configs import patterns
from .export_forms.form import commented, number_text
from .file_types import kind_of_file
from .gain_export import Export
from .joint_yaml import load_joint
from .robot_yaml import load_robot_system


def export_actuators(path: Path, form: str, onto: Path | None, version: str, today: datetime.date) -> Export:
    """Export of the joints of the file at `path` in one of OF_WHOLE_FILES. Raises GainroomError for what the form cannot hold."""
    if onto is not None:
        raise GainroomError(f"--onto {onto}: actuators are written as a whole; give --output")
    kind = kind_of_file(path) if path.suffix.lower() in (".yaml", ".yml") else "other"
    if kind not in ("joint", "robot"):
        raise GainroomError(f"{path}: --to {form} needs a joint.yaml or a robot.yaml, which say the delay, the rate and the motors")
    system = load_joint(path, two_paths=True) if kind == "joint" else load_robot_system(path, two_paths=True)
    if problems := [*_not_held(system)]:
        raise GainroomError(*(f"{path}: {problem}" for problem in problems))
    names = (path.stem,) if kind == "joint" else system.source.joint_names
    groups: dict[tuple[tuple[str, Any], ...], list[str]] = {}
    for name, numbers in zip(names, _numbers(system), strict=True):
        groups.setdefault(tuple(numbers.items()), []).append(name)
    header = [
        f"actuators by gainroom {version}, {today.isoformat()}, from {path}",
        "  the physics step and the periods must be multiples of one time",
    ]
    return Export(_mjlab(groups, [printable(line) for line in header]), "", {}, (), tuple(_notes(system, names)))


def _not_held(system: System) -> Iterator[str]:
    """Messages about what an actuator does not hold, and about what it needs and the file does not say."""
    control, law, unheld = system.control, system.control.controller, "has no place in an actuator"
    if law is None:
        yield f"control.space: a task's gain {unheld}"
    else:
        others = [name for name in law.gain_names() if name not in PD.gain_names() and np.any(getattr(law, name))]
        if others or not {*PD.gain_names()} <= {*law.gain_names()}:
            yield f"control.type: {type_of(law)}: {' and '.join(others) or 'what it has instead of kp and kd'} {unheld}"
        yield from (
            f"control.{name}: a gain that couples joints {unheld}" for name in PD.gain_names() if np.ndim(getattr(law, name, 0.0)) == 2
        )
    yield from (f"control.{name}: a filter {unheld}" for name in FILTERS if getattr(law, name, None) or getattr(control, name))
    if control.feedback.mixed:
        yield f"control.feedback: a sensor for each gain ({control.feedback}) {unheld}"
    if control.sample_time is None:
        yield "control.sample_rate_hz is missing: an actuator samples its encoder"
    if ratios := {drive.damping_ratio for drive in system.drives if not drive.is_ideal} - {DAMPING_RATIO}:
        yield f"drive.damping_ratio: {min(ratios):g} {unheld}, whose current loops have {DAMPING_RATIO:g}"
    if unknown := system.source.unknown.get("motor_inertia_unknown"):
        yield f"joints: motor_inertia or rotor_inertia is missing of {first_of_many(unknown)}"


def _numbers(system: System) -> list[dict[str, Any]]:
    """Fields of each joint's actuator, those with their defaults left out."""
    control, quantities, size = system.control, system.source.quantities, len(system.source.joint_names)
    path, step = control.kd_path, control.sample_time
    assert step is not None

    def each(values: Any) -> Floats:
        return np.broadcast_to(np.asarray(values, dtype=float), size)

    rigid = np.isinf(quantities["stiffness"])
    limits = getattr(getattr(system.source, "actuators", None), "effort_limit", math.inf)
    columns: dict[str, tuple[Floats, float | None]] = {
        "stiffness": (np.diagonal(gain_matrix("kp", control.controller.kp, size)), None),
        "damping": (np.diagonal(gain_matrix("kd", control.controller.kd, size)), None),
        "effort_limit": (each(limits), math.inf),
        "viscous_damping": (quantities["link_viscous"], 0.0),
        "motor_inertia": (quantities["motor_inertia"], None),
        "gearbox_stiffness": (quantities["stiffness"], math.inf),
        "gearbox_damping": (np.where(rigid, 0.0, quantities["damping"]), 0.0),
        "viscous": (quantities["motor_viscous"], 0.0),
        "delay": (each([drive.delay for drive in system.drives]), None),
        "period": (each(step), None),
        "kd_delay": (each(math.nan if path is None else path.delay), None),
        "kd_period": (each(math.nan if path is None else path.sample_time), None),
        "bandwidth": (each([drive.bandwidth for drive in system.drives]), math.inf),
    }
    found: list[dict[str, Any]] = [
        {name: float(values[k]) for name, (values, default) in columns.items() if values[k] != default and not math.isnan(values[k])}
        for k in range(size)
    ]
    return found if control.feedback.motor else [{**one, "encoder": control.feedback.position} for one in found]


def _notes(system: System, names: tuple[str, ...]) -> Iterator[str]:
    """Notes on what the actuators leave to their user."""
    numbers = _numbers(system)
    if unlimited := [name for name, one in zip(names, numbers, strict=True) if "effort_limit" not in one]:
        yield f"no limit of the torque is known of {first_of_many(unlimited)}: give effort_limit"
    if rigid := system.source.unknown.get("gearbox_unknown"):
        yield f"the gearbox of {first_of_many(rigid)} is not known and taken as rigid, which vibrates later than an elastic one"
    low = math.nan if system.uncertainty.resonance is None else system.uncertainty.resonance[0]
    if typed := [name for name, one in zip(names, np.broadcast_to(low, len(names)).tolist(), strict=True) if not math.isnan(one)]:
        yield f"the gearbox of {first_of_many(typed)} is known by its type alone, and written with the middle of that type's range"
    if system.control.command_delay:
        late = 1e3 * system.control.command_delay
        yield f"set-points are {late:g} ms late on their way: delay_min_lag and delay_max_lag have that, in physics steps"
    if system.requirements.needed.get("jitter_margin"):
        yield "a delay that varies is not written: jitter has its range"
    if system.uncertainty.names:
        ranges = [name.replace("_", " ") for name in system.uncertainty.names]
        yield f"ranges of {first_of_many(ranges)} are written by their nominal values"


def _mjlab(groups: dict[tuple[tuple[str, Any], ...], list[str]], header: list[str]) -> str:
    """Python text of a tuple of ElasticDelayedActuatorCfg, joints with equal numbers together."""
    text = f"{commented(header)}from gainroom.trainers.mjlab import ElasticDelayedActuatorCfg\n\nACTUATORS = (\n"
    for fields, names in groups.items():
        text += f"    ElasticDelayedActuatorCfg(\n        target_names_expr=({patterns(names)},),\n"
        for name, value in fields:
            text += f"        {name}={number_text(value) if isinstance(value, float) else repr(value)},\n"
        text += "    ),\n"
    return f"{text})\n"
