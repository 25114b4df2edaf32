"""Margins of a loop of n >= 1 joints, and those of one joint from its scan. The verdict comes first; an unstable loop has none (NaN).

Formulas of the margins are in docs/nomenclature.md; the record is margin_record.py. The delay margin is φ/ω at the crossing |L| = 1 where
that is least (`_gain_crossing`); of sampled loops it is corrected for fractions of a tick (scalar_delay_margin.hpp), of several joints
it is in boundary.py (`coupled_delay_margin`).
"""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import GainroomError, computable
from ..native import _core
from ..system.loop import Loop, require_loop
from .boundary import coupled_margins, one_loop_gains
from .crossings import Scan
from .gain_limit import gain_limit
from .margin_record import GainCrossing, GainLimit, Margins, OneLoop, PhaseCrossing
from .multirate import Multirate
from .stability import scan_loop, unstable_roots

FOLLOWED, DELAY_STEPS = 4, 40  # gain crossings whose delay is followed, and steps for each, each of which gains about four digits
SAME_DELAY = 1e-12  # relative step that ends them
DELAY_NUDGE, LEAST_ANGLE = 1e-7, 1e-10  # as in scalar_delay_margin.hpp
NOTHING, _, HALVED, ENDLESS, FAILED = range(5)  # the values of enum Found in scalar_delay_margin.hpp


def margins(loop: Loop) -> Margins:
    """All margins of a loop of n >= 1 joints: for one joint from the certified scan, else by boundary.py.

    The delay margin of a sampled loop that was built from its parts is exact for any fraction of a tick; that of a sampled LTI system,
    and those listed with the crossings, count a fraction of a tick as the phase that it costs. Each joint's largest gains are not among
    them (joint_margins). Where kd closes on a path of its own, they are those of the lifted loop (multirate.py).
    Raises GainroomError for several joints whose gains are all zero, or whose loci cannot be followed.
    """
    require_loop("margins", loop)
    if loop.kd_path is not None:
        return Multirate(loop).margins()
    if loop.size > 1:
        with computable("margins"):
            return coupled_margins(loop)
    found = margins_from_scan(loop, scan_loop(loop))
    if not found.stable:
        with suppress(GainroomError):
            return replace(found, limit=gain_limit(loop))
    if loop.sample_time is None or not found.stable:
        return found
    if loop.sensed is not None:
        return _with_followed_delay(loop, found)
    return _with_sampled_delay(loop, found) if loop.unsampled is not None else found


def joint_margins(loop: Loop) -> Margins:
    """`margins` of a loop built with build_loop, its phase margin without sign; with largest kp and kd, and a counted limit of one joint.

    Where gains measure both sides of one joint, its largest kp and kd are those of its region of gains (gain_region.py), and None here.
    Raises GainroomError for other loops, and for gains that are all zero.
    """
    require_loop("joint_margins", loop)
    if loop.parts is None:
        raise GainroomError("joint_margins needs a loop built with build_loop; use margins for a scalar return ratio")
    if loop.size == 1 and loop.kd_path is None:
        limit, found = gain_limit(loop), margins(loop)
        if loop.sensed is None:
            gains = one_loop_gains(loop) if found.stable else OneLoop.unknown(1)
            one_loop = replace(found.one_loop, certified=gains.certified, largest_kp=gains.largest_kp, largest_kd=gains.largest_kd)
            found = replace(found, one_loop=one_loop)
        found = replace(found, limit=limit)
    else:
        with computable("joint_margins"):
            found = coupled_margins(loop, largest=True) if loop.kd_path is None else Multirate(loop).margins(largest=True)
    return replace(found, phase_margin=abs(found.phase_margin))


def _with_sampled_delay(loop: Loop, found: Margins) -> Margins:
    """`found` with the extra delay that puts a root of a sampled loop on the boundary, as scalar_delay_margin.hpp confirms it."""
    plant, control, tick = loop.unsampled, loop.control, loop.sample_time
    assert plant is not None
    assert control is not None
    assert tick is not None
    crossings = np.array(sorted((crossing.delay_margin, crossing.omega) for crossing in found.gain_crossings)).reshape(-1, 2)
    way, extra, omega = _core.delay_margin(
        plant.zeros,
        plant.poles,
        plant.gain,
        plant.delay,
        control.zeros,
        control.poles,
        control.gain * loop.gain,
        tick,
        loop.unstable_poles,
        crossings,
    )
    if way == FAILED:
        raise GainroomError("loop: its turns about −1 cannot be computed: look for values that are many orders of magnitude off")
    if way == ENDLESS:
        return replace(found, certified=False)
    if way == NOTHING:
        return found
    # The delays tried are stable, no more is known: an unstable delay shorter than them would lie near that of the first crossing.
    tried = way == HALVED and extra > found.delay_margin + tick
    return replace(found, delay_margin=extra, delay_crossover=omega, certified=found.certified and not tried)


def _with_followed_delay(loop: Loop, found: Margins) -> Margins:
    """`found` with the extra delay that puts a root of a sampled loop whose gains measure both sides on the boundary.

    The first gain crossings are followed with both plants sampled anew for each delay, and roots are counted on both sides of the one
    that comes first. Where these do not confirm it, the delay margin counts a fraction of a tick as the phase that it costs, and nothing
    is certified.
    """
    tick = loop.sample_time
    assert tick is not None
    crossings = sorted((crossing.delay_margin, crossing.omega) for crossing in found.gain_crossings)
    near = [each for each in crossings if each[0] <= 1.02 * crossings[0][0] + 0.1 * tick][:FOLLOWED]
    ends = [end for each in near if (end := _followed_delay(loop, *each)) is not None]
    if not crossings and abs(loop.response(math.pi / tick)[0]) < 1:
        return found
    if ends:
        extra, omega = min(ends)
        nudge = DELAY_NUDGE * extra + LEAST_ANGLE / omega
        if unstable_roots(loop.delayed(extra - nudge)) == 0 < unstable_roots(loop.delayed(extra + nudge)):
            return replace(found, delay_margin=extra, delay_crossover=omega)
    return replace(found, certified=False)


def _followed_delay(loop: Loop, extra: float, omega: float) -> tuple[float, float] | None:
    """Extra delay [s] at which a gain crossing near `omega` comes to −1, and its frequency [rad/s]; None where it is lost."""
    for _ in range(DELAY_STEPS):
        if not 0 <= extra < math.inf:
            return None
        crossings = scan_loop(loop.delayed(extra), with_peaks=False).gains
        if not len(crossings):
            return None
        place, phase = crossings[int(np.argmin(np.abs(crossings[:, 0] - omega)))].tolist()
        if abs(place - omega) > 0.1 * omega:
            return None
        left = float(np.angle(np.exp(1j * (phase - math.pi)))) / place
        extra, omega = extra + left, place
        if abs(left) <= SAME_DELAY * extra:
            return extra, omega
    return None


def margins_from_scan(loop: Loop, scan: Scan) -> Margins:
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
        loops=(loop,),
    )


def _gain_crossing(omega: float, phase: float) -> GainCrossing:
    turn = 2 * math.pi
    positive = (phase + math.pi) % turn  # phase margin in [0, 2π)
    signed = positive - turn if positive > math.pi else positive
    return GainCrossing(omega, signed, positive / omega if omega > 0 else math.inf)
