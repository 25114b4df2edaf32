"""What fails in an audit, or is tightest: the factors on the gains of every joint, state by state, beside the factor that is required."""

import math
import re
from dataclasses import dataclass
from html import escape

import numpy as np

from ..studies.audit import Audit
from ..system.linear.arrays import Floats, first_least, rank
from ..system.margin_units import to_db
from . import style
from .number_format import digits
from .page import Html, figure
from .robot_headroom import TOGETHER

MOST_ROWS = 12
"""In the picture: the tightest; the heat map has all joints."""
ALIKE = 5e-3
"""Relative: joints of both sides whose least factors differ by less share a row."""
PATHS = "kp or kd by itself"
WHOLE = (TOGETHER, PATHS)
"""Names of the rows that are no joint's."""
WIDEST = 30.0
"""Ratio of the factors on the axis; what lies beyond is drawn at its end."""


@dataclass(frozen=True)
class Row:
    """Factors by state (k,), of joints that share a row the least; NaN where there is none. `sides`: what their names begin with."""

    name: str
    sides: tuple[str, ...]
    factors: Floats

    @property
    def title(self) -> str:
        """The names of its joints, in a sentence."""
        return ", ".join(f"{side}{self.name}" for side in self.sides) or self.name

    @property
    def least(self) -> float:
        """Over the states."""
        return float(np.min(self.factors, initial=math.inf, where=~np.isnan(self.factors)))


def headroom_rows(result: Audit) -> list[Row]:
    """All gains together, single paths where kd has its own, and every joint as it is judged, the one with the least headroom first."""
    rows = [Row(TOGETHER, (), np.array([state.limit.gain for state in result.states]))]
    paths = [state.margins.paths for state in result.states]
    if any(path is not None for path in paths):
        rows.append(Row(PATHS, (), np.array([math.nan if path is None else path.headroom for path in paths])))
    judged = np.array([result.joint_limits_in(state) for state in result.states])
    joints: list[Row] = []
    for name, factors in zip(result.system.source.joint_names, judged.T, strict=True):
        side, _, rest = re.sub(r"([^A-Za-z0-9]+)", r"\0\1", name, count=1).partition("\0")
        own = Row(rest, (side,), factors) if rest else Row(name, (), factors)
        twin = next(
            (k for k, row in enumerate(joints) if own.sides and row.name == rest and math.isclose(row.least, own.least, rel_tol=ALIKE)),
            None,
        )
        if twin is None:
            joints.append(own)
        else:
            joints[twin] = Row(rest, (*joints[twin].sides, side), np.fmin(joints[twin].factors, factors))
    single = [Row(row.title, (), row.factors) if len(row.sides) == 1 else row for row in joints]
    return rows + sorted(single, key=lambda row: rank(row.least))


def row_of_verdict(result: Audit, rows: list[Row]) -> Row:
    """Of `rows` the one that the verdict is about: of all joints together, unless one of a stable robot has too little, and less."""
    short = result.stable and "gain_margin" in result.missed
    return min([row for row in rows if short or row.name in WHOLE], key=lambda row: rank(row.least))


def _is_named(result: Audit) -> bool:
    """Whether the verdict is about a factor on gains."""
    return result.safe or "gain_margin" in result.missed


