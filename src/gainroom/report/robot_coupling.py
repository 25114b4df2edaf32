"""What the coupling costs: the factor that one loop alone would allow, beside what the whole robot allows."""

import math
from collections.abc import Sequence

import numpy as np

from ..errors import listed
from ..linear.arrays import Floats
from . import style
from .number_format import digits
from .page import Html, figure
from .robot_room import Factors

WIDEST = 1e3  # ratio of the factors on one axis; what lies beyond is drawn at its end
NEGLIGIBLE = 0.97  # coupling that leaves more than this share costs nothing worth a word
MARKS = (
    ("alone", "circle-open", style.BLUE, 15),
    ("others closed", "circle", style.BLACK, 10),
    ("all together", "diamond", style.VERMILION, 8),
)
Row = tuple[str, tuple[float, float, float]]
"""Name; factor alone, with the others closed, all together. NaN: none."""


def coupling(factors: Factors, what: str) -> tuple[Html, Html]:
    """What scaling one part alone, one with the others closed, and all together allow: by state, and by part in the tightest state."""
    few, tight = factors.few(), factors.tightest
    by_state: list[Row] = [
        (style.shown(state.title), (_least(few.alone[k]), _least(few.closed[k]), float(few.whole[k]))) for k, state in enumerate(few.states)
    ]
    parts = zip(factors.parts, factors.alone[tight].tolist(), factors.closed[tight].tolist(), strict=True)
    by_part: list[Row] = [(style.shown(part), (alone, closed, math.nan)) for part, alone, closed in parts]
    title = f"Each {what} in {factors.states[tight].title}"
    return (
        _dumbbells(by_state, math.nan, f"Tightest {what}, state by state", _cost_caption(factors, what)),
        _dumbbells(by_part, float(factors.whole[tight]), title, _part_caption(factors, what)),
    )


