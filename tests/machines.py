"""Random coupled loops, each described twice: for gainroom, and for the independent roots of independent/machine.py."""

from dataclasses import dataclass, replace

import numpy as np

import gainroom as gr
from gainroom.robot.tasks import TaskPPI
from gainroom.system.plant import Compliance
from independent.machine import Machine, unstable


@dataclass(frozen=True)
class Pair:
    """The same loop, and what kind it is."""

    loop: gr.Loop
    machine: Machine
    kind: str

    def scaled(self, factor: float) -> "Pair":
        return Pair(self.loop.scaled(factor), self.machine.scaled(factor), self.kind)


def between(rng: np.random.Generator, low: float, high: float, size=None):
    """Evenly in the logarithm."""
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def paired(machine: Machine, controller, kind: str) -> Pair:
    ground = None if machine.ground is None else Compliance(*machine.ground)
    plant = gr.Plant(
        machine.inverse_inertia, machine.motor_inertia, machine.stiffness, machine.damping, machine.motor_viscous, machine.link_viscous,
        gravity_stiffness=machine.gravity, compliance=ground,
    )  # fmt: skip
    drives = [gr.Drive(*of) for of in zip(machine.bandwidth.tolist(), machine.damping_ratio.tolist(), machine.delay.tolist(), strict=True)]
    return Pair(gr.build_loop(plant, drives, controller, machine.side, machine.sample_time), machine, kind)


def limbs(seed: int, number: int) -> Pair:
    """2 or 4 equal limbs of 2 or 3 joints, weakly coupled through the base: legs of a biped or quadruped."""
    rng = np.random.default_rng([seed, 1, number])
    count, joints = int(rng.choice([2, 4])), int(rng.choice([2, 3]))
    mixing = rng.normal(size=(joints, joints)) + 1.5 * np.eye(joints)
    own = mixing @ mixing.T * between(rng, 0.1, 10)
    push = rng.normal(size=(joints, joints)) / joints
    coupling = between(rng, 1e-4, 0.1) * np.trace(own) / joints
    weight = between(rng, 1e-4, 0.1) * np.trace(own) / joints  # without a base this heavy, limbs would be exactly equal
    base = np.ones((count, count)) if rng.random() < 0.6 else np.outer(signs := rng.choice([-1.0, 1.0], count), signs)
    w = np.kron(np.eye(count), own) + coupling * np.kron(base, push @ push.T) + weight * np.kron(np.eye(count), np.eye(joints))
    size = count * joints

    def each(values):
        return np.tile(values, count)

    sampled = number % 4 == 3
    step = float(rng.choice([5e-4, 1e-3])) if sampled else None
    delay = step * int(rng.integers(1, 6)) if sampled else between(rng, 5e-4, 6e-3)
    inertia = each(between(rng, 0.05, 2.0, joints))
    crossover = rng.uniform(0.05, 0.4) / (delay + 1.5 * (step or 0.0))
    kd = inertia * crossover * each(rng.uniform(0.5, 1.5, joints))
    kp = kd * crossover * each(between(rng, 0.02, 0.5, joints))
    stiffness = each(between(rng, 2e3, 5e4, joints))
    machine = Machine(
        w, inertia, stiffness, each(between(rng, 2e-4, 5e-3, joints)) * np.sqrt(stiffness * inertia), np.zeros(size), np.zeros(size), None,
        None, np.full(size, between(rng, 1500, 6000)), np.full(size, 0.9), np.full(size, float(delay)),
        {(0, 0): np.diag(kp), (1, 0): np.diag(kd)}, None, None, "motor", step,
    )  # fmt: skip
    return paired(machine, gr.PD(kp, kd), f"{count} limbs of {joints}, {'sampled' if sampled else 'continuous'}")


