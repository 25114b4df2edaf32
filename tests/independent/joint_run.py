"""An elastic joint under a sampled controller, followed in small steps, with everything that makes joints shake.

Up to three masses in a row, the first with the motor's encoder, the last the link. Positions and velocities go by Verlet's scheme, dry
friction as the impulse of a half step that can stop a mass but not turn it round (Moreau), and the drive's second-order lag by its
exponential. The linear loop is judged by a spectral radius. Nothing here knows the package.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import expm

PHASE = 0.12  # [rad] of the fastest spring per step, at most: Verlet's frequency error is its square over 24, 0.06 %


@dataclass(frozen=True)
class Joint:
    """SI, joint side. `gap` to either side and `cubic` [N m/rad³] of the first spring; `static` is the dry friction at rest.

    middle   (inertia, stiffness, damping) of a mass between motor and link, the spring toward the motor
    change   (time, factor) on the link's inertia
    """

    motor_inertia: float
    link_inertia: float
    stiffness: float
    damping: float
    motor_viscous: float = 0.0
    coulomb: float = 0.0
    static: float = 0.0
    stribeck: float = 0.05
    link_coulomb: float = 0.0
    gravity: float = 0.0
    gap: float = 0.0
    cubic: float = 0.0
    middle: tuple[float, float, float] | None = None
    change: tuple[float, float] | None = None

    @property
    def chain(self) -> tuple[list[float], list[float], list[float]]:
        """Inertias, springs and dampers from the motor to the link."""
        if self.middle is None:
            return [self.motor_inertia, self.link_inertia], [self.stiffness], [self.damping]
        inertia, stiffness, damping = self.middle
        return [self.motor_inertia, inertia, self.link_inertia], [stiffness, self.stiffness], [damping, self.damping]

    @property
    def resonance(self) -> float:
        """[rad/s] of two masses."""
        return math.sqrt(self.stiffness * (1 / self.motor_inertia + 1 / self.link_inertia))

    @property
    def inertia(self) -> float:
        return sum(self.chain[0])

    @property
    def fastest(self) -> float:
        """[rad/s] of the chain."""
        masses, springs, _ = self.chain
        return math.sqrt(max(np.linalg.eigvals(_laplace(springs) / np.array(masses)[:, None]).real))


@dataclass(frozen=True)
class Drive:
    """Second-order current loop, transport delay [s], torque limit [N m] of the drive, and of the controller, whose target is clipped."""

    bandwidth: float
    damping_ratio: float
    delay: float
    limit: float = math.inf
    target_limit: float = math.inf


@dataclass(frozen=True)
class Law:
    """kp (r − q) + ki ∫(r − q) − kd q̇, q̇ by difference, of the motor's or the link's encoder."""

    kp: float
    kd: float
    ki: float = 0.0
    side: str = "motor"

    def scaled(self, factor: float) -> "Law":
        return replace(self, kp=factor * self.kp, kd=factor * self.kd, ki=factor * self.ki)


@dataclass(frozen=True)
class Outer:
    """A slower loop that sets the set-point every `every` ticks from the reading of `late` ticks before: about `goal`, at most `most` away.

    kind "policy": r = goal − most tanh((gain (q − goal) + rate q̇)/most); "integral": r moves by gain (goal − q) per turn.
    """

    every: int
    late: int
    gain: float
    rate: float
    goal: float
    most: float
    kind: str = "policy"


@dataclass(frozen=True)
class Setup:
    """What runs: joint, drive, law, tick [s], encoder's step and noise [rad], torque noise [N m] on the motor, ripple (torque, periods
    per radian of the joint, phase), substeps at least: 4 have the loop's limit to 0.2 %."""

    joint: Joint
    drive: Drive
    law: Law
    tick: float
    step: float = 0.0
    noise: float = 0.0
    shaken: float = 0.0
    ripple: tuple[float, float, float] | None = None
    outer: Outer | None = None
    least: int = 4

    @property
    def substeps(self) -> int:
        return max(self.least, math.ceil(self.joint.fastest * self.tick / PHASE))

    @property
    def late(self) -> int:
        """Of the command, in substeps."""
        return round(self.drive.delay / self.tick * self.substeps)

    @property
    def delay(self) -> float:
        """[s] as it is run."""
        return self.late * self.tick / self.substeps


