"""The joints of the paper. What it prints stands beside the value; "inferred" marks what was recovered by matching its numbers."""

import cmath
import math
from dataclasses import replace

from ..analysis.gain_limit import gain_limit
from ..analysis.margin_record import GainLimit
from ..system.controller import PD
from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.loop import Loop, build_loop

MOTOR_INERTIA = 1.0  # [kg m²] Figs. 4, 5, 9: the printed 1.0e-4 behind the testbed's 100:1; inferred, Fig. 9's margins require it
STIFFNESS = 1e4  # [N m/rad] printed
DAMPING = 1.0  # [N m s/rad] printed
LOAD_RATIOS = (0.1, 1.0, 16.0)  # load-to-motor inertia, printed with Fig. 5
RATIO = 16.0  # of Figs. 4, 7 and 9: the largest of Fig. 5; inferred, Fig. 9's margins require it

DRIVE = Drive(bandwidth=4000.0, damping_ratio=0.9, delay=2e-3)  # inferred
GAINS = PD(kp=1e4, kd=300.0)  # inferred; Sec. IV-C names them for the biped's joints

TESTBED = ElasticJoint.from_motor(rotor_inertia=0.2e-4, gear_ratio=100, link_inertia=4 * 0.2, stiffness=STIFFNESS, damping=DAMPING)
TESTBED_KP, LARGEST_KV = 1600.0, 77.0  # [N m/rad], [N m s/rad] printed: the edge of stability, Sec. IV-B
CROSSOVER = 494.0  # [rad/s] printed: the phase crossover there
STABLE_KV, VIBRATING_KV = 70.0, 80.0  # [N m s/rad] the two trials of Fig. 11, printed
SAMPLE_TIME = 5e-4  # [s] the 2 kHz of Sec. IV


def _delay_of_crossover() -> float:
    """The delay T [s] that puts the testbed's phase crossover at the printed frequency: arg L₀ − ωT = −π, L₀ the loop without delay."""
    undelayed = build_loop(TESTBED, replace(DRIVE, delay=0.0), PD(TESTBED_KP, LARGEST_KV))
    return (math.pi + cmath.phase(complex(undelayed.response([CROSSOVER])[0]))) / CROSSOVER


TESTBED_DRIVE = replace(DRIVE, delay=_delay_of_crossover())  # inferred, 2.674 ms: 4 to 6 ticks of 0.5 ms are printed


def joint_with_load(ratio: float) -> ElasticJoint:
    """The joint of Figs. 4, 5 and 9 with `ratio` times the motor's inertia as load."""
    return ElasticJoint(MOTOR_INERTIA, ratio * MOTOR_INERTIA, STIFFNESS, DAMPING)


def rigid(joint: ElasticJoint) -> ElasticJoint:
    """Rigid joint with the same two inertias, eq. (1)."""
    return ElasticJoint(joint.motor_inertia, joint.link_inertia)


def torque_to_position(joint: ElasticJoint, delay: float = 0.0) -> Loop:
    """P_M e^{−sT} by itself, as the loop of a unit gain: Γ → P_M of eq. (2)."""
    return build_loop(joint, Drive(delay=delay), PD(1.0, 0.0))


def limit_with_load(load: float, gains: PD = GAINS, delay: float = DRIVE.delay) -> GainLimit:
    """The factor on `gains` at the edge of stability of the joint with a load of `load` [kg m²], with Fig. 9's drive; `delay` [s]."""
    return gain_limit(build_loop(joint_with_load(load / MOTOR_INERTIA), replace(DRIVE, delay=delay), gains))
