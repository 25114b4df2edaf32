"""Margins of a loop of n >= 1 joints, and those of one joint from its scan. The verdict comes first; an unstable loop has none (NaN)."""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import GainroomError
from ..system.loop import Loop
from ..system.requirements import Requirements
from .coupled_margins import coupled_margins, one_loop_margins
from .crossings import Scan
from .gain_limit import gain_limit
from .loci import Sweep
from .margin_record import GainCrossing, GainLimit, Margins, OneLoop, PhaseCrossing
from .quick_margins import Sampled, quick_look
from .stability import scan_loop, unstable_roots

DELAY_NUDGE = 1e-7  # relative; the delay margin of a sampled loop is confirmed on both sides of it,
LEAST_ANGLE = 1e-10  # or this far in phase [rad] where it is next to nothing


def margins(loop: Loop) -> Margins:
    """All margins of a loop of n >= 1 joints: for one joint from the certified scan, else from the characteristic loci.

    The delay margin of a sampled loop that was built from its parts is exact for any fraction of a tick; that of a sampled LTI system,
    and those listed with the crossings, count a fraction of a tick as the phase that it costs.
    Raises GainroomError for several joints whose gains are all zero, or whose loci cannot be followed.
    """
    if loop.size > 1:
        return coupled_margins(loop)
    found = margins_of(loop, scan_loop(loop))
    if not found.stable:
        with suppress(GainroomError):
            return replace(found, limit=gain_limit(loop))
    return _with_sampled_delay(loop, found) if loop.sample_time is not None and loop.parts is not None and found.stable else found


def joint_margins(loop: Loop) -> Margins:
    """`margins` of a loop built with build_loop, its phase margin without sign; for one joint with largest kp, kd and a counted limit.

    Raises GainroomError for other loops, and for gains that are all zero.
    """
    if loop.parts is None:
        raise GainroomError("joint_margins needs a loop built with build_loop; use margins for a scalar return ratio")
    if loop.size == 1:
        limit, found = gain_limit(loop), margins(loop)
        gains = one_loop_margins(Sweep(loop)) if found.stable else OneLoop.unknown(1)
        one_loop = replace(found.one_loop, certified=gains.certified, largest_kp=gains.largest_kp, largest_kd=gains.largest_kd)
        found = replace(found, limit=limit, one_loop=one_loop)
    else:
        found = margins(loop)
    return replace(found, phase_margin=abs(found.phase_margin))


def required_margins(loop: Loop, required: Requirements) -> tuple[Margins, Sampled | None]:
    """What requirements bound, from a quick look, and the samples behind it; all margins where samples do not tell what is required."""
    found, sampled = quick_look(loop, required)
    if sampled is not None and any(math.isnan(one.value(found)) for one, _ in required.asked_for):
        with suppress(GainroomError):
            return margins(loop), sampled
    return found, sampled


def _with_sampled_delay(loop: Loop, found: Margins) -> Margins:
    """`found` with the extra delay that puts a root of a sampled loop on the boundary, confirmed on both sides of it.

    A fraction of a tick of delay in front of a hold is nearly, not quite, a phase ωT. So the first of the gain crossings, and those that
    come about as soon, are followed with the plant sampled anew for each delay; where the count of roots does not confirm the
    first of them, the delay is halved between stable and unstable.
    """
    assert loop.sample_time is not None
    estimates = sorted((crossing.delay_margin, crossing.omega) for crossing in found.gain_crossings)
    near = [(extra, omega) for extra, omega in estimates if extra <= 1.02 * estimates[0][0] + 0.1 * loop.sample_time]
    followed = [one for extra, omega in near[:4] if (one := _followed(loop, extra, omega)) is not None]
    extra, omega = min(followed, default=(math.inf, math.nan))
    latest = abs(loop.response(math.pi / loop.sample_time)[0]) > 1  # within a tick L(−1) then comes to −1 from 1 or more
    if math.isinf(extra) and not estimates and not latest:
        return found
    nudge = DELAY_NUDGE * extra + LEAST_ANGLE / omega if math.isfinite(extra) else 0.0
    if math.isfinite(extra) and _stable_later(loop, extra - nudge) and not _stable_later(loop, extra + nudge):
        return replace(found, delay_margin=extra, delay_crossover=omega)
    return _halved(loop, found, min(extra, loop.sample_time if latest else estimates[-1][0] + loop.sample_time))


def _halved(loop: Loop, found: Margins, unstable: float) -> Margins:
    """The delay margin by bisection below a delay at which, or just beyond which, the loop is unstable."""
    stable = 0.0
    for _ in range(40):
        if not _stable_later(loop, unstable):
            break
        stable, unstable = unstable, 2 * unstable
    else:
        return replace(found, certified=False)
    while unstable - stable > DELAY_NUDGE * unstable:
        middle = 0.5 * (stable + unstable)
        stable, unstable = (middle, unstable) if _stable_later(loop, middle) else (stable, middle)
    crossings = _crossings_later(loop, stable)
    omega = min(crossings, key=lambda crossing: abs(crossing.phase_margin)).omega if crossings else math.nan
    return replace(found, delay_margin=stable, delay_crossover=omega)


