"""Robots reduced to a tree of joints for sweeps and simulation: joints that only follow others are held."""

from collections.abc import Mapping
from dataclasses import replace

from ..system.system import System
from .assemble import FOLLOWERS_NOTE, hold
from .body import RigidBody, library
from .linkage import FollowingJoint
from .robot import Posture, Robot


def on_a_tree(system: System) -> System:
    """System whose robot has its following joints held, with a warning.

    Unchanged if it has none, or other closed loops or passive joints.
    """
    robot = system.source
    if not isinstance(robot, Robot) or not followers(robot.body):
        return system
    postures = {name: Posture(with_followers_held(one.body, one.angles), one.angles) for name, one in robot.postures.items()}
    held = ", ".join(map(repr, followers(robot.body)))
    warning = (
        f"the motion of joints that follow others, which are held here: {held}; those that lead them have less inertia, and other limits"
    )
    others = (text for text in system.warnings if not text.startswith(FOLLOWERS_NOTE))
    return replace(system, source=replace(robot, postures=postures), warnings=(warning, *others))


def followers(body: RigidBody) -> tuple[str, ...]:
    """Passive joints if all of them follow others and nothing else closes a loop; otherwise ()."""
    following = {one.follower for one in body.linkages if isinstance(one, FollowingJoint)}
    return body.passive if len(following) == len(body.linkages) and following == {*body.passive} else ()


def with_followers_held(body: RigidBody, angles: Mapping[str, float]) -> RigidBody:
    """Body as a tree: following joints held at their positions for `angles` [rad; m if prismatic]."""
    pin, q, held = library("pinocchio", "Pinocchio"), body.configuration(angles), followers(body)
    model = hold(pin, body.model, [body.model.getJointId(name) for name in held], q)
    places = {name: body.position(q, name) for name in held}
    return replace(body, model=model, locked={**body.locked, **places}, passive=(), linkages=(), passive_springs={})
