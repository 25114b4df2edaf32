"""What `gainroom audit` is asked, without a configuration file: a model, the gains it runs with, and a few numbers, as a RobotSpec."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError, first_of_many, named, nearest
from ..io.validation import checked, number
from ..io.yaml_text import shown
from ..robot.actuators import ActuatorEntry, Actuators, actuators_of
from ..robot.body import Base, RigidBody
from ..robot.contact import Contact
from ..robot.formats.mjcf import keyframes
from ..robot.formats.model_files import load_model, locate
from ..robot.name_patterns import select
from ..robot.plausibility import unusual_robot
from ..robot.spec import Posture, Robot, RobotControl, RobotSpec
from ..system.controller import PD, PID
from ..system.drive import Drive
from .common_sections import BANDWIDTH, DELAY_MS, RATE, refuse_long_delay
from .file_types import kind_of_file, wrong_kind
from .gain_files import JointGains, gains_of, read_gains
from .robot_yaml import base_of, refuse_absurd_gains, refuse_long_delays

POSITIVE_OR_INFINITE = number(above=0, infinite=True)
CHECKS = {
    "rate_hz": RATE,
    "stiffness": POSITIVE_OR_INFINITE,
    "damping": number(least=0),
    "motor_inertia": number(above=0),
    "bandwidth": BANDWIDTH,
}
"""What options that may be left out may hold."""
ANGLE = number(least=-1e4, most=1e4)
DESCRIPTIONS = (".yaml", ".yml", ".json")


@dataclass(frozen=True)
class AuditOptions:
    """As they are typed: ms, Hz, otherwise SI; None: not given. `contacts` are frames on the ground, all at once.

    posture   JOINT=ANGLE (a name or pattern; rad, m where the joint slides), or the name of an MJCF's keyframe; later ones win
    """

    delay_ms: float
    rate_hz: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    motor_inertia: float | None = None
    bandwidth: float | None = None
    base: Base | Any = None
    contacts: tuple[str, ...] = ()
    posture: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        checked("--delay-ms", self.delay_ms, DELAY_MS)
        if self.base not in (None, "fixed", "floating"):
            raise GainroomError(f"--base {self.base}: must be fixed or floating")
        for name, check in CHECKS.items():
            if getattr(self, name) is not None:
                checked(f"--{name.replace('_', '-')}", getattr(self, name), check)
        if self.damping is not None and not self.is_elastic:
            raise GainroomError(f"--damping {self.damping:g}: is of elastic gearboxes; give --stiffness too")
        if self.rate_hz is not None:
            refuse_long_delay(1e-3 * self.delay_ms, 1 / self.rate_hz, "--delay-ms")

    @property
    def is_elastic(self) -> bool:
        """Whether the gearboxes bend."""
        return self.stiffness is not None and math.isfinite(self.stiffness)


def margin_factor(decibels: float) -> float:
    """The factor of a gain margin in dB. Raises GainroomError."""
    return 10 ** (checked("--margin-db", decibels, number(least=0, most=100)) / 20)


def audit_spec(model: str, gains: Path | None, options: AuditOptions) -> RobotSpec:
    """A robot with the gains it has; joints without gains are held still.

    model   a URDF or MJCF, or a name of robot_descriptions
    gains   where they are (see gain_files.py); None: in the model, an MJCF

    Raises GainroomError, one line that names the file or option, the value and what is allowed.
    """
    path = locate(model)
    _require_model(path)
    base, guessed = base_of(options.base, path, bool(options.contacts))
    body = load_model(path, base)
    source = path if gains is None else gains
    found = gains_of(read_gains(source), (*body.joint_names, *body.locked))
    held = [name for name, given in zip(body.joint_names, found.given, strict=False) if not given]
    kept = [k for k, name in enumerate(body.joint_names) if name not in held]
    if not kept:
        raise GainroomError(f"{path}: no joint that can move has gains")
    angles = _angles(options.posture, path, (*body.joint_names, *body.locked))
    if held or not angles.keys().isdisjoint(body.locked):
        body = load_model(path, base, held, posture_for_locked=angles)
    posture = Posture(body, {name: angle for name, angle in angles.items() if name in body.joint_names})
    actuators, notes = _actuators(body, found.motor_inertia[kept], options)
    robot = Robot(
        name=str(path), actuators=actuators, postures={_posture_name(options): posture}, contacts=_contacts(body, options.contacts)
    )
    sample_time = None if options.rate_hz is None else 1 / options.rate_hz
    refuse_long_delays(body.joint_names, [1e-3 * options.delay_ms] * body.size, sample_time)
    drive = Drive(delay=1e-3 * options.delay_ms, bandwidth=math.inf if options.bandwidth is None else options.bandwidth)
    control = _controller(found, kept)
    with named(str(source)):
        refuse_absurd_gains(body, actuators, (drive,) * body.size, control)
    unusual = unusual_robot(actuators, body.joint_names, [drive] * body.size, control, sample_time, slides=body.slides)
    return RobotSpec(
        robot=robot,
        drives=(drive,) * body.size,
        control=RobotControl("joint", control, "motor", sample_time),
        assumptions=(*guessed, *_assumptions(body, held, options), *notes),
        warnings=(*found.notes, *body.notes, *_beyond_limits(posture), *unusual),
    )


def _posture_name(options: AuditOptions) -> str:
    """As it was typed."""
    return first_of_many(options.posture) or "zero"


def _angles(typed: Sequence[str], path: Path, joint_names: Sequence[str]) -> dict[str, float]:
    """Angles by joint name, of those that are named. Raises GainroomError that names the option."""
    angles: dict[str, float] = {}
    for text in typed:
        owner = f"--posture {shown(text)}"
        pattern, sign, number_typed = text.rpartition("=")
        if not sign:
            angles |= _keyframe(text, owner, path)
            continue
        try:
            value = float(number_typed)
        except ValueError as error:
            raise GainroomError(f"{owner}: {shown(number_typed)} must be a number in rad (m where the joint slides)") from error
        angle = checked(owner, value, ANGLE)
        angles |= dict.fromkeys((joint_names[k] for k in select(pattern, joint_names, owner)), angle)
    return angles


def _keyframe(name: str, owner: str, path: Path) -> Mapping[str, float]:
    known = keyframes(path)
    if name not in known:
        raise GainroomError(f"{owner}: must be JOINT=ANGLE, or a keyframe of an MJCF{nearest(name, tuple(known), 'keyframe')}")
    return known[name]


def _beyond_limits(posture: Posture) -> tuple[str, ...]:
    body = posture.body
    beyond = body.beyond_limits(body.configuration(posture.angles))
    posed = tuple(f"joint {name!r} " for name in posture.angles)
    return tuple(
        f"{text}; {'move --posture inside, or check the model' if text.startswith(posed) else 'a robot.yaml can pose it, or --posture'}"
        for text in beyond
    )


def _require_model(path: Path) -> None:
    """Raise GainroomError where a YAML file stands in a model's place."""
    if path.suffix.lower() in DESCRIPTIONS:
        found = kind_of_file(path)
        if found in ("joint", "robot"):
            raise wrong_kind(str(path), "URDF or MJCF", found)
        if found == "other":
            raise GainroomError(f"{path}: must be a URDF or MJCF; gains go with --gains {path}")


