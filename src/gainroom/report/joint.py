"""Page of one joint: verdict, numbers, gain map, figures, step response, tables, certification."""

import math

import numpy as np

from ..analysis.margin_record import Margins
from ..errors import at_frequency, case_text
from ..simulation.step_response import StepResponse, step_response
from ..studies.joint import JointStudy
from ..system.controller import type_of
from ..system.requirements import REQUIREMENTS, Requirements
from . import style
from .bode import bode, cases, nyquist
from .columns import Column
from .gain_advice import gains_box
from .gain_map import gain_map
from .joint_tables import JointPresentation, case_table, crossing_table, inputs, margin_table, uncertainty_table
from .joint_text import cause, notes, recommended_text, sentence, uncertainty_cost_text, warnings
from .margin_columns import bounded_columns
from .number_format import digits, frequency, hertz, model_kind, typed_gains
from .page import Card, Html, Lead, Section, facts, figure, page, paragraph
from .page_parts import assumptions, margin_card, unstable_card
from .words import tone


CARDS = ("gain_margin", "phase_margin", "peak_sensitivity", "delay_margin", "dynamic_stiffness")
"""Margins with a card of their own, beside those that are required."""
MOST_CARDS = 5  # but that every required margin has one


def joint_page(shown: JointPresentation, command: str) -> str:
    """HTML page of a joint study; `command`: the command that makes it."""
    study, found = shown.study, shown.study.margins
    pictured = cases(study)
    sections = [
        Section("Gain map", [gain_map(study)]),
        Section("Why: the open loop", [*map(paragraph, filter(None, [cause(study)])), bode(study, pictured)]),
        Section("Nyquist plot", [nyquist(study, pictured)], "the open loop beside −1, and the disk about −1 that it stays out of"),
        Section("Over time", [time_response(study)], "responses to a step and to a disturbance"),
        Section("Margins", [margin_table(study), *_recommended(study)], "this file's gains, the recommended ones, and the 10 Hz rule's"),
        None
        if study.uncertainty_cost is None
        else Section("What the uncertainty costs", [uncertainty_table(study)], uncertainty_cost_text(study, ranked=False)),
        Section("With and without elasticity and delay", [case_table(pictured)], "the same gains on a rigid joint, and without delay"),
        Section("All crossings of this file's loop", [crossing_table(found)], f"{len(found.phase_crossings) + len(found.gain_crossings)}"),
        Section(
            "Inputs and assumptions",
            [inputs(study), assumptions("Linear two-mass joint", study.system.control), *map(paragraph, notes(study))],
            "what was read, and what it leaves out",
        ),
        Section("Certification", [_certificate(study)], "how each number was checked"),
    ]
    title = f"gainroom joint: gains of one joint, {model_kind(study.system.control.sample_time)} model"
    return page(title, _lead(shown), _cards(study), sections, command)


def _lead(shown: JointPresentation) -> Lead:
    study = shown.study
    found_warnings, do, how = warnings(study), gains_box(study, shown.to_use), tone(study.verdict)
    where = f" within the uncertainty ranges, at {case_text(study.unstable_at)}" if study.unstable_at else ""
    return Lead(sentence(study), how, f"UNSTABLE{where}: do not run these gains" if how == "bad" else "", found_warnings, do)


def _cards(study: JointStudy) -> list[Card]:
    """Cards of the main numbers, three to five."""
    found, asked = study.margins, study.system.requirements
    worst = study.in_range.margins if study.system.uncertainty.names else None
    time = "continuous time" if study.system.rate_is_missing else ""
    required = [column for column in bounded_columns() if column.requirement in asked.asked]
    others = [column for column in bounded_columns() if column.requirement in CARDS and column not in required]
    shown = required + others[max(0, len(required) + len(others) - MOST_CARDS) :]
    cards = [_margin_card(column, found, worst, asked, time) for column in shown]
    if not found.stable:
        cards[0] = unstable_card(asked, study.limit, f"; vibration there {at_frequency(study.limit.frequency, 'at ', hertz)}", "it")
    return cards


def _margin_card(column: Column, found: Margins, worst: Margins | None, asked: Requirements, time: str) -> Card:
    """Card of a margin at the worst of the uncertainty, with the nominal value where there is a `worst`; `time` ends the note."""
    one = REQUIREMENTS[column.requirement]
    note = "" if column.at is None else at_frequency(column.at(found), "at ", hertz)
    nominal = getattr(found, one.name, one.value(found))
    if worst is None:
        return margin_card(asked, one.name, nominal, ", ".join(filter(None, [note, time])), one.value(found))
    note = "" if column.at is None or not found.stable else at_frequency(column.at(worst), "at ", hertz)
    within = f"nominal {one.text(nominal)}" if found.stable else ""
    return margin_card(asked, one.name, one.value(worst), ", ".join(filter(None, [note, within, time])), label=f"{one.label}, worst case")


def _recommended(study: JointStudy) -> list[str]:
    best = study.recommended
    if best is None:
        return ["No gains are recommended: nothing is required, or no PD gains meet it."]
    other = "" if type(best.controller) is type(study.system.control.controller) else f", type {type_of(best.controller)}"
    return [f"Recommended controller{other}: {typed_gains(best.controller)}.", recommended_text(best)]


