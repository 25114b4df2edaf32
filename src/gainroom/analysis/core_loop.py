"""Coupled loops with their gains as the core has them, along joints or along directions of tasks, for loop_samples.py to sample."""

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..system.controller import Terms
from ..system.linear.arrays import Booleans, Floats, are_diagonal
from ..system.loop import Loop
from .loop_samples import Directed, LoopSamples, Reach, directed_loop, joint_loops, lag_about, take_samples
from .stability_boundary import HIGHEST

EVERY_PHASE = Reach(HIGHEST, math.pi, ((1.0, 0.0, 0.5),))
"""Reach of samples for reported margins: every phase, factors up to 1000, all peaks."""
NEAR_BY = Reach(1.05, 0.05)
"""Reach of samples for a root count: loci about −1 alone."""
BY_ORDER = [(0, 1)], [(0, 0), (1, 1)], [(1, 0)]  # powers of V and I whose terms go with 1/ω, 1 and ω
SLOWER = 0.1  # share of the frequency at which two gains are equal, below which the slower one dominates
SAME = 1e-11  # largest error of gains along directions, relative to the largest entry


@dataclass(frozen=True)
class CoreLoop:
    """Loop in the C++ core without its gains, and the gains (3, m) of its directions: kp, kd, ki.

    cascade   True, for all directions or by direction (m,): the gains are kp, kv, ki of a P/PI
    """

    loop: Directed
    gains: Floats
    cascade: bool | Booleans
    by_joint: bool = False

    @classmethod
    def of(cls, loop: Loop) -> "CoreLoop | None":
        """Loop in the core; None for a loop that was not built with build_loop, and if kd closes on a path of its own."""
        if loop.parts is None or loop.kd_path is not None:
            return None
        terms = _terms(loop)
        if are_diagonal(terms.values()):
            own = _of_directions({powers: np.diagonal(gain) for powers, gain in terms.items()}, loop.size)
            return cls.of_matrices(loop) if own is None else cls(joint_loops(loop, own[1]), *own, by_joint=True)
        shared = _shared(terms, loop.seen)
        own = None if shared is None else _of_directions(shared[2], len(shared[1]))
        if shared is None or own is None:
            return cls.of_matrices(loop)
        directed = directed_loop(loop, shared[0], shared[1], np.full(len(shared[1]), own[1]), loop.exact_modes is not None)
        return cls(directed, *own)

    @classmethod
    def of_matrices(cls, loop: Loop, with_joints: bool = False) -> "CoreLoop":
        """Loop in the core for any gain matrices: they enter as one law, on the subspace of positions that they act on (Loop.seen).

        The directions span that subspace and have gains of 1, so that a factor on them is a factor on all gains.

        with_joints   True: further directions follow, one per joint, with gains of 0: for changes of one joint's gains
        """
        seen, terms, joints = loop.seen, _terms(loop), np.eye(loop.size)[:, : loop.size if with_joints else 0]
        acting, idle = seen.shape[1], joints.shape[1]
        torque, jacobian = np.hstack([np.zeros_like(seen), joints]), np.vstack([seen.T, joints.T])
        cascade = np.zeros(acting + idle, dtype=bool)
        directed = directed_loop(loop, torque, jacobian, cascade, loop.exact_modes is not None, by_direction=with_joints, own=False)
        sizes = [sum(float(np.linalg.norm(terms.get(powers, 0.0))) for powers in order) for order in BY_ORDER]
        pairs = [(high - low, sizes[low] / sizes[high]) for low, high in combinations(range(3), 2) if sizes[low] and sizes[high]]
        slow = SLOWER * min((ratio ** (1 / orders) for orders, ratio in pairs), default=math.inf)
        for (velocity, integral), gain in terms.items():
            directed.set_matrix(np.hstack([gain @ seen, np.zeros_like(joints)]), bool(velocity), bool(integral), slow)
        return cls(directed, np.vstack([np.repeat([1.0, 0.0], [acting, idle]), np.zeros((2, acting + idle))]), False)

    @classmethod
    def of_directions(cls, loop: Loop, torque: Floats, jacobian: Floats, gains: Floats, cascade: Booleans) -> "CoreLoop":
        """Loop in the core with gains (3, m) along given directions, each of them one loop at a time; torque (n, m), jacobian (m, n).

        cascade   (m,) True where they are kp, kv and ki of (kv + ki/s)(kp + s), else of kp + ki/s + kd s
        """
        directed = directed_loop(loop, torque, jacobian, cascade, loop.exact_modes is not None, by_direction=True)
        return cls(directed, gains, cascade)

    def samples(self, reach: Reach, between: bool = False, smooth: bool = True) -> LoopSamples:
        """Samples of the loop as far as `reach` asks; `between` and `smooth` as of analysis/loop_samples.py."""
        return take_samples(self.loop, self.gains, reach, between, smooth)

    def scaled(self, factor: float) -> "CoreLoop":
        """The loop with all gains times `factor`."""
        return replace(self, gains=self.gains * np.where(self.cascade, [[1.0], [factor], [factor]], factor))

    def unstable(self) -> int:
        """Number of unstable roots among those that the gains move; −1 if they cannot be counted."""
        samples = self.samples(NEAR_BY, smooth=False)
        return samples.unstable if samples.followed else -1

    def lag_about(self, omega: float) -> tuple[float, float]:
        """Common phase lag [rad] with which the locus nearest to −1 at `omega` [rad/s] passes through −1, and its frequency [rad/s] there.

        NaN, both, if the locus cannot be followed.
        """
        return lag_about(self.loop, self.gains, omega)


