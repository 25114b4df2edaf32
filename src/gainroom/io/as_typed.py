"""Numbers in answers and written files as a person would have typed them."""


def as_typed(value: float) -> float:
    """Without the round-off of the way to other units and back: 6, not 5.999999999999998, and 43740, not 43740.000000000015."""
    return float(f"{value:.12g}")
