"""Numbers in answers and written files as a person would have typed them."""

ROUND_OFF = 4e-15
"""Relative rounding error of a few products and sums."""


def as_typed(value: float) -> float:
    """Value without the rounding error of a unit conversion and back: 6, not 5.999999999999998, and 43740, not 43740.000000000015.

    A number that is no short one plus round-off stays as it is, to the last bit.
    """
    short = float(f"{value:.12g}")
    return short if abs(short - value) <= ROUND_OFF * abs(value) else value
