"""gainroom: the largest stable gains of torque-controlled joints with elasticity and delay, exact and certified.

The names below load on first use, so that `gainroom --help` does not wait for numpy.
"""

from importlib import import_module

TYPE_CHECKING = False  # as typing has it, which takes a third of the way to `gainroom --help`, and Ctrl-C is not yet heeded here
if TYPE_CHECKING:
    from typing import Any

    from .analysis.dynamic_stiffness import DynamicStiffness as DynamicStiffness
    from .analysis.gain_limit import gain_limit as gain_limit
    from .analysis.gain_region import PDRegion as PDRegion, pd_region as pd_region
    from .analysis.links import dynamic_stiffness as dynamic_stiffness
    from .analysis.margin_record import GainLimit as GainLimit, Margins as Margins
    from .analysis.margins import joint_margins as joint_margins, margins as margins
    from .analysis.stability import Roots as Roots, is_stable as is_stable, rightmost_roots as rightmost_roots
    from .design.joint_gains import Recommendation as Recommendation, recommend_pd as recommend_pd
    from .design.realtime.posture_table import Feature as Feature, PostureTable as PostureTable, TableGains as TableGains
    from .design.realtime.scheduler import GainScheduler as GainScheduler, GainTable as GainTable
    from .design.realtime.tracker import GainTracker as GainTracker, TrackedLimit as TrackedLimit, TrackedMotion as TrackedMotion
    from .errors import GainroomError as GainroomError
    from .files.audit_call import audit as audit
    from .files.robot_yaml import load_robot as load_robot
    from .native import warmup as warmup
    from .robot.robot import Robot as Robot
    from .simulation import Friction as Friction, Scenario as Scenario, Testbed as Testbed, simulate as simulate
    from .studies.analysis import Analysis as Analysis, State as State, analyze as analyze
    from .studies.audit import Audit as Audit
    from .studies.comparison import Comparison as Comparison, ComparisonSettings as ComparisonSettings, compare as compare
    from .studies.joint import JointStudy as JointStudy, study_joint as study_joint
    from .studies.robot import RobotStudy as RobotStudy, study_robot as study_robot
    from .studies.sweep.store import open_sweep as open_sweep
    from .system.closed_loop import ClosedLoop as ClosedLoop, closed_loop as closed_loop
    from .system.controller import (
        PD as PD,
        PID as PID,
        PPI as PPI,
        Compensator as Compensator,
        DisturbanceObserver as DisturbanceObserver,
        TorqueFeedback as TorqueFeedback,
    )
    from .system.drive import Drive as Drive
    from .system.elastic_joint import ElasticJoint as ElasticJoint
    from .system.filters import Biquad as Biquad, LowPass as LowPass, Notch as Notch
    from .system.gain_bounds import GainBounds as GainBounds
    from .system.gain_path import GainPath as GainPath
    from .system.jitter_margin import JitterMargin as JitterMargin, jitter_margin as jitter_margin
    from .system.loop import Loop as Loop, build_loop as build_loop, loop_from as loop_from
    from .system.plant import Compliance as Compliance, Plant as Plant
    from .system.requirements import Requirements as Requirements
    from .system.system import Control as Control, JointSpec as JointSpec, System as System
    from .system.uncertainty import Uncertainty as Uncertainty

__version__ = "0.1.0"

# In the order of the data flow: description, loop, verdict and margins, limits, recommendation, time domain.
_HOME = {
    "system.elastic_joint": ("ElasticJoint",),
    "system.plant": ("Plant", "Compliance"),
    "system.drive": ("Drive",),
    "system.controller": ("PD", "PID", "PPI", "TorqueFeedback", "DisturbanceObserver", "Compensator"),
    "system.filters": ("Biquad", "LowPass", "Notch"),
    "system.gain_path": ("GainPath",),
    "system.loop": ("Loop", "build_loop", "loop_from"),
    "system.closed_loop": ("closed_loop", "ClosedLoop"),
    "analysis.stability": ("is_stable", "rightmost_roots", "Roots"),
    "analysis.margins": ("margins", "joint_margins"),
    "system.jitter_margin": ("jitter_margin", "JitterMargin"),
    "analysis.gain_region": ("pd_region", "PDRegion"),
    "analysis.gain_limit": ("gain_limit",),
    "analysis.dynamic_stiffness": ("DynamicStiffness",),
    "analysis.links": ("dynamic_stiffness",),
    "analysis.margin_record": ("Margins", "GainLimit"),
    "design.joint_gains": ("recommend_pd", "Recommendation"),
    "system.requirements": ("Requirements",),
    "system.gain_bounds": ("GainBounds",),
    "system.uncertainty": ("Uncertainty",),
    "system.system": ("System", "Control", "JointSpec"),
    "studies.analysis": ("analyze", "Analysis", "State"),
    "studies.joint": ("study_joint", "JointStudy"),
    "studies.comparison": ("compare", "Comparison", "ComparisonSettings"),
    "robot.robot": ("Robot",),
    "files.robot_yaml": ("load_robot",),
    "files.audit_call": ("audit",),
    "studies.audit": ("Audit",),
    "studies.robot": ("study_robot", "RobotStudy"),
    "simulation": ("Scenario", "simulate", "Testbed", "Friction"),
    "design.realtime.tracker": ("GainTracker", "TrackedLimit", "TrackedMotion"),
    "design.realtime.scheduler": ("GainScheduler", "GainTable"),
    "design.realtime.posture_table": ("PostureTable", "Feature", "TableGains"),
    "studies.sweep.store": ("open_sweep",),
    "native": ("warmup",),
    "errors": ("GainroomError",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [*_MODULE_OF]  # pyright: ignore[reportUnsupportedDunderAll] - it goes by what is imported under its own name


def __getattr__(name: str) -> "Any":
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'gainroom' has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
