"""Options of `gainroom audit`, which needs no configuration file: a model, the gains it runs with, and a few numbers.

They are put into the sections that a robot.yaml has and read as one, so both mean the same and are refused alike; messages name options.
"""

import contextlib
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ..errors import GainroomError, all_of, digits, first_of_many, listed, named, nearest, option_name, refuse_all
from ..io.validation import checked, require_one_of, validate
from ..io.yaml_text import shown
from ..robot.assemble import ASSUMED, DAMPING_NOTE
from ..robot.body import Base, RigidBody
from ..robot.contact import ContactKind
from ..robot.formats.model_files import joint_order, load_model
from ..robot.formats.model_names import locate
from ..robot.gearbox_types import DIRECT, typed_gearboxes
from ..robot.linkage import ties_base
from ..robot.name_patterns import DEFAULT, select, select_all
from ..system.plausibility import NO_STIFFNESS
from ..system.system import Balance, System
from .actuator_facts import KnownRobot, actuators, grades_of, recognised, unknown_actuator
from .file_types import kind_of_file, wrong_kind
from .gain_context import BALANCE, GROUPS, JOINT_KEYS
from .gain_files import JointGains, gains_of, read_gains
from .gain_formats.gain_record import ANGLE, GAINS_RUN, JOINT_DAMPING, GainFile
from .model_keyframes import model_keyframes
from .plausibility import plausible
from .robot_sections import RobotFile
from .robot_yaml import base_of, robot_spec
from .system_sections import refuse_long_delay
from .typed_over_gains import JOINT_VALUES as JOINT_VALUES, padded, typed_first, with_joint_damping

WHO = tuple(filter(None, get_args(Balance)))
KEYS = {
    "balance": ("balance",),
    "delay_ms": ("drive", "delay_ms"),
    "rate_hz": ("control", "sample_rate_hz"),
    "stiffness": ("joints", DEFAULT, "stiffness"),
    "damping": ("joints", DEFAULT, "damping"),
    "motor_inertia": ("joints", DEFAULT, "motor_inertia"),
    "bandwidth": ("drive", "bandwidth"),
    "base": ("model", "base"),
    "contact": ("contacts", "contact"),
}
"""Path of each option's key in a robot.yaml."""
PATHS = {
    "drive": {
        "delay_ms": ("drive", "command_delay_ms"),
        "drive_delay_ms": ("drive", "delay_ms"),
        "drive_rate_hz": ("control", "sample_rate_hz"),
    },
    "split": {"drive_delay_ms": ("control", "kd_path", "delay_ms"), "drive_rate_hz": ("control", "kd_path", "sample_rate_hz")},
}
"""Paths that replace those of KEYS, by the value of --gains-run."""
GIVEN = "given"
"""Name of a posture whose angles are given as options."""
SLIGHT_DAMPING = 0.01
"""Share of kd below which the joints' own damping is only reported among the assumptions."""
UNLIKE = 1.5
"""Ratio of the largest to the least published inertia of a robot's motors from which one armature for all of them is a placeholder."""
HELD_SHOWN = 3
"""Maximum number of joints without gains that a warning names; the rest are counted, so that the answer fits on one screen."""
DESCRIPTIONS = (".yaml", ".yml", ".json")


