"""Gearbox types: usual ranges of a joint's stiffness and damping where neither is measured.

Ranges are stated in motor quantities, so that one serves small and large joints: the resonance Ω = √(K/J) of the motor, J its inertia on
the joint side, on its gearbox with the output held; and the damping ratio ζ = B/(2 √(K J)). They are part of a system's Uncertainty.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import GainroomError, first_of_many, nearest
from ..system.linear.arrays import Booleans, Floats
from .name_patterns import select


@dataclass(frozen=True)
class GearboxType:
    """Gearbox type with the ranges (low, high) of its values.

    resonance      [rad/s], motor on its gearbox, output held
    damping_ratio  relative to critical damping
    source         of these numbers, in a few words
    """

    name: str
    resonance: tuple[float, float]
    damping_ratio: tuple[float, float]
    source: str


GUESS = "an engineering guess, without a source"
TYPES: dict[str, GearboxType] = {
    one.name: one
    for one in (
        # K/J: TALOS legs 10000 N·m/rad, at the hips 4000 in series, on 0.88 to 4.05 kg m²; HyQ 8077 on 0.572; WALK-MAN 31e3 on 0.548 (data
        # sheet), 75e3 on 1.10 (identified). ζ: HyQ 0.007, TALOS' knee 0.05, WALK-MAN 0.057, the joint of Jung et al. 0.005.
        GearboxType("harmonic", (40.0, 270.0), (0.005, 0.06), "published joints of TALOS, HyQ and WALK-MAN, ratios near 100"),
        GearboxType("planetary", (100.0, 1600.0), (0.01, 0.1), GUESS),
        GearboxType("cycloidal", (150.0, 1000.0), (0.01, 0.1), GUESS),
        GearboxType("belt", (60.0, 400.0), (0.01, 0.1), GUESS),
    )
}
"""Gearbox types by the name that --gearbox takes."""
WIND_UP = math.radians(5)
"""Largest angle [rad] by which a gearbox turns at its motor's peak torque: WALK-MAN's, with a torsion bar in series, turn by 3.6°."""
DIRECT = "direct"
"""The name for joints without a gearbox, which are rigid."""


@dataclass(frozen=True)
class TypedGearboxes:
    """Gearbox types given by options, per joint.

    types   (n,) type name; "" for a joint without one, or with a stiffness of its own
    known   joints that an option names but that keep their own stiffness
    """

    types: tuple[str, ...]
    known: tuple[str, ...] = ()

    def without_effect(self, option: str, source: object) -> list[str]:
        """Warning that `option` has no effect on joints whose stiffness is known from `source`; [] where there are none."""
        count = f"{len(self.known)} joints have their stiffness" if len(self.known) > 1 else "one joint has its stiffness"
        advice = "leave the stiffness out there to audit the range"
        return [f"{option} has no effect where {count} from {source}: {first_of_many(self.known)}; {advice}"] * bool(self.known)


def typed_gearboxes(typed: Sequence[str], joint_names: Sequence[str], given: Booleans, option: str) -> TypedGearboxes:
    """Gearbox types from options TYPE and PATTERN=TYPE, later ones winning; a joint whose stiffness is `given` (n,) keeps it.

    Raises GainroomError, which names the `option`, for an unknown type and a pattern that matches nothing.
    """
    types, known = [""] * len(joint_names), [False] * len(joint_names)
    for text in typed:
        pattern, _, name = text.rpartition("=")
        if name not in (*TYPES, DIRECT):
            raise GainroomError(f"{option} {text}: {name!r} is no type of gearbox{nearest(name, (*TYPES, DIRECT), 'type')}")
        for k in select(pattern, joint_names, f"{option} {text}") if pattern else range(len(joint_names)):
            known[k] = bool(given[k])
            types[k] = "" if known[k] else name
    return TypedGearboxes(tuple(types), tuple(itertools.compress(joint_names, known)))


def resonances(kind: str, inertia: float, peak: float) -> tuple[float, float]:
    """Range of a motor's resonance [rad/s] on a gearbox of this type: that of the type, above what WIND_UP allows.

    inertia   of the motor [kg m²]; peak: its published peak torque [N m], 0 where none is known
    """
    low, high = TYPES[kind].resonance
    return min(max(low, math.sqrt(peak / (WIND_UP * inertia)) if peak else 0.0), high), high


def ranges_of(types: Sequence[str], inertia: Sequence[float], peak: Sequence[float]) -> dict[str, tuple[Floats, Floats]]:
    """Intervals of an Uncertainty for gearboxes of `types` (n,), NaN where the type is ""; {} where all are "".

    inertia, peak   (n,) of the motors, as `resonances` has them
    """
    if not any(types):
        return {}
    ends = [
        (*resonances(kind, *motor), *TYPES[kind].damping_ratio) if kind else (math.nan,) * 4
        for kind, *motor in zip(types, inertia, peak, strict=True)
    ]
    low, high, least, most = np.array(ends).T
    return {"resonance": (low, high), "damping_ratio": (least, most)}


def middle(kind: str, inertia: float, peak: float) -> tuple[float, float]:
    """Stiffness [N m/rad] and damping [N m s/rad] at the geometric middle of a type's range, for a motor as `resonances` has it."""
    omega, ratio = (math.sqrt(low * high) for low, high in (resonances(kind, inertia, peak), TYPES[kind].damping_ratio))
    return inertia * omega**2, 2 * ratio * inertia * omega


def sources(types: Mapping[str, None], stiff_enough: Sequence[str]) -> list[str]:
    """Sentences for users: each type with its range and source; and joints that WIND_UP makes stiffer than their type."""
    found = []
    for one in map(TYPES.__getitem__, types):
        low, high = (f"{omega / (2 * math.pi):.0f}" for omega in one.resonance)
        least, most = (f"{100 * ratio:g}" for ratio in one.damping_ratio)
        found.append(
            f"{one.name} gearboxes: motors resonate at {low} to {high} Hz with the output held, damped by {least} to {most} % of critical "
            f"({one.source})"
        )
    if stiff_enough:
        angle = f"{math.degrees(WIND_UP):g}°"
        found.append(f"the gearboxes of {first_of_many(stiff_enough)} turn by at most {angle} at their motors' published peak torque")
    return found
