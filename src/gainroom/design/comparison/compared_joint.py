"""The joint, or joints, whose controllers are compared, at every place where they are judged: in the box and, of a robot, in its states.

A single joint is the robot of one joint in one state. Of a robot, the loops of all other joints are closed by the gains of its file.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...errors import GainroomError, case_text, nearest
from ...system.assembly import Parts
from ...system.controller import PD
from ...system.elastic_joint import ElasticJoint
from ...system.system import System
from ...system.uncertainty import NOMINAL, Place, Uncertainty
from .joint_responses import Opened, opened

STIFFNESS, LOAD = (0.8, 1.2), (0.5, 1.5)
"""Ranges, as factors on the nominal values, where a file has no uncertainty; a robot's load is the robot."""
SAMPLES, OF_ROBOT = 200, 20
"""Seeded samples inside the box at which a winner is looked at: of a single joint, and of a robot beside the corners in all its states."""
TUNED, MOST_STATES = 8, 24
"""States of a robot that structures are tuned in, and that they are looked at in, the softest of its file."""
FRAGILE_STIFFNESS, FRAGILE_LOAD, FRAGILE_DELAY = (0.8, 1.0, 1.2), (0.5, 1.0, 1.5), (0.0, 5e-4)
"""Factors and extra delays [s] of the joints on which a design tuned at nominal is tried."""


class Spot(NamedTuple):
    """Place in the uncertainty, and the index of a state, 0 for the one that leads."""

    place: Place = NOMINAL
    state: int = 0


