"""The page of a simulation of a joint or a robot: verdict, what to do, numbers, what fails, the whole run; the rest closed below."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import at_frequency, listed
from ..robot.ground import Sole
from ..simulation.robot_run import RobotRun
from ..simulation.robot_simulation import RobotSimulation
from ..simulation.simulation_spec import JointSimulation
from ..studies.simulation import Outcome
from ..system.requirements import REQUIREMENTS
from . import joint_tables
from .number_format import digits, hertz, milli, motion_unit, span, typed_gains
from .page import Card, Html, Lead, Section, advice_box, beside, facts, page, paragraph, table
from .page_parts import filters, margin_card, unstable_card
from .robot_tables import angles_text, contacts_text, machine
from .simulation_advice import CALL, what_to_do
from .simulation_figures import channel, channels, close_up, drawn_channels, in_time, links_over_time, pose
from .simulation_text import (
    TRACKING,
    farthest_off,
    floor_of,
    not_counted,
    overshoots,
    sentence,
    tracking_cells,
    unsettled,
    warnings,
)
from .words import tone

Pair = tuple[str, str]


def inputs(outcome: Outcome) -> list[Pair]:
    """In the units of the file."""
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
    """The torque limits of the joints that have one."""
    limited = np.isfinite(limits)
    which = "" if limited.all() else f", {int(limited.sum())} of {len(limits)} joints"
    return span(limits[limited], "N·m") + which if limited.any() else "none"


def _gains(simulation: RobotSimulation) -> str:
    """The gains of the file."""
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
    """One kind of simulation: title, inputs, assumptions, and sections that only its page has."""

    title: str
    inputs: Callable[[Outcome], list[Pair]]
    assumptions: Callable[[Outcome], str]
    sections: Callable[[Outcome], list[Section]] = lambda outcome: []


KINDS = {
    "linear": Kind("linear sampled model", _joint, _linear),
    "testbed": Kind("virtual testbed", _joint, _testbed),
    "mujoco": Kind("MuJoCo", _robot, _mujoco, _poses),
}
"""By SimulationSpec.kind."""


SHOWN_AS_ZERO = 1e-3
"""[N·m], and a participation factor: less is shown as 0."""


def simulation_page(outcome: Outcome, command: str, call: str = CALL, study_call: str = "") -> str:
    """The report of a run as one HTML page; `command` is the command that makes it, `call` and `study_call`: see what_to_do."""
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
    return page(f"gainroom simulate: {what}, {kind.title}", _lead(outcome, call, study_call), _cards(outcome), sections, command)


def _first(outcome: Outcome) -> list[Section]:
    """The picture of what fails, and the whole run."""
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


def _lead(outcome: Outcome, call: str, study_call: str) -> Lead:
    """The verdict with its sentence, warnings and advice."""
    do = advice_box(what_to_do(outcome, call, study_call))
    if outcome.sound:
        return Lead(sentence(outcome), tone(outcome.verdict), "", warnings(outcome), do)
    verdict = {"fell": "FELL", "diverged": "DIVERGES"}.get(outcome.run.ending, "VIBRATES" if outcome.vibrates else "UNSTABLE")
    what = "this on the robot" if outcome.run.ending == "fell" else "these gains"
    return Lead(sentence(outcome), "bad", f"{verdict}: do not run {what}", warnings(outcome), do)


def _cards(outcome: Outcome) -> list[Card]:
    """Four or five numbers."""
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
    """The steady-state error that is the largest."""
    value = " ".join(_distance(abs(float(outcome.tracking.steady_state[channel])), outcome.run.units[channel], floor_of(outcome)))
    return ", ".join(filter(None, [f"steady-state error {value}", _named(outcome, outcome.run.channels[channel])]))


def _named(outcome: Outcome, name: str) -> str:
    """A channel or joint, where there are several."""
    return name if len(outcome.run.joint_names) > 1 else ""


def _margin_cards(outcome: Outcome) -> list[Card]:
    """What the linear loop has: its gain margin, and what else is missed."""
    limit, asked = outcome.limit, outcome.spec.system.requirements
    if limit is None or outcome.margins is None:
        return []
    if not limit.stable:
        return [unstable_card(asked, limit, "", "it")]
    where = f"linear loop{' in this state' if outcome.spec.kind == 'mujoco' else ''}"
    where += ", nominal" if outcome.spec.system.uncertainty.names else ""
    cards = []
    for name in dict.fromkeys((*outcome.missed, "gain_margin")):
        at = where + at_frequency(REQUIREMENTS[name].frequency(outcome.margins), ", ", hertz)
        cards.append(replace(margin_card(asked, name, REQUIREMENTS[name].value(outcome.margins), at), met=outcome.met(name)))
    return cards


def _settling_card(outcome: Outcome) -> list[Card]:
    """Of the channels that were asked to move the one that settles last."""
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
        notes.append(", ".join(filter(None, [f"overshoot {digits(100 * float(over[most]), '%', 3)}", _named(outcome, names[most])])))
    # No requirement of the file, so neither met nor not: the verdict counts those alone
    return [Card("settles in" if unit == "s" else "settles", value, unit, note="; ".join(["within 2 % of the move", *filter(None, notes)]))]


def _distance(value: float, unit: str, floor: float = 1e-9) -> tuple[str, str]:
    """Number and unit of an error [rad, m]; what is below `floor` is 0."""
    factor, shown = motion_unit(value, unit)
    return (milli(value, floor) if factor > 1 else digits(value, significant=3)), shown


def _beyond(outcome: Outcome) -> str:
    """A note where the actual torque passes its limit."""
    return "above the limit: the current loop overshoots the demand" if overshoots(outcome) else ""


def _vibration_card(outcome: Outcome) -> Card:
    """The simulated vibration."""
    found = outcome.vibration
    seen = ("none", "") if found is None else (digits(found.frequency / (2 * math.pi), "", 3), "Hz")
    note = not_counted(outcome) if found is not None and not outcome.vibrates else ""
    asked = "none sustained" if outcome.stable else "none sustained, stable loop"
    return Card("vibration", *seen, requirement=asked, met=outcome.stable and not outcome.vibrates, note=note)


def _slip_card(outcome: Outcome) -> list[Card]:
    """Where feet can slip: the largest displacement of a contact frame from its start."""
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


def _digits(value: float, significant: int) -> str:
    return digits(0.0 if value < SHOWN_AS_ZERO else value, "", significant)
