"""The page of a played robot: answer, numbers, the channels that move, the robot before and after, its vibration, tables, assumptions."""

import math
from dataclasses import replace

import numpy as np

from ..errors import listed
from ..robot.body import is_slide
from ..robot.ground import Sole
from ..studies.robot_outcome import RobotPlay
from ..studies.robot_outcome_text import TINY, UNEVEN, uncounted
from .number_format import digits, milli, settling
from .page import Card, Html, Lead, Section, beside, block, facts, page, paragraph, table
from .played import error_cards, lead, vibration_card
from .robot_motion import channels, drawn_channels, in_time, pose, vibration_close_up
from .robot_tables import angles_in_words, contacts_in_words, machine, span
from .shared import footer

VERDICTS = {"fell": "FELL", "diverged": "DIVERGES"}
NOTHING = 1e-3
"""[N m], and a part in a vibration: less is shown as 0."""


def robot_simulation_page(play: RobotPlay, command: str) -> str:
    """The report of a run as one HTML page; `command` is what a reader types to get it again."""
    shaken = [Section("The vibration", [vibration_close_up(play)])] if play.vibrates else []
    sections = [
        Section("In time", [in_time(play)]),
        *shaken,
        Section("The robot before and after", [pose(play)]),
        Section("Channel by channel", _by_channel(play)),
        Section("Joints", [_joints(play)]),
        Section("Inputs and assumptions", [_inputs(play), paragraph(_assumptions(play)), *_taken(play)]),
        Section("This page again", [block(command)]),
    ]
    return page(f"gainroom simulate: a robot of {play.run.setup.body.size} joints, MuJoCo", _lead(play), _cards(play), sections, footer())


def _by_channel(play: RobotPlay) -> list[Html]:
    chosen = drawn_channels(play)
    words = (
        "Commanded, as the encoders tell it, and where the links are in truth: encoders before elastic gearboxes do not see how far these "
        "wind up. Everything counts from where the run began."
    )
    for unit in ("m", "rad"):
        hidden = [k for k in range(len(play.units)) if k not in chosen and play.units[k] == unit]
        if hidden:
            most = max(float(play.tracking.peak[k]) for k in hidden)
            words += f" Not drawn: {listed([play.run.channels[k] for k in hidden])}, within {milli(most, TINY)} m{unit}."
    return [paragraph(words), beside(*channels(play)), _channels(play)]


def _lead(play: RobotPlay) -> Lead:
    what = "this on the robot" if play.run.ending == "fell" else "these gains"
    bad = VERDICTS.get(play.run.ending, "VIBRATES" if play.vibrates else "UNSTABLE")
    return lead(play.sentence, "" if play.sound else bad, play.warnings, what)


def _cards(play: RobotPlay) -> list[Card]:
    found, first, hardest = play.tracking, play.leading[0], int(np.argmax(play.torque_peak))
    unit, name = f"m{play.units[first]}", play.run.channels[first]
    torque = Card(
        "torque peak", _digits(float(play.torque_peak[hardest]), 3), play.torque_units[hardest], note=play.run.joint_names[hardest]
    )
    heard = vibration_card(play.vibration, play.vibrates, play.limit)
    if not play.stable:
        heard = replace(heard, requirement="none that lasts, and a stable loop", met=False)
    if play.vibration is not None and not play.vibrates:
        heard = replace(heard, note=f"{uncounted(play)}; {heard.note}" if heard.note else uncounted(play))
    if not play.completed:
        end, what = digits(play.lasted, "", 3), "falls after" if play.run.ending == "fell" else "runs away within"
        off = Card("largest error", milli(float(found.peak[first])), unit, note=name)
        return [Card(what, end, "s", "never", met=False), off, torque, heard, *_slip_card(play)]
    last, slip = play.left_most, _slip_card(play)
    roughest = max(play.leading, key=lambda k: float(found.rms[k]))
    peak, rms, steady = float(found.peak[first]), float(found.rms[roughest]), float(found.steady_state[last])
    errors = error_cards(peak, rms, steady, unit, "", TINY)
    names = (name, play.run.channels[roughest], play.run.channels[last])
    errors = [replace(card, note=f"{card.note}, {whose}") for card, whose in zip(errors, names, strict=True)]
    if slip:  # five cards at most
        rough = f"{milli(float(found.rms[first]), TINY)} {unit}"
        errors = [replace(errors[0], note=f"{name}; RMS {rough}"), errors[2]]
    return [*errors, torque, heard, *slip]


