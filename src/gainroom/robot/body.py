"""The links of a robot as rigid bodies, without rotors: inertia, frames, centre of mass and gravity torques at a posture.

Velocities are v = (base twist, passive joint rates, joint rates): a floating base comes first, with its linear and angular velocity in its
own axes, as Pinocchio has it (Featherstone, Rigid Body Dynamics Algorithms, 2008; Carpentier et al., The Pinocchio C++ library, 2019).
"""

import importlib.util
import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, first_of_many, nearest, require_finite
from ..system.linear.arrays import Booleans, Floats, Integers
from .linkage import Linkage, closed
from .skeleton import Bone, Skeleton

Base = Literal["fixed", "floating"]
UNLIMITED = 1e300  # Pinocchio writes the largest float where a joint has no limit


def require_installed(name: str, title: str) -> None:
    """Raise GainroomError where the module `name` of the extra `robot` is not installed; it is not loaded."""
    if importlib.util.find_spec(name) is None:
        raise GainroomError(f"robot models need {title}: pip install 'gainroom[robot]'")


def library(name: str, title: str) -> Any:
    """Module `name` of the extra `robot`. Raises GainroomError if it is not installed or does not load."""
    require_installed(name, title)
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise GainroomError(f"robot models need {title}, which is installed but does not load: {error}") from error


def is_continuous(joint: Any) -> bool:
    """True if a posture stores cosine and sine of this Pinocchio joint instead of its angle."""
    return joint.nq == 2 and joint.nv == 1


def is_prismatic(joint: Any) -> bool:
    """True if this Pinocchio joint is prismatic."""
    return joint.shortname().startswith("JointModelP")  # PX, PY, PZ, PrismaticUnaligned


