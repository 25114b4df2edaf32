"""The Nyquist picture around the critical point: how near the loop comes, and at which frequencies."""

import math

import numpy as np

from ..studies.joint import JointStudy
from ..system.linear.arrays import Complexes, Floats
from . import style
from .bode import Case, frequency_span, grid
from .number_format import digits, frequency
from .page import Html, figure

WINDOW = ((-3.2, 1.6), (-2.4, 2.4))  # real, imaginary


def nyquist(study: JointStudy, shown: list[Case]) -> Html:
    """L(jω) near −1, with the disk about −1 that the disk margin excludes."""
    low, high = frequency_span(study, shown)
    omega = grid(study.loop, 0.05 * low, high if study.system.control.sample_time is not None else 4 * high)
    value = study.loop.response(omega)
    text = [frequency(w) for w in omega]
    near: Complexes = np.where(np.abs(value) < 60, value, np.nan)  # what runs off to infinity is far outside the picture
    traces = [
        *_disk(study),
        style.line(near.real, -near.imag, style.SOFT, dash="dot", width=1.2),
        style.line(near.real, near.imag, style.BLACK, width=2.6, hoverinfo="text", text=text),
        style.markers([-1], [0], "x", style.VERMILION, 13),
    ]
    beads, notes = _beads(omega, value)
    notes.append(style.label(-1, 0, "−1", style.VERMILION, xanchor="right", yanchor="top", xshift=-6, yshift=-4))
    rows = {"scaleanchor": "x", "range": list(WINDOW[1]), "zeroline": True, "zerolinecolor": "#bbb", "dtick": 1}
    picture = style.layout(
        xaxis=style.axis("Re L", range=list(WINDOW[0]), zeroline=True, zerolinecolor="#bbb", constrain="domain", dtick=1),
        yaxis=style.axis("Im L", **rows),
        annotations=notes,
    )
    return figure(
        {"data": [*traces, beads], "layout": picture}, "Nyquist curve near the critical point", _caption(study), 520, style.NARROW
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
    return [style.line(x, y, style.BLUE, dash="dash", width=1.6, fill="toself", fillcolor="rgba(86,180,233,0.25)", hoveron="fills")]


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
    return style.markers(xs, ys, "circle", style.BLACK, 8), notes


def _caption(study: JointStudy) -> str:
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
