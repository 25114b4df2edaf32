"""Search for the best parameters of one structure that keep the ceilings everywhere in the box.

Local searches begin at the optimum of every smaller structure, and at the best of global searches, half of which know of these. They are
repeated with other seeds until the two best ends agree; the gap between them says how far the optimum may be trusted. Samples inside the
box at which a ceiling breaks join the corners, and the local search goes on.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...system.gain_path import GainPath
from ...system.linear.arrays import Floats
from .ceilings import Ceilings
from .closed_loop import Corners, Merits
from .compared_joint import ComparedJoint, Spot
from .global_search import evolved
from .joint_responses import DRIVE, HOST, Joint, Opened
from .local_search import Polished, polished
from .objective import Objective
from .structures import Structure

RESERVE = 2e-4
"""Ln by which a search keeps its ceilings, so that they hold exactly where margins are worked out."""
DIGITS = 5
KEPT = 1e-5
"""Ln by which a ceiling may be exceeded: round-off, and the height of a peak between samples."""
SEEDS, MOST_SEEDS = 2, 5
"""Fewest and most global searches of a structure."""
AGREED = 5e-3
"""Gap of the two best ends, in ln, at which no further one is made."""
FEW = 12
"""Steps of a local search from the optimum of a smaller structure before the best of these are followed to the end."""
GENERATIONS = 20
"""Generations of the global search per parameter."""
COARSE, FINE, FINEST = 1.0, 3.0, 12.0
"""Densities of the frequency grid of global search, of local search, and of what is said of its end."""
POLISHED = 2
"""Members of each global search that a local search begins at."""
ROUNDS, AT_ONCE = 6, 3
"""Searches with samples that broke a ceiling among the corners, and how many of these join them at once."""
APART = 0.05
WORSE = 5e-3
"""Ln by which the objective is worse in another state of a robot from which on the search goes on with that."""


@dataclass(frozen=True)
class Problem:
    """Task of every structure on one joint: its box, ceilings and objective.

    joint       with its box and states
    ceilings, objective
    path        of the drive, for structures part of which runs there
    """

    joint: ComparedJoint
    ceilings: Ceilings
    objective: Objective
    path: GainPath

    def at(self, structure: Structure, opened: Opened) -> Joint:
        """An opened joint as `structure` meets it; the drive's path has the same share of its delay in reserve as the host's."""
        reserves = {HOST: self.ceilings.delay_reserve}
        if not structure.in_drive:
            return Joint(opened, reserves, None)
        delay = float(opened.delays.max())
        share = self.ceilings.delay_reserve / delay if delay > 0 else 0.0
        return Joint(opened, reserves | {DRIVE: share * self.path.delay}, self.path)

    def spot(self, structure: Structure, spot: Spot) -> Joint:
        """Joint at a spot, as `structure` meets it."""
        return self.at(structure, self.joint.opened(spot))

    def corners(self, structure: Structure, spots: Sequence[Spot], density: float) -> Corners:
        """Sampled joints at `spots`."""
        return Corners(structure, [self.spot(structure, spot) for spot in spots], self.ceilings, self.objective, density)


@dataclass(frozen=True)
class Found:
    """Best parameters of a structure.

    structure   with its ranges
    x           coordinates (n,)
    objective   at the nominal values
    worst, at   largest objective over the corners, and its spot
    excess      ln of the worst ceiling's value over the ceiling, over corners and samples
    gap         ln of the objective of the second best search over that of the best; NaN where only one kept the ceilings
    broken      spot at which a ceiling breaks, None: none
    evaluated   closed loops looked at by the global searches
    spots       at which the ceilings were held in the search: corners, and samples that broke one
    """

    structure: Structure
    x: Floats
    objective: float
    worst: float
    at: Spot
    excess: float
    gap: float
    broken: Spot | None
    evaluated: int
    spots: tuple[Spot, ...]

    @property
    def holds(self) -> bool:
        """True if every ceiling is kept at every corner and sample."""
        return self.broken is None


def searched(
    problem: Problem,
    structure: Structure,
    starts: Sequence[Floats] = (),
    spots: Sequence[Spot] | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Found | None:
    """Best parameters of `structure`, whose ranges are set; None where none was found that is stable at all `spots`.

    spots   corners, by default nominal and all of the box; the nominal one alone: a search that knows of no box
    """
    boxed_in = spots is None
    chosen = problem.joint.corners if spots is None else list(spots)
    coarse = problem.corners(structure, chosen, COARSE)
    fine = problem.corners(structure, chosen, FINE)
    begun = [one for start in starts if (one := polished(coarse, start, RESERVE, progress, FEW)) is not None]
    begun = sorted(begun, key=rank)
    ends = _polished(fine, [one.x for one in begun[:POLISHED]], progress)
    for seed in range(MOST_SEEDS):
        hopeless = seed > SEEDS and not any(one.excess <= KEPT for one in ends)
        if seed >= SEEDS and (_gap(ends) < AGREED or hopeless):
            break
        known = [one.x for one in begun] if seed % 2 else []  # every other one knows nothing of smaller structures
        members, costs = evolved(coarse, seed, GENERATIONS * len(structure.parameters), known, RESERVE, progress)
        ends = sorted(ends + _polished(fine, _apart(members, costs), progress)[:1], key=rank)
    if not ends:
        return None
    best, gap = ends[0], _gap(ends)
    broken = None
    if boxed_in:
        best, chosen, fine, broken = _inside(problem, structure, best, chosen, fine, progress)
    return _found(problem, structure, best, fine, chosen, gap, broken, coarse.evaluated)


def held_harder(problem: Problem, found: Found, factor: float, progress: Callable[[], None] = lambda: None) -> Found | None:
    """`found`, searched on with the ceiling of the sensitivity divided by `factor`; None where that leads nowhere."""
    tighter = replace(problem, ceilings=replace(problem.ceilings, peak_sensitivity=problem.ceilings.peak_sensitivity / factor))
    spots = list(found.spots)
    best = polished(tighter.corners(found.structure, spots, FINE), found.x, RESERVE, progress)
    if best is None or best.excess > KEPT:
        return None
    fine = problem.corners(found.structure, spots, FINE)
    return _found(problem, found.structure, best, fine, spots, found.gap, found.broken, found.evaluated)


def _found(
    problem: Problem,
    structure: Structure,
    best: Polished,
    fine: Corners,
    spots: list[Spot],
    gap: float,
    broken: Spot | None,
    evaluated: int,
) -> Found:
    x = rounded(structure, best.x)
    merits = fine.all(x[None])
    if not merits.stable[0] or merits.excess[0] > max(0.0, best.excess):
        x = best.x
    every = list(dict.fromkeys([*spots, *problem.joint.elsewhere])) if len(spots) > 1 else spots
    finest = problem.corners(structure, every, FINEST)
    values = [math.exp(float(finest.one(x[None], k).objective[0])) for k in range(len(every))]
    corner = int(np.argmax(values))
    return Found(structure, x, values[0], values[corner], every[corner], best.excess, gap, broken, evaluated, tuple(spots))


def rounded(structure: Structure, x: Floats) -> Floats:
    """Coordinates of parameters rounded to DIGITS digits, which people see and type in: the margins are those of the values in use."""
    return structure.coordinates({name: float(f"{value:.{DIGITS}g}") for name, value in structure.by_field(x).items()})


def _polished(corners: Corners, starts: Sequence[Floats], progress: Callable[[], None]) -> list[Polished]:
    """Ends of local searches, the best first."""
    found = [polished(corners, start, RESERVE, progress) for start in starts]
    return sorted((one for one in found if one is not None), key=rank)


def rank(one: Polished) -> tuple[bool, float, float]:
    """Those that keep the ceilings first, by their objective; then by what exceeds them."""
    missed = one.excess > KEPT
    return missed, one.excess if missed else one.objective, one.objective


def _gap(ends: list[Polished]) -> float:
    kept = [one.objective for one in ends if one.excess <= KEPT]
    return kept[1] - kept[0] if len(kept) > 1 else math.nan


def _apart(members: Floats, costs: Floats) -> list[Floats]:
    """The best members, no two of them near each other."""
    found: list[Floats] = []
    for one, cost in zip(members, costs, strict=True):
        if np.isfinite(cost) and all(np.abs(one - other).max() > APART for other in found):
            found.append(one)
        if len(found) == POLISHED:
            break
    return found


def _everywhere(
    problem: Problem, structure: Structure, best: Polished, spots: list[Spot], fine: Corners, progress: Callable[[], None]
) -> tuple[Polished, list[Spot], Corners]:
    """`best`, searched on with the spots of a robot's other states at which the objective is worst; with the corners it then has."""
    elsewhere = problem.joint.elsewhere
    if not elsewhere:
        return best, spots, fine
    looked = problem.corners(structure, elsewhere, FINE)
    for _ in range(ROUNDS):
        merits = [looked.one(best.x[None], k) for k in range(len(elsewhere))]
        values = np.array([float(one.objective[0]) if one.stable[0] else math.inf for one in merits])
        worst = [elsewhere[k] for k in np.argsort(-values, kind="stable")[:AT_ONCE].tolist() if values[k] > best.objective + WORSE]
        more = [*spots, *(spot for spot in worst if spot not in spots)]
        if len(more) == len(spots):
            break
        wider = problem.corners(structure, more, FINE)
        again = polished(wider, best.x, RESERVE, progress)
        if again is None:
            break
        best, spots, fine = again, more, wider
    return best, spots, fine


