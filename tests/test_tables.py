"""Tables at any width of the terminal: words give way, no number is cut, and what is explained below is what is shown."""

import re

import pytest

from gainroom.cli.output import headings, render, table
from gainroom.report.columns import Column, definitions, units_of

TITLES = ("at 1 kHz", "worst", "required", "met", "at", "posture/contact", "new gains")
NUMBERS = ("−15.25 dB", "≥ 6 dB", "78.21 Hz", "6.021 dB")
LONG = "left_leg_forward_while_right_arm_reaches_over_the_rail/double_support"
WORDS = "RR_hip_joint, RL_hip_joint, FL_hip_joint and FR_hip_joint, standing on three feet with the trunk turned"


def rows(state: str) -> list[tuple[str, ...]]:
    worst, required, at, new = NUMBERS
    return [("gain margin", worst, required, "yes", at, state, new), ("phase margin of one loop", "7.131°", "≥ 30°", "no", "–", state, "")]


@pytest.mark.parametrize("columns", [80, 100, 120])
@pytest.mark.parametrize("state", [LONG, WORDS, LONG * 3, "stand/double"])
def test_no_number_is_cut_however_long_the_names_are(monkeypatch: pytest.MonkeyPatch, columns: int, state: str):
    monkeypatch.setenv("COLUMNS", str(columns))
    text = render(table("", TITLES, rows(state)))
    for number in (*NUMBERS, "7.131°", "≥ 30°"):
        assert re.search(rf"(?<!\S){re.escape(number)}(?!\S)", text), number
    for word in " ".join(TITLES).replace("/", "/ ").split():
        assert word in text
    assert max(map(len, text.splitlines())) <= columns
    if state != "stand/double":  # in pieces, but all there
        assert not [name for name in re.findall(r"\w{9,20}", WORDS) if state == WORDS and name not in text]
        assert "…" not in text


def test_a_state_breaks_behind_its_posture():
    text = render(table("", TITLES, rows("kneeling_very_low/on_three_feet")[:1]))
    (first,) = [line.split() for line in text.splitlines() if "15.25" in line]
    assert first[-3] == "kneeling_very_low/"


@pytest.mark.parametrize("columns", [40, 80])
def test_a_number_is_whole_where_there_is_no_room(monkeypatch: pytest.MonkeyPatch, columns: int):
    """Sixteen columns of a number need more than 80: the lines are longer then."""
    monkeypatch.setenv("COLUMNS", str(columns))
    numbers = [f"{k}.23456" for k in range(10, 26)]
    text = render(table("a title that may be broken", ("", *map(str, range(16))), [(LONG, *numbers)]))
    assert [number for number in numbers if number not in text.split()] == []


def test_columns_are_left_out_before_words_are_broken():
    numbers = [f"{k}.2345" for k in range(10, 17)]
    titles = ("", *(f"c{k}" for k in range(6)), "spare")
    shown = table("", titles, [("a_name_of_twenty_chr", *numbers)], drops=("spare",))
    assert headings(shown) == [*titles[:-1]]
    assert "a_name_of_twenty_chr" in render(shown)


def test_only_columns_that_are_shown_are_explained():
    columns = [Column("a", "", str, definition="one"), Column("b", "", str, definition="two"), Column("", "c", str, definition="three")]
    assert definitions(columns, ["b"]) == "b: two."
    assert definitions(columns, ["a", "b"]) == "a: one; b: two."
    assert units_of(["kp"], {"kp": "N·m/rad", "ki": "N·m/(rad·s)"}) == "kp [N·m/rad]"


def test_a_broken_heading_is_one_heading():
    shown = table("", ("joint", "motor inertia", *map(str, range(9))), [("FL_thigh_joint", "0.003", *9 * ("123.4",))])
    assert headings(shown)[:2] == ["joint", "motor inertia"]
    assert "motor inertia" not in render(shown)
