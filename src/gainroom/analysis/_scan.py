"""Compiled kernel: every crossing and every peak of a scalar response, certified between the sampled points.

L(v) = gain Π(v − zeros)/Π(v − poles) e^{−jωT} is a product, so d log L/dω is a sum of one simple term per root. Between *breakpoints*
(the frequencies where some term has an extremum) each term is monotone, hence its range on an interval is given by its two ends, and
the sum of ranges bounds the slopes of log|L| and arg L on the whole interval. An interval is bisected until those bounds decide it:
it holds no crossing, or the slope has one sign and it holds at most one, which bracketed Newton then polishes; no peak inside can be
more than 1 % above the best one found. Nothing is interpolated, and nothing between two points can be missed; where rounding stops
the bisection, `certified` comes back False.

The code keeps to scalars, loops and preallocated arrays: numba compiles these several times faster than array expressions, and the
first run of a fresh installation waits for the compiler.
"""

import math

import numpy as np

from ._scan_terms import (
    TINY,
    bounds,
    breakpoints,
    evaluate,
    half_turns_below,
    holds_odd_multiple,
    jump_between,
    log_size,
    objective,
    objective_bound,
    tail_bound,
    turn_between,
    wrapped,
)
from .compiled import cached_njit

_jit = cached_njit(error_model="numpy")
_MAX_NODES = 4000  # bounds memory and time; an ordinary loop needs 50 to 300
_DEPTH = 60  # of bisection


@_jit
def _polish(kind, low, high, value_low, roots, signs, gain, delay, sample_time, slopes):
    """Root of log|L| (kind 0) or of arg(−L) (kind 1) in a bracket, by Newton with bisection as the fallback."""
    rising = abs(value_low) <= 1 if kind == 0 else math.atan2(-value_low.imag, -value_low.real) <= 0
    omega = 0.5 * (low + high)
    for _ in range(80):
        value = evaluate(omega, roots, signs, gain, delay, sample_time, slopes)
        f = log_size(value) if kind == 0 else math.atan2(-value.imag, -value.real)
        slope = 0.0 if kind == 0 else -delay
        for k in range(len(roots)):
            slope += slopes[k, kind]
        if (f <= 0) == rising:
            low = omega
        else:
            high = omega
        step = omega - f / slope if slope != 0.0 else low
        if f == 0.0 or abs(step - omega) <= 1e-15 * omega:
            break
        omega = step if low < step < high else 0.5 * (low + high)
    return omega


@_jit
def _inclination(kind, value, slopes, delay):
    """d log(objective)/dω."""
    rate = complex(0.0, -delay)
    for k in range(len(slopes)):
        rate += complex(slopes[k, 0], slopes[k, 1])
    slope = (value * rate / (1 + value)).real
    if kind == 1:
        slope -= rate.real
    elif kind == 2:
        slope += (value * rate / (1 - value)).real
    return slope


@_jit
def _polish_minimum(kind, omega, lowest, roots, signs, gain, delay, sample_time, slopes):
    """The local minimum of an objective next to `omega`: (ω, minimum).

    Steps grow downhill and shrink at the bottom; once they are small, a secant on the inclination jumps to the bottom, if it is one.
    """
    step, jumps = 0.01 * omega, 0
    for _ in range(200):
        if abs(step) <= 1e-9 * omega:  # the minimum is flat: its value is then good to about 1e-16
            break
        if jumps < 6 and abs(step) < 1e-3 * omega:
            jumps += 1
            here = _inclination(kind, evaluate(omega, roots, signs, gain, delay, sample_time, slopes), slopes, delay)
            beside = omega + 1e-3 * step
            there = _inclination(kind, evaluate(beside, roots, signs, gain, delay, sample_time, slopes), slopes, delay)
            trial = omega - here * (beside - omega) / (there - here) if there != here else omega
            if abs(trial - omega) < 10 * abs(step):
                value = objective(kind, evaluate(trial, roots, signs, gain, delay, sample_time, slopes))
                if value <= lowest * (1 + 1e-15) and (sample_time == 0 or trial <= math.pi / sample_time):
                    step = min(abs(step), max(abs(trial - omega), 1e-12 * omega))
                    omega, lowest = trial, min(value, lowest)
                    continue
        trial = max(omega + step, 0.5 * omega)  # an infimum at ω → 0 is approached, never passed
        if sample_time > 0:
            trial = min(trial, math.pi / sample_time)
        value = objective(kind, evaluate(trial, roots, signs, gain, delay, sample_time, slopes))
        if value < lowest:
            omega, lowest, step = trial, value, 1.3 * step
        else:
            step *= -0.5
    return omega, lowest


