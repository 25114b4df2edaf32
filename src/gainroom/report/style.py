"""Style of all figures: colours distinguishable by all eyes, a quiet grid, labels on the lines."""

import math
from html import escape
from typing import Any

from .number_format import digits

# Okabe and Ito, Color Universal Design (2008)
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = "#000000", "#e69f00", "#56b4e9", "#009e73", "#0072b2", "#d55e00", "#cc79a7"
INK, SOFT, GRID = "#1b1b1b", "#5a5a5a", "#e6e6e6"
DARK = {PURPLE: "#96386f", GREEN: "#00704f", VERMILION: "#b34a00"}  # the same hues where they must be read as text
UNSTABLE_GROUND = "#fdf1e9"
TEXT = 13  # [px]
LINK, MOTOR = 3.0, 1.1  # [px] widths of their lines: people see the link
LONGEST = 26  # characters of a name in a picture
ROUNDING = 1e-9  # relative: a tick at an axis's end is on it
NARROW = {"margin.l": 58, "margin.r": 8}

Trace = dict[str, Any]
Annotation = dict[str, Any]


def layout(**parts: Any) -> dict[str, Any]:
    """Common figure layout, with the figure's own `parts`."""
    base: dict[str, Any] = {
        "font": {"family": 'system-ui, "Segoe UI", Roboto, Arial, sans-serif', "size": TEXT, "color": INK},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": {"l": 72, "r": 24, "t": 16, "b": 52},
        "hovermode": "closest",
        "hoverlabel": {"bgcolor": "white", "font": {"size": TEXT}},
        "showlegend": False,
        "autosize": True,
        "separators": ".\u202f",
        "dragmode": False,
    }
    return base | parts


def axis(title: str, **parts: Any) -> dict[str, Any]:
    """Linear axis. Its title names quantity and unit."""
    base: dict[str, Any] = {
        "title": {"text": title, "standoff": 8},
        "gridcolor": GRID,
        "linecolor": "#888",
        "showline": True,
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": "#888",
        "zeroline": False,
        "tickformat": ",~r",
        "automargin": True,
    }
    return base | parts


def log_axis(title: str, low: float, high: float, scale: float = 1.0, **parts: Any) -> dict[str, Any]:
    """Logarithmic axis over [low, high] with ticks at 1, 2 and 5, or at every digit, in units of `scale` (2π: rad/s in Hz)."""
    wide, narrow = high / low > 3e3, high / low < 10  # wide: only powers of ten have room for their names
    named = (1,) if wide else (1, 2, 5) if high / low > 4 else range(1, 10)
    ticks, names = [], []
    for decade in range(math.floor(math.log10(low / scale)), math.ceil(math.log10(high / scale)) + 1):
        for step in range(1, 10) if narrow else (1, 2, 5):
            value = step * 10.0**decade
            if low <= value * scale * (1 + ROUNDING) and value * scale <= high * (1 + ROUNDING):
                ticks.append(value * scale)
                names.append(digits(value) if step in named else "")
    span = [math.log10(low), math.log10(high)]
    return axis(title, type="log", range=span, tickmode="array", tickvals=ticks, ticktext=names, **parts)


def frequency_axes(low: float, high: float) -> dict[str, Any]:
    """Axes of two panels over [low, high] rad/s: in rad/s under the lower one (x, y2), in Hz above the upper one (x2, y)."""
    above = {"side": "top", "anchor": "y", "matches": "x", "showgrid": False}
    return {
        "xaxis": log_axis("frequency [rad/s]", low, high, anchor="y2"),
        "xaxis2": log_axis("frequency [Hz]", low, high, 2 * math.pi, **above),
    }


def decades(name: str, low: float, high: float, scale: float = 1.0) -> dict[str, Any]:
    """Ticks of a logarithmic axis on a phone: powers of ten only."""
    exponents = range(math.ceil(math.log10(low / scale)), math.floor(math.log10(high / scale)) + 1)
    values = [10.0**exponent for exponent in exponents]
    return {f"{name}.tickvals": [value * scale for value in values], f"{name}.ticktext": [digits(value) for value in values]}


def line(x: Any, y: Any, color: str, *, dash: str = "solid", width: float = 2, **parts: Any) -> Trace:
    """Trace of a curve."""
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": y,
        "line": {"color": color, "dash": dash, "width": width},
        "hoverinfo": "skip",
    } | parts


def markers(x: Any, y: Any, symbol: str, color: str, size: float = 10, **parts: Any) -> Trace:
    """Trace of points."""
    edge = {"color": color, "width": 2.2} if symbol.endswith("open") else {"color": "white", "width": 1.5}
    marker = {"symbol": symbol, "color": color, "size": size, "line": edge}
    return {"type": "scatter", "mode": "markers", "x": x, "y": y, "marker": marker, "hoverinfo": "skip"} | parts


def upright(x: float, color: str, dash: str = "solid", width: float = 1, **parts: Any) -> dict[str, Any]:
    """Vertical line across the whole height, behind everything else."""
    line = {"color": color, "dash": dash, "width": width}
    return {"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "yref": "paper", "line": line, "layer": "below"} | parts


def stretch(low: float, high: float, color: str, opacity: float) -> dict[str, Any]:
    """Band from `low` to `high` across the whole height, behind everything else."""
    place = {"type": "rect", "x0": low, "x1": high, "y0": 0, "y1": 1, "yref": "paper", "layer": "below"}
    return place | {"fillcolor": color, "opacity": opacity, "line": {"width": 0}}


def label(x: float, y: float, text: str, color: str = INK, **parts: Any) -> Annotation:
    """Text label on a white ground, so that lines do not run through it."""
    base = {
        "x": x,
        "y": y,
        "text": text,
        "showarrow": False,
        "font": {"color": DARK.get(color, color), "size": TEXT},
        "bgcolor": "rgba(255,255,255,0.82)",
        "borderpad": 1,
    }
    return base | parts


def stamp(word: str) -> Annotation:
    """Label with one large word at the lower right of a figure, such as a verdict."""
    place = {"xref": "x domain", "yref": "y domain", "xanchor": "right", "yanchor": "bottom"}
    return label(1, 0, f"<b>{word}</b>", **place) | {"font": {"size": 18, "color": DARK[VERMILION]}}


def arrow(start: tuple[float, float], end: tuple[float, float], color: str, **parts: Any) -> Annotation:
    """Arrow in data coordinates (on a logarithmic axis: decimal logarithms, as plotly requires)."""
    base = {
        "ax": start[0],
        "ay": start[1],
        "x": end[0],
        "y": end[1],
        "axref": "x",
        "ayref": "y",
        "text": "",
        "showarrow": True,
        "arrowhead": 2,
        "arrowsize": 1,
        "arrowwidth": 1.6,
        "arrowcolor": color,
    }
    return base | parts


def switches(y: float = 1.0, **parts: Any) -> dict[str, Any]:
    """Legend above the figure whose entries switch their lines on and off."""
    return {"orientation": "h", "x": 0, "xanchor": "left", "y": y, "yanchor": "bottom", "font": {"size": TEXT}, "itemwidth": 30} | parts


def shown(name: str) -> str:
    """Name as plain text for a figure, shortened."""
    return escape(name if len(name) <= LONGEST else name[: LONGEST - 1] + "…", quote=False)
