"""Assembly of a rigid body from a robot file: choice of moving, held and passive joints, and checks of its values."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from ..errors import GainroomError, first_of_many, nearest, require_finite
from ..system.linear.arrays import Floats
from .body import Base, RigidBody, library, put_position
from .linkage import FollowingJoint, JoinedFrames, Linkage
from .name_patterns import select_all
from .plausible_links import Solid, impossible_inertias, link_doubts
from .skeleton import Bone

MAX_JOINTS = 150
"""Pinocchio's workspace grows with the third power of the joints: 150 take about 250 MB."""

# Scaled to a unit diagonal, the mass matrices of public robots have eigenvalues above 1e-4; massless links leave round-off, about 1e-16.
SINGULAR = 1e-12
MASSLESS = 1e-14
"""Joint inertia [kg m², kg] below which a joint carries no mass: a grain of sand at 1 mm has 1e-12."""

PART = 0.1
"""Least share of a joint in a massless motion, relative to the largest: less is round-off."""

FARTHEST = 1e6
"""Largest coordinate [m] or angle [rad] of a file: a robot in mm still fits a thousand times."""
LARGEST = 1e12
"""Largest mass [kg] or inertia [kg m²] of a file: products stay far below the overflow of a double."""

LINK = "link:"
RESERVED = "universe"
"""Pinocchio's name for the fixed world."""
DAMPING_NOTE = "the joints' own damping in the model file is not counted"
FRICTION_NOTE = "the joints' own dry friction in the model file is not counted [N m]"
FOLLOWERS_NOTE = "these joints follow others, which move their inertia, too"
HELD_NOTE = "held by constraints of the model file"
LOOPS_NOTE = "closed loops are kept closed"
PASSIVE_NOTE = "passive joints, without a motor"
RUBBED_NOTE = "damping of passive joints without a spring does not count"
SPRING_NOTE = "the joints' own springs in the model file count as stiffness beside the gearbox, without the load they carry [N m/rad]"
ASSUMED = (FOLLOWERS_NOTE, HELD_NOTE, LOOPS_NOTE, PASSIVE_NOTE, RUBBED_NOTE, FRICTION_NOTE, SPRING_NOTE)
"""Beginnings of notes about how a model was read that leave nothing missing and nothing to decide."""


@dataclass(frozen=True)
class Description:
    """Robot description as a file reader returns it.

    model   Pinocchio's, with every joint; a floating base, if there is one, is its first. Rotors in `armature`, not in the links
    held    joints that others, or constraints, hold in place, with the reason
    springs, friction   of the joints themselves, by name [N m/rad; N/m if prismatic], [N m; N]
    linkages   closed loops and following joints: a joint of `held` whose leader moves follows it
    solids     links as given in the file
    actuated   joints with an actuator; None: the format, or this file, names none
    """

    source: str
    model: Any
    held: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    springs: Mapping[str, float] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)
    linkages: tuple[Linkage, ...] = ()
    solids: tuple[Solid, ...] = ()
    actuated: frozenset[str] | None = None


