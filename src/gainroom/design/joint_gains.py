"""The PD gains that keep the required margins for every joint within the uncertainty, and make its link dynamically stiffest.

The allowed kd on each line kp = const are exact for one joint (gain_region.py). For an uncertain joint they are intersected over a few
*active* cases, with a little in reserve; the best of what is allowed is searched in link_gains.py, or the largest kp is taken, as the
objective says. The answer is then screened on a population (every corner of the uncertainty, its centre, a
low-discrepancy filling, a local search from the worst) and last of all proved for the whole of it (range_proof.py). A case that either
finds to break a requirement becomes active, as does one in which the link is softer, and the search starts over. Where the proof comes to
no end, the certificate says so.
"""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..analysis.crossings import scan
from ..analysis.gain_region import PDRegion, pd_region
from ..analysis.margin_record import Margins, worst_of
from ..analysis.margins import margins, margins_from_scan
from ..analysis.range_proof import Proof, prove
from ..errors import GainroomError
from ..system.controller import PD
from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.excluded_sets import ROUND_OFF
from ..system.feedback import GivenFeedback, feedback_of
from ..system.gain_bounds import BOUNDS, GainBounds
from ..system.linear.arrays import Floats
from ..system.loop import Loop, build_loop
from ..system.requirements import REQUIREMENTS, Requirements, title_of
from ..system.system import Objective
from ..system.uncertainty import NOMINAL, Case, Place, Uncertainty
from .link_gains import LinkCase, Stiffest, stiffest_link

COST_ACCURACY = 0.01
FILLING = 16  # cases inside the uncertainty, in addition to corners and centre
RESERVE = 0.002  # share of each requirement kept in reserve at the active cases, so that a proof can come to an end
UNPROVED_RESERVE = 0.02  # reserve after a proof that came to no end: it costs a few percent
OFF = 1.5  # reserve added, times the shortfall, where the gains found miss a requirement in a case that was searched over
SOFTER = 3e-3  # share by which a link must be softer in a case, with the gains found, for the case to become active
BINDING = 0.01  # shortfall above which a requirement counts as reached: where none is, the link limits the gains
QUICK_BOXES, MOST_BOXES = 200_000, 500_000  # most boxes of a proof with the first and second reserve: about 1 s and 3 s
SAME = 3e-3  # share of the dynamic stiffness that gains in few digits may lose
NEARLY = 0.01  # share of a bound within which gains found are put on it: gains that its user typed are as short as any
ALIKE = 1e-3  # share of a requirement by which shortfalls may differ and count as equal: the first case stands for all
MOST_ACTIVE = 6  # active cases at a time: what an older one excludes is found again, if it still matters
MOST_ROUNDS = 20  # most cases that break a requirement, one after the other
QUICK_ROUNDS = 10  # from then on kp is lowered in large steps

LINK = "link"
"""What limits gains of which no requirement is reached."""

CaseMargins = tuple[Place, Margins, float]
"""A case, its margins, and by how much the requirement is missed there that is missed most; below 0: all are met."""


