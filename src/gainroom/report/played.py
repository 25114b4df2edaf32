"""What the pages of a played scenario share, one joint's and a whole robot's: how the answer looks, its cards, curves over time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..analysis.gain_limit import GainLimit
from ..linear.arrays import Floats, Integers
from ..simulation.oscillation import Vibration
from . import style
from .number_format import digits, frequency, gain_factor, hertz, milli
from .page import Card, Html, Lead, figure

MOST_POINTS = 2400  # of a curve
CLOSE_PERIODS = 12  # of the vibration in its own picture
RUNAWAY = 3.0  # times the reference's range: what a run that diverges is shown up to
LEAST_RANGE = 0.01  # [rad, m] of a reference that hardly moves
MARGINS = {"l": 78, "r": 24, "t": 8, "b": 52}  # [px]
GAP, LEGEND_LINE = 14, 21  # [px] between panels, and what a line of a legend takes
WIDE, PHONE = 920, 300  # [px] that a legend has
LETTER, KEY = 7.0, 46  # [px] of a legend's entry: about that much per letter, and the line before it


@dataclass(frozen=True)
class Curve:
    """A signal (k,) over time; `named`: it stands in its panel's legend."""

    name: str
    values: Floats
    color: str
    dash: str = "solid"
    named: bool = True


@dataclass(frozen=True)
class Panel:
    """Curves in one pair of axes: what they are and in which unit, and the share of the picture's height that they take."""

    title: str
    unit: str
    curves: Sequence[Curve]
    share: float


def lead(sentence: str, verdict: str, warnings: Sequence[str], what: str = "these gains") -> Lead:
    """The answer; `verdict`, in capitals, makes it look bad, and says not to run `what`."""
    return Lead(sentence, "bad", f"{verdict}: do not run {what}", warnings) if verdict else Lead(sentence, "good", "", warnings)


def error_cards(peak: float, rms: float, steady: float, unit: str, whose: str = "", floor: float = 1e-9) -> list[Card]:
    """Of the tracking error [rad, m], shown in thousandths, 0 below `floor`; `whose` ends the notes."""
    told = (("largest", peak, "over the whole run"), ("RMS", rms, "over the whole run"), ("steady-state", steady, "mean of the last tenth"))
    return [Card(f"{name} error", milli(value, floor).lstrip("−"), unit, note=note + whose) for name, value, note in told]


def vibration_card(found: Vibration | None, vibrates: bool, limit: GainLimit | None) -> Card:
    """What was heard, beside what the linear loop predicts."""
    seen = ("none", "") if found is None else (digits(found.frequency / (2 * math.pi), "", 3), "Hz")
    note = ""
    if limit is not None and 0 < limit.gain < math.inf:
        note = f"linear limit: {gain_factor(limit.gain, 3)} × these gains, {hertz(limit.frequency)}"
    return Card("vibration", *seen, requirement="none may last", met=not vibrates, note=note)


def shown_ticks(reference: Floats, error: Floats) -> int:
    """Of a run that diverges, (k, n) each, how many ticks are worth a picture: those until it is far out of it."""
    covered = np.vstack([reference[:1] - error[:1], reference])  # from where it starts: a step at t = 0 alone is a constant
    room = RUNAWAY * max(float(np.ptp(covered, axis=0).max()), LEAST_RANGE)
    far = np.abs(error).max(axis=1) > room
    return max(2, min(len(far), int(np.argmax(far)) + 1)) if far.any() else len(far)


def close_up(found: Vibration, sample_time: float, end: int) -> slice:
    """The ticks before `end` that hold the last periods of a vibration."""
    ticks = max(24, math.ceil(CLOSE_PERIODS * 2 * math.pi / found.frequency / sample_time))
    return slice(max(0, end - ticks), end)


def close_up_words(found: Vibration, limit: GainLimit | None) -> tuple[str, str]:
    """Title and caption of a vibration's own picture."""
    title = f"The last {CLOSE_PERIODS} periods of the picture above: {frequency(found.frequency)}"
    caption = f"One period is {digits(2e3 * math.pi / found.frequency, 'ms', 3)}."
    if limit is not None and 0 < limit.gain < math.inf:
        caption += f" The linear loop predicts {hertz(limit.frequency)} where vibration begins; "
        caption += "above the limit the frequency rises with the gains."
    return title, caption


