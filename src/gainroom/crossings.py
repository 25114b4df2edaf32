"""Every crossing and every peak of scalar responses, certified between the points looked at; many loops at once, in numpy.

L(v) = gain Π(v − zeros)/Π(v − poles) e^{−jωT} is a product, so d log L/dω is a sum of one simple term per root. Between *breakpoints*
(the frequencies where some term has an extremum) each term is monotone, hence its range on an interval is given by its two ends, and
the sum of ranges bounds the slopes of log|L| and arg L on the whole interval. Intervals are bisected until those bounds decide them:
an interval holds no crossing, or the slope has one sign and it holds at most one, which bracketed Newton then polishes; no peak inside
can be more than 1 % above the best one found. Nothing is interpolated, and nothing between two points can be missed; where rounding
stops the bisection, `certified` comes back False.

`_scan.py` holds the same algorithm compiled, for one loop at a time; tests compare the two.
"""

import math
from dataclasses import dataclass

import numpy as np

from .arrays import Booleans, Complexes, Floats, Integers
from .factored import Factored

TINY = 1e-12  # relative width at which bisection stops, a few thousand times the rounding of a double
MAX_ROUNDS = 60  # of bisection
MAX_NODES = 300_000  # of all loops of one call together: bounds memory and time
FLOOR = 1e-3  # in continuous time the walk ends where |L| stays below; lower when no crossing has been found by then
LOWEST_FLOOR = 1e-9


@dataclass(frozen=True)
class Scan:
    """What one loop's response does along the whole stability boundary.

    gains        (g, 2): ω of every |L| = 1, arg L there by continuity from small s > 0
    phases       (p, 3): ω of every arg L = π (mod 2π), |L| there, sign of the phase slope (0 at an end of the boundary)
    peaks        (3, 2): ω and minimum of |1+L|, |1+L|/|L|, 2|1+L|/|1−L|; zeros when not asked for
    half_turns   change of arg(1+L) along the upper half of the contour, divided by π
    certified    False where rounding or the work limit stopped the proof
    """

    gains: Floats
    phases: Floats
    peaks: Floats
    half_turns: float
    certified: bool


@dataclass
class _Batch:
    """m loops with k roots each, padded with pairs that cancel."""

    roots: Complexes  # (m, k)
    signs: Floats  # (m, k): +1 zero, −1 pole, 0 padding
    gain: Floats  # (m,)
    delay: Floats  # (m,)
    sample_time: float  # 0: continuous
    low: Floats  # (m,) where the walk begins
    high: Floats  # (m,) where it ends

    def evaluate(self, owner: Integers, omega: Floats) -> tuple[Complexes, Complexes]:
        """L(jω) and the terms of d log L/dω (len(omega), k), at `omega` of the loops `owner`."""
        if self.sample_time == 0:
            v = 1j * omega
            dv = np.full(len(omega), 1j)
        else:
            rotation = np.exp(0.5j * omega * self.sample_time)
            # (e^{jθ} − 1)/T_s = e^{jθ/2} 2j sin(θ/2)/T_s, without cancellation
            v = rotation * (2j / self.sample_time) * np.sin(0.5 * omega * self.sample_time)
            dv = 1j * rotation * rotation
        distance = v[:, None] - self.roots[owner]
        signs = self.signs[owner]
        factors = np.where(signs > 0, distance, 1.0) / np.where(signs < 0, distance, 1.0)
        value = np.prod(factors, axis=1) * (self.gain[owner] * np.exp(-1j * omega * self.delay[owner]))
        return value, signs * (dv[:, None] / np.where(signs != 0, distance, 1.0))


@dataclass
class _Nodes:
    """Points on the boundary, sorted by loop and frequency."""

    owner: Integers
    omega: Floats
    value: Complexes
    terms: Complexes
    phase: Floats

    def take(self, index: Integers) -> "_Nodes":
        return _Nodes(self.owner[index], self.omega[index], self.value[index], self.terms[index], self.phase[index])

    def merged(self, other: "_Nodes") -> "_Nodes":
        """Both sets of nodes, sorted."""
        joined = [np.concatenate([getattr(self, name), getattr(other, name)]) for name in ("owner", "omega", "value", "terms", "phase")]
        return _Nodes(*joined).take(np.lexsort((joined[1], joined[0])))


