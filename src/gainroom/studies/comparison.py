"""Controllers of one joint compared at equal robustness: what another structure, another sensor, or kd in the drive buys it.

Every structure is tuned under the same ceilings at every corner of the joint's box: sensitivity, delay reserve and torque noise, by default
the noise that the best PD makes. Its winner is proved by the margins of its loop, at every corner and at samples inside. A joint of a robot
is compared with all other joints closed by the gains of the file, in the state where its link is softest, and looked at in all others.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..analysis.dynamic_stiffness import stiffness_of
from ..analysis.margin_record import GainLimit, Margins, worst_of
from ..analysis.margins import margins
from ..analysis.stability import is_stable
from ..design.comparison.best_known import BestKnown, best_known as searched_freely, require_solver
from ..design.comparison.bound import box_bound
from ..design.comparison.catalogue import OF_ROBOTS, USUAL, starts_from, structure_of
from ..design.comparison.ceilings import Ceilings
from ..design.comparison.certificate import Certificate
from ..design.comparison.closed_loop import Corners, curves
from ..design.comparison.compared_joint import ComparedJoint, Spot, joint_index, require_comparable
from ..design.comparison.exact_joint import ExactJoint
from ..design.comparison.joint_responses import quadrature
from ..design.comparison.objective import Objective
from ..design.comparison.opened_loop import opened_loop
from ..design.comparison.robot_controllers import robot_with
from ..design.comparison.structure_search import FINE, Found, Problem, held_harder, searched
from ..design.comparison.structures import Structure
from ..design.comparison.two_rates import largest_root
from ..design.parallel import in_parallel
from ..errors import GainroomError, digits
from ..system.elastic_joint import ElasticJoint
from ..system.gain_path import GainPath
from ..system.linear.arrays import Floats
from ..system.loop import Loop
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import System
from .progress import Progress, quiet
from .study_record import StudyRecord

SHARE = 0.5
"""Delay reserve as a share of the drive's delay, where none is given."""
DRIVE_DELAY, DRIVE_RATE = 1e-4, 20e3
"""Delay [s] and least rate [Hz] of the drive's own loop, where none is given."""
GAP_DIGITS = 4
"""Decimals of a gap: what is less is where a search stops."""
BITS, RATIO = 13, 100.0
"""Encoder that is assumed where none is given: 2¹³ steps per turn of the motor, behind a gear of this ratio where that is not given."""
KNEE = 1.15
"""Factor within which the best structure on the same sensor and host is no reason to leave PD."""
FAR_OFF = 2.0
"""Factor on the worst objective of the box's design above which a design tuned at nominal is fragile, though stable."""
TIGHTENED = 4
"""Searches with a tighter sensitivity where that of the exact loop is above that of the search."""
HELD_BACK = 1e-4
"""Share of a ceiling by which each of them stays below what would do if peaks moved with the ceiling, as they do but for a few percent."""
REACHED = 0.998
"""Share of a ceiling from which on a design is limited by it: a search stays 2e-4 below, and ends within a thousandth of what it seeks."""
ALIKE = 1e-6
"""Relative difference of the stiffness of joints that mirror each other: the first of them is taken."""
SENSITIVITY = 1e-6
"""Relative excess of a peak over its ceiling that counts as round-off."""


@dataclass(frozen=True)
class ComparisonSettings:
    """Settings of a comparison: section `compare` of a joint's file.

    structures   entries as structure_of takes them; (): those whose sensors are known
    objective    what is made small
    sensor_noise standard deviation per sample by sensor: of an encoder step/√12 [rad], of the torque sensor [N m]
    path         the drive's own loop; None: 0.1 ms, 20 kHz
    torque_noise ceiling [N m]; None: that of the limits, else what the best PD makes
    """

    structures: tuple[Any, ...] = ()
    objective: Objective = field(default_factory=Objective)
    sensor_noise: Mapping[str, float] = field(default_factory=dict)
    path: GainPath | None = None
    torque_noise: float | None = None


@dataclass(frozen=True)
class Binding:
    """Ceiling that limits a design.

    ceiling  peak_sensitivity, delay_reserve or torque_noise
    share    of the ceiling that the design takes
    at       place of the box where it takes most, in words
    """

    ceiling: str
    share: float
    at: str


