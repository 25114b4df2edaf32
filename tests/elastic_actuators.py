"""Joints and a leg whose actuators trainers have, the limits that gainroom predicts, and the onset of vibration in a simulator's run."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from gainroom.analysis.gain_limit import gain_limit
from gainroom.system.controller import PD
from gainroom.system.drive import Drive
from gainroom.system.gain_path import GainPath
from gainroom.system.loop import build_loop
from gainroom.system.plant import Plant
from gainroom.trainers.elastic_delayed import ElasticDelayed

BESIDE = 0.03
"""Largest part by which factors lie beside the predicted limit: an onset that is further off is none at all, and fails."""
FIRST = 0.01
"""Speed with which joints start [rad/s]; every model here is linear at that size, and single precision has seven digits of it."""


@dataclass(frozen=True)
class Held:
    """Joints with fixed base and without gravity, their actuators and gains.

    xml         MJCF of the links by themselves, joints in the order of `actuators`
    posture     of the joints, where the set-points are, too [rad]
    actuators   by joint
    """

    xml: str
    posture: tuple[float, ...]
    actuators: dict[str, ElasticDelayed]
    kp: tuple[float, ...]
    kd: tuple[float, ...]

    def inertia(self) -> np.ndarray:
        """Inertia (n, n) of the links at the posture, by MuJoCo; with the motor's of rigid joints [kg m²]."""
        model = mujoco.MjModel.from_xml_string(self.xml)
        data = mujoco.MjData(model)
        data.qpos[:] = self.posture
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        for k in range(model.nv):  # column by column, as mj_fullM is called in two ways by releases in use
            unit, column = np.eye(model.nv)[k], np.zeros(model.nv)
            mujoco.mj_mulM(model, data, column, unit)
            full[:, k] = column
        return full + np.diag([each.motor_inertia if each.is_rigid else 0.0 for each in self.actuators.values()])

    def own_inertia(self) -> np.ndarray:
        """Inertia (n,) of each link by itself, the others free [kg m²]."""
        return 1 / np.diagonal(np.linalg.inv(self.inertia()))

    def limit(self) -> float:
        """Largest factor on all gains, as gainroom predicts it from the numbers of the actuators."""
        every = list(self.actuators.values())
        rigid = np.diag([each.motor_inertia if each.is_rigid else 0.0 for each in every])
        plant = Plant(
            np.linalg.inv(self.inertia() - rigid),
            np.array([each.motor_inertia for each in every]),
            np.array([each.gearbox_stiffness for each in every]),
            np.array([each.gearbox_damping for each in every]),
            np.array([each.viscous for each in every]),
        )
        drives = tuple(Drive(bandwidth=each.bandwidth, delay=each.delay) for each in every)
        first, size = every[0], len(every)
        path = GainPath(first.kd_delay or 0.0, first.kd_period or 0.0) if first.is_split else None
        gains = PD(self.kp[0], self.kd[0]) if size == 1 else PD(np.array(self.kp), np.array(self.kd))
        return gain_limit(build_loop(plant, drives, gains, first.encoder, first.period, path)).gain


def joint(inertia: float, kp: float, kd: float, actuator: ElasticDelayed) -> Held:
    """One joint with a link of an inertia [kg m²]."""
    body = f'<joint name="joint" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="0.01 {inertia} {inertia}"/>'
    xml = f"<mujoco><worldbody><body>{body}</body></worldbody></mujoco>"
    return Held(xml, (0.0,), {"joint": actuator}, (kp,), (kd,))


