"""How every bad call is refused."""

from collections.abc import Callable, Sequence
from typing import Any

import pytest

import gainroom as gr


def assert_refused(make: Callable[[], Any], words: Sequence[str]) -> None:
    """`make()` raises GainroomError with one line per problem; every word stands in them."""
    with pytest.raises(gr.GainroomError) as caught:
        make()
    for word in words:
        assert word in str(caught.value)
    assert not any("\n" in problem for problem in caught.value.problems)
