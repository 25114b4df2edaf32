"""Expected accuracy of a record before it is made: the Cramér–Rao bound of the model that identification fits.

A virtual log of the planned torque is made on the testbed; at the parameters that it was made with, the information of the predictions
(likelihood.py) is what no unbiased estimate can beat, and what maximum likelihood reaches on long records (Ljung, System Identification,
sec. 7.4). The delay's comes from the torques, as the current loop shows them. What identification adds to its intervals since no law of
friction and no clock is exact is added here too.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GainroomError
from ..simulation import Friction, Run, Scenario, Testbed, simulate
from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Floats
from ..system.system import System
from .current_loop import DAMPING, SPEED, Response
from .delay import FLOOR
from .estimate import FREEDOM, quantile
from .frequency_response import frequency_response
from .friction_estimates import damping_beside_friction
from .joint import DELAY_FLOOR, MODEL_ERROR, MODEL_ERROR_EXPLAINED, ROUGH_ROWS, likeliest, resonances
from .joint_model import JointModel, Prior
from .motion import STRIBECK_VELOCITIES, motion_of
from .prediction import Signals
from .residuals import explained_share

FASTEST = 20.0  # radians per tick: a current loop beyond it is over within the tick
MOVED = 1e-3  # of a tick, or of a logarithm, for differences
DRIFT, TURNING = 1e-3, 0.3  # of the torque noise and of friction: random walk per tick, and what no law of friction says near standstill
SETTLED = 5  # iterations from the true point, after which the noise is that of the record
LEAST_NOISE = 1e-6  # of the torque: a record without any is none
NAMES = ("motor_inertia", "link_inertia", "stiffness", "damping", "resonance", "antiresonance", "delay")
"""Parameters whose accuracy is predicted. Friction is left out: its accuracy depends on how far its law is from Coulomb's."""


@dataclass(frozen=True)
class Hardware:
    """Hardware between a joint and its log: friction, encoder and torque sensor.

    friction        Coulomb's, on the motor [N m]
    encoder_step    [rad] on the joint side
    torque_noise    standard deviation [N m] of the measured torque, and of the torque that acts beside the command
    link_friction   as friction, on the link
    """

    friction: float
    encoder_step: float
    torque_noise: float
    link_friction: float = 0.0

    @property
    def dry(self) -> float:
        """Coulomb friction of both sides [N m]."""
        return self.friction + self.link_friction


def virtual_log(system: System, torque: Floats, hardware: Hardware, seed: int = 0) -> Run:
    """Run of the testbed under feed-forward `torque` (m,) [N m], held at 0 by the system's controller."""
    tick = system.control.sample_time
    assert tick is not None
    bed = Testbed(
        system.loop(),
        motor_friction=Friction(hardware.friction),
        link_friction=Friction(hardware.link_friction),
        motor_resolution=hardware.encoder_step,
        link_resolution=hardware.encoder_step,
        substep=tick / 4,
    )
    ripple = hardware.torque_noise * np.random.default_rng([seed, 2]).standard_normal((len(torque), 1))
    return simulate(bed, Scenario(0.0, (len(torque) - 1) * tick, feedforward=torque[:, None], motor_torque=ripple, seed=seed))


