"""Eq. (4): what a joint under position control makes of reference, noise and disturbance, against its block diagram solved whole."""

import numpy as np

from ..system.loop import build_loop, closed_loop
from .joints import DRIVE, GAINS, joint_with_load
from .picture import AXIS, BodePicture
from .row import Row, compare

RATIO = 16.0
ROUNDING = 1e-9  # relative; both sides are closed forms, and |1 + L| is nowhere below a third of |L| + 1
INPUTS = {"reference": "P_d", "noise": "n", "disturbance": "d"}


def rows() -> list[Row]:
    """Largest deviation of each of the three terms over the axis of the Bode plots, relative."""
    joint, s = joint_with_load(RATIO), 1j * (omega := np.geomspace(*AXIS, 500))
    found = closed_loop(build_loop(joint, DRIVE, GAINS))
    gearbox = joint.stiffness + joint.damping * s
    motor = joint.motor_inertia * s**2 + gearbox
    link = joint.link_inertia * s**2 + gearbox
    current = DRIVE.bandwidth**2 / (s**2 + 2 * DRIVE.damping_ratio * DRIVE.bandwidth * s + DRIVE.bandwidth**2) * np.exp(-s * DRIVE.delay)
    law = GAINS.kp + s * GAINS.kd
    # Motor: (J_M s² + k) θ − k q = C e^{−sT} (D (P_d − n − θ) + d); link: (J_L s² + k) q = k θ.
    system = np.moveaxis(np.array([[motor + current * law, -gearbox], [-gearbox, link]]), 2, 0)
    driven = {"reference": current * law, "noise": -current * law, "disturbance": current}
    result = []
    for name, symbol in INPUTS.items():
        right = np.stack([driven[name], np.zeros_like(s)], axis=1)[:, :, None]
        solved = np.linalg.solve(system, right)[:, 0, 0]
        deviation = float(np.abs(getattr(found, name)(omega) / solved - 1).max())
        note = f"Eq. (4)'s term in {symbol}: largest relative deviation from Fig. 8's diagram solved whole; Fig. 9's joint and gains."
        result.append(compare(f"eq4.{name}.deviation", 0.0, deviation, "", ROUNDING, note))
    return result


def pictures() -> list[BodePicture]:
    """None: the paper has none."""
    return []
