"""Compiled: a scalar response from its zeros and poles at one frequency, and bounds of it between two.

Used by `_scan.py`, where the method is described.
"""

import math

from .compiled import cached_njit

_jit = cached_njit(error_model="numpy")
TINY = 1e-12  # relative width at which bisection stops, a few thousand times the rounding of a double
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
def angle(root, sample_time):
    """The frequency of the boundary point nearest to a root, in [−π/T_s, π/T_s] or (−∞, ∞)."""
    if sample_time == 0.0:
        return root.imag
    return math.atan2(sample_time * root.imag, 1 + sample_time * root.real) / sample_time


@_jit
def breakpoints(roots, sample_time, low, high, points):
    """Fill `points` with the sorted ω in (low, high) where a slope term may have an extremum or a pole; return their number."""
    count = 0
    period = 2 * math.pi / sample_time if sample_time > 0 else 0.0
    for k in range(len(roots)):
        x, y = roots[k].real, roots[k].imag
        center, spread = angle(roots[k], sample_time), abs(x)
        rate = x + (x * x + y * y) * sample_time / 2
        if sample_time > 0:
            radius = math.sqrt(max(1 + 2 * sample_time * rate, 0.0))  # |z|
            spread = 2 * math.atan(2 * sample_time * abs(rate) / (1 + radius) ** 2) / sample_time
        if abs(rate) <= 1e-13 * math.sqrt(x * x + y * y):  # on the boundary: a pair around it
            spread = 2 * TINY * abs(center)
        for side in range(-1, 2):
            for turn in range(-1, 2):
                point = center + side * spread + turn * period
                if not low < point < high or (turn != 0 and period == 0.0) or (side == 0 and spread == 2 * TINY * abs(center)):
                    continue
                place = count
                while place > 0 and points[place - 1] > point:
                    points[place] = points[place - 1]
                    place -= 1
                points[place] = point
                count += 1
    return count


@_jit
def tail_bound(omega, magnitude, roots, signs):
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
def wrapped(angle):
    """`angle` in (−π, π]."""
    return angle - 2 * math.pi * math.ceil((angle - math.pi) / (2 * math.pi))


@_jit
def log_size(value):
    """log|value|, finite."""
    return math.log(abs(value)) if value != 0 else _LOG_ZERO


@_jit
def turn_between(value_a, value_b):
    """arg(value_b / value_a) in (−π, π]."""
    rotated = value_b * value_a.conjugate()
    return math.atan2(rotated.imag, rotated.real)


@_jit
def objective(kind, value):
    """What each peak minimises: 0: |1+L| (Ms), 1: |1+L|/|L| (Mt), 2: 2|1+L|/|1−L| (disk margin)."""
    below = 1.0 if kind == 0 else abs(value) if kind == 1 else abs(1 - value) / 2
    return abs(1 + value) / below if below > 0 else math.inf


@_jit
def objective_bound(kind, log_low, log_high, phase_low, phase_high):
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
def bounds(kind, width, at_a, at_b, delay, end_a, end_b):
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
def jump_between(low, high, roots, signs, sample_time):
    """Change of arg L across a pair of breakpoints around roots on the boundary, which the contour passes on their right."""
    total = 0.0
    for k in range(len(roots)):
        x, y = roots[k].real, roots[k].imag
        on_axis = abs(x + (x * x + y * y) * sample_time / 2) <= 1e-13 * math.sqrt(x * x + y * y)
        if on_axis and low <= angle(roots[k], sample_time) <= high:
            total += signs[k] * math.pi
    return total


@_jit
def half_turns_below(phase):
    """Number of odd multiples of π below `phase`, up to a constant."""
    return math.floor((phase - math.pi) / (2 * math.pi))


@_jit
def holds_odd_multiple(low, high):
    """Whether an odd multiple of π lies in [low, high]."""
    return math.floor((high - math.pi) / (2 * math.pi)) >= math.ceil((low - math.pi) / (2 * math.pi))
