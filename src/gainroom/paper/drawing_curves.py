"""Curves above each other over one axis: claims 2 and 3, Figs. 6 and 11."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..report import style
from ..report.number_format import digits
from .picture import Curve, CurvePicture, Panel, Spot

COLOURS = (style.BLUE, style.VERMILION, style.GREEN)
DASHES = ("solid", "dash", "dashdot")
SPOTS = (("circle", style.BLACK), ("diamond", style.VERMILION), ("triangle-down", style.PURPLE))
PLACES = {  # of a spot's name: plotly's anchors, and a shift [px]
    "left": {"xanchor": "right", "xshift": -9},
    "right": {"xanchor": "left", "xshift": 9},
    "above": {"yanchor": "bottom", "yshift": 8},
    "below": {"yanchor": "top", "yshift": -8},
}
BAND = "rgba(0,0,0,0.07)"
Across = Callable[[float], float]
"""From a place on the common axis to where plotly wants an annotation: a logarithmic axis counts decades."""
GAP = 0.08  # of the height, between panels
ROUNDING = 1e-9  # of the logarithm of a power of ten


def curve_drawing(picture: CurvePicture) -> dict[str, Any]:
    """`picture` as a plotly figure."""
    traces, notes, shapes, axes = [], [], [], {}
    count = len(picture.panels)
    height = (1 - GAP * (count - 1)) / count
    for index, panel in enumerate(picture.panels):
        name = "y" if index == 0 else f"y{index + 1}"
        top = 1 - index * (height + GAP)
        span = [math.log10(end) for end in panel.heights] if panel.logarithmic else list(panel.heights)
        kind = {"type": "log"} | _ticks(*panel.heights) if panel.logarithmic else {}
        axes[f"yaxis{index + 1 if index else ''}"] = style.axis(
            panel.title, range=span, domain=[max(top - height, 0.0), top], fixedrange=True, **kind
        )
        traces += [_line(curve, place, name) for place, curve in enumerate(panel.curves)]
        traces += _spots(panel, name, picture.kinds if index == 0 else ())
        across = math.log10 if picture.logarithmic else float
        notes += [_named(curve, place, panel, name, across) for place, curve in enumerate(panel.curves) if curve.label]
        notes += [_spot_name(spot, panel, name, across) for spot in panel.spots if spot.label]
        if panel.band is not None:
            ends = {"x0": 0, "x1": 1, "xref": "paper", "y0": panel.band[0], "y1": panel.band[1], "yref": name}
            shapes.append({"type": "rect", **ends, "fillcolor": BAND, "line": {"width": 0}, "layer": "below"})
    axes["xaxis"] = style.axis(picture.x_title, anchor=f"y{count}" if count > 1 else "y", fixedrange=True) | _across(picture)
    layout = style.layout(
        **axes,
        shapes=shapes,
        annotations=notes,
        showlegend=bool(picture.kinds),
        legend=style.switches(1.01),
        margin={"l": 72, "r": 16, "t": 40 if picture.kinds else 12, "b": 52},
    )
    return {"data": traces, "layout": layout}


def _across(picture: CurvePicture) -> dict[str, Any]:
    """The common axis's kind and range."""
    if not picture.logarithmic:
        return {"range": list(picture.x_range)}
    return {"type": "log", "range": [math.log10(end) for end in picture.x_range]} | _ticks(*picture.x_range)


def _line(curve: Curve, place: int, axis: str) -> style.Trace:
    hover = {"hoverinfo": "all", "hovertemplate": f"{curve.label}<br>%{{x:.3g}}: %{{y:.3g}}<extra></extra>"}
    return style.line(curve.x, curve.y, COLOURS[place], dash=DASHES[place], width=2.2, yaxis=axis, showlegend=False, **hover)


def _spots(panel: Panel, axis: str, kinds: tuple[str, ...]) -> list[style.Trace]:
    """The points of each sort; their names go into the legend once."""
    traces = []
    for kind, (symbol, color) in enumerate(SPOTS):
        spots = [spot for spot in panel.spots if spot.kind == kind]
        if spots:
            places = [spot.x for spot in spots], [spot.y for spot in spots]
            text = [f"{spot.label}<br>{digits(spot.x)}: {digits(spot.y)}".removeprefix("<br>") for spot in spots]
            name = kinds[kind] if kind < len(kinds) else ""
            parts = {"name": name, "showlegend": bool(name), "hoverinfo": "text", "text": text, "yaxis": axis}
            traces.append(style.markers(*places, symbol, color, 10, **parts))
    return traces


def _named(curve: Curve, place: int, panel: Panel, axis: str, across: Across) -> style.Annotation:
    """The name of a curve, beside it; in its colour where there are others."""
    height = float(np.interp(across(curve.named_at), [across(x) for x in curve.x.tolist()], curve.y))
    color = COLOURS[place] if len(panel.curves) > 1 else style.INK
    return style.label(across(curve.named_at), _height(height, panel), curve.label, color, yref=axis, **PLACES[curve.side])


def _spot_name(spot: Spot, panel: Panel, axis: str, across: Across) -> style.Annotation:
    return style.label(across(spot.x), _height(spot.y, panel), spot.label, yref=axis, **PLACES[spot.side])


def _height(value: float, panel: Panel) -> float:
    """Where plotly wants an annotation: a logarithmic axis counts decades."""
    return math.log10(value) if panel.logarithmic else value


def _ticks(low: float, high: float) -> dict[str, Any]:
    """Powers of ten."""
    values = [10.0**k for k in range(math.ceil(math.log10(low) - ROUNDING), math.floor(math.log10(high) + ROUNDING) + 1)]
    return {"tickmode": "array", "tickvals": values, "ticktext": [digits(value) for value in values]}
