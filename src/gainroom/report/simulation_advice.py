"""What to do after a simulated run: lower gains where it vibrates or has too little margin, else what helps its tracking."""

import math
from dataclasses import replace

from ..errors import listed, printable
from ..studies.simulation import USUAL, Outcome
from ..system.requirements import REQUIREMENTS
from .page import Advice
from .simulation_text import left_short, unsettled

CALL = "gainroom simulate FILE"


def what_to_do(outcome: Outcome, call: str = CALL, study_call: str = "") -> Advice | None:
    """None where the warnings say it all. `call`: simulates the file's own gains; `study_call`: the command that judges them."""
    more = f"`gainroom {'joint' if outcome.spec.kind != 'mujoco' else 'robot'}`"
    study_call = study_call or f"{more.strip('`')} FILE"
    if not outcome.stable or outcome.missed:
        found, late = _lower(outcome, study_call, call), outcome.stable and unsettled(outcome)
        return replace(found, remarks=[*found.remarks, _tracking(outcome, more)]) if late else found
    if outcome.run.ending == "fell":
        return Advice("Make the move smaller or slower, and simulate again: it is not the gains.")
    if not outcome.sound:
        return None
    if unsettled(outcome):
        return Advice(_tracking(outcome, more))
    if outcome.spec.system.uncertainty.names:
        return Advice("Judge these gains over the file's ranges:", [study_call])
    if outcome.spec.kind == "mujoco":
        return Advice("These gains may stay in this state. Judge them in every state:", [study_call])
    return Advice(f"These gains may stay, as far as this run shows. {more} judges all their margins.")


def _lower(outcome: Outcome, study_call: str, call: str) -> Advice:
    """The command that finds gains, and the factor with which the same run has every margin."""
    factor, every = outcome.gain_to_try, " in every state" if outcome.spec.kind == "mujoco" else ""
    if math.isnan(factor):
        return Advice(
            f"Find gains that meet every requirement{every} (no single factor on all gains was found to be enough):",
            [study_call],
        )
    needed = outcome.spec.system.requirements.needed or {"gain_margin": USUAL}
    margins = listed([f"{(one := REQUIREMENTS[name]).heading} {one.sign} {one.text(value)}" for name, value in needed.items()])
    where = (" in this state" if outcome.spec.kind == "mujoco" else "") + (
        ", at nominal values" if outcome.spec.system.uncertainty.names else ""
    )
    heading = (
        f"Find gains that meet every requirement{every}. To see what lower gains do, repeat this run with all present gains × {factor:g}:"
    )
    lower = f"With these lower gains the linear loop has {margins}{where}."
    return Advice(heading, [study_call, f"{call} --gain {factor:g}"], [lower])


def _tracking(outcome: Outcome, more: str) -> str:
    """What helps the channels that do not settle: gains where an error is left, damping or time where none is."""
    run, late, left = outcome.run, unsettled(outcome), left_short(outcome)
    names = listed([printable(run.channels[k]) for k in left or late]) if len(run.channels) > 1 else ""
    if not left:
        return f"Let {names or 'it'} come to rest: lengthen `scenario.duration`, slow the move, or raise kd as far as {more} allows."
    where = f" in {names}" if names else ""
    helps = "add integral action, or feed-forward of gravity and friction"
    if outcome.missed:
        return f"This run leaves an error{where}. If the new gains do, too, {helps}."
    return f"An error is left{where}: raise kp as far as {more} allows, {helps}."
