"""Actuator entries of a robot file: motor and gearbox values, before name patterns assign them to joints."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ..errors import GainroomError


@dataclass(frozen=True)
class ActuatorEntry:
    """Motor, gearbox and drive values of one file entry, SI units as in Actuators and Drive; None: the entry does not give the value.

    motor_inertia   [kg m²], joint side; or rotor_inertia [kg m², motor side] with gear_ratio
    bandwidth, damping_ratio, delay   override the drive's
    gearbox         gearbox type (robot/gearbox_types.py), in place of stiffness and damping
    ranges          (low, high) of the given values, by name in Uncertainty
    actuator        name whose published figures the entry has (files/actuator_facts.py), and `published`, which of its values they are
    """

    motor_inertia: float | None = None
    rotor_inertia: float | None = None
    gear_ratio: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    motor_viscous: float | None = None
    link_viscous: float | None = None
    effort_limit: float | None = None
    bandwidth: float | None = None
    damping_ratio: float | None = None
    delay: float | None = None
    gearbox: str | None = None
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    actuator: str | None = None
    published: frozenset[str] = frozenset()

    def over(self, weaker: "ActuatorEntry") -> "ActuatorEntry":
        """This entry completed by `weaker`: values that this entry does not give are taken from `weaker`.

        Alternatives replace each other: motor_inertia and the pair rotor_inertia, gear_ratio; stiffness and gearbox type; all that is
        published of one actuator and of another. A replaced value loses its range.
        """
        given = {name: value for name, value in vars(self).items() if value is not None and name not in ("ranges", "published")}
        if self.actuator is not None:
            weaker = weaker.unpublished()
        if "motor_inertia" in given:
            weaker = replace(weaker, rotor_inertia=None, gear_ratio=None)
        elif "rotor_inertia" in given and "gear_ratio" in given:
            weaker = replace(weaker, motor_inertia=None)
        if "gearbox" in given:
            weaker = replace(weaker, stiffness=None, damping=None)
            given |= {name: given.get(name) for name in ("stiffness", "damping")}
        elif "stiffness" in given:
            weaker = replace(weaker, gearbox=None)
        replaced = {*given, *(["motor_inertia"] if "rotor_inertia" in given else [])}
        ranges = {name: pair for name, pair in weaker.ranges.items() if name not in replaced}
        published = weaker.published - replaced | self.published
        return replace(weaker, **given, ranges={**ranges, **self.ranges}, published=published)

    def unpublished(self) -> "ActuatorEntry":
        """Entry without the figures of its actuator."""
        ranges = {name: pair for name, pair in self.ranges.items() if name not in self.published}
        return replace(self, **dict.fromkeys(self.published), ranges=ranges, actuator=None, published=frozenset())

    def without_published_ranges(self, names: Sequence[str]) -> "ActuatorEntry":
        """Entry without the ranges `names` of published figures."""
        return replace(self, ranges={name: pair for name, pair in self.ranges.items() if name not in names or name not in self.published})

    def reflected(self, owner: str) -> float | None:
        """Motor inertia J_m on the joint side [kg m²]; None where the entry gives none.

        Raises GainroomError where only one of rotor_inertia and gear_ratio is given, or either beside motor_inertia.
        """
        halves = {"rotor_inertia": self.rotor_inertia, "gear_ratio": self.gear_ratio}
        given = [name for name, value in halves.items() if value is not None]
        if self.motor_inertia is not None and given:
            raise GainroomError(f"{owner}: {given[0]} has no meaning beside motor_inertia; give either")
        if self.motor_inertia is not None or not given:
            return self.motor_inertia
        if self.rotor_inertia is None or self.gear_ratio is None:
            missing = "gear_ratio" if self.gear_ratio is None else "rotor_inertia"
            raise GainroomError(f"{owner}: {given[0]} needs {missing}, or give motor_inertia (joint side) instead of both")
        return self.rotor_inertia * self.gear_ratio**2