@dataclass(frozen=True)
class Recommendation:
    """Recommended gains.

    objective     what was made largest: "dynamic_stiffness" of the link, or "largest_kp"
    kp, kd        [N m/rad], [N m s/rad]; for a P/PI controller kp·kv and kv
    stiffness     dynamic stiffness of the link in the worst of the examined cases [N m/rad]
    controller    with these gains, the given filters and integral ratio
    margins       in the worst of the examined cases; `worst_case` says where that is
    worst         every margin in the examined case where that margin is smallest: they may come from different cases
    nominal       margins at the nominal values
    shortfalls    of each requirement, by its name: by how much it is missed in the worst case; below 0: met
    dropped       searches for `costs`, when they are asked for
    certificate   what has been checked, as text
    proved        the requirements hold for every joint within the uncertainty; False: for those that were examined
    reserve       share of each requirement that the search kept to spare, without which a proof over the uncertainty does not end
    bounds        within which the gains were searched
    """

    objective: Objective
    kp: float
    kd: float
    stiffness: float
    controller: Any
    margins: Margins
    worst: Margins
    nominal: Margins
    worst_case: dict[str, float]
    shortfalls: dict[str, float]
    dropped: Callable[[], dict[str, float]]
    certificate: str
    proved: bool
    reserve: float
    bounds: GainBounds = field(default_factory=GainBounds)

    @property
    def value(self) -> float:
        """What was made largest: dynamic stiffness or kp [N m/rad]."""
        return self.stiffness if self.objective == "dynamic_stiffness" else self.kp

    @cached_property
    def costs(self) -> dict[str, float]:
        """Largest `value` without one requirement or bound, by its name [N m/rad]; what the uncertainty costs: uncertainty_cost.py."""
        return self.dropped()

    @property
    def binding(self) -> str:
        """The requirement or bound without which `value` could go highest; "link" where none is reached; else the tightest."""
        if not self.felt and self.objective == "dynamic_stiffness" and max(self.shortfalls.values()) < -BINDING:
            return LINK
        return max(self.costs, key=lambda name: (self.felt.get(name, self.value), self.shortfalls.get(name, -math.inf)))

    @property
    def felt(self) -> dict[str, float]:
        """The costs that exceed `value` by at least 1 %, the accuracy to which they are known."""
        return {name: value for name, value in self.costs.items() if value >= (1 + COST_ACCURACY) * self.value}

    def held_back_by(self) -> str:
        """The requirement or bound that binds, by its title, the link, or all of them where dropping any one alone gains nothing."""
        own = np.array([[self.kp], [self.kd], [0.0]])
        asked = [title_of(name) for name in self.costs if name not in BOUNDS or self.bounds.on(name, own)[0]]
        if self.binding == LINK:
            return "link itself: stiffer gains damp it less"
        if self.binding in self.felt or len(asked) == 1:
            return title_of(self.binding)
        return f"{', '.join(asked[:-1])} and {asked[-1]} together"


def recommend_pd(
    joint: ElasticJoint,
    drive: Drive,
    requirements: Requirements | None = None,
    uncertainty: Uncertainty | None = None,
    feedback: GivenFeedback = "motor",
    sample_time: float | None = None,
    controller: Any = None,
    objective: Objective = "dynamic_stiffness",
    bounds: GainBounds | None = None,
) -> Recommendation | None:
    """The best PD gains that keep `requirements` in every case.

    requirements  None: 6 dB, 30°, Ms 2
    controller    a PD, PID or PPI whose filters and integral ratio are kept; None: plain PD
    objective     "dynamic_stiffness": the largest of the link (dynamic_stiffness.py) in the case in which it is least, and of equal ones
                  the least kd. "largest_kp": the largest kp, and the kd with the lowest peak sensitivity
    bounds        of kp and kd, on the controller's kp–kd plane; None: none

    Returns None where no gains keep them, and where nothing limits kp. Raises GainroomError where nothing is required.
    """
    requirements = Requirements.usual() if requirements is None else requirements
    if not requirements.asked:
        raise GainroomError(f"recommend: at least one of {', '.join(REQUIREMENTS)} must be required")
    template, bounds = controller or PD(1.0, 1.0), bounds or GainBounds()
    if any(np.ndim(getattr(bounds, name)) for name in BOUNDS):
        raise GainroomError("recommend: bounds of one joint must be numbers")
    return _JointSearch(joint, drive, requirements, uncertainty or Uncertainty(), feedback, sample_time, template, objective, bounds).run()


