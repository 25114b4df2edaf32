"""Requirements from command-line options."""

import math
from collections.abc import Mapping, Sequence

from ..errors import GainroomError, option_name
from ..io.as_typed import as_typed
from ..io.validation import checked, number
from ..system.margin_units import from_db
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS, Requirements

NONE = "none"
"""Word in place of a number for a limit that is not required."""


def margin_factor(decibels: float) -> float:
    """Factor of a gain margin in dB. Raises GainroomError."""
    return from_db(checked("--margin-db", decibels, number(above=0, most=100, unit="dB")))


def further_requirements(
    delay_margin_ms: float | None, phase_margin_deg: float | None, peak_sensitivity: float | None, named: Sequence[str] = ()
) -> Mapping[str, float | None]:
    """Requirements other than --margin-db by name, in SI; None: not required. `named`: LIMIT=NUMBER or LIMIT=none each.

    Raises GainroomError, which names the option.
    """
    values: dict[str, float | None] = {}
    if delay_margin_ms is not None and checked("--delay-margin-ms", delay_margin_ms, number(least=0, most=1000)) > 0:
        values["delay_margin"] = REQUIREMENTS["delay_margin"].in_si(delay_margin_ms)
    for name, value in (("phase_margin", phase_margin_deg), ("peak_sensitivity", peak_sensitivity)):
        if value is not None:
            values[name] = _in_si(option_name(REQUIREMENTS[name].key), REQUIREMENTS[name], value)
    for text in named:
        limit, _, typed = text.partition("=")
        one = next((one for one in REQUIREMENTS.values() if one.key == limit), None)
        if one is None:
            raise GainroomError(
                f"--require {text}: must be LIMIT=NUMBER or LIMIT=none, with one of {', '.join(one.key for one in REQUIREMENTS.values())}"
            )
        try:
            value = None if typed == NONE else float(typed)
        except ValueError:
            raise GainroomError(f"--require {limit}: {typed!r} must be a number, or {NONE}") from None
        values[one.name] = None if value is None else _in_si(f"--require {limit}", one, value)
    return values


def unusual_limits(asked: Requirements) -> tuple[str, ...]:
    """Limits that an audit does not have by default, and default ones that were not required, each as --require takes it."""
    usual, found = Requirements.usual().needed, list[str]()
    for one, needed in asked.asked_for:
        if one.name not in usual or not math.isclose(needed, usual[one.name], rel_tol=1e-12):  # dB come back off by a digit
            found.append(f"{one.key}={repr(as_typed(one.in_unit(needed))).removesuffix('.0')}")
    return (*found, *(f"{REQUIREMENTS[name].key}={NONE}" for name in usual if name not in asked.needed))


def _in_si(typed: str, one: Requirement, value: float) -> float:
    if not one.in_unit(one.low) < value <= one.most:
        raise GainroomError(f"{typed} {value:g}: must be > {one.in_unit(one.low):g} and <= {one.most:g}")
    return one.in_si(value)