def headroom(result: Audit) -> Html:
    """Of all gains together and of each of the tightest joints a mark per state: the worst filled, the deciding one a star."""
    every = headroom_rows(result)
    rows = every[:MOST_ROWS]
    decides = row_of_verdict(result, every) if _is_named(result) else None
    known = [value for row in rows for value in row.factors.tolist() if math.isfinite(value) and value > 0]
    low, high = min([1.0, *known]), max([result.margin, *known])
    right = max(1.7 * min(high, WIDEST * low), 7.6 * low)
    left, far = (low * (low / right) ** share for share in (0.2, 0.6))  # room for a number left of its mark, where its row has no other
    edge = (right / left) ** 0.02
    traces, numbers = [], []
    for place, row in enumerate(rows):
        worst = first_least(row.factors) if not np.isnan(row.factors).all() else -1
        for k, value in enumerate(row.factors.tolist()):
            if math.isnan(value) or (k != worst and value < row.least * (1 + ALIKE)):
                continue  # under the worst one's mark
            color = style.BLUE if value >= result.margin else style.VERMILION
            symbol, size = ("star", 20) if row is decides and k == worst else ("circle", 12) if k == worst else ("circle-open", 9)
            hover = f"{escape(row.title)}<br>{escape(result.states[k].contact)}<br>{digits(value, '×')} ({_level(value)})"
            x = min(max(value, left * edge), right / edge)
            mark = style.markers([x], [place], symbol, color, size)
            traces.append(mark | {"hoverinfo": "text", "hovertext": [hover], "cliponaxis": False})
            if k == worst:
                beside = {"xanchor": "left", "xshift": 0.6 * size} if value < x else {"xanchor": "right", "xshift": -0.6 * size}
                numbers.append(style.label(math.log10(x), place, digits(value, "×", 3), **beside))
    names = [f"<b>{row.name}</b>" if row.name == TOGETHER else _label(row) for row in rows]
    words = {"yref": "paper", "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"}
    picture = style.layout(
        xaxis=style.log_axis("factor on the gains at which vibration starts [×]", left, right, fixedrange=True),
        yaxis=style.axis("", tickvals=list(range(len(rows))), ticktext=names, range=[len(rows) - 0.4, -0.6], fixedrange=True, ticks=""),
        shapes=[
            style.stretch(far, result.margin, style.UNSTABLE_GROUND, 1.0),
            style.upright(1.0, style.INK, "dot", 1.4),
            style.upright(result.margin, style.VERMILION, "solid", 2),
        ],
        annotations=[
            *numbers,
            style.label(0.0, 1, "these gains", style.SOFT, **words, xanchor="right" if result.margin < 1.5 else "center", name="wide"),
            style.label(math.log10(result.margin), 1, f"required {digits(result.margin, '×', 4)}", style.VERMILION, **words),
        ],
        margin={"l": 20, "r": 24, "t": 30, "b": 48},
    )
    narrow = {"margin.l": 8, "margin.r": 8, "xaxis.title.text": "factor [×]", "xaxis.range": [math.log10(far), math.log10(right)]}
    return figure(
        {"data": traces, "layout": picture}, _title(result), _caption(result, len(every) - len(rows)), 32 * len(rows) + 96, narrow
    )


def _level(value: float) -> str:
    return digits(to_db(value), "dB", 3) if value > 0 else "stable at no factor"


def _label(row: Row) -> str:
    """One line, and a smaller one with the sides."""
    below = f'<br><span style="font-size:11px;color:{style.SOFT}">{escape(", ".join(row.sides), quote=False)}</span>' if row.sides else ""
    return escape(row.name.lstrip("_- ") if row.sides else row.name, quote=False) + below


def _title(result: Audit) -> str:
    others = "the other loops closed" if result.stable else "all others switched off"
    return (
        f"Factor on the gains at which vibration starts, {f'of each joint, {others}, and ' if len(result.joints) > 1 else ''}all together"
    )


def _caption(result: Audit, hidden: int) -> str:
    paths = any(state.margins.paths is not None for state in result.states)
    words = "Factors on kp or kd by itself count up and down: at 10 × also a tenth. " if paths else ""
    words += "Star: what the verdict names. " if _is_named(result) else ""
    words += "Dotted: factor 1, these gains; what vibrates at less is unstable. Left of the other line the margin is too small."
    if len(result.states) > 1:
        words += " Filled: the worst state; open: the others."
    return words + (f" {hidden} more rows with no less headroom are not drawn; the tables below have all joints." if hidden > 0 else "")
