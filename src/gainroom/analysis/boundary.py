"""Margins of coupled loops: crossings of −1 and peaks read from the core's samples, each confirmed by root counts on other samples.

A loop is sampled once, and its crossings are polished. Unstable roots are then counted a little inside and outside each margin: of a phase
and of one loop's gains by turns about 0 on other samples, of a delay in the loop with that delay. An unconfirmed margin is not certified.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..errors import GainroomError
from ..system.controller import gain_matrix
from ..system.linear.arrays import Booleans, Floats
from ..system.loop import Loop
from .core_loop import EVERY_PHASE, NEAR_BY, CoreLoop
from .disk_margin import MultiLoopDisk, disk_margin
from .gain_limit import gain_limit, lost
from .loop_samples import LoopSamples, Reach
from .margin_record import NUDGE, Certificate, Margins, OneLoop
from .stability_boundary import HIGHEST, Boundary

MOST_ROUNDS = 5  # further samplings, where loci of equal joints or curves that nearly turn may cross unseen
LONGEST_DELAY = 1.0  # [s] largest extra delay that is searched: a hundred times the delay of actuators
LEAST_FACTOR = 1e-3  # smallest factor on one joint's gains that is searched: a limit below counts as none
CLOSE = 0.03  # relative distance within which crossings of sampled loops may change places when the delay is exact
TRIES, HALVINGS, EXACT_LAG = 12, 30, 1e-11  # steps of secants and of halvings to an exact delay, and the lag [rad] at which it is found


def coupled_margins(loop: Loop, largest: bool = False) -> Margins:
    """All margins of a loop of several joints built with build_loop, read from the core's samples and certified by counts of roots.

    Margins that the counts do not confirm are reported uncertified.

    largest   True: also each joint's largest kp and kd; of gain matrices that couple joints the largest diagonal entries

    Raises GainroomError where all gains are zero, and where the loop cannot be sampled finely enough.
    """
    limit, core = gain_limit(loop), _in_the_core(loop)
    samples = core.samples(EVERY_PHASE)
    if not limit.stable:
        return replace(
            Margins.unknown(limit), unstable_roots=max(samples.unstable, 1) if samples.followed else -1, certified=limit.certified
        )
    phase, crossover = _phase_of_all(samples) if samples.followed and samples.unstable == 0 else (math.nan, math.nan)
    if not samples.followed or samples.unstable != 0:
        raise GainroomError(f"margins: {lost(loop)}")
    reach = min(math.pi, 1.2 * abs(phase) + NEAR_BY.phase)
    counting = core.samples(Reach(NEAR_BY.factor, reach, EVERY_PHASE.peaks), between=True)
    phase_certificate, delay = _phase_counted(counting, phase), _first_delay(loop, samples)
    one_loop = _one_loop(loop, core, samples, counting, largest)
    peak, peak_at = samples.peak(1.0, 0.0)
    complementary, complementary_at = samples.peak(-1.0, 1.0)
    disk = disk_of(loop)
    crossed = np.array([limit.frequency, limit.lower_frequency, crossover, delay.omega])
    # Beside a resonance without damping roots are counted that grow by TILT: slow ones may cross the boundary well before.
    leans = bool(np.any(Boundary(loop).leans(crossed[np.isfinite(crossed)]) > 0))
    certificates = all(one is None or one.holds for one in (phase_certificate, delay.certificate))
    return Margins(
        limit,
        one_loop,
        phase_margin=phase,
        gain_crossover=crossover,
        delay_margin=delay.at,
        delay_crossover=delay.omega,
        peak_sensitivity=peak,
        peak_sensitivity_frequency=peak_at,
        peak_complementary=complementary,
        peak_complementary_frequency=complementary_at,
        certified=limit.certified and certificates and delay.known and bool(np.all(one_loop.certified)) and not leans,
        phase_certificate=phase_certificate,
        delay_certificate=delay.certificate,
        loops=(loop,),
        disk_margin=disk.margin if disk else math.nan,
        disk_margin_frequency=disk.frequency if disk else math.nan,
        disk_certified=disk.certified if disk else False,
    )


def coupled_delay_margin(loop: Loop) -> float:
    """Delay margin [s] of n > 1 joints: the smallest extra delay in all loops that puts a root on the stability boundary, with root counts.

    inf: none up to LONGEST_DELAY; NaN: the loop is unstable as it is. Raises GainroomError where the loop cannot be sampled finely enough.
    """
    samples = _in_the_core(loop).samples(EVERY_PHASE, smooth=False)
    if samples.followed and samples.unstable > 0:
        return math.nan
    if samples.followed:
        samples.tell_apart(NEAR_BY.factor, math.pi)
    if not samples.followed or samples.unstable < 0:
        raise GainroomError(f"margins: {lost(loop)}")
    return _first_delay(loop, samples).at


def one_loop_gains(loop: Loop) -> OneLoop:
    """Margins of one joint at a time, the other loops closed, with its largest kp and kd; `loop` is stable and built with build_loop.

    Raises GainroomError where the loop cannot be sampled finely enough.
    """
    core = _in_the_core(loop)
    samples, counting = core.samples(EVERY_PHASE), core.samples(Reach(NEAR_BY.factor, NEAR_BY.phase, EVERY_PHASE.peaks), between=True)
    if not samples.followed:
        raise GainroomError(f"margins: {lost(loop)}")
    return _one_loop(loop, core, samples, counting, largest=True)


def _in_the_core(loop: Loop) -> CoreLoop:
    core = CoreLoop.of(loop)
    if core is None:
        raise GainroomError("margins of several joints need a loop built with build_loop")
    return core


def direction_limits(loop: Loop, torque: Floats, jacobian: Floats, gains: Floats, cascade: Booleans) -> Floats:
    """(m,) largest factor on the gains of each direction, the others as they are; inf: any; NaN where it is not confirmed by counts.

    A factor g on direction k multiplies the determinant of the return difference by 1 + (g − 1) T_kk, T = (I + Q)⁻¹ Q, Q = E P X Δ.

    loop                of all directions, stable: where it is not, all are NaN
    torque, jacobian    X (n, m), E (m, n)
    gains, cascade      (3, m), (m,): as CoreLoop.of_directions
    """
    core = CoreLoop.of_directions(loop, torque, jacobian, gains, cascade)
    samples, counting = core.samples(EVERY_PHASE), core.samples(Reach(NEAR_BY.factor, NEAR_BY.phase, EVERY_PHASE.peaks), between=True)
    if not (samples.followed and counting.followed and samples.unstable == counting.unstable == 0):
        return np.full(len(cascade), math.nan)
    return np.array([_factor(samples, counting, k, 1, up) for k, up in enumerate(samples.one_loop()[:, 0].tolist())])


def _phase_of_all(samples: LoopSamples) -> tuple[float, float]:
    """Phase margin common to all loops [rad], with its sign, and its frequency [rad/s], after refining samples at nearly equal loci.

    Loci of equal limbs, and curves that nearly turn back, may cross the unit circle between samples. Large phases are refined, too: at a
    high frequency they are a short delay.
    """
    found = samples.common_phase()
    for _ in range(MOST_ROUNDS):
        up, down = samples.one_loop().T[:2]  # (n,) per joint; inf where none is seen
        before = samples.samples
        samples.tell_apart(math.exp(min(float(np.minimum(up, down).max()), math.log(HIGHEST))), math.pi)
        if not samples.followed or samples.samples == before:
            break
        found = samples.common_phase()
    return found


def _phase_counted(counting: LoopSamples, phase: float) -> Certificate | None:
    """Numbers of roots that a common phase makes unstable: NUDGE inside the phase margin `phase` [rad], either sign, and outside it.

    None for an infinite phase; −1 for both if the loop is unstable or its loci cannot be followed.
    """
    if math.isinf(phase):
        return None
    if not counting.followed or counting.unstable != 0:
        return Certificate(-1, -1)
    inside = max(abs(counting.crossed(way * phase * (1 - NUDGE))) for way in (1, -1))
    return Certificate(inside, counting.crossed(phase * (1 + NUDGE)))


class _Delay(NamedTuple):
    """Delay margin `at` [s], its frequency `omega` [rad/s] and its certificate, None where no delay is known to be too long.

    known   True: roots have been counted on both sides, or no delay up to LONGEST_DELAY loses the loop
    """

    at: float
    omega: float
    certificate: Certificate | None
    known: bool = True


def _first_delay(loop: Loop, samples: LoopSamples) -> _Delay:
    """Smallest extra delay in all loops that puts a root on the stability boundary, with its root counts; inf: none up to LONGEST_DELAY.

    A crossing of −1 in the samples is exact where a delay T turns loci by ωT; of a sampled loop it is the start of a secant iteration.
    Where roots are unstable before that delay, the loop is sampled anew with a longer delay that is still stable.
    """

    def counted(delay: float) -> int:
        return _in_the_core(loop.delayed(delay)).unstable()

    def lag(delay: float, omega: float) -> tuple[float, float]:
        return _in_the_core(loop.delayed(delay)).lag_about(omega)

    stable, found = 0.0, _Delay(math.nan, math.nan, None, False)
    for _ in range(TRIES):
        crossings = [(stable + more, omega) for more, omega in samples.delay_crossings(LONGEST_DELAY - stable).tolist()]
        if not crossings:
            known = counted(LONGEST_DELAY) == 0
            return _Delay(math.inf, math.nan, None, known) if stable == 0 else found
        first = min(crossings)[0]
        near = [one for one in crossings if one[0] <= first * (1 + CLOSE)]
        exact = near if loop.sample_time is None else [one for place in near if (one := exact_delay(lag, *place)) is not None]
        delay, omega = min((one for one in exact if one[0] > stable), default=(math.nan, math.nan))
        if not math.isnan(delay):
            certificate = Certificate(*(counted(delay * (1 + side * NUDGE)) for side in (-1, 1)))
            found = _Delay(delay, omega, certificate, certificate.outside > 0)
            if certificate.holds:
                return found
            first = delay
        stable = _later(counted, stable, first)
        samples = _in_the_core(loop.delayed(stable)).samples(EVERY_PHASE, smooth=False)
        if not samples.followed or samples.unstable != 0:
            break
    return found


def _later(counted: Callable[[float], int], stable: float, unstable: float) -> float:
    """Longest delay [s] at which `counted` finds no unstable root, among HALVINGS midpoints from `unstable` down; else `stable`."""
    for _ in range(HALVINGS):
        middle = 0.5 * (stable + unstable)
        if counted(middle) == 0:
            return middle
        unstable = middle
    return stable


def _one_loop(loop: Loop, core: CoreLoop, samples: LoopSamples, counting: LoopSamples, largest: bool) -> OneLoop:
    """Margins of one loop at a time, with `largest` also each joint's largest gains; certified where roots are counted on both sides."""
    up, down, phase, peak = samples.one_loop().T
    highest = [_factor(samples, counting, joint, 1, size) for joint, size in enumerate(up.tolist())]
    lowest = [_factor(samples, counting, joint, -1, size) for joint, size in enumerate(down.tolist())]
    certified = ~np.isnan(highest) & ~np.isnan(lowest)
    highest, lowest = np.where(np.isnan(highest), np.exp(up), highest), np.where(np.isnan(lowest), np.exp(-down), lowest)
    found = OneLoop(highest, lowest, phase, certified, peak_sensitivity=peak)
    return _with_largest(loop, core, samples, counting, found) if largest else found


