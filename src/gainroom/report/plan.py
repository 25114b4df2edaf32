"""Planned excitation as page, sentences and JSON: signal, predicted motion, and accuracy expected from its log."""

import math
from typing import Any

import numpy as np

from ..identification.plan import NAMES, Plan
from ..system.linear.arrays import Floats
from . import style
from .curves import Curve, Panel, stacked
from .identified_text import TITLES
from .number_format import digits
from .page import Card, Html, Lead, Section, figure, page, paragraph, table

EXPECTED = ("motor_inertia", "link_inertia", "stiffness", "damping", "resonance", "antiresonance", "delay")
UNITS = {"torque": "N·m", "speed": "rad/s", "travel": "rad"}
MEANT = {"friction": "no friction", "encoder_step": "an encoder step of {}", "torque_noise": "torque noise of {}"}
LIMIT_TITLES = ("", "reached", "allowed", "binds")
EXPECTED_TITLES = ("", "95 % interval")


def sentence(plan: Plan) -> str:
    """Sentence on the signal to run, and the accuracy of the stiffness."""
    low, high = (digits(omega / (2 * math.pi), "", 3) for omega in (plan.excitation.frequencies[0], plan.excitation.frequencies[-1]))
    return (
        f"Run a {plan.kind} of {digits(plan.amplitude, 'N·m', 3)} peak from {low} to {high} Hz for "
        f"{digits(float(plan.excitation.time[-1]), 's', 3)}: its log will tell the stiffness to ± {percent(plan.expected['stiffness'])}."
    )


def percent(share: float) -> str:
    """Share in percent, two digits."""
    return digits(100 * share, "%", 2)


def limit_rows(plan: Plan) -> list[tuple[str, ...]]:
    """Table rows (LIMIT_TITLES) of the limits."""
    rows = []
    for name in NAMES:
        allowed = getattr(plan.bounds, name)
        shown = "any" if math.isinf(allowed) else digits(allowed, UNITS[name], 3)
        rows.append((name, digits(plan.reached[name], UNITS[name], 3), shown, "yes" if name == plan.binding else ""))
    return rows


def expected_rows(plan: Plan) -> list[tuple[str, str]]:
    """Table rows (EXPECTED_TITLES) of the expected accuracy."""
    widths = {name: f"± {percent(plan.expected[name])}" for name in EXPECTED}
    if plan.expected["damping"] >= 1:
        widths["damping"] = "not told"
    return [(TITLES[name], width) for name, width in widths.items()]


def assumptions(plan: Plan) -> list[str]:
    """Assumptions behind limits and accuracy."""
    shown = {"encoder_step": digits(plan.hardware.encoder_step, "rad", 2), "torque_noise": digits(plan.hardware.torque_noise, "N·m", 2)}
    assumed = [MEANT[name].format(shown.get(name, "")) for name in plan.assumed]
    held = "the controller of the file holds the joint" if plan.closed else "nothing holds the joint"
    where = "at the nominal values" if plan.cases == 1 else f"in {plan.cases} cases of the ranges"
    found = [
        f"The limits hold {where}, by the linear model without friction and weight; {held} meanwhile.",
        "The accuracy is the Cramér–Rao bound of the model that identify joint fits; log target_torque, actual_torque and motor_position.",
    ]
    if plan.hardware.dry:
        sides = (("motor", plan.hardware.friction), ("link", plan.hardware.link_friction))
        sizes = [f"{digits(size, 'N·m', 3)} on the {side}" for side, size in sides if size]
        found.append(f"Coulomb friction of {' and '.join(sizes)} is included; the damping's interval has what friction may hide of it.")
    elif "friction" not in plan.assumed:
        found.append("It holds for a joint without friction.")
    return found + ([f"Assumed, as nothing was said: {', '.join(assumed)}."] if assumed else [])


def facts(plan: Plan) -> dict[str, Any]:
    """JSON of a plan."""
    return {
        "sentence": sentence(plan),
        "kind": plan.kind,
        "frequencies_hz": (plan.excitation.frequencies / (2 * math.pi)).tolist(),
        "amplitude": plan.amplitude,
        "crest_factor": plan.excitation.crest_factor,
        "duration": float(plan.excitation.time[-1]),
        "limits": {name: {"allowed": getattr(plan.bounds, name), "reached": plan.reached[name]} for name in NAMES},
        "binding": plan.binding,
        "closed_loop": plan.closed,
        "expected": dict(plan.expected),
        "hardware": {**vars(plan.hardware), "assumed": list(plan.assumed)},
        "warnings": list(plan.warnings),
    }


CARDS = ("stiffness", "motor_inertia", "link_inertia", "delay")
CLOSE_UP = 1.0  # [s]
BEYOND = 1.3  # times the first and the last frequency: as far as the spectrum is drawn


def plan_page(plan: Plan, command: str) -> str:
    """HTML page of a plan; `command`: the command that makes it."""
    cards = [Card(TITLES[name], f"± {percent(plan.expected[name]).removesuffix(' %')}", "%", note="95 % interval") for name in CARDS]
    cards.append(Card("limit that binds", plan.binding, note=digits(getattr(plan.bounds, plan.binding), UNITS[plan.binding], 3)))
    middle = float(plan.excitation.time[-1]) / 2
    sections = [
        Section("What runs", [_in_time(plan, 0.0, 2 * middle, "Excitation and predicted motion")]),
        Section("Which frequencies", [_spectrum(plan)]),
        Section("A closer look", [_in_time(plan, middle, middle + CLOSE_UP, "One second of it")]),
        Section("Limits", [table(LIMIT_TITLES, limit_rows(plan), "", sorts=False)]),
        Section("Accuracy to expect", [table(EXPECTED_TITLES, expected_rows(plan), "", sorts=False)]),
        Section("Assumptions", [paragraph(text) for text in assumptions(plan)]),
    ]
    lead = Lead(sentence(plan), "warn" if plan.warnings else "good", "", plan.warnings)
    return page(f"gainroom identify plan: {plan.kind}", lead, cards, sections, command)


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
    """Figure of the amplitudes of torque and motion, with the ranges of antiresonance and resonance."""
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

    def points(color: str) -> dict[str, Any]:
        return {"mode": "markers", "marker": {"color": color, "size": 5}} if plan.kind == "multisine" else {}

    traces = [
        style.line(omega[shown], torque[shown], style.BLACK, xaxis="x2", **hover) | points(style.BLACK),
        style.line(omega[shown], 1e3 * motion[shown], style.BLUE, yaxis="y2", **hover) | points(style.BLUE),
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
    """Amplitudes (k,) of the sines in `values` (m,)."""
    return 2 * np.abs(np.fft.rfft(values)) / len(values)
