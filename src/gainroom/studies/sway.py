"""Sway of a robot in one state, apart from its vibrations: what swings, how it is damped, and the margins without it.

A floating base on its contacts swings at what the joints' position gains hold it with. A balance controller above the joints damps that;
no gain that is safe otherwise may be able to. So its part in phase margins and peak sensitivities is judged by who is said to damp it.
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

LATE = 0.05
"""[rad] of phase that drives, delay and sampling may take at a mode's frequency, 3°: with more, delay has a part in how it swings, and that
is a vibration."""
FROM = -0.05 + 1j
"""Times a mode's frequency without damping: where the search for its root begins."""


@dataclass(frozen=True)
class Sway:
    """Sway of one state.

    modes    by rising frequency, one or more
    bands    (k, 2) about them, in which margins are theirs [rad/s]
    frequency, damping_ratio   of the mode that is damped least, by its closed-loop root [rad/s]; the ratio NaN where none was found
    mode     (n,) the joints' part in that mode, the largest 1
    """

    modes: tuple["SlowMode", ...]
    bands: Floats
    frequency: float
    damping_ratio: float
    mode: Floats


def sway_of(case: StateCase, loop: Loop) -> Sway | None:
    """The sway of one state with its loop; None where nothing sways, where tasks hold the base, and where kd has a path of its own."""
    if case.system.source.body is None or case.system.control.space == "task" or loop.kd_path is not None or loop.parts is None:
        return None
    from ..robot.sway import bands, slow_modes  # the whole robot, which a joint does without

    modes = slow_modes(case.model, loop.parts.controller, case.system.control.feedback)
    swaying = tuple(one for one in modes if one.sways and case.system.lag * one.frequency <= LATE)
    if not swaying:
        return None
    found = [(_root(loop, one), one) for one in swaying]
    root, least = min(found, key=lambda pair: math.inf if pair[0] is None else -pair[0].real / abs(pair[0]))
    ratio = math.nan if root is None else -root.real / abs(root)
    omega = least.frequency if root is None else abs(root)
    return Sway(swaying, bands(modes, swaying), omega, ratio, least.joints)


def without_sway(case: StateCase, found: Margins, loop: Loop | None = None) -> Margins:
    """`found`, the margins of a case and its loop, as requirements are held against them: without sway where a controller damps that."""
    if case.system.balance != "controller" or not found.stable:
        return found
    loop = case.system.loop(case.model) if loop is None else loop
    sway = sway_of(case, loop)
    return found if sway is None else margins_outside(loop, found, sway.bands)


def _root(loop: Loop, mode: "SlowMode") -> complex | None:
    """The root of the closed loop that belongs to a mode; None where another one is found, or none."""
    from ..robot.sway import NEAR

    root = root_near(loop, FROM * mode.frequency)
    return root if root is not None and 1 / NEAR < abs(root) / mode.frequency < NEAR else None
