"""The cost of coupling: the gain factor that one loop alone allows, beside what the whole robot allows."""

import math
from collections.abc import Sequence

import numpy as np

from ..errors import listed
from ..system.linear.arrays import Floats
from . import style
from .number_format import digits
from .page import Html, figure
from .robot_headroom import Factors

WIDEST = 1e3  # ratio of the factors on one axis; what lies beyond is drawn at its end
NEGLIGIBLE = 0.97  # of the factor alone: where more remains, the cost of coupling is not reported
MARKS = (
    ("alone", "circle-open", style.BLUE, 15),
    ("other loops closed", "circle", style.BLACK, 10),
    ("all together", "diamond", style.VERMILION, 8),
)
Row = tuple[str, tuple[float, float, float]]
"""Name; factor alone, with the other loops closed, all together. NaN: none."""


def coupling(factors: Factors, what: str) -> tuple[Html, Html]:
    """The factors on one part alone, on one with the other loops closed, and on all: by state, and by part in the tightest state."""
    few, tight = factors.few(), factors.tightest
    by_state: list[Row] = [
        (style.shown(state.title), (_least(few.alone[k]), _least(few.other_loops_closed[k]), float(few.together[k])))
        for k, state in enumerate(few.states)
    ]
    parts = zip(factors.parts, factors.alone[tight].tolist(), factors.other_loops_closed[tight].tolist(), strict=True)
    by_part: list[Row] = [(style.shown(part), (alone, closed, math.nan)) for part, alone, closed in parts]
    title = f"Each {what} in {factors.states[tight].title}"
    return (
        _dumbbells(by_state, math.nan, f"Tightest {what}, state by state", _cost_caption(factors, what)),
        _dumbbells(by_part, float(factors.together[tight]), title, _part_caption(factors, what)),
    )


def _least(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(known.min()) if len(known) else math.nan


def _dumbbells(rows: Sequence[Row], whole: float, title: str, caption: str) -> Html:
    """Three marks per row on a logarithmic scale of factors, joined; `whole`: one value for all rows, drawn as a line."""
    finite = [value for _, values in rows for value in (*values, whole) if math.isfinite(value) and value > 0]
    low, high = min([1.0, *finite]), max([1.0, *finite])
    left, right = 0.75 * low, 1.6 * min(high, WIDEST * low)
    shapes = [style.upright(1.0, style.INK, "dot", 1.4)]
    notes = [style.label(0.0, 1, "these gains", style.SOFT, yref="paper", yanchor="bottom", bgcolor="rgba(0,0,0,0)")]
    if 0 < whole < math.inf:
        shapes.append(style.upright(whole, style.VERMILION, "solid", 2))
        side = "left" if math.log(whole / left) < 0.5 * math.log(right / left) else "right"
        place = {"yref": "paper", "yanchor": "bottom", "xanchor": side, "xshift": 4 if side == "left" else -4}
        notes.append(style.label(math.log10(whole), 0, f"all together {digits(whole, '×', 3)}", style.VERMILION, **place))
    span = {"range": [len(rows) - (0.4 if math.isnan(whole) else -0.3), -0.6], "fixedrange": True}
    picture = style.layout(
        xaxis=style.log_axis("factor on the gains [×]", left, right, fixedrange=True),
        yaxis=style.axis("", tickvals=list(range(len(rows))), ticktext=[name for name, _ in rows], **span),
        shapes=shapes,
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.0, yref="container", yanchor="top"),
        margin={"l": 20, "r": 12, "t": 62, "b": 48},
    )
    beyond = any(value > right or value < left for _, values in rows for value in values)
    caption += " Marks at an end of the scale lie beyond it." if beyond else ""
    height = round(max(26 * len(rows) + 130, 220))
    return figure({"data": _marks(rows, left, right), "layout": picture}, title, caption, height, {"margin.l": 8})


def _marks(rows: Sequence[Row], left: float, right: float) -> list[style.Trace]:
    """The bars first, the three kinds of marks over them; none outside [left, right]."""
    edge = (right / left) ** 0.03
    names, values = [name for name, _ in rows], np.array([values for _, values in rows])
    places = np.clip(values, left * edge, right / edge)
    traces = []
    for k, place in enumerate(places):
        known = place[~np.isnan(place)]
        if len(known):
            traces.append(style.line([known.min(), known.max()], [k, k], "#b0b0b0", width=3, showlegend=False))
    for column, (kind, symbol, color, size) in enumerate(MARKS):
        known = np.flatnonzero(~np.isnan(values[:, column]))
        if len(known):
            text = [f"{names[k]}<br>{kind}: {digits(values[k, column], '×')}" for k in known]
            named = {"name": kind, "hoverinfo": "text", "text": text, "showlegend": True}
            traces.append(style.markers(places[known, column], known, symbol, color, size, **named))
    return traces


def _cost_caption(factors: Factors, what: str) -> str:
    """Where the coupling costs most."""
    pairs = [(_least(alone), float(whole)) for alone, whole in zip(factors.alone, factors.together, strict=True)]
    costs = [(whole / alone, k) for k, (alone, whole) in enumerate(pairs) if 0 < alone < math.inf and math.isfinite(whole)]
    if not costs and np.any(factors.alone == 0):
        return _lost_alone(factors, what)
    if not costs:
        return "No single gain has a limit, so there is nothing to compare."
    ratio, k = min(costs)
    if ratio > NEGLIGIBLE:
        return f"Coupling costs less than 3 %: in every state all gains together allow the factor of the tightest {what} alone."
    alone, whole = pairs[k]
    return (
        f"Coupling costs most in {factors.states[k].title}: the tightest {what} alone allows {digits(alone, '', 3)} ×, all together "
        f"{digits(whole, '', 3)} ×, {100 * ratio:.0f} % of it."
    )


def _lost_alone(factors: Factors, what: str) -> str:
    """Parts that are unstable by themselves at any factor: coupling is not the cause."""
    lost = [part for k, part in enumerate(factors.parts) if np.any(factors.alone[:, k] == 0)]
    known = int(np.count_nonzero(~np.isnan(factors.alone).all(axis=0)))
    if len(lost) == known:
        return f"No {what} is stable by itself at any lower gains: coupling is not the cause of the vibration."
    return (
        f"Unstable by themselves at any lower gains: {listed(lost)} ({len(lost)} of {known}). Coupling is not the cause of their vibration."
    )


def _part_caption(factors: Factors, what: str) -> str:
    """The effect of closing the other loops on each part."""
    tight = factors.tightest
    if not factors.stable[tight]:
        whole = factors.together[tight]
        lower = "all gains together must be scaled to the left of the line" if whole > 0 else "no factor on all gains is stable"
        lower = "the stable factor on all gains is not known" if math.isnan(whole) else lower
        return f"Unstable: with the other loops closed no single {what} has a factor; {lower}."
    both = zip(factors.alone[tight].tolist(), factors.other_loops_closed[tight].tolist(), strict=True)
    pairs = [(closed / alone, k) for k, (alone, closed) in enumerate(both) if 0 < alone < math.inf and closed < math.inf]
    if not pairs:
        return f"No single {what} has a limit here."
    ratio, k = min(pairs)
    if ratio > NEGLIGIBLE:
        return f"With the other loops closed every {what} allows the same factor as alone."
    return f"{factors.parts[k]} loses most: with the other loops closed it allows {100 * ratio:.0f} % of its factor alone."