def expected_widths(system: System, torque: Floats, hardware: Hardware) -> Mapping[str, float]:
    """Half-widths of the expected 95 % intervals, relative to the values, by NAMES.

    Raises GainroomError where the virtual log diverges.
    """
    run = virtual_log(system, torque, hardware)
    if run.diverged or not np.ptp(run.motor_reading):
        raise GainroomError(f"plan: under this torque the simulated joint {'diverges' if run.diverged else 'does not move: allow more'}")
    joint, drive, tick = system.source, system.drives[0], run.sample_time
    target, positions = run.target_torque[:, 0], run.motor_reading
    late = delay_error(target, drive.bandwidth * tick, drive.damping_ratio, drive.delay / tick, hardware.torque_noise)
    motion = motion_of(positions, False, tick, joint)
    signals = Signals(target, False, positions, motion, tick)
    model = JointModel.of(target, positions, drive, tick, True, True, (True, False, False))
    point = model.start(joint, drive.delay, signals)
    noise = max(hardware.torque_noise / model.torque, LEAST_NOISE)
    known = {
        "coulomb": hardware.friction / model.torque,
        "link_coulomb": hardware.link_friction / model.torque,
        "noise torque": math.log(noise),
        "noise drift": math.log(DRIFT * noise),
        "noise turning": math.log(max(TURNING * hardware.dry / model.torque, noise)),
        "noise reading 0": math.log(hardware.encoder_step / math.sqrt(12)),
    }
    point = np.array([known.get(name, value) for name, value in zip(model.names, point, strict=True)])

    prior = model.prior(point, (drive.delay / tick, math.hypot(late, DELAY_FLOOR)))
    variance = np.linalg.inv(likeliest(model, signals, point, prior, 0).information + np.diag(prior[1]))
    variance += _law_error(model, signals, joint, point, prior) if hardware.dry else model.law_error(point, MODEL_ERROR)
    estimates = model.estimates(point, variance) | resonances(point, variance)
    widths = {name: estimates[name].half_width / estimates[name].value for name in NAMES if name in estimates}
    # Upwards, as the interval ends at 0 where friction hides the damping.
    damping, _ = damping_beside_friction(estimates, motion.speed)
    widths["damping"] = (damping.high - joint.damping) / joint.damping if joint.damping else math.inf
    widths["delay"] = quantile(FREEDOM) * math.hypot(late, FLOOR) * tick / drive.delay if drive.delay else math.inf
    return {name: widths[name] for name in NAMES}


def _law_error(model: JointModel, signals: Signals, joint: ElasticJoint, point: Floats, prior: Prior) -> Floats:
    """Covariance (p, p) from friction, as in identification: residuals that follow the torque, and the effect of another law."""
    first = max(len(signals.torque) - ROUGH_ROWS, 0) // 2
    rows = slice(first, first + ROUGH_ROWS)
    other = replace(signals, motion=motion_of(signals.positions, False, signals.sample_time, joint, cautious=STRIBECK_VELOCITIES[0]))
    part = signals.rows(rows)
    best = likeliest(model, part, point, prior, SETTLED)
    difference = likeliest(model, other.rows(rows), best.parameters, prior, 1).parameters - best.parameters
    measured = frequency_response(part.torque, part.positions[:, 0], part.sample_time)
    explained = explained_share(best.errors, best.variances, part, measured)
    return np.outer(difference, difference) + model.law_error(point, MODEL_ERROR + MODEL_ERROR_EXPLAINED * explained)


def delay_error(target: Floats, speed: float, damping: float, delay: float, noise: float) -> float:
    """Standard error [ticks] of the delay between `target` (m,) [N m] and an actual torque with white `noise` [N m].

    speed, damping   ω_c in radians per tick and ζ of the current loop, which are fitted too, with a gain and an offset
    """
    point = np.array([delay, math.log(min(speed, FASTEST)), math.log(damping)])
    changes = np.diff(target, prepend=target[0])

    def actual(point: Floats) -> Floats:
        kernel = Response(point[0], math.exp(point[1]), math.exp(point[2])).kernel()
        return target[0] + np.convolve(changes, np.append(kernel, 1.0))[: len(target)] + _settled(changes, len(kernel) + 1)

    steps = MOVED * np.eye(3)
    slopes = [(actual(point + step) - actual(point - step)) / (2 * MOVED) for step in steps]
    columns = np.column_stack([*slopes, actual(point), np.ones(len(target))])
    information = columns.T @ columns / max(noise, LEAST_NOISE * float(np.std(target))) ** 2
    information[1, 1] += SPEED[1] ** -2
    information[2, 2] += DAMPING[1] ** -2
    scale = np.sqrt(np.diag(information))
    return float(np.linalg.inv(information / np.outer(scale, scale))[0, 0] ** 0.5 / scale[0])


def _settled(changes: Floats, ticks: int) -> Floats:
    """Sum (m,) of the changes that are older than `ticks`."""
    total = np.cumsum(changes)
    return np.concatenate([np.zeros(min(ticks, len(total))), total[:-ticks]])[: len(total)]