@_jit
def _walk(seek_peaks, ends, phase, roots, signs, gain, delay, sample_time, nodes, gains, phases, peaks):
    """Walk along the boundary from ends[0] through every end, bisecting until each interval is decided.

    Either `seek_peaks`: improve peaks (3, 2: ω, minimum), which hold a first guess; or list gains (g, 2: ω, arg L), phases
    (p, 3: ω, |L|, sign of the slope) and fill nodes (ω). Returns (last arg L, gain crossings, phase crossings, nodes, certified).
    """
    size, certified = len(roots), True
    at_a, work = np.empty((size, 2)), np.empty((size, 2))
    stack, stack_value, at_b = np.empty(_DEPTH), np.empty(_DEPTH, np.complex128), np.empty((_DEPTH, size, 2))
    a = ends[0]
    value_a = evaluate(a, roots, signs, gain, delay, sample_time, at_a)
    log_a, gain_count, phase_count, count, spent = log_size(value_a), 0, 0, 0, 0
    nodes[0] = a
    for target in range(1, len(ends)):
        top = 0
        stack[0] = ends[target]
        stack_value[0] = evaluate(ends[target], roots, signs, gain, delay, sample_time, at_b[0])
        while top >= 0:
            b, value_b = stack[top], stack_value[top]
            width, log_b = b - a, log_size(value_b)
            phase_b, jump = phase + turn_between(value_a, value_b), 0.0
            if width <= 8 * TINY * b:
                jump = jump_between(a, b, roots, signs, sample_time)
                if jump != 0.0:
                    phase_b = phase + jump + wrapped(phase_b - phase - jump)
                    if not seek_peaks:
                        for side in range(2):  # |L| is 0 at a zero and infinite at a pole, however large or small just beside it
                            if ((log_b if side else log_a) > 0) != (jump < 0):
                                gains[gain_count, 0], gains[gain_count, 1] = b if side else a, phase_b if side else phase
                                gain_count += 1
            else:
                steep_low, steep_high, log_low, log_high = bounds(0, width, at_a, at_b[top], delay, log_a, log_b)
                turn_low, turn_high, phase_low, phase_high = bounds(1, width, at_a, at_b[top], delay, phase, phase_b)
                undecided = max(-turn_low, turn_high) * width > 2.5
                if seek_peaks:
                    for kind in range(3):
                        undecided = undecided or objective_bound(kind, log_low, log_high, phase_low, phase_high) < 0.99 * peaks[kind, 1]
                else:
                    undecided = undecided or (steep_low < 0 < steep_high and log_low <= 0 <= log_high)
                    undecided = undecided or (turn_low < 0 < turn_high and holds_odd_multiple(phase_low, phase_high))
                if undecided:
                    spent += 1
                    if top + 1 < _DEPTH and spent < _MAX_NODES:
                        top += 1
                        stack[top] = math.sqrt(a * b) if 0 < 4 * a < b else 0.5 * (a + b)
                        stack_value[top] = evaluate(stack[top], roots, signs, gain, delay, sample_time, at_b[top])
                        if seek_peaks:
                            for kind in range(3):
                                lower = objective(kind, stack_value[top])
                                if lower < peaks[kind, 1]:
                                    peaks[kind, 0], peaks[kind, 1] = stack[top], lower
                        continue
                    certified = False
            if not seek_peaks and jump == 0.0:
                if (log_a > 0) != (log_b > 0):
                    crossing = _polish(0, a, b, value_a, roots, signs, gain, delay, sample_time, work)
                    at_crossing = evaluate(crossing, roots, signs, gain, delay, sample_time, work)
                    gains[gain_count, 0], gains[gain_count, 1] = crossing, phase + turn_between(value_a, at_crossing)
                    gain_count += 1
                at_end = sample_time > 0 and b == ends[-1] and value_b.real < 0  # listed by the caller, as L(0) < 0 is
                if half_turns_below(phase) != half_turns_below(phase_b) and not at_end and (a > 0 or value_a.real > 0):
                    crossing = _polish(1, a, b, value_a, roots, signs, gain, delay, sample_time, work)
                    phases[phase_count, 0] = crossing
                    phases[phase_count, 1] = abs(evaluate(crossing, roots, signs, gain, delay, sample_time, work))
                    phases[phase_count, 2] = 1.0 if phase_b > phase else -1.0
                    phase_count += 1
            for k in range(size):
                at_a[k, 0], at_a[k, 1] = at_b[top, k, 0], at_b[top, k, 1]
            a, value_a, log_a, phase = b, value_b, log_b, phase_b
            top -= 1
            count += 1
            if count >= _MAX_NODES - 1 or gain_count >= _MAX_NODES - 1 or phase_count >= _MAX_NODES - 1:
                return phase, gain_count, phase_count, count, False
            nodes[count] = a
    return phase, gain_count, phase_count, count + 1, certified


@_jit
def _half_encirclements(start_phase, outside, ends_at_boundary, last_phase, gains, gain_count):
    """Change of arg(1+L) along the upper half of the contour, divided by π.

    While |L| > 1, arg(1+L) = arg L + arg(1+1/L); while |L| < 1 it cannot turn around. So the gain crossings alone fix it.
    """
    turned, mark = 0.0, start_phase if outside else 0.0
    for k in range(gain_count):
        phase = gains[k, 1]
        half = wrapped(phase) / 2  # arg(1 + e^{j phase})
        turned += (phase - half if outside else half) - mark
        mark = half if outside else phase - half
        outside = not outside
    end = math.pi * math.floor(last_phase / math.pi + 0.5) if outside and ends_at_boundary else 0.0
    return (turned + end - mark) / math.pi