@dataclass(frozen=True)
class AuditOptions:
    """Options of an audit in the units of the command line: ms, Hz, otherwise SI; None: not given.

    `contacts` are frames on the ground, all at once.

    balance         who damps sway: "joints" or "controller"; None: not said
    posture         JOINT=ANGLE (a name or pattern; rad, m if prismatic), or the name of an MJCF's keyframe; later ones win
    joint_damping   what the model's own damping of joints is: "controller", a part of kd; "friction", of the link; None: not counted
    gains_run       "host" or None: both gains see the whole delay; "drive": neither does, it is that of set-points; "split": kp does, kd
                    runs on the drive
    drive_rate_hz, drive_delay_ms   of the loop that runs on the drive, from measurement to torque
    gearboxes       TYPE, or JOINT=TYPE (a name or pattern): later ones win (robot/gearbox_types.py)
    actuators       NAME, or JOINT=NAME (a name or pattern): later ones win (actuator_facts.py)
    of_joints       which of JOINT_VALUES, of which joints (a name or pattern), and how much: later ones win, and all of them over
                    what is said of all joints or by the file of gains
    required        limits that go along with the gains, each as --require takes it
    """

    delay_ms: float
    rate_hz: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    motor_inertia: float | None = None
    bandwidth: float | None = None
    base: Base | Any = None
    contacts: tuple[str, ...] = ()
    balance: str | None = None
    posture: tuple[str, ...] = ()
    joint_damping: str | None = None
    gains_run: str | None = None
    drive_rate_hz: float | None = None
    drive_delay_ms: float | None = None
    gearboxes: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()
    of_joints: tuple[tuple[str, str, float], ...] = ()
    required: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        all_of(
            [
                *self._drive_checks(),
                partial(require_one_of, f"--base {self.base}", self.base, get_args(Base)),
                partial(require_one_of, f"--balance {self.balance}", self.balance, WHO),
                partial(require_one_of, f"--joint-damping {self.joint_damping}", self.joint_damping, JOINT_DAMPING),
                lambda: refuse_all(self._gearbox_problems()),
                lambda: refuse_all(self._actuator_problems()),
            ]
        )

    def _gearbox_problems(self) -> Iterator[str]:
        damped = [self.damping, *(value for key, _, value in self.of_joints if key == "damping")]
        if not self.is_elastic and (given := [value for value in damped if value is not None]):
            yield f"--damping {given[0]:g}: is of elastic gearboxes; give --stiffness too"
        if self.gearboxes and self.stiffness is not None:
            yield "--gearbox: a range of stiffness for a type; with --stiffness it is known: give one of the two"
        if any(text.rpartition("=")[2] != DIRECT for text in self.gearboxes) and self.gains_run == "split":
            yield "--gearbox: ranges are not known with --gains-run split; give --stiffness and --damping"

    def _actuator_problems(self) -> Iterator[str]:
        for text in self.actuators:
            name = text.rpartition("=")[2]
            if name not in actuators():
                yield f"--actuator {text}: {unknown_actuator(name)}"

    def _drive_checks(self) -> list[Callable[[], None]]:
        """Checks that raise GainroomError where a loop on the drive is described incompletely, or is described but does not exist."""
        place = partial(require_one_of, f"--gains-run {self.gains_run}", self.gains_run, GAINS_RUN)
        known = self.gains_run is None or self.gains_run in GAINS_RUN
        return [place, *([lambda: refuse_all(self._drive_problems())] if known else [])]

    def _drive_problems(self) -> Iterator[str]:
        given = {"--drive-rate-hz": self.drive_rate_hz, "--drive-delay-ms": self.drive_delay_ms}
        for option, value in given.items():
            if self.on_drive and value is None:
                yield f"--gains-run {self.gains_run}: needs {option}, of the loop that runs on the drive"
            if not self.on_drive and value is not None:
                yield f"{option} {value:g}: is of gains that run on the drive; give --gains-run drive, or split for kd alone"
        if self.gains_run == "drive" and self.rate_hz is not None:
            yield f"--rate-hz {self.rate_hz:g}: no gain runs on the host with --gains-run drive; --drive-rate-hz is their rate"

    @property
    def on_drive(self) -> bool:
        """True if at least kd runs on the drive."""
        return self.gains_run in ("drive", "split")

    @property
    def keys(self) -> dict[str, tuple[str, ...]]:
        """Path of each option's key in a robot.yaml, for this value of --gains-run."""
        return KEYS | PATHS.get(self.gains_run or "", {})

    @property
    def is_elastic(self) -> bool:
        """True if an option makes any gearbox elastic."""
        said = [self.stiffness, *(value for key, _, value in self.of_joints if key == "stiffness")]
        return any(value is not None and math.isfinite(value) for value in said)

    def base_of(self, path: Path, system: Mapping[str, Any]) -> Base | None:
        """Base of the robot: the option --base, else the base stored with the gains, else the one of the model file."""
        stands = bool(self.contacts) or any((system.get("contacts") or {}).values())
        return base_of(self.base or (system.get("model") or {}).get("base"), path, stands)[0]

    @property
    def posture_name(self) -> str:
        """Name of the posture: that of the keyframe, or a short one for angles."""
        if not self.posture:
            return "zero"
        return self.posture[0] if len(self.posture) == 1 and "=" not in self.posture[0] else GIVEN

    def sections(self, file: str, body: RigidBody, gains: JointGains, driven: Sequence[str] = ()) -> dict[str, Any]:
        """Sections of the robot.yaml that these options stand for, with the model in `file`.

        Joints without gains are locked, or passive in loops.

        driven   as load_model has it
        """
        names = body.every_joint
        given = [k for k, has in enumerate(gains.given) if has]
        idle = [name for name, has in zip(body.joint_names, gains.given, strict=False) if not has]
        rubbed = {k: {"link_viscous": float(body.damping[k])} for k in given if self.joint_damping == "friction" and k < body.size}
        columns = {"kp": gains.kp, "kd": gains.kd} | ({"ki": gains.ki} if np.any(gains.ki) else {})
        data: dict[str, Any] = {
            "model": {"file": file},
            "joints": {
                DEFAULT: {},
                **{names[k]: {**rubbed.get(k, {}), **gains.actuators[k]} for k in given if gains.actuators[k] or k in rubbed},
                "locked": [name for name in idle if name not in body.looped],
                "passive": [*body.passive, *(name for name in idle if name in body.looped)],
                **({"driven": list(driven)} if driven else {}),
            },
            "drive": {"bandwidth": math.inf},
            "control": {"type": "pid" if "ki" in columns else "pd", "feedback": "motor"}
            | {name: {names[k]: float(column[k]) for k in given} for name, column in columns.items()},
            "postures": {self.posture_name: _angles(self.posture, Path(file), names, gains.postures)},
            "contacts": {"flight" if body.base == "floating" and not ties_base(body) else "free": []}
            | ({"contact": [_contact(text) for text in self.contacts]} if self.contacts else {}),
        }
        self._add_context(data, gains.origin.system, [names[k] for k in given], idle)
        moved = [names[k] for k in given]
        of_file = {names[k]: gains.named[k] for k in given if k < len(gains.named) and gains.named[k]}
        typed = {key: value for key in JOINT_VALUES if (value := getattr(self, key)) is not None}  # wins over what is published
        for joint, actuator in (_recognised(body, moved) | of_file | self._actuators(moved)).items():
            data["joints"][joint] = {"actuator": actuator, **typed, **data["joints"].get(joint, {})}
        for key, pattern, value in self.of_joints:
            for k in select(pattern, moved, f"{option_name(key)} {pattern}={value:g}"):
                data["joints"].setdefault(moved[k], {})[key] = value
        for option, (*sections, key) in self.keys.items():
            if (value := getattr(self, option, None)) is not None:
                reduce(lambda section, name: section.setdefault(name, {}), sections, data)[key] = value
        return data

    def _actuators(self, names: Sequence[str]) -> dict[str, str]:
        """Actuator that an option gives, by joint of `names`. Raises GainroomError for a pattern that matches none."""
        found: dict[str, str] = {}
        for text in self.actuators:
            pattern, _, actuator = text.rpartition("=")
            found |= dict.fromkeys((names[k] for k in select(pattern, names, f"--actuator {text}")) if pattern else names, actuator)
        return found

    def _add_context(self, data: dict[str, Any], system: Mapping[str, Any], given: Sequence[str], idle: Sequence[str]) -> None:
        """Adds the system that is stored with the gains to the sections `data`, except where an option gives another value.

        `given` are the joints with gains, `idle` those without.
        """
        joints = data["joints"]
        for name in given:
            own = (system.get("joints") or {}).get(name) or {}
            left = {"bandwidth": self.bandwidth is not None, "delay_ms": self.on_drive or not self._same_delay(system)}
            own = {key: own[key] for key in JOINT_KEYS if key in own and not left.get(key)}
            if own:
                joints[name] = {**own, **joints.get(name, {})}
        patterns = (system.get("joints") or {}).get("passive") or ()
        free = {idle[k] for found in select_all(patterns, idle, "joints.passive", all_match=False) for k in found}
        joints["locked"] = [name for name in joints["locked"] if name not in free]
        joints["passive"] += [name for name in idle if name in free and name not in joints["passive"]]
        data["model"] |= system.get("model") or {}
        data["control"] |= system.get("control") or {}
        left = {"bandwidth": self.bandwidth is not None, "delay_includes_sampling": self.rate_hz is not None or self.on_drive}
        data["drive"] |= {key: value for key, value in (system.get("drive") or {}).items() if not left.get(key)}
        if not self.balance and BALANCE in system:
            data[BALANCE] = system[BALANCE]
        data |= {key: system[key] for key in ("gain_bounds", GROUPS) if key in system}
        if known := self._context_ranges(system):
            data["uncertainty"] = known
        if not self.posture and "postures" in system:
            data["postures"] = system["postures"]
        if not self.contacts and "contacts" in system:
            data["contacts"] = system["contacts"]

    def _context_ranges(self, system: Mapping[str, Any]) -> dict[str, Any]:
        """Ranges that are stored with the gains, without those of quantities that an option gives, which are known."""
        typed = {key for key, *_ in self.of_joints} | {key for key in JOINT_VALUES if getattr(self, key) is not None}
        typed |= {"stiffness", "damping"} if self.gearboxes else set()
        delay, rate = (self.drive_delay_ms, self.drive_rate_hz) if self.gains_run == "drive" else (self.delay_ms, self.rate_hz)
        there = {"delay_ms": delay, "delay_ticks": None if delay is None or rate is None else 1e-3 * delay * rate}

        def holds(key: str, given: Any) -> bool:
            if key not in there or not isinstance(given, list):
                return True
            value = there[key]
            return value is not None and given[0] * (1 - 1e-9) <= value <= given[1] * (1 + 1e-9)

        return {key: each for key, each in (system.get("uncertainty") or {}).items() if key not in typed and holds(key, each)}

    def _same_delay(self, system: Mapping[str, Any]) -> bool:
        """True if --delay-ms equals the largest joint delay that is stored with the gains."""
        delays = [own["delay_ms"] for name, own in (system.get("joints") or {}).items() if isinstance(own, dict) and "delay_ms" in own]
        return bool(delays) and math.isclose(max(delays), self.delay_ms, rel_tol=1e-12)

    @property
    def where_gains_run(self) -> str:
        """Location of the gains, in a few words."""
        if self.gains_run == "split":
            return "kd runs on the drives, kp on the host"
        return f"kp and kd run on the {'drives' if self.on_drive else 'host'}"

    def path_assumption(self) -> str:
        """Assumption about the delay, as text."""
        delay = f"{self.delay_ms:g} ms"
        if self.on_drive:
            there = f"at {self.drive_rate_hz:g} Hz, {self.drive_delay_ms:g} ms from measurement to torque"
            if self.gains_run == "drive":
                return f"{self.where_gains_run} {there}; the {delay} of --delay-ms delay set-points alone, so no margin depends on them"
            kp = f"kp on the host at {self.rate_hz:g} Hz, {delay} from measurement to torque"
            return f"kd runs on the drives {there}; {kp}; the delay limit is that of kp's path"
        text = f"{self.where_gains_run}: the {delay} of --delay-ms lie between measurement and torque"
        return text if self.gains_run == "host" else f"{text}; if they run on the drives, give --gains-run drive, or split for kd alone"


