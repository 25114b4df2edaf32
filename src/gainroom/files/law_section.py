"""Section of a control law in plain numbers: zeros, poles and gain of a transfer function in z, from one sensor to the torque.

Zeros and poles keep the digits that coefficients lose. Near z = 1 a filter of order 14 with poles at 0.95 has a denominator of size
0.05^14 = 6e-19 made of coefficients up to 3432: rounding these to 16 digits leaves none. Its zeros and poles, 0.05 from 1, leave 14.
Coefficients are read, too, as other programs print them, for laws of low order.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from ..errors import GainroomError
from ..io.validation import Refusals, Section, number, refusal, relation
from ..io.yaml_text import shown
from ..system.linear.arrays import Complexes
from ..system.linear.lti import in_v
from ..system.linear.transfer_function import Factored, polynomial_roots

MOST_ROOTS = 1100
"""Most zeros or poles of one law: of a disturbance observer with the longest delay, and some."""
LARGEST = 1e100
REAL = number(least=-LARGEST, most=LARGEST)


def _root(value: object) -> complex:
    """A real number, or [re, im] for the pair re ± j im."""
    if not isinstance(value, list):
        return complex(_real(value))
    if len(value) != 2:
        raise refusal(f"{shown(value)} must be a number, or [re, im] for the pair of re + j im and re − j im")
    real, imaginary = map(_real, value)
    if imaginary <= 0:
        raise refusal(f"{shown(value)}: the second number must be > 0: the pair has one of either sign")
    return complex(real, imaginary)


def _real(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise refusal(f"{shown(value)} is not a number, as zeros, poles and coefficients are")
    return float(value)


Roots = Annotated[list[Annotated[complex, BeforeValidator(_root)]], Field(max_length=MOST_ROOTS)]
Coefficients = Annotated[list[Annotated[float, BeforeValidator(_real)]], Field(min_length=1, max_length=MOST_ROOTS)]
WAYS = (("zeros", "poles", "gain"), ("numerator", "denominator"))


class LawSection(Section):
    """Transfer function in z from what a sensor measures to the torque command, without its sign: u = −Σ K_i(z) y_i."""

    zeros: Roots | None = None
    poles: Roots | None = None
    gain: Annotated[float, BeforeValidator(_real)] | None = None
    numerator: Coefficients | None = Field(None, description="its coefficients, highest power of z first")
    denominator: Coefficients | None = Field(None, description="its coefficients, highest power of z first")

    @classmethod
    def allowed(cls) -> str:
        return "must be a section {zeros, poles, gain} or {numerator, denominator}, in z"

    @relation
    def _one_way(self) -> Refusals:
        given = [any(map(self.is_given, keys)) for keys in WAYS]
        if given[0] == given[1]:
            yield refusal("must have either zeros, poles and gain, or numerator and denominator, in z")
            return
        for key in WAYS[given.index(True)]:
            if not self.is_given(key):
                yield refusal(f"is missing: {'a number' if key == 'gain' else 'a list'}, in z", key=key)

    @relation
    def _can_run(self) -> Refusals:
        if self.is_given("denominator") and self.is_right("denominator") and not any(self.denominator or []):
            yield refusal("must not be 0", key="denominator")
            return
        zeros, poles, _ = self._in_z()
        if len(zeros) > len(poles):
            yield refusal(f"has {len(zeros)} zeros and {len(poles)} poles in z: more zeros than poles would need readings of the future")

    def _in_z(self) -> tuple[Complexes, Complexes, float]:
        """Zeros, poles and gain in z."""
        if self.denominator is None:
            return _both(self.zeros), _both(self.poles), self.gain or 0.0
        if not any(self.numerator or []):
            return _both([]), _both([]), 0.0
        above, below = np.trim_zeros(self.numerator or [], "f"), np.trim_zeros(self.denominator, "f")
        return polynomial_roots(above), polynomial_roots(below), above[0] / below[0]

    def law(self, sample_time: float) -> Factored:
        """Transfer function, sampled every `sample_time` [s]."""
        self.require_right()
        return in_v(*self._in_z(), sample_time)


def _both(roots: list[complex] | None) -> Complexes:
    """Roots with the conjugates of those that stand for a pair."""
    given: Complexes = np.array(roots or [], dtype=complex)
    pairs = given[given.imag > 0]
    return np.concatenate([given[given.imag == 0], pairs, pairs.conj()])


def law_written(law: Factored) -> dict[str, Any]:
    """Section of a sampled transfer function, as LawSection reads it, to 16 digits. Raises GainroomError in continuous time."""
    step = law.sample_time
    if step is None:
        raise GainroomError("a law in continuous time has no zeros and poles in z")

    def listed(roots: Complexes) -> list[Any]:
        in_z = (1 + step * roots[roots.imag >= 0]).tolist()
        return [[one.real, one.imag] if one.imag else one.real for one in in_z]

    late = np.full(round(law.delay / step), -1 / step, dtype=complex)
    poles = np.concatenate([law.poles, late])
    gain = law.gain * step ** (len(law.poles) - len(law.zeros))
    return {"zeros": listed(law.zeros), "poles": listed(poles), "gain": float(gain)}
