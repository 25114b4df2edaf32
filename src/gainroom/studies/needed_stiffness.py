"""How stiff gearboxes are seen to be safe where nobody has said it: the softest with which gains that are safe on rigid ones stay safe.

All gearboxes that are not known have one resonance Ω and damping ratio ζ (gearbox_looks.py). More stiffness need not be safer, so all
stiffer ones are looked at, too, up to where a resonance is too low to do harm at any phase. What is found is no bound: gearboxes that
differ are looked at a few times only, and others of them, each stiffer and more damped, may be unsafe.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..system.controller import own_gain
from ..system.linear.arrays import Booleans
from ..system.system import System
from .gearbox_looks import STEPS, Gearboxes, Looks, lowest_point
from .progress import Progress, quiet
from .state import State


@dataclass(frozen=True)
class Search:
    """How the softest is searched."""

    coarse: float = 2.0  # of Ω, below what is safe: for the table alone
    beyond: float = 2.0  # times the Ω from which on the resonance of a joint alone is too low to do harm
    far: float = 4.0  # times that: the stiffest
    fine: float = 1.005  # of Ω: 1 % of stiffness, to which the softest is found
    spread: float = 10.0  # of Ω among gearboxes that differ, each at least as stiff and as damped as is needed
    damped: float = 4.0  # of their damping ratio
    raised: float = 1.1  # Ω, where one of these is not safe
    tries: int = 12


SEARCH = Search()


@dataclass(frozen=True)
class NeededStiffness:
    """What was looked at, and what is needed.

    damping_ratio   ζ
    unknown     (n,) the gearboxes that are varied; False: known, or the motor's inertia is not
    looks       by falling stiffness, all at a common Ω
    least       the softest of them that is safe, as are all stiffer ones and all mixes above it that were looked at; None: there is none
    mixed       looks at gearboxes that differ, none softer or less damped than `least`, all of them safe
    """

    damping_ratio: float
    unknown: Booleans
    looks: tuple[Gearboxes, ...]
    least: Gearboxes | None
    mixed: int

    @property
    def unsafe(self) -> Gearboxes | None:
        """The next softer one that was looked at, which is not safe; None where all are safe, down to the stiffness of the gains."""
        return next((look for look in self.looks if not look.safe), None)


def unknown_gearboxes(system: System) -> Booleans:
    """(n,) True for those whose stiffness is looked for: of assumed rigid joints with a motor inertia; none where kd runs apart."""
    joints, actuators = system.source.quantities, getattr(system.source, "actuators", None)
    rigid = np.isinf(joints["stiffness"]) if actuators is None else actuators.assumed_rigid
    return rigid & (joints["motor_inertia"] > 0) & (system.control.kd_path is None)


def needed_stiffness(
    system: System,
    states: Sequence[State],
    damping_ratio: float,
    progress: Progress = quiet,
) -> NeededStiffness | None:
    """Of a system that is safe with rigid gearboxes; None where no rigid joint has a motor inertia, or kd runs apart."""
    unknown = unknown_gearboxes(system)
    if not unknown.any():
        return None
    search = _Search(system, states, damping_ratio, unknown, progress)
    return search.run()


class _Search:
    """Looks at gearboxes, the stiffest first."""

    def __init__(
        self,
        system: System,
        states: Sequence[State],
        damping_ratio: float,
        unknown: Booleans,
        progress: Progress,
    ) -> None:
        self.looks, self.margin = Looks(system, states, unknown), system.requirements.gain_margin or 1.0
        self.ratio, self.unknown, self.progress = damping_ratio, unknown, progress
        self.known: list[Gearboxes] = []

    def run(self) -> NeededStiffness:
        grid = self.grid()
        softer = iter(grid)
        safe: Gearboxes | None = None
        unsafe: Gearboxes | None = None
        for omega in softer:
            self.progress(len(self.known), len(grid) + STEPS.mixed, "stiffness of gearboxes")
            look = self.look(omega)
            unsafe = self.dip(look) if look.safe else look
            if unsafe is not None:
                break
            safe = look
        if unsafe is not None:
            safe = min((one for one in self.known if one.safe and one.resonance > unsafe.resonance), key=_resonance, default=None)
            safe = None if safe is None else self.halved(safe, unsafe)
        least = None if safe is None else self.any_mix(safe)
        last = math.inf if unsafe is None else unsafe.resonance
        for omega in softer:  # the table below what is safe
            if omega <= last / SEARCH.coarse or omega == grid[-1]:
                last = self.look(omega).resonance
        self.progress(1, 1, "")
        looks = tuple(sorted(self.known, key=_resonance, reverse=True))
        return NeededStiffness(self.ratio, self.unknown, looks, least, STEPS.mixed if least is not None else 0)

    def dip(self, last: Gearboxes) -> Gearboxes | None:
        """An unsafe one in a dip of the limit among the last three looks, where a parabola has its lowest point; None: none is found."""
        for _ in range(STEPS.dips):
            three = sorted(self.known, key=_resonance)
            three = three[three.index(last) :][:3]
            below = [one for one in self.known if one.resonance < last.resonance]
            limits = [one.gain_limit for one in three]
            if (
                len(three) < 3
                or below
                or not (limits[1] <= min(limits) and limits[1] < STEPS.near * self.margin and max(limits) < math.inf)
            ):
                return None
            place = lowest_point(np.log([one.resonance for one in three]).tolist(), limits)
            look = three[1] if place is None else self.look(math.exp(place))
            if not look.safe:
                return look
            if look.gain_limit > (1 - STEPS.settled) * limits[1]:
                return None
        return None

    def grid(self) -> list[float]:
        """Ω from where no resonance is high enough to do harm down to the stiffness of the gains, kp = K."""
        inertia, (least, most) = np.where(self.unknown, self.looks.inertia, math.inf), self.looks.coupled
        kp, kd = np.zeros((2, len(inertia)))
        for state in self.looks.states:
            terms, size = state.controller.terms(), state.model.size
            for k in np.flatnonzero(self.unknown):
                kp[k], kd[k] = (abs(own_gain(terms.get(powers, 0.0), int(k), size)) for powers in ((0, 0), (1, 0)))
        harmful = SEARCH.beyond * self.margin * kd / least**2 / (2 * self.ratio * inertia)
        softest = math.sqrt(float(np.max(kp / inertia))) or float(harmful.max()) / 100
        omega = max(float(harmful.max()), SEARCH.far * softest)
        points = [SEARCH.far * omega]
        while omega > softest:
            points.append(omega)
            omega -= self.looks.step(omega, math.sqrt(float(most[harmful >= omega].max(initial=0.0))))
        return [*points, softest]

    def look(self, omega: float) -> Gearboxes:
        """All unknown gearboxes at a common Ω."""
        self.known.append(self.looks.at(omega, self.ratio))
        return self.known[-1]

    def halved(self, safe: Gearboxes, unsafe: Gearboxes) -> Gearboxes:
        """The softest safe one between the two, but for SEARCH.fine."""
        while safe.resonance > SEARCH.fine * unsafe.resonance:
            look = self.look(math.sqrt(safe.resonance * unsafe.resonance))
            safe, unsafe = (look, unsafe) if look.safe else (safe, look)
        return safe

    def any_mix(self, least: Gearboxes) -> Gearboxes | None:
        """`least`, or what is stiffer by so much that gearboxes that differ are safe, too; None where none is found."""
        random = np.random.default_rng(0)
        parts = random.random((2, STEPS.mixed, len(self.unknown)))
        parts[0, 0] = np.arange(len(self.unknown)) % 2
        parts[0, 1] = 1 - parts[0, 0]
        ratios = self.ratio * SEARCH.damped ** parts[1]
        lowest = 0.0  # of the mixes that are not safe the highest of the softest in each: what is needed is more
        for _ in range(SEARCH.tries):
            mixes = least.resonance * SEARCH.spread ** parts[0]
            unsafe = next((mix for mix, ratio in zip(mixes, ratios, strict=True) if not self.looks.safe_at(mix, ratio)), None)
            lowest = lowest if unsafe is None else max(lowest, float(unsafe[self.unknown].min()))
            if unsafe is None and least.resonance > lowest:
                return least
            least = self.look(SEARCH.raised * max(least.resonance, lowest))
            if not least.safe:
                return None
        return None


def _resonance(one: Gearboxes) -> float:
    return one.resonance
