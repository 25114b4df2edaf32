"""gainroom verify: the predicted limit compared with simulation."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..report.number_format import digits
from .options import AsJson, Report, command_line, kind_of, report_stream
from .output import closing, emit, emit_json, render, table
from .progress import progress_bar

if TYPE_CHECKING:
    from ..studies.simulation import Progress
    from ..studies.verification import Case, Verification
    from ..system.system import System

    Run = Callable[[Progress], Verification]

CASE_KEYS = {
    "what": "what",
    "witness": "witness",
    "predicted_gain": "predicted_gain",
    "simulated_gain": "simulated_gain",
    "predicted_frequency_rad_s": "predicted_frequency",
    "simulated_frequency_rad_s": "simulated_frequency",
    "gain_difference": "gain_difference",
    "frequency_difference": "frequency_difference",
    "tolerance": "tolerance",
    "agrees": "agrees",
}
"""JSON's names of what a Case holds."""


def verify(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A joint.yaml or robot.yaml with control.sample_rate_hz.", show_default=False),
    ],
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """Find by simulation the gains at which vibration starts, and compare them with the predicted limit.

    A robot is simulated twice, in every contact state: its linear loop, and its bodies, springs and drives in MuJoCo.

    \b
    Example:
      gainroom verify joint.yaml --report verify.html

    Exit status: 0 they agree within the tolerance (linear simulation: 0.1 %, MuJoCo: 2 %); 1 they do not; 2 the file or the call is wrong;
    130 interrupted.
    """
    system = _load(file)
    with report_stream(report) as page:
        from ..studies.verification import verify as verified

        with progress_bar("verify:") as progress:
            result = verified(system, progress)
        if as_json:
            emit_json(_facts(result))
        else:
            emit(_terminal(result, report))
        if page is not None:
            from ..report.verification import verification_page

            page.write(verification_page(system, result, command_line("verify", file, ("--report", report))))
    return 0 if result.agrees else 1


def _load(file: Path) -> "System":
    """What the file describes."""
    if kind_of(file) == "robot":
        from ..files.robot_yaml import load_robot_system
        from ..simulation.robot_simulation import require_sampled

        robot = load_robot_system(file)
        require_sampled(robot)
        return robot
    from ..files.joint_yaml import load_simulation

    return load_simulation(file).system


def _facts(result: "Verification") -> dict[str, Any]:
    """What --json prints."""
    from ..report.verification_text import sentence

    return {
        "agrees": result.agrees,
        "sentence": sentence(result),
        "cases": [{name: getattr(case, field) for name, field in CASE_KEYS.items()} for case in result.cases],
        "warnings": list(result.warnings),
    }


def _terminal(result: "Verification", report: Path | None) -> str:
    from ..report.verification_text import frequency_cells, gain_cells, sentence

    columns = ("method", "predicted", "simulated", "difference", "allowed", "agrees")
    gains = [(case.what, case.witness, *gain_cells(case), *_verdict(case, case.gain_difference)) for case in result.cases]
    frequencies = [(case.what, case.witness, *frequency_cells(case), *_verdict(case, case.frequency_difference)) for case in result.cases]
    parts: list[Any] = [
        sentence(result),
        "",
        table("Factor on all gains at which vibration starts", ("", *columns), gains),
        table("Its frequency", ("[rad/s]", *columns), frequencies),
    ]
    parts += [f"Left out: {warning}" for warning in result.warnings]
    return render(*parts, *closing({"Report": report}, ()))


def _verdict(case: "Case", difference: float) -> tuple[str, str]:
    return f"{digits(100 * case.tolerance)} %", "yes" if abs(difference) <= case.tolerance else "no"
