"""Compared controllers pushed in simulation: with dry friction and encoder steps, on joints that are not as they were described.

A simulation proves nothing: friction of 1 N m holds a linearly unstable observer quiet. It shows what margins are about.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from ..errors import GainroomError
from ..simulation.friction import Friction
from ..simulation.run import simulate
from ..simulation.scenario import Scenario
from ..simulation.testbed import Testbed
from ..simulation.trajectories import Step
from ..system.system import System

PUSH, PUSHED_AT, DURATION = 30.0, 0.1, 1.1
"""Load torque on the link [N m], when it comes [s], and the run's length [s]."""
RESTS = 0.3
"""Last part of the run [s], in which a joint that does not vibrate is at rest."""
QUIET = 10.0
"""Steps of the encoder: the standard deviation of the motor's position, without its slow motion, up to which a joint does not vibrate. Dry
friction and steps leave one or two at most."""
SLOW = 5
"""Degree of the polynomial in time that slow motion is taken for: below 5 Hz or so in RESTS, where loops with integral action creep."""
CASES: dict[str, tuple[float, float, float]] = {
    "nominal": (1.0, 1.0, 0.0),
    "K − 20 %": (0.8, 1.0, 0.0),
    "K + 20 %": (1.2, 1.0, 0.0),
    "load × 0.5": (1.0, 0.5, 0.0),
    "load × 1.5": (1.0, 1.5, 0.0),
    "+ 0.5 ms": (1.0, 1.0, 5e-4),
}
"""Factors on stiffness and load, and further delay [s], by name."""


@dataclass(frozen=True)
class Pushed:
    """One run of a controller under a push.

    case      of CASES
    peak      largest motion of the link [rad]
    ripple    standard deviation of the motor's position at the end, without its slow motion [rad]; inf where the run diverged
    vibrates  True: the ripple is more than QUIET steps of the encoder
    """

    case: str
    peak: float
    ripple: float
    vibrates: bool


def pushed(system: System, friction: float, cases: Sequence[str] = tuple(CASES)) -> list[Pushed]:
    """Runs of a joint's controller under a push of PUSH, one for each of `cases`.

    friction   Coulomb friction of the motor [N m]

    Raises GainroomError for several joints, for an encoder without steps, and for a loop without a rate.
    """
    if len(system.drives) != 1:
        raise GainroomError(f"pushed runs are of one joint, not of {len(system.drives)}")
    if system.drives[0].resolution <= 0:
        raise GainroomError("pushed runs need drive.encoder_resolution: what is not more than some of its steps is no vibration")
    return [_run(system, case, friction) for case in cases]


def _run(system: System, case: str, friction: float) -> Pushed:
    stiffness, load, later = CASES[case]
    joint = system.source
    changed = system.with_values(stiffness=stiffness * joint.stiffness, link_inertia=load * joint.link_inertia, delay=system.delay + later)
    step = system.drives[0].resolution
    bed = Testbed(changed.loop(), Friction(friction), motor_resolution=step)
    run = simulate(bed, Scenario(0.0, DURATION, link_torque=Step(PUSH, PUSHED_AT)))
    peak = float(np.abs(run.link_position).max())
    last = run.time > DURATION - RESTS
    if run.diverged:
        return Pushed(case, peak, math.inf, True)
    moved = run.motor_position[last, 0]
    ripple = float((moved - Polynomial.fit(run.time[last], moved, SLOW)(run.time[last])).std())
    return Pushed(case, peak, ripple, not ripple <= QUIET * step)
