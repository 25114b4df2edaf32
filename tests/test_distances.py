"""Distances are shown in the unit that suits them: no thousands of thousandths."""

import pytest

from gainroom.report.number_format import motion, motion_unit


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(2.93, "rad", "2.93 rad"), (-12.0, "rad", "−12 rad"), (0.00402, "rad", "4.02 mrad"), (0.5, "m", "500 mm"), (0.51, "m", "0.51 m")],
)
def test_a_distance_with_its_unit(value: float, unit: str, text: str):
    assert motion(value, unit) == text
    factor, shown = motion_unit(value, unit)
    assert text.endswith(f" {shown}")
    assert abs(factor * value) < 1000
