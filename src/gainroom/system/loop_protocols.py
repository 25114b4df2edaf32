"""What a requirement may ask of a loop: its margins, and of coupled loops their curves, sampled or as they move with the gains."""

from typing import Any, Protocol


class MarginRecord(Protocol):
    """Margins that requirements are held against (analysis/margin_record.py)."""

    @property
    def stable(self) -> bool: ...

    @property
    def loops(self) -> tuple[Any, ...]:
        """The loops that they are the margins of, or the worst of; none where one is not known."""
        ...


class Curves(Protocol):
    """Curves of coupled loops, and how they move with the gains (design/margin_slopes.py): what may be asked of them."""

    def at_axis(self, name: str, factor: float) -> Any:
        """Gain margins of about `factor`: loci and return ratios on the negative real axis."""
        ...

    def at_circle(self, name: str, angle: float) -> Any:
        """Phase margins of about `angle` [rad]: loci and return ratios on the unit circle."""
        ...

    def at_delays(self, name: str, longest: float) -> Any:
        """Delay margins of about `longest` [s]: loci that pass −1 with so much delay more."""
        ...

    def at_peaks(self, name: str, ceiling: float, slope: float, offset: float) -> Any:
        """Peaks of |slope S_ii + offset| of about `ceiling`."""
        ...

    def by_differences(self, requirement: Any, needed: float) -> Any:
        """The margin itself, at gains that are a little larger."""
        ...


class Sampled(Protocol):
    """Coupled loops along the stability boundary (analysis/look.py)."""

    def peak(self, slope: float = 1.0, offset: float = 0.0) -> tuple[float, float]:
        """The largest |slope S_ii + offset|, and its frequency [rad/s]."""
        ...

    def delay(self) -> tuple[float, float]:
        """The least extra delay [s] in all loops with which a locus passes −1, and its frequency [rad/s]."""
        ...
