"""Recordings of joints that vibrate, each for one known cause.

A cause is true by construction: the same run with it taken away swings by less than a tenth of it. Amplitudes are of the true position of
the encoder's side in the last third, and at least three encoder steps. A quantiser keeps up no amplitude that large (its describing
function is below 1.1 from one and a half steps on): there it is three steps from peak to peak in the readings.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from .drawn import Drawn, draw, healthy, joint_yaml, log_uniform
from .joint_run import Outer, Run, Setup, damping, limit, radius, roots, run

LEAST_STEPS = 3.0  # amplitude over the encoder's step
VANISHES = 0.1  # of the amplitude: more of it must not be left without the cause
MOST_ROWS = 16_000


@dataclass(frozen=True)
class Recording:
    """A log's columns by name, the joint.yaml, the cause ("quiet": none), its variety, and what is known of it."""

    columns: dict[str, np.ndarray]
    yaml: str
    cause: str
    kind: str
    known: dict[str, float] = field(default_factory=dict)


def straightened(values: np.ndarray) -> np.ndarray:
    """Beside a straight line."""
    line = np.linspace(-1, 1, len(values))[:, None] ** np.arange(2)
    return values - line @ np.linalg.lstsq(line, values, rcond=None)[0]


def amplitude(values: np.ndarray) -> float:
    """√2 RMS beside a straight line."""
    return math.sqrt(2) * float(np.std(straightened(values)))


def swing(made: Run) -> float:
    """Amplitude in the last third."""
    return amplitude(made.last)


def frequency(values: np.ndarray, tick: float) -> float:
    """[Hz] of the largest line of the spectrum."""
    power = np.abs(np.fft.rfft(straightened(values) * np.hanning(len(values)), 8 * len(values)))
    return float(np.argmax(power)) / (8 * len(values) * tick)


def lasts(values: np.ndarray, least: float) -> bool:
    """The last third swings by at least that, and no less than 0.8 of the third before."""
    third = len(values) // 3
    return amplitude(values[-third:]) > max(least, 0.8 * amplitude(values[-2 * third : -third]))


def log_of(rng: np.random.Generator, made: Run, kind: str = "any", every: int = 1) -> dict[str, np.ndarray]:
    """Columns as logs have them, every `every`th row: most have both torques; one in six lacks either ("both": never)."""
    count, tick, lack = len(made.true), made.setup.tick, int(rng.integers(6))
    columns = {"time": np.arange(count) * tick}
    torque = made.columns["actual_torque"]
    noise = float(rng.uniform(0.002, 0.01)) * float(np.std(torque))
    if lack != 0 or kind == "both":
        columns["target_torque"] = made.columns["target_torque"]
    if lack != 1 or kind == "both":
        columns["actual_torque"] = torque + noise * rng.standard_normal(count)
    both = made.setup.law.side == "link" and rng.random() < 0.5
    for side in ("motor", "link") if both else (made.setup.law.side,):
        columns[f"{side}_position"] = made.columns[f"{side}_position"]
    columns["reference"] = made.columns["reference"]
    return {name: values[::every] for name, values in columns.items()}


def rows(setup: Setup, seconds: float) -> int:
    return int(min(max(seconds / setup.tick, 400), MOST_ROWS))


def stepped(count: int, tick: float, size: float, at: float = 0.2) -> np.ndarray:
    """A set-point that steps once."""
    return np.where(np.arange(count) * tick < at, 0.0, size)


def noisy(rng: np.random.Generator, drawn: Drawn, step: float) -> Drawn:
    """With the encoder's step and up to 0.3 of it of noise."""
    return drawn.with_(step=step, noise=step * float(rng.choice([0.0, 0.1, 0.3])))


def encoder(rng: np.random.Generator) -> float:
    return log_uniform(rng, 2e-6, 4e-4)


def counts(made: Run, without: Run, least: float = LEAST_STEPS) -> bool:
    """Large enough, and gone without the cause."""
    size = swing(made)
    return size >= least * made.setup.step and not without.away and swing(without) < VANISHES * size


