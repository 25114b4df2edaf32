"""Closed-loop roots of n coupled joints, whole: the textbook's equations as one matrix, and its eigenvalues. Nothing of gainroom is used.

    J θ̈ = τ_m − τ_J − D_m θ̇,   τ_J = K (θ − q) + B (θ̇ − q̇),   M_l q̈ = τ_J − D_l q̇ − G q − ground,   τ_m = C(s) e^{−sT} u,   u = −D y

The links may be held in some directions: M_l⁻¹ = W is given, W = R Rᵀ, q = R ξ. Continuous: every delay line on Chebyshev points (Breda,
Maset and Vermiglio 2005). Sampled: hold, any delay, whole ticks as a chain of states (Åström and Wittenmark, sec. 2.3).
"""

from dataclasses import dataclass, replace
from math import tan

import numpy as np
from scipy.linalg import expm
from scipy.signal import tf2ss

SILENT = 1e-6  # relative change of a root with all gains, below which they do not move it
BESIDE = 1e-5  # damping ratio of a root that may lie on the boundary
SLOW = 3e-4  # [1/s] of a real root that has passed 0, and more than round-off moves a double root that rests there
AT_REST = 2e-2  # [1/s] of roots at 0 of motions that no gain holds, which come in twos and threes, known to a root of round-off


