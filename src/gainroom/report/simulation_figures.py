"""Figures of a simulated run: channels over time, the vibration enlarged, the initial and the final posture of a robot."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit
from ..errors import listed
from ..simulation import Run
from ..simulation.robot_run import RobotRun
from ..simulation.robot_simulation import RobotSimulation
from ..simulation.tracking import SETTLED
from ..studies.oscillation import MUJOCO
from ..studies.simulation import Outcome
from ..system.linear.arrays import Floats
from . import style
from .curves import Curve, Panel, stacked
from .number_format import digits, frequency, hertz, milli, motion_unit
from .page import Html, figure
from .robot_drawing import WIDTH, drawing_layout
from .robot_skeleton import NAMES_BETWEEN, drawn, ghost, labels, path, view_of
from .simulation_text import floor_of, left_short

MOST_TOGETHER = 3  # channels, or joints, in one panel
MOST_CHANNELS = 6  # that have a figure of their own
LARGE_POINTS, SMALL_POINTS = 1200, 500  # of a curve, in a figure of full and of half width
MOST_LINK_TICKS = 1200  # at which true link positions are computed
POSES = 200  # on the path of the centre of mass
ROUNDED = 9  # decimals [m, rad, N m] of what is drawn
CLOSE_PERIODS = 12  # of the vibration in its own figure
DIVERGED_RANGE = 3.0  # times the reference's range: a run that diverges is drawn up to it
LEAST_RANGE = 0.01  # [rad, m] of a reference that hardly moves
COLORS = ((style.BLUE, "solid"), (style.VERMILION, "dash"), (style.DARK[style.GREEN], "dashdot"), (style.DARK[style.PURPLE], "longdash"))
TORQUES = ((style.BLACK, "solid"), (style.ORANGE, "dash"), (style.DARK[style.PURPLE], "dashdot"))


def shown_ticks(reference: Floats, error: Floats) -> int:
    """The number of ticks of a diverging run, (k, n) each, to be drawn: those within DIVERGED_RANGE."""
    covered = np.vstack([reference[:1] - error[:1], reference])  # from where it starts: a step at t = 0 alone is a constant
    widest = DIVERGED_RANGE * max(float(np.ptp(covered, axis=0).max()), LEAST_RANGE)
    far = np.abs(error).max(axis=1) > widest
    return max(2, min(len(far), int(np.argmax(far)) + 1)) if far.any() else len(far)


def _shown(outcome: Outcome) -> int:
    """How many ticks are drawn."""
    run, chosen = outcome.run, list(outcome.leading)
    return shown_ticks(run.reference[:, chosen], run.error[:, chosen]) if run.diverged else len(run.time)


def in_time(outcome: Outcome) -> Html:
    """The leading channels, their errors, and the joints with the largest torques; of a single joint both sides, and its target torque."""
    run, end = outcome.run, _shown(outcome)
    chosen, unit = sorted(outcome.leading[:MOST_TOGETHER]), run.units[outcome.leading[0]]
    scale, rows = _scale(outcome, chosen[0]), slice(0, end)
    looks = list(zip(COLORS, chosen, strict=False))
    if len(run.joint_names) == 1:
        move = [
            Curve(side, scale * _change(values[rows, 0]), *look) for side, values, look in zip(*_both_sides(outcome), COLORS, strict=False)
        ]
    else:
        move = [Curve(run.channels[k], scale * _change(run.measured[rows, k]), color) for (color, _), k in looks]
    dots = [style.BLACK] if len(looks) == 1 else [color for (color, _), _ in looks]  # of several its own, to be told apart
    move += [
        Curve("commanded", scale * _commanded(outcome, k)[rows], color, "dot", k == chosen[-1])
        for color, (_, k) in zip(dots, looks, strict=True)
    ]
    error = [Curve(run.channels[k], 1e3 * np.round(run.error[rows, k], ROUNDED), color, named=False) for (color, _), k in looks]
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
        f"{what}; all curves start at 0. The {run.feedback} side is fed back. Error: commanded minus actual position there. Torque at "
        "the ticks, of the joints with the largest. "
        + (BAND if band else "")
        + (f"Cut at {digits(run.time[end - 1], 's', 3)}, beyond the range of the figure. " if end < len(run.time) else "")
        + _conclusion(outcome)
    ).rstrip()
    return stacked(run.time[rows], panels, "Commanded and actual, tracking error, torque", caption, 640, notes, 2 * LARGE_POINTS, band)


BAND = "Green: within 2 % of the move, where it is settled. "


def _settled_band(outcome: Outcome, channel: int) -> list[dict[str, Any]]:
    """Around an error of 0, in the second panel; none where no move is judged."""
    if math.isnan(outcome.tracking.settling_time[channel]):
        return []
    wide = (
        1e3 * SETTLED * abs(float(outcome.run.reference[-1, channel] - outcome.run.reference[0, channel] + outcome.run.error[0, channel]))
    )
    band = style.stretch(0, 1, style.GREEN, 0.2) | {"xref": "x domain", "yref": "y2", "y0": -wide, "y1": wide}
    return [band] if wide > 0 else []


def _both_sides(outcome: Outcome) -> tuple[tuple[str, ...], tuple[Floats, ...]]:
    return ("motor", "link"), (outcome.run.motor_position, outcome.run.link_position)


def _torques(outcome: Outcome, rows: slice, joints: list[int]) -> list[Curve]:
    """Actual ones; of a single joint the target too."""
    run = outcome.run
    curves = [
        Curve(run.joint_names[k], np.round(run.actual_torque[rows, k], ROUNDED), *look) for look, k in zip(TORQUES, joints, strict=False)
    ]
    return curves if len(run.joint_names) > 1 else [Curve("target torque", run.target_torque[rows, 0], *TORQUES[1]), *curves]


def _commanded(outcome: Outcome, channel: int) -> Floats:
    """Relative to where the run starts, as a step at once is not in the reference's own change."""
    run = outcome.run
    return np.round(run.reference[:, channel] - run.reference[0, channel] + run.error[0, channel], ROUNDED)


