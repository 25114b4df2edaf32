"""What a loop must keep of gain, phase and sensitivity."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..errors import GainroomError, margin_in_words

ROUND_OFF = 1e-6
"""Relative: a margin that misses its requirement by no more than this is met. Gains that were set right on a requirement come back with
the round-off of the search and of dB and degrees, below 1e-8; what this grants beyond, 1e-5 dB or 2e-5° of 30°, nobody can measure."""


def enough(value: float, needed: float) -> bool:
    """Whether `value` is at least `needed` but for ROUND_OFF; False for NaN."""
    return bool(value >= needed * (1 - ROUND_OFF))


class Judged(Protocol):
    """Margins that requirements are held against (analysis/margin_record.py)."""

    @property
    def stable(self) -> bool: ...

    def least(self, name: str) -> float:
        """What the requirement `name` bounds; NaN where it is not known."""
        ...


@dataclass(frozen=True)
class Requirements:
    """What a loop must keep; None: not asked for.

    gain_margin       g > 1: any common factor in [1/g, g] on the gains is survived
    phase_margin      φ [rad]: any phase in [−φ, φ] at any gain crossing is survived
    peak_sensitivity  Ms > 1: |1/(1 + L)| stays below
    """

    gain_margin: float | None = None
    phase_margin: float | None = None
    peak_sensitivity: float | None = None

    def __post_init__(self) -> None:
        for name, low, high in (("gain_margin", 1.0, math.inf), ("phase_margin", 0.0, math.pi), ("peak_sensitivity", 1.0, math.inf)):
            value = getattr(self, name)
            number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if value is not None and not (number and low < value < high):
                raise GainroomError(f"requirements: {name} {value!r} must be > {low:g}" + (f" and < {high:.4g}" if high < math.inf else ""))

    @classmethod
    def usual(cls) -> "Requirements":
        """What is asked for where nothing is said: 6 dB, 30°, Ms 2 (Åström and Murray 2021, sec. 12.3)."""
        return cls(gain_margin=10 ** (6 / 20), phase_margin=math.pi / 6, peak_sensitivity=2.0)

    def __str__(self) -> str:
        """In words: "gain margin ≥ 6 dB, phase margin ≥ 30°, Ms ≤ 2"."""
        signs = {"gain_margin": "gain margin ≥", "phase_margin": "phase margin ≥", "peak_sensitivity": "Ms ≤"}
        return ", ".join(f"{signs[name]} {margin_in_words(name, getattr(self, name))}" for name in self.asked) or "stability alone"

    @property
    def asked(self) -> tuple[str, ...]:
        """The names of those that are asked for."""
        return tuple(name for name in ("gain_margin", "phase_margin", "peak_sensitivity") if getattr(self, name) is not None)

    def tightened(self, share: float) -> "Requirements":
        """Each asked for with a `share` of it more; what could then not be asked for at all (Ms below 1, π of phase) halfway there."""
        gain, phase, peak = self.gain_margin, self.phase_margin, self.peak_sensitivity
        return Requirements(
            gain_margin=None if gain is None else gain * (1 + share),
            phase_margin=None if phase is None else min(phase * (1 + share), 0.5 * (phase + math.pi)),
            peak_sensitivity=None if peak is None else max(peak / (1 + share), 0.5 * (1 + peak)),
        )

    def met(self, name: str, value: float) -> bool | None:
        """Whether `value` keeps what is asked for under `name`, but for ROUND_OFF; None where nothing is, False for NaN."""
        needed = getattr(self, name)
        if needed is None:
            return None
        return enough(needed, value) if name == "peak_sensitivity" else enough(value, needed)

    def met_by(self, found: Judged) -> bool:
        """Whether a stable loop meets everything that is asked for."""
        return found.stable and all(self.met(name, found.least(name)) for name in self.asked)

    def missed(self, found: Judged) -> str:
        """The name of what is missed most: a field of Requirements, or "stability"; "" where nothing is."""
        if not found.stable:
            return "stability"
        short = self.shortfalls(found)
        return max((name for name in short if not self.met(name, found.least(name))), key=lambda name: short[name], default="")

    def shortfall(self, found: Judged) -> float:
        """By how much the requirement that is missed most is missed: in ln of a gain or a sensitivity, or as part of a phase.

        Negative where all are met; inf where unstable, or where something is not known.
        """
        worst = max(self.shortfalls(found).values(), default=-math.inf)
        return worst if found.stable else math.inf

    def shortfalls(self, found: Judged) -> dict[str, float]:
        """The same of every requirement."""
        asked = {name: (getattr(self, name), found.least(name)) for name in self.asked}
        short = {
            name: 1 - value / needed
            if name == "phase_margin"
            else (1 if name == "peak_sensitivity" else -1) * (math.log(value) - math.log(needed))
            for name, (needed, value) in asked.items()
        }
        return {name: math.inf if math.isnan(value) else value for name, value in short.items()}
