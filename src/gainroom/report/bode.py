"""Bode and Nyquist figures of the open loop, with and without elasticity and delay, as Fig. 9 of Jung et al. 2017."""

import math
from dataclasses import dataclass

import numpy as np

from ..analysis.margin_record import Margins
from ..errors import at_frequency
from ..studies.joint import JointStudy
from ..system.linear.arrays import Complexes, Floats, distinct
from ..system.loop import Loop
from ..system.margin_units import to_db
from . import style
from .number_format import digits, frequency, hertz
from .page import Html, figure

PER_DECADE = 120
FLOOR, CEILING, DEEPEST = -60.0, 80.0, -560.0  # [dB], [dB], [°]: what lies beyond is not drawn
LOOK = (("solid", style.BLACK, 3.0), ("dash", style.BLUE, 1.8), ("dot", style.VERMILION, 2.2), ("dashdot", style.GREEN, 1.8))


@dataclass(frozen=True)
class BodeLoop:
    """One of the four loops of the figure."""

    name: str
    loop: Loop
    margins: Margins


def cases(study: JointStudy) -> list[BodeLoop]:
    """Loops of the figure: the given one, then without elasticity, without delay, without both, as far as they differ."""
    present = [name for name in ("elasticity", "delay") if name in study.others]
    found = [BodeLoop(f"with {' and '.join(present)}" if present else "this loop", study.loop, study.margins)]
    names = {"elasticity": "without elasticity", "delay": "without delay", "delay and elasticity": "without both"}
    return found + [BodeLoop(title, *study.others[name]) for name, title in names.items() if name in study.others]


def bode(study: JointStudy, shown: list[BodeLoop]) -> Html:
    """Figure of magnitude and phase on one frequency axis, with the deciding margins as arrows."""
    span = frequency_span(study, shown)
    curves = [response(case.loop, *span) for case in shown]
    traces = []
    for case, (omega, size, phase), (dash, color, width) in zip(shown, curves, LOOK, strict=False):
        common = {"dash": dash, "width": width, "legendgroup": case.name, "name": case.name, "hoverinfo": "all"}
        hover = case.name + "<br>%{x:.4~g} rad/s<br>%{y:.3~g} "
        traces.append(style.line(omega, size, color, **common, xaxis="x2", hovertemplate=hover + "dB<extra></extra>"))
        traces.append(style.line(omega, phase, color, **common, showlegend=False, yaxis="y2", hovertemplate=hover + "°<extra></extra>"))
    omega, _, phase = curves[0]
    arrows, reached = _margin_arrows(study, span, omega, phase)
    levels = _range(np.concatenate([size for _, size, _ in curves]), FLOOR, 6.0, CEILING)
    angles = _range(np.concatenate([*(phase for *_, phase in curves), reached]), DEEPEST, 25.0)
    picture = style.layout(
        **style.frequency_axes(*span),
        yaxis=style.axis("magnitude |L| [dB]", domain=[0.47, 1], range=levels, dtick=20, anchor="x2"),
        yaxis2=style.axis("phase arg L [°]", domain=[0, 0.44], range=angles, dtick=90),
        showlegend=True,
        legend=style.switches(1.13),
        annotations=_landmark_names(study, span) + arrows,
        shapes=_lines(study, angles),
        margin={"l": 78, "r": 24, "t": 96, "b": 52},
    )
    narrow = {**style.NARROW, "xaxis2.title.text": "Hz", "yaxis.title.text": "|L| [dB]", "yaxis2.title.text": "arg L [°]"}
    narrow |= style.decades("xaxis", *span) | style.decades("xaxis2", *span, scale=2 * math.pi)
    return figure({"data": traces, "layout": picture}, _title(shown), _caption(study, shown), 640, narrow)


