"""What a long command says of itself where no bar stands, by a clock that the test turns."""

import threading

import pytest

from gainroom.cli import progress as module
from gainroom.cli.progress import EVERY, Progress, at_rest, duration_text, followed, progress_bar


@pytest.fixture(autouse=True)
def lines_are_due(monkeypatch: pytest.MonkeyPatch):
    """As often as elsewhere: for other tests conftest.py puts them off."""
    monkeypatch.setattr(module, "EVERY", EVERY)


class Clock:
    """Time that passes only while somebody waits."""

    def __init__(self, until: float) -> None:
        self.now, self.until, self.during = 0.0, until, {}

    def __call__(self) -> float:
        return self.now

    def wait(self, seconds: float) -> bool:
        """Whether all is over before `seconds` have passed; what is to happen `during` them happens."""
        end = self.now + seconds
        for at in sorted(time for time in self.during if self.now < time <= min(end, self.until)):
            self.now = at
            self.during.pop(at)()
        self.now = min(end, self.until)
        return self.now >= self.until


def lines_of(clock: Clock, told: Progress) -> list[tuple[float, str]]:
    found: list[tuple[float, str]] = []
    told.follow(clock.wait, lambda line: found.append((clock.now, line)))
    return found


def test_a_run_of_less_than_ten_seconds_says_nothing():
    clock = Clock(9.99)
    told = Progress(clock)
    for second in range(1, 10):
        clock.during[float(second)] = lambda second=second: told.tell("robot:", second, 10, "states")
    assert lines_of(clock, told) == []


def test_one_line_every_ten_seconds_however_often_something_is_told():
    clock = Clock(65.0)
    told = Progress(clock)
    for tenth in range(1, 650):
        clock.during[tenth / 10] = lambda tenth=tenth: told.tell("sweep:", tenth, 650, "")
    found = lines_of(clock, told)
    assert [at for at, _ in found] == [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
    # 650 steps at 10 a second, counted from the first: after 20 s 200 are done, 199 in 19.9 s, and 450 are left
    assert found[1][1] == "gainroom: sweep: 31 % done, 20 s so far, about 45 s left"


def test_silence_is_not_waited_for():
    """The line comes also where the work tells nothing for a minute."""
    clock = Clock(61.0)
    told = Progress(clock)
    clock.during[5.0] = lambda: told.tell("robot:", 1, 4, "stand, double")
    found = lines_of(clock, told)
    assert len(found) == 6
    assert found[-1][1] == "gainroom: robot: stand, double: 25 % done, 1 min 0 s so far"  # nothing was done since: no rate, no time


def test_before_and_after_what_is_counted():
    clock = Clock(31.0)
    told = Progress(clock)
    clock.during[12.0] = lambda: told.tell("audit:", 0, 8, "stand")
    clock.during[15.0] = lambda: told.tell("audit:", 2, 8, "squat")
    clock.during[22.0] = lambda: told.tell("audit:", 0, 0, module.LAST)
    assert [line for _, line in lines_of(clock, told)] == [
        "gainroom: reading the input: 10 s so far",
        "gainroom: audit: squat: 25 % done, 20 s so far, about 24 s left",  # 2 in the 8 s since 12, 6 are left
        "gainroom: audit: preparing the answer and its page: 30 s so far",
    ]


def test_a_count_that_begins_again_has_its_own_rate():
    clock = Clock(21.0)
    told = Progress(clock)
    for at, done in ((1.0, 0), (9.0, 10), (11.0, 0), (19.0, 2)):  # 10 in 8 s; then 2 in the 9 s since 11
        clock.during[at] = lambda done=done: told.tell("audit:", done, 10, "states")
    assert lines_of(clock, told)[1][1] == "gainroom: audit: states: 20 % done, 20 s so far, about 36 s left"


def test_two_counts_in_turns_keep_their_own_rates():
    """States beside a search for gains: each tells how far it is, in whatever order."""
    clock = Clock(11.0)
    told = Progress(clock)
    for at, done, total in ((1.0, 0, 40), (2.0, 0, 6), (6.0, 10, 40), (7.0, 3, 6)):
        clock.during[at] = lambda done=done, total=total: told.tell("robot:", done, total, str(total))
    assert lines_of(clock, told)[0][1] == "gainroom: robot: 6: 50 % done, 10 s so far, about 8 s left"  # 3 in 8 s, 3 are left


def test_all_that_was_expected_is_done_and_the_work_is_not():
    clock = Clock(11.0)
    told = Progress(clock)
    clock.during[1.0] = lambda: told.tell("robot:", 0, 5, "gains")
    clock.during[2.0] = lambda: told.tell("robot:", 5, 5, "gains")
    assert lines_of(clock, told)[0][1] == "gainroom: robot: gains: longer than expected, 10 s so far"  # no "0 s left", which would be false


def test_no_line_while_a_bar_stands():
    clock = Clock(21.0)
    told = Progress(clock)
    told.in_a_bar = True
    clock.during[15.0] = lambda: setattr(told, "in_a_bar", False)
    assert [at for at, _ in lines_of(clock, told)] == [20.0]


def test_a_line_stays_one_line_whatever_a_posture_is_called():
    told = Progress(lambda: 0.0)
    told.tell("robot:", 1, 2, "crouch\nInjected: \x1b[2J")
    assert told.line().isprintable()


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "0 s"), (59.4, "59 s"), (59.6, "1 min 0 s"), (130, "2 min 10 s"), (3599.7, "1 h 0 min"), (11_100, "3 h 5 min")],
)
def test_lengths_of_time(seconds: float, text: str):
    assert duration_text(seconds) == text


def test_what_a_block_tells_is_what_the_command_says(monkeypatch: pytest.MonkeyPatch):
    """`progress_bar`, where standard error is no terminal, speaks to the lines of the command that runs."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: False, raising=False)
    with followed():
        told, over = module._running[-1]
        with progress_bar("verify:") as progress:
            progress(1, 4, "one joint")
            assert told.line().startswith("gainroom: verify: one joint: 25 % done, ")
        assert told.line().startswith("gainroom: verify: preparing the answer and its page: ")
        at_rest()
        assert over.is_set()
    assert not module._running


def test_a_command_leaves_no_thread_behind():
    before = threading.active_count()
    with followed():
        assert threading.active_count() == before + 1
    assert threading.active_count() == before


def test_the_first_line_is_at_ten_seconds():
    assert EVERY == 10.0


def test_the_first_steps_tell_no_time_left():
    """Of 1000 steps 10, 1 %, in 9 s would be 15 minutes, and 40 in 18 s are 8."""
    clock = Clock(21.0)
    told = Progress(clock)
    clock.during[1.0] = lambda: told.tell("robot:", 0, 1000, "gains")
    clock.during[9.0] = lambda: told.tell("robot:", 10, 1000, "gains")
    clock.during[19.0] = lambda: told.tell("robot:", 40, 1000, "gains")
    assert [line for _, line in lines_of(clock, told)] == [
        "gainroom: robot: gains: 1 % done, 10 s so far",
        "gainroom: robot: gains: 4 % done, 20 s so far, about 7 min 36 s left",  # 40 in the 19 s since 1, 960 are left: 456 s
    ]