@dataclass(frozen=True)
class Fragile:
    """A structure tuned at the nominal values alone, and what becomes of it on perturbed joints.

    objective   at the nominal values
    unstable, tried   perturbed joints in which it is unstable, of how many
    worst       largest objective over the box's corners; inf where unstable in one
    fragile     True: it is unstable in some, or far off the design for the box
    parameters  by name, SI
    """

    objective: float
    unstable: int
    tried: int
    worst: float
    fragile: bool
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Row:
    """One structure.

    structure     key, such as pd+biquad
    controller    System with the controller found, which joint, simulate and export take; None where none was found. Of a robot's joint it
                  is that of the joint alone, with the law that it would have
    parameters    by name, SI
    objective, worst, worst_at   at the nominal values, the largest over the box's corners, of a robot in all states, and where
    margins, worst_margins       at the nominal values, and of each margin the least over corners and samples
    proved        number of places whose margins were worked out
    delay_reserve [s] the least over the corners: any delay up to it may be added, by the disk of the complementary sensitivity
    noise         largest rms torque command over the corners [N m]; NaN where a sensor's noise is not known
    sensors       that it needs
    where         it runs
    gap           (objective of the second best start)/(that of the best) − 1; NaN where only one kept the ceilings
    fragile       of the same structure tuned at nominal; None where that was not tried
    broken        what breaks the box; "" where the design holds
    limited_by    ceilings that it reaches, the tightest first; () where it reaches none
    robot         System of the robot with the controller in that joint; None of a single joint, and where a robot.yaml cannot hold it
    """

    structure: str
    controller: System | None
    parameters: Mapping[str, float]
    objective: float
    worst: float
    worst_at: str
    margins: Margins | None
    worst_margins: Margins | None
    proved: int
    delay_reserve: float
    noise: float
    sensors: tuple[str, ...]
    where: str
    gap: float
    fragile: Fragile | None
    broken: str = ""
    limited_by: tuple[Binding, ...] = ()
    robot: System | None = None

    @property
    def holds(self) -> bool:
        """True if a design was found that keeps every ceiling in the box."""
        return not self.broken

    def missed(self, required: Requirements) -> list[tuple[Requirement, float, float]]:
        """Requirements that it misses in the box, each with its bound and its worst value: structures are held to other ceilings."""
        worst = self.worst_margins
        values = [] if worst is None else [(one, needed, one.value(worst)) for one, needed in required.asked_for]
        return [(one, needed, value) for one, needed, value in values if not (math.isnan(value) or one.met(needed, value))]


@dataclass(frozen=True)
class Comparison(StudyRecord):
    """Structures compared on one joint.

    rows         in the order asked for
    bound        value of the objective that no linear controller on the host at this rate and delay is below; None: not worked out
    certificate  of the bound, at the place of the box that makes it, `bound_at` in words; None without one
    best_known   best controller of any structure that was found at the place of the bound, for that place alone; None: not asked for
    unbounded    why no bound, or no best controller, was found where one was asked for; "" otherwise
    system       the joint with its box: of a robot alone, as ComparedJoint has it; ceilings and objective that held for every row
    joint        what was compared, and `settings` with which
    """

    rows: tuple[Row, ...]
    bound: float | None
    certificate: Certificate | None
    system: System
    ceilings: Ceilings
    objective: Objective
    unbounded: str = ""
    bound_at: str = ""
    best_known: BestKnown | None = None
    joint: ComparedJoint = field(kw_only=True)
    settings: ComparisonSettings = field(kw_only=True)

    def row(self, structure: str) -> Row:
        """Row of one structure. Raises GainroomError where there is none."""
        for one in self.rows:
            if one.structure == structure:
                return one
        raise GainroomError(f"comparison: {structure!r} must be one of {', '.join(one.structure for one in self.rows)}")

    @property
    def best_beside_pd(self) -> Row | None:
        """Best row on the sensors of pd, on the host; None where there is no other."""
        pd = next((one for one in self.rows if one.structure == "pd"), None)
        others = [one for one in self.rows if pd is not None and one.holds and one is not pd and _alike(one, pd)]
        return min(others, key=lambda one: one.worst, default=None)

    @property
    def leave_pd(self) -> bool:
        """True if no structure on the same sensor and host is better than PD by more than KNEE: leave PD as it is."""
        pd, best = next((one for one in self.rows if one.structure == "pd"), None), self.best_beside_pd
        return pd is not None and pd.holds and best is not None and pd.worst <= KNEE * best.worst