def _actuators(body: RigidBody, inertia: np.ndarray, options: AuditOptions) -> tuple[Actuators, tuple[str, ...]]:
    """Motor inertia from the gains' file, else from the option, else from the model's armature; one gearbox for all."""
    entries = [
        ActuatorEntry(
            motor_inertia=options.motor_inertia if np.isnan(value) else float(value),
            stiffness=math.inf if options.stiffness is None else options.stiffness,
            damping=options.damping,
        )
        for value in inertia
    ]
    return actuators_of(entries, body.joint_names, body.armature)


def _contacts(body: RigidBody, frames: Sequence[str]) -> dict[str, tuple[Contact, ...]]:
    """In the air, and on the named frames where there are any."""
    for frame in frames:
        if frame not in body.frames:
            raise GainroomError(f"--contact {frame}: the robot has no such frame{nearest(frame, body.frames, 'frame')}")
        if frames.count(frame) > 1:
            raise GainroomError(f"--contact {frame}: is given twice")
    in_air = {"flight" if body.base == "floating" else "free": ()}
    return in_air | ({"contact": tuple(Contact(frame) for frame in frames)} if frames else {})


def _controller(found: JointGains, kept: Sequence[int]) -> PD | PID:
    kp, kd, ki = (column[list(kept)] for column in (found.kp, found.kd, found.ki))
    return PID(kp=kp, ki=ki, kd=kd) if np.any(ki) else PD(kp=kp, kd=kd)


def _assumptions(body: RigidBody, held: Sequence[str], options: AuditOptions) -> tuple[str, ...]:
    """What is taken for granted where nothing was said, each with how to say it."""
    zero = "every joint stands at 0, perhaps far from how the robot works: give --posture"
    notes = ["joints that --posture does not name stand at 0" if options.posture else zero, "the encoders are on the motor side"]
    if held:
        notes.append(f"these joints are held still, as they have no gains: {first_of_many(held)}")
    if not options.is_elastic:
        notes.append("gearboxes are rigid, which flatters: give --stiffness and --damping")
    if options.bandwidth is None:
        notes.append("current loops are infinitely fast: give --bandwidth [rad/s]")
    if body.base == "floating" and not options.contacts:
        notes.append("the robot is in flight only: name the frames on the ground with --contact")
    return tuple(notes)