def put_position(q: Floats, joint: Any, value: float) -> None:
    """Write `value` [rad; m if prismatic] as the position of one of Pinocchio's joints into posture `q`."""
    q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if is_continuous(joint) else value


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Rigid links, n actuated joints of one degree of freedom each, and N velocities: n, the passive joints', 6 of a floating base.

    source        its name in messages
    model         Pinocchio's, links only: armature and rotor inertia of the actuated joints are zero
    joint_names   the n actuated joints, in the model's order
    base          "fixed" | "floating"
    armature      (n,) reflected rotor inertia given in the file, 0 where none [kg m²; kg if prismatic]
    locked        joints of the file that are held, with their position [rad; m if prismatic]
    led           locked joints that would follow a moving joint: they are held where its position in the posture puts them
    notes         warnings about how the file was read
    doubts        implausible link data (plausible_links.py), which makes every verdict doubtful
    bones         joints of the file, parents first, for a drawing
    springs       stiffness of a joint's own spring, beside the gearbox, by name [N m/rad; N/m if prismatic]
    passive       joints without a motor, in the model's order, of any freedom; their rotors are part of the links
    linkages      closed loops and following joints
    passive_springs   stiffness and damping of passive joints with a spring, by name [N m/rad; N m s/rad]
    looped        joints of closed loops, actuated or passive
    payload       added point masses by frame [kg], already contained in `model`

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
    passive: tuple[str, ...] = ()
    linkages: tuple[Linkage, ...] = ()
    passive_springs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    looped: frozenset[str] = frozenset()
    payload: Mapping[str, float] = field(default_factory=dict)
    led: frozenset[str] = frozenset()
    doubts: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"RigidBody({self.source!r}: {self.size} joints, {len(self.locked)} locked, {self.base} base)"

    @property
    def size(self) -> int:
        """Number n of actuated joints."""
        return len(self.joint_names)

    def require_tree(self, owner: str) -> None:
        """Raise GainroomError, its message beginning with `owner`, if the body has closed loops or passive joints."""
        if self.linkages or self.passive:
            named = {name for name in self.passive if any(repr(name) in linkage.name for linkage in self.linkages)}
            passive = [f"passive joint {name!r}" for name in self.passive if name not in named]
            what = first_of_many([*(linkage.name for linkage in self.linkages), *passive])
            them = "closed loops, passive joints and joints that follow others"
            raise GainroomError(f"{owner}: {them} are not carried here, and this robot has {what}; lock joints that do not matter")

    @property
    def every_joint(self) -> tuple[str, ...]:
        """Names of all joints of the file: actuated, locked, passive."""
        return (*self.joint_names, *self.locked, *self.passive)

    @property
    def prismatic(self) -> Booleans:
        """(n,) True where a joint is prismatic: its values are in m and N instead of rad and N m."""
        return np.array([is_prismatic(joint) for joint in self.joints])

    @property
    def damping(self) -> Floats:
        """Joint damping (n,) given in the file [N m s/rad; N s/m if prismatic]; it is not part of the links."""
        return np.array([float(self.model.damping[joint.idx_v]) for joint in self.joints])

    @property
    def nq(self) -> int:
        """Length of a posture q."""
        return self.model.nq

    @property
    def nv(self) -> int:
        """Number N of degrees of freedom: n, those of passive joints, and 6 of a floating base."""
        return self.model.nv

    @cached_property
    def total_mass(self) -> float:
        """Mass of all moving links [kg]."""
        return float(sum(self.model.inertias[joint].mass for joint in range(1, self.model.njoints)))

    def with_payload(self, frame: str, mass: float) -> "RigidBody":
        """Body with an added point mass [kg] at the origin of a frame.

        Raises GainroomError for an unknown frame, and for one that does not move.
        """
        place = self.model.frames[self.frame_index(frame)]
        if not place.parentJoint:
            raise GainroomError(f"{self.source}: frame {frame!r} does not move, so that a payload there has no effect; name one that does")
        model = self._pinocchio.Model(self.model)
        model.inertias[place.parentJoint] += place.placement.act(self._pinocchio.Inertia(mass, np.zeros(3), np.zeros((3, 3))))
        return replace(self, model=model, payload={**self.payload, frame: self.payload.get(frame, 0.0) + mass})

    @property
    def carriers(self) -> tuple[str, ...]:
        """Names of the moving frames, at which a payload has an effect."""
        return tuple(name for name, index in self._frames.items() if self.model.frames[index].parentJoint)

    @cached_property
    def lower(self) -> Floats:
        """Lower position limits (n,) [rad; m if prismatic]; −inf where there is none."""
        return self._limits(self.model.lowerPositionLimit, -1)

    @cached_property
    def upper(self) -> Floats:
        """Upper position limits (n,) [rad; m if prismatic]; inf where there is none."""
        return self._limits(self.model.upperPositionLimit, 1)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of contact and task frames: URDF links, MJCF bodies and sites."""
        return tuple(self._frames)

    def neutral(self) -> Floats:
        """Neutral posture (nq,).

        Every joint at 0, a floating base at the identity, or where the file puts it if loops tie it to the world.
        """
        return self._pinocchio.neutral(self.model)

    def configuration(self, angles: Mapping[str, float]) -> Floats:
        """Posture (nq,) with joints at `angles` [rad; m if prismatic], 0 where not named; a floating base as in `neutral`.

        A locked joint may be named with the position that it is held at. Closed loops are closed: a tied base follows, and passive joints
        are solved for, starting where they are named. Raises GainroomError for unknown joints, other positions of locked ones, and loops
        that stay open.
        """
        q = self.neutral()
        moved: dict[str, float] = {}
        for name, angle in angles.items():
            value = float(require_finite(self.source, f"position of joint {name!r}", angle))
            if name in self.locked:
                # A posture file and the lock may round differently in the last digit.
                if not np.isclose(value, self.locked[name], rtol=1e-9, atol=1e-9):
                    raise GainroomError(f"{self.source}: joint {name!r} is locked at {self.locked[name]:g} and cannot stand at {value:g}")
                continue
            moved[name] = value
            self.place(q, name, value)
        if not self.linkages:
            return q
        return closed(self, self.neutral(), moved)

    def place(self, q: Floats, name: str, value: float) -> None:
        """Write the position of a one-degree-of-freedom joint, actuated or passive, into `q`. Raises GainroomError for another joint."""
        if name not in self.passive and name not in self.joint_names:
            raise GainroomError(f"{self.source}: no joint {name!r}{nearest(name, self.joint_names, 'joint')}")
        joint = self._joint(name)
        if joint.nv > 1:
            raise GainroomError(f"{self.source}: joint {name!r} has {joint.nv} degrees of freedom and no single position")
        put_position(q, joint, value)

    def position(self, q: Floats, name: str) -> float:
        """Position of any one-degree-of-freedom joint in `q` [rad; m if prismatic]."""
        if name in self.locked:
            return float(self.locked[name])
        joint = self._joint(name)
        at = joint.idx_q
        return float(np.arctan2(q[at + 1], q[at]) if is_continuous(joint) else q[at])

    def velocity_of(self, name: str) -> int:
        """Index of a joint's rate among the N velocities, the first for several; −1 for a locked joint."""
        return -1 if name in self.locked else int(np.flatnonzero(self._order == self._joint(name).idx_v)[0])

    def rate(self, name: str) -> Floats:
        """Row (N,) from velocity to the rate of a one-degree-of-freedom joint; zeros for a locked one."""
        return (np.arange(self.nv) == self.velocity_of(name)).astype(float)

    def angles(self, q: ArrayLike) -> Floats:
        """Joint positions (n,) in posture `q` [rad; m if prismatic]; a continuous joint's within ±π."""
        q = self._posture(q)
        return np.array([np.arctan2(q[j.idx_q + 1], q[j.idx_q]) if is_continuous(j) else q[j.idx_q] for j in self.joints])

    def beyond_limits(self, q: ArrayLike) -> tuple[str, ...]:
        """Warnings, one for each joint outside its position limits in posture `q`."""
        return tuple(
            f"joint {name!r} at {angle:.4g} is outside its limits {low:.4g} to {high:.4g} {'m' if is_prismatic(joint) else 'rad'}"
            for name, joint, angle, low, high in zip(self.joint_names, self.joints, self.angles(q), self.lower, self.upper, strict=True)
            if not low - 1e-9 <= angle <= high + 1e-9  # limits are written with few digits
        )

    def integrate(self, q: ArrayLike, displacement: ArrayLike) -> Floats:
        """Posture (nq,) reached from `q` by the velocity `displacement` (N,) in unit time."""
        moved = require_finite(self.source, "displacement", displacement)
        if moved.shape != (self.nv,):
            raise GainroomError(f"{self.source}: displacement of shape {moved.shape} must be ({self.nv},)")
        in_tree = np.empty(self.nv)
        in_tree[self._order] = moved
        return self._pinocchio.integrate(self.model, self._posture(q), in_tree)

    def mass_matrix(self, q: ArrayLike) -> Floats:
        """Mass matrix A (N, N), symmetric, of the links without the actuated joints' rotors [kg m², kg m, kg]."""
        upper = np.triu(self._pinocchio.crba(self.model, self._data, self._posture(q)))
        return self._ordered(upper + np.triu(upper, 1).T, both=True)

    def gravity_torque(self, q: ArrayLike) -> Floats:
        """Gravity torques g (N,) with A v̇ = Sᵀ τ − g at rest [N m; N if prismatic and for a base's linear part]."""
        return self._ordered(self._pinocchio.computeGeneralizedGravity(self.model, self._data, self._posture(q)))

    def com(self, q: ArrayLike) -> Floats:
        """Centre of mass (3,) of everything that moves, world axes [m]."""
        return self._pinocchio.centerOfMass(self.model, self._data, self._posture(q)).copy()

    def com_jacobian(self, q: ArrayLike) -> Floats:
        """Jacobian (3, N) of the centre of mass, world axes."""
        jacobian = self._pinocchio.jacobianCenterOfMass(self.model, self._data, self._posture(q))
        return self._ordered(jacobian.reshape(3, self.nv))  # Pinocchio returns a vector for one degree of freedom

    def frame_placement(self, q: ArrayLike, frame: str) -> tuple[Floats, Floats]:
        """Placement of a frame in world axes: rotation R (3, 3) and origin p (3,) [m]. Raises GainroomError for an unknown frame."""
        return self.frame_placements(q, [frame])[0]

    def frame_placements(self, q: ArrayLike, frames: Iterable[str]) -> list[tuple[Floats, Floats]]:
        """Placements of several frames in one posture, see frame_placement."""
        data = self._placed(q)
        return [(data.oMf[index].rotation.copy(), data.oMf[index].translation.copy()) for index in map(self.frame_index, frames)]

    def frame_jacobian(self, q: ArrayLike, frame: str) -> Floats:
        """Jacobian (6, N) of a frame: linear velocity of its origin, then angular; both in the frame's own axes.

        Raises GainroomError for an unknown frame.
        """
        return self._jacobian(q, self.frame_index(frame))

    def anchor_jacobian(self, q: ArrayLike, anchor: str) -> Floats:
        """Jacobian (6, N) of an anchor of a closed loop, in its own axes."""
        return self._jacobian(q, self._anchor(anchor))

    def _jacobian(self, q: ArrayLike, index: int) -> Floats:
        pin = self._pinocchio
        jacobian = pin.computeFrameJacobian(self.model, self._data, self._posture(q), index, pin.ReferenceFrame.LOCAL)
        return self._ordered(jacobian.reshape(6, self.nv))

    def anchors(self, q: ArrayLike, *names: str) -> tuple[Any, ...]:
        """Placements of anchors of closed loops in world axes, as Pinocchio's SE3."""
        data = self._placed(q)
        return tuple(data.oMf[self._anchor(name)].copy() for name in names)

    def _anchor(self, name: str) -> int:
        return self.model.getFrameId(name, self._pinocchio.FrameType.SENSOR)

    def logarithm(self, placement: Any) -> Floats:
        """Twist (6,) that reaches a placement in unit time: linear [m], angular [rad]."""
        return np.array(self._pinocchio.log6(placement).vector)

    def skeleton(self, q: ArrayLike) -> Skeleton:
        """Joints and chain ends as points, for a drawing of posture `q`."""
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
        """Pinocchio workspace, one per thread: expensive to make, and written by every call."""
        if not hasattr(self._scratch, "data"):
            self._scratch.data = self.model.createData()
        return self._scratch.data

    def __getstate__(self) -> dict[str, Any]:
        """State for pickling without modules and workspaces, so that a body can be sent to another process."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_pinocchio", "_scratch", "joints")}

    @cached_property
    def joints(self) -> tuple[Any, ...]:
        """Pinocchio's record of each actuated joint."""
        return tuple(self._joint(name) for name in self.joint_names)

    def _joint(self, name: str) -> Any:
        return self.model.joints[self.model.getJointId(name)]

    @cached_property
    def _order(self) -> Integers:
        """Indices (N,) of this body's velocities in Pinocchio's, which follow the tree."""
        parts = [(joint.idx_v, joint.nv) for joint in (*(self._joint(name) for name in self.passive), *self.joints)]
        base = np.arange(self.nv - sum(size for _, size in parts))
        return np.concatenate([base, *(np.arange(start, start + size) for start, size in parts)]).astype(int)

    def _ordered(self, values: Floats, both: bool = False) -> Floats:
        """Copy of `values` with its last axis (`both`: the last two) in this body's order of velocities."""
        if not self.passive:
            return np.array(values)
        return values[np.ix_(self._order, self._order)] if both else values[..., self._order]

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

    def frame_index(self, name: str) -> int:
        """Pinocchio's index of a frame. Raises GainroomError for an unknown one."""
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
