"""Ground that feet may slip on and leave, and the soles that touch it: what a simulation needs beyond a contact's frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..errors import require_positive


@dataclass(frozen=True, kw_only=True)
class Sole:
    """The rectangle of a contact frame's x-y plane that touches the ground; a line contact uses its width alone, a point contact nothing.

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
    """Ground that the feet stand on and may leave: under each contact frame a plane through it, normal to its z axis.

    friction   of Coulomb, between sole and ground
    soles      by frame; a Sole of ordinary size where none is given
    """

    friction: float = 0.8
    soles: Mapping[str, Sole] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_positive("ground", "friction", self.friction)
