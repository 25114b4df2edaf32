"""gainroom: the largest stable gains of torque-controlled joints with elasticity and delay, exact and certified.

The names below load on first use, so that `gainroom --help` does not wait for numpy.
"""

from importlib import import_module

TYPE_CHECKING = False  # as typing has it, which takes a third of the way to `gainroom --help`, and Ctrl-C is not yet heeded here
if TYPE_CHECKING:
    from typing import Any

    from .analysis.gain_limit import GainLimit, gain_limit
    from .analysis.gain_region import PDRegion, pd_region
    from .analysis.margins import Margins, joint_margins, margins
    from .analysis.stability import Roots, is_stable, rightmost_roots
    from .design.joint_gains import Recommendation, recommend_pd
    from .design.realtime.posture_table import Feature, PostureTable, TableGains
    from .design.realtime.scheduler import GainScheduler, GainTable
    from .design.realtime.tracker import GainTracker, TrackedLimit
    from .errors import GainroomError
    from .files.robot_yaml import load_robot
    from .native import warmup
    from .simulation import Friction, Scenario, Testbed, simulate
    from .studies.analysis import Analysis, State, analyze
    from .studies.joint import JointStudy, study_joint
    from .studies.sweep.store import open_sweep
    from .system.closed_loop import ClosedLoop, closed_loop
    from .system.controller import PD, PID, PPI, Compensator
    from .system.drive import Drive
    from .system.filters import LowPass, Notch
    from .system.gain_path import GainPath
    from .system.loop import Loop, build_loop, loop_from
    from .system.plant import Compliance, ElasticJoint, Plant
    from .system.requirements import Requirements
    from .system.system import Control, JointSpec, System
    from .system.uncertainty import Uncertainty

__version__ = "0.1.0"

# In the order of the data flow: description, loop, verdict and margins, limits, recommendation, time domain.
_HOME = {
    "system.plant": ("ElasticJoint", "Plant", "Compliance"),
    "system.drive": ("Drive",),
    "system.controller": ("PD", "PID", "PPI", "Compensator"),
    "system.filters": ("LowPass", "Notch"),
    "system.gain_path": ("GainPath",),
    "system.loop": ("Loop", "build_loop", "loop_from"),
    "system.closed_loop": ("closed_loop", "ClosedLoop"),
    "analysis.stability": ("is_stable", "rightmost_roots", "Roots"),
    "analysis.margins": ("margins", "Margins", "joint_margins"),
    "analysis.gain_region": ("pd_region", "PDRegion"),
    "analysis.gain_limit": ("gain_limit", "GainLimit"),
    "design.joint_gains": ("recommend_pd", "Recommendation"),
    "system.requirements": ("Requirements",),
    "system.uncertainty": ("Uncertainty",),
    "system.system": ("System", "Control", "JointSpec"),
    "studies.analysis": ("analyze", "Analysis", "State"),
    "studies.joint": ("study_joint", "JointStudy"),
    "files.robot_yaml": ("load_robot",),
    "simulation": ("Scenario", "simulate", "Testbed", "Friction"),
    "design.realtime.tracker": ("GainTracker", "TrackedLimit"),
    "design.realtime.scheduler": ("GainScheduler", "GainTable"),
    "design.realtime.posture_table": ("PostureTable", "Feature", "TableGains"),
    "studies.sweep.store": ("open_sweep",),
    "native": ("warmup",),
    "errors": ("GainroomError",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "PD",
    "PID",
    "PPI",
    "Analysis",
    "ClosedLoop",
    "Compliance",
    "Compensator",
    "Control",
    "Drive",
    "ElasticJoint",
    "Feature",
    "Friction",
    "GainLimit",
    "GainPath",
    "GainTracker",
    "GainScheduler",
    "GainTable",
    "GainroomError",
    "JointSpec",
    "JointStudy",
    "Loop",
    "LowPass",
    "Margins",
    "Notch",
    "PDRegion",
    "Plant",
    "PostureTable",
    "Recommendation",
    "Requirements",
    "Roots",
    "Scenario",
    "State",
    "System",
    "TableGains",
    "Testbed",
    "TrackedLimit",
    "Uncertainty",
    "analyze",
    "build_loop",
    "closed_loop",
    "gain_limit",
    "is_stable",
    "joint_margins",
    "load_robot",
    "loop_from",
    "margins",
    "open_sweep",
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
