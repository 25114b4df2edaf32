"""Random joints: verdict, gain, phase and delay margins are confirmed by an independent root count, just inside and just outside.

Another population: GAINROOM_SEED=7 pytest tests/test_population.py; another size: GAINROOM_POPULATION=500. The whole runs with
`-m population` (an hour or two of one core), a share in every test run: 10 000 joints of every kind ("wide"), and 2000 robot joints
under PD ("narrow"). Odd numbers are continuous, even ones sampled. The count (independent/counts.py) is algebraic in 100 digits, so it
resolves a shift of 1e-6 with many digits to spare; what it cannot decide is counted, too.
"""

import os
from collections import Counter
from functools import cache
from math import inf, isinf

import numpy as np
import pytest

import gainroom as gr
from independent.counts import Boundary
from independent.delay_roots import UndecidedError
from wide_joints import Case, narrow, wide

SEED = int(os.environ.get("GAINROOM_SEED", "20171117"))
WHOLE = {kind: min(count, int(os.environ.get("GAINROOM_POPULATION", "10000"))) for kind, count in (("wide", 10_000), ("narrow", 2000))}
DRAWS = {"wide": wide, "narrow": narrow}
SHARE, BATCH = 30, 30
SHIFT = 1e-6  # relative: the claim to be confirmed
LEAST_ANGLE = 1e-9  # [rad] by which phase and delay margins are at least shifted: rounding of ω and of roots beside the boundary
HIGHEST = 1e9  # factor up to which the absence of a limit is claimed in continuous time

TALLY: Counter[str] = Counter()


class Examined:
    """What the product says of one case, beside what is true."""

    def __init__(self, case: Case) -> None:
        self.case, self.found, self.base = case, [], 1.0
        self.truth = cache(case.truth)

    def unstable(self, factor: float, **more: float) -> int:
        """Unstable roots with the gains at `factor` of those drawn."""
        TALLY["counts"] += 1
        return self.truth(factor).count(**more)

    def note(self, wrong: bool, kind: str, what: str) -> None:
        if wrong:
            self.found.append(f"{kind}: {what}")

    def safe(self, count: int, what: str) -> None:
        """The product says that this is stable."""
        self.note(count > 0, "WRONG SAFE", what)

    def lost(self, count: int, what: str) -> None:
        """The product says that this is not stable."""
        self.note(count == 0, "too strict", what)

    def run(self) -> list[str]:
        loop = self.case.loop()
        limit = gr.gain_limit(loop)
        count = self.unstable(1.0)
        (self.safe if limit.stable else self.lost)(count, "verdict")
        if not limit.stable:
            told = gr.margins(loop).unstable_roots
            self.note(told != count, "miscounted", f"{told} unstable roots for {count}")
            if limit.gain == 0:
                for factor in (0.3, 1e-2, 1e-4):
                    self.lost(self.unstable(factor), f"at {factor:g} of the gains")
                return self.found
            self.ends(limit.gain, limit.lower_gain, "limit")
            self.base = float(np.sqrt(limit.gain * limit.lower_gain)) if limit.lower_gain else limit.gain / 2
            loop = loop.scaled(self.base)
        TALLY["with margins"] += 1
        found = gr.margins(loop)
        self.note(not found.certified, "uncertified", "scan")
        if not found.stable:
            self.lost(0, f"at {self.base:g} of the gains")
            return self.found
        self.ends(self.base * found.gain_margin, self.base * found.lower_gain_margin, "margin")
        if limit.stable:
            same = limit.gain == found.gain_margin or abs(limit.gain / found.gain_margin - 1) < 1e-9
            self.note(not same, "two numbers", f"gain limit {limit.gain!r}, gain margin {found.gain_margin!r}")
        self.phase(found)
        self.delay(found)
        return self.found

    def ends(self, upper: float, lower: float, name: str) -> None:
        """Both ends of the stable interval of the factor, and a point in between."""
        if isinf(upper):
            upper = self.base * HIGHEST
            for factor in (3.0, 1e2, 1e5, HIGHEST * (1 - SHIFT)):
                self.safe(self.unstable(self.base * factor), f"no upper gain {name}, at {factor:g}")
        else:
            self.safe(self.unstable(upper * (1 - SHIFT)), f"just below the gain {name} {upper!r}")
            self.lost(self.unstable(upper * (1 + SHIFT)), f"just above the gain {name} {upper!r}")
        if lower:
            self.safe(self.unstable(lower * (1 + SHIFT)), f"just above the lower gain {name} {lower!r}")
            self.lost(self.unstable(lower * (1 - SHIFT)), f"just below the lower gain {name} {lower!r}")
        else:
            lower = 1e-4 * min(upper, self.base)
            self.safe(self.unstable(lower), f"no lower gain {name}")
        self.safe(self.unstable(lower * (upper / lower) ** 0.83), f"inside the gain {name}s")

    def phase(self, found: gr.Margins) -> None:
        margin = found.phase_margin
        if isinf(margin):
            self.safe(self.unstable(self.base, phase=3.1) + self.unstable(self.base, phase=-3.1), "no phase margin")
            return
        shift = max(SHIFT * abs(margin), LEAST_ANGLE)
        for sign in (-1, 1):
            self.safe(self.unstable(self.base, phase=sign * (abs(margin) - shift)), f"below the phase margin {margin!r}")
        self.lost(self.unstable(self.base, phase=float(np.copysign(abs(margin) + shift, margin))), f"above the phase margin {margin!r}")

    def delay(self, found: gr.Margins) -> None:
        margin = found.delay_margin
        if isinf(margin):
            if self.case.sample_time is None:
                self.safe(self.unstable(self.base, delay=1e3 * self.case.joint.delay), "no delay margin")
            else:
                later = self.case.controlled().scaled(self.base)
                for ticks in (0.5, 1.0, 17.3):
                    count = Boundary.of(later.later(ticks * self.case.sample_time)).count()
                    self.safe(count, f"no delay margin, {ticks} ticks")
            return
        shift = max(SHIFT * margin, LEAST_ANGLE / found.delay_crossover)
        for sign, check in ((-1, self.safe), (1, self.lost)):
            extra = margin + sign * shift
            if self.case.sample_time is None:
                count = self.unstable(self.base, delay=extra)
            else:
                TALLY["counts"] += 1
                count = Boundary.of(self.case.controlled().scaled(self.base).later(extra)).count()
            check(count, f"{'below' if sign < 0 else 'above'} the delay margin {margin!r}")


