"""One joint as a file describes it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .drive import Drive
from .loop import Feedback, Loop, build_loop
from .plant import ElasticJoint
from .plausibility import unusual_joint
from .requirements import Requirements
from .uncertainty import Uncertainty


@dataclass(frozen=True)
class JointSpec:
    """One joint with its drive and controller, what is required of it, and what is not known exactly. SI units.

    typed   values that a file gave in place of those of `joint`, by key: rotor_inertia, gear_ratio
    """

    joint: ElasticJoint
    drive: Drive
    controller: Any
    feedback: Feedback
    sample_time: float | None = None
    requirements: Requirements = field(default_factory=Requirements.usual)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    typed: Mapping[str, float] = field(default_factory=dict)

    def loop(self) -> Loop:
        """The loop of this specification."""
        return build_loop(self.joint, self.drive, self.controller, self.feedback, self.sample_time)

    def unusual(self) -> tuple[str, ...]:
        """What lies far outside what actuators have: most often a slip of units."""
        return unusual_joint(self.joint, self.drive, self.controller, self.sample_time, self.requirements, self.uncertainty, self.typed)
