"""Objectives that compared structures make small: measures of the compliance |q/d| from load torque to link position."""

import math
from dataclasses import dataclass

import numpy as np

from ...errors import GainroomError, require_positive
from ...system.linear.arrays import Floats

PEAKS = ("dynamic_stiffness", "low_frequency_compliance")
MEANS = ("white_load", "step_load")
OBJECTIVES = (*PEAKS, *MEANS)
"""Names of objectives: peak of |q/d|, over all frequencies or up to `below`; root of the mean square for a white load, or after a step."""
WINDOW = 1.0
"""Time constant [s] with which the step of `step_load` decays, so that the deviation at rest counts for as long."""


@dataclass(frozen=True)
class Objective:
    """Objective of a comparison, smaller is better.

    name    one of OBJECTIVES
    below   highest frequency [rad/s] of low_frequency_compliance

    dynamic_stiffness, low_frequency_compliance   peak of |q/d| [rad/(N m)]
    white_load   (1/π ∫ |q/d|² dω)^½: rms deviation for a load torque of 1 N²m² per Hz, both sides [rad/(N m) √Hz]
    step_load    the same of q/d / (s + 1/WINDOW): rms deviation over a second after a step of 1 N m that decays as slowly [rad/(N m)]
    """

    name: str = "dynamic_stiffness"
    below: float = math.inf

    def __post_init__(self) -> None:
        if self.name not in OBJECTIVES:
            raise GainroomError(f"compare.objective: {self.name!r} must be one of {', '.join(OBJECTIVES)}")
        require_positive("compare", "below", self.below, "rad/s", infinite=True)

    @property
    def is_peak(self) -> bool:
        """True if the objective is a peak over frequency."""
        return self.name in PEAKS

    def value(self, size: Floats, omega: Floats, weights: Floats) -> Floats:
        """Objective (batch,) of compliances |q/d| (batch, m) at omega (m,), with weights (m,) of the quadrature over omega."""
        if self.is_peak:
            return (size if math.isinf(self.below) else size[:, omega <= self.below]).max(axis=1)
        share = weights / math.pi
        if self.name == "step_load":
            share = share / (omega**2 + WINDOW**-2)
        return np.sqrt(size**2 @ share)
