"""Verification: predicted gain limit against the onset of vibration in simulation, two methods that share only the model.

The prediction comes from the frequency response, the simulation from stepping in time. Two witnesses: the sampled linear loop, which shares
the model; and for robots MuJoCo with drives and running controller, which shares only the file.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_limit import gain_limit
from ..analysis.margin_record import GainLimit
from ..analysis.stability import rightmost_roots
from ..errors import GainroomError
from ..robot.body import library
from ..robot.held_followers import on_a_tree
from ..simulation.onset import FURTHEST_FACTOR, Onset, linear_onset, linear_vibration
from ..simulation.robot_onset import robot_onset
from ..simulation.robot_run import RobotStepper
from ..simulation.robot_setup import robot_setup
from ..simulation.robot_simulation import require_sampled
from ..system.linear.arrays import Floats
from ..system.loop import Loop
from ..system.requirement import enough
from ..system.system import System
from .progress import Progress, quiet

TOLERANCES = {"linear": 1e-3, "mujoco": 2e-2}
"""Largest relative difference of gain and frequency from the prediction, by witness."""
LOWERED = (1.0, 0.3, 0.1)  # factors at which a loop is simulated that no lower gains stabilise
LOWERED_DURATION = 2.0  # [s] of such a run at factor 1
FEWEST_RUN_TICKS, MOST_RUN_TICKS = 200, 400_000  # ticks of one run
MOST_VERIFIED_STATES = 4  # with more states, only the tightest posture of each contact state is simulated
PERIODS_PER_RUN = 100.0  # periods of the predicted vibration: enough to detect growth of 1e-6 per period


@dataclass(frozen=True)
class VerifiedLimit:
    """One limit, predicted and simulated. Gains: factors on the file's; infinite, with frequency NaN, if none vibrates.

    what       description as text
    witness    "linear" or "mujoco"
    required   gain margin that the file requires of the present gains, a factor; None: nothing is required of the loop closed here
    """

    what: str
    witness: str
    predicted_gain: float
    simulated_gain: float
    predicted_frequency: float
    simulated_frequency: float
    runs: int = 0
    required: float | None = None

    @property
    def enough(self) -> bool | None:
        """True if the predicted limit has the required gain margin; None if none is required, or it is not known."""
        if self.required is None or math.isnan(self.predicted_gain):
            return None
        return self.predicted_gain > 1 and enough(self.predicted_gain, self.required)

    @property
    def tolerance(self) -> float:
        """Relative tolerance of the witness."""
        return TOLERANCES[self.witness]

    @property
    def gain_difference(self) -> float:
        """Relative difference of the gains, simulated over predicted minus 1; 0 if neither vibrates."""
        return _difference(self.predicted_gain, self.simulated_gain)

    @property
    def frequency_difference(self) -> float:
        """Relative difference of the frequencies, simulated over predicted minus 1; 0 if neither vibrates."""
        if self.predicted_gain == self.simulated_gain:  # 0 or inf: no vibration to have one
            return 0.0
        return _difference(self.predicted_frequency, self.simulated_frequency)

    @property
    def agrees(self) -> bool:
        """True if both differences are within the tolerance."""
        return abs(self.gain_difference) <= self.tolerance and abs(self.frequency_difference) <= self.tolerance


Job = tuple[str, Callable[[], VerifiedLimit]]
"""Name of a case, and the function that computes it."""


@dataclass(frozen=True)
class Verification:
    """Result of `gainroom verify`."""

    cases: tuple[VerifiedLimit, ...]
    of_robot: bool = False
    warnings: tuple[str, ...] = ()
    """Omissions and their reasons."""
    effects: tuple[str, ...] = ()
    """Effects of the file's scenario, which neither prediction nor simulation includes."""
    uncertain: bool = False
    """True if the file has ranges: all cases are at its nominal values."""

    @property
    def agrees(self) -> bool:
        """True if every case agrees."""
        return all(case.agrees for case in self.cases)

    @property
    def least(self) -> VerifiedLimit:
        """Case with the lowest predicted limit, unknown ones first; among those that the file's requirements apply to, if there are any."""
        judged = [case for case in self.cases if case.required is not None] or self.cases
        return min(judged, key=lambda case: -math.inf if math.isnan(case.predicted_gain) else case.predicted_gain)


