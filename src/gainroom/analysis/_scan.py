"""Compiled kernel: every crossing and every peak of a scalar response, certified between the points it looks at.

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

from .compiled import cached_njit

_jit = cached_njit(error_model="numpy")
_TINY = 1e-12  # relative width at which bisection stops, a few thousand times the rounding of a double
_MAX_NODES = 4000  # bounds memory and time; an ordinary loop needs 50 to 300
_DEPTH = 60  # of bisection
_LOG_ZERO = -700.0  # stands for log 0


@_jit
def evaluate(omega, roots, signs, gain, delay, sample_time, slopes):
    """L(jω); row k of `slopes` (k, 2) receives root k's terms of d log|L|/dω and d arg L/dω."""
    if sample_time == 0.0:
        v, dv = complex(0.0, omega), 1j
    else:
        # v = (e^{jθ} − 1)/T_s = e^{jθ/2} 2j sin(θ/2)/T_s, without cancellation
        half = omega * sample_time / 2
        rotation = complex(math.cos(half), math.sin(half))
        v, dv = rotation * complex(0.0, 2 * math.sin(half) / sample_time), 1j * rotation * rotation
    value = gain * complex(math.cos(omega * delay), -math.sin(omega * delay))
    for k in range(len(roots)):
        distance = v - roots[k]
        term = signs[k] * dv / distance
        slopes[k, 0] = term.real
        slopes[k, 1] = term.imag
        value = value * distance if signs[k] > 0 else value / distance
    return value


@_jit
def _angle(root, sample_time):
    """The frequency of the boundary point nearest to a root, in [−π/T_s, π/T_s] or (−∞, ∞)."""
    if sample_time == 0.0:
        return root.imag
    return math.atan2(sample_time * root.imag, 1 + sample_time * root.real) / sample_time


@_jit
def _breakpoints(roots, sample_time, low, high, points):
    """Fill `points` with the sorted ω in (low, high) where a slope term may have an extremum or a pole; return their number."""
    count = 0
    period = 2 * math.pi / sample_time if sample_time > 0 else 0.0
    for k in range(len(roots)):
        x, y = roots[k].real, roots[k].imag
        center, spread = _angle(roots[k], sample_time), abs(x)
        rate = x + (x * x + y * y) * sample_time / 2
        if sample_time > 0:
            radius = math.sqrt(max(1 + 2 * sample_time * rate, 0.0))  # |z|
            spread = 2 * math.atan(2 * sample_time * abs(rate) / (1 + radius) ** 2) / sample_time
        if abs(rate) <= 1e-13 * math.sqrt(x * x + y * y):  # on the boundary: a pair around it
            spread = 2 * _TINY * abs(center)
        for side in range(-1, 2):
            for turn in range(-1, 2):
                point = center + side * spread + turn * period
                if not low < point < high or (turn != 0 and period == 0.0) or (side == 0 and spread == 2 * _TINY * abs(center)):
                    continue
                place = count
                while place > 0 and points[place - 1] > point:
                    points[place] = points[place - 1]
                    place -= 1
                points[place] = point
                count += 1
    return count


@_jit
def _tail_bound(omega, magnitude, roots, signs):
    """Largest |L(jω')| for any ω' >= omega, continuous time, given |L(jω)| = magnitude.

    Zeros and as many of the slowest poles (poles come sorted) are bounded together, as |jω' − root|/ω'; each further pole by its least
    distance.
    """
    bound, unpaired = magnitude, 0
    for k in range(len(roots)):
        x, y = roots[k].real, roots[k].imag
        size2 = x * x + y * y
        here = (x * x + (omega - y) ** 2) / (omega * omega)  # |jω' − root|²/ω'² is a convex quadratic in 1/ω', equal to 1 at 0
        if signs[k] > 0:
            bound *= math.sqrt(max(1.0, here) / here)
            unpaired += 1
            continue
        least = min(1.0, here)
        if y > 0 and omega * y <= size2:
            least = x * x / size2
        if unpaired <= 0:
            least = x * x / (omega * omega) if y > omega else here
        if least == 0.0:
            return math.inf
        bound *= math.sqrt(here / least)
        unpaired -= 1
    return bound if unpaired <= 0 else math.inf


@_jit
def _wrapped(angle):
    """`angle` in (−π, π]."""
    return angle - 2 * math.pi * math.ceil((angle - math.pi) / (2 * math.pi))


@_jit
def _log(value):
    """log|value|, finite."""
    return math.log(abs(value)) if value != 0 else _LOG_ZERO


@_jit
def _turn(value_a, value_b):
    """arg(value_b / value_a) in (−π, π]."""
    rotated = value_b * value_a.conjugate()
    return math.atan2(rotated.imag, rotated.real)


@_jit
def _polish(kind, low, high, value_low, roots, signs, gain, delay, sample_time, slopes):
    """Root of log|L| (kind 0) or of arg(−L) (kind 1) in a bracket, by Newton with bisection as the fallback."""
    rising = abs(value_low) <= 1 if kind == 0 else math.atan2(-value_low.imag, -value_low.real) <= 0
    omega = 0.5 * (low + high)
    for _ in range(80):
        value = evaluate(omega, roots, signs, gain, delay, sample_time, slopes)
        f = _log(value) if kind == 0 else math.atan2(-value.imag, -value.real)
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
def objective(kind, value):
    """What each peak minimises: 0: |1+L| (Ms), 1: |1+L|/|L| (Mt), 2: 2|1+L|/|1−L| (disk margin)."""
    below = 1.0 if kind == 0 else abs(value) if kind == 1 else abs(1 - value) / 2
    return abs(1 + value) / below if below > 0 else math.inf


