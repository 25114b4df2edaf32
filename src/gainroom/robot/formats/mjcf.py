"""From MuJoCo's compiled model to Pinocchio's: the same bodies, joints and inertias, so the same mass matrix; and armature and damping.

(Pinocchio's own MJCF reader is silently wrong on some files: masses of default classes, settotalmass, all trees after the first.)

A body stands at T₀ E₁ … E_m in its parent, with T₀ its place at qpos0 and E_j = Trans(p_j) Rot(a_j, q_j − q0_j) Trans(−p_j) for the m
joints in it; prismatic joints translate by a_j (q_j − q0_j) instead (MuJoCo's documentation, Computation: kinematics).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.polynomial import Polynomial

from ...errors import GainroomError, first_of_many, refuse_all
from ..assemble import Description, require_at_most
from ..body import Base, library
from ..linkage import FollowingJoint, JoinedFrames, Linkage
from ..plausible_links import Solid
from .mjcf_constraints import Constraints, Join, Placed
from .mjcf_file import MOST_KEYFRAMES, Compiled, compile_mjcf
from .model_format import INTEGRATORS, ActuatorGain, ActuatorGains, ModelFormat, Stepping


class Mjcf(ModelFormat):
    """MuJoCo's format. It says itself what floats; "fixed" holds a free joint, "floating" frees the one robot of a file that has none.

    Free things without joints of their own are left out.
    """

    title = "MJCF"
    has_base = True

    def describe(self, root: Element, path: Path, base: Base | None) -> Description:
        compiled = compile_mjcf(root, path, meanwhile=lambda: library("pinocchio", "Pinocchio"))  # each takes half a second
        pin = library("pinocchio", "Pinocchio")
        tree = _Tree(pin, compiled.model, str(path))
        tree.grow(base, compiled.constraints)
        tree.constrain(compiled.constraints)
        notes = (*compiled.notes, *tree.notes, *_not_counted(compiled.model))
        return Description(
            str(path),
            tree.result,
            tree.held,
            notes,
            tree.springs,
            tree.friction,
            tuple(tree.linkages),
            tuple(tree.solids),
            tree.actuated(compiled),
        )

    def keyframes(self, root: Element, path: Path) -> Mapping[str, Mapping[str, float]]:
        """Keyframes by name: positions by joint name [rad; m if prismatic], of joints with one degree of freedom."""
        compiled = compile_mjcf(root, path)
        require_at_most(str(path), sum(map(len, root.findall("keyframe"))), "of <keyframe>", MOST_KEYFRAMES)
        refuse_all(compiled.unkeyed)
        model = compiled.model
        places = {_joint_name(model, joint): model.jnt_qposadr[joint] for joint in range(model.njnt) if model.jnt_type[joint] in _ONE_DOF}
        frames = {name or f"key#{index}": model.key_qpos[index] for index, name in enumerate(model.names["key"])}
        return {frame: {joint: float(qpos[place]) for joint, place in places.items()} for frame, qpos in frames.items()}

    def position_gains(self, root: Element, path: Path) -> ActuatorGains:
        """Gains of <position>, <velocity>, <intvelocity>, <pid> and affine <general> actuators, as MuJoCo compiles them, times gear²."""
        compiled = compile_mjcf(root, path)
        model, gains, late = compiled.model, {}, []
        for index in range(len(model.actuator_trnid)):
            joint, gear = model.actuator_trnid[index, 0], float(model.actuator_gear[index, 0])
            stiffness, damping = (-float(each) * gear**2 for each in model.actuator_biasprm[index, 1:3])
            integral = float(model.actuator_gainprm[index, 0]) * gear**2 if model.actuator_gaintype[index] == compiled.pid else 0.0
            if model.jnt_type[joint] not in _ONE_DOF or not (stiffness or damping):
                continue
            name = _joint_name(model, joint)
            before = gains.get(name, ActuatorGain())
            gains[name] = ActuatorGain(before.kp + stiffness, before.kd + damping, before.ki + integral, _effort_limit(model, int(joint)))
            late += [name] if getattr(model, "actuator_delay", np.zeros(index + 1))[index] > 0 else []  # since MuJoCo 3.5
        notes = [f"actuators that are no torque on one joint are left out: {first_of_many(compiled.left_out)}"] * bool(compiled.left_out)
        if late:
            notes.append(
                f"the delay of these joints' actuators delays the set-point, not the feedback, and does not count: {first_of_many(late)}"
            )
        return ActuatorGains(gains, tuple(notes))

    def stepping(self, root: Element, path: Path) -> Stepping:
        """Stepping by <option>, in the file or in those that it includes."""
        option = compile_mjcf(root, path).model.opt
        named = {name for each in root.iter("option") for name in each.attrib}
        name = next((name for name in INTEGRATORS if name.upper() == option.integrator), option.integrator)
        unnamed = tuple(name for name in ("timestep", "integrator") if name not in named)
        return Stepping(float(option.timestep), name, int(option.disableflags), unnamed, True)


_FREE, _BALL, _SLIDE, _HINGE = range(4)  # mjtJoint
_ONE_DOF = (_SLIDE, _HINGE)
_TO_XYZW = (1, 2, 3, 0)  # MuJoCo's quaternions begin with w


@dataclass
class _Tree:
    """Pinocchio model under construction, body by body.

    places     for each body, its joint, its placement in that joint, its frame
    floating   the body that floats
    tied       a constraint joins it, or what moves with it, to the rest; then it stands where the file puts it, else at the identity
    """

    pin: Any
    mujoco_model: Any
    source: str
    result: Any = None
    notes: list[str] = field(default_factory=list)
    places: dict[int, tuple[int, Any, int]] = field(default_factory=dict)
    floating: int | None = None
    tied: bool = False
    springs: dict[str, float] = field(default_factory=dict)
    friction: dict[str, float] = field(default_factory=dict)
    held: dict[str, str] = field(default_factory=dict)
    linkages: list[Linkage] = field(default_factory=list)
    solids: list[Solid] = field(default_factory=list)

    def grow(self, base: Base | None, constraints: Constraints) -> None:
        model = self.mujoco_model
        self.result = self.pin.Model()
        self.result.gravity.linear = np.array(model.opt.gravity) * (not _disabled(model, "mjDSBL_GRAVITY"))
        self.floating, left = self._roots(base)
        self.places[0] = (0, self.pin.SE3.Identity(), 0)
        roots = np.array(model.body_rootid)
        kept = [one for one in constraints.joins if not {int(roots[one.first.body]), int(roots[one.second.body])} & left]
        self.tied = any(self._ties_base(join) for join in kept)
        order = [body for body in range(1, model.nbody) if roots[body] not in left]
        # The base's six velocities come first.
        for body in sorted(order, key=lambda body: roots[body] != self.floating):
            self._add_body(body, body == self.floating)
        self._add_sites()

    def _roots(self, base: Base | None) -> tuple[int | None, set[int]]:
        """Index of the floating body, None for a fixed base; and the free bodies left out, which have no joints to actuate."""
        model = self.mujoco_model
        free = [model.jnt_bodyid[joint] for joint in range(model.njnt) if model.jnt_type[joint] == _FREE]
        moved = {model.body_rootid[model.jnt_bodyid[joint]] for joint in range(model.njnt) if model.jnt_type[joint] != _FREE}
        robots = [body for body in free if body in moved]
        left = {int(body) for body in free if body not in moved} if moved else set()
        self.notes.extend(f"free body {_body_name(model, body)!r} has no joints and is left out" for body in sorted(left))
        if base == "fixed":
            self.notes.extend(f"base: fixed holds the free joint of {_body_name(model, body)!r}, as if bolted down" for body in robots)
            return None, left
        if len(robots) > 1:
            named = ", ".join(repr(_body_name(model, body)) for body in robots)
            raise GainroomError(
                f"{self.source}: more than one floating base with joints: {named}; leave one in the file, or take base: fixed"
            )
        if base == "floating" and not robots:
            tops = sorted(int(body) for body in moved)
            if len(tops) != 1 or model.body_jntnum[tops[0]]:
                raise GainroomError(f"{self.source}: base: floating needs a <freejoint/>, or one top body without joints above all others")
            return tops[0], left
        return (int(robots[0]) if robots else None), left

    def _add_body(self, body: int, floats: bool) -> None:
        pin, model = self.pin, self.mujoco_model
        joint, place, frame = self.places[int(model.body_parentid[body])]
        place = place * self._placement(model.body_pos[body], model.body_quat[body])
        first = model.body_jntadr[body]
        if floats:
            name = _unused("root_joint", {_joint_name(model, index) for index in range(model.njnt)})
            joint = self.result.addJoint(0, pin.JointModelFreeFlyer(), place if self.tied else pin.SE3.Identity(), name)
            frame = self.result.addJointFrame(joint, frame)
            place = pin.SE3.Identity()
        for index in range(first, first + model.body_jntnum[body]):
            if model.jnt_type[index] != _FREE:
                joint, place, frame = self._add_joint(index, joint, place, frame)
            elif floats:
                self._set_armature_and_damping(index, joint)
        inertia = pin.Inertia(float(model.body_mass[body]), np.zeros(3), np.diag(model.body_inertia[body]))
        self.result.appendBodyToJoint(joint, inertia, place * self._placement(model.body_ipos[body], model.body_iquat[body]))
        frame = self.result.addBodyFrame(_body_name(model, body), joint, place, frame)
        self.places[body] = (joint, place, frame)
        self.solids.append(
            Solid(_body_name(model, body), inertia.mass, np.array(model.body_ipos[body]), np.sort(np.array(model.body_inertia[body])))
        )

    def _add_joint(self, index: int, parent: int, place: Any, frame: int) -> tuple[int, Any, int]:
        """Adds one joint of a body; returns its index, the body's placement in it, and the index of its frame."""
        pin, model = self.pin, self.mujoco_model
        axis, anchor = np.array(model.jnt_axis[index]), np.array(model.jnt_pos[index])
        start = float(model.qpos0[model.jnt_qposadr[index]])
        place = place * pin.SE3(np.eye(3), anchor)
        kind = model.jnt_type[index]
        if kind == _HINGE:
            place = place * pin.SE3(pin.AngleAxis(-start, axis).toRotationMatrix(), np.zeros(3))
            joint_model = pin.JointModelRevoluteUnaligned(axis)
        elif kind == _SLIDE:
            place = place * pin.SE3(np.eye(3), -start * axis)
            joint_model = pin.JointModelPrismaticUnaligned(axis)
        else:
            joint_model = pin.JointModelSpherical()
        joint = self.result.addJoint(parent, joint_model, place, _joint_name(model, index))
        self._set_armature_and_damping(index, joint)
        if kind != _BALL:
            self._set_limits(index, joint)
            self.friction[_joint_name(model, index)] = float(model.dof_frictionloss[model.jnt_dofadr[index]])
            if not _disabled(model, "mjDSBL_SPRING"):
                self.springs[_joint_name(model, index)] = float(model.jnt_stiffness[index])
        return joint, pin.SE3(np.eye(3), -anchor), self.result.addJointFrame(joint, frame)

    def _set_limits(self, index: int, joint: int) -> None:
        model, at = self.mujoco_model, self.result.joints[joint].idx_q
        low, high = model.jnt_range[index] if model.jnt_limited[index] else (-np.inf, np.inf)
        self._put("lowerPositionLimit", slice(at, at + 1), low)
        self._put("upperPositionLimit", slice(at, at + 1), high)

    def _set_armature_and_damping(self, index: int, joint: int) -> None:
        """Sets armature and damping of a joint, equal for each of its velocities."""
        model, record = self.mujoco_model, self.result.joints[joint]
        velocities = slice(record.idx_v, record.idx_v + record.nv)
        self._put("armature", velocities, joint_and_actuators(model, "armature", index))
        self._put("damping", velocities, joint_and_actuators(model, "damping", index))

    def _put(self, name: str, at: slice, value: float) -> None:
        values = np.array(getattr(self.result, name))
        values[at] = value
        setattr(self.result, name, values)

    def _add_sites(self) -> None:
        model, pin = self.mujoco_model, self.pin
        bodies = {_body_name(model, body) for body in range(1, model.nbody)}
        for site in range(model.nsite):
            name, body = model.names["site"][site], int(model.site_bodyid[site])
            if body not in self.places or not name:
                continue
            if name in bodies:
                self.notes.append(f"site {name!r} has the name of a body; as a frame, {name!r} is the body")
                continue
            joint, place, frame = self.places[body]
            place = place * self._placement(model.site_pos[site], model.site_quat[site])
            self.result.addFrame(pin.Frame(name, joint, frame, place, pin.FrameType.OP_FRAME))

    def constrain(self, constraints: Constraints) -> None:
        """Adds closed loops as pairs of frames, and the joints that are held or follow others."""
        model = self.mujoco_model
        start = {_joint_name(model, joint): float(model.qpos0[model.jnt_qposadr[joint]]) for joint in range(model.njnt)}
        for tie in constraints.ties:
            self.held[tie.follower] = f"is tied to {tie.leader!r}" if tie.leader else "is held by a constraint"
            if tie.leader:
                shifted = Polynomial(tie.coefficients)(Polynomial([-start[tie.leader], 1.0])) + start[tie.follower]
                self.linkages.append(FollowingJoint(f"joint {tie.follower!r}", tie.follower, tie.leader, tuple(shifted.coef)))
        for join in constraints.joins:
            if join.first.body not in self.places or join.second.body not in self.places:
                self.notes.append(f"the constraint {join.name!r} is ignored: it holds something that is left out")
                continue
            first, second = (self._anchor(f"{join.name} {side}", end) for side, end in enumerate((join.first, join.second)))
            ties_base = self._ties_base(join)
            name = f"the loop of {join.name!r}{' through the world' * ties_base}"
            self.linkages.append(JoinedFrames(name, first, second, join.welded, ties_base))

    def _ties_base(self, join: Join) -> bool:
        """True if one end of a closed loop moves with the floating base and the other does not."""
        first, second = (int(self.mujoco_model.body_rootid[end.body]) for end in (join.first, join.second))
        return (first == self.floating) != (second == self.floating)

    def _anchor(self, name: str, end: Placed) -> str:
        """Adds a frame that users cannot name, at one end of a closed loop, and returns its name."""
        joint, place, frame = self.places[end.body]
        place = place * self._placement(end.position, end.quaternion)
        name = _unused(name, {each.name for each in self.result.frames})
        self.result.addFrame(self.pin.Frame(name, joint, frame, place, self.pin.FrameType.SENSOR))
        return name

    def actuated(self, compiled: Compiled) -> frozenset[str] | None:
        """Names of the joints with an actuator; None if the file has no actuators."""
        return frozenset(each.joint for each in compiled.elements if each.joint) or None

    def _placement(self, position: Any, quaternion: Any) -> Any:
        rotation = self.pin.Quaternion(np.array(quaternion)[list(_TO_XYZW)]).normalized().toRotationMatrix()
        return self.pin.SE3(rotation, np.array(position))


