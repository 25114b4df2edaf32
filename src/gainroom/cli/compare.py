"""gainroom compare: what another controller, another sensor, or damping in the drive buys a joint at equal robustness."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import AsJson, Report, Verbose, number_option, report_stream, text_output, typed_command
from .output import present
from .progress import progress_bar

if TYPE_CHECKING:
    from ..design.comparison.compared_joint import ComparedJoint
    from ..studies.comparison import Comparison, ComparisonSettings, Row
    from ..system.system import System


JointNames = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Joint of a robot.yaml, or a pattern of several together, all others closed by its gains; else the softest.",
        show_default=False,
    ),
]
State = Annotated[
    str | None,
    typer.Option(metavar="POSTURE/CONTACT", help="State for several joints together, else the softest.", show_default=False),
]
Structures = Annotated[
    str | None,
    typer.Option(metavar="KEY,KEY,…", help="pd, pid, pd+biquad, dob, observer, split, torque_feedback …", show_default=False),
]
SensorNoise = Annotated[
    float | None,
    number_option("--torque-sensor", "in N·m", "As if the joint had a torque sensor with so much noise [N·m rms].", show_default=False),
]
TorqueNoise = Annotated[
    float | None,
    number_option("--noise", "in N·m", "Largest rms torque command that noise may make [N·m], else the best PD's.", show_default=False),
]
ObjectiveName = Annotated[str | None, typer.Option(metavar="NAME", help="dynamic_stiffness, white_load or step_load.", show_default=False)]
BestKnown = Annotated[
    bool, typer.Option("--best-known", help="Also how near to that a controller is known to come (needs gainroom[compare]).")
]


def compare(
    context: typer.Context,
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="A joint.yaml with control.sample_rate_hz; gains may be left out. Or a robot.yaml.", show_default=False
        ),
    ],
    joint: JointNames = None,
    state: State = None,
    structures: Structures = None,
    torque_sensor: SensorNoise = None,
    noise: TorqueNoise = None,
    objective: ObjectiveName = None,
    bound: Annotated[bool, typer.Option(help="Also what no linear controller can beat.")] = True,
    best_known: BestKnown = False,
    write: Annotated[
        Path | None, typer.Option(metavar="FILE.yaml", help="Also write a copy with the controller found.", show_default=False)
    ] = None,
    take: Annotated[
        str | None, typer.Option(metavar="KEY", help="Structure for --write, else the one to use as the joint is.", show_default=False)
    ] = None,
    as_json: AsJson = False,
    verbose: Verbose = False,
    report: Report = None,
) -> int:
    """Is PD the problem? Other structures, another sensor, kd in the drive: tuned at equal Ms, delay reserve and torque noise.

    \b
    Example:
      gainroom compare joint.yaml --report compare.html
      gainroom compare joint.yaml --torque-sensor 0.05
      gainroom compare joint.yaml --structures pd,split --write better.yaml --take split
      gainroom compare robot.yaml --joint left_knee
      gainroom compare robot.yaml --joint "left_.*" --state stand/left

    Exit status: 0 done; 2 the file or the call is wrong; 130 interrupted.
    """
    from ..errors import named
    from ..files.compare_section import assumption
    from ..files.compared_joint import load_compared

    given, settings, one = load_compared(file, joint, state)
    if one.beside:
        alone = {"torque-sensor": torque_sensor, "noise": noise, "objective": objective, "best-known": best_known or None}
        _refuse_of_one(alone | {"write": write, "take": take, "report": report})
        return _together(file, given, one, _structures(structures, None, None)[0], assumption(given, settings), as_json, verbose)
    settings = _settings(settings, torque_sensor, noise, objective)
    keys, taken = _structures(structures, take, write)
    with report_stream(report, write) as page, text_output(write, "copy of the file", yaml_of="--write") as copy:
        from ..report.comparison_text import ComparisonPresentation
        from ..studies.comparison import compare as compared

        with progress_bar("compare:") as progress, named(str(file)):
            found = compared(one.system, keys, joint=one, settings=settings, bound=bound, best_known=best_known, progress=progress)
        row = None if copy is None else _taken(found, taken)
        call, files = typed_command(context, "report", "write", "take"), {"Report": report, "Joint" if one.is_single else "Robot": write}
        shown = ComparisonPresentation(found, given, settings, str(file), assumption(given, settings), row, call=call, files=files)
        present(shown, as_json, verbose)
        if page is not None:
            from ..report.comparison import comparison_page

            page.write(comparison_page(shown, typed_command(context)))
        if copy is not None and row is not None:
            copy.write(_text_of_copy(found, row, file))
    return 0


def _refuse_of_one(given: Mapping[str, object]) -> None:
    """Raise GainroomError for the first option given that several joints together do not have."""
    from ..errors import GainroomError

    for option, value in given.items():
        if value is not None:
            raise GainroomError(f"--{option}: is of one joint; several together are held to σ_max(S) and the delay disk, and printed")


def _together(
    file: Path, given: "System", joint: "ComparedJoint", keys: list[str] | None, assumed: list[str], as_json: bool, verbose: bool
) -> int:
    """Compare several joints together, and print it; `given` has the ranges of the file."""
    from ..errors import named
    from ..report.coupled_comparison import CoupledPresentation
    from ..studies.coupled_comparison import compare_together

    with progress_bar("compare:") as progress, named(str(file)):
        found = compare_together(joint, keys, ranged=bool(given.uncertainty.names), progress=progress)
    present(CoupledPresentation(found, assumed), as_json, verbose)
    return 0


def _settings(
    settings: "ComparisonSettings", torque_sensor: float | None, noise: float | None, objective: str | None
) -> "ComparisonSettings":
    """Settings of the file with what the command line says otherwise. Raises GainroomError for numbers and names that do not fit."""
    from dataclasses import replace

    from ..design.comparison.objective import OBJECTIVES, Objective
    from ..errors import require_positive
    from ..io.validation import require_one_of

    if torque_sensor is not None:
        require_positive("--torque-sensor", "noise", torque_sensor, "N·m")
        settings = replace(settings, sensor_noise={**settings.sensor_noise, "torque": torque_sensor})
    if noise is not None:
        require_positive("--noise", "torque noise", noise, "N·m")
        settings = replace(settings, torque_noise=noise)
    if objective is not None:
        names = [name for name in OBJECTIVES if name != "low_frequency_compliance" or settings.objective.name == name]
        require_one_of(f"--objective {objective}", objective, names)
        settings = replace(settings, objective=settings.objective if objective == settings.objective.name else Objective(objective))
    return settings


def _structures(structures: str | None, take: str | None, write: Path | None) -> tuple[list[str] | None, str | None]:
    """Keys of the structures to compare, None for the file's, and of the one to write. Raises GainroomError where they do not fit."""
    from ..errors import GainroomError

    if take is not None and write is None:
        raise GainroomError(f"--take {take}: is for --write, which names the file")
    keys = None if structures is None else [_structure(one.strip(), "--structures") for one in structures.split(",")]
    taken = None if take is None else _structure(take, "--take")
    if taken is not None and keys is not None and taken not in keys:
        raise GainroomError(f"--take {take}: must be one of --structures {structures}")
    return keys, taken


