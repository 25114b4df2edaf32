"""Virtual recordings of joints that vibrate for one known cause, and of joints that do not; with the joint.yaml that a user would have.

What is true of a recording is settled without the package's diagnosis: by roots of the linear loop, and by simulating the same run with the
effect taken away. Structural resonances come from the independent chain of inertias.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

import gainroom as gr
from draws import log_uniform
from gainroom.identification.record import Record
from gainroom.simulation import Friction, Scenario, Start, Testbed, simulate
from gainroom.system.system import System
from identified import SEED, multisine, noisy
from independent.chain import Chain, record

CAUSES = ("gain_limit", "stick_slip", "quantisation", "structural_resonance", "saturation")


@dataclass(frozen=True)
class Recording:
    """A log, the joint as its file describes it (values a few percent off), what vibrates it ("quiet": nothing), and how it was made."""

    record: Record
    system: System
    cause: str
    kind: str
    frequency: float = math.nan


@dataclass(frozen=True)
class Drawn:
    """A joint with its drive, PD gains and tick."""

    joint: gr.ElasticJoint
    drive: gr.Drive
    controller: gr.PD | gr.PID
    tick: float

    @property
    def loop(self) -> gr.Loop:
        return gr.build_loop(self.joint, self.drive, self.controller, sample_time=self.tick)

    def scaled(self, factor: float) -> "Drawn":
        return replace(self, controller=self.controller.scaled(factor))

    def described(self, rng: np.random.Generator, off: float = 0.05) -> System:
        """What a joint.yaml says: inertias, stiffness and delay off by some percent."""
        joint = self.joint
        wrong = {name: getattr(joint, name) * log_uniform(rng, 1 - off, 1 + off) for name in ("motor_inertia", "link_inertia", "stiffness")}
        drive = replace(self.drive, delay=self.drive.delay * log_uniform(rng, 1 - off, 1 + off))
        return System.of_joint(replace(joint, **wrong), drive, self.controller, sample_time=self.tick)


def draw(rng: np.random.Generator, damping: tuple[float, float] = (0.005, 0.05), viscous: float = 0.0) -> Drawn:
    """Of soft gains: natural frequency 1 to 3 Hz."""
    tick = float(rng.choice([2.5e-4, 5e-4, 1e-3, 2e-3]))
    motor, ratio = log_uniform(rng, 0.02, 3.0), log_uniform(rng, 0.3, 8.0)
    resonance = 2 * math.pi * log_uniform(rng, 8.0, min(60.0, 0.08 / tick))
    stiffness = resonance**2 * motor * ratio / (1 + ratio)
    viscosity = viscous * motor * (1 + ratio) * 2 * math.pi
    joint = gr.ElasticJoint(
        motor, motor * ratio, stiffness, 2 * log_uniform(rng, *damping) * stiffness / resonance, motor_viscous=viscosity
    )
    drive = gr.Drive(log_uniform(rng, 0.6, 3.0) / tick, float(rng.uniform(0.5, 1.2)), float(rng.uniform(0.5, 5)) * tick)
    omega, inertia = 2 * math.pi * log_uniform(rng, 1.0, 3.0), motor * (1 + ratio)
    controller = gr.PD(inertia * omega**2, 2 * float(rng.uniform(0.4, 1.2)) * omega * inertia)
    return Drawn(joint, drive, controller, tick)


def columns_of(rng: np.random.Generator, run, size: float, clips: bool = False) -> dict[str, np.ndarray]:
    """Of a run, as a log has them: position, set-point, one to three torques; where it `clips` not the target alone."""
    columns = {"reference": run.reference[:, 0], "motor_position": run.motor_reading[:, 0]}
    which = int(rng.integers(3))
    if which != 1:
        columns["target_torque"] = run.target_torque[:, 0]
    if which != 0 or clips:
        columns["actual_torque"] = noisy(rng, run.actual_torque[:, 0], 0.005 * size, 0.0)
    if which == 2:
        columns["demand_torque"] = run.demand_torque[:, 0]
    return columns


def swing(values: np.ndarray) -> float:
    """√2 RMS of the last third, about a straight line."""
    part = values[-(len(values) // 3) :]
    line = np.linspace(-1, 1, len(part))[:, None] ** np.arange(2)
    return math.sqrt(2) * float(np.std(part - line @ np.linalg.lstsq(line, part, rcond=None)[0]))


def gain_limit(rng: np.random.Generator, kind: int) -> Recording | None:
    """Gains beyond the limit of the linear loop; in a third of the cases the torque limit ends the growth."""
    drawn = draw(rng)
    limit = gr.gain_limit(drawn.loop)
    if not limit.stable or not 1.2 < limit.gain < 1e3:
        return None
    drawn = drawn.scaled(limit.gain * float(rng.uniform(1.03, 1.5)))
    root = max(gr.rightmost_roots(drawn.loop, count=6).roots, key=lambda s: s.real)
    if root.real <= 0 or abs(root.imag) < 5 or root.real > 0.2 * abs(root.imag):
        return None
    clipped = kind % 3 == 0
    step, size = log_uniform(rng, 1e-6, 3e-5), drawn.controller.kp * 0.01
    ends = min(math.log(3e4) / root.real, 20.0) * (1.0 if not clipped else 1.3)
    bed = Testbed(
        drawn.loop,
        torque_limit=float(rng.uniform(2, 8)) * size if clipped else math.inf,
        motor_resolution=step,
        substep=drawn.tick / 4,
        whole_ticks=False,
    )
    scenario = Scenario(
        0.0, ends, noise=0.3 * step, seed=int(rng.integers(1e6)), start=Start(motor_velocity=1e-3, link_velocity=1e-3), limit=0.5
    )
    run = simulate(bed, scenario)
    if swing(run.motor_position[:, 0]) < 10 * step or len(run.time) < 200:
        return None
    if clipped and (run.diverged or np.mean(np.abs(run.demand_torque) >= bed.torque_limit) < 0.05):
        return None
    record_ = Record(run.time, columns_of(rng, run, swing(run.actual_torque[:, 0]), clipped), drawn.tick)
    return Recording(record_, drawn.described(rng), "gain_limit", "clipped" if clipped else "growing", abs(root.imag))


def stick_slip(rng: np.random.Generator, kind: int) -> Recording | None:
    """Static friction above Coulomb friction: hunting under integral action, or stick-slip motion along a slow ramp."""
    drawn = draw(rng, damping=(0.02, 0.1))
    if drawn.tick < 5e-4:
        return None  # long recordings take long
    loop_limit = gr.gain_limit(drawn.loop)
    if not loop_limit.stable or loop_limit.gain < 3:
        return None
    hunting = kind % 2 == 0
    kp, kd = drawn.controller.kp, drawn.controller.kd
    if hunting:
        drawn = replace(drawn, controller=gr.PID(kp, kp * float(rng.uniform(1.0, 3.0)), kd))
        found = gr.gain_limit(drawn.loop)
        if not found.stable or found.gain < 2 or found.lower_gain > 0.5:
            return None
    coulomb = kp * log_uniform(rng, 0.003, 0.03)
    duration = float(rng.uniform(15, 30))
    count = int(duration / drawn.tick) + 1
    if hunting:
        reference = np.where(np.arange(count) * drawn.tick < 0.5, 0.0, coulomb / kp * float(rng.uniform(2, 8)))
    else:
        reference = np.arange(count) * drawn.tick * coulomb / kp * float(rng.uniform(0.2, 1.0))
    law = Friction(coulomb, coulomb * float(rng.uniform(1.3, 2.0)), coulomb / kp * float(rng.uniform(0.3, 1.0)))
    step = coulomb / kp * log_uniform(rng, 1e-4, 1e-2)
    scenario = Scenario(reference[:, None], duration, noise=step * float(rng.uniform(0, 0.5)), seed=int(rng.integers(1e6)), limit=50.0)
    bed = Testbed(drawn.loop, motor_friction=law, motor_resolution=step, substep=drawn.tick / 2)
    run = simulate(bed, scenario)
    if run.diverged or (size := swing(run.error[:, 0])) < 20 * step or reversals(run.error[:, 0]) < 8:
        return None
    smooth = simulate(replace(bed, motor_friction=Friction()), scenario)
    if smooth.diverged or swing(smooth.error[:, 0]) > 0.1 * size:
        return None
    record_ = Record(run.time, columns_of(rng, run, coulomb), drawn.tick)
    return Recording(record_, drawn.described(rng), "stick_slip", "hunting" if hunting else "ramp")


def lasts(values: np.ndarray, least: float) -> bool:
    """The last third swings by at least so much; it, and its last half, no less than as many rows before."""

    def grows(count: int) -> bool:
        return bool(np.std(values[-count:]) > 0.9 * np.std(values[-2 * count : -count]))

    return float(np.std(values[-(len(values) // 3) :])) > least and grows(len(values) // 3) and grows(len(values) // 6)


def reversals(values: np.ndarray) -> int:
    """How often the last two thirds cross their mean, with hysteresis."""
    part = values[len(values) // 3 :]
    part = (part - part.mean()) / max(float(part.std()), 1e-300)
    state = np.where(part > 0.5, 1, np.where(part < -0.5, -1, 0))
    state = state[state != 0]
    return int(np.count_nonzero(np.diff(state)))


def quantisation(rng: np.random.Generator, kind: int) -> Recording | None:
    """Coarse encoder steps in a stable loop of little margin."""
    drawn = draw(rng, damping=(0.01, 0.1))
    limit = gr.gain_limit(drawn.loop)
    if not limit.stable or not 1.2 < limit.gain < 1e4:
        return None
    drawn = drawn.scaled(limit.gain / log_uniform(rng, 1.15, 3.0))
    step = log_uniform(rng, 2e-4, 3e-3)
    duration = float(rng.uniform(2, 8))
    start = Start(motor_position=3 * step, link_position=3 * step)
    reference = step * float(rng.uniform(-0.5, 0.5))
    scenario = Scenario(
        reference, duration, noise=step * float(rng.choice([0, 0.1, 0.3])), seed=int(rng.integers(1e6)), start=start, limit=5.0
    )
    bed = Testbed(drawn.loop, motor_resolution=step, gravity=float(rng.choice([0, 1])) * 5 * step * drawn.controller.kp, substep=drawn.tick)
    run, smooth = simulate(bed, scenario), simulate(replace(bed, motor_resolution=0.0), replace(scenario, noise=0.0))
    if run.diverged or swing(run.motor_position[:, 0]) < 0.5 * step or swing(smooth.motor_position[:, 0]) > 0.05 * step:
        return None
    record_ = Record(run.time, columns_of(rng, run, swing(run.actual_torque[:, 0])), drawn.tick)
    return Recording(record_, drawn.described(rng), "quantisation", f"{limit.gain:.3g}")


def structural_resonance(rng: np.random.Generator, kind: int) -> Recording | None:
    """A third inertia on a spring behind the link, which the joint's file does not have: the loop drives its mode, or it rings for long."""
    ringing = kind % 2 == 1
    drawn = draw(rng)
    limit = gr.gain_limit(drawn.loop)
    if not limit.stable or not 2.5 < limit.gain < 1e4:
        return None
    drawn = drawn.scaled(limit.gain / float(rng.uniform(1.6, 4.0)))
    joint, tick, late = drawn.joint, drawn.tick, round(drawn.drive.delay / drawn.tick)
    drawn = replace(drawn, drive=replace(drawn.drive, delay=late * tick))
    modelled = [abs(r.imag) for r in gr.rightmost_roots(drawn.loop, count=6).roots if abs(r.imag) > 1 and -r.real / abs(r) < 0.2]
    lag = drawn.drive.delay + tick + 2 * drawn.drive.damping_ratio / drawn.drive.bandwidth
    for _ in range(30):
        share, ratio = float(rng.uniform(0.3, 0.7)), log_uniform(rng, 0.001, 0.004)
        if ringing:  # the link bends
            inertia = np.array([joint.motor_inertia, (1 - share) * joint.link_inertia, share * joint.link_inertia])
            omega = joint.antiresonance * float(rng.choice([rng.uniform(0.3, 0.7), rng.uniform(1.3, 4.0)]))
        else:  # the motor's side does, at a frequency that the delay turns round
            inertia = np.array([(1 - share) * joint.motor_inertia, share * joint.motor_inertia, joint.link_inertia])
            omega = float(rng.uniform(1.7, 3.5)) / lag
        spring = omega**2 * np.prod(inertia[1:] if ringing else inertia[:2]) / np.sum(inertia[1:] if ringing else inertia[:2])
        extra = np.array([spring, 2 * ratio * spring / omega])
        springs = np.column_stack([(joint.stiffness, joint.damping), extra] if ringing else [extra, (joint.stiffness, joint.damping)])
        chain = Chain(
            inertia,
            *springs,
            bandwidth=drawn.drive.bandwidth,
            damping_ratio=drawn.drive.damping_ratio,
            resolution=1e-6,
        )
        s = np.log(max((z for z in chain_roots(chain, drawn, late) if z.imag > 0), key=abs)) / tick
        wanted = 0 < -s.real / abs(s) < 0.006 if ringing else 0.001 < s.real / abs(s) < 0.05
        if wanted and s.imag * tick < 0.9 and not any(abs(s.imag / m - 1) < 0.15 for m in modelled):
            break
    else:
        return None
    ticks = int(max(12 / s.imag / 0.01 if s.real < 0 else 12 / s.real, 0.8 if ringing else 0) / tick)
    if not 300 < ticks < 8000:
        return None
    kp, kd, past = drawn.controller.kp, drawn.controller.kd, [0.0]
    half = max(1, round(math.pi / s.imag / tick))
    push = np.zeros(ticks)
    push[20 : 20 + half] = (1e-2 if ringing else 1e-5) * np.sum(inertia) * s.imag**2 * float(rng.uniform(0.2, 1))

    def command(k: int, reading: float) -> float:
        speed = (reading - past[0]) / tick
        past[0] = reading
        return push[k] - kp * reading - kd * speed

    columns = record(chain, command, ticks, tick, late, substeps=3)
    if not np.all(np.isfinite(columns["motor_position"])):
        return None
    position = columns["motor_position"]
    end = int(np.argmax(np.abs(position) > 0.5)) or ticks
    if end < 300 or tone(position[-(-3 * end // 4) : end], s.imag * tick) < 10 * chain.resolution:
        return None
    log = {name: columns[name][:end] for name in ("target_torque", "motor_position")}
    log["actual_torque"] = noisy(rng, columns["actual_torque"][:end], 0.002 * float(np.std(columns["actual_torque"][:end])), 0.0)
    log["reference"] = np.zeros(end)
    record_ = Record(np.arange(end) * tick, log, tick)
    return Recording(record_, drawn.described(rng), "structural_resonance", "ringing" if s.real < 0 else "driven", s.imag)


def tone(values: np.ndarray, turn: float) -> float:
    """Amplitude at `turn` [rad per row], beside a straight line, by least squares."""
    rows = np.arange(len(values))
    basis = np.column_stack([np.cos(turn * rows), np.sin(turn * rows), np.ones(len(rows)), rows])
    return float(np.hypot(*np.linalg.lstsq(basis, values, rcond=None)[0][:2]))


def chain_roots(chain: Chain, drawn: Drawn, late: int) -> np.ndarray:
    """z of the sampled loop around the chain, by matrix exponential, for the choice of cases."""
    from scipy.linalg import expm

    count, w = len(chain.inertia), chain.bandwidth
    size = 2 * count + 2
    a = np.column_stack([replace(chain, coulomb=0.0).slope(column, 0.0) for column in np.eye(size)])
    b = np.zeros(size)
    b[-1] = w * w
    whole = expm(np.block([[a, b[:, None]], [np.zeros((1, size + 1))]]) * drawn.tick)
    kp, kd = drawn.controller.kp, drawn.controller.kd / drawn.tick
    total = size + 1 + late  # plant, last reading, commands under way
    z = np.zeros((total, total))
    z[:size, :size] = whole[:size, :size]
    command = np.zeros(total)
    command[0], command[size] = -(kp + kd), kd
    if late:
        z[:size, size + late] = whole[:size, -1]
        z[size + 1] = command
        for k in range(1, late):
            z[size + 1 + k, size + k] = 1
    else:
        z[:size] += np.outer(whole[:size, -1], command)
    z[size, 0] = 1
    return np.linalg.eigvals(z)


def saturation(rng: np.random.Generator, kind: int) -> Recording | None:
    """Integral action: a loop that is stable as it is and unstable at lower gains, as a torque limit makes them after a large step."""
    drawn = draw(rng, damping=(0.02, 0.1), viscous=float(rng.choice([0.0, log_uniform(rng, 0.01, 0.5)])))
    kp, kd = drawn.controller.kp, drawn.controller.kd
    omega = math.sqrt(kp / (drawn.joint.motor_inertia + drawn.joint.link_inertia))
    drawn = replace(drawn, controller=gr.PID(kp, kp * omega * float(rng.uniform(0.3, 1.5)), kd))
    limit = gr.gain_limit(drawn.loop)
    if not limit.stable or limit.gain < 2 or not 0.1 < limit.lower_gain < 0.8:
        return None
    goal, step = float(rng.uniform(0.1, 1.0)), log_uniform(rng, 1e-6, 3e-5)
    duration = float(rng.uniform(8, 15)) * 2 * math.pi / omega
    if duration > 20_000 * drawn.tick:
        return None
    reference = np.where(np.arange(int(duration / drawn.tick) + 1) * drawn.tick < 0.3, 0.0, goal)
    scenario = Scenario(reference[:, None], duration, noise=0.3 * step, seed=int(rng.integers(1e6)), limit=float(rng.uniform(5, 20)) * goal)
    bed = Testbed(drawn.loop, motor_resolution=step, substep=drawn.tick)
    if (smooth := simulate(bed, scenario)).diverged or swing(smooth.motor_position[:, 0]) > 0.02 * goal:
        return None
    low, high, run = 0.0, 1.5 * kp * goal, smooth  # torque limits: with the lower one it runs away, with the higher one it settles
    for _ in range(int(rng.integers(6, 12))):
        most = (low + high) / 2
        tried = simulate(replace(bed, torque_limit=most), scenario)
        if tried.diverged or lasts(tried.error[:, 0], 0.1 * goal):
            low, run, limited = most, tried, most
        else:
            high = most
    if low == 0 or reversals(run.error[:, 0]) < 5:
        return None
    most = limited
    record_ = Record(run.time, columns_of(rng, run, most, clips=True), drawn.tick)
    return Recording(record_, drawn.described(rng), "saturation", "growing" if run.diverged else "sustained")


def quiet(rng: np.random.Generator, kind: int) -> Recording | None:
    """Well damped: at rest under noise, along smooth motion, steps, ramps, a policy's set-points, an oscillating set-point."""
    drawn = draw(rng, damping=(0.05, 0.2))
    limit = gr.gain_limit(drawn.loop)
    if not limit.stable or limit.gain < 2.5:
        return None
    drawn = drawn.scaled(min(limit.gain / float(rng.uniform(2.2, 6)), 30.0))
    found = gr.margins(drawn.loop)
    if not found.stable or found.phase_margin < math.radians(35):
        return None
    roots = [r for r in gr.rightmost_roots(drawn.loop, count=8).roots if r.imag > 1]
    if any(-r.real / abs(r) < 0.06 for r in roots):
        return None
    kp, duration = drawn.controller.kp, float(rng.uniform(4, 15))
    count = int(duration / drawn.tick) + 1
    time = np.arange(count) * drawn.tick
    kinds = ("rest", "sine", "multisine", "step", "steps", "ramp", "policy", "vibrating set-point")
    name = kinds[kind % len(kinds)]
    size = float(rng.uniform(0.05, 0.4))
    if name == "rest":
        reference = np.zeros(count)
    elif name == "sine":
        reference = size * np.sin(2 * np.pi * float(rng.uniform(0.2, 2)) * time)
    elif name == "multisine":
        reference = size * multisine(rng, time, rng.uniform(0.2, 5, 8)) / 3
    elif name == "step":
        reference = np.where(time < 0.3, 0.0, size)
    elif name == "steps":
        held = int(float(rng.uniform(0.4, 1.2)) / drawn.tick)
        reference = np.repeat(rng.uniform(-size, size, count // held + 1), held)[:count]
    elif name == "ramp":
        reference = size * time / duration * float(rng.uniform(1, 5))
    elif name == "policy":
        held = max(1, int(0.02 / drawn.tick))
        reference = np.repeat(np.cumsum(rng.normal(0, 0.03, count // held + 1)), held)[:count]
    else:
        reference = 0.1 * size * np.sin(2 * np.pi * float(rng.uniform(3, 15)) * time)
    step = log_uniform(rng, 1e-6, 1e-4)
    coulomb = float(rng.choice([0.0, 0.02])) * kp * size * (name != "ramp")
    bed = Testbed(
        drawn.loop,
        motor_friction=Friction(coulomb),
        motor_resolution=step,
        gravity=float(rng.choice([0.0, 0.2])) * kp * size,
        substep=drawn.tick / 4,
    )
    noise = step * float(rng.choice([0.0, 0.3, 1.0]))
    scenario = Scenario(reference[:, None], duration, noise=noise, seed=int(rng.integers(1e6)), limit=50.0)
    run, smooth = simulate(bed, scenario), simulate(replace(bed, motor_resolution=0.0), replace(scenario, noise=0.0))
    if run.diverged or swing(run.motor_position[:, 0] - smooth.motor_position[:, 0]) > 0.2 * step:
        return None  # the encoder's steps or noise keep it in motion
    record_ = Record(run.time, columns_of(rng, run, 0.2 * kp * size), drawn.tick)
    return Recording(record_, drawn.described(rng), "quiet", name)


MAKERS = {f.__name__: f for f in (gain_limit, stick_slip, quantisation, structural_resonance, saturation, quiet)}


def recording(cause: str, index: int, seed: int = SEED) -> Recording:
    """The `index`th of a cause: the first draw in which that cause, and no other, makes it vibrate."""
    rng = np.random.default_rng([seed, 5, list(MAKERS).index(cause), index])
    while True:
        made = MAKERS[cause](rng, index)
        if made is not None:
            return made