def _certificate(study: JointStudy) -> Html:
    found, limit = study.margins, study.limit
    crossings = "every crossing and peak was bracketed and polished; bounds between the evaluated frequencies prove that none was missed"
    pairs = [
        ("margins", crossings if found.certified else "estimates: a crossing or peak could not be proved"),
        ("verdict", _verdict(found)),
    ]
    if study.system.uncertainty.names and found.stable:
        verdict = f"unstable at {case_text(study.unstable_at)}" if study.unstable_at else "stable"
        how = "a case that was counted" if study.unstable_at else "proved for every joint within them, between all frequencies"
        if not study.range_proved:
            how = "ends, corners, a filling and a search examined; between them not proved"
        pairs.append(("verdict in the uncertainty ranges", f"{verdict}; {how}"))
    if limit.certificate is not None:
        proof = limit.certificate
        pairs.append(
            (
                "gain limit",
                f"{digits(limit.gain, '', 6)} × these gains at {frequency(limit.frequency)}: {proof.inside} unstable roots at "
                f"(1 − {digits(proof.nudge)}) of it, {proof.outside} at (1 + {digits(proof.nudge)}); "
                f"{'confirmed' if proof.holds else 'NOT confirmed'}",
            )
        )
    pairs.append(("gain map", "boundaries in closed form (D-decomposition), exact on every line drawn, not a pixel grid"))
    if study.recommended is not None:
        pairs.append(("recommended gains", study.recommended.certificate))
    return facts(pairs)


def _verdict(found: Margins) -> str:
    count = "no closed-loop root is" if found.stable else f"{found.unstable_roots} closed-loop roots are"
    return f"{count} unstable, counted by Nyquist's criterion on the certified crossings"


CURVE_POINTS = 1200  # drawn per curve


def time_response(study: JointStudy) -> Html:
    """Figure of the step responses: two panels over one time axis."""
    own = step_response(study.loop)
    shown = [("this file", own, style.BLACK, "solid", 2.6)]
    recommended = study.recommended
    if recommended is not None:
        loop = study.system.loop(controller=recommended.controller)
        shown.append(("recommended", step_response(loop, float(own.time[-1])), style.BLUE, "dash", 2.0))
    traces, notes = [], []
    for name, response, color, dash, width in shown:
        pick = slice(None, None, max(1, len(response.time) // CURVE_POINTS))
        time = 1e3 * response.time[pick]
        shape = "hv" if study.system.control.sample_time is not None and len(time) < 150 else "linear"
        parts = {"dash": dash, "width": width, "name": name, "hoverinfo": "x+y+name"}
        for values, axis in ((response.reference, "y"), (1e6 * response.disturbance, "y2")):
            trace = style.line(time, values[pick], color, **parts, yaxis=axis, legendgroup=name, showlegend=axis == "y")
            trace["line"]["shape"] = shape
            traces.append(trace)
    end = 1e3 * float(own.time[-1])
    traces.insert(0, style.line([0, 0, end], [0, 1, 1], style.SOFT, dash="dot", width=1.4, name="commanded", showlegend=True))
    if own.growth > 0:
        notes.append(_vibration(own))
    place = {"xref": "paper", "yref": "paper", "xanchor": "right", "yanchor": "bottom", "name": "wide"}
    for height, words in ((1.0, "unit step of the reference"), (0.45, "1 N·m added to the torque command")):
        notes.append(style.label(0.995, height, words, style.SOFT, **place))
    picture = style.layout(
        xaxis=style.axis("time [ms]", anchor="y2", range=[-0.01 * end, end]),
        yaxis=style.axis("position / reference step [–]", domain=[0.55, 1]),
        yaxis2=style.axis("position for 1 N·m [µrad]", domain=[0, 0.45]),
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.03),
        margin={"l": 78, "r": 24, "t": 40, "b": 52},
    )
    narrow = {**style.NARROW, "yaxis.title.text": "position [–]", "yaxis2.title.text": "position [µrad]"}
    return figure(
        {"data": traces, "layout": picture}, "Step of the reference, and step of a disturbance torque", _caption(study, own), 560, narrow
    )


def _vibration(response: StepResponse) -> style.Annotation:
    """Label of a growing vibration's frequency, at the top of the figure."""
    words = f"vibrates at {hertz(response.frequency)}" if response.frequency > 0 else "diverges"
    doubling = math.log(2) / response.growth
    text = f"<b>{words}</b>, doubling every {digits(1e3 * doubling, 'ms', 3)}"
    return style.label(0.01, 0.99, text, style.VERMILION, xref="paper", yref="paper", xanchor="left", yanchor="top")


def _caption(study: JointStudy, own: StepResponse) -> str:
    side = study.system.control.feedback
    text = f"Position of the {side} side. "
    if own.growth > 0:
        rate = f"{digits(own.growth, '1/s', 3)}"
        text += f"The response grows at {rate}, at {hertz(own.frequency)}: do not run these gains. "
    else:
        overshoot = 100 * (float(own.reference.max()) - 1)
        last = 1e6 * float(np.abs(own.disturbance[-1]))
        text += f"These gains overshoot by {digits(max(overshoot, 0.0), '%', 3)}; the controller differentiates the step, "
        text += "as in eq. (4) of the paper. "
        text += f"A constant torque of 1 N·m deflects the joint by {digits(last, 'µrad', 3)} at the end of the figure. "
    if study.system.control.sample_time is not None:
        return text + "Stepped exactly from tick to tick; torque is held between ticks."
    if study.system.delay == 0:
        return text + "Stepped exactly (matrix exponential)."
    share = f"{digits(100 * own.change, '', 1)} %" if own.change >= 1e-5 else "less than 0.001 %"
    return text + f"Stepped with the exact delay; halving the step changes the curve by {share}."
