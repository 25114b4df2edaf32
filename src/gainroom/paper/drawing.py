"""Pictures of the reproduction in plotly's format, and as figures of a page."""

import math
from typing import Any

from ..report import style
from ..report.number_format import digits
from ..report.page import Html, figure
from .picture import Curve, Panel, Picture

COLOURS = (style.BLUE, style.VERMILION, style.GREEN, style.PURPLE)
DASHES = ("solid", "dash", "dashdot", "dot")
MARKS = (  # of each kind; open ones are larger, so that they show around the others
    ("diamond", style.BLUE, 10),
    ("circle-open", style.VERMILION, 12),
    ("square-open", style.BLACK, 10),
    ("triangle-up-open", style.GREEN, 11),
    ("x", style.VERMILION, 12),
)
SIDES = {  # of a name: plotly's anchors, and a shift [px]
    "left": {"xanchor": "right", "xshift": -8},
    "right": {"xanchor": "left", "xshift": 8},
    "above": {"yanchor": "bottom", "yshift": 7},
    "below": {"yanchor": "top", "yshift": -7},
}
BAND, SHADE, BAR = "rgba(0,0,0,0.07)", "rgba(0,114,178,0.10)", "#c8c8c8"
GAP = 0.08  # of the height, between panels


def drawn(picture: Picture) -> Html:
    """`picture` as a figure of a page."""
    height = 440 if len(picture.panels) == 1 and not any(curve.filled for curve in picture.panels[0].curves) else 620
    return figure(plotly_figure(picture), picture.title, picture.caption, height, {"margin.r": 8})


def plotly_figure(picture: Picture) -> dict[str, Any]:
    """`picture` in plotly's format."""
    count = len(picture.panels)
    traces, notes, shapes, axes = [], [], [], _x_axes(picture)
    height = (1 - GAP * (count - 1)) / count
    for index, panel in enumerate(picture.panels):
        name = "y" if index == 0 else f"y{index + 1}"
        on = {"xaxis": "x2" if picture.hertz and index == 0 else "x", "yaxis": name}
        top = 1 - index * (height + GAP)
        axes[name.replace("y", "yaxis")] = _y_axis(panel, domain=[max(top - height, 0.0), top], anchor=on["xaxis"])
        bars = [mark for mark in panel.marks if mark.stem is not None]
        traces += [style.line([mark.x, mark.x], [mark.y, mark.stem], BAR, width=3, showlegend=False, **on) for mark in bars]
        traces += [_line(curve, place, on) for place, curve in enumerate(panel.curves)]
        traces += _points(panel, on, picture.kinds if index == 0 else ())
        notes += _names(panel, name, picture.logarithmic)
        shapes += _ground(panel, name)
    has_legend = any(trace.get("showlegend") for trace in traces)
    top = 40 * has_legend + 44 * picture.hertz
    layout = style.layout(
        **axes,
        shapes=shapes,
        annotations=notes,
        showlegend=has_legend,
        legend=style.switches(1.12 if picture.hertz else 1.01),
        margin={"l": 72, "r": 16, "t": top or 12, "b": 52},
    )
    return {"data": traces, "layout": layout}


def _x_axes(picture: Picture) -> dict[str, Any]:
    if picture.hertz:
        return style.frequency_axes(*picture.x_range)
    anchor = "y" if len(picture.panels) == 1 else f"y{len(picture.panels)}"
    if picture.logarithmic:
        return {"xaxis": style.log_axis(picture.x_title, *picture.x_range, anchor=anchor)}
    names = {"tickvals": list(range(len(picture.places))), "ticktext": list(picture.places)} if picture.places else {}
    return {"xaxis": style.axis(picture.x_title, range=list(picture.x_range), anchor=anchor, **names)}


def _y_axis(panel: Panel, **parts: Any) -> dict[str, Any]:
    if panel.logarithmic:
        return style.log_axis(panel.title, *panel.heights, **parts)
    return style.axis(panel.title, range=list(panel.heights), dtick=panel.step, **parts)


def _line(curve: Curve, place: int, axes: dict[str, str]) -> style.Trace:
    """A curve; its name stands in the legend once, of the first panel."""
    hover = {"hoverinfo": "all", "hovertemplate": f"{curve.name}<br>%{{x:.4g}}: %{{y:.4g}}<extra></extra>"}
    legend = {"name": curve.name, "legendgroup": curve.name, "showlegend": bool(curve.name) and axes["yaxis"] == "y"}
    inside = {"fill": "toself", "fillcolor": SHADE} if curve.filled else {}
    return style.line(curve.x, curve.y, COLOURS[place], dash=DASHES[place], width=2.2, **axes, **hover, **legend, **inside)


def _points(panel: Panel, axes: dict[str, str], kinds: tuple[str, ...]) -> list[style.Trace]:
    """The marks of each kind; the kinds' names go into the legend."""
    traces = []
    for kind, (symbol, color, size) in enumerate(MARKS):
        marks = [mark for mark in panel.marks if mark.kind == kind]
        if marks:
            name = kinds[kind] if kind < len(kinds) else ""
            text = ["<br>".join(filter(None, (mark.name or name, f"{digits(mark.x)}: {digits(mark.y)}"))) for mark in marks]
            parts = {"name": name, "showlegend": bool(name), "hoverinfo": "text", "text": text} | axes
            traces.append(style.markers([mark.x for mark in marks], [mark.y for mark in marks], symbol, color, size, **parts))
    return traces


def _names(panel: Panel, axis: str, logarithmic: bool) -> list[style.Annotation]:
    notes = []
    for mark in panel.marks:
        if mark.name:
            # on a logarithmic axis plotly wants decades
            x = math.log10(mark.x) if logarithmic else mark.x
            y = math.log10(mark.y) if panel.logarithmic else mark.y
            anchors = {key: value for side in mark.side.split() for key, value in SIDES[side].items()}
            notes.append(style.label(x, y, mark.name, yref=axis, **anchors))
    return notes


def _ground(panel: Panel, axis: str) -> list[dict[str, Any]]:
    """Shapes of a panel's band and levels, behind everything else."""
    across = {"x0": 0, "x1": 1, "xref": "paper", "yref": axis, "layer": "below"}
    shapes = [across | {"type": "line", "y0": y, "y1": y, "line": {"color": "#777", "width": 1.2}} for y in panel.levels]
    if panel.band is not None:
        low, high = panel.band
        shapes.append(across | {"type": "rect", "y0": low, "y1": high, "fillcolor": BAND, "line": {"width": 0}})
    return shapes
