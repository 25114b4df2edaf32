"""Figures of curves over time, in stacked panels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..system.linear.arrays import Floats, Integers, distinct
from . import style
from .page import Html, figure

MOST_POINTS = 2400  # most points of a curve
MARGINS = {"l": 78, "r": 24, "t": 8, "b": 52}  # [px]
PANEL_GAP, LEGEND_LINE = 14, 21  # [px] between panels, and what a line of a legend takes
WIDE, PHONE = 920, 300  # [px] that a legend has
LETTER, KEY = 7.0, 46  # [px] of a legend's entry: about that much per letter, and the line before it


@dataclass(frozen=True)
class Curve:
    """Signal (k,) over time; `named`: True if it is in its panel's legend; `width` [px]."""

    name: str
    values: Floats
    color: str
    dash: str = "solid"
    named: bool = True
    width: float = 1.8


@dataclass(frozen=True)
class Panel:
    """Curves in one pair of axes, with title, unit, and share of the figure's height."""

    title: str
    unit: str
    curves: Sequence[Curve]
    share: float


def stacked(
    time: Floats,
    panels: Sequence[Panel],
    title: str,
    caption: str,
    height: int,
    notes: Sequence[style.Annotation] = (),
    most: int = MOST_POINTS,
    shapes: Sequence[dict[str, Any]] = (),
) -> Html:
    """Figure of panels over one time axis, `height` [px] in all, each under its own legend; `most` points per curve."""
    traces, legends, axes = [], {}, {}
    for index, panel in enumerate(panels):
        number = "" if index == 0 else str(index + 1)
        axes[f"yaxis{number}"] = style.axis(f"{panel.title} [{panel.unit}]")
        for curve in panel.curves:
            keep = thinned(curve.values, most)
            hover = f"%{{x:.4g}} s: %{{y:.4g}} {panel.unit}<extra>{style.shown(curve.name)}</extra>"
            look = {"dash": curve.dash, "width": curve.width, "name": style.shown(curve.name), "hoverinfo": "all", "hovertemplate": hover}
            place = {"yaxis": f"y{number}", "legend": f"legend{number}", "showlegend": curve.named}
            traces.append(style.line(time[keep], curve.values[keep], curve.color, **look, **place))
    wide, phone = (_domains(panels, height - MARGINS["t"] - MARGINS["b"], width) for width in (WIDE, PHONE))
    narrow: dict[str, Any] = dict(style.NARROW)
    for index, (panel, domain, small) in enumerate(zip(panels, wide, phone, strict=True)):
        number = "" if index == 0 else str(index + 1)
        axes[f"yaxis{number}"]["domain"] = domain
        legends[f"legend{number}"] = style.switches(domain[1])
        narrow |= {f"yaxis{number}.title.text": f"[{panel.unit}]", f"yaxis{number}.domain": small, f"legend{number}.y": small[1]}
    layout = style.layout(
        xaxis=style.axis("time [s]", anchor=f"y{len(panels) if len(panels) > 1 else ''}", range=[float(time[0]), float(time[-1])]),
        **axes,
        **legends,
        annotations=list(notes),
        shapes=list(shapes),
        showlegend=True,
        margin=MARGINS,
    )
    return figure({"data": traces, "layout": layout}, title, caption, height, narrow)


def _domains(panels: Sequence[Panel], height: float, width: float) -> list[list[float]]:
    """Vertical extent of each panel, from the bottom 0 to the top 1 of `height` [px], with space above for its legend of `width` [px]."""
    above = [LEGEND_LINE * _legend_lines(panel, width) + (PANEL_GAP if index else 0) for index, panel in enumerate(panels)]
    left = height - sum(above)
    shares = [panel.share / sum(panel.share for panel in panels) for panel in panels]
    domains, top = [], height
    for space, share in zip(above, shares, strict=True):
        top -= space
        domains.append([max(0.0, (top - share * left) / height), top / height])
        top -= share * left
    return domains


def _legend_lines(panel: Panel, width: float) -> int:
    """Number of lines of a panel's legend. Plotly gives all entries of a legend the width of the longest."""
    names = [curve.name for curve in panel.curves if curve.named]
    if not names:
        return 0
    longest = KEY + LETTER * min(style.LONGEST, max(map(len, names)))
    return math.ceil(len(names) / max(1, int(width // longest)))


def thinned(values: Floats, most: int = MOST_POINTS) -> Integers:
    """Indices of `values` (k,) that draw the same curve: all, or the lowest and the highest of every stretch."""
    count = len(values)
    if count <= most:
        return np.arange(count)
    edges = np.linspace(0, count, most // 2 + 1).astype(int)
    picked = [0, count - 1]
    for begin, end in pairwise(edges.tolist()):
        part = values[begin:end]
        picked += [begin + int(np.argmin(part)), begin + int(np.argmax(part))]
    return distinct(np.array(picked))
