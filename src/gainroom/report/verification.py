"""The page of a verification: predicted and simulated limit, and the growth rate about the limit."""

import math
from html import escape
from typing import Any

import numpy as np

from ..studies.verification import Verification, growth_about
from ..system.system import System
from . import style
from .columns import tabulated
from .number_format import digits, frequency, model_text
from .page import Card, Html, Lead, Section, block, figure, page, table
from .page_parts import assumptions, footer
from .verification_text import CASE, left_out, percent, sentence


def verification_page(system: System, result: Verification, command: str) -> str:
    """The report as one HTML page; `command` is the command that makes it."""
    limit = result.cases[0].predicted_gain
    sample_time, sections = system.control.sample_time, []
    what, model = "a robot", "Robot linearised about each posture, all loops closed"
    if not result.of_robot:
        what, model = "one joint", "Linear two-mass joint"
    if not result.of_robot and 0 < limit < math.inf:
        sections.append(Section("Growth about the limit", [_growth(system, limit)]))
    notes = ["Left out: " + warning for warning in result.warnings]
    sections += [
        Section("Predicted and simulated", [_table(result)]),
        Section("Assumptions", [assumptions(model, sample_time), _method(result), *map(escape, notes)]),
        Section("Command", [block(command)]),
    ]
    headline = "" if result.agrees else "Simulation and prediction disagree"
    lead = Lead(sentence(result), "good" if result.agrees else "bad", headline)
    return page(f"gainroom verify: {what}, {model_text(sample_time)}", lead, _cards(result), sections, footer())


def _cards(result: Verification) -> list[Card]:
    cards = []
    for case in result.cases[:2]:
        allowed = f"within {digits(100 * case.tolerance)} % of {digits(case.predicted_gain, '', 5)}"
        cards.append(Card("simulated limit", digits(case.simulated_gain, "", 5), "× these gains", allowed, case.agrees, case.what))
        note = f"predicted {frequency(case.predicted_frequency)}"
        cards.append(Card("simulated frequency", digits(case.simulated_frequency, "", 5), "rad/s", note=note))
        cards.append(Card("difference", percent(case.gain_difference, case.tolerance), note="in gain"))
    return cards


def _growth(system: System, limit: float) -> Html:
    """Growth rate over gain: the rightmost root's as a line, that of simulated runs as dots."""
    found = growth_about(system.loop())
    seen = np.isfinite(found.simulated)
    hover: dict[str, Any] = {"hovertemplate": "× %{x:.4g}: %{y:.4g} 1/s", "hoverinfo": "all"}
    traces = [
        style.line(found.gain, found.predicted, style.BLUE, name="predicted: rightmost root", showlegend=True, **hover),
        style.markers(
            found.gain[seen], found.simulated[seen], "circle", style.VERMILION, 10, name="simulated: one run each", showlegend=True, **hover
        ),
    ]
    zero = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 0, "y1": 0, "line": {"color": style.INK, "width": 1}}
    layout = style.layout(
        xaxis=style.axis("factor on all gains [–]"),
        yaxis=style.axis("growth rate of the vibration [1/s]"),
        shapes=[zero, style.upright(limit, style.SOFT, "dot", 1.5)],
        annotations=[
            style.label(limit, 0.02, f"predicted limit {digits(limit, '', 5)}", yref="paper", yanchor="bottom", xanchor="left", xshift=4)
        ],
        showlegend=True,
        legend=style.switches(1.02),
        margin={"l": 78, "r": 24, "t": 40, "b": 52},
    )
    caption = (
        "Below zero the impulse response decays, above zero it grows. The line is computed from the loop's roots, the dots from simulated "
        "runs; both cross zero at the limit."
    )
    return figure({"data": traces, "layout": layout}, "Vibration starts where its growth rate changes sign", caption, 440, style.NARROW)


def _table(result: Verification) -> Html:
    return table(
        *tabulated(CASE, result.cases), "Predicted and simulated gains are factors on the file's own.", {"yes": "met", "no": "unmet"}
    )


def _method(result: Verification) -> str:
    return (
        "Every run starts with a torque impulse. A matrix pencil finds the fastest-growing oscillation in its second half, and a bracketed "
        "search the factor at which its growth rate is zero, to one part in a million; in MuJoCo, where the motors start at a small "
        "speed, to one in a thousand. The limits " + left_out(result) + "; gainroom simulate includes the scenario."
    )
