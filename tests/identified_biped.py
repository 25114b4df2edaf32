"""The biped from its joints' bench logs: true joints drawn at random, a log of each kind, what identification tells, and the robot of it.

Left and right joints are of one kind: six logs, twelve joints.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import gainroom as gr
from draws import log_uniform
from gainroom.files.identified_joint import identified_text
from gainroom.files.logs.reading import read_log
from gainroom.files.logs.writing import open_log
from gainroom.files.robot_yaml import parse_robot
from gainroom.identification import JointFit, Record, identify_joint
from gainroom.simulation import Friction, Scenario, Testbed, simulate
from gainroom.system.system import System
from gainroom.system.uncertainty import Uncertainty
from identified import SEED, multisine, soft_loop

TICK = 5e-4
KINDS = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
QUANTITIES = ("delay", "stiffness", "motor_inertia", "damping")
ROBOT = """\
model: {package: gainroom, file: biped.urdf, base: floating}
joints: {default: {motor_inertia: 1.0, stiffness: 1.0e4, damping: 1.0}}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
postures: {stand: {".*_hip_pitch": -0.3, ".*_knee": 0.6, ".*_ankle_pitch": -0.3}}
contacts: {double: [left_sole, right_sole]}
control: {type: pd, feedback: motor, sample_rate_hz: 2000, kp: 2000.0, kd: 100.0}
scenario:
  posture: stand
  duration: 1.0
  ground: {friction: 0.8, soles: {left_sole: {length: 0.28, width: 0.15}, right_sole: {length: 0.28, width: 0.15}}}
"""
Values = dict[str, np.ndarray]


@dataclass(frozen=True)
class Identified:
    """One kind of joint: what it is, what the log tells, and the joint.yaml's system."""

    joint: gr.ElasticJoint
    drive: gr.Drive
    fit: JointFit
    system: System


def bench(index: int, kind: int, folder: Path, seconds: float = 10.0) -> Identified:
    """A joint on its bench, loaded with twice its motor's inertia: multisine on slow motion, friction, encoder steps, noise, jitter."""
    rng = np.random.default_rng([SEED, 9, index, kind])
    motor, stiffness = log_uniform(rng, 0.6, 1.6), log_uniform(rng, 7e3, 1.5e4)
    resonance = math.sqrt(1.5 * stiffness / motor)
    joint = gr.ElasticJoint(motor, 2 * motor, stiffness, 2 * log_uniform(rng, 0.01, 0.04) * stiffness / resonance)
    drive = gr.Drive(float(rng.uniform(2500, 4500)), float(rng.uniform(0.7, 1.0)), float(rng.uniform(2, 5)) * TICK)
    time, size = TICK * np.arange(int(seconds / TICK)), 15 * (joint.motor_inertia + joint.link_inertia)
    torque = size * multisine(rng, time, np.geomspace(0.3 * joint.antiresonance / 2 / math.pi, resonance / math.pi, 60))
    bed = Testbed(
        soft_loop(joint, drive, 1.0, 0.7, TICK),
        motor_friction=Friction(0.05 * size, 0.06 * size, 0.05),
        link_friction=Friction(0.005 * size),
        motor_resolution=7.7e-6,
        jitter=0.3 * TICK,
        substep=TICK / 4,
    )
    motion = Scenario(
        0.4 * np.sin(0.4 * math.pi * time)[:, None], time[-1], feedforward=torque[:, None], noise=4e-6, seed=index, limit=50.0
    )
    run = simulate(bed, motion)
    measured = run.actual_torque + 0.01 * size * rng.standard_normal(run.actual_torque.shape)
    path = folder / f"{KINDS[kind]}.csv"
    with open_log(path, run.joint_names, ("target_torque", "demand_torque", "actual_torque", "motor_position")) as log:
        log.write(replace(run, actual_torque=measured).columns())
    read = read_log(path).joint()
    fit = identify_joint(Record(read.time, read.channels, read.sample_time))
    _, system, _ = identified_text(fit, path, None, "today", "0")
    return Identified(joint, drive, fit, system)


def robot_of(kinds: list[Identified]) -> System:
    """The biped with every joint as its kind's joint.yaml has it, intervals and all; `kinds` (6,), or one for all."""
    system = parse_robot(ROBOT, "biped")
    each = [kinds[place % len(kinds)] for place in places(system)]
    found = [one.system for one in each]
    quantities = [vars(one.source) | {"delay": one.drives[0].delay} for one in found]
    values = {name: np.array([one[name] for one in quantities]) for name in QUANTITIES}

    def ends(name: str) -> tuple[np.ndarray, np.ndarray]:
        low, high = zip(*(getattr(one.uncertainty, name) for one in found), strict=True)
        return np.array(low, dtype=float), np.array(high, dtype=float)

    system = replace(system.with_values(**values), uncertainty=Uncertainty(**{name: ends(name) for name in QUANTITIES}))
    loops = [one.drives[0] for one in found]
    return with_loops(system, [loop.bandwidth for loop in loops], [loop.damping_ratio for loop in loops])


def with_loops(system: System, bandwidths, ratios) -> System:
    """With other current loops, one per joint."""
    each = zip(system.drives, bandwidths, ratios, strict=True)
    return replace(system, drives=tuple(replace(drive, bandwidth=float(b), damping_ratio=float(r)) for drive, b, r in each))


def places(system: System) -> list[int]:
    """(n,) of each joint in KINDS."""
    return [next(place for place, kind in enumerate(KINDS) if name.endswith(kind)) for name in system.source.joint_names]


def drawn(rng: np.random.Generator, robot: System, kinds: list[Identified], ends: bool) -> System:
    """True parameters from within the intervals, those of the current loops too: every kind by itself, anywhere or (`ends`) at an end."""
    each = [place % len(kinds) for place in places(robot)]

    def shares() -> np.ndarray:
        return (rng.integers(0, 2, len(KINDS)).astype(float) if ends else rng.uniform(size=len(KINDS)))[each]

    values = {}
    for name in robot.uncertainty.names:
        low, high = getattr(robot.uncertainty, name)
        values[name] = low + shares() * (high - low)
    loops = []
    for name in ("bandwidth", "damping_ratio"):
        estimates = [getattr(kinds[place].fit.delay, name) for place in each]
        low, high = (np.array([getattr(one, end) for one in estimates]) for end in ("low", "high"))
        loops.append(low + shares() * (high - low))
    return with_loops(robot.with_values(**values), *loops)