def assemble(
    description: Description,
    base: Base | None = None,
    locked: Sequence[str] = (),
    selected: Sequence[str] | None = None,
    posture_for_locked: Mapping[str, float] | None = None,
    locked_key: str = "",
    passive: Sequence[str] = (),
    driven: Sequence[str] = (),
    for_names: bool = False,
) -> RigidBody:
    """Rigid body whose actuated joints are the `selected` ones (None: all) without the `locked` and `passive` ones; see load_model.

    Raises GainroomError.
    """
    source, model = description.source, description.model
    require_at_most(source, model.njoints - 1, "joints", MAX_JOINTS)
    _require_names(source, model)
    _require_sane(source, model)
    first = 2 if floats(model) else 1
    names = tuple(model.names[first:])
    motors = frozenset().union(description.actuated or (), *_named(driven, names, f"{source}: driven"))
    held, idle = _not_actuated(description, names, locked, selected, passive, motors, locked_key or f"{source}: locked")
    positions = _positions(description, names, held, posture_for_locked or {})
    actuated = tuple(name for name in names if name not in held and name not in idle)
    if not actuated:
        there = f"all {len(names)} joints are locked" if names else "it has no joints"
        raise GainroomError(f"{source}: no actuated joint: {there}")

    welded = (model.names[1],) if base == "fixed" and first == 2 else ()
    reduced, armature = _reduce(model, (*welded, *held), positions, idle)
    ids = [model.getJointId(name) for name in actuated]
    body = RigidBody(
        source=source,
        model=reduced,
        joint_names=actuated,
        base="floating" if floats(reduced) else "fixed",
        armature=np.array([armature[model.joints[index].idx_v] for index in ids]),
        locked={name: positions.get(name, 0.0) for name in held},
        notes=_notes(description, held, idle, positions, model),
        bones=tuple(_bone(model, index, first) for index in range(first, model.njoints)),
        springs={name: stiffness for name, stiffness in description.springs.items() if name in actuated},
        passive=idle,
        linkages=tuple(one for one in description.linkages if _counts(one, model, held)),
        passive_springs={
            name: (description.springs[name], _damping(model, name)) for name in idle if description.springs.get(name, 0.0) > 0
        },
        looped=frozenset(_looped(description) | _geared(description, held, motors)),
        doubts=link_doubts(model, description.solids),
        led=frozenset(name for name, one in _leaders(description).items() if name in held and one.leader not in held),
    )
    if not for_names:
        require_movable(body)
    return body


def require_movable(body: RigidBody) -> None:
    """Raise GainroomError, naming joints, if an actuated joint has more than one degree of freedom or the mass matrix is singular."""
    for name in body.joint_names:
        freedom = body.model.joints[body.model.getJointId(name)].nv
        if freedom != 1:
            raise GainroomError(f"{body.source}: joint {name!r} has {freedom} degrees of freedom; lock it, as an actuated joint has one")
    _require_mass(body)


def require_at_most(source: str, count: int, what: str, most: int) -> None:
    """Raise GainroomError if a file holds more than `most` of `what`."""
    if count > most:
        raise GainroomError(f"{source}: has {count} {what} and must have at most {most}")


def floats(model: Any) -> bool:
    """True if the first joint of a Pinocchio model is a floating base."""
    return model.njoints > 1 and model.joints[1].nv == 6


