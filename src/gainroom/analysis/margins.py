"""Margins of a scalar loop: what is left before it is lost. The verdict comes first; an unstable loop has none (NaN)."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..system.loop import Loop, build_loop
from .crossings import Scan
from .stability import scan_loop, unstable_roots

DELAY_NUDGE = 1e-7  # relative; the delay margin of a sampled loop is confirmed on both sides of it,
LEAST_ANGLE = 1e-10  # or this far in phase [rad] where it is next to nothing


class PhaseCrossing(NamedTuple):
    """L is real and negative at `omega` [rad/s]; multiplying the gains by `gain` = −1/Re L puts a root there."""

    omega: float
    gain: float


class GainCrossing(NamedTuple):
    """|L| = 1 at `omega` [rad/s]; phase_margin [rad] in (−π, π]; delay_margin [s]: extra delay that puts a root there."""

    omega: float
    phase_margin: float
    delay_margin: float


class Margins(NamedTuple):
    """All margins of one scalar loop.

    stable, unstable_roots       the verdict
    gain_margin, phase_crossover factor > 1 on all gains that is lost, and at which frequency [rad/s]; inf and NaN where none (in continuous
                                 time: none below 1e9)
    lower_gain_margin, lower_phase_crossover   the same for factors < 1 (conditionally stable loops); 0 and NaN where none
    phase_margin, gain_crossover [rad] the smallest in size over all gain crossings, with its sign, and its frequency [rad/s]
    delay_margin, delay_crossover   the smallest extra delay over all gain crossings [s], and its frequency [rad/s]
    peak_sensitivity             Ms = max 1/|1+L|, at peak_sensitivity_frequency [rad/s]
    peak_complementary           Mt = max |L|/|1+L|, at peak_complementary_frequency [rad/s]
    disk_margin                  min 2|1+L|/|1−L|, balanced disk margin (Seiler, Packard and Gahinet 2020), at disk_margin_frequency
    phase_crossings, gain_crossings   all of them; in continuous time down to |L| = 0.001, or to where no nearer one can follow
    certified                    nothing between the evaluated frequencies was missed; False for loops given as callables
    """

    stable: bool
    unstable_roots: int
    gain_margin: float
    phase_crossover: float
    lower_gain_margin: float
    lower_phase_crossover: float
    phase_margin: float
    gain_crossover: float
    delay_margin: float
    delay_crossover: float
    peak_sensitivity: float
    peak_sensitivity_frequency: float
    peak_complementary: float
    peak_complementary_frequency: float
    disk_margin: float
    disk_margin_frequency: float
    phase_crossings: tuple[PhaseCrossing, ...]
    gain_crossings: tuple[GainCrossing, ...]
    certified: bool

    @property
    def gain_room(self) -> float:
        """The smallest factor, up or down, on all gains that is lost."""
        return min(self.gain_margin, 1 / self.lower_gain_margin if self.lower_gain_margin > 0 else math.inf)


def margins(loop: Loop) -> Margins:
    """All margins of a scalar loop, every crossing polished to machine precision.

    The delay margin of a sampled loop that was built from its parts is exact for any fraction of a tick; that of a sampled LTI system,
    and those listed with the crossings, count a fraction of a tick as the phase that it costs.
    Raises GainroomError for several joints (see gain_limit).
    """
    found = margins_of(loop, scan_loop(loop))
    return _with_sampled_delay(loop, found) if loop.sample_time is not None and loop.parts is not None and found.stable else found


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
        return found._replace(delay_margin=extra, delay_crossover=omega)
    return _halved(loop, found, min(extra, loop.sample_time if latest else estimates[-1][0] + loop.sample_time))


def _halved(loop: Loop, found: Margins, unstable: float) -> Margins:
    """The delay margin by bisection below a delay at which, or just beyond which, the loop is unstable."""
    stable = 0.0
    for _ in range(40):
        if not _stable_later(loop, unstable):
            break
        stable, unstable = unstable, 2 * unstable
    else:
        return found._replace(certified=False)
    while unstable - stable > DELAY_NUDGE * unstable:
        middle = 0.5 * (stable + unstable)
        stable, unstable = (middle, unstable) if _stable_later(loop, middle) else (stable, middle)
    crossings = _crossings_later(loop, stable)
    omega = min(crossings, key=lambda crossing: abs(crossing.phase_margin)).omega if crossings else math.nan
    return found._replace(delay_margin=stable, delay_crossover=omega)


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
    parts = loop.parts
    assert parts is not None
    assert parts.sample_time is not None
    ticks = math.floor(extra / parts.sample_time)
    rest = extra - ticks * parts.sample_time
    drives = [replace(drive, delay=drive.delay + rest) for drive in parts.drives]
    later = build_loop(parts.plant, drives, parts.controller, parts.feedback, parts.sample_time).scaled(loop.gain)
    return later, scan_loop(later, with_peaks=False), ticks


def margins_of(loop: Loop, scan: Scan) -> Margins:
    """The margins that a finished scan tells."""
    unstable = unstable_roots(loop, scan)
    gain_crossings = tuple(_gain_crossing(omega, phase) for omega, phase in scan.gains.tolist())
    phase_crossings = tuple(PhaseCrossing(omega, 1 / size if size > 0 else math.inf) for omega, size, _ in scan.phases.tolist())
    crossings = {"phase_crossings": phase_crossings, "gain_crossings": gain_crossings, "certified": scan.certified}
    if unstable:
        numbers = (name for name, kind in Margins.__annotations__.items() if kind is float)
        return Margins(stable=False, unstable_roots=unstable, **dict.fromkeys(numbers, math.nan), **crossings)
    nothing = math.nan
    upper = min(((c.gain, c.omega) for c in phase_crossings if c.gain > 1), default=(math.inf, nothing))
    lower = max(((c.gain, c.omega) for c in phase_crossings if c.gain <= 1), default=(0.0, nothing))
    phase = min(((abs(c.phase_margin), c.phase_margin, c.omega) for c in gain_crossings), default=(0.0, math.inf, nothing))
    delay = min(((c.delay_margin, c.omega) for c in gain_crossings), default=(math.inf, nothing))
    (ms_at, ms), (mt_at, mt), (disk_at, disk) = scan.peaks.tolist()
    return Margins(
        stable=True,
        unstable_roots=0,
        gain_margin=upper[0],
        phase_crossover=upper[1],
        lower_gain_margin=lower[0],
        lower_phase_crossover=lower[1],
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
        **crossings,
    )


def _gain_crossing(omega: float, phase: float) -> GainCrossing:
    turn = 2 * math.pi
    positive = (phase + math.pi) % turn  # phase margin in [0, 2π)
    signed = positive - turn if positive > math.pi else positive
    return GainCrossing(omega, signed, positive / omega if omega > 0 else math.inf)


def to_db(factor: float) -> float:
    """A gain factor in decibels."""
    return 20 * math.log10(factor) if factor > 0 else -math.inf


def from_db(decibels: float) -> float:
    """Decibels as a gain factor."""
    return float(np.power(10.0, decibels / 20))
