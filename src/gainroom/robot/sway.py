"""Sway modes: motions of a floating base on its contacts that the joints' position gains alone hold, so their frequency → 0 with Kp.

Slow motion sees each motor's gain and its gearbox in series, K₀ = (Kp⁻¹ + K⁻¹)⁻¹, and the inertia of links and motors together,
W₀ = (W⁻¹ + J_m)⁻¹. Its modes obey W₀ K₀ φ = ω² φ: every one goes to 0 with Kp, as no resonance of a gearbox does. The links' torques
f = −(K₀ − ω² J_m) φ move the whole robot by v = P Sᵀ f / ω², base first, which tells how much of the motion is the base's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..system.controller import Controller, gain_matrix
from ..system.feedback import Feedback
from ..system.linear.arrays import Floats
from .contact import free_motion
from .model import RobotModel

BASE = 6
"""Number of velocities of a floating base, the first of a body's."""
LATE = 0.05
"""Phase [rad], 3°, that drives, delay and sampling may take at a mode's frequency: with more, delay takes part in the oscillation, and that
is a vibration."""
OF_BASE = 0.5
"""Least share of the base in the kinetic energy of a sway mode."""
NEAR = 1.5
"""Factor around a mode's frequency that contains its margins: with a damping ratio up to 0.65 the gain crossover is within it (ω_c²/ω² =
2ζ² + √(4ζ⁴ + 1)), and |S| of an undamped mode falls to r²/(r² − 1) = 1.8 at r = 1.5."""


@dataclass(frozen=True)
class SlowMode:
    """Slow mode of a robot whose joints' position gains act as springs.

    frequency   undamped [rad/s]
    of_base     the base's share of the kinetic energy, all bodies moving along with it
    joints      (n,) joint motion, the largest 1
    held        (n,) shares of the joints in the energy stored in gains and gearboxes, with the sum 1
    """

    frequency: float
    of_base: float
    joints: Floats
    held: Floats

    @property
    def sways(self) -> bool:
        """True if the base has at least OF_BASE of the kinetic energy."""
        return self.of_base >= OF_BASE


@dataclass(frozen=True)
class SlowMotion:
    """Slow motion of a floating robot on its contacts, whatever its gains.

    model    the linearised robot
    motion   (b, r) velocities of all bodies, base first, in the motions that the contacts leave
    links    (n, n) mobility of the joints, W
    """

    model: RobotModel
    motion: Floats
    links: Floats

    @classmethod
    def of(cls, model: RobotModel) -> "SlowMotion | None":
        """Slow motion of a model; None of a fixed base and in flight, where nothing sways."""
        if model.body.base == "fixed" or not model.contacts:
            return None
        motion = free_motion(model.inertia, model.held.jacobian)  # compliant contacts, too, hold the base: springs move little when slow
        joints = motion[len(model.inertia) - model.size :]
        return cls(model, motion, joints @ joints.T)

    def modes(self, controller: Controller, feedback: Feedback) -> tuple[SlowMode, ...]:
        """Modes on the gains of a controller, by rising frequency."""
        size, motors = self.model.size, np.diag(self.model.motor_inertia)
        joints = self.motion[len(self.model.inertia) - size :]
        held = gain_matrix("kp", controller.terms().get((0, 0), 0.0), size)
        if feedback.motor:
            held = np.linalg.solve(np.eye(size) + held / self.model.stiffness, held)
        squares, vectors = np.linalg.eig(np.linalg.solve(np.eye(size) + self.links @ motors, self.links @ held))
        found = []
        for square, vector in zip(squares, vectors.T, strict=True):
            if not square.real > 1e-12 * np.abs(squares).max() or abs(square.imag) > 1e-6 * square.real:
                continue  # no gain holds it, or tasks couple two of them
            mode = vector.real / vector.real[np.argmax(np.abs(vector.real))]
            whole = self.motion @ (joints.T @ ((held - square.real * motors) @ mode)) / square.real
            energy = whole @ self.model.inertia @ whole + mode @ motors @ mode
            base, stored = whole[:BASE], mode * (held @ mode)
            share = float(base @ self.model.inertia[:BASE, :BASE] @ base / energy)
            found.append(SlowMode(float(np.sqrt(square.real)), share, mode, stored / stored.sum()))
        return tuple(sorted(found, key=lambda one: one.frequency))

    def sway(self, controller: Controller, feedback: Feedback, lag: float) -> tuple[tuple[SlowMode, ...], Floats]:
        """Modes that sway, of loops with a lag [s] of drives, delay and sampling, and their frequency bands (k, 2) [rad/s]."""
        modes = self.modes(controller, feedback)
        found = tuple(one for one in modes if one.sways and lag * one.frequency <= LATE)
        return found, bands(modes, found)


def bands(modes: Sequence[SlowMode], which: Sequence[SlowMode]) -> Floats:
    """Frequency bands (k, 2) [rad/s] of the modes `which`: within a factor NEAR, and up to the geometric mean with other modes."""
    others = np.array([one.frequency for one in modes if not any(one is each for each in which)])
    found = []
    for one in which:
        below, above = others[others <= one.frequency], others[others >= one.frequency]
        low = max(one.frequency / NEAR, np.sqrt(one.frequency * below.max()) if len(below) else 0.0)
        high = min(one.frequency * NEAR, np.sqrt(one.frequency * above.min()) if len(above) else np.inf)
        found.append((low, high))
    return np.array(found).reshape(-1, 2)