def _factor(samples: LoopSamples, counting: LoopSamples, joint: int, way: int, first: float) -> float:
    """Factor on one joint's gains at which the loop becomes unstable, above 1 (`way` 1) or below 1 (`way` −1).

    inf or 0 if there is none; NaN if no crossing is confirmed by counts of roots.

    first   |ln| of the nearest crossing among the samples; if the counts do not confirm it, farther ones are tried in turn
    """

    def confirmed(size: float) -> float:
        factor = math.exp(way * size)
        factor = 0.0 if factor < LEAST_FACTOR else factor
        return factor if _is_end(counting, joint, 0, factor - 1, factor, (HIGHEST if way > 0 else LEAST_FACTOR) - 1) else math.nan

    found = confirmed(first)
    if not math.isnan(found):
        return found
    others = [way * one for one in samples.one_loop_crossings(joint)[:, 0].tolist() if way * one > first]
    return next((other for size in [*others, math.inf] if not math.isnan(other := confirmed(size))), math.nan)


def _is_end(counting: LoopSamples, joint: int, gain: int, change: float, scale: float, farthest: float) -> bool:
    """True if `change` of one joint's gains is a stability limit: no root is unstable just before it, at least one is just beyond.

    For `scale` 0 or inf no limit is claimed; then True if no root is unstable at the change `farthest`.

    gain    0: all gains of the joint, `change` relative to them; 1: kp; 2: kd
    scale   size that the distances "just before" and "just beyond", NUDGE, are relative to
    """
    if not 0 < scale < math.inf:
        return counting.one_loop_count(joint, farthest, gain) == 0
    aside = math.copysign(NUDGE * scale, change)
    return counting.one_loop_count(joint, change - aside, gain) == 0 and counting.one_loop_count(joint, change + aside, gain) > 0


