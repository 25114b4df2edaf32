"""What to do after a simulated run: lower gains where it vibrates or has too little margin, else what helps its tracking."""

import math

from ..simulation.tracking import SETTLED
from ..studies.simulation import Outcome
from ..system.requirements import REQUIREMENTS
from .margin_columns import requirement
from .page import Html, advice, coded
from .simulation_text import farthest_off, margin_met
from .simulation_text import unsettled as not_settled

USUAL = REQUIREMENTS["gain_margin"].usual or 2.0
"""The gain margin that gains to try have where the file requires none."""


def advice_box(outcome: Outcome) -> Html | str:
    """The box; "" where the warnings say it all."""
    more = f"`gainroom {'joint' if outcome.spec.kind != 'mujoco' else 'robot'}`"
    if not outcome.stable or margin_met(outcome) is False:
        return _lower(outcome, more)
    if outcome.run.ending == "fell":
        return advice("Make the move smaller or slower, and simulate again: it is not the gains.", "")
    if not outcome.sound:
        return ""
    if not_settled(outcome):
        return advice(coded(_tracking(outcome, more)), "")
    return advice(coded(f"These gains may stay, as far as this run shows. {more} judges all their margins."), "")


def _lower(outcome: Outcome, more: str) -> Html:
    """The factor with which the same run has the margin."""
    limit, asked = outcome.limit, outcome.spec.system.requirements
    assert limit is not None
    factor = gain_to_try(outcome)
    if math.isnan(factor):
        return advice(coded(f"No lower gains in the same ratio are known to be stable. {more} recommends gains."), "")
    margin = requirement(asked, "gain_margin", 3).removeprefix("≥ ") or "6 dB"
    here, every = (" in this state", " in every state") if outcome.spec.kind == "mujoco" else ("", "")
    heading = f"Lower all gains together. This factor on the file's gains has {margin} of gain margin{here}; simulate it:"
    return advice(heading, f"--gain {factor:g}", coded(f"{more} recommends gains that meet every requirement{every}."))


def gain_to_try(outcome: Outcome) -> float:
    """The factor on the file's gains, rounded down, at which the linear loop has the required gain margin; NaN where none is known."""
    limit = outcome.limit
    if limit is None or not 0 < limit.gain < math.inf:
        return math.nan
    margin = outcome.spec.system.requirements.needed.get("gain_margin", USUAL)
    factor = outcome.gain * limit.gain / margin
    if factor <= outcome.gain * limit.lower_gain * margin:
        return math.nan
    step = 10.0 ** (math.floor(math.log10(factor)) - 2)
    return float(f"{step * math.floor(factor / step * (1 + 1e-12)):.3g}")


def _tracking(outcome: Outcome, more: str) -> str:
    """What helps the channel that is farthest off: gains where an error is left, damping or time where none is."""
    k = farthest_off(outcome)
    assert k is not None
    found, run = outcome.tracking, outcome.run
    name = run.channels[k] if len(run.channels) > 1 else ""
    band = SETTLED * abs(float(run.reference[-1, k] - run.reference[0, k] + run.error[0, k]))
    if not abs(float(found.steady_state[k])) > band:
        return f"Let {name or 'it'} come to rest: lengthen `scenario.duration`, slow the move, or raise kd as far as {more} allows."
    where = f" in {name}" if name else ""
    return f"An error is left{where}: raise kp as far as {more} allows, add integral action, or compensate the load that holds it off."