class _JointSearch:
    """The search of `recommend_pd`: cases by their place in the uncertainty, regions of the active ones."""

    def __init__(
        self,
        joint: ElasticJoint,
        drive: Drive,
        requirements: Requirements,
        uncertainty: Uncertainty,
        feedback: GivenFeedback,
        sample_time: float | None,
        template: Any,
        objective: Objective,
        bounds: GainBounds,
    ) -> None:
        self.objective: Objective = objective
        self.bounds = bounds
        self.joint, self.drive, self.requirements, self.uncertainty = joint, drive, requirements, uncertainty
        self.feedback = feedback_of(feedback, template)
        self.sample_time, self.template = sample_time, template
        self.reserve = RESERVE if self.uncertainty.names else 0.0
        self.proof: Proof | None = None
        self.plants: dict[Place, Loop] = {}
        self.seen: list[Margins] = []
        self.checked: set[Place] = set()
        self.cases = [self.likely_worst()]
        self.active = [self.region(self.case(self.cases[0]))]
        self.links: dict[Place, LinkCase] = {}
        self.soft = [self.cases[0]]

    def case(self, place: Place) -> Case:
        return self.uncertainty.case(self.joint, self.drive, place) if place else (self.joint, self.drive)

    def region(self, case: Case) -> PDRegion:
        aimed = self.requirements.tightened(self.reserve)
        return pd_region(*case, feedback=self.feedback, sample_time=self.sample_time, controller=self.template, **aimed.needed)

    def likely_worst(self) -> Place:
        """A corner to start from: the one that moderate gains, for the delay there is, bring nearest to a requirement."""
        if not self.uncertainty.names:
            return NOMINAL
        lag = max(self.case(place)[1].delay for place in self.uncertainty.corners) + 2 / self.drive.bandwidth + (self.sample_time or 0.0)
        crossover = 0.2 / lag if lag else 2 * math.pi
        inertia = self.joint.motor_inertia + min(self.joint.link_inertia, self.joint.motor_inertia)
        return self.least(self.uncertainty.corners, inertia * crossover**2, 2 * inertia * crossover)[0]

    def run(self) -> Recommendation | None:
        high = float(self.active[0].ladder[-1])
        for count in range(MOST_ROUNDS):
            found = self.best(high)
            if found is None:
                return None
            kp, kd = found
            place, worst, missed = self.worst_at(kp, kd)
            if missed <= -self.reserve / 2 and self.softer_case(kp, kd):
                continue
            if missed <= -self.reserve / 2:
                place, worst, missed = self.proved(kp, kd, (place, worst, missed))
                if self.proof is None or self.proof.holds:
                    break
                if not self.proof.broken:
                    if self.reserve == UNPROVED_RESERVE or not self.proof.boxes:  # no box: what is required cannot be proved at all
                        break
                    self.reserve = UNPROVED_RESERVE
                    self.active = [self.region(self.case(one)) for one in self.cases]
                    continue
            if place in self.cases and self.objective != "largest_kp":  # whose region is off by this: other gains are as good
                self.reserve += OFF * max(missed, SAME)
                self.active = [self.region(self.case(one)) for one in self.cases]
                continue
            self.cases = [*self.cases, place][-MOST_ACTIVE:]
            self.active = [*self.active, self.region(self.case(place))][-MOST_ACTIVE:]
            high = (1.002 if count < QUICK_ROUNDS else 0.8) * kp
        else:
            return None
        nominal = self.margins([NOMINAL], kp, kd)[0]
        case = self.case(place)
        stiffness = min(self.softness(place, kp, kd) for place in self.checked)
        return Recommendation(
            objective=self.objective,
            kp=kp,
            kd=kd,
            stiffness=stiffness,
            controller=self.template.from_plane(kp, kd),
            margins=worst,
            worst=worst_of(self.seen),
            nominal=nominal,
            worst_case={name: value_of(case, name) for name in self.uncertainty.names},
            shortfalls=self.requirements.shortfalls(worst),
            dropped=lambda: self.costs(kp, kp if self.objective == "largest_kp" else stiffness),
            certificate=self.certificate(),
            proved=self.proof is None or self.proof.holds,
            reserve=self.reserve,
            bounds=self.bounds,
        )

    def best(self, high: float) -> tuple[float, float] | None:
        """The best gains by the objective over the active cases, in few digits; kp up to `high` where it is to be largest."""
        if self.objective == "largest_kp":
            return self.stiffest(max(float(self.ladder[0]), float(self.bounds.kp_min)), min(high, float(self.bounds.kp_max)))
        found = self.stiffest_link(self.requirements.asked)
        return None if found is None else self.short(found)

    @property
    def ladder(self) -> Floats:
        rungs = self.active[0].ladder
        return rungs[rungs > 0]

    @property
    def inertia(self) -> float:
        """Of motor and link, or of the motor alone where the link is locked [kg m²]."""
        return self.joint.motor_inertia + (self.joint.link_inertia if math.isfinite(self.joint.link_inertia) else 0.0)

    def stiffest_link(self, names: Sequence[str]) -> Stiffest | None:
        """Gains with the largest dynamic stiffness over the active cases, under some of the requirements."""
        cases = [self.link(place) for place in self.soft]

        def allowed(kps: Floats, polish: bool) -> list[Floats]:
            return self.allowed(self.active, kps, names, polish)

        return stiffest_link(cases, allowed, self.ladder, self.inertia, self.bounds)

    def link(self, place: Place) -> LinkCase:
        """Link of the joint at one place in the uncertainty; worked out once."""
        if place not in self.links:
            joint, drive = self.case(place)

            def loop(kp: float, kd: float) -> Loop:
                return build_loop(joint, drive, self.template.from_plane(kp, kd), self.feedback, self.sample_time)

            self.links[place] = LinkCase(loop, self.template)
        return self.links[place]

    def softness(self, place: Place, kp: float, kd: float) -> float:
        """Dynamic stiffness of the link at one place [N m/rad]."""
        return float(self.link(place).stiffness(np.array([kp]), np.array([kd]))[0])

    def softer_case(self, kp: float, kd: float) -> bool:
        """True if one of the examined cases has a softer link than the active ones; it becomes active, too."""
        if self.objective == "largest_kp":
            return False
        softest = min(self.checked, key=lambda place: self.softness(place, kp, kd))
        if softest in self.soft or self.softness(softest, kp, kd) > (1 - SOFTER) * min(self.softness(one, kp, kd) for one in self.soft):
            return False
        self.soft.append(softest)
        return True

    def short(self, found: Stiffest) -> tuple[float, float] | None:
        """The gains found in as few digits as leave them allowed and their link as stiff: 1 % of a flat top is no loss."""
        kp_ends, kd_ends = ([float(getattr(self.bounds, f"{gain}_{end}")) for end in ("min", "max")] for gain in ("kp", "kd"))
        for kp in _shorter(found.kp, kp_ends):
            (allowed,) = self.allowed(self.active, np.array([kp]), self.requirements.asked, polish=True)
            for low, high in allowed.tolist():
                room = min(0.002 * (high - low), 1e-3 * found.kd)
                for kd in _shorter(found.kd, kd_ends):
                    inside = (low + room < kd or low == kd == kd_ends[0]) and (kd < high - room or high == kd == kd_ends[1])
                    if inside and min(self.softness(place, kp, kd) for place in self.soft) >= (1 - SAME) * found.stiffness:
                        return kp, kd
        return found.kp, found.kd

    def costs(self, kp: float, value: float) -> dict[str, float]:
        """Largest value of the objective without each requirement and bound in turn, see `Recommendation.costs`; `value` with all."""
        asked, bounds = self.requirements.asked, self.bounds.names
        found = {name: self.highest(kp, [other for other in asked if other != name]) for name in asked}
        free = self.freed(bounds).highest(kp, asked) if len(bounds) > 1 else math.inf
        alike = free < (1 + COST_ACCURACY) * value  # bounds that cost nothing together cost nothing each
        return found | {name: free if alike else self.freed([name]).highest(kp, asked) for name in bounds}

    def freed(self, names: Sequence[str]) -> "_JointSearch":
        """This search, with the same cases and regions, without some of the bounds."""
        found = copy.copy(self)
        found.bounds = self.bounds.without(names)
        return found

    def highest(self, kp: float, names: Sequence[str]) -> float:
        """Largest value of the objective over the active cases with some of the requirements; `kp` is recommended with all of them."""
        if self.objective == "largest_kp":
            return self.cost(kp, names, self.active)
        found = self.stiffest_link(names)
        return math.inf if found is None else found.stiffness

    def cost(self, kp: float, names: Sequence[str], regions: list[PDRegion]) -> float:
        """The largest kp, from the recommended one up, with these requirements and cases alone."""
        found, top = self.largest(names, regions, kp, 1e3 * kp, accuracy=COST_ACCURACY), float(regions[0].ladder[-1])
        found = self.largest(names, regions, kp, top, accuracy=COST_ACCURACY) if math.isinf(found) and top > kp else found
        return min(found, float(self.bounds.kp_max))

    def certificate(self) -> str:
        if not self.uncertainty.names:
            return "exact for the nominal joint: every crossing and peak certified between the frequencies evaluated"
        assert self.proof is not None
        looked = f"{len(self.checked)} joints within it (corners, centre, a filling, and a search from the worst)"
        if self.proof.holds:
            spare = f", with {100 * self.reserve:g} % of each requirement in reserve" if self.reserve > 0.01 else ""
            return f"proved for every joint within the uncertainty, between all frequencies{spare}; the margins are the worst of {looked}"
        return f"not proved: searched, and held at {looked}, there with {100 * self.reserve:g} % of each requirement in reserve"

    def margins(self, places: Sequence[Place], kp: float, kd: float) -> list[Margins]:
        """Margins with these gains at each place; a place's plant is worked out once."""
        controller = self.template.from_plane(kp, kd)
        control = controller.transfer(self.sample_time)
        loops = []
        for place in places:
            if place not in self.plants:
                self.plants[place] = build_loop(*self.case(place), self.template, self.feedback, self.sample_time)
            plant = self.plants[place]
            assert plant.parts is not None
            parts = replace(plant.parts, controller=controller)
            loops.append(replace(plant, parts=parts) if plant.sensed else replace(plant, control=control, parts=parts))
        if not all(one.in_closed_form(needed) for one, needed in self.requirements.asked_for):  # it may be of any margin there is
            return [margins(build_loop(*self.case(place), controller, self.feedback, self.sample_time)) for place in places]
        return [margins_from_scan(loop, scan(loop.scalar)) for loop in loops if loop.scalar is not None]

    def worst_at(self, kp: float, kd: float) -> CaseMargins:
        """The screened case that misses most. Stops at the first screening that finds one that misses something."""
        self.seen, self.checked = [], set()
        places = self.uncertainty.corners
        if self.uncertainty.names:  # without uncertainty the one corner is NOMINAL already
            places = [*places, NOMINAL, *self.uncertainty.inside(FILLING)]
        best = self.least(places, kp, kd)
        return best if best[2] > 0 else self.worst_near(best, kp, kd)

    def worst_near(self, best: CaseMargins, kp: float, kd: float) -> CaseMargins:
        """Worst case found by a local search from the case `best`."""
        count = len(self.uncertainty.names)
        step = 0.25
        while count and step > 0.01 and best[2] < math.inf:
            shifts = step * np.vstack([np.eye(count), -np.eye(count)])
            center = np.array(best[0] or (0.5,) * count)
            trial = self.least([tuple(place) for place in np.clip(center + shifts, 0.0, 1.0).tolist()], kp, kd)
            if trial[2] > best[2]:
                best = trial
            else:
                step /= 2
        return best

    def proved(self, kp: float, kd: float, best: CaseMargins) -> CaseMargins:
        """Worst case after an attempt to prove the requirements over the whole uncertainty: `best`, or one that the attempt found."""
        if not self.uncertainty.names:
            return best

        def breaks(values: dict[str, float]) -> bool:
            return self.least([self.uncertainty.place(values)], kp, kd)[2] > ROUND_OFF

        controller = self.template.from_plane(kp, kd)
        most = MOST_BOXES if self.reserve == UNPROVED_RESERVE else QUICK_BOXES
        self.proof = prove(
            self.joint, self.drive, self.uncertainty, controller, self.requirements, self.feedback, self.sample_time, breaks, most
        )
        if not self.proof.worst:
            return best
        near = self.least([self.uncertainty.place(self.proof.worst)], kp, kd)
        if self.proof.broken:
            near = self.worst_near(near, kp, kd)
        return max(best, near, key=lambda found: found[2])

    def least(self, places: Sequence[Place], kp: float, kd: float) -> CaseMargins:
        found = self.margins(places, kp, kd)
        self.checked.update(places)
        self.seen += found
        missed = np.array([self.requirements.shortfall(one) for one in found])
        most = float(missed.max())
        k = int(np.argmax(missed if most > 0 else missed >= most - ALIKE))
        return places[k], found[k], most

    def stiffest(self, low: float, high: float) -> tuple[float, float] | None:
        """The largest kp, rounded down to three digits, and its best kd, over the active cases."""
        if low > high:
            return None
        largest = self.largest(self.requirements.asked, self.active, low, high, accuracy=0.001)
        most = float(self.bounds.kp_max)
        if math.isinf(largest) and high >= min(most, self.active[0].ladder[-1]):  # nothing in the model limits kp
            if math.isinf(most):
                return None
            if (found := self.first_allowed(np.array([most]))) is not None:
                return found  # as the bound is written, in however many digits
        kp = rounded_down(min(high, largest))
        if not kp > 0:
            return None
        for _ in range(4):  # the first search is as good as its grid; this one is exact
            trials = _and_below(kp)
            found = self.first_allowed(self.bounded(trials))
            if found is not None:
                return found
            kp = 0.9995 * float(trials[-1])
        kp = self.largest(self.requirements.asked, self.active, low, kp, accuracy=0.001, polish=True)  # the grid was far off
        return None if math.isnan(kp) else self.first_allowed(self.bounded(_and_below(min(kp, high))))

    def bounded(self, kps: Floats) -> Floats:
        """Descending `kps` down to the least that is allowed, which is then the last."""
        least = float(self.bounds.kp_min)
        return kps if kps[-1] >= least else np.append(kps[kps > least], least)

    def first_allowed(self, kps: Floats) -> tuple[float, float] | None:
        """The first of `kps` (k,) that the active cases allow, and its best kd."""
        for some in np.split(kps, [1] if len(kps) > 1 else []):  # mostly the first will do; seven more at once cost little more than one
            for kp, allowed in zip(some, self.allowed(self.active, some, self.requirements.asked, polish=True), strict=True):
                if len(allowed):
                    return float(kp), self.best_kd(float(kp), *allowed[-1])
        return None

    def best_kd(self, kp: float, low: float, high: float) -> float:
        """The kd in (low, high) with the lowest peak sensitivity over the active cases, in as few digits as there is room for."""
        if math.isinf(high):  # more damping is always allowed: look around the critical damping of the whole inertia
            high = 4 * max(low, 2 * math.sqrt(kp * (self.joint.motor_inertia + min(self.joint.link_inertia, 1e6))))
        trials = low + (high - low) * np.linspace(0.05, 0.95, 9)
        peaks = np.array([max(1 / scan(region.scalar(kp, kd)).peaks[0, 1] for region in self.active) for kd in trials.tolist()])
        kd = float(trials[np.argmin(peaks)])
        room = 0.02 * (high - low)
        return next((short for digits in range(3, 9) if low + room < (short := float(f"{kd:.{digits}g}")) < high - room), kd)

    def allowed(self, regions: list[PDRegion], kps: Floats, names: Sequence[str], polish: bool) -> list[Floats]:
        """Intervals of kd (p, 2) that every region allows, one array per kp."""
        result = [np.array([[0.0, np.inf]])] * len(kps)
        for region in regions:
            free = region.excluding(region.required.only(*names), kps, region.stable_columns(kps, polish), polish)
            result = [_common(first, second) for first, second in zip(result, free, strict=True)]
        low, high = float(self.bounds.kd_min), float(self.bounds.kd_max)
        return result if (low, high) == (0.0, math.inf) else [_bounded(intervals, low, high) for intervals in result]

    def largest(
        self, names: Sequence[str], regions: list[PDRegion], low: float, high: float, accuracy: float, polish: bool = False
    ) -> float:
        """The largest kp in [low, high] under some of the requirements, to a relative `accuracy`; NaN where even `low` is not allowed."""
        kps = np.geomspace(low, high, 20)
        while True:
            filled = np.flatnonzero([len(intervals) > 0 for intervals in self.allowed(regions, kps, names, polish)])
            if not len(filled):
                return math.nan
            if filled[-1] == len(kps) - 1:
                return math.inf
            low, high = float(kps[filled[-1]]), float(kps[filled[-1] + 1])
            if high <= low * (1 + accuracy):
                return low
            kps = np.geomspace(low, high, 8)


