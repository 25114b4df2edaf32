"""Compiled kernels, brought in only when they pay: numba takes seconds to compile them on a machine's very first use."""

import numpy as np

from ..linear.transfer_function import Factored

_enabled = False


def warmup() -> None:
    """Compile (once per machine) and load the kernels; from then on single loops are scanned by them, some 50 times faster."""
    global _enabled
    _enabled = True
    scan_one(Factored(np.zeros(0, complex), np.array([-1.0 + 0j]), 1.0, 1.0), True)


def scan_one(system: Factored, with_peaks: bool):
    """The Scan of one loop by the compiled kernel; None before `warmup`, and where the kernel cannot certify it."""
    if not _enabled:
        return None
    from . import _scan
    from .crossings import FLOOR, Scan, finished, next_floor

    system = system.reduced
    roots = np.concatenate([system.zeros, system.poles[np.argsort(np.abs(system.poles))]])
    signs = np.ones(len(roots), dtype=np.int64)
    signs[len(system.zeros) :] = -1
    if system.relative_degree == 0 and system.sample_time is None:
        return None  # |L| stays above its gain up to ω = ∞, which the kernel does not follow
    floor = FLOOR
    while True:
        try:
            gains, phases, peaks, half_turns, certified = _scan.scan(
                roots, signs, system.gain, system.delay, system.sample_time or 0.0, floor, with_peaks
            )
        except ZeroDivisionError:  # a sample fell on an undamped resonance; numpy has an infinite response there
            return None
        if not certified:
            return None  # its work space is fixed; numpy goes on where it stops
        lower = next_floor(system, phases, floor)
        if lower is None:
            return finished(system, Scan(gains, phases, peaks, half_turns, certified), with_peaks)
        floor = lower