def _not_actuated(
    description: Description,
    names: Sequence[str],
    locked: Sequence[str],
    selected: Sequence[str] | None,
    passive: Sequence[str],
    motors: frozenset[str],
    locked_key: str,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Held joints and passive joints, in the model's order; `motors`: joints known to have a motor."""
    source = description.source
    everything = set(range(len(names)))
    chosen = everything if selected is None else set().union(*select_all(selected, names, f"{source}: selected"))
    fixed = set().union(*select_all(locked, names, locked_key, lambda pattern: f"{locked_key}[{list(locked).index(pattern)}]"))
    key = locked_key.replace("locked", "passive")
    named = set().union(*select_all(passive, names, key, lambda pattern: f"{key}[{list(passive).index(pattern)}]"))
    looped = _looped(description) - motors if description.actuated is not None else set()
    free = {names[index] for index in chosen | named} - {names[index] for index in fixed} - {*description.held}
    following = {index for index, name in enumerate(names) if name in _following(description, free)} - fixed
    held = {index for index, name in enumerate(names) if name in description.held} - following
    geared = {index for index in following if names[index] in motors}
    idle = ({index for index, name in enumerate(names) if name in looped} | following - geared | named) - held - fixed
    still = (everything - chosen | fixed | held) - idle - geared
    return tuple(names[index] for index in sorted(still)), tuple(names[index] for index in sorted(idle))


def _named(patterns: Sequence[str], names: Sequence[str], key: str) -> list[set[str]]:
    """Joint names that match each pattern."""
    return [{names[index] for index in found} for found in select_all(patterns, names, key)]


def _leaders(description: Description) -> dict[str, FollowingJoint]:
    """Following joints of a description, by the follower's name."""
    return {one.follower: one for one in description.linkages if isinstance(one, FollowingJoint)}


def _following(description: Description, free: set[str]) -> set[str]:
    """Joints with mass that follow one of `free`, directly or through a chain; a massless follower may as well be held."""
    found: set[str] = set()
    leaders = _leaders(description)
    for _ in leaders:  # the longest chain
        found = {name for name, one in leaders.items() if one.leader in free | found}
    return {name for name in found if _moves_mass(description.model, name)}


def _moves_mass(model: Any, name: str) -> bool:
    index = model.getJointId(name)
    inertias = [model.inertias[each] for each in model.subtrees[index]] if index < model.njoints else []
    return any(one.mass > 0 or one.inertia.any() for one in inertias) or bool(inertias and _rotors(model)[model.joints[index].idx_v])


def _looped(description: Description) -> set[str]:
    """Names of the joints in closed loops."""
    model = description.model
    return set().union(*(_on_loop(one, model) for one in description.linkages if isinstance(one, JoinedFrames)))


def _geared(description: Description, held: Sequence[str], motors: frozenset[str]) -> set[str]:
    """Following joints with `motors`, and their leaders: either motor moves both."""
    pairs = [one for one in _leaders(description).values() if one.follower in motors and one.follower not in held]
    return {name for one in pairs for name in (one.follower, one.leader)}


def _on_loop(loop: JoinedFrames, model: Any) -> set[str]:
    """Names of the joints between the two frames of a closed loop, without a floating base."""
    first, second = ({*model.supports[model.frames[model.getFrameId(name)].parentJoint]} for name in (loop.first, loop.second))
    return {model.names[index] for index in first ^ second if model.joints[index].nv != 6}


def _counts(linkage: Linkage, model: Any, held: Sequence[str]) -> bool:
    """True if a joint can move against the linkage; a held joint follows nothing."""
    if isinstance(linkage, FollowingJoint):
        return linkage.follower not in held
    return not isinstance(linkage, JoinedFrames) or linkage.ties_base or not _on_loop(linkage, model) <= {*held}


def _damping(model: Any, name: str) -> float:
    return float(model.damping[model.joints[model.getJointId(name)].idx_v])


def _positions(description: Description, names: Sequence[str], held: Sequence[str], posture: Mapping[str, float]) -> dict[str, float]:
    """Joint positions of the posture, checked, completed by those of held followers."""
    source, leaders = description.source, _leaders(description)
    for name in posture:
        if name not in names:
            raise GainroomError(f"{source}: no joint {name!r}{nearest(name, names, 'joint')}")
    found = {name: float(require_finite(source, f"position of joint {name!r}", value)) for name, value in posture.items()}

    def place(name: str, rest: int) -> float:
        if name in found or name not in leaders or not rest:  # nothing moves a ring of followers
            return found.get(name, 0.0)
        return float(polyval(place(leaders[name].leader, rest - 1), leaders[name].coefficients))

    return found | {name: place(name, len(leaders)) for name in held if name in leaders}


def _reduce(model: Any, held: Sequence[str], positions: Mapping[str, float], passive: Sequence[str]) -> tuple[Any, Floats]:
    """Pinocchio model with `held` joints rigid and rotors of base and passive joints alone; and all rotor inertias of the full model.

    Rotor inertias are indexed by the full model's velocities.
    """
    pin = library("pinocchio", "Pinocchio")
    q = pin.neutral(model)
    for name in held:
        joint = model.joints[model.getJointId(name)]
        if joint.nv == 1:
            put_position(q, joint, positions.get(name, 0.0))
    rotors = _rotors(model)
    reduced = hold(pin, model, [model.getJointId(name) for name in held], q)
    # Pinocchio adds the armature to the mass matrix; here it is the motors' own degree of freedom.
    armature = np.zeros(reduced.nv)
    for name in (*reduced.names[1 : 1 + floats(reduced)], *passive):
        old, new = (each.joints[each.getJointId(name)] for each in (model, reduced))
        armature[new.idx_v : new.idx_v + new.nv] = rotors[old.idx_v : old.idx_v + old.nv]
    reduced.armature = armature
    reduced.rotorInertia = np.zeros(reduced.nv)
    return reduced, rotors


def _rotors(model: Any) -> Floats:
    """Rotor inertias [kg m²] by velocity index."""
    return np.array(model.armature) + np.array(model.rotorInertia) * np.array(model.rotorGearRatio) ** 2


def hold(pin: Any, model: Any, joints: list[int], q: Floats) -> Any:
    """Pinocchio's buildReducedModel, made to work where a joint has the name of a link."""
    renamed = pin.Model(model)
    mark = LINK
    while any(frame.name.startswith(mark) for frame in model.frames):
        mark += LINK
    for frame in renamed.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME):
            frame.name = f"{mark}{frame.name}"
    reduced = pin.buildReducedModel(renamed, joints, q)
    for frame in reduced.frames:
        frame.name = frame.name.removeprefix(mark)
    return reduced


