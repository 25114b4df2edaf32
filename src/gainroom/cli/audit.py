"""gainroom audit: whether the gains that a robot already has are safe."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import named
from ..io.as_typed import as_typed
from ..report.number_format import model_facts, model_text
from .model_options import ModelCall, audited_text
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
from .output import closing, column_table, do_this, folded_parts, headings, render, show, warned_first
from .progress import progress_bar

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..files.audit_options import Audited
    from ..report.page import Advice
    from ..simulation.simulated_gains import Simulator
    from ..studies.audit import Audit
    from ..studies.audited_workspace import AuditedWorkspace
    from ..studies.simulator_audit import SimulatorAudit
    from ..system.requirements import Requirements
    from ..system.system import System

STIFFNESS = "By the stiffness of the gearboxes that are not known"
FEW_LINES = 4
"""Shown without being asked for all; of more, the table has the factors."""
FEW_JOINTS = 4
"""Shown without being asked for all, at most: those with the least headroom."""
SCREEN_LINES = 25
"""Of a short answer; where it would be longer, fewer joints are shown."""


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
            metavar="LIMIT=NUMBER", help="Another limit of safe gains, as in a robot.yaml: delay_margin_ms=2; may be given again."
        ),
    ] = None

    def of(self, margin_db: float) -> "Callable[[System], Requirements]":
        """Requirements of a system, with a gain margin of `margin_db`. Raises GainroomError."""
        from ..files.typed_requirements import further_requirements, margin_factor
        from ..studies.audit import required_of

        further = further_requirements(self.delay_margin_ms, self.phase_margin_deg, self.peak_sensitivity, self.require or ())
        margin = margin_factor(margin_db)
        return lambda system: required_of(margin, further, system.control.kd_path is not None)


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
        """The simulator, as simulator_of has it; None where nothing is asked. Raises GainroomError."""
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
    damping_ratio: Annotated[
        float, number_option("--damping-ratio", "", "Of gearboxes whose stiffness is not given, for how stiff they must be; 0.05 is 5 %.")
    ] = 0.05,
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
    from ..files.audit_options import audited
    from ..studies.audit import audit as run_audit

    if workspace is not None:
        from ..studies.sweep.postures import require_postures

        require_postures(workspace, "--workspace")
    options, required = given.options(delay_ms, damping_ratio=damping_ratio), asked.of(given.margin_db)
    found = audited(model, given.gains, options)
    simulator = training.of(model, given.gains is None, found.options.joint_damping == "controller")
    besides = (*vars(training), "workspace", "write_robot")
    call = typed_command(context, *besides, "report")
    with report_stream(report, write_robot) as page, text_output(write_robot, "robot.yaml", yaml_of="--write-robot") as robot:
        with progress_bar("audit:") as progress, named(model):

            def judged(one: "Audited") -> "Audit":
                result = run_audit(one.system, required(one.system), progress, options.damping_ratio, one.gearboxes)
                return replace(result, joint_damping=one.options.joint_damping)

            result, found = read_in_every_way(model, given.gains, found, judged)
        simulated = None
        if simulator is not None:
            from ..studies.simulator_audit import audit_simulator

            with progress_bar("audit:") as progress:
                progress(0, 0, "in the simulator")
                simulated = audit_simulator(result, *simulator)
        swept = None
        if workspace is not None:
            from ..studies.audited_workspace import audited_workspace

            with progress_bar("audit:") as progress:
                swept = audited_workspace(result, workspace, progress)
        show(
            as_json,
            lambda: _facts(result, simulated, swept, found),
            lambda: _terminal(result, simulated, swept, call, found.options.where_gains_run, report, write_robot, verbose),
        )
        if robot is not None and write_robot is not None:
            robot.write(audited_text(found, result, model, result.required, call, write_robot))
        if page is not None:
            from ..report.audit import audit_page

            page.write(audit_page(result, typed_command(context, "write_robot"), simulated, swept, call))
    return exit_status(result.verdict_with(simulated, swept), exit_zero)


def read_in_every_way(model: str, gains: Path | None, found: "Audited", judged: "Callable[[Audited], Audit]") -> "tuple[Audit, Audited]":
    """The audit of what was `found`, or of each way to read what it leaves open, and what it is of; `judged`: of one of them."""
    from ..files.readings import HOST, damping_readings, drive_reading
    from ..studies.audit import ReadAs
    from ..studies.audit_readings import least_of, with_drives

    damped = damping_readings(model, gains, found)
    if damped:
        result = least_of([ReadAs(one.option, one.meaning, judged(one.asked)) for one in damped])
        return result, next(each.asked for each, one in zip(damped, result.readings, strict=True) if one.audit.every is result.every)

    def drives() -> ReadAs | None:
        there = drive_reading(model, gains, found.options)
        return None if there is None else ReadAs(there.option, there.meaning, judged(there.asked))

    return with_drives(judged(found), drives, *HOST), found


def _facts(result: "Audit", simulated: "SimulatorAudit | None", swept: "AuditedWorkspace | None", found: "Audited") -> dict[str, Any]:
    """What --json prints."""
    from .. import __version__
    from ..files.carried_robot import carried
    from ..report.audit_text import audit_scale, audit_sentence, audit_warnings
    from ..report.columns import facts
    from ..report.gearboxes import gearbox_assumptions, needed_facts, range_facts
    from ..report.margin_columns import required_facts
    from ..report.number_format import path_facts
    from ..report.robot_columns import AUDITED_JOINT, audited_states

    columns = audited_states(result.enough_in)
    from ..system.margin_units import to_db
    from ..system.requirements import REQUIREMENTS

    further = {name: one for name, one in REQUIREMENTS.items() if name not in ("gain_margin", "delay_margin")}
    paths = result.tightest.margins.paths
    return {
        "robot": result.system.source.name,
        "gainroom": __version__,
        **result.verdict_with(simulated, swept).facts,
        "safe": result.verdict_with(simulated, swept).level == "safe",
        "decided": result.decided,
        "sentence": audit_sentence(result),
        "requirements_met": result.safe,
        "unmet": list(result.missed),
        "required": required_facts(result.required),
        "scale": audit_scale(result),
        "to_use": _to_use_facts(result),
        **model_facts(result.system.control.sample_time),
        "delay_ms": 1e3 * max(drive.delay for drive in result.system.drives),
        "command_delay_ms": 1e3 * result.system.control.command_delay,
        "kd_path": path_facts(result.system.control.kd_path),
        "gains_run": found.options.gains_run,
        "joint_damping": found.options.joint_damping,
        "margin_db": as_typed(to_db(result.margin)),
        "stable": all(state.limit.stable for state in result.states),
        "gain_limit": result.tightest.limit.gain,
        "limit_frequency_rad_s": result.tightest.limit.frequency,
        "delay_limit_ms": 1e3 * result.delay_limit,
        "delay_margin_ms": 1e3 * result.least_extra_delay if result.stable else math.nan,
        **{one.key: one.in_unit(one.value(result.worst[name].margins)) for name, one in further.items()},
        "path_gain_limits": None if paths is None else {"kp": [paths.lower_others, paths.others], "kd": [paths.lower_kd, paths.kd]},
        "limiting_joints": list(result.limiting_joints),
        "posture": result.angles,
        "base": result.system.source.body.base,
        "system": carried(found.sections, result.system),
        "joints": [facts(AUDITED_JOINT, joint) for joint in result.joints],
        "states": [facts(columns, state) for state in result.states + result.immobile],
        **_further_facts(simulated, swept),
        "needed_stiffness": needed_facts(result),
        "gearbox_range": range_facts(result),
        "readings": [
            {
                "option": one.option,
                "meaning": one.meaning,
                "safe": one.audit.safe,
                "gain_limit": one.audit.tightest.limit.gain,
                "unsafe_joints": [joint.name for joint in one.audit.joints if not joint.safe],
            }
            for one in result.readings
        ],
        "rigid_gearboxes": [joint.name for joint, rigid in zip(result.joints, result.assumed_rigid.tolist(), strict=True) if rigid],
        "assumptions": [*result.system.assumptions, *gearbox_assumptions(result)],
        "warnings": list(audit_warnings(result)),
    }


def _to_use_facts(result: "Audit") -> dict[str, Any] | None:
    """The factor (None: each has its own), the joints whose gains it is on, whether they may be used yet, and every joint's gains as typed.

    None for safe gains, and where none are known.
    """
    found = result.to_use
    if found is None:
        return None
    names = result.system.source.joint_names
    columns = {**found.gains, "factor": found.factors}
    gains = [{"name": name, **{key: float(values[k]) for key, values in columns.items()}} for k, name in enumerate(names)]
    return {"factor": found.factor, "scaled": list(found.joints), "ready": result.ready_to_use is not None, "joints": gains}


def _terminal(
    result: "Audit",
    simulated: "SimulatorAudit | None",
    swept: "AuditedWorkspace | None",
    call: str,
    gains_run: str,
    report: Path | None,
    written: Path | None,
    verbose: bool,
) -> str:
    """`call`, `written`: see what_to_do; `gains_run`: where; `verbose`: also every contact state and joint, and all that is assumed."""
    from ..report.audit_advice import what_to_do
    from ..report.audit_text import audit_warnings
    from ..report.columns import definitions
    from ..report.gearboxes import CAPTION, gearbox_assumptions, look_columns, shown_looks
    from ..report.robot_columns import audited_joints, audited_states, joint_caption, legend
    from ..report.verdict import MOST_WARNINGS

    control = result.system.control
    title = f"All joints together ({model_text(control.sample_time, control.kd_path)})"
    columns = audited_states(result.enough_in)
    said, assumed = _further_text(simulated, swept, result.safe)
    assumed, warned = result.system.assumptions + gearbox_assumptions(result) + assumed, audit_warnings(result)
    needed, do = result.needed, what_to_do(result, call, written, None if verbose else FEW_LINES)
    doubts, warned = warned_first(warned, None if verbose else MOST_WARNINGS)
    answer = _answer(result, simulated, swept, do)
    stiffness = [] if needed is None else ["", column_table(STIFFNESS, look_columns(result, needed), shown_looks(needed)), CAPTION]
    if not verbose:
        other = "gain_limit" if result.stable else "limit_others_closed"  # which is not what joints are judged by
        columns = [one for one in audited_joints(result) if one.key not in ("motor_inertia", other)]

        def screen(count: int) -> str:
            """With the `count` joints of the least headroom."""
            left = result.joints_tightest_first[count:]
            failing = sum(not joint.safe for joint in left)
            of_them = f", {failing} of which fail" if failing else ""
            others = f"{len(left)} more joint{'s' * (len(left) > 1)}{of_them}: --verbose. " if left else ""
            joints = column_table("", columns, result.joints_tightest_first[:count])
            return render(
                *doubts,
                *answer,
                *said,
                joints,
                others + legend(result, headings(joints)),
                *closing({"Report": report, "Robot": written}, warned),
                f"Posture: {result.states[0].posture}; {result.system.source.body.base} base{_rigid(result)}; "
                f"{gains_run} (--gains-run). {len(assumed)} assumptions: --verbose.",
            )

        screens = (screen(count) for count in range(FEW_JOINTS, 0, -1))
        return next((text for text in screens if text.count("\n") <= SCREEN_LINES), screen(1))
    states = column_table(title, columns, result.states + result.immobile)
    joints = column_table("Joint by joint, in the worst state", audited_joints(result), result.joints, ("motor inertia", "one loop"))
    return render(
        *doubts,
        *answer,
        *said,
        "",
        states,
        definitions(columns, headings(states)),
        "",
        joints,
        joint_caption(result, headings(joints)),
        *stiffness,
        *folded_parts(do),
        f"Posture: {result.states[0].posture}; {result.system.source.body.base} base",
        *closing({"Report": report, "Robot": written}, warned, assumed),
    )


def _answer(result: "Audit", simulated: "SimulatorAudit | None", swept: "AuditedWorkspace | None", do: "Advice") -> list[Any]:
    """The verdict, what to do, and why."""
    from ..report.audit_text import reason, verdict
    from ..report.words import in_simulator

    said, there = in_simulator(verdict(result), simulated), do_this(do)
    if swept is not None and not swept.safe:
        from ..report.workspace import advice_there, in_workspace

        said = in_workspace(said, swept)
        there = do_this(replace(advice_there(swept), remarks=())) if result.safe else there
    return [said, *there, reason(result)]


def _rigid(result: "Audit") -> str:
    """That gearboxes are assumed to be rigid, where some are."""
    rigid = result.assumed_rigid.tolist()
    count = sum(rigid)
    which = "" if all(rigid) else f"{count} of {len(rigid)} "
    return f"; {which}gearboxes assumed rigid (--stiffness, --damping)" if count else ""


def _further_facts(simulated: "SimulatorAudit | None", swept: "AuditedWorkspace | None") -> dict[str, Any]:
    """What was asked for besides; loaded only where it was."""
    found: dict[str, Any] = {"simulator": None, "workspace": None}
    if simulated is not None:
        from ..report.simulator_text import simulator_facts

        found["simulator"] = simulator_facts(simulated)
    if swept is not None:
        from ..report.workspace import audited_facts

        found["workspace"] = audited_facts(swept)
    return found


def _further_text(simulated: "SimulatorAudit | None", swept: "AuditedWorkspace | None", safe: bool) -> tuple[list[str], tuple[str, ...]]:
    """Its paragraphs, and what the simulator assumes; likewise. `safe`: where it was audited, so that the workspace says what to do."""
    said, assumed = [], ()
    if simulated is not None:
        from ..report.simulator_text import simulator_assumptions, simulator_sentence

        said, assumed = ["", simulator_sentence(simulated)], simulator_assumptions(simulated)
    if swept is not None:
        from ..report.workspace import workspace_text

        said += ["", workspace_text(swept, not safe)]
    return said, assumed
