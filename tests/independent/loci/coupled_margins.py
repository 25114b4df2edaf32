"""Margins of coupled loops: of all together, and of one loop at a time with the other loops closed, each certified by root counts."""

import math
from dataclasses import replace

import numpy as np

from gainroom.analysis.boundary import LEAST_FACTOR, LONGEST_DELAY, disk_of
from gainroom.analysis.margin_record import Margins, OneLoop
from gainroom.analysis.stability_boundary import sensitivity
from gainroom.system.controller import gain_matrix
from gainroom.system.linear.arrays import Complexes, Floats
from gainroom.system.loop import Loop

from .curve_distances import Summed, distances
from .first_crossing import End, delays, phases
from .limit import coupled_limit
from .loci import Sweep
from .return_ratios import Peak, Sampled, own_phases


def coupled_margins(loop: Loop, largest: bool = True) -> Margins:
    """All margins of a loop built with build_loop, n >= 1, from its loci and each loop's own curve; also `largest` gains of each joint.

    Raises GainroomError for gains that are all zero, and where the loci cannot be followed.
    """
    sweep = Sweep(loop)
    own_peaks, complementary, own_phase = _one_loop_peaks_and_phases(sweep)  # first, on samples that no other search has added to
    limit = coupled_limit(sweep)
    if not limit.stable:
        return replace(Margins.unknown(limit), unstable_roots=max(sweep.unstable(1.0), 1), certified=limit.certified)
    phase = common_phase(sweep)
    delay = _common_delay(sweep)
    peak = max(own_peaks)
    own_heights = np.array([one.height for one in own_peaks])
    one_loop = replace(one_loop_margins(sweep, largest), phase_margin=own_phase, peak_sensitivity=own_heights)
    disk = disk_of(loop)
    certificates = [end.certificate.holds for end in (phase, delay) if end is not None]
    # Beside a resonance without damping roots are counted that grow by LOCI.tilt: slow ones may cross the boundary well before.
    crossed = np.array([limit.frequency, limit.lower_frequency, *(end.omega for end in (phase, delay) if end is not None)])
    certificates.append(not np.any(sweep.boundary.leans(crossed[np.isfinite(crossed)]) > 0))
    return Margins(
        limit,
        one_loop,
        phase_margin=phase.at if phase else math.inf,
        gain_crossover=phase.omega if phase else math.nan,
        delay_margin=delay.at if delay else math.inf,
        delay_crossover=delay.omega if delay else math.nan,
        peak_sensitivity=peak.height,
        peak_sensitivity_frequency=peak.omega,
        peak_complementary=complementary.height,
        peak_complementary_frequency=complementary.omega,
        disk_margin=disk.margin if disk else math.nan,
        disk_margin_frequency=disk.frequency if disk else math.nan,
        disk_certified=disk.certified if disk else False,
        certified=limit.certified and all(certificates) and bool(np.all(one_loop.certified)),
        phase_certificate=phase.certificate if phase else None,
        delay_certificate=delay.certificate if delay else None,
        loops=(loop,),
    )


def _one_loop_peaks_and_phases(sweep: Sweep) -> tuple[list[Peak], Peak, Floats]:
    """The largest |S_ii| of each loop, the largest |T_ii| of all, and the smallest phase in each (n,); of a stable loop."""
    unknown = Peak(math.nan, math.nan)
    if not sweep.largest or sweep.unstable(1.0) != 0 or sweep.full:
        return [unknown] * sweep.loop.size, unknown, np.full(sweep.loop.size, math.nan)
    try:
        sampled = Sampled.of(sweep)
        return sampled.own_peaks(), max(sampled.own_peaks(-1.0, 1.0)), own_phases(sampled.single)
    except np.linalg.LinAlgError:  # a root on the boundary, to the last digit
        return [Peak(math.inf, math.nan)] * sweep.loop.size, Peak(math.inf, math.nan), np.zeros(sweep.loop.size)


def common_phase(sweep: Sweep) -> End | None:
    """The smallest phase [rad], > 0 for a lag, < 0 for a lead, at which all loops of a stable set together vibrate; None: none does."""
    ends = [replace(end, at=way * end.at) for way in (1, -1) if (end := phases(sweep, way).end(0.0, math.pi)) is not None]
    return min(ends, key=lambda end: abs(end.at), default=None)


def _common_delay(sweep: Sweep) -> End | None:
    """The delay margin of all loops together, with its counts of roots; None where no delay makes them vibrate."""
    family = delays(sweep)
    longest = max((one.at for one in family.crossings()), default=None)
    return None if longest is None else family.end(0.0, min(1.1 * longest, LONGEST_DELAY))


def one_loop_margins(sweep: Sweep, largest: bool = True) -> OneLoop:
    """Largest and smallest factor on one joint's gains, certified, and its `largest` diagonal kp and kd where it has such; no phases.

    All other gains stay as they are. A factor 1 + δ on joint i's gains adds δ T_ii to the determinant of the return difference, relative
    to itself, T = (I + L)⁻¹ L; a change δ of one of its diagonal gains adds δ times (I + L)⁻¹ P C e^{−sT} at (i, i), times what that
    gain multiplies.
    """
    loop = sweep.loop
    assert loop.parts is not None
    controller, size, sample_time = loop.parts.controller, loop.size, loop.sample_time
    units = controller.units()

    def curves(omega: Floats) -> Summed:
        s = sweep.boundary.points(omega)
        v = loop.variable(s)
        actuated = loop.actuated_at(s)
        returned = controller.after(loop.gain * actuated, s, v, sample_time)
        sensitive = sensitivity(loop, returned)
        own, terms = _diagonal(sensitive, actuated)
        alone = [unit.matrix(s, v, 1, sample_time)[:, 0] for unit in units.values()]
        closed = 1 - np.diagonal(sensitive, axis1=1, axis2=2)
        # The product keeps the digits of a small T_ii, but where its terms, as large as integrators make them, cancel to it
        product, spread = _diagonal(sensitive, returned)
        closed = np.where((np.abs(closed) > 1e-3) | (spread > 1), closed, product)
        return Summed(
            np.hstack([closed, -closed, *(own * one for one in alone)]),
            np.hstack([spread, spread, *(terms * np.abs(one) for one in alone)]),
        )

    # The curves of largest gains are sampled anyway: samples, and with them the last digits of factors, do not depend on what is asked for.
    farthest = np.repeat([math.inf, 1 - LEAST_FACTOR, *(math.inf if largest else 0.0 for _ in units)], size)
    found, certified = distances(sweep, curves, farthest)
    found, certified = found.reshape(-1, size), np.all(certified.reshape(-1, size), axis=0, keepdims=True)[0]
    smallest = np.where(np.isfinite(found[1]), 1 - found[1], 0.0)
    now = {name: np.diagonal(gain_matrix(name, getattr(controller, name), size)) * loop.gain for name in units if largest}
    gains = {f"largest_{name}": gain + more for (name, gain), more in zip(now.items(), found[2:], strict=largest)}
    return OneLoop(1 + found[0], smallest, np.full(size, math.nan), certified, **gains)


def _diagonal(left: Complexes, right: Complexes) -> tuple[Complexes, Floats]:
    """(k, n) that of the products of matrices (k, n, n), and the size of the terms of which it is the sum."""
    return np.einsum("kij,kji->ki", left, right), np.einsum("kij,kji->ki", np.abs(left), np.abs(right))