JOINTS = {
    "soft": joint(
        0.5, 150.0, 8.0, ElasticDelayed(motor_inertia=0.1, gearbox_stiffness=800.0, gearbox_damping=0.3, delay=3.3e-3, period=1e-3)
    ),
    "stiff": joint(
        0.8,
        1600.0,
        70.0,
        ElasticDelayed(
            motor_inertia=0.2, gearbox_stiffness=1e4, gearbox_damping=1.0, viscous=0.5, delay=2.174e-3, period=5e-4, bandwidth=4000.0
        ),
    ),
    "link": joint(
        1.5,
        200.0,
        10.0,
        ElasticDelayed(motor_inertia=0.3, gearbox_stiffness=5e3, gearbox_damping=4.0, delay=1.3e-3, period=1e-3, encoder="link"),
    ),
    "split": joint(
        0.3,
        300.0,
        5.0,
        ElasticDelayed(
            motor_inertia=0.04,
            gearbox_stiffness=3e3,
            gearbox_damping=0.5,
            delay=4.4e-3,
            period=2e-3,
            kd_delay=0.3e-3,
            kd_period=5e-4,
        ),
    ),
    "rigid": joint(0.15, 60.0, 2.0, ElasticDelayed(motor_inertia=0.05, delay=5.6e-3, period=2e-3, bandwidth=2000.0)),
}
PROXIMAL = ElasticDelayed(motor_inertia=0.12, gearbox_stiffness=8e3, gearbox_damping=4.0, delay=2.3e-3, period=1e-3)
LEG = Held(
    """
<mujoco><compiler angle="radian"/><worldbody><body name="thigh"><joint name="hip" axis="0 1 0"/>
  <inertial pos="0 0 -0.15" mass="5" diaginertia="0.06 0.06 0.01"/>
  <body name="shank" pos="0 0 -0.35"><joint name="knee" axis="0 1 0"/>
    <inertial pos="0.02 0 -0.15" mass="3" diaginertia="0.04 0.04 0.005"/>
    <body name="foot" pos="0 0 -0.35"><joint name="ankle" axis="0 1 0"/>
      <inertial pos="0.05 0 -0.04" mass="1" diaginertia="0.01 0.01 0.01"/></body></body></body></worldbody></mujoco>
""",
    (-0.4, 0.8, -0.4),
    {"hip": PROXIMAL, "knee": PROXIMAL, "ankle": replace(PROXIMAL, motor_inertia=0.03, gearbox_stiffness=2.5e3, gearbox_damping=1.0)},
    (200.0, 200.0, 60.0),
    (6.0, 6.0, 1.5),
)
EVERY = {**JOINTS, "leg": LEG}


def first_speeds(held: Held) -> np.ndarray:
    """Speeds (n,) with which a run starts [rad/s]: of no symmetry, so that they excite every motion."""
    return FIRST * np.random.default_rng(0).uniform(0.5, 1.0, len(held.kp)) * (-1.0) ** np.arange(len(held.kp))


def onset(run: Callable[[np.ndarray], np.ndarray], near: float) -> float:
    """Factor on all gains at which torques neither grow nor decay.

    run    squared torques (steps, factors) of a run with these factors
    near   the factor that is predicted

    The rate of growth, between the last two quarters of a run, is all but straight between neighbouring factors.
    """
    factors = near * np.linspace(1 - BESIDE, 1 + BESIDE, 13)
    record = run(factors)
    quarter = len(record) // 4
    rates = np.log(record[3 * quarter : 4 * quarter].mean(0) / record[2 * quarter : 3 * quarter].mean(0))
    rising = np.flatnonzero((rates[:-1] < 0) & (rates[1:] >= 0))
    assert len(rising) == 1, f"no onset within {BESIDE:g} of {near:g}: growth {rates}"
    k = int(rising[0])
    return float(factors[k] - rates[k] * (factors[k + 1] - factors[k]) / (rates[k + 1] - rates[k]))


def stiffest_step(held: Held, step: float) -> float:
    """Ω dt of the links on their springs, the motors held."""
    stiffness = [0.0 if each.is_rigid else each.gearbox_stiffness for each in held.actuators.values()]
    root = np.diag(np.sqrt(stiffness))
    return step * math.sqrt(float(np.linalg.eigvalsh(root @ np.linalg.inv(held.inertia()) @ root)[-1]))
