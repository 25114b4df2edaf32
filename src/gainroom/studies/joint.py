"""Study of one joint: its analysis, and results that exist for n = 1 alone.

Gain regions, largest gains, causes of the limit, and ranges.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from ..analysis.crossings import scan
from ..analysis.gain_region import PDRegion, pd_region
from ..analysis.margin_record import GainLimit, Margins, worst_of
from ..analysis.margins import margins, margins_from_scan
from ..analysis.range_proof import Proof, prove
from ..design.joint_gains import FILLING, MOST_BOXES, QUICK_BOXES, Recommendation, recommend_pd
from ..design.link_gains import LinkCase
from ..design.uncertainty_cost import UncertaintyCost, cost_of, uncertainty_cost
from ..errors import GainroomError, case_text
from ..simulation.step_response import StepResponse, step_response
from ..system.gain_bounds import GainBounds
from ..system.loop import Loop
from ..system.requirements import Requirements
from ..system.system import System
from ..system.torque_noise import torque_per_count
from ..system.uncertainty import Uncertainty
from .analysis import Analysis, analyze
from .over_uncertainty import Worst
from .state import USUAL_RATE, State
from .study_record import StudyRecord
from .verdict import Finding, Verdict

RULE_FREQUENCY = 2 * math.pi * 10.0  # [rad/s] of the rule that reinforcement-learning teams copy: kp = J ω², kd = 2 ζ J ω
RULE_DAMPING = 2.0
RIGID, AT_ONCE = {"stiffness": math.inf, "damping": 0.0}, {"delay": 0.0}


class NoGainsError(GainroomError):
    """A joint's file asks which gains may be used, and none meet the requirements, or, if `unlimited`, nothing limits them."""

    def __init__(self, system: System, unlimited: bool, prevented_by: tuple[str, ...]) -> None:
        super().__init__("no gains are recommended")
        self.system, self.unlimited, self.prevented_by = system, unlimited, prevented_by

    @property
    def verdict(self) -> Verdict:
        """No gains to be had: not safe."""
        return Verdict.of((Finding("no_gains", "unsafe"),))


@dataclass(frozen=True)
class Rule:
    """Gains of the 10 Hz rule on this joint, and their margins."""

    kp: float
    kd: float
    margins: Margins


