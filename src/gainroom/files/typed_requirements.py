"""Requirements as they are typed in options."""

from ..errors import GainroomError, option_name
from ..io.validation import checked, number
from ..system.margin_units import from_db
from ..system.requirements import REQUIREMENTS, Requirements


def margin_factor(decibels: float) -> float:
    """The factor of a gain margin in dB. Raises GainroomError."""
    return from_db(checked("--margin-db", decibels, number(above=0, most=100, unit="dB")))


def delay_of_margin(milliseconds: float | None) -> float | None:
    """A delay margin in ms as it is typed, in s. Raises GainroomError."""
    return None if milliseconds is None else 1e-3 * checked("--delay-margin-ms", milliseconds, number(least=0, most=1000))


def further_requirements(phase_margin_deg: float | None, peak_sensitivity: float | None) -> Requirements:
    """What is required besides, as it is typed. Raises GainroomError, which names the option."""
    typed, values = {"phase_margin": phase_margin_deg, "peak_sensitivity": peak_sensitivity}, {}
    for name, value in typed.items():
        one = REQUIREMENTS[name]
        if value is not None:
            if not one.in_unit(one.low) < value <= one.most:
                raise GainroomError(f"{option_name(one.key)} {value:g}: must be > {one.in_unit(one.low):g} and <= {one.most:g}")
            values[name] = one.in_si(value)
    return Requirements(**values)
