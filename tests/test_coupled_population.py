"""Random coupled loops: every verdict, limit and margin against independently counted roots, just inside and just outside.

Machines with near-equal limbs, also from gains just above their limit, and joints of every sort (machines.py). A share runs every time, all
of them with `pytest -m population -s`; other draws: GAINROOM_SEED=7. Counts are printed.
"""

import math
import os
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

import gainroom as gr
from gainroom.analysis.disk_margin import disk_margin
from gainroom.analysis.margin_record import OneLoop
from independent.machine import SLOW, Machine, topples, turns, unstable
from machines import Pair, chain, limbs

SEED = int(os.environ.get("GAINROOM_SEED", "2017"))
LIMBS, CHAINS, BATCHES = 1000, 2000, 20
SHARE = 8  # of each, in every run
INSIDE = 1e-5  # relative distance from a limit at which roots are counted: ten times the certificate's own
NEAR = 1e-3  # likewise, of what is left of one gain: loops that it hardly moves are unstable so slowly that nearer counts do not tell
TOPPLING = 0.03  # likewise from limits at rest, where the root that passes is slower than counts tell from 0 any nearer
LONGEST = 10.0  # [s] of processor time for all margins of a loop: longer ones are counted and printed
REFUSED = 0.01  # of the loops may be refused in one line


class Found(Counter):
    """What was looked at, and what was wrong with it."""

    def __init__(self) -> None:
        super().__init__()
        self.wrong: list[str] = []

    def ends(self, what: str, inside: int, outside: int) -> None:
        self[what] += 1
        if inside != 0 or outside == 0:
            self.wrong.append(f"{what}: {inside} unstable roots inside, {outside} outside")


def look_at(pair: Pair, found: Found, name: str) -> None:
    start, before = time.process_time(), len(found.wrong)
    try:
        limit, margins = gr.gain_limit(pair.loop), gr.joint_margins(pair.loop)
    except gr.GainroomError:
        found["refused"] += 1
        return
    found["over 10 s"] += time.process_time() - start > LONGEST
    count = unstable(pair.machine)
    found["stable" if limit.stable else "unstable"] += 1
    if not (limit.stable == gr.is_stable(pair.loop) == margins.stable == (count == 0)):
        found.wrong.append(f"verdict: {limit.stable}, {count} unstable roots")
    found["not certified"] += not margins.certified
    if limit.certified:
        look_at_limit(pair, limit, found)
    if margins.stable and count == 0:
        look_at_margins(pair, margins, found)
    found.wrong[before:] = [f"{name} ({pair.kind}): {text}" for text in found.wrong[before:]]


def end_of(found: Found, what: str, scaled: Callable[[float], Machine], end: float, way: int) -> None:
    """Roots on both sides of the factor `end`, above it where `way` is 1, below where it is -1."""
    inside, outside = (unstable(scaled(end * (1 + side * way * INSIDE))) for side in (-1, 1))
    if inside or not outside:  # a root that passes 0, or nearly so, is too slow there to be seen
        before, beyond = (scaled(end * (1 + side * way * TOPPLING)) for side in (-1, 1))
        slowly = [unstable(machine, machine.slowest / 10) for machine in (before, beyond)]
        topple = [end_where_roots_pass(scaled, end, way, slow) for slow in (SLOW, SLOW / 3)]
        if unstable(before) == 0 and abs((3 * topple[1] - topple[0]) / (2 * end) - 1) < TOPPLING / 3:
            found[f"{what} at rest"] += 1
            inside, outside = 0, 1
        elif not slowly[0] and slowly[1]:
            found[f"{what} slowly"] += 1
            inside, outside = 0, slowly[1]
    found.ends(what, inside, outside)


def end_where_roots_pass(scaled: Callable[[float], Machine], end: float, way: int, slow: float) -> float:
    """The factor at which a real root passes `slow`, within a third about `end`; NaN where none does.

    The root moves evenly with the factor: from where it passes two of these, where it passes 0 is told.
    """
    low, high = end * (1 - way / 3), end * (1 + way / 3)
    if topples(scaled(low), slow) or not topples(scaled(high), slow):
        return math.nan
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if topples(scaled(middle), slow) else (middle, high)
    return high


def look_at_limit(pair: Pair, limit: gr.GainLimit, found: Found) -> None:
    if 0 < limit.gain < math.inf:
        end_of(found, "upper limit", pair.machine.scaled, limit.gain, 1)
    elif limit.gain == 0:
        found["no lower gains"] += 1
        helping = [factor for factor in (0.999, 0.9, 0.5, 0.1, 0.01) if unstable(pair.machine.scaled(factor)) == 0]
        if helping:
            found.wrong.append(f"no lower gains help: {helping} do")
    if limit.lower_gain > 0:
        end_of(found, "lower limit", pair.machine.scaled, limit.lower_gain, -1)
    elif limit.lower_gain == 0 and limit.stable:
        found["no lower limit"] += 1
        found.wrong += [f"no lower limit: unstable at {factor}" for factor in (0.7, 0.3, 0.05) if unstable(pair.machine.scaled(factor)) > 0]


