"""Stiffness from a record with the output locked: torque against deflection, as the paper measured K, and the hysteresis of friction.

With the link held the motor turns by τ/K and friction holds it back: τ = K θ ± F + offset, + while the motor turns forward, − while it
turns back. The two branches are 2F apart in torque and 2F/K in deflection.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GainroomError
from ..system.linear.arrays import Booleans, Floats
from .estimate import FREEDOM, Estimate, covariance, interval, quantile
from .record import Record, resolution

LEAST_STEPS = 20  # of the encoder that the deflection must span
LEAST_MOVING = 0.02  # of the largest speed: slower, the direction of friction is not known
SMOOTHED = 0.01  # [s] over which the velocity is taken
MOST_RELATIVE = 0.1  # standard error of K
LEAST_EXPLAINED = 0.95  # of the torque's variance: a locked joint leaves noise alone, one whose link moves its inertia's torque
CURVED = 3.0  # standard errors of the cubic term that make a spring progressive


@dataclass(frozen=True)
class StiffnessFit:
    """Torque–deflection line of a locked output.

    stiffness    K [N m/rad]
    friction     F, half the hysteresis' width in torque [N m]
    hysteresis   the width in deflection, 2F/K [rad]
    hardening    relative rise of the slope from the middle to the ends of the record: (K_end − K_middle)/K
    offset       torque at deflection 0, the middle of the branches [N m]
    deflection, torque, direction   (r,) the rows that were used [rad], [N m], ±1
    residual     (r,) [N m]
    warnings     what the reader should know
    """

    stiffness: Estimate
    friction: Estimate
    hysteresis: Estimate
    hardening: Estimate
    offset: float
    deflection: Floats
    torque: Floats
    direction: Floats
    residual: Floats
    warnings: tuple[str, ...] = ()


def identify_stiffness(record: Record, motor_inertia: float = 0.0) -> StiffnessFit:
    """Stiffness K from slow torques back and forth on a joint with a fixed output: actual, demand or target torque, motor position.

    motor_inertia   J_M [kg m²], whose share J_M θ̈ is taken off the torque; 0: the record is slow
    With a link position in the record the deflection is motor less link, so that a mount that gives way does no harm.

    Raises GainroomError where channels are missing, where the joint hardly moves, where it turns one way only, and where a spring and
    friction do not explain the torque, as when the link moves.
    """
    torque_name = record.first_of("stiffness", "actual_torque", "demand_torque", "target_torque")
    torque, motor = record.need("stiffness", torque_name, "motor_position")
    deflection = motor - record.channels["link_position"] if record.has("link_position") else motor
    step = max((resolution(record.channels[name]) for name in ("motor_position", "link_position") if record.has(name)), default=0.0)
    if np.ptp(torque) == 0:
        raise GainroomError(f"stiffness: {torque_name} does not change: load the joint slowly back and forth")
    if np.ptp(deflection) == 0 or np.ptp(deflection) < LEAST_STEPS * step:
        raise GainroomError(
            f"stiffness: the deflection spans {np.ptp(deflection):.3g} rad, {LEAST_STEPS} steps of the encoder ({step:.3g} rad) are "
            "needed: record with a larger torque"
        )
    if record.has("link_position") and np.ptp(record.channels["link_position"]) > np.ptp(deflection):
        raise GainroomError(
            f"stiffness: link_position moves by {np.ptp(record.channels['link_position']):.3g} rad, more than the spring's deflection of "
            f"{np.ptp(deflection):.3g} rad: fix the output, or identify the joint from its motion (gainroom identify joint)"
        )
    velocity, acceleration = _derivatives(motor, record)
    moving = _steady(velocity, record)
    direction = np.sign(velocity)
    if min(np.count_nonzero(moving & (direction > 0)), np.count_nonzero(moving & (direction < 0))) < SHORTEST_BRANCH:
        raise GainroomError("stiffness: the joint turns one way only: load it back and forth, so that friction shows as hysteresis")
    pull = (torque - motor_inertia * acceleration)[moving]
    return _fitted(deflection[moving], pull, direction[moving], np.flatnonzero(moving))


SHORTEST_BRANCH = 20  # rows


def _derivatives(position: Floats, record: Record) -> tuple[Floats, Floats]:
    """Velocity and acceleration (m,) from a local parabola (scipy.signal.savgol_filter); zero near gaps."""
    from scipy.signal import savgol_filter

    length = 2 * max(int(SMOOTHED / record.sample_time), 3) + 1
    if len(position) <= length:
        raise GainroomError(f"stiffness: {len(position)} rows are too few; at least {length + 1} are needed")
    velocity: Any = savgol_filter(position, length, 2, deriv=1, delta=record.sample_time)
    acceleration: Any = savgol_filter(position, length, 2, deriv=2, delta=record.sample_time)
    near = np.convolve(record.fresh.astype(float), np.ones(length), "same") > 0
    near[: length // 2], near[-(length // 2) :] = True, True
    return np.where(near, 0.0, velocity), np.where(near, 0.0, acceleration)


def _steady(velocity: Floats, record: Record) -> Booleans:
    """Rows (m,) in which the motor has turned the same way for a while, fast enough to know which."""
    fast = np.abs(velocity) > LEAST_MOVING * float(np.quantile(np.abs(velocity), 0.99))
    same = fast & (np.sign(velocity) == np.sign(np.roll(velocity, 1))) & np.roll(fast, 1)
    length = max(int(SMOOTHED / record.sample_time), 3)
    return np.convolve(same.astype(float), np.ones(2 * length + 1), "same") > 2 * length + 0.5


def _fitted(deflection: Floats, torque: Floats, direction: Floats, rows: Floats) -> StiffnessFit:
    middle, half = float((deflection.max() + deflection.min()) / 2), float(np.ptp(deflection)) / 2
    x = (deflection - middle) / half
    columns = np.column_stack([x, direction, np.ones(len(x))])
    solution, *_ = np.linalg.lstsq(columns, torque, rcond=None)
    residual = torque - columns @ solution
    # Branches, not rows, are what repeats independently: friction's wandering lasts as long as the joint turns one way.
    turns = np.concatenate([[0], np.cumsum((np.diff(direction) != 0) | (np.diff(rows) > 1))])
    inverse = np.linalg.inv(columns.T @ columns)
    influence = residual[:, None] * (columns @ inverse)
    variance = covariance(influence)
    freedom = float(FREEDOM)
    if turns[-1] >= 3:
        by_branch = covariance(influence, turns)
        if by_branch[0, 0] > variance[0, 0]:
            variance, freedom = by_branch, min(freedom, float(turns[-1]))
    slope, friction, level = solution
    if slope <= 0:
        raise GainroomError(
            f"stiffness: the torque falls with the deflection ({slope / half:.3g} N·m/rad): look at the signs of the columns, and whether "
            "the output is fixed"
        )
    explained = 1 - float(np.var(residual) / np.var(torque))
    if explained < LEAST_EXPLAINED:
        raise GainroomError(
            f"stiffness: a spring and friction explain {100 * explained:.0f} % of the torque's variance, less than "
            f"{100 * LEAST_EXPLAINED:.0f} %: the output is not fixed, or the load not slow; fix it and load the joint slowly back and forth"
        )
    error = float(variance[0, 0] ** 0.5) / half
    if error > MOST_RELATIVE * slope / half:
        raise GainroomError(
            f"stiffness: the record tells K to ± {100 * quantile(freedom) * error * half / slope:.0f} % only: load the joint slowly, "
            "several times back and forth, well beyond friction"
        )
    stiffness = interval(slope / half, error, freedom)
    towards = np.array([-2 * friction * half / slope**2, 2 * half / slope, 0.0])
    hysteresis = interval(2 * friction * half / slope, float(np.sqrt(towards @ variance @ towards)), freedom)
    hardening, curved = _hardening(x, direction, torque)
    warnings = []
    if curved:
        warnings.append(
            f"the spring is not linear: its slope at the ends is {100 * hardening.value:+.0f} % of that in the middle; K is the mean slope"
        )
    if not math.isfinite(stiffness.low) or stiffness.low <= 0:
        warnings.append("the interval of K reaches 0")
    offset = float(level - slope * middle / half)
    return StiffnessFit(
        stiffness, interval(friction, float(variance[1, 1] ** 0.5), freedom), hysteresis, hardening, offset, deflection, torque, direction,
        residual, tuple(warnings),
    )  # fmt: skip


def _hardening(x: Floats, direction: Floats, torque: Floats) -> tuple[Estimate, bool]:
    """Slope 1 + 3c x² at the ends of a cubic fit over −1 <= x <= 1 relative to the middle: estimate, and True if it is beyond chance."""
    columns = np.column_stack([x, x**3, x**2, direction, np.ones(len(x))])
    solution, *_ = np.linalg.lstsq(columns, torque, rcond=None)
    influence = (torque - columns @ solution)[:, None] * (columns @ np.linalg.pinv(columns.T @ columns))
    error = float(covariance(influence)[1, 1] ** 0.5)
    slope = solution[0] + 0.6 * solution[1]  # of the line through a cubic, evenly loaded
    value = interval(3 * solution[1] / slope, 3 * error / abs(slope), FREEDOM)
    return value, abs(solution[1]) > CURVED * error and abs(value.value) > 0.1
