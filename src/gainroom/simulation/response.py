"""What came of a run, tick by tick, and the numbers that sum it up."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np

from ..errors import GainroomError
from ..linear.arrays import Floats
from ..system.loop import Feedback

SETTLED = 0.02  # of the move: the usual band of the settling time
HUGE = 1e150  # states beyond are about to overflow
LAST = 0.1  # of the run: what the steady state is averaged over
REFERENCE = "reference"
LOGGED = ("target_torque", "demand_torque", "actual_torque", "motor_position", "link_position", REFERENCE)
"""The columns of a log beside time, in their order."""


@dataclass(frozen=True)
class Response:
    """One row per tick, joint side, SI.

    time             (k,) [s]
    reference        (k, n) x_d [rad]
    motor_position, link_position   (k, n) where the two sides are [rad]
    motor_reading, link_reading     (k, n) what their encoders say [rad]
    target_torque    (k, n) what the controller asks for [N m]
    demand_torque    (k, n) what has arrived at the current loop: the target, delayed and limited
    actual_torque    (k, n) what the current loop has made of it
    sample_time      [s]
    feedback         the side that the controller measures
    joint_names      (n,)
    diverged_at      [s] when a joint passed the scenario's limit, which ended the run; None where none did
    """

    time: Floats
    reference: Floats
    motor_position: Floats
    link_position: Floats
    motor_reading: Floats
    link_reading: Floats
    target_torque: Floats
    demand_torque: Floats
    actual_torque: Floats
    sample_time: float
    feedback: Feedback
    joint_names: tuple[str, ...]
    diverged_at: float | None = None

    @property
    def diverged(self) -> bool:
        """True where the run ended because a joint went out of bounds."""
        return self.diverged_at is not None

    @property
    def measured(self) -> Floats:
        """(k, n) what the controller saw [rad]."""
        return self.motor_reading if self.feedback == "motor" else self.link_reading

    @property
    def error(self) -> Floats:
        """(k, n) x_d − x on the side that is fed back, true position [rad]."""
        return self.reference - (self.motor_position if self.feedback == "motor" else self.link_position)

    def columns(self) -> dict[str, Floats]:
        """What a log holds: `time` (k,), then each of LOGGED (k, n); positions as the encoders read them."""
        return {
            "time": self.time,
            "target_torque": self.target_torque,
            "demand_torque": self.demand_torque,
            "actual_torque": self.actual_torque,
            "motor_position": self.motor_reading,
            "link_position": self.link_reading,
            REFERENCE: self.reference,
        }


def cut(response: Response, limit: float, first: int, ticks: int) -> Response:
    """`response`, which begins at tick `first`, up to where it diverges, if it does.

    That is before the first row in which a position lies beyond `limit` [rad] or a number is not finite, or where fewer than `ticks` rows
    came, before the first that did not.
    """
    good = np.ones(ticks, dtype=bool)
    good[len(response.time) :] = False
    for name in ("motor_position", "link_position", "target_torque", "actual_torque"):
        bound = limit if name.endswith("position") else np.finfo(float).max
        good[: len(response.time)] &= (np.abs(getattr(response, name)) <= bound).all(axis=1)  # nan is not <= anything
    if good.all():
        return response
    end = int(np.argmin(good))
    rows = {name: getattr(response, name)[:end] for name in _rows()}
    return replace(response, **rows, diverged_at=(first + end) * response.sample_time)


def joined(parts: Iterable[Response]) -> Response:
    """Parts of one run, one after the other. Raises GainroomError where there is none."""
    parts = list(parts)
    if not parts:
        raise GainroomError("a response needs at least one part")
    rows = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _rows()}
    return replace(parts[-1], **rows)


def _rows() -> list[str]:
    """The fields with one row per tick."""
    others = ("sample_time", "feedback", "joint_names", "diverged_at")
    return [field.name for field in fields(Response) if field.name not in others]


@dataclass(frozen=True)
class Tracking:
    """How what is fed back follows its reference; each (n,), in its unit: rad, and m for tasks in space.

    rms, peak       of x_d − x over the whole run
    steady_state    mean of x_d − x over the last tenth of the run
    overshoot       furthest beyond the final reference, as a part of the way there from where x began; nan where there is no way
    settling_time   from the reference's first change until x stays within 2 % of that way around the final reference, and is seen to for
                    at least a tenth of what is judged [s]; inf where it does not until the end, nan where there is no way
    """

    rms: Floats
    peak: Floats
    steady_state: Floats
    overshoot: Floats
    settling_time: Floats


class Tracked(Protocol):
    """A run of k ticks and what it was to follow."""

    @property
    def time(self) -> Floats: ...
    @property
    def reference(self) -> Floats: ...
    @property
    def error(self) -> Floats: ...


def track(response: Tracked, until: float = math.inf) -> Tracking:
    """The numbers of a run, however it ended.

    until   when something else sets in [s], such as a disturbance: overshoot and settling are those before it, and a settling that it
            cut short is nan
    """
    error = response.error
    last = max(1, round(LAST * len(error)))
    rows = max(1, int(np.searchsorted(response.time, until)))
    over, settled = np.transpose([_arrival(response, joint, rows) for joint in range(error.shape[1])])
    return Tracking(
        rms=np.sqrt(np.mean(error**2, axis=0)),
        peak=np.abs(error).max(axis=0),
        steady_state=error[-last:].mean(axis=0),
        overshoot=over,
        settling_time=settled,
    )


def _arrival(response: Tracked, joint: int, rows: int) -> tuple[float, float]:
    """(overshoot, settling time) of one joint within the first `rows`."""
    reference = response.reference[:rows, joint]
    position = reference - response.error[:rows, joint]
    way = reference[-1] - position[0]
    if way == 0:
        return math.nan, math.nan
    beyond = (position - reference[-1]) / way  # −1 at the start, 0 at the goal
    overshoot = max(0.0, float(beyond.max()))
    outside = np.flatnonzero(np.abs(beyond) > SETTLED)
    arrived = int(outside[-1]) + 1 if len(outside) else 0
    if len(beyond) - arrived < LAST * len(beyond):  # inside by chance, for all that is known
        return overshoot, math.nan if rows < len(response.time) else math.inf
    begin = response.time[_departure(reference)]
    return overshoot, max(0.0, float(response.time[arrived] - begin))


def _departure(reference: Floats) -> int:
    """The row at which `reference` (k,) begins to change: a jump is there at once, what sets out from rest was still there a row before."""
    moved = np.flatnonzero(reference != reference[0])
    if not len(moved):
        return 0
    first = int(moved[0])
    way = np.abs(reference[first : first + 2] - reference[first - 1])
    jumps = len(way) < 2 or way[1] - way[0] < way[0]
    return first if jumps else first - 1
