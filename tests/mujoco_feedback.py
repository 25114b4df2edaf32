"""What an MJCF's actuators do, as MuJoCo itself computes it."""

from pathlib import Path

import mujoco


def compiled_feedback(path: Path) -> dict[str, tuple[float, float]]:
    """kp and kd of each joint as MuJoCo's own forces have them: their slopes in position and velocity at rest, by differences."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)

    def force(joint: int, q: float, v: float) -> float:
        mujoco.mj_resetData(model, data)
        data.qpos[joint], data.qvel[joint] = q, v
        mujoco.mj_forward(model, data)
        return float(data.qfrc_actuator[joint])

    step = 1e-6
    names = [model.joint(joint).name for joint in range(model.njnt)]
    return {
        name: (-(force(k, step, 0) - force(k, -step, 0)) / (2 * step), -(force(k, 0, step) - force(k, 0, -step)) / (2 * step))
        for k, name in enumerate(names)
    }