def beyond(rng: np.random.Generator, **options) -> tuple[Drawn, float] | None:
    """A joint whose gains are 4 to 45 % beyond its limit, and the factor back to the limit."""
    drawn = draw(rng, **options)
    found = limit(drawn.setup)
    if not 1.05 < found < 200:
        return None
    over = float(rng.uniform(1.04, 1.45))
    drawn = drawn.with_(law=drawn.setup.law.scaled(found * over))
    s = np.log(roots(drawn.setup).astype(complex) + 1e-300) / drawn.setup.tick
    worst = s[np.argmax(s.real)]
    if abs(worst.imag) < 2 or worst.real > 0.25 * abs(worst.imag) or worst.real <= 0:
        return None
    return drawn, over


def gain_limit(rng: np.random.Generator, index: int) -> Recording | None:
    """Gains beyond the limit: it grows to the end of the log, or until the torque is clipped, by the drive or the controller."""
    found = beyond(rng)
    if found is None:
        return None
    drawn, over = found
    made = _beyond_run(rng, drawn, over, index)
    if made is None:
        return None
    drawn, done = made
    kind = "clipped" if index % 2 else "growing"
    tick = drawn.setup.tick
    return Recording(
        log_of(rng, done, "both" if index % 2 else "any"),
        joint_yaml(rng, drawn),
        "gain_limit",
        kind,
        {"hz": frequency(done.last, tick), "over": over},
    )


def _beyond_run(rng: np.random.Generator, drawn: Drawn, over: float, index: int) -> tuple[Drawn, Run] | None:
    setup = drawn.setup
    s = np.log(roots(setup).astype(complex) + 1e-300) / setup.tick
    worst = s[np.argmax(s.real)]
    step, size = encoder(rng), log_uniform(rng, 1e-4, 2e-2)
    drawn = noisy(rng, drawn, step)
    if index % 2:
        most = float(rng.uniform(0.7, 4.0)) * setup.law.kp * size
        limits = {"limit": most} if rng.random() < 0.6 else {"target_limit": most}
        drawn = drawn.with_(drive=replace(setup.drive, **limits), joint=replace(setup.joint, coulomb=float(rng.choice([0, 0.02])) * most))
        count = rows(setup, min(8 * math.log(1e3) / worst.real, 20) + float(rng.uniform(1, 3)))
    else:
        count = rows(setup, min(math.log(1e5) / worst.real, 20) + 0.3)
    wanted = stepped(count, setup.tick, size)
    seed, most = int(rng.integers(1e6)), float(rng.uniform(20, 60)) * size
    done = run(drawn.setup, wanted, seed=seed, bound=min(most, 1.0))
    periods = len(done.last) * setup.tick * abs(worst.imag) / 2 / math.pi
    if len(done.true) < 300 or periods < 5 or (index % 2 and done.away):
        return None
    if index % 2 and np.mean(np.abs(done.columns["target_torque"][-len(done.last) :]) >= 0.99 * most_of(drawn)) < 0.05:
        return None
    calm = replace(drawn.setup, law=drawn.setup.law.scaled(0.4 / over))
    if not counts(done, run(calm, wanted[: len(done.true)], seed=seed)) or not lasts(done.true, 0.0):
        return None
    return drawn, done


def most_of(drawn: Drawn) -> float:
    return min(drawn.setup.drive.limit, drawn.setup.drive.target_limit)