@_jit
def _objective_bound(kind, log_low, log_high, phase_low, phase_high):
    """Lower bound of `objective` for log|L| and arg L within the given ranges."""
    nearest = math.pi * (2 * math.floor((0.5 * (phase_low + phase_high)) / (2 * math.pi)) + 1)
    offset = max(0.0, phase_low - nearest, nearest - phase_high)  # of arg L from the nearest odd multiple of π
    cosine = math.cos(min(offset, math.pi))
    if kind == 1:
        log_low, log_high = -log_high, -log_low
    low, high = math.exp(min(log_low, 300.0)), math.exp(min(log_high, 300.0))
    if kind == 2:
        size = min(max(1.0, low), high)
        if cosine < 0:  # right of the imaginary axis: the farther from unity, the closer to −1
            size = low if low * high < 1 else high
        closeness = cosine * 2 / (size + 1 / size) if size > 0 else 0.0
        return 2 * math.sqrt(max(0.0, 1 - closeness) / (1 + closeness)) if closeness > -1 else math.inf
    magnitude = min(max(cosine, low), high)
    return math.sqrt(max(0.0, 1 + magnitude * magnitude - 2 * magnitude * cosine))


@_jit
def _bounds(kind, width, at_a, at_b, delay, end_a, end_b):
    """Between two nodes, of log|L| (kind 0) or arg L (kind 1): (lowest slope, highest slope, lowest value, highest value)."""
    low = high = 0.0 if kind == 0 else -delay
    for k in range(len(at_a)):
        first, second = at_a[k, kind], at_b[k, kind]
        low += min(first, second)
        high += max(first, second)
    if low >= 0:
        return low, high, end_a, end_b
    if high <= 0:
        return low, high, end_b, end_a
    return low, high, max(end_a + low * width, end_b - high * width), min(end_a + high * width, end_b - low * width)


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
def _jump(low, high, roots, signs, sample_time):
    """Change of arg L across a pair of breakpoints around roots on the boundary, which the contour passes on their right."""
    total = 0.0
    for k in range(len(roots)):
        x, y = roots[k].real, roots[k].imag
        on_axis = abs(x + (x * x + y * y) * sample_time / 2) <= 1e-13 * math.sqrt(x * x + y * y)
        if on_axis and low <= _angle(roots[k], sample_time) <= high:
            total += signs[k] * math.pi
    return total


@_jit
def _half_turns(phase):
    """Number of odd multiples of π below `phase`, up to a constant."""
    return math.floor((phase - math.pi) / (2 * math.pi))


@_jit
def _holds_odd_multiple(low, high):
    """Whether an odd multiple of π lies in [low, high]."""
    return math.floor((high - math.pi) / (2 * math.pi)) >= math.ceil((low - math.pi) / (2 * math.pi))


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
    log_a, gain_count, phase_count, count, spent = _log(value_a), 0, 0, 0, 0
    nodes[0] = a
    for target in range(1, len(ends)):
        top = 0
        stack[0] = ends[target]
        stack_value[0] = evaluate(ends[target], roots, signs, gain, delay, sample_time, at_b[0])
        while top >= 0:
            b, value_b = stack[top], stack_value[top]
            width, log_b = b - a, _log(value_b)
            phase_b, jump = phase + _turn(value_a, value_b), 0.0
            if width <= 8 * _TINY * b:
                jump = _jump(a, b, roots, signs, sample_time)
                if jump != 0.0:
                    phase_b = phase + jump + _wrapped(phase_b - phase - jump)
                    if not seek_peaks:
                        for side in range(2):  # |L| is 0 at a zero and infinite at a pole, however large or small just beside it
                            if ((log_b if side else log_a) > 0) != (jump < 0):
                                gains[gain_count, 0], gains[gain_count, 1] = b if side else a, phase_b if side else phase
                                gain_count += 1
            else:
                steep_low, steep_high, log_low, log_high = _bounds(0, width, at_a, at_b[top], delay, log_a, log_b)
                turn_low, turn_high, phase_low, phase_high = _bounds(1, width, at_a, at_b[top], delay, phase, phase_b)
                undecided = max(-turn_low, turn_high) * width > 2.5
                if seek_peaks:
                    for kind in range(3):
                        undecided = undecided or _objective_bound(kind, log_low, log_high, phase_low, phase_high) < 0.99 * peaks[kind, 1]
                else:
                    undecided = undecided or (steep_low < 0 < steep_high and log_low <= 0 <= log_high)
                    undecided = undecided or (turn_low < 0 < turn_high and _holds_odd_multiple(phase_low, phase_high))
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
                    gains[gain_count, 0], gains[gain_count, 1] = crossing, phase + _turn(value_a, at_crossing)
                    gain_count += 1
                at_end = sample_time > 0 and b == ends[-1] and value_b.real < 0  # listed by the caller, as L(0) < 0 is
                if _half_turns(phase) != _half_turns(phase_b) and not at_end and (a > 0 or value_a.real > 0):
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
        half = _wrapped(phase) / 2  # arg(1 + e^{j phase})
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
    return omega, limit + _wrapped(math.atan2(value.imag, value.real) - limit), start_phase, integrators, scale


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
            if _tail_bound(last, magnitude, roots, signs) < floor:
                break
            certified = doubling < 119
    ends[0] = first
    count = 1 + _breakpoints(roots, sample_time, first, last, ends[1:])
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