def _alike(one: Row, other: Row) -> bool:
    return one.sensors == other.sensors and one.where == other.where


def compare(
    system: System,
    structures: Sequence[Any] | None = None,
    *,
    joint: str | ComparedJoint | None = None,
    settings: ComparisonSettings | None = None,
    nominal: bool = True,
    bound: bool = True,
    best_known: bool = False,
    progress: Progress = quiet,
) -> Comparison:
    """Structures of a controller of one joint, each tuned under the same ceilings over the joint's box.

    system      with a rate: one joint, whose own gains do not matter, or a robot, whose gains close the loops of all other joints
    joint       name of a robot's joint, or what compared_joint made of it; None: the softest
    structures  keys (pd, pid, pd+biquad, split, torque_feedback, …) or mappings such as {"pd": {"biquads": 1}}; None: those of the settings
    settings    None: the usual ones, with the encoder that is assumed where none is given
    bound       True: also what no linear controller comes below, for the objective dynamic_stiffness
    best_known  True: also the best controller of any structure that a cone programme finds at the place of the bound; needs clarabel
    nominal     True: each structure is also tuned at the nominal values alone, to tell how fragile that is

    Raises GainroomError without a rate, for joints, structures and sensors that are not known, and for a best known controller without a
    bound or without clarabel.
    """
    if best_known:
        require_solver()
    one = joint if isinstance(joint, ComparedJoint) else compared_joint(system, joint)
    boxes = one.alone
    chosen = settings or ComparisonSettings(sensor_noise=assumed_noise(boxes))
    wanted = _wanted(one, chosen, structures)
    path = chosen.path or usual_path(boxes)
    problem = Problem(one, ceilings_of(boxes, chosen), chosen.objective, path)
    bounded = bound and problem.objective == Objective()
    if best_known and not bounded:
        raise GainroomError("the best known controller stands beside the bound: it needs that, and the objective dynamic_stiffness")
    steps = _Steps(progress, 1 + (2 if nominal else 1) * len(wanted) + bounded + best_known)
    plain = structure_of("pd", position_of(boxes)).scaled_to(boxes, path)
    steps.tell("pd, whose noise is the ceiling of the torque noise")
    pd = {box: searched(problem, plain, (), None if box else [Spot()], steps.checkpoint) for box in (True, False)}
    if problem.ceilings.torque_noise is None and plain.position in problem.ceilings.sensor_noise and (made := _noises(problem, pd)):
        problem = replace(problem, ceilings=replace(problem.ceilings, torque_noise=max(made)))
    rows = _rows(problem, [one.scaled_to(boxes, path) for one in wanted], plain, pd, nominal, steps)
    found = Comparison(tuple(rows), None, None, boxes, problem.ceilings, chosen.objective, joint=one, settings=chosen)
    if bounded:
        steps.tell("what no linear controller can beat")
        found = _bounded(found, plain, pd[True], steps)
    if best_known and found.certificate is not None:
        steps.tell("the best known controller")
        found = _with_best_known(found, found.certificate)
    steps.tell("")
    return found


def assumed_step(system: System) -> float:
    """Step [rad] of the encoder that is assumed where none is given, on the joint side."""
    return 2 * math.pi / 2**BITS / system.entered.get("gear_ratio", RATIO)


def assumed_noise(system: System) -> dict[str, float]:
    """Deviation [rad] by sensor of the encoder that is assumed; {} where the drive has a resolution."""
    return {} if system.drives[0].resolution else {position_of(system): assumed_step(system) / math.sqrt(12)}