def stick_slip(rng: np.random.Generator, index: int) -> Recording | None:
    """Hunting under integral action, or a slow ramp, with more friction at rest than in motion."""
    drawn = healthy(rng, margin=2.5, dampings=(0.02, 0.1))
    setup = drawn.setup
    law, hunting = setup.law, index % 2 == 0
    if setup.tick < 9e-4:  # hunting is slow, and long logs take long
        return None
    if hunting:
        drawn = drawn.with_(law=replace(law, ki=law.kp * log_uniform(rng, 1.5, 10.0)))
        if limit(drawn.setup) < 1.5 or damping(drawn.setup) < 0.06:
            return None
    coulomb = law.kp * log_uniform(rng, 0.002, 0.03)
    width = coulomb / law.kp
    joint = replace(
        setup.joint, coulomb=coulomb, static=coulomb * float(rng.uniform(1.3, 2.0)), stribeck=width * float(rng.uniform(0.3, 1.5))
    )
    drawn = noisy(rng, drawn.with_(joint=joint), width * log_uniform(rng, 1e-4, 2e-2))
    count = rows(setup, float(rng.uniform(12, 30)))
    time = np.arange(count) * setup.tick
    wanted = stepped(count, setup.tick, width * float(rng.uniform(2, 8))) if hunting else time * width * float(rng.uniform(0.15, 0.8))
    seed = int(rng.integers(1e6))
    done, smooth = (run(replace(drawn.setup, joint=j), wanted, seed=seed) for j in (joint, setup.joint))
    periods = frequency(done.last, setup.tick) * len(done.last) * setup.tick
    if not counts(done, smooth) or not lasts(done.true, 0.0) or periods < 3:
        return None
    return Recording(
        log_of(rng, done),
        joint_yaml(rng, drawn),
        "stick_slip",
        "hunting" if hunting else "ramp",
        {"hz": periods / (len(done.last) * setup.tick)},
    )


def quantisation(rng: np.random.Generator, index: int) -> Recording | None:
    """A coarse encoder in a stable loop of little margin."""
    drawn = draw(rng, dampings=(0.01, 0.08))
    found = limit(drawn.setup)
    if not 1.05 < found < 300:
        return None
    drawn = drawn.with_(law=drawn.setup.law.scaled(found / float(rng.uniform(1.04, 1.4))))
    setup, step = drawn.setup, log_uniform(rng, 1e-4, 5e-3)
    coarse = drawn.with_(step=step, noise=step * float(rng.choice([0.0, 0.1, 0.3])))
    weight = float(rng.choice([0.0, 1.0])) * float(rng.uniform(0.5, 5)) * step * setup.law.kp
    coarse = coarse.with_(joint=replace(setup.joint, gravity=weight))
    count, seed = rows(setup, float(rng.uniform(2, 8))), int(rng.integers(1e6))
    wanted = stepped(count, setup.tick, step * float(rng.uniform(5, 40)))
    done = run(coarse.setup, wanted, seed=seed)
    readings = done.columns["motor_position"][-len(done.last) :]
    if done.away or np.ptp(readings) < (LEAST_STEPS - 0.5) * step or amplitude(done.last) < step:
        return None
    fine = run(replace(coarse.setup, step=step / 256, noise=0.0), wanted, seed=seed)
    if swing(fine) > VANISHES * swing(done) or not lasts(done.true, 0.0):
        return None
    known = {"hz": frequency(done.last, setup.tick), "margin": limit(setup), "steps": amplitude(done.last) / step}
    return Recording(log_of(rng, done), joint_yaml(rng, coarse), "quantisation", "limit cycle", known)


