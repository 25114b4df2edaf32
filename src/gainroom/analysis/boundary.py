"""Margins of coupled loops, from where samples in the core see their curves meet −1, each claim counted on samples of its own.

A loop is sampled once; what it shows is polished. Then unstable roots are counted a little inside and outside of every claim: of a phase
and of one loop's gains by turns about 0 on other samples, of a delay in the loop with that delay. What is not confirmed is not reported.
"""

import math
from dataclasses import replace

import numpy as np

from ..system.controller import gain_matrix
from ..system.loop import Loop
from .coupled_margins import LEAST_FACTOR, LONGEST_DELAY, coupled_margins as loci_margins, disk_of
from .first_crossing import SEARCH, Certificate, exact_delay
from .gain_limit import gain_limit
from .look import Reach, Seen
from .margin_record import Margins, OneLoop
from .sampled_loop import EVERY_PHASE, NEAR_BY, SampledLoop
from .stability_boundary import LOCI

MOST_ROUNDS = 5  # of more samples for what may cross unseen


def coupled_margins(loop: Loop, largest: bool = False) -> Margins:
    """All margins of several joints: from the core's samples, else from loci that are followed (coupled_margins.py). Raises as that does.

    largest   with each joint's largest kp and kd
    """
    found = sampled_margins(loop, largest)
    return loci_margins(loop, largest) if found is None else found


def coupled_delay_margin(loop: Loop) -> float:
    """The smallest extra delay [s] in all loops, n > 1, at which a stable set vibrates, inf where none is; NaN for an unstable one."""
    sampled = SampledLoop.of(loop)
    seen = None if sampled is None else sampled.look(EVERY_PHASE, smooth=False)
    if seen is not None and seen.followed and seen.unstable > 0:
        return math.nan
    if seen is not None and seen.followed:
        seen.tell_apart(NEAR_BY.factor, math.pi)
    found = None if seen is None or not seen.followed or seen.unstable < 0 else _first_delay(loop, seen)
    return loci_margins(loop, largest=False).delay_margin if found is None else found[0]


def sampled_margins(loop: Loop, largest: bool = False) -> Margins | None:
    """None where the core does not have such a loop, or something is not confirmed. `largest`: with each joint's largest kp and kd."""
    sampled = SampledLoop.of(loop)
    if sampled is None:
        return None
    seen = sampled.look(EVERY_PHASE)
    if not seen.followed or seen.unstable < 0:
        return None
    limit = gain_limit(loop)  # raises for a loop that is 0
    if limit.stable != (seen.unstable == 0):
        return None
    if not limit.stable:
        return replace(Margins.unknown(limit), unstable_roots=seen.unstable, certified=limit.certified)
    phase, crossover = _told_apart(seen)
    reach = min(math.pi, 1.2 * abs(phase) + NEAR_BY.phase)
    counting = sampled.look(Reach(NEAR_BY.factor, reach, EVERY_PHASE.peaks), between=True)
    if not seen.followed or not counting.followed or counting.unstable != 0:
        return None
    phase_certificate, delay = _phase_counted(counting, phase), _first_delay(loop, seen)
    one_loop = _one_loop(loop, seen, counting, largest)
    if one_loop is None or delay is None or (phase_certificate is not None and not phase_certificate.holds):
        return None
    peak, peak_at = seen.peak(1.0, 0.0)
    complementary, complementary_at = seen.peak(-1.0, 1.0)
    disk = disk_of(loop)
    return Margins(
        limit,
        one_loop,
        phase_margin=phase,
        gain_crossover=crossover,
        delay_margin=delay[0],
        delay_crossover=delay[1],
        peak_sensitivity=peak,
        peak_sensitivity_frequency=peak_at,
        peak_complementary=complementary,
        peak_complementary_frequency=complementary_at,
        certified=limit.certified,
        phase_certificate=phase_certificate,
        delay_certificate=delay[2],
        loops=(loop,),
        disk_margin=disk.margin if disk else math.nan,
        disk_margin_frequency=disk.frequency if disk else math.nan,
        disk_certified=disk.certified if disk else False,
    )


def _told_apart(seen: Seen) -> tuple[float, float]:
    """The common phase and its frequency, with samples where loci of equal limbs, or curves that nearly turn, may cross with less.

    With any phase: where ω is high, a large one is a short delay.
    """
    found = seen.common_phase()
    for _ in range(MOST_ROUNDS):
        up, down = seen.one_loop().T[:2]  # of each joint; inf where none is seen
        before = seen.samples
        seen.tell_apart(math.exp(min(float(np.minimum(up, down).max()), math.log(LOCI.highest))), math.pi)
        if not seen.followed or seen.samples == before:
            break
        found = seen.common_phase()
    return found