def scan_many(loops: list[Factored], with_peaks: bool = True, floor: float = FLOOR) -> list[Scan]:
    """Scan every loop; all must have the same sample time."""
    batch, start_phase, integrators = _prepare(loops, floor)
    nodes, turned = _resolve_turns(batch, _first_nodes(batch))
    _unwrap(batch, nodes, start_phase - integrators * math.pi / 2, integrators == 0)
    nodes, decided = _bisect(batch, nodes, _undecided_crossing)
    decided &= turned
    gains, phases = _crossings(batch, nodes)
    scans = []
    peaks = np.zeros((len(loops), 3, 2))
    if with_peaks:
        peaks, sure = _peaks(batch, nodes)
        decided &= sure
    for m in range(len(loops)):
        own = np.flatnonzero(nodes.owner == m)
        first, last = own[0], own[-1]
        mine = gains[0] == m
        gain_rows = np.stack([gains[1][mine], gains[2][mine]], axis=1)
        outside = bool(integrators[m] > 0 or (integrators[m] == 0 and abs(nodes.value[first]) > 1))
        half_turns = half_encirclements(start_phase[m], outside, batch.sample_time > 0, float(nodes.phase[last]), gain_rows)
        phase_rows = [row for row in zip(*phases, strict=True) if row[0] == m]
        rows = [row[1:] for row in phase_rows]
        if integrators[m] == 0 and nodes.value[first].real < 0:
            rows.insert(0, (0.0, abs(nodes.value[first]), 0.0))
        if batch.sample_time > 0 and nodes.value[last].real < 0:
            rows.append((nodes.omega[last], abs(nodes.value[last]), 0.0))
        phase_table = np.array(rows, dtype=float).reshape(-1, 3)
        if batch.sample_time == 0 and floor > LOWEST_FLOOR and not np.any(phase_table[:, 1] < 1):
            scans.append(scan_many([loops[m]], with_peaks, floor * 1e-3)[0])
            continue
        scans.append(Scan(gain_rows, phase_table, peaks[m], half_turns, bool(decided[m])))
    return scans


def _prepare(loops: list[Factored], floor: float) -> tuple[_Batch, Floats, Integers]:
    """The batch with its ends, arg L at small real s > 0, and the number of integrators of each loop."""
    width = max(len(loop.zeros) + len(loop.poles) for loop in loops)
    roots: Complexes = np.zeros((len(loops), width), dtype=complex)
    signs = np.zeros((len(loops), width))
    for m, loop in enumerate(loops):
        both = np.concatenate([loop.zeros, loop.poles[np.argsort(np.abs(loop.poles))]])
        roots[m, : len(both)] = both
        signs[m, : len(loop.zeros)] = 1
        signs[m, len(loop.zeros) : len(both)] = -1
    sample_time = loops[0].sample_time or 0.0
    gain = np.array([loop.gain for loop in loops])
    delay = np.array([loop.delay for loop in loops])
    batch = _Batch(roots, signs, gain, delay, sample_time, np.zeros(len(loops)), np.zeros(len(loops)))

    present = signs != 0
    at_zero = present & (roots == 0)
    integrators = -np.sum(signs * at_zero, axis=1).astype(int)
    flips = np.sum(present & (roots.imag == 0) & (roots.real > 0), axis=1) + (gain <= 0)
    start_phase = np.where(flips % 2 == 1, math.pi, 0.0)
    scale = np.min(np.where(present & ~at_zero, np.abs(roots), np.inf), axis=1, initial=np.inf)
    scale = np.minimum(scale, np.where(delay > 0, 1 / np.where(delay > 0, delay, 1.0), np.inf))
    plain = np.abs(gain) ** (1 / np.maximum(np.abs(integrators), 1))
    scale = np.where(np.isinf(scale), np.where(plain > 0, plain, 1.0), scale)
    _set_low(batch, scale, integrators)
    _set_high(batch, scale, floor)
    return batch, start_phase, integrators


