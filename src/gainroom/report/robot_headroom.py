"""Gain headroom by joint or task direction and state: heat map of the factors until vibration, and the cost of coupling."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..analysis.margin_record import GainLimit
from ..errors import listed
from ..studies.analysis import Analysis
from ..studies.state import State, limit_headroom
from ..system.linear.arrays import Floats, first_least
from . import style
from .number_format import digits
from .page import Html, figure

# Vermilion and blue of Okabe and Ito around white: too much gain, and headroom. Light enough for dark numbers everywhere.
COLOR_SCALE = [[0, "#e07a2f"], [0.25, "#f3b98e"], [0.5, "#ffffff"], [0.75, "#b5d7ee"], [1, "#62a9d8"]]
DECADE = 1.0  # the colours span factors from 0.1 to 10
MOST_STATES = 16  # in one picture
TOGETHER = "all together"


@dataclass(frozen=True)
class Factors:
    """Factors on the gains of one space, joints or task directions, at which the robot starts to vibrate, in several states.

    parts                names of the joints or directions
    alone                (states, parts) all other loops open
    other_loops_closed   (states, parts) all other loops closed with their gains; NaN where the state is unstable
    limits               (states,) of all gains together
    """

    states: tuple[State, ...]
    parts: tuple[str, ...]
    alone: Floats
    other_loops_closed: Floats
    limits: tuple[GainLimit, ...]

    @property
    def together(self) -> Floats:
        """Factor (states,) on all gains together."""
        return np.array([limit.gain for limit in self.limits])

    @property
    def stable(self) -> tuple[bool, ...]:
        """(states,) True if stable with the present gains."""
        return tuple(limit.stable for limit in self.limits)

    @property
    def tightest_first(self) -> list[int]:
        """Indices of the states, the one with the least headroom first."""
        return sorted(range(len(self.states)), key=lambda k: limit_headroom(self.limits[k]))

    @property
    def tightest(self) -> int:
        """Index of the state with the least headroom."""
        return self.tightest_first[0]

    def few(self) -> "Factors":
        """Factors of at most MOST_STATES states, the tightest, in their order."""
        shown = sorted(self.tightest_first[:MOST_STATES])
        return Factors(
            tuple(self.states[k] for k in shown),
            self.parts,
            self.alone[shown],
            self.other_loops_closed[shown],
            tuple(self.limits[k] for k in shown),
        )


def joint_factors(study: Analysis) -> Factors:
    """Factors of the file's loops, joint by joint."""
    return Factors(
        study.states,
        study.system.source.joint_names,
        np.array([state.limits_others_open for state in study.states]),
        np.array([state.margins.one_loop.gain_margin for state in study.states]),
        tuple(state.limit for state in study.states),
    )


def task_factors(study: Analysis) -> Factors | None:
    """Factors of the tasks, direction by direction, in the states in which they can move; None without any."""
    found = [(state, state.tasks) for state in study.states if state.tasks is not None and state.tasks.moves]
    if not found:
        return None
    return Factors(
        tuple(state for state, _ in found),
        tuple(f"{row.name} {row.direction}" for row in found[0][1].rows),
        np.array([[row.gain_limit for row in tasks.rows] for _, tasks in found]),
        np.array([[row.limit_others_closed for row in tasks.rows] for _, tasks in found]),
        tuple(tasks.limit for _, tasks in found),
    )


