"""Claim 3: a joint with a large load, as the supporting ankle, cannot reach high tracking performance under PD (Secs. III-A and V).

Motor and delay limit kd [N·m·s/rad]; tracking performance is kd over the whole inertia that it moves, K'v = kd/(J_M + J_L) [1/s].
The load of an ankle depends on its neighbours: with them free it is 1/W_ii; with all held, the ankle carries the robot, and in double
support two ankles share it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..analysis.gain_limit import gain_limit
from ..system.controller import PD
from ..system.elastic_joint import ElasticJoint
from ..system.linear.arrays import Floats
from ..system.loop import build_loop
from .biped import COM_KD, COM_KP, NAMES, SUPPORTS, com_tasks, free_loads, standing
from .claim2 import RATIOS, limits
from .joints import DRIVE, GAINS, MOTOR_INERTIA, limit_with_load
from .picture import Curve, Mark, Panel, Picture
from .row import Row, at_least, compare

TOLERANCE = 0.05  # of K'v: the gearbox's stiffness and the load move the motor's own limit by a few per cent (claim 2)
SINGULAR = 1e-9  # of W's largest eigenvalue; feet closed into a loop leave round-off, 1e-16
CLEARLY = 1.5  # "significantly": half as much again at least
PAPER = f"The paper: significantly increased in single support, read as {CLEARLY:g} times at least."
ANKLES = ("ankle_pitch", "ankle_roll")
SWAY = {  # joints that move when the body sways over the standing feet and all others are held
    ("double", "ankle_pitch"): ("left_ankle_pitch", "right_ankle_pitch"),
    ("double", "ankle_roll"): ("left_ankle_roll", "right_ankle_roll", "left_hip_roll", "right_hip_roll"),
    ("left", "ankle_pitch"): ("left_ankle_pitch",),
    ("left", "ankle_roll"): ("left_ankle_roll",),
}


@dataclass(frozen=True)
class Edge:
    """Joint at its gain limit.

    load   [kg·m²]
    kd     largest, with Fig. 9's kp per kd [N·m·s/rad]
    rate   K'v = kd / (J_M + load) [1/s]
    """

    load: float
    kd: float

    @property
    def rate(self) -> float:
        return self.kd / (MOTOR_INERTIA + self.load)


def rows() -> Iterator[Row]:
    """K'v of the supporting ankles, the body held stiff above them; one leg against two; the same for the centre of mass."""
    for contact, joint in SWAY:
        edge, expected = supporting(contact, joint), motor_alone() / (MOTOR_INERTIA + supporting(contact, joint).load)
        note = (
            f"Largest K'v in {SUPPORTS[contact]}, all other joints held: load {edge.load:.1f} kg·m², largest kd {edge.kd:.0f} N·m·s/rad. "
            f"Expected: the lone motor's largest kd, {motor_alone():.0f}, over J_M + J_L. Tolerance 5 %: the effect of the load "
            "on kd (claim 2)."
        )
        note = _claim() if (contact, joint) == ("left", "ankle_pitch") else note
        yield compare(f"claim3.{contact}.{joint}.kv_limit_per_s", expected, edge.rate, "1/s", TOLERANCE * expected, note)
    for joint in ANKLES:
        held = supporting("left", joint).load / supporting("double", joint).load
        note = f"Confirmed where the joints above are held: one ankle then carries what two shared. {PAPER}"
        yield at_least(f"claim3.{joint}.held.load_ratio", CLEARLY, held, "×", note)
    for joint in ANKLES:
        two, one = (free_load(contact, f"left_{joint}") for contact in SUPPORTS)
        note = (
            f"Corrected: with its neighbours free the ankle's load is {two:.3g} kg·m² on two legs and {one:.3g} on one. Lifting the other "
            f"foot loads it only through joints that are held. {PAPER}"
        )
        yield at_least(f"claim3.{joint}.free.load_ratio", CLEARLY, one / two, "×", note)
    for axis, two, one in zip("xyz", com_limits("double"), com_limits("left"), strict=True):
        note = (
            f"Centre of mass along {axis} by itself, K'p to K'v as in Table I: K'v may be {two:.3g} 1/s on two legs and {one:.3g} on one. "
            f"Expected: more on two, by {CLEARLY:g} at least."
        )
        yield at_least(f"claim3.com_{axis}.kv_limit_double_over_single", CLEARLY, two / one, "×", note)


