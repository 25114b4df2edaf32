"""What to do after a simulated run: lower gains where it vibrates or has too little margin, else what helps its tracking."""

import math
from dataclasses import replace

from ..errors import listed
from ..simulation.tracking import SETTLED
from ..studies.simulation import USUAL, Outcome
from ..system.requirements import REQUIREMENTS
from .simulation_text import farthest_off, unsettled
from .what_to_do import Advice


def what_to_do(outcome: Outcome) -> Advice | None:
    """None where the warnings say it all."""
    more = f"`gainroom {'joint' if outcome.spec.kind != 'mujoco' else 'robot'}`"
    if not outcome.stable or outcome.missed:
        found, late = _lower(outcome, more), outcome.stable and unsettled(outcome)
        return replace(found, remarks=[*found.remarks, _tracking(outcome, more)]) if late else found
    if outcome.run.ending == "fell":
        return Advice("Make the move smaller or slower, and simulate again: it is not the gains.")
    if not outcome.sound:
        return None
    if unsettled(outcome):
        return Advice(_tracking(outcome, more))
    if outcome.spec.system.uncertainty.names:
        return Advice(f"This run is at the file's nominal values. Whether these gains may stay in its ranges, {more} says.")
    return Advice(f"These gains may stay, as far as this run shows. {more} judges all their margins.")


def _lower(outcome: Outcome, more: str) -> Advice:
    """The factor with which the same run has every margin."""
    factor = outcome.gain_to_try
    if math.isnan(factor):
        return Advice(f"Take other gains: no common factor is known that gives these every margin. {more} recommends some.")
    needed = outcome.spec.system.requirements.needed or {"gain_margin": USUAL}
    margins = listed([f"{(one := REQUIREMENTS[name]).heading} {one.sign} {one.text(value)}" for name, value in needed.items()])
    where = (" in this state" if outcome.spec.kind == "mujoco" else "") + (
        ", at nominal values" if outcome.spec.system.uncertainty.names else ""
    )
    heading = f"Lower all gains together. With this factor on the file's gains the linear loop has {margins}{where}; simulate it:"
    every = " in every state" if outcome.spec.kind == "mujoco" else ""
    return Advice(heading, [f"--gain {factor:g}"], [f"{more} recommends gains that meet every requirement{every}."])


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