@dataclass(frozen=True)
class Run:
    """Columns by row; `true` [rad] is the motor's position itself. `away`: it went beyond `bound`, where the rows end."""

    setup: Setup
    columns: dict[str, np.ndarray]
    true: np.ndarray
    away: bool = False
    given: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def last(self) -> np.ndarray:
        return self.true[-(len(self.true) // 3) :]


def drive_step(drive: Drive, step: float) -> tuple[float, float, float, float]:
    """exp of the current loop's (torque, rate) over `step`."""
    w = drive.bandwidth
    e = expm(np.array([[0.0, 1.0], [-w * w, -2 * drive.damping_ratio * w]]) * step)
    return float(e[0, 0]), float(e[0, 1]), float(e[1, 0]), float(e[1, 1])


def run(
    setup: Setup,
    reference: np.ndarray,
    added: np.ndarray | None = None,
    outside: np.ndarray | None = None,
    seed: int = 0,
    bound: float = 10.0,
) -> Run:
    """From rest at 0: `reference` (ticks,) [rad], `added` (ticks,) to the target torque, `outside` (ticks,) torque on the link."""
    drive, law, outer, tick = setup.drive, setup.law, setup.outer, setup.tick
    ticks, n, late = len(reference), setup.substeps, setup.late
    h = tick / n
    rng = np.random.default_rng([seed, 77])
    read_noise = (setup.noise * rng.standard_normal(ticks)).tolist()
    shaken = (setup.shaken * rng.standard_normal(ticks)).tolist()
    push = [0.0] * ticks if added is None else np.asarray(added, dtype=float).tolist()
    load = [0.0] * ticks if outside is None else np.asarray(outside, dtype=float).tolist()
    asked = np.asarray(reference, dtype=float).tolist()
    advance, forces, order = _stepper(setup, h), drive_step(drive, h), setup.ripple
    e00, e01, e10, e11 = forces
    state, torque, rate = [0.0] * 6, 0.0, 0.0
    sent, made, seen, far, set_to, true = [], [], [], [], [], []
    last, integral, r, away = 0.0, 0.0, asked[0] if asked else 0.0, False
    for k in range(ticks):
        here = state[0] if law.side == "motor" else state[4]
        both = [state[0] + read_noise[k], state[4] + read_noise[k]]
        if setup.step:
            both = [setup.step * math.floor(value / setup.step + 0.5) for value in both]
        reading = both[0] if law.side == "motor" else both[1]
        seen.append(both[0])
        far.append(both[1])
        r = asked[k] if outer is None else _outer(outer, k, r, asked[k], seen, tick)
        if k == 0:
            last = reading
        integral += law.ki * (r - reading) * tick
        u = law.kp * (r - reading) - law.kd * (reading - last) / tick + integral + push[k]
        last = reading
        u = min(max(u, -drive.target_limit), drive.target_limit)
        sent.append(u)
        made.append(torque)
        set_to.append(r)
        true.append(here)
        if abs(here) > bound:
            away = True
            break
        for j in range(n):
            index = (k * n + j - late) // n
            demand = min(max(sent[index], -drive.limit), drive.limit) if index >= 0 else 0.0
            now = torque + shaken[k]
            off = torque - demand
            torque, rate = demand + e00 * off + e01 * rate, e10 * off + e11 * rate
            if order is not None:
                now += order[0] * math.sin(order[1] * state[0] + order[2])
            advance(state, now, torque + shaken[k], load[k], (k + j / n) * tick)
    columns = {"target_torque": sent, "actual_torque": made, "motor_position": seen, "link_position": far, "reference": set_to}
    return Run(setup, {name: np.array(values) for name, values in columns.items()}, np.array(true), away)


def _outer(outer: Outer, k: int, r: float, asked: float, seen: list[float], tick: float) -> float:
    """Set-point of row k."""
    if k % outer.every or k <= outer.late + outer.every:
        return r if k > outer.late + outer.every else asked
    goal = outer.goal + asked
    q, before = seen[k - outer.late], seen[k - outer.late - outer.every]
    if outer.kind == "integral":
        return min(max(r + outer.gain * (goal - q), goal - outer.most), goal + outer.most)
    return goal - outer.most * math.tanh((outer.gain * (q - goal) + outer.rate * (q - before) / (outer.every * tick)) / outer.most)


def _stepper(setup: Setup, h: float):
    """advance(state, torque now, torque then, outside, time): state is q, q̇ of motor, middle and link, in place."""
    joint, order = setup.joint, setup.ripple
    masses, springs, dampers = joint.chain
    three = len(masses) == 3
    jm, jl, gap, cubic = masses[0], masses[-1], joint.gap, joint.cubic
    k1, b1, k2, b2 = springs[0], dampers[0], springs[-1], dampers[-1]
    jx, viscous, gravity, half = masses[1], joint.motor_viscous, joint.gravity, h / 2
    coulomb, more, stribeck, link_dry = joint.coulomb, max(joint.static - joint.coulomb, 0.0), joint.stribeck, joint.link_coulomb
    change = joint.change

    def spring(stretch: float, speed: float) -> float:
        if gap:
            if stretch > gap:
                stretch -= gap
            elif stretch < -gap:
                stretch += gap
            else:
                return 0.0
        return k1 * stretch + b1 * speed + cubic * stretch * stretch * stretch

    def dried(speed: float, before: float, inertia: float, dry: float, most: float) -> float:
        if most:
            dry += most * math.exp(-((before / stribeck) ** 2))
        loss = half * dry / inertia
        return speed - loss if speed > loss else speed + loss if speed < -loss else 0.0

    def kick(x: list[float], torque: float, outside: float, link: float) -> None:
        q0, v0, q1, v1, q2, v2 = x
        if three:
            first, second = spring(q0 - q1, v0 - v1), k2 * (q1 - q2) + b2 * (v1 - v2)
            x[3] = v1 + half * (first - second) / jx
        else:
            first = second = spring(q0 - q2, v0 - v2)
        fast = v0 + half * (torque - first - viscous * v0) / jm
        slow = v2 + half * (second + outside - gravity * math.sin(q2)) / link
        x[1] = dried(fast, v0, jm, coulomb, more) if coulomb else fast
        x[5] = dried(slow, v2, link, link_dry, 0.0) if link_dry else slow

    def advance(x: list[float], now: float, then: float, outside: float, time: float) -> None:
        link = jl * change[1] if change is not None and time >= change[0] else jl
        kick(x, now, outside, link)
        x[0] += h * x[1]
        x[2] += h * x[3]
        x[4] += h * x[5]
        if order is not None:
            then += order[0] * math.sin(order[1] * x[0] + order[2])
        kick(x, then, outside, link)

    return advance


def _laplace(springs: list[float]) -> np.ndarray:
    count = len(springs) + 1
    matrix = np.zeros((count, count))
    for k, spring in enumerate(springs):
        matrix[k : k + 2, k : k + 2] += spring * np.array([[1, -1], [-1, 1]])
    return matrix


def roots(setup: Setup, factor: float = 1.0) -> np.ndarray:
    """z of the linear sampled loop, all gains times `factor`."""
    masses, springs, dampers = setup.joint.chain
    count, w, n, late = len(masses), setup.drive.bandwidth, setup.substeps, setup.late
    size = 2 * count + 2
    a = np.zeros((size, size))
    inverse = 1 / np.array(masses)[:, None]
    a[:count, count : 2 * count] = np.eye(count)
    a[count : 2 * count, :count] = -_laplace(springs) * inverse
    a[count : 2 * count, count : 2 * count] = -_laplace(dampers) * inverse
    a[count, count] -= setup.joint.motor_viscous / masses[0]
    a[count, size - 2], a[size - 2, size - 1] = 1 / masses[0], 1.0
    a[size - 1, size - 2 :] = -w * w, -2 * setup.drive.damping_ratio * w
    block = np.zeros((size + 1, size + 1))
    block[:size, :size], block[size - 1, size] = a, w * w
    one = expm(block * setup.tick / n)
    held = late // n + 1  # commands of before that a tick needs
    total = size + 2 + held  # plant, last reading, integral, commands of before
    z = np.zeros((total, total))
    law, read = setup.law.scaled(factor), 0 if setup.law.side == "motor" else count - 1
    command = np.zeros(total)
    command[read] = -law.kp - law.kd / setup.tick - law.ki * setup.tick
    command[size], command[size + 1] = law.kd / setup.tick, 1.0
    plant = np.eye(size, total)
    for j in range(n):
        back = -((j - late) // n)  # ticks before this one
        plant = one[:size, :size] @ plant + np.outer(one[:size, size], command if back == 0 else np.eye(total)[size + 1 + back])
    z[:size] = plant
    z[size, read] = 1.0
    z[size + 1, size + 1], z[size + 1, read] = 1.0, -law.ki * setup.tick
    z[size + 2] = command
    for k in range(1, held):
        z[size + 2 + k, size + 1 + k] = 1.0
    if not law.ki:  # the integral has no part in it
        z = np.delete(np.delete(z, size + 1, 0), size + 1, 1)
    return np.linalg.eigvals(z)


def radius(setup: Setup, factor: float = 1.0) -> float:
    return float(np.max(np.abs(roots(setup, factor))))


def limit(setup: Setup, most: float = 1e4) -> float:
    """Least factor > 1 on all gains from which on the loop is unstable; 1: it is; `most`: none up to there."""
    if radius(setup) >= 1:
        return 1.0
    low = 1.0
    while low < most:
        if radius(setup, 1.1 * low) >= 1:
            break
        low *= 1.1
    else:
        return most
    high = 1.1 * low
    for _ in range(25):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if radius(setup, middle) < 1 else (low, middle)
    return low


def damping(setup: Setup) -> float:
    """Least damping ratio of the loop's oscillating roots."""
    s = np.log(roots(setup).astype(complex) + 1e-300) / setup.tick
    s = s[(np.abs(s.imag) > 1e-3) & (np.abs(s.imag) * setup.tick < 3.0)]
    return float(np.min(-s.real / np.abs(s))) if len(s) else 1.0
