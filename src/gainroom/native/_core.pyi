"""What bindings/ brings into Python. Arrays are contiguous, and of the type said here: nothing is converted."""

from ..linear.arrays import Complexes, Floats

def scan(
    zeros: Complexes, poles: Complexes, gain: float, delay: float, sample_time: float, with_peaks: bool
) -> tuple[Floats, Floats, Floats, float, bool]: ...
def half_encirclements(start_phase: float, outside: bool, ends_on_boundary: bool, last_phase: float, gains: Floats) -> float: ...