def pictures() -> Iterator[Picture]:
    """kd and K'v at the edge of stability over the load."""
    loads = RATIOS * MOTOR_INERTIA
    kd = limits(DRIVE.delay)[0] * GAINS.kd
    marked = (
        (edge_at(free_load("left", "right_ankle_pitch")), "swinging ankle", 2, "below"),
        (edge_at(free_load("double", "left_hip_yaw")), "hip yaw", 0, "above"),
        (supporting("double", "ankle_roll"), "ankle roll, one of two", 0, "left"),
        (supporting("double", "ankle_pitch"), "ankle pitch, one of two", 0, "left"),
        (supporting("left", "ankle_pitch"), "ankle, alone", 1, "left"),
    )
    above = tuple(Mark(edge.load, edge.kd, "", kind) for edge, _, kind, _ in marked)
    below = tuple(Mark(edge.load, edge.rate, name, kind, side) for edge, name, kind, side in marked)
    panels = (
        Panel("largest kd [N·m·s/rad]", (0.0, 800.0), (Curve("set by motor and delay", loads, kd),), above),
        Panel("K'v = kd/(J_M + J_L) [1/s]", (4.0, 1500.0), (Curve("", loads, kd / (MOTOR_INERTIA + loads)),), below, logarithmic=True),
    )
    caption = (
        "Above: motor and delay set kd at every load. Below: the same kd divided by the moved inertia. Kp and Kd in Fig. 9's ratio, "
        f"T = {1e3 * DRIVE.delay:g} ms; supporting ankles with all other joints held, the others with their neighbours free."
    )
    title = "Claim 3. The largest kd does not depend on the load, so a heavy load tracks slowly"
    kinds = (*(f"biped, {name}" for name in SUPPORTS.values()), "biped, swinging leg")
    yield Picture(title, caption, "load inertia J_L [kg·m²]", (0.01, 200.0), panels, kinds, logarithmic=True)


@cache
def motor_alone() -> float:
    """The largest kd [N·m·s/rad] of the motor with nothing on it, at Fig. 9's kp per kd."""
    motor = ElasticJoint(MOTOR_INERTIA / 2, MOTOR_INERTIA / 2)  # rigid: one inertia
    return gain_limit(build_loop(motor, DRIVE, GAINS)).gain * GAINS.kd


def edge_at(load: float) -> Edge:
    """Edge of a joint with this load [kg·m²]."""
    return Edge(load, limit_with_load(load).gain * GAINS.kd)


@cache
def supporting(contact: str, joint: str) -> Edge:
    """Edge of a supporting ankle, with the body held stiff above it."""
    moving = [NAMES.index(name) for name in SWAY[contact, joint]]
    load = shared_load(standing(contact).link_inverse_inertia, moving, NAMES.index(f"left_{joint}"))
    return edge_at(load / sum(name.endswith(joint) for name in SWAY[contact, joint]))


def free_load(contact: str, name: str) -> float:
    """A joint's load with its neighbours free [kg m²]."""
    return float(free_loads(contact)[NAMES.index(name)])


def shared_load(link_inverse_inertia: Floats, moving: list[int], driven: int) -> float:
    """The inertia [kg·m²] of the one motion in which only the joints `moving` move, per unit rate of joint `driven`.

    With W = U diag(λ) Uᵀ over λ > 0, contacts allow q̇ = U y and the links then hold ½ yᵀ diag(1/λ) y of kinetic energy.
    """
    sizes, directions = np.linalg.eigh(link_inverse_inertia)
    possible = sizes > SINGULAR * sizes[-1]
    held = [index for index in range(len(sizes)) if index not in moving]
    at_rest = directions[held][:, possible]
    motion = np.linalg.svd(at_rest)[2][-1]  # y with the held joints at rest
    assert np.linalg.norm(at_rest @ motion) < 1e-7
    return float(motion @ (motion / sizes[possible]) / (directions[driven, possible] @ motion) ** 2)


@cache
def com_limits(contact: str) -> tuple[float, ...]:
    """Largest K'v [1/s] along x, y, z, each by itself, K'p to K'v as in Table I."""
    model = standing(contact)
    tasks = com_tasks(model)
    found = []
    for direction, kp, kd in zip(tasks.directions, COM_KP.tolist(), COM_KD.tolist(), strict=True):
        loop = build_loop(model, DRIVE, PD(*tasks.direction_gains(direction, kp, kd)))
        found.append(gain_limit(loop).gain * kd)
    return tuple(found)


def _claim() -> str:
    one, two = supporting("left", "ankle_pitch"), supporting("double", "ankle_pitch")
    light = edge_at(free_load("double", "left_hip_yaw"))
    return (
        "Claim 3: a joint with a large load, as the supporting ankle, cannot reach high tracking performance under PD. Confirmed: the "
        f"largest kd is that of the motor alone at any load ({one.kd:.0f} N·m·s/rad), so the largest K'v = kd/(J_M + J_L) is "
        f"{light.rate:.0f} 1/s at the hip yaw, {two.rate:.1f} at an ankle pitch that shares the robot with the other leg "
        f"({two.load:.0f} kg·m²) and {one.rate:.1f} at one that carries it alone ({one.load:.0f}). Corrected: single support loads the "
        f"ankle only where the joints above it are held; with them free its load is {free_load('double', 'left_ankle_pitch'):.2g} kg·m² "
        f"on two legs and {free_load('left', 'left_ankle_pitch'):.2g} on one."
    )
