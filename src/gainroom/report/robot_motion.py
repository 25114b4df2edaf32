"""A played robot in pictures: its channels over time, where it stood before and after, its vibration."""

import math
from dataclasses import replace

import numpy as np

from ..analysis.gain_limit import GainLimit
from ..linear.arrays import Floats
from ..studies.robot_outcome import RobotPlay
from ..studies.robot_outcome_text import TINY
from ..studies.robot_vibration import NOTICED
from . import style
from .number_format import digits, frequency, milli
from .page import Html, figure
from .played import Curve, Panel, close_up, close_up_words, shown_ticks, stacked, vibration_note
from .robot_drawing import WIDTH, drawing_layout
from .robot_skeleton import drawn, ghost, labels, path, view_of

TOGETHER = 3  # channels, or joints, in one panel
MOST_CHANNELS = 6  # that have a picture of their own
LARGE_POINTS, SMALL_POINTS = 1200, 500  # of a curve, in a picture of its own width and in half of it
MOST_LOOKS = 1200  # ticks at which links are looked at
POSES = 200  # on the way of the centre of mass
ROUNDED = 9  # decimals [m, rad, N m] of what is drawn
FAR = 0.5  # [rad] from where on a picture counts in rad
COLORS = ((style.BLUE, "solid"), (style.VERMILION, "dash"), (style.DARK[style.GREEN], "dashdot"), (style.DARK[style.PURPLE], "longdash"))
TORQUES = ((style.BLACK, "solid"), (style.ORANGE, "dash"), (style.DARK[style.PURPLE], "dashdot"))


def _shown(play: RobotPlay) -> int:
    """How many ticks are drawn."""
    chosen = list(play.leading)
    run = play.run
    return shown_ticks(run.reference[:, chosen], run.error[:, chosen]) if run.ending == "diverged" else len(run.time)


def in_time(play: RobotPlay) -> Html:
    """The channels that lead, their error, and the joints that work hardest."""
    run, end = play.run, _shown(play)
    chosen, unit = sorted(play.leading[:TOGETHER]), play.units[play.leading[0]]
    scale = _scale(play, chosen[0])
    rows = slice(0, end)
    looks = list(zip((color for color, _ in COLORS), chosen, strict=False))
    move = [Curve(run.channels[k], scale * _change(run.measured[rows, k]), color) for color, k in looks]
    move += [Curve("commanded", scale * _change(run.reference[rows, k]), color, "dot", k == chosen[-1]) for color, k in looks]
    error = [Curve(run.channels[k], 1e3 * np.round(run.error[rows, k], ROUNDED), color, named=False) for color, k in looks]
    hardest = np.argsort(-np.abs(run.actual_torque[rows]).max(axis=0), kind="stable")[:TOGETHER].tolist()
    torque = [
        Curve(run.joint_names[k], np.round(run.actual_torque[rows, k], ROUNDED), *look) for look, k in zip(TORQUES, hardest, strict=False)
    ]
    panels = [
        Panel("moved" if play.moving else "drift", "rad" if scale == 1 else f"m{unit}", move, 0.42),
        Panel("error", f"m{unit}", error, 0.27),
        Panel("torque", "N m", torque, 0.31),
    ]
    notes = [vibration_note(play.vibration)] if play.vibration is not None and play.vibrates else []
    if run.ending == "fell":
        place = {"xref": "x domain", "yref": "y domain", "xanchor": "right", "yanchor": "top"}
        notes.append(style.label(0.99, 0.995, f"<b>fell after {digits(play.lasted, 's', 3)}</b>", style.VERMILION, **place))
    others = len(play.leading) - len(chosen)
    what = (
        f"{len(chosen)} of {len(play.leading)} channels, those furthest off" if others else "What moves" if play.moving else "All channels"
    )
    less = "the true position there" if play.spec.control.space == "joint" else "that"
    caption = (
        f"{what}, from where the run began, as the controller sees it from its {run.setup.control.feedback}-side encoders; error: "
        f"commanded less {less}; actual torque of the {len(hardest)} joints that work hardest. "
        + (f"Cut at {digits(run.time[end - 1], 's', 3)}, where it is already out of the picture. " if end < len(run.time) else "")
        + _conclusion(play)
    )
    return stacked(run.time[rows], panels, "Commanded and actual, tracking error, torque", caption, 680, notes, LARGE_POINTS)


def _change(values: Floats) -> Floats:
    """From where it began, without rounding errors, which would fill a picture where nothing moves."""
    return np.round(values - values[0], ROUNDED)


def _scale(play: RobotPlay, channel: int) -> float:
    """Of a picture: joints that move far in rad, all else in mm or mrad."""
    run = play.run
    way = max(float(np.ptp(values[:, channel])) for values in (run.reference, run.measured))
    return 1.0 if play.units[channel] == "rad" and way > FAR else 1e3


def _conclusion(play: RobotPlay) -> str:
    if play.run.ending == "fell":
        return "The run ends where the base has sunk by half its height or tilted by half a radian."
    if play.run.ending == "diverged":
        return "These gains must not be run."
    if play.vibrates and play.heard is not None and play.heard.moving:
        return "It vibrates while it moves, as is shown below: lower all gains together, or shorten the delay."
    if play.vibrates:
        return "The vibration does not die away: lower all gains together, or shorten the delay."
    if not play.stable:
        return "Nothing lasts here, but the linear loop is unstable at these gains."
    held = ", and friction can hold that" if np.any(play.run.setup.coulomb) else ""
    return f"Nothing lasts but the error that is left{held}."


