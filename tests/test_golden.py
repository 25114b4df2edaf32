"""Golden outputs: the commands say what is recorded; what the comparison takes as the same, and how it tells what is not."""

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from golden import cases
from golden.cases import CASES, Case
from golden.difference import NEAR, Summary, difference
from golden.running import Runner, as_recorded, page_text

RECORDED = Path(__file__).parent / "golden" / "recorded"
QUICK = 6
"""Refused inputs, and other lines without JSON, of which so many run every time, a tenth of a second each."""
AGAIN = "python scripts/golden.py compare shows it whole; python scripts/golden.py record accepts it"
OLD = """\
@@@ $ gainroom joint safe.yaml --json
@@@ exit status 0
@@@ standard output
  {
   "gain_margin_db": 6.0,
   "safe": true,
   "unmet": []
  }
"""


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as found:
        yield found


def assert_as_recorded(runner: Runner, case: Case):
    old = (RECORDED / f"{case.name or 'nothing'}.txt").read_text("utf-8")
    lines = difference(case.name, old, runner.output(case))
    assert not lines, "\n".join([*lines[:60], AGAIN])


def test_a_share_of_the_quick_cases_is_as_recorded(runner: Runner):
    """A joint and some that take no time, drawn with a seed: others when the table grows."""
    draw = random.Random(len(CASES))
    quick = [case for case in (*cases.OTHERS, *cases.REFUSED) if not case.json]
    for case in (*draw.sample(quick, QUICK), draw.choice(cases.JOINTS)):
        assert_as_recorded(runner, case)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_case_is_as_recorded(runner: Runner, name: str):
    assert_as_recorded(runner, CASES[name])


def test_every_case_has_a_recording_and_every_recording_a_case():
    assert {path.stem for path in RECORDED.glob("*.txt")} == set(CASES)


def test_names_of_cases_differ():
    """Of two cases with one name the table would hold one alone."""
    assert len(CASES) == len(cases.EVERY)


def test_numbers_of_json_may_differ_by_round_off_and_nothing_else_may():
    assert not difference("safe", OLD, OLD.replace("6.0", str(6.0 * (1 + NEAR / 2))))
    for new in ("6.00002", "6.1", "null"):
        assert f'+   "gain_margin_db": {new},' in difference("safe", OLD, OLD.replace("6.0", new))
    assert difference("safe", "@@@ $ gainroom\n@@@ standard output\n  6.0000001\n", "@@@ $ gainroom\n@@@ standard output\n  6.0000002\n")


def test_the_summary_counts_by_kind():
    new = OLD.replace("status 0", "status 1").replace("6.0,", "3.0,").replace("true", "false").replace('"unmet": []', '"undecided": []')
    summary = Summary()
    summary.count("safe", OLD, new)
    text = summary.text(2)
    for part in (
        "1 of 2 cases differ",
        "Exit statuses changed: 1\n  safe: 0 → 1",
        "Verdict words changed: 1\n  safe: safe: True → False",
        "gone: 1\n  unmet (1 cases)",
        "added: 1\n  undecided (1 cases)",
        "gain_margin_db: 1 ×, by up to 0.5",
    ):
        assert part in text
    assert Summary().text(2) == "All 2 cases are as recorded."


def test_json_is_sorted_and_rounded():
    assert as_recorded('{"b": [0.123456789, 1e-17], "a": {"c": null}}') == '{\n "a": {\n  "c": null\n },\n "b": [0.12345679, 0.0]\n}'
    assert as_recorded("{no: json}") == "{no: json}"


@pytest.mark.slow
def test_the_text_of_a_page_is_what_is_read():
    page = '<body class="bad"><style>x</style><h1>Not <b>safe</b></h1><script>1</script><table><tr><td>a</td><td>b</td></tr></table></body>'
    assert page_text(page) == "body: bad\nNot safe\n| a | b"
