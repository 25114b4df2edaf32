"""Gain limits of a robot with other gearboxes: how they are looked at where stiffness and damping are not known.

A gearbox is told by the resonance Ω of its motor with the output held, and by its damping ratio ζ:

    K = J Ω²,   B = 2 ζ J Ω        J motor inertia

A resonance of height k_d μ²/B, μ = J_L/(J_m + J_L), does harm where delay has turned its phase: so neither more stiffness nor more of it
with the same B need be safer. Looks along Ω are taken in steps that turn that phase by a sixth of a turn at most, and, where the limit
dips, at its lowest point. Each look is a certified gain limit and, where that is enough, a proof that gain and delay margins are kept, else
the margins of sampled curves; between looks nothing is proved.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..analysis.limbs import limbs_of
from ..analysis.modal_loop import ModalLoop
from ..analysis.proved_limit import keeps_margins, limit_by_modes, provable, proved_limit
from ..design.gain_cases import bounded_margins
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from ..system.requirement import enough
from ..system.requirements import Requirements
from ..system.system import StateCase, System
from .loop_numbers import LATE, extra_delay, limit_of, margins_of
from .state import State
from .sway import without_sway

FAR_BELOW = 0.01
"""Of gains that are not stable themselves: there the proof of their limit begins, if it can."""


@dataclass(frozen=True)
class Steps:
    """Where gearboxes are looked at."""

    turn: float = math.pi / 3  # [rad] of the resonance's phase, by the delay, from one look to the next
    factor: float = 1.3  # of Ω, at most
    most: float = 40.0  # Ω by the step from one to the next
    near: float = 1.5  # times what is required: a dip of the limit below that is followed to its lowest point
    dips: int = 3  # looks at most
    settled: float = 2e-3  # of the limit
    mixed: int = 6  # looks at gearboxes that differ


STEPS = Steps()


@dataclass(frozen=True)
class Gearboxes:
    """The gearboxes that are varied, once.

    resonance    Ω [rad/s] where all have the same; else NaN
    stiffness, damping   (n,) of all joints [N m/rad], [N m s/rad]; inf and 0 where a joint stays rigid
    gain_limit   the factor on all gains at which vibration starts, in the worst state; NaN: not known
    safe         all that is required is there in every state, proved or by sampled curves
    """

    resonance: float
    stiffness: Floats
    damping: Floats
    gain_limit: float
    safe: bool


class Looks:
    """Looks at the gearboxes of some joints of a system, in all its states, against the system's requirements.

    varied   (n,) joints with a motor's inertia
    parts    of every state its limbs that do not feel each other, whatever the gearboxes, or the whole: joints, and their loop
    """

    def __init__(self, system: System, states: Sequence[State], varied: Booleans) -> None:
        self.system, self.states, self.varied, self.required = system, states, varied, system.requirements
        self.inertia: Floats = system.source.quantities["motor_inertia"]
        self.parts = [limbs_of(state.loop) or [(np.arange(state.model.size), state.loop)] for state in states]

    @property
    def coupled(self) -> Floats:
        """(2, n) 1/μ = 1 + J W_ii: the least and the largest, over the states."""
        loads = [np.diagonal(state.model.link_inverse_inertia) for state in self.states]
        return 1 + self.inertia * np.array([np.min(loads, axis=0), np.max(loads, axis=0)])

    @property
    def kept(self) -> bool:
        """Whether it is proved, without samples, that the states have what is required with the gearboxes that they have."""
        return bool(self.parts) and all(_Limb(limb).keeps(self.required) for own in self.parts for _, limb in own)

    def step(self, omega: float, near: float) -> float:
        """From `omega` to the next softer look: at resonances of joints `near` times theirs; inf where no delay turns their phase."""
        lag = self.system.lag
        fine = max(STEPS.turn / (lag * near), omega / STEPS.most) if lag * near > 0 else math.inf
        return min(fine, omega * (1 - 1 / STEPS.factor))

    def at(self, omega: Floats | float, ratio: Floats | float) -> Gearboxes:
        """Every varied gearbox at Ω and a damping ratio, each a number for all or (n,)."""
        gearboxes = self.gearboxes(omega, ratio)
        limbs = self.limbs_with(*gearboxes)
        least = float(np.min([limb.first_factor for own in limbs for limb in own]))
        safe = enough(least, self.required.gain_margin or 1.0) and all(
            self.holds(state, own, *gearboxes) for state, own in zip(self.states, limbs, strict=True)
        )
        return Gearboxes(float(omega) if np.ndim(omega) == 0 else math.nan, *gearboxes, least, safe)

    def safe_at(self, omega: Floats | float, ratio: Floats | float) -> bool:
        """Whether they are safe there: without their limit where that is proved."""
        limbs = self.limbs_with(*self.gearboxes(omega, ratio))
        return all(limb.keeps(self.required) for own in limbs for limb in own) or self.at(omega, ratio).safe

    def gearboxes(self, omega: Floats | float, ratio: Floats | float) -> tuple[Floats, Floats]:
        """(n,) stiffness and damping of all joints."""
        joints = self.system.source.quantities
        stiffness = np.where(self.varied, self.inertia * np.square(omega), joints["stiffness"])
        return stiffness, np.where(self.varied, 2 * np.asarray(ratio) * self.inertia * omega, joints["damping"])

    def limbs_with(self, stiffness: Floats, damping: Floats) -> "list[list[_Limb]]":
        """The limbs of every state with these gearboxes, (n,) each."""
        return [[_Limb(limb.regeared(stiffness[joints], damping[joints])) for joints, limb in own] for own in self.parts]

    def holds(self, state: State, limbs: "Sequence[_Limb]", stiffness: Floats, damping: Floats) -> bool:
        """Whether a state has what is required: proved limb by limb, else by samples; a delay margin near what is needed is certified.

        A root on the boundary is one limb's, so that the delay margin is what those have of which it is not proved.
        """
        doubtful = [limb for limb in limbs if not limb.keeps(self.required)]
        if not doubtful:
            return True
        system = self.system.with_values(stiffness=stiffness, damping=damping)
        model = replace(state.model, stiffness=stiffness, damping=damping)
        case = StateCase(state.posture, state.contact, "", system, model)
        found = without_sway(case, bounded_margins(case, near=True))
        needed = self.required.delay_margin
        if needed is None or not found.delay_margin < LATE * needed:
            return self.required.met_by(found)
        others = self.required.met_by(replace(found, delay_margin=math.inf))
        return others and all(enough(extra_delay(limb.loop), needed) for limb in doubtful)


def lowest_point(x: Sequence[float], limits: Sequence[float]) -> float | None:
    """Of a parabola through three limits (logarithms), the middle one the least; None where it has none."""
    places, values = np.asarray(x) - x[1], np.log(limits)
    bend, slope, _ = np.polyfit(places, values, 2)
    return float(x[1] - slope / (2 * bend)) if bend > 0 else None


def first_factor(loop: Loop) -> float:
    """The smallest factor on all gains at which a loop vibrates; NaN where it is not known.

    The proof begins at rest and ends at the first crossing, so that of a part of unstable gains is theirs. Limbs that do not feel each
    other are asked one by one.
    """
    return float(np.min([_Limb(limb).first_factor for _, limb in limbs_of(loop)] or [_Limb(loop).first_factor]))


@dataclass(frozen=True)
class _Limb:
    """A loop that does not fall apart."""

    loop: Loop

    @cached_property
    def modal(self) -> ModalLoop | None:
        """By which something may be proved of it; None: nothing may."""
        return provable(self.loop)

    @cached_property
    def first_factor(self) -> float:
        """As above."""
        proved = None if self.modal is None else limit_by_modes(self.loop, self.modal)
        if proved is not None:
            return proved.gain
        proved = proved_limit(self.loop.scaled(FAR_BELOW))
        if proved is not None and proved.gain < math.inf:  # a proof from far below ends not far above
            return FAR_BELOW * proved.gain
        limit = limit_of(self.loop)
        return limit.gain if limit.stable or math.isnan(limit.gain) else min(limit.gain, 1.0)

    def keeps(self, required: Requirements) -> bool:
        """Whether it is proved that it meets all that is asked for; one joint's margins are known.

        What a robot keeps is what each of its limbs keeps: a root on the boundary is one limb's.
        """
        if self.loop.size == 1:
            return required.met_by(margins_of(self.loop))
        if self.modal is None or not set(required.asked) <= {"gain_margin", "delay_margin"}:
            return False
        return keeps_margins(self.loop, self.modal, required.gain_margin or 1.0, required.delay_margin or 0.0)