def _followed(loop: Loop, extra: float, omega: float) -> tuple[float, float] | None:
    """The extra delay, near `extra`, that puts a root at about `omega`, and its frequency; gains about four digits a step."""
    for _ in range(8):
        crossings = _crossings_later(loop, extra)
        if not crossings:
            return None
        nearest = min(crossings, key=lambda crossing: (abs(math.log(crossing.omega / omega)) > 0.1, abs(crossing.phase_margin)))
        left, omega = nearest.phase_margin / nearest.omega, nearest.omega
        if extra + left < 0:
            return None
        extra += left
        if abs(left) <= 1e-12 * extra:
            return extra, omega
    return None


def _crossings_later(loop: Loop, extra: float) -> list[GainCrossing]:
    """The gain crossings with `extra` more delay [s]."""
    scan, ticks = _later(loop, extra)[1:]
    return [_gain_crossing(omega, phase - omega * ticks * (loop.sample_time or 0.0)) for omega, phase in scan.gains.tolist()]


def _stable_later(loop: Loop, extra: float) -> bool:
    """Whether the loop is stable with `extra` more delay [s].

    Whole ticks only turn L: by ωT_s each, so that a pair of roots comes out where |L| falls through 1 and arg L passes an odd multiple of
    π, and goes in where |L| rises; where |L| > 1 at z = −1, each tick brings one root more. Thousands of ticks cost no more than one.
    """
    later, scan, ticks = _later(loop, extra)
    assert loop.sample_time is not None
    unstable = unstable_roots(later, scan)
    outside = bool(abs(later.response(math.pi / loop.sample_time)[0]) > 1)
    unstable += ticks * outside
    for omega, phase in scan.gains[::-1].tolist():
        turns = [math.floor((angle - math.pi) / (2 * math.pi)) for angle in (phase, phase - omega * ticks * loop.sample_time)]
        unstable += 2 * (turns[0] - turns[1]) * (-1 if outside else 1)
        outside = not outside
    return unstable == 0


def _later(loop: Loop, extra: float) -> tuple[Loop, Scan, int]:
    """The loop with the part of `extra` that is less than a tick as more delay, its scan, and the whole ticks that are left out."""
    assert loop.sample_time is not None
    ticks = math.floor(extra / loop.sample_time)
    later = loop.delayed(extra - ticks * loop.sample_time)
    return later, scan_loop(later, with_peaks=False), ticks


def margins_of(loop: Loop, scan: Scan) -> Margins:
    """The margins of one joint from a finished scan; without the gain limit of an unstable loop."""
    unstable = unstable_roots(loop, scan)
    gain_crossings = tuple(_gain_crossing(omega, phase) for omega, phase in scan.gains.tolist())
    phase_crossings = tuple(PhaseCrossing(omega, 1 / size if size > 0 else math.inf) for omega, size, _ in scan.phases.tolist())
    if unstable:
        found = Margins.unknown(GainLimit.unknown(1, stable=False))
        certified = {"unstable_roots": unstable, "certified": scan.certified}
        return replace(found, **certified, phase_crossings=phase_crossings, gain_crossings=gain_crossings)
    nothing = math.nan
    upper = min(((c.gain, c.omega) for c in phase_crossings if c.gain > 1), default=(math.inf, nothing))
    lower = max(((c.gain, c.omega) for c in phase_crossings if c.gain <= 1), default=(0.0, nothing))
    phase = min(((abs(c.phase_margin), c.phase_margin, c.omega) for c in gain_crossings), default=(0.0, math.inf, nothing))
    delay = min(((c.delay_margin, c.omega) for c in gain_crossings), default=(math.inf, nothing))
    (ms_at, ms), (mt_at, mt), (disk_at, disk) = scan.peaks.tolist()
    return Margins(
        GainLimit(True, upper[0], lower[0], upper[1], np.ones(1, dtype=complex), None, lower_frequency=lower[1]),
        OneLoop(*(np.array([value]) for value in (upper[0], lower[0], abs(phase[1]), scan.certified))),
        phase_margin=phase[1],
        gain_crossover=phase[2],
        delay_margin=delay[0],
        delay_crossover=delay[1],
        peak_sensitivity=1 / ms,
        peak_sensitivity_frequency=ms_at,
        peak_complementary=1 / mt,
        peak_complementary_frequency=mt_at,
        disk_margin=min(disk, 2.0),
        disk_margin_frequency=disk_at,
        disk_certified=scan.certified,
        certified=scan.certified,
        phase_crossings=phase_crossings,
        gain_crossings=gain_crossings,
    )


def _gain_crossing(omega: float, phase: float) -> GainCrossing:
    turn = 2 * math.pi
    positive = (phase + math.pi) % turn  # phase margin in [0, 2π)
    signed = positive - turn if positive > math.pi else positive
    return GainCrossing(omega, signed, positive / omega if omega > 0 else math.inf)
