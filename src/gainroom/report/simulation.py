"""Page of a simulation of a joint or a robot: verdict, advice, numbers, failures, the whole run; details are folded below."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit
from ..errors import at_frequency, listed
from ..robot.ground import Sole
from ..simulation import Run
from ..simulation.robot_run import RobotRun
from ..simulation.robot_simulation import RobotSimulation
from ..simulation.simulation_spec import JointSimulation
from ..simulation.tracking import SETTLED
from ..studies.oscillation import MUJOCO
from ..studies.simulation import Outcome
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS
from . import joint_tables, style
from .curves import Curve, Panel, stacked
from .number_format import digits, frequency, hertz, milli, motion_unit, span, typed_gains
from .page import Card, Html, Lead, Section, advice_box, beside, facts, figure, page, paragraph, table
from .page_parts import filters, margin_card, unstable_card
from .robot_drawing import WIDTH, drawing_layout
from .robot_skeleton import NAMES_BETWEEN, drawn, ghost, labels, path, view_of
from .robot_tables import angles_text, contacts_text, machine
from .simulation_text import (
    SimulationPresentation,
    farthest_off,
    floor_of,
    left_short,
    not_counted,
    overshoot_of,
    overshoots,
    sentence,
    tracking_cells,
    tracking_headings,
    unsettled,
    warnings,
    whose,
)
from .words import tone

Pair = tuple[str, str]
MOST_TOGETHER = 3  # channels, or joints, in one panel
MOST_CHANNELS = 6  # that have a figure of their own
LARGE_POINTS, SMALL_POINTS = 1200, 400  # of a curve, in a figure of full and of half width
MOST_LINK_TICKS = 1200  # at which true link positions are computed
POSES = 200  # on the path of the centre of mass
ROUNDED = 9  # decimals [m, rad, N m] of what is drawn
CLOSE_PERIODS = 12  # periods of the vibration in its own figure
DIVERGED_RANGE = 3.0  # times the reference's range: a run that diverges is drawn up to it
LEAST_RANGE = 0.01  # [rad, m] of a reference that hardly moves
COLORS = ((style.BLUE, "solid"), (style.VERMILION, "dash"), (style.DARK[style.GREEN], "dashdot"), (style.DARK[style.PURPLE], "longdash"))
TORQUES = ((style.BLACK, "solid"), (style.ORANGE, "dash"), (style.DARK[style.PURPLE], "dashdot"))


def inputs(outcome: Outcome) -> list[Pair]:
    """Inputs of the run, in the units of the file."""
    spec, run = outcome.spec, outcome.run
    ticks = f"{digits(1 / run.sample_time, 'Hz')}, {len(run.time)} rows over {digits(outcome.duration, 's')}"
    return [*KINDS[spec.kind].inputs(outcome), ("ticks", ticks)]


def _joint(outcome: Outcome) -> list[Pair]:
    spec = outcome.spec
    assert isinstance(spec, JointSimulation)
    system, controller = spec.system, spec.system.control.controller
    return [
        *joint_tables.machine(system),
        ("control", f"{typed_gains(controller)}, all × {outcome.gain:g}; {filters(controller)}"),
        *((f"scenario.{key}", text) for key, text in spec.described.items()),
    ]


def _robot(outcome: Outcome) -> list[Pair]:
    simulation = outcome.spec
    assert isinstance(simulation, RobotSimulation)
    system, setup, scenario = simulation.system, simulation.setup, simulation.system.scenario
    posture, contact = scenario.posture or next(iter(system.source.postures)), scenario.contact or next(iter(system.source.contacts))
    size, channels = setup.body.size, zip(outcome.run.channels, simulation.displacement, outcome.run.units, strict=True)
    move = ", ".join(f"{name} {milli(float(by))} m{unit}" for name, by, unit in channels if by)
    footings = ", ".join(f"{one.frame} {math.degrees(one.slope):.3g}°, {milli(one.height, 1e-6)} mm high" for one in simulation.footings)
    return [
        *machine(system),
        ("gains", f"{_gains(simulation)}; all × {outcome.gain:g}"),
        (f"posture {posture}", angles_text(system.source.postures[posture])),
        (f"contact {contact}", f"{contacts_text(setup.contacts)}{_ground(simulation) if setup.contacts else ''}"),
        *([("ground under the feet, slope and height", footings)] if footings else []),
        ("move", f"{move} in {digits(simulation.moves_until, 's')}, quintic, from rest to rest" if move else "none"),
        ("Coulomb friction of the motors", span(np.broadcast_to(setup.coulomb, size), "N·m")),
        ("viscous friction added to the motors", span(np.broadcast_to(scenario.viscous, size), "N·m·s/rad")),
        ("torque limit", _limits(np.broadcast_to(setup.torque_limit, size))),
        ("encoder steps, joint side", digits(1e3 * setup.encoder_step, "mrad", 3) if setup.encoder_step else "none"),
        *(("assumed", text) for text in system.assumptions),
    ]


def _ground(simulation: RobotSimulation) -> str:
    ground = simulation.setup.ground
    if ground is None:
        return "; fixed: they cannot slip or lift"
    feet = [(one, ground.soles.get(one.frame, Sole())) for one in simulation.setup.contacts if one.kind != "point"]
    soles = ", ".join(f"{one.frame} {_sole(sole) if one.kind == 'flat' else f'{sole.width:g} m wide'}" for one, sole in feet)
    return f"; they may slip and lift: friction {ground.friction:g}{', soles ' if soles else ''}{soles}"


def _sole(sole: Sole) -> str:
    centre = f" about ({sole.center[0]:g}, {sole.center[1]:g}) m" if any(sole.center) else ""
    return f"{sole.length:g} m × {sole.width:g} m{centre}"


def _limits(limits: np.ndarray) -> str:
    """Torque limits of the joints that have one, as text."""
    limited = np.isfinite(limits)
    which = "" if limited.all() else f", {int(limited.sum())} of {len(limits)} joints"
    return span(limits[limited], "N·m") + which if limited.any() else "none"


def _gains(simulation: RobotSimulation) -> str:
    """Gains of the file, as text."""
    law = simulation.system.control.controller
    if law is not None:
        return ", ".join(f"{name} {span(np.broadcast_to(getattr(law, name), simulation.setup.body.size))}" for name in law.gain_names())
    tasks = []
    for task in simulation.setup.stack:
        gains = {"kp": task.kp} | ({"kd": task.kd} if task.ki is None else {"kv": task.kd, "ki": task.ki})
        tasks.append(
            f"{task.name}: " + ", ".join(f"{name} {'/'.join(f'{g:g}' for g in np.atleast_1d(value))}" for name, value in gains.items())
        )
    return "; ".join(tasks)


def _linear(outcome: Outcome) -> str:
    return (
        "Linear two-mass joint, stepped exactly from tick to tick: torque held between ticks, velocity by the controller's own difference, "
        "exact delay. No dry friction, gravity, torque limit or encoder steps: the file's scenario adds them."
    )


def _testbed(outcome: Outcome) -> str:
    text = (
        "The same loop on a virtual testbed. Between ticks linear parts are exact; friction and gravity are constant over substeps of "
        "25 µs and create no energy. No backlash, no thermal effects."
    )
    start = (
        " The run starts at rest at the reference and without torque, so gravity first pulls the joint down; peaks and RMS include this."
    )
    return text + (start if "gravity" in outcome.spec.effects else "")


def _mujoco(outcome: Outcome) -> str:
    assert isinstance(outcome.spec, RobotSimulation)
    setup = outcome.spec.setup
    contact = (
        "fixed contacts are constraints that yield by a ten-thousandth"
        if setup.ground is None
        else "the ground force builds up within 2 ms"
    )
    text = (
        "MuJoCo between the controller's ticks, its semi-implicit Euler steps taken as leapfrog steps, so short that the frequency of the "
        f"fastest vibration of the plant is at most 1 % too high. Every elastic joint is a motor behind a spring and a damper; {contact}. "
        "Torques pass the delay and the current loop; no backlash. The controller has an exact model of the links, measures the "
        f"{setup.control.feedback} side of the gearboxes, assumes fixed contacts and compensates gravity; its Jacobians are updated "
        f"every {setup.refresh} ticks."
    )
    if outcome.limit is None:
        return text
    return (
        f"{text} The linear limit is that of small motions about the initial posture with fixed contacts, without this run's Coulomb "
        "friction, torque limit and encoder steps; its viscous friction is included."
    )


def _poses(outcome: Outcome) -> list[Section]:
    assert isinstance(outcome.spec, RobotSimulation)
    assert isinstance(outcome.run, RobotRun)
    return [Section("Initial and final posture", [pose(outcome, outcome.spec, outcome.run)])]


@dataclass(frozen=True)
class Kind:
    """Kind of simulation: title, inputs, assumptions, and page sections of its own."""

    title: str
    inputs: Callable[[Outcome], list[Pair]]
    assumptions: Callable[[Outcome], str]
    sections: Callable[[Outcome], list[Section]] = lambda outcome: []


KINDS = {
    "linear": Kind("linear sampled model", _joint, _linear),
    "testbed": Kind("virtual testbed", _joint, _testbed),
    "mujoco": Kind("MuJoCo", _robot, _mujoco, _poses),
}
"""Kinds of simulation, by SimulationSpec.kind."""


SHOWN_AS_ZERO = 1e-3
"""Torque [N m] or participation factor below which 0 is displayed."""


def simulation_page(shown: SimulationPresentation, command: str) -> str:
    """HTML page of a run; `command`: the command that makes it."""
    outcome = shown.outcome
    kind, size, names = KINDS[outcome.spec.kind], len(outcome.run.joint_names), len(outcome.run.channels)
    fell = outcome.run.ending == "fell"
    sections = [
        *_first(outcome),
        *(Section(one.title, one.parts, "" if fell else "drawn over each other") for one in kind.sections(outcome)),
        Section("Channel by channel", _by_channel(outcome), f"{names} channel{'s' * (names > 1)}: error, overshoot and settling time"),
        Section("Joints", [_joints(outcome)], "torques, deflections and ranges"),
        Section(
            "Inputs and assumptions", [facts(inputs(outcome)), paragraph(kind.assumptions(outcome))], "what was read, and what is left out"
        ),
    ]
    what = "one joint" if size == 1 else f"a robot of {size} joints"
    return page(f"gainroom simulate: {what}, {kind.title}", _lead(shown), _cards(outcome), sections, command)


def _first(outcome: Outcome) -> list[Section]:
    """First sections: the figure of the failure, and the whole run."""
    run, whole, worst = outcome.run, in_time(outcome), farthest_off(outcome)
    if outcome.vibrates:
        assert outcome.oscillation is not None
        what = f"What fails: vibration at {hertz(outcome.oscillation.vibration.frequency)}"
        return [Section(what, [close_up(outcome)]), Section("Over time", [whole])]
    if not outcome.completed:
        return [Section("What fails: the robot falls" if run.ending == "fell" else "What fails: it diverges", [whole])]
    if worst is None:
        return [Section("Over time", [whole])]
    if len(run.channels) == 1:
        return [Section("Over time: not settled within 2 % of the move", [whole])]
    what = f"Over time: {run.channels[worst]}, at the end the farthest from where it was sent"
    return [Section(what, [channel(outcome, worst, links_over_time(outcome))]), Section("Over time: the channels together", [whole])]


def _lead(shown: SimulationPresentation) -> Lead:
    """Lead of the page: verdict with its sentence, warnings and advice."""
    outcome, do = shown.outcome, advice_box(shown.advice)
    if outcome.sound:
        return Lead(sentence(outcome), tone(outcome.verdict), "", warnings(outcome), do)
    verdict = {"fell": "FELL", "diverged": "DIVERGES"}.get(outcome.run.ending, "VIBRATES" if outcome.vibrates else "UNSTABLE")
    what = "this on the robot" if outcome.run.ending == "fell" else "these gains"
    return Lead(sentence(outcome), "bad", f"{verdict}: do not run {what}", warnings(outcome), do)


def _cards(outcome: Outcome) -> list[Card]:
    """Cards of the main numbers, four or five."""
    run, found, hardest = outcome.run, outcome.tracking, int(np.argmax(outcome.torque_peak))
    first, last, floor = outcome.leading[0], outcome.worst_at_end, floor_of(outcome)
    peak = _digits(float(outcome.torque_peak[hardest]), 3)
    torque = Card(
        "torque peak",
        peak,
        run.torque_units[hardest],
        note="; ".join(filter(None, [_named(outcome, run.joint_names[hardest]), _beyond(outcome)])),
    )
    cards = sorted([_vibration_card(outcome), *_margin_cards(outcome)], key=lambda card: card.met is not False)
    if not outcome.completed:
        what = "falls after" if run.ending == "fell" else "diverges after"
        off = Card("largest error", *_distance(float(found.peak[first]), run.units[first]), note=run.channels[first])
        return [Card(what, digits(outcome.duration, "", 3), "s", "never", met=False), *cards, off, torque]
    notes = [_named(outcome, run.channels[first]), "" if math.isnan(found.steady_state[last]) else _at_end(outcome, last)]
    peak = _distance(float(found.peak[first]), run.units[first], floor)
    error = Card("largest error", *peak, note="; ".join(filter(None, notes)))
    return [*cards, *_settling_card(outcome), error, *(_slip_card(outcome) or [torque])]


def _at_end(outcome: Outcome, channel: int) -> str:
    """Note with the steady-state error of a channel, and its name if there are several joints."""
    value = " ".join(_distance(abs(float(outcome.tracking.steady_state[channel])), outcome.run.units[channel], floor_of(outcome)))
    return ", ".join(filter(None, [f"steady-state error {value}", _named(outcome, outcome.run.channels[channel])]))


def _named(outcome: Outcome, name: str) -> str:
    """Name of a channel or joint; "" for a single joint."""
    return name if len(outcome.run.joint_names) > 1 else ""


def _margin_cards(outcome: Outcome) -> list[Card]:
    """Cards of the linear loop: gain margin, and missed requirements."""
    limit, asked = outcome.limit, outcome.spec.system.requirements
    if limit is None or outcome.margins is None:
        return []
    if not limit.stable:
        return [unstable_card(asked, replace(limit, gain=outcome.gain * limit.gain), "", "it", whose=whose(outcome.gain))]
    where = f"linear loop{' in this state' if outcome.spec.kind == 'mujoco' else ''}"
    where += ", nominal" if outcome.spec.system.uncertainty.names else ""
    cards = []
    for name in dict.fromkeys((*outcome.missed, "gain_margin")):
        at = where + at_frequency(REQUIREMENTS[name].frequency(outcome.margins), ", ", hertz)
        cards.append(replace(margin_card(asked, name, REQUIREMENTS[name].value(outcome.margins), at), met=outcome.met(name)))
    return cards


def _settling_card(outcome: Outcome) -> list[Card]:
    """Card of the moved channel that settles last; [] if none was moved."""
    times, over = outcome.tracking.settling_time, outcome.tracking.overshoot
    if np.isnan(times).all():
        return []
    missed, most = unsettled(outcome), int(np.nanargmax(over))
    worst = farthest_off(outcome)
    last = int(np.nanargmax(times)) if worst is None else worst
    value, unit = ("not", "in this run") if math.isinf(times[last]) else (digits(float(times[last]), "", 3), "s")
    names = outcome.run.channels
    notes = [_named(outcome, names[last]) + (f" and {len(missed) - 1} more" if len(missed) > 1 else "")]
    if over[most] > 0:
        share = f"{overshoot_of(outcome)} {digits(100 * float(over[most]), '%', 3)}"
        notes.append(", ".join(filter(None, [share, _named(outcome, names[most])])))
    # No requirement of the file, so neither met nor not: the verdict counts those alone
    return [Card("settles in" if unit == "s" else "settles", value, unit, note="; ".join(["within 2 % of the move", *filter(None, notes)]))]


def _distance(value: float, unit: str, floor: float = 1e-9) -> tuple[str, str]:
    """Number and unit of an error [rad, m]; 0 below `floor`."""
    factor, shown = motion_unit(value, unit)
    return (milli(value, floor) if factor > 1 else digits(value, significant=3)), shown


def _beyond(outcome: Outcome) -> str:
    """Note that the actual torque exceeds the limit of the demand torque; "" otherwise."""
    return "above the limit: the current loop overshoots the demand" if overshoots(outcome) else ""


def _vibration_card(outcome: Outcome) -> Card:
    """Card of the simulated vibration."""
    found = outcome.vibration
    seen = ("none", "") if found is None else (digits(found.frequency / (2 * math.pi), "", 3), "Hz")
    note = not_counted(outcome) if found is not None and not outcome.vibrates else ""
    asked = "none sustained" if outcome.stable else "none sustained, stable loop"
    return Card("vibration", *seen, requirement=asked, met=outcome.stable and not outcome.vibrates, note=note)


def _slip_card(outcome: Outcome) -> list[Card]:
    """Card of the largest displacement of a contact frame from its start; [] if feet cannot slip."""
    if not len(outcome.slip) or "the ground" not in outcome.spec.effects:
        return []
    worst = int(np.argmax(outcome.slip))
    note = f"{outcome.spec.contact_frames[worst]}, the foot that moved most on the ground or off it"
    return [Card("feet moved by", milli(float(outcome.slip[worst])), "mm", note=note)]


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
    columns = ("channel", "unit", "move", *tracking_headings(outcome))
    rows = [
        (name, f"m{run.units[k]}", milli(float(np.ptp(run.reference[:, k])), floor), *tracking_cells(outcome, k))
        for k, name in enumerate(run.channels)
    ]
    caption = (
        f"Error: commanded minus true position on the {run.feedback} side; for tasks, minus the position that the encoders give. Steady "
        "state: mean of the last tenth, if the reference is at rest then. Settling time: from when the error stays within 2 % of the move, "
        f"for at least a tenth of the run. {_of_links(outcome)}Both are those of a move, before any later disturbance."
    )
    return table(columns, rows, caption + ("" if outcome.completed else " The run ended early, without a steady state."))


def _joints(outcome: Outcome) -> Html:
    run, found = outcome.run, outcome.oscillation
    deflection = np.abs(run.motor_position - run.link_position).max(axis=0)
    torques = {"torque peak [N·m]": outcome.torque_peak, "torque RMS [N·m]": outcome.torque_rms}
    caption = "; ".join(filter(None, ["Torque: actual, of the motor on the joint side", _beyond(outcome)]))
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


def _of_links(outcome: Outcome) -> str:
    """Sentence that names the side, link or motor, of the overshoot in the table."""
    if outcome.run.links is None:
        return f"Overshoot: of the {outcome.run.feedback} side. "
    return "Overshoot: of the link over where it comes to rest, about which it also has to stay within 2 % to be settled. "


def _fed_back(outcome: Outcome) -> str:
    """Statement of the side that the controller measures."""
    feedback = outcome.spec.system.control.feedback
    return f"{feedback.where} {'are' if feedback.mixed else 'is'} fed back"


def _whose_position(outcome: Outcome) -> str:
    """Sentence that names the side, link or motor, whose position the figures of the channels show."""
    if len(outcome.run.joint_names) == 1:
        return "Thick: the link; thin: the motor. "
    side = "of the links" if outcome.run.links is not None else f"from the encoders on the {outcome.run.feedback} side"
    return f"Position: {side}. "


def _digits(value: float, significant: int) -> str:
    return digits(0.0 if value < SHOWN_AS_ZERO else value, "", significant)


def shown_ticks(reference: Floats, error: Floats) -> int:
    """Number of ticks of a diverging run, (k, n) each, to be drawn: those within DIVERGED_RANGE."""
    covered = np.vstack([reference[:1] - error[:1], reference])  # from where it starts: a step at t = 0 alone is a constant
    widest = DIVERGED_RANGE * max(float(np.ptp(covered, axis=0).max()), LEAST_RANGE)
    far = np.abs(error).max(axis=1) > widest
    return max(2, min(len(far), int(np.argmax(far)) + 1)) if far.any() else len(far)


def _shown(outcome: Outcome) -> int:
    """Number of ticks drawn: all, or for a diverging run those within DIVERGED_RANGE."""
    run, chosen = outcome.run, list(outcome.leading)
    return shown_ticks(run.reference[:, chosen], run.error[:, chosen]) if run.diverged else len(run.time)


def in_time(outcome: Outcome) -> Html:
    """Figure of the leading channels, their errors, and the largest joint torques; for a single joint both sides, and its target torque."""
    run, end = outcome.run, _shown(outcome)
    chosen, unit = sorted(outcome.leading[:MOST_TOGETHER]), run.units[outcome.leading[0]]
    scale, rows = _scale(outcome, chosen[0]), slice(0, end)
    looks = list(zip(COLORS, chosen, strict=False))
    if len(run.joint_names) == 1:
        move = [
            Curve(side, scale * _change(values[rows, 0]), color, dash, width=width)
            for side, values, color, dash, width in _both_sides(outcome)
        ]
    else:
        seen = run.measured if run.links is None else run.links
        move = [Curve(run.channels[k], scale * _change(seen[rows, k]), color, width=style.LINK) for (color, _), k in looks]
    dots = [style.BLACK] if len(looks) == 1 else [color for (color, _), _ in looks]  # of several its own, to be told apart
    move += [
        Curve("commanded", scale * _commanded(outcome, k)[rows], color, "dot", k == chosen[-1])
        for color, (_, k) in zip(dots, looks, strict=True)
    ]
    error = [Curve(run.channels[k], 1e3 * np.round(run.error[rows, k], ROUNDED), color, named=False) for (color, _), k in looks]
    if len(run.joint_names) == 1:
        error = [
            Curve(side, 1e3 * np.round((run.reference - values)[rows, 0], ROUNDED), color, dash, False, width)
            for side, values, color, dash, width in _both_sides(outcome)
        ]
    hardest = np.argsort(-np.abs(run.actual_torque[rows]).max(axis=0), kind="stable")[:MOST_TOGETHER].tolist()
    moving = outcome.spec.moves_until > 0 or not np.isnan(outcome.tracking.settling_time).all()  # a step at once has moved by then
    panels = [
        Panel("position" if moving else "drift", "rad" if scale == 1 else f"m{unit}", move, 0.42),
        Panel("error", f"m{unit}", error, 0.27),
        Panel("torque", " or ".join(dict.fromkeys(run.torque_units[k] for k in hardest)), _torques(outcome, rows, hardest), 0.31),
    ]
    band = _settled_band(outcome, chosen[0]) if len(chosen) == 1 else []
    notes = [_vibration_note(outcome)] if outcome.vibrates else []
    if run.ending == "fell":
        place = {"xref": "x domain", "yref": "y domain", "xanchor": "right", "yanchor": "top"}
        notes.append(style.label(0.99, 0.995, f"<b>fell after {digits(outcome.duration, 's', 3)}</b>", style.VERMILION, **place))
    most = f"{len(chosen)} of {len(outcome.leading)} channels, those with the largest errors"
    what = most if len(outcome.leading) > len(chosen) else "Moving channels" if moving else "All channels"
    caption = (
        f"{what}; all curves start at 0. {_whose_position(outcome)}Error: commanded minus actual position"
        f"{'' if len(run.joint_names) == 1 else f' on the {run.feedback} side'}; {_fed_back(outcome)}. Torque at "
        "the ticks, of the joints with the largest. "
        + (BAND if band else "")
        + (f"Cut at {digits(run.time[end - 1], 's', 3)}, beyond the range of the figure. " if end < len(run.time) else "")
        + _conclusion(outcome)
    ).rstrip()
    return stacked(run.time[rows], panels, "Commanded and actual, tracking error, torque", caption, 640, notes, LARGE_POINTS, band)


BAND = "Green: within 2 % of the move, where it is settled. "


def _settled_band(outcome: Outcome, channel: int) -> list[dict[str, Any]]:
    """Settling band around an error of 0, in the second panel; [] if no move is judged."""
    if math.isnan(outcome.tracking.settling_time[channel]):
        return []
    wide = (
        1e3 * SETTLED * abs(float(outcome.run.reference[-1, channel] - outcome.run.reference[0, channel] + outcome.run.error[0, channel]))
    )
    band = style.stretch(0, 1, style.GREEN, 0.2) | {"xref": "x domain", "yref": "y2", "y0": -wide, "y1": wide}
    return [band] if wide > 0 else []


Side = tuple[str, Floats, str, str, float]
"""Positions (k, 1) of motor or link with name, colour, dash and width."""


def _both_sides(outcome: Outcome) -> list[Side]:
    """Motor, thin, and link, thick, of a single joint."""
    run = outcome.run
    return [
        ("motor", run.motor_position, style.BLUE, "solid", style.MOTOR),
        ("link", run.link_position, style.VERMILION, "solid", style.LINK),
    ]


def _torques(outcome: Outcome, rows: slice, joints: list[int]) -> list[Curve]:
    """Curves of the actual torques; for a single joint the target too."""
    run = outcome.run
    curves = [
        Curve(run.joint_names[k], np.round(run.actual_torque[rows, k], ROUNDED), *look) for look, k in zip(TORQUES, joints, strict=False)
    ]
    return curves if len(run.joint_names) > 1 else [Curve("target torque", run.target_torque[rows, 0], *TORQUES[1]), *curves]


def _commanded(outcome: Outcome, channel: int) -> Floats:
    """Reference relative to the initial position, which shows a step at t = 0."""
    run = outcome.run
    return np.round(run.reference[:, channel] - run.reference[0, channel] + run.error[0, channel], ROUNDED)


def _change(values: Floats) -> Floats:
    """Values relative to the start, rounded, since round-off would fill a figure in which nothing moves."""
    return np.round(values - values[0], ROUNDED)


def _scale(outcome: Outcome, channel: int) -> float:
    """Factor from SI to the unit of the axis: 1 (rad) for a joint that moves by more than LARGE rad, 1e3 (mrad, mm) otherwise."""
    run = outcome.run
    extent = max(float(np.ptp(values[:, channel])) for values in (run.reference, run.measured))
    return motion_unit(extent)[0] if run.units[channel] == "rad" else 1e3


def _vibration_note(outcome: Outcome) -> style.Annotation:
    """Label of the vibration frequency, at the top of a figure."""
    assert outcome.vibration is not None
    omega = outcome.vibration.frequency
    words = f"<b>vibrates at {hertz(omega)}</b> ({digits(omega, 'rad/s')})"
    return style.label(0.01, 0.995, words, style.VERMILION, xref="x domain", yref="y domain", xanchor="left", yanchor="top")


def _conclusion(outcome: Outcome) -> str:
    if outcome.run.ending == "fell":
        return "The run ends when the base has sunk by half its height or tilted by 0.5 rad."
    if outcome.run.diverged:
        return "These gains must not be run."
    if outcome.oscillation is not None and outcome.vibrates:
        how = "It vibrates while it moves, as above" if outcome.oscillation.moving else "The vibration does not decay"
        return f"{how}: lower all gains together, or shorten the delay."
    if outcome.hidden:
        return "These gains are unstable, whatever hides it here: lower all of them together, or shorten the delay."
    return _left_over(outcome)


def _left_over(outcome: Outcome) -> str:
    """Sentence on the tracking error left at the end of a run without vibration, with its likely causes; "" if none is left.

    The motion has stopped where over the last tenth it changes by no more than 2 % of that error.
    """
    left, run = left_short(outcome), outcome.run
    if not left:
        return ""
    tail = run.measured[-max(2, len(run.measured) // 10) :, left]
    if np.any(np.ptp(tail, axis=0) > SETTLED * np.abs(outcome.tracking.steady_state[left])):
        return "An error remains, and the motion has not stopped."
    causes = [name for name in ("friction", "gravity") if name in outcome.spec.effects]
    return f"Motion has stopped; {listed(causes, 'or')} may explain the remaining error." if causes else "Motion has stopped with an error."


def close_up(outcome: Outcome) -> Html:
    """Figure of the last periods of the vibration, motors without mean and slope, and torques: of the main joints.

    Of one joint both sides.
    """
    from scipy.signal import detrend

    run, found = outcome.run, outcome.oscillation
    assert found is not None
    first, end, _ = found.rows.indices(_shown(outcome))
    ticks = max(24, math.ceil(CLOSE_PERIODS * 2 * math.pi / found.vibration.frequency / run.sample_time))
    if run.diverged:  # what is drawn of it may end before the stretch in which the vibration was measured
        first = 0
    rows = slice(max(first, end - ticks), end)
    time, single = run.time[rows], len(run.joint_names) == 1
    joints = [0] if single else [run.joint_names.index(name) for name in found.strongest[: len(COLORS)]]
    motors: list[Side] = [(run.joint_names[k], run.motor_position[:, [k]], *look, 1.8) for k, look in zip(joints, COLORS, strict=False)]
    swings = [
        Curve(name, 1e3 * detrend(values[rows, 0]), color, dash, width=width)
        for name, values, color, dash, width in (_both_sides(outcome) if single else motors)
    ]
    torques = [Curve(run.joint_names[k], run.actual_torque[rows, k], *look, named=False) for look, k in zip(COLORS, joints, strict=False)]
    panels = [Panel("swing", "mrad", swings, 0.55), Panel("torque", "N·m", torques, 0.45)]
    title = f"The last {CLOSE_PERIODS} periods: {frequency(found.vibration.frequency)}"
    if found.moving:
        title = f"The vibration about {digits(time[-1], 's', 3)}: {frequency(found.vibration.frequency)}"
    caption = f"Mainly {', '.join(found.strongest[: len(COLORS)])}, without the slow motion. {'' if single else 'Swing: of the motors. '}"
    caption += f"One period is {digits(2e3 * math.pi / found.vibration.frequency, 'ms', 3)}."
    if outcome.limit is not None and 0 < outcome.limit.gain < math.inf:
        caption += f" The linear loop predicts {hertz(outcome.limit.frequency)} where vibration starts; "
        caption += "above the limit the frequency rises with the gains."
    return stacked(time, panels, title, caption, 520)


def drawn_channels(outcome: Outcome) -> list[int]:
    """Indices of channels with a figure: the leading ones, then those with the largest errors, in table order."""
    left = [k for k in outcome.others if outcome.tracking.peak[k] > MUJOCO.least]
    return sorted([*outcome.leading, *left][:MOST_CHANNELS])


def channels(outcome: Outcome) -> list[Html]:
    """Figures, one per channel."""
    links = links_over_time(outcome)
    return [channel(outcome, k, links, 330, SMALL_POINTS) for k in drawn_channels(outcome)]


def links_over_time(outcome: Outcome) -> Run:
    """Run at the few ticks at which true link positions are computed."""
    end = _shown(outcome)
    return outcome.run.rows(slice(0, end, max(1, end // MOST_LINK_TICKS)))


def channel(outcome: Outcome, k: int, links: Run, height: int = 460, most: int = LARGE_POINTS) -> Html:
    """Figure of channel `k`: commanded, measured and true position, and its error with the settling band; `links`: links_over_time."""
    run, end, floor, found = outcome.run, _shown(outcome), floor_of(outcome), outcome.tracking
    time, scale, unit = run.time[:end], _scale(outcome, k), run.units[k]
    curves = (
        Curve("links", scale * _change(np.interp(time, links.time, links.actual[:, k])), style.VERMILION, width=style.LINK),
        Curve("encoders", scale * _change(run.measured[:end, k]), style.BLUE, width=style.MOTOR),
        Curve("commanded", scale * _commanded(outcome, k)[:end], style.BLACK, "dot"),
    )
    error = [Curve("error", 1e3 * np.round(run.error[:end, k], ROUNDED), style.BLUE, named=False)]
    panels = [Panel("position", "rad" if scale == 1 else f"m{unit}", curves, 0.6), Panel("error", f"m{unit}", error, 0.4)]
    band = _settled_band(outcome, k)
    steady = "" if math.isnan(found.steady_state[k]) else f", steady-state error {milli(float(found.steady_state[k]), floor)} m{unit}"
    words = f"Largest error {milli(float(found.peak[k]), floor)} m{unit}{steady}. {BAND if band else ''}".strip()
    return stacked(time, panels, run.channels[k], words, height, most=most, shapes=band)


def pose(outcome: Outcome, spec: RobotSimulation, run: RobotRun) -> Html:
    """Figure of the final posture over the initial one, with the path of the centre of mass."""
    model, found = spec.model, outcome.oscillation if outcome.vibrates else None
    looks = run.rows(slice(None, None, max(1, len(run.time) // POSES)))
    postures = [looks.posture(row) for row in range(len(looks.time))] + [run.posture(-1)]
    floats = model.body.base == "floating" and not model.contacts
    if floats:  # in free fall, soon out of every figure
        postures = [np.concatenate([run.posture(0)[:7], posture[7:]]) for posture in postures]
    start, end = (replace(model, q=postures[row]) for row in (0, -1))
    centre = np.array([model.body.com(posture) for posture in postures])
    view = view_of([start, end], 0.3 if found is None else NAMES_BETWEEN)
    wide, high = view.high - view.low
    parts = np.zeros(model.size, dtype=complex) if outcome.oscillation is None else outcome.oscillation.parts
    limit = GainLimit(True, math.nan, math.nan, math.nan if found is None else found.vibration.frequency, parts, None)
    traces, notes = drawn(end, limit, view, 15)
    notes += [] if found is None else labels(end, limit, view, float(WIDTH / wide))
    if run.ending == "fell":
        notes.append(style.stamp("FELL"))
    bar = {"len": 0.7, "xpad": 4}
    picture = {"data": [*ghost(start, view), *traces, *path(centre, view)], "layout": drawing_layout(limit, notes, view, [0, 1], bar)}
    if not outcome.sound:
        picture["layout"]["plot_bgcolor"] = style.UNSTABLE_GROUND
    moved = float(np.linalg.norm(centre[-1] - centre[0]))
    colored = (
        " Joints are coloured by the amplitude of their motors in the vibration, relative to the largest." if found is not None else ""
    )
    patches = " Dark patches are contact frames." if model.contacts else ""
    caption = (
        f"Faint: initial posture. Blue: path of the centre of mass, {digits(1e3 * moved, 'mm', 3)} from end to end.{colored}{patches} "
        "What is farther away is drawn up and to the right, at half scale."
    )
    caption = f"In free fall, drawn relative to the base. {caption}" if floats else caption
    title = f"Initial posture, and posture after {digits(outcome.duration, 's', 3)}"
    return figure(picture, title, caption, round(min(max(WIDTH * high / wide, 260), 460)) + 18, {"margin.l": 4, "margin.r": 4})