def compared_joint(system: System, joint: str | None = None) -> ComparedJoint:
    """Joint to compare, in the state where it is softest; `joint` None: of a robot the softest. Raises GainroomError."""
    if isinstance(system.source, ElasticJoint):
        require_comparable(system)
        if joint is not None:
            raise GainroomError(f"joint {joint!r}: names one of a robot's joints, and this is a single joint")
        return ComparedJoint.of(system)
    require_comparable(system, [] if joint is None else [joint_index(system, joint)])
    soft = link_stiffness(system)
    if joint is None:
        turning = np.where(system.source.prismatic, math.inf, soft.min(axis=0))
        index = int(np.argmax(turning <= (1 + ALIKE) * turning.min()))
        require_comparable(system, [index])
    else:
        index = joint_index(system, joint)
    own = soft[:, index]
    if not np.any(np.isfinite(own)):
        raise GainroomError(f"joint {system.source.joint_names[index]!r}: no load moves its link in any state")
    order = np.argsort(np.where(np.isfinite(own), own / own.min() if own.min() > 0 else own, math.inf).round(6), kind="stable")
    return ComparedJoint.of(system, index, [system.source.states[k] for k in order.tolist()])


def link_stiffness(system: System) -> Floats:
    """Dynamic stiffness [N m/rad] of every joint's link (states, n) with the gains of the file; 0 in states where these are unstable."""
    found = []
    for state in system.source.states:
        loop = system.loop(system.source.linearize(*state))
        found.append(stiffness_of(loop, True).stiffness if is_stable(loop) else np.zeros(loop.size))
    return np.array(found)


def _bounded(found: Comparison, plain: Structure, pd: Found | None, steps: "_Steps") -> Comparison:
    """`found` with the largest of the bounds of the box's corners: one controller for all of them is one for each.

    A joint of a robot is held by the best PD, the controller `pd` of the structure `plain`.
    """
    ceilings, sensor, compared = found.ceilings, position_of(found.system), found.joint

    if not compared.is_single and pd is None:
        return replace(found, unbounded="no PD was found that holds the joint at every corner of the box")
    gains = plain.by_field(pd.x) if pd is not None else {}
    held = None if compared.is_single else (gains["kp"], gains["kd"])

    def joint(spot: Spot) -> ExactJoint:
        return ExactJoint.of(compared.opened(spot).parts, compared.index, held)

    spots = compared.softest + ([] if pd is None or pd.at in compared.softest else [pd.at])
    joints = [joint(spot) for spot in spots]
    try:
        best = box_bound(joints, ceilings, sensor, steps.checkpoint)
    except GainroomError as error:
        return replace(found, unbounded=str(error))
    proved = best.certificate.joint.state_space.a
    where = next(spot for spot, one in zip(spots, joints, strict=True) if np.array_equal(one.state_space.a, proved))
    return replace(found, bound=best.value, certificate=best.certificate, bound_at=compared.where(where))


def _with_best_known(found: Comparison, certificate: Certificate) -> Comparison:
    """`found` with the best controller of any structure at the place that the bound's certificate is of."""
    try:
        return replace(found, best_known=searched_freely(certificate.joint, found.ceilings, (certificate.sensor,)))
    except GainroomError as error:
        return replace(found, unbounded=str(error))


class _Steps:
    """Progress of a comparison, step by step."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done, self._what = progress, total, -1, ""

    def tell(self, what: str, steps: int = 1) -> None:
        """Report that the next steps begin."""
        self._done, self._what = min(self._done + steps, self._total), what
        self.checkpoint()

    def checkpoint(self) -> None:
        """Report that the present step goes on."""
        self._progress(max(self._done, 0), self._total, self._what)


def _wanted(joint: ComparedJoint, settings: ComparisonSettings, structures: Sequence[Any] | None) -> list[Structure]:
    """Structures asked for, each once. Raises GainroomError for one whose sensor is not known."""
    system = joint.alone
    entries = tuple(structures if structures is not None else settings.structures)
    position, sensors = position_of(system), {position_of(system), *settings.sensor_noise}
    elastic = math.isfinite(system.source.stiffness)
    found: dict[str, Structure] = {}
    for entry in entries or (USUAL if joint.is_single else OF_ROBOTS):
        one = structure_of(entry, position)
        missing = [sensor for sensor in one.sensors if sensor not in sensors]
        if not entries and (missing or (one.torque and not elastic)):
            continue
        if one.torque and not elastic:
            raise GainroomError(f"structure {one.key}: needs the torque of the gearbox's spring, and joint.stiffness is rigid")
        if missing:
            raise GainroomError(
                f"structure {one.key}: needs compare.sensors.torque_noise, or --torque-sensor: the noise of the joint's torque sensor [N·m]"
            )
        found.setdefault(one.key, one)
    return list(found.values())


def position_of(system: System) -> str:
    """Sensor of the position: that of the file's gains. Raises GainroomError where they measure both sides."""
    feedback = system.control.feedback
    if feedback.both:
        raise GainroomError("control.feedback: a comparison needs motor or link, the side that structures measure the position on")
    return feedback.position