def _least(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(known.min()) if len(known) else math.nan


def _dumbbells(rows: Sequence[Row], whole: float, title: str, caption: str) -> Html:
    """Three marks per row on a logarithmic scale of factors, joined; `whole`: one value for all rows, drawn as a line."""
    finite = [value for _, values in rows for value in (*values, whole) if math.isfinite(value) and value > 0]
    low, high = min([1.0, *finite]), max([1.0, *finite])
    left, right = 0.75 * low, 1.6 * min(high, WIDEST * low)
    shapes = [_upright(1.0, style.INK, "dot", 1.4)]
    notes = [style.label(0.0, 1, "these gains", style.SOFT, yref="paper", yanchor="bottom", bgcolor="rgba(0,0,0,0)")]
    if 0 < whole < math.inf:
        shapes.append(_upright(whole, style.VERMILION, "solid", 2))
        side = "left" if math.log(whole / left) < 0.5 * math.log(right / left) else "right"
        place = {"yref": "paper", "yanchor": "bottom", "xanchor": side, "xshift": 4 if side == "left" else -4}
        notes.append(style.label(math.log10(whole), 0, f"all together {digits(whole, '×', 3)}", style.VERMILION, **place))
    room = {"range": [len(rows) - (0.4 if math.isnan(whole) else -0.3), -0.6], "fixedrange": True}
    across = {"type": "log", "range": [math.log10(left), math.log10(right)], "fixedrange": True} | _round_factors(left, right)
    picture = style.layout(
        xaxis=style.axis("factor on the gains [×]", **across),
        yaxis=style.axis("", tickvals=list(range(len(rows))), ticktext=[name for name, _ in rows], **room),
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

    def inside(value: float) -> float:
        return min(max(value, left * edge), right / edge)

    traces = []
    for k, (_, values) in enumerate(rows):
        ends = [inside(value) for value in values if not math.isnan(value)]
        if ends:
            traces.append(style.line([min(ends), max(ends)], [k, k], "#b0b0b0", width=3, showlegend=False))
    for column, (name, symbol, color, size) in enumerate(MARKS):
        known = [(k, title, values[column]) for k, (title, values) in enumerate(rows) if not math.isnan(values[column])]
        if not known:
            continue
        text = [f"{title}<br>{name}: {digits(value, '×')}" for _, title, value in known]
        place = [inside(value) for _, _, value in known], [k for k, _, _ in known]
        trace = style.markers(*place, symbol, color, size, name=name, hoverinfo="text", text=text, showlegend=True)
        is_open = symbol.endswith("open")
        trace["marker"]["line"] = {"width": 2.4 if is_open else 1, "color": color if is_open else "white"}
        traces.append(trace)
    return traces


def _upright(x: float, color: str, dash: str, width: float) -> dict:
    line = {"color": color, "dash": dash, "width": width}
    return {"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "yref": "paper", "line": line, "layer": "below"}


def _round_factors(left: float, right: float) -> dict:
    """Ticks at 1, 2 and 5 of every decade, only at 1 over many, at every digit over less than one."""
    span = right / left
    steps = (1,) if span >= 300 else (1, 2, 5) if span >= 10 else range(1, 10)
    decades = range(math.floor(math.log10(left)), math.ceil(math.log10(right)) + 1)
    values = [step * 10.0**decade for decade in decades for step in steps if left <= step * 10.0**decade <= right]
    return {"tickmode": "array", "tickvals": values, "ticktext": [digits(value) for value in values]}


def _cost_caption(factors: Factors, what: str) -> str:
    """Where the coupling costs most, in words."""
    pairs = [(_least(alone), float(whole)) for alone, whole in zip(factors.alone, factors.whole, strict=True)]
    costs = [(whole / alone, k) for k, (alone, whole) in enumerate(pairs) if 0 < alone < math.inf and math.isfinite(whole)]
    if not costs and any(np.any(alone == 0) for alone in factors.alone):
        return _lost_alone(factors, what)
    if not costs:
        return "Nothing limits these gains one by one, so there is nothing to compare."
    share, k = min(costs)
    if share > NEGLIGIBLE:
        return f"Coupling costs next to nothing here: in every state all together allow what the tightest {what} alone does, within 3 %."
    alone, whole = pairs[k]
    return (
        f"Coupling costs most in {factors.states[k].title}: the tightest {what} alone allows {digits(alone, '', 3)}, all together only "
        f"{digits(whole, '', 3)}, {100 * share:.0f} % of it. Whoever looks at one {what} at a time believes in the open circles."
    )


def _lost_alone(factors: Factors, what: str) -> str:
    """That parts are unstable by themselves, whatever the factor: there is nothing left for the coupling to cost."""
    lost = [part for k, part in enumerate(factors.parts) if np.any(factors.alone[:, k] == 0)]
    known = int(np.count_nonzero(~np.isnan(factors.alone).all(axis=0)))
    if len(lost) == known:
        return f"No {what} is stable by itself, by whatever factor its gains are lowered: the coupling is not what makes it vibrate."
    return (
        f"Not stable by themselves, by whatever factor their gains are lowered: {listed(lost)} ({len(lost)} of {known}). "
        "The coupling is not what makes them vibrate."
    )


def _part_caption(factors: Factors, what: str) -> str:
    """What closing the other loops does to each part."""
    tight = factors.tightest
    if not factors.stable[tight]:
        told = "Unstable as it is: no single factor with the others closed; "
        if factors.whole[tight] > 0:
            return f"{told}all gains together have to go left of the line."
        return (
            f"{told}how far all gains together would have to be lowered is not known."
            if math.isnan(factors.whole[tight])
            else (f"{told}lowering all gains together makes nothing stable.")
        )
    both = zip(factors.alone[tight].tolist(), factors.closed[tight].tolist(), strict=True)
    pairs = [(closed / alone, k) for k, (alone, closed) in enumerate(both) if 0 < alone < math.inf and closed < math.inf]
    if not pairs:
        return f"No single {what} has a limit here."
    share, k = min(pairs)
    if share > NEGLIGIBLE:
        return f"Every {what} keeps what it has alone, with the others closed."
    return f"{factors.parts[k]} loses most: with the others closed, {100 * share:.0f} % of what it has alone is left."