def response(loop: Loop, low: float, high: float) -> tuple[Floats, Floats, Floats]:
    """Frequencies omega [rad/s], |L| [dB] and arg L [°] of a scalar loop built with build_loop, all (k,).

    The phase is continuous and begins between −360° and 0°; the delay may turn it any number of times between samples.
    """
    assert loop.parts is not None
    omega = grid(loop, low, high)
    value = loop.response(omega)
    drawn = np.isfinite(value) & (value != 0)  # at the pole of a spring without damping there is neither size nor phase
    omega, value = omega[drawn], value[drawn]
    turned = omega * loop.parts.drives[0].delay
    phase = np.degrees(np.unwrap(np.angle(value * np.exp(1j * turned))) - turned)
    return omega, 20 * np.log10(np.abs(value)), phase - 360 * math.ceil((phase[0] - 1) / 360)


def grid(loop: Loop, low: float, high: float) -> Floats:
    """Frequencies [rad/s] from `low` to `high`, dense around resonances."""
    parts = [np.geomspace(low, high, round(PER_DECADE * math.log10(high / low)))]
    parts += [one.imag * (1 + 0.3 * np.linspace(-1, 1, 81) ** 3) for one in loop.corner_frequencies.every if one.imag > 0]
    omega = distinct(np.concatenate(parts))
    return omega[(omega >= low) & (omega <= high)]


def frequency_span(study: JointStudy, shown: list[BodeLoop]) -> tuple[float, float]:
    """Frequency range [rad/s] from well below the first crossover to well above the last landmark, or to the Nyquist frequency."""
    joint, drive = study.system.source, study.system.drives[0]
    marks = [joint.resonance, joint.antiresonance, drive.bandwidth]
    for case in shown:
        marks += [c.omega for c in case.margins.gain_crossings] + [case.margins.phase_crossover]
    known = [w for w in marks if math.isfinite(w) and w > 0] or [1.0]
    low, high = 0.2 * min(known), 2.5 * max(known)
    if study.system.control.sample_time is not None:
        high = math.pi / study.system.control.sample_time
    return max(low, 1e-5 * high), high


def _range(values: Floats, least: float, margin: float, most: float = math.inf) -> list[float]:
    """Axis range that shows `values` from `least` up to `most`, with `margin` on either side."""
    return [max(float(values.min()) - margin, least), min(float(values.max()) + margin, most)]


def _margin_arrows(
    study: JointStudy, span: tuple[float, float], omega: Floats, phase: Floats
) -> tuple[list[style.Annotation], list[float]]:
    """Arrows of the gain and the phase margin, each at the deciding crossing; and the phases that they reach."""
    found, notes, reached = study.margins, [], []
    crossings = [c for c in found.phase_crossings if c.omega > 0 and 0 < c.gain < 1e3]
    if crossings:
        crossing = min(crossings, key=lambda c: abs(to_db(c.gain)))
        x, level = math.log10(crossing.omega), -to_db(crossing.gain)
        what = "gain margin" if found.stable else "too high by" if crossing.gain < 1 else "margin"
        short = digits(abs(level), "dB", 3)
        side = "right" if _place(crossing.omega, span) > 0.72 else "left"
        place = {"xanchor": side, "yanchor": "bottom", "yshift": 3, "align": side}
        notes = [
            style.arrow((x, level), (x, 0.0), style.VERMILION),
            style.label(x, max(level, 0.0), f"{what} {short}<br>at {frequency(crossing.omega, 3)}", style.VERMILION, **place, name="wide"),
            style.label(x, max(level, 0.0), short, style.VERMILION, **place, name="narrow"),
        ]
    if found.gain_crossings:
        crossing = min(found.gain_crossings, key=lambda c: abs(c.phase_margin))
        margin = math.degrees(crossing.phase_margin)
        x, there = math.log10(crossing.omega), float(np.interp(crossing.omega, omega, phase))
        line = there - margin  # −180° or whole turns from it
        if min(there, line) >= DEEPEST:
            reached = [there, line]
            text = f"phase margin {digits(margin, '°', 3)}<br>at {frequency(crossing.omega, 3)}"
            place = {"yref": "y2", "xanchor": "right", "yanchor": "top", "xshift": 30, "yshift": -6, "align": "right"}
            notes.append(style.arrow((x, line), (x, there), style.BLUE, yref="y2", ayref="y2"))
            notes.append(style.label(x, min(line, there), text, style.BLUE, **place))
    return notes, reached


