"""Controllers of several joints of a robot compared together, all their loops closed at once: those of a supporting leg, say.

Every structure is tuned in one state of the robot under the same ceilings of all joints together, σ_max(S) and the delay disk, and its peak
of σ_max(q/d) made least, at the corners of the file's uncertainty, and at the nominal values alone where it has none. Stability is that of
the roots of all rates together, and the peaks of laws at one rate are proved. All other joints are closed by the gains of the file.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..design.comparison.catalogue import structure_of
from ..design.comparison.ceilings import Ceilings
from ..design.comparison.compared_joint import ComparedJoint, Spot, require_comparable
from ..design.comparison.coupled_joints import COMPLIANCE, SENSITIVITY, CoupledJoints
from ..design.comparison.coupled_search import DENSE, Peak, Together, peaks_of, searched_together
from ..design.comparison.objective import Objective
from ..design.comparison.structure_search import COARSE, Problem
from ..design.comparison.structures import Structure
from ..design.parallel import in_parallel
from ..errors import GainroomError, listed
from ..system.gain_path import GainPath
from ..system.linear.arrays import Floats
from ..system.system import System
from .comparison import ComparisonSettings, assumed_noise, ceilings_of, link_stiffness, position_of, usual_path
from .progress import Progress, quiet

TOGETHER = ("pd", "pd+biquad", "split")
"""Structures that are compared where none are named; a pid, and more biquads, can be."""


@dataclass(frozen=True)
class Elsewhere:
    """A design at a spot that it was not tuned at.

    at           in words
    stable       by the roots of all rates together
    sensitivity  σ_max(S); inf where unstable
    compliance   σ_max(q/d) [rad/(N m)]; inf where unstable
    """

    at: str
    stable: bool
    sensitivity: float
    compliance: float


@dataclass(frozen=True)
class CoupledRow:
    """One structure in every joint.

    structure  key
    found      parameters and peaks; None where none were found that are stable
    box, states  the design at the corners of the box that it was not tuned at, and in the robot's other states
    """

    structure: Structure
    found: Together | None
    box: tuple[Elsewhere, ...] = ()
    states: tuple[Elsewhere, ...] = ()

    @property
    def holds(self) -> bool:
        """True if a design was found that keeps both ceilings where it was tuned."""
        return self.found is not None and self.found.holds

    @property
    def compliance(self) -> float:
        """Peak of σ_max(q/d) [rad/(N m)]; inf without a design."""
        return math.inf if self.found is None else self.found.peaks[COMPLIANCE].value

    @property
    def systems(self) -> list[System]:
        """Every joint by itself with its controller; [] without a design."""
        return [] if self.found is None else self.found.coupled.systems(self.found.x)


@dataclass(frozen=True)
class CoupledComparison:
    """Structures compared on several joints together.

    joint     the joints, in the state in which structures are tuned, the first of its states
    ceilings  of all joints together
    tuned     spots at which structures are tuned: nominal, with the corners of the file's uncertainty
    path      of a kd in the drive
    """

    rows: tuple[CoupledRow, ...]
    joint: ComparedJoint
    ceilings: Ceilings
    tuned: tuple[Spot, ...]
    path: GainPath

    @property
    def names(self) -> list[str]:
        """Names of the joints."""
        return [self.joint.system.source.joint_names[k] for k in self.joint.joints]

    @property
    def pd(self) -> CoupledRow | None:
        """Row of PD, where it was asked for and holds."""
        return next((row for row in self.rows if row.structure.key == "pd" and row.holds), None)


def compared_joints(system: System, joints: Sequence[int], state: tuple[str, str] | None = None) -> ComparedJoint:
    """Joints to compare together, in `state`, None: that in which one of their links is softest. Raises GainroomError."""
    require_comparable(system, joints)
    states = list(system.source.states)
    if state is not None and state not in states:
        known = listed(["/".join(one) for one in states], "or", 12)
        raise GainroomError(f"--state {'/'.join(state)}: must be {known}")
    chosen = states[int(np.argmin(link_stiffness(system)[:, list(joints)].min(axis=1)))] if state is None else state
    one = ComparedJoint.of(system, joints[0], [chosen, *(other for other in states if other != chosen)], joints[1:])
    for own in one.apart:
        if not math.isfinite(own.alone.source.link_inertia):
            raise GainroomError(f"joint {own.name!r}: no load moves its link in {'/'.join(chosen)}")
    return one


def compare_together(
    joint: ComparedJoint, structures: Sequence[Any] | None = None, *, ranged: bool = False, progress: Progress = quiet
) -> CoupledComparison:
    """Structures of the controllers of several joints, each tuned under the same ceilings of all together.

    joint       as compared_joints makes it
    structures  keys; None: TOGETHER
    ranged      True: they are tuned at every corner of the joint's box; False: at the nominal values alone, and looked at in the box

    Raises GainroomError for structures that several joints cannot have.
    """
    slowest = max((one.alone for one in joint.apart), key=lambda alone: alone.delay)
    position = position_of(slowest)
    wanted = {one.key: one for one in (_structure(entry, position) for entry in structures or TOGETHER)}
    ceilings = ceilings_of(slowest, ComparisonSettings(sensor_noise=assumed_noise(slowest)))
    problem = Problem(joint, ceilings, Objective(), usual_path(slowest))
    tuned = joint.softest if ranged else [Spot()]
    plain = structure_of("pd", position)
    total, done = 1 + sum(key != plain.key for key in wanted), 0

    def told() -> None:
        progress(done, total, ", ".join(key for key in wanted if key != plain.key) if done else plain.key)

    pd = searched_together(problem, plain, None, tuned, told)
    done = 1
    if ceilings.torque_noise is None and pd is not None:  # that of the best PD, for all
        problem = replace(problem, ceilings=replace(ceilings, torque_noise=pd.noise))
        pd = replace(pd, coupled=CoupledJoints(problem, plain, tuned, DENSE), noise=1.0)
    others = [one for one in wanted.values() if one.key != plain.key]
    jobs = [lambda checkpoint, one=one: _row(problem, one, searched_together(problem, one, pd, tuned, checkpoint), tuned) for one in others]
    rows = {row.structure.key: row for row in in_parallel(jobs, told)}
    if plain.key in wanted:
        rows[plain.key] = _row(problem, plain, pd, tuned)
    return CoupledComparison(tuple(rows[key] for key in wanted), joint, problem.ceilings, tuple(tuned), problem.path)


def _structure(entry: Any, position: str) -> Structure:
    """Structure of an entry. Raises GainroomError for one that is not of gains and biquads on the position."""
    one = structure_of(entry, position)
    if type(one) is not Structure or one.torque:
        raise GainroomError(f"structure {one.key}: of several joints together it must be pd, pid, pd+biquad, pd+2biquads or split")
    return one


def _row(problem: Problem, structure: Structure, found: Together | None, tuned: Sequence[Spot]) -> CoupledRow:
    if found is None:
        return CoupledRow(structure, None)
    box = [spot for spot in problem.joint.softest if spot not in tuned]
    states = [Spot(state=k) for k in range(1, len(problem.joint.states))]
    return CoupledRow(
        structure, found, *(tuple(_elsewhere(problem, structure, found.x, spot) for spot in spots) for spots in (box, states))
    )


def _elsewhere(problem: Problem, structure: Structure, x: Floats, spot: Spot) -> Elsewhere:
    there = CoupledJoints(problem, structure, [spot], COARSE)
    if not there.root(x) < 1:
        return Elsewhere(problem.joint.where(spot), False, math.inf, math.inf)
    found: dict[int, Peak] = peaks_of(there, x, [spot], (SENSITIVITY, COMPLIANCE))
    limit = problem.ceilings.peak_sensitivity
    return Elsewhere(problem.joint.where(spot), True, limit * found[SENSITIVITY].value, found[COMPLIANCE].value)