def verify(system: System, progress: Progress = quiet, effects: Sequence[str] = ()) -> Verification:
    """Verification of the common factor on all gains at which vibration starts, predicted and by linear simulation, in every state.

    Robots are verified in joint and in task space, with MuJoCo as a second witness. `effects`: names of the scenario's effects; they are
    left out. Raises GainroomError for continuous control, and if the gains act on no motion in any state.
    """
    require_sampled(system)
    known, system = system.warnings, on_a_tree(system)
    warnings = [text for text in system.warnings if text not in known]
    asked = system.requirements.needed.get("gain_margin")
    jobs = [
        (job, asked if space.control.space == system.control.space else None) for space in spaces(system) for job in _jobs(space, warnings)
    ]
    if not jobs:
        raise GainroomError(
            f"{system.source.name}: the gains act on no motion in any posture and contact state, so there is nothing to verify"
        )
    cases = []
    for index, ((name, make), required) in enumerate(jobs):
        progress(index, len(jobs), name)
        cases.append(replace(make(), required=required))
    progress(len(jobs), len(jobs), "")
    return Verification(tuple(cases), system.source.body is not None, tuple(warnings), tuple(effects), bool(system.uncertainty.names))


def spaces(system: System) -> Iterator[System]:
    """Systems with the file's control in joint space, if it has such gains, and in task space, if it has tasks."""
    control = system.control
    if control.space == "joint":
        yield system
    if system.source.stack:
        yield replace(system, control=replace(control, space="task", controller=None))


def _jobs(system: System, warnings: list[str]) -> Iterator[Job]:
    """Jobs of one space; omissions are appended to `warnings`."""
    for posture, contact, loop in _states(system):
        name = f"{posture}/{contact} ({system.control.space} space)" if posture else "one joint"
        yield name, lambda name=name, loop=loop: linear_case(name, loop)
        if system.source.body is None:
            continue
        try:
            library("mujoco", "MuJoCo")
        except GainroomError as error:
            reason = f"MuJoCo as a witness: {error}"
            warnings += [] if reason in warnings else [reason]
            continue
        try:
            make = _mujoco(name, system, posture, contact, loop)
        except GainroomError as error:
            warnings.append(f"{name}: {error}")
            continue
        if make is not None:
            yield name, make


def _states(system: System) -> list[tuple[str, str, Loop]]:
    """Posture, contact state and loop of every simulated state."""
    loops = [(posture, contact, system.loop(system.source.linearize(posture, contact))) for posture, contact in system.source.states]
    loops = [state for state in loops if state[2].acts]
    if len(loops) <= MOST_VERIFIED_STATES:
        return loops
    tightest: dict[str, tuple[float, tuple[str, str, Loop]]] = {}
    for state in loops:
        limit = gain_limit(state[2]).gain
        if state[1] not in tightest or limit < tightest[state[1]][0]:
            tightest[state[1]] = limit, state
    return [state for _, state in tightest.values()]


@dataclass(frozen=True)
class Growth:
    """Growth rate of the vibration over the factor on all gains (k,): `predicted` by the rightmost root, and `simulated` [1/s]."""

    gain: Floats
    predicted: Floats
    simulated: Floats


def growth_about(loop: Loop) -> Growth:
    """Growth rates within 10 % of the gain limit, which must be finite, for a figure; NaN if a run shows no vibration."""
    limit = gain_limit(loop)
    gains = limit.gain * np.linspace(0.9, 1.1, 9)
    found = [linear_vibration(loop.scaled(gain), _duration(loop, limit)) for gain in gains]
    simulated = [math.nan if one is None else one.growth_rate for one in found]
    predicted = [float(rightmost_roots(loop.scaled(gain)).roots[0].real) for gain in gains]
    return Growth(gains, np.array(predicted), np.array(simulated))


