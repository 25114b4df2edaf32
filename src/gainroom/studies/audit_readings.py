"""An audit of what may be read in two ways: unsafe where it is so in both, else not decided, with what each reading gives."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from .audit import Audit, ReadAs, or_none


def least_of(readings: Sequence[ReadAs]) -> Audit:
    """Of readings of which either may hold: the audit with the least limit, which tells of the others; no verdict but unsafe in all."""
    worst = min((one.audit for one in readings), key=lambda audit: audit.tightest.limit.gain)
    return replace(worst, readings=tuple(readings), open=any(one.audit.safe for one in readings))


def with_drives(host: Audit, drives: Callable[[], ReadAs | None], option: str, meaning: str) -> Audit:
    """An audit of gains that run on the host; where it is unsafe, beside what they are in the drives, if those are known to take them.

    No verdict where it is safe there.
    """
    there = None if host.safe or host.withheld else or_none(drives)
    if there is None:
        return host
    return replace(host, readings=(ReadAs(option, meaning, host), there), open=there.audit.safe)
