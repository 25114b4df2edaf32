"""Commands that carry gains from `gainroom robot` into a file, and from that file into an audit."""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..files.typed_requirements import unusual_limits
from ..io.as_typed import as_typed
from ..robot.formats.model_names import is_name
from ..system.system import System

FOUND = "found.json"
"""Name of the file between the two commands, which receives the answer of the first."""


def search_and_audit(call: str, robot: str) -> list[str]:
    """Commands that find gains for the file `robot` and audit them; `call`: command of the present audit."""
    return [kept(shlex.join(["gainroom", "robot", robot])), with_found(call)]


def kept(call: str) -> str:
    """Command with its answer redirected to FOUND."""
    return f"{call} --json > {FOUND}"


def with_found(call: str) -> str:
    """Audit command with the gains in FOUND in place of its own.

    FOUND holds the stiffness that the gains were found with; a gearbox type given for all joints is written as a pattern that wins over it.
    """
    words, found = shlex.split(call), list[str]()
    for before, word in zip(["", *words], words, strict=False):
        if word != "--gains" and before != "--gains":
            found.append(f".*={word}" if before == "--gearbox" and "=" not in word else word)
    return shlex.join([*found, "--gains", FOUND])


def audit_of_found(sections: Mapping[str, Any], folder: Path, system: System) -> str:
    """Command that audits the gains in FOUND, of a robot.yaml with these `sections` in `folder`, with all its other data."""
    model, control = sections["model"], system.control
    package, file = model.get("package"), str(model["file"])
    file = f"{package}:{file}" if package else file if is_name(file) else str(folder / file)
    typed = [
        f"{re.escape(name)}={kind}" for name, kind in zip(system.source.joint_names, system.source.actuators.gearbox, strict=True) if kind
    ]
    kinds = set(system.source.actuators.gearbox)
    typed = [f".*={kind}" for kind in kinds] if len(kinds) == 1 and typed else typed
    ranges = [word for one in typed for word in ("--gearbox", one)]
    limits = [word for limit in unusual_limits(system.requirements) for word in ("--require", limit)]
    delay = _typed(1e3 * (control.command_delay or system.delay))
    return shlex.join(["gainroom", "audit", file, "--delay-ms", delay, *ranges, *limits, "--gains", FOUND])


def _typed(value: float) -> str:
    return repr(as_typed(value)).removesuffix(".0")
