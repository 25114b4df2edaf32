"""A robot's postures and contact states, nominal and at the corners of the uncertainty."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import case_in_words
from ..linear.arrays import Floats
from .spec import RobotSpec

if TYPE_CHECKING:
    from .model import RobotModel


@dataclass(frozen=True)
class StateCase:
    """One posture and contact state at one place in the uncertainty.

    place        as text; "" for the nominal case
    spec, model  of the robot there
    """

    posture: str
    contact: str
    place: str
    spec: RobotSpec
    model: "RobotModel"

    @property
    def title(self) -> str:
        """For messages."""
        return f"{self.posture}, {self.contact}" + (f" ({self.place})" if self.place else "")


def state_cases(spec: RobotSpec, weight: bool = False) -> Iterator[StateCase]:
    """Every posture and contact state, each nominal and then at every corner of the uncertainty; `weight`: see Robot.linearize."""
    uncertain = spec.uncertainty
    corners = [*itertools.product((0.0, 1.0), repeat=len(uncertain.names))] if uncertain.names else []
    for posture, contact in spec.robot.states:
        yield StateCase(posture, contact, "", spec, spec.robot.linearize(posture, contact, weight))
        for corner in corners:
            actuators, drives = uncertain.case(spec.robot.actuators, spec.drives, corner)
            moved = replace(spec, robot=replace(spec.robot, actuators=actuators), drives=drives)
            delays = np.array([drive.delay for drive in drives])
            values = {name: delays if name == "delay" else getattr(actuators, name) for name in uncertain.names}
            ends = dict(zip(uncertain.names, corner, strict=True))
            yield StateCase(posture, contact, _corner_text(values, ends), moved, moved.robot.linearize(posture, contact, weight))


def _corner_text(values: Mapping[str, Floats], ends: Mapping[str, float]) -> str:
    """Each quantity by its value, or by its end where joints differ."""
    return ", ".join(
        case_in_words({name: float(each[0])}) if np.all(each == each[0]) else f"{name.replace('_', ' ')} {'high' if ends[name] else 'low'}"
        for name, each in values.items()
    )
