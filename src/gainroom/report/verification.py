"""Page of a verification: agreement of simulation and prediction, a figure of every case, and, folded, table and method."""

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from ..errors import listed
from ..studies.verification import TOLERANCES, Verification, VerifiedLimit, growth_about
from ..system.requirements import Requirements
from ..system.system import System
from . import style
from .columns import tabulated
from .margin_columns import requirement
from .number_format import digits, hertz, model_text
from .page import Card, Html, Lead, Section, advice_box, beside, figure, page, table
from .page_parts import assumptions
from .verification_text import CASE, WITNESSES, VerificationPresentation, at_nominal, furthest, left_out, percent, sentence, size

MARKS = {"linear": ("circle", style.BLUE, 11, -0.18), "mujoco": ("diamond", style.ORANGE, 11, 0.18)}
"""Symbol, colour, size, and place in its case's row, by witness."""
APART = 0.22
"""Share of a row between the marks of gain and frequency differences, which would hide each other."""
SHADES = {"mujoco": 0.12, "linear": 0.3}
"""Opacity of the bands of agreement, the wider one first."""
WIDEST = 100.0
"""Largest difference [%] drawn to scale; larger ones are drawn at the end."""


def agreement(cases: Sequence[VerifiedLimit]) -> Html:
    """Figures of predicted and simulated limits, row by row, and of the differences in gain and frequency with their tolerance."""
    return beside(_limits(cases), _differences(cases))


def _limits(cases: Sequence[VerifiedLimit]) -> Html:
    """Figure of simulated over predicted limits; limits of 0 and inf at the ends."""
    rows, values = _rows(cases), [value for case in cases for value in (case.predicted_gain, case.simulated_gain)]
    known = [1.0, *(value for value in values if math.isfinite(value) and value > 0)]
    left, right = min(known) / 1.6, max(1.6 * max(known), 6.3 * min(known))  # a decade at least: ticks at 1, 2 and 5
    edge = (right / left) ** 0.02

    def marks(some: Sequence[VerifiedLimit], how: str, shift: float, *look: Any, name: str) -> style.Trace:
        gains = [getattr(case, f"{how}_gain") for case in some]
        at = [hertz(getattr(case, f"{how}_frequency")) for case in some]
        hover = [
            f"{escape(case.what)}<br>{name}: {digits(gain, '×', 6)}<br>{omega}" for case, gain, omega in zip(some, gains, at, strict=True)
        ]
        places = np.clip(gains, left * edge, right / edge), [rows.index(case.what) + shift for case in some]
        return style.markers(*places, *look, name=name, showlegend=True, hoverinfo="text", hovertext=hover)

    first = [next(case for case in cases if case.what == row) for row in rows]
    traces = [marks(first, "predicted", 0.0, "line-ns-open", style.BLACK, 36, name="predicted")]
    for witness, some in _by_witness(cases):
        symbol, color, size, shift = MARKS[witness]
        traces.append(marks(some, "simulated", shift, symbol, color, size, name=WITNESSES[witness]))
    axis = style.log_axis("factor on all gains [×]", left, right, fixedrange=True)
    start = style.upright(1.0, style.INK, "dot", 1.4)
    caption = "Where vibration starts. The dotted line is these gains: a limit left of it means that they are unstable."
    return _picture(traces, axis, rows, [start], [], "Limit, predicted and simulated", caption)