def _bone(model: Any, index: int, first: int) -> Bone:
    """Joint `index` for a drawing.

    A chain ends at its farthest frame, or at twice the distance of its centre of mass if that is farther.
    """
    parent = model.parents[index]
    name_of_parent = model.names[parent] if parent >= first else None
    if index in list(model.parents):
        return Bone(model.names[index], name_of_parent, None)
    points = [frame.placement.translation for frame in model.frames if frame.parentJoint == index]
    tip = max(points, key=np.linalg.norm, default=np.zeros(3))
    if np.linalg.norm(tip) < np.linalg.norm(model.inertias[index].lever):
        tip = 2 * model.inertias[index].lever
    return Bone(model.names[index], name_of_parent, np.array(tip))


def _notes(
    description: Description, held: Sequence[str], idle: Sequence[str], positions: Mapping[str, float], model: Any
) -> tuple[str, ...]:
    notes = []
    tied = {name: f"{name!r} {why}" for name, why in description.held.items()}
    followers = [text for name, text in tied.items() if name not in held]
    if followers:
        notes.append(f"{FOLLOWERS_NOTE}: {first_of_many(followers)}")
    still = [f"{text}, at {positions.get(name, 0.0):g}" for name, text in tied.items() if name in held]
    if still:
        notes.append(f"{HELD_NOTE}: {first_of_many(still)}")
    loops = [one.name for one in description.linkages if isinstance(one, JoinedFrames) and _counts(one, model, held)]
    if loops:
        motors = "" if description.actuated is not None or idle else "; a motor is on each of their joints that is not listed as passive"
        notes.append(f"{LOOPS_NOTE}: {first_of_many(loops)}{motors}")
    passive = [name for name in idle if name not in description.held]
    if passive:
        notes.append(f"{PASSIVE_NOTE}: {first_of_many(passive)}")
    unmoved = (*model.names[1 : 1 + floats(model)], *idle)  # by motors
    rubbed = [name for name in unmoved if _damping(model, name) > 0 and not description.springs.get(name)]
    if rubbed:
        notes.append(f"{RUBBED_NOTE}: {first_of_many(rubbed)}")
    own = {name: _damping(model, name) for name in _one_dof(model) if name not in (*held, *idle)}
    damped = [f"{name} {damping:.4g}" for name, damping in own.items() if damping > 0]
    if damped:
        notes.append(f"{DAMPING_NOTE}, give it as link_viscous [N m s/rad]: {first_of_many(damped)}")
    for values, note in ((description.friction, FRICTION_NOTE), (description.springs, SPRING_NOTE)):
        found = [f"{name} {value:.4g}" for name, value in values.items() if value and name not in (*held, *idle)]
        if found:
            notes.append(f"{note}: {first_of_many(found)}")
    return (*impossible_inertias(description.solids), *description.notes, *notes)


def _one_dof(model: Any) -> list[str]:
    """Names of the joints with one degree of freedom."""
    return [model.names[index] for index in range(1, model.njoints) if model.joints[index].nv == 1]


