"""All requirements in postures of a sweep, which itself computes the gain limit alone: in the lowest ones, and in a random share of them.

In each contact state the posture with the lowest limit gets all its margins, as in `gainroom robot`. The others are sampled as corners of
an uncertainty are (design/gain_cases.py), in a tenth of the time; the worst of them is computed again in full.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..analysis.margin_record import Margins
from ..errors import GainroomError
from ..system.requirement import Requirement
from ..system.requirements import Requirements
from ..system.system import StateCase
from .analysis import KEYS, Analysis, found_missed, found_unstable, read_as, rests_on
from .loop_numbers import margins_of, with_certified_delay
from .progress import Progress, quiet
from .state import State, state_of
from .sway import without_sway
from .sweep.plan import SweepPlan
from .sweep.summary import SweepSummary, SweptPosture
from .verdict import Finding, Verdict, judged, missed

MOST = 6
"""Most contact states whose worst posture gets all margins: those with the lowest limits."""
MANY, FEW = 50, 5
"""Number of lowest, and as many random, postures of each contact state; FEW for robots whose limits are computed individually."""


@dataclass(frozen=True)
class SampledRequirement:
    """One requirement in the sample: its worst `state`, with all margins, and the number of postures that miss it.

    random_missed   number of random postures that miss it
    without_sway    a state that misses it with sway damped, if the worst one would not; None: there is none
    """

    requirement: Requirement
    needed: float
    state: State
    missed: int
    random_missed: int
    without_sway: State | None = None

    @property
    def value(self) -> float:
        """Worst value found [SI]."""
        return self.requirement.value(self.state.counted)

    @property
    def met(self) -> bool:
        """True if met in all postures of the sample."""
        return not self.missed and self.requirement.met(self.needed, self.value)


@dataclass(frozen=True)
class WorstStates:
    """Worst posture of each contact state, the lowest limit first, with its draw's values; and the sample.

    lowest, random   number of lowest and of random postures of each contact state
    count, random_count   judged in all, and of the random ones; everywhere: True if that is all there are
    requirements     besides the gain margin, which is among them if one joint alone misses it
    toppling         a state of the sample that the weight topples, if all requirements are met; None: there is none
    """

    states: tuple[State, ...] = ()
    lowest: int = 0
    random: int = 0
    count: int = 0
    random_count: int = 0
    everywhere: bool = False
    requirements: tuple[SampledRequirement, ...] = ()
    toppling: State | None = None

    @property
    def unmet(self) -> dict[str, SampledRequirement]:
        """Requirements missed in the sample, by name."""
        return {one.requirement.name: one for one in self.requirements if not one.met}

    def unmet_at(self, factor: float) -> list[Requirement]:
        """Requirements missed with `factor` on all gains, each in its worst state."""
        found = {id(one.state): margins_of(one.state.loop.scaled(factor)) for one in self.requirements}
        return [
            one.requirement for one in self.requirements if not one.requirement.met(one.needed, one.requirement.value(found[id(one.state)]))
        ]


def worst_states(found: SweepSummary, each: int | None = None, progress: Progress = quiet) -> WorstStates:
    """Sample of `each` lowest and as many random postures of each contact state; None: a number that suits the robot; 0: the lowest one.

    Reproducible: the seed is the sweep's.
    """
    plan = found.plan
    ordered = sorted((one.worst[0] for one in found.contacts if one.worst), key=lambda one: one.gain)
    states = tuple(state for one in ordered[:MOST] if (state := _in_full(one, plan)) is not None)
    others = plan.system.requirements.asked_for
    if not others or not states:
        return WorstStates(states)
    if each is None:
        each = MANY if all(plan.at(0, contact).quick for contact in range(len(plan.contacts))) else FEW
    sample = _Sample(found, each)
    looked = list(_sampled(sample, progress))
    sampled = []
    for requirement, needed in others:

        def misses(found: Margins, one: Requirement = requirement, needed: float = needed) -> bool:
            return not one.met(needed, one.value(found))

        short = [(requirement.shortfall(needed, requirement.value(margins)), one) for one, margins in looked]
        missed = [(one, margins) for one, margins in looked if misses(margins)]
        if requirement.name == "gain_margin" and not (missed and found.margin_held):
            continue  # limits tell it everywhere, but for the gains of one joint alone
        known = [*states, *([] if not short else filter(None, [_in_full(max(short, key=lambda pair: pair[0])[1], plan)]))]
        worst = max(known, key=lambda state, one=requirement, least=needed: one.shortfall(least, one.value(state.counted)))
        random = sum(one.key in sample.random for one, _ in missed)
        other = None
        if missed and misses(worst.margins) and not misses(worst.balanced.counted):
            lost = next((one for one, margins in missed if misses(_balanced(one, plan, margins))), None)
            other = None if lost is None else _in_full(lost, plan)
        sampled.append(SampledRequirement(requirement, needed, worst, len(missed), random, other))
    random_count = sum(one.key in sample.random for one, _ in looked)
    every = len(looked) == plan.states
    lowest = max(len(contact.worst[: max(each, 1)]) for contact in found.contacts)
    toppling = next(filter(None, (_toppling(one, plan) for one, _ in looked)), None) if all(one.met for one in sampled) else None
    return WorstStates(states, lowest, min(each, plan.postures.count), len(looked), random_count, every, tuple(sampled), toppling)


def swept_verdict(found: SweepSummary, worst: WorstStates) -> Verdict:
    """Verdict on every swept posture: findings of `gainroom robot` in the worst ones, and what is not known of all."""
    system, lowest = found.plan.system, found.worst_posture
    sampled = [state for one in worst.requirements for state in (one.state, one.without_sway)]
    studied = Analysis(system, tuple(dict.fromkeys(state for state in (*worst.states, *sampled, worst.toppling) if state is not None)))
    findings = [*_found(found, worst, studied)] if studied.states else []
    codes = {one.code for one in findings}
    title = "" if lowest is None else f"{lowest.name}/{found.plan.contacts[lowest.contact]}"
    joints = () if lowest is None or lowest.joint < 0 else (found.plan.robot.joint_names[lowest.joint],)
    unstable, short = (sum(getattr(one, name) for one in found.contacts) for name in ("unstable", "short"))
    if lowest is not None and unstable and not codes & {"unstable", "topples"}:
        limit = {"gain_limit": lowest.gain, "lower_gain_limit": lowest.lower, "limit_frequency_rad_s": lowest.frequency}
        findings.append(Finding("unstable", "unsafe", {**limit, "postures": unstable}, title, joints))
    elif lowest is not None and short and found.margin > 1 and not codes & {"unstable", "topples", "gain_margin"}:
        where = {"frequency": lowest.frequency, "state": title, "joints": joints, "postures": short}
        findings.append(missed(Requirements(gain_margin=found.margin), "gain_margin", lowest.gain, **where))
    if found.unknown or not found.complete or lowest is None:
        findings.append(Finding("limit_unknown", "undecided", {"postures": found.unknown}))
    if worst.requirements and not worst.everywhere:
        findings.append(Finding("judged_in_sample", "safe", {"postures": worst.count}))
    if found.uncertified and "not_certified" not in codes:
        findings.append(Finding("not_certified", "safe", {"postures": found.uncertified}))
    return judged(system, KEYS, findings, lambda level: read_as(system, findings, studied.states, level))


def _found(found: SweepSummary, worst: WorstStates, studied: Analysis) -> Iterator[Finding]:
    """Findings in the worst states of a sweep, each with the number of postures that are unstable or miss that requirement, if known."""
    contacts = {one.name: one for one in found.contacts}
    counts = {name: one.missed for name, one in worst.unmet.items()}
    counts["gain_margin"] = max(counts.get("gain_margin", 0), sum(one.short for one in found.contacts))
    for one in (*found_unstable(studied), *found_missed(studied), *rests_on(studied)):
        contact = contacts.get(one.state.rpartition("/")[2])
        lost = one.code in ("unstable", "topples") and contact is not None
        count = contact.unstable if lost and contact is not None else counts.get(one.code)
        yield one if count is None else replace(one, values={**one.values, "postures": count})


@dataclass(frozen=True)
class _Sample:
    """Lowest and random postures of each contact state."""

    summary: SweepSummary
    each: int

    @cached_property
    def random(self) -> dict[tuple[int, int, int], SweptPosture]:
        """Random postures by contact state, draw and index: the same postures in every contact state."""
        plan = self.summary.plan
        count = plan.postures.count
        rng = np.random.default_rng([plan.seed, 14])
        numbers = np.sort(rng.choice(count, min(self.each, count), replace=False))
        draws = rng.integers(len(plan.places), size=len(numbers))
        angles = [plan.postures.at(number, number + 1)[0] for number in numbers.tolist()]
        chosen = [
            SweptPosture(number, contact, draw, np.nan, np.nan, -1, False, one)
            for contact in range(len(plan.contacts))
            for number, draw, one in zip(numbers.tolist(), draws.tolist(), angles, strict=True)
        ]
        return {one.key: one for one in chosen}

    @property
    def all(self) -> list[SweptPosture]:
        """All sampled postures, each once."""
        tail = {one.key: one for contact in self.summary.contacts for one in contact.worst[: max(self.each, 1)]}
        return list({**self.random, **tail}.values())


def _sampled(sample: _Sample, progress: Progress) -> Iterator[tuple[SweptPosture, Margins]]:
    """Sampled margins of every posture that moves and can be linearised; the others count as not known, or need nothing."""
    plan, every = sample.summary.plan, sample.all
    for done, one in enumerate(every):
        progress(done, len(every), "margins")
        contact = plan.contacts[one.contact]
        system = one.system(plan)
        try:
            model = system.source.linearize(one.name, contact)
            if system.loop(model).acts:
                case = StateCase(one.name, contact, "", system, model)
                yield one, without_sway(case, with_certified_delay(case))
        except GainroomError:
            continue
    progress(len(every), len(every), "margins")


def _balanced(one: SweptPosture, plan: SweepPlan, found: Margins) -> Margins:
    """Margins `found` of a posture with a controller that damps sway."""
    system, contact = replace(one.system(plan), balance="controller"), plan.contacts[one.contact]
    return without_sway(StateCase(one.name, contact, "", system, system.source.linearize(one.name, contact)), found)


def _toppling(one: SweptPosture, plan: SweepPlan) -> State | None:
    """State of a posture that the weight topples, if the file does not say whether it counts; otherwise None."""
    state = state_of(one.system(plan), one.name, plan.contacts[one.contact], ("moves",))
    return state if state.topples_with_weight else None


def _in_full(one: SweptPosture, plan: SweepPlan) -> State | None:
    """State of a swept posture with all margins; None if it cannot be linearised, or nothing moves."""
    try:
        state = state_of(one.system(plan), one.name, plan.contacts[one.contact], ("margins",))
    except GainroomError:
        return None
    return state if state.moves else None
