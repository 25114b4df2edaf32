"""The page of a simulation of a joint or a robot: verdict, numbers, curves over time, the vibration, tables, assumptions."""

import math
from dataclasses import replace

import numpy as np

from ..errors import listed
from ..studies.simulation import Outcome
from .number_format import digits, gain_factor, hertz, milli, motion_unit
from .page import Card, Html, Lead, Section, beside, block, facts, page, paragraph, table
from .page_parts import footer
from .simulation_figures import channels, close_up, drawn_channels, in_time
from .simulation_inputs import KINDS, inputs
from .simulation_text import TRACKING, floor_of, not_counted, overshoots, sentence, tracking_cells, unsettled, warnings

SHOWN_AS_ZERO = 1e-3
"""[N·m], and a participation factor: less is shown as 0."""


def simulation_page(outcome: Outcome, command: str) -> str:
    """The report of a run as one HTML page; `command` is the command that makes it."""
    kind, size = KINDS[outcome.spec.kind], len(outcome.run.joint_names)
    sections = [Section("In time", [in_time(outcome)])]
    if outcome.vibrates:
        sections.append(Section("The vibration", [close_up(outcome)]))
    sections += [
        *kind.sections(outcome),
        Section("Channel by channel", _by_channel(outcome)),
        Section("Joints", [_joints(outcome)]),
        Section("Inputs and assumptions", [facts(inputs(outcome)), paragraph(kind.assumptions(outcome))]),
        Section("Command", [block(command)]),
    ]
    what = "one joint" if size == 1 else f"a robot of {size} joints"
    return page(f"gainroom simulate: {what}, {kind.title}", _lead(outcome), _cards(outcome), sections, footer())


def _lead(outcome: Outcome) -> Lead:
    """The verdict with its sentence and warnings."""
    if outcome.sound:
        return Lead(sentence(outcome), "warn" if unsettled(outcome) else "good", "", warnings(outcome))
    verdict = {"fell": "FELL", "diverged": "DIVERGES"}.get(outcome.run.ending, "VIBRATES" if outcome.vibrates else "UNSTABLE")
    what = "this on the robot" if outcome.run.ending == "fell" else "these gains"
    return Lead(sentence(outcome), "bad", f"{verdict}: do not run {what}", warnings(outcome))


def _cards(outcome: Outcome) -> list[Card]:
    run, found, first, hardest = outcome.run, outcome.tracking, outcome.leading[0], int(np.argmax(outcome.torque_peak))
    floor = floor_of(outcome)
    torque = Card(
        "torque peak",
        _digits(float(outcome.torque_peak[hardest]), 3),
        run.torque_units[hardest],
        note=f"{run.joint_names[hardest]}{_beyond(outcome)}",
    )
    others = [torque, _vibration_card(outcome), *_slip_card(outcome)]
    if not outcome.completed:
        what = "falls after" if run.ending == "fell" else "diverges after"
        off = Card("largest error", *_distance(float(found.peak[first]), run.units[first]), note=run.channels[first])
        return [Card(what, digits(outcome.duration, "", 3), "s", "never", met=False), off, *others]
    last, roughest = outcome.worst_at_end, max(outcome.leading, key=lambda k: float(found.rms[k]))
    errors = [
        Card(f"{name} error", *_distance(abs(float(values[k])), run.units[k], floor), note=f"{over}, {run.channels[k]}")
        for name, values, k, over in (
            ("largest", found.peak, first, "over the whole run"),
            ("RMS", found.rms, roughest, "over the whole run"),
            ("steady-state", found.steady_state, last, "mean of the last tenth"),
        )
        if not math.isnan(values[k])
    ]
    if len(others) > 2:  # five cards at most
        rough = " ".join(_distance(float(found.rms[first]), run.units[first], floor))
        errors = [replace(errors[0], note=f"{run.channels[first]}; RMS {rough}"), *errors[2:]]
    return [*errors, *others]


def _distance(value: float, unit: str, floor: float = 1e-9) -> tuple[str, str]:
    """Number and unit of an error [rad, m]; what is below `floor` is 0."""
    factor, shown = motion_unit(value, unit)
    return (milli(value, floor) if factor > 1 else digits(value, significant=3)), shown


def _beyond(outcome: Outcome) -> str:
    """A note where the actual torque passes its limit."""
    return "; above the limit: the current loop overshoots the demand" if overshoots(outcome) else ""


