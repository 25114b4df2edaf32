"""Detection of channels of a record that contradict each other: another unit, a wrong sign, or two exchanged columns.

What is left of the record explains itself all the same, with inertias that are a thousand times too large, so it is looked for before.
"""

import math

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Floats
from .record import Record

FURTHEST = 0.1  # [s] that one torque is looked for before or behind the other
ALIKE = 0.95  # correlation from which on two channels are taken for the same quantity
LEAST, MOST = 0.5, 2.0  # of the one over the other: beyond, no torque constant or filter is that far off
FACTORS = {180 / math.pi: "180/π, degrees", 2 * math.pi: "2π, revolutions", 1e3: "1000, milli", 30 / math.pi: "30/π, rpm"}
ROWS = 20_000  # of the middle of a record, in which the order of torques is looked for
LOOK = "look at the sign, the unit and the side of the gearbox of the two columns (--units, --rotor-side)"
LEAST_FOLLOWED = 0.5  # of the motor's motion by the link's: less or twice as much, and where no joint fits the columns are suspect
SAME = 0.03  # of a factor: one this near is named


def require_consistent(record: Record) -> None:
    """Raises GainroomError if two channels cannot be what they are called."""
    try:
        record = record.longest_run()
    except GainroomError:  # nothing but gaps: then there is too little to contradict
        return
    for side in ("motor", "link"):
        if record.has(f"{side}_position", f"{side}_velocity"):
            _require_rate(record, side)
    if record.has("target_torque", "actual_torque"):
        _require_order(record)


def _require_rate(record: Record, side: str) -> None:
    position, velocity = record.channels[f"{side}_position"], record.channels[f"{side}_velocity"]
    rate = (position[2:] - position[:-2]) / (2 * record.sample_time)
    slope = _slope(rate, velocity[1:-1])
    if slope is not None and not LEAST < slope < MOST:
        raise GainroomError(f"{side}_position changes {slope:.3g} times as fast as {side}_velocity says{_named(slope)}: {LOOK}")


def _require_order(record: Record) -> None:
    first = max(len(record.time) - ROWS, 0) // 2
    target, actual = (record.channels[name][first : first + ROWS] for name in ("target_torque", "actual_torque"))
    most = min(int(FURTHEST / record.sample_time) + 1, len(target) // 4)
    alike = {lag: abs(_together(actual[max(lag, 0) :], target[max(-lag, 0) :])[0]) for lag in range(-most, most + 1)}
    lag = max(alike, key=lambda lag: alike[lag])
    behind = max(alike[lag] for lag in range(most + 1))
    if lag < 0 and alike[lag] > ALIKE and 1 - alike[lag] ** 2 < (1 - behind**2) / 2:
        raise GainroomError(
            f"actual_torque is {-1e3 * lag * record.sample_time:.3g} ms ahead of target_torque, as it cannot be: exchange the two columns "
            "(--columns target_torque=…,actual_torque=…)"
        )
    slope = _slope(actual[max(lag, 0) :], target[max(-lag, 0) :])
    if slope is not None and not LEAST < slope < MOST:
        raise GainroomError(f"actual_torque is {slope:.3g} times target_torque{_named(slope)}: {LOOK}")


def _slope(values: Floats, of: Floats) -> float | None:
    """Slope of `values` over `of`; None if they are not proportional."""
    alike, slope = _together(values, of)
    return slope if abs(alike) > ALIKE else None


def _together(values: Floats, of: Floats) -> tuple[float, float]:
    """Correlation of two columns over their common length, and the slope of `values` over `of`; 0 if one is constant."""
    count = min(len(values), len(of))
    values, of = values[:count] - values[:count].mean(), of[:count] - of[:count].mean()
    size = float(np.linalg.norm(values) * np.linalg.norm(of))
    product = float(values @ of)
    return (product / size, product / float(of @ of)) if size else (0.0, 0.0)


def _named(slope: float) -> str:
    """Name of a common cause of this factor, in parentheses; "" if there is none."""
    size = max(abs(slope), 1 / abs(slope))
    return next((f" ({name})" for factor, name in FACTORS.items() if abs(size / factor - 1) < SAME), "")


def encoders_apart(positions: Floats) -> str:
    """Reason why two encoders cannot belong to one joint, for a message; "" if they can: in slow motion the link moves as the motor does.

    positions   (m, o) [rad] of the motor, and of the link where it is measured
    """
    if positions.shape[1] < 2:
        return ""
    motor, link = (positions - positions.mean(axis=0)).T
    slope = float(link @ motor / (motor @ motor))
    if LEAST_FOLLOWED < slope < 1 / LEAST_FOLLOWED:
        return ""
    return f"link_position moves by {slope:.3g} times motor_position: look at the sign, the unit and the gear ratio of the two columns"
