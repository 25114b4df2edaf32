"""Random joints: the gain limits are confirmed by the independent checks, just inside and just outside, every one.

Another population: GAINROOM_SEED=7 pytest tests/test_population.py; another size: GAINROOM_POPULATION=500. The whole
population of 2000 runs with `-m population`, a share of 200 in every test run. Odd numbers are continuous, even ones
sampled with a random tick and a fractional delay. The independent verdicts are algebraic (Walton-Marshall in exact
fractions and 40 digits, Schur-Cohn in 70), so they resolve a gain shift of 1e-6 with many digits to spare.
"""

import os
from dataclasses import dataclass
from math import isinf

import numpy as np
import pytest

import gainroom as gr
from independent import delay_roots, sampled
from independent.joint import PDJoint, random_joint

SEED = int(os.environ.get("GAINROOM_SEED", "20171117"))
WHOLE = int(os.environ.get("GAINROOM_POPULATION", "2000"))
SHARE = min(200, WHOLE)
BATCH = 50
SHIFT = 1e-6  # relative, of the gain: the claim to be confirmed
WEAKER = 0.3  # gains shrink by this until the independent check finds the loop stable
WEAKEST = 1e-6  # a direction that is unstable down to this share of the first gains is taken as unstable at any gain


@dataclass(frozen=True)
class Case:
    """One draw: number `index` of a population."""

    index: int
    joint: PDJoint
    sample_time: float | None

    @classmethod
    def draw(cls, index: int, seed: int = SEED) -> "Case":
        rng = np.random.default_rng([seed, index])
        joint = random_joint(rng)
        return cls(index, joint, None if index % 2 else float(rng.uniform(0.25e-3, 2e-3)))

    def truly_stable(self, factor: float) -> bool:
        if self.sample_time is None:
            return delay_roots.count_unstable(self.joint.scaled(factor)) == 0
        return sampled.is_stable(self.joint.scaled(factor), self.sample_time)

    def loop(self, factor: float) -> gr.Loop:
        joint = self.joint.scaled(factor)
        described = gr.ElasticJoint(joint.motor_inertia, joint.link_inertia, joint.stiffness, joint.damping)
        drive = gr.Drive(joint.bandwidth, joint.damping_ratio, joint.delay)
        controller = gr.PD(joint.kp, joint.kd)
        return gr.build_loop(described, drive, controller, feedback=joint.feedback, sample_time=self.sample_time)


def disagreements(case: Case) -> list[str]:
    """What the product says of this case that the independent check does not confirm."""
    factor = 1.0
    while factor > WEAKEST and not case.truly_stable(factor):
        factor *= WEAKER
    if not case.truly_stable(factor):
        claimed = [f for f in (1.0, 1e-2, factor) if gr.is_stable(case.loop(f))]
        return [f"claimed stable at {f:g} of the gains" for f in claimed]
    limit = gr.gain_limit(case.loop(factor))
    if not limit.stable:
        return [f"claimed unstable at {factor:g} of the gains"]
    found = []
    ends = [("gain", factor * limit.gain, -1)]
    if limit.lower_gain > 0:
        ends.append(("lower gain", factor * limit.lower_gain, +1))
    elif not case.truly_stable(factor * WEAKEST):
        found.append("no lower limit claimed, but weak gains are unstable")
    for name, end, inward in ends:
        if isinf(end):
            if not case.truly_stable(1e6 * factor):
                found.append(f"{name}: none claimed, but there is one")
            continue
        if not case.truly_stable(end * (1 + inward * SHIFT)):
            found.append(f"{name} {end!r}: unstable just inside")
        if case.truly_stable(end * (1 - inward * SHIFT)):
            found.append(f"{name} {end!r}: stable just outside")
    return found


def assert_confirmed(indices: range) -> None:
    wrong = {index: found for index in indices if (found := disagreements(Case.draw(index)))}
    assert not wrong, f"population {SEED}: {wrong}"


@pytest.mark.parametrize("start", range(0, SHARE, BATCH))
def test_share_of_the_population(start):
    assert_confirmed(range(start, min(start + BATCH, SHARE)))


@pytest.mark.population
@pytest.mark.skipif("'population' not in config.getoption('markexpr')", reason="runs with -m population")
@pytest.mark.parametrize("start", range(0, WHOLE, BATCH))
def test_whole_population(start):
    assert_confirmed(range(start, min(start + BATCH, WHOLE)))


@pytest.mark.parametrize("index", [648, 1112, 462, 1538])
def test_hard_draws(index):
    """Sampled link feedback with many samples per period: the sampled zeros are ill-conditioned, the limits are not."""
    assert not disagreements(Case.draw(index, seed=20171117))


def test_population_reaches_both_kinds():
    """At least half of the directions have a limit to confirm, and some are unstable at any gain."""
    draws = [Case.draw(index) for index in range(100)]
    limited = sum(any(case.truly_stable(WEAKER**k) for k in range(12)) for case in draws)
    assert 50 <= limited < 100
