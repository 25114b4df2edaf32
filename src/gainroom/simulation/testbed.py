"""Virtual testbed: one joint with friction and gravity, its drive on a bus, its encoders, and the loop's own controller.

The bus delivers every command some ticks late, by a constant delay or with jitter; an overtaken command is dropped. The drive limits the
torque before its current loop; the encoders quantise. With friction, gravity, limit, quantisation and jitter off this is the linear loop.
"""

import math
from dataclasses import dataclass, field

from ..errors import GainroomError, require_finite, require_positive
from ..system.loop import Loop
from .friction import Friction


@dataclass(frozen=True)
class Testbed:
    """Testbed of one joint with real hardware effects.

    loop               one joint, sampled, built with gainroom.build_loop: plant, drive, delay and controller
    motor_friction, link_friction   on either side of the gearbox
    gravity            m g l of the link [N m]: the torque that holds it level
    hanging_at         link position at which it hangs down [rad]
    torque_limit       of the drive [N m]
    motor_resolution, link_resolution   steps of the encoders, on the joint side [rad]; 0: exact
    jitter             the delay of every command is drawn from the drive's delay ± jitter [s]
    whole_ticks        True: delays are rounded to whole ticks, as on a bus that is read once a tick
    substep            longest step of the integration [s]; matters for friction and gravity only

    Raises GainroomError for a loop of several joints or without ticks, and for values that are not physical.
    """

    loop: Loop
    motor_friction: Friction = field(default_factory=Friction)
    link_friction: Friction = field(default_factory=Friction)
    gravity: float = 0.0
    hanging_at: float = 0.0
    torque_limit: float = math.inf
    motor_resolution: float = 0.0
    link_resolution: float = 0.0
    jitter: float = 0.0
    whole_ticks: bool = False
    substep: float = 25e-6

    __test__ = False  # not a test class, whatever its name

    def __post_init__(self) -> None:
        if self.loop.parts is None or self.loop.sample_time is None or self.loop.size != 1:
            raise GainroomError("testbed: loop must be one joint's, built with build_loop and a sample_time")
        require_positive("testbed", "torque_limit", self.torque_limit, "N·m", infinite=True)
        for name, unit in (("motor_resolution", "rad"), ("link_resolution", "rad"), ("jitter", "s")):
            require_positive("testbed", name, getattr(self, name), unit, zero=True)
        require_positive("testbed", "substep", self.substep, "s")
        for name in ("gravity", "hanging_at"):
            if require_finite("testbed", name, getattr(self, name)).ndim:
                raise GainroomError(f"testbed: {name} {getattr(self, name)!r} must be one number")
        delay = self.loop.parts.drives[0].delay
        if self.jitter > delay:
            raise GainroomError(f"testbed: jitter {self.jitter:g} s must be <= the drive's delay, {delay:g} s")