def _vibration_card(outcome: Outcome) -> Card:
    """The simulated vibration, beside what the linear loop predicts."""
    found, limit = outcome.vibration, outcome.limit
    seen = ("none", "") if found is None else (digits(found.frequency / (2 * math.pi), "", 3), "Hz")
    notes = [not_counted(outcome)] if found is not None and not outcome.vibrates else []
    if limit is not None and 0 < limit.gain < math.inf:
        notes.append(f"linear limit: {gain_factor(limit.gain, 3)} × these gains, {hertz(limit.frequency)}")
    asked = "none sustained" if outcome.stable else "none sustained, stable loop"
    return Card("vibration", *seen, requirement=asked, met=outcome.stable and not outcome.vibrates, note="; ".join(notes))


def _slip_card(outcome: Outcome) -> list[Card]:
    """Where feet can slip: the largest displacement of a contact frame from its start."""
    if not len(outcome.slip) or "the ground" not in outcome.spec.effects:
        return []
    worst = int(np.argmax(outcome.slip))
    note = f"{outcome.spec.contact_frames[worst]}: largest displacement, slipped or lifted"
    return [Card("slip of the feet", milli(float(outcome.slip[worst])), "mm", note=note)]


def _by_channel(outcome: Outcome) -> list[Html]:
    run, tracking = outcome.run, _tracking(outcome)
    if len(run.channels) == 1:  # the curves over time show all of it
        return [tracking]
    chosen = drawn_channels(outcome)
    words = (
        "Commanded, measured by the encoders, and true position of the links: encoders on the motor side do not measure the deflection of "
        "elastic gearboxes. All curves start at 0."
    )
    for unit in ("m", "rad"):
        hidden = [k for k in range(len(run.units)) if k not in chosen and run.units[k] == unit]
        if hidden:
            most = max(float(outcome.tracking.peak[k]) for k in hidden)
            words += f" Not drawn: {listed([run.channels[k] for k in hidden])}, error at most {milli(most, floor_of(outcome))} m{unit}."
    return [paragraph(words), beside(*channels(outcome)), tracking]


def _tracking(outcome: Outcome) -> Html:
    run, floor = outcome.run, floor_of(outcome)
    columns = ("channel", "unit", "move", *TRACKING)
    rows = [
        (name, f"m{run.units[k]}", milli(float(np.ptp(run.reference[:, k])), floor), *tracking_cells(outcome, k))
        for k, name in enumerate(run.channels)
    ]
    caption = (
        f"Error: commanded minus true position on the {run.feedback} side; for tasks, minus the position that the encoders give. Steady "
        "state: mean of the last tenth, if the reference is at rest then. Settling time: from when the error stays within 2 % of the move, "
        "for at least a tenth of the run. Overshoot and settling time are those of a move, before any later disturbance."
    )
    return table(columns, rows, caption + ("" if outcome.completed else " The run ended early, without a steady state."))


def _joints(outcome: Outcome) -> Html:
    run, found = outcome.run, outcome.oscillation
    deflection = np.abs(run.motor_position - run.link_position).max(axis=0)
    torques = {"torque peak [N·m]": outcome.torque_peak, "torque RMS [N·m]": outcome.torque_rms}
    caption = f"Torque: actual, of the motor on the joint side{_beyond(outcome)}"
    if run.joint_torque is not None:
        torques["gearbox peak [N·m]"] = np.abs(run.joint_torque).max(axis=0)
        caption += "; gearbox: the torque in its spring, – for rigid gearboxes"
    parts = found.parts if found is not None and outcome.vibrates and found.names == run.joint_names else None
    rows = [
        (
            name,
            *(_digits(float(values[k]), 3) for values in torques.values()),
            *(milli(float(value), floor_of(outcome)) for value in (deflection[k], np.ptp(run.link_position[:, k]))),
            *([] if parts is None else [_digits(abs(complex(parts[k])), 2)]),
        )
        for k, name in enumerate(run.joint_names)
    ]
    caption += "."
    if "N" in run.torque_units:
        caption += " Prismatic joints: N and mm."
    columns = ["joint", *torques, "deflection [mrad]", "range [mrad]"]
    if parts is not None:
        columns.append("participation factor")
        caption += " Participation factor: amplitude of the motor in the vibration, relative to the largest."
    return table(columns, rows, caption)


def _digits(value: float, significant: int) -> str:
    return digits(0.0 if value < SHOWN_AS_ZERO else value, "", significant)