def heat_map(factors: Factors, what: str) -> Html:
    """Heat map; rows: all together, then every part; columns: states. `what` is scaled: "joint" or "task direction"."""
    total, factors = len(factors.states), factors.few()
    known = any(factors.stable)  # where nothing is stable, single parts have no factor
    values = np.vstack([factors.together, factors.other_loops_closed.T]) if known else factors.together[None]
    names = [f"<b>{TOGETHER}</b>", *(style.shown(part) for part in factors.parts if known)]
    columns = list(range(len(factors.states)))
    rows, wide = list(range(len(names))), len(columns) > 5  # columns that hold no numbers on a phone
    with np.errstate(divide="ignore"):
        colors = np.clip(np.log10(values), -DECADE, DECADE)
    text = [["" if math.isnan(value) else digits(value, "", 3) for value in row] for row in values.tolist()]
    cells = {"type": "heatmap", "x": columns, "y": rows, "z": colors, "coloraxis": "coloraxis", "xgap": 1, "ygap": 1}
    cells |= {"hoverinfo": "text", "hovertext": _hover(factors, values)}
    look = {"size": style.TEXT if len(columns) <= 12 else 12, "color": style.INK}
    written = cells | {"text": text, "texttemplate": "%{text}", "textfont": look}
    traces = [cells, written | {"meta": "wide"}] if wide else [written]
    labels, high = _columns(factors.states)
    picture = style.layout(
        xaxis=style.axis("", tickvals=columns, ticktext=labels, side="top", showgrid=False, ticks="", showline=False, fixedrange=True)
        | {"range": [-0.5, len(columns) - 0.5], "tickangle": -90 if high else 0},
        yaxis=style.axis("", tickvals=rows, ticktext=names, showgrid=False, ticks="", showline=False, fixedrange=True)
        | {"range": [len(rows) - 0.5, -0.5]},
        shapes=[_rule(len(columns)), *_unstable_columns(factors)] if known else [],
        annotations=[*_unstable_labels(factors), *_no_gains(factors)] if known else [],
        coloraxis={"colorscale": COLOR_SCALE, "cmin": -DECADE, "cmax": DECADE, "showscale": known, "colorbar": _colour_bar()},
        plot_bgcolor="#efefef",
        margin={"l": 20, "r": 8, "t": 24, "b": 12},
    )
    narrow = {"margin.l": 8, "margin.r": 4, "coloraxis.showscale": False} | (
        {"xaxis.tickangle": -90, "margin.t": 70} if len(columns) > 4 else {}
    )
    title = f"Factor on the gains of each {what} at which the robot starts to vibrate, other loops closed"
    if not known:
        title = "Factor on all gains below which the robot is stable"
    height = round(26 * len(rows) + 90 + (60 if high else 0))
    return figure({"data": traces, "layout": picture}, title, _map_caption(factors, total, what), height, narrow)


def _hover(factors: Factors, values: Floats) -> list[list[str]]:
    names = [style.shown(name) for name in (TOGETHER, *factors.parts)]
    titles = [style.shown(state.title) for state in factors.states]
    return [
        [f"{name}<br>{title}<br>{digits(value, '×', 4)}" for title, value in zip(titles, row, strict=True)]
        for name, row in zip(names, values.tolist(), strict=False)  # all together alone where nothing is stable
    ]


def _colour_bar() -> dict:
    marks = (0.1, 0.2, 0.5, 1, 2, 5, 10)
    text = ["≤ 0.1", "0.2", "0.5", "1: the limit", "2", "5", "≥ 10"]
    return {"tickvals": [math.log10(mark) for mark in marks], "ticktext": text, "thickness": 12, "outlinewidth": 0, "len": 0.9}


def _columns(states: Sequence[State]) -> tuple[list[str], bool]:
    """Column names, and True if they have to stand upright."""
    postures = len({state.posture for state in states}) > 1
    labels = [f"<b>{style.shown(state.contact)}</b>" + (f"<br>{style.shown(state.posture)}" if postures else "") for state in states]
    longest = max(len(word) for state in states for word in (state.contact, state.posture if postures else ""))
    return labels, longest * len(states) > 90


def _rule(columns: int) -> dict:
    """Line between all gains together and the single parts."""
    return {"type": "line", "x0": -0.5, "x1": columns - 0.5, "y0": 0.5, "y1": 0.5, "line": {"color": style.INK, "width": 2}}


def _unstable_columns(factors: Factors) -> list[dict]:
    line = {"color": style.VERMILION, "width": 3}
    place = {"type": "rect", "y0": 0.5, "y1": len(factors.parts) + 0.5, "line": line, "fillcolor": style.UNSTABLE_GROUND, "layer": "above"}
    return [{**place, "x0": k - 0.48, "x1": k + 0.48} for k, stable in enumerate(factors.stable) if not stable]


def _unstable_labels(factors: Factors) -> list[style.Annotation]:
    middle = 0.5 + 0.5 * len(factors.parts)
    look = {"textangle": -90, "bgcolor": "rgba(0,0,0,0)"}
    return [style.label(k, middle, "<b>UNSTABLE</b>", style.VERMILION, **look) for k, stable in enumerate(factors.stable) if not stable]


