"""Is the loop stable, and where are its rightmost roots? Exact with the delay in place; never Padé.

Scalar loops: the Nyquist count over certified crossings (crossings.py). Roots, any n: the delay lines of the n delayed channels are
discretised on Chebyshev points (Breda, Maset and Vermiglio 2005) to find candidates, which Newton then polishes on the exact
characteristic matrix M(s) = sI − A + B e^{−sT} C.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import GainroomError, require_count
from ..native import _core
from ..system.linear.arrays import Complexes, Floats
from ..system.linear.transfer_function import growth
from ..system.loop import Loop, require_loop
from .callable_scan import scan_callable, scan_sampled
from .characteristic import RESOLUTION, Characteristic, characteristic, growth_rate
from .core_loop import CoreLoop
from .crossings import Scan, scan
from .multirate import Multirate

SPARE = 10  # candidates for roots that are polished beside twice as many as are asked for
MOST_STATES = 1000  # with discretised delay lines, for a proof of instability, which other means may give as well
INFINITELY_MANY = 10**9


@dataclass(frozen=True)
class Roots:
    """Rightmost closed-loop roots.

    roots       (count,) complex, in s [1/s], largest real part first; sampled loops: ln(z)/T_s
    residuals   (count,) last Newton step relative to |root|: how far each may be off
    lost        candidates near or right of the boundary that could not be confirmed as roots; 0 where all is well
    unmoved     (k,) roots on the boundary that no gain moves, which `roots` leaves out: a joint that drifts, a spring that rings on
    """

    roots: Complexes
    residuals: Floats
    lost: int = 0
    unmoved: Complexes = field(default_factory=lambda: np.zeros(0, dtype=complex))


def scan_loop(loop: Loop, with_peaks: bool = True) -> Scan:
    """All crossings and peaks of a scalar loop: certified from zeros and poles, or sampled adaptively from a callable or a state space."""
    if loop.scalar is not None and loop.scalar.gain == 0:
        return _silent(with_peaks)
    if loop.scalar is not None:
        return scan(loop.scalar, with_peaks)
    if loop.function is not None:
        return scan_callable(loop.response)
    if loop.is_given:
        assert loop.sample_time is not None
        return scan_sampled(loop.response, loop.corner_frequencies.poles, loop.sample_time)
    raise GainroomError(f"a loop of {loop.size} joints has no scalar response; use gain_limit or rightmost_roots")


def _silent(with_peaks: bool) -> Scan:
    """The scan of L = 0: no crossings, and nothing amplified."""
    peaks = np.array([[0.0, 1.0], [0.0, math.inf], [0.0, 2.0]]) if with_peaks else np.zeros((3, 2))
    return Scan(np.empty((0, 2)), np.empty((0, 3)), peaks, 0.0, True)


def unstable_roots(loop: Loop, scan: Scan | None = None) -> int:
    """Number of closed-loop roots right of the imaginary axis (outside the unit circle).

    Those on it count where the gains move them. A motion that no gain moves (a joint without kp drifts, a spring that neither sensor nor
    motor sees rings on) counts only where it grows; without any gain at all, everything on the boundary counts.
    """
    if loop.kd_path is not None:
        return Multirate(loop).unstable()
    if loop.is_given:
        assert loop.given is not None
        closed = loop.given.a - loop.gain * loop.given.b @ loop.given.c
        return int(np.count_nonzero(growth(np.linalg.eigvals(closed), loop.sample_time) >= 0))
    if loop.scalar is None and loop.function is None:
        return _coupled_unstable_roots(loop)
    if _is_lost_at_infinity(loop):
        return INFINITELY_MANY
    if loop.scalar is not None and loop.scalar.gain == 0:
        return int(np.count_nonzero(growth(loop.scalar.poles, loop.sample_time) >= 0))
    scan = scan_loop(loop, with_peaks=False) if scan is None else scan
    if math.isnan(scan.half_turns):
        raise GainroomError("loop: its turns about −1 cannot be computed: look for values that are many orders of magnitude off")
    return int(_core.unstable_roots(scan.gains, scan.phases, scan.half_turns, loop.unstable_poles))


def _coupled_unstable_roots(loop: Loop) -> int:
    """Number of unstable roots of several joints, by the turns of the characteristic loci or, failing that, from the rightmost roots."""
    if not loop.acts:
        assert loop.open_loop is not None
        return int(np.count_nonzero(growth(np.linalg.eigvals(loop.open_loop.a), loop.sample_time) >= 0))
    core = CoreLoop.of(loop)
    count = -1 if core is None else core.unstable()
    if count >= 0:
        return count
    found = rightmost_roots(loop, count=loop.size + 4)
    return int(np.count_nonzero(found.roots.real >= 0)) + found.lost


def _is_lost_at_infinity(loop: Loop) -> bool:
    """True for a delayed continuous loop with |L(∞)| ≥ 1 (a neutral equation: its chain of roots runs off on the right)."""
    system = loop.scalar
    return system is not None and loop.sample_time is None and system.delay > 0 and system.relative_degree == 0 and abs(system.gain) >= 1


def is_stable(loop: Loop) -> bool:
    """True when every closed-loop root decays that the gains move, and none grows that they do not (see unstable_roots)."""
    require_loop("is_stable", loop)
    return not loop.topples and unstable_roots(loop) == 0


def rightmost_roots(loop: Loop, count: int = 6) -> Roots:
    """The `count` rightmost closed-loop roots, polished, with residuals; those that are on the boundary at any gains are listed separately.

    Raises GainroomError for a loop given as a callable: it has no state space.
    """
    require_loop("rightmost_roots", loop)
    require_count("rightmost_roots", "count", count, 1)
    loop.require_one_path("a root in s")
    if loop.open_loop is None:
        raise GainroomError("rightmost_roots needs a loop built with build_loop or from an LTI system, not a callable")
    system = characteristic(loop)
    unmoved = system.unmoved(loop.sample_time)
    apart = _rightmost(unmoved, np.zeros(len(unmoved)), 0, 2 * len(unmoved), loop.sample_time)
    if loop.sample_time is not None or not np.any(system.delays > 0):
        starts = system.without(unmoved, np.linalg.eigvals(system.collocated(0)))
        starts = starts[starts.imag >= 0]
        starts = starts[np.argsort(-growth_rate(starts, loop.sample_time), kind="stable")][: 2 * count + SPARE]
        return replace(_rightmost(*_newton(system, starts, math.inf), count, loop.sample_time), unmoved=apart.roots)
    best: Complexes | None = None
    for nodes in (12, 20, 32, 48, 72, 108):
        starts = system.without(unmoved, _candidates(system, nodes, count))
        found = replace(_rightmost(*_newton(system, starts, 0.3), count, None), unmoved=apart.roots)
        if best is not None and len(best) == len(found.roots) and np.allclose(best, found.roots, rtol=1e-9, atol=1e-9):
            return found
        best = found.roots
    return found


def has_growing_root(loop: Loop) -> bool:
    """True where a polished closed-loop root proves a loop of several joints unstable; False proves nothing."""
    if loop.kd_path is not None:
        return Multirate(loop).unstable() > 0
    system = characteristic(loop)
    plain = loop.sample_time is not None or not np.any(system.delays > 0)
    for nodes in (0,) if plain else (12, 20, 32):
        starts = np.linalg.eigvals(system.collocated(0)) if plain else _candidates(system, nodes, loop.size + 4)
        likely = starts[np.argsort(-growth_rate(starts, loop.sample_time))][: loop.size + 4]
        roots = _newton(system, likely, math.inf if plain else 0.3)[0]
        if np.any(growth_rate(roots, loop.sample_time) > 10 * RESOLUTION * np.abs(system.a).max(initial=1.0)):
            return True
        if len(system.a) + 2 * nodes * loop.size > MOST_STATES:
            break
    return False


def _candidates(system: Characteristic, nodes: int, count: int) -> Complexes:
    """Eigenvalues of the discretised delay lines, rightmost first, upper half plane; more than requested, as some are spurious."""
    values = np.linalg.eigvals(system.collocated(nodes))
    values = values[values.imag >= 0]
    return values[np.argsort(-values.real)][: 2 * count + SPARE]


def _newton(system: Characteristic, starts: Complexes, reach: float) -> tuple[Complexes, Floats, int]:
    """Roots of det M reached from `starts` without leaving their neighbourhood (`reach`, relative), and their last steps.

    Also the number of starts near or right of the boundary from which none was reached: a verdict may not pass over them.
    """
    size = np.abs(system.a).max(initial=1.0)
    roots, residuals, lost = [], [], 0
    for start in starts[starts.imag >= 0]:
        s, step = complex(start), math.inf
        for _ in range(30):
            last = abs(step)
            matrix, slope = system.matrix(s)
            try:
                rate = complex(np.trace(np.linalg.solve(matrix, slope)))
            except np.linalg.LinAlgError:  # exactly singular: s is a root to the last digit
                step = 0.0
            else:
                step = 1 / rate if rate else math.inf  # det M has no slope here: no root is near
            s -= step
            if not np.isfinite(s) or abs(step) <= 1e-15 * abs(s) or last <= min(abs(step), 1e-10 * abs(s)):  # round-off is all that is left
                break
        scale = max(abs(s), abs(start))
        arrived = np.isfinite(s) and abs(step) <= 1e-8 * scale + RESOLUTION * size
        if arrived and abs(s - start) <= reach * scale + 1e-6 * size:
            roots.append(s)
            residuals.append(abs(step) / scale if scale else 0.0)
        elif start.real > -1e-6 * size:
            lost += 1
    return np.array(roots, dtype=complex), np.array(residuals), lost


def _rightmost(roots: Complexes, residuals: Floats, lost: int, count: int, sample_time: float | None) -> Roots:
    """Distinct roots in s with their conjugates, sorted by real part, the first `count`."""
    if sample_time is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            roots = np.log(1 + sample_time * roots) / sample_time
        keep = np.isfinite(roots)
        roots, residuals = roots[keep], residuals[keep]
    order = np.argsort(-roots.real, kind="stable")
    distinct: list[complex] = []
    sizes: list[float] = []
    for root, residual in zip(roots[order], residuals[order], strict=True):
        real = abs(root.imag) <= 1e-9 * abs(root) or (sample_time is not None and abs(root.imag) >= math.pi / sample_time * (1 - 1e-12))
        if any(abs(root - other) <= 1e-9 * abs(root) or abs(root.conjugate() - other) <= 1e-9 * abs(root) for other in distinct):
            continue
        distinct += [root] if real else [root, root.conjugate()]
        sizes += [residual] if real else [residual, residual]
    return Roots(np.array(distinct[:count]), np.array(sizes[:count]), lost)
