"""Gains that go with contact and posture while a controller runs: never above the tracked limit, and without a step in torque.

A table holds gains for each contact state, such as `recommended` per contact finds them, and the set that is safe in every state. At a tick

    target = min(highest, safe_gain / margin) · own gains of the contact state
    target = the set that is safe in every state, where the contact state or its limit is not known

with safe_gain the factor on these own gains up to which the robot is known not to vibrate now. A gain above its target falls to it at once,
as safety goes before smoothness. One below rises by so many dB per second: slowly beside the frequencies at which loops vibrate.

The command stays continuous by an offset, as in bumpless transfer between controllers (Åström and Hägglund, Advanced PID Control, 2006,
sec. 3.5): it takes what a change of gains would change the torque by, and decays,

    τ = kp e + kd ė + feed-forward + o,    o(k) = o(k−1) e^{−dt/fade} + (kp(k−1) − kp(k)) e(k) + (kd(k−1) − kd(k)) ė(k)

To a constant error the effective gain kp + o/e is kp behind a first-order lag: it stays between the gains before and after. To an
error at ω the offset is no more than r/ω of the gains, with r the rate of rise in 1/s: 60 dB/s is 6.9/s, 3 % at 40 Hz.
"""

import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ...errors import GainroomError, require_finite, require_positive
from ...system.linear.arrays import Floats
from ...system.requirements import Requirements

if TYPE_CHECKING:
    from ..gain_sets import RobotGains

RISE = 60.0
"""[dB/s]"""
FADE = 0.05
"""[s]"""
LONGEST_TICK = 0.02
"""A tick that took longer counts as this long: gains that nobody applied for a while do not jump [s]."""
LEAST_SHARE = 1e-3
"""Share of its target from which a gain of 0 begins to rise; no tick may rise by more than from there: 60 dB."""

GainPair = tuple[ArrayLike, ArrayLike]
"""kp [N m/rad], kd [N m s/rad] of n joints."""


class Limit(Protocol):
    """Gain limit that a tracker reports at one tick, see GainTracker."""

    @property
    def certified(self) -> bool: ...
    @property
    def safe_gain(self) -> float: ...


class Tracker(Protocol):
    """Tracker of the limit of one contact state's own gains. Its `update` raises nothing."""

    def update(self, q: Any, contact: Any) -> Limit: ...


@dataclass(frozen=True)
class GainTable:
    """Gains (2, n) [N m/rad; N m s/rad] by contact state, and `everywhere`: the set for states that are not known."""

    own: Mapping[str, Floats]
    everywhere: Floats

    @classmethod
    def of(cls, own: Mapping[str, GainPair], everywhere: GainPair | None = None) -> "GainTable":
        """From (kp, kd) by contact state. Without `everywhere`: the smallest of every gain over the table.

        Raises GainroomError for an empty table, for lengths that differ, and for gains that are not finite and >= 0.
        """
        if not own:
            raise GainroomError("gain table: there is no contact state in it")
        found = {name: _pair(f"gain table: {name!r}", gains) for name, gains in own.items()}
        least = np.min(list(found.values()), axis=0) if _alike(found) else np.zeros((2, 0))
        found["everywhere"] = least if everywhere is None else _pair("gain table: everywhere", everywhere)
        if not _alike(found):
            lengths = ", ".join(f"{name!r} {gains.shape[1]}" for name, gains in found.items() if gains.size)
            raise GainroomError(f"gain table: numbers of joints must be the same: {lengths}")
        return cls({name: found[name] for name in own}, found["everywhere"])

    @classmethod
    def recommended(cls, gains: "RobotGains") -> "GainTable":
        """Gains that recommend_robot found in joint space; a contact state without gains of its own has those that are safe in all.

        A joint that nothing can move in any state has gains 0. Raises GainroomError in task space, and where no set is safe in all.
        """
        if gains.space != "joint":
            raise GainroomError(f"gain table: recommended gains of {gains.space} space; joint space is scheduled")
        if gains.everywhere is None:
            raise GainroomError("gain table: no gains were found that are safe in every state")
        safe = np.nan_to_num([gains.everywhere.kp, gains.everywhere.kd])
        sets = {name: safe if one is None else np.array([one.kp, one.kd]) for name, one in gains.per_contact.items()}
        return cls.of({name: tuple(np.where(np.isnan(one), safe, one)) for name, one in sets.items()}, tuple(safe))


