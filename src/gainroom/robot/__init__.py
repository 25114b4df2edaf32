"""The whole robot: links from a file, actuators, contacts, and the linear model about a posture.

Files          formats: URDF, MJCF (links, joints, inertias, the rotors' armature)
Links          body (inertia, frames, gravity at a posture), assemble (from what a file describes to the body that is studied),
               plausible_links (units), name_patterns, mirror_names (images of each other), linkage and held_followers (closed loops,
               joints that follow), skeleton (drawings), rigid_tree (the core)
Actuators      actuators, gearbox_types
Ground         contact (what holds the robot), ground (slip and lift, for simulation)
Linear model   robot (all of the above), linearize, model (about one posture in one contact state), tasks (operational space),
               sway (modes of the base on its contacts)

Pinocchio and MuJoCo come with the extra `robot` and load when a model is first read.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .body import RigidBody as RigidBody
    from .formats.model_files import load_model as load_model

__all__ = ["RigidBody", "load_model"]


def __getattr__(name: str) -> object:
    """Loads the two public names on first use: the guarded child that compiles an MJCF needs neither."""
    if name == "RigidBody":
        from .body import RigidBody

        return RigidBody
    if name == "load_model":
        from .formats.model_files import load_model

        return load_model
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
