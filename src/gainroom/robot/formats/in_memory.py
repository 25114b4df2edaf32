"""Models that a program holds, as MJCF text: MuJoCo's MjModel and MjSpec, Pinocchio's Model.

The text has what bears on bodies and joints, with inertias as they are compiled, so that it is read as any other file is.
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from ...errors import GainroomError
from ...io.atomic import text_as_file
from ..body import library
from .model_format import INTEGRATORS

_JOINTS = ("free", "ball", "slide", "hinge")  # mjtJoint
_EQUALITIES = ("connect", "weld", "joint")  # the first of mjtEq
_GAINS, _BIASES = ("fixed", "affine"), ("none", "affine")  # the first of mjtGain, mjtBias
_ON_JOINT = 0  # mjTRN_JOINT
TAKEN = "a path, mujoco.MjModel, mujoco.MjSpec or pinocchio.Model"


@contextmanager
def as_file(model: Any) -> Iterator[str]:
    """Model as a file: a path or name unchanged, one in memory as an MJCF that messages call by its type. Raises as mjcf_of."""
    if isinstance(model, str | PathLike):
        yield str(model)
        return
    name = type(model).__name__
    with text_as_file(mjcf_of(model), f"{name}.xml", name) as path:
        yield str(path)


def mjcf_of(model: Any) -> str:
    """MJCF of a model in memory. Raises GainroomError for another type, and for what the text cannot hold."""
    kind = f"{type(model).__module__.partition('.')[0]}.{type(model).__name__}"
    if kind == "mujoco.MjSpec":
        return _of_mujoco(model.copy().compile())
    if kind == "mujoco.MjModel":
        return _of_mujoco(model)
    if type(model).__name__ == "Model" and kind.startswith("pinocchio"):
        return _of_pinocchio(model)
    raise GainroomError(f"model: a {kind} must be {TAKEN}")


def _text(*numbers: Any) -> str:
    return " ".join(repr(float(one)) for one in np.concatenate([np.ravel(each) for each in numbers]))


def _root(name: str) -> Element:
    root = Element("mujoco", model=name)
    SubElement(root, "compiler", angle="radian", autolimits="false", balanceinertia="false", boundmass="0", boundinertia="0")
    return root


def _of_mujoco(model: Any) -> str:
    """MJCF of an MjModel."""
    root = _root(model.names[: model.names.index(b"\0")].decode("utf-8", "replace"))
    option, mujoco = model.opt, library("mujoco", "MuJoCo")
    own = mujoco.mjtIntegrator(option.integrator).name.removeprefix("mjINT_")
    integrator = next((name for name in INTEGRATORS if name.upper() == own), "Euler")
    stepping = SubElement(root, "option", gravity=_text(option.gravity), timestep=_text(option.timestep), integrator=integrator)
    if option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY):
        SubElement(stepping, "flag", gravity="disable")
    bodies = {0: SubElement(root, "worldbody")}
    for body in range(1, model.nbody):
        place = {"pos": _text(model.body_pos[body]), "quat": _text(model.body_quat[body])}
        element = bodies[body] = SubElement(
            bodies[int(model.body_parentid[body])], "body", {"name": _name(model.body(body), "body"), **place}
        )
        if model.body_gravcomp[body]:
            element.set("gravcomp", _text(model.body_gravcomp[body]))
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            SubElement(element, "joint", _mujoco_joint(model, joint))
        if model.body_mass[body] > 0:
            inertia = {"mass": model.body_mass[body], "diaginertia": model.body_inertia[body]}
            inertia |= {"pos": model.body_ipos[body], "quat": model.body_iquat[body]}
            SubElement(element, "inertial", {key: _text(value) for key, value in inertia.items()})
    for site in range(model.nsite):
        place = {"pos": _text(model.site_pos[site]), "quat": _text(model.site_quat[site])}
        SubElement(bodies[int(model.site_bodyid[site])], "site", {"name": _name(model.site(site), "site"), **place})
    equality, actuators = SubElement(root, "equality"), SubElement(root, "actuator")
    for index in range(model.neq):
        kind, given = _mujoco_equality(model, index)
        SubElement(equality, kind, given)
    for index in range(model.nu):
        SubElement(actuators, "general", _mujoco_actuator(model, index))
    if model.nkey:
        frames = SubElement(root, "keyframe")
        for index in range(model.nkey):
            SubElement(frames, "key", name=_name(model.key(index), "key"), qpos=_text(model.key_qpos[index]))
    return tostring(root, "unicode")


def _name(part: Any, what: str) -> str:
    """Name of a part of an MjModel, or what messages call one without."""
    return part.name or f"{what}#{part.id}"


def _mujoco_joint(model: Any, joint: int) -> dict[str, str]:
    """Attributes of a joint of an MjModel."""
    kind, first = _JOINTS[model.jnt_type[joint]], model.jnt_dofadr[joint]
    found = {"name": _name(model.joint(joint), "joint"), "type": kind}
    found |= {name: _text(getattr(model, f"dof_{name}")[first]) for name in ("armature", "damping", "frictionloss")}
    if kind == "free":
        return found
    start, limited = model.qpos0[model.jnt_qposadr[joint]], bool(model.jnt_limited[joint])
    found |= {"pos": _text(model.jnt_pos[joint]), "axis": _text(model.jnt_axis[joint]), "stiffness": _text(model.jnt_stiffness[joint])}
    if kind != "ball":
        found |= {"ref": _text(start), "springref": _text(model.qpos_spring[model.jnt_qposadr[joint]])}
    if limited:
        found |= {"limited": "true", "range": _text(model.jnt_range[joint])}
    if model.jnt_actfrclimited[joint]:
        found |= {"actuatorfrclimited": "true", "actuatorfrcrange": _text(model.jnt_actfrcrange[joint])}
    return found


def _mujoco_equality(model: Any, index: int) -> tuple[str, dict[str, str]]:
    """Kind and attributes of an equality constraint of an MjModel. Raises GainroomError for one of tendons, flexible bodies or sites."""
    kind, data, mujoco = int(model.eq_type[index]), model.eq_data[index], library("mujoco", "MuJoCo")
    on_sites = int(model.eq_objtype[index]) == int(mujoco.mjtObj.mjOBJ_SITE)
    if kind >= len(_EQUALITIES) or on_sites:
        raise GainroomError(
            f"model: the constraint {_name(model.equality(index), 'equality')!r} is no connect, weld or joint between bodies"
        )
    found = {"name": _name(model.equality(index), "equality"), "active": "true" if model.eq_active0[index] else "false"}
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if _EQUALITIES[kind] == "joint":
        found |= {"joint1": _name(model.joint(first), "joint"), "polycoef": _text(data[:5])}
        return "joint", found | ({"joint2": _name(model.joint(second), "joint")} if second >= 0 else {})
    found |= {"body1": _name(model.body(first), "body"), "body2": _name(model.body(second), "body")}
    if _EQUALITIES[kind] == "connect":
        return "connect", found | {"anchor": _text(data[:3])}
    return "weld", found | {"anchor": _text(data[:3]), "relpose": _text(data[3:10])}


def _mujoco_actuator(model: Any, index: int) -> dict[str, str]:
    """Attributes of an actuator of an MjModel. Raises GainroomError for one that is not on a joint, or no affine law of it."""
    name = _name(model.actuator(index), "actuator")
    gain, bias = int(model.actuator_gaintype[index]), int(model.actuator_biastype[index])
    if int(model.actuator_trntype[index]) != _ON_JOINT or gain >= len(_GAINS) or bias >= len(_BIASES):
        raise GainroomError(f"model: the actuator {name!r} is no position, velocity or torque of one joint")
    found = {"name": name, "joint": _name(model.joint(int(model.actuator_trnid[index, 0])), "joint")}
    found |= {"gear": _text(model.actuator_gear[index]), "gaintype": _GAINS[gain], "biastype": _BIASES[bias]}
    found |= {"gainprm": _text(model.actuator_gainprm[index, :3]), "biasprm": _text(model.actuator_biasprm[index, :3])}
    for what in ("ctrl", "force"):
        if getattr(model, f"actuator_{what}limited")[index]:
            found |= {f"{what}limited": "true", f"{what}range": _text(getattr(model, f"actuator_{what}range")[index])}
    return found


def _of_pinocchio(model: Any) -> str:
    """MJCF of a pinocchio.Model: every joint of a type with one axis, ball or free; its rotors as armature."""
    root = _root(model.name)
    SubElement(root, "option", gravity=_text(model.gravity.linear))
    bodies = {0: SubElement(root, "worldbody")}
    for joint in range(1, model.njoints):
        place, name = model.jointPlacements[joint], model.names[joint]
        element = bodies[joint] = SubElement(
            bodies[int(model.parents[joint])], "body", name=f"{name}_body", pos=_text(place.translation), quat=_quaternion(place.rotation)
        )
        SubElement(element, "joint", {"name": name, **_pinocchio_joint(model, joint)})
        inertia = model.inertias[joint]
        if inertia.mass > 0:
            moments = inertia.inertia
            full = [moments[k, k] for k in range(3)] + [moments[0, 1], moments[0, 2], moments[1, 2]]
            SubElement(element, "inertial", mass=_text(inertia.mass), pos=_text(inertia.lever), fullinertia=_text(full))
    for name, frame in _frames(model):
        place = frame.placement
        SubElement(bodies[int(frame.parentJoint)], "site", name=name, pos=_text(place.translation), quat=_quaternion(place.rotation))
    return tostring(root, "unicode")


def _frames(model: Any) -> Iterator[tuple[str, Any]]:
    """Frames of a pinocchio.Model that are no joints, each name once."""
    seen = {"universe", *model.names}
    for frame in model.frames:
        if frame.name not in seen:
            seen.add(frame.name)
            yield frame.name, frame


_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


def _pinocchio_joint(model: Any, joint: int) -> dict[str, str]:
    """Attributes of a joint of a pinocchio.Model. Raises GainroomError for a type that MJCF has not."""
    kind, first = model.joints[joint].shortname(), model.joints[joint].idx_v
    if "FreeFlyer" in kind:
        return {"type": "free"}
    if "Spherical" in kind and "ZYX" not in kind:
        return {"type": "ball"}
    own = kind.removeprefix("JointModel")
    if own.startswith(("RevoluteUnaligned", "RevoluteUnboundedUnaligned", "PrismaticUnaligned")):
        axis = np.asarray(model.joints[joint].extract().axis)
    elif re.fullmatch("(R|RUB|P)[XYZ]", own):
        axis = np.array(_AXES[own[-1]])
    else:
        raise GainroomError(f"model: the joint {model.names[joint]!r} of Pinocchio's type {kind} is no hinge, slide, ball or free joint")
    found = {"type": "slide" if own.startswith("P") else "hinge", "axis": _text(axis)}
    rotor, ratio = model.rotorInertia[first], model.rotorGearRatio[first]
    found["armature"] = _text(model.armature[first] + rotor * ratio**2)
    found |= {"damping": _text(model.damping[first]), "frictionloss": _text(model.friction[first])}
    low, high = (getattr(model, f"{end}PositionLimit")[model.joints[joint].idx_q] for end in ("lower", "upper"))
    bounded = model.joints[joint].nq == 1  # a continuous joint has cosine and sine, of which the limits are
    if math.isfinite(low) and math.isfinite(high) and low < high and bounded:
        found |= {"limited": "true", "range": _text(low, high)}
    effort = model.effortLimit[first]
    if math.isfinite(effort) and effort > 0:
        found |= {"actuatorfrclimited": "true", "actuatorfrcrange": _text(-effort, effort)}
    return found


def _quaternion(rotation: Any) -> str:
    """Quaternion w, x, y, z of a rotation matrix (3, 3): the eigenvector of Bar-Itzhack's matrix, of which no term cancels."""
    r = np.asarray(rotation)
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [0, r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [0, 0, r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [0, 0, 0, r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    return _text(np.linalg.eigh(k + np.triu(k, 1).T)[1][:, -1])