def look_at_margins(pair: Pair, margins: gr.Margins, found: Found) -> None:
    machine = pair.machine
    longest = 60 * machine.sample_time if machine.sample_time else 0.03  # else the independent count takes minutes
    delay = margins.delay_margin
    if margins.delay_certificate is not None and margins.delay_certificate.holds and delay < longest:
        found.ends("delay margin", *(unstable(machine.delayed(delay * (1 + way * INSIDE))) for way in (-1, 1)))
    elif delay == math.inf:
        found["no delay margin"] += 1
        found.wrong += [
            f"no delay margin: unstable {late:g} s later" for late in (0.1 * longest, longest) if unstable(machine.delayed(late))
        ]
    phase = margins.phase_margin
    if machine.sample_time is None and machine.size < 8 and margins.phase_certificate is not None and margins.phase_certificate.holds:
        counts = [(0, 0), (0, 0)]
        for lowest in (1e-3, 1e-7):  # a locus that the gains hardly reach may be at 1 as slowly as that
            if not any(counts[1]):
                counts = [
                    [turns(machine, way * phase * (1 + side * 1e-4), margins.gain_crossover, lowest) for way in (-1, 1)] for side in (-1, 1)
                ]
        found.ends("phase margin", *(sum(abs(one) for one in both) for both in counts))
    if margins.one_loop.largest_kp is not None:
        look_at_largest_gains(pair, margins.one_loop, found)
    for joint in range(0, machine.size, max(1, machine.size // 4)):
        found["not certified, one loop at a time"] += not margins.one_loop.certified[joint]
        for end, way in ((margins.one_loop.gain_margin[joint], 1), (margins.one_loop.lower_gain_margin[joint], -1)):
            if 1e-3 < end < 1e3 and margins.one_loop.certified[joint]:
                what = "one loop at a time, " + ("upper" if way > 0 else "lower")
                end_of(found, what, lambda factor, joint=joint: machine.with_joint_scaled(joint, factor), end, way)


def look_at_largest_gains(pair: Pair, one_loop: OneLoop, found: Found) -> None:
    """Largest kp and kd of single joints, from what these have now: no unstable root a thousandth of the way inside, some outside."""
    for powers, largest in (((0, 0), one_loop.largest_kp), ((1, 0), one_loop.largest_kd)):
        for joint in range(0, pair.machine.size, max(1, pair.machine.size // 4)):
            if largest is None or powers not in pair.machine.gains or not one_loop.certified[joint]:
                continue

            def unstable_with(more: float, joint: int = joint, powers: tuple[int, int] = powers) -> int:
                return unstable(pair.machine.with_joint_raised(powers, joint, more))

            now = pair.machine.gains[powers][joint, joint]
            room, what = largest[joint] - now, f"largest {('kp', 'kd')[powers[0]]}"
            if room == math.inf:
                found[f"no {what}"] += 1
                farther = [share * max(now, pair.machine.motor_inertia[joint]) for share in (1.0, 30.0, 1e3, 3e4)]
                found.wrong += [f"no {what}: unstable {more:g} above {now:g}" for more in farther if unstable_with(more)]
            elif room > 1e-3 * now:  # else what is lost is too slow to be seen
                found[what] += 1
                if inside := unstable_with(room * (1 - NEAR)):
                    found.wrong.append(f"{what} {largest[joint]:g} of joint {joint}, {now:g} now: {inside} unstable roots inside")


def look_just_above(pair: Pair, found: Found, name: str) -> None:
    """From gains slightly too high the limit is the one just below."""
    limit = gr.gain_limit(pair.loop)
    for above in (1e-4, 2e-3, 2e-2):
        found["from just above"] += 1
        back = gr.gain_limit(pair.loop.scaled(limit.gain * (1 + above)))
        inside, outside = (unstable(pair.machine.scaled(limit.gain * (1 + above) * back.gain * (1 + way * INSIDE))) for way in (-1, 1))
        if back.stable or inside or not outside or back.certificate is None or not back.certificate.holds:
            found.wrong.append(f"{name} ({pair.kind}): {above} above the limit: {back.gain}, {inside} roots inside, {outside} outside")


def confirm(draw: Callable[[int, int], Pair], numbers: range) -> None:
    found = Found()
    for number in numbers:
        pair = draw(SEED, number)
        look_at(pair, found, f"{draw.__name__} {number}")
        if draw is limbs:
            look_just_above(pair, found, f"{draw.__name__} {number}")
    print(f"\n{draw.__name__} {numbers}: {dict(found)}, {len(found.wrong)} wrong")
    assert not found.wrong, "\n".join(found.wrong)
    assert found["refused"] <= max(1, 2 * REFUSED * len(numbers))  # of so few, twice the share is no evidence of more


@pytest.mark.slow
@pytest.mark.parametrize("draw", [limbs, chain])
def test_share(draw):
    confirm(draw, range(SHARE))


def last_digits(loop):
    """The loop with gains that differ in their last digit: round-off differs from machine to machine, the answer does not."""
    return [loop.scaled(1 + last_digit * 2.3e-16) for last_digit in range(6)]


def least_peak(sensitivity, enough=0.0):
    """min over D of σ_max(D (S − T) D⁻¹), by a search that shares nothing with the package's; Perron's D, where that is below `enough`."""

    def size(x):
        d = np.exp(np.append(0.0, x))
        return np.linalg.svd(d[:, None] * sensitivity / d, compute_uv=False)[0]

    right, left = (np.abs(perron_vector(np.abs(matrix))) for matrix in (sensitivity, sensitivity.T))
    start = np.log(np.clip(left, 1e-12, None) / np.clip(right, 1e-12, None)) / 2
    start = start[1:] - start[0]
    if size(start) < enough:
        return size(start)
    return minimize(size, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6}).fun


def perron_vector(matrix):
    values, vectors = np.linalg.eig(matrix)
    return vectors[:, values.real.argmax()]


def perron(sensitivities):
    """The spectral radius of |S − T|: no least peak is above it (Perron)."""
    return np.abs(np.linalg.eigvals(np.abs(sensitivities))).max(axis=1)


def least_peaks(sensitivities, count):
    """The highest `count` least peaks, and their indices: what is bounded below them is not looked at."""
    found, most = [(0.0, -1)] * count, perron(sensitivities)
    for k in np.argsort(most)[::-1].tolist():
        if most[k] < found[0][0]:
            break
        found = sorted([*found, (least_peak(sensitivities[k], found[0][0]), k)])[-count:]
    return tuple(map(list, zip(*found, strict=True)))


@pytest.mark.slow
@pytest.mark.parametrize("number", [807, 1642, 1809])
def test_joints_that_no_gain_holds_take_no_disk_margin(number):
    """They drift at 0, where rounding makes L infinite in directions in which it is not. With gains K = K V Vᵀ no such motion is left:

    T = K V (I + Vᵀ P K V)⁻¹ Vᵀ P.
    """
    pair = chain(2017, number)
    seen = pair.loop.seen
    assert seen.shape[1] < pair.loop.size
    controller = pair.loop.parts.controller if pair.loop.parts else None
    assert controller is not None

    def sensitivities(omega):
        plant, v = pair.loop.actuated_at(1j * omega), pair.loop.variable(1j * omega)
        gains = controller.matrix(1j * omega, v, pair.loop.size, pair.loop.sample_time) @ seen
        inside = np.linalg.inv(np.eye(seen.shape[1]) + seen.T @ plant @ gains)
        return np.eye(pair.loop.size) - 2 * gains @ inside @ (seen.T @ plant)

    coarse = np.geomspace(1e-6, 1e4, 20_000)
    most = perron(sensitivities(coarse))
    tops = 1 + np.flatnonzero((most[1:-1] >= most[:-2]) & (most[1:-1] >= most[2:]))
    tried = np.union1d(coarse[tops], coarse[::50])
    highest = tried[least_peaks(sensitivities(tried), 3)[1]]
    near = highest[:, None] * np.geomspace(0.97, 1.03, 150)
    margin = min(2 / least_peaks(sensitivities(near.ravel()), 1)[0][0], 2)
    for loop in last_digits(pair.loop):
        found = disk_margin(loop)
        assert found.certified
        assert found.margin == pytest.approx(margin, rel=2e-3)  # certified to 1e-3, and as much for this search
        assert gr.joint_margins(loop).stable == (unstable(pair.machine) == 0)


@pytest.mark.slow
@pytest.mark.parametrize("number", [114, 147, 148, 368])
def test_loops_whose_integrators_drown_the_rest(number):
    """I + L is singular to the last digit at rest: no disk margin is known there, all else is."""
    pair = chain(2017, number)
    for loop in last_digits(pair.loop):
        found = gr.joint_margins(loop)
        assert math.isnan(found.disk_margin)
        assert found.disk_certified is False
        assert found.stable == (unstable(pair.machine) == 0)
        assert math.isfinite(found.peak_sensitivity)
        assert math.isfinite(found.one_loop_phase_margin)


def test_a_curve_that_round_off_makes_zero():
    """A PID's T_ii falls with ω towards rest, and is 0 to the last digit at some of the frequencies that are looked at."""
    confirm(chain, range(1317, 1318))


@pytest.mark.population
@pytest.mark.parametrize("batch", range(BATCHES))
@pytest.mark.parametrize(("draw", "count"), [(limbs, LIMBS), (chain, CHAINS)])
def test_population(draw, count, batch):
    confirm(draw, range(batch, count, BATCHES))
