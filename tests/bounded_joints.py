"""Joints that bounds are tried on: the three that are compared, with their ceilings, and random ones with random PD gains."""

from dataclasses import dataclass

import numpy as np

from compared_joints import COUNT, TICK
from gainroom import PD, Drive, ElasticJoint, build_loop
from gainroom.design.comparison.ceilings import Ceilings
from gainroom.design.comparison.exact_joint import ExactJoint

STEP = COUNT / np.sqrt(12)  # rad, standard deviation of an encoder's quantisation


def exact(motor: float, link: float, stiffness: float, damping: float, delay: float) -> ExactJoint:
    joint, drive = ElasticJoint(motor, link, stiffness, damping), Drive(4000.0, 0.9, delay)
    return ExactJoint.of(build_loop(joint, drive, PD(1.0, 1.0), sample_time=TICK).parts)


PARAMETERS = {
    "fig9": (1.0, 16.0, 1e4, 1.0, 2e-3),
    "testbed": (0.2, 0.8, 1e4, 1.0, 2.174e-3),
    "knee": (1.9546e-4 * 144**2, 16.0, 1e4, 20.0, 2e-3),
}
CEILINGS = {
    "fig9": Ceilings(1e-3, torque_noise=1.38, sensor_noise={"motor": STEP}),
    "testbed": Ceilings(1.087e-3, torque_noise=0.142, sensor_noise={"motor": STEP}),
    "knee": Ceilings(1e-3, torque_noise=3.41, sensor_noise={"motor": STEP * 100 / 144}),
}


def box(name: str) -> list[ExactJoint]:
    """Corners of ± 20 % stiffness and 0.5 to 1.5 times the link's inertia."""
    motor, link, stiffness, damping, delay = PARAMETERS[name]
    return [exact(motor, load * link, soft * stiffness, damping, delay) for soft in (0.8, 1.2) for load in (0.5, 1.5)]


def random_joint(rng: np.random.Generator) -> tuple[ExactJoint, float]:
    """Resonance 3 to 100 Hz, delay 0.5 to 10 ms, link 0.1 to 30 motor inertias, damping ratio 0 to 5 %, and the delay."""
    resonance, delay = 2 * np.pi * 3 * (100 / 3) ** rng.random(), 5e-4 * 20 ** rng.random()
    motor = 0.05 * 40 ** rng.random()
    link = motor * 0.1 * 300 ** rng.random()
    reduced = motor * link / (motor + link)
    ratio = 0.05 * rng.random() * (rng.random() > 0.1)
    return exact(motor, link, reduced * resonance**2, 2 * ratio * reduced * resonance, delay), delay


@dataclass(frozen=True)
class Tried:
    """What one PD does to a joint, from the joint's own responses: the bound's theory has no part in it."""

    peak: float
    sensitivity: float
    delay_share: float
    noise: float


class Bench:
    """A joint on which PDs on the motor are tried."""

    def __init__(self, joint: ExactJoint) -> None:
        self.joint = joint
        self.angles = np.union1d(np.geomspace(1e-4, np.pi, 1200), np.linspace(2e-3, np.pi, 1200))
        self.response = joint.at(self.angles / joint.sample_time)

    def tried(self, kp: float, kd: float, reserve: float) -> Tried | None:
        """Peaks of |q/d|, |S| and |T| |1 − e^(−jωτ)|, and rms gain from encoder to torque; None where it is not stable."""
        step, response = self.joint.sample_time, self.response
        law = kp + kd * (1 - np.exp(-1j * self.angles)) / step
        sensitivity = 1 / (1 + law * response[:, 0, 0])
        space = self.joint.state_space
        a, b, motor = np.eye(len(space.a)) + step * space.a, step * space.b[:, :1], space.c[:1]
        closed = np.block([[a - b @ ((kp + kd / step) * motor), b * kd / step], [motor, np.zeros((1, 1))]])
        if np.abs(np.linalg.eigvals(closed)).max() >= 1:
            return None
        turn = self.angles * reserve / step
        share = np.abs(1 - sensitivity) * np.where(turn < np.pi, np.abs(1 - np.exp(-1j * turn)), 2.0)
        compliance = response[:, 1, 1] - response[:, 1, 0] * law * sensitivity * response[:, 0, 1]
        noise = np.sqrt(np.trapezoid(np.abs(law * sensitivity) ** 2, self.angles) / np.pi)
        return Tried(np.abs(compliance).max(), np.abs(sensitivity).max(), share.max(), noise)

    def random_pd(self, rng: np.random.Generator) -> tuple[float, float]:
        """Gains for 0.3 to 30 rad/s, and further damping, of the joint's whole inertia."""
        inertia = 1 / np.abs(self.response[0, 0, 0] * (self.angles[0] / self.joint.sample_time) ** 2)
        bandwidth = 0.3 * 100 ** rng.random()
        return inertia * bandwidth**2, 2 * 0.3 * 20 ** rng.random() * bandwidth * inertia
