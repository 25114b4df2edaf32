"""Rows that print alike, as those of a left and a right leg do, share one: nothing that a reader could tell apart is lost."""

import pytest

from gainroom.cli.output import render
from gainroom.report.columns import alike_rows, shared_row
from gainroom.report.presentation import TextTable

LEFT = ("left_knee", "no", "98.7", "✗ 22.1°")


@pytest.mark.parametrize(
    ("other", "shares"),
    [
        (("right_knee", "no", "98.7", "✗ 22.1°"), True),
        (("right_knee", "no", "98.71", "✗ 22.1°"), True),  # 0.01 %
        (("right_knee", "no", "98.9", "✗ 22.1°"), False),  # 0.2 %
        (("right_knee", "yes", "98.7", "✗ 22.1°"), False),
        (("right_knee", "no", "98.7", "22.1°"), False),  # not missed
        (("right_knee", "no", "98.7", "✗ 22.1"), False),  # another unit
        (("right_ankle", "no", "98.7", "✗ 22.1°"), False),  # two words differ
        (("knee", "no", "98.7", "✗ 22.1°"), False),
    ],
)
def test_rows_share_one_where_they_print_alike(other: tuple[str, ...], shares: bool):
    rows = [LEFT, other]
    assert alike_rows(rows) == ([[0, 1]] if shares else [[0], [1]])
    if shares:
        assert shared_row(rows, [0, 1]) == ("left/right_knee", *LEFT[1:])


def test_four_legs_share_one_row_and_other_joints_keep_theirs():
    """FL differs from FR in one word, and so does each from each; large numbers have thin spaces."""
    legs = [(f"{leg}_hip", "1\u202f000.5", "7") for leg in ("FL", "FR", "RL", "RR")]
    rows = [*legs[:2], ("head", "1", "7"), *legs[2:]]
    assert alike_rows(rows) == [[0, 1, 3, 4], [2]]
    assert shared_row(rows, [0, 1, 3, 4])[0] == "FL/FR/RL/RR_hip"


def test_what_differs_in_a_column_that_has_no_room_is_no_difference(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")
    rows = [(f"{side}_{'long' * 4}", "12.34", "1.5", value) for side, value in (("left", "1.234567"), ("right", "2.345678"))]
    grid = TextTable("", ["joint", "a", "b", "more"], rows, ["more"]).sharing
    assert len([line for line in render(grid).splitlines() if "12.34" in line]) == 2
    monkeypatch.setenv("COLUMNS", "40")
    assert len([line for line in render(grid).splitlines() if "12.34" in line]) == 1