def usual_path(system: System) -> GainPath:
    """The drive's own loop: the least multiple of the host's rate from DRIVE_RATE on."""
    step = system.control.sample_time
    assert step is not None
    return GainPath(DRIVE_DELAY, step / max(1, math.ceil(DRIVE_RATE * step - 1e-9)))


def ceilings_of(system: System, settings: ComparisonSettings) -> Ceilings:
    """Ceilings that every structure is held to; the torque noise None where it is that of the best PD."""
    asked = {name: getattr(system.requirements, name) for name in system.requirements.asked}
    reserve = asked.get("delay_reserve", SHARE * system.delay)
    noise = settings.torque_noise if settings.torque_noise is not None else asked.get("torque_noise")
    sensed, step = dict(settings.sensor_noise), system.drives[0].resolution
    if step > 0:
        sensed.setdefault(position_of(system), step / math.sqrt(12))
    limits = {"peak_sensitivity": asked["peak_sensitivity"]} if "peak_sensitivity" in asked else {}
    return Ceilings(reserve, torque_noise=noise, sensor_noise=sensed, **limits)


def _rows(
    problem: Problem, wanted: list[Structure], plain: Structure, pd: Mapping[bool, Found | None], nominal: bool, steps: _Steps
) -> list[Row]:
    """Rows of the structures, tuned in an order in which each begins at the optima of those that it contains."""
    known = {box: {plain.key: (plain, found)} for box, found in pd.items()}
    rows: dict[str, Row] = {}
    left = list(wanted)
    while left:
        ready = [one for one in left if not any(_contains(one, other) for other in left if other is not one)]
        kinds = [(one, box) for one in ready for box in ((True, False) if nominal else (True,)) if one.key not in known[box]]
        jobs = [
            lambda checkpoint, one=one, box=box: searched(
                problem, one, _starts(one, known[box]), None if box else [Spot()], progress=checkpoint
            )
            for one, box in kinds
        ]
        steps.tell(", ".join(one.key for one in ready), len(kinds))
        for (one, box), found in zip(kinds, in_parallel(jobs, steps.checkpoint), strict=True):
            known[box][one.key] = one, found
        tuned = [(one, known[True][one.key][1], known[False].get(one.key, (one, None))[1]) for one in ready]
        proofs = [
            lambda checkpoint, one=one, found=found, alone=alone: _row(problem, one, found, alone, checkpoint)
            for one, found, alone in tuned
        ]
        rows |= dict(zip((one.key for one in ready), in_parallel(proofs, steps.checkpoint), strict=True))
        left = [one for one in left if one not in ready]
    return [rows[one.key] for one in wanted]


def _contains(structure: Structure, other: Structure) -> bool:
    """True if `structure` can do what `other` does, and more."""
    return len(structure.ranges) > len(other.ranges) and bool(starts_from(structure, other, dict.fromkeys(other.ranges, 1.0)))


def _starts(structure: Structure, known: Mapping[str, tuple[Structure, Found | None]]) -> list[Any]:
    """Coordinates of `structure` at the optima of the structures that it contains."""
    starts: list[Any] = []
    for other, found in known.values():
        if found is not None and _contains(structure, other):
            values = other.by_field(found.x)
            starts += [structure.coordinates(one) for one in starts_from(structure, other, values)]
    return starts


def _noises(problem: Problem, pd: Mapping[bool, Found | None]) -> list[float]:
    """Torque noise of the best PD in the box, and of that tuned at the nominal values, there [N m]."""
    spots = {True: problem.joint.corners, False: [Spot()]}
    return [_noise(problem, found, spots[box]) for box, found in pd.items() if found is not None]


