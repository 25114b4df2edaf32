"""One joint in two descriptions, gainroom's and that of the independent checks; examples with published numbers, and random ones."""

from math import cos, inf, sin

import numpy as np

import gainroom as gr
from independent import delay_roots, sampled
from independent.joint import PDJoint, random_joint

EXAMPLE = PDJoint(0.2, 0.8, 1e4, 1.0, kp=2000, kd=30, delay=2.5e-3, bandwidth=4000)
FIG9 = PDJoint(1.0, 16.0, 1e4, 1.0, kp=1e4, kd=300, delay=2e-3, bandwidth=4000)
TESTBED = PDJoint(0.2, 0.8, 1e4, 1.0, kp=1600, kd=77, delay=2.674e-3, bandwidth=4000)
TICK = 5e-4


def parts(joint: PDJoint) -> tuple[gr.ElasticJoint, gr.Drive]:
    described = gr.ElasticJoint(
        joint.motor_inertia,
        joint.link_inertia,
        joint.stiffness,
        0.0 if joint.rigid else joint.damping,
        joint.motor_viscous,
        joint.link_viscous,
    )
    return described, gr.Drive(joint.bandwidth, joint.damping_ratio, joint.delay)


def build(joint: PDJoint, sample_time: float | None = None) -> gr.Loop:
    return gr.build_loop(*parts(joint), gr.PD(joint.kp, joint.kd), feedback=joint.feedback, sample_time=sample_time)


def is_stable(joint: PDJoint, sample_time: float | None) -> bool:
    if sample_time is None:
        return delay_roots.count_unstable(joint) == 0
    return sampled.is_stable(joint, sample_time)


def stable_draw(seed: int) -> tuple[PDJoint, float | None]:
    """A random joint with gains shrunk until it is stable; every other one sampled, with a fractional delay."""
    rng = np.random.default_rng([20, seed])
    sample_time = None if seed % 2 else float(rng.uniform(0.25e-3, 2e-3))
    while True:
        joint = random_joint(rng)
        for _ in range(12):
            if is_stable(joint, sample_time):
                return joint, sample_time
            joint = joint.scaled(0.4)


RIGID = PDJoint(0.3, 0.7, inf, 0.0, kp=1.0, kd=1.0, delay=3e-3)  # J = 1


def rigid_boundary(omega: float) -> tuple[float, float]:
    inertia, angle = RIGID.motor_inertia + RIGID.link_inertia, omega * RIGID.delay
    return inertia * omega**2 * cos(angle), inertia * omega * sin(angle)