def _no_gains(factors: Factors) -> list[style.Annotation]:
    """Dashes where a stable state has no gains to scale."""
    empty = [(k, row) for k, row in np.argwhere(np.isnan(factors.other_loops_closed)).tolist() if factors.stable[k]]
    return [style.label(k, row + 1, "–", style.SOFT, bgcolor="rgba(0,0,0,0)") for k, row in empty]


def _map_caption(factors: Factors, total: int, what: str) -> str:
    words = (
        "White is the limit: 1 means that these gains are at it. Blue: headroom; vermilion: too much gain. The first row scales every "
        f"{what} at once."
    )
    if not any(factors.stable):
        words = f"Every state is unstable: no single {what} has a factor of its own before all gains are lowered."
    elif not all(factors.stable):
        words += f" Where a state is unstable, no single {what} has a factor of its own: lower all gains below the factor in the first row."
    tightest = factors.tightest
    closed = factors.other_loops_closed[tightest]
    if factors.stable[tightest] and np.any(np.isfinite(closed)):
        k = first_least(closed)
        words += f" Least headroom of one {what} in {factors.states[tightest].title}: {factors.parts[k]}, {digits(closed[k], '', 3)}."
    if _no_gains(factors):
        words += f" A dash: no gain acts on that {what} in that state."
    if total > len(factors.states):
        words += f" The {len(factors.states)} tightest of {total} states are shown; the tables have all."
    return words


WIDEST = 1e3  # ratio of the factors on one axis; what lies beyond is drawn at its end
NEGLIGIBLE = 0.97  # relative to the factor alone: above it the cost of coupling is not reported
MARKS = (
    ("alone", "circle-open", style.BLUE, 15),
    ("other loops closed", "circle", style.BLACK, 10),
    ("all together", "diamond", style.VERMILION, 8),
)
FactorRow = tuple[str, tuple[float, float, float]]
"""Name, and factors: alone, with the other loops closed, all together. NaN: none."""


def coupling(factors: Factors, what: str) -> tuple[Html, Html]:
    """Figures of the factors on one part alone, with the other loops closed, and on all: by state, and by part in the tightest state."""
    few, tight = factors.few(), factors.tightest
    by_state: list[FactorRow] = [
        (style.shown(state.title), (_least(few.alone[k]), _least(few.other_loops_closed[k]), float(few.together[k])))
        for k, state in enumerate(few.states)
    ]
    parts = zip(factors.parts, factors.alone[tight].tolist(), factors.other_loops_closed[tight].tolist(), strict=True)
    by_part: list[FactorRow] = [(style.shown(part), (alone, closed, math.nan)) for part, alone, closed in parts]
    title = f"Each {what} in {factors.states[tight].title}"
    return (
        _dumbbells(by_state, math.nan, f"Tightest {what}, state by state", _cost_caption(factors, what)),
        _dumbbells(by_part, float(factors.together[tight]), title, _part_caption(factors, what)),
    )


def _least(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(known.min()) if len(known) else math.nan


def _dumbbells(rows: Sequence[FactorRow], whole: float, title: str, caption: str) -> Html:
    """Figure of three joined marks per row on a logarithmic scale; `whole`: one value for all rows, drawn as a line."""
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


def _marks(rows: Sequence[FactorRow], left: float, right: float) -> list[style.Trace]:
    """Traces of the bars, then the three kinds of marks; none outside [left, right]."""
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
    """Caption with the state in which coupling costs most."""
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
        f"Coupling costs most in {factors.states[k].title}: one {what} alone suggests {digits(alone, '×', 3)}; with all closed the limit "
        f"is {digits(whole, '×', 3)}."
    )


def _lost_alone(factors: Factors, what: str) -> str:
    """Caption on parts unstable by themselves at any factor: coupling is not the cause."""
    lost = [part for k, part in enumerate(factors.parts) if np.any(factors.alone[:, k] == 0)]
    known = int(np.count_nonzero(~np.isnan(factors.alone).all(axis=0)))
    if len(lost) == known:
        return f"No {what} is stable by itself at any lower gains: coupling is not the cause of the vibration."
    return (
        f"Unstable by themselves at any lower gains: {listed(lost)} ({len(lost)} of {known}). Coupling is not the cause of their vibration."
    )


def _part_caption(factors: Factors, what: str) -> str:
    """Caption on the effect of closing the other loops on each part."""
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
