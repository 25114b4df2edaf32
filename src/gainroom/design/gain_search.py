"""The search for the best gains of coupled loops that meet the requirements in every case.

A direction is a joint, or one of a task. Of all gains that meet the requirements those are sought that make a cost least (objectives.py):
the links' dynamic softness, or Σ_j w_j u_j / k_j with k_j the stiffness of direction j, u_j the inertia it moves and w_j the weight that
its user gives it. The search goes in ln of the gains: at every step all that may be missed (margin_slopes.py) and every peak of a link's
compliance is replaced by its tangent, and the quadratic programme of that solved, within a radius that shrinks where the tangents mislead
(sequential quadratic programming: Nocedal and Wright 2006, chapter 18). Gains that were tried and are not better leave their tangents as
well, which say how what is missed bends (a bundle: Mäkelä 2002, Optimization Methods and Software 17). It begins anywhere that is stable,
and makes what is missed smaller first. Nothing in it depends on the order of directions or on units.

What is returned has been looked at in every case; of the largest stiffness, also that no direction can be raised.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.margin_record import Margins
from ..errors import GainroomError
from ..native import _core
from ..system.gain_bounds import BOUNDS, GainBounds
from ..system.linear.arrays import Booleans, Floats
from ..system.system import Objective
from .margin_slopes import NEAR, GainCase, Gains, Slopes, moved, stiffness
from .objectives import Cost, LinkSoftness, StaticSoftness, acting, goal_of
from .parallel import at_once

LINK = "link"
"""What limits a direction that could be raised by RAISE: its link would be dynamically softer."""
RAISE = 1.05
"""No stiffness can be raised by this factor, whether its damping stays or rises as much."""
DIGITS = 4
RADIUS = 0.3  # largest first step, in ln of a gain
LARGEST_RADIUS = 1.0
LEAST_RADIUS = 2e-4  # at which a search ends
LEAST_PROMISE = 3e-5  # a step that promises less than this ends it too
PRICES = ((10.0, 1e-3), (50.0, 3e-3), (250.0, 2e-2))
"""Cost of a shortfall of 1, against ln of the sum of compliances, and the reserve kept on each requirement: first as much as may
be lost by rounding gains. Where that does not hold, more: two loci that meet part again like a square root, which has no tangent.
"""
HOPELESS = 0.03  # shortfall at the end of a search above which a higher price was of no use in any robot tried: seen, not proved
PULL = 0.02  # cost of any change of a gain: without it gains on which nothing depends would be arbitrary
STALLED, LEFT = 8, 0.9  # steps that leave more than this share of the shortfall end a search: none of 858 that reached 0 paused so long
STEPS = 150
SLOW = 10  # steps that together lower the cost by less than a goal's LITTLE end a search, too
NOTHING = 1e-4  # excess of the shortfall in new samples over the predicted one, above which something new has come near −1
FOLLOWED = 4  # predicted steps between two samplings of the loops: if a crossing came near −1 unseen, all of them are taken back
ANEW = 0.05  # least radius, in ln of a gain, where new samples have shown a crossing not known before
COARSE = 3e-2  # the same while some cases that decide may not be known yet
FEW = 3  # cases up to which all are searched over as soon as one of them is met


@dataclass(frozen=True)
class Raised:
    """Result of a search: the best gains, or those that came nearest to the requirements.

    gains    (3, m)
    margins  of each case, in the order of the cases
    holds    False where no gains were found that meet the requirements
    margin   per direction what limits it: the requirement that breaks if it is raised, a field of Requirements, "stability", LINK where its
             link would be softer, or "" where nothing does
    case     per direction the index of the case in which that is so; −1: none
    of_sway  per direction True where sway alone breaks that requirement
    failed   indices of the cases for which alone no gains were found; empty where `holds`
    """

    gains: Gains
    margins: tuple[Margins, ...]
    holds: bool
    margin: tuple[str, ...] = ()
    case: tuple[int, ...] = ()
    of_sway: tuple[bool, ...] = ()
    failed: tuple[int, ...] = ()


def stiffer(gains: Gains, which: int | Sequence[int], factor: float, power: float, cascade: Booleans) -> Gains:
    """`gains` with the stiffness of one direction, or some, times `factor`, and its damping times factor^power."""
    step = np.zeros((2, gains.shape[1]))
    step[:, which] = math.log(factor) * (np.array([1.0, power]) if isinstance(which, int) else np.array([[1.0], [power]]))
    return moved(gains, step, cascade)


def rounded(gains: Gains) -> Gains:
    """Gains rounded to DIGITS digits, which people see and type in: the margins are those of the gains in use."""
    return np.array([[float(f"{value:.{DIGITS}g}") for value in row] for row in gains])


def raised_gains(
    cases: Sequence[GainCase],
    start: Gains,
    unit: Floats,
    groups: Sequence[Sequence[int]],
    most: float,
    progress: Callable[[], None] = lambda: None,
    objective: Objective = "largest_kp",
    weight: Floats | None = None,
    bounds: GainBounds | None = None,
) -> Raised:
    """The best gains that a search reaches from `start`, which is stable in every case.

    unit     (m,) unit of each direction's stiffness: its inertia times its weight
    groups   the directions that may be changed; those of one group (the legs of a biped) by the same factors
    most     largest stiffness in units of `unit`, above which nothing limits it
    weight   (m,) of each direction's dynamic stiffness; None: 1
    bounds   of the directions' gains, which `start` keeps; None: none

    Raises GainroomError without cases or requirements, and where `start` is not stable or out of bounds.
    """
    if not cases or not any(case.required.asked for case in cases):
        raise GainroomError("raised_gains needs at least one case and one requirement")
    if not all(case.known(start) for case in cases):
        raise GainroomError("raised_gains needs gains to begin with that are stable in every case")
    if not np.any(stiffness(start, cases[0].cascade) > 0):
        raise GainroomError("raised_gains needs a direction that has stiffness")
    bounds = (bounds or GainBounds()).shared(groups, len(unit))
    if not np.array_equal(bounds.within(start), start):
        raise GainroomError("raised_gains needs gains to begin with that are within the bounds")
    goal = goal_of(objective, cases, unit, np.ones(len(unit)) if weight is None else weight, groups)
    return _GainSearch(cases, unit, goal, most, progress, bounds).raised(start)


class _GainSearch:
    def __init__(
        self,
        cases: Sequence[GainCase],
        unit: Floats,
        goal: LinkSoftness | StaticSoftness,
        most: float,
        progress: Callable[[], None],
        bounds: GainBounds,
    ) -> None:
        self._cases, self._unit, self._goal, self._most, self._progress = cases, unit, goal, most, progress
        self._member, self._cascade, self._bounds = goal.member, goal.cascade, bounds

    def raised(self, start: Gains, careful: bool = False) -> Raised:
        """Result of the search from gains that are stable in every case; repeated with `careful` samples where quick ones miss some."""
        reached, active = self.descended(start)
        for gains in (self._bounds.within(rounded(reached)), reached, start):
            if not all(case.required.met_by(case.margins(gains)) for case in self._cases):
                continue
            self._anchor(gains, self._cases)
            if careful or not any(case.breaks(gains) for case in self._cases):
                found = self.proved(gains) if isinstance(self._goal, StaticSoftness) else self.limited(gains)
                kept = all(case.required.met_by(one) for case, one in zip(self._cases, found.margins, strict=True))
                if careful or kept:
                    return replace(found, holds=kept, failed=() if kept else active)
                gains = found.gains
            for case in self._cases:
                case.be_careful()
            return self.raised(gains, careful=True)
        return Raised(reached, tuple(at_once(lambda case: case.all_margins(reached), self._cases)), False, failed=active)

    def descended(self, start: Gains) -> tuple[Gains, tuple[int, ...]]:
        """Gains and the cases searched over: one first, then also those that it breaks or in which links are softer, until all are met."""
        active, gains = [self._worst(start)], start
        little = COARSE if len(self._cases) > 1 else self._goal.LITTLE
        self._goal.begin(active)
        while True:
            cases = [self._cases[k] for k in active]
            gains, missed = self._descended(gains, cases, PRICES[: 1 if len(active) > 1 else None], little)
            if missed > 0 and len(active) > 1:
                gains, missed = self._descended(start, cases, PRICES, little)
            worst = self._worst(gains)
            there = self._missed(gains, [self._cases[worst]])
            whole = there == math.inf or self._goal.complete(gains)
            if missed > 0 or worst in active or there <= 0:
                if missed > 0 or (little == self._goal.LITTLE and whole):
                    return gains, tuple(active)
                little, active = self._goal.LITTLE, sorted({*active, *self._goal.counted})
                continue
            active += sorted(set(range(len(self._cases))) - set(active)) if len(self._cases) <= FEW else [worst]
            little = self._goal.LITTLE if len(active) == len(self._cases) else little
            active = sorted({*active, *self._goal.counted})
            gains = start if there == math.inf else gains  # slopes are those of a loop that is stable

    def _worst(self, gains: Gains) -> int:
        """Index of the case that misses a requirement most, or meets it least."""
        return int(np.argmax(at_once(lambda case: self._missed(gains, [case]), self._cases)))

    def _missed(self, gains: Gains, cases: Sequence[GainCase]) -> float:
        """Largest shortfall of a requirement over `cases`, as margin_slopes.py measures it; negative if all are met, inf if unstable."""
        worst = -math.inf
        for case in cases:
            worst = max(worst, case.required.shortfall(case.margins(gains)))
            self._progress()
            if worst == math.inf:
                break
        return worst

    def _descended(
        self, gains: Gains, cases: Sequence[GainCase], prices: Sequence[tuple[float, float]], little: float
    ) -> tuple[Gains, float]:
        """The stiffest gains that meet the requirements, or the nearest to it, and their shortfall; `gains` to begin with are stable."""
        found = []
        for price, reserve in prices:
            found.append(self._descended_at(gains, cases, price, reserve, little))
            if found[-1][1] <= 0 or found[-1][1] > HOPELESS:
                break
        return min(found, key=lambda each: each[1])

    def _descended_at(self, gains: Gains, cases: Sequence[GainCase], price: float, reserve: float, little: float) -> tuple[Gains, float]:
        """Gains of the search at one price of a shortfall, and their shortfall; ended where SLOW steps win less than `little`.

        After short steps the loops are not sampled again: their curves are predicted from the last samples, a few times, until the search
        is far from there or seems to end. Where new samples then show more shortfall than predicted, and a cost above that of the last
        samples, the search goes back to these.
        """

        def cost(gains: Gains, missed: float) -> float:
            return self._cost(gains, missed + reserve, price)

        slopes = self._tangents(gains, cases)
        missed, radius, kept, way, seen, careful, followed = _most(slopes), RADIUS, [], [], True, False, 0
        last = gains, slopes, missed, 0  # at the gains of the last sampling
        if slopes is None:
            return gains, self._missed(gains, cases)
        self._anchor(gains, cases)
        model, highest = self._goal.at(gains)
        for _ in range(STEPS):
            way.append(min([missed, *way[-1:]]))
            if missed <= 0:
                kept.append((model.value, gains))
            step, promised = self._step(gains, model, slopes, missed + reserve, radius, price, reserve)
            tried = self._bounds.within(moved(gains, step.reshape(2, -1) @ self._member, self._cascade))
            slow = len(kept) > SLOW and kept[-SLOW][0] - kept[-1][0] < little
            ending = slow or promised < LEAST_PROMISE or radius < LEAST_RADIUS or _hopeless(way)
            close = self._goal.predicts and not careful and followed < FOLLOWED and all(case.follows(tried) for case in cases)
            if ending and seen:
                break
            if not seen and (ending or not close):  # the loops are sampled again, and compared with their prediction
                new, before = self._tangents(gains, cases), missed
                if new is None or cost(gains, _most(new)) > cost(last[0], last[2]):
                    gains, slopes, missed, held = last
                    assert slopes is not None
                    model, highest = self._goal.at(gains)
                    del kept[held:]
                    careful, radius = True, min(radius, RADIUS)
                elif ending and _most(new) <= max(before, -reserve) + NOTHING:
                    break
                else:
                    slopes, missed = new, _most(new)
                    if ending:  # something has come near unseen
                        radius, kept, way = max(radius, ANEW), [], []
                    last = gains, slopes, missed, len(kept)
                    self._anchor(gains, cases)
                seen, followed = True, 0
                continue
            followed = followed + 1 if close else 0
            there = self._tangents(tried, cases, close)
            after = _most(there)
            gained = cost(gains, missed) - cost(tried, after)
            if there is not None and gained > 0.1 * promised:
                gains, missed, slopes, seen = tried, after, there, not close
                model, highest = self._goal.at(gains)
                if seen:
                    careful, last = False, (gains, slopes, missed, len(kept))
                    self._anchor(gains, cases)
                if gained > 0.7 * promised and np.abs(step).max() > 0.99 * radius:
                    radius = min(2 * radius, LARGEST_RADIUS)
            else:
                misled = 0.6 if there else 0.4  # with the tangents from there it is misled less
                radius = misled * min(radius, float(np.abs(step).max()))
                if there:
                    slopes = Slopes.of([slopes, there.seen_from(step.reshape(2, -1) @ self._member, missed)])
                    other, others = self._goal.at(tried)
                    if len(others) == len(highest):
                        model = model.joined(other, others - highest, step)
        for _, best in sorted(kept, key=lambda each: each[0]):
            if (left := self._missed(best, cases)) <= 0:  # roots are counted there, too
                return best, left
        return gains, self._missed(gains, cases)

    def _tangents(self, gains: Gains, cases: Sequence[GainCase], close: bool = False) -> Slopes | None:
        """Tangents of all cases, predicted from the last samples if `close` to them; None where a loop is unstable."""
        for _ in cases:
            self._progress()
        if close:
            return Slopes.of([case.followed(gains) for case in cases])
        found = at_once(lambda case: case.slopes(gains), cases)
        stable = [one for one in found if one is not None]
        return Slopes.of(stable) if len(stable) == len(found) else None

    def _anchor(self, gains: Gains, cases: Sequence[GainCase]) -> None:
        for case in cases:
            case.anchor(gains)

    def _cost(self, gains: Gains, missed: float, price: float) -> float:
        """Cost that is minimised: that of the goal, and `price` per shortfall `missed`."""
        return math.inf if missed == math.inf else self._goal.at(gains)[0].value + price * max(missed, 0.0)

    def _step(
        self,
        gains: Gains,
        model: Cost,
        slopes: Slopes,
        missed: float,
        radius: float,
        price: float,
        reserve: float,
        bounds: GainBounds | None = None,
    ) -> tuple[Floats, float]:
        """Best step (2g,) of the groups within `radius` according to the tangents, and the decrease of the cost that it promises.

        bounds   that it keeps; None: those of the search

        Each term of the cost is a variable t of its own, above all its tangents; no price of a shortfall is so low that one would be
        above t instead.
        """
        size, terms = len(self._member), len(model.share)
        stiff = stiffness(gains, self._cascade)
        share = np.divide(stiff, self._unit, out=np.zeros(len(stiff)), where=acting(gains, self._member))
        most = np.array([share[member > 0].max() for member in self._member])
        room = np.array([math.log(self._most / one) if one else 0.0 for one in most])
        near = model.within(radius)
        moves = (slopes.slope @ self._member.T).reshape(len(slopes.missed), 2 * size)
        above = np.zeros((int(near.sum()), terms))
        above[np.arange(len(above)), model.term[near]] = -1.0
        rows = np.block([[moves, np.zeros((len(moves), terms))], [model.slope[near], above]])
        values = np.concatenate([slopes.missed + reserve, model.height[near]])
        bend = np.concatenate([model.bend + PULL, PULL * model.share])
        farthest = 1.0 + radius * np.abs(model.slope).sum(axis=1).max(initial=0.0)
        low, high = np.full(2 * size + terms, -farthest), np.full(2 * size + terms, farthest)
        low[: 2 * size], high[: 2 * size] = -radius, radius
        high[:size] = np.clip(room, -radius, radius)
        least, most = self._room(gains, bounds or self._bounds)
        low[: 2 * size], high[: 2 * size] = np.maximum(low[: 2 * size], least), np.minimum(high[: 2 * size], most)
        (found,), over = _core.quadratic_programme(bend, np.concatenate([model.pull, model.share]), rows, values, price, low, high)
        step = found[: 2 * size]
        return step, price * (max(missed, 0.0) - over) - model.least(step)

    def _room(self, gains: Gains, bounds: GainBounds) -> tuple[Floats, Floats]:
        """Room to the bounds (2g,), down and up, in ln of each group's stiffness and damping; directions without gains have all."""
        held = (self._member > 0) & (gains[:2, None] > 0)  # (2, g, m)
        with np.errstate(divide="ignore", invalid="ignore"):
            down, up = (np.log(ends / gains[:2])[:, None] for ends in bounds.box(len(self._unit)))
        down, up = np.where(held, down, -math.inf).max(axis=2), np.where(held, up, math.inf).min(axis=2)
        return np.minimum(down, 0.0).ravel(), np.maximum(up, 0.0).ravel()

    def _bound_of(self, gains: Gains) -> dict[int, str]:
        """Bound that limits each group, by its first direction: the one on which its gains are whose loss would lower the cost most.

        By the tangents, within RAISE, as requirements and the other groups would then allow; groups that none limits are left out.
        """
        reached = {name: self._bounds.on(name, gains) for name in self._bounds.names}
        if not any(map(np.any, reached.values())) or (slopes := self._tangents(gains, self._cases)) is None:
            return {}
        (model, _), (price, reserve), radius = self._goal.at(gains), PRICES[0], math.log(RAISE)

        def promise(bounds: GainBounds) -> float:
            return self._step(gains, model, slopes, _most(slopes) + reserve, radius, price, reserve, bounds)[1]

        held, found = promise(self._bounds), {}
        for group in self._moving(gains):
            lost = {name: promise(self._bounds.freed(name, group)) - held for name, on in reached.items() if on[group].any()}
            if lost and max(lost.values()) > LEAST_PROMISE:
                found[group[0]] = max(lost, key=lost.__getitem__)
        return found

    def limited(self, gains: Gains) -> Raised:
        """`gains` with what limits each direction: a bound, a requirement that breaks if its group is raised by RAISE, or its own link."""
        cases, order = self._cases, list(range(len(self._cases)))
        assert isinstance(self._goal, LinkSoftness)
        self._anchor(gains, cases)
        blind = [k for k, case in enumerate(cases) if case.breaks(gains)]
        names, places = [""] * gains.shape[1], [-1] * gains.shape[1]
        of_sway = [False] * gains.shape[1]
        softest, bounds = self._goal.softest(gains), self._bound_of(gains)
        for group in self._moving(gains):
            if group[0] in bounds:
                for j in group:
                    names[j] = bounds[group[0]]
                continue
            raised = stiffer(gains, group, RAISE, 0.0, self._cascade)
            swaying = self._broken_by_sway(raised)
            broken = swaying or self._quickly_broken(raised, order, blind)
            for j in group:
                of_sway[j] = swaying is not None
                names[j], places[j] = broken or ((LINK, int(softest[j])) if softest[j] >= 0 else ("", -1))
        margins = tuple(at_once(lambda case: case.all_margins(gains), cases))
        return Raised(gains, margins, True, tuple(names), tuple(places), tuple(of_sway))

    def _moving(self, gains: Gains) -> list[list[int]]:
        """Groups of directions that have stiffness."""
        moving = acting(gains, self._member) & (gains[0] > 0)
        return [group for row in self._member if (group := np.flatnonzero((row > 0) & moving).tolist())]

    def proved(self, gains: Gains) -> Raised:
        """Gains of which no group of directions can be raised by RAISE without breaking a requirement; those that can are raised first.

        Loops are predicted until no direction is left to raise, or the gains are far from the last samples; then they are sampled. Where
        samples show a broken requirement that the prediction did not, the search goes back and checks the next raise by samples, then two,
        four, ….
        """
        cases, order = self._cases, list(range(len(self._cases)))
        self._anchor(gains, cases)
        blind = [k for k, case in enumerate(cases) if case.breaks(gains)]  # cases whose prediction errs
        groups = {group[0]: group for group in self._moving(gains)}
        free = list(groups)
        why: dict[int, tuple[str, int]] = {}
        known = set(free)  # directions tried with these gains; an entry of `why` may be of gains that were softer
        looked_at, to_look, careful = gains, math.inf if blind else 0, 1  # raises checked by samples before predictions are used again
        while True:
            left = [j for j in free if j not in why] or [j for j in free if j not in known]
            if looked_at is not gains and not (left and all(case.follows(gains) for case in cases)):
                if self._broken(gains, order) is None:
                    looked_at = gains
                    self._anchor(gains, cases)
                else:
                    gains, known = looked_at, set(free)
                    to_look, careful = careful, 2 * careful
                    why.clear()
                continue
            if not left:
                break
            share = stiffness(gains, self._cascade) / self._unit
            j = min(left, key=lambda j: share[j])
            known.add(j)
            if share[j] * RAISE > self._most:
                why[j] = "", -1
                continue
            if self._bounds.on("kp_max", gains)[j]:
                why[j] = "kp_max", -1
                continue
            raised, broken = self._raised(gains, groups[j], order, blind, to_look == 0)
            if raised is None:
                why[j] = broken
                continue
            gains, known = raised, set()
            why.pop(j, None)
            if to_look:
                looked_at, to_look = gains, to_look - 1
                self._anchor(gains, cases)
        first = {j: group[0] for group in groups.values() for j in group}
        kept = [j for j, (name, _) in why.items() if name not in BOUNDS]
        swaying = {j: broken for j in kept if (broken := self._broken_by_sway(stiffer(gains, groups[j], RAISE, 0.0, self._cascade)))}
        why |= swaying
        names, places = zip(*(why.get(first.get(j, -1), ("", -1)) for j in range(gains.shape[1])), strict=True)
        of_sway = [first.get(j, -1) in swaying for j in range(gains.shape[1])]
        return Raised(gains, tuple(at_once(lambda case: case.all_margins(gains), cases)), True, names, places, tuple(of_sway))

    def _raised(
        self, gains: Gains, which: Sequence[int], order: list[int], blind: Sequence[int], follow: bool
    ) -> tuple[Gains | None, tuple[str, int]]:
        """Gains with the directions `which` raised, or None with the requirement and case that break first.

        order   cases, those that broke last first; it is updated
        """
        first: tuple[str, int] | None = None
        for power in (0.0, 1.0):
            exact = self._bounds.within(stiffer(gains, which, RAISE, power, self._cascade))
            broken = self._quickly_broken(exact, order, blind)
            for found in (self._bounds.within(rounded(exact)), exact) if broken is None else ():
                broken = self._quickly_broken(found, order, blind) if follow else self._broken(found, order)
                if broken is None:
                    return found, ("", -1)
            assert broken is not None
            first = first or broken
            order.remove(broken[1])
            order.insert(0, broken[1])
        assert first is not None
        if self._bounds.on("kd_max", exact)[which].any():
            more = self._bounds.without(["kd_max"]).within(stiffer(gains, which, RAISE, 1.0, self._cascade))
            if self._broken(more, order) is None:
                return None, ("kd_max", -1)
        return None, first

    def _quickly_broken(self, gains: Gains, order: Sequence[int], blind: Sequence[int]) -> tuple[str, int] | None:
        """Requirement predicted to be broken, without new samples, and the index of the case; None where none is."""
        return self._first(lambda case: case.breaks(gains), [k for k in order if k not in blind])

    def _broken_by_sway(self, gains: Gains) -> tuple[str, int] | None:
        """First requirement predicted to be broken by sway alone, and the index of the case; None where there is none."""
        return next(((one.breaks(gains), k) for k, one in enumerate(self._cases) if one.breaks_by_sway(gains)), None)

    def _broken(self, gains: Gains, order: Sequence[int]) -> tuple[str, int] | None:
        """First requirement that is broken, and the index of the case; None where none is."""
        return self._first(lambda case: case.required.missed(case.margins(gains)), order)

    def _first(self, missed: Callable[[GainCase], str], order: Sequence[int]) -> tuple[str, int] | None:
        for k in order:
            name = missed(self._cases[k])
            self._progress()
            if name:
                return name, k
        return None


def _most(slopes: Slopes | None) -> float:
    """Largest shortfall of a requirement, negative where all are met; inf where a loop is unstable."""
    return math.inf if slopes is None else float(slopes.missed.max(initial=-NEAR))


def _hopeless(way: Sequence[float]) -> bool:
    """True if the least shortfall, listed after every step up to now, has stopped falling while far from 0."""
    return len(way) > STALLED and way[-1] > max(HOPELESS, LEFT * way[-1 - STALLED])