def _set_low(batch: _Batch, scale: Floats, integrators: Integers) -> None:
    """Begin at ω = 0, or low enough for the integrators (or differentiators) to rule."""
    everyone = np.arange(len(scale))
    low = 1e-3 * scale
    for _ in range(300):
        value, _ = batch.evaluate(everyone, low)
        waiting = ((np.abs(value) > 10) != (integrators > 0)) & (integrators != 0) & (value != 0)
        if not waiting.any():
            break
        low[waiting] /= 4
    batch.low = np.where(integrators == 0, 0.0, low)


def _set_high(batch: _Batch, scale: Floats, floor: float) -> None:
    """End at the Nyquist frequency, or where |L| stays below `floor`."""
    if batch.sample_time > 0:
        batch.high = np.full(len(scale), math.pi / batch.sample_time)
        return
    omega = scale[:, None] * 2.0 ** np.arange(1, 121)
    owner = np.repeat(np.arange(len(scale)), omega.shape[1])
    value, _ = batch.evaluate(owner, omega.ravel())
    # |L| of a loop with as many zeros as poles tends to its gain: there the walk ends once it stays below 1.
    neutral = np.sum(batch.signs, axis=1) == 0
    floors = np.where(neutral, np.maximum(floor, (1 + np.abs(batch.gain)) / 2), floor)
    below = _tail_bound(batch, omega, np.abs(value).reshape(omega.shape)) < floors[:, None]
    first = np.where(below.any(axis=1), np.argmax(below, axis=1), omega.shape[1] - 1)
    batch.high = omega[np.arange(len(scale)), first]


def _tail_bound(batch: _Batch, omega: Floats, magnitude: Floats) -> Floats:
    """Largest |L(jω')| for any ω' >= omega (m, j), continuous time, given |L(jω)| = magnitude (m, j).

    Zeros and as many of the slowest poles are bounded together, as |jω' − root|/ω'; each further pole by its least distance.
    """
    x, y = batch.roots.real[:, None, :], batch.roots.imag[:, None, :]
    signs, size2 = batch.signs[:, None, :], np.abs(batch.roots[:, None, :]) ** 2
    zeros = np.sum(batch.signs > 0, axis=1)[:, None, None]
    paired = np.cumsum(signs < 0, axis=2) <= zeros
    far = omega[:, :, None]
    # |jω' − root|²/ω'² is a convex quadratic in 1/ω', equal to 1 at ω' = ∞ and to `here` at ω
    here = (x**2 + (far - y) ** 2) / far**2
    vertex = (y > 0) & (far * y <= size2)
    least = np.where(vertex, x**2 / np.where(size2 > 0, size2, 1.0), np.minimum(1.0, here))
    nearest = np.where(y > far, x**2, x**2 + (far - y) ** 2) / far**2
    with np.errstate(divide="ignore", invalid="ignore"):
        growth = np.where(signs > 0, np.maximum(1.0, here) / here, np.where(paired, here / least, here / nearest))
        bound = magnitude * np.sqrt(np.prod(np.where(signs != 0, growth, 1.0), axis=2))
    return np.where(np.sum(batch.signs, axis=1)[:, None] <= 0, np.nan_to_num(bound, nan=np.inf), np.inf)


def _centers(batch: _Batch) -> Floats:
    """(m, k) the frequency of the boundary point nearest to each root."""
    if batch.sample_time == 0:
        return batch.roots.imag
    return np.angle(1 + batch.sample_time * batch.roots) / batch.sample_time


def _rates(batch: _Batch) -> tuple[Floats, Booleans]:
    """(m, k) how fast each root grows [1/s], and whether it lies on the boundary."""
    rate = batch.roots.real + np.abs(batch.roots) ** 2 * batch.sample_time / 2
    return rate, np.abs(rate) <= 1e-13 * np.abs(batch.roots)