@dataclass(frozen=True)
class Audited:
    """Robot and gains of an audit.

    system     the robot with the gains it has
    sections   the robot.yaml that says the same, without requirements; the model's file as it was found
    options    as they were typed, with what the file of gains says
    motors     sentence on the actuators whose published figures count, and their grades; "" where there are none
    """

    system: System
    sections: Mapping[str, Any]
    options: AuditOptions
    motors: str = ""

    def actuator_facts(self, joint: str) -> dict[str, Any]:
        """Actuator of a joint, a name in `gainroom actuators`, and which of the joint's numbers are its published figures, for JSON."""
        name = named_actuators(self.sections).get(joint)
        published = set() if name is None else actuators()[name].entry().published - self.sections["joints"][joint].keys()
        if not published - {"effort_limit"}:  # no margin rests on its figures
            return {"actuator": None, "published": []}
        return {"actuator": name, "published": sorted(published)}


def audited(model: str, gains: Path | None, options: AuditOptions) -> Audited:
    """Robot with the gains that it has; joints without gains are held.

    model   a URDF or MJCF, or a name of robot_descriptions
    gains   where they are (see gain_files.py); None: in the model, an MJCF

    Raises GainroomError, one line that names the file or option, the value and what is allowed.
    """
    path = locate(model)
    _require_model(path)
    source = path if gains is None else gains
    with _options_named(options):
        read_in = read_gains(source)
        body, found, driven = _body_with_gains(path, read_in, options.base_of(path, read_in.origin.system))
        if not np.any(found.given[: body.size]):
            raise GainroomError(f"{path}: no joint that can move has gains")
        options, read = _as_the_file_says(options, found, source)
        damping, found, counted = with_joint_damping(options.joint_damping, found, body, source)
        options = replace(options, joint_damping=damping)
        found = typed_first(options, found, body.every_joint, source)
        sections = options.sections(str(path), body, found, driven)
        file = validate(RobotFile, sections, "")
        owner = "--drive-delay-ms" if options.gains_run == "drive" else "--delay-ms"
        refuse_long_delay(1e-3 * (file.drive.delay_ms or 0.0), file.sample_time(), owner)
        spec = robot_spec(file, str(path), lambda: path, known_body=body)
        without_effect = []
        if options.gearboxes:
            names, given = spec.source.joint_names, ~spec.source.actuators.assumed_rigid
            typed = typed_gearboxes(options.gearboxes, names, given, "--gearbox")
            without_effect, sections = typed.without_effect("--gearbox", source), _with_gearboxes(sections, names, typed.types)
            spec = robot_spec(validate(RobotFile, sections, ""), str(path), lambda: path, known_body=body)
    with named(str(source)):
        spec = plausible(spec)
    read += [
        f"--posture {name}: the keyframe of {scene}"
        for name in options.posture
        if "=" not in name and name not in found.postures and (scene := model_keyframes(path)[name].file) != path
    ]
    rigid = [name for name, one in zip(spec.source.joint_names, spec.source.actuators.assumed_rigid.tolist(), strict=True) if one]
    taken = [text for text in spec.warnings if text.startswith(ASSUMED)]
    slight = _slight_damping(body, found, options)
    taken += [text for text in spec.warnings if slight and text.startswith(DAMPING_NOTE)]
    locked = file.joints.locked
    held = [f"these joints are held, as they have no gains: {first_of_many(locked, HELD_SHOWN)}"] * bool(locked)
    assumptions = (
        options.path_assumption(),
        *(text for text in spec.assumptions if not text.startswith(NO_STIFFNESS)),  # said below, with the options
        *(slight if text.startswith(DAMPING_NOTE) else text for text in taken),
        *read,
        *counted,
        *(held if gains is None else []),
        *_assumptions(spec.source.body, options, rigid, len(spec.source.joint_names), found.origin.system),
    )
    warnings = [text.replace("move it inside", "move it inside with --posture") for text in spec.warnings if text not in taken]
    idle = [name for name, has in zip(body.every_joint, found.given, strict=True) if has and name not in body.joint_names]
    idle = [f"gains of joints that have no motor in the model do not count: {first_of_many(idle)}"] * bool(idle)
    # A file of gains may have left out a leg; a model has the actuators that it has.
    asked = (*_contradicted(body, sections), *_damping_asked(warnings, options))
    warnings = (*found.notes, *([] if gains is None else held), *idle, *without_effect, *asked)
    return Audited(replace(spec, assumptions=assumptions, warnings=warnings), sections, options, _motors(body, sections))


