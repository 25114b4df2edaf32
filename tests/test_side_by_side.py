"""Searches side by side: what they give, what they raise, and threads as they were before."""

import sys
from collections.abc import Callable

import pytest

from gainroom.design.side_by_side import HANDOVER, Job, side_by_side

Checkpoint = Callable[[], None]


def intervals(checkpoint: Checkpoint) -> list[float]:
    """How quickly threads take turns here, and after jobs within this one."""
    return [sys.getswitchinterval(), *side_by_side([lambda checkpoint: sys.getswitchinterval()] * 2, checkpoint), sys.getswitchinterval()]


def test_threads_take_turns_quickly_only_meanwhile(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda process: {0, 1}, raising=False)
    before = sys.getswitchinterval()
    for found in side_by_side([intervals, intervals], lambda: None):
        assert found == pytest.approx([HANDOVER] * 4)
    assert sys.getswitchinterval() == before


def test_what_the_first_that_fails_raises_ends_the_others():
    def endless(checkpoint: Checkpoint) -> None:
        while True:
            checkpoint()

    def fails(checkpoint: Checkpoint) -> None:
        raise ZeroDivisionError

    before = sys.getswitchinterval()
    jobs: list[Job[None]] = [fails, endless]
    with pytest.raises(ZeroDivisionError):
        side_by_side(jobs, lambda: None)
    assert sys.getswitchinterval() == before
    assert side_by_side([lambda checkpoint, k=k: k for k in range(5)], lambda: None) == list(range(5))
