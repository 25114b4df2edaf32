"""Logs of excited joints for identification: two masses on a spring with friction, and joints that are something else.

Every other model moves an inertia or the stiffness by more than a fifth: that of the two masses which explain the cross spectra best
(`two_masses`), against the joint's as it is at small twists, with its whole link, before the load changes.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import csd, welch

from .drawn import log_uniform
from .joint_run import Drive, Joint, Law, Run, Setup, radius, run

MOVED = 0.2  # relative, of the parameter that the wrong model moves most: at least
WRONG = ("backlash", "stiffening", "load change", "second mode", "torque limit")
EXCITATIONS = ("plan", "multisine", "chirp", "log chirp")


@dataclass(frozen=True)
class Excited:
    """A log's columns, its truth (SI; delay [s], resonance [rad/s]), the model ("right" or of WRONG) and the excitation."""

    columns: dict[str, np.ndarray]
    truth: dict[str, float]
    model: str
    kind: str
    known: dict[str, float] = field(default_factory=dict)


def low_crest(shape: np.ndarray, rounds: int = 30) -> np.ndarray:
    """A multisine of the same lines (all of one amplitude spectrum) with a lower peak: phases from clipping it again and again."""
    spectrum, values = np.abs(np.fft.rfft(shape)), shape
    for _ in range(rounds):
        clipped = np.clip(values, -0.8 * np.max(np.abs(values)), 0.8 * np.max(np.abs(values)))
        values = np.fft.irfft(spectrum * np.exp(1j * np.angle(np.fft.rfft(clipped))), len(values))
    return values


def excitation(rng: np.random.Generator, kind: str, count: int, tick: float, band: tuple[float, float]) -> np.ndarray:
    """(count,) of unit RMS in the band [Hz]."""
    time, (low, high) = np.arange(count) * tick, band
    if kind == "chirp":
        values = np.sin(2 * np.pi * (low * time + (high - low) * time**2 / (2 * time[-1])))
    elif kind == "log chirp":
        rate = math.log(high / low) / time[-1]
        values = np.sin(2 * np.pi * low * (np.exp(rate * time) - 1) / rate)
    else:
        number = 100 if kind == "plan" else int(rng.integers(25, 70))
        lines = np.unique(np.rint(np.geomspace(low, high, number) * count * tick)) / (count * tick)
        values = np.sin(2 * np.pi * np.outer(lines, time) + rng.uniform(0, 2 * np.pi, (len(lines), 1))).sum(axis=0)
        if kind == "plan":
            values = low_crest(values)
    return values / np.sqrt(np.mean(values**2))


@dataclass(frozen=True)
class Bench:
    """A joint's setup with what is run on it."""

    setup: Setup
    torque: np.ndarray
    reference: np.ndarray
    size: float
    band: tuple[float, float]
    kind: str
    seed: int

    def run(self, joint: Joint | None = None, drive: Drive | None = None) -> Run:
        setup = replace(self.setup, joint=joint or self.setup.joint, drive=drive or self.setup.drive)
        return run(setup, self.reference, added=self.torque, seed=self.seed, bound=20.0)


def bench(rng: np.random.Generator, index: int, still: bool = False) -> Bench | None:
    """A joint of 5 to 60 Hz under soft gains, with the excitation of that index; `still`: without slow motion beside it."""
    motor, ratio, hz = log_uniform(rng, 0.005, 2.0), log_uniform(rng, 0.4, 6.0), log_uniform(rng, 5.0, 60.0)
    tick = 1 / float(rng.choice([250, 500, 1000, 2000]))
    if hz * tick > 0.08 or hz * tick < 0.004:
        return None
    resonance, link = 2 * math.pi * hz, motor * ratio
    stiffness = resonance**2 * motor * link / (motor + link)
    damping = 2 * log_uniform(rng, 0.01, 0.06) * stiffness / resonance
    inertia, size = motor + link, (motor + link) * float(rng.uniform(5, 25))
    coulomb = size * log_uniform(rng, 0.02, 0.15)
    joint = Joint(
        motor,
        link,
        stiffness,
        damping,
        motor_viscous=float(rng.choice([0.0, 1.0])) * inertia * float(rng.uniform(0.05, 0.5)),
        coulomb=coulomb,
        static=coulomb * float(rng.choice([1.0, rng.uniform(1, 1.4)])),
        stribeck=0.05,
        link_coulomb=coulomb * float(rng.uniform(0, 0.3)),
        gravity=float(rng.choice([0.0, 0.5])) * size * float(rng.uniform(0, 1)),
    )
    omega = 2 * math.pi * float(rng.uniform(0.4, 1.2))
    law = Law(inertia * omega**2, 1.4 * omega * inertia)
    drive = Drive(min(float(rng.uniform(0.8, 3.0)) / tick, 6000.0), float(rng.uniform(0.6, 1.0)), float(rng.uniform(0.5, 5)) * tick)
    setup = Setup(joint, drive, law, tick, least=10)
    setup = replace(setup, drive=replace(drive, delay=setup.delay))
    if radius(setup) >= 1:
        return None
    count = int(min(float(rng.uniform(6, 16)) / tick, 14_000))
    antiresonance = math.sqrt(stiffness / link) / 2 / math.pi
    band = (0.5 * antiresonance, min(max(2 * hz, 0.1 / tick), 0.2 / tick))
    kind = EXCITATIONS[index % len(EXCITATIONS)]
    torque = size * excitation(rng, kind, count, tick, band)
    time = np.arange(count) * tick
    slow = 0.0 if still or rng.random() < 0.5 else float(rng.uniform(0.1, 0.5))
    reference = slow * np.sin(2 * np.pi * float(rng.uniform(0.1, 0.3)) * time)
    return Bench(setup, torque, reference, size, band, kind, int(rng.integers(1e6)))