def _body_with_gains(path: Path, file: GainFile, base: Base | None) -> tuple[RigidBody, JointGains, tuple[str, ...]]:
    """Links of the model, gains of its joints, and the joints that have a motor because they have gains. Raises GainroomError.

    Raises GainroomError.
    """
    body, gains = load_model(path, base, for_names=True), file.in_order(joint_order(path))
    found = gains_of(gains, body.every_joint)
    moved = {name for name, has in zip(body.every_joint, found.given, strict=True) if has}
    driven = tuple(re.escape(name) for name in body.passive if name in moved)
    if not driven:
        return body, found, ()
    body = load_model(path, base, driven=driven, for_names=True)
    return body, gains_of(gains, body.every_joint), driven


def _motors(body: RigidBody, sections: Mapping[str, Any]) -> str:
    """Sentence on the actuators whose published figures count, and their grades; "" where there are none."""
    taken = {
        name: actuator
        for name, actuator in named_actuators(sections).items()
        if "motor_inertia" not in sections["joints"][name] and actuators()[actuator].used("motor_inertia") is not None
    }
    if not taken:
        return ""
    robot = _known_robot(body, [*sections["control"]["kp"]])
    whose = f"the joints are those of {robot.title}, and its" if robot is not None and robot.of_joints([*taken]) == taken else "the"
    set_aside = {armature for name, armature in zip(body.joint_names, body.armature.tolist(), strict=True) if name in taken} - {0.0}
    instead = "".join(f", in place of the model's armature of {one:g} kg·m², the same for unlike motors" for one in set_aside)
    return f"{whose} motors' inertias are published figures{instead}: {grades_of(taken.values())} (--actuator)"


