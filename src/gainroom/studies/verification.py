"""The predicted gain limit against where simulation begins to vibrate: two ways to one number that share nothing but the model.

The prediction comes from the frequency response, the simulation from tick after tick in time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..analysis.gain_limit import GainLimit, gain_limit
from ..analysis.stability import rightmost_roots
from ..errors import GainroomError, apart
from ..linear.arrays import Floats
from ..simulation.onset import FURTHEST, linear_onset, linear_vibration
from ..system.joint_spec import JointSpec
from ..system.loop import Loop

TOLERANCES = {"linear": 1e-3, "mujoco": 2e-2}
"""By witness: how far, relatively, gain and frequency may be from the prediction."""
LOWERED = (1.0, 0.3, 0.1)  # factors at which a loop that no lower gains steady is run
SLOW = 2.0  # [s] of such a run at factor 1
FEWEST, MOST = 200, 400_000  # ticks of one run
ONE = "the joint"
PERIODS = 100.0  # of the predicted vibration in one run: enough to tell growth of 1e-6 per period from none

Progress = Callable[[int, int, str], None]
"""Called with (cases done, cases in all, the next one's name)."""


@dataclass(frozen=True)
class Case:
    """One limit, predicted and simulated. Gains: factors on the file's; infinite, with frequency NaN, where none vibrates.

    what       in words
    witness    "linear" or "mujoco"
    """

    what: str
    witness: str
    predicted_gain: float
    simulated_gain: float
    predicted_frequency: float
    simulated_frequency: float
    runs: int = 0

    @property
    def tolerance(self) -> float:
        """Relative."""
        return TOLERANCES[self.witness]

    @property
    def gain_difference(self) -> float:
        """Simulated over predicted, less 1; 0 where neither vibrates."""
        return _difference(self.predicted_gain, self.simulated_gain)

    @property
    def frequency_difference(self) -> float:
        """As gain_difference."""
        if self.predicted_gain == self.simulated_gain:  # 0 or inf: no vibration to have one
            return 0.0
        return _difference(self.predicted_frequency, self.simulated_frequency)

    @property
    def agrees(self) -> bool:
        """Both within the tolerance."""
        return abs(self.gain_difference) <= self.tolerance and abs(self.frequency_difference) <= self.tolerance


@dataclass(frozen=True)
class Verification:
    """What `gainroom verify` tells."""

    cases: tuple[Case, ...]
    sentence: str
    warnings: tuple[str, ...] = ()
    """What was left out, and why."""

    @property
    def agrees(self) -> bool:
        """Every case does."""
        return all(case.agrees for case in self.cases)


def verify_joint(spec: JointSpec, progress: Progress = lambda done, total, what: None) -> Verification:
    """The common factor on a joint's gains at which it begins to vibrate, predicted and by linear simulation.

    Raises GainroomError for a continuous joint, which has no ticks to simulate.
    """
    progress(0, 1, "one joint")
    cases = (linear_case("one joint", spec.loop()),)
    progress(1, 1, "")
    return Verification(cases, sentence_of(cases))


@dataclass(frozen=True)
class Growth:
    """How fast a vibration grows, by the factor on all gains (k,): `predicted` from the rightmost root, and `simulated` [1/s]."""

    gain: Floats
    predicted: Floats
    simulated: Floats


def growth_about(loop: Loop, count: int = 9) -> Growth:
    """Over the tenth of the gain to either side of its limit, which must be finite, for a picture; NaN where a run shows no vibration."""
    limit = gain_limit(loop)
    gains = limit.gain * np.linspace(0.9, 1.1, count)
    found = [linear_vibration(loop.scaled(gain), _duration(loop, limit)) for gain in gains]
    simulated = [math.nan if one is None else one.growth_rate for one in found]
    predicted = [float(rightmost_roots(loop.scaled(gain)).roots[0].real) for gain in gains]
    return Growth(gains, np.array(predicted), np.array(simulated))


def linear_case(what: str, loop: Loop) -> Case:
    """A sampled loop of any number of joints, stepped linearly."""
    limit = gain_limit(loop)
    if not 0 < limit.gain < math.inf:
        return _without_limit(what, loop, limit)
    duration = _duration(loop, limit)
    begin = 1.0 if 1 / FURTHEST < limit.gain < FURTHEST else limit.gain  # the search goes no further than that from where it begins
    try:
        onset = linear_onset(loop.scaled(begin), duration)
    except GainroomError:  # no factor that was tried changes the verdict
        return Case(what, "linear", limit.gain, math.nan, limit.frequency, math.nan)
    return Case(what, "linear", limit.gain, begin * onset.gain, limit.frequency, onset.frequency, onset.runs)


def _duration(loop: Loop, limit: GainLimit) -> float:
    """Of one run [s], by the predicted frequency; only how long is looked, not what is seen, comes from it."""
    assert loop.sample_time is not None
    wanted = PERIODS * 2 * math.pi / limit.frequency if limit.frequency > 0 else 0.0
    return float(np.clip(wanted, FEWEST * loop.sample_time, MOST * loop.sample_time))


def _without_limit(what: str, loop: Loop, limit: GainLimit) -> Case:
    """No factor changes the predicted verdict; none that is tried may change the simulated one."""
    if limit.gain == 0:  # it grows at every factor, and the more slowly the lower the gains
        grown = [linear_vibration(loop.scaled(factor), SLOW / math.sqrt(factor)) for factor in LOWERED]
        grows = all(found is not None and found.growth_rate > 0 for found in grown)
        return Case(what, "linear", 0.0, 0.0 if grows else math.nan, math.nan, math.nan, len(LOWERED))
    try:
        onset = linear_onset(loop)
    except GainroomError:  # the same verdict at every factor: it may be either
        still = linear_vibration(loop)
        calm = still is None or still.growth_rate <= 0
        return Case(what, "linear", math.inf, math.inf if calm else math.nan, math.nan, math.nan)
    return Case(what, "linear", limit.gain, onset.gain, limit.frequency, onset.frequency, onset.runs)


def sentence_of(cases: tuple[Case, ...], what: str = ONE) -> str:
    """The answer in one sentence; `what` would vibrate."""
    wrong = sorted((case for case in cases if not case.agrees), key=lambda case: -_furthest(case) / case.tolerance)
    worst = max(cases, key=lambda case: (_size(case.gain_difference), 0 < case.predicted_gain < math.inf))
    if wrong:
        names = ", ".join(f"{case.what} ({case.witness}), {_apart_in_words(case)}" for case in wrong[:3])
        names += " and others" if len(wrong) > 3 else ""
        return (
            f"Simulation and prediction differ by more than the tolerance in {len(wrong)} of {len(cases)} cases: {names}; "
            f"{_where_to_look(cases, wrong)}."
        )
    if not 0 < worst.predicted_gain < math.inf:
        told = f"no common factor on these gains makes {what} vibrate" if worst.predicted_gain else "no lower gains are stable"
        return f"Simulation agrees with the prediction: {told}."
    return (
        f"Simulation agrees with the prediction: vibration begins at {worst.simulated_gain:.5g} times these gains, predicted "
        f"{worst.predicted_gain:.5g}, {percent(worst.gain_difference)} apart"
        + (f" in the worst of {len(cases)} cases" if len(cases) > 1 else "")
        + f"; both without the scenario's friction{' and' if what == ONE else ','} torque limit{'' if what == ONE else ' and ground'}."
    )


def _furthest(case: Case) -> float:
    """The larger of both differences."""
    return max(_size(case.gain_difference), _size(case.frequency_difference))


def _apart_in_words(case: Case) -> str:
    """What of it is off, and by how much."""
    told = []
    for what, difference in (("gain", case.gain_difference), ("frequency", case.frequency_difference)):
        if not abs(difference) <= case.tolerance:
            told.append(f"no {what} found" if math.isnan(difference) else f"{what} {percent(difference, case.tolerance)} apart")
    return ", ".join(told) + f" with {100 * case.tolerance:g} % allowed"


def _where_to_look(cases: tuple[Case, ...], wrong: list[Case]) -> str:
    """Which of model and simulation is to be doubted."""
    if any(case.witness == "linear" for case in wrong):
        return "the prediction itself is in doubt: report the input"
    if any(case.witness == "linear" for case in cases):
        return "the linear simulation agrees, so look at what MuJoCo steps or holds differently: stiff gearboxes on light links, contacts"
    return "look at stiff gearboxes on light links, and at contacts"


def percent(difference: float, tolerance: float = 0.0) -> str:
    """A relative difference in words, in digits enough to tell it from `tolerance`; below a thousandth of a percent none are worth it."""
    if math.isnan(difference):
        return "–"
    if abs(difference) < 1e-5:
        return "< 0.001 %"
    return f"{100 * abs(difference):.{apart(abs(difference), tolerance, 2)}g} %"


def _size(value: float) -> float:
    return math.inf if math.isnan(value) else abs(value)


def _difference(predicted: float, simulated: float) -> float:
    if predicted == simulated:
        return 0.0
    return simulated / predicted - 1 if math.isfinite(predicted) and predicted > 0 else math.nan
