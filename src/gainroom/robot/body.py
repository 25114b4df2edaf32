"""The links of a robot as rigid bodies, without rotors: inertia, frames, centre of mass and gravity torques at a posture.

Velocities are v = (base twist, joint rates): a floating base comes first, with its linear and angular velocity in its own axes, as
Pinocchio has it (Featherstone, Rigid Body Dynamics Algorithms, 2008; Carpentier et al., The Pinocchio C++ library, 2019).
"""

import importlib
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, nearest, require_finite
from ..linear.arrays import Booleans, Floats, Integers

Base = Literal["fixed", "floating"]
UNLIMITED = 1e300  # Pinocchio writes the largest float where a joint has no limit


def library(name: str, title: str) -> Any:
    """The module `name` of the extra `robot`. Raises GainroomError where it is not installed."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise GainroomError(f"robot models need {title}: pip install 'gainroom[robot]'") from error
    except ImportError as error:
        raise GainroomError(f"robot models need {title}, which is installed but does not load: {error}") from error


def is_continuous(joint: Any) -> bool:
    """Whether a posture holds cosine and sine of this joint of Pinocchio's instead of its angle."""
    return joint.nq == 2 and joint.nv == 1


def is_prismatic(joint: Any) -> bool:
    """Whether this joint of Pinocchio's is prismatic."""
    return joint.shortname().startswith("JointModelP")  # PX, PY, PZ, PrismaticUnaligned


def put_position(q: Floats, joint: Any, value: float) -> None:
    """Write `value` [rad; m if prismatic] as the position of one of Pinocchio's joints into posture `q`."""
    q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if is_continuous(joint) else value


@dataclass(frozen=True)
class Bone:
    """One joint of the file for a drawing: `tip` (3,) [m] in its frame is where its links end, None where other joints follow."""

    name: str
    parent: str | None
    tip: Floats | None


