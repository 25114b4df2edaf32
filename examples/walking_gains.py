"""Gains for the two steps of walking_plan.py, found by gainroom's own search: prints scheduled_gains.yaml.

    python examples/walking_gains.py        two to three minutes

Each contact state has the postures in which the plan has it, and their mirror images: 17 states. The requirements are those of the file,
weight included, for the set that is safe in all of them and for each contact state's own. The search is a local one: it begins with what it
finds for 5 of these states. From its usual beginning it leaves the weight out, as then it comes to no gains that meet the requirements.
"""

from dataclasses import fields, replace

import numpy as np
from walking_plan import Plan
from walking_run import biped, plan_of

from gainroom.design.gain_sets import RobotGains
from gainroom.design.robot_gains import recommend_robot
from gainroom.robot.robot import Posture, Robot
from gainroom.system.system import System

FEW = {"double": (0.0, 1.8), "left": (2.5,), "right": ()}
MOMENTS = {"double": (0.0, 1.8, 4.4, 5.6), "left": (1.8, 2.5, 3.2), "right": (5.6, 6.3, 7.0)}
"""At which the plan's postures are taken [s]."""
TURNED = np.array([-1, -1, 1, 1, 1, -1] * 2)
"""Of a leg's joints (hip yaw, roll, pitch, knee, ankle pitch, roll), in a mirror."""


class Walked(Robot):
    """The robot in those postures alone that a contact state has on the way; their names begin with its."""

    @property
    def states(self) -> tuple[tuple[str, str], ...]:
        return tuple((posture, posture.rstrip("0123456789")) for posture in self.postures)


def with_states(system: System, plan: Plan, at: dict[str, tuple[float, ...]]) -> System:
    """The system in the states of the plan at some moments."""
    other = {"double": "double", "left": "right", "right": "left"}
    found: dict[str, list[np.ndarray]] = {name: [] for name in at}
    for contact, moments in at.items():
        for moment in moments:
            joints = plan.joints[int(np.searchsorted(plan.time, moment - 1e-9))]
            for name, angles in ((contact, joints), (other[contact], TURNED * np.roll(joints, 6))):
                if not any(np.allclose(angles, known, atol=1e-6) for known in found[name]):
                    found[name].append(angles)
    source, body = system.source, system.source.body
    postures = {
        f"{name}{number}": Posture(body, dict(zip(body.joint_names, angles.tolist(), strict=True)))
        for name, rows in found.items()
        for number, angles in enumerate(rows)
    }
    values = {field.name: getattr(source, field.name) for field in fields(Robot)} | {"postures": postures}
    return replace(system, source=Walked(**values))


def text(gains: RobotGains) -> str:
    """As the file has it."""
    lines = []
    for name, one in (("everywhere", gains.everywhere), *gains.per_contact.items()):
        assert one is not None, f"no gains found for {name}: {gains.nearest}"
        lines += [f"{name}:", *(f"  {key}: [{', '.join(f'{value:.4g}' for value in getattr(one, key))}]" for key in ("kp", "kd"))]
    return "\n".join(lines)


if __name__ == "__main__":
    system = biped()
    plan = plan_of(system)
    few = recommend_robot(with_states(system, plan, FEW))
    print(text(recommend_robot(with_states(system, plan, MOMENTS), start=few)))
