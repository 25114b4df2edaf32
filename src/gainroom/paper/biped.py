"""The biped that ships with gainroom, standing in for the paper's: actuators as the paper's, posture and shapes of the links ours."""

from dataclasses import replace
from functools import cache
from importlib.resources import files

import numpy as np

from ..files.robot_yaml import parse_robot
from ..robot.linearize import linearize
from ..robot.model import RobotModel
from ..robot.spec import RobotSpec
from ..robot.tasks import Task, Tasks, tasks_of

EXAMPLE = "biped.yaml"
SUPPORTS = {"double": "double support", "left": "single support"}  # contact states of the example; in single support the right leg swings
JOINTS = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")  # of one leg, in the paper's order
NAMES = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in JOINTS)
COM_KP, COM_KD = np.array([50.0, 90.0, 200.0]), np.array([1.0, 5.0, 15.0])  # K'p [1/s²], K'v [1/s] in x, y, z; printed in Sec. IV-C


@cache
def biped() -> RobotSpec:
    """The example file. Raises GainroomError where Pinocchio is not installed."""
    return parse_robot((files("gainroom") / "files" / "examples" / EXAMPLE).read_text("utf-8"), EXAMPLE)


@cache
def standing(contact: str, rigid: bool = False) -> RobotModel:
    """The biped in the example's first posture (knees at 0.6 rad); `rigid`: without elasticity."""
    robot = biped().robot
    if rigid:
        size = len(robot.joint_names)
        robot = replace(robot, actuators=replace(robot.actuators, stiffness=np.full(size, np.inf), damping=np.zeros(size)))
    return robot.linearize(contact=contact)


def standing_so(q: np.ndarray) -> RobotModel:
    """The biped on both feet in posture `q`."""
    robot = biped().robot
    return linearize(robot.body, robot.actuators, q, robot.contacts["double"])


def com_tasks(model: RobotModel, rotors: bool = True, pelvis: bool = False) -> Tasks:
    """Control of the centre of mass, alone or with the pelvis's orientation besides, all gains 1; `rotors`: see tasks_of."""
    stack = [Task(name="com", kind="com", kp=1.0, kd=1.0)]
    if pelvis:
        stack.append(Task(name="pelvis", kind="orientation", frame="pelvis", kp=1.0, kd=1.0))
    return tasks_of(model, stack, rotors)
