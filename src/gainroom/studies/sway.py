"""Sway of a robot in one state, separated from its vibrations: moving joints, damping, and the margins without it.

A floating base on its contacts oscillates on the stiffness of the joints' position gains. A balance controller above the joints damps that;
no joint gain that is otherwise safe may be able to. So its part in phase margins and peak sensitivities is judged by the controller stated
to damp it.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..analysis.followed_root import root_near
from ..analysis.margin_record import Margins
from ..analysis.margins_outside import margins_outside
from ..system.linear.arrays import Floats
from ..system.loop import Loop
from ..system.system import StateCase

if TYPE_CHECKING:
    from ..robot.sway import SlowMode

FROM = -0.05 + 1j
"""Start of the search for a mode's closed-loop root, relative to its undamped frequency."""


@dataclass(frozen=True)
class Sway:
    """Sway of one state.

    modes    by rising frequency, one or more
    bands    (k, 2) frequency bands of the modes, in which margins belong to sway [rad/s]
    frequency, damping_ratio   of the least damped mode, by its closed-loop root [rad/s]; the ratio NaN if none was found
    mode     (n,) the joints' part in that mode, the largest 1
    """

    modes: tuple["SlowMode", ...]
    bands: Floats
    frequency: float
    damping_ratio: float
    mode: Floats


def sway_of(case: StateCase, loop: Loop) -> Sway | None:
    """Sway of one state with its loop; None if nothing sways, if tasks hold the base, and if kd has a separate path."""
    if case.system.source.body is None or case.system.control.space == "task" or loop.kd_path is not None or loop.parts is None:
        return None
    from ..robot.sway import SlowMotion  # the whole robot, which a joint does without

    motion = SlowMotion.of(case.model)
    if motion is None:
        return None
    held, bands = motion.sway(loop.parts.controller, case.system.control.feedback, case.system.lag)
    if not held:
        return None
    found = [(_root(loop, one), one) for one in held]
    root, least = min(found, key=lambda pair: math.inf if pair[0] is None else -pair[0].real / abs(pair[0]))
    ratio = math.nan if root is None else -root.real / abs(root)
    omega = least.frequency if root is None else abs(root)
    return Sway(held, bands, omega, ratio, least.joints)


def without_sway(case: StateCase, found: Margins, loop: Loop | None = None) -> Margins:
    """Margins `found` of a case and its loop as compared with requirements: without sway if a controller damps it."""
    if case.system.balance != "controller" or not found.stable:
        return found
    loop = case.system.loop(case.model) if loop is None else loop
    sway = sway_of(case, loop)
    return found if sway is None else margins_outside(loop, found, sway.bands)


def _root(loop: Loop, mode: "SlowMode") -> complex | None:
    """Closed-loop root of a mode; None if another one is found, or none."""
    from ..robot.sway import NEAR

    root = root_near(loop, FROM * mode.frequency)
    return root if root is not None and 1 / NEAR < abs(root) / mode.frequency < NEAR else None
