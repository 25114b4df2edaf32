"""MJCF compiled by MuJoCo in a guarded child: it is sent text, and answers with numbers and names.

Not with MuJoCo's own binary form (MJB): so the parent needs no MuJoCo, whose import takes about as long as the child's start, and trusts no
reader of binary models. Files named inside are read only from the model's own folder.
"""

import contextlib
import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import GainroomError, first_of_many, one_line
from ...io.guarded_child import Answer, Handler
from .mjcf_constraints import take_constraints
from .mujoco_messages import mujoco_warnings
from .xml_text import MAX_BYTES

ARENA = 33 * 2**20
"""Work space of an MjData [bytes], more than MuJoCo's own 15 MiB: the C library gives what is above 32 MiB back to the system when it is
freed. Of aligned blocks below that glibc before 2.38 finds none again, and every new MjData takes address space that nobody had before."""
ARRAYS = (
    "body_parentid",
    "body_rootid",
    "body_jntnum",
    "body_jntadr",
    "body_mass",
    "body_inertia",
    "body_pos",
    "body_quat",
    "body_ipos",
    "body_iquat",
    "body_gravcomp",
    "jnt_type",
    "jnt_bodyid",
    "jnt_qposadr",
    "jnt_dofadr",
    "jnt_pos",
    "jnt_axis",
    "jnt_limited",
    "jnt_range",
    "jnt_stiffness",
    "jnt_stiffnesspoly",
    "jnt_actfrclimited",
    "jnt_actfrcrange",
    "qpos0",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "site_bodyid",
    "site_pos",
    "site_quat",
    "actuator_trnid",
    "actuator_gear",
    "actuator_biasprm",
    "actuator_gainprm",
    "actuator_gaintype",
    "actuator_forcelimited",
    "actuator_forcerange",
    "actuator_armature",
    "actuator_damping",
    "actuator_delay",
)
"""Arrays of an MjModel that are read, by MuJoCo's names; some are younger than the oldest MuJoCo that is supported."""
COUNTS = {"body": "nbody", "joint": "njnt", "site": "nsite"}
"""Parts whose names are read, and MuJoCo's number of them."""
FINITE = {
    "body": ("body_mass", "body_inertia", "body_pos", "body_ipos", "body_quat", "body_iquat"),
    "joint": ("jnt_pos", "jnt_axis", "jnt_stiffness"),
    "site": ("site_pos", "site_quat"),
}


@dataclass(frozen=True)
class ActuatorElement:
    """Actuator of a file with its defaults: its joint ("" for another target), its gear, and its values on the actuator's side of the gear.

    stiffness, offset   of an affine bias: −b1 and b0; gain: the factor on its input
    control_range       as an attribute's text, "" where the input is not limited
    """

    joint: str
    gear: float
    is_affine: bool
    gain: float
    stiffness: float
    offset: float
    control_range: str
    force_limited: bool


def inside(path: Path, name: str, near: tuple[Path, ...], what: str) -> Path | None:
    """Path of the file `name`, searched in the folders `near` in turn; None if it is missing.

    Raises GainroomError where it lies outside the folder of the model `path`, through .. or a symbolic link too.
    """
    home = path.parent.resolve()
    for folder in near:
        try:
            target = (folder / name).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a NUL
            raise GainroomError(f"{path}: {what} {name[:60]!r} cannot be read") from error
        if not target.is_relative_to(home):
            raise GainroomError(f"{path}: {what} {name[:60]!r} lies outside the model's folder; put it there")
        if target.is_file():
            return target
    return None


def loaded() -> Any:
    """Module mujoco, in the child. Raises GainroomError if it does not load."""
    os.environ["MUJOCO_GL"] = "disable"  # else its import loads glfw, which takes a quarter of it
    try:
        import mujoco
    except ImportError as error:
        raise GainroomError(f"robot models need MuJoCo, which is installed but does not load: {one_line(error)}") from error
    return mujoco


