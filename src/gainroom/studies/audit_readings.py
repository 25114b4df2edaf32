"""Audit of ambiguous input: the verdict on which all readings agree, or undecided, with the result of each."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from .audit import Audit, ReadAs, or_none


def least_of(readings: Sequence[ReadAs]) -> Audit:
    """Audit of the reading with the lowest gain limit, with all readings attached; any of them may be the true one."""
    return _read(min((one.audit for one in readings), key=lambda audit: audit.tightest.limit.gain), readings)


def with_drives(host: Audit, drives: Callable[[], ReadAs | None], option: str, meaning: str) -> Audit:
    """Audit of gains on the host, with the reading that they run in the drives attached if the drives can take them and it decides."""
    there = None if host.withheld else or_none(drives)
    return host if there is None or (host.safe and there.audit.safe) else _read(host, (ReadAs(option, meaning, host), there))


def _read(one: Audit, readings: Sequence[ReadAs]) -> Audit:
    """Audit `one` with all readings attached; no verdict if they differ."""
    return replace(one, readings=tuple(readings), open=len({each.audit.verdict.level for each in readings}) > 1)
