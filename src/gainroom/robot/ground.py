"""Ground for simulation, on which feet may slip and from which they may lift, and the soles that touch it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import require_positive
from ..system.linear.arrays import Floats
from .contact import Contact

LEVEL = 1e-6
"""Sine of the angle to the vertical below which a line counts as vertical, so that it determines no ground plane."""


@dataclass(frozen=True, kw_only=True)
class Sole:
    """Sole: the rectangle of a contact frame's x-y plane that touches the ground; a line contact uses its width alone, a point none.

    length, width   along x and y of the frame [m]
    center          of the rectangle in the frame [m]
    """

    length: float = 0.2
    width: float = 0.1
    center: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_positive("sole", "length", self.length, "m")
        require_positive("sole", "width", self.width, "m")


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Ground on which the feet stand and which they may leave: a plane through each contact frame, see `ground_axes`.

    friction   Coulomb coefficient between sole and ground
    soles      by frame; a Sole of ordinary size where none is given
    """

    friction: float = 0.8
    soles: Mapping[str, Sole] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_positive("ground", "friction", self.friction)


def upwards(body: Any) -> Floats | None:
    """Unit vector (3,) against gravity in world axes; None for a model without gravity."""
    gravity = np.array(body.model.gravity.linear)
    size = float(np.linalg.norm(gravity))
    return -gravity / size if size > 0 else None


def ground_axes(contact: Contact, frame: Floats, up: Floats | None) -> Floats:
    """Axes (3, 3) of the ground under a contact frame with axes `frame` (3, 3), in world axes; the last column is the normal.

    Under a flat contact the ground has the frame's slope. Under a line contact it contains the frame's y axis and is otherwise as level as
    possible, under a point contact it is level. `up` (3,); None, without gravity: the frame's own axes.
    """
    if contact.kind == "flat" or up is None:
        return frame
    along = frame[:, 1] if contact.kind == "line" else _level(frame, up)
    normal = up - along * (along @ up)
    size = float(np.linalg.norm(normal))
    if size < LEVEL:
        return frame
    normal = normal / size
    return np.column_stack([np.cross(along, normal), along, normal])


def _level(frame: Floats, up: Floats) -> Floats:
    """Horizontal unit vector (3,) along the frame's y axis, or along x where y is steeper."""
    flat = [axis - up * (axis @ up) for axis in (frame[:, 1], frame[:, 0])]
    best = max(flat, key=lambda axis: float(np.linalg.norm(axis)))
    return best / np.linalg.norm(best)


@dataclass(frozen=True)
class Footing:
    """Ground under one contact frame: height [m], and angle of its normal to the vertical [rad]."""

    frame: str
    height: float
    slope: float


def footings(body: Any, q: Floats, contacts: Sequence[Contact]) -> tuple[Footing, ...]:
    """Ground under the rigid `contacts` in posture `q` (nq,), heights relative to the lowest; empty without gravity."""
    up, found = upwards(body), []
    if up is None:
        return ()
    for contact in contacts:
        if np.isfinite(contact.springs).any():
            continue
        frame, place = body.frame_placement(q, contact.frame)
        normal = ground_axes(contact, frame, up)[:, 2]
        slope = math.atan2(float(np.linalg.norm(np.cross(normal, up))), float(normal @ up))
        found.append(Footing(contact.frame, float(up @ place), slope))
    lowest = min((footing.height for footing in found), default=0.0)
    return tuple(Footing(footing.frame, footing.height - lowest, footing.slope) for footing in found)