@dataclass(frozen=True)
class ScheduledGains:
    """The gains to use at one tick.

    kp, kd     (n,) [N m/rad], [N m s/rad]
    factor     on the contact state's own gains, at most; NaN where the set for unknown states is the target
    certified  whether the tracker's limit is certified at this tick
    settled    whether all gains have reached their target
    problem    what was wrong with the call, or is not known; "" where nothing is
    """

    kp: Floats
    kd: Floats
    factor: float
    certified: bool
    settled: bool
    problem: str = ""


class GainScheduler:
    """Gains and torques of n joints, tick by tick.

    table         gains by contact state; see GainTable
    trackers      by contact state: what follows the limit of its own gains as a factor on them
    requirements  the gain margin to hold at every tick. The others are held where the table's gains were found for them, and are not
                  looked at here; None: the usual ones
    rise          rate at which gains rise [dB/s]
    fade          time constant with which the offset decays [s]
    highest       of the factor on the table's gains. Above 1 of all requirements only the gain margin holds

    The first tick begins with `everywhere`. Nothing raises in the loop: what cannot be used is told by `problem`. Raises GainroomError here
    where contact states or gains of table and trackers differ, where no gain margin is asked for, and for numbers that make no sense.
    """

    def __init__(
        self,
        table: GainTable,
        trackers: Mapping[str, Tracker],
        requirements: Requirements | None = None,
        *,
        rise: float = RISE,
        fade: float = FADE,
        highest: float = 1.0,
    ):
        if set(table.own) != set(trackers):
            names = ", ".join(sorted({str(name) for name in set(table.own) ^ set(trackers)}))
            raise GainroomError(f"gain scheduler: every contact state needs gains and a tracker; only one of them is there for {names}")
        for name, tracker in trackers.items():
            if getattr(tracker, "space", "joint") != "joint":
                raise GainroomError(f"gain scheduler: the tracker of {name!r} follows tasks; only gains of joints are scheduled")
            own = table.own[name]
            tracked = np.asarray(getattr(tracker, "gains", own))  # one of a user's own need not tell
            if tracked.shape != own.shape or not np.allclose(tracked, own, rtol=1e-9, atol=0.0):
                raise GainroomError(
                    f"gain scheduler: the tracker of {name!r} follows the limit of other gains than the table's: "
                    f"GainTracker(robot, PD(*table.own[{name!r}]), contacts=[{name!r}])"
                )
        margin = (Requirements.usual() if requirements is None else requirements).gain_margin
        if margin is None:
            raise GainroomError("gain scheduler: the requirements must have a gain margin")
        self._table, self._trackers, self._margin = table, dict(trackers), margin
        self._rise = require_positive("gain scheduler", "rise", rise, "dB/s") * math.log(10) / 20
        self._fade = require_positive("gain scheduler", "fade", fade, "s")
        self._highest = require_positive("gain scheduler", "highest", highest, "")
        self._gains, self._applied = table.everywhere.copy(), table.everywhere.copy()
        self._offset = np.zeros(table.everywhere.shape[1])
        self._torque, self._feedforward = self._offset.copy(), self._offset.copy()
        self._decay, self._switched, self._contact, self._started = 1.0, False, None, False

    @property
    def offset(self) -> Floats:
        """Offset o (n,) [N m]: the torque that remains of earlier changes of gains, and decays."""
        return self._offset.copy()

    def update(self, q: ArrayLike, contact: str | None, dt: float) -> ScheduledGains:
        """The gains of this tick, in posture `q` (nq,) on `contact`, `dt` [s] after the last.

        contact   None where it is not known, as about the moment at which a foot lands
        """
        problem = ""
        name = contact if isinstance(contact, str) and contact in self._table.own else None
        if name is None and contact is not None:
            problem = "unknown contact state"
        if not (isinstance(dt, numbers.Real) and 0 <= dt < math.inf):
            dt, problem = 0.0, "tick length is not finite and >= 0"
        dt = min(float(dt), LONGEST_TICK)
        self._switched = self._switched or name != self._contact
        self._contact, factor, certified = name, math.nan, False
        target = self._table.everywhere
        if name is not None:
            limit = self._trackers[name].update(q, name)
            flag = getattr(limit, "flag", "")  # one of a user's own need not have it
            problem = problem or (f"the tracker's flag is {flag!r}" if flag else "")
            if limit.safe_gain > 0:  # not NaN
                factor, certified = min(self._highest, limit.safe_gain / self._margin), bool(limit.certified)
                target = factor * self._table.own[name]
            else:
                problem = problem or "no limit is known"
        lowest = np.where(self._gains > 0, self._gains, LEAST_SHARE * target)
        self._gains = np.minimum(target, lowest * math.exp(min(self._rise * dt, -math.log(LEAST_SHARE))))
        self._decay *= math.exp(-dt / self._fade)
        kp, kd = self._gains
        return ScheduledGains(kp.copy(), kd.copy(), factor, certified, bool(np.array_equal(self._gains, target)), problem)

    def torque(self, error: ArrayLike, rate: ArrayLike, feedforward: ArrayLike = 0.0) -> Floats:
        """(n,) [N m] with the gains of the last update, continuous over changes of gains and, where the contact switches, of feed-forward.

        error, rate   x_d − x and its rate, (n,) [rad], [rad/s]
        feedforward   (n,) such as torques that hold the weight [N m]

        Where one of these is not finite or of the wrong length, the last torque is held.
        """
        try:
            e, v, ahead = (np.broadcast_to(np.asarray(value, dtype=float), self._offset.shape) for value in (error, rate, feedforward))
        except (TypeError, ValueError):
            return self._torque.copy()
        if not (np.isfinite(e).all() and np.isfinite(v).all() and np.isfinite(ahead).all()):
            return self._torque.copy()
        before, now = self._applied, self._gains
        self._offset = self._offset * self._decay + (before[0] - now[0]) * e + (before[1] - now[1]) * v
        if self._switched:
            self._offset += self._feedforward - ahead
        if not self._started:
            self._offset[:] = 0.0
        self._decay, self._switched, self._started, self._feedforward = 1.0, False, True, ahead.copy()
        self._applied = now.copy()
        self._torque = now[0] * e + now[1] * v + ahead + self._offset
        return self._torque.copy()


def _pair(owner: str, gains: GainPair) -> Floats:
    """Gains kp and kd as one array (2, n). Raises GainroomError where lengths differ or a gain is not finite and >= 0."""
    try:
        stiffness, damping = gains
    except (TypeError, ValueError) as error:
        raise GainroomError(f"{owner}: gains must be kp and kd of every joint") from error
    kp, kd = (np.atleast_1d(require_finite(owner, name, value)) for name, value in (("kp", stiffness), ("kd", damping)))
    if kp.ndim != 1 or kp.shape != kd.shape or not kp.size:
        raise GainroomError(f"{owner}: kp of shape {kp.shape} and kd of shape {kd.shape} must be (n,) both, n > 0")
    lowest = min(kp.min(), kd.min())
    if lowest < 0:
        raise GainroomError(f"{owner}: a gain of {lowest:g} must be >= 0")
    return np.array([kp, kd])


def _alike(sets: Mapping[str, Floats]) -> bool:
    return len({gains.shape for gains in sets.values()}) == 1
