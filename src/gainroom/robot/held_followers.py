"""Robots for what is carried on a tree of joints alone, as sweeps and simulations: joints that only follow others are held."""

from collections.abc import Mapping
from dataclasses import replace

from ..system.system import System
from .assemble import FOLLOWERS_NOTE, hold
from .body import RigidBody, library
from .linkage import FollowingJoint
from .robot import Posture, Robot


def on_a_tree(system: System) -> System:
    """The same system with a robot whose followers are held, and a warning that says so; the same where it has none, or more than them."""
    robot = system.source
    if not isinstance(robot, Robot) or not followers(robot.body):
        return system
    postures = {name: Posture(with_followers_held(one.body, one.angles), one.angles) for name, one in robot.postures.items()}
    held = ", ".join(map(repr, followers(robot.body)))
    warning = (
        f"the motion of joints that follow others, which are held here: {held}; those that lead them have less inertia, and other limits"
    )
    kept = (text for text in system.warnings if not text.startswith(FOLLOWERS_NOTE))
    return replace(system, source=replace(robot, postures=postures), warnings=(warning, *kept))


def followers(body: RigidBody) -> tuple[str, ...]:
    """The passive joints, where all of them follow others and nothing else keeps the joints from being a tree; else none."""
    following = {one.follower for one in body.linkages if isinstance(one, FollowingJoint)}
    return body.passive if len(following) == len(body.linkages) and following == {*body.passive} else ()


def with_followers_held(body: RigidBody, angles: Mapping[str, float]) -> RigidBody:
    """The same body as a tree: its followers held where they stand at `angles` [rad; m if prismatic]."""
    pin, q, held = library("pinocchio", "Pinocchio"), body.configuration(angles), followers(body)
    model = hold(pin, body.model, [body.model.getJointId(name) for name in held], q)
    places = {name: body.position(q, name) for name in held}
    return replace(body, model=model, locked={**body.locked, **places}, passive=(), linkages=(), passive_springs={})