def _terms(loop: Loop) -> Terms:
    """Gain matrices (n, n) of a loop built with build_loop, times its common factor on all gains.

    The key is the pair of powers of velocity V and integral I (system/controller.py): (0, 0) kp, (1, 0) kd, (0, 1) ki.
    """
    assert loop.parts is not None
    return {powers: loop.gain * gain for powers, gain in loop.parts.controller.matrices(loop.size).items()}


def _of_directions(terms: Terms, size: int) -> tuple[Floats, bool] | None:
    """Gains (3, m) with `terms` (m,) by powers of V and I, and True for a cascade (kv + ki/s)(kp + s): kp, kd, ki, or kp, kv, ki.

    None if the terms belong to neither form.
    """
    stiff, damped, slow, both = (terms.get(powers, np.zeros(size)) for powers in ((0, 0), (1, 0), (0, 1), (1, 1)))
    if not both.any():
        return np.array([stiff, damped, slow]), False
    outer = np.divide(stiff, damped, out=np.zeros(size), where=damped != 0)
    same = np.allclose(outer * damped, stiff, rtol=SAME, atol=0) and np.allclose(outer * both, slow, rtol=SAME, atol=0)
    return (np.array([outer, damped, both]), True) if same else None


def _shared(terms: Terms, seen: Floats) -> tuple[Floats, Floats, Terms] | None:
    """Directions X (n, m), E (m, n) and gains (m,) with every gain matrix = X diag(gains) E, as of tasks; None where there are none.

    seen   (n, r) orthonormal basis of the positions on which the gains act (Loop.seen)
    """
    leading = terms.get((1, 0), terms.get((0, 0)))
    if leading is None:
        return None
    acting, _, _ = np.linalg.svd(leading @ seen, full_matrices=False)
    whole = acting.T @ leading @ seen
    try:
        ratios = {powers: np.linalg.solve(whole, acting.T @ gain @ seen) for powers, gain in terms.items()}
        _, basis = np.linalg.eig(sum(weight * one for weight, one in zip((1.0, 0.7, 0.3, 0.1), ratios.values(), strict=False)))
        if np.iscomplexobj(basis):
            return None
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        return None
    torque, jacobian = acting @ whole @ basis, inverse @ seen.T
    gains = {powers: np.diagonal(inverse @ one @ basis) for powers, one in ratios.items()}
    for powers, gain in terms.items():
        if np.abs(torque * gains[powers] @ jacobian - gain).max() > SAME * np.abs(gain).max():
            return None
    return torque, jacobian, gains