def _contradicted(body: RigidBody, sections: Mapping[str, Any]) -> list[str]:
    """Warning about armatures of the model that count, of a known robot whose motors' published inertias are others; [] for none."""
    names = [*sections["control"]["kp"]]
    robot, armature = _known_robot(body, names), dict(zip(body.joint_names, body.armature.tolist(), strict=True))
    if robot is None:
        return []
    found: dict[tuple[str, float, str], list[str]] = {}
    for name, actuator in robot.of_joints(names).items():
        own, used = armature.get(name, 0.0), actuators()[actuator].used("motor_inertia")
        counts = own > 0 and not {"motor_inertia", "rotor_inertia", "actuator"} & sections["joints"].get(name, {}).keys()
        if counts and used is not None and not used.low / UNLIKE <= own <= used.high * UNLIKE:
            found.setdefault((actuator, own, f"{digits(used.value, 'kg·m²', 3)}, {used.grade}"), []).append(name)
    return [
        f"{first_of_many(where)}: the model's armature, {own:g} kg·m², is not the published one of {robot.title}, {published}: "
        f"--actuator PATTERN={actuator} takes that"
        for (actuator, own, published), where in found.items()
    ]


def named_actuators(sections: Mapping[str, Any]) -> dict[str, str]:
    """Name of the actuator of each joint that has one in the sections of an audit."""
    return {name: own["actuator"] for name, own in sections["joints"].items() if isinstance(own, dict) and "actuator" in own}


