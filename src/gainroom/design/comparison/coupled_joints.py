"""Several joints closed together: σ_max of their sensitivity, delay and compliance, and how these move with every joint's parameters.

H leads from the torques (n) into the current loops to the measured positions, D from the load torques; H_q and D_q lead to the links.
Each joint has κ = Σ_p h_p K_p over its paths p: K_p is its law there, h_p hold and delay of the path (1 where H has them). Opened at those
torques,

    S = (I + κ H)⁻¹,   T_p = κ_p H S,   q/d = D_q − H_q S κ D

and the ceilings are σ_max(S) ≤ Ms, Σ_p σ_max(T_p) |1 − e^(−jωτ_p)| ≤ 1, and the rms torque of every motor that the encoders' noise makes,
of which S κ_p passes what path p hears. With factors E_p = diag(e^(−jωt_j)) of further delays t_j ≤ τ_p,

    I + Σ_p E_p κ_p H = (I − Σ_p (I − E_p) T_p) (I + κ H),

so that the loops are stable for every such delay, each joint's by itself (small gain). n = 1 are the ceilings of closed_loop.py.

A singular value moves by dσ = Re(uᴴ dM v), with its vectors u and v, and dS = −S dκ H S, dT_p = (dκ_p − T_p dκ) H S,
d(q/d) = −H_q S dκ R, R = (I + H κ)⁻¹ D = D − H S κ D.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...analysis.peak_gain import peak_gain
from ...system.assembly import current_loop
from ...system.delay_reserve import turned
from ...system.linear.arrays import Complexes, Floats, Integers
from ...system.linear.state_space import StateSpace
from ...system.system import System
from .closed_loop import as_many
from .compared_joint import Spot
from .exact_joint import SENSORS, sampled_state
from .joint_responses import DRIVE, HOST, Joint, Opened, quadrature
from .local_search import STEP, Model, followed, tops
from .structure_search import Problem, rounded
from .structures import Structure
from .two_rates import largest_root, laws_beside

SENSITIVITY, DELAY, COMPLIANCE = range(3)
"""Kinds of curves."""
THINNED = 4
"""One in so many frequencies serves for the curvature of the noise, which is a smooth integral."""
LAW_STEP = 1e-5
"""Step of a coordinate for central differences of a law, whose logarithm is smooth: off by 1e-10 of it."""
ZOOMS, BETWEEN, TOPS = 4, 25, 6
"""Rounds in which the highest peaks of a curve are sampled anew between their neighbours, at how many frequencies, and how many peaks.

