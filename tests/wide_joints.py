"""Single joints over everything that a drive may be, in gainroom's description and in that of the independent counts."""

from dataclasses import dataclass, replace
from math import inf, pi
from typing import Any

import numpy as np

import gainroom as gr
from draws import log_uniform
from independent.counts import Boundary, Controlled
from independent.joint import PDJoint, random_joint


@dataclass(frozen=True)
class Case:
    """One joint with its controller: `kind` "PD" (kp, kd), "PID" (kp, ki, kd) or "PPI" (kp, kv, ki)."""

    joint: PDJoint
    kind: str
    gains: tuple[float, ...]
    low_pass: tuple[float, int, float] | None = None
    notches: tuple[tuple[float, float, float], ...] = ()
    sample_time: float | None = None

    def controlled(self) -> Controlled:
        """For the independent count."""
        if self.kind == "PD":
            terms = zip([(0, 0), (1, 0)], self.gains, strict=True)
        elif self.kind == "PID":
            terms = zip([(0, 0), (0, 1), (1, 0)], self.gains, strict=True)
        else:
            kp, kv, ki = self.gains
            terms = zip([(0, 0), (1, 0), (0, 1), (1, 1)], [kv * kp, kv, ki * kp, ki], strict=True)
        kept = tuple((powers, gain) for powers, gain in terms if gain)
        return Controlled(self.joint, kept, self.low_pass, self.notches, self.sample_time)

    def truth(self, factor: float = 1.0) -> Boundary:
        return Boundary.of(self.controlled().scaled(factor))

    def controller(self):
        filters: dict[str, Any] = {"notches": tuple(gr.Notch(*notch) for notch in self.notches)}
        if self.low_pass:
            bandwidth, order, damping = self.low_pass
            filters["velocity_filter"] = gr.LowPass(bandwidth, order, damping)
        return getattr(gr, self.kind)(*self.gains, **filters)

    def parts(self) -> tuple[gr.ElasticJoint, gr.Drive]:
        joint = self.joint
        damping = 0.0 if joint.rigid else joint.damping
        described = gr.ElasticJoint(
            joint.motor_inertia, joint.link_inertia, joint.stiffness, damping, joint.motor_viscous, joint.link_viscous
        )
        return described, gr.Drive(joint.bandwidth, joint.damping_ratio, joint.delay)

    def loop(self) -> gr.Loop:
        side: Any = self.joint.feedback
        return gr.build_loop(*self.parts(), self.controller(), feedback=side, sample_time=self.sample_time)

    def in_units(self, mass: float, time: float) -> "Case":
        """The same joint with every quantity in other units of mass and time (1 s is `time` of them)."""
        joint, torque = self.joint, mass / time**2
        described = replace(
            joint,
            motor_inertia=joint.motor_inertia * mass,
            link_inertia=joint.link_inertia * mass,
            stiffness=joint.stiffness * torque,
            damping=joint.damping * mass / time,
            motor_viscous=joint.motor_viscous * mass / time,
            link_viscous=joint.link_viscous * mass / time,
            delay=joint.delay * time,
            bandwidth=joint.bandwidth / time,
        )
        units = {
            "PD": (torque, torque * time),
            "PID": (torque, torque / time, torque * time),
            "PPI": (1 / time, torque * time, torque),
        }[self.kind]
        return replace(
            self,
            joint=described,
            gains=tuple(gain * unit for gain, unit in zip(self.gains, units, strict=True)),
            low_pass=self.low_pass and (self.low_pass[0] / time, *self.low_pass[1:]),
            notches=tuple((notch[0] / time, *notch[1:]) for notch in self.notches),
            sample_time=self.sample_time and self.sample_time * time,
        )


def narrow(rng: np.random.Generator, continuous: bool) -> Case:
    """PD around robot joints: 5 to 150 Hz, 0.5 to 20 ms, see random_joint; sampled with a random tick."""
    joint = random_joint(rng)
    step = None if continuous else float(rng.uniform(0.25e-3, 2e-3))
    return Case(replace(joint, kp=0.0, kd=0.0), "PD", (joint.kp, joint.kd), sample_time=step)


