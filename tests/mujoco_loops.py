"""Constraints of closed loops and of a held base, as MuJoCo has them, and the plant that they leave."""

import mujoco
import numpy as np
import pinocchio


def solid(mass: float, size: float, at: str = "0 0 0") -> str:
    return f'<inertial pos="{at}" mass="{mass}" diaginertia="{mass * size**2} {1.2 * mass * size**2} {0.9 * mass * size**2}"/>'


def posed(text: str, body, q):
    """MuJoCo's model and data with the robot in posture q."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for index in range(model.njnt):
        at = model.jnt_qposadr[index]
        if model.jnt_type[index] == mujoco.mjtJoint.mjJNT_FREE:
            base = body.model.jointPlacements[1] * pinocchio.XYZQUATToSE3(q[:7])
            data.qpos[at : at + 7] = pinocchio.SE3ToXYZQUAT(base)[[0, 1, 2, 6, 3, 4, 5]]
            continue
        joint = body.model.joints[body.model.getJointId(model.joint(index).name)]
        here = q[joint.idx_q : joint.idx_q + joint.nq]
        data.qpos[at : at + joint.nq] = here[[3, 0, 1, 2]] if joint.nq == 4 else here
    mujoco.mj_forward(model, data)
    return model, data


def in_mujoco(text: str, body, q):
    """MuJoCo's mass matrix without the actuated joints' rotors, the rows of its constraints, and those that pick the actuated joints."""
    model, data = posed(text, body, q)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    places = [model.joint(name).dofadr[0] for name in body.joint_names]
    mass[places, places] -= model.dof_armature[places]
    equality = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    assert np.abs(data.efc_pos[equality]).max(initial=0.0) < 1e-8  # MuJoCo finds every loop closed, too
    return mass, data.efc_J.reshape(-1, model.nv)[equality], np.eye(model.nv)[places]


def projected(mass, rows, picked):
    """W of joints whose motion `rows` constrain: accelerations by unit torques, from the KKT equations of Gauss's principle."""
    size = len(mass)
    whole = np.block([[mass, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    return picked @ np.linalg.lstsq(whole, np.vstack([picked.T, np.zeros((len(rows), len(picked)))]), rcond=1e-12)[0][:size]