def _differences(cases: Sequence[VerifiedLimit]) -> Html:
    """Figure of the differences, gains filled, frequencies open, in percent of the prediction."""
    rows, every = _rows(cases), [value for case in cases for value in (case.gain_difference, case.frequency_difference)]
    allowed = {witness: 100 * TOLERANCES[witness] for witness in SHADES if any(case.witness == witness for case in cases)}
    reach = 1.25 * min(WIDEST, max(*allowed.values(), *(100 * abs(value) for value in every if math.isfinite(value))))
    traces = []
    for witness, some in _by_witness(cases):
        symbol, color, size, shift = MARKS[witness]
        for what, look, place in (("gain", symbol, shift - APART / 2), ("frequency", f"{symbol}-open", shift + APART / 2)):
            values = [getattr(case, f"{what}_difference") for case in some]
            hover = [
                f"{escape(case.what)}<br>{WITNESSES[witness]}, {what}: {percent(value, case.tolerance)}"
                for case, value in zip(some, values, strict=True)
            ]
            places = np.clip(100 * np.array(values), -0.97 * reach, 0.97 * reach), [rows.index(case.what) + place for case in some]
            named = {"name": f"{WITNESSES[witness]}, {what}", "hoverinfo": "text", "hovertext": hover}
            traces.append(style.markers(*places, look, color, size, **named))
    axis = style.axis("difference from the prediction [%]", range=[-reach, reach], fixedrange=True)
    bands = [style.stretch(-width, width, style.GREEN, SHADES[witness]) for witness, width in allowed.items()]
    bounds = ", ".join(f"{WITNESSES[witness]} within {digits(width)} %" for witness, width in reversed(allowed.items()))
    caption = f"Filled: gain; open, below it: frequency. Green is agreement: {bounds}."
    lost = [
        style.label(0, rows.index(case.what) + MARKS[case.witness][3], f"<b>{WITNESSES[case.witness]}: no limit found</b>", style.VERMILION)
        for case in cases
        if math.isnan(case.gain_difference)
    ]
    return _picture(traces, axis, rows, bands, lost, "Simulated minus predicted", caption)


def _rows(cases: Sequence[VerifiedLimit]) -> list[str]:
    return list(dict.fromkeys(case.what for case in cases))


def _by_witness(cases: Sequence[VerifiedLimit]) -> list[tuple[str, list[VerifiedLimit]]]:
    found = [(witness, [case for case in cases if case.witness == witness]) for witness in MARKS]
    return [(witness, some) for witness, some in found if some]


def _picture(traces: list, axis: dict, rows: Sequence[str], shapes: list, notes: list, title: str, caption: str) -> Html:
    """Figure with a row per case, named on two lines: state and space."""
    names = [escape(row, quote=False).replace(": ", "<br>") for row in rows]
    layout = style.layout(
        xaxis=axis,
        yaxis=style.axis("", range=[len(rows) - 0.5, -0.5], tickvals=list(range(len(rows))), ticktext=names, ticks="", fixedrange=True),
        shapes=shapes,
        annotations=notes,
        showlegend=any(trace.get("showlegend") for trace in traces),
        legend=style.switches(1.0, yref="container", yanchor="top"),
        margin={"l": 20, "r": 12, "t": 40, "b": 48},
    )
    return figure({"data": traces, "layout": layout}, title, caption, 64 * len(rows) + 104, {"margin.l": 8})


def growth(system: System, limit: float) -> Html:
    """Figure of the growth rate over gain: the rightmost root's as a line, that of simulated runs as dots."""
    found = growth_about(system.loop())
    seen = np.isfinite(found.simulated)
    hover: dict[str, Any] = {"hovertemplate": "%{x:.4g} ×: %{y:.4g} 1/s", "hoverinfo": "all"}
    traces = [
        style.line(found.gain, found.predicted, style.BLACK, name="predicted: rightmost root", showlegend=True, **hover),
        style.markers(
            found.gain[seen], found.simulated[seen], "circle", style.BLUE, 10, name="simulated: one run each", showlegend=True, **hover
        ),
    ]
    zero = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 0, "y1": 0, "line": {"color": style.INK, "width": 1}}
    layout = style.layout(
        xaxis=style.axis("factor on all gains [×]"),
        yaxis=style.axis("growth rate of the vibration [1/s]"),
        shapes=[zero, style.upright(limit, style.SOFT, "dot", 1.5)],
        annotations=[
            style.label(limit, 0.02, f"predicted limit {digits(limit, '×', 5)}", yref="paper", yanchor="bottom", xanchor="left", xshift=4)
        ],
        showlegend=True,
        legend=style.switches(1.02),
        margin={"l": 78, "r": 24, "t": 40, "b": 52},
    )
    caption = (
        "Below zero the impulse response decays, above zero it grows. The line is computed from the loop's roots, the dots from simulated "
        "runs; both cross zero at the limit."
    )
    narrow = style.NARROW | {"margin.t": 64, "yaxis.title.text": "growth rate [1/s]"}
    return figure({"data": traces, "layout": layout}, "Vibration starts where its growth rate changes sign", caption, 400, narrow)