def _place(omega: float, span: tuple[float, float]) -> float:
    """Position of a frequency on the axis, from 0 to 1."""
    return math.log(omega / span[0]) / math.log(span[1] / span[0])


def _landmark_names(study: JointStudy, span: tuple[float, float]) -> list[style.Annotation]:
    """Labels of landmarks: resonance and anti-resonance at the foot of the magnitude, current loop and half the sample rate at its top."""
    joint, drive, step = study.system.source, study.system.drives[0], study.system.control.sample_time
    named = [
        ("anti-resonance", joint.antiresonance, 0.475),
        ("resonance", joint.resonance, 0.51),
        ("ω<sub>c</sub>", drive.bandwidth, 0.955),
        ("half the sample rate", math.inf if step is None else math.pi / step, 0.92),
    ]
    quiet = {"yref": "paper", "yanchor": "bottom", "font": {"size": 12, "color": style.SOFT}}
    return [
        style.label(
            math.log10(omega),
            height,
            f"{name} {hertz(omega)}",
            name="" if height < 0.9 else "wide",
            xanchor="right" if _place(omega, span) > 0.6 else "left",
            **quiet,
        )
        for name, omega, height in named
        if span[0] < omega <= span[1]
    ]


def _lines(study: JointStudy, angles: list[float]) -> list[dict]:
    """Lines at 0 dB, at −180° and its repeats, and at the landmarks."""
    flat = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "line": {"color": "#777", "width": 1.2}, "layer": "below"}
    shapes = [flat | {"y0": 0, "y1": 0}]
    shapes += [flat | {"yref": "y2", "y0": y, "y1": y} for y in (180, -180, -540) if angles[0] < y < angles[1]]
    joint, drive = study.system.source, study.system.drives[0]
    marked = [omega for omega in (joint.antiresonance, joint.resonance, drive.bandwidth) if math.isfinite(omega)]
    return shapes + [style.upright(omega, "#bbb", "dot") for omega in marked]


def _title(shown: list[BodeLoop]) -> str:
    if len(shown) == 4:
        return "Open loop with and without elasticity and delay"
    return "Open loop" + (f", with and {shown[1].name}" if len(shown) == 2 else "")


def _caption(study: JointStudy, shown: list[BodeLoop]) -> str:
    cases = []
    for case in shown:
        found = case.margins
        margin = digits(to_db(found.gain_margin), "dB", 3) if found.stable else "unstable"
        cases.append(f"{case.name}: {margin}{at_frequency(found.phase_crossover, text=hertz)}")
    text = f"Gain margins: {'; '.join(cases)}. "
    if study.system.delay > 0:
        text += "The delay does not change the magnitude and turns the phase by −ωT. "
    if any(case.name == "without elasticity" for case in shown):
        text += "Elasticity raises the magnitude above the resonance. "
    return text + ("Click a name above the picture to switch its line." if len(shown) > 1 else "")


WINDOW = ((-3.2, 1.6), (-2.4, 2.4))  # real, imaginary


