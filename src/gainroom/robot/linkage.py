"""Linkages: constraints between parts of a robot beside its joints, i.e. closed kinematic loops and following joints.

Each is rows of a Jacobian (r, N) that the motion of the links keeps at zero, as rigid contacts do (contact.py), and a residual (r,) that is
zero where the loop is closed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Floats

CLOSED = 1e-9
"""Largest residual of a closed loop [m, rad]; Newton's steps go on to round-off."""
ROUNDS = 50
SHARE = 0.1
"""Step of a joint [rad; m if prismatic] on the way to a posture after which loops are closed again."""
LOOSE = 1e-10
"""Singular values below this share of the largest count as 0: directions that loops leave free are not moved."""


class Links(Protocol):
    """Interface to a robot's links that linkages need; members as in RigidBody."""

    @property
    def source(self) -> str: ...
    @property
    def nv(self) -> int: ...
    @property
    def size(self) -> int: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def passive(self) -> tuple[str, ...]: ...
    @property
    def base(self) -> str: ...
    @property
    def linkages(self) -> "tuple[Linkage, ...]": ...
    def anchors(self, q: Floats, *names: str) -> tuple[Any, ...]: ...
    def anchor_jacobian(self, q: Floats, anchor: str) -> Floats: ...
    def logarithm(self, placement: Any) -> Floats: ...
    def place(self, q: Floats, name: str, value: float) -> None: ...
    def position(self, q: Floats, name: str) -> float: ...
    def velocity_of(self, name: str) -> int: ...
    def rate(self, name: str) -> Floats: ...
    def integrate(self, q: Floats, displacement: Floats) -> Floats: ...


class Linkage(Protocol):
    """One constraint; `name` is its name in messages."""

    @property
    def name(self) -> str: ...

    def residual(self, body: Links, q: Floats) -> Floats:
        """Residual (r,) [m, rad], zero where the constraint holds."""
        ...

    def jacobian(self, body: Links, q: Floats) -> Floats:
        """Constraint Jacobian (r, N); for a closed loop that of the residual."""
        ...


@dataclass(frozen=True)
class JoinedFrames:
    """Two frames that coincide: in all six directions (a weld), or in their origins (a ball joint that closes a loop).

    first, second   names of the frames, which users do not see
    ties_base       one of them moves with a floating base and the other does not
    """

    name: str
    first: str
    second: str
    welded: bool
    ties_base: bool = False

    def residual(self, body: Links, q: Floats) -> Floats:
        first, second = body.anchors(q, self.first, self.second)
        apart = first.actInv(second)
        return body.logarithm(apart) if self.welded else apart.translation.copy()

    def jacobian(self, body: Links, q: Floats) -> Floats:
        first, second = body.anchors(q, self.first, self.second)
        turn = first.rotation.T @ second.rotation
        of_first, of_second = body.anchor_jacobian(q, self.first), body.anchor_jacobian(q, self.second)
        return np.vstack([turn @ of_second[rows] - of_first[rows] for rows in (slice(0, 3), slice(3, 6))[: 2 if self.welded else 1]])


@dataclass(frozen=True)
class FollowingJoint:
    """Joint at position Σ c_k x^k, where its leader is at x (both from the file's zero)."""

    name: str
    follower: str
    leader: str
    coefficients: tuple[float, ...]

    def residual(self, body: Links, q: Floats) -> Floats:
        place = np.polynomial.polynomial.polyval(body.position(q, self.leader), self.coefficients)
        return np.array([body.position(q, self.follower) - place])

    def jacobian(self, body: Links, q: Floats) -> Floats:
        slope = np.polynomial.polynomial.polyder(self.coefficients)
        rate = np.polynomial.polynomial.polyval(body.position(q, self.leader), slope)
        return (body.rate(self.follower) - rate * body.rate(self.leader))[None]


def ties_base(body: Links) -> bool:
    """True if a closed loop goes through the world, so that it holds a floating base in some directions."""
    return any(isinstance(linkage, JoinedFrames) and linkage.ties_base for linkage in body.linkages)


def linkage_jacobian(body: Links, q: Floats) -> Floats:
    """Constraint Jacobian (r, N) of all linkages of the body."""
    return np.vstack([np.zeros((0, body.nv)), *(linkage.jacobian(body, q) for linkage in body.linkages)])


def closed(body: Links, start: Floats, angles: Mapping[str, float]) -> Floats:
    """Posture (nq,) with joints at `angles` and every loop closed, reached from `start` (nq,), which is nearly closed.

    Passive joints and a base tied by loops follow; where those cannot close a loop, joints without a given angle follow too. Angles of
    passive joints are starting points. Raises GainroomError if a loop cannot be closed.
    """
    driven = {name: angle for name, angle in angles.items() if name in body.joint_names}
    known = {name: angle for name, angle in angles.items() if name in body.passive}
    steps = 1 if known else max(1, int(np.ceil(max(map(abs, driven.values()), default=0.0) / SHARE)))
    first = {name: body.position(start, name) for name in driven}
    unnamed = [name for name in body.joint_names if name not in driven]
    q, left = start, np.inf
    for follow in [(), unnamed] if unnamed else [()]:
        q = start.copy()
        for name, angle in known.items():
            body.place(q, name, angle)
        for step in range(1, steps + 1):
            for name, angle in driven.items():
                body.place(q, name, first[name] + (angle - first[name]) * step / steps)
            q, left = _closed_about(body, q, follow)
        if left <= CLOSED:
            return q
    worst = max(body.linkages, key=lambda linkage: float(np.abs(linkage.residual(body, q)).max(initial=0.0)))
    gap = float(np.abs(worst.residual(body, q)).max())
    raise GainroomError(
        f"{body.source}: {worst.name} cannot be closed in this posture: it stays {gap:.3g} (m or rad) open; change its angles"
    )


def _closed_about(body: Links, q: Floats, follow: Sequence[str]) -> tuple[Floats, float]:
    """Posture after Newton's method with least steps in passive joints, a tied base and the joints of `follow`.

    And its largest residual.
    """
    first = 0 if ties_base(body) or body.base == "fixed" else 6
    moving = np.array([*range(first, body.nv - body.size), *map(body.velocity_of, follow)], dtype=int)
    moving = moving[moving >= 0]
    left = np.inf
    for _ in range(ROUNDS):
        residual = np.concatenate([linkage.residual(body, q) for linkage in body.linkages])
        before, left = left, float(np.abs(residual).max(initial=0.0))
        if left <= 1e-4 * CLOSED or (left <= CLOSED and left > 0.5 * before) or not len(moving):
            break
        step = np.zeros(body.nv)
        step[moving] = -np.linalg.lstsq(linkage_jacobian(body, q)[:, moving], residual, rcond=LOOSE)[0]
        most = float(np.abs(step).max())
        q = body.integrate(q, step * min(1.0, 3 * SHARE / most) if most else step)
    return q, left
