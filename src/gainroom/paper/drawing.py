"""Pictures of the reproduction in plotly's format: Bode plots as the paper has them, gain maps, and the claims' own."""

import math
from typing import Any

from .drawing_curves import curve_drawing
from .drawing_factors import factor_drawing
from .picture import AXIS, BodePicture, CurvePicture, GainPicture, Picture

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")  # Okabe and Ito
DASHES = ("solid", "dash", "dashdot", "dot")
INK, GRID = "#1b1b1b", "#e4e4e4"
TURN = 2 * math.pi
TALL = 620


def drawing(picture: Picture) -> tuple[dict[str, Any], int]:
    """`picture` as a plotly figure, and its height [px]."""
    if isinstance(picture, BodePicture):
        return _bode(picture), TALL
    if isinstance(picture, GainPicture):
        return _gain_map(picture), TALL
    if isinstance(picture, CurvePicture):
        return curve_drawing(picture), TALL if len(picture.panels) > 1 else 440
    return factor_drawing(picture), 110 + (1 + max(line.count("<br>") for line in picture.lines)) * 26 * len(picture.lines)


def _bode(picture: BodePicture) -> dict[str, Any]:
    data = []
    for place, curve in enumerate(picture.curves):
        style = {"color": COLOURS[place], "dash": DASHES[place], "width": 2.2}
        shared = {"x": curve.omega, "mode": "lines", "line": style, "name": curve.label, "legendgroup": curve.label}
        at = "%{x:.4g} rad/s: %{y:.4g}"
        data.append({**shared, "y": curve.magnitude, "xaxis": "x", "yaxis": "y", "hovertemplate": at + " dB"})
        data.append({**shared, "y": curve.phase, "xaxis": "x", "yaxis": "y2", "showlegend": False, "hovertemplate": at + "°"})
    # the Hz axis above needs something of its own to show
    data.append({"x": [AXIS[0] / TURN], "y": [None], "xaxis": "x2", "yaxis": "y", "showlegend": False, "hoverinfo": "skip"})
    decades = [math.log10(end) for end in AXIS]
    layout = {
        **_layout(),
        "xaxis": {**_axis("frequency (rad/s)"), "type": "log", "range": decades, "dtick": 1, "exponentformat": "power", "anchor": "y2"},
        "xaxis2": {
            **_axis("frequency (Hz)"),
            "type": "log",
            "range": [decade - math.log10(TURN) for decade in decades],
            "dtick": 1,
            "exponentformat": "power",
            "overlaying": "x",
            "side": "top",
            "anchor": "y",
            "showgrid": False,
        },
        "yaxis": {**_axis("magnitude (dB)"), "range": picture.magnitude_range, "domain": [0.46, 1.0]},
        "yaxis2": {**_axis("phase (°)"), "range": picture.phase_range, "domain": [0.0, 0.4], "dtick": _phase_step(picture)},
        "shapes": [_level(0, "y"), _level(-180, "y2"), *_stems(picture)],
        "annotations": _notes(picture),
    }
    return {"data": data, "layout": layout}


def _stems(picture: BodePicture) -> list[dict[str, Any]]:
    """Margins, as lines from the curve to 0 dB and on to the phase that makes them."""
    shapes = []
    for mark in picture.marks:
        if mark.stem:
            line = {"color": COLOURS[mark.curve], "width": 1.6, "dash": DASHES[mark.curve]}
            shapes.append({"type": "line", "x0": mark.omega, "x1": mark.omega, "y0": mark.magnitude, "y1": 0, "yref": "y", "line": line})
    return shapes


def _notes(picture: BodePicture) -> list[dict[str, Any]]:
    notes = []
    for mark in picture.marks:
        colour = COLOURS[mark.curve]
        notes.append(
            {
                "x": math.log10(mark.omega),
                "y": mark.magnitude,
                "text": mark.label,
                "arrowcolor": colour,
                "arrowhead": 2,
                "arrowsize": 0.8,
                "ax": 40 if mark.above else -40,
                "ay": -28 if mark.above else 28,
                "xanchor": "left" if mark.above else "right",
                "bgcolor": "rgba(255,255,255,0.85)",
            }
        )
    return notes


def _phase_step(picture: BodePicture) -> int:
    low, high = picture.phase_range
    return 90 if high - low < 400 else 180


def _level(height: float, axis: str) -> dict[str, Any]:
    """A line across the whole picture at 0 dB or −180°."""
    line = {"color": "#777777", "width": 1}
    return {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "yref": axis, "y0": height, "y1": height, "line": line, "layer": "below"}


def _gain_map(picture: GainPicture) -> dict[str, Any]:
    data, notes = [], []
    for place, (label, outline) in enumerate(picture.outlines):
        style = {"color": COLOURS[place], "dash": DASHES[place], "width": 2.2}
        hover = "kp %{x:.4g}, kd %{y:.4g}"
        inside = {"fill": "toself", "fillcolor": "rgba(0,114,178,0.10)"} if place == 0 else {}
        curve = {"x": outline[:, 0], "y": outline[:, 1], "mode": "lines", "line": style, "name": label, "hovertemplate": hover}
        data.append(curve | inside)
    for point in picture.points:
        marker = {"symbol": "circle" if point.stable else "x", "size": 12, "color": INK, "line": {"color": "white", "width": 1.5}}
        data.append({"x": [point.kp], "y": [point.kd], "mode": "markers", "marker": marker, "showlegend": False, "name": point.label})
        notes.append({"x": point.kp, "y": point.kd, "text": point.label, "ax": 54, "ay": 10 if point.stable else -10})
    layout = {
        **_layout(),
        "margin": {"l": 64, "r": 16, "t": 36, "b": 52},
        "legend": {"orientation": "h", "x": 0, "y": 1.01, "xanchor": "left", "yanchor": "bottom"},
        "separators": ".\u202f",
        "xaxis": {**_axis("kp (N m/rad)"), "range": picture.kp_range, "tickformat": ",d"},
        "yaxis": {**_axis("kd (N m s/rad)"), "range": picture.kd_range},
        "annotations": [{**note, "font": {"size": 13}, "arrowwidth": 1, "bgcolor": "rgba(255,255,255,0.85)"} for note in notes],
    }
    return {"data": data, "layout": layout}


def _axis(title: str) -> dict[str, Any]:
    return {
        "title": {"text": title, "font": {"size": 14}},
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": "#888888",
        "ticks": "outside",
    }


def _layout() -> dict[str, Any]:
    return {
        "font": {"size": 13, "color": INK},
        "plot_bgcolor": "white",
        "paper_bgcolor": "white",
        "margin": {"l": 64, "r": 16, "t": 84, "b": 52},
        "legend": {"orientation": "h", "x": 0, "y": 1.13, "xanchor": "left", "yanchor": "bottom"},
        "hovermode": "closest",
    }
