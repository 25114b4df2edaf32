"""Run record, tick by tick: one type for a joint, the joints of a loop and a whole robot."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np

from ..errors import GainroomError
from ..system.feedback import Side
from ..system.linear.arrays import Floats

OVERFLOWING = 1e150  # states beyond are about to overflow
STEADY_SHARE = 0.1  # share of the run over which the steady state is averaged
REFERENCE_SIGNAL = "reference"
LOGGED = ("target_torque", "demand_torque", "actual_torque", "motor_position", "link_position", REFERENCE_SIGNAL)
"""Columns of a log beside time, in order."""
Ending = Literal["completed", "diverged", "fell"]
Unit = Literal["m", "rad"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Run or part of a run: one row per tick, k rows of n joints, joint side, SI.

    time             (k,) [s]
    reference, measured   (k, m) reference and measured value of each channel: joints [rad, m], or directions of tasks
    motor_position, link_position   (k, n) true positions of both sides [rad]
    motor_reading, link_reading     (k, n) their encoder readings [rad]
    target_torque    (k, n) the controller's output [N m]
    demand_torque    (k, n) input of the current loop: the target, delayed and limited [N m]
    actual_torque    (k, n) output of the current loop [N m]
    joint_torque     (k, n) through the gearboxes [N m], NaN for rigid joints; None: not recorded
    sample_time      [s]
    feedback         the side that the controller measures, "motor" or "link"; of both that of its position gains
    joint_names, channels   (n,) and (m,) names
    ending           "completed" (or not yet ended), "diverged" or "fell"
    ended_at, reason   time [s] and reason of an early end; None and "" otherwise
    """

    time: Floats
    reference: Floats
    measured: Floats
    motor_position: Floats
    link_position: Floats
    motor_reading: Floats
    link_reading: Floats
    target_torque: Floats
    demand_torque: Floats
    actual_torque: Floats
    sample_time: float
    feedback: Side
    joint_names: tuple[str, ...]
    channels: tuple[str, ...]
    joint_torque: Floats | None = None
    ending: Ending = "completed"
    ended_at: float | None = None
    reason: str = ""

    @property
    def units(self) -> tuple[Unit, ...]:
        """Units (m,) of the channels."""
        return ("rad",) * len(self.channels)

    @property
    def torque_units(self) -> tuple[str, ...]:
        """Units (n,) of the joint torques."""
        return ("N·m",) * len(self.joint_names)

    @property
    def diverged(self) -> bool:
        """True if the run ended because a joint diverged."""
        return self.ending == "diverged"

    @property
    def diverged_at(self) -> float | None:
        """Time of divergence [s]; None if nothing diverged."""
        return self.ended_at if self.diverged else None

    @property
    def fed_back(self) -> Floats:
        """True positions (k, n) of the measured side [rad]."""
        return self.motor_position if self.feedback == "motor" else self.link_position

    @property
    def error(self) -> Floats:
        """Tracking error (k, m): reference minus true position on the measured side."""
        return self.reference - self.fed_back

    @cached_property
    def actual(self) -> Floats:
        """Channel values (k, m) computed from the true link positions."""
        return self.link_position

    @property
    def links(self) -> Floats | None:
        """True positions (k, m) of the links where each channel is a joint; None for directions of tasks."""
        return self.link_position if self.channels == self.joint_names else None

    @cached_property
    def slip(self) -> Floats:
        """Distance (k, c) of each contact frame from its start [m]."""
        return np.zeros((len(self.time), 0))

    def columns(self) -> dict[str, Floats]:
        """Columns of a log by name: `time` (k,), then those of LOGGED (k, n) that the run has; positions are encoder readings."""
        columns = {name: getattr(self, name) for name in ("time", *LOGGED)}
        return columns | {"motor_position": self.motor_reading, "link_position": self.link_reading}

    def rows(self: "AnyRun", places: slice) -> "AnyRun":
        """Run restricted to the ticks `places`."""
        return replace(self, **{name: values[places] for name, values in self.ticking().items()})

    def ticking(self) -> dict[str, Floats]:
        """Fields with one row per tick, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}

    def steady_error(self, last: float | None = None) -> Floats:
        """Mean error (m,) over the `last` seconds; None: the last tenth. Raises GainroomError for a run that ended early."""
        if self.ending != "completed":
            raise GainroomError(f"simulation: no steady state: {self.reason}")
        rows = round(STEADY_SHARE * len(self.time)) if last is None else round(last / self.sample_time)
        return self.error[-max(1, rows) :].mean(axis=0)


AnyRun = TypeVar("AnyRun", bound=Run)


def joined(parts: Iterable[AnyRun]) -> AnyRun:
    """Run joined from consecutive parts. Raises GainroomError if there is none."""
    parts = list(parts)
    if not parts:
        raise GainroomError("a run needs at least one part")
    return replace(parts[-1], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in parts[-1].ticking()})


def cut(run: Run, limit: float, first: int, ticks: int) -> Run:
    """`run`, which begins at tick `first`, cut where it diverges, if it does.

    It ends before the first row in which a position exceeds `limit` [rad] or a value is not finite; if fewer than `ticks` rows were
    computed, after the last of them.
    """
    good = np.ones(ticks, dtype=bool)
    good[len(run.time) :] = False
    for name in ("motor_position", "link_position", "target_torque", "actual_torque"):
        bound = limit if name.endswith("position") else np.finfo(float).max
        good[: len(run.time)] &= (np.abs(getattr(run, name)) <= bound).all(axis=1)  # nan is not <= anything
    if good.all():
        return run
    end = int(np.argmin(good))
    why = f"a joint position exceeded {limit:g} rad" if math.isfinite(limit) else "its numbers are no longer finite"
    return ended(run.rows(slice(0, end)), "diverged", (first + end) * run.sample_time, f"the simulation diverged: {why}")


def ended(run: AnyRun, ending: Ending, time: float, reason: str) -> AnyRun:
    """`run` marked as ended early at `time` [s]."""
    return replace(run, ending=ending, ended_at=time, reason=f"{reason} after {time:.4g} s")
