"""Options of `audit` about a model and the gains it runs with, for every command that takes a model."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import Number, joints_option, number_option

USUAL_DB = 6.0
"""Default gain margin of safe gains [dB]."""

if TYPE_CHECKING:
    from ..files.audit_options import Audited, AuditOptions
    from ..studies.audit import Audit
    from ..system.requirements import Requirements


@dataclass(frozen=True)
class ModelCall:
    """Options about a model, as typed."""

    gains: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Gains: plain or ros2_control YAML, a Python file of mjlab or Isaac Lab (FILE.py:NAME), Kp and Kd arrays, a policy's "
            "ONNX, moteus, {read forms}; without it, the MJCF's own actuators.",
        ),
    ] = None
    rate_hz: Annotated[Number, number_option("--rate-hz", "in Hz", "Of the controller [Hz]; without it, continuous time.")] = None
    stiffness: Annotated[
        list[str] | None,
        joints_option(
            "--stiffness", "in N m/rad", "Of every gearbox [N m/rad], or of the joints that match a pattern, which wins; without it, rigid."
        ),
    ] = None
    damping: Annotated[list[str] | None, joints_option("--damping", "in N m s/rad", "The same of its damping [N m s/rad].")] = None
    gearbox: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[JOINT=]TYPE",
            help="harmonic, planetary, cycloidal, belt: judge the worst of a typical range of stiffness and damping; direct: rigid. Of all "
            "joints, or of those that match a pattern; may be repeated, the later wins.",
        ),
    ] = None
    motor_inertia: Annotated[
        list[str] | None,
        joints_option(
            "--motor-inertia",
            "in kg m²",
            "Joint side [kg m²]: of all joints of which the gains' file names none, or of those that match a pattern.",
        ),
    ] = None
    actuator: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[JOINT=]NAME",
            help="An actuator of `gainroom actuators`: its published figures stand where the gains' file has none. Of all joints, or of "
            "those that match a pattern; may be repeated, the later wins.",
        ),
    ] = None
    bandwidth: Annotated[Number, number_option("--bandwidth", "in rad/s", "Of the current loops [rad/s]; without it, ideal.")] = None
    base: Annotated[str | None, typer.Option(help="fixed or floating; without it, as the MJCF has it. fixed locks a free joint.")] = None
    contact: Annotated[
        list[str] | None,
        typer.Option(metavar="FRAME[:TYPE]", help="A frame on the ground, flat; FRAME:line, FRAME:point; may be repeated."),
    ] = None
    balance: Annotated[
        str | None,
        typer.Option(
            metavar="WHO",
            help="Who damps the sway of a floating base on its contacts: joints, by their gains; controller, one above them, so that its "
            "phase margin and Ms do not count.",
        ),
    ] = None
    posture: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=ANGLE",
            help="Position of a joint, or of all that match a pattern [rad; m if prismatic]; or the name of an MJCF's keyframe. May be "
            "repeated, the later wins; default 0.",
        ),
    ] = None
    joint_damping: Annotated[
        str | None,
        typer.Option(
            metavar="WHAT",
            help="What the model's own joint damping is: controller (a part of kd) or friction; without it, it does not count.",
        ),
    ] = None
    margin_db: Annotated[float, number_option("--margin-db", "in dB", "Gain margin that safe gains have [dB].")] = USUAL_DB
    gains_run: Annotated[
        str | None,
        typer.Option(
            metavar="WHERE",
            help="host: kp and kd see all of --delay-ms, as is assumed without it; drive: it only delays set-points; split: kd runs on the "
            "drive, kp on the host.",
        ),
    ] = None
    drive_rate_hz: Annotated[Number, number_option("--drive-rate-hz", "in Hz", "Of gains that run on the drive [Hz].")] = None
    drive_delay_ms: Annotated[
        Number, number_option("--drive-delay-ms", "in milliseconds", "Of their own loop, measurement to torque [ms].")
    ] = None

    def options(self, delay_ms: float, **more: Any) -> "AuditOptions":
        """Options of audit from these and `more`. Raises GainroomError."""
        from ..files.audit_options import JOINT_VALUES, AuditOptions

        apart = ("gains", "margin_db", "contact", "posture", "gearbox", "actuator", *JOINT_VALUES)
        alike: dict[str, Any] = {name: value for name, value in vars(self).items() if name not in apart}
        of_joints: list[tuple[str, str, float]] = []
        for name in JOINT_VALUES:
            for text in getattr(self, name) or ():
                pattern, sign, value = text.rpartition("=")
                if sign:
                    of_joints.append((name, pattern, float(value)))
                else:
                    alike[name] = float(value)
        several = {"contacts": self.contact, "posture": self.posture, "gearboxes": self.gearbox, "actuators": self.actuator}
        alike |= {name: tuple(given or ()) for name, given in several.items()}
        return AuditOptions(delay_ms, of_joints=tuple(of_joints), **alike, **more)


def audited_text(found: "Audited", result: "Audit | None", model: str, required: "Requirements", command: str, target: Path) -> str:
    """Text of the robot.yaml in the place `target`, with comments on its readings; `result`: the audit, if there is one.

    Raises GainroomError.
    """
    from .. import __version__
    from ..files.audited_robot import audited_robot_text

    heading, sections = [f"Written by gainroom {__version__}: {command}"], found.sections
    if result is not None and result.open:
        read = next((one.option for one in result.readings if one.audit.every is result.every), "")
        others = [one.option for one in result.readings if one.option != read]
        heading.append(f"This file reads {model} as with {read}; it may as well be {' or '.join(others)}, of which the audit tells.")
    return audited_robot_text(sections, model, required, heading, target)
