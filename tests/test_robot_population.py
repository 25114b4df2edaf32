"""Whole robots at random: the gain limit against independently counted roots, just below and just above.

Robots, postures, contact states, actuators, gains in joint and in operational space, continuous and sampled. A share runs every time; all
520 with `pytest -m population`. Other draws: GAINROOM_SEED=7 pytest -m population.
"""

import os
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np
import pytest

import gainroom as gr
from independent.coupled import Coupled, count_unstable, sampled_radius

pytest.importorskip("pinocchio")

from gainroom.robot.actuators import Actuators
from gainroom.robot.contact import Contact
from gainroom.robot.formats.model_files import load_model
from gainroom.robot.linearize import linearize
from gainroom.robot.tasks import Task, tasks_of

SEED = int(os.environ.get("GAINROOM_SEED", "2017"))
COUNT, STEP = 520, 43  # no multiple of 2 or 3, by which draws differ in kind: the share has all kinds
SAMPLE_TIME = 5e-4


@dataclass(frozen=True)
class Kind:
    file: object
    base: str
    locked: tuple[str, ...] = ()
    feet: tuple[str, ...] = ()
    kind: str = "flat"


def shipped(path: str) -> dict[str, str]:
    return {"package": "example-robot-data", "file": path}


ROBOTS = {
    "biped": Kind(files("gainroom") / "robot" / "models" / "biped.urdf", "floating", (), ("left_sole", "right_sole")),
    "talos": Kind(shipped("talos_data/robots/talos_reduced.urdf"), "floating", ("(?!leg_).*",), ("left_sole_link", "right_sole_link")),
    "solo12": Kind(shipped("solo_description/robots/solo12.urdf"), "floating", (), ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"), "point"),
    "panda": Kind(shipped("panda_description/urdf/panda.urdf"), "fixed", ("panda_finger_.*",)),
    "g1": Kind(
        shipped("g1_description/urdf/g1_29dof_rev_1_0.urdf"), "floating", (".*_(wrist|elbow|shoulder)_.*",),
        ("left_ankle_roll_link", "right_ankle_roll_link"),
    ),
}  # fmt: skip


@cache
def body(name: str):
    robot = ROBOTS[name]
    return load_model(robot.file, base=robot.base, locked=robot.locked)


@dataclass(frozen=True)
class Draw:
    model: object
    kp: np.ndarray
    kd: np.ndarray
    drive: gr.Drive
    sample_time: float | None

    def loop(self) -> gr.Loop:
        return gr.build_loop(self.model, self.drive, gr.PD(self.kp, self.kd), sample_time=self.sample_time)

    def independent(self, factor: float) -> Coupled:
        model, drive = self.model, self.drive
        parts = (model.link_inverse_inertia, model.motor_inertia, model.stiffness, model.damping)
        return Coupled(*parts, factor * self.kp, factor * self.kd, drive.delay, drive.bandwidth, drive.damping_ratio)

    def stable(self, factor: float, near: float) -> bool:
        if self.sample_time is None:
            return count_unstable(self.independent(factor), near) == 0
        return sampled_radius(self.independent(factor), self.sample_time, round(self.drive.delay / self.sample_time)) < 1


def draw(number: int) -> Draw:
    rng = np.random.default_rng([SEED, number])
    name = list(ROBOTS)[number % len(ROBOTS)]
    robot, links = ROBOTS[name], body(name)
    size = len(links.joint_names)
    low, high = (np.nan_to_num(np.clip(limit, -1.5, 1.5)) for limit in (links.lower, links.upper))
    q = links.configuration(dict(zip(links.joint_names, rng.uniform(low, high).tolist(), strict=True)))
    feet = [Contact(frame, robot.kind) for frame in robot.feet if rng.random() < 0.6]
    actuators = Actuators(
        motor_inertia=np.exp(rng.uniform(np.log(0.02), np.log(2.0))) * rng.uniform(0.5, 1.5, size),
        stiffness=np.exp(rng.uniform(np.log(2e3), np.log(5e4), size)),
        damping=rng.uniform(0.5, 3.0, size),
        motor_viscous=np.zeros(size),
        link_viscous=np.zeros(size),
    )
    model = linearize(links, actuators, q, feet)
    sampled = number % 4 == 3
    delay = SAMPLE_TIME * int(rng.integers(2, 9)) if sampled else float(np.exp(rng.uniform(np.log(1e-3), np.log(6e-3))))
    if robot.base == "floating" and number % 3 == 1 and feet:
        stack = [Task(name="com", kind="com", kp=rng.uniform(20, 200, 3), kd=rng.uniform(2, 20, 3))]
        stack += (
            [Task(name="base", kind="orientation", frame=links.frames[0], kp=100.0, kd=rng.uniform(5, 20))] if rng.random() < 0.5 else []
        )
        kp, kd = tasks_of(model, stack, rotors=bool(rng.random() < 0.5)).joint_gains()
    else:
        crossover = 0.2 / delay
        inertia = actuators.motor_inertia * rng.uniform(0.3, 2.0, size)
        kp, kd = np.diag(inertia * crossover**2 * rng.uniform(0.05, 1.0)), np.diag(inertia * crossover * rng.uniform(0.5, 2.0, size))
    drive = gr.Drive(float(rng.uniform(1500, 5000)), 0.9, delay)
    return Draw(model, kp, kd, drive, SAMPLE_TIME if sampled else None)


def assert_confirmed(number: int) -> None:
    case = draw(number)
    limit = gr.gain_limit(case.loop())
    if np.isinf(limit.gain):  # more than 60 dB of room: weak gains on a quick robot
        case = replace(case, kp=100 * case.kp, kd=100 * case.kd)
        limit = gr.gain_limit(case.loop())
    assert np.isfinite(limit.gain), number
    assert limit.gain > 0, number
    assert limit.certificate.holds, number
    assert case.stable(0.999 * limit.gain, limit.frequency), number
    assert not case.stable(1.001 * limit.gain, limit.frequency), number


@pytest.mark.slow
@pytest.mark.parametrize("number", range(0, COUNT, STEP))
def test_share_of_the_robots(number):
    assert_confirmed(number)


@pytest.mark.population
@pytest.mark.parametrize("batch", range(20))
def test_limits_are_confirmed_by_an_independent_count(batch):
    for number in range(batch, COUNT, 20):
        assert_confirmed(number)
