"""gainroom: the largest stable gains of torque-controlled joints with elasticity and delay, exact and certified.

The names below load on first use, so that `gainroom --help` does not wait for numpy.
"""

from importlib import import_module

TYPE_CHECKING = False  # as typing has it, which takes a third of the way to `gainroom --help`, and Ctrl-C is not yet heeded here
if TYPE_CHECKING:
    from typing import Any

    from .acceleration import warmup
    from .controller import PD, PID, PPI, Compensator, LowPass, Notch
    from .coupled import JointMargins, joint_margins
    from .drive import Drive
    from .errors import GainroomError
    from .forbidden import Requirements
    from .limits import GainLimit, gain_limit
    from .loop import ClosedLoop, Loop, build_loop, closed_loop, loop_from
    from .plant import Compliance, ElasticJoint, Plant
    from .recommend import Recommendation, recommend_pd
    from .region import PDRegion, pd_region
    from .robot_config import load_robot
    from .robustness import Margins, margins
    from .simulation import Friction, Scenario, Testbed, simulate
    from .stability import Roots, is_stable, rightmost_roots
    from .study import JointSpec, JointStudy, study_joint
    from .uncertainty import Uncertainty

__version__ = "0.1.0"

# In the order of the data flow: description, loop, verdict and margins, limits, recommendation, time domain.
_HOME = {
    "plant": ("ElasticJoint", "Plant", "Compliance"),
    "drive": ("Drive",),
    "controller": ("PD", "PID", "PPI", "Compensator", "LowPass", "Notch"),
    "loop": ("Loop", "build_loop", "loop_from", "closed_loop", "ClosedLoop"),
    "stability": ("is_stable", "rightmost_roots", "Roots"),
    "robustness": ("margins", "Margins"),
    "region": ("pd_region", "PDRegion"),
    "limits": ("gain_limit", "GainLimit"),
    "coupled": ("joint_margins", "JointMargins"),
    "recommend": ("recommend_pd", "Recommendation"),
    "forbidden": ("Requirements",),
    "uncertainty": ("Uncertainty",),
    "study": ("study_joint", "JointSpec", "JointStudy"),
    "robot_config": ("load_robot",),
    "simulation": ("Scenario", "simulate", "Testbed", "Friction"),
    "acceleration": ("warmup",),
    "errors": ("GainroomError",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "PD",
    "PID",
    "PPI",
    "ClosedLoop",
    "Compliance",
    "Compensator",
    "Drive",
    "ElasticJoint",
    "Friction",
    "GainLimit",
    "GainroomError",
    "JointMargins",
    "JointSpec",
    "JointStudy",
    "Loop",
    "LowPass",
    "Margins",
    "Notch",
    "PDRegion",
    "Plant",
    "Recommendation",
    "Requirements",
    "Roots",
    "Scenario",
    "Testbed",
    "Uncertainty",
    "build_loop",
    "closed_loop",
    "gain_limit",
    "is_stable",
    "joint_margins",
    "load_robot",
    "loop_from",
    "margins",
    "pd_region",
    "recommend_pd",
    "rightmost_roots",
    "simulate",
    "study_joint",
    "warmup",
]


def __getattr__(name: str) -> "Any":
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'gainroom' has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
