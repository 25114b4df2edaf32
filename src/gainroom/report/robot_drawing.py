"""Drawings of a vibrating robot: the tightest state, large, and one for each of the others."""

import math

import numpy as np

from ..analysis.margin_record import GainLimit
from ..robot.model import RobotModel
from ..studies.state import State, limiting_joints, strongest_first
from . import style
from .number_format import digits, hertz
from .page import Html, figure
from .robot_skeleton import NAMES_BETWEEN, DrawingView, common_view, drawn, labels, participation_text, stand, vibration

# ColorBrewer's YlOrBr (Brewer 2013): light to dark in grey too, and to all eyes
PARTICIPATION = [[0, "#fffbe6"], [0.15, "#fee391"], [0.35, "#fec44f"], [0.55, "#fe9929"], [0.75, "#cc4c02"], [1, "#662506"]]
MOST_BARS, FEW_BARS = 14, 6  # beside the drawing, and on a phone
LEAST_BAR = 0.005  # participation factor: less reads as 0 %
WIDTH = 1028  # [px] of a picture on a wide screen


def hero(state: State, alone: bool, motion: GainLimit | None = None, title: str = "") -> Html:
    """Large figure of the state with the least headroom, with each joint's participation factor. `alone`: it is the only state.

    motion   another motion than at the gain limit, with the figure's `title`
    """
    view, limit = common_view([state], NAMES_BETWEEN), motion or state.limit
    title = title or _title(state, alone)
    caption = _hero_caption(state) if motion is None else f"The colour of a joint is its motion relative to the largest; {_parts(state)}"
    wide, high = view.high - view.low
    part = min(0.54, max(0.4, 0.42 * wide / high))
    traces, notes = drawn(state.model, limit, view, 17)
    if vibration(limit) is None:  # no vibration
        height = round(min(max(part * WIDTH * high / wide, 220), 420)) + 34
        layout = drawing_layout(limit, notes, view, [0, 1], {})
        return figure({"data": traces, "layout": layout}, title, caption, height)
    bars, names = _bars(state.model, limit)
    notes += labels(state.model, limit, view, float(part * WIDTH / wide))
    height = round(min(max(part * WIDTH * high / wide, 27 * len(names)), 420)) + 78
    bar = {"orientation": "h", "x": 0.5 * part, "xanchor": "center", "y": 0, "yanchor": "top", "len": 0.3}
    picture = drawing_layout(limit, notes, view, [0, part], bar)
    picture |= {
        "xaxis2": style.axis("participation factor [–]", domain=[part + 0.24, 1], range=[0, 1.7], anchor="y2", tickvals=[0, 0.5, 1]),
        "yaxis2": style.axis("", range=[len(names) - 0.4, -0.6], tickvals=list(range(len(names))), ticktext=names, anchor="x2", ticks="")
        | {"showgrid": False},
    }
    narrow = {"margin.l": 8, "margin.r": 8, "xaxis.domain": [0, 1], "yaxis.domain": [0.42, 1]}
    narrow |= {
        "xaxis2.domain": [0.4, 1],
        "yaxis2.domain": [0, 0.34],
        "xaxis2.title.text": "participation [–]",
        "coloraxis.showscale": False,
        "yaxis2.range": [FEW_BARS - 0.4, -0.6],
    }
    hidden = state.model.size - len(names)
    caption += f" Not listed: {hidden} joint{'s' * (hidden > 1)} with less." if hidden else ""
    return figure({"data": [*traces, bars], "layout": picture}, title, caption, height, narrow)


def small(state: State, limit: GainLimit, view: DrawingView, others: int) -> Html:
    """Small figure of one contact state in the common view, with the vibration at `limit`: of its joints' gains or its tasks'.

    others   number of postures of this contact state with more headroom
    """
    traces, notes = drawn(state.model, limit, view, 12)
    picture = drawing_layout(limit, notes, view, [0, 1], {"len": 0.7, "xpad": 4})
    wide, high = view.high - view.low
    height = round(min(max(430 * high / wide, 220), 420)) + 34
    joints = limiting_joints(limit, state.model.joint_names)
    posture = f"The tightest of {others + 1} postures. " if others else ""
    posture += f"{digits(limit.frequency, 'rad/s')}. " if joints else ""
    most = f"Mainly: {', '.join(joints[:4])}{' and more' if len(joints) > 4 else ''}." if joints else "No joint takes part mainly."
    narrow = {"coloraxis.showscale": False}
    return figure({"data": traces, "layout": picture}, f"{state.title}: {_vibrates(limit, short=True)}", posture + most, height, narrow)


