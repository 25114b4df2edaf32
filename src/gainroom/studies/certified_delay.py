"""A state's margins as the core looks at them, with a delay margin near what is required as it is certified."""

from dataclasses import replace

from ..analysis.margin_record import Margins
from ..design.gain_cases import bounded_margins
from ..system.system import StateCase
from .loop_numbers import extra_delay

LATE = 1.5
"""Times what is required: a delay margin below that is certified."""


def with_certified_delay(case: StateCase) -> Margins:
    """bounded_margins, whose delay margin is certified where it is near what is required.

    Of two crossings that are close, as equal limbs have them, samples may see the later one alone; and a share of a tick is not quite a
    phase.
    """
    found, needed = bounded_margins(case), case.system.requirements.delay_margin
    if needed is None or not found.delay_margin < LATE * needed:
        return found
    return replace(found, delay_margin=extra_delay(case.system.loop(case.model)))