def _with_largest(loop: Loop, core: CoreLoop, samples: LoopSamples, counting: LoopSamples, found: OneLoop) -> OneLoop:
    """Margins of one loop at a time with each joint's largest kp and kd, where there are such gains."""
    assert loop.parts is not None
    controller = loop.parts.controller
    units, first = controller.units(), 0
    if not units:
        return found
    if not core.by_joint:
        extended = CoreLoop.of_matrices(loop, with_joints=True)
        samples, counting = extended.samples(EVERY_PHASE), extended.samples(NEAR_BY, between=True)
        first = extended.gains.shape[1] - loop.size
    largest, certified = {}, found.certified.copy()
    for gain, name in enumerate(units, start=1):
        now = np.diagonal(gain_matrix(name, getattr(controller, name), loop.size)) * loop.gain
        more = samples.growths(gain)[first:, 0]
        for joint, (grown, own) in enumerate(zip(more.tolist(), now.tolist(), strict=True)):
            farthest = (HIGHEST - 1) * own
            if 0 <= grown < NUDGE * own:  # no more is stable: the gain as it is stands for the side within
                certified[joint] &= counting.one_loop_count(first + joint, NUDGE * own, gain) > 0
            else:
                certified[joint] &= grown > 0 and _is_end(counting, first + joint, gain, grown, own + grown, farthest)
        largest[f"largest_{name}"] = now + more
    return replace(found, certified=certified, **largest)


def exact_delay(lag: Callable[[float, float], tuple[float, float]], delay: float, omega: float) -> tuple[float, float] | None:
    """Extra delay [s] near `delay` at which a locus of a sampled loop passes −1, and the frequency [rad/s] of that, near `omega`.

    None if the locus cannot be followed.

    lag   (delay, ω) → further common phase lag [rad] with which the locus near ω passes −1 at that delay, and the frequency; NaN: not known

    A fraction of a tick is not exactly a phase lag ωT, least of all near a resonance, so that the delay is found by secants.
    """
    before = None
    for _ in range(TRIES):
        left, omega = lag(delay, omega)
        if abs(left) <= EXACT_LAG:
            return delay + left / omega, omega
        slope = -omega if before is None or before[0] == delay else (left - before[1]) / (delay - before[0])
        before, delay = (delay, left), delay - left / slope if slope else math.nan
        if not delay >= 0:  # NaN where the locus cannot be followed
            return None
    return None


def disk_of(loop: Loop) -> MultiLoopDisk | None:
    """Disk margin of the loop; None if I + L is singular in floating point, as where integrators exceed all else by its precision."""
    try:
        return disk_margin(loop)
    except np.linalg.LinAlgError:
        return None