def _known_robot(body: RigidBody, names: Sequence[str]) -> KnownRobot | None:
    """Known robot whose joints with gains are `names`; None where it is not known."""
    path = Path(body.source)
    return recognised(names, body.every_joint, (body.model.name, path.stem, path.parent.name))


def _recognised(body: RigidBody, names: Sequence[str]) -> dict[str, str]:
    """Actuator of each joint of `names` whose motor the model does not describe, where its robot is known; {} where it is not.

    One armature for motors of which published inertias differ describes none of them.
    """
    robot = _known_robot(body, names)
    if robot is None:
        return {}
    own, armature = robot.of_joints(names), dict(zip(body.joint_names, body.armature.tolist(), strict=True))
    published = [used.value for name in own if (used := actuators()[own[name]].used("motor_inertia")) is not None]
    unlike = len(published) > 1 and max(published) > UNLIKE * min(published)
    alike = unlike and len({armature.get(name) for name in own}) == 1
    return {name: actuator for name, actuator in own.items() if alike or armature.get(name) == 0}


def _with_gearboxes(sections: Mapping[str, Any], names: Sequence[str], types: Sequence[str]) -> dict[str, Any]:
    """Sections with the type (n,) of each joint's gearbox; gearboxes without a type are rigid."""
    joints = dict(sections["joints"])
    for name, kind in zip(names, types, strict=True):
        if kind:
            own = {key: value for key, value in joints.get(name, {}).items() if key not in ("stiffness", "damping")}
            joints[name] = {**own, **({"stiffness": math.inf} if kind == DIRECT else {"gearbox": kind})}
    return {**sections, "joints": joints}