def structural_resonance(rng: np.random.Generator, index: int) -> Recording | None:
    """A mass on a spring that the file does not have: the loop drives its mode, or it rings for long after a blow."""
    ringing = index % 2 == 1
    drawn = healthy(rng, margin=2.0, least=0.04)
    setup, joint = drawn.setup, drawn.setup.joint
    share, ratio = float(rng.uniform(0.2, 0.7)), log_uniform(rng, 0.0008, 0.004)
    omega = joint.resonance * float(np.exp(rng.uniform(math.log(0.4), math.log(4.0))))
    if omega * setup.tick > 1.0:
        return None
    if ringing:  # the link bends
        masses = (1 - share) * joint.link_inertia, share * joint.link_inertia
        spring = omega**2 * masses[0] * masses[1] / joint.link_inertia
        bent = replace(
            joint,
            link_inertia=masses[1],
            stiffness=spring,
            damping=2 * ratio * spring / omega,
            middle=(masses[0], joint.stiffness, joint.damping),
        )
    else:  # behind the motor's encoder
        masses = (1 - share) * joint.motor_inertia, share * joint.motor_inertia
        spring = omega**2 * masses[0] * masses[1] / joint.motor_inertia
        bent = replace(joint, motor_inertia=masses[0], middle=(masses[1], spring, 2 * ratio * spring / omega))
    whole = drawn.with_(joint=bent)
    s = np.log(roots(whole.setup).astype(complex) + 1e-300) / setup.tick
    swinging = s[(np.abs(s.imag) > 1) & (np.abs(s.imag) * setup.tick < 1.2)]
    if not len(swinging):
        return None
    worst = swinging[np.argmax(swinging.real / np.abs(swinging))]
    growth = worst.real / abs(worst)
    two = np.log(roots(setup).astype(complex) + 1e-300) / setup.tick
    if np.min(np.abs(np.log(np.abs(two[np.abs(two.imag) > 1].imag) / abs(worst.imag))), initial=9.0) < 0.15:
        return None
    if not (-0.008 < growth < -0.001 if ringing else 0.002 < growth < 0.06):
        return None
    return _struck(rng, drawn, whole, worst, ringing)


def _struck(rng: np.random.Generator, drawn: Drawn, whole: Drawn, worst: complex, ringing: bool) -> Recording | None:
    setup, omega = drawn.setup, abs(worst.imag)
    seconds = min(float(rng.uniform(2, 4)) / abs(worst.real), 15) if ringing else min(math.log(1e4) / worst.real, 15)
    count, seed = rows(setup, seconds + 0.3), int(rng.integers(1e6))
    blow, start = np.zeros(count), int(0.1 / setup.tick) + 2
    size = setup.joint.link_inertia * omega**2 * (log_uniform(rng, 1e-4, 1e-2) if ringing else 1e-5)
    blow[start : start + max(1, round(math.pi / omega / setup.tick))] = size
    whole = noisy(rng, whole, encoder(rng))
    wanted = np.zeros(count)
    done = run(whole.setup, wanted, outside=blow, seed=seed, bound=0.5)
    two = run(replace(whole.setup, joint=setup.joint), wanted[: len(done.true)], outside=blow, seed=seed)
    part = straightened(done.last)
    found = frequency(part, setup.tick)
    if len(done.true) < 300 or abs(2 * math.pi * found / omega - 1) > 0.1 or found * len(part) * setup.tick < 6:
        return None
    if not counts(done, two):
        return None
    yaml = joint_yaml(rng, replace(drawn, setup=replace(whole.setup, joint=setup.joint)))
    return Recording(
        log_of(rng, done), yaml, "structural_resonance", "ringing" if ringing else "driven", {"hz": found, "damping": -worst.real / omega}
    )


