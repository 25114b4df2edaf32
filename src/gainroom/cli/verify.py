"""gainroom verify: the predicted limit compared with simulation."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import named
from .options import AsJson, Report, command_line, kind_of, report_stream, typed_command
from .output import present
from .progress import progress_bar

if TYPE_CHECKING:
    from ..system.system import System


def verify(
    context: typer.Context,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A joint.yaml or robot.yaml with control.sample_rate_hz.", show_default=False)
    ],
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """Find by simulation the gains at which vibration starts, and compare them with the predicted limit.

    A robot is simulated twice, in every contact state: its linear loop, and its bodies, springs and drives in MuJoCo.

    \b
    Example:
      gainroom verify joint.yaml --report verify.html

    Exit status: 0 they agree within the tolerance (linear simulation: 0.1 %, MuJoCo: 2 %); 1 they do not, or the gains
    are unstable; 2 the file or the call is wrong; 130 interrupted.
    """
    system, effects = _load(file)
    with report_stream(report) as page:
        from ..report.verification_text import VerificationPresentation
        from ..studies.verification import verify as verified

        with progress_bar("verify:") as progress, named(str(file)):
            result = verified(system, progress, effects)
        study_call = command_line("robot" if result.of_robot else "joint", file)
        shown = VerificationPresentation(system, result, call=study_call, files={"Report": report})
        present(shown, as_json, False)
        if page is not None:
            from ..report.verification import verification_page

            page.write(verification_page(shown, typed_command(context)))
    return 0 if result.agrees else 1


def _load(file: Path) -> "tuple[System, tuple[str, ...]]":
    """System that the file describes, and the names of its scenario's effects."""
    if kind_of(file) == "robot":
        from ..files.robot_yaml import load_robot_system
        from ..simulation.robot_simulation import require_sampled, scenario_effects

        robot = load_robot_system(file)
        require_sampled(robot)
        return robot, scenario_effects(robot.scenario)
    from ..files.joint_yaml import load_simulation

    simulation = load_simulation(file, two_paths=True)
    return simulation.system, simulation.scenario_effects
