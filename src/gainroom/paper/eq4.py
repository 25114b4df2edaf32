"""Eq. (4): what a joint under position control makes of reference, noise and disturbance, against its block diagram solved whole."""

from collections.abc import Iterator

import numpy as np

from ..system.closed_loop import closed_loop
from ..system.loop import build_loop
from .joints import DRIVE, GAINS, RATIO, joint_with_load
from .picture import AXIS
from .row import Row, compare

ROUNDING = 1e-9  # relative; both sides are closed forms, and |1 + L| is nowhere below a third of |L| + 1


def rows() -> Iterator[Row]:
    """Rows for reference, noise and disturbance: the largest relative deviation of eq. (4)'s term over the axis of the Bode plots."""
    joint, s = joint_with_load(RATIO), 1j * (omega := np.geomspace(*AXIS, 500))
    found = closed_loop(build_loop(joint, DRIVE, GAINS))
    gearbox = joint.stiffness + joint.damping * s
    motor = joint.motor_inertia * s**2 + gearbox
    link = joint.link_inertia * s**2 + gearbox
    current = DRIVE.bandwidth**2 / (s**2 + 2 * DRIVE.damping_ratio * DRIVE.bandwidth * s + DRIVE.bandwidth**2) * np.exp(-s * DRIVE.delay)
    law = GAINS.kp + s * GAINS.kd
    # Motor: (J_M s² + k) θ − k q = C e^{−sT} (D (P_d − n − θ) + d); link: (J_L s² + k) q = k θ.
    system = np.moveaxis(np.array([[motor + current * law, -gearbox], [-gearbox, link]]), 2, 0)
    for name, symbol, driven in (("reference", "P_d", current * law), ("noise", "n", -current * law), ("disturbance", "d", current)):
        right = np.stack([driven, np.zeros_like(s)], axis=1)[:, :, None]
        solved = np.linalg.solve(system, right)[:, 0, 0]
        deviation = float(np.abs(getattr(found, name)(omega) / solved - 1).max())
        note = f"Eq. (4)'s term in {symbol}: largest relative deviation from Fig. 8's diagram solved whole; Fig. 9's joint and gains."
        yield compare(f"eq4.{name}.deviation", 0.0, deviation, "", ROUNDING, note)
