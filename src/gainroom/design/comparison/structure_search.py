"""Search for the best parameters of one structure that keep the ceilings everywhere in the box.

Local searches begin at the optimum of every smaller structure, and at the best of global searches, half of which know of these. They are
repeated with other seeds until the two best ends agree; the gap between them says how far the optimum may be trusted. Samples inside the
box at which a ceiling breaks join the corners, and the local search goes on.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...errors import GainroomError
from ...system.gain_path import GainPath
from ...system.linear.arrays import Floats
from ...system.system import System
from ...system.uncertainty import NOMINAL, Place, Uncertainty
from .ceilings import Ceilings
from .closed_loop import Corners, Merits
from .global_search import evolved
from .joint_responses import DRIVE, HOST, Joint
from .local_search import Polished, polished
from .objective import Objective
from .structures import Structure

STIFFNESS, LOAD = (0.8, 1.2), (0.5, 1.5)
"""Ranges, as factors on the nominal values, where a file has no uncertainty."""
RESERVE = 2e-4
"""Ln by which a search keeps its ceilings, so that they hold exactly where margins are worked out."""
DIGITS = 5
SAMPLES = 200
"""Seeded samples inside the box at which a winner is looked at."""
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
COARSE, FINE = 1.0, 3.0
"""Densities of the frequency grid of global and local search."""
POLISHED = 2
"""Members of each global search that a local search begins at."""
ROUNDS, AT_ONCE = 6, 3
"""Searches with samples that broke a ceiling among the corners, and how many of these join them at once."""
APART = 0.05


def boxed(system: System) -> System:
    """`system` with the default box where its file has no uncertainty: stiffness ± 20 %, load 0.5 to 1.5 times."""
    if system.uncertainty.names:
        return system
    joint = system.source
    ranges = {"link_inertia": tuple(factor * joint.link_inertia for factor in LOAD)}
    if math.isfinite(joint.stiffness):
        ranges["stiffness"] = tuple(factor * joint.stiffness for factor in STIFFNESS)
    return replace(system, uncertainty=Uncertainty(**ranges))


def corner_places(system: System) -> list[Place]:
    """Nominal place, then every corner of the box."""
    return [NOMINAL, *(place for place in system.uncertainty.corners if place != NOMINAL)]


def sample_places(system: System, count: int = SAMPLES) -> list[Place]:
    """Seeded places inside the box."""
    names = system.uncertainty.names
    return [tuple(one) for one in np.random.default_rng(0).random((count if names else 0, len(names))).tolist()]


@dataclass(frozen=True)
class Problem:
    """Task of every structure on one joint: its box, ceilings and objective.

    system      with its box
    ceilings, objective
    path        of the drive, for structures part of which runs there
    """

    system: System
    ceilings: Ceilings
    objective: Objective
    path: GainPath

    def joint(self, structure: Structure, place: Place) -> Joint:
        """Joint at a place of the box, as `structure` meets it."""
        known = self._joints.setdefault(structure.in_drive, {})
        if place not in known:
            known[place] = self.joint_of(structure, self.system.at(place))
        return known[place]

    def joint_of(self, structure: Structure, system: System) -> Joint:
        """Joint of `system`, as `structure` meets it; the drive's path has the same share of its delay in reserve as the host's."""
        reserves = {HOST: self.ceilings.delay_reserve}
        if not structure.in_drive:
            return Joint.of(system, reserves, None)
        share = self.ceilings.delay_reserve / system.delay if system.delay > 0 else 0.0
        return Joint.of(system, reserves | {DRIVE: share * self.path.delay}, self.path)

    @cached_property
    def _joints(self) -> dict[bool, dict[Place, Joint]]:
        """Joints made so far, of which the same places serve every structure."""
        return {}

    def corners(self, structure: Structure, places: Sequence[Place], density: float) -> Corners:
        """Sampled joints at `places`."""
        return Corners(structure, [self.joint(structure, place) for place in places], self.ceilings, self.objective, density)


@dataclass(frozen=True)
class Found:
    """Best parameters of a structure.

    structure   with its ranges
    x           coordinates (n,)
    objective   at the nominal values
    worst, at   largest objective over the corners, and its place
    excess      ln of the worst ceiling's value over the ceiling, over corners and samples
    gap         ln of the objective of the second best search over that of the best; NaN where only one kept the ceilings
    broken      place at which a ceiling breaks, None: none
    evaluated   closed loops looked at by the global searches
    places      at which the ceilings were held in the search: corners, and samples that broke one
    """

    structure: Structure
    x: Floats
    objective: float
    worst: float
    at: Place
    excess: float
    gap: float
    broken: Place | None
    evaluated: int
    places: tuple[Place, ...]

    @property
    def holds(self) -> bool:
        """True if every ceiling is kept at every corner and sample."""
        return self.broken is None


def searched(
    problem: Problem,
    structure: Structure,
    starts: Sequence[Floats] = (),
    places: Sequence[Place] | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Found | None:
    """Best parameters of `structure`, whose ranges are set; None where none was found that is stable at all `places`.

    places   corners, by default nominal and all of the box; NOMINAL alone: a search that knows of no box
    """
    boxed_in = places is None
    chosen = corner_places(problem.system) if places is None else list(places)
    coarse = problem.corners(structure, chosen, COARSE)
    fine = problem.corners(structure, chosen, FINE)
    begun = [one for start in starts if (one := polished(coarse, start, RESERVE, progress, FEW)) is not None]
    begun = sorted(begun, key=_rank)
    ends = _polished(fine, [one.x for one in begun[:POLISHED]], progress)
    for seed in range(MOST_SEEDS):
        hopeless = seed > SEEDS and not any(one.excess <= KEPT for one in ends)
        if seed >= SEEDS and (_gap(ends) < AGREED or hopeless):
            break
        known = [one.x for one in begun] if seed % 2 else []  # every other one knows nothing of smaller structures
        members, costs = evolved(coarse, seed, GENERATIONS * len(structure.parameters), known, RESERVE, progress)
        ends = sorted(ends + _polished(fine, _apart(members, costs), progress)[:1], key=_rank)
    if not ends:
        return None
    best, gap = ends[0], _gap(ends)
    broken = None
    if boxed_in:
        best, chosen, fine, broken = _inside(problem, structure, best, chosen, fine, progress)
    return _found(structure, best, fine, chosen, gap, broken, coarse.evaluated)


def held_harder(problem: Problem, found: Found, factor: float, progress: Callable[[], None] = lambda: None) -> Found | None:
    """`found`, searched on with the ceiling of the sensitivity divided by `factor`; None where that leads nowhere."""
    tighter = replace(problem, ceilings=replace(problem.ceilings, peak_sensitivity=problem.ceilings.peak_sensitivity / factor))
    places = list(found.places)
    best = polished(tighter.corners(found.structure, places, FINE), found.x, RESERVE, progress)
    if best is None or best.excess > KEPT:
        return None
    fine = problem.corners(found.structure, places, FINE)
    return _found(found.structure, best, fine, places, found.gap, found.broken, found.evaluated)


def _found(
    structure: Structure, best: Polished, fine: Corners, places: list[Place], gap: float, broken: Place | None, evaluated: int
) -> Found:
    x = rounded(structure, best.x)
    merits = fine.all(x[None])
    if not merits.stable[0] or merits.excess[0] > max(0.0, best.excess):
        x = best.x
    values = [math.exp(float(fine.one(x[None], k).objective[0])) for k in range(len(places))]
    corner = int(np.argmax(values))
    return Found(structure, x, values[0], values[corner], places[corner], best.excess, gap, broken, evaluated, tuple(places))


def rounded(structure: Structure, x: Floats) -> Floats:
    """Coordinates of parameters rounded to DIGITS digits, which people see and type in: the margins are those of the values in use."""
    return structure.coordinates({name: float(f"{value:.{DIGITS}g}") for name, value in structure.by_field(x).items()})


def _polished(corners: Corners, starts: Sequence[Floats], progress: Callable[[], None]) -> list[Polished]:
    """Ends of local searches, the best first."""
    found = [polished(corners, start, RESERVE, progress) for start in starts]
    return sorted((one for one in found if one is not None), key=_rank)


def _rank(one: Polished) -> tuple[bool, float, float]:
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


def _inside(
    problem: Problem, structure: Structure, best: Polished, places: list[Place], fine: Corners, progress: Callable[[], None]
) -> tuple[Polished, list[Place], Corners, Place | None]:
    """`best`, searched on with samples inside the box that break a ceiling; with the corners it then has, and a place that still breaks."""
    if best.excess > KEPT:
        worst = int(np.argmax([_excess(fine.one(best.x[None], k)) for k in range(len(places))]))
        return best, places, fine, places[worst]
    inside = sample_places(problem.system)
    looked = problem.corners(structure, inside, COARSE)
    for left in reversed(range(ROUNDS)):
        excesses = np.array([_excess(looked.one(best.x[None], k)) for k in range(len(inside))])
        worst = np.argsort(-excesses, kind="stable")[:AT_ONCE]
        if excesses[worst[0]] <= KEPT:
            return best, places, fine, None
        more = [*places, *(inside[k] for k in worst.tolist() if excesses[k] > KEPT and inside[k] not in places)]
        wider = problem.corners(structure, more, FINE)
        again = polished(wider, best.x, RESERVE, progress) if left and len(more) > len(places) else None
        if again is None or again.excess > KEPT:
            return replace(best, excess=float(excesses[worst[0]])), places, fine, inside[worst[0]]
        best, places, fine = again, more, wider
    raise AssertionError("the last round returns")


def _excess(merits: Merits) -> float:
    return float(merits.excess[0]) if merits.stable[0] else math.inf


def require_comparable(system: System) -> None:
    """Raise GainroomError for what cannot be compared: several joints, a loop without a rate, a link that no load moves."""
    if system.control.sample_time is None:
        raise GainroomError("control.sample_rate_hz is missing: structures are compared as they run, sampled")
    if len(system.drives) != 1:
        raise GainroomError(f"a comparison is of one joint, not of {len(system.drives)}")
    if math.isinf(system.source.link_inertia):
        raise GainroomError("a comparison needs a link that a load can move: joint.link_inertia is .inf")
