"""How far something that takes long has come."""

from collections.abc import Callable

Progress = Callable[[int, int, str], None]
"""Called with (done, in all, what is done or comes next)."""


def quiet(done: int, total: int, what: str) -> None:
    """Progress that nobody follows."""


def after(checkpoint: Callable[[], None], progress: Progress) -> Progress:
    """`progress` of a job of several, which ends at its `checkpoint` where another has failed (design/side_by_side.py)."""

    def report(done: int, total: int, what: str) -> None:
        checkpoint()
        progress(done, total, what)

    return report
