"""gainroom identify plan: the excitation to run on a joint before its log is identified."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import AsJson, Number, Report, number_option, refuse_inputs, report_stream, typed_command
from .output import render, show, table

if TYPE_CHECKING:
    from ..identification.plan import Plan

KINDS = ("multisine", "chirp")


def plan(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A joint.yaml with rough values; intervals welcome.", show_default=False)],
    max_torque: Annotated[Number, number_option("--max-torque", "in N m", "Of controller and excitation together [N m].")] = None,
    max_speed: Annotated[Number, number_option("--max-speed", "in rad/s", "Of either side of the gearbox [rad/s].")] = None,
    max_travel: Annotated[Number, number_option("--max-travel", "in rad", "To either side [rad].")] = None,
    kind: Annotated[str, typer.Option("--kind", metavar="|".join(KINDS), help="Of excitation.")] = "multisine",
    duration: Annotated[float, number_option("--duration", "in seconds", "Of the recording [s].")] = 20.0,
    friction: Annotated[
        Number, number_option("--friction", "in N m", "Coulomb's, joint side [N m]; without it, the file's of motor and link.")
    ] = None,
    encoder_step: Annotated[
        Number, number_option("--encoder-step", "in rad", "Joint side [rad]; without it, the file's, else 1e-4.")
    ] = None,
    torque_noise: Annotated[
        Number, number_option("--torque-noise", "in N m", "Standard deviation [N m]; without it, 1 % of the excitation.")
    ] = None,
    open_loop: Annotated[bool, typer.Option("--open-loop", help="No controller holds the joint; it may drift.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="LOG", help="Write time and target_torque: .csv, .parquet or .mcap.")
    ] = None,
    as_json: AsJson = False,
    report: Report = None,
) -> int:
    """What to run on a joint so that its log tells inertias, stiffness and delay: a torque within limits, and the accuracy to expect.

    Friction, encoder steps and torque limit are those of the file's scenario; friction else that of its section identified.

    \b
    Example:
      gainroom identify plan joint.yaml --max-torque 40 --output excitation.csv
      gainroom simulate joint.yaml --feedforward excitation.csv --log run.csv
      gainroom identify joint run.csv

    Exit status: 0 done; 2 the file or the call is wrong, or no log of such a recording can tell the joint.
    """
    from ..errors import GainroomError

    if kind not in KINDS:
        raise GainroomError(f"--kind: {kind!r} must be {' or '.join(KINDS)}")
    found = _planned(file, (max_torque, max_speed, max_travel), kind, duration, (friction, encoder_step, torque_noise), not open_loop)
    from ..report.plan import facts, plan_page

    with report_stream(report, output) as page:
        if output is not None:
            _write(found, output)
        show(as_json, lambda: facts(found) | {"output": None if output is None else str(output)}, lambda: _terminal(found, output, report))
        if page is not None:
            page.write(plan_page(found, typed_command(context, "output")))
    return 0


def _planned(
    file: Path, bounds: tuple[Number, Number, Number], kind: Any, duration: float, hardware: tuple[Number, Number, Number], closed: bool
) -> "Plan":
    """Plan from the options, else from the file's scenario. Raises GainroomError."""
    import math

    from ..errors import named, require_positive
    from ..files.joint_yaml import load_simulation

    for name, value in zip(("--friction", "--encoder-step", "--torque-noise"), hardware, strict=True):
        if value is not None:
            require_positive("options", name, value, zero=name == "--friction")
    simulation = load_simulation(file)
    from ..identification.plan import Bounds, plan_excitation

    torque, speed, travel = bounds
    friction, step, noise = hardware
    known = simulation.hardware
    torque = known.get("torque_limit") if torque is None else torque
    friction, link_friction = (simulation.coulomb or (None, 0.0)) if friction is None else (friction, 0.0)
    step = known.get("motor_resolution") if step is None else step
    with named(str(file)):
        allowed = Bounds(*(math.inf if value is None else value for value in (torque, speed, travel)))
        return plan_excitation(simulation.system, allowed, kind, duration, friction, step, noise, closed, link_friction)


def _write(found: "Plan", output: Path) -> None:
    from ..files.logs import open_log

    refuse_inputs(output, "excitation")
    with open_log(output, found.system.source.joint_names, ("target_torque",)) as writer:
        writer.write({"time": found.excitation.time, "target_torque": found.torque[:, None]})


def _terminal(found: "Plan", output: Path | None, report: Path | None) -> str:
    from ..report.plan import EXPECTED_TITLES, LIMIT_TITLES, assumptions, expected_rows, limit_rows, sentence
    from ..report.presentation import closing

    return render(
        sentence(found),
        "",
        table("Limits", LIMIT_TITLES, limit_rows(found)),
        table("Accuracy to expect", EXPECTED_TITLES, expected_rows(found)),
        *assumptions(found),
        *closing({"Excitation": output, "Report": report}, found.warnings),
    )
