"""The open loop over frequency, with and without elasticity and delay, as Fig. 9 of Jung et al. 2017."""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.margins import Margins, margins
from ..linear.arrays import Complexes, Floats
from ..studies.joint import JointStudy
from ..system.joint_spec import JointSpec
from ..system.loop import Loop
from . import style
from .number_format import decibels, digits, hertz
from .page import Html, figure

PER_DECADE = 120
FLOOR, DEEPEST = -60.0, -560.0  # [dB], [°] nothing below is shown
LOOK = (("solid", style.BLACK, 3.0), ("dash", style.BLUE, 1.8), ("dot", style.VERMILION, 2.2), ("dashdot", style.GREEN, 1.8))


@dataclass(frozen=True)
class Case:
    """One of the four loops of the figure."""

    name: str
    loop: Loop
    margins: Margins


def cases(study: JointStudy) -> list[Case]:
    """The loop as it is, then without elasticity, without delay, without both, as far as they differ."""
    spec = study.spec
    elastic = math.isfinite(spec.joint.stiffness) and math.isfinite(spec.joint.link_inertia)
    late = spec.drive.delay > 0
    both = [name for name, present in (("elasticity", elastic), ("delay", late)) if present]
    found = [Case(f"with {' and '.join(both)}" if both else "this loop", study.loop, study.margins)]
    if elastic:
        found.append(_case("without elasticity", _rigid(spec)))
    if late:
        found.append(_case("without delay", _instant(spec)))
    if elastic and late:
        found.append(_case("without both", _instant(_rigid(spec))))
    return found


def _case(name: str, spec: JointSpec) -> Case:
    loop = spec.loop()
    return Case(name, loop, margins(loop))


def _rigid(spec: JointSpec) -> JointSpec:
    return replace(spec, joint=replace(spec.joint, stiffness=math.inf, damping=0.0))


def _instant(spec: JointSpec) -> JointSpec:
    return replace(spec, drive=replace(spec.drive, delay=0.0))


def bode(study: JointStudy, shown: list[Case]) -> Html:
    """Magnitude and phase on one frequency axis."""
    span = frequency_span(study, shown)
    traces, sizes, phases = [], [], []
    for case, (dash, color, width) in zip(shown, LOOK, strict=False):
        omega = grid(case.loop, *span, study)
        value = case.loop.response(omega)
        size, phase = 20 * np.log10(np.abs(value)), unwrapped(case.loop, value)
        sizes.append(size)
        phases.append(phase)
        common = {"dash": dash, "width": width, "legendgroup": case.name, "name": case.name, "hoverinfo": "all"}
        told = case.name + "<br>%{x:.4~g} rad/s<br>%{y:.3~g} "
        traces.append(style.line(omega, size, color, **common, xaxis="x2", hovertemplate=told + "dB<extra></extra>"))
        traces.append(style.line(omega, phase, color, **common, showlegend=False, yaxis="y2", hovertemplate=told + "°<extra></extra>"))
    levels = _range(np.concatenate(sizes), FLOOR, 6.0)
    arrows, reached = _phase_arrows(study)
    angles = _range(np.concatenate([*phases, reached]), DEEPEST, 25.0)
    notes = _landmarks(study, span) + _gain_arrows(study, span) + arrows
    fig = {"data": traces, "layout": _layout(study, span, levels, angles, notes)}
    narrow = {**style.NARROW, "xaxis2.title.text": "Hz", "yaxis.title.text": "|L| [dB]", "yaxis2.title.text": "arg L [°]"}
    narrow |= style.decades("xaxis", *span) | style.decades("xaxis2", *span, scale=2 * math.pi)
    return figure(fig, _title(shown), _caption(study, shown), 640, narrow)


def _range(values: Floats, least: float, room: float) -> list[float]:
    """An axis that shows `values` from `least` up, with some room on either side."""
    return [max(float(values.min()) - room, least), float(values.max()) + room]


