"""The least margins of coupled loops from their loci, for comparison with what the core looks at (loop_curves.hpp).

Sampled by the package's `Sweep`, polished here: every locus everywhere, eigenvalues by LAPACK.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gainroom.analysis.margin_record import GainLimit, Margins, OneLoop
from gainroom.system.loop import Loop
from independent.loci.first_crossing import Family, gains, height, phases, slope
from independent.loci.loci import Sweep
from independent.loci.return_ratios import Curves, Sampled, own_phases
from independent.loci.sampled_curves import meets_axis, meets_circle

Array = np.ndarray
REAL, CLOSE, SLACK, BEFORE, HIGHEST = 0.01, 0.05, 0.01, 1e-6, 100.0


def quick_margins(loop: Loop) -> Margins:
    """The gain and phase margins and the peak sensitivity; the rest is NaN. Factors: the lesser one up and down, under both names."""
    sweep = Sweep(loop, HIGHEST)
    count = sweep.unstable(1.0)
    if count > 0 or sweep.full or count < 0:
        return Margins.unknown(GainLimit.unknown(loop.size, stable=count <= 0))
    try:
        sampled = Sampled.of(sweep)
        peak = max(sampled.own_peaks())
        limits = [(_factor_of_real(loci), _factor_of_real(ratios)) for loci, ratios in _ends(sampled)]
        common = min([_common_factor(sweep), *(one for one, _ in limits)])
        single = min([_own_factors(sampled.single), *(one for _, one in limits)])
        phase, one_phase = _common_phase(sweep), float(own_phases(sampled.single).min())
    except np.linalg.LinAlgError:  # a root on the boundary, to the last digit
        return Margins.unknown(GainLimit.unknown(loop.size, stable=False))
    factor, every = math.exp(common), np.full(loop.size, math.exp(single))
    limit = replace(GainLimit.unknown(loop.size), gain=factor, lower_gain=1 / factor)
    one_loop = OneLoop(every, 1 / every, np.full(loop.size, one_phase), np.zeros(loop.size, dtype=bool))
    return Margins(limit, one_loop, phase_margin=phase, peak_sensitivity=peak.height, peak_sensitivity_frequency=peak.omega)


def _ends(sampled: Sampled) -> list[tuple[Array, Array]]:
    """Where the boundary ends and values may be real: the loci that matter there, and every return ratio (n,)."""
    sweep, found = sampled.sweep, []
    loop = sweep.loop
    if loop.sample_time is not None:  # at half the sample rate
        found.append((sweep.loci[-1], sampled.single.values[-1]))
    if loop.parts is not None and loop.parts.plant.gravity_stiffness is not None:  # where gravity topples
        found.append((sweep.at_rest(), sampled.single.at(1e-6 * sampled.single.omega[:1])[0]))
    return found


def _near_least(sizes: Array) -> Array:
    """True for what may be the least when it is polished."""
    return sizes <= sizes.min(initial=math.inf) * (1 + CLOSE) + SLACK


def _own_factors(single: Curves) -> float:
    """The smallest |ln g| at which g times one loop's gains make it vibrate."""
    rows, joints, _, value = meets_axis(single.values[:-1], single.values[1:])
    chosen = _near_least(np.abs(np.log(-value)))
    value = single.on_axis(rows[chosen], joints[chosen]).real
    return float(np.abs(np.log(-value[value < 0])).min(initial=math.inf))


def _common_factor(sweep: Sweep) -> float:
    """The smallest |ln g| at which g times all gains make them vibrate."""
    steps = sweep.steps()
    rows, _, share, value = meets_axis(steps.start, steps.end)
    chosen = _near_least(np.abs(np.log(-value)))
    omega = (sweep.omega[rows] + share * (sweep.omega[rows + 1] - sweep.omega[rows]))[chosen]
    value = value[chosen]
    found = _polished(sweep, omega, value.astype(complex), slope, lambda value: np.log(-value.real))
    for way in (1, -1) if found < math.log(sweep.highest) else ():
        found = abs(math.log(_counted(gains(sweep), 1.0, math.exp(way * found))))
    return found


def _counted(family: Family, start: float, end: float) -> float:
    """`end`, or where the first root crosses before it: of two crossings close together polishing may find one twice."""
    before = end + BEFORE * (start - end)
    if family.count(before) == 0:
        return end
    first = family.end(start, before)
    return end if first is None or abs(first.at - start) > abs(end - start) else first.at


def _common_phase(sweep: Sweep) -> float:
    """The smallest phase [rad] at which all loops together vibrate."""
    steps = sweep.steps()
    rows, _, share, lag = meets_circle(steps.start, steps.end)
    chosen = _near_least(np.abs(lag))
    omega = (sweep.omega[rows] * (sweep.omega[rows + 1] / sweep.omega[rows]) ** share)[chosen]
    found = _polished(sweep, omega, -np.exp(1j * lag[chosen]), height, lambda value: np.angle(-value))
    for way in (1, -1) if found < math.pi else ():
        found = _counted(phases(sweep, way), 0.0, found)
    return found


def _polished(
    sweep: Sweep,
    omega: Array,
    wanted: Array,
    zero: Callable[[Array], Array],
    margin: Callable[[Array], Array],
) -> float:
    """The smallest |margin| of the loci that are about `wanted` at `omega`, where `zero` of them is 0."""
    _, value = sweep.boundary.crossings(omega, wanted, zero)
    near = np.abs(value / wanted - 1) < 0.5  # else it went astray, and what was interpolated stands
    value = np.where(near, value, wanted)
    return float(np.abs(margin(value)).min(initial=math.inf))


def _factor_of_real(values: Array) -> float:
    """The smallest |ln g| with −1/g among the values that are real."""
    real = np.real(values[np.abs(np.imag(values)) < REAL * np.abs(values)])
    return float(np.abs(np.log(-real[real < 0])).min(initial=math.inf))