def two_masses(torque: np.ndarray, position: np.ndarray, tick: float, band: tuple[float, float], start: Joint) -> dict[str, float]:
    """J_M, J_L and K of two masses on a spring, with viscous friction and a delay, that explain the spectra best, and the residual."""
    parts = {"fs": 1 / tick, "nperseg": min(len(torque), int(16 / band[0] / tick)), "window": "hann"}
    hz, cross = csd(torque, position, **parts)
    power, other = welch(torque, **parts)[1], welch(position, **parts)[1]
    used = (hz > band[0]) & (hz < band[1]) & (power > 1e-3 * np.max(power))
    response, s = (cross / power)[used], 2j * np.pi * hz[used]
    coherence = np.clip((np.abs(cross) ** 2 / power / other)[used], 0, 0.999)
    weight = np.sqrt(coherence / (1 - coherence) / hz[used])
    weight /= np.sqrt(np.sum(weight**2))

    def missed(x: np.ndarray) -> np.ndarray:
        jm, jl, k, b, viscous = np.exp(x[:5])
        spring = k + b * s
        model = np.exp(-s * x[5] * tick) * (jl * s**2 + spring) / ((jm * s**2 + viscous * s + spring) * (jl * s**2 + spring) - spring**2)
        off = weight * np.log(response / model)
        turned = (off.imag + np.pi * weight) % (2 * np.pi * weight + 1e-300) - np.pi * weight
        return np.concatenate([off.real, turned])

    first = np.log(
        [start.motor_inertia, start.link_inertia, start.stiffness, start.damping, 0.3 * (start.motor_inertia + start.link_inertia)]
    )
    best = min(
        (least_squares(missed, np.append(first + np.log(shift) * np.array([1, 1, 1, 0, 0]), 0.5)) for shift in (1.0, 0.7, 1.4)),
        key=lambda found: found.cost,
    )
    found = dict(zip(("motor_inertia", "link_inertia", "stiffness"), np.exp(best.x[:3]).tolist(), strict=True))
    return {**found, "left": math.sqrt(2 * best.cost)}


def moved(made: Run, torque: np.ndarray, band: tuple[float, float], true: Joint) -> dict[str, float]:
    """Relative, of each parameter of the best two masses against the truth."""
    found = two_masses(torque, made.columns["motor_position"], made.setup.tick, band, true)
    return {name: found[name] / getattr(true, name) - 1 for name in ("motor_inertia", "link_inertia", "stiffness")}


def with_encoder(rng: np.random.Generator, one: Bench, made: Run) -> Bench:
    """With an encoder's step and noise, of which the motor's motion is at least 60."""
    step = min(log_uniform(rng, 1e-6, 1e-4), float(np.ptp(made.true - one.reference)) / 60)
    return replace(one, setup=replace(one.setup, step=step, noise=step * float(rng.uniform(0, 1))))


