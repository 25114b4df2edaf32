"""gainroom actuators: published figures of motors and gearboxes, each with its source."""

from typing import Annotated

import typer

from .options import AsJson
from .output import render, show


def actuators(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Which one, or a part of its name; without it, the list.", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Published figures of motors and gearboxes, for joint.yaml and robot.yaml (`actuator: NAME`) and `--actuator NAME`.

    \b
    Example:
      gainroom actuators robstride-04
      gainroom audit robot.xml --delay-ms 2 --gains gains.yaml --actuator '.*_knee=robstride-04'

    Exit status: 0 done; 2 no actuator is called so.
    """
    from ..report.actuator_text import chosen, facts, parts

    found = chosen(name)
    show(as_json, lambda: facts(found), lambda: render(*parts(found, name)))
    return 0
