"""Progress of a long computation."""

from collections.abc import Callable

Progress = Callable[[int, int, str], None]
"""Callback with (done, in all, description of the current or next step)."""


def quiet(done: int, total: int, what: str) -> None:
    """Progress callback that does nothing."""


def after(checkpoint: Callable[[], None], progress: Progress) -> Progress:
    """Progress callback of one of several parallel jobs: `checkpoint` ends the job if another has failed (design/parallel.py)."""

    def report(done: int, total: int, what: str) -> None:
        checkpoint()
        progress(done, total, what)

    return report