def saturation(rng: np.random.Generator, index: int) -> Recording | None:
    """Integral action that a torque limit makes unstable after a large step, stable without it."""
    drawn = healthy(rng, margin=2.2, dampings=(0.02, 0.1))
    law, setup = drawn.setup.law, drawn.setup
    omega = math.sqrt(law.kp / setup.joint.inertia)
    drawn = drawn.with_(law=replace(law, ki=law.kp * omega * float(rng.uniform(0.3, 1.3))))
    if radius(drawn.setup) >= 1 or damping(drawn.setup) < 0.05 or limit(drawn.setup) < 1.6:
        return None
    goal = float(rng.uniform(0.1, 1.0))
    drawn = noisy(rng, drawn, encoder(rng))
    count, seed = rows(setup, float(rng.uniform(8, 15)) * 2 * math.pi / omega), int(rng.integers(1e6))
    wanted, bound = stepped(count, setup.tick, goal, 0.3), float(rng.uniform(5, 20)) * goal
    smooth = run(drawn.setup, wanted, seed=seed)
    if smooth.away or swing(smooth) > 0.02 * goal:
        return None
    low, high, best = 0.0, 1.5 * law.kp * goal, None
    name = "limit" if index % 2 else "target_limit"
    for _ in range(8):
        most = (low + high) / 2
        tried = run(replace(drawn.setup, drive=replace(setup.drive, **{name: most})), wanted, seed=seed, bound=bound)
        if tried.away or lasts(tried.true, 0.1 * goal):
            low, best = most, tried
        else:
            high = most
    if best is None or not counts(best, smooth):
        return None
    most = min(best.setup.drive.limit, best.setup.drive.target_limit)
    share = float(np.mean(np.abs(best.columns["target_torque"]) >= 0.999 * most))
    turns = np.flatnonzero(np.diff(np.sign(best.true - wanted[: len(best.true)])))
    if share < 0.1 or len(turns) < 6:
        return None
    known = {"hz": 0.5 / (float(np.mean(np.diff(turns[-3:]))) * setup.tick), "clipped": share}
    return Recording(log_of(rng, best, "both"), joint_yaml(rng, drawn), "saturation", "away" if best.away else "sustained", known)


def external_torque(rng: np.random.Generator, index: int) -> Recording | None:
    """A periodic torque on the link from outside: a sine, a sine with harmonics, or pushes of a gait."""
    drawn = healthy(rng, margin=2.0)
    setup = drawn.setup
    hz = log_uniform(rng, 0.6, 8.0)
    count, seed = rows(setup, max(float(rng.uniform(8, 14)) / hz, 3.0)), int(rng.integers(1e6))
    if hz * count * setup.tick < 8:
        return None
    time, kind = np.arange(count) * setup.tick, ("sine", "harmonics", "gait")[index % 3]
    phase = 2 * math.pi * hz * time + float(rng.uniform(0, 6))
    if kind == "sine":
        shape = np.sin(phase)
    elif kind == "harmonics":
        shape = sum(float(rng.uniform(0.1, 1.0)) / k * np.sin(k * phase + float(rng.uniform(0, 6))) for k in range(1, 5))
    else:
        shape = np.maximum(np.sin(phase), 0.0) ** float(rng.uniform(0.5, 3))
    wanted, size = stepped(count, setup.tick, float(rng.choice([0.0, 0.05]))), log_uniform(rng, 2e-4, 3e-2)
    drawn = noisy(rng, drawn, min(encoder(rng), size / 4))
    once = run(replace(drawn.setup, step=0.0), wanted, outside=setup.law.kp * size * shape, seed=seed)
    scale = size / swing(once)
    coulomb = float(rng.choice([0.0, 0.15])) * setup.law.kp * size
    drawn = drawn.with_(joint=replace(setup.joint, coulomb=coulomb, static=coulomb))
    done = run(drawn.setup, wanted, outside=scale * setup.law.kp * size * shape, seed=seed)
    without = run(drawn.setup, wanted, seed=seed)
    if not counts(done, without):
        return None
    return Recording(
        log_of(rng, done), joint_yaml(rng, drawn), "external_torque", kind, {"hz": hz, "steps": swing(done) / drawn.setup.step}
    )