def value_of(case: Case, name: str) -> float:
    """Value of an uncertain quantity `name` in a case, SI."""
    joint, drive = case
    return drive.delay if name == "delay" else getattr(joint, name)


def _common(first: Floats, second: Floats) -> Floats:
    """Intersection of two sets of intervals."""
    low = np.maximum(first[:, None, 0], second[None, :, 0])
    high = np.minimum(first[:, None, 1], second[None, :, 1])
    keep = high > low
    return np.stack([low[keep], high[keep]], axis=1)


def _bounded(intervals: Floats, low: float, high: float) -> Floats:
    """Parts of open `intervals` from `low` to `high`, whose ends may be taken; they may be the same."""
    parts = np.clip(intervals, low, high)
    return parts[(parts[:, 1] > parts[:, 0]) | ((low == high) & (intervals[:, 0] < low) & (high < intervals[:, 1]))]


def _shorter(value: float, bounds: Sequence[float]) -> list[float]:
    """Values near `value`, within its bounds, the shortest to write first: a bound itself, then 2 to 8 digits."""
    low, high = bounds
    ends = [end for end in bounds if 0 < end < math.inf and abs(value - end) <= NEARLY * end]
    return [*ends, *(short for digits in range(2, 9) if low <= (short := float(f"{value:.{digits}g}")) <= high)]


def _and_below(kp: float) -> Floats:
    """`kp` > 0 rounded down to three significant digits, and the seven next lower numbers of as many digits."""
    found = [rounded_down(kp)]
    while len(found) < 8:
        found.append(rounded_down(found[-1] * (1 - 1e-5)))  # the next one down
    return np.array(found)


def rounded_down(value: float) -> float:
    """`value` > 0 to three significant digits, never up."""
    if not (value > 0 and math.isfinite(value)):
        return value if value == math.inf else math.nan
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.floor(value / unit) * unit:.3g}")
