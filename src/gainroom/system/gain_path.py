"""Separate path of kd: a velocity gain that closes on the drive at its own rate and delay, while the other gains come over a bus."""

from dataclasses import dataclass
from fractions import Fraction

from ..errors import GainroomError, require_positive

MOST_PARTS = 20
"""Most samples of the slower rate in the common period of both."""
MOST_SAMPLES = 1000
"""Most samples of the faster rate in the common period, which is followed sample by sample."""
EQUAL = 1e-9
"""Relative deviation from a ratio of whole numbers that counts as rounding."""


@dataclass(frozen=True)
class GainPath:
    """Path of kd from measurement to torque.

    delay        [s], in place of the drive's delay, which applies to all other gains
    sample_time  [s], in place of the loop's; velocity is differenced and filtered at this rate
    """

    delay: float
    sample_time: float

    def __post_init__(self) -> None:
        require_positive("kd_path", "delay", self.delay, "s", zero=True)
        require_positive("kd_path", "sample_time", self.sample_time, "s")


def samples_in_common(first: float, second: float) -> tuple[int, int]:
    """Numbers of samples that loops with sample times `first` and `second` [s] take in their common period.

    Raises GainroomError where the ratio of their rates is not one of small whole numbers.
    """
    ratio = Fraction(second / first).limit_denominator(MOST_SAMPLES)
    few, many = sorted((ratio.numerator, ratio.denominator))
    if not 0 < few <= MOST_PARTS or many > MOST_SAMPLES or abs(second / first - float(ratio)) > EQUAL * second / first:
        raise GainroomError(
            f"kd_path: the rates of kd, {1 / second:.10g} Hz, and of the other gains, {1 / first:.10g} Hz, must have a ratio of small "
            f"whole numbers, as 40 or 5/2 (at most {MOST_SAMPLES}/1 and {MOST_PARTS} in the smaller)"
        )
    return ratio.numerator, ratio.denominator