@contextlib.contextmanager
def opened(path: Path) -> Iterator[tuple[dict[str, Any], Handler]]:
    """A request has the `text` of an MJCF read from `path`, and `keyed`: the one with its keyframes, "" where it has none.

    Answered by the fields of mjcf_file.Compiled, and the model's numbers one behind the other.
    """
    mujoco = loaded()

    def answer(request: Any) -> Answer:
        model, about = _compile(mujoco, request["text"], path)
        names = {kind: [getattr(model, kind)(k).name for k in range(getattr(model, count))] for kind, count in COUNTS.items()}
        found = {name: np.asarray(getattr(model, name)) for name in ARRAYS if hasattr(model, name)}
        names["key"], found["key_qpos"], unkeyed = [], np.zeros((0, model.nq)), []
        if request["keyed"]:
            try:
                keyed, _ = _compile(mujoco, request["keyed"], path)
                names["key"], found["key_qpos"] = [keyed.key(k).name for k in range(keyed.nkey)], np.asarray(keyed.key_qpos)
            except GainroomError as error:
                unkeyed = error.problems
        option = model.opt
        about |= {
            "names": names,
            "unkeyed": unkeyed,
            "pid": int(getattr(mujoco.mjtGain, "mjGAIN_PID", -1)),
            "option": {
                "gravity": np.asarray(option.gravity).tolist(),
                "timestep": float(option.timestep),
                "integrator": mujoco.mjtIntegrator(option.integrator).name.removeprefix("mjINT_"),
                "disableflags": int(option.disableflags),
                "disabled": [name for name, bit in mujoco.mjtDisableBit.__members__.items() if option.disableflags & int(bit)],
            },
            "arrays": [[name, values.dtype.str, values.shape] for name, values in found.items()],
        }
        return about, np.concatenate([values.ravel().astype(float) for values in found.values()])

    yield {}, answer


def _compile(mujoco: Any, text: str, path: Path) -> tuple[Any, dict[str, Any]]:
    """Model without its constraints; constraints, actuators, meshes and warnings beside it. Raises GainroomError."""
    source = str(path)
    with mujoco_warnings(mujoco) as said, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            spec = mujoco.MjSpec.from_string(text)
            spec.modelfiledir, spec.memory = str(path.parent), ARENA
            meshes = _drop_shapes(spec, path)
            elements = [asdict(_element(mujoco, actuator)) for actuator in spec.actuators]
            rotors = _rotors_elsewhere(mujoco, spec)
            left_out = _drop_actuators(mujoco, spec)
            constraints = take_constraints(mujoco, spec)
            model = spec.compile()
        except GainroomError:
            raise
        except (ValueError, RuntimeError, LookupError, TypeError, mujoco.FatalError) as error:
            # Lines are those of the text that MuJoCo was given, not the file's.
            raise GainroomError(f"{source}: not a valid MJCF: {re.sub(r',? *line [0-9]+', '', one_line(error))}") from error
    _require_finite(model, source)
    notes = [*rotors, *(f"MuJoCo: {one_line(text)}" for text in (*said, *(str(each.message) for each in caught)))]
    return model, {"constraints": constraints.as_json(), "notes": notes, "elements": elements, "left_out": left_out, "meshes": meshes}


def _require_finite(model: Any, source: str) -> None:
    """Raises GainroomError if a number of the file, or one that the compiler computed from it, is not finite."""
    for what, columns in FINITE.items():
        for column in columns:
            values = np.asarray(getattr(model, column), dtype=float)
            wrong = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1)) if len(values) else []
            if len(wrong):
                name = getattr(model, what)(int(wrong[0])).name or f"{what}#{wrong[0]}"
                raise GainroomError(f"{source}: {what} {name!r}: {column.partition('_')[2]} {values[wrong[0]].tolist()} must be finite")


def _drop_shapes(spec: Any, path: Path) -> list[str]:
    """Deletes the geoms that no inertia comes from, and the meshes then unused; returns the files of the meshes that are left."""
    used: dict[str, str] = {}
    for body in spec.bodies:
        for geom in list(body.geoms):
            if not _gives_inertia(spec, body, geom):
                spec.delete(geom)
            elif geom.meshname:
                used[geom.meshname] = _mesh_file(spec, body.name, geom.meshname, path)
    for mesh in list(spec.meshes):
        if _mesh_name(mesh) not in used:
            spec.delete(mesh)
    return [*filter(None, used.values())]


