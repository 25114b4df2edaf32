"""Random joints, drives, controllers and loops of every kind that the package describes, for property tests."""

from dataclasses import dataclass
from math import inf, pi, sqrt
from typing import Any

import numpy as np
import pytest

import gainroom as gr


def seeds(share: int, whole: int) -> list[Any]:
    """For `parametrize`: the first `share` every time, the rest of `whole` with -m population."""
    return [*range(share), *(pytest.param(seed, marks=pytest.mark.population) for seed in range(share, whole))]


@dataclass(frozen=True)
class Setup:
    """Everything that build_loop takes."""

    joint: Any
    drive: Any
    controller: Any
    feedback: str = "motor"
    sample_time: float | None = None

    def loop(self) -> gr.Loop:
        return gr.build_loop(self.joint, self.drive, self.controller, feedback=self.feedback, sample_time=self.sample_time)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def draw_joint(rng: np.random.Generator, elastic: bool = True) -> gr.ElasticJoint:
    """Resonance 5 to 150 Hz, damping ratio 0.1 to 5 %, a third with viscous friction."""
    motor, ratio = log_uniform(rng, 0.05, 2.0), log_uniform(rng, 0.05, 20.0)
    link = motor * ratio
    resonance, mode_damping = 2 * pi * log_uniform(rng, 5, 150), log_uniform(rng, 1e-3, 5e-2)
    reduced = motor * link / (motor + link)
    viscous = (float(rng.uniform(0, 2)), float(rng.uniform(0, 2))) if rng.random() < 1 / 3 else (0.0, 0.0)
    if not elastic:
        return gr.ElasticJoint(motor, link, motor_viscous=viscous[0], link_viscous=viscous[1])
    return gr.ElasticJoint(motor, link, reduced * resonance**2, 2 * mode_damping * resonance * reduced, *viscous)


def draw_filters(rng: np.random.Generator, joint: gr.ElasticJoint, sample_time: float | None) -> dict[str, Any]:
    """Half of the draws have a velocity filter, a third one or two notches, all below 0.9 of the Nyquist frequency."""
    highest = 0.9 * pi / sample_time if sample_time else inf
    filters: dict[str, Any] = {}
    if rng.random() < 0.5:
        bandwidth = min(log_uniform(rng, 200, 5000), highest)
        filters["velocity_filter"] = gr.LowPass(bandwidth, order=int(rng.integers(1, 3)), damping_ratio=float(rng.uniform(0.4, 1.2)))
    if rng.random() < 1 / 3:
        centre = joint.resonance if np.isfinite(joint.resonance) else 300.0
        notches = [gr.Notch(min(centre, highest), float(rng.uniform(0.1, 1.0)), float(rng.uniform(0.0, 0.5)))]
        if rng.random() < 0.5:
            notches.append(gr.Notch(min(2.3 * centre, highest)))
        filters["notches"] = tuple(notches)
    return filters


def draw_setup(rng: np.random.Generator, sampled: bool, controller: str | None = None, feedback: str | None = None) -> Setup:
    """One joint with any drive, delay and controller; gains around what the delay allows, some beyond it."""
    joint = draw_joint(rng, elastic=rng.random() > 0.15)
    sample_time = log_uniform(rng, 0.2e-3, 2e-3) if sampled else None
    delay = log_uniform(rng, 0.5e-3, 20e-3) if rng.random() > 0.1 else 0.0
    if sampled and rng.random() < 0.3:
        delay = float(rng.integers(0, 9)) * sample_time  # whole ticks
    drive = gr.Drive(inf if rng.random() < 0.2 else log_uniform(rng, 500, 6000), float(rng.uniform(0.5, 1.1)), delay)
    filters = draw_filters(rng, joint, sample_time)
    crossover = 1 / (4 * max(delay, 0.5e-3)) * log_uniform(rng, 0.05, 2.0)
    inertia = joint.motor_inertia + joint.link_inertia
    kp, kd = inertia * crossover**2 * rng.uniform(-0.2, 1.0), inertia * crossover * rng.uniform(-0.1, 1.0)
    kind = controller or str(rng.choice(["PD", "PID", "PPI"]))
    described = {
        "PD": lambda: gr.PD(kp, kd, **filters),
        "PID": lambda: gr.PID(kp, 0.2 * kp * crossover * rng.random(), kd, **filters),
        "PPI": lambda: gr.PPI(abs(kp / kd), abs(kd), 0.2 * abs(kp) * rng.random(), **filters),
    }[kind]()
    side = feedback or ("link" if rng.random() < 0.25 else "motor")
    return Setup(joint, drive, described, side, sample_time)


def draw_plant(rng: np.random.Generator, size: int, rank: int | None = None, rigid: int = 0, gravity: bool = False) -> gr.Plant:
    """n coupled joints with W of the given rank, the first `rigid` joints rigid."""
    root = rng.normal(size=(size, size if rank is None else rank))
    stiffness = np.array([inf] * rigid + [log_uniform(rng, 3e3, 3e4) for _ in range(size - rigid)])
    stiffness_of_gravity = None
    if gravity:
        half = rng.normal(size=(size, size))
        stiffness_of_gravity = 20 * (half + half.T)
    return gr.Plant(
        link_inverse_inertia=root @ root.T / size,
        motor_inertia=rng.uniform(0.1, 1.0, size),
        stiffness=stiffness,
        damping=rng.uniform(0.1, 2.0, size),
        motor_viscous=rng.uniform(0, 1.0, size),
        link_viscous=rng.uniform(0, 1.0, size),
        gravity_stiffness=stiffness_of_gravity,
    )


def draw_robot(seed: int, size: int, delay: float = 2e-3, sample_time: float | None = None, full: bool = False, **plant) -> gr.Loop:
    """A stable loop of coupled joints of any gains, lowered until it has some room."""
    rng = np.random.default_rng([11, seed])
    kp, kd = rng.uniform(50, 200, size), rng.uniform(2, 10, size)
    if full:
        turn = np.linalg.qr(rng.normal(size=(size, size)))[0]
        kp, kd = (turn @ np.diag(gain) @ turn.T for gain in (kp, kd))
    drive = gr.Drive(3000.0, 0.9, delay)
    loop = gr.build_loop(draw_plant(rng, size, **plant), drive, gr.PD(kp, kd), sample_time=sample_time)
    return next(loop.scaled(factor) for factor in 0.5 ** np.arange(20) if gr.is_stable(loop.scaled(factor * 1.2)))


def complex_normal(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def resonance_of(joint: gr.ElasticJoint) -> float:
    """√(K (1/J_M + 1/J_L)), written out."""
    return sqrt(joint.stiffness / joint.motor_inertia + joint.stiffness / joint.link_inertia)