def linear_case(what: str, loop: Loop) -> VerifiedLimit:
    """Case of a sampled loop of any number of joints, stepped linearly."""
    limit = gain_limit(loop)
    if not 0 < limit.gain < math.inf:
        return _without_limit(what, loop, limit)
    near = 1 / FURTHEST_FACTOR < limit.gain < FURTHEST_FACTOR
    begin = 1.0 if near else limit.gain  # the search stays within that factor of its start
    found = _case(what, "linear", limit, lambda: linear_onset(loop.scaled(begin), _duration(loop, limit)), begin)
    if loop.kd_path is None:
        return found
    return replace(found, simulated_frequency=_alias(found.simulated_frequency, limit.frequency, loop))


def _alias(read: float, near: float, loop: Loop) -> float:
    """Frequency [rad/s] next to `near` that reads `read` at the loop's ticks: with kd at a higher rate it may be above half of theirs."""
    assert loop.sample_time is not None
    turn = 2 * math.pi / loop.sample_time
    whole = turn * round(near / turn)
    return min(abs(whole + read), abs(whole - read), key=lambda one: abs(one - near))


def _mujoco(what: str, system: System, posture: str, contact: str, loop: Loop) -> Callable[[], VerifiedLimit] | None:
    """Function that computes the MuJoCo case; None if no predicted limit can be searched.

    Raises GainroomError if MuJoCo cannot simulate the state.
    """
    limit = gain_limit(loop)
    if not (1 / FURTHEST_FACTOR < limit.gain < FURTHEST_FACTOR and limit.frequency > 0):
        return None
    if system.source.gravity:
        raise GainroomError("gravity stiffness counts in the prediction; the simulated limit is without gravity")
    setup = robot_setup(system, posture, contact)
    RobotStepper(setup)  # refuses now what it cannot simulate
    return lambda: _case(what, "mujoco", limit, lambda: robot_onset(setup, limit.gain, limit.frequency))


def _case(what: str, witness: str, limit: GainLimit, search: Callable[[], Onset], begin: float = 1.0) -> VerifiedLimit:
    """Case of `limit` beside the result of `search`, as a factor on `begin`; NaN if no factor tried changes stability."""
    try:
        onset = search()
    except GainroomError:
        return VerifiedLimit(what, witness, limit.gain, math.nan, limit.frequency, math.nan)
    return VerifiedLimit(what, witness, limit.gain, begin * onset.gain, limit.frequency, onset.frequency, onset.runs)


def _duration(loop: Loop, limit: GainLimit) -> float:
    """Duration of one run [s], from the predicted frequency, which it influences in no other way."""
    assert loop.sample_time is not None
    wanted = PERIODS_PER_RUN * 2 * math.pi / limit.frequency if limit.frequency > 0 else 0.0
    return float(np.clip(wanted, FEWEST_RUN_TICKS * loop.sample_time, MOST_RUN_TICKS * loop.sample_time))


def _without_limit(what: str, loop: Loop, limit: GainLimit) -> VerifiedLimit:
    """Case in which no factor changes the predicted stability; none that is tried may change the simulated one."""
    if limit.gain == 0:  # it grows at every factor, more slowly at lower gains
        grown = [linear_vibration(loop.scaled(factor), LOWERED_DURATION / math.sqrt(factor)) for factor in LOWERED]
        grows = all(found is not None and found.growth_rate > 0 for found in grown)
        return VerifiedLimit(what, "linear", 0.0, 0.0 if grows else math.nan, math.nan, math.nan, len(LOWERED))
    try:
        onset = linear_onset(loop)
    except GainroomError:  # the same verdict at every factor: it may be either
        found = linear_vibration(loop)
        decays = found is None or found.growth_rate <= 0
        return VerifiedLimit(what, "linear", math.inf, math.inf if decays else math.nan, math.nan, math.nan)
    return VerifiedLimit(what, "linear", limit.gain, onset.gain, limit.frequency, onset.frequency, onset.runs)


def _difference(predicted: float, simulated: float) -> float:
    if predicted == simulated:
        return 0.0
    return simulated / predicted - 1 if math.isfinite(predicted) and predicted > 0 else math.nan