def _slip_card(play: RobotPlay) -> list[Card]:
    """Where feet can slip: how far the one that moves most was from where it started."""
    if not len(play.slip) or play.run.setup.ground is None:
        return []
    worst = int(np.argmax(play.slip))
    foot = play.run.setup.contacts[worst].frame
    return [Card("slip of the feet", milli(float(play.slip[worst])), "mm", note=f"{foot}, slipped or lifted, at most")]


def _channels(play: RobotPlay) -> Html:
    found = play.tracking
    columns = ("channel", "unit", "moved by", "RMS", "peak", "steady state", "overshoot", "settles in")
    rows = [
        (
            name,
            f"m{play.units[k]}",
            *(
                milli(float(value), TINY)
                for value in (np.ptp(play.run.reference[:, k]), found.rms[k], found.peak[k], found.steady_state[k])
            ),
            digits(100 * float(found.overshoot[k]), "%", 3),
            settling(float(found.settling_time[k])),
        )
        for k, name in enumerate(play.run.channels)
    ]
    caption = (
        f"Error: commanded less {_seen(play)}. Steady state: mean of the last tenth. Settled: within 2 % of the move for good; "
        "only what moves has an overshoot."
    )
    return table(columns, rows, caption + ("" if play.completed else " The run ended early: there is no steady state."))


def _seen(play: RobotPlay) -> str:
    """What errors are counted from."""
    side = play.run.setup.control.feedback
    return f"true position on the {side} side" if play.spec.control.space == "joint" else "what the encoders show"


def _joints(play: RobotPlay) -> Html:
    run = play.run
    through = np.abs(run.joint_torque).max(axis=0)
    wound = np.abs(run.motor_position - run.link_position).max(axis=0)
    columns = ["joint", "torque peak [N m]", "torque RMS [N m]", "gearbox peak [N m]", "wound up by [mrad]", "moved [mrad]"]
    parts = play.parts if play.vibrates else None
    rows = [
        (
            name,
            *(_digits(float(value[k]), 3) for value in (play.torque_peak, play.torque_rms, through)),
            *(milli(float(value), TINY) for value in (wound[k], np.ptp(run.link_position[:, k]))),
            *([] if parts is None else [_digits(abs(complex(parts[k])), 2)]),
        )
        for k, name in enumerate(run.joint_names)
    ]
    caption = "Torque: actual, of the motor on the joint side; gearbox: through its spring, – of a rigid one, which nothing measures."
    if parts is not None:
        columns.append("share")
        caption += " Share: how far the motor swings in the vibration, the one that swings most counting 1."
    if any(map(is_slide, run.setup.body.joints)):
        caption += " Of slides read N and mm."
    return table(columns, rows, caption)


def _digits(value: float, significant: int) -> str:
    return digits(0.0 if value < NOTHING else value, "", significant)