def _noise(problem: Problem, found: Found, spots: Sequence[Spot]) -> float:
    """Largest rms torque command at `spots` [N m]; NaN where the noise of a sensor is not known."""
    if any(sensor not in problem.ceilings.sensor_noise for sensor in found.structure.sensors):
        return math.nan
    ceilings = replace(problem.ceilings, torque_noise=1.0)
    largest = 0.0
    for spot in spots:
        joint = problem.spot(found.structure, spot)
        responses = joint.at(joint.grid(FINE))
        density = curves(found.structure, found.x[None], joint, responses, ceilings).noise
        assert density is not None
        largest = max(largest, math.sqrt(float(density[0] @ quadrature(responses.omega))))
    return largest


def _reserve(problem: Problem, found: Found) -> float:
    """Least delay reserve over the corners [s]; NaN where it is not known, as of kd in a drive without delay.

    In a robot it is the largest τ with Σ|L_p S||1 − e^(−jωτ_p)| ≤ 1 for the one joint, τ_p in the ratio of the reserves.
    """
    if problem.joint.is_single:
        loops = (_loop(problem, found, spot) for spot in problem.joint.corners)
        return float(np.min([REQUIREMENTS["delay_reserve"].measured_once(loop) for loop in loops]))
    least = math.inf
    for spot in problem.joint.corners:
        joint = problem.spot(found.structure, spot)
        omega = joint.grid(FINE)
        responses, low, high = joint.at(omega), 0.0, 64.0
        for _ in range(40):
            middle = (low + high) / 2
            later = replace(joint, reserves={path: middle * one for path, one in joint.reserves.items()})
            kept = curves(found.structure, found.x[None], later, responses, problem.ceilings).delay.max() <= 1
            low, high = (middle, high) if kept else (low, middle)
        least = min(least, low * problem.ceilings.delay_reserve)
    return least


def _row(problem: Problem, structure: Structure, found: Found | None, alone: Found | None, checkpoint: Callable[[], None]) -> Row:
    """Row of a structure from its search in the box and, where there was one, at the nominal values."""
    if found is None:
        nothing = (math.nan, math.nan, "", None, None, 0, math.nan, math.nan)
        broken = "no parameters were found that are stable at every corner of the box"
        return Row(structure.key, None, {}, *nothing, structure.sensors, structure.where, math.nan, None, broken)
    found, proof = _proved(problem, found, checkpoint)
    system = structure.system(found.x, problem.joint.alone, problem.path)
    return Row(
        structure.key,
        system,
        structure.by_field(found.x),
        found.objective,
        found.worst,
        problem.joint.text(found.at),
        proof.nominal,
        proof.worst,
        proof.count,
        _reserve(problem, found),
        _noise(problem, found, problem.joint.corners),
        structure.sensors,
        structure.where,
        round(math.expm1(found.gap), GAP_DIGITS),
        None if alone is None else _fragile(problem, alone, found.worst),
        proof.broken,
        _limited_by(problem, found),
        robot_with(problem.joint, system),
    )


def _limited_by(problem: Problem, found: Found) -> tuple[Binding, ...]:
    """Ceilings that a design reaches somewhere in the box, the tightest first, each where it takes most of it."""
    worst: dict[str, Binding] = {}
    for spot in found.spots:
        joint = problem.spot(found.structure, spot)
        responses = joint.at(joint.grid(FINE))
        one = curves(found.structure, found.x[None], joint, responses, problem.ceilings)
        shares = {"peak_sensitivity": float(one.sensitivity.max()), "delay_reserve": float(one.delay.max())}
        if one.noise is not None:
            shares["torque_noise"] = math.sqrt(float(one.noise[0] @ quadrature(responses.omega)))
        for ceiling, share in shares.items():
            if share >= REACHED and (ceiling not in worst or share > worst[ceiling].share):
                worst[ceiling] = Binding(ceiling, share, problem.joint.where(spot))
    return tuple(sorted(worst.values(), key=lambda one: -one.share))


@dataclass(frozen=True)
class _Proof:
    """Margins of a winner's loops: nominal, and the worst over `count` places; `broken`: what breaks the box."""

    nominal: Margins
    worst: Margins
    count: int
    broken: str


