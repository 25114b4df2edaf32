"""YAML of ros2_control: the text of a whole file, and p, i, d written into an existing one."""

import json
import re
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

from ...errors import GainroomError, first_of_many
from ...io.yaml_text import parse_yaml
from ..edited_text import Keys, edited
from ..gain_formats.gain_record import Gain
from ..gain_formats.ros2_control import read_ros2_control
from .form import ExportedGains, ExportForm, commented, entries, number_text, quoted
from .sampled_law import LINE, SampledFilter, SampledLaw, filter_notes, sampled_law

CONTROLLER = "effort_joint_trajectory_controller"
FILTERED = "joint_filters"
"""Name of the controller that filters what joints measure, and with it of the joints as the trajectory controller reads them."""
UNCHANGED = SampledFilter("unchanged", ())
"""Filter of an interface that has none, for each needs a chain."""
HEADER = re.compile(r"\A(?:# gains by gainroom\b[^\n]*\n)(?:# {2}[^\n]*\n)*")


def ros2_terms(gain: Gain) -> dict[str, float]:
    """Terms p, i, d of a gain, and its effort limit as their clamp."""
    limit = gain.effort_limit
    return {"p": gain.kp, "i": gain.ki, "d": gain.kd} | ({} if limit is None else {"u_clamp_max": limit, "u_clamp_min": -limit})


def ros2_control_text(goal: ExportedGains, header: Sequence[str]) -> str:
    """YAML of a joint_trajectory_controller with effort commands; its update_rate is an integer.

    Filters become those of a chained_filter_controller, whose output the trajectory controller reads in place of the joints' own.
    """
    rate, law = goal.origin.sample_rate_hz, sampled_law(goal)
    manager = "controller_manager:\n  ros__parameters:\n" + (f"    update_rate: {round(rate)}\n" if rate else "")
    own = {name: quoted(name) for name in goal.gains}
    read = own if law is None else {name: quoted(f"{FILTERED}/{name}") for name in goal.gains}
    lines = [f"      {read[name]}: {{{entries(ros2_terms(gain))}}}\n" for name, gain in goal.gains.items()]
    if law is not None:
        header = [*header, f"  {law.line}"]
        manager += f"    {FILTERED}: {{type: chained_filter_controller/ChainedFilter}}\n"
    commanded = "" if law is None else f"    command_joints: [{', '.join(own.values())}]\n"
    return (
        f"{commented(header)}{manager}    {CONTROLLER}: {{type: joint_trajectory_controller/JointTrajectoryController}}\n"
        f"{'' if law is None else _filter_chains(law, list(goal.gains))}"
        f"{CONTROLLER}:\n  ros__parameters:\n    joints: [{', '.join(read.values())}]\n{commanded}    command_interfaces: [effort]\n"
        f"    state_interfaces: [position, velocity]\n    gains:\n{''.join(lines)}"
    )


def _filter_chains(law: SampledLaw, joints: Sequence[str]) -> str:
    """Section of the chained_filter_controller: a chain for each joint's position and one for its velocity.

    As all is linear, what filters the torque filters its measured position and velocity as well.
    """
    chains = {"position": law.shaping, "velocity": law.filters}
    interfaces = {f"{joint}/{measured}": chain or (UNCHANGED,) for joint in joints for measured, chain in chains.items()}
    names = ", ".join(map(json.dumps, interfaces))
    text = f"{FILTERED}:\n  ros__parameters:\n    input_interfaces: [{names}]\n    output_interfaces: [{names}]\n"
    for interface, chain in interfaces.items():
        text += f"    {json.dumps(interface)}:\n      filter_chain:\n"
        text += "".join(f"        filter{k}: {_transfer_function(one)}\n" for k, one in enumerate(chain, 1))
    return text


def _transfer_function(one: SampledFilter) -> str:
    """Filter of the package `filters`, which divides b by a."""
    b, a = (one.coefficients[:3], ("1.0", *one.coefficients[3:])) if one.coefficients else (("1.0",), ("1.0",))
    params = f"{{a: [{', '.join(a)}], b: [{', '.join(b)}]}}"
    return f"{{name: {one.name.replace(' ', '_')}, type: filters/TransferFunctionFilterDouble, params: {params}}}"


def _notes(goal: ExportedGains, text: str, onto: Path | None) -> list[str]:
    """Notes on how the filters' controller is run."""
    law = None if onto is not None else sampled_law(goal)
    if law is None:
        return filter_notes(goal, text, onto)
    settled = f"activate {FILTERED} {law.settling:.2g} s or more before {CONTROLLER}: filters begin at 0, and joints are not there"
    return [
        f"the filters are in {FILTERED}, of the package chained_filter_controller, which filters what the joints measure: the loop is the "
        f"same, set-points are not filtered, and trajectories call the joints {FILTERED}/{next(iter(goal.gains))}",
        settled,
    ]


def ros2_control_onto(text: str, path: Path, goal: ExportedGains, header: Sequence[str]) -> str:
    """YAML `text` of a file with p, i and d of these gains; the rest of it stays as it is.

    Raises GainroomError where a joint is not in it.
    """
    source, law, old = str(path), sampled_law(goal), LINE.search(text)
    text = HEADER.sub("", text)
    data = parse_yaml(text, source)
    if not isinstance(data, dict):
        raise GainroomError(f"{source}: must be a ros2_control file with p, i and d under joints' names")
    if old is not None:
        if law is None or law.line != old[0]:
            raise GainroomError(f"{source}: its {FILTERED} are not those of these gains; export a new file (without --onto)")
        header = [*header, f"  {law.line}"]
    paths = read_ros2_control(data, source, "holds no gains of ros2_control to replace").paths
    if missing := [joint for joint in goal.gains if joint not in paths]:
        raise GainroomError(f"{source}: has no p, i and d for {first_of_many(missing)}; add them, or export a new file (without --onto)")
    values: dict[Keys, float] = {}
    for joint, gain in goal.gains.items():
        there = reduce(lambda node, key: node[key], paths[joint], data)
        terms = ros2_terms(gain)
        values |= {(*paths[joint], term): value for term, value in terms.items() if value or term in there}
    return commented(header) + edited(text, source, values, number_text)


ROS2_CONTROL = ExportForm(
    *("ros2_control", "ros2_control", "a joint_trajectory_controller", ".yaml", ros2_control_text, ros2_control_onto),
    notes=_notes,
    integral=True,
)
