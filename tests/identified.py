"""Virtual logs with known truth: random joints, drives and motions on the package's testbed, as the columns of a log.

Populations run with `-m population`; another one: GAINROOM_SEED=7.
"""

import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np

import gainroom as gr
from draws import log_uniform
from gainroom.identification.estimate import Estimate
from gainroom.identification.record import Record
from gainroom.simulation import Friction, Run, Scenario, Testbed, simulate

SEED = int(os.environ.get("GAINROOM_SEED", "20171117"))


@dataclass(frozen=True)
class Case:
    """A log and what is true of it."""

    record: Record
    truth: dict[str, Any]


def multisine(rng: np.random.Generator, time: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Of unit standard deviation; frequencies [Hz]."""
    values = np.zeros(len(time))
    for frequency, phase in zip(frequencies, rng.uniform(0, 2 * np.pi, len(frequencies)), strict=True):
        values += np.sin(2 * np.pi * frequency * time + phase)
    return values / values.std()


def noisy(rng: np.random.Generator, values: np.ndarray, deviation: float, step: float) -> np.ndarray:
    """With white noise, rounded to `step`; 0: not rounded."""
    values = values + deviation * rng.standard_normal(len(values))
    return step * np.round(values / step) if step else values


def draw_elastic(rng: np.random.Generator, resonances: tuple[float, float]) -> gr.ElasticJoint:
    """Resonance [Hz] between two, damping ratio 0.5 to 5 %."""
    motor, ratio = log_uniform(rng, 0.02, 3.0), log_uniform(rng, 0.3, 8.0)
    resonance, damping = 2 * math.pi * log_uniform(rng, *resonances), log_uniform(rng, 0.005, 0.05)
    stiffness = resonance**2 * motor * ratio / (1 + ratio)
    return gr.ElasticJoint(motor, motor * ratio, stiffness, 2 * damping * stiffness / resonance)


def soft_loop(joint: gr.ElasticJoint, drive: gr.Drive, natural: float, damping: float, tick: float) -> gr.Loop:
    """PD that holds the whole joint at a natural frequency [Hz]."""
    inertia, omega = joint.motor_inertia + joint.link_inertia, 2 * math.pi * natural
    return gr.build_loop(joint, drive, gr.PD(inertia * omega**2, 2 * damping * inertia * omega), sample_time=tick)


def delay_case(index: int) -> Case:
    """Torques of a closed loop: steps, multisine or operation; with and without demand; jitter up to a tick (0.3 without demand)."""
    rng = np.random.default_rng([SEED, 1, index])
    tick = float(rng.choice([2.5e-4, 5e-4, 1e-3]))
    with_demand, whole = bool(rng.integers(2)), bool(rng.integers(2))
    ticks = float(rng.integers(1, 9)) if whole else float(rng.uniform(1, 8))
    most = 1.0 if with_demand else 0.0 if whole else 0.3
    jitter = min(float(rng.choice([0.0, most])), ticks)
    joint = draw_elastic(rng, (8.0, 40.0))
    drive = gr.Drive(log_uniform(rng, 0.6, 3.0) / tick, float(rng.uniform(0.5, 1.2)), ticks * tick)
    count, kind = int(rng.integers(4000, 16_000)), str(rng.choice(["steps", "multisine", "operation"]))
    time = np.arange(count) * tick
    if kind == "steps":
        held = int(rng.integers(12, 60))
        torque = 10 * rng.uniform(-1, 1, count // held + 1).repeat(held)[:count]
    elif kind == "multisine":
        torque = 8 * multisine(rng, time, np.linspace(1, 0.1 / tick, 40))
    else:
        torque = 8 * multisine(rng, time, np.exp(rng.uniform(np.log(0.3), np.log(5), 6)))
    bed = Testbed(
        soft_loop(joint, drive, 0.5, 1.0, tick),
        motor_friction=Friction(0.5, 0.7, 0.05),
        motor_resolution=1e-5,
        jitter=jitter * tick,
        whole_ticks=whole,
        substep=tick / 4,
    )
    run = simulate(bed, Scenario(0.0, (count - 1) * tick, feedforward=torque[:, None], noise=1e-5, seed=index, limit=50.0))
    if run.diverged:
        return delay_case(index + 2_000_000)
    columns = {"target_torque": run.target_torque[:, 0]}
    columns["actual_torque"] = noisy(rng, run.actual_torque[:, 0], log_uniform(rng, 0.005, 0.2), float(rng.choice([0.0, 0.01, 0.1])))
    if with_demand:
        columns["demand_torque"] = run.demand_torque[:, 0]
    truth = {"ticks": ticks, "bandwidth": drive.bandwidth, "damping_ratio": drive.damping_ratio, "kind": kind, "jitter": jitter}
    return Case(Record(run.time, columns, tick), truth)


def joint_case(index: int) -> Case:
    """A joint's log; see joint_run."""
    return joint_run(index)[0]


def joint_run(index: int) -> tuple[Case, Run]:
    """With the run behind it: a multisine of torque round the resonance on slow motion; friction, weight, encoder steps, noise, jitter."""
    rng = np.random.default_rng([SEED, 2, index])
    tick = float(rng.choice([5e-4, 1e-3]))
    joint = draw_elastic(rng, (8.0, 60.0))
    drive = gr.Drive(float(rng.uniform(1, 3)) / tick, float(rng.uniform(0.6, 1.0)), float(rng.uniform(1, 5)) * tick)
    count = int(rng.uniform(10, 25) / tick)
    time, inertia = np.arange(count) * tick, joint.motor_inertia + joint.link_inertia
    size = inertia * float(rng.uniform(5, 25))
    highest = min(2 * joint.resonance / 2 / math.pi, 0.2 / tick)
    torque = size * multisine(rng, time, np.geomspace(0.3 * joint.antiresonance / 2 / math.pi, highest, 60))
    reference = float(rng.uniform(0.2, 0.6)) * np.sin(2 * np.pi * float(rng.uniform(0.1, 0.3)) * time)
    coulomb, step = size * log_uniform(rng, 0.02, 0.15), log_uniform(rng, 1e-6, 3e-5)
    link_coulomb = coulomb * float(rng.uniform(0, 0.3))
    bed = Testbed(
        soft_loop(joint, drive, float(rng.uniform(0.5, 1.5)), 0.7, tick),
        motor_friction=Friction(coulomb, coulomb * float(rng.uniform(1, 1.4)), 0.05),
        link_friction=Friction(link_coulomb),
        gravity=float(rng.choice([0.0, 1.0])) * size * float(rng.uniform(0, 0.5)),
        motor_resolution=step,
        link_resolution=step,
        jitter=float(rng.choice([0.0, 0.3])) * tick,
        substep=tick / 4,
    )
    scenario = Scenario(
        reference[:, None], (count - 1) * tick, feedforward=torque[:, None], noise=step * float(rng.uniform(0, 1)), seed=index, limit=50.0
    )
    run = simulate(bed, scenario)
    if run.diverged:
        return joint_run(index + 1_000_000)
    columns = {"target_torque": run.target_torque[:, 0], "motor_position": run.motor_reading[:, 0]}
    columns["actual_torque"] = noisy(rng, run.actual_torque[:, 0], 0.01 * size, 0.0)
    if rng.integers(2):
        columns["demand_torque"] = run.demand_torque[:, 0]
    if index % 4 == 0:
        columns["link_position"] = run.link_reading[:, 0]
    truth = {name: getattr(joint, name) for name in ("motor_inertia", "link_inertia", "stiffness", "resonance", "antiresonance", "damping")}
    truth |= {"coulomb": coulomb, "link_coulomb": link_coulomb, "weight": bed.gravity, "delay": drive.delay, "tick": tick}
    truth |= {"ticks": drive.delay / tick, "jitter": bed.jitter / tick}
    return Case(Record(run.time, columns, tick), truth), run


def gains_case(index: int) -> Case:
    """A firmware's PD under set-points of a policy, a multisine or steps; target or actual torque, with and without a velocity."""
    rng = np.random.default_rng([SEED, 3, index])
    tick = float(rng.choice([5e-4, 1e-3, 2e-3]))
    joint = draw_elastic(rng, (10.0, 50.0))
    drive = gr.Drive(float(rng.uniform(0.8, 3)) / tick, 0.8, float(rng.uniform(0.5, 3)) * tick)
    inertia, omega = joint.motor_inertia + joint.link_inertia, 2 * math.pi * float(rng.uniform(0.8, 2.5))
    kp, kd = inertia * omega**2, 2 * float(rng.uniform(0.3, 1)) * omega * inertia
    count, kind, which = int(rng.uniform(8, 20) / tick), index % 3, int(rng.integers(3))
    time = np.arange(count) * tick
    if kind == 0:
        held = int(0.02 / tick)
        reference = np.repeat(np.cumsum(rng.normal(0, 0.05, count // held + 1)), held)[:count]
        reference -= np.linspace(0, reference[-1], count)
    elif kind == 1:
        reference = 0.14 * multisine(rng, time, rng.uniform(0.2, 5, 8))
    else:
        reference = np.repeat(rng.uniform(-0.3, 0.3, count // int(0.7 / tick) + 1), int(0.7 / tick))[:count]
    step, size, follows = log_uniform(rng, 1e-6, 1e-4), 0.2 * kp, bool(rng.integers(2))
    bed = Testbed(
        gr.build_loop(joint, drive, gr.PD(kp, kd), sample_time=tick),
        motor_friction=Friction(0.1 * size, 0.12 * size, 0.05),
        motor_resolution=step,
        gravity=float(rng.choice([0.0, 0.2])) * size,
        substep=tick / 4,
    )
    scenario = Scenario(reference[:, None], (count - 1) * tick, noise=0.3 * step, seed=index, reference_velocity=follows, limit=50.0)
    run = simulate(bed, scenario)
    if run.diverged:
        return gains_case(index + 3_000_000)
    columns = {"reference": run.reference[:, 0], "motor_position": run.motor_reading[:, 0]}
    if which == 0:
        columns["target_torque"] = run.target_torque[:, 0]
    else:
        columns["actual_torque"] = noisy(rng, run.actual_torque[:, 0], 0.02 * size, 0.0)
    if which == 2:
        velocity = np.gradient(run.motor_position[:, 0], tick)
        columns["motor_velocity"] = noisy(rng, velocity, 0.01 * float(np.std(velocity)), 0.0)
    return Case(Record(run.time, columns, tick), {"kp": kp, "kd": kd, "follows": follows})


def setpoint_case(index: int) -> Case:
    """Set-points that reach the sampled loop some whole ticks late, and the position."""
    rng = np.random.default_rng([SEED, 4, index])
    tick = float(rng.choice([1e-3, 2e-3]))
    inertia, omega = log_uniform(rng, 0.02, 2.0), 2 * math.pi * float(rng.uniform(3, 8))
    kp, kd = inertia * omega**2, 2 * float(rng.uniform(0.3, 0.9)) * omega * inertia
    loop_ticks, command_ticks = float(rng.uniform(1, 5)), int(rng.integers(0, 12))
    count = int(20 / tick)
    reference = 0.2 * multisine(rng, np.arange(count) * tick, rng.uniform(0.3, 20, 30))
    late = np.concatenate([np.full(command_ticks, reference[0]), reference])[:count]
    coulomb = kp * 0.3 * float(rng.uniform(0, 0.02))
    loop = gr.build_loop(gr.ElasticJoint(inertia / 2, inertia / 2), gr.Drive(delay=loop_ticks * tick), gr.PD(kp, kd), sample_time=tick)
    friction = Friction(coulomb, 1.2 * coulomb, 0.05) if coulomb else Friction()
    bed = Testbed(loop, motor_friction=friction, motor_resolution=log_uniform(rng, 1e-5, 3e-4), substep=tick / 4)
    run = simulate(bed, Scenario(late[:, None], (count - 1) * tick, reference_velocity=bool(index % 2), limit=50.0))
    if run.diverged:
        return setpoint_case(index + 4_000_000)
    columns = {"reference": reference, "motor_position": run.motor_reading[:, 0]}
    return Case(Record(run.time, columns, tick), {"loop": loop_ticks, "command": float(command_ticks), "follows": bool(index % 2)})


def holds(estimate: Estimate, value: float) -> bool:
    """The 95 % interval contains `value`."""
    return estimate.low <= value <= estimate.high


def coverage_bounds(count: int) -> tuple[float, float]:
    """Shares of intervals that hold between which a sample of a true share of 90 to 99 % lies but once in a thousand."""
    from scipy.stats import binom

    return float(binom.ppf(5e-4, count, 0.90)) / count, float(binom.ppf(1 - 5e-4, count, 0.99)) / count