def vibration_close_up(play: RobotPlay) -> Html:
    """The last periods: motors and torques of the joints that take part most."""
    run, heard = play.run, play.heard
    assert heard is not None
    found = heard.found
    rows = close_up(found, run.setup.sample_time, heard.rows.stop)
    rows = slice(max(rows.start, heard.rows.start), rows.stop)
    time, chosen = run.time[rows], play.parts_strongest_first()[: len(COLORS)]
    looks = list(zip(COLORS, chosen, strict=False))
    motors = [Curve(run.joint_names[k], 1e3 * _swing(time, run.motor_position[rows, k]), *look) for look, k in looks]
    torques = [Curve(run.joint_names[k], run.actual_torque[rows, k], *look, named=False) for look, k in looks]
    panels = [Panel("motor, swing", "mrad", motors, 0.55), Panel("torque", "N m", torques, 0.45)]
    title, caption = close_up_words(found, play.limit)
    if heard.moving:
        title = f"The vibration about {digits(run.time[rows][-1], 's', 3)}: {frequency(found.frequency)}"
    most = ", ".join(run.joint_names[k] for k in chosen)
    caption = f"{most} swing most, shown without the motion under it. {caption} The drawing below colours each joint by its share."
    return stacked(time, panels, title.replace(" of the picture above", ""), caption, 520)


def _swing(time: Floats, values: Floats) -> Floats:
    """Without mean and slope."""
    line = np.column_stack([np.ones(len(time)), time - time.mean()])
    return values - line @ np.linalg.lstsq(line, values, rcond=None)[0]


def pose(play: RobotPlay) -> Html:
    """The robot where it ended over where it began, with the way of its centre of mass."""
    run, scenario = play.run, play.spec.scenario
    model = play.spec.robot.linearize(scenario.posture, scenario.contact)
    looks = run.rows(slice(None, None, max(1, len(run.time) // POSES)))
    postures = [looks.posture(row) for row in range(len(looks.time))] + [run.posture(-1)]
    floats = model.body.base == "floating" and not model.contacts
    if floats:  # it falls freely, soon out of every picture
        postures = [np.concatenate([run.posture(0)[:7], posture[7:]]) for posture in postures]
    start, end = (replace(model, q=postures[row]) for row in (0, -1))
    centre = np.array([model.body.com(posture) for posture in postures])
    heard = play.vibration if play.vibrates else None
    view = view_of([start, end], 0.3 if heard is None else 0.65)  # names stand between the sides
    wide, high = view.high - view.low
    nothing = np.zeros(model.size, dtype=complex) if play.parts is None else play.parts
    limit = GainLimit(True, math.nan, math.nan, math.nan if heard is None else heard.frequency, nothing, None)
    traces, notes = drawn(end, limit, view, 15)
    notes += [] if heard is None else labels(end, limit, view, float(WIDTH / wide))
    if run.ending == "fell":
        place = {"xref": "x domain", "yref": "y domain", "xanchor": "right", "yanchor": "bottom"}
        notes.append(style.label(1, 0, "<b>FELL</b>", style.VERMILION, **place) | {"font": {"size": 18, "color": "#b34a00"}})
    bar = {"len": 0.7, "xpad": 4}
    picture = {"data": [*ghost(start, view), *traces, *path(centre, view)], "layout": drawing_layout(limit, notes, view, [0, 1], bar)}
    if not play.sound:
        picture["layout"]["plot_bgcolor"] = style.UNSTABLE_GROUND
    moved = float(np.linalg.norm(centre[-1] - centre[0]))
    colored = " Joints are coloured by how far their motors swing, the one that swings most counting 1." if heard is not None else ""
    patches = " Dark patches are contact frames." if model.contacts else ""
    caption = (
        f"Faint: the start. Blue: the way of the centre of mass, {digits(1e3 * moved, 'mm', 3)} from end to end.{colored}{patches} What is "
        "farther away is drawn up and to the right, at half scale."
    )
    caption = f"In free fall, drawn as if the base had stayed. {caption}" if floats else caption
    title = f"Where it stood, and where it is after {digits(play.lasted, 's', 3)}"
    return figure(picture, title, caption, round(min(max(WIDTH * high / wide, 260), 460)), {"margin.l": 4, "margin.r": 4})


def drawn_channels(play: RobotPlay) -> list[int]:
    """The channels that have a picture: those that lead, then of what is left those furthest off; in the order of the tables."""
    left = [k for k in play.others if play.tracking.peak[k] > NOTICED]
    return sorted([*play.leading, *left][:MOST_CHANNELS])


def channels(play: RobotPlay) -> list[Html]:
    """Each of them: commanded, seen and true, and the error."""
    run, end = play.run, _shown(play)
    looks = run.rows(slice(0, end, max(1, end // MOST_LOOKS)))
    time = run.time[:end]

    def picture(k: int) -> Html:
        scale, unit, found = _scale(play, k), play.units[k], play.tracking
        true = np.interp(time, looks.time, looks.actual[:, k])
        curves = (
            Curve("links", scale * _change(true), style.VERMILION, "dash"),
            Curve("encoders", scale * _change(run.measured[:end, k]), style.BLUE),
            Curve("commanded", scale * _change(run.reference[:end, k]), style.BLACK, "dot"),
        )
        error = [Curve("error", 1e3 * np.round(run.error[:end, k], ROUNDED), style.BLUE, named=False)]
        panels = [Panel("moved", "rad" if scale == 1 else f"m{unit}", curves, 0.6), Panel("error", f"m{unit}", error, 0.4)]
        left = "" if math.isnan(found.steady_state[k]) else f", {milli(float(found.steady_state[k]), TINY)} left"
        words = f"At most {milli(float(found.peak[k]), TINY)} m{unit} off{left}."
        return stacked(time, panels, run.channels[k], words, 330, most=SMALL_POINTS)

    return [picture(k) for k in drawn_channels(play)]