def _as_the_file_says(options: AuditOptions, found: JointGains, source: Path) -> tuple[AuditOptions, list[str]]:
    """Options completed from the file of gains: location of the gains, rate and posture; and notes about what was taken from there.

    Raises GainroomError where a rate is needed and nobody gives one, and where the file's posture is not understood and none is given.
    """
    read, origin = [], found.origin
    if not options.posture and not found.postures and found.unread_postures:
        raise GainroomError(f"{next(iter(found.unread_postures.values()))}; give --posture")
    if options.gains_run is None and origin.gains_run is not None:
        if origin.gains_run == "drive" and options.rate_hz is not None:
            raise GainroomError(
                f"--rate-hz {options.rate_hz:g}: the gains of {source} run on the drive: leave it out, or say where with --gains-run"
            )
        if origin.gains_run == "drive" and origin.drive_rate_hz is None:
            raise GainroomError(
                f"{source}: servos compute with their registers themselves: give the rate and delay of their loop, drive_rate_hz and "
                "drive_delay_ms there, or --gains-run drive --drive-rate-hz N --drive-delay-ms N"
            )
        options = replace(options, gains_run=origin.gains_run, drive_rate_hz=origin.drive_rate_hz, drive_delay_ms=origin.drive_delay_ms)
        read.append(f"{options.where_gains_run}, as {source} has it: --gains-run says another")
    read += origin.converted
    if origin.required:
        options = replace(options, required=origin.required)
        read.append(f"what is required goes along with {source} ({', '.join(origin.required)}): options of limits say another")
    stiffness = options.stiffness is not None or any(key == "stiffness" for key, *_ in options.of_joints)
    if origin.gearboxes and not options.gearboxes and not stiffness:
        options = replace(options, gearboxes=origin.gearboxes)
        read.append(f"gearboxes lie in the ranges of their types, as {source} has them: --gearbox or --stiffness says another")
    if options.rate_hz is None and (rate := origin.sample_rate_hz) is not None and options.gains_run != "drive":
        options = replace(options, rate_hz=rate)
        read.append(f"the controller runs at {rate:g} Hz, as {source} has it: --rate-hz says another")
    if origin.system:
        read.append(f"{listed([*origin.system], most=9)}, as {source} has them, where no option says another")
    if not options.posture and "postures" in origin.system:
        pass  # all of them are judged
    elif not options.posture and len(found.postures) == 1:
        (name,) = found.postures
        options = replace(options, posture=(name,))
        read.append(f"the posture is {name} of {source}: --posture says another")
    elif not options.posture and found.postures:
        read.append(f"{source} holds postures, none of which is taken: --posture {first_of_many(tuple(found.postures))}")
    if options.gains_run == "split" and options.rate_hz is None:
        raise GainroomError("--gains-run split: needs --rate-hz, at which kp runs on the host")
    return options, read


def _slight_damping(body: RigidBody, found: JointGains, options: AuditOptions) -> str:
    """Note that the joints' own damping is too small beside kd to decide anything; "" if it is larger, or if --joint-damping was given."""
    own = padded(body.damping, len(found.kd))
    ratio = float(np.max(own / np.maximum(found.kd, 1e-300), initial=0.0, where=found.given))
    if options.joint_damping is not None or not ratio < SLIGHT_DAMPING:
        return ""
    return f"{DAMPING_NOTE}, at most {100 * ratio:.2g} % of kd: --joint-damping says what it is"


def _damping_asked(warnings: Sequence[str], options: AuditOptions) -> list[str]:
    """Warnings about the joints' own damping, each with what the damping counts as, or with the option to give where nothing was given."""
    meant = {
        "controller": "the joints' own damping in the model file counts as a part of the controller's kd",
        "friction": "the joints' own damping in the model file counts as friction of the links",
        None: f"{DAMPING_NOTE}: say what it is, --joint-damping controller (a part of kd, as in many training models) or friction",
    }[options.joint_damping]
    found = []
    for text in warnings:
        values = f"{text.rpartition(': ')[2]} [N·m·s/rad]"
        found.append(f"{meant}: {values}" if text.startswith(DAMPING_NOTE) else text)
    return found