def _structure(key: str, option: str) -> str:
    """Key of a structure as results have it. Raises GainroomError for one that is not known."""
    from ..design.comparison.catalogue import structure_of
    from ..errors import named

    with named(option):
        return structure_of(key).key


def _taken(found: "Comparison", key: str | None) -> "Row":
    """Row to write. Raises GainroomError where there is none that holds the box, or that a robot.yaml can hold."""
    from ..errors import GainroomError
    from ..report.comparison_text import winner

    row = winner(found) if key is None else found.row(key)
    if row is None or not row.holds:
        why = "no structure holds the box" if row is None else f"{row.structure} does not hold the box: {row.broken}"
        raise GainroomError(f"--write: {why}")
    if not found.joint.is_single and row.robot is None:
        held = [one.structure for one in found.rows if one.holds and one.robot is not None]
        other = f"; --take {held[0]} can be written" if held else ""
        raise GainroomError(
            f"--write: a robot.yaml cannot hold {row.structure} in one joint: filters and rates are those of all joints{other}"
        )
    return row


def _text_of_copy(found: "Comparison", row: "Row", file: Path) -> str:
    """Text of the file to write."""
    from .. import __version__
    from ..files.compared_joint import compared_robot_text, compared_text
    from ..io.yaml_text import read_text

    text_of = compared_text if found.joint.is_single else compared_robot_text
    return text_of(found, row, read_text(file), str(file), __version__)
