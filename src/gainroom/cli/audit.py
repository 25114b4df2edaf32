"""gainroom audit: whether the gains that a robot already has are safe."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import named
from .model_options import USUAL_DB, ModelCall, audited_text
from .options import (
    AsJson,
    ExitZero,
    Number,
    Report,
    Verbose,
    exit_status,
    number_option,
    report_stream,
    text_output,
    typed_command,
    with_options,
)
from .output import present
from .progress import progress_bar

if TYPE_CHECKING:
    from ..simulation.simulated_gains import Simulator
    from ..studies.audit import Audit
    from ..studies.audited_workspace import AuditedWorkspace
    from ..studies.simulator_audit import SimulatorAudit
    from ..system.requirements import Requirements


@dataclass(frozen=True)
class RequirementCall:
    """Requirements of safe gains besides their gain margin, as they are typed."""

    delay_margin_ms: Annotated[
        Number,
        number_option(
            "--delay-margin-ms", "in milliseconds", "Extra delay that safe gains survive [ms]; without it, it is shown and not judged."
        ),
    ] = None
    phase_margin_deg: Annotated[
        Number, number_option("--phase-margin-deg", "in degrees", "Phase margin that safe gains have [°]; 30 without it.")
    ] = None
    peak_sensitivity: Annotated[
        Number, number_option("--peak-sensitivity", "", "Peak sensitivity Ms of safe gains, at most; 2 without it.")
    ] = None
    require: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LIMIT=NUMBER",
            help="Another limit of safe gains, as in a robot.yaml: delay_margin_ms=2; LIMIT=none: not asked for; may be given again.",
        ),
    ] = None

    def of(self, margin_db: float, along: Sequence[str]) -> "Requirements":
        """Requirements with a gain margin of `margin_db`. Raises GainroomError.

        along   limits that go along with the gains, each as --require takes it; those that are typed win over them
        """
        from ..files.typed_requirements import further_requirements, margin_factor
        from ..studies.audit import required_of

        typed = further_requirements(self.delay_margin_ms, self.phase_margin_deg, self.peak_sensitivity, self.require or ())
        further = {**further_requirements(None, None, None, along), **typed}
        if margin_db != USUAL_DB and "gain_margin" not in typed:
            further.pop("gain_margin", None)
        margin = margin_factor(margin_db)
        return required_of(margin, further)


@dataclass(frozen=True)
class SimulatorCall:
    """Questions about the simulator that trains a policy, as they are typed."""

    simulator: Annotated[
        str | None, typer.Option(metavar="mujoco", help="Also: are the gains stable in the simulator that trains a policy?")
    ] = None
    timestep: Annotated[Number, number_option("--timestep", "in seconds", "Of the simulator [s]; without it, the MJCF's.")] = None
    integrator: Annotated[str | None, typer.Option(metavar="NAME", help="MuJoCo's, as implicitfast; without it, the MJCF's.")] = None
    pd: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="explicit: a program computes torques; implicit: MuJoCo's actuators do; joint-damping: so, kd as joint damping.",
        ),
    ] = None
    decimation: Annotated[int | None, typer.Option(metavar="STEPS", help="For which an explicit torque is held; 1 by default.")] = None
    armature: Annotated[str | None, typer.Option(metavar="OF", help="Of the simulator's joints: file, or motor, its inertia.")] = None

    def of(self, model: str, own_gains: bool, damping_in_kd: bool) -> "tuple[Simulator, tuple[str, ...]] | None":
        """Simulator and notes, as simulator_of returns them; None if no option asks for it. Raises GainroomError."""
        if all(value is None for value in vars(self).values()):
            return None
        from ..files.simulator_options import SimulatorOptions, simulator_of

        return simulator_of(SimulatorOptions(**vars(self)), model, own_gains, damping_in_kd)


@with_options
def audit(
    *,
    context: typer.Context,
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="A URDF or MJCF; PACKAGE:FILE for one in an installed package; a name of robot_descriptions.",
            show_default=False,
        ),
    ],
    delay_ms: Annotated[
        float, number_option("--delay-ms", "in milliseconds", "Delay, host to motor torque [ms]; see --gains-run.", show_default=False)
    ],
    given: ModelCall,
    asked: RequirementCall,
    training: SimulatorCall,
    write_robot: Annotated[
        Path | None, typer.Option(metavar="ROBOT.yaml", help="Also write this robot as a robot.yaml, to go on from with gainroom robot.")
    ] = None,
    workspace: Annotated[
        int | None, typer.Option(metavar="POSTURES", help="Also: are the gains safe in so many postures within the joints' limits?")
    ] = None,
    as_json: AsJson = False,
    verbose: Verbose = False,
    exit_zero: ExitZero = False,
    report: Report = None,
) -> int:
    """Which of the gains that a robot already has are safe, their headroom, and the delay at which it vibrates.

    \b
    Example:
      gainroom audit robot.xml --delay-ms 2 --gains gains.yaml --report audit.html
      gainroom audit robot.urdf --delay-ms 2 --gains gains.yaml --posture '.*_knee=0.6' --posture '.*_hip_pitch=-0.3'
      gainroom audit robot.xml --delay-ms 2 --posture home
      gainroom audit robot.xml --delay-ms 2 --simulator mujoco --timestep 0.005 --pd explicit
      gainroom audit robot.xml --delay-ms 4 --rate-hz 500 --gains-run split --drive-rate-hz 20000 --drive-delay-ms 0.05

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..files.audit_call import read_in_every_way
    from ..files.audit_options import audited

    if workspace is not None:
        from ..studies.sweep.postures import require_postures

        require_postures(workspace, "--workspace")
    asked.of(given.margin_db, ())  # refused before the model is read
    found = audited(model, given.gains, given.options(delay_ms))
    required = asked.of(given.margin_db, found.options.required)
    simulator = training.of(model, given.gains is None, found.options.joint_damping == "controller")
    call = typed_command(context, *vars(training), "workspace", "write_robot", "report")
    with report_stream(report, write_robot) as page, text_output(write_robot, "robot.yaml", yaml_of="--write-robot") as robot:
        with progress_bar("audit:") as progress, named(model):
            result = read_in_every_way(model, given.gains, found, required, progress)
        from ..report.audit_text import AuditPresentation

        more = _besides(result, simulator, workspace)
        shown = AuditPresentation(result, result.of, *more, call=call, files={"Report": report, "Robot": write_robot})
        present(shown, as_json, verbose)
        if page is not None:
            from ..report.audit import audit_page

            page.write(audit_page(shown, typed_command(context, "write_robot")))
        if robot is not None and write_robot is not None:
            robot.write(audited_text(result.of, result, model, result.required, call, write_robot))
    return exit_status(shown.verdict, exit_zero)


def _besides(
    result: "Audit", simulator: "tuple[Simulator, tuple[str, ...]] | None", workspace: int | None
) -> "tuple[SimulatorAudit | None, AuditedWorkspace | None]":
    """Answers of the simulator and of the whole workspace; None for one that is not asked for."""
    simulated = swept = None
    if simulator is not None:
        from ..studies.simulator_audit import audit_simulator

        with progress_bar("audit:") as progress:
            progress(0, 0, "in the simulator")
            simulated = audit_simulator(result, *simulator)
    if workspace is not None:
        from ..studies.audited_workspace import audited_workspace

        with progress_bar("audit:") as progress:
            swept = audited_workspace(result, workspace, progress)
    return simulated, swept