def _change(values: Floats) -> Floats:
    """Relative to the start, without rounding errors, which would fill a figure where nothing moves."""
    return np.round(values - values[0], ROUNDED)


def _scale(outcome: Outcome, channel: int) -> float:
    """The factor from SI to the axis: rad for joints that move far, else mm or mrad."""
    run = outcome.run
    extent = max(float(np.ptp(values[:, channel])) for values in (run.reference, run.measured))
    return motion_unit(extent)[0] if run.units[channel] == "rad" else 1e3


def _vibration_note(outcome: Outcome) -> style.Annotation:
    """Its frequency, at the top of a figure."""
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
    """What is to be said of an error that is left at the end of a run that does not vibrate; "" where none is.

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
    """The last periods of the vibration, motors without mean and slope, and torques: mainly of which joints; of one joint both sides."""
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
    names, sides = _both_sides(outcome) if single else ([run.joint_names[k] for k in joints], run.motor_position.T[joints][:, :, None])
    swings = [Curve(name, 1e3 * detrend(values[rows, 0]), *look) for name, values, look in zip(names, sides, COLORS, strict=False)]
    torques = [Curve(run.joint_names[k], run.actual_torque[rows, k], *look, named=False) for look, k in zip(COLORS, joints, strict=False)]
    panels = [Panel("swing", "mrad", swings, 0.55), Panel("torque", "N·m", torques, 0.45)]
    title = f"The last {CLOSE_PERIODS} periods: {frequency(found.vibration.frequency)}"
    if found.moving:
        title = f"The vibration about {digits(time[-1], 's', 3)}: {frequency(found.vibration.frequency)}"
    caption = f"Mainly {', '.join(found.strongest[: len(COLORS)])}, without the slow motion. "
    caption += f"One period is {digits(2e3 * math.pi / found.vibration.frequency, 'ms', 3)}."
    if outcome.limit is not None and 0 < outcome.limit.gain < math.inf:
        caption += f" The linear loop predicts {hertz(outcome.limit.frequency)} where vibration starts; "
        caption += "above the limit the frequency rises with the gains."
    return stacked(time, panels, title, caption, 520)


def drawn_channels(outcome: Outcome) -> list[int]:
    """The channels that have a figure: the leading ones, then those of the others with the largest errors; in the order of the tables."""
    left = [k for k in outcome.others if outcome.tracking.peak[k] > MUJOCO.least]
    return sorted([*outcome.leading, *left][:MOST_CHANNELS])


def channels(outcome: Outcome) -> list[Html]:
    """One figure per channel."""
    links = links_over_time(outcome)
    return [channel(outcome, k, links, 330, SMALL_POINTS) for k in drawn_channels(outcome)]


def links_over_time(outcome: Outcome) -> Run:
    """The run at the few ticks at which the true positions of the links are computed."""
    end = _shown(outcome)
    return outcome.run.rows(slice(0, end, max(1, end // MOST_LINK_TICKS)))


def channel(outcome: Outcome, k: int, looks: Run, height: int = 460, most: int = 2 * LARGE_POINTS) -> Html:
    """Commanded, measured and true position of one channel, and its error with the band where it is settled; `looks`: links_over_time."""
    run, end, floor, found = outcome.run, _shown(outcome), floor_of(outcome), outcome.tracking
    time, scale, unit = run.time[:end], _scale(outcome, k), run.units[k]
    curves = (
        Curve("links", scale * _change(np.interp(time, looks.time, looks.actual[:, k])), style.VERMILION, "dash"),
        Curve("encoders", scale * _change(run.measured[:end, k]), style.BLUE),
        Curve("commanded", scale * _commanded(outcome, k)[:end], style.BLACK, "dot"),
    )
    error = [Curve("error", 1e3 * np.round(run.error[:end, k], ROUNDED), style.BLUE, named=False)]
    panels = [Panel("position", "rad" if scale == 1 else f"m{unit}", curves, 0.6), Panel("error", f"m{unit}", error, 0.4)]
    band = _settled_band(outcome, k)
    steady = "" if math.isnan(found.steady_state[k]) else f", steady-state error {milli(float(found.steady_state[k]), floor)} m{unit}"
    words = f"Largest error {milli(float(found.peak[k]), floor)} m{unit}{steady}. {BAND if band else ''}".strip()
    return stacked(time, panels, run.channels[k], words, height, most=most, shapes=band)


def pose(outcome: Outcome, spec: RobotSimulation, run: RobotRun) -> Html:
    """The final posture over the initial one, with the path of the centre of mass."""
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
