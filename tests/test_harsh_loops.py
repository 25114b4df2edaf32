"""What must never be said: "stable" of a loop that grows. Machines with the worst of everything, roots counted independently.

A share runs every time, all of them with `pytest -m population -s`; other draws: GAINROOM_SEED=7.
"""

import math
import os

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.loop_samples import WHOLE, Reach, take_samples
from gainroom.analysis.stability import unstable_roots
from independent.machine import Machine, roots
from machines import Pair, harsh
from test_loop_samples import directed, scaled

SEED = int(os.environ.get("GAINROOM_SEED", "2017"))
SHARE, ALL, BATCHES = 24, 3000, 12
LIMITS = 3  # one in so many has its limit looked at, too, which takes longest
INSIDE = 1e-5  # relative distance from a limit at which roots are counted: ten times the certificate's own


def grows(machine: Machine) -> bool:
    """Whether a root grows by more than the boundary is tilted for poles that lie on it, and round-off moves roots at 0.

    Of continuous loops roots that the delay turns by more than once are known to 3e-5 of themselves: one of 3,000 machines has such at
    22,868 rad/s and 0.6 ms, where det(I + L) is 0 on the axis, not 0.3 1/s beside it.
    """
    found = roots(machine)
    turned = machine.sample_time is None and np.abs(found) * machine.delay.max() > 2 * np.pi
    return bool(np.any(found.real > 1e-6 + np.where(turned, 3e-5, 1e-8) * np.abs(found)))


def wrong_of(pair: Pair, limits: bool) -> list[str]:
    wrong, along = [], directed(pair)
    if along is not None:
        loop = along.loop(pair)
        for factor in (1.0, 0.2, 3.0, 0.97, 1.1):
            gains = scaled(along.gains, along.cascade, factor)
            for reach in (Reach(3.0, 0.7), WHOLE):
                seen = take_samples(loop, gains, reach)
                if seen.followed and seen.unstable == 0 and grows(pair.machine.scaled(factor)):
                    wrong.append(f"{pair.kind}: times {factor} is seen to be stable as far as {reach}")
    if limits:
        try:
            limit = gr.gain_limit(pair.loop)
        except gr.GainroomError:  # said plainly
            return wrong
        if limit.stable and grows(pair.machine):
            wrong.append(f"{pair.kind}: called stable")
        if limit.stable and 0 < limit.gain < np.inf and grows(pair.machine.scaled(limit.gain * (1 - INSIDE))):
            wrong.append(f"{pair.kind}: grows inside the limit {limit.gain}")
    return wrong


@pytest.mark.parametrize("number", range(SHARE))
def test_share(number):
    assert wrong_of(harsh(SEED, number), number % LIMITS == 0) == []


def test_a_delay_that_turns_whole_between_samples():
    """No drive slows these gains down: loci stay beyond −1 up to 8e5 rad/s, where a delay of 0.9 ms turns them by 6 rad a sample."""
    assert wrong_of(harsh(SEED, 1666), False) == []


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("kd", [2e2, 5e3, 2e5])
def test_every_turn_of_a_delay_is_counted(size, kd):
    """Joints that do not feel each other: as many roots as each alone has, by its certified scan."""
    drive = gr.Drive(math.inf, 1.0, 0.02)
    alone = gr.build_loop(gr.ElasticJoint(0.1, 0.9), drive, gr.PD(kd, kd))
    several = gr.build_loop(gr.Plant(np.eye(size) / 0.9, 0.1, math.inf), drive, gr.PD(np.full(size, kd), np.full(size, kd)))
    assert unstable_roots(several) == size * unstable_roots(alone) > 0


@pytest.mark.population
@pytest.mark.parametrize("batch", range(BATCHES))
def test_population(batch):
    wrong = [text for number in range(batch, ALL, BATCHES) for text in wrong_of(harsh(SEED, number), number // BATCHES % LIMITS == 0)]
    print(f"\n{len(wrong)} wrong of {ALL // BATCHES} machines: {wrong}")
    assert not wrong
