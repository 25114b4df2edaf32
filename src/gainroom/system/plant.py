"""The plant: n elastic joints between motors and links; a single joint (elastic_joint.py) is n = 1.

Motor side θ, link side q, motor torque τ_m, joint torque τ_J, all on the joint (output) side of the gearbox:

    J_m θ̈ = τ_m − τ_J − D_m θ̇
    τ_J   = K (θ − q) + B (θ̇ − q̇)
    q̈     = W (τ_J − D_l q̇ − G q)

W is the inverse inertia of the links as the joints feel it. It may be singular (feet closed into a loop by the ground), so it is
never inverted: it is factored as W = R Rᵀ and the links move in the range of R. A rigid joint (infinite stiffness) adds its motor
inertia to the links. After Jung et al. 2017, eqs. (1) and (2); Spong 1987 for n joints.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, first_of_many, require_finite, require_positive
from .linear.apart import eigensystem
from .linear.arrays import Booleans, Complexes, Floats, Integers, diagonals, distinct
from .modes import AT_REST, Corners, Modes, modes_of, rough_poles, undamped

BESIDE = 1.07  # times a natural frequency: there a sum over modes is compared with the response itself
NOT_HUNG = 1e-13  # relative to the largest singular value: round-off of a motion that no spring resists
OFF_MODES = 1e-7  # relative: a sum over modes that is further off, as where two modes are as good as one, is not used


@dataclass(frozen=True)
class Mechanism:
    """The plant in second-order form, M_η η̈ + D_η η̇ + K_η η = F τ_m.

    η = (ξ, θ_e) are the m coordinates: ξ of the links, with q = R ξ and W = R Rᵀ (see this module's title), and the motor positions θ_e
    of the elastic joints, or their gearboxes' twists; a rigid joint's motor moves with its link. W is not inverted, so a singular one is
    an ordinary case.

    mass, damping, stiffness        M_η, D_η, K_η (m, m), symmetric
    force                           F (m, n): which coordinates a motor's torque acts on
    motor_position, link_position   (n, m) from η to θ and to q
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    force: Floats
    motor_position: Floats
    link_position: Floats


@dataclass(frozen=True)
class Compliance:
    """Compliant ground: c directions in which the links rest on springs and dampers.

    A foot on a soft floor has six such directions x_c (c,): three shifts, three turns. The links alone, base included, obey
    A v̇ = Sᵀ τ_J + J_cᵀ f: A is the mass matrix of all N degrees of freedom v, S (n, N) picks the n joints among them, J_c (c, N) turns v
    into the speeds ẋ_c, and f (c,) are the forces of springs and dampers, f = −(K_c + s B_c) x_c. What the joints then feel needs of
    A and J_c no more than

    coupling         W_c = S A⁻¹ J_cᵀ (n, c): acceleration of the joints by forces along those directions
    inverse_inertia  W_cc = J_c A⁻¹ J_cᵀ (c, c), symmetric, ≥ 0: acceleration along the directions by forces along them
    stiffness, damping   K_c, B_c (c,) [N/m, N m/rad], [N s/m, N m s/rad]

    and is W(s) = W − W_c (W_cc + s² diag(1/(K_c + s B_c)))⁻¹ W_cᵀ, with W = S A⁻¹ Sᵀ. Contacts that are held rigidly are taken out
    beforehand: A⁻¹ is then what they leave of it (robot/linearize.py).

    Raises GainroomError on shapes that disagree, stiffness that is not > 0 and damping that is not >= 0.
    """

    coupling: Floats
    inverse_inertia: Floats
    stiffness: Floats
    damping: Floats

    def __post_init__(self) -> None:
        count = np.shape(self.coupling)[-1]
        for name in ("coupling", "inverse_inertia", "stiffness", "damping"):
            object.__setattr__(self, name, require_finite("compliance", name, getattr(self, name)))
        if self.inverse_inertia.shape != (count, count) or self.stiffness.shape != (count,) or self.damping.shape != (count,):
            raise GainroomError(f"compliance: {count} directions need inverse_inertia ({count}, {count}), stiffness and damping ({count},)")
        if np.any(self.stiffness <= 0) or np.any(self.damping < 0):
            raise GainroomError("compliance: stiffness must be > 0 and damping >= 0 in every direction")


@dataclass(frozen=True)
class Plant:
    """Linear model of n joints and the links that they move, about one posture.

    link_inverse_inertia   W (n, n), symmetric, ≥ 0 [1/(kg m²)]
    motor_inertia, stiffness, damping, motor_viscous, link_viscous   (n,) or a scalar for all, units as ElasticJoint
    gravity_stiffness      G (n, n) [N m/rad], the derivative of the gravity torque; None: compensated or absent
    compliance             springs under the links' contacts with the ground, see Compliance; W is then what the joints feel without them

    Raises GainroomError on shapes that disagree and on values that are not physical.
    """

    link_inverse_inertia: Floats
    motor_inertia: Floats
    stiffness: Floats = field(default_factory=lambda: np.array(math.inf))
    damping: Floats = field(default_factory=lambda: np.zeros(()))
    motor_viscous: Floats = field(default_factory=lambda: np.zeros(()))
    link_viscous: Floats = field(default_factory=lambda: np.zeros(()))
    gravity_stiffness: Floats | None = None
    compliance: Compliance | None = None
    joint_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        inverse_inertia = require_finite("plant", "link_inverse_inertia", self.link_inverse_inertia)
        if inverse_inertia.ndim != 2 or inverse_inertia.shape[0] != inverse_inertia.shape[1] or not len(inverse_inertia):
            raise GainroomError(f"plant: link_inverse_inertia of shape {inverse_inertia.shape} must be square, (n, n)")
        size = len(inverse_inertia)
        scale = np.abs(inverse_inertia).max()
        if np.abs(inverse_inertia - inverse_inertia.T).max() > 1e-9 * scale:
            raise GainroomError("plant: link_inverse_inertia must be symmetric")
        if (inverse_inertia[0, 0] if size == 1 else np.linalg.eigvalsh(inverse_inertia)[0]) < -1e-9 * scale:
            raise GainroomError("plant: link_inverse_inertia must have no negative eigenvalue")
        names = self.joint_names or tuple(f"joint{i + 1}" for i in range(size))
        if len(names) != size:
            raise GainroomError(f"plant: {len(names)} joint_names for {size} joints")
        set_field = object.__setattr__  # the dataclass is frozen; this is the one place that completes it
        set_field(self, "joint_names", names)
        set_field(self, "link_inverse_inertia", (inverse_inertia + inverse_inertia.T) / 2)
        for name, unit, infinite in _JOINT_FIELDS:
            values, zero = _per_joint(name, getattr(self, name), size), name != "stiffness"
            for k, value in enumerate(values.tolist()):
                if not (value > 0 or (zero and value == 0)) or not (infinite or value < math.inf):
                    require_positive(f"joint '{names[k]}'", name, value, unit, zero=zero, infinite=infinite)
            set_field(self, name, values)
        if self.compliance is not None and self.compliance.coupling.shape[0] != size:
            raise GainroomError(f"plant: compliance couples {self.compliance.coupling.shape[0]} joints, not {size}")
        if self.gravity_stiffness is not None:
            gravity = require_finite("plant", "gravity_stiffness", self.gravity_stiffness)
            if gravity.shape != (size, size):
                raise GainroomError(f"plant: gravity_stiffness of shape {gravity.shape} must be {(size, size)}")
            set_field(self, "gravity_stiffness", gravity)
        for joint, inertia, elastic in zip(names, self.motor_inertia, self.elastic, strict=True):
            if inertia == 0 and elastic:
                raise GainroomError(f"joint '{joint}': motor_inertia 0 kg·m² must be > 0 on an elastic joint")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.size} joint{'s' * (self.size > 1)}: {first_of_many(self.joint_names)})"

    @property
    def size(self) -> int:
        """Number n of joints."""
        return len(self.motor_inertia)

    @property
    def elastic(self) -> Booleans:
        """(n,) True where the gearbox is elastic."""
        return np.isfinite(self.stiffness)

    @cached_property
    def units(self) -> Floats:
        """Square root (n,) [√(kg m²)] of each motor's inertia, or the link's where it is 0: units in which joints are comparable."""
        own = np.diagonal(self.link_inverse_inertia)
        links = np.divide(1.0, own, out=np.ones(self.size), where=own > 0)
        return np.sqrt(np.where(self.motor_inertia > 0, self.motor_inertia, links))

    def regeared(self, stiffness: Floats, damping: Floats) -> "Plant":
        """Plant with other gearbox stiffness [N m/rad] and damping [N m s/rad], (n,) each."""
        found = replace(self, stiffness=stiffness, damping=damping)
        vars(found)["hung"] = self.hung  # of links and contacts alone
        return found

    def response(self, s: ArrayLike, side: str) -> Complexes:
        """Response torque → position (k, n, n) at complex s (k,): P_M (side "motor") or P_L ("link"). W and K are not inverted.

        P_M = (1/s²) Z (I + J Z)⁻¹,  P_L = (1/s²) W (I + J Z)⁻¹,  Z = W + s² diag(1/k(s)),  k = K + sB,  J = J_m + D_m/s,
        and with link friction, gravity and springs under contacts W(s) = R (I + Rᵀ (D_l/s + G/s²) R + Hᵀ ((K_c + s B_c)/s²) H)⁻¹ Rᵀ.
        """
        points = np.atleast_1d(np.asarray(s, dtype=complex))[:, None, None]
        if self._unsprung is not None:
            return self._unsprung * (1 / points**2)
        links = np.broadcast_to(self.link_inverse_inertia, (len(points), self.size, self.size))
        load = np.diag(self.link_viscous) / points
        if self.gravity_stiffness is not None:
            load = load + self.gravity_stiffness / points**2
        if self.compliance is not None or np.any(load):
            # Contacts that hold motions make W singular, and its round-off times G/s² is not small: R excludes them.
            root, hung = self.hung
            held = np.eye(root.shape[1]) + root.T @ load @ root
            if self.compliance is not None:
                springs = (self.compliance.stiffness + points[:, 0] * self.compliance.damping) / points[:, 0] ** 2
                held = held + hung.T @ (springs[:, :, None] * hung)
            links = root @ np.linalg.solve(held, np.broadcast_to(root.T, (len(points), *root.T.shape)))
        gearbox = 1 / np.where(self.elastic, self.stiffness + points[:, 0] * self.damping, np.inf)  # 0 where rigid
        admittance = np.array(links, dtype=complex, order="C")
        diagonals(admittance)[:] += points[:, 0] ** 2 * gearbox
        motors = self.motor_inertia + self.motor_viscous / points[:, 0]
        moved = admittance if side == "motor" else links
        # X (I + J Z)⁻¹ = ((I + J Z)ᵀ \ Xᵀ)ᵀ
        feedback = motors[:, :, None] * admittance
        diagonals(feedback)[:] += 1
        return np.linalg.solve(feedback.swapaxes(1, 2), moved.swapaxes(1, 2)).swapaxes(1, 2) / points**2

    @cached_property
    def _unsprung(self) -> Floats | None:
        """Matrix W (I + J_m W)⁻¹ (n, n) where no spring and no damper acts (rigid joints alone); None elsewhere."""
        resisted = np.any(self.motor_viscous) or np.any(self.link_viscous) or self.gravity_stiffness is not None
        if np.any(self.elastic) or resisted or self.compliance is not None:
            return None
        links = self.link_inverse_inertia
        return np.linalg.solve(np.eye(self.size) + links * self.motor_inertia, links)

    @cached_property
    def hung(self) -> tuple[Floats, Floats]:
        """Factor R (n, r) with W = R Rᵀ, and H (c, r): the deflection of each contact spring in the same r independent motions.

        Motions that no spring resists come last, and are exactly 0 in H: as ω → 0 they exceed spring-held motion by 1/ω², and a difference
        of the two would lose the latter.
        """
        soft = self.compliance
        if soft is None:
            root = _factor(self.link_inverse_inertia)
            return root, np.zeros((0, root.shape[1]))
        roots = _factor(np.block([[self.link_inverse_inertia, soft.coupling], [soft.coupling.T, soft.inverse_inertia]]))
        root, rest = roots[: self.size], roots[self.size :]
        _, sizes, turn = np.linalg.svd(rest)
        hung = rest @ turn.T
        hung[:, int(np.count_nonzero(sizes > NOT_HUNG * sizes.max(initial=0.0))) :] = 0.0
        return root @ turn.T, hung

    def mechanism(self, twists: bool = False) -> Mechanism:
        """Second-order form, exact for any mixture of rigid and elastic joints and for singular W.

        twists   True: coordinates θ_e − q_e (gearbox deflections) in place of θ_e. Motions without a spring are then in ξ alone, and their
                 columns of K_η exactly 0; in θ_e, round-off of K_η acts as a spring of 1e-16 of the gearboxes', of either sign.
        """
        soft, (root, rest) = self.compliance, self.hung
        elastic = np.flatnonzero(self.elastic)
        links, size = root.shape[1], self.size
        total = links + len(elastic)
        motor_position = np.zeros((size, total))
        motor_position[:, :links] = root if twists else np.where(self.elastic[:, None], 0.0, root)
        motor_position[elastic, links + np.arange(len(elastic))] = 1.0
        link_position = np.hstack([root, np.zeros((size, len(elastic)))])
        twist = (motor_position - link_position)[elastic]

        mass = np.zeros((total, total))
        mass[:links, :links] = np.eye(links)
        mass += motor_position.T @ (self.motor_inertia[:, None] * motor_position)
        damping = twist.T @ (self.damping[elastic, None] * twist)
        damping += motor_position.T @ (self.motor_viscous[:, None] * motor_position)
        damping += link_position.T @ (self.link_viscous[:, None] * link_position)
        stiffness = twist.T @ (self.stiffness[elastic, None] * twist)
        if soft is not None:
            damping[:links, :links] += rest.T @ (soft.damping[:, None] * rest)
            stiffness[:links, :links] += rest.T @ (soft.stiffness[:, None] * rest)
        if self.gravity_stiffness is not None:
            stiffness = stiffness + link_position.T @ self.gravity_stiffness @ link_position
        return Mechanism(mass, damping, stiffness, motor_position.T, motor_position, link_position)

    @cached_property
    def modes(self) -> Modes | None:
        """Modal form of the motors' response; None with friction to ground, unsymmetric gravity stiffness, and where modes_of has none."""
        gravity = self.gravity_stiffness
        if np.any(self.motor_viscous) or np.any(self.link_viscous) or (gravity is not None and not np.array_equal(gravity, gravity.T)):
            return None
        form = self.mechanism()
        found = modes_of(form.mass, form.damping, form.stiffness, form.motor_position)
        if found is None:
            return None
        s = 1j * BESIDE * distinct(np.abs(found.poles[found.poles.imag >= 0]))
        right = self.response(s, "motor")
        off = np.abs(found.response(s) - right).max(axis=(1, 2)) / np.abs(right).max(axis=(1, 2))
        inexact = float(off.max(initial=0.0))
        return replace(found, inexact=inexact) if inexact < OFF_MODES else None

    @cached_property
    def toppling(self) -> int | None:
        """Number of unstable motions of the uncontrolled plant under gravity, one pole each; None if G is not symmetric."""
        return self.toppled(np.zeros((self.size, self.size)))

    def toppled(self, held: Floats) -> int | None:
        """Number of motions that gravity topples when symmetric springs `held` (n, n) [N m/rad] hold the motors.

        None if G is not symmetric.

        A gain kp is such a spring for real, slow roots. The number equals that of the negative eigenvalues of K_η with these springs, since
        no damper drives anything (Thomson, Tait and Chetaev: Merkin 1997, Introduction to the Theory of Stability, chapter 6). With PD
        gains as springs that act late these are still roots on the positive real axis: there the symmetric M_η s² + D_η s + K_η + θᵀ d(s)
        θ, d real, is positive for large s, and each of its eigenvalues that is negative at 0 has passed 0 on the way.
        """
        gravity = self.gravity_stiffness
        if gravity is None:
            return 0
        if not np.allclose(gravity, gravity.T, rtol=0, atol=1e-9 * np.abs(gravity).max()):
            return None
        form = self.mechanism()
        squares = undamped(form.mass, form.stiffness + form.force @ held @ form.motor_position)[0]
        return int(np.count_nonzero(squares < -AT_REST * np.abs(squares).max(initial=0.0)))

    def corners(self) -> Corners:
        """Rough poles of the motors' response, and its rough zeros: the poles with the motors held."""
        form = self.mechanism()
        held = np.flatnonzero(~np.any(form.force, axis=1))

        def motions(part: Integers) -> Complexes:
            at = np.ix_(part, part)
            return rough_poles(form.mass[at], form.damping[at], form.stiffness[at])

        return Corners(motions(np.arange(len(form.mass))), motions(held))


_JOINT_FIELDS = (
    ("motor_inertia", "kg·m²", False),
    ("stiffness", "N·m/rad", True),
    ("damping", "N·m·s/rad", False),
    ("motor_viscous", "N·m·s/rad", False),
    ("link_viscous", "N·m·s/rad", False),
)


def _per_joint(name: str, value: ArrayLike, size: int) -> Floats:
    """`value` as (n,) numbers, one per joint. Raises GainroomError for other shapes."""
    try:
        found = np.array(value, dtype=float)
        return found if found.shape == (size,) else np.broadcast_to(found, (size,)).copy()
    except (TypeError, ValueError) as error:
        raise GainroomError(f"plant: {name} of shape {np.shape(value)} must be a number or {size} numbers") from error


def _factor(inverse_inertia: Floats) -> Floats:
    """Factor R (n, r) of full column rank r with W = R Rᵀ."""
    values, vectors = eigensystem(inverse_inertia)
    # Round-off of a contact projection leaves eigenvalues of about 1e-16 of the largest; true ones are far above 1e-12 of it.
    keep = values > 1e-12 * max(values[-1], 0.0)
    return vectors[:, keep] * np.sqrt(values[keep])