def _inputs(play: RobotPlay) -> Html:
    spec, run, played = play.spec, play.run, play.spec.scenario
    setup = run.setup
    posture, contact = played.posture or next(iter(spec.robot.postures)), played.contact or next(iter(spec.robot.contacts))
    moved = {name: float(run.reference[-1, k] - run.reference[0, k]) for k, name in enumerate(run.channels)}
    way = ", ".join(f"{name} {milli(by)} m{unit}" for (name, by), unit in zip(moved.items(), play.units, strict=True) if by)
    stood = "; held where they are: they cannot slip or lift"
    if setup.ground is not None:
        soles = [(one, setup.ground.soles.get(one.frame, Sole())) for one in setup.contacts if one.kind != "point"]
        told = [f"{one.frame} {_sole(sole) if one.kind == 'flat' else f'{sole.width:g} m wide'}" for one, sole in soles]
        stood = f"; they may slip and lift: friction {setup.ground.friction:g}{', soles ' if told else ''}{', '.join(told)}"
    pairs = [
        *machine(spec),
        ("gains", f"{_gains(play)}; all × {play.gain:g}"),
        (f"posture {posture}", angles_in_words(spec.robot.postures[posture])),
        (f"contact {contact}", f"{contacts_in_words(setup.contacts)}{stood if setup.contacts else ''}"),
        *_footings(play),
        ("move", f"{way} in {digits(play.moved_until, 's')}, quintic, from rest to rest" if way else "none: it holds still"),
        ("Coulomb friction of the motors", span(np.broadcast_to(setup.coulomb, setup.body.size), "N·m")),
        ("viscous friction added to the motors", span(np.broadcast_to(played.viscous, setup.body.size), "N·m·s/rad")),
        ("torque limit", _limits(play)),
        ("encoder steps, joint side", digits(1e3 * setup.encoder_step, "mrad", 3) if setup.encoder_step else "none"),
        ("ticks", f"{digits(1 / setup.sample_time, 'Hz')}, {len(run.time)} rows over {digits(play.lasted, 's')}"),
    ]
    return facts(pairs)


def _footings(play: RobotPlay) -> list[tuple[str, str]]:
    """Slope and height of the ground under each foot."""
    told = ", ".join(f"{one.frame} {math.degrees(one.slope):.3g}°, {milli(one.height, UNEVEN / 1e3)} mm high" for one in play.footings)
    return [("ground under the feet, slope and height", told)] if told else []


def _sole(sole: Sole) -> str:
    centre = f" about ({sole.center[0]:g}, {sole.center[1]:g}) m" if any(sole.center) else ""
    return f"{sole.length:g} m × {sole.width:g} m{centre}"


def _limits(play: RobotPlay) -> str:
    """Of the joints that have one."""
    limits = np.broadcast_to(play.run.setup.torque_limit, play.run.setup.body.size)
    limited = np.isfinite(limits)
    which = "" if limited.all() else f", {int(limited.sum())} of {len(limits)} joints"
    return span(limits[limited], "N·m") + which if limited.any() else "none"


def _gains(play: RobotPlay) -> str:
    """As the file has them, joints of the same gains together."""
    law = play.spec.control.joints
    if law is not None:
        return ", ".join(f"{name} {span(np.broadcast_to(getattr(law, name), play.run.setup.body.size))}" for name in law.gain_names())
    told = []
    for task in play.run.setup.stack:
        kd = {"kd": task.kd} if task.ki is None else {"kv": task.kd, "ki": task.ki}
        gains = ({"kp": task.kp} | kd).items()
        told.append(f"{task.name}: " + ", ".join(f"{name} {'/'.join(f'{g:g}' for g in np.atleast_1d(value))}" for name, value in gains))
    return "; ".join(told)


def _assumptions(play: RobotPlay) -> str:
    setup = play.run.setup
    contact = "held contacts are constraints that give way by a ten-thousandth"
    if setup.ground is not None:
        contact = "the ground pushes back within 2 ms"
    words = (
        "MuJoCo between the controller's ticks, its semi-implicit Euler steps read as a leapfrog and so short that the fastest vibration "
        f"of the plant is heard 1 % too high at most. Every elastic joint is a motor behind a spring and a damper; {contact}. Torques come "
        "through the delay and the current loop; no backlash. The controller knows the links exactly, "
        f"sees the {setup.control.feedback} side of the gearboxes, takes its contacts as unmoved, and compensates the weight; its "
        f"Jacobians are renewed every {setup.refresh} ticks."
    )
    if play.limit is not None:
        words += " The linear limit is that of small motions about the posture at the start, on contacts that hold, without this run's "
        words += "Coulomb friction, torque limit and encoder steps; its viscous friction counts."
    return words


def _taken(play: RobotPlay) -> list[Html]:
    """What the file left open."""
    found = play.spec.assumptions
    return [facts([("taken for granted", text) for text in found])] if found else []