def wide(rng: np.random.Generator, continuous: bool) -> Case:
    """Resonance 0.5 to 500 Hz, damping ratio of the gearbox 1e-5 to 0.5, inertia ratio 1e-3 to 1e3, delay 0 to 50 ms.

    Sampled from 0.2 to 10 kHz, half of the delays within 1e-6 to 1e-13 of whole ticks or on them. All controllers, velocity filters,
    notches on the resonance, both sides; one gain in twenty negative; one in three in units of mass and time that differ by up to 1e9.
    """
    step = None if continuous else log_uniform(rng, 1e-4, 5e-3)
    resonance, damping = 2 * pi * log_uniform(rng, 0.5, 500), log_uniform(rng, 1e-5, 0.5)
    motor = log_uniform(rng, 1e-3, 1e2)
    link = motor * log_uniform(rng, 1e-3, 1e3)
    reduced = motor * link / (motor + link)
    rigid = rng.random() < 0.05
    viscous = rng.random() < 1 / 3
    joint = PDJoint(
        motor,
        link,
        inf if rigid else reduced * resonance**2,
        0.0 if rigid else 2 * damping * resonance * reduced,
        kp=0.0,
        kd=0.0,
        delay=_delay(rng, step),
        bandwidth=inf if rng.random() < 0.15 else log_uniform(rng, 50, 6000),
        damping_ratio=float(rng.uniform(0.4, 1.1)) if rng.random() < 0.8 else log_uniform(rng, 0.1, 5),
        motor_viscous=motor * log_uniform(rng, 1e-3, 10) if viscous else 0.0,
        link_viscous=link * log_uniform(rng, 1e-3, 10) if viscous and rng.random() < 0.7 else 0.0,
        feedback="link" if rng.random() < 0.3 else "motor",
    )
    highest = inf if step is None else 0.9 * pi / step
    low_pass, notches = None, []
    if rng.random() < 0.5:
        low_pass = (min(log_uniform(rng, 20, 5000), highest), int(rng.integers(1, 3)), float(rng.uniform(0.2, 1.5)))
    if rng.random() < 0.3:
        depth = 0.0 if rng.random() < 0.2 else float(rng.uniform(0, 0.5))
        notches.append((min(resonance, highest), log_uniform(rng, 0.02, 1.5), depth))
        if rng.random() < 0.3:
            notches.append((min(2.3 * resonance, highest), 0.5, 0.1))
    case = Case(joint, *_gains(rng, joint, step or 0.0), low_pass, tuple(notches), step)
    if rng.random() < 1 / 3:
        case = case.in_units(log_uniform(rng, 1e-9, 1e9), log_uniform(rng, 1e-9, 1e9))
    return case


def _delay(rng: np.random.Generator, step: float | None) -> float:
    """Delay [s]."""
    if rng.random() < 0.1:
        return 0.0
    delay = log_uniform(rng, 5e-5, 50e-3)
    if step is None or rng.random() < 0.5:
        return delay
    whole = max(1, round(delay / step)) * step
    near = 0.0 if rng.random() < 0.2 else float(rng.choice([-1, 1]) * 10 ** rng.uniform(-13, -6))
    return whole * (1 + near)


def _gains(rng: np.random.Generator, joint: PDJoint, step: float) -> tuple[str, tuple[float, ...]]:
    """Gains around what the delays of a rigid joint allow, below or beyond; some far below."""
    late = joint.delay + step + (0.0 if joint.bandwidth == inf else 2 * joint.damping_ratio / joint.bandwidth)
    crossover = log_uniform(rng, 0.02, 2.0) / (4 * max(late, 1e-3))
    inertia = joint.motor_inertia + (joint.link_inertia if rng.random() < 0.7 else 0.0)
    kd = inertia * crossover * log_uniform(rng, 0.05, 2.0)
    kp = inertia * crossover**2 * log_uniform(rng, 0.01, 1.0)
    if rng.random() < 0.1:
        weak = log_uniform(rng, 1e-6, 1e-1)
        kp, kd = kp * weak, kd * weak
    if rng.random() < 0.05:
        kp, kd = (-kp, kd) if rng.random() < 0.5 else (kp, -kd)
    rate = crossover * log_uniform(rng, 1e-3, 0.5)
    kind = str(rng.choice(["PD", "PID", "PPI"]))
    return kind, {"PD": (kp, kd), "PID": (kp, kp * rate, kd), "PPI": (kp / kd, kd, 0.0 if rng.random() < 0.3 else kd * rate)}[kind]