def _breakpoints(batch: _Batch) -> Floats:
    """(m, p) every ω > 0 where a slope term may have an extremum or a pole; NaN elsewhere. Axis roots give a pair around them."""
    rate, on_axis = _rates(batch)
    center = _centers(batch)
    spread = np.abs(batch.roots.real)
    shifts = np.zeros(1)
    if batch.sample_time > 0:
        radius = np.sqrt(np.maximum(1 + 2 * batch.sample_time * rate, 0.0))  # |z|
        spread = 2 * np.arctan(2 * batch.sample_time * np.abs(rate) / (1 + radius) ** 2) / batch.sample_time
        shifts = np.array([-1.0, 0.0, 1.0]) * 2 * math.pi / batch.sample_time
    spread = np.where(on_axis, 2 * TINY * np.abs(center), spread)
    points = np.stack([center - spread, center + spread, np.where(on_axis, np.nan, center)], axis=-1)[..., None] + shifts
    points = np.where(batch.signs[:, :, None, None] != 0, points, np.nan).reshape(len(batch.gain), -1)
    return np.where(points > 0, points, np.nan)


def _first_nodes(batch: _Batch) -> _Nodes:
    """Both ends, the breakpoints between, and a coarse ladder that saves rounds of bisection."""
    points = _breakpoints(batch)
    inner = (points > batch.low[:, None]) & (points < batch.high[:, None])
    owner, column = np.nonzero(inner)
    everyone = np.arange(len(batch.gain))
    outermost = np.max(np.where(inner, points, 0.0), axis=1)
    ladder = np.minimum(np.maximum(outermost, batch.low)[:, None] * 2.0 ** np.arange(1, 40), batch.high[:, None])
    steps = (ladder < batch.high[:, None]) & (ladder > batch.low[:, None])
    owners = np.concatenate([everyone, everyone, owner, np.nonzero(steps)[0]])
    omega = np.concatenate([batch.low, batch.high, points[owner, column], ladder[steps]])
    order = np.lexsort((omega, owners))
    owners, omega = owners[order], omega[order]
    keep = np.append(True, (np.diff(owners) != 0) | (np.diff(omega) > 0))
    value, terms = batch.evaluate(owners[keep], omega[keep])
    return _Nodes(owners[keep], omega[keep], value, terms, np.zeros(np.count_nonzero(keep)))


def _intervals(nodes: _Nodes) -> Integers:
    """Index of the left node of each interval."""
    return np.flatnonzero(nodes.owner[1:] == nodes.owner[:-1])


def _bounds(batch: _Batch, nodes: _Nodes, left: Integers, part: str) -> tuple[Floats, Floats]:
    """Lowest and highest slope of log|L| (part 'real') or of arg L ('imag') on each interval."""
    first, second = getattr(nodes.terms[left], part), getattr(nodes.terms[left + 1], part)
    low, high = np.minimum(first, second).sum(axis=1), np.maximum(first, second).sum(axis=1)
    if part == "imag":
        low, high = low - batch.delay[nodes.owner[left]], high - batch.delay[nodes.owner[left]]
    return low, high