def _phase_counted(counting: Seen, phase: float) -> Certificate | None:
    """Roots that lags and leads up to a little less than `phase` make unstable, and those of a little more of its own sign."""
    if math.isinf(phase):
        return None
    inside = max(abs(counting.crossed(way * phase * (1 - SEARCH.nudge))) for way in (1, -1))
    return Certificate(inside, counting.crossed(phase * (1 + SEARCH.nudge)))


def _first_delay(loop: Loop, seen: Seen) -> tuple[float, float, Certificate | None] | None:
    """The least delay [s] more in all loops at which they are lost, its frequency and certificate; None where it is not confirmed."""

    def lag(delay: float, omega: float) -> tuple[float, float]:
        later = SampledLoop.of(loop.delayed(delay))
        return (math.nan, omega) if later is None else later.lag_about(omega)

    crossings = sorted(map(tuple, seen.delay_crossings(LONGEST_DELAY).tolist()))
    if not crossings:
        longest = SampledLoop.of(loop.delayed(LONGEST_DELAY))
        return (math.inf, math.nan, None) if longest is not None and longest.unstable() == 0 else None
    if loop.sample_time is not None:
        near = [one for one in crossings if one[0] <= crossings[0][0] * (1 + SEARCH.close)]
        crossings = sorted(found for one in near if (found := exact_delay(lag, *one)) is not None)
        if not crossings:
            return None
    delay, omega = crossings[0]
    sides = [SampledLoop.of(loop.delayed(delay * (1 + side * SEARCH.nudge))) for side in (-1, 1)]
    certificate = Certificate(*(-1 if one is None else one.unstable() for one in sides))
    return (delay, omega, certificate) if certificate.holds and certificate.outside > 0 else None


def _one_loop(loop: Loop, seen: Seen, counting: Seen, largest: bool) -> OneLoop | None:
    """Margins of one loop at a time, with `largest` kp and kd, factors and gains counted on both sides; None where one is not confirmed."""
    up, down, phase, peak = seen.one_loop().T
    highest, lowest = np.exp(up), np.exp(-down)
    lowest[lowest < LEAST_FACTOR] = 0.0
    known = all(
        _is_end(counting, joint, 0, high - 1, high, LOCI.highest - 1) and _is_end(counting, joint, 0, low - 1, low, LEAST_FACTOR - 1)
        for joint, (high, low) in enumerate(zip(highest.tolist(), lowest.tolist(), strict=True))
    )
    found = OneLoop(highest, lowest, phase, np.ones(len(up), dtype=bool), peak_sensitivity=peak) if known else None
    return _with_largest(loop, seen, counting, found) if largest and found is not None else found


def _is_end(counting: Seen, joint: int, gain: int, change: float, scale: float, farthest: float) -> bool:
    """A change of one joint's gains is where it is lost: no root is unstable a little before it, and one is a little behind.

    True also where there is none, `scale` 0 or inf, and none is unstable at `farthest`.

    gain    0: all gains of the joint, as a part of them; 1: kp; 2: kd
    scale   of which the certificate's nudge is a part
    """
    if not 0 < scale < math.inf:
        return counting.one_loop_count(joint, farthest, gain) == 0
    aside = math.copysign(SEARCH.nudge * scale, change)
    return counting.one_loop_count(joint, change - aside, gain) == 0 and counting.one_loop_count(joint, change + aside, gain) > 0


def _with_largest(loop: Loop, seen: Seen, counting: Seen, found: OneLoop) -> OneLoop | None:
    """Margins of one loop at a time with each joint's largest kp and kd, where there are such gains; None where one is not confirmed."""
    assert loop.parts is not None
    controller = loop.parts.controller
    units = controller.units()
    if not units:
        return found
    if any(np.count_nonzero(gain) > np.count_nonzero(np.diagonal(gain)) for gain in controller.matrices(loop.size).values()):
        return None
    largest = {}
    for gain, name in enumerate(units, start=1):
        now = np.diagonal(gain_matrix(name, getattr(controller, name), loop.size)) * loop.gain
        more = seen.growths(gain)[:, 0]
        for joint, (grown, own) in enumerate(zip(more.tolist(), now.tolist(), strict=True)):
            if not (grown > 0 and own > 0 and _is_end(counting, joint, gain, grown, own + grown, (LOCI.highest - 1) * own)):
                return None
        largest[f"largest_{name}"] = now + more
    return replace(found, **largest)