def _disabled(model: Any, flag: str) -> bool:
    """True if the file disables a part of the physics, by the name of MuJoCo's flag."""
    return flag in model.opt.disabled


def _not_counted(model: Any) -> tuple[str, ...]:
    """Notes on what the file has that acts on the links and is left out."""
    notes = []
    lifted = [_body_name(model, body) for body in range(model.nbody) if model.body_gravcomp[body]]
    if lifted:
        notes.append(f"gravcomp of these bodies is left out, they weigh what they weigh: {first_of_many(lifted)}")
    several = [joint for joint in range(model.njnt) if model.jnt_type[joint] not in _ONE_DOF and model.jnt_stiffness[joint]]
    if several:
        notes.append(f"springs of ball and free joints are left out: {first_of_many([_joint_name(model, joint) for joint in several])}")
    curves = getattr(model, "jnt_stiffnesspoly", np.zeros(model.njnt))  # since MuJoCo 3.5
    bent = [_joint_name(model, joint) for joint in range(model.njnt) if np.any(curves[joint])]
    if bent:
        notes.append(f"of these joints' own springs only the linear part counts: {first_of_many(bent)}")
    return tuple(notes)


def _effort_limit(model: Any, joint: int) -> float | None:
    """Torque limit of all actuators of a joint together [N m; N if prismatic]; None if there is none."""
    own = [index for index in range(len(model.actuator_trnid)) if model.actuator_trnid[index, 0] == joint]
    limited = model.actuator_forcelimited[own]
    largest = np.max(np.abs(model.actuator_forcerange[own]), axis=1) * np.abs(model.actuator_gear[own, 0])
    limits = [float(np.sum(largest))] if np.all(limited) else []
    limits += [float(np.max(np.abs(model.jnt_actfrcrange[joint])))] if model.jnt_actfrclimited[joint] else []
    return min(limits, default=0.0) or None


def joint_and_actuators(model: Any, name: str, joint: int) -> float:
    """Armature [kg m²; kg if prismatic] or damping [N m s/rad; N s/m] of a joint, and of the actuators on it, which stand before a gear."""
    whole = float(getattr(model, f"dof_{name}")[model.jnt_dofadr[joint]])
    count = len(model.actuator_trnid)  # nu counts inputs, of which a <pid> has two
    before_gear = getattr(model, f"actuator_{name}", np.zeros(count))  # since MuJoCo 3.5
    own = [index for index in range(count) if model.actuator_trnid[index, 0] == joint]
    return whole + sum(float(before_gear[index] * model.actuator_gear[index, 0] ** 2) for index in own)


def _body_name(model: Any, body: int) -> str:
    return model.names["body"][body] or f"body#{body}"


def _joint_name(model: Any, joint: int) -> str:
    return model.names["joint"][joint] or f"joint#{joint}"


def _unused(name: str, names: set[str]) -> str:
    return name if name not in names else _unused(name + "_", names)