def verification_page(shown: VerificationPresentation, command: str) -> str:
    """HTML page of a verification; `command`: the command that makes it."""
    system, result = shown.system, shown.result
    limit, wrong = result.cases[0].predicted_gain, [case for case in result.cases if not case.agrees]
    sample_time, what, model = system.control.sample_time, "a robot", "Robot linearised about each posture, all loops closed"
    if not result.of_robot:
        what, model = "one joint", "Linear two-mass joint"
    count = len(result.cases)
    cases = table(*tabulated(CASE, result.cases), "Predicted and simulated gains are factors on the file's own.")
    sections = [
        Section(f"What disagrees: {len(wrong)} of {count} cases" if wrong else "Predicted and simulated", [agreement(result.cases)]),
        Section("Growth about the limit", [growth(system, limit)]) if not result.of_robot and 0 < limit < math.inf else None,
        Section("Case by case", [cases], f"{count} case{'s' * (count > 1)} with gains and frequencies"),
        Section(
            "Assumptions",
            [assumptions(model, system.control), _method(result), *(f"Left out: {warning}" for warning in result.warnings)],
            "the model, and how the limits are simulated",
        ),
    ]
    texts = [f"left out: {warning}" for warning in result.warnings]
    state = "bare" if result.least.enough is False or result.least.predicted_gain <= 1 else "good"
    headline = "" if result.agrees else "Simulation and prediction disagree: do not rely on the predicted limit"
    lead = Lead(sentence(result), state if result.agrees else "bad", headline, texts, advice_box(shown.advice))
    return page(f"gainroom verify: {what}, {model_text(sample_time)}", lead, _cards(result), sections, command)


def _cards(result: Verification) -> list[Card]:
    cases, right = result.cases, sum(case.agrees for case in result.cases)
    wrong = listed([f"{case.what} ({case.witness})" for case in cases if not case.agrees])
    cards = [Card("cases that agree", str(right), f"of {len(cases)}", "all", result.agrees, f"not: {wrong}" if wrong else "")]
    for witness, name in WITNESSES.items():
        own = [case for case in cases if case.witness == witness]
        if own:
            worst = max(own, key=furthest)
            gain = size(worst.gain_difference) >= size(worst.frequency_difference)
            difference = worst.gain_difference if gain else worst.frequency_difference
            value, _, unit = percent(difference, worst.tolerance).rpartition(" ")
            note = f"in {'gain' if gain else 'frequency'}, the larger of both, {worst.what}"
            allowed = f"≤ {digits(100 * worst.tolerance)} %"
            cards.append(Card(f"largest difference, {name}", value or "none found", unit * bool(value), allowed, worst.agrees, note))
    return sorted([*cards, _limit(result)], key=lambda card: card.met is not False)


def _limit(result: Verification) -> Card:
    """Card of the lowest limit with the required gain margin."""
    least, required = result.least, result.least.required
    at = f"{hertz(least.predicted_frequency)}, " if math.isfinite(least.predicted_frequency) else ""
    asked = Requirements() if required is None else Requirements(gain_margin=required)
    wanted = "> 1: stable" if required is None else f"≥ {digits(required, '×', 3)}: gain margin {requirement(asked, 'gain_margin', 3)}"
    met = least.predicted_gain > 1 if required is None else least.enough
    if met and result.uncertain:  # one case of the file's ranges
        met = None
    return Card("vibration starts at", digits(least.predicted_gain, "", 4), "×", wanted, met, f"{at}{least.what}{at_nominal(result)}")


def _method(result: Verification) -> str:
    return (
        "Every run starts with a torque impulse. A matrix pencil finds the fastest-growing oscillation in its second half, and a bracketed "
        "search the factor at which its growth rate is zero, to one part in a million; in MuJoCo, where the motors start at a small "
        "speed, to one in a thousand. The limits " + left_out(result) + "; gainroom simulate includes the scenario."
    )