def torque_ripple(rng: np.random.Generator, index: int) -> Recording | None:
    """Of the motor's torque with its angle, at two or three speeds."""
    drawn = healthy(rng, margin=2.0)
    setup, number = drawn.setup, int(rng.choice([1, 2, 4, 6, 12, 14, 24, 36, 42]))
    order = drawn.ratio * number  # periods per turn of the joint
    hz = log_uniform(rng, 2.0, min(40.0, 0.1 / setup.tick))
    first = 2 * math.pi * hz / order  # [rad/s]
    if not 0.05 < first < 6:
        return None
    ratios = [1.0, float(rng.choice([-1, 1])) * log_uniform(rng, 1.4, 3.0), *([log_uniform(rng, 0.4, 0.8)] if rng.random() < 0.5 else [])]
    held = max(float(rng.uniform(12, 25)) / hz / min(abs(r) for r in ratios), 0.8)
    ends = np.cumsum([held] * len(ratios))
    count, seed = rows(setup, float(ends[-1])), int(rng.integers(1e6))
    if count * setup.tick < 0.98 * ends[-1] or max(abs(r) for r in ratios) * hz * setup.tick > 0.2:
        return None
    speed = np.array(ratios)[np.minimum(np.searchsorted(ends, np.arange(count) * setup.tick, side="right"), len(ratios) - 1)] * first
    wanted = np.cumsum(speed) * setup.tick
    size = log_uniform(rng, 1e-4, 1e-2)
    drawn = noisy(rng, drawn, min(encoder(rng), size / 4))
    plain = run(replace(drawn.setup, step=0.0), wanted, seed=seed, bound=1e3)
    torque = size * setup.law.kp
    for _ in range(3):  # of the amplitude that was drawn, in the last third
        shaken = replace(drawn.setup, ripple=(torque, float(order), float(rng.uniform(0, 6))))
        done = run(shaken, wanted, seed=seed, bound=1e3)
        torque *= size / max(amplitude((done.true - plain.true)[-len(done.last) :]), 1e-12)
        torque = min(torque, setup.law.kp * 0.5)
    settled = amplitude(plain.last[len(plain.last) // 2 :])
    ripple = amplitude((done.true - plain.true)[-len(done.last) :])
    least = min(amplitude((done.true - plain.true)[int(a * count) : int(b * count)]) for a, b in ((0.1, 0.3), (0.7, 0.95)))
    speeds = straightened(done.true[-len(done.true) // 5 :])
    turning = frequency(speeds, setup.tick) / (abs(speed[-1]) * order / 2 / math.pi)
    if min(least, ripple) < LEAST_STEPS * drawn.setup.step or settled > VANISHES * ripple or not 0.9 < turning < 1.1:
        return None
    return Recording(log_of(rng, done), joint_yaml(rng, drawn), "torque_ripple", f"{number} per turn", {"hz": hz, "speeds": len(ratios)})


def backlash(rng: np.random.Generator, index: int) -> Recording | None:
    """A gap in the gear: without the link the motor's loop is beyond its limit, or the link's encoder closes the loop around the gap."""
    far = index % 3 != 0
    drawn = draw(rng, dampings=(0.01, 0.1) if far else (0.1, 0.5))
    if far:
        drawn = drawn.with_(law=replace(drawn.setup.law, side="link"))
    found = limit(drawn.setup)
    if not 1.3 < found < 300:
        return None
    drawn = drawn.with_(law=drawn.setup.law.scaled(found / float(rng.uniform(1.5, 2.5))))
    alone = replace(drawn.setup, joint=replace(drawn.setup.joint, link_inertia=1e-3 * drawn.setup.joint.motor_inertia))
    if damping(drawn.setup) < 0.03 or (not far and radius(alone) < 1):
        return None
    setup, gap = drawn.setup, log_uniform(rng, 3e-4, 2e-2)
    drawn = noisy(rng, drawn, min(encoder(rng), gap / 8))
    coulomb = float(rng.choice([0.0, 0.05])) * gap * setup.law.kp
    loose = drawn.with_(joint=replace(setup.joint, gap=gap, coulomb=coulomb))
    tight = drawn.with_(joint=replace(setup.joint, coulomb=coulomb))
    count, seed = rows(setup, float(rng.uniform(3, 8))), int(rng.integers(1e6))
    wanted = stepped(count, setup.tick, gap * float(rng.uniform(3, 15)))
    done = run(loose.setup, wanted, seed=seed, bound=1.0)
    if done.away:
        return None
    hz = frequency(done.last, setup.tick)
    if hz * len(done.last) * setup.tick < 6 or not counts(done, run(tight.setup, wanted, seed=seed)) or not lasts(done.true, 0.0):
        return None
    sides = np.ptp(done.last)
    return Recording(
        log_of(rng, done),
        joint_yaml(rng, drawn),
        "backlash",
        "link's encoder" if far else "motor's encoder",
        {"hz": hz, "gap": gap, "swing": float(sides)},
    )


def aliasing(rng: np.random.Generator, index: int) -> Recording | None:
    """A loop beyond its limit that a log shows whose rate is below twice the vibration's frequency."""
    found = beyond(rng, least_rate=400.0)
    if found is None:
        return None
    drawn, over = found
    made = _beyond_run(rng, drawn, over, 1)
    if made is None:
        return None
    drawn, done = made
    control, hz = 1 / drawn.setup.tick, frequency(done.last, drawn.setup.tick)
    choices = [
        m for m in (4, 5, 8, 10, 16, 20, 25, 40, 50) if control / m < 1.8 * hz and control / m > 0.5 * hz and len(done.true) / m > 150
    ]
    if not choices:
        return None
    every = int(rng.choice(choices))
    rate = control / every
    seen = abs(hz - rate * round(hz / rate))
    columns = log_of(rng, done, "both", every)
    position = columns["motor_position"]
    shown = amplitude(position[-(len(position) // 3) :])
    if not 0.04 * rate < seen < 0.46 * rate or shown < LEAST_STEPS * drawn.setup.step:
        return None
    return Recording(columns, joint_yaml(rng, drawn), "aliasing", f"1 in {every}", {"hz": hz, "seen": seen, "rate": rate})


def outer_loop(rng: np.random.Generator, index: int) -> Recording | None:
    """A policy's or an integrating outer loop at 20 to 100 Hz that swings; the joint's own loop is well damped."""
    drawn = healthy(rng, margin=2.0, least_rate=200.0)
    setup, slow = drawn.setup, float(rng.choice([20.0, 25.0, 50.0, 100.0]))
    every = round(1 / slow / setup.tick)
    integral = index % 3 == 2
    late = int(rng.integers(0, 3)) * every + int(rng.integers(0, every))
    size = log_uniform(rng, 5e-3, 0.15)
    gain = float(rng.uniform(0.05, 0.6)) if integral else log_uniform(rng, 0.5, 6.0)
    outer = Outer(
        every, late, gain, 0.0 if integral else float(rng.choice([0.0, 0.02, 0.05])) * gain, 0.0, size, "integral" if integral else "policy"
    )
    drawn = noisy(rng, drawn.with_(outer=outer), min(encoder(rng), size / 20))
    coulomb = float(rng.choice([0.0, 0.02])) * setup.law.kp * size
    drawn = drawn.with_(joint=replace(setup.joint, coulomb=coulomb))
    count, seed = rows(setup, float(rng.uniform(4, 9))), int(rng.integers(1e6))
    goal = stepped(count, setup.tick, float(rng.uniform(0.3, 1.5)) * size, 0.1)
    done = run(drawn.setup, goal, seed=seed, bound=5.0)
    fixed = run(replace(drawn.setup, outer=None), goal, seed=seed)
    if done.away or not counts(done, fixed) or not lasts(done.true, 0.2 * size):
        return None
    hz = frequency(done.last, setup.tick)
    if not 0.4 < hz < 0.3 * slow or hz * len(done.last) * setup.tick < 3:
        return None
    return Recording(log_of(rng, done), joint_yaml(rng, drawn), "outer_loop", outer.kind, {"hz": hz, "rate": slow})


CAUSES: dict[str, Callable[[np.random.Generator, int], Recording | None]] = {
    one.__name__: one
    for one in (
        gain_limit,
        stick_slip,
        quantisation,
        structural_resonance,
        saturation,
        external_torque,
        torque_ripple,
        backlash,
        aliasing,
        outer_loop,
    )
}


def shaking(cause: str, index: int, seed: int) -> Recording:
    """The first draw that is of that cause."""
    rng = np.random.default_rng([seed, 1, list(CAUSES).index(cause), index])
    while True:
        made = CAUSES[cause](rng, index)
        if made is not None:
            return made