def _values(width: Floats, end_a: Floats, end_b: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Range of a quantity on each interval from its two ends and its slope's range."""
    lowest = np.maximum(end_a + low * width, end_b - high * width)
    highest = np.minimum(end_a + high * width, end_b - low * width)
    lowest, highest = np.where(low >= 0, end_a, lowest), np.where(low >= 0, end_b, highest)
    return np.where(high <= 0, end_b, lowest), np.where(high <= 0, end_a, highest)


def _is_gap(nodes: _Nodes, left: Integers) -> Booleans:
    """True for the narrow interval around a root on the boundary."""
    return nodes.omega[left + 1] - nodes.omega[left] <= 8 * TINY * nodes.omega[left + 1]


def _middle(low: Floats, high: Floats) -> Floats:
    """Where to bisect: geometric on a wide interval, arithmetic on a narrow one."""
    return np.where((low > 0) & (high > 4 * low), np.sqrt(low * high), 0.5 * (low + high))


def _resolve_turns(batch: _Batch, nodes: _Nodes) -> tuple[_Nodes, Booleans]:
    """Bisect until arg L provably turns by less than π on every interval, so that it can be unwrapped; per loop whether it was reached."""
    decided = np.ones(len(batch.gain), dtype=bool)
    for attempt in range(MAX_ROUNDS):
        left = _intervals(nodes)
        low, high = _bounds(batch, nodes, left, "imag")
        width = nodes.omega[left + 1] - nodes.omega[left]
        split = left[(np.maximum(-low, high) * width > 2.5) & ~_is_gap(nodes, left)]
        if not len(split):
            break
        if attempt == MAX_ROUNDS - 1 or len(nodes.omega) + len(split) > MAX_NODES:
            decided[nodes.owner[split]] = False
            break
        owner, omega = nodes.owner[split], _middle(nodes.omega[split], nodes.omega[split + 1])
        nodes = nodes.merged(_Nodes(owner, omega, *batch.evaluate(owner, omega), np.zeros(len(split))))
    return nodes, decided


def _turn(value_a: Complexes, value_b: Complexes) -> Floats:
    return np.angle(value_b * value_a.conj())


def _unwrap(batch: _Batch, nodes: _Nodes, limit: Floats, exact_start: Booleans) -> None:
    """Fill in arg L by continuity along each loop's nodes, from its limit at ω → 0+."""
    left = _intervals(nodes)
    turn = np.zeros(len(nodes.omega))
    turn[left + 1] = _turn(nodes.value[left], nodes.value[left + 1])
    centers, (_, on_axis) = _centers(batch), _rates(batch)
    for k in left[_is_gap(nodes, left)]:
        m = nodes.owner[k]
        inside = (centers[m] >= nodes.omega[k]) & (centers[m] <= nodes.omega[k + 1]) & on_axis[m] & (batch.roots[m] != 0)
        jump = math.pi * np.sum(batch.signs[m, inside])
        turn[k + 1] = jump + np.angle(np.exp(1j * (turn[k + 1] - jump)))
    first = np.flatnonzero(np.append(True, np.diff(nodes.owner) != 0))
    offset = np.angle(nodes.value[first] * np.exp(-1j * limit))
    turn[first] = limit + np.where(exact_start, 0.0, offset)
    total = np.cumsum(turn)
    before = np.append(0.0, total[first[1:] - 1])
    nodes.phase = total - np.repeat(before, np.diff(np.append(first, len(nodes.omega))))


def _log(value: Complexes) -> Floats:
    return np.log(np.maximum(np.abs(value), 1e-300))


def _half_turns(phase: Floats) -> Floats:
    """Number of odd multiples of π below `phase`, up to a constant."""
    return np.floor((phase - math.pi) / (2 * math.pi))


def _undecided_crossing(batch: _Batch, nodes: _Nodes, left: Integers) -> Booleans:
    """True where an interval may hold a crossing without a slope of one sign."""
    width = nodes.omega[left + 1] - nodes.omega[left]
    steep_low, steep_high = _bounds(batch, nodes, left, "real")
    log_low, log_high = _values(width, _log(nodes.value[left]), _log(nodes.value[left + 1]), steep_low, steep_high)
    turn_low, turn_high = _bounds(batch, nodes, left, "imag")
    phase_low, phase_high = _values(width, nodes.phase[left], nodes.phase[left + 1], turn_low, turn_high)
    odd_multiple = _half_turns(phase_high) >= -_half_turns(-phase_low)
    return ((steep_low < 0) & (steep_high > 0) & (log_low <= 0) & (log_high >= 0)) | ((turn_low < 0) & (turn_high > 0) & odd_multiple)


def _bisect(batch: _Batch, nodes: _Nodes, undecided) -> tuple[_Nodes, Booleans]:
    """Bisect until no interval is undecided: the nodes, and per loop whether that was reached."""
    decided = np.ones(len(batch.gain), dtype=bool)
    fresh = np.ones(len(nodes.omega), dtype=bool)  # only intervals with a new end need another look
    split = np.empty(0, dtype=int)
    for _ in range(MAX_ROUNDS):
        left = _intervals(nodes)
        left = left[fresh[left] | fresh[left + 1]]
        left = left[~_is_gap(nodes, left)]
        split = left[undecided(batch, nodes, left)]
        if not len(split):
            return nodes, decided
        if len(nodes.omega) + len(split) > MAX_NODES:
            break
        owner, omega = nodes.owner[split], _middle(nodes.omega[split], nodes.omega[split + 1])
        value, terms = batch.evaluate(owner, omega)
        added = _Nodes(owner, omega, value, terms, nodes.phase[split] + _turn(nodes.value[split], value))
        order = np.lexsort((np.append(nodes.omega, omega), np.append(nodes.owner, owner)))
        fresh = np.append(np.zeros(len(nodes.omega), dtype=bool), np.ones(len(omega), dtype=bool))[order]
        nodes = nodes.merged(added)
    decided[nodes.owner[split]] = False
    return nodes, decided


def _crossings(batch: _Batch, nodes: _Nodes) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Polished crossings of all loops: (owner, ω, arg L) of |L| = 1, and (owner, ω, |L|, slope sign) of arg L = π (mod 2π)."""
    left = _intervals(nodes)
    left = left[~_is_gap(nodes, left)]
    unity = left[(_log(nodes.value[left]) > 0) != (_log(nodes.value[left + 1]) > 0)]
    omega, value = _polish(batch, nodes, unity, lambda value: _log(value), "real")
    gains = (nodes.owner[unity], omega, nodes.phase[unity] + _turn(nodes.value[unity], value))
    # L < 0 at an end of the boundary is itself a crossing, listed by the caller
    ends = (nodes.omega[left] == 0) & (nodes.value[left].real < 0)
    if batch.sample_time > 0:
        ends |= (nodes.omega[left + 1] == batch.high[nodes.owner[left]]) & (nodes.value[left + 1].real < 0)
    odd = left[(_half_turns(nodes.phase[left]) != _half_turns(nodes.phase[left + 1])) & ~ends]
    omega, value = _polish(batch, nodes, odd, lambda value: np.angle(-value), "imag")
    rising = np.where(nodes.phase[odd + 1] > nodes.phase[odd], 1.0, -1.0)
    return gains, (nodes.owner[odd], omega, np.abs(value), rising)


def _polish(batch: _Batch, nodes: _Nodes, left: Integers, function, part: str) -> tuple[Floats, Complexes]:
    """Roots of a monotone function of L in the intervals `left`, by Newton with bisection as the fallback: (ω, L)."""
    owner, low, high = nodes.owner[left], nodes.omega[left].copy(), nodes.omega[left + 1].copy()
    rising = function(nodes.value[left]) <= 0
    omega = 0.5 * (low + high)
    delay = batch.delay[owner] if part == "imag" else 0.0
    value = np.zeros(len(left), dtype=complex)
    for _ in range(80):
        value, terms = batch.evaluate(owner, omega)
        f, slope = function(value), getattr(terms, part).sum(axis=1) - delay
        below = (f <= 0) == rising
        low, high = np.where(below, omega, low), np.where(below, high, omega)
        step = omega - np.divide(f, slope, out=np.full(len(f), np.inf), where=slope != 0)
        done = (f == 0) | (np.abs(step - omega) <= 1e-15 * omega)
        omega = np.where(done, omega, np.where((step > low) & (step < high), step, 0.5 * (low + high)))
        if done.all():
            break
    return omega, value


def objective(kind: int, value: Complexes) -> Floats:
    """What each peak minimises: 0: |1+L| (Ms), 1: |1+L|/|L| (Mt), 2: 2|1+L|/|1−L| (disk margin)."""
    below = (1.0, np.abs(value), np.abs(1 - value) / 2)[kind]
    return np.divide(np.abs(1 + value), below, out=np.full(len(value), np.inf), where=np.asarray(below) > 0)


def _objective_bound(kind: int, log_low: Floats, log_high: Floats, phase_low: Floats, phase_high: Floats) -> Floats:
    """Lower bound of `objective` for log|L| and arg L within the given ranges."""
    nearest = math.pi * (2 * np.floor((phase_low + phase_high) / (4 * math.pi)) + 1)
    offset = np.maximum(0.0, np.maximum(phase_low - nearest, nearest - phase_high))  # of arg L from the nearest odd multiple of π
    cosine = np.cos(np.minimum(offset, math.pi))
    if kind == 1:
        log_low, log_high = -log_high, -log_low
    low, high = np.exp(np.clip(log_low, -300, 300)), np.exp(np.clip(log_high, -300, 300))
    if kind == 2:
        # left of the imaginary axis |L| nearest to unity is closest to −1; right of it, farthest
        size = np.where(cosine >= 0, np.clip(1.0, low, high), np.where(low * high < 1, low, high))
        closeness = 2 * cosine / (size + 1 / size)
        return 2 * np.sqrt(np.maximum(0.0, 1 - closeness) / np.maximum(1 + closeness, 1e-300))
    magnitude = np.clip(cosine, low, high)
    return np.sqrt(np.maximum(0.0, 1 + magnitude**2 - 2 * magnitude * cosine))


def _peaks(batch: _Batch, nodes: _Nodes) -> tuple[Floats, Booleans]:
    """(m, 3, 2) ω and minimum of each objective, and per loop whether nothing 1 % lower can be hidden."""
    count = len(batch.gain)
    peaks, decided = np.zeros((count, 3, 2)), np.ones(count, dtype=bool)
    for kind in range(3):

        def undecided(batch: _Batch, nodes: _Nodes, left: Integers, kind: int = kind) -> Booleans:
            width = nodes.omega[left + 1] - nodes.omega[left]
            ranges = []
            for part, end_a, end_b in (
                ("real", _log(nodes.value[left]), _log(nodes.value[left + 1])),
                ("imag", nodes.phase[left], nodes.phase[left + 1]),
            ):
                ranges += _values(width, end_a, end_b, *_bounds(batch, nodes, left, part))
            best = np.full(count, np.inf)
            np.minimum.at(best, nodes.owner, objective(kind, nodes.value))
            return _objective_bound(kind, *ranges) < 0.99 * best[nodes.owner[left]]

        nodes, sure = _bisect(batch, nodes, undecided)
        decided &= sure
        lowest = objective(kind, nodes.value)
        order = np.lexsort((lowest, nodes.owner))
        best = order[np.append(True, np.diff(nodes.owner[order]) != 0)]
        peaks[:, kind, 0], peaks[:, kind, 1] = _polish_minimum(batch, kind, nodes.owner[best], nodes.omega[best], lowest[best])
    return peaks, decided


def _polish_minimum(batch: _Batch, kind: int, owner: Integers, omega: Floats, lowest: Floats) -> tuple[Floats, Floats]:
    """The local minimum of an objective next to each `omega`, by steps that grow downhill and shrink at the bottom."""
    step = 0.01 * omega
    for _ in range(200):
        if np.all(np.abs(step) <= 1e-9 * omega):  # the minimum is flat: its value is then good to about 1e-16
            break
        trial = np.maximum(omega + step, 0.5 * omega)  # an infimum at ω → 0 is approached, never passed
        if batch.sample_time > 0:
            trial = np.minimum(trial, math.pi / batch.sample_time)
        value = objective(kind, batch.evaluate(owner, trial)[0])
        better = value < lowest
        omega, lowest = np.where(better, trial, omega), np.where(better, value, lowest)
        step = np.where(better, 1.3 * step, -0.5 * step)
    return omega, lowest


def half_encirclements(start_phase: float, outside: bool, ends_at_boundary: bool, last_phase: float, gains: Floats) -> float:
    """Change of arg(1+L) along the upper half of the contour, divided by π.

    While |L| > 1, arg(1+L) = arg L + arg(1+1/L); while |L| < 1 it cannot turn around. So the gain crossings alone fix it.
    """
    turned, mark = 0.0, start_phase if outside else 0.0
    for phase in gains[:, 1]:
        half = float(np.angle(np.exp(1j * phase))) / 2  # arg(1 + e^{j phase})
        turned += (phase - half if outside else half) - mark
        mark = half if outside else phase - half
        outside = not outside
    end = math.pi * round(last_phase / math.pi) if outside and ends_at_boundary else 0.0
    return (turned + end - mark) / math.pi
