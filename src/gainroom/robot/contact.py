"""Constraints of a robot: rigid and compliant contacts, closed loops, springs of passive joints; and the motion that they leave free.

Rigid contact takes motion away. With the links' inertia A (N, N) and the rows J_c of what is held (theory after Park and Khatib 2006,
and Sentis, Park and Khatib 2010):

    Λ_c = (J_c A⁻¹ J_cᵀ)⁺,    N_c = I − A⁻¹ J_cᵀ Λ_c J_c,    P = A⁻¹ N_cᵀ = R Rᵀ

P takes forces to accelerations; the columns of R span the free motion. Redundant rows (two frames on one foot, feet closed
into a loop) change nothing. Closed loops are rows like any rigid contact's, and the springs of passive joints like a compliant one's.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from ..errors import GainroomError, require_positive
from ..system.linear.arrays import Booleans, Floats
from .linkage import linkage_jacobian

if TYPE_CHECKING:
    from .body import RigidBody

ContactKind = Literal["flat", "line", "point"]
_ROWS = {"flat": (0, 1, 2, 3, 4, 5), "line": (0, 1, 2, 3, 5), "point": (0, 1, 2)}  # rows of a twist: linear x y z, angular x y z
_LINEAR = 3

# A held direction counts as its own when it moves the links by more than this, relative to the one that moves them most. Redundant rows
# come out at round-off, about 1e-13 with the worst-scaled robots; true ones are above 1e-5 unless a leg is singular to within 1e-9 rad.
REDUNDANT = 1e-9


@dataclass(frozen=True)
class Contact:
    """Contact of one frame with the ground.

    frame       on the robot; directions are its own axes, and its origin is the point
    kind        "flat" holds all 6 directions; "line" 5, free to roll about the frame's y axis; "point" the 3 translations
    stiffness   of the ground; None: rigid. A number for every direction, two numbers (translations, rotations), or one for each
                held direction in the order linear x y z, angular x y z [N/m, N m/rad]; inf: that direction is rigid
    damping     of the ground, in the same forms [N s/m, N m s/rad]; None: 0; only beside stiffness

    Raises GainroomError for an unknown kind and for values that are not physical.
    """

    frame: str
    kind: ContactKind = "flat"
    stiffness: Any = None
    damping: Any = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(ContactKind):
            raise GainroomError(f"contact {self.frame!r}: type {self.kind!r} must be one of {', '.join(get_args(ContactKind))}")
        if self.stiffness is None and self.damping is not None:
            raise GainroomError(f"contact {self.frame!r}: damping needs a stiffness; a contact without stiffness is rigid")
        for value in self.springs:
            require_positive(f"contact {self.frame!r}", "stiffness", value, "N/m or N·m/rad", infinite=True)
        for value in self.dampers:
            require_positive(f"contact {self.frame!r}", "damping", value, "N·s/m or N·m·s/rad", zero=True)

    @property
    def rows(self) -> tuple[int, ...]:
        """Held directions, as row indices of the frame's twist (linear x y z, angular x y z)."""
        return _ROWS[self.kind]

    @property
    def springs(self) -> Floats:
        """Stiffness (c,) of each held direction, inf where rigid [N/m, N m/rad]."""
        return np.full(len(self.rows), np.inf) if self.stiffness is None else self._per_row("stiffness", self.stiffness)

    @property
    def dampers(self) -> Floats:
        """Damping (c,) of each held direction [N s/m, N m s/rad]."""
        return np.zeros(len(self.rows)) if self.damping is None else self._per_row("damping", self.damping)

    def _per_row(self, name: str, value: Any) -> Floats:
        rotations = sum(row >= _LINEAR for row in self.rows)
        wanted = "a number, 2 numbers (translations, rotations)" if rotations else "a number"
        problem = f"contact {self.frame!r}: {name} {value!r} must be {wanted} or {len(self.rows)} numbers"
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError) as error:
            raise GainroomError(problem) from error
        if array.ndim == 0:
            return np.full(len(self.rows), float(array))
        if array.shape == (2,) and rotations:
            return np.repeat(array, (len(self.rows) - rotations, rotations))
        if array.shape != (len(self.rows),):
            raise GainroomError(problem)
        return array


def contact_jacobian(body: "RigidBody", q: Floats, contacts: Sequence[Contact]) -> Floats:
    """Contact Jacobian (c, N): held directions of all contacts, one below the other, each in its frame's axes.

    Raises GainroomError for a frame that the robot does not have and for a frame used twice.
    """
    for frame, count in Counter(contact.frame for contact in contacts).items():
        if count > 1:
            raise GainroomError(f"contact {frame!r}: the frame is used {count} times; give each contact frame once")
    rows = [body.frame_jacobian(q, contact.frame)[list(contact.rows)] for contact in contacts]
    return np.vstack([np.zeros((0, body.nv)), *rows])


class Constraints(NamedTuple):
    """Held directions: rows of contact_jacobian, then closed loops, then springs of passive joints.

    jacobian           J_c (c, N)
    springs, dampers   (c,) inf where rigid [N/m, N m/rad], [N s/m, N m s/rad]
    """

    jacobian: Floats
    springs: Floats
    dampers: Floats

    @property
    def rigid(self) -> Booleans:
        """(c,) True for each row that is held rigidly."""
        return ~np.isfinite(self.springs)


def held(body: "RigidBody", q: Floats, contacts: Sequence[Contact]) -> Constraints:
    """Constraints on the robot in posture `q` (nq,) on `contacts`. Raises GainroomError as contact_jacobian."""
    loops = linkage_jacobian(body, q)
    sprung = [body.rate(name)[None] for name in body.passive_springs]
    own = np.array(list(body.passive_springs.values())).reshape(-1, 2)
    return Constraints(
        np.vstack([contact_jacobian(body, q, contacts), loops, *sprung]),
        np.concatenate([np.zeros(0), *(contact.springs for contact in contacts), np.full(len(loops), np.inf), own[:, 0]]),
        np.concatenate([np.zeros(0), *(contact.dampers for contact in contacts), np.zeros(len(loops)), own[:, 1]]),
    )


def free_motion(inertia: Floats, held: Floats) -> Floats:
    """Free motion R (N, r) under rigid constraints, P = R Rᵀ, columns of unit kinetic energy (Rᵀ A R = I).

    inertia   A (N, N), symmetric, > 0
    held      J_c (c, N), any rank

    With A = L Lᵀ and X = L⁻¹ J_cᵀ, P = L⁻ᵀ (I − X X⁺) L⁻¹: R is L⁻ᵀ times an orthonormal basis of the complement of X's range, so nothing
    is subtracted and P comes out symmetric and ≥ 0.
    """
    unit = np.linalg.inv(np.linalg.cholesky(inertia)).T
    if not len(held):
        return unit
    reached, sizes, _ = np.linalg.svd((held @ unit).T)
    rank = int(np.count_nonzero(sizes > REDUNDANT * sizes[0]))
    return unit @ reached[:, rank:]