def _gives_inertia(spec: Any, body: Any, geom: Any) -> bool:
    """True if MuJoCo would take part of the body's inertia from this geom, provided that it uses geoms at all."""
    low, high = spec.compiler.inertiagrouprange
    weightless = geom.mass == 0 or (geom.mass != geom.mass and geom.density == 0)  # a NaN says: by density
    return low <= geom.group <= high and not weightless and not (_is_static(spec, body) and spec.compiler.settotalmass <= 0)


def _is_static(spec: Any, body: Any) -> bool:
    """True if no joint moves the body."""
    while body.name != spec.worldbody.name or body.id != spec.worldbody.id:
        if len(body.joints):
            return False
        body = body.parent
    return True


def _mesh_name(mesh: Any) -> str:
    return mesh.name or Path(mesh.file).stem


def _mesh_file(spec: Any, body: str, name: str, path: Path) -> str:
    """File of a mesh; "" if it has none. Raises GainroomError if that is missing, as the body's inertia comes from it."""
    mesh = next((mesh for mesh in spec.meshes if _mesh_name(mesh) == name), None)
    if mesh is None or not mesh.file:
        return ""  # an unknown name MuJoCo reports itself; vertices may stand in the file
    owner = f"{path}: body {body!r} has no <inertial>, and its mesh {mesh.file[:60]!r}"
    file = inside(path, os.path.basename(mesh.file) if spec.strippath else mesh.file, (path.parent / spec.meshdir,), "mesh")
    if file is None:
        raise GainroomError(f"{owner} is missing")
    if file.stat().st_size > MAX_BYTES:
        raise GainroomError(f"{owner} is larger than {MAX_BYTES} bytes")
    return str(file)


def _element(mujoco: Any, actuator: Any) -> ActuatorElement:
    bias, (low, high) = actuator.biasprm, actuator.ctrlrange
    limited = low < high and int(actuator.ctrllimited) != 0  # 1: true; 2: as the range says
    limits_force = (False, True, actuator.forcerange[0] < actuator.forcerange[1])[int(actuator.forcelimited)]
    return ActuatorElement(
        joint=actuator.target if _on_joint(mujoco, actuator) else "",
        gear=float(actuator.gear[0]),
        is_affine=actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE,
        gain=float(actuator.gainprm[0]),
        stiffness=-float(bias[1]),
        offset=float(bias[0]),
        control_range=f"{low:.10g} {high:.10g}" if limited else "",
        force_limited=bool(limits_force),
    )


def _on_joint(mujoco: Any, actuator: Any) -> bool:
    return actuator.trntype in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def _drop_actuators(mujoco: Any, spec: Any) -> tuple[str, ...]:
    """Removes actuators other than torques on a joint, with or without position and velocity feedback; returns their names.

    What is on a joint stays as a motor, whose rotor moves with the joint.
    """
    gain = (mujoco.mjtGain.mjGAIN_FIXED, getattr(mujoco.mjtGain, "mjGAIN_PID", None))  # since MuJoCo 3.12
    left_out = []
    bias = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
    for index, actuator in enumerate(list(spec.actuators)):
        on_joint = _on_joint(mujoco, actuator)
        if not on_joint or actuator.gaintype not in gain or actuator.biastype not in bias:
            left_out.append(actuator.name or f"actuator#{index}")
            if on_joint:
                actuator.set_to_motor()
            else:
                spec.delete(actuator)
    return tuple(left_out)


def _rotors_elsewhere(mujoco: Any, spec: Any) -> list[str]:
    """Note on actuators with armature that are on no joint; [] if there are none."""
    names = [actuator.name or f"actuator#{index}" for index, actuator in enumerate(spec.actuators)]
    rotors = [
        name
        for name, actuator in zip(names, spec.actuators, strict=True)
        if getattr(actuator, "armature", 0.0) and not _on_joint(mujoco, actuator)  # since MuJoCo 3.5
    ]
    return [f"armature of these actuators, which are on no joint, does not count: {first_of_many(rotors)}"] * bool(rotors)
