"""Axes of pictures: their ticks and names, which are those that a person would draw."""

import math

import pytest

from gainroom.report.style import log_axis

LOG_AXES = {  # low, high: the ticks, and the names of those that have one
    (0.7, 1.3): ([0.7, 0.8, 0.9, 1, None], ["0.7", "0.8", "0.9", "1"]),
    (3, 9.5): ([3, 4, 5, 6, 7, 8, 9], ["3", "4", "5", "6", "7", "8", "9"]),
    (4, 20): ([4, 5, 6, 7, 8, 9, 10, 20], ["5", "10", "20"]),
    (1, 100): ([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"]),
    (1, 1e4): ([1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000], ["1", "10", "100", "1000", "10000"]),
}


@pytest.mark.parametrize(("low", "high"), LOG_AXES)
@pytest.mark.parametrize("scale", [1.0, 2 * math.pi])
def test_a_logarithmic_axis_has_ticks_where_there_is_room(low, high, scale):
    """Every digit within less than a decade, 1, 2 and 5 beyond that; of more than 3000 powers of ten alone are named."""
    ticks, names = LOG_AXES[low, high]
    ticks = [tick for tick in ticks if tick is not None]
    found = log_axis("", low * scale, high * scale, scale)
    assert found["tickvals"] == pytest.approx([tick * scale for tick in ticks], rel=1e-12)
    assert [name.replace("\u202f", "") for name in found["ticktext"] if name] == names
    assert found["range"] == pytest.approx([math.log10(low * scale), math.log10(high * scale)], rel=1e-12)
