"""Sway of a robot in one state as a function of its joints' gains: its bands of frequencies, and its damping.

To first order in frequency times lag, and in the damping ratio itself, a slow mode (robot/sway.py) has the damping of Rayleigh's quotient,

    ζ = ½ ω Σ_j e_j c_j (kd_j/kp_j − τ_j)

with e_j the joints' shares in the stored energy, τ_j the lag of their torque, and c_j = K_j/(kp_j + K_j) the motors' part of the motion,
or 1 with encoders at the links. Of its slopes those by the mode's shape are left out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..system.assembly import Feedback
from ..system.linear.arrays import Floats
from ..system.loop import Loop
from ..system.system import System

if TYPE_CHECKING:
    from ..robot.sway import SlowMotion

FLOOR = 0.03
"""Least damping ratio of sway that recommended gains leave to a balance controller: by itself it decays, as a building does (0.01 to 0.05).
More costs stiffness: 0.1 asks for 4 N m/rad at the ankle of a Unitree G1, 0.03 for 33."""


@dataclass(frozen=True)
class SwayAt:
    """Sway with some gains.

    frequency   (k,) of its modes [rad/s]
    bands       (k, 2) their frequency bands [rad/s]
    damping     (k,) their damping ratios
    slope       (k, 2, n) the damping ratios' derivatives by ln of each joint's kp, and of its kd
    """

    frequency: Floats
    bands: Floats
    damping: Floats
    slope: Floats


class Swaying:
    """Sway of a robot in one state.

    motion   its slow motion
    system   with drives, delays and rate
    loop     gains (3, n) → the loop
    """

    def __init__(self, motion: "SlowMotion", system: System, loop: Callable[[Floats], Loop]) -> None:
        self._motion, self._loop, self._latest = motion, loop, system.lag
        self._feedback: Feedback = system.control.feedback
        self._lag = np.array(system.torque_lags)
        self._known: tuple[bytes, SwayAt] | None = None

    def at(self, gains: Floats) -> SwayAt:
        """Sway with gains (3, n); the last result is stored."""
        key = gains.tobytes()
        if self._known is None or self._known[0] != key:
            self._known = key, self._at(gains)
        return self._known[1]

    def _at(self, gains: Floats) -> SwayAt:
        parts = self._loop(gains).parts
        assert parts is not None
        found, bands = self._motion.sway(parts.controller, self._feedback, self._latest)
        kp, kd = gains[:2]
        stiffness = self._motion.model.stiffness
        part = np.ones(len(kp)) if self._feedback.link else np.divide(1.0, 1.0 + kp / stiffness)
        rate = np.divide(kd, kp, out=np.zeros(len(kp)), where=kp > 0)
        own = part * (rate - self._lag)
        frequency = np.array([one.frequency for one in found])
        share = np.array([one.held for one in found]).reshape(len(found), len(kp))
        half = 0.5 * frequency[:, None]
        whole = share @ own
        stiffer = share * part * (own - 0.5 * whole[:, None] - rate) - share * (1 - part) * own
        slope = np.stack([half * stiffer, half * share * part * rate], axis=1)
        return SwayAt(frequency, bands, half[:, 0] * whole, slope)
