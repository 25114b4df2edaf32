"""Factors, line by line, on a logarithmic axis: Table I's computed gains over the printed ones, and claim 4's limits."""

import math
from typing import Any

import numpy as np

from ..report import style
from ..report.number_format import digits
from .picture import DotPicture

MARKS = (  # open ones are larger, so that they show under the others
    ("diamond", style.BLUE, 10),
    ("circle-open", style.VERMILION, 12),
    ("square-open", style.BLACK, 9),
    ("triangle-up-open", style.GREEN, 11),
)
BAND = "rgba(0,0,0,0.07)"


def factor_drawing(picture: DotPicture) -> dict[str, Any]:
    """`picture` as a plotly figure."""
    low, high = picture.x_range
    traces = [_joined(picture, k) for k in range(len(picture.lines))]
    for (symbol, color, size), dots in zip(MARKS, picture.series, strict=False):
        text = [f"{line}<br>{dots.label}: {digits(value)}" for line, value in zip(picture.lines, dots.values.tolist(), strict=True)]
        places = np.clip(dots.values, low, high), list(range(len(picture.lines)))
        trace = style.markers(*places, symbol, color, size, name=dots.label, hoverinfo="text", text=text, showlegend=True)
        is_open = symbol.endswith("open")
        trace["marker"]["line"] = {"width": 2.2 if is_open else 1, "color": color if is_open else "white"}
        traces.append(trace)
    shapes = [{**_upright(1.0, 1.0), "type": "line", "line": {"color": style.INK, "dash": "dot", "width": 1.4}}]
    if picture.band is not None:
        shapes.append({**_upright(*picture.band), "type": "rect", "fillcolor": BAND, "line": {"width": 0}})
    layout = style.layout(
        xaxis=style.axis(picture.x_title, type="log", range=[math.log10(low), math.log10(high)], fixedrange=True) | _ticks(low, high),
        yaxis=style.axis("", tickvals=list(range(len(picture.lines))), ticktext=list(picture.lines), fixedrange=True)
        | {"range": [len(picture.lines) - 0.4, -0.6]},
        shapes=shapes,
        showlegend=True,
        legend=style.switches(1.01),
        margin={"l": 20, "r": 12, "t": 40, "b": 48},
    )
    return {"data": traces, "layout": layout}


def _joined(picture: DotPicture, k: int) -> style.Trace:
    """The quiet bar behind the marks of one line."""
    values = np.array([dots.values[k] for dots in picture.series])
    ends = np.clip([np.nanmin(values), np.nanmax(values)], *picture.x_range)
    return style.line(ends, [k, k], "#c8c8c8", width=3, showlegend=False)


def _upright(left: float, right: float) -> dict[str, Any]:
    return {"x0": left, "x1": right, "y0": 0, "y1": 1, "yref": "paper", "layer": "below"}


def _ticks(low: float, high: float) -> dict[str, Any]:
    steps = (1, 2, 5)
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [step * 10.0**exponent for exponent in exponents for step in steps if low <= step * 10.0**exponent <= high]
    return {"tickmode": "array", "tickvals": values, "ticktext": [digits(value) for value in values]}
