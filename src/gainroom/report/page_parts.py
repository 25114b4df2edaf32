"""Parts shared by the pages of a joint and a robot: cards of margins, limits, assumptions."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit
from ..errors import listed
from ..studies.state import State
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import Control, System
from .margin_columns import margin_value, requirement
from .number_format import digits, quantity, rounded_up
from .page import Card, Html, facts, paragraph

ON_TOP = 2
"""Number of warnings shown first; the others are listed with the assumptions."""


def margin_card(asked: Requirements, name: str, value: float, note: str, bounded: float | None = None, label: str = "") -> Card:
    """Card of a margin with its requirement (`name`); a degree sign follows its number.

    value   displayed value: factor, rad, factor
    bounded the judged value, if that is not `value`
    label   the card's name, if not the default
    """
    one = REQUIREMENTS[name]
    unit = "" if one.unit == "°" or not math.isfinite(value) else one.unit
    judged = value if bounded is None else bounded
    met = None if math.isnan(judged) else asked.met(name, judged)  # of what is not known nothing is said to fail
    shown = margin_value(asked, name, value, met, 3).removesuffix(f" {unit}")
    return Card(label or one.label, shown, unit, requirement(asked, name, 3), met, note)


def unstable_card(
    asked: Requirements, limit: GainLimit, where: str, what: str, above: float = math.nan, whose: str = "these gains"
) -> Card:
    """Card of the factor below which unstable gains become stable, or `above` which; the limit's factors are on the gains `whose`.

    `where` ends the note, `what` is the subject that has no stable gains.
    """
    required = requirement(asked, "gain_margin", 3)
    required = f"gain margin {required}" if required else ""
    if 0 < limit.gain < math.inf:
        return Card("stable only below", digits(limit.gain, "", 3), "×", required, False, f"times {whose}{where}")
    if above > 1:
        return Card("stable only above", digits(rounded_up(above), "", 3), "×", required, False, f"times {whose}{where}")
    if math.isnan(limit.gain):
        return Card("stable factor on these gains", "–", "", required, False, "not known")
    return Card("stable factor on these gains", "none", "", required, False, f"no uniform gain reduction makes {what} stable")


def limit_proofs(states: Sequence[State], immobile: Sequence[State]) -> list[tuple[str, str]]:
    """Certification of the limits of several coupled loops, state by state, as facts; `immobile`: states without a verdict."""
    limits = [state.limit for state in states]
    known = [limit.certificate for limit in limits if limit.certificate is not None]
    holding = sum(proof.holds for proof in known)
    pairs = [("verdict", "unstable closed-loop roots counted from the turns of the characteristic loci about −1 (Nyquist), state by state")]
    if known:
        count = "confirmed" if holding == len(known) else "confirmed, the rest NOT"
        words = (
            f"crossings polished to machine precision, roots counted on both sides, at (1 ± {digits(known[0].nudge)}) times each limit: "
        )
        pairs.append(("gain limits", f"{words}{holding} of {len(known)} {count}"))
    if len(known) < len(limits):
        pairs.append(("no limit", f"{len(limits) - len(known)} states have none to confirm; factors up to 1000 were searched"))
    if immobile:
        pairs.append(("no verdict", f"{listed([one.title for one in immobile])}: {immobile[0].reason}, so no loop is closed"))
    return pairs


def assumptions(model: str, control: Control, further: str = "") -> str:
    """Assumptions of a model as text; `model` begins the sentence, `further` ends it."""
    text = (
        f"{model}, small motions: no friction other than viscous, no torque limit, no backlash, no quantisation{further}. The delay is "
        "exact, never approximated by a rational function."
    )
    if control.sampling_in_delay:
        text += " The model is continuous: hold and velocity difference of the loop are part of the delay (drive.delay_includes_sampling)."
    elif control.sample_time is None:
        text += " The model is continuous; a sampled controller is worse by about one more tick of delay."
    return text


def assumed_and_warned(assumed: Sequence[str], further: Sequence[str]) -> list[Html]:
    """Assumptions, and the warnings and notes not shown first."""
    return [*([facts([("assumed", text) for text in assumed])] if assumed else []), *map(paragraph, further)]


def uncertainty_text(system: System) -> str:
    """Ranges of uncertain values as text; for several joints, from the least to the largest."""
    ranges = []
    for name in system.uncertainty.names:
        low, high = map(np.atleast_1d, getattr(system.uncertainty, name))
        finite = np.isfinite(high)
        ranges.append(quantity(name, float(low[finite].min()), float(high[finite].max())) if finite.any() else f"{name}: rigid")
    return ", ".join(ranges) or "none given: every value is taken as exact"


def filters(controller: Any) -> str:
    """Velocity filter, notches and biquads of a controller, as text."""
    low_pass = controller.velocity_filter
    text = (
        "no velocity filter" if low_pass is None else f"velocity filter of order {low_pass.order} at {digits(low_pass.bandwidth, 'rad/s')}"
    )
    text += "".join(f", notch at {digits(notch.frequency, 'rad/s')}" for notch in controller.notches)
    biquads = ((digits(one.zero_frequency, "rad/s"), digits(one.pole_frequency, "rad/s")) for one in controller.biquads)
    return text + "".join(f", biquad with zeros at {zeros} and poles at {poles}" for zeros, poles in biquads)
