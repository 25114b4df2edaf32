"""What `audit` is asked about a model and the gains it runs with, for every command that takes a model."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import command_line, number_option

if TYPE_CHECKING:
    from ..files.audit_options import Audited, AuditOptions
    from ..studies.audit import Audit

Number = float | None
MARGIN_DB = 6.0
DAMPING_RATIO = 0.05

Gains = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Gains: plain or ros2_control YAML, a Python file of mjlab or Isaac Lab (FILE.py:NAME), Kp and Kd arrays, a policy's "
        "ONNX, moteus, MJCF; without it, the MJCF's own actuators.",
    ),
]
RateHz = Annotated[Number, number_option("--rate-hz", "in Hz", "Of the controller [Hz]; without it, continuous time.")]
Stiffness = Annotated[Number, number_option("--stiffness", "in N m/rad", "Of every gearbox [N m/rad]; without it, rigid.")]
Damping = Annotated[Number, number_option("--damping", "in N m s/rad", "Of every gearbox [N m s/rad].")]
DampingRatio = Annotated[
    float, number_option("--damping-ratio", "", "Of gearboxes whose stiffness is not given, for how stiff they must be; 0.05 is 5 %.")
]
Gearbox = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[JOINT=]TYPE",
        help="harmonic, planetary, cycloidal, belt: judge the worst of a typical range of stiffness and damping; direct: rigid. Of all "
        "joints, or of those that match a pattern; may be repeated, the later wins.",
    ),
]
MotorInertia = Annotated[Number, number_option("--motor-inertia", "in kg m²", "Joint side [kg m²], where the gains' file names none.")]
Bandwidth = Annotated[Number, number_option("--bandwidth", "in rad/s", "Of the current loops [rad/s]; without it, ideal.")]
Base = Annotated[str | None, typer.Option(help="fixed or floating; without it, as the MJCF has it. fixed locks a free joint.")]
Contact = Annotated[
    list[str] | None, typer.Option(metavar="FRAME[:TYPE]", help="A frame on the ground, flat; FRAME:line, FRAME:point; may be repeated.")
]
Posture = Annotated[
    list[str] | None,
    typer.Option(
        metavar="JOINT=ANGLE",
        help="Position of a joint, or of all that match a pattern [rad; m if prismatic]; or the name of an MJCF's keyframe. May be "
        "repeated, the later wins; default 0.",
    ),
]
JointDamping = Annotated[
    str | None,
    typer.Option(
        metavar="WHAT", help="What the model's own joint damping is: controller (a part of kd) or friction; without it, it does not count."
    ),
]
MarginDb = Annotated[float, number_option("--margin-db", "in dB", "Gain margin that safe gains have [dB].")]
GainsRun = Annotated[
    str | None,
    typer.Option(
        metavar="WHERE",
        help="host: kp and kd see all of --delay-ms, as is assumed without it; drive: it only delays set-points; split: kd runs on the "
        "drive, kp on the host.",
    ),
]
DriveRateHz = Annotated[Number, number_option("--drive-rate-hz", "in Hz", "Of gains that run on the drive [Hz].")]
DriveDelayMs = Annotated[Number, number_option("--drive-delay-ms", "in milliseconds", "Of their own loop, measurement to torque [ms].")]


def audit_command(
    model: str, gains: Path | None, options: "AuditOptions", asked: dict[str, Any], limits: dict[str, Any], report: Path | None
) -> str:
    """The command that makes the same page; `asked` of a simulator, `limits` by option."""
    return command_line(
        "audit",
        model,
        ("--delay-ms", options.delay_ms),
        ("--gains", gains),
        ("--rate-hz", options.rate_hz),
        ("--stiffness", options.stiffness),
        ("--damping", options.damping),
        ("--damping-ratio", options.damping_ratio if options.damping_ratio != DAMPING_RATIO else None),
        *(("--gearbox", text) for text in options.gearboxes),
        ("--motor-inertia", options.motor_inertia),
        ("--bandwidth", options.bandwidth),
        ("--base", options.base),
        *(("--contact", frame) for frame in options.contacts),
        *(("--posture", text) for text in options.posture),
        ("--joint-damping", options.joint_damping),
        ("--gains-run", options.gains_run),
        ("--drive-rate-hz", options.drive_rate_hz),
        ("--drive-delay-ms", options.drive_delay_ms),
        *((name, value if (name, value) != ("--margin-db", MARGIN_DB) else None) for name, value in limits.items()),
        *((f"--{name}", value) for name, value in asked.items()),
        ("--report", report),
    )


def audited_text(found: "Audited", result: "Audit | None", model: str, margin_db: float, command: str, target: Path) -> str:
    """The robot.yaml in the place `target`; `result`: where gearboxes were given by type, for their worst. Raises GainroomError."""
    from .. import __version__
    from ..files.audited_robot import audited_robot_text, with_gearboxes

    over = None if result is None else result.over
    sections = found.sections if result is None or over is None else with_gearboxes(found.sections, result.system.source, over.range.types)
    return audited_robot_text(sections, model, margin_db, command, __version__, target)
