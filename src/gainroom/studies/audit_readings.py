"""An audit of what may be read in two ways: what it is in both, or not decided, with what each reading gives."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from .audit import Audit, ReadAs, or_none


def least_of(readings: Sequence[ReadAs]) -> Audit:
    """The audit of the reading with the lowest gain limit, with all readings attached; any of them may be the true one."""
    return _read(min((one.audit for one in readings), key=lambda audit: audit.tightest.limit.gain), readings)


def with_drives(host: Audit, drives: Callable[[], ReadAs | None], option: str, meaning: str) -> Audit:
    """An audit of gains that run on the host, beside what they are in the drives, if those are known to take them."""
    there = None if host.withheld else or_none(drives)
    return host if there is None or (host.safe and there.audit.safe) else _read(host, (ReadAs(option, meaning, host), there))


def _read(one: Audit, readings: Sequence[ReadAs]) -> Audit:
    """One of the readings with all of them; no verdict where they differ."""
    return replace(one, readings=tuple(readings), open=len({each.audit.verdict.level for each in readings}) > 1)
