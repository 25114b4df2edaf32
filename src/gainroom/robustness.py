"""Margins of a scalar loop: what is left before it is lost. The verdict comes first; an unstable loop has none (NaN)."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .crossings import Scan
from .loop import Loop, build_loop
from .stability import scan_loop, unstable_roots


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
    if loop.sample_time is not None and loop.parts is not None and math.isfinite(found.delay_margin):
        return found._replace(delay_margin=_sampled_delay_margin(loop, found.delay_margin, found.delay_crossover))
    return found


def _sampled_delay_margin(loop: Loop, extra: float, omega: float) -> float:
    """The extra delay that puts a root at about `omega`, from the estimate phase margin / ω.

    A fraction of a tick of delay in front of a hold is nearly, not quite, a phase ωT; correcting by what is left over, plant sampled
    anew each time, gains about four digits a step.
    """
    parts = loop.parts
    assert parts is not None
    for _ in range(6):
        drives = [replace(drive, delay=drive.delay + extra) for drive in parts.drives]
        later = build_loop(parts.plant, drives, parts.controller, parts.feedback, parts.sample_time).scaled(loop.gain)
        crossings = [_gain_crossing(*row) for row in scan_loop(later, with_peaks=False).gains.tolist()]
        nearest = min(crossings, key=lambda crossing: abs(crossing.omega - omega))
        left = nearest.phase_margin / nearest.omega
        extra += left
        if abs(left) <= 1e-12 * extra:
            break
    return extra


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