@_jit
def _start(roots, signs, gain, delay, sample_time, slopes):
    """(ω, arg L there, arg L at small real s > 0, integrators, scale). Where integrators rule, ω is small but not 0."""
    integrators, scale, start_phase = 0, math.inf, 0.0 if gain > 0 else math.pi
    for k in range(len(roots)):
        if roots[k] == 0:
            integrators -= signs[k]
        else:
            scale = min(scale, abs(roots[k]))
            if roots[k].imag == 0 and roots[k].real > 0:
                start_phase = math.pi - start_phase
    if delay > 0:
        scale = min(scale, 1 / delay)
    if math.isinf(scale):
        scale = abs(gain) ** (1.0 / max(abs(integrators), 1))
    if integrators == 0:
        return 0.0, start_phase, start_phase, 0, scale
    omega, limit, value = 1e-3 * scale, start_phase - integrators * math.pi / 2, 0j
    for _ in range(300):
        value = evaluate(omega, roots, signs, gain, delay, sample_time, slopes)
        if (abs(value) > 10) if integrators > 0 else (abs(value) < 0.1):
            break
        omega /= 4
    return omega, limit + wrapped(math.atan2(value.imag, value.real) - limit), start_phase, integrators, scale


@_jit
def scan(roots, signs, gain, delay, sample_time, floor, with_peaks):
    """All crossings, peaks and the encirclement count of one loop.

    roots, signs (+1 zero, −1 pole), gain, delay [s], sample_time [s] (0: continuous); in continuous time the walk ends where |L| stays
    below `floor`. Returns (gains (g, 2): ω, arg L; phases (p, 3): ω, |L|, sign of the phase slope (0 at an end of the boundary);
    peaks (3, 2): ω, minimum of each `objective`; half_turns: change of arg(1+L) along the upper half of the contour / π; certified).
    """
    work = np.empty((len(roots), 2))
    first, phase, start_phase, integrators, scale = _start(roots, signs, gain, delay, sample_time, work)
    ends, nodes = np.empty(9 * len(roots) + 2), np.empty(_MAX_NODES)
    gains, phases, peaks = np.empty((_MAX_NODES, 2)), np.empty((_MAX_NODES, 3)), np.empty((3, 2))
    certified = True
    last = math.pi / sample_time
    if sample_time == 0:
        last = scale
        for doubling in range(121):
            last *= 2
            magnitude = abs(evaluate(last, roots, signs, gain, delay, sample_time, work))
            if tail_bound(last, magnitude, roots, signs) < floor:
                break
            certified = doubling < 119
    ends[0] = first
    count = 1 + breakpoints(roots, sample_time, first, last, ends[1:])
    ends[count] = last
    count += 1
    at_first = evaluate(first, roots, signs, gain, delay, sample_time, work)
    outside = integrators > 0 or (integrators == 0 and abs(at_first) > 1)
    last_phase, gain_count, phase_count, node_count, sure = _walk(
        False, ends[:count], phase, roots, signs, gain, delay, sample_time, nodes, gains, phases, peaks
    )
    certified = certified and sure
    half_turns = _half_encirclements(start_phase, outside, sample_time > 0, last_phase, gains, gain_count)
    if integrators == 0 and at_first.real < 0:
        for k in range(phase_count, 0, -1):
            for column in range(3):
                phases[k, column] = phases[k - 1, column]
        phases[0, 0], phases[0, 1], phases[0, 2] = 0.0, abs(at_first), 0.0
        phase_count += 1
    at_last = evaluate(ends[count - 1], roots, signs, gain, delay, sample_time, work)
    if sample_time > 0 and at_last.real < 0:
        phases[phase_count, 0], phases[phase_count, 1], phases[phase_count, 2] = last, abs(at_last), 0.0
        phase_count += 1
    if with_peaks:
        for kind in range(3):
            peaks[kind, 0], peaks[kind, 1] = 0.0, math.inf
        for k in range(node_count):
            value = evaluate(nodes[k], roots, signs, gain, delay, sample_time, work)
            for kind in range(3):
                lower = objective(kind, value)
                if lower < peaks[kind, 1]:
                    peaks[kind, 0], peaks[kind, 1] = nodes[k], lower
        spare = np.empty(_MAX_NODES)
        sure = _walk(True, nodes[:node_count], phase, roots, signs, gain, delay, sample_time, spare, gains, phases, peaks)[4]
        certified = certified and sure
        for kind in range(3):
            where, lowest = _polish_minimum(kind, peaks[kind, 0], peaks[kind, 1], roots, signs, gain, delay, sample_time, work)
            peaks[kind, 0], peaks[kind, 1] = where, lowest
    return gains[:gain_count], phases[:phase_count], peaks, half_turns, certified