def _contact(typed: str) -> str | dict[str, str]:
    """Contact as a robot.yaml has it, from FRAME or FRAME:TYPE."""
    frame, _, kind = typed.rpartition(":")
    return {"frame": frame, "type": kind} if frame and kind in get_args(ContactKind) else typed


@contextlib.contextmanager
def _options_named(options: AuditOptions) -> Iterator[None]:
    """Context in which messages about a key of a robot.yaml name the option for it."""
    try:
        yield
    except GainroomError as error:
        raise GainroomError(*(_optional(text, options) for text in error.problems)) from error


def _optional(text: str, options: AuditOptions) -> str:
    """Message about a key of a robot.yaml, turned into one about the option for it."""
    for name, keys in options.keys.items():
        text = re.sub(rf"^{re.escape('.'.join(keys))}\b(\[\d+\])?", option_name(name), text)
    text = text.replace("model.base: fixed", "--base fixed")
    for key, *_ in options.of_joints:
        text = re.sub(rf"^joints\.(.*)\.{key}\b", rf"{option_name(key)} of \1", text)
    return text


def _angles(typed: Sequence[str], path: Path, joint_names: Sequence[str], postures: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Angles by name of the joints that are named; `postures`: those in the file of gains. Raises GainroomError that names the option."""
    angles: dict[str, float] = {}
    for text in typed:
        owner = f"--posture {shown(text)}"
        pattern, sign, number_typed = text.rpartition("=")
        if text in postures:
            angles |= postures[text]
            continue
        if not sign:
            known = model_keyframes(path)
            if text not in known:
                raise GainroomError(f"{owner}: must be JOINT=ANGLE, or a keyframe of an MJCF{nearest(text, tuple(known), 'keyframe')}")
            angles |= known[text].angles
            continue
        try:
            value = float(number_typed)
        except ValueError as error:
            raise GainroomError(f"{owner}: {shown(number_typed)} must be a number in rad (m for a prismatic joint)") from error
        angle = checked(owner, value, ANGLE)
        angles |= dict.fromkeys((joint_names[k] for k in select(pattern, joint_names, owner)), angle)
    return angles


def _require_model(path: Path) -> None:
    """Raise GainroomError if the model is a YAML file."""
    if path.suffix.lower() in DESCRIPTIONS:
        found = kind_of_file(path)
        if found in ("joint", "robot"):
            raise wrong_kind(str(path), "URDF or MJCF", found)
        if found == "other":
            raise GainroomError(f"{path}: must be a URDF or MJCF; gains go with --gains {path}")


def _assumptions(body: RigidBody, options: AuditOptions, rigid: Sequence[str], count: int, system: Mapping[str, Any]) -> tuple[str, ...]:
    """Assumptions made where nothing was given, each with the option that replaces it.

    rigid   gearboxes, of `count`, of which nobody says how stiff
    system  what goes along with the gains
    """
    zero = "every joint stands at 0, perhaps far from how the robot works: give --posture"
    notes = ["joints that --posture does not name stand at 0" if options.posture else zero] * ("postures" not in system)
    notes += ["the encoders are on the motor side"] * ("feedback" not in (system.get("control") or {}))
    if rigid:
        which = "gearboxes are rigid" if len(rigid) == count else f"these gearboxes are rigid ({first_of_many(rigid)})"
        notes.append(f"{which}, so limits are optimistic: give --stiffness and --damping")
    loops = "bandwidth" in (system.get("drive") or {}) or any(
        isinstance(own, dict) and "bandwidth" in own for own in (system.get("joints") or {}).values()
    )
    if options.bandwidth is None and not loops:
        notes.append("current loops are infinitely fast: give --bandwidth [rad/s]")
    if flat := [text for text in options.contacts if isinstance(_contact(text), str)]:
        notes.append(f"these contacts are flat, all 6 directions held: {first_of_many(flat)}; else FRAME:point or FRAME:line")
    if body.base == "floating" and not options.contacts and not ties_base(body) and "contacts" not in system:
        notes.append("the robot is in flight only: name the frames on the ground with --contact")
    return tuple(notes)