def _title(state: State, alone: bool) -> str:
    """Title of the large figure."""
    found = _vibrates(state.limit)
    return f"{found[0].upper()}{found[1:]}" if alone else f"The tightest state, {state.title}: {found}"


def _vibrates(limit: GainLimit, short: bool = False) -> str:
    """Sentence on the factor at which vibration starts, and its frequency."""
    if math.isnan(limit.gain):
        return f"{'stable' if limit.stable else 'UNSTABLE'}; gain limit not known"
    if not math.isfinite(limit.frequency):
        return "no vibration at any factor" if limit.stable else "UNSTABLE at any lower gain"
    if short:
        return f"{'' if limit.stable else 'UNSTABLE; '}{hertz(limit.frequency)} at {digits(limit.gain, '', 3)}\u00a0×"
    at = f"at {hertz(limit.frequency)} ({digits(limit.frequency, 'rad/s', 3)})"
    factor = digits(limit.gain, "", 3)
    if limit.stable:
        return f"vibration starts at {factor}\u00a0× these gains, {at}"
    return f"UNSTABLE; stable below {factor}\u00a0× these gains, where vibration starts {at}"


def _parts(state: State) -> str:
    """Explanation of the marks in the drawing, from the joints' rings on."""
    fixed = state.model.body.base == "fixed"
    patches = (
        "Dark patches are contacts" + " and the fixed base" * fixed if state.model.contacts else "The dark patch is the fixed base" * fixed
    )
    patches += ", the dashed line its stand" * bool(stand(state.model))
    return (
        "rings are joints at one point, the first of the chain outermost. Angles beside the bars: phase lag behind the first joint, 180° "
        f"is opposite. {patches + ', the' if patches else 'The'} crossed circle is the centre of mass."
    )


def _hero_caption(state: State) -> str:
    text = (
        "The colour of a joint is its participation factor: its motion in the vibration at the limit, relative to the largest; "
        f"{_parts(state)} What is farther away is drawn up and to the right, at half scale."
    )
    joints = state.limiting_joints
    if not joints:
        return text.partition(";")[0] + ". Here there is no vibration, so joints are white."
    lead = f"{joints[0]} leads" if len(joints) == 1 else f"{' and '.join(joints[:2])} lead" + (" with others" if len(joints) > 2 else "")
    return f"{lead}: start there for more gain headroom. {text}"


def drawing_layout(limit: GainLimit, notes: list[style.Annotation], view: DrawingView, domain: list[float], bar: dict) -> dict:
    """Layout with hidden, equally scaled axes in `domain` of the width; `bar`: place of the colour bar."""
    hidden = {"showgrid": False, "showline": False, "showticklabels": False, "ticks": "", "zeroline": False, "fixedrange": True}
    ground = "white" if limit.stable else style.UNSTABLE_GROUND
    return style.layout(
        xaxis=hidden | {"range": [view.low[0], view.high[0]], "domain": domain, "constrain": "domain"},
        yaxis=hidden | {"range": [view.low[1], view.high[1]], "scaleanchor": "x", "constrain": "domain"},
        annotations=notes,
        margin={"l": 8, "r": 8, "t": 26, "b": 44 if domain[1] < 1 else 8},
        plot_bgcolor=ground,
        coloraxis={
            "colorscale": PARTICIPATION,
            "cmin": 0,
            "cmax": 1,
            "showscale": vibration(limit) is not None,
            "colorbar": {"title": {"text": "participation"}, "thickness": 10, "tickvals": [0, 0.5, 1], "outlinewidth": 0} | bar,
        },
    )


def _bars(model: RobotModel, limit: GainLimit) -> tuple[style.Trace, list[str]]:
    """Bars of the joints with the largest participation factors, the largest on top."""
    parts, mode = np.abs(limit.mode), limit.mode
    chosen = [k for k in strongest_first(mode)[:MOST_BARS] if parts[k] >= LEAST_BAR]
    values = parts[chosen].tolist()
    bars = {
        "type": "bar",
        "orientation": "h",
        "x": values,
        "y": list(range(len(chosen))),
        "xaxis": "x2",
        "yaxis": "y2",
        "width": 0.72,
        "text": [participation_text(complex(mode[k])) for k in chosen],
        "textposition": "outside",
        "constraintext": "none",
        "cliponaxis": False,
        "hoverinfo": "skip",
        "marker": {"color": values, "coloraxis": "coloraxis", "line": {"color": "#4a4a4a", "width": 1}},
    }
    return bars, [style.shown(model.joint_names[k]) for k in chosen]
