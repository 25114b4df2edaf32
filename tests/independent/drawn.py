"""Random joints of arms, legs, series elastic and direct drives with their controllers, and the joint.yaml that a user would have."""

import math
from dataclasses import dataclass, replace

import numpy as np

from .joint_run import Drive, Joint, Law, Setup, damping, limit, roots


@dataclass(frozen=True)
class Family:
    """Ranges: gear ratio, motor's inertia at the joint [kg m²], link's over motor's, resonance [Hz], rates [Hz]."""

    ratio: tuple[float, float]
    motor: tuple[float, float]
    links: tuple[float, float]
    resonance: tuple[float, float]
    rates: tuple[int, ...]


FAMILIES = {
    "arm": Family((50, 160), (0.1, 3.0), (0.3, 6.0), (8.0, 60.0), (250, 500, 1000, 2000, 4000)),
    "leg": Family((6, 16), (0.005, 0.08), (0.5, 8.0), (15.0, 90.0), (400, 500, 1000, 2000)),
    "elastic": Family((50, 160), (0.05, 1.0), (0.3, 4.0), (4.0, 20.0), (200, 500, 1000, 2000)),
    "direct": Family((1, 1), (0.002, 0.05), (0.3, 8.0), (30.0, 120.0), (1000, 2000, 4000)),
    "servo": Family((200, 350), (0.005, 0.05), (0.3, 4.0), (5.0, 12.0), (100, 200, 250)),
}


@dataclass(frozen=True)
class Drawn:
    """A setup without friction and encoder steps, its family and gear ratio."""

    setup: Setup
    family: str
    ratio: float

    def with_(self, **changes) -> "Drawn":
        return replace(self, setup=replace(self.setup, **changes))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def draw(rng: np.random.Generator, dampings: tuple[float, float] = (0.005, 0.06), least_rate: float = 0.0) -> Drawn:
    """Of a resonance below a ninth of the rate, with soft gains: natural frequency 0.8 to 4 Hz."""
    while True:
        name = str(rng.choice(list(FAMILIES)))
        family = FAMILIES[name]
        tick = 1.0 / float(rng.choice(family.rates))
        motor = log_uniform(rng, *family.motor)
        link, resonance = motor * log_uniform(rng, *family.links), 2 * math.pi * log_uniform(rng, *family.resonance)
        if tick * least_rate > 1 or resonance * tick > 0.7:
            continue
        reduced = motor * link / (motor + link)
        stiffness = resonance**2 * reduced
        joint = Joint(motor, link, stiffness, 2 * log_uniform(rng, *dampings) * resonance * reduced)
        drive = Drive(min(log_uniform(rng, 600, 6000), 3 / tick), float(rng.uniform(0.6, 1.1)), float(rng.uniform(0.5, 4.0)) * tick)
        omega, inertia = 2 * math.pi * log_uniform(rng, 0.8, 4.0), motor + link
        law = Law(inertia * omega**2, 2 * float(rng.uniform(0.4, 1.2)) * omega * inertia)
        ratio = 1.0 if name == "direct" else round(log_uniform(rng, *family.ratio), 1)
        setup = Setup(joint, drive, law, tick)
        setup = replace(setup, drive=replace(drive, delay=setup.delay))  # the delay that is run: whole substeps
        return Drawn(setup, name, ratio)


def healthy(rng: np.random.Generator, margin: float = 2.0, least: float = 0.05, **options) -> Drawn:
    """Of a gain margin of at least that and of roots damped by at least `least`."""
    while True:
        drawn = draw(rng, **options)
        found = limit(drawn.setup)
        if found <= 1.05:
            continue
        stiffer = min(found / margin / float(rng.uniform(1.0, 3.0)), 6.0)
        drawn = drawn.with_(law=drawn.setup.law.scaled(max(stiffer, 0.3)))
        if limit(drawn.setup) > margin and damping(drawn.setup) > least:
            return drawn


def slowest(setup: Setup) -> float:
    """[1/s] decay of the loop's slowest root."""
    return -math.log(float(np.max(np.abs(roots(setup))))) / setup.tick


def joint_yaml(rng: np.random.Generator, drawn: Drawn, off: float = 0.05) -> str:
    """Inertias, stiffness and delay up to `off` from the truth; the gains and rate are those that run."""
    setup, ratio = drawn.setup, drawn.ratio
    joint, law, drive = setup.joint, setup.law, setup.drive
    wrong = [log_uniform(rng, 1 - off, 1 + off) for _ in range(4)]
    gains = f"kp: {law.kp:.8g}, " + (f"ki: {law.ki:.8g}, " if law.ki else "") + f"kd: {law.kd:.8g}"
    late = 1e3 * drive.delay * wrong[3]
    return (
        f"joint: {{rotor_inertia: {joint.motor_inertia * wrong[0] / ratio**2:.8g}, gear_ratio: {ratio:g}, "
        f"link_inertia: {joint.link_inertia * wrong[1]:.8g}, stiffness: {joint.stiffness * wrong[2]:.8g}, damping: {joint.damping:.6g}}}\n"
        f"drive: {{bandwidth: {drive.bandwidth:.6g}, damping_ratio: {drive.damping_ratio:.4g}, delay_ms: {late:.6g}}}\n"
        f"control: {{type: {'pid' if law.ki else 'pd'}, {gains}, feedback: {law.side}, sample_rate_hz: {1 / setup.tick:g}}}\n"
        "limits: {gain_margin_db: 6.0, phase_margin_deg: 30.0, peak_sensitivity: 2.0}\n"
    )
