"""Where vibration begins in MuJoCo: the factor on all gains at which, after a small kick, the robot no longer comes to rest.

A witness for gain_limit that knows nothing of loci, linear models or delays in z: bodies, springs, drives and the running controller, and
the growth rate of what the motors do. Without gravity, friction or lifting feet, as the limits are those of small motions.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Floats
from ..errors import GainroomError, require_positive
from .growth import SHORTEST, Growth, fastest_growth
from .robot_run import run_robot
from .robot_setup import RobotSetup, hold

KICK = 1e-4
"""Speed of the motors at the start [rad/s]: small enough that what is nonlinear, a millionth, is not seen, and far above rounding."""
SETTLED = 0.1
"""Share of a run that is not looked at, so that what dies quickly is gone."""
FINE_STEPS = 4
"""Substeps per tick at least: vibrations at 500 rad/s are then heard 2e-4 too high."""
FACTOR = 1.5
"""Between the factors tried while looking for one that vibrates and one that does not."""
FURTHEST = 1e3


@dataclass(frozen=True)
class Onset:
    """Where vibration begins.

    gain        factor on all gains
    frequency   [rad/s]
    low, high   factors tried between which it lies: the robot came to rest at `low`, not at `high`
    runs        simulations made
    """

    gain: float
    frequency: float
    low: float
    high: float
    runs: int


def vibration_onset(
    setup: RobotSetup,
    near: float = 1.0,
    *,
    duration: float = 0.3,
    accuracy: float = 1e-3,
    progress: Callable[[int, float], None] | None = None,
) -> Onset:
    """The factor on all gains at which vibration begins, going up from a robot that comes to rest.

    near       where to look first; any factor does
    duration   of each run [s]: long enough for a few periods of what may vibrate
    accuracy   of the factor
    progress   called with (runs made, the factor tried next)

    Raises GainroomError where no factor up to 1000 vibrates, or none down to a thousandth comes to rest.
    """
    require_positive("simulation", "near", near)
    still = replace(setup, gravity=False, coulomb=0.0, torque_limit=math.inf, encoder_step=0.0, ground=None)
    still = replace(still, substeps=max(FINE_STEPS, setup.substeps or 0))
    kick = KICK * np.random.default_rng(0).standard_normal(setup.body.size)
    plan = hold(still, duration)
    runs: list[tuple[float, Growth]] = []

    def grown(gain: float) -> float:
        if progress is not None:
            progress(len(runs), gain)
        runs.append((gain, growth_at(still, plan, gain, kick)))
        return runs[-1][1].rate

    low, high = _bracket(grown, near)
    while high[0] / low[0] - 1 > accuracy:
        guess = low[0] - low[1] * (high[0] - low[0]) / (high[1] - low[1])
        # Where the fastest growth belongs to another vibration at either end, straight lines mislead: never less than a tenth inside.
        inside = 0.1 * (high[0] - low[0]) if math.isfinite(guess) else math.nan
        gain = min(max(guess, low[0] + inside), high[0] - inside) if math.isfinite(guess) else math.sqrt(low[0] * high[0])
        rate = grown(gain)
        low, high = ((gain, rate), high) if rate < 0 else (low, (gain, rate))
    found = dict(runs)
    share = low[1] / (low[1] - high[1]) if math.isfinite(high[1]) else 0.5
    return Onset(low[0] + share * (high[0] - low[0]), found[high[0]].frequency, low[0], high[0], len(runs))


def growth_at(setup: RobotSetup, plan: Floats, gain: float, kick: Floats) -> Growth:
    """Of the motors' fastest growing vibration after a kick.

    −inf where they come to rest at once, inf where the robot runs away at once.
    """
    run = run_robot(setup, plan, gain=gain, kick=kick)
    speeds = np.diff(run.motor_position, axis=0) / setup.sample_time
    speeds = speeds[int(SETTLED * len(plan)) :]
    if len(speeds) < SHORTEST:
        return Growth(math.inf, math.nan)
    growth = fastest_growth(speeds, setup.sample_time)
    if growth is None:
        return Growth(-math.inf if run.ending == "completed" else math.inf, math.nan)
    return growth


End = tuple[float, float]
"""A factor and the growth rate there."""


def _bracket(grown: Callable[[float], float], near: float) -> tuple[End, End]:
    """A factor that comes to rest and, above it, one that does not."""
    here = (near, grown(near))
    step = 1 / FACTOR if here[1] >= 0 else FACTOR
    while 1 / FURTHEST < here[0] / near < FURTHEST:
        gain = here[0] * step
        there = (gain, grown(gain))
        if (there[1] >= 0) != (here[1] >= 0):
            return (here, there) if here[1] < 0 else (there, here)
        here = there
    raise GainroomError(
        f"simulation: the robot {'vibrates' if here[1] >= 0 else 'comes to rest'} at every factor on its gains from {near:g} to {here[0]:g}"
    )
