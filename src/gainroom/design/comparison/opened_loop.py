"""Loop of one joint of a robot at one rate, all other joints' loops closed, as margins take it."""

import numpy as np

from ...system.assembly import controller_state
from ...system.feedback import Feedback
from ...system.linear.state_space import StateSpace
from ...system.loop import Loop
from ...system.system import System
from .exact_joint import COMMAND, SENSORS, ExactJoint
from .joint_responses import Opened


def opened_loop(opened: Opened, alone: System) -> Loop:
    """Loop of the joint `opened`, closed by the controller of `alone`, a system of that joint alone."""
    joint = ExactJoint.of(opened.parts, opened.joints[0])
    controller, feedback = alone.control.controller, alone.control.feedback
    if controller.laws:
        feedback = Feedback.of_law(controller.laws)
    law = controller_state(controller, 1, joint.sample_time)
    rows = [SENSORS.index(feedback.position)] * 2 + ([SENSORS.index("torque")] if controller.torque_name else [])
    plant = joint.state_space.between(np.array([COMMAND]), np.array(rows))
    whole = law @ plant
    poles = 1 + joint.sample_time * np.linalg.eigvals(plant.a)
    unstable = int(np.count_nonzero(np.abs(poles) > 1 + OUTSIDE))
    given = StateSpace(whole.a, whole.b, whole.c, np.zeros((1, 1)))
    return Loop(1, joint.sample_time, delays=np.zeros(1), given=given, unstable_poles=unstable)


OUTSIDE = 1e-7
"""Distance from the unit circle from which on a pole is outside, and no drift with its round-off."""