def vibration_note(found: Vibration) -> style.Annotation:
    """Its frequency, at the top of a picture."""
    words = f"<b>vibrates at {hertz(found.frequency)}</b> ({digits(found.frequency, 'rad/s')})"
    return style.label(0.01, 0.995, words, style.VERMILION, xref="x domain", yref="y domain", xanchor="left", yanchor="top")


def stacked(
    time: Floats,
    panels: Sequence[Panel],
    title: str,
    caption: str,
    height: int,
    notes: Sequence[style.Annotation] = (),
    most: int = MOST_POINTS,
) -> Html:
    """Panels under each other over one time axis, `height` [px] in all, each under its own legend; `most` points per curve."""
    traces, legends, axes = [], {}, {}
    for index, panel in enumerate(panels):
        number = "" if index == 0 else str(index + 1)
        axes[f"yaxis{number}"] = style.axis(f"{panel.title} [{panel.unit}]")
        for curve in panel.curves:
            keep = thinned(curve.values, most)
            look = {"dash": curve.dash, "width": 1.8, "name": style.shown(curve.name), "hoverinfo": "x+y+name"}
            place = {"yaxis": f"y{number}", "legend": f"legend{number}", "showlegend": curve.named}
            traces.append(style.line(time[keep], curve.values[keep], curve.color, **look, **place))
    wide, phone = (_domains(panels, height - MARGINS["t"] - MARGINS["b"], width) for width in (WIDE, PHONE))
    narrow: dict[str, Any] = dict(style.NARROW)
    for index, (panel, domain, small) in enumerate(zip(panels, wide, phone, strict=True)):
        number = "" if index == 0 else str(index + 1)
        axes[f"yaxis{number}"]["domain"] = domain
        legends[f"legend{number}"] = style.switches(domain[1])
        narrow |= {f"yaxis{number}.title.text": f"[{panel.unit}]", f"yaxis{number}.domain": small, f"legend{number}.y": small[1]}
    layout = style.layout(
        xaxis=style.axis("time [s]", anchor=f"y{len(panels) if len(panels) > 1 else ''}", range=[float(time[0]), float(time[-1])]),
        **axes,
        **legends,
        annotations=list(notes),
        showlegend=True,
        margin=MARGINS,
    )
    return figure({"data": traces, "layout": layout}, title, caption, height, narrow)


def _domains(panels: Sequence[Panel], height: float, width: float) -> list[list[float]]:
    """Where each panel is, from the bottom 0 to the top 1 of `height` [px], with room for its legend of `width` [px] above it."""
    above = [LEGEND_LINE * _legend_lines(panel, width) + (GAP if index else 0) for index, panel in enumerate(panels)]
    left = height - sum(above)
    shares = [panel.share / sum(panel.share for panel in panels) for panel in panels]
    domains, top = [], height
    for room, share in zip(above, shares, strict=True):
        top -= room
        domains.append([max(0.0, (top - share * left) / height), top / height])
        top -= share * left
    return domains


def _legend_lines(panel: Panel, width: float) -> int:
    """How often it wraps. Plotly gives all entries of a legend the room of the longest."""
    names = [curve.name for curve in panel.curves if curve.named]
    if not names:
        return 0
    longest = KEY + LETTER * min(style.LONGEST, max(map(len, names)))
    return math.ceil(len(names) / max(1, int(width // longest)))


def thinned(values: Floats, most: int = MOST_POINTS) -> Integers:
    """Places in `values` (k,), in order, that draw the same picture: all, or the lowest and the highest of every stretch."""
    count = len(values)
    if count <= most:
        return np.arange(count)
    edges = np.linspace(0, count, most // 2 + 1).astype(int)
    picked = [0, count - 1]
    for begin, end in pairwise(edges.tolist()):
        part = values[begin:end]
        picked += [begin + int(np.argmin(part)), begin + int(np.argmax(part))]
    return np.unique(picked)
