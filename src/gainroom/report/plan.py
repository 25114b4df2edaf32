"""The page of a planned excitation: what to run, what the joint will do, what its log will tell."""

import math

import numpy as np

from ..identification.plan import Plan
from ..system.linear.arrays import Floats
from . import style
from .curves import Curve, Panel, stacked
from .identified_joint_text import TITLES
from .number_format import digits
from .page import Card, Html, Lead, Section, block, figure, page, paragraph, table
from .page_parts import footer
from .plan_text import EXPECTED_TITLES, LIMIT_TITLES, UNITS, assumptions, expected_rows, limit_rows, percent, sentence

CARDS = ("stiffness", "motor_inertia", "link_inertia", "delay")
CLOSE_UP = 1.0  # [s]
BEYOND = 1.3  # times the first and the last frequency: as far as the spectrum is drawn


def plan_page(plan: Plan, command: str) -> str:
    """The report as one HTML page; `command` is the command that makes it."""
    cards = [Card(TITLES[name], f"± {percent(plan.expected[name]).removesuffix(' %')}", "%", note="95 % interval") for name in CARDS]
    cards.append(Card("limit that binds", plan.binding, note=digits(getattr(plan.bounds, plan.binding), UNITS[plan.binding], 3)))
    middle = float(plan.excitation.time[-1]) / 2
    sections = [
        Section("What runs", [_in_time(plan, 0.0, 2 * middle, "Excitation and predicted motion")]),
        Section("Which frequencies", [_spectrum(plan)]),
        Section("A closer look", [_in_time(plan, middle, middle + CLOSE_UP, "One second of it")]),
        Section("Limits", [table(LIMIT_TITLES, limit_rows(plan), "", {"yes": "met"}, sorts=False)]),
        Section("Accuracy to expect", [table(EXPECTED_TITLES, expected_rows(plan), "", sorts=False)]),
        Section("Assumptions", [paragraph(text) for text in assumptions(plan)]),
        Section("Command", [block(command)]),
    ]
    lead = Lead(sentence(plan), "warn" if plan.warnings else "good", "", plan.warnings)
    return page(f"gainroom identify plan: {plan.kind}", lead, cards, sections, footer())


def _in_time(plan: Plan, start: float, end: float, title: str) -> Html:
    run = plan.run
    rows = slice(*np.searchsorted(run.time, [start, end + 1e-9]).tolist())
    torques = [
        Curve("excitation", plan.torque[rows], style.ORANGE, "dash"),
        Curve("target torque", run.target_torque[rows, 0], style.BLACK),
    ]
    scale = 1e3
    sides = [
        Curve("motor", scale * run.motor_position[rows, 0], style.BLUE),
        Curve("link", scale * run.link_position[rows, 0], style.VERMILION, "dash"),
    ]
    caption = "Target torque: excitation and controller together. " if plan.closed else ""
    caption += "Positions by the linear model at the nominal values, from rest at 0; friction makes them smaller."
    panels = [Panel("torque", "N·m", torques, 0.5), Panel("position", "mrad", sides, 0.5)]
    return stacked(run.time[rows], panels, title, caption, 460)


def _spectrum(plan: Plan) -> Html:
    """Amplitudes of torque and motion, and where antiresonance and resonance may lie."""
    run, tick = plan.run, plan.run.sample_time
    omega = 2 * np.pi * np.fft.rfftfreq(len(run.time), tick)
    low, high = plan.excitation.frequencies[0] / BEYOND, min(plan.excitation.frequencies[-1] * BEYOND, math.pi / tick)
    shown = (omega >= low) & (omega <= high)
    torque, motion = _amplitudes(run.target_torque[:, 0]), _amplitudes(run.measured[:, 0])
    if plan.kind == "multisine":  # its lines, not the little between them
        lines = np.unique(np.searchsorted(omega, plan.excitation.frequencies - 0.5 * omega[1]))
        shown &= np.isin(np.arange(len(omega)), lines)
    floor = plan.hardware.encoder_step / math.sqrt(12) * 2 / math.sqrt(len(run.time))
    hover = {"hoverinfo": "all", "hovertemplate": "%{customdata:.4~g} Hz<br>%{y:.3~g}", "customdata": omega[shown] / (2 * np.pi)}
    mode = {"mode": "markers", "marker": {"size": 5}} if plan.kind == "multisine" else {}
    traces = [
        style.line(omega[shown], torque[shown], style.BLACK, xaxis="x2", **hover)
        | mode
        | ({"marker": {"color": style.BLACK, "size": 5}} if mode else {}),
        style.line(omega[shown], 1e3 * motion[shown], style.BLUE, yaxis="y2", **hover)
        | mode
        | ({"marker": {"color": style.BLUE, "size": 5}} if mode else {}),
        style.line([low, high], [1e3 * floor, 1e3 * floor], style.SOFT, dash="dot", yaxis="y2"),
    ]
    notes = [
        style.label(
            math.log10(low), math.log10(1e3 * floor), "encoder's noise", style.SOFT, yref="y2", xanchor="left", yanchor="bottom", xshift=6
        )
    ]
    shapes = []
    for name, color in (("antiresonance", style.GREEN), ("resonance", style.VERMILION)):
        first, last = plan.span(name)  # type: ignore[arg-type]
        shapes.append(style.stretch(first / 1.01, last * 1.01, color, 0.18))
        middle = math.log10(math.sqrt(first * last))
        notes.append(style.label(middle, 0.44, name, color, yref="paper", yanchor="middle", font={"color": style.DARK[color], "size": 12}))
    layout = style.layout(
        **style.frequency_axes(low, high),
        yaxis=style.axis("torque [N·m]", domain=[0.5, 1], anchor="x2", rangemode="tozero"),
        yaxis2=style.axis("motion [mrad]", domain=[0, 0.4], type="log", dtick=1, tickformat=".1~g"),
        annotations=notes,
        shapes=shapes,
        margin={"l": 84, "r": 24, "t": 60, "b": 52},
    )
    narrow = {**style.NARROW, "xaxis2.title.text": "Hz"} | style.decades("xaxis", low, high)
    narrow |= style.decades("xaxis2", low, high, scale=2 * math.pi)
    caption = (
        "Amplitude of every line, of the target torque and of the measured side, at the nominal values. Bands: where antiresonance and "
        "resonance may lie over the range. Motion has to stand clear of the encoder's noise."
    )
    return figure({"data": traces, "layout": layout}, "Torque and motion over frequency", caption, 560, narrow)


def _amplitudes(values: Floats) -> Floats:
    """(k,) of the sines in (m,)."""
    return 2 * np.abs(np.fft.rfft(values)) / len(values)