A peak is a parabola there, and each round narrows it by 12: its top is found to 1e-9."""


@dataclass(frozen=True)
class Motions:
    """Responses (k, n, n) at omega (k,) [rad/s]: H, H_q, D and D_q, and h (k, n) of every path.

    heard   density of a path's white noise of 1 per sample in what its hold puts out, over |h|², behind the current loop if there are two
            paths (k, n)
    """

    omega: Floats
    moved: Complexes
    linked: Complexes
    loaded: Complexes
    given: Complexes
    paths: Mapping[str, Complexes]
    heard: Mapping[str, Floats]

    def part(self, which: slice) -> "Motions":
        """Responses at some of the frequencies."""
        paths, heard = ({path: one[which] for path, one in each.items()} for each in (self.paths, self.heard))
        moved, linked, loaded, given = (one[which] for one in (self.moved, self.linked, self.loaded, self.given))
        return Motions(self.omega[which], moved, linked, loaded, given, paths, heard)


def motions(joints: Sequence[Joint], omega: Floats, rows: Integers) -> Motions:
    """Responses at omega (k,) [rad/s], each of the group of joints whose index `rows` (k,) has."""
    opened, path = joints[0].opened, joints[0].path
    size = opened.size
    found = np.empty((len(omega), len(SENSORS) * size, 2 * size), dtype=complex)
    for k, joint in enumerate(joints):
        if np.any(own := rows == k):
            found[own] = joint.sensed(omega[own])
    seen, link = (SENSORS.index(name) * size for name in (opened.parts.feedback.position, "link"))
    moved, linked, loaded, given = (
        found[:, side : side + size, which] for which in (slice(size), slice(size, None)) for side in (seen, link)
    )
    paths, passed = {HOST: np.ones((len(omega), size), dtype=complex)}, np.ones((len(omega), size))
    if path is not None:
        delays = {HOST: np.array([joint.opened.delays for joint in joints])[rows], DRIVE: np.full((1, size), path.delay)}
        for name, step in joints[0].sample_times.items():
            held = np.sinc(omega * step / (2 * math.pi))[:, None]
            paths[name] = held * np.exp(-1j * omega[:, None] * (delays[name] + step / 2))
        drives = [opened.parts.drives[joint] for joint in opened.joints]
        passed = np.stack([np.abs(current_loop(drive).at(1j * omega)) ** 2 for drive in drives], axis=1)
    steps = joints[0].sample_times.items()
    heard = {name: passed * ((omega < math.pi / step) * step / math.pi)[:, None] for name, step in steps}
    return Motions(omega, moved, linked, loaded, given, paths, heard)


def closed_state(opened: Opened, plant: StateSpace, alone: Sequence[System]) -> StateSpace:
    """Sampled state space in δ of joints closed by the controllers of `alone`, one each, at the host's rate; plant: their sampled_state.

    Inputs: torques (n) added to the commands, load torques (n). Outputs: the commands with what was added, S, and the links.
    """
    size, step = opened.size, opened.sample_time
    law = laws_beside([one.control.controller for one in alone], step)
    heard, through = law.b[:, :size] + law.b[:, size:], law.d[:, :size] + law.d[:, size:]
    side, link = (SENSORS.index(name) * size for name in (opened.parts.feedback.position, "link"))
    seen, pushed, nothing = plant.c[side : side + size], plant.b[:, :size], np.zeros((len(law.a), 2 * size))
    a = np.block([[plant.a - pushed @ through @ seen, -pushed @ law.c], [heard @ seen, law.a]])
    c = np.block([[-through @ seen, -law.c], [plant.c[link : link + size], np.zeros((size, len(law.a)))]])
    d = np.zeros((2 * size, 2 * size))
    d[:size, :size] = np.eye(size)
    return StateSpace(a, np.vstack([plant.b, nothing]), c, d)


class CoupledJoints:
    """The joints of a problem at some spots, each with the parameters of `structure` of its own: coordinates x (N,), joint after joint."""

    def __init__(self, problem: Problem, structure: Structure, spots: Sequence[Spot], density: float) -> None:
        self.problem, self.structure, self.spots = problem, structure, list(spots)
        self.alone = [one.alone for one in problem.joint.apart]
        self.structures = [structure.scaled_to(system, problem.path) for system in self.alone]
        self.joints = [problem.spot(structure, spot) for spot in spots]
        steps = np.array([system.drives[0].resolution for system in self.alone])
        self.deviations = np.where(steps > 0, steps / math.sqrt(12), problem.ceilings.sensor_noise.get(structure.position, 0.0))
        self.omega = np.stack(as_many([joint.grid(density) for joint in self.joints]))
        self.rows = np.repeat(np.arange(len(spots)), self.omega.shape[1])
        self.every = motions(self.joints, self.omega.ravel(), self.rows)

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """Coordinates (N,), (N,) that a search never leaves."""
        ends = [one.limits for one in self.structures]
        return np.concatenate([low for low, _ in ends]), np.concatenate([high for _, high in ends])

    def of_joints(self, x: Floats) -> list[Floats]:
        """Coordinates of each joint."""
        return np.split(x, np.cumsum([len(one.parameters) for one in self.structures])[:-1])

    def rounded(self, x: Floats) -> Floats:
        """Coordinates of rounded parameters."""
        return np.concatenate([rounded(one, own) for one, own in zip(self.structures, self.of_joints(x), strict=True)])

    def systems(self, x: Floats) -> list[System]:
        """Every joint by itself, with its controller."""
        every = zip(self.structures, self.of_joints(x), self.alone, strict=True)
        return [structure.system(own, system, self.problem.path) for structure, own, system in every]

    # stability

    @cached_property
    def _plants(self) -> list[StateSpace]:
        return [sampled_state(one.opened.parts, one.opened.joints, one.opened.delays) for one in self.joints]

    def closed(self, x: Floats) -> list[StateSpace]:
        """closed_state at every spot, of laws on the host alone."""
        alone = self.systems(x)
        return [closed_state(one.opened, plant, alone) for one, plant in zip(self.joints, self._plants, strict=True)]

    def root(self, x: Floats) -> float:
        """Largest |z| over a period of the host, over all spots, by every rate that there is."""
        if self.structure.in_drive:
            return max(largest_root(one.opened, *self.systems(x)) for one in self.joints)
        step = self.joints[0].opened.sample_time
        return max(float(np.abs(1 + step * np.linalg.eigvals(one.a)).max()) for one in self.closed(x))

    # curves

    def _laws(self, x: Floats, at: Motions) -> dict[str, Complexes]:
        """κ_p (batch, k, n) of every path at x (batch, N)."""
        own, start, steps = dict[str, list[Complexes]](), 0, self.joints[0].sample_times
        for k, structure in enumerate(self.structures):
            stop = start + len(structure.parameters)
            for law in structure.laws(x[:, start:stop], at.omega, steps):
                own.setdefault(law.path, []).append(at.paths[law.path][:, k] * law.response)
            start = stop
        return {path: np.stack(one, axis=-1) for path, one in own.items()}

    def matrices(self, x: Floats, at: Motions) -> tuple[Complexes, dict[str, Complexes], Complexes, Complexes]:
        """S, T_p and q/d (batch, k, n, n), and κ (batch, k, n, 1), at x (batch, N)."""
        own = self._laws(x, at)
        total = np.sum(list(own.values()), axis=0)[..., None]
        sensitivity = np.linalg.inv(np.eye(at.moved.shape[1]) + total * at.moved)
        through = at.moved @ sensitivity
        complementary = {path: one[..., None] * through for path, one in own.items()}
        return sensitivity, complementary, at.given - at.linked @ (sensitivity @ (total * at.loaded)), total

    def logs(self, x: Floats, at: Motions, order: float = math.inf) -> list[Floats]:
        """Logarithms (k,) of the curves: σ_max(S) and delay over their ceilings, and σ_max(q/d); of a finite `order`, Schatten norms."""
        sensitivity, complementary, compliance, _ = self.matrices(x[None], at)
        size = [_norm(one[0], order) for one in (sensitivity, compliance)]
        delay = np.sum([_norm(one[0], order) * self._weight(path, at) for path, one in complementary.items()], axis=0)
        return [np.log(size[0] / self.problem.ceilings.peak_sensitivity), np.log(np.maximum(delay, 1e-9)), np.log(size[1])]

    def _weight(self, path: str, at: Motions) -> Floats:
        return turned(at.omega * self.joints[0].reserves[path])

    def at(self, omega: Floats, rows: Integers) -> Motions:
        """Responses at omega (k,), each at the spot of index `rows` (k,)."""
        return motions(self.joints, omega, rows)

    def slopes(self, x: Floats, at: Motions, kind: Integers, order: float = math.inf) -> tuple[Floats, Floats]:
        """Logarithms (batch, k), of the curve that `kind` (k,) names, and their derivatives (batch, k, N), at x (batch, N)."""
        sensitivity, complementary, compliance, total = self.matrices(x, at)
        through, linked = at.moved @ sensitivity, at.linked @ sensitivity
        pull = {path: np.zeros(total.shape[:-1], dtype=complex) for path in complementary}  # derivatives of the value by κ_p
        value = np.zeros((len(x), len(kind)))

        def add(of: int, matrix: Complexes, left: Complexes, right: Complexes, weight: Floats, path: str = "") -> None:
            """Count `weight` |`matrix`|, which moves by −`left` dκ `right`, and of T_p by dκ_p `right`, too."""
            which = np.flatnonzero(kind == of)
            u, sizes, v = np.linalg.svd(matrix[:, which])
            size, share = _schatten(sizes, order)
            value[:, which] += weight[which] * size
            u, across = u.conj().swapaxes(-1, -2), right[:, which] @ v.conj().swapaxes(-1, -2)
            share = (share * weight[which, None])[..., None]
            across = across.swapaxes(-1, -2) * share
            moved = -(u @ left[:, which] * across).sum(axis=-2)
            for name, one in pull.items():
                one[:, which] += moved + ((u * across).sum(axis=-2) if name == path else 0.0)

        ones = np.ones(len(kind))
        add(SENSITIVITY, sensitivity, sensitivity, through, ones / self.problem.ceilings.peak_sensitivity)
        for path, one in complementary.items():
            add(DELAY, one, one, through, self._weight(path, at), path)
        add(COMPLIANCE, compliance, linked, at.loaded - through @ (total * at.loaded), ones)
        slopes = self._law_slopes(x, at)
        found = np.sum([(one[..., None] * slopes[path]).real for path, one in pull.items()], axis=0)
        return np.log(value), found.reshape(*value.shape, -1) / value[..., None]

    def _law_slopes(self, x: Floats, at: Motions) -> dict[str, Complexes]:
        """Derivatives (batch, k, n, c) of κ_p by the coordinates c of each joint; one step moves one parameter of every joint."""
        count = len(self.structures[0].parameters)
        steps = np.eye(count)[:, np.arange(x.shape[1]) % count] * LAW_STEP
        moved = self._laws((x[:, None] + np.concatenate([steps, -steps])).reshape(-1, x.shape[1]), at)
        parted = {path: one.reshape(len(x), 2, count, *one.shape[1:]) for path, one in moved.items()}
        return {path: np.moveaxis(one[:, 0] - one[:, 1], 1, -1) / (2 * LAW_STEP) for path, one in parted.items()}

    def noises(self, x: Floats, at: Motions, weights: Floats) -> tuple[Floats, Floats]:
        """Logarithms (batch, n) of every motor's rms torque of noise over its ceiling, 1 N m without one, and derivatives (batch, n, N).

        weights (k,) of the integral over `at.omega`, all of one spot
        """
        own, ceiling = self._laws(x, at), self.problem.ceilings.torque_noise or 1.0
        total = np.sum(list(own.values()), axis=0)[..., None]
        sensitivity = np.linalg.inv(np.eye(at.moved.shape[1]) + total * at.moved)
        heard = {path: at.heard[path] * weights[:, None] * (self.deviations / ceiling) ** 2 for path in own}
        passed = np.abs(sensitivity) ** 2
        sent = np.sum([np.abs(one) ** 2 * heard[path] for path, one in own.items()], axis=0)[..., None, :]
        power = (passed * sent).sum(axis=(1, -1))
        common = -2 * sensitivity * ((sensitivity.conj() * sent) @ (at.moved @ sensitivity).swapaxes(-1, -2))
        slopes = self._law_slopes(x, at)
        pulls = {path: common + 2 * passed * (one.conj() * heard[path])[..., None, :] for path, one in own.items()}
        found = np.sum([np.einsum("bkil,bklc->bilc", pulls[path], slopes[path]).real for path in own], axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):  # encoders without steps make none
            return 0.5 * np.log(power), found.reshape(*power.shape, -1) / (2 * power[..., None])

    def _noise_model(self, x: Floats, spot: int) -> Model:
        """Model of the noise at a spot."""
        own = slice(spot * self.omega.shape[1], (spot + 1) * self.omega.shape[1])
        at, omega = self.every.part(own), self.omega[spot]
        values, slopes = self.noises(x[None], at, quadrature(omega))
        thin = slice(None, None, THINNED)
        _, beside = self.noises(x + STEP * np.eye(len(x) + 1, len(x), -1), at.part(thin), quadrature(omega[thin]))
        bends = np.moveaxis(beside[1:] - beside[0], 0, 1) / STEP
        return Model(values[0], slopes[0], (bends + bends.swapaxes(1, 2)) / 2, np.zeros(len(values[0]), dtype=bool))

    def model(self, x: Floats, order: float = math.inf) -> Model | None:
        """Model of the highest peaks of `logs` at x (N,), as local_search.py has it; None where the loops are unstable at a spot."""
        if not self.root(x) < 1:
            return None
        kind, rows, at, inner = tops(self.omega, [one[None] for one in self.logs(x, self.every, order)], math.inf)
        here = self.at(at, rows)
        value, slopes = self.slopes(x + STEP * np.eye(len(x) + 1, len(x), -1), here, kind, order)
        above, below = (self.slopes(x[None], self.at(at * np.exp(side), rows), kind, order) for side in (STEP, -STEP))
        bends = np.moveaxis(slopes[1:] - slopes[0], 0, 1) / STEP
        value, moved = followed(np.stack([value[0], above[0][0], below[0][0]]), (above[1][0] - below[1][0]) / (2 * STEP), inner)
        parts = [Model(value, slopes[0], (bends + bends.swapaxes(1, 2)) / 2 + moved, kind == COMPLIANCE)]
        if self.problem.ceilings.torque_noise is not None:
            parts += [self._noise_model(x, spot) for spot in range(len(self.spots))]
        found = Model(*(np.concatenate(part) for part in zip(*(vars(one).values() for one in parts), strict=True)))
        return found if all(np.isfinite(one).all() for one in vars(found).values()) else None

    # peaks

    def worst(self, x: Floats) -> tuple[float, float]:
        """Logarithms of the largest σ_max(q/d), and of the worst ceiling's value over the ceiling; inf, both, where x (N,) is unstable."""
        found = self.model(x)
        if found is None:
            return math.inf, math.inf
        return float(found.values[found.objective].max()), float(found.values[~found.objective].max())

    def peak(self, x: Floats, kind: int, spot: int) -> tuple[float, float, bool]:
        """Highest value of a curve of stable joints at a spot: of a ceiling as its share, σ_max(q/d) itself; its frequency [rad/s].

        Last, True where it is proved that no frequency has more than 1e-9 of it more (analysis/peak_gain.py): σ_max of laws at one rate.
        """
        if not self.structure.in_drive and kind != DELAY:
            closed, opened = self.closed(x)[spot], self.joints[spot].opened
            which = slice(opened.size) if kind == SENSITIVITY else slice(opened.size, None)
            step = opened.sample_time
            found = peak_gain(
                StateSpace(np.eye(len(closed.a)) + step * closed.a, step * closed.b[:, which], closed.c[which], closed.d[which, which])
            )
            if found.certified:
                unit = self.problem.ceilings.peak_sensitivity if kind == SENSITIVITY else 1.0
                return found.height / unit, found.angle / step, True
        return *self._seen(x, kind, spot), False

    def noise(self, x: Floats) -> float:
        """Largest rms torque [N m] that noise makes in a motor, over all spots, over its ceiling if there is one."""
        size = self.omega.shape[1]
        each = [
            self.noises(x[None], self.every.part(slice(k * size, (k + 1) * size)), quadrature(one))[0] for k, one in enumerate(self.omega)
        ]
        return math.exp(float(np.max(each)))

    def _seen(self, x: Floats, kind: int, spot: int) -> tuple[float, float]:
        """Highest value of a curve at a spot, and its frequency [rad/s], from samples that narrow the highest peaks."""
        omega = self.omega[spot]
        value = self.logs(x, self.at(omega, np.full(len(omega), spot)))[kind]
        order = np.argsort(-value)
        best = [(float(value[order[0]]), float(omega[order[0]]))]
        for k in [k for k in order.tolist() if value[k] >= value[max(k - 1, 0) : k + 2].max()][:TOPS]:
            low, high = float(omega[max(k - 1, 0)]), float(omega[min(k + 1, len(omega) - 1)])
            for _ in range(ZOOMS):
                close = np.linspace(low, high, BETWEEN)
                there = self.logs(x, self.at(close, np.full(BETWEEN, spot)))[kind]
                top = int(np.argmax(there))
                low, high = float(close[max(top - 1, 0)]), float(close[min(top + 1, BETWEEN - 1)])
                best.append((float(there[top]), float(close[top])))
        height, place = max(best)
        return math.exp(height), place


def _norm(matrix: Complexes, order: float) -> Floats:
    square = np.linalg.eigvalsh(matrix.conj().swapaxes(-1, -2) @ matrix)[..., ::-1]  # quicker than svd; the largest keep all digits
    return _schatten(np.sqrt(np.maximum(square, 0.0)), order)[0]


def _schatten(sizes: Floats, order: float) -> tuple[Floats, Floats]:
    """Norm (…) of matrices with singular values (…, n), and its derivatives (…, n) by these: (Σσ^p)^(1/p) with p = `order`, inf: σ_max.

    Where the largest are equal σ_max has a kink, which hides the way on from a search; the norm has none, and is above σ_max by less than
    ln(n)/p, in ln.
    """
    if math.isinf(order):
        return sizes[..., 0], np.broadcast_to(np.eye(1, sizes.shape[-1])[0], sizes.shape)
    shares = sizes / sizes[..., :1]
    total = (shares**order).sum(axis=-1, keepdims=True)
    return (sizes[..., :1] * total ** (1 / order))[..., 0], shares ** (order - 1) * total ** (1 / order - 1)
