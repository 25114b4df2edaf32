"""Delay margins where the root that crosses is slow: it hardly moves with the delay, and a joint without damping is nearby.

Certified means: no root right of the boundary 2e-6 of the margin before it, one behind it. Roots by Newton's method on the determinant of
the equations of independent/machine.py, from its eigenvalues.
"""

from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from independent import machine as own
from machines import Pair, harsh, paired

SLOW = 1e-6  # |Re s|/|s| of roots that are polished; eigenvalues are good to far less
FASTEST = 4000.0  # [rad/s] that the delay lines of independent/machine.py resolve
ROUND_OFF = 1e-11  # likewise, of what is as good as on the boundary: 1e-16 times norms of 1e7, at 100 1/s


def growth(machine: own.Machine) -> float:
    """The largest Re s/|s| of the roots, of slow ones to 1e-11."""
    body = own.law(machine).after(own.actuated(machine))
    eye = np.eye(len(body.a))

    def determinant(s: complex) -> complex:
        late = body.c @ np.linalg.solve(s * eye - body.a, body.b) * np.exp(-s * machine.delay)
        return np.linalg.det(np.eye(machine.size) + late)

    found = own.roots(machine)
    found = found[found.imag > 0]
    slow = found[np.abs(found.real) < SLOW * np.abs(found)]
    ratios = [float(one.real / abs(one)) for one in found if abs(one.real) >= SLOW * abs(one)]
    for start in slow.tolist():
        before, s = start * (1 + 1e-7), start
        first = determinant(before)
        for _ in range(12):
            now = determinant(s)
            if now == first:
                break
            before, s, first = s, s - now * (s - before) / (now - first), now
        ratios.append(s.real / abs(s))
    return max(ratios, default=-1.0)


def drawn(seed: int, number: int) -> Pair | None:
    """Harsh loops in continuous time; of every other one, joints damped by a 1e-10th to all of what they had."""
    pair = harsh(seed, number)
    machine, rng = pair.machine, np.random.default_rng([seed, number])
    if machine.sample_time is not None:
        return None
    if number % 2 == 0:
        machine = replace(machine, damping=machine.damping * rng.choice([1.0, 1e-4, 1e-8, 1e-10], machine.size))
    assert pair.loop.parts is not None
    return paired(machine, pair.loop.parts.controller, pair.kind)


def wrong_margin(seed: int, number: int) -> str:
    """Empty where the delay margin is what roots say, or is not certified, or there is none."""
    pair = drawn(seed, number)
    if pair is None:
        return ""
    try:
        found = gr.margins(pair.loop)
    except gr.GainroomError:  # other tests say which may be refused
        return ""
    if not (found.stable and found.certified and found.delay_crossover < FASTEST):  # NaN where there is no margin
        return ""
    inside, outside = (growth(pair.machine.delayed(found.delay_margin * (1 + part))) for part in (-2e-6, 1e-4))
    return "" if inside < ROUND_OFF and outside > -ROUND_OFF else f"{seed} {number} {pair.kind}: {inside:.2g}, {outside:.2g}"


@pytest.mark.parametrize("number", [15, 115])
def test_two_slow_roots(number):
    """Roots at 346 and 961 rad/s whose damping ratio changes by 2e-9 and 2e-8 within 1e-5 of the margin."""
    pair = drawn(4242, number)
    assert pair is not None
    assert gr.margins(pair.loop).certified
    assert not wrong_margin(4242, number)


@pytest.mark.population
@pytest.mark.parametrize("start", range(0, 400, 20))
def test_slow_roots_of_many_loops(start):
    assert not [wrong for number in range(start, start + 20) if (wrong := wrong_margin(4243, number))]
