"""Postures of the biped on both feet, by where its centre of mass is and how its pelvis leans."""

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import GainroomError
from ..linear.arrays import Floats
from ..robot.body import RigidBody

SIDES = ("left", "right")
BENT = {"hip_pitch": -0.55, "knee": 1.1, "ankle_pitch": -0.55}  # where the search starts: knees forward
CLOSE = 1e-10  # [m, rad] Gauss–Newton converges quadratically here: another step would be round-off
LONGEST = 0.5  # step [rad] that does not turn the knees over


def on_both_feet(body: RigidBody, com: Floats, pitch: float, near: Floats | None = None) -> Floats:
    """The posture (nq,) with both soles flat at height 0, straight ahead under the hips, their origins (the ankles') at x = 0.

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
    """What is left to turn, in the frame's own axes [rad]."""
    return (Rotation.from_matrix(axes).inv() * wanted).as_rotvec()
