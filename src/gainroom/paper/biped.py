"""The biped that ships with gainroom, standing in for the paper's: actuators as the paper's, posture and shapes of the links ours."""

from functools import cache
from importlib.resources import files

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import GainroomError
from ..files.robot_yaml import parse_robot
from ..robot.body import RigidBody
from ..robot.linearize import linearize
from ..robot.model import RobotModel
from ..robot.tasks import Task, Tasks, tasks_of
from ..system.linear.arrays import Floats
from ..system.system import System

EXAMPLE = "biped.yaml"
SUPPORTS = {"double": "double support", "left": "single support"}  # contact states of the example; in single support the right leg swings
JOINTS = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")  # of one leg, in the paper's order
NAMES = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in JOINTS)
COM_KP, COM_KD = np.array([50.0, 90.0, 200.0]), np.array([1.0, 5.0, 15.0])  # K'p [1/s²], K'v [1/s] in x, y, z; printed in Sec. IV-C
MOVE = np.full(3, 0.06)  # [m] of the centre of mass, printed: 6.0 cm in x, y and z at once
START = np.array([-0.05, 0.0, 0.79])  # [m] inferred; from the ankles' line, the middle between the feet, the soles
SIDES = ("left", "right")
BENT = {"hip_pitch": -0.55, "knee": 1.1, "ankle_pitch": -0.55}  # where the search starts: knees forward
CLOSE = 1e-10  # [m, rad] Gauss–Newton converges quadratically here: another step would be round-off
LONGEST = 0.5  # step [rad] that does not turn the knees over


@cache
def biped() -> System:
    """System of the example file. Raises GainroomError if Pinocchio is not installed."""
    return parse_robot((files("gainroom") / "files" / "examples" / EXAMPLE).read_text("utf-8"), EXAMPLE)


@cache
def standing(contact: str, rigid: bool = False) -> RobotModel:
    """The biped in the example's first posture (knees at 0.6 rad); `rigid`: without elasticity."""
    robot = biped().source
    if rigid:
        robot = robot.with_quantities(stiffness=np.inf, damping=0.0)
    return robot.linearize(contact=contact)


def standing_so(q: Floats) -> RobotModel:
    """Biped on both feet in posture `q`."""
    robot = biped().source
    return linearize(robot.body, robot.actuators, q, robot.contacts["double"])


def com_tasks(model: RobotModel, rotors: bool = True, pelvis: bool = False) -> Tasks:
    """Control of the centre of mass, alone or with the pelvis's orientation besides, all gains 1; `rotors`: see tasks_of."""
    stack = [Task(name="com", kind="com", kp=1.0, kd=1.0)]
    if pelvis:
        stack.append(Task(name="pelvis", kind="orientation", frame="pelvis", kp=1.0, kd=1.0))
    return tasks_of(model, stack, rotors)


def free_loads(contact: str) -> Floats:
    """Load 1/W_ii of every joint with its neighbours free (12,) [kg m²]."""
    return 1 / np.diag(standing(contact).link_inverse_inertia)


def on_both_feet(body: RigidBody, com: Floats, pitch: float, near: Floats | None = None) -> Floats:
    """Posture (nq,) with both soles flat at height 0, straight ahead under the hips, their origins (the ankles') at x = 0.

    com     (3,) centre of mass over the middle between the feet [m]
    pitch   of the pelvis [rad], forward where positive; it neither rolls nor yaws
    near    a posture to start from

    Raises GainroomError where the legs do not reach.
    """
    neutral = body.neutral()
    soles = {f"{side}_sole": np.array([0.0, body.frame_placement(neutral, f"{side}_sole")[1][1], 0.0]) for side in SIDES}
    upright = Rotation.from_rotvec([0.0, pitch, 0.0])
    bent = {f"{side}_{joint}": angle for side in SIDES for joint, angle in BENT.items()}
    q = body.configuration(bent) if near is None else near
    for _ in range(60):
        errors, rows = [com - body.com(q)], [body.com_jacobian(q)]
        for frame, place in soles.items():
            axes, origin = body.frame_placement(q, frame)
            errors += [axes.T @ (place - origin), _turn(axes, Rotation.identity())]
            rows.append(body.frame_jacobian(q, frame))
        errors.append(_turn(body.frame_placement(q, "pelvis")[0], upright))
        rows.append(body.frame_jacobian(q, "pelvis")[3:])
        error = np.concatenate(errors)
        if np.linalg.norm(error) < CLOSE:
            return q
        step = np.linalg.lstsq(np.vstack(rows), error, rcond=1e-6)[0]
        q = body.integrate(q, step * min(1.0, LONGEST / np.linalg.norm(step)))
    raise GainroomError(f"biped: on both feet the centre of mass does not reach {com} with the pelvis at {pitch:g} rad")


def _turn(axes: Floats, wanted: Rotation) -> Floats:
    """Remaining rotation, in the frame's own axes [rad]."""
    return (Rotation.from_matrix(axes).inv() * wanted).as_rotvec()
