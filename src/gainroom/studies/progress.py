"""How far something that takes long has come."""

from collections.abc import Callable

Progress = Callable[[int, int, str], None]
"""Called with (done, in all, what is done or comes next)."""


def quiet(done: int, total: int, what: str) -> None:
    """Progress that nobody follows."""