@dataclass(frozen=True)
class ComparedJoint:
    """One joint of a system, or several together.

    system   with its box
    index    of the joint, of several the first
    beside   indices of the joints that are compared together with it
    states   (posture, contact state) names, the softest first; structures are tuned in the first TUNED, and looked at in all
    """

    system: System
    index: int = 0
    states: tuple[tuple[str, str], ...] = (("", ""),)
    beside: tuple[int, ...] = ()

    @classmethod
    def of(
        cls, system: System, index: int = 0, states: Sequence[tuple[str, str]] | None = None, beside: Sequence[int] = ()
    ) -> "ComparedJoint":
        """Joint of `system` in `states`, the softest first, None: all; with the default box where the file has no uncertainty.

        That is stiffness ± 20 % of this joint and those `beside` it, together, and of a single one 0.5 to 1.5 times the load.
        """
        every = system.source.states if states is None else states
        return cls(_boxed(system, [index, *beside]), index, tuple(every[:MOST_STATES]), tuple(beside))

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices of all joints that are compared."""
        return (self.index, *self.beside)

    @property
    def apart(self) -> "list[ComparedJoint]":
        """The joints one by one."""
        return [replace(self, index=joint, beside=()) for joint in self.joints]

    @property
    def is_single(self) -> bool:
        """True if the system is a joint by itself, whose load is one of its numbers, and no robot."""
        return isinstance(self.system.source, ElasticJoint)

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.system.source.joint_names[self.index]

    @cached_property
    def alone(self) -> System:
        """The joint as a system of its own: of a robot with the inertia that it feels while all other joints are free, in the first state.

        What sizes parameters, and what people read of motor, gearbox, drive and box.
        """
        if self.is_single:
            return self.system
        k, system = self.index, self.system
        plant = system.source.linearize(*self.states[0])
        moved = plant.link_inverse_inertia[k, k]
        joint = ElasticJoint(
            float(plant.motor_inertia[k]),
            float(1 / moved) if moved > 0 else math.inf,
            float(plant.stiffness[k]),
            float(plant.damping[k]),
            float(plant.motor_viscous[k]),
            float(plant.link_viscous[k]),
            self.name,
        )
        control = system.control
        return System.of_joint(
            joint,
            system.drives[k],
            PD(0.0, 0.0),
            control.feedback.position,
            control.sample_time,
            system.requirements,
            _sliced(system.uncertainty, k, len(system.drives)),
        )

    @property
    def softest(self) -> list[Spot]:
        """Nominal place, then every corner of the box, in the first state."""
        return [Spot(place) for place in self._places]

    @property
    def corners(self) -> list[Spot]:
        """Spots that structures are tuned at: softest, then the nominal places of the next states."""
        return [*self.softest, *(Spot(NOMINAL, state) for state in range(1, min(TUNED, len(self.states))))]

    @property
    def elsewhere(self) -> list[Spot]:
        """Corners of the box in all states, but those that structures are tuned at."""
        tuned = set(self.corners)
        every = (Spot(place, state) for state in range(1, len(self.states)) for place in self._places)
        return [spot for spot in every if spot not in tuned]

    @cached_property
    def samples(self) -> list[Spot]:
        """Spots beside the corners: seeded ones inside the box and, of several states, the corners in all others."""
        names = self.system.uncertainty.names
        rng = np.random.default_rng(0)
        count = (SAMPLES if self.is_single else OF_ROBOT) if names else 0
        inside = [tuple(one) for one in rng.random((count, len(names))).tolist()]
        return [*self.elsewhere, *(Spot(place, k % len(self.states)) for k, place in enumerate(inside))]

    @property
    def proved(self) -> list[Spot]:
        """Spots at which margins of a winner are worked out, beside the corners: samples, of a robot the nominal places of other states."""
        return self.samples if self.is_single else [Spot(NOMINAL, state) for state in range(1, len(self.states))]

    @property
    def _places(self) -> list[Place]:
        return [NOMINAL, *(place for place in self.system.uncertainty.corners if place != NOMINAL)]

    def opened(self, spot: Spot) -> Opened:
        """The joint at a spot."""
        if spot not in self._opened:
            self._opened[spot] = self._open(self.system.at(spot.place), spot.state)
        return self._opened[spot]

    @cached_property
    def _opened(self) -> dict[Spot, Opened]:
        """Joints made so far, which serve every structure."""
        return {}

    def _open(self, system: System, state: int) -> Opened:
        if self.is_single:
            return opened(system)
        plant, control = system.source.linearize(*self.states[state]), system.control
        return Opened(Parts(plant, system.drives, system.controller(plant), control.feedback, control.sample_time), *self.joints)

    def perturbed(self) -> list[Opened]:
        """Joints with other stiffness and delay and, of a single one, load, else in three of its states: 18, or fewer."""
        values = self.system.source.quantities
        stiffness = np.broadcast_to(values["stiffness"], len(self.system.drives))
        delays = np.array([drive.delay for drive in self.system.drives])
        found = []
        for factor in FRAGILE_STIFFNESS:
            own = np.where(np.arange(len(stiffness)) == self.index, factor * stiffness, stiffness)
            for more in FRAGILE_DELAY:
                later = delays + more
                if self.is_single:
                    loads = [{"link_inertia": load * self.system.source.link_inertia} for load in FRAGILE_LOAD]
                    found += [self._open(self.system.with_values(delay=later, stiffness=own[0], **load), 0) for load in loads]
                else:
                    moved = self.system.with_values(delay=later, stiffness=own)
                    found += [self._open(moved, state) for state in range(min(3, len(self.states)))]
        return found

    def text(self, spot: Spot) -> str:
        """Spot in words; "" at the nominal values in the first state."""
        every = {} if spot.place == NOMINAL else self.system.uncertainty.values(spot.place)
        own = {name: float(np.broadcast_to(value, len(self.system.drives))[self.index]) for name, value in every.items()}
        known = {name: value for name, value in own.items() if math.isfinite(value)}
        state = f"{'/'.join(filter(None, self.states[spot.state]))}" if spot.state else ""
        return ", ".join(filter(None, [case_text(known), state]))

    def where(self, spot: Spot) -> str:
        """Spot in words."""
        return self.text(spot) or "the nominal values"


def _boxed(system: System, joints: Sequence[int]) -> System:
    if system.uncertainty.names:
        return system
    ranges, joint = {}, system.source
    if isinstance(joint, ElasticJoint):
        ranges["link_inertia"] = tuple(factor * joint.link_inertia for factor in LOAD)
        if math.isfinite(joint.stiffness):
            ranges["stiffness"] = tuple(factor * joint.stiffness for factor in STIFFNESS)
    else:
        stiffness = np.broadcast_to(joint.quantities["stiffness"], len(system.drives))
        own = np.isin(np.arange(len(stiffness)), joints) & np.isfinite(stiffness)
        if own.any():
            ranges["stiffness"] = tuple(np.where(own, factor * stiffness, stiffness) for factor in STIFFNESS)
    return replace(system, uncertainty=Uncertainty(**ranges))


def _sliced(uncertainty: Uncertainty, index: int, size: int) -> Uncertainty:
    """Ranges of one of `size` joints, those that it has."""
    ranges = {}
    for name in uncertainty.names:
        low, high = (float(np.broadcast_to(end, size)[index]) for end in getattr(uncertainty, name))
        if math.isfinite(high):
            ranges[name] = (low, high)
    return Uncertainty(**ranges)


def joint_index(system: System, name: str, owner: str = "joint") -> int:
    """Index of the joint of that name. Raises GainroomError, with the nearest name, where there is none."""
    names = system.source.joint_names
    if name not in names:
        raise GainroomError(f"{owner} {name!r}: the robot has no such joint{nearest(name, names, 'joint')}")
    return names.index(name)


def require_comparable(system: System, joints: Iterable[int] = (0,)) -> None:
    """Raise GainroomError for what cannot be compared.

    That is a loop without a rate, a link that no load moves, and of a robot joints that slide, and gains that do not close one loop each.
    """
    control = system.control
    if control.sample_time is None:
        clock = ", and drive.clock has to be left out" if control.continuous else ""
        raise GainroomError(f"control.sample_rate_hz is missing{clock}: structures are compared as they run, sampled")
    if isinstance(system.source, ElasticJoint):
        if math.isinf(system.source.link_inertia):
            raise GainroomError("a comparison needs a link that a load can move: joint.link_inertia is .inf")
        return
    if control.controller is None:
        raise GainroomError("control.space: a comparison needs joint, as gains of tasks close the loops of all joints together, not of one")
    if control.kd_path is not None:
        raise GainroomError("control.kd_path: a comparison of one joint needs the others' gains at one rate")
    for k in joints:
        if system.source.prismatic[k]:
            raise GainroomError(f"joint {system.source.joint_names[k]}: a comparison is of joints that turn, and this one slides")
