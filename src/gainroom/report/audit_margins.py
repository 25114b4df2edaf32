"""The margins of audited gains beside what is required of them, and those of the gains to use."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from ..studies.audit import Audit
from ..system.requirements import REQUIREMENTS, enough, to_db
from .columns import Column, yes
from .number_format import digits


@dataclass(frozen=True)
class AuditedMargin:
    """One margin, the worst over all states: its `value` in an audit, in its unit, and what is `needed` of it; NaN: nothing is."""

    title: str
    value: Callable[[Audit], float]
    unit: str
    needed: float
    at_most: bool = False

    @property
    def required(self) -> str:
        """As text."""
        return "not required" if math.isnan(self.needed) else f"{'≤' if self.at_most else '≥'} {digits(self.needed, self.unit, 3)}"

    def met(self, found: Audit) -> bool | None:
        """None where nothing is required, or the margin is not known."""
        value = self.value(found)
        if math.isnan(self.needed) or math.isnan(value):
            return None
        return found.stable and (enough(self.needed, value) if self.at_most else enough(value, self.needed))


def margins_of_audit(result: Audit) -> list[AuditedMargin]:
    """What is required first; then phase margin and peak sensitivity where they are not."""
    needed, gain = result.further.needed, to_db(result.margin)
    rows = [
        AuditedMargin("gain margin, all joints together", lambda found: to_db(found.tightest.limit.gain), "dB", gain),
        AuditedMargin("gain margin, one joint by itself", lambda found: to_db(min(joint.gain_limit for joint in found.joints)), "dB", gain),
        AuditedMargin("delay margin", lambda found: 1e3 * found.least_extra_delay, "ms", 1e3 * result.delay_margin),
    ]
    for name in ("phase_margin", "peak_sensitivity"):
        one = REQUIREMENTS[name]
        bound = one.in_unit(needed[name]) if name in needed else math.nan
        rows.append(
            AuditedMargin(
                one.label, lambda found, one=one: one.in_unit(one.value(found.worst[one.name].margins)), one.unit, bound, one.at_most
            )
        )
    return rows


def audited_margins(result: Audit) -> list[Column]:
    """Of AuditedMargin: of the present gains, and of those to use where there are some."""
    step = result.system.control.sample_time
    columns = [
        Column("in continuous time" if step is None else f"at {digits(1e-3 / step, 'kHz', 4)}", "", lambda row: row.title),
        Column("these gains", "", lambda row: digits(row.value(result), row.unit, 3)),
        Column("required", "", lambda row: row.required),
        Column("met", "", lambda row: "" if row.met(result) is None else yes(row.met(result))),
    ]
    if result.ready_to_use is not None:
        use = result.ready_to_use.audited
        columns.append(Column("to use", "", lambda row: digits(row.value(use), row.unit, 3)))
    return columns