def _layout(study: JointStudy, span: tuple[float, float], levels: list[float], angles: list[float], notes: list[style.Annotation]) -> dict:
    top = {"side": "top", "anchor": "y", "matches": "x", "showgrid": False}
    return style.layout(
        xaxis=style.log_axis("frequency [rad/s]", *span, anchor="y2", domain=[0, 1]),
        xaxis2=style.log_axis("frequency [Hz]", *span, scale=2 * math.pi, **top),
        yaxis=style.axis("magnitude |L| [dB]", domain=[0.47, 1], range=levels, dtick=20, anchor="x2"),
        yaxis2=style.axis("phase arg L [°]", domain=[0, 0.44], range=angles, dtick=90),
        showlegend=True,
        legend=style.switches(1.13),
        annotations=notes,
        shapes=_rules(study, angles),
        margin={"l": 78, "r": 24, "t": 96, "b": 52},
    )


def frequency_span(study: JointStudy, shown: list[Case]) -> tuple[float, float]:
    """From well below the first crossover to well above the last landmark, to the Nyquist frequency in sampled time."""
    joint, drive = study.spec.joint, study.spec.drive
    marks = [joint.resonance, joint.antiresonance, drive.bandwidth]
    for case in shown:
        marks += [c.omega for c in case.margins.gain_crossings] + [case.margins.phase_crossover]
    known = [w for w in marks if math.isfinite(w) and w > 0] or [1.0]
    low, high = 0.2 * min(known), 2.5 * max(known)
    if study.spec.sample_time is not None:
        high = math.pi / study.spec.sample_time
    return max(low, 1e-5 * high), high


def grid(loop: Loop, low: float, high: float, study: JointStudy) -> Floats:
    """Frequencies [rad/s] that resolve the resonances as well as the rest."""
    parts = [np.geomspace(low, high, round(PER_DECADE * math.log10(high / low)))]
    joint = study.spec.joint
    for center in (joint.resonance, joint.antiresonance):
        if math.isfinite(center) and loop.parts is not None and np.isfinite(loop.parts.plant.stiffness[0]):
            parts.append(center * (1 + 0.3 * np.linspace(-1, 1, 81) ** 3))
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= low) & (omega <= high)]


def unwrapped(loop: Loop, value: Complexes) -> Floats:
    """arg L [°] along the grid, continuous, beginning between −360° and 0°."""
    phase = np.degrees(np.unwrap(np.angle(value)))
    return phase - 360 * math.ceil((phase[0] - 1) / 360)


def _phase_at(loop: Loop, omega: float, study: JointStudy) -> float:
    """Continuous arg L [°] at one frequency."""
    low = min(0.2 * omega, 0.2 * min((c.omega for c in study.margins.gain_crossings), default=omega))
    points = np.append(grid(loop, low, omega, study), omega)
    return float(unwrapped(loop, loop.response(points))[-1])


def _gain_arrows(study: JointStudy, span: tuple[float, float]) -> list[style.Annotation]:
    """Every phase crossover with its gain margin as an arrow; the smallest is written out."""
    found, notes = study.margins, []
    shown = [c for c in found.phase_crossings if c.omega > 0 and 0 < c.gain < 1e3]
    closest = min(shown, key=lambda c: abs(decibels(c.gain)), default=None)
    for crossing in shown:
        x, level = math.log10(crossing.omega), -decibels(crossing.gain)
        notes.append(style.arrow((x, level), (x, 0.0), style.VERMILION))
        if crossing is closest:
            side = "right" if math.log(crossing.omega / span[0]) > 0.72 * math.log(span[1] / span[0]) else "left"
            word = "gain margin" if found.stable else "too high by" if crossing.gain < 1 else "left"
            text = f"{word} {digits(abs(decibels(crossing.gain)), 'dB', 3)}<br>at {_both(crossing.omega)}"
            short = digits(abs(decibels(crossing.gain)), "dB", 3)
            for words, width in ((text, "wide"), (short, "narrow")):
                notes.append(
                    style.label(
                        x, max(level, 0.0), words, style.VERMILION, xanchor=side, yanchor="bottom", yshift=3, align=side, name=width
                    )
                )
    return notes


