"""Three joints on which controllers are compared: of the paper's figure 9, its testbed, and a stiff knee, sampled at 2 kHz."""

import math

import gainroom as gr
from gainroom.design.comparison.ceilings import Ceilings
from gainroom.design.comparison.joint_responses import HOST, Joint, opened
from gainroom.system.system import System

TICK = 5e-4
COUNT = 7.67e-6
"""Step of the encoder on the motor [rad]."""


def joint(inertia: float, load: float, stiffness: float, damping: float, delay: float, count: float = COUNT) -> System:
    """System of one joint without ranges; its gains do not matter."""
    drive = gr.Drive(4000.0, 0.9, delay, resolution=count)
    return System.of_joint(gr.ElasticJoint(inertia, load, stiffness, damping), drive, gr.PD(1.0, 1.0), sample_time=TICK)


def fig9() -> System:
    """Joint of the paper's figure 9."""
    return joint(1.0, 16.0, 1e4, 1.0, 2e-3)


def bench() -> System:
    """Joint of the paper's testbed."""
    return joint(0.2, 0.8, 1e4, 1.0, 2.174e-3)


def knee() -> System:
    """Knee whose gearbox is well damped: rotor of 1.9546e-4 kg m² behind 144:1."""
    return joint(1.9546e-4 * 144**2, 16.0, 1e4, 20.0, 2e-3, COUNT * 100 / 144)


def ceilings(system: System, noise: float | None = None) -> Ceilings:
    """Usual ceilings: Ms 2, half of the delay in reserve, `noise` [N m] from the encoder and a torque sensor of 0.05 N m."""
    sensed = {"motor": system.drives[0].resolution / math.sqrt(12), "torque": 0.05}
    return Ceilings(system.delay / 2, torque_noise=noise, sensor_noise=sensed)


def nominal(system: System) -> Joint:
    """The joint at its nominal values, as laws on the host meet it."""
    return Joint(opened(system), {HOST: system.delay / 2}, None)