def nyquist(study: JointStudy, shown: list[BodeLoop]) -> Html:
    """Figure of L(jω) near −1, with the disk about −1 that the disk margin excludes."""
    low, high = frequency_span(study, shown)
    omega = grid(study.loop, 0.05 * low, high if study.system.control.sample_time is not None else 4 * high)
    value = study.loop.response(omega)
    text = [frequency(w) for w in omega]
    near: Complexes = np.where(np.abs(value) < 60, value, np.nan)  # what runs off to infinity is far outside the picture
    traces = [
        *_disk(study),
        style.line(near.real, -near.imag, style.SOFT, dash="dot", width=1.2, name="mirror image, L(−jω)"),
        style.line(near.real, near.imag, style.BLACK, width=2.6, hoverinfo="text", text=text, name="open loop, L(jω)", legendrank=1),
        style.markers([-1], [0], "x", style.VERMILION, 13, name="critical point −1"),
    ]
    beads, notes = _beads(omega, value)
    notes.append(style.label(-1, 0, "−1", style.VERMILION, xanchor="right", yanchor="top", xshift=-6, yshift=-4))
    rows = {"scaleanchor": "x", "range": list(WINDOW[1]), "zeroline": True, "zerolinecolor": "#bbb", "dtick": 1}
    picture = style.layout(
        xaxis=style.axis("Re L", range=list(WINDOW[0]), zeroline=True, zerolinecolor="#bbb", constrain="domain", dtick=1),
        yaxis=style.axis("Im L", **rows),
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.01),
        margin={"l": 78, "r": 24, "t": 64, "b": 52},
    )
    return figure(
        {"data": [*traces, beads], "layout": picture}, "Nyquist curve near the critical point", _nyquist_caption(study), 520, style.NARROW
    )


def _disk(study: JointStudy) -> list[style.Trace]:
    """The disk of the balanced disk margin α: its ends lie at −(2+α)/(2−α) and −(2−α)/(2+α) (Seiler et al. 2020)."""
    alpha = study.margins.disk_margin
    if not 0 < alpha < 1.99:
        return []
    far, close = -(2 + alpha) / (2 - alpha), -(2 - alpha) / (2 + alpha)
    turn = np.linspace(0, 2 * math.pi, 121)
    center, radius = (far + close) / 2, (close - far) / 2
    x, y = center + radius * np.cos(turn), radius * np.sin(turn)
    look = {"dash": "dash", "width": 1.6, "fill": "toself", "fillcolor": "rgba(86,180,233,0.25)", "hoveron": "fills"}
    return [style.line(x, y, style.BLUE, **look, name=f"disk of the disk margin {digits(alpha, '', 3)}")]


def _beads(omega: Floats, value: Complexes) -> tuple[style.Trace, list[style.Annotation]]:
    """Round frequencies on the curve, no two labels close together."""
    (left, right), (bottom, top) = WINDOW
    wanted = [step * 10.0**decade for decade in range(-3, 7) for step in (1, 2, 3, 5, 7)]
    xs, ys, notes = [], [], []
    for target in wanted:
        if not omega[0] < target < omega[-1]:
            continue
        point = complex(np.interp(target, omega, value.real), np.interp(target, omega, value.imag))
        inside = left + 0.1 < point.real < right - 0.1 and bottom + 0.1 < point.imag < top - 0.1
        if not inside or any(math.hypot(point.real - x, point.imag - y) < 0.3 for x, y in zip(xs, ys, strict=True)):
            continue
        xs.append(point.real)
        ys.append(point.imag)
        notes.append(style.label(point.real, point.imag, digits(target), style.INK, xanchor="left", yanchor="bottom", xshift=4, yshift=2))
    if notes:
        notes[-1]["text"] += " rad/s"
    return style.markers(xs, ys, "circle", style.BLACK, 8, name="numbers: ω [rad/s]"), notes


def _nyquist_caption(study: JointStudy) -> str:
    found = study.margins
    if not found.stable:
        return (
            f"The curve goes round −1 so that {found.unstable_roots} closed-loop roots are unstable. Numbers on the curve are ω in rad/s; "
            "the dotted curve is the mirror image at −ω."
        )
    return (
        f"The curve passes −1 at a distance of {digits(1 / found.peak_sensitivity, '', 3)} (1/Ms). It never enters the shaded "
        f"disk (disk margin {digits(found.disk_margin, '', 3)}): gain and phase may change together by anything inside it. "
        "Numbers on the curve are ω in rad/s."
    )
