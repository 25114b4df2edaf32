"""Eqs. (5) to (10) on the biped: forces of the operational space as joint torques, and the joint gains that they amount to."""

from collections.abc import Iterator

import numpy as np

from ..robot.model import RobotModel, with_rotors
from ..system.linear.arrays import Floats
from .biped import COM_KD, COM_KP, SUPPORTS, com_tasks, standing
from .row import Row, compare

STEP = 1e-5  # [rad]
CURVED = 1e-3  # relative: x_d − x ≈ J (q_d − q) is off by about STEP over the angle, 0.1 rad or so, in which J changes by its own size
ROUNDING = 1e-8  # relative; linear systems with condition numbers of about 1e6


def rows() -> Iterator[Row]:
    """Rows in double and in single support."""
    for contact, support in SUPPORTS.items():
        model = standing(contact)
        tasks = com_tasks(model)
        reached = model.body.com_jacobian(model.q) @ _accelerations(model, tasks.torque)
        note = (
            f"Eqs. (7) and (8), Γ = JᵀΛ ẍ, in {support}: the centre of mass accelerates as asked, 1 m/s² in x, y or z and nothing across; "
            "links, rotors and contact forces solved whole."
        )
        deviation = float(np.abs(reached - np.eye(3)).max())
        yield compare(f"eq10.{contact}.acceleration_deviation", 0.0, deviation, "", ROUNDING, note)
        note = (
            f"Kpq q_e and Kvq q_e of eqs. (9) and (10) against JᵀΛ K'p x_e and JᵀΛ K'v x_e, relative, in {support}; x_e is the centre of "
            f"mass of a posture {STEP:g} rad away."
        )
        yield compare(f"eq10.{contact}.torque_deviation", 0.0, _torque_deviation(model), "", CURVED, note)


def _torque_deviation(model: RobotModel) -> float:
    """Largest relative difference of joint torques from joint gains and from task gains, over five errors that the contacts allow."""
    tasks = com_tasks(model)
    kpq, kvq = tasks.joint_gains(COM_KP, COM_KD)
    random = np.random.default_rng(0)
    deviations = []
    for _ in range(5):
        moved = tasks.follow @ random.standard_normal(model.size)  # eqs. (9) and (10) know no other errors
        joints = model.selection @ moved * STEP
        error = _com(model, moved * STEP) - _com(model, 0 * moved)
        for joint_gains, task_gains in ((kpq, COM_KP), (kvq, COM_KD)):
            asked = tasks.torque @ (task_gains * error)
            deviations.append(float(np.linalg.norm(joint_gains @ joints - asked) / np.linalg.norm(asked)))
    return max(deviations)


def _accelerations(model: RobotModel, torque: Floats) -> Floats:
    """Accelerations (N, m) of all coordinates under joint torques (n, m): inertia with rotors, contacts that do not accelerate."""
    inertia, contacts = with_rotors(model), model.contact_jacobian
    held = len(contacts)
    system = np.block([[inertia, contacts.T], [contacts, np.zeros((held, held))]])
    right = np.vstack([model.selection.T @ torque, np.zeros((held, torque.shape[1]))])
    return np.linalg.lstsq(system, right, rcond=1e-13)[0][: len(inertia)]


def _com(model: RobotModel, moved: Floats) -> Floats:
    """Centre of mass (3,) [m] after a small motion (N,)."""
    return model.body.com(model.body.integrate(model.q, moved))