def _require_names(source: str, model: Any) -> None:
    """Raise GainroomError for joint names that Pinocchio would confuse."""
    for name, count in Counter(model.names).items():
        if count > 1:
            what = f"name {RESERVED!r} is taken; rename it" if name == RESERVED else f"{count} joints have this name"
            raise GainroomError(f"{source}: joint {name!r}: {what}")


def _require_sane(source: str, model: Any) -> None:
    """Raise GainroomError for values so large that their products would overflow a double."""
    rotors = _rotors(model)
    for index in range(model.njoints):
        inertia, placement, joint = model.inertias[index], model.jointPlacements[index], model.joints[index]
        if not 0 <= inertia.mass <= LARGEST:
            raise _absurd(source, model, index, f"mass {inertia.mass:g} kg of its links must be >= 0 and <= {LARGEST:g} kg")
        for what, values, most, unit in (
            ("place [m]", placement.translation, FARTHEST, "m"),
            ("orientation", placement.rotation.ravel(), 2.0, ""),
            ("centre of mass of its links [m]", inertia.lever, FARTHEST, "m"),
            ("inertia of its links [kg m²]", inertia.inertia.ravel(), LARGEST, "kg·m²"),
            ("armature [kg m²]", rotors[joint.idx_v : joint.idx_v + joint.nv], LARGEST, "kg·m²"),
        ):
            if len(values) and not np.abs(values).max() <= most:  # NaN is not <= anything
                raise _absurd(source, model, index, f"{what} {np.abs(values).max():g} must be finite and <= {most:g} {unit}".rstrip())
        if np.any(rotors[joint.idx_v : joint.idx_v + joint.nv] < 0):
            raise _absurd(source, model, index, f"armature {rotors[joint.idx_v]:g} kg·m² must be >= 0")
    for frame in model.frames:
        if not np.abs(frame.placement.translation).max() <= FARTHEST:
            raise GainroomError(f"{source}: frame {frame.name!r}: its place must be finite and <= {FARTHEST:g} m in each direction")


def _absurd(source: str, model: Any, index: int, problem: str) -> GainroomError:
    return GainroomError(f"{source}: joint {model.names[index]!r}: {problem}")


def _require_mass(body: RigidBody) -> None:
    """Raises GainroomError, naming joints, if the mass matrix is singular in the neutral and in a generic posture: likely in all."""
    # A wrist of massless links is singular in a few postures only, one of which may be the neutral one.
    generic = np.sin(1.0 + np.arange(body.nv)) * (np.arange(body.nv) >= body.nv - body.size)
    for q in (body.neutral(), body.integrate(body.neutral(), generic)):
        culprits = massless(body.mass_matrix(q))
        if not culprits:
            return
    if body.base == "floating" and body.model.inertias[1].mass < MASSLESS:
        raise GainroomError(
            f"{body.source}: the link of the floating base has no mass (singular mass matrix); give it some, or take model.base: fixed"
        )
    every = (*body.passive, *body.joint_names)
    names = [repr(name) for name in every if body.velocity_of(name) in culprits]
    several = len(names) > 1
    what = f"joint{'s' * several} {first_of_many(names)}" if names else "floating base"
    how = "all of them, or of some that move against each other all but one," if several else "it"
    raise GainroomError(
        f"{body.source}: no mass moves with the {what} (singular mass matrix); give the links inertia, or lock {how} in a robot.yaml "
        "(joints.locked)"
    )


def massless(mass_matrix: Floats) -> list[int]:
    """Degrees of freedom without inertia: those with a zero diagonal, otherwise those that take part in a motion without inertia."""
    diagonal = np.diag(mass_matrix)
    if np.any(diagonal < MASSLESS):
        return np.flatnonzero(diagonal < MASSLESS).tolist()
    scale = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(mass_matrix / scale / scale[:, None])
    share = np.abs(vectors[:, 0])
    return np.flatnonzero(share > PART * share.max()).tolist() if values[0] < SINGULAR else []