@dataclass(frozen=True)
class InRange:
    """Given gains within the uncertainty.

    unstable_at   first unstable case, by quantity, SI; {}: none found, or the gains are nominally unstable
    margins       every margin in the examined case in which it is smallest
    proved        True: the verdict holds everywhere within; False: no unstable case was found, but there may be one
    met           True: every requirement is met everywhere within; None: met in all examined cases, not proved between them
    at            case, as text, in which each requirement has its worst value; "" at the nominal values
    """

    unstable_at: dict[str, float]
    margins: Margins
    proved: bool
    met: bool | None
    at: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class JointStudy(Analysis, StudyRecord):
    """Results of `gainroom joint` on the given gains, all other gains, and recommended ones. Gain regions are computed on demand."""

    @property
    def state(self) -> State:
        """State of the joint, its only one."""
        return self.every[0]

    @property
    def loop(self) -> Loop:
        """Loop with the given gains."""
        return self.state.loop

    @property
    def margins(self) -> Margins:
        """Margins of the given gains, at the nominal values."""
        return self.state.margins

    @property
    def limit(self) -> GainLimit:
        """Limit of the common factor on the given gains."""
        return self.margins.limit

    @property
    def template(self) -> Any:
        """Controller whose gain plane is studied: the file's own, or a plain PD with its filters if that has none."""
        controller = self.system.control.controller
        return controller if controller.has_plane else controller.plain_pd(1.0, 1.0)

    @cached_property
    def region(self) -> PDRegion:
        """Region of the gains (kp, kd) on the controller's plane that are stable, at the nominal values."""
        return self._region(Requirements())

    @cached_property
    def link(self) -> LinkCase | None:
        """Dynamic stiffness of the link with any gains on the controller's plane, at the nominal values; None where it is locked."""
        if math.isinf(self.system.source.link_inertia):
            return None

        def loop(kp: float, kd: float) -> Loop:
            return self.system.loop(controller=self.template.from_plane(kp, kd))

        return LinkCase(loop, self.template)

    @cached_property
    def required_region(self) -> PDRegion:
        """Region of the gains (kp, kd) on the controller's plane that meet the requirements, at the nominal values."""
        return self._region(self.system.requirements)

    def _region(self, required: Requirements) -> PDRegion:
        asked = {name: getattr(required, name) for name in required.asked}
        return pd_region(self.system.source, self.system.drives[0], **asked, **self._loop_options)

    @property
    def _loop_options(self) -> dict[str, Any]:
        control = self.system.control
        return {"feedback": control.feedback, "sample_time": control.sample_time, "controller": self.template}

    @cached_property
    def max_kp(self) -> float:
        """Largest stable kp over all kd."""
        return self.region.max_kp()

    @property
    def torque_per_count(self) -> float:
        """Torque that one count of the encoder commands at once [N m]; NaN where the loop is not sampled or the resolution not known."""
        with suppress(GainroomError):
            return float(torque_per_count(self.every[0].loop)[0])
        return math.nan

    @property
    def kd_at_max_kp(self) -> float:
        """Gain kd at the largest stable kp; NaN if kp has no largest value or kd no bound there."""
        if not math.isfinite(self.max_kp):
            return math.nan
        (stable,) = self.region.columns(self.max_kp * (1 - 1e-6))
        return float(stable[-1].mean()) if len(stable) and math.isfinite(stable[-1, 1]) else math.nan

    @cached_property
    def max_kd(self) -> float | None:
        """Largest stable kd at the given kp; None for controllers without a kp–kd plane."""
        controller = self.system.control.controller
        return self.region.max_kd(controller.plane_gains()[0]) if controller.has_plane else None

    @cached_property
    def found(self) -> Recommendation | None:
        """Gains that the search found, see `recommended`."""
        return self._recommend(self.system.uncertainty)

    @cached_property
    def recommended(self) -> Recommendation | None:
        """Recommended gains; None if nothing is required, or no gains meet it."""
        found = self.found
        if found is None:
            return None
        nominal = margins(self.system.loop(controller=found.controller))  # as the file with these gains has them, to the last bit
        return replace(found, nominal=nominal) if self.system.uncertainty.names else replace(found, nominal=nominal, worst=nominal)

    @cached_property
    def response(self) -> StepResponse:
        """Motion of motor and link after steps of reference and load, with the given gains at the nominal values."""
        return step_response(self.loop)

    @cached_property
    def recommended_response(self) -> StepResponse | None:
        """Motion as in `response` with the recommended gains; None if there are none, or if they are the given ones."""
        best = self.recommended
        if best is None or best.controller == self.system.control.controller:
            return None
        return step_response(self.system.loop(controller=best.controller))

    @cached_property
    def at_usual_rate(self) -> "JointStudy | None":
        """Study of the recommended gains at USUAL_RATE; None if the file has a rate, or none are recommended."""
        if not self.system.rate_is_missing or self.recommended is None:
            return None
        control = replace(self.system.control, controller=self.recommended.controller, sample_time=1 / USUAL_RATE)
        sampled = replace(self.system, control=control)
        return JointStudy(sampled, analyze(sampled).every)

    def at_rate(self, rate: float) -> Margins:
        """Worst margins of the recommended gains in a loop at `rate` [Hz], over the nominal values and the corners of the ranges."""
        assert self.recommended is not None
        control = replace(self.system.control, controller=self.recommended.controller, sample_time=1 / rate)
        system, uncertain = replace(self.system, control=control), self.system.uncertainty
        every = [system, *(system.with_values(**uncertain.values(place)) for place in uncertain.corners if uncertain.names)]
        found = [margins(one.loop()) for one in every]
        return next((one for one in found if not one.stable), worst_of(found))

    @cached_property
    def prevented_by(self) -> tuple[str, ...]:
        """Bounds without any one of which there would be recommended gains, or else without all; () where they are not the reason."""
        bounds = self.system.bounds
        if self.found is not None or not bounds.names:
            return ()

        def found(names: Sequence[str]) -> bool:
            return self._recommend(self.system.uncertainty, bounds.without(names)) is not None

        alone = tuple(name for name in bounds.names if found([name]))
        return alone or (bounds.names if len(bounds.names) > 1 and found(bounds.names) else ())

    def _recommend(self, uncertainty: Uncertainty, bounds: GainBounds | None = None) -> Recommendation | None:
        """Gains that hold over `uncertainty`; `bounds` None: those of the system."""
        system = self.system
        if not system.requirements.asked:
            return None
        options = {**self._loop_options, "objective": system.objective, "bounds": bounds or system.bounds}
        return recommend_pd(system.source, system.drives[0], system.requirements, uncertainty, **options)

    @cached_property
    def exact(self) -> Recommendation | None:
        """Recommended gains without uncertainty."""
        return self._recommend(Uncertainty()) if self.system.uncertainty.names else self.recommended

    @property
    def cost(self) -> float | None:
        """Share of the exact joint's dynamic stiffness (or kp) that the uncertainty costs; None without any, or without exact gains."""
        return None if self.exact is None or not self.system.uncertainty.names else cost_of(self.recommended, self.exact)

    @cached_property
    def uncertainty_cost(self) -> UncertaintyCost | None:
        """Cost of the uncertainty by quantity; None if `cost` is.

        It takes about as long again as `recommended`, so it is computed on demand.
        """
        if self.exact is None or self.cost is None:
            return None
        nominal = {"delay": self.system.delay, **vars(self.system.source)}
        return uncertainty_cost(self._recommend, self.system.uncertainty, nominal, self.recommended, self.exact)

    @cached_property
    def rule(self) -> Rule:
        """Gains of the 10 Hz rule, which uses the reflected motor inertia alone; a joint without one uses the load's."""
        joint, template = self.system.source, self.template
        inertia = joint.motor_inertia or joint.link_inertia
        kp, kd = inertia * RULE_FREQUENCY**2, 2 * RULE_DAMPING * inertia * RULE_FREQUENCY
        return Rule(kp, kd, margins(self.system.loop(controller=template.plain_pd(kp, kd))))

    @cached_property
    def others(self) -> dict[str, tuple[Loop, Margins]]:
        """Loop and margins of the same controller without "delay", "elasticity", "delay and elasticity" (Jung et al. 2017, Fig. 9)."""
        system = self.system
        elastic = math.isfinite(system.source.stiffness) and math.isfinite(system.source.link_inertia)
        elastic = elastic and not system.control.feedback.torque  # a rigid gearbox has no spring whose torque is measured
        changes = {"delay": AT_ONCE} if system.delay > 0 else {}
        changes |= {"elasticity": RIGID} if elastic else {}
        changes |= {"delay and elasticity": RIGID | AT_ONCE} if len(changes) == 2 else {}
        loops = {name: system.with_values(**change).loop() for name, change in changes.items()}
        return {name: (loop, margins(loop)) for name, loop in loops.items()}

    @property
    def without(self) -> dict[str, float]:
        """Gain limits (factors) of the loops of `others`, by the name of what is left out."""
        return {name: found.limit.gain for name, (_, found) in self.others.items()}

    @cached_property
    def in_range(self) -> InRange:
        """Given gains in the range; examined are the ends of each quantity, corners, a filling, and cases that arise during the proof."""
        uncertain, asked = self.system.uncertainty, self.system.requirements
        if not uncertain.names or not self.margins.stable:
            return InRange({}, self.margins, True, self.margins.stable and asked.met_by(self.margins))
        places = [*({name: end} for name in uncertain.names for end in getattr(uncertain, name))]
        places += [uncertain.values(place) for place in (*uncertain.corners, *uncertain.inside(FILLING))]
        systems = [self.system.with_values(**values) for values in places]
        loops = [system.loop() for system in systems]
        found = [margins_from_scan(loop, scan(loop.scalar)) for loop in loops if loop.scalar is not None]
        for values, one in zip(places, found, strict=True):
            if not one.stable:
                return InRange(_numbers(values), one, True, False)
        cases = [("", self.margins), *((case_text(_numbers(values)), one) for values, one in zip(places, found, strict=True))]
        met = asked.met_by(worst_of([one for _, one in cases]))
        if met:
            proof = self._proof(asked, QUICK_BOXES)
            if proof.holds:
                return self._looked_at(cases, True, True)
            if proof.broken:
                cases.append((case_text(proof.worst), margins(self.system.with_values(**proof.worst).loop())))
        proof = self._proof(Requirements(), MOST_BOXES)
        if proof.broken:
            return InRange(proof.worst, margins(self.system.with_values(**proof.worst).loop()), True, False)
        return self._looked_at(cases, proof.holds, None if asked.met_by(worst_of([one for _, one in cases])) else False)

    def _looked_at(self, cases: list[tuple[str, Margins]], proved: bool, met: bool | None) -> InRange:
        worst = Worst.of(cases, self.system.requirements)
        return InRange({}, worst.margins, proved, met, worst.at)

    def _proof(self, required: Requirements, most: int) -> Proof:
        """Proof that the given gains meet `required` everywhere in the range; with nothing required, that they are stable there."""
        system, control = self.system, self.system.control

        def breaks(values: dict[str, float]) -> bool:
            found = margins(system.with_values(**values).loop())
            return not (found.stable and required.met_by(found))

        return prove(
            system.source,
            system.drives[0],
            system.uncertainty,
            control.controller,
            required,
            control.feedback,
            control.sample_time,
            breaks,
            most,
        )

    @property
    def unstable_at(self) -> dict[str, float]:
        """First unstable case, see InRange."""
        return self.in_range.unstable_at

    @property
    def range_proved(self) -> bool:
        """True if the verdict of `in_range` is proved for the whole range, see InRange.proved."""
        return self.in_range.proved

    def worst_in(self, state: State) -> Worst:
        """Worst margins over the range, from in_range."""
        return Worst(self.in_range.margins, self.in_range.at, case_text(self.unstable_at))

    @property
    def requirements_met(self) -> bool | None:
        """True if all requirements are met in the range; None: not proved, see InRange."""
        return self.in_range.met


def _numbers(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items()}


def study_joint(system: System) -> JointStudy:
    """Study of one joint; regions, largest gains and recommended gains are computed on demand.

    Of a system that asks which gains may be used it is the study of the recommended ones. Raises NoGainsError where there are none.
    """
    if not system.asks:
        return JointStudy(system, analyze(system).every)
    asking = JointStudy(system, ())
    found = asking.found
    if found is None:
        raise NoGainsError(system, math.isinf(asking.max_kp), asking.prevented_by)
    system = system.with_controller(found.controller)
    study = JointStudy(system, analyze(system).every)
    vars(study)["found"] = found
    return study
