"""Page of a comparison: what to do about PD, a bar per structure, compliance over frequency, table, inputs, certification."""

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from ..design.comparison.catalogue import structure_of
from ..design.comparison.closed_loop import curves
from ..design.comparison.structure_search import Problem
from ..studies.comparison import Comparison, Row
from ..system.gain_path import GainPath
from ..system.linear.arrays import Floats
from . import style
from .columns import definitions, tabulated
from .comparison_text import (
    TABLE,
    ComparisonPresentation,
    best_known_sentence,
    broken_texts,
    capital,
    ceilings_text,
    control_lines,
    fragile_sentence,
    fragile_text,
    gap_text,
    is_bounded,
    limited_texts,
    lines,
    measure,
    name_of,
    pd_row,
    sentence,
    thousandths,
    times,
    unit,
    unsure,
    winner,
)
from .joint_tables import machine
from .number_format import MISSED, digits, model_text
from .page import Card, Html, Lead, Section, advice_box, copied, details, facts, figure, page, paragraph, table
from .page_parts import assumptions, uncertainty_text

COLORS = (style.BLACK, style.BLUE, style.VERMILION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
DENSITY = 3.0
"""Density of the frequencies of a curve (design/comparison/joint_responses.py)."""
LOWEST = 1e-2
"""Least share of the highest curve that is drawn."""
BEFORE = 30.0
"""Factor below the lowest peak from which curves are drawn."""
END = 0.86
"""Share of the figure's width at which longer bars are cut: of structures that do not hold the box."""
ROW, BESIDE = 58, 124
"""Height [px] of a structure in the figure of bars, and of all else there."""
BOUND = "no linear controller on this encoder"
KNOWN = "best known, any linear controller"


def comparison_page(shown: ComparisonPresentation, command: str) -> str:
    """HTML page of a comparison; `command`: the command that makes it."""
    found, given = shown.found, shown.given
    headings, rows = tabulated(TABLE, lines(found))
    caption = (
        f"{measure(found.objective)[:1].upper()}{measure(found.objective)[1:]} [{unit(found.objective)}]. {definitions(TABLE, headings)}"
    )
    told = best_known_sentence(found), fragile_sentence(found)
    sections = [
        Section("What each structure lets through", [bars(found), *filter(None, told), *broken_texts(found)]),
        Section("Over frequency: the link under a load", [compliance(found)]),
        Section("Structure by structure", [table(headings, rows, caption), *map(paragraph, limited_texts(found))]),
        Section("Controllers", _controllers(found), "what was found, as lines of joint.yaml"),
        Section(
            "Inputs and assumptions",
            [
                facts([*machine(given), ("box", uncertainty_text(found.system))]),
                *map(paragraph, (ceilings_text(shown), *shown.all_assumed)),
                assumptions("Linear two-mass joint" if found.joint.is_single else "Linear robot", given.control),
            ],
            "what was read, what every structure was held to",
        ),
        Section("Certification", [_certificate(found), *map(paragraph, unsure(found))], "how the numbers were checked"),
    ]
    which = "one joint" if found.joint.is_single else found.joint.name
    title = f"gainroom compare: controllers of {which}, {model_text(given.control.sample_time)}"
    best = winner(found)
    lead = Lead(sentence(found), "bare" if best is None else "good", warnings=shown.cautions, advice=advice_box(shown.advice))
    return page(title, lead, _cards(found), sections, command)


def _cards(found: Comparison) -> list[Card]:
    """Cards of PD, of the best of every kind, and of the bound."""
    pd = pd_row(found)
    shown: list[tuple[str, Row]] = [] if pd is None else [("PD", pd)]
    kinds: dict[tuple[tuple[str, ...], str], Row] = {}
    for row in found.rows:
        kind = row.sensors, row.where
        if row is not pd and row.holds and (kind not in kinds or row.worst < kinds[kind].worst):
            kinds[kind] = row
    shown += [(name_of(row.structure), row) for row in kinds.values()][:3]
    cards = [_card(found, name, row) for name, row in shown]
    if found.bound is not None:
        note = f"at most {digits(times(found, found.bound), '×', 3)} PD's stiffness" if math.isfinite(times(found, found.bound)) else ""
        cards.append(Card(BOUND, f"≥ {thousandths(found.bound)}", unit(found.objective), note=note))
    return cards


def _card(found: Comparison, name: str, row: Row) -> Card:
    if not row.holds:
        return Card(name, "none", "", "the whole box", False, row.broken)
    against = times(found, row.worst)
    text = "" if row.structure == "pd" or math.isnan(against) else f"{digits(against, '×', 3)} PD's stiffness; "
    return Card(name, thousandths(row.worst), unit(found.objective), note=f"{text}nominal {thousandths(row.objective)}")


def bars(found: Comparison) -> Html:
    """Figure with a bar per structure, nominal and worst in the box, and the zone that no linear controller reaches."""
    rows = [row for row in found.rows if math.isfinite(row.worst)]
    names, count = [name_of(row.structure) for row in rows], len(rows)
    places = np.arange(count)
    worst, nominal = 1e3 * np.array([row.worst for row in rows]), 1e3 * np.array([row.objective for row in rows])
    held = [1e3 * max(row.worst, row.objective) for row in rows if row.holds]
    right = 1.3 * max(held or worst.tolist() or [1e-9])
    traces = [
        _bars("worst in the box", rows, worst, END * right, -0.17),
        _bars("the same design, nominal", rows, nominal, END * right, 0.17),
    ]
    fragile = [(k, row.fragile) for k, row in enumerate(rows) if row.fragile is not None and row.fragile.fragile]
    if fragile:
        at = [1e3 * one.objective for _, one in fragile]
        beside = [fragile_text(rows[k]) for k, _ in fragile]
        text = [f"tuned at nominal alone: {thousandths(1e-3 * x)}, fragile {told}" for x, told in zip(at, beside, strict=True)]
        look = {"name": "tuned at nominal alone: fragile", "showlegend": True, "hoverinfo": "text", "hovertext": text}
        traces.append(style.markers(at, [k + 0.17 for k, _ in fragile], "diamond-open", style.VERMILION, 11, **look))
    notes = [_unstable(min(nominal[k], END * right), k, rows[k]) for k, _ in fragile if rows[k].holds]
    if found.bound is not None:
        bounded = [k for k, row in enumerate(rows) if is_bounded(row)]
        traces.insert(0, _zone(1e3 * found.bound, bounded))
        if found.best_known is not None:
            traces.append(_known(1e3 * found.best_known.value, bounded))
    axis = style.axis(f"{measure(found.objective)} [{unit(found.objective)}]", range=[0, right], fixedrange=True)
    layout = style.layout(
        xaxis=axis,
        yaxis=style.axis("", range=[count - 0.45, -0.55], tickvals=places, ticktext=[*map(escape, names)], ticks="", fixedrange=True),
        annotations=notes,
        barmode="overlay",
        showlegend=True,
        legend=style.switches(1.0, yref="container", yanchor="top"),
        margin={"l": 20, "r": 12, "t": 62, "b": 52},
    )
    cut = " ✗: does not hold the box, bars cut." if any(not row.holds for row in rows) else ""
    caption = f"Shorter is stiffer. {_zone_text(found)}{cut}"
    narrow = {
        "margin.l": 8,
        "margin.t": 112,
        "yaxis.ticktext": [escape(name).replace(" + ", "<br>+ ").replace(", ", ",<br>") for name in names],
    }
    return figure({"data": traces, "layout": layout}, f"{_title(found)}, nominal and at its worst", caption, ROW * count + BESIDE, narrow)


def _title(found: Comparison) -> str:
    return "How far a load moves the link" if found.objective.is_peak else capital(measure(found.objective))


def _zone_text(found: Comparison) -> str:
    if found.bound is None:
        return "What no linear controller can beat was not worked out."
    below = f"Hatched, below {thousandths(found.bound)} {unit(found.objective)}"
    known = "" if found.best_known is None else f" Dashed: {KNOWN}, at {found.bound_at} alone."
    return f"{below}: {BOUND} and the host, at this rate and delay, everywhere in the box under the same ceilings.{known}"


def _bars(name: str, rows: Sequence[Row], values: Floats, end: float, shift: float) -> style.Trace:
    """Bars of one kind, cut at `end`; `shift`: place in the structure's row, that of the worst above."""
    above = shift < 0
    texts = [thousandths(1e-3 * value) for value in values.tolist()]
    bold = [f"<b>{text if row.holds else f'{MISSED} {text}'}</b>" for row, text in zip(rows, texts, strict=True)]
    return {
        "type": "bar",
        "orientation": "h",
        "x": np.minimum(values, end),
        "y": np.arange(len(rows)) + shift,
        "width": 0.34,
        "name": name,
        "marker": {"color": [(style.BLUE if row.holds else style.VERMILION) if above else style.SKY for row in rows]},
        "text": bold if above else texts,
        "textposition": "outside",
        "cliponaxis": False,
        "hoverinfo": "text",
        "hovertext": [f"{escape(name_of(row.structure))}, {name}: {text}" for row, text in zip(rows, texts, strict=True)],
    }


def _zone(bound: float, places: Sequence[int]) -> style.Trace:
    """Hatched zone from 0 to the bound, in the rows of the structures that it is of."""
    look = {"fill": "toself", "fillcolor": "rgba(90,90,90,0.10)", "fillpattern": {"shape": "/", "fgcolor": style.SOFT, "size": 7}}
    across = [0.0, bound, bound, 0.0, 0.0, math.nan] * len(places)
    down = [k + side for k in places for side in (-0.5, -0.5, 0.5, 0.5, -0.5, math.nan)]
    return style.line(across, down, style.SOFT, width=1.2, name=BOUND, showlegend=True, **look)


def _known(value: float, places: Sequence[int]) -> style.Trace:
    """Line at the objective of the best known controller, in the rows of the structures that the bound is of."""
    across = [value, value, math.nan] * len(places)
    down = [k + side for k in places for side in (-0.5, 0.5, math.nan)]
    look = {"hoverinfo": "text", "hovertext": f"{KNOWN}: {thousandths(1e-3 * value)}", "showlegend": True}
    return style.line(across, down, style.BLACK, width=2.0, name=KNOWN, dash="dash", **look)


def _unstable(x: float, place: int, row: Row) -> style.Annotation:
    """Label behind the nominal bar of a structure that is fragile where tuned at nominal alone."""
    text = fragile_text(row).removeprefix(f"{MISSED} ")
    text = f"◇ {text} in the box" if row.fragile is not None and not row.fragile.unstable else f"◇ unstable in {text}"
    return style.label(x, place + 0.17, text, style.VERMILION, xanchor="left", yanchor="middle", xshift=44, name="wide")


def compliance(found: Comparison) -> Html:
    """Figure of the compliance |q/d| of every structure over frequency, each at its worst corner of the box."""
    known = [(row, *worst_curve(found, row)) for row in found.rows if row.controller is not None and row.holds]
    traces, top, ends = [], 0.0, [math.inf, 0.0]
    for k, (row, omega, size) in enumerate(known):
        look = {"name": name_of(row.structure), "showlegend": True, "hoverinfo": "all", "dash": DASHES[k // len(COLORS)]}
        hover = f"%{{x:.4g}} rad/s: %{{y:.4g}} mrad/N·m<extra>{escape(name_of(row.structure))}</extra>"
        width = style.LINK if row.structure == "pd" else 2.0
        traces.append(style.line(omega, 1e3 * size, COLORS[k % len(COLORS)], width=width, **look, hovertemplate=hover))
        top = max(top, 1e3 * float(size.max()))
    for _, omega, size in known:
        drawn = omega[1e3 * size > LOWEST * top]
        ends = [min(ends[0], max(float(omega[0]), float(omega[int(np.argmax(size))]) / BEFORE)), max(ends[1], float(drawn.max()))]
    shapes: list[dict[str, Any]] = []
    notes = []
    if found.bound is not None and found.objective.is_peak:
        level = 1e3 * found.bound
        line = {"color": style.SOFT, "dash": "dash", "width": 1.5}
        shapes.append({"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": level, "y1": level, "line": line})
        text = f"{BOUND}: its peak is not below"
        look = {"xref": "paper", "xanchor": "right", "yanchor": "top", "name": "wide"}
        notes.append(style.label(0.99, math.log10(level), text, style.SOFT, **look))
    low, high = LOWEST * top, 2 * top
    layout = style.layout(
        xaxis=style.log_axis("frequency of the load [rad/s]", *ends),
        yaxis=style.log_axis("|q/d| [mrad/N·m]", low, high),
        shapes=shapes,
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.0, yref="container", yanchor="top"),
        margin={"l": 78, "r": 24, "t": 62, "b": 52},
    )
    narrow = {**style.NARROW, "margin.t": 132, **style.decades("xaxis", *ends)}
    caption = "Load torque on the link to its position, sampled exactly, each structure at the corner of the box that is worst for it."
    return figure({"data": traces, "layout": layout}, "How far a load of 1 N·m moves the link, by frequency", caption, 460, narrow)


def worst_curve(found: Comparison, row: Row) -> tuple[Floats, Floats]:
    """Frequencies (m,) [rad/s] and |q/d| (m,) [rad/(N m)] at the corner of the box where that peaks highest."""
    assert row.controller is not None
    control = row.controller.control
    structure = structure_of(row.structure, control.feedback.position)
    path = control.kd_path or GainPath(0.0, 1.0)  # not used without one
    structure = structure.scaled_to(found.system, path)
    problem = Problem(found.joint, found.ceilings, found.objective, path)
    x = structure.coordinates(row.parameters)[None]
    best: tuple[Floats, Floats] | None = None
    for spot in found.joint.corners:
        joint = problem.spot(structure, spot)
        omega = joint.grid(DENSITY)
        size = np.abs(curves(structure, x, joint, joint.at(omega), found.ceilings).compliance[0])
        if best is None or size.max() > best[1].max():
            best = omega, size
    assert best is not None
    return best


def _controllers(found: Comparison) -> list[Html]:
    """Controller of every structure that holds the box, to copy."""
    return [
        details(name_of(row.structure), copied(control_lines(row.controller)))
        for row in found.rows
        if row.controller is not None and row.holds
    ]


def _certificate(found: Comparison) -> Html:
    proved = [row for row in found.rows if row.holds]
    counts = sorted({row.proved for row in proved})
    margins = "no structure holds the box"
    if proved:
        margins = (
            f"margins of every winner's loop worked out at {digits(counts[0])} to {digits(counts[-1])} places: all corners of the box "
        )
        margins += (
            "and samples inside; no grid of frequencies decides a ceiling"
            if found.joint.is_single
            else "and every state of the file, all other loops closed, stability by the roots of the whole robot; where two rates meet "
            "it is counted with both, and ceilings are those of the search"
        )
    gaps = ", ".join(f"{name_of(row.structure)} {gap_text(row)}" for row in proved)
    pairs = [
        ("ceilings", margins),
        ("optimum", f"not proved: global searches with two seeds, then local ones; the two best ended apart by: {gaps}"),
        ("fragile", "the same structure tuned at the nominal values alone, tried on joints with other stiffness, load and delay"),
    ]
    if found.bound is not None:
        pairs.append(
            (
                "bound",
                "weak duality: for the weights of the certificate every linear controller that keeps the ceilings has at least this "
                f"peak at {found.bound_at}, and so in the box; recomputed on a grid twice as fine. The certificate is in --json, and "
                "anyone can recompute it",
            )
        )
    return facts(pairs)
