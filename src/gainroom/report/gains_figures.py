"""Figures of locked outputs and of gains: the hysteresis loop, torque predicted by gains, gains beside those asked for."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..identification import GainsFit, Record, StiffnessFit
from ..identification.gains import predicted_torque
from . import style
from .curves import Curve, Panel, stacked
from .number_format import digits, hertz
from .page import Html, figure

MOST_POINTS = 2500  # of a hysteresis loop
SHOWN_SECONDS = 2.0  # of predicted and logged torque
LEAST_WINDOW = 12  # ticks


def hysteresis(fit: StiffnessFit) -> Html:
    """The loop of a locked output: both ways, and the lines that go through them."""
    step = max(1, len(fit.torque) // MOST_POINTS)
    traces, span = [], np.array([fit.deflection.min(), fit.deflection.max()])
    for way, name, color, symbol in ((1, "turning forward", style.BLUE, "circle"), (-1, "turning back", style.VERMILION, "x-thin-open")):
        rows = np.flatnonzero(fit.direction == way)[::step]
        points = {"mode": "markers", "marker": {"color": color, "size": 4.5, "symbol": symbol, "line": {"width": 1, "color": color}}}
        hover: dict[str, Any] = {"hoverinfo": "all", "hovertemplate": "%{x:.3~g} mrad<br>%{y:.3~g} N·m<extra></extra>"}
        traces.append(style.line(1e3 * fit.deflection[rows], fit.torque[rows], color, name=name, showlegend=True, **hover) | points)
        branch = fit.stiffness.value * span + fit.offset + way * fit.friction.value
        traces.append(style.line(1e3 * span, branch, style.BLACK, dash="dash", width=1.4, showlegend=False))
    middle = fit.stiffness.value * span + fit.offset
    traces.append(style.line(1e3 * span, middle, style.BLACK, name=f"K = {digits(fit.stiffness.value, 'N·m/rad')}", showlegend=True))
    layout = style.layout(
        xaxis=style.axis("deflection [mrad]"),
        yaxis=style.axis("torque [N·m]"),
        showlegend=True,
        legend=style.switches(1.02),
        margin={"l": 78, "r": 24, "t": 48, "b": 52},
    )
    caption = (
        f"Dashed: the branches, {digits(2 * fit.friction.value, 'N·m', 3)} apart, which is twice friction, and "
        f"{digits(1e3 * fit.hysteresis.value, 'mrad', 3)} wide. The line between them has the stiffness as its slope."
    )
    return figure({"data": traces, "layout": layout}, "Torque over deflection of the locked output", caption, 480, style.NARROW)


def predicted(fit: GainsFit, record: Record) -> Html:
    """Logged torque and that of the law, over the part of the log where most happens."""
    rows, logged, law = predicted_torque(fit, record)
    count = min(len(logged), max(round(SHOWN_SECONDS / rows.sample_time), LEAST_WINDOW))
    power = np.convolve(np.square(np.diff(logged, prepend=logged[0])), np.ones(count), "valid")
    first = int(np.argmax(power))
    shown = slice(first, first + count)
    panels = [
        Panel("torque", "N·m", [Curve("logged", logged[shown], style.BLACK), Curve("predicted", law[shown], style.ORANGE, "dash")], 0.65),
        Panel("difference", "N·m", [Curve("logged − predicted", (logged - law)[shown], style.BLUE)], 0.35),
    ]
    caption = (
        f"{fit.torque} and the torque of the gains found, both up to {hertz(fit.band)}, where most happens in the log. "
        f"The gains explain {digits(100 * fit.explained, '%', 4)} of its power."
    )
    return stacked(rows.time[shown], panels, "Predicted and logged torque", caption, 460)


def gains_beside(fit: GainsFit, asked: Sequence[tuple[str, float]]) -> Html:
    """Applied over asked, with intervals, on a logarithmic scale; 1 is right."""
    traces, names = [], []
    for name, value in reversed(asked):
        if not value:
            continue
        found = getattr(fit, name)
        ratio, low, high = (max(end / value, 1e-6) for end in (found.value, found.low, found.high))
        names.append(name)
        spread = {
            "type": "data",
            "symmetric": False,
            "array": [high - ratio],
            "arrayminus": [ratio - low],
            "color": style.BLUE,
            "thickness": 2.5,
        }
        hover: dict[str, Any] = {"hoverinfo": "all", "hovertemplate": f"{name}: %{{x:.4~g}} × what was asked<extra></extra>"}
        traces.append(style.markers([ratio], [name], "circle", style.BLUE, 12, **hover) | {"error_x": spread})
    ratios = [trace["x"][0] for trace in traces] or [1.0]
    low, high = min(*ratios, 1.0) / 2, max(*ratios, 1.0) * 2
    layout = style.layout(
        xaxis=style.log_axis("applied over asked", low, high),
        yaxis={"type": "category", "automargin": True, "categoryorder": "array", "categoryarray": names, "range": [-0.6, len(names) - 0.4]},
        shapes=[style.upright(1.0, style.BLACK, "dash", 1.5)],
        margin={"l": 60, "r": 24, "t": 16, "b": 52},
    )
    wrong = "; ".join(f"{error.gain}: {digits(error.factor)} × is {error.name}" for error in fit.unit_errors)
    caption = "The dashed line is what was asked for; bars are 95 % intervals." + (f" {wrong}." if wrong else "")
    return figure({"data": traces, "layout": layout}, "Gains found beside gains asked for", caption, 220, style.NARROW)
