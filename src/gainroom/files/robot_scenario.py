"""Section `scenario` of robot.yaml: the move, and hardware effects beyond the linear model; and values by joint pattern."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import GainroomError, Together, nearest
from ..io.validation import Name, NotNegative, Positive, PositiveOrInfinite, Refusals, Section, each, number, refusal
from ..io.yaml_text import shown
from ..robot.contact import Contact
from ..robot.ground import Ground, Sole
from ..robot.name_patterns import DEFAULT, strongest
from ..robot.robot import RobotScenario
from ..system.linear.arrays import Floats

T = TypeVar("T")

PerJoint = Annotated[dict[str, T], BeforeValidator(lambda value: value if isinstance(value, dict) else {DEFAULT: value})]
"""One value for all joints, or one per pattern."""
Angle = Annotated[float, number(least=-1e4, most=1e4)]
Weight = Annotated[float, number(above=0, most=1e6)]
Several = Annotated[float | list[float], each(number(least=0))]
Springs = Annotated[float | list[float], each(number(above=0, infinite=True))]


Metres = Annotated[float, number(least=-1e3, most=1e3)]
Moves = Annotated[float | list[float], each(number(least=-1e3, most=1e3))]


def _ground(value: Any) -> Any:
    """Ground of a scenario: false means none, true the default ground."""
    if isinstance(value, bool):
        return {} if value else None
    if value is not None and not isinstance(value, dict):
        raise refusal(f"{shown(value)} must be true, false or a section")
    return value


class RobotMoveSection(Section):
    """Move of a task or of joints, from rest to rest along a quintic."""

    task: Name | None = None
    joint: Name | None = None
    by: Moves = Field(description="how far it goes [m, rad]; a number, or one per direction")
    duration: Annotated[float, number(above=0, most=3600)] = 1.0


class RobotFrictionSection(Section):
    """Friction on the motors' side, a number or one per pattern."""

    coulomb: PerJoint[NotNegative] = Field(default_factory=dict)
    viscous: PerJoint[NotNegative] = Field(default_factory=dict)


class SoleSection(Section):
    """Rectangle of one foot that touches the ground."""

    length: Positive = Field(Sole.length, description="along x of the frame [m]")
    width: Positive = Field(Sole.width, description="along y [m]")
    center: Annotated[list[Metres], Field(min_length=2, max_length=2)] = Field([0.0, 0.0])

    def sole(self) -> Sole:
        """Sole in SI."""
        return Sole(length=self.length, width=self.width, center=(self.center[0], self.center[1]))


class GroundSection(Section):
    """Ground on which feet may slip, and which they may leave."""

    friction: Positive = Ground.friction
    soles: dict[str, SoleSection] = Field({}, description="by contact frame")

    def ground(self, contacts: Mapping[str, Sequence[Contact]]) -> Ground:
        """Ground in SI, with the soles of the frames that touch it. Raises GainroomError for a sole of any other frame."""
        every = [contact for state in contacts.values() for contact in state]
        frames, wrong = tuple(dict.fromkeys(contact.frame for contact in every)), []
        for frame in self.soles:
            if frame not in frames:
                wrong.append(f"scenario.ground.soles: {shown(frame)} is no contact of this file{nearest(frame, frames, 'contact frame')}")
            elif all(contact.kind == "point" for contact in every if contact.frame == frame):
                wrong.append(f"scenario.ground.soles: {shown(frame)} is a point contact, which has no sole")
        if wrong:
            raise GainroomError(*wrong)
        return Ground(friction=self.friction, soles={frame: sole.sole() for frame, sole in self.soles.items()})


class RobotScenarioSection(Section):
    """Section `scenario`: the simulation of `gainroom simulate`."""

    posture: Name | None = None
    contact: Name | None = None
    duration: Annotated[float, number(above=0, most=3600)] = 2.0
    move: RobotMoveSection | None = None
    friction: RobotFrictionSection = RobotFrictionSection()
    torque_limit: PerJoint[PositiveOrInfinite] = Field(default_factory=dict)
    resolution: Annotated[float, number(least=0, most=1)] = 0.0
    ground: Annotated[GroundSection | None, BeforeValidator(_ground)] = None

    def refuse_unknown(self, postures: Sequence[str], contacts: Sequence[str], tasks: Sequence[str]) -> Refusals:
        """Refusals of names that the file does not have."""
        known = {"posture": postures, "contact": contacts, "move.task": tasks}
        asked = {name: getattr(self, name) for name in ("posture", "contact") if self.is_right(name)}
        if self.is_right("move") and self.move is not None and self.move.is_right("task"):
            asked["move.task"] = self.move.task
        for key, name in asked.items():
            if name is not None and name not in known[key]:
                yield refusal(f"{shown(name)} is none of the file's{nearest(name, known[key], key)}", key=f"scenario.{key}")

    def refuse_other_space(self, space: str) -> Refusals:
        """Refusals of a move in a space other than control.space."""
        if self.move is None:
            return
        other = "task" if space == "joint" else "joint"
        if getattr(self.move, space) is None:
            yield refusal(f"control.space is {space}: give {space}", key="scenario.move")
        elif getattr(self.move, other) is not None:
            yield refusal(f"control.space is {space}: give {space} alone, without {other}", key="scenario.move")

    def scenario(self, joint_names: Sequence[str], contacts: Callable[[], Mapping[str, Sequence[Contact]]]) -> RobotScenario:
        """Scenario in SI, for these joints (n) and contact states. Raises GainroomError for an unknown joint or contact."""
        move = self.move
        moved = {} if move is None else {"task": move.task, "joint": move.joint, "move_duration": move.duration}
        if move is not None:
            moved["by"] = tuple(np.atleast_1d(move.by).tolist())
        with Together() as together:
            step = together.step
            coulomb = step(lambda: _where_given(self.friction.coulomb, joint_names, "friction.coulomb", 0.0))
            viscous = step(lambda: _where_given(self.friction.viscous, joint_names, "friction.viscous", 0.0))
            limit = step(lambda: _where_given(self.torque_limit, joint_names, "torque_limit", math.inf))
            ground = step(lambda: None if self.ground is None else self.ground.ground(contacts()))
            return RobotScenario(
                posture=self.posture,
                contact=self.contact,
                duration=self.duration,
                coulomb=coulomb(),
                viscous=viscous(),
                torque_limit=limit(),
                resolution=self.resolution,
                ground=ground(),
                **moved,
            )


def _where_given(values: Mapping[str, float], joint_names: Sequence[str], key: str, otherwise: float) -> Floats:
    """Values (n,) of scenario.`key` by joint; `otherwise` where no pattern matches."""
    found = strongest(values, joint_names, f"scenario.{key}")
    return np.array([otherwise if value is None else value for value in found])
