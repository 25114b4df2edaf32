"""Implausible links: masses, lengths and inertias compared with each other to detect slips of units by a thousand.

The borders are physical, or far from all of 69 public URDFs of hands, arms, quadrupeds, humanoids and drones:

- a radius of gyration is less than half of a link's extent: public links of more than a hundredth of the robot's mass have 0.05 to 0.8 of
  the robot's size L, the extent of its joints and centres of mass at its zero posture, or the length of its longest chain
- mass over the cube of that radius: 1.3e5 kg/m³ of a solid ball of steel, 3.2e5 of tungsten, less of any other shape; robots as a whole
  have 70 to 2.3e4
- mass over L²: 1.6 to 60 kg/m² of public robots, 470 of the heaviest industrial arms, 0.05 of one of 40 g

What one link alone has wrong can stay inside them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import digits, first_of_many
from ..system.linear.arrays import Floats
from ..system.plausibility import NO_ROBOT, NO_SOLID
from .body import is_prismatic, library

COUNTS = 0.01
"""Least mass of a checked link relative to the robot's: sensor and tip dummies are lighter and have arbitrary inertia."""
SPREAD = 1.2
"""Largest radius of gyration of a link, relative to the robot's size."""
SMALL = 0.2
"""Least robot size [m] used in that comparison."""
POINT = 1e-4
"""Radius of gyration [m] below which a link was described as a point."""
DENSEST = 4e5
"""Largest mass over the cube of the radius of gyration [kg/m³], averaged over the links by mass."""
DENSE = 5e4
"""Largest mass over the cube of the radius of gyration [kg/m³] of a robot that is also heavy for its size."""
HEAVIEST = 1000.0
"""Mass over the square of the size [kg/m²] above which a robot is heavy for its size."""
LIGHTEST = 0.5
"""Mass over the square of the size [kg/m²] below which a robot is light for its size."""
LONGEST = 60.0
"""Largest robot size [m]."""
CENTIMETRES = 250.0
"""Size [m] up to which lengths in cm may explain a robot that is too large."""
LEAST = 0.05
"""Size [m] below which radii are not compared with it: a single link that turns about its centre has size 0."""
SLACK = 0.01
"""Rounding of file values (two or three digits), relative to the largest principal inertia."""


@dataclass(frozen=True)
class Solid:
    """One link as given in the file.

    mass     [kg]
    centre   of mass (3,) in the link's frame [m]
    moments  (3,) principal moments about the centre, ascending [kg m²]
    """

    name: str
    mass: float
    centre: Floats
    moments: Floats

    @property
    def radius(self) -> float:
        """Radius of gyration [m] about the axis of the largest inertia; NaN for a link without mass."""
        return math.sqrt(max(float(self.moments[2]), 0.0) / self.mass) if self.mass > 0 else math.nan


def link_doubts(model: Any, solids: Sequence[Solid]) -> tuple[str, ...]:
    """Warnings about implausible links, each with the unit that may have been meant; `model`: Pinocchio's, with every joint."""
    size, steps, turning = _lengths(model, solids)
    total = sum(one.mass for one in solids)
    moving = [one for one in solids if one.name in steps]
    heavy = [one for one in moving if one.mass >= COUNTS * sum(each.mass for each in moving) and one.mass > 0]
    if not heavy or size == 0:
        return ()
    if size > LONGEST:
        name, step = max(steps.items(), key=lambda one: one[1])
        unit = "mm" if size > CENTIMETRES else "cm, or mm"
        return (f"link {name!r} reaches {_m(step)} from the joint before it, and the robot {_m(size)}: {NO_ROBOT}; lengths in {unit}?",)
    light, big = total < LIGHTEST * size**2, total > HEAVIEST * size**2
    wide = max((one for one in heavy if one.name in turning), key=lambda one: one.radius, default=heavy[0])
    if size > LEAST and wide.name in turning and wide.radius > SPREAD * max(size, SMALL):
        meant = "its mass in t" if light else "its inertia in kg·cm², g·m² or kg·mm²"
        return (f"link {wide.name!r}: {_inertia(wide)} of a robot of {_m(size)}: {NO_ROBOT}; is {meant}?",)
    solid = [one for one in heavy if one.radius > POINT]
    if solid and _density(solid) > (DENSE if big else DENSEST):
        heaviest = max(solid, key=lambda one: one.mass)
        meant = "its mass in g" if big else "its inertia in t·m², or its mass in g"
        return (f"link {heaviest.name!r}: {_inertia(heaviest)}, denser than any metal: {NO_ROBOT}; is {meant}?",)
    if light:
        heaviest = max(heavy, key=lambda one: one.mass)
        whole = (
            f"all links have {digits(total, 'kg')} over {_m(size)}, link {heaviest.name!r} most of it with {digits(heaviest.mass, 'kg')}"
        )
        return (f"{whole}: {NO_ROBOT}; masses in t, or lengths in cm or mm?",)
    return ()


def impossible_inertias(solids: Sequence[Solid]) -> tuple[str, ...]:
    """Note about links with an inertia that no solid has (one principal moment exceeds the sum of the others); (): none."""
    total = sum(one.mass for one in solids)
    counted = [one for one in solids if one.mass >= COUNTS * total and one.radius > POINT]
    found = [
        f"{one.name!r} ({', '.join(digits(float(each)) for each in one.moments)} kg·m²)"
        for one in counted
        if one.moments[2] > (1 + SLACK) * (one.moments[0] + one.moments[1])
    ]
    why = "one principal moment is more than the other two together; taken as given"
    return (f"{NO_SOLID} of these links, {why}: {first_of_many(found)}",) if found else ()


def _m(length: float) -> str:
    return digits(length, "m")


def _inertia(one: Solid) -> str:
    return f"{digits(one.mass, 'kg')} and {digits(float(one.moments[2]), 'kg·m²')}, a radius of gyration of {digits(one.radius, 'm')}"


def _density(solids: Sequence[Solid]) -> float:
    """Density of a typical link [kg/m³], the mean by mass."""
    mass, radius = np.array([one.mass for one in solids]), np.array([one.radius for one in solids])
    share = mass / mass.sum()
    return float(share @ mass / (share @ radius**2) ** 1.5)


def _lengths(model: Any, solids: Sequence[Solid]) -> tuple[float, dict[str, float], set[str]]:
    """Robot size [m]; reach of each moving link from its joint and the joint before; names of links that turn.

    The position of the whole robot does not count.
    """
    pin = library("pinocchio", "Pinocchio")
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    chains = np.zeros(model.njoints)
    for joint in range(1, model.njoints):
        step = np.linalg.norm(model.jointPlacements[joint].translation) if model.parents[joint] else 0.0
        chains[joint] = chains[model.parents[joint]] + step
    places, steps, turning = [], dict[str, float](), set[str]()
    for one in solids:
        frame = model.frames[model.getFrameId(one.name, pin.FrameType.BODY)]
        centre = frame.placement.act(one.centre)
        if not frame.parentJoint:
            continue
        places += [data.oMi[frame.parentJoint].act(each) for each in (centre, frame.placement.translation)]
        if any(index and not is_prismatic(model.joints[index]) for index in model.supports[frame.parentJoint]):
            turning.add(one.name)
        joint = model.jointPlacements[frame.parentJoint].translation * bool(model.parents[frame.parentJoint])
        steps[one.name] = float(max(np.linalg.norm(each) for each in (centre, frame.placement.translation, joint)))
    extent = float(np.linalg.norm(np.ptp(np.array(places), axis=0))) if places else 0.0
    return max(extent, float(chains.max(initial=0.0))), steps, turning