@dataclass(frozen=True)
class System:
    """x' = a x + b u, y = c x + d u."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray

    def after(self, first: "System") -> "System":
        zero = np.zeros((len(first.a), len(self.a)))
        a = np.block([[first.a, zero], [self.b @ first.c, self.a]])
        return System(a, np.vstack([first.b, self.b @ first.d]), np.hstack([self.d @ first.c, self.c]), self.d @ first.d)


def static(d) -> System:
    d = np.atleast_2d(d)
    return System(np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((d.shape[0], 0)), d)


def of_ratio(num, den, copies: int) -> System:
    """num/den, highest power first, in `copies` channels."""
    return System(*(np.kron(np.eye(copies), part) for part in tf2ss(np.atleast_1d(num) / den[0], np.atleast_1d(den) / den[0])))


def beside(first: System, second: System) -> System:
    """Same input, outputs stacked."""
    a = np.block([[first.a, np.zeros((len(first.a), len(second.a)))], [np.zeros((len(second.a), len(first.a))), second.a]])
    c = np.block([[first.c, np.zeros((len(first.c), len(second.a)))], [np.zeros((len(second.c), len(first.a))), second.c]])
    return System(a, np.vstack([first.b, second.b]), c, np.vstack([first.d, second.d]))


@dataclass(frozen=True)
class Machine:
    """Shapes: W (n, n); motor_inertia, stiffness, damping, motor_viscous, link_viscous (n,); stiffness inf: rigid.

    gravity          (n, n) or None
    ground           None, or (coupling (n, c), inverse inertia (c, c), springs (c,), dampers (c,))
    bandwidth, damping_ratio, delay   (n,) of the drives; bandwidth inf: ideal
    gains            by (power of velocity, power of integral): (n, n)
    low_pass         on the velocity: None or (bandwidth, order, damping ratio)
    notch            None or (frequency, width, depth)
    """

    inverse_inertia: np.ndarray
    motor_inertia: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    motor_viscous: np.ndarray
    link_viscous: np.ndarray
    gravity: np.ndarray | None
    ground: tuple | None
    bandwidth: np.ndarray
    damping_ratio: np.ndarray
    delay: np.ndarray
    gains: dict
    low_pass: tuple | None
    notch: tuple | None
    side: str
    sample_time: float | None

    @property
    def size(self) -> int:
        return len(self.motor_inertia)

    @property
    def slowest(self) -> float:
        """[1/s] below which a root may be one at 0 that no gain moves; 0 where the gains reach every motion."""
        reach = [*self.gains.values(), *([self.inverse_inertia] if self.side == "link" else [])]
        return 0.0 if all(np.linalg.matrix_rank(one, tol=1e-9 * np.linalg.norm(one)) == self.size for one in reach) else AT_REST

    def scaled(self, factor: float) -> "Machine":
        return replace(self, gains={powers: factor * gain for powers, gain in self.gains.items()})

    def with_joint_scaled(self, joint: int, factor: float) -> "Machine":
        """The gains on what this joint measures, multiplied."""
        columns = np.ones(self.size)
        columns[joint] = factor
        return replace(self, gains={powers: gain * columns for powers, gain in self.gains.items()})

    def with_joint_raised(self, powers: tuple[int, int], joint: int, more: float) -> "Machine":
        """`more` of the gain of that kind by which this joint acts on itself."""
        gain = self.gains[powers].copy()
        gain[joint, joint] += more
        return replace(self, gains={**self.gains, powers: gain})

    def delayed(self, more: float) -> "Machine":
        return replace(self, delay=self.delay + more)


def mechanics(machine: Machine) -> System:
    """Motor torques (n) → measured positions and velocities (2n)."""
    n, whole = machine.size, machine.inverse_inertia
    soft = machine.ground is not None
    if soft:
        coupling, inertia, springs, dampers = machine.ground
        whole = np.block([[whole, coupling], [coupling.T, inertia]])
    values, vectors = np.linalg.eigh(whole)
    kept = values > 1e-12 * values.max()
    roots = vectors[:, kept] * np.sqrt(values[kept])
    links = roots.shape[1]
    elastic = np.isfinite(machine.stiffness)
    size = links + np.count_nonzero(elastic)
    link = np.zeros((n, size))
    link[:, :links] = roots[:n]
    motor = link.copy()
    motor[elastic] = 0.0
    motor[elastic, links + np.arange(np.count_nonzero(elastic))] = 1.0
    twist = (motor - link)[elastic]
    mass = np.diag(np.append(np.ones(links), np.zeros(size - links))) + motor.T @ np.diag(machine.motor_inertia) @ motor
    spring = twist.T @ np.diag(machine.stiffness[elastic]) @ twist
    damper = twist.T @ np.diag(machine.damping[elastic]) @ twist
    damper += motor.T @ np.diag(machine.motor_viscous) @ motor + link.T @ np.diag(machine.link_viscous) @ link
    if machine.gravity is not None:
        spring = spring + link.T @ machine.gravity @ link
    if soft:
        ground = np.hstack([roots[n:], np.zeros((len(springs), size - links))])
        spring, damper = spring + ground.T @ np.diag(springs) @ ground, damper + ground.T @ np.diag(dampers) @ ground
    a = np.block([[np.zeros((size, size)), np.eye(size)], [-np.linalg.solve(mass, spring), -np.linalg.solve(mass, damper)]])
    b = np.vstack([np.zeros((size, n)), np.linalg.solve(mass, motor.T)])
    read = motor if machine.side == "motor" else link
    return System(a, b, np.kron(np.eye(2), read), np.zeros((2 * n, n)))


def actuated(machine: Machine) -> System:
    """Torque behind the delay → measured positions and velocities."""
    plant = mechanics(machine)
    currents = None
    for w, zeta in zip(machine.bandwidth, machine.damping_ratio, strict=True):
        one = static([[1.0]]) if np.isinf(w) else of_ratio([w * w], [1.0, 2 * zeta * w, w * w], 1)
        if not np.isinf(w):  # like sizes of states: rates in units of the bandwidth
            one = System(np.array([[0.0, w], [-w, -2 * zeta * w]]), np.array([[0.0], [w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))
        currents = one if currents is None else _diagonal(currents, one)
    return plant.after(currents)


def _diagonal(first: System, second: System) -> System:
    def block(p, q):
        return np.block([[p, np.zeros((len(p), q.shape[1]))], [np.zeros((len(q), p.shape[1])), q]])

    return System(block(first.a, second.a), block(first.b, second.b), block(first.c, second.c), block(first.d, second.d))


def _tustin(num, den, frequency: float, step: float):
    """s → ω/tan(ωT/2) (z − 1)/(z + 1)."""
    rate = frequency / tan(frequency * step / 2)
    degree = len(den) - 1

    def mapped(poly):
        total = np.zeros(degree + 1)
        for power, coefficient in enumerate(reversed(np.atleast_1d(poly))):
            term = np.array([coefficient * rate**power])
            for k in range(degree):
                term = np.polymul(term, [1.0, -1.0] if k < power else [1.0, 1.0])
            total = total + term
        return total

    return mapped(num), mapped(den)


def law(machine: Machine) -> System:
    """(positions, what velocity is made from) (2n) → torque command before the sign (n)."""
    n, step = machine.size, machine.sample_time
    position, motion = static(np.hstack([np.eye(n), np.zeros((n, n))])), static(np.hstack([np.zeros((n, n)), np.eye(n)]))
    velocity = static(np.eye(n))
    if step is not None:
        velocity = of_ratio([1.0, -1.0], [step, 0.0], n)
    if machine.low_pass is not None:
        w, order, zeta = machine.low_pass
        num, den = ([w], [1.0, w]) if order == 1 else ([w * w], [1.0, 2 * zeta * w, w * w])
        velocity = of_ratio(*(_tustin(num, den, w, step) if step is not None else (num, den)), n).after(velocity)
    signals = beside(position, velocity.after(motion))
    nothing = np.zeros((n, n))
    direct = static(np.hstack([machine.gains.get((0, 0), nothing), machine.gains.get((1, 0), nothing)]))
    integral = np.hstack([machine.gains.get((0, 1), nothing), machine.gains.get((1, 1), nothing)])
    total = direct
    if np.any(integral):
        memory = of_ratio([1.0], [1.0, 0.0], n) if step is None else of_ratio([step, 0.0], [1.0, -1.0], n)
        both = beside(direct, memory.after(static(integral)))
        total = System(both.a, both.b, both.c[:n] + both.c[n:], both.d[:n] + both.d[n:])
    result = total.after(signals)
    if machine.notch is not None:
        w, width, depth = machine.notch
        num, den = [1.0, depth * width * w, w * w], [1.0, width * w, w * w]
        result = of_ratio(*(_tustin(num, den, w, step) if step is not None else (num, den)), n).after(result)
    return result


def roots(machine: Machine, slowest: float | None = None) -> np.ndarray:
    """Closed-loop roots in s [1/s]; sampled: ln(z)/T_s. Without those that rest or ring on the boundary and that no gain moves.

    slowest   size below which roots are not told from those at rest; None: the machine's own

    Continuous with delays: all that lie near or right of the imaginary axis.
    """
    matrix, entry, command = (_sampled if machine.sample_time is not None else _continuous)(machine)
    values = np.linalg.eigvals(matrix)
    found = values if machine.sample_time is None else np.log(np.where(values == 0, 1e-300, values).astype(complex)) / machine.sample_time
    kept = np.abs(found) > (machine.slowest if slowest is None else slowest)
    for k in np.flatnonzero(kept & (np.abs(found.real) < BESIDE * np.abs(found))):
        shifted = matrix - (values[k] + 1e-13 * np.abs(values).max()) * np.eye(len(matrix))
        right, left = (np.linalg.solve(one, np.linalg.solve(one, np.ones(len(matrix)))) for one in (shifted, shifted.T))
        slope = (left @ entry) @ (command @ right) / (left @ right)  # by the gains; in z as in s but for the step
        kept[k] = abs(slope) > SILENT * abs(found[k]) * (machine.sample_time or 1.0)
    return found[kept]


def unstable(machine: Machine, slowest: float | None = None) -> int:
    """Roots right of the imaginary axis, outside the unit circle; see `roots`."""
    return int(np.count_nonzero(roots(machine, slowest).real > 0))


def topples(machine: Machine, slow: float = SLOW) -> bool:
    """True where an odd number of real roots lies right of `slow`: there det(sI − A + B e^{−sT} C) < 0, which is > 0 far to the right.

    Sees a root that has passed 0 where `roots` does not tell it from those that rest there.
    """
    if machine.sample_time is not None:
        matrix = _sampled(machine)[0]
        return bool(np.linalg.slogdet(np.exp(slow * machine.sample_time) * np.eye(len(matrix)) - matrix)[0] < 0)
    body = law(machine).after(actuated(machine))
    return bool(np.linalg.slogdet(slow * np.eye(len(body.a)) - body.a + body.b * np.exp(-slow * machine.delay) @ body.c)[0] < 0)


def _continuous(machine: Machine):
    plant, control = actuated(machine), law(machine)
    body = control.after(plant)
    n, states = machine.size, len(body.a)
    assert not np.any(body.d), "a torque that passes straight through"
    lines = np.flatnonzero(machine.delay > 0)
    # A vibration that turns by φ within the delay is resolved to ten digits by 10 + φ/2 nodes; what is faster than the drives is small.
    fastest = min(np.abs(np.linalg.eigvals(plant.a)).max(), 4000.0)
    nodes = 10 + int(np.ceil(fastest * machine.delay.max(initial=0.0) / 2))
    size = states + nodes * len(lines)
    matrix = np.zeros((size, size))
    matrix[:states, :states] = body.a
    command = np.zeros((n, size))
    command[:, :states] = -body.c
    entry = np.zeros((size, n))
    direct = np.flatnonzero(machine.delay == 0)
    matrix[:states] += body.b[:, direct] @ command[direct]
    entry[:states, direct] = body.b[:, direct]
    points = np.cos(np.pi * np.arange(nodes + 1) / nodes)
    weight = np.append(2.0, np.append(np.ones(nodes - 1), 2.0)) * (-1.0) ** np.arange(nodes + 1)
    change = np.outer(weight, 1 / weight) / (points[:, None] - points[None, :] + np.eye(nodes + 1))
    change -= np.diag(change.sum(axis=1))
    for k, line in enumerate(lines):
        rows = states + k * nodes + np.arange(nodes)
        scaled = change * (2 / machine.delay[line])
        matrix[np.ix_(rows, rows)] = scaled[1:, 1:]
        matrix[rows] += np.outer(scaled[1:, 0], command[line])
        entry[rows, line] = scaled[1:, 0]
        matrix[:states, rows[-1]] += body.b[:, line]
    return matrix, entry, command


def _sampled(machine: Machine):
    step, n = machine.sample_time, machine.size
    plant = actuated(machine)
    states = len(plant.a)
    both = np.block([[plant.a, plant.b], [np.zeros((n, states + n))]])

    def over(time):
        flow = expm(time * both)
        return flow[:states, :states], flow[:states, states:]

    transition, _ = over(step)
    whole = np.floor(machine.delay / step + 1e-9).astype(int)
    rest = np.maximum(machine.delay / step - whole, 0.0)
    rest[rest < 1e-9] = 0.0
    longest = int(whole.max()) + 1
    control = law(machine)
    read = np.vstack([plant.c[:n], plant.c[:n]])
    memory = len(control.a)
    size = states + memory + longest * n
    matrix = np.zeros((size, size))
    command = np.zeros((n, size))
    command[:, :states], command[:, states : states + memory] = -control.d @ read, -control.c
    matrix[:states, :states] = transition
    matrix[states : states + memory, :states] = control.b @ read
    matrix[states : states + memory, states : states + memory] = control.a
    entry = np.zeros((size, n))

    def place(joint, age):
        """Row that gives the command of `joint` `age` ticks ago."""
        row = np.zeros(size)
        row[states + memory + (age - 1) * n + joint] = 1.0
        return command[joint] if age == 0 else row

    for joint in range(n):
        late = rest[joint] * step
        after, now = over(step - late)
        _, before = over(late)
        matrix[:states] += np.outer(now[:, joint], place(joint, whole[joint]))
        matrix[:states] += np.outer((after @ before)[:, joint], place(joint, whole[joint] + 1))
        if whole[joint] == 0:
            entry[:states, joint] += now[:, joint]
    first = states + memory
    matrix[first : first + n] = command
    entry[first : first + n] = np.eye(n)
    for age in range(1, longest):
        matrix[first + age * n : first + (age + 1) * n, first + (age - 1) * n : first + age * n] = np.eye(n)
    return matrix, entry, command


def response(machine: Machine, omega: np.ndarray) -> np.ndarray:
    """L at jω or e^{jωT_s} (k, n, n), torque command → measured → torque command, delays included; continuous machines only."""
    plant, control = actuated(machine), law(machine)
    body = control.after(plant)
    s = 1j * omega[:, None, None]
    through = body.c @ np.linalg.solve(
        s * np.eye(len(body.a)) - body.a, np.broadcast_to(body.b.astype(complex), (len(omega), *body.b.shape))
    )
    return (through + body.d) * np.exp(-1j * omega[:, None, None] * machine.delay)


def turns(machine: Machine, phase: float, near: float, lowest: float = 1e-3) -> int:
    """How many times more often det(I + e^{−j phase} L(jω)) turns about 0 than det(I + L(jω)) does, ω > 0; continuous machines.

    Not 0 once a smaller phase of the same sign has put a root at some jω. `near` [rad/s]: where to look closely; `lowest`
    [rad/s]: where to begin.
    """
    fastest = np.abs(np.linalg.eigvals(actuated(machine).a)).max()
    omega = np.unique(np.concatenate([
        np.geomspace(lowest, 30 * fastest, 1500), near * (1 + np.concatenate([s * np.geomspace(1e-7, 0.05, 80) for s in (-1, 1)])),
    ]))  # fmt: skip
    eye, twist = np.eye(machine.size), np.array([1.0, np.exp(-1j * phase)])[:, None, None]

    def returned(loops):
        return eye + twist[:, None] * loops  # (2, k, n, n)

    loops = response(machine, omega)
    for _ in range(60):
        # det(I + L + Δ) = det(I + L) det(I + (I + L)⁻¹ Δ), which turns by less than n asin(1/(n + 1)) < π/2 where that is so small.
        change = np.linalg.solve(returned(loops)[:, :-1], twist[:, None] * np.diff(loops, axis=0))
        rough = (np.linalg.norm(change, axis=(2, 3)).max(axis=0) * (machine.size + 1) > 1) & (np.diff(omega) > 1e-12 * omega[1:])
        if not rough.any():
            break
        assert len(omega) < 50_000, "loci that turn too often to be followed"
        spots = np.flatnonzero(rough)
        middle = 0.5 * (omega[spots] + omega[spots + 1])
        omega, loops = np.insert(omega, spots + 1, middle), np.insert(loops, spots + 1, response(machine, middle), axis=0)
    signs = np.linalg.slogdet(returned(loops))[0]
    plain, turned = np.angle(signs[:, 1:] * signs[:, :-1].conj()).sum(axis=1)

    def shift(at):
        loci = np.linalg.eigvals(response(machine, np.array([at]))[0])
        return np.angle((1 + twist[1, 0, 0] * loci) / (1 + loci)).sum()

    return round((turned - plain - (shift(omega[-1]) - shift(omega[0]))) / (2 * np.pi))