def _inside(
    problem: Problem, structure: Structure, best: Polished, spots: list[Spot], fine: Corners, progress: Callable[[], None]
) -> tuple[Polished, list[Spot], Corners, Spot | None]:
    """`best`, searched on with samples inside the box that break a ceiling; with the corners it then has, and a spot that still breaks."""
    best, spots, fine = _everywhere(problem, structure, best, spots, fine, progress)
    if best.excess > KEPT:
        worst = int(np.argmax([_excess(fine.one(best.x[None], k)) for k in range(len(spots))]))
        return best, spots, fine, spots[worst]
    inside = problem.joint.samples
    looked = problem.corners(structure, inside, COARSE)
    for left in reversed(range(ROUNDS)):
        excesses = np.array([_excess(looked.one(best.x[None], k)) for k in range(len(inside))])
        worst = np.argsort(-excesses, kind="stable")[:AT_ONCE]
        if excesses[worst[0]] <= KEPT:
            return best, spots, fine, None
        more = [*spots, *(inside[k] for k in worst.tolist() if excesses[k] > KEPT and inside[k] not in spots)]
        wider = problem.corners(structure, more, FINE)
        again = polished(wider, best.x, RESERVE, progress) if left and len(more) > len(spots) else None
        if again is None or again.excess > KEPT:
            return replace(best, excess=float(excesses[worst[0]])), spots, fine, inside[worst[0]]
        best, spots, fine = again, more, wider
    raise AssertionError("the last round returns")


def _excess(merits: Merits) -> float:
    return float(merits.excess[0]) if merits.stable[0] else math.inf