@dataclass(frozen=True)
class Skeleton:
    """Where the joints are.

    names       of the k nodes: "base", then every joint of the file, locked ones too, each chain closed by a tip
    positions   (k, 3) [m]; a floating base stands at the origin
    parents     (k,) index of the node that this one hangs on; −1 for the base
    joints      (k,) index in joint_names of the joint at the node; −1 for base, locked joints and tips
    """

    names: tuple[str, ...]
    positions: Floats
    parents: Integers
    joints: Integers


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Rigid links, n actuated joints of one degree of freedom each, and N = n (fixed base) or 6 + n (floating base).

    source        its name in messages
    model         Pinocchio's, links only: its armature and rotor inertias are zero
    joint_names   the n actuated joints, in the model's order
    base          "fixed" | "floating"
    armature      (n,) reflected rotor inertia given in the file, 0 where none [kg m²; kg if prismatic]
    locked        joints of the file that are held, and at which position [rad; m if prismatic]
    notes         warnings about how the file was read
    bones         joints of the file, parents first, for a drawing
    springs       of joints that have one of their own, beside the gearbox, by name [N m/rad; N/m if prismatic]

    Postures q (nq,) hold the base's position and quaternion (x, y, z, w) if it floats, then each joint's angle, or cosine and sine of a
    continuous joint's. Make them with `configuration`. All methods raise GainroomError for a q of wrong shape or not finite.
    """

    source: str
    model: Any
    joint_names: tuple[str, ...]
    base: Base
    armature: Floats
    locked: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    bones: tuple[Bone, ...] = ()
    springs: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"RigidBody({self.source!r}: {self.size} joints, {len(self.locked)} locked, {self.base} base)"

    @property
    def size(self) -> int:
        """n, the number of actuated joints."""
        return len(self.joint_names)

    @property
    def prismatic(self) -> Booleans:
        """(n,) True where a joint is prismatic: its numbers are in m and N, where those of a hinge are in rad and N m."""
        return np.array([is_prismatic(joint) for joint in self.joints])

    @property
    def damping(self) -> Floats:
        """(n,) the joints' own damping given in the file [N m s/rad; N s/m if prismatic]; it is no part of the links."""
        return np.array([float(self.model.damping[joint.idx_v]) for joint in self.joints])

    @property
    def nq(self) -> int:
        """Length of a posture q."""
        return self.model.nq

    @property
    def nv(self) -> int:
        """N, the degrees of freedom: n, or 6 + n on a floating base."""
        return self.model.nv

    @cached_property
    def total_mass(self) -> float:
        """Of all moving links [kg]."""
        return float(sum(self.model.inertias[joint].mass for joint in range(1, self.model.njoints)))

    @cached_property
    def lower(self) -> Floats:
        """(n,) lowest positions [rad; m if prismatic], −inf where there is no limit."""
        return self._limits(self.model.lowerPositionLimit, -1)

    @cached_property
    def upper(self) -> Floats:
        """(n,) highest positions [rad; m if prismatic], inf where there is no limit."""
        return self._limits(self.model.upperPositionLimit, 1)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of contact and task frames: URDF links, MJCF bodies and sites."""
        return tuple(self._frames)

    def neutral(self) -> Floats:
        """(nq,) every joint at 0, a floating base at the identity."""
        return self._pinocchio.neutral(self.model)

    def configuration(self, angles: Mapping[str, float]) -> Floats:
        """(nq,) joints at `angles` [rad; m if prismatic], at 0 where not named; a floating base at the identity.

        A locked joint may be named with the position that it is held at. Raises GainroomError for unknown joints and other positions.
        """
        q = self.neutral()
        for name, angle in angles.items():
            value = float(require_finite(self.source, f"position of joint {name!r}", angle))
            if name in self.locked:
                # A posture file and the lock may round differently in the last digit.
                if not np.isclose(value, self.locked[name], rtol=1e-9, atol=1e-9):
                    raise GainroomError(f"{self.source}: joint {name!r} is locked at {self.locked[name]:g} and cannot stand at {value:g}")
                continue
            put_position(q, self.joints[self._index(name)], value)
        return q

    def angles(self, q: ArrayLike) -> Floats:
        """(n,) joint positions in posture `q` [rad; m if prismatic]; of a continuous joint within ±π."""
        q = self._posture(q)
        return np.array([np.arctan2(q[j.idx_q + 1], q[j.idx_q]) if is_continuous(j) else q[j.idx_q] for j in self.joints])

    def beyond_limits(self, q: ArrayLike) -> tuple[str, ...]:
        """One warning for each joint that stands outside its limits in posture `q`."""
        return tuple(
            f"joint {name!r} at {angle:.4g} is outside its limits {low:.4g} to {high:.4g}"
            for name, angle, low, high in zip(self.joint_names, self.angles(q), self.lower, self.upper, strict=True)
            if not low - 1e-9 <= angle <= high + 1e-9  # limits are written with few digits
        )

    def integrate(self, q: ArrayLike, displacement: ArrayLike) -> Floats:
        """(nq,) the posture `displacement` (N,) away from `q`, as after unit time at that velocity."""
        moved = require_finite(self.source, "displacement", displacement)
        if moved.shape != (self.nv,):
            raise GainroomError(f"{self.source}: displacement of shape {moved.shape} must be ({self.nv},)")
        return self._pinocchio.integrate(self.model, self._posture(q), moved)

    def mass_matrix(self, q: ArrayLike) -> Floats:
        """A (N, N), symmetric: inertia of the links alone, rotors apart [kg m², kg m, kg]."""
        upper = np.triu(self._pinocchio.crba(self.model, self._data, self._posture(q)))
        return upper + np.triu(upper, 1).T

    def gravity_torque(self, q: ArrayLike) -> Floats:
        """g (N,), the torques that balance gravity: A v̇ = Sᵀ τ − g at rest [N m; N if prismatic and for a base's linear part]."""
        return self._pinocchio.computeGeneralizedGravity(self.model, self._data, self._posture(q)).copy()

    def com(self, q: ArrayLike) -> Floats:
        """(3,) centre of mass of everything that moves, world axes [m]."""
        return self._pinocchio.centerOfMass(self.model, self._data, self._posture(q)).copy()

    def com_jacobian(self, q: ArrayLike) -> Floats:
        """(3, N) from velocity to that of the centre of mass, world axes."""
        jacobian = self._pinocchio.jacobianCenterOfMass(self.model, self._data, self._posture(q))
        return jacobian.reshape(3, self.nv).copy()  # Pinocchio returns a vector for one degree of freedom

    def frame_placement(self, q: ArrayLike, frame: str) -> tuple[Floats, Floats]:
        """(R (3, 3), p (3,)): axes and origin of a frame in world axes [m]. Raises GainroomError for an unknown frame."""
        placement = self._placed(q).oMf[self._frame(frame)]
        return placement.rotation.copy(), placement.translation.copy()

    def frame_jacobian(self, q: ArrayLike, frame: str) -> Floats:
        """(6, N) from velocity to the frame's: linear, of its origin, then angular; both in the frame's own axes.

        Raises GainroomError for an unknown frame.
        """
        pin = self._pinocchio
        index = self._frame(frame)
        jacobian = pin.computeFrameJacobian(self.model, self._data, self._posture(q), index, pin.ReferenceFrame.LOCAL)
        return jacobian.reshape(6, self.nv).copy()

    def frame_index(self, frame: str) -> int:
        """Pinocchio's number of a frame. Raises GainroomError for an unknown one."""
        return self._frame(frame)

    def skeleton(self, q: ArrayLike) -> Skeleton:
        """Joints and the ends of chains as points, for a drawing of posture `q`."""
        data = self._placed(q)
        names, positions, parents, joints = ["base"], [data.oMf[self._root].translation.copy()], [-1], [-1]
        node: dict[str | None, int] = {None: 0}
        for bone in self.bones:
            placement = data.oMf[self._joint_frames[bone.name]]
            node[bone.name] = len(names)
            names.append(bone.name)
            positions.append(placement.translation.copy())
            parents.append(node[bone.parent])
            joints.append(self.joint_names.index(bone.name) if bone.name in self.joint_names else -1)
            if bone.tip is not None:
                names.append(f"end of {bone.name}")
                positions.append(placement.act(bone.tip))
                parents.append(node[bone.name])
                joints.append(-1)
        return Skeleton(tuple(names), np.array(positions), np.array(parents), np.array(joints))

    @cached_property
    def _pinocchio(self) -> Any:
        return library("pinocchio", "Pinocchio")

    @cached_property
    def _scratch(self) -> threading.local:
        return threading.local()

    @property
    def _data(self) -> Any:
        """Pinocchio's workspace, one per thread: costly to make, and written by every call."""
        if not hasattr(self._scratch, "data"):
            self._scratch.data = self.model.createData()
        return self._scratch.data

    def __getstate__(self) -> dict[str, Any]:
        """Without modules and workspaces, so that a body can be sent to another process."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_pinocchio", "_scratch")}

    @property
    def joints(self) -> list[Any]:
        """Pinocchio's record of each actuated joint."""
        return list(self.model.joints)[self.model.njoints - self.size :]

    @cached_property
    def _frames(self) -> dict[str, int]:
        """Index of each frame that a user may name; index 0 is the world."""
        kinds = (self._pinocchio.FrameType.BODY, self._pinocchio.FrameType.OP_FRAME)
        return {frame.name: index for index, frame in enumerate(self.model.frames) if index and frame.type in kinds}

    @cached_property
    def _joint_frames(self) -> dict[str, int]:
        """Index of the frame of each joint, moving or not."""
        kinds = (self._pinocchio.FrameType.JOINT, self._pinocchio.FrameType.FIXED_JOINT)
        return {frame.name: index for index, frame in enumerate(self.model.frames) if frame.type in kinds}

    @property
    def _root(self) -> int:
        """Index of the base's frame."""
        return self._joint_frames[self.model.names[1]] if self.base == "floating" else 0

    def _index(self, name: str) -> int:
        if name not in self.joint_names:
            raise GainroomError(f"{self.source}: no joint {name!r}{nearest(name, self.joint_names, 'joint')}")
        return self.joint_names.index(name)

    def _frame(self, name: str) -> int:
        if name not in self._frames:
            raise GainroomError(f"{self.source}: no frame {name!r}{nearest(name, self.frames, 'frame')}")
        return self._frames[name]

    def _posture(self, q: ArrayLike) -> Floats:
        posture = require_finite(self.source, "posture", q)
        if posture.shape != (self.nq,):
            raise GainroomError(f"{self.source}: posture of shape {posture.shape} must be ({self.nq},)")
        return posture

    def _placed(self, q: ArrayLike) -> Any:
        self._pinocchio.framesForwardKinematics(self.model, self._data, self._posture(q))
        return self._data

    def _limits(self, bounds: Sequence[float], side: int) -> Floats:
        values = [side * np.inf if is_continuous(joint) else bounds[joint.idx_q] for joint in self.joints]
        return np.array([side * np.inf if abs(value) > UNLIMITED else value for value in values], dtype=float)