def _phase_arrows(study: JointStudy) -> tuple[list[style.Annotation], list[float]]:
    """Every gain crossover with its phase margin as an arrow, the smallest written out; and the phases that the arrows reach."""
    found, notes, reached = study.margins, [], []
    closest = min(found.gain_crossings, key=lambda c: abs(c.phase_margin), default=None)
    for crossing in found.gain_crossings:
        x, phase = math.log10(crossing.omega), _phase_at(study.loop, crossing.omega, study)
        line = phase - math.degrees(crossing.phase_margin)  # −180° or whole turns from it
        if min(phase, line) < DEEPEST:
            continue
        reached += [phase, line]
        notes.append(style.arrow((x, line), (x, phase), style.BLUE, yref="y2", ayref="y2"))
        if crossing is closest:
            text = f"phase margin {digits(math.degrees(crossing.phase_margin), '°', 3)}<br>at {_both(crossing.omega)}"
            place = {"yref": "y2", "xanchor": "right", "yanchor": "top", "xshift": 30, "yshift": -6, "align": "right"}
            notes.append(style.label(x, min(line, phase), text, style.BLUE, **place))
    return notes, reached


def _both(omega: float) -> str:
    return f"{digits(omega, 'rad/s', 3)} ({hertz(omega)})"


def _landmarks(study: JointStudy, span: tuple[float, float]) -> list[style.Annotation]:
    """Resonance and anti-resonance named at the foot of the magnitude, the current loop and half the sample rate at its top."""
    joint, drive, step = study.spec.joint, study.spec.drive, study.spec.sample_time
    named = [("anti-resonance", joint.antiresonance, 0.475), ("resonance", joint.resonance, 0.51)]
    named.append(("ω<sub>c</sub>", drive.bandwidth, 0.955))
    if step is not None:
        named.append(("half the sample rate", math.pi / step, 0.92))
    quiet = {"yref": "paper", "yanchor": "bottom", "font": {"size": 12, "color": style.SOFT}}
    return [
        style.label(
            math.log10(omega),
            height,
            f"{name} {digits(omega, 'rad/s', 3)}",
            name="" if height < 0.9 else "wide",
            xanchor="right" if math.log(omega / span[0]) > 0.6 * math.log(span[1] / span[0]) else "left",
            **quiet,
        )
        for name, omega, height in named
        if span[0] < omega <= span[1]
    ]


def _rules(study: JointStudy, angles: list[float]) -> list[dict]:
    """0 dB, −180° and its repeats, and the landmarks."""
    flat = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "line": {"color": "#777", "width": 1.2}, "layer": "below"}
    shapes = [flat | {"y0": 0, "y1": 0}]
    shapes += [flat | {"yref": "y2", "y0": y, "y1": y} for y in (180, -180, -540) if angles[0] < y < angles[1]]
    joint, drive = study.spec.joint, study.spec.drive
    dotted = {"color": "#bbb", "width": 1, "dash": "dot"}
    upright = {"type": "line", "yref": "paper", "y0": 0, "y1": 1, "line": dotted, "layer": "below"}
    marked = [omega for omega in (joint.antiresonance, joint.resonance, drive.bandwidth) if math.isfinite(omega)]
    return shapes + [upright | {"x0": omega, "x1": omega} for omega in marked]


def _title(shown: list[Case]) -> str:
    if len(shown) == 4:
        return "Open loop: what elasticity and delay each take away"
    return "Open loop" + (f", with and {shown[1].name}" if len(shown) == 2 else "")


def _caption(study: JointStudy, shown: list[Case]) -> str:
    told = []
    for case in shown:
        found = case.margins
        room = digits(decibels(found.gain_margin), "dB", 3) if found.stable else "unstable"
        place = f" at {digits(found.phase_crossover, 'rad/s', 3)}" if math.isfinite(found.phase_crossover) else ""
        told.append(f"{case.name}: {room}{place}")
    text = f"Gain margins: {'; '.join(told)}. "
    if study.spec.drive.delay > 0:
        text += "The delay leaves the magnitude as it is and turns the phase by −ωT. "
    if any(case.name == "without elasticity" for case in shown):
        text += "Elasticity lifts the magnitude above the resonance. "
    return text + ("Click a name above the picture to switch its line." if len(shown) > 1 else "")
