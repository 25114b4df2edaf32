"""Protocols between requirements and analysis: margins of a loop, sampled coupled loops, and their curves under changes of gains."""

from typing import Any, Protocol


class MarginRecord(Protocol):
    """Margins that requirements are compared with (analysis/margin_record.py)."""

    @property
    def stable(self) -> bool: ...

    @property
    def loops(self) -> tuple[Any, ...]:
        """Loops that the margins belong to (the worst of each, for several); empty where one is not known."""
        ...


class LoopCurves(Protocol):
    """Curves of coupled loops and their derivatives by the gains (design/margin_slopes.py)."""

    def at_axis(self, name: str, factor: float) -> Any:
        """Gain margins of about `factor`: loci and return ratios on the negative real axis."""
        ...

    def at_circle(self, name: str, angle: float) -> Any:
        """Phase margins of about `angle` [rad]: loci and return ratios on the unit circle."""
        ...

    def at_delays(self, name: str, longest: float) -> Any:
        """Delay margins of about `longest` [s]: loci that pass −1 with an extra delay of that size."""
        ...

    def at_peaks(self, name: str, ceiling: float, slope: float, offset: float) -> Any:
        """Peaks of |slope S_ii + offset| of about `ceiling`."""
        ...

    def at_sway(self, name: str, needed: float) -> Any:
        """Damping ratios of a floating base's sway."""
        ...

    def at_measured(self, requirement: Any, needed: float) -> Any:
        """Quantity that `requirement` computes from the loop itself, at gains near those for which it is known (measured_about)."""
        ...

    def by_differences(self, requirement: Any, needed: float) -> Any:
        """Margin by finite differences, at gains that are a little larger."""
        ...


class SampledLoops(Protocol):
    """Coupled loops sampled along the stability boundary (analysis/loop_samples.py)."""

    def peak(self, slope: float = 1.0, offset: float = 0.0) -> tuple[float, float]:
        """Largest |slope S_ii + offset| over all loops i, S = (I + L)⁻¹ with all loops closed, and its frequency [rad/s]."""
        ...

    def delay(self) -> tuple[float, float]:
        """Least extra delay [s] in all loops for which a locus passes −1, and its frequency [rad/s]."""
        ...