def case_of(kind: str, index: int, seed: int = SEED) -> Case:
    return DRAWS[kind](np.random.default_rng([seed, index]), bool(index % 2))


def disagreements(case: Case) -> list[str]:
    """What the product says of this case that the independent count does not confirm."""
    TALLY["joints"] += 1
    examined = Examined(case)
    try:
        examined.run()
    except UndecidedError:
        TALLY["undecided by the count"] += 1
    except gr.GainroomError as error:
        examined.note(True, "refused", str(error))
    for kind in {one.split(":")[0] for one in examined.found}:
        TALLY[kind] += 1
    return examined.found


def assert_confirmed(kind: str, indices: range) -> None:
    wrong = {index: found for index in indices if (found := disagreements(case_of(kind, index)))}
    assert not wrong, f"population {kind} {SEED}: {wrong}"


@pytest.mark.slow
@pytest.mark.parametrize("kind", DRAWS)
@pytest.mark.parametrize("start", range(0, SHARE, BATCH))
def test_share_of_the_population(kind, start):
    assert_confirmed(kind, range(start, start + BATCH))


@pytest.mark.population
@pytest.mark.parametrize(("kind", "start"), [(kind, start) for kind, whole in WHOLE.items() for start in range(0, whole, BATCH)])
def test_whole_population(kind, start):
    assert_confirmed(kind, range(start, min(start + BATCH, WHOLE[kind])))


@pytest.mark.parametrize("index", [648, 1112, 462, 1538])
def test_hard_draws(index):
    """Sampled link feedback with many samples per period: the sampled zeros are ill-conditioned, the limits are not."""
    assert not disagreements(case_of("narrow", index, seed=20171117))


def test_the_draws_are_of_every_kind():
    """At least half have margins to confirm, and the count decides all but one in a hundred."""
    cases = [case_of("wide", index) for index in range(400)]
    for ask in (
        lambda case: case.kind == "PID",
        lambda case: case.kind == "PPI",
        lambda case: case.low_pass and case.low_pass[1] == 2,
        lambda case: case.notches and case.joint.feedback == "link",
        lambda case: case.sample_time and 0 < abs(case.joint.delay / case.sample_time - round(case.joint.delay / case.sample_time)) < 1e-6,
        lambda case: case.joint.motor_inertia > 1e6 or case.joint.motor_inertia < 1e-6,
        lambda case: min(case.gains) < 0,
        lambda case: case.joint.bandwidth == inf and case.joint.delay == 0,
    ):
        assert sum(bool(ask(case)) for case in cases) >= 4


@pytest.mark.population
def test_tell_the_counts(capsys):
    """Last: what was looked at in this process."""
    with capsys.disabled():
        print(f"\nseed {SEED}: " + ", ".join(f"{count} {kind}" for kind, count in sorted(TALLY.items())))
    assert TALLY["WRONG SAFE"] == 0
    assert TALLY["undecided by the count"] <= 0.01 * TALLY["joints"] + 1
    assert TALLY["with margins"] >= 0.5 * TALLY["joints"]
