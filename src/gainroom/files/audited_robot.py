"""Text of a robot.yaml for the robot of an audit, to continue from."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ..errors import named
from ..io.as_typed import as_typed
from ..system.requirements import Requirements
from .robot_yaml import parse_robot


class _Dumper(yaml.SafeDumper):
    """YAML writer that keeps numbers as typed and writes equal lists out each time, as a robot.yaml has no references."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(float, lambda dumper, value: dumper.represent_float(as_typed(value)))


def audited_robot_text(sections: Mapping[str, Any], model: str, required: Requirements, heading: Sequence[str], target: Path) -> str:
    """Text of a robot.yaml in the place `target`, which is read back before it is returned.

    sections    of the audit
    model       as it was typed; a file is named from the folder of `target`
    required    of the audit
    heading     lines of comment

    Raises GainroomError where what is written cannot be read back.
    """
    file = os.path.relpath(model, target.parent) if Path(model).exists() else model
    limits = {one.key: one.in_unit(needed) for one, needed in required.asked_for}
    data = {**sections, "model": {**sections["model"], "file": file}, "limits": limits}
    body = yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    text = "".join(f"# {' '.join(line.split())}\n" for line in heading) + body
    with named("the robot.yaml that would be written cannot be read"):
        parse_robot(text, str(target), target.parent, two_paths=True)
    return text