def _proved(problem: Problem, found: Found, checkpoint: Callable[[], None]) -> tuple[Found, _Proof]:
    """`found`, searched on with a tighter sensitivity where margins show more of it than the search did, and its proof."""
    factor = 1.0
    for _ in range(TIGHTENED):
        proof = _proof(problem, found, checkpoint)
        excess = proof.worst.peak_sensitivity / problem.ceilings.peak_sensitivity
        if not found.holds or not proof.broken or not excess > 1:
            return found, proof
        factor *= excess * (1 + HELD_BACK)
        tighter = held_harder(problem, found, factor, checkpoint)
        if tighter is None:
            return found, proof
        found = tighter
    return found, _proof(problem, found, checkpoint)


def _proof(problem: Problem, found: Found, checkpoint: Callable[[], None]) -> _Proof:
    joint, limit = problem.joint, problem.ceilings.peak_sensitivity
    spots = list(dict.fromkeys([*joint.corners, *found.spots]))
    if not found.structure.in_drive:
        spots += [spot for spot in joint.proved if spot not in spots]
    elif not joint.is_single:
        return _seen(problem, found, [*spots, *(spot for spot in joint.proved if spot not in spots)])
    every = []
    for spot in spots:
        checkpoint()
        every.append(margins(_loop(problem, found, spot)))
        if not every[-1].stable:
            return _Proof(every[0], every[-1], len(every), f"unstable at {joint.where(spot)}")
    worst = worst_of(every)
    peaks = [one.peak_sensitivity for one in every]
    if broken := _exceeded(problem, found):
        return _Proof(every[0], worst, len(every), broken)
    highest = int(np.argmax(peaks))
    over = peaks[highest] > limit * (1 + SENSITIVITY)
    broken = f"Ms {peaks[highest]:.4g} at {joint.where(spots[highest])}" if over else ""
    return _Proof(every[0], worst, len(every), broken)


def _exceeded(problem: Problem, found: Found) -> str:
    """What breaks the box in the search's own eyes; "" where nothing does."""
    if found.broken is None:
        return ""
    if math.isinf(found.excess):
        return f"unstable at {problem.joint.where(found.broken)}"
    much = digits(100 * math.expm1(max(found.excess, 0.0)), "%", 3)
    return f"a ceiling is exceeded by {much} at {problem.joint.where(found.broken)}"


def _seen(problem: Problem, found: Found, spots: Sequence[Spot]) -> _Proof:
    """Peak sensitivity of a law of two rates in a robot, as the search sees it, and its stability by the roots of both rates together."""
    alone = found.structure.system(found.x, problem.joint.alone, problem.path)

    def seen(spot: Spot) -> Margins:
        joint = problem.spot(found.structure, spot)
        ratio = curves(found.structure, found.x[None], joint, joint.at(joint.grid(FINE)), problem.ceilings).sensitivity.max()
        return replace(Margins.unknown(GainLimit.unknown(1)), peak_sensitivity=problem.ceilings.peak_sensitivity * float(ratio))

    every = [seen(spot) for spot in spots]
    lost = next((spot for spot in spots if not largest_root(problem.joint.opened(spot), alone) < 1), None)
    broken = _exceeded(problem, found) if lost is None else f"unstable at {problem.joint.where(lost)}"
    return _Proof(every[0], worst_of(every), len(spots), broken)


def _loop(problem: Problem, found: Found, spot: Spot) -> Loop:
    """Loop of a winner at a spot: that of the joint, of a robot with the other joints' loops closed."""
    structure, joint = found.structure, problem.joint
    if joint.is_single:
        return structure.system(found.x, joint.system.at(spot.place), problem.path).loop()
    return opened_loop(joint.opened(spot), structure.system(found.x, joint.alone, problem.path))


def _fragile(problem: Problem, found: Found, worst: float) -> Fragile:
    """Fate on perturbed joints of parameters tuned at the nominal values; `worst`: largest objective of those tuned in the box."""
    changed = problem.joint.perturbed()
    unstable = 0
    for opened in changed:
        corners = Corners(found.structure, [problem.at(found.structure, opened)], problem.ceilings, problem.objective, FINE)
        unstable += int(not corners.all(found.x[None]).stable[0])
    there = problem.corners(found.structure, problem.joint.corners, FINE).all(found.x[None])
    reached = math.exp(float(there.objective[0])) if there.stable[0] else math.inf
    fragile = unstable > 0 or reached > FAR_OFF * worst
    return Fragile(found.objective, unstable, len(changed), reached, fragile, found.structure.by_field(found.x))
