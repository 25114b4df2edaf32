"""Margins and limits from samples in the core against those along loci in Python, which share no samples, searches or counts.

A share of the machines of machines.py runs every time, more with `pytest -m population -s`, which prints how many are not certified; other
draws: GAINROOM_SEED=7. Both sides count roots at 1 ± 1e-6 of what they claim.
"""

import math
import os
from collections import Counter
from dataclasses import dataclass

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.boundary import coupled_margins
from gainroom.analysis.gain_limit import sampled_limit
from independent.loci.coupled_margins import coupled_margins as loci_margins
from independent.loci.limit import limit_from_loci
from machines import chain, limbs

SEED = int(os.environ.get("GAINROOM_SEED", "2017"))
SHARE, ALL = 6, 200
NEAR = 1e-6  # relative: what both certificates tell apart
FOLLOWED = 1e3  # factors up to which both follow their curves
UNCONFIRMED = 0.02  # of the loops may not be certified: 1 of 500 was, and a count of roots decides each


def apart(found: float, truth: float) -> bool:
    """Whether two numbers differ; both may be unknown, or none."""
    return not (found == truth or (math.isnan(found) and math.isnan(truth)) or math.isclose(found, truth, rel_tol=NEAR))


def differences(found: gr.Margins, truth: gr.Margins) -> list[str]:
    """The names of what differs, with both values."""
    if found.stable != truth.stable:
        return [f"stable {found.stable}, not {truth.stable}"]
    names = ("phase_margin", "delay_margin", "peak_sensitivity", "peak_complementary", "disk_margin") if truth.stable else ()
    pairs = [(name, getattr(found, name), getattr(truth, name)) for name in names]
    pairs += [(name, getattr(found.limit, name), getattr(truth.limit, name)) for name in ("gain", "lower_gain")]
    for name in ("gain_margin", "lower_gain_margin", "phase_margin", "largest_kp", "largest_kd") if truth.stable else ():
        own, other = getattr(found.one_loop, name), getattr(truth.one_loop, name)
        if own is not None and other is not None:
            pairs += [(f"{name} of one loop", *both) for both in zip(own.tolist(), other.tolist(), strict=True)]
    return [f"{name} {one}, not {other}" for name, one, other in pairs if min(one, other) < FOLLOWED and apart(one, other)]


def compared(draw, number: int, factor: float, seen: Counter) -> list[str]:
    """What is wrong with the margins and the limit of one machine, its gains times `factor`."""
    loop = draw(SEED, number).scaled(factor).loop
    found, limit = coupled_margins(loop, largest=True), sampled_limit(loop)
    seen["margins" if found.certified else "margins not certified"] += 1
    wrong = differences(found, loci_margins(loop, largest=found.one_loop.largest_kp is not None)) if found.certified else []
    if limit is not None:
        seen["limits"] += 1
        truth = limit_from_loci(loop)
        wrong += ["stable"] if limit.stable != truth.stable else []
        wrong += [
            f"limit {one}, not {other}"
            for one, other in ((limit.gain, truth.gain), (limit.lower_gain, truth.lower_gain))
            if apart(one, other)
        ]
        assert limit.certified
    return wrong


@pytest.mark.slow
@pytest.mark.parametrize("draw", [limbs, chain])
@pytest.mark.parametrize("number", range(SHARE))
def test_share(draw, number):
    for factor in (1.0, 20.0):
        assert compared(draw, number, factor, Counter()) == []


@pytest.mark.population
@pytest.mark.parametrize("factor", [1.0, 4.0, 20.0])
@pytest.mark.parametrize("draw", [limbs, chain])
def test_population(draw, factor):
    seen, wrong = Counter(), list[str]()
    for number in range(ALL):
        wrong += [f"{draw.__name__} {number}: {text}" for text in compared(draw, number, factor, seen)]
    print(f"\n{draw.__name__} × {factor:g}: {dict(seen)}")
    assert wrong == []
    assert seen["margins not certified"] <= UNCONFIRMED * ALL


def test_a_loop_that_nothing_is_proved_for_is_known_from_samples():
    """Encoders on the links and drives that differ: a certified limit, with its mode, as the loci have it."""
    plant = gr.Plant(np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([0.2, 0.1]), np.array([4e3, 3e3]), np.array([4.0, 2.0]))
    drives = [gr.Drive(delay=2e-3), gr.Drive(delay=3e-3)]
    loop = gr.build_loop(plant, drives, gr.PD(np.array([40.0, 30.0]), np.array([2.0, 1.0])), "link")
    found, truth = sampled_limit(loop), limit_from_loci(loop)
    assert found is not None
    assert found.certified
    assert not apart(found.gain, truth.gain)
    assert abs(np.vdot(found.mode, truth.mode)) == pytest.approx(np.linalg.norm(found.mode) * np.linalg.norm(truth.mode), rel=1e-9)


@dataclass(frozen=True)
class Detuned(gr.PPI):
    """A cascade whose integral acts on half of what its other gains act on: no product (kv + ki/s)(kp + s), joint by joint."""

    def terms(self):
        return {powers: (0.5 if powers == (0, 1) else 1.0) * gain for powers, gain in super().terms().items()}


def test_gains_of_joints_that_are_no_pid_and_no_cascade_are_sampled_as_one_law():
    plant = gr.Plant(np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([0.2, 0.1]), np.array([4e3, 3e3]), np.array([4.0, 2.0]))
    loop = gr.build_loop(plant, gr.Drive(delay=2e-3), Detuned(np.array([8.0, 10.0]), np.array([4.0, 2.0]), np.array([6.0, 3.0])))
    found = coupled_margins(loop)
    assert found.stable
    assert found.certified
    assert differences(found, loci_margins(loop)) == []