def log_columns(rng: np.random.Generator, made: Run, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """With noise of 0.5 to 1.5 % on the measured torque."""
    columns = {"time": np.arange(len(made.true)) * made.setup.tick, **{name: made.columns[name] for name in names}}
    if "actual_torque" in columns:
        noise = float(rng.uniform(0.005, 0.015)) * float(np.std(made.columns["actual_torque"]))
        columns["actual_torque"] = columns["actual_torque"] + noise * rng.standard_normal(len(made.true))
    return columns


def truth_of(setup: Setup) -> dict[str, float]:
    joint = setup.joint
    return {
        "motor_inertia": joint.motor_inertia,
        "link_inertia": joint.link_inertia,
        "stiffness": joint.stiffness,
        "damping": joint.damping,
        "viscous": joint.motor_viscous,
        "coulomb": joint.coulomb,
        "link_coulomb": joint.link_coulomb,
        "delay": setup.delay,
        "resonance": joint.resonance,
    }


BOTH = ("target_torque", "actual_torque", "motor_position")


def right(rng: np.random.Generator, index: int) -> Excited | None:
    """Two masses, as they are fitted."""
    one = bench(rng, index)
    if one is None:
        return None
    one = with_encoder(rng, one, one.run())
    made = one.run()
    if made.away:
        return None
    names = (*BOTH, "link_position") if rng.random() < 0.15 else BOTH
    columns = log_columns(rng, made, (*names, "reference") if rng.random() < 0.5 else names)
    return Excited(columns, truth_of(one.setup), "right", one.kind, {"hz": one.setup.joint.resonance / 2 / math.pi})


def wrong(rng: np.random.Generator, index: int, model: str) -> Excited | None:
    """Something else, which moves a parameter of two masses by more than a fifth."""
    one = bench(rng, index % 2 if model == "load change" else index, still=True)  # a sweep has passed by when the load changes
    if one is None:
        return None
    one = replace(one, setup=replace(one.setup, joint=replace(one.setup.joint, gravity=0.0)))
    plain = one.run()
    one = with_encoder(rng, one, plain)
    joint, drive = one.setup.joint, one.setup.drive
    twist = plain.columns["motor_position"] - plain.columns["link_position"]
    names, known = BOTH, {}
    if model == "backlash":
        gap = float(np.std(twist)) * log_uniform(rng, 0.3, 2.0)
        joint, known = replace(joint, gap=gap), {"gap": gap}
    elif model == "stiffening":
        growth = log_uniform(rng, 0.7, 6.0)  # of the slope at twice the deviation of the twist
        joint, known = replace(joint, cubic=growth * joint.stiffness / 3 / (2 * float(np.std(twist))) ** 2), {"growth": growth}
    elif model == "load change":
        at = float(rng.uniform(0.35, 0.65)) * len(one.torque) * one.setup.tick
        factor = log_uniform(rng, 1.3, 3.0) ** float(rng.choice([-1, 1]))
        joint, known = replace(joint, change=(at, factor)), {"at": at, "factor": factor}
    elif model == "second mode":
        share, above = float(rng.uniform(0.3, 0.7)), log_uniform(rng, 0.6, 1.8)
        masses = (1 - share) * joint.link_inertia, share * joint.link_inertia
        omega = above * joint.resonance
        spring = omega**2 * masses[0] * masses[1] / joint.link_inertia
        bent = (masses[0], joint.stiffness, joint.damping)
        joint, known = (
            replace(joint, link_inertia=masses[1], stiffness=spring, damping=0.04 * spring / omega, middle=bent),
            {"above": above},
        )
    else:
        most = one.size * float(rng.uniform(0.5, 1.1))
        drive, known = replace(drive, limit=most), {"limit": most}
        names = BOTH if index % 2 else ("target_torque", "motor_position")
    made = one.run(joint, drive)
    if made.away or np.ptp(made.true) < 60 * one.setup.step:
        return None
    source = made.columns["target_torque" if model == "torque limit" else "actual_torque"]
    off = moved(made, source, one.band, one.setup.joint)
    if not MOVED < max(abs(value) for value in off.values()) < 20:  # more: the fit is no fit
        return None
    columns = log_columns(rng, made, names)
    known = {**known, "hz": one.setup.joint.resonance / 2 / math.pi, **{f"moved {name}": value for name, value in off.items()}}
    return Excited(columns, truth_of(one.setup), model, one.kind, known)


def excited(model: str, index: int, seed: int) -> Excited:
    """The first draw of that model."""
    rng = np.random.default_rng([seed, 4, ("right", *WRONG).index(model), index])
    while True:
        made = right(rng, index) if model == "right" else wrong(rng, index, model)
        if made is not None:
            return made