def chain(seed: int, number: int) -> Pair:
    """2 to 12 joints of every sort: held links, springs under them, gravity, tasks, filters, different drives, both sides, sampled."""
    rng = np.random.default_rng([seed, 2, number])
    n = int(rng.integers(2, 5)) if (share := rng.random()) < 0.7 else int(rng.integers(5, 8) if share < 0.9 else rng.integers(8, 13))
    spread = between(rng, 1, 100, n)
    directions, _ = np.linalg.qr(rng.normal(size=(n, n)))
    singular = rng.random() < 0.3
    values = between(rng, 0.1, 5) * spread
    if singular:
        values[: int(rng.integers(1, max(2, n // 2 + 1)))] = 0.0
    w = (directions * values) @ directions.T
    w = (w + w.T) / 2
    inertia = between(rng, 0.03, 3.0) * rng.uniform(0.3, 3.0, n)
    stiffness = between(rng, 1e3, 1e5) * rng.uniform(0.3, 3.0, n)
    damping = between(rng, 1e-4, 2e-2) * np.sqrt(stiffness * inertia)
    side = "link" if rng.random() < 0.3 else "motor"
    sampled = rng.random() < 0.4
    step = float(rng.choice([5e-4, 1e-3, 2e-3])) if sampled else None
    delay = np.full(n, step * int(rng.integers(0, 6)) if sampled and rng.random() < 0.6 else between(rng, 2e-4, 6e-3))
    bandwidth, ratio = np.full(n, between(rng, 1000, 6000)), np.full(n, rng.uniform(0.6, 1.1))
    if rng.random() < 0.3:
        delay, bandwidth = delay * rng.uniform(0.5, 1.5, n), bandwidth * rng.uniform(0.7, 1.4, n)
    viscous = rng.random() < 0.3
    motor_viscous, link_viscous = (rng.uniform(0, 0.02, n) * np.sqrt(stiffness * inertia) if viscous else np.zeros(n) for _ in range(2))
    gravity = ground = None
    words = ["sampled" if sampled else "continuous", side]
    if singular:
        words.append("singular")
    if rng.random() < 0.25:
        slope = rng.normal(size=(n, n)) * between(rng, 1e-3, 3e-2) * stiffness.mean()
        gravity = slope + slope.T
        words.append("gravity")
    elif rng.random() < 0.2:
        count = int(rng.choice([1, 3, 6]))
        rows = rng.normal(size=(n + count, n + count))
        whole = rows @ rows.T * values.mean() / (n + count)
        w, coupling, inner = whole[:n, :n], whole[:n, n:], whole[n:, n:]
        springs = between(rng, 1e3, 1e6, count)
        ground = (coupling, inner, springs, between(rng, 1e-3, 0.1, count) * np.sqrt(springs / np.diagonal(inner)))
        words.append("compliant")
    total = float(delay.mean()) + 1.5 * (step or 0.0) + 2 / float(bandwidth.mean())
    slowest = 0.3 * np.sqrt(stiffness.min() / inertia.max()) if side == "link" else np.inf
    crossover = min(rng.uniform(0.05, 0.4) / total, slowest * rng.uniform(0.1, 1.0))
    load = inertia + 1 / np.maximum(np.diagonal(w), 1e-3) * (side == "link")
    kd = np.diag(load * crossover * rng.uniform(0.5, 1.5, n))
    if rng.random() < 0.25 and side == "motor":  # a task of fewer directions than joints, and another in what it leaves free
        rank = int(rng.integers(1, n + 1))
        jacobian = rng.normal(size=(rank, n))
        if rng.random() < 0.3:
            jacobian[-1] = jacobian[0] + between(rng, 1e-4, 1e-1) * jacobian[-1]
        kd = jacobian.T @ np.linalg.inv(jacobian @ np.diag(1 / inertia) @ jacobian.T) @ jacobian * crossover
        kd = (kd + kd.T) / 2
        words.append("task")
    share = between(rng, 0.02, 0.5)
    low_pass = None
    if rng.random() < 0.3:
        low_pass = (float(between(rng, 300, 1500)), int(rng.choice([1, 2])), 0.7)
        words.append("filter")
    notch = None
    if rng.random() < 0.15:
        notch = (float(min(np.sqrt(stiffness.mean() / inertia.mean()), 0.8 * np.pi / (step or 1e-9))), 0.5, 0.1)
        words.append("notch")
    filters = {
        "velocity_filter": gr.LowPass(*low_pass) if low_pass else None,
        "notches": (gr.Notch(*notch),) if notch else (),
    }
    kind = str(rng.choice(["pd", "pid", "ppi"], p=[0.5, 0.25, 0.25]))
    words.insert(0, kind)
    kp = kd * crossover * share
    scale = float(np.exp(rng.uniform(np.log(0.03), np.log(3.0))))
    kd, kp = scale * kd, scale * kp
    slow = crossover * share * between(rng, 0.02, 0.3)
    if kind == "pd":
        controller, gains = gr.PD(kp, kd, **filters), {(0, 0): kp, (1, 0): kd}
    elif kind == "pid":
        controller, gains = gr.PID(kp, slow * kp, kd, **filters), {(0, 0): kp, (1, 0): kd, (0, 1): slow * kp}
    else:
        outer = crossover * share
        controller = gr.PPI(outer, kd, slow * kd, **filters)
        gains = {(0, 0): outer * kd, (1, 0): kd, (0, 1): outer * slow * kd, (1, 1): slow * kd}
    machine = Machine(
        w, inertia, stiffness, damping, motor_viscous, link_viscous, gravity, ground, bandwidth, ratio, delay, gains, low_pass, notch, side,
        step,
    )  # fmt: skip
    return paired(machine, controller, " ".join(words))


def holding(seed: int, number: int) -> Pair:
    """`limbs` with an integral, and every other time gravity, which topples some of them; or, every fourth, PD with gravity."""
    rng, pair = np.random.default_rng([seed, 3, number]), limbs(seed, number)
    machine, size = pair.machine, pair.machine.size
    kp, kd = (np.diagonal(machine.gains[powers]) for powers in ((0, 0), (1, 0)))
    slow = between(rng, 0.02, 0.3) * float(np.median(kp / kd))
    kind = ("pid", "pd", "ppi", "pid")[number // 2 % 4]
    gravity = None
    if number % 2 or kind == "pd":
        slope = rng.normal(size=(size, size)) / np.sqrt(size)
        gravity = between(rng, 1e-2, 1.0) * (slope + slope.T) * float(kp.min())
    if kind == "pd":
        controller, gains = gr.PD(kp, kd), machine.gains
    elif kind == "pid":
        controller, gains = gr.PID(kp, slow * kp, kd), machine.gains | {(0, 1): np.diag(slow * kp)}
    else:
        controller = gr.PPI(kp / kd, kd, slow * kd)
        gains = {(0, 0): np.diag(kp), (1, 0): np.diag(kd), (0, 1): np.diag(slow * kp), (1, 1): np.diag(slow * kd)}
    return paired(replace(machine, gains=gains, gravity=gravity), controller, f"{kind}{' gravity' * (gravity is not None)}, {pair.kind}")


def directed(seed: int, number: int) -> Pair:
    """`limbs` under tasks whose gains differ from direction to direction, Γ = J̄ Λ diag(k) J: gain matrices that are not symmetric."""
    rng, pair = np.random.default_rng([seed, 4, number]), limbs(seed, number)
    machine, size = pair.machine, pair.machine.size
    rank = int(rng.integers(2, 4))  # of more no proof is tried (analysis/modal_loop.py)
    jacobian = rng.normal(size=(rank, size)) if number % 3 else np.eye(size)[:rank] + 0.3 * rng.normal(size=(rank, size))
    inner = np.linalg.inv(machine.inverse_inertia + np.diag(1 / machine.motor_inertia))
    torque = jacobian.T @ np.linalg.inv(jacobian @ np.linalg.solve(inner + np.diag(machine.motor_inertia), jacobian.T))
    rate = rng.uniform(0.05, 0.3) / (float(machine.delay.max()) + 1.5 * (machine.sample_time or 0.0))
    kd = rate * between(rng, 0.5, 1.5, rank)
    kp = kd * rate * between(rng, 0.02, 0.5, rank)
    slow = between(rng, 0.02, 0.2) * float(np.median(kp / kd))
    kind = ("pd", "pid", "ppi", "pd")[number // 2 % 4]

    def gain(of):
        return torque @ (np.broadcast_to(of, (rank,))[:, None] * jacobian)

    gains = {(0, 0): gain(kp), (1, 0): gain(kd)}
    if kind == "pd":
        controller = gr.PD(gains[0, 0], gains[1, 0])
    elif kind == "pid":
        gains[0, 1] = gain(slow * kp)
        controller = gr.PID(gains[0, 0], gains[0, 1], gains[1, 0])
    else:
        gains |= {(0, 1): gain(slow * kp), (1, 1): gain(slow * kd)}
        controller = TaskPPI(kp=kp / kd, kv=kd, ki=slow * kd, torque=torque, jacobian=jacobian)
    return paired(replace(machine, gains=gains), controller, f"{kind} of {rank} directions, {pair.kind}")


def hard(seed: int, number: int) -> Pair:
    """`holding` and `directed` with gearboxes that hardly damp, up to five times the delay, and slow current loops that ring.

    Their gains are lowered until the loop is stable, where that helps.
    """
    rng, pair = np.random.default_rng([seed, 5, number]), (holding, directed)[number % 2](seed, number)
    machine, longer = pair.machine, between(rng, 1.0, 5.0)
    delay = (
        machine.delay * longer
        if machine.sample_time is None
        else np.round(machine.delay * longer / machine.sample_time) * machine.sample_time
    )
    machine = replace(
        machine,
        damping=machine.damping * between(rng, 0.02, 1.0),
        delay=delay,
        bandwidth=np.full(machine.size, between(rng, 300, 5000)),
        damping_ratio=np.full(machine.size, rng.uniform(0.2, 1.0)),
    )
    assert pair.loop.parts is not None
    found = paired(machine, pair.loop.parts.controller, f"hard: {pair.kind}")
    return next((one for one in (found.scaled(0.4**k) for k in range(8)) if unstable(one.machine) == 0), found)


def harsh(seed: int, number: int) -> Pair:
    """`chain` and `limbs` with what machines may have worst: no damping at some joints, rigid ones among elastic ones, gravity that hardly
    holds or topples, motors a thousand times lighter than others, no delay or parts of a tick, current loops without lag or that ring.

    Two in three have their gains lowered until they are stable, where that helps.
    """
    rng, pair = np.random.default_rng([seed, 77, number]), (chain, chain, limbs)[number % 3](seed, number)
    machine, n = pair.machine, pair.machine.size
    if rng.random() < 0.5:
        machine = replace(machine, damping=machine.damping * rng.choice([1.0, 0.0, 1e-6, 1e-3], n))
    if rng.random() < 0.3:
        rigid = rng.random(n) < 0.5
        machine = replace(machine, stiffness=np.where(rigid, np.inf, machine.stiffness), damping=np.where(rigid, 0.0, machine.damping))
    if rng.random() < 0.4 and machine.ground is None:
        directions = np.linalg.qr(rng.normal(size=(n, n)))[0]
        least = max(float(np.abs(np.diagonal(machine.gains[0, 0])).min()), 1e-3)
        pulls = least * rng.choice([-1.0, 1.0], n) * between(rng, 1e-4, 0.3, n)
        machine = replace(machine, gravity=directions @ (pulls[:, None] * directions.T))
    if rng.random() < 0.3:
        machine = replace(machine, motor_inertia=machine.motor_inertia * np.where(rng.random(n) < 0.4, between(rng, 1e-3, 1e3, n), 1.0))
    if rng.random() < 0.3:
        part = 0.0 if machine.sample_time is None else machine.sample_time * rng.uniform(0, 1)
        machine = replace(machine, delay=machine.delay * rng.choice([0.0, 0.3, 1.0, 4.0]) + part)
    if rng.random() < 0.3:
        bandwidth = np.full(n, np.inf) if rng.random() < 0.5 else 0.2 * machine.bandwidth
        machine = replace(machine, bandwidth=bandwidth, damping_ratio=np.full(n, 0.15) if rng.random() < 0.5 else machine.damping_ratio)
    assert pair.loop.parts is not None
    found = paired(machine, pair.loop.parts.controller, f"{pair.kind}, harsh")
    if rng.random() < 1 / 3:
        return found
    return next((one for one in (found.scaled(0.3**k) for k in range(8)) if unstable(one.machine) == 0), found)
