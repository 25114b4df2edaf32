"""Page of a diagnosis: answer, advice, signals over time, spectrogram, spectrum with harmonics, evidence."""

import math
from collections.abc import Sequence

import numpy as np

from ..identification.recorded_oscillation import POSITIONS, TORQUES
from ..studies.diagnosis import Diagnosis
from ..studies.vibration_causes import Cause
from ..system.linear.arrays import Floats
from ..system.margin_units import to_db
from . import style
from .curves import Curve, Panel, stacked
from .diagnosis_text import (
    NAMES,
    SHORT,
    DiagnosisPresentation,
    advice,
    evidence_text,
    growth,
    percent,
    ranked,
    sentence,
    size,
    strength,
    warnings,
)
from .number_format import digits, frequency, hertz, motion_unit
from .page import Card, Html, Lead, Section, details, facts, figure, page, paragraph, table

CLOSE_PERIODS = 8  # periods of the vibration in the enlarged figure
COLUMNS, LINES = 160, 160  # of the spectrogram, at most
FLOOR = 60.0  # [dB] below the largest: black
ORDERS = 6  # harmonics that are marked
SPECTRUM_POINTS = 1500
HIGHEST = 6.0  # times the vibration's frequency, or the predicted one: pictures end there
PERIODS_IN_WINDOW = 8.0
ASSUMPTIONS = (
    "A vibration grows, is sustained, or rings with a damping ratio below 0.02. Likelihoods compare the causes listed, as if one alone "
    "were at work, and one that is none of them; weights are rounded and were chosen on virtual recordings."
)


def diagnosis_page(shown: DiagnosisPresentation, command: str) -> str:
    """HTML page of a diagnosis; `command`: the command that makes it."""
    found, texts = shown.found, advice(shown.found)
    sections = [
        Section("What to do", texts) if texts else None,
        Section("Why", [_causes(found)]) if found.causes else None,
        Section("Over time", [_in_time(found), *([_close_up(found)] if found.oscillation is not None else [])]),
        Section("Frequencies", [_spectrogram(found), _spectrum(found)]),
        Section("Inputs and assumptions", [facts(_inputs(found, shown.log)), ASSUMPTIONS]),
    ]
    return page("gainroom diagnose: a joint's recording", _lead(found), _cards(found), sections, command)


def _lead(found: Diagnosis) -> Lead:
    if found.ran_away and not found.vibrates:
        return Lead(sentence(found), "bad", "RUNS AWAY", warnings(found))
    if not found.vibrates:
        return Lead(sentence(found), "good", "", warnings(found))
    return Lead(sentence(found), "bad", "VIBRATES" if found.cause is not None else "VIBRATES: cause not known", warnings(found))


def _cards(found: Diagnosis) -> list[Card]:
    seen, predicted = found.oscillation, found.predicted
    cards = []
    if seen is not None and not found.toggles:
        note = "" if predicted is None or not predicted.frequency > 0 else f"model's loop: {hertz(predicted.frequency)}"
        label, allowed, met = ("vibrates at", "none allowed", False) if found.vibrates else ("oscillation that decays", "", None)
        cards.append(Card(label, digits(seen.vibration.frequency / (2 * math.pi), "", 3), "Hz", allowed, met, note))
        steps = f"{digits(seen.steps, '', 3)} encoder steps" if math.isfinite(seen.steps) else ""
        value, unit = size(seen).rsplit(" ", 1)
        cards.append(Card("amplitude at the end", value, unit, note="; ".join(filter(None, [growth(seen), steps]))))
    if found.causes:
        first = found.cause
        note = "" if first is None else percent(first)
        cards.append(Card("cause", "not known" if first is None else SHORT[first.name], note=note))
    if predicted is not None and math.isfinite(predicted.limit.gain):
        met = predicted.limit.stable and predicted.limit.gain >= found.required
        asked = f"≥ {digits(to_db(found.required), 'dB', 3)}"
        cards.append(
            Card(
                "gain margin by the model",
                digits(to_db(predicted.limit.gain), "", 3),
                "dB",
                asked,
                met,
                f"at {hertz(predicted.limit.frequency)}",
            )
        )
    return cards


def _causes(found: Diagnosis) -> Html:
    likely, every = ranked(found, everything=False), ranked(found)
    words = paragraph(
        "What speaks for (+) and against (−) each cause: each + makes it about three times as likely, each − a third as likely."
    )
    others = [one for one in every if one not in likely]
    hidden = details("Unlikely causes, and what speaks against them", *map(_evidence, others)) if others else ""
    return Html("".join([*map(_evidence, likely), words, hidden]))


def _evidence(cause: Cause) -> Html:
    strongest = sorted(cause.evidence, key=lambda one: -abs(one.weight))
    lines = [(evidence_text(one), strength(one)) for one in strongest] or [("nothing in the log speaks for or against it", "")]
    return table((f"{NAMES[cause.name]}: {percent(cause)}", "for, against"), lines, sorts=False)


def _panels(found: Diagnosis, part: slice, torque_names: Sequence[str]) -> list[Panel]:
    """Panels of position with set-point, and torques, over the rows `part`."""
    channels = found.record.channels
    side = next((name for name in POSITIONS if name in channels), None)
    panels = []
    if side is not None:
        values = channels[side][part]
        scale, unit = motion_unit(float(np.ptp(values)))
        curves = [Curve(side.replace("_", " "), scale * (values - values[0]), style.BLUE)]
        if "reference" in channels:
            curves.append(Curve("set-point", scale * (channels["reference"][part] - values[0]), style.VERMILION, "dash"))
        panels.append(Panel("position", unit, curves, 0.5))
    looks = ((style.ORANGE, "dash"), (style.DARK[style.PURPLE], "dot"), (style.BLACK, "solid"))
    torques = [
        Curve(name.replace("_", " "), channels[name][part], *look)
        for name, look in zip(TORQUES, looks, strict=True)
        if name in torque_names
    ]
    if torques:
        panels.append(Panel("torque", "N·m", torques, 0.5))
    if not panels:
        side = next(iter(channels))
        panels.append(
            Panel(side.replace("_", " "), "rad/s" if "velocity" in side else "", [Curve(side, channels[side][part], style.BLUE)], 1.0)
        )
    return panels


def _in_time(found: Diagnosis) -> Html:
    time, seen = found.record.time, found.oscillation
    there = [name for name in TORQUES if name in found.record.channels]  # a target alone may be far beyond what is applied
    caption = "The recording; position relative to its start."
    if seen is not None:
        caption += f" The oscillation was found from {digits(time[seen.rows][0], 's', 3)} to {digits(time[seen.rows][-1], 's', 3)}."
    return stacked(time, _panels(found, slice(None), there[-1:]), "Position and torque", caption, 460)


def _close_up(found: Diagnosis) -> Html:
    seen = found.oscillation
    assert seen is not None
    rows_ = range(len(found.record.time))[seen.rows]
    count = min(len(rows_), max(16, math.ceil(CLOSE_PERIODS * 2 * math.pi / seen.vibration.frequency / found.record.sample_time)))
    part = slice(rows_[-1] + 1 - count, rows_[-1] + 1)
    words = [f"The last {CLOSE_PERIODS} periods at {hertz(seen.vibration.frequency)}."]
    if seen.clipped == seen.clipped:
        words.append(f"The torque is at a limit {100 * seen.clipped:.0f} % of the time.")
    if seen.standing == seen.standing:
        words.append(f"The joint stands still {100 * seen.standing:.0f} % of the time.")
    if seen.step:
        words.append(f"An encoder's step is {digits(1e3 * seen.step, 'mrad', 3)}.")
    return stacked(
        found.record.time[part],
        _panels(found, part, [name for name in TORQUES if name in found.record.channels]),
        "The oscillation enlarged",
        " ".join(words),
        460,
    )


def _signal(found: Diagnosis) -> tuple[str, Floats]:
    """Title and values of the examined signal: the deviation from the set-point, otherwise an available channel."""
    channels = found.record.channels
    side = (
        found.oscillation.side
        if found.oscillation is not None
        else next((name for name in (*POSITIONS, *TORQUES) if name in channels), next(iter(channels)))
    )
    values = channels[side]
    if side in POSITIONS and "reference" in channels:
        return "position minus set-point", values - channels["reference"]
    return side.replace("_", " "), values


def _highest(found: Diagnosis) -> float:
    """Highest frequency in the figures [Hz]."""
    nyquist = 0.5 / found.record.sample_time
    marks = [omega for omega in (_seen(found), _expected(found)) if omega > 0]
    return min(nyquist, HIGHEST * max(marks) / (2 * math.pi)) if marks else nyquist


def _seen(found: Diagnosis) -> float:
    return found.oscillation.vibration.frequency if found.oscillation is not None else math.nan


def _expected(found: Diagnosis) -> float:
    return found.predicted.frequency if found.predicted is not None else math.nan


def _spectrogram(found: Diagnosis) -> Html:
    from scipy.signal import spectrogram

    name, values = _signal(found)
    tick, high = found.record.sample_time, _highest(found)
    period = 2 * math.pi / _seen(found) if found.oscillation is not None else 2e2 / high
    width = int(min(max(32, PERIODS_IN_WINDOW * period / tick), max(32, len(values) // 4)))
    step = max(1, (len(values) - width) // COLUMNS)
    lines, times, power = spectrogram(
        values, 1 / tick, nperseg=width, noverlap=max(0, width - step), nfft=max(256, 2 * width), detrend="linear"
    )
    keep = lines <= high
    every = max(1, int(np.count_nonzero(keep)) // LINES)
    lines, power = lines[keep][::every], power[keep][: (np.count_nonzero(keep) // every) * every or None]
    power = power[: len(lines) * every].reshape(-1, every, power.shape[1]).max(axis=1) if every > 1 else power
    lines = lines[: len(power)]
    level = 10 * np.log10(np.maximum(power, 1e-300))
    level -= level.max()
    heat = {
        "type": "heatmap",
        "x": found.record.time[0] + times,
        "y": lines,
        "z": np.round(np.maximum(level, -FLOOR), 1),
        "colorscale": "Cividis",
        "zmin": -FLOOR,
        "zmax": 0,
        "colorbar": {"title": {"text": "dB"}, "thickness": 12, "len": 1.0},
        "hovertemplate": "%{x:.3g} s, %{y:.3g} Hz: %{z:.0f} dB<extra></extra>",
    }
    ends = [float(found.record.time[0]), float(found.record.time[-1])]
    traces = [heat]
    looks = (("found", _seen(found), "#ffffff", "solid"), ("predicted by the model", _expected(found), style.ORANGE, "dash"))
    traces += [
        style.line(ends, [omega / (2 * math.pi)] * 2, color, dash=dash, width=2, name=title, showlegend=True)
        for title, omega, color, dash in looks
        if omega > 0
    ]
    layout = style.layout(
        xaxis=style.axis("time [s]", range=ends),
        yaxis=style.axis("frequency [Hz]", range=[0, high]),
        showlegend=True,
        legend=style.switches(1.0, bgcolor="#dddddd"),
        margin={"l": 72, "r": 16, "t": 30, "b": 52},
    )
    words, stable = f"Power of {name} in dB below its largest.", found.predicted is not None and found.predicted.limit.stable
    if _expected(found) > 0:
        words += f" The loop of the file {'would begin to vibrate' if stable else 'vibrates'} at {frequency(_expected(found), 3)}."
    return figure({"data": traces, "layout": layout}, "Spectrogram", words, 420, {**style.NARROW, "margin.r": 4})


def _spectrum(found: Diagnosis) -> Html:
    name, values = _signal(found)
    part = values if found.oscillation is None else values[found.oscillation.rows]
    curves = [(name, part, style.BLUE, "solid")]
    torque = next((one for one in TORQUES[::-1] if one in found.record.channels), None)
    if torque is not None and not name.endswith("torque"):
        column = found.record.channels[torque]
        curves.append(
            (torque.replace("_", " "), column if found.oscillation is None else column[found.oscillation.rows], style.ORANGE, "dash")
        )
    high, traces = _highest(found), []
    for title, column, color, dash in curves:
        lines, sizes = _amplitudes(column, found.record.sample_time, high)
        traces.append(
            style.line(
                lines, 20 * np.log10(np.maximum(sizes / sizes.max(), 1e-6)), color, dash=dash, width=1.6, name=title, showlegend=True
            )
        )
    shapes, notes = [], []
    if found.oscillation is not None:
        first = _seen(found) / (2 * math.pi)
        for order in range(1, ORDERS + 1):
            if order * first < high:
                shapes.append(style.upright(order * first, style.INK if order == 1 else style.SOFT, "solid" if order == 1 else "dot"))
                text = f"<b>{digits(first, 'Hz', 3)}</b>" if order == 1 else f"{order}×"
                notes.append(style.label(order * first, 1.0, text, yref="paper", yanchor="top"))
    if _expected(found) > 0 and _expected(found) / (2 * math.pi) < high:
        shapes.append(style.upright(_expected(found) / (2 * math.pi), style.VERMILION, "dash", 2))
        notes.append(
            style.label(_expected(found) / (2 * math.pi), 0.06, "model", style.VERMILION, yref="paper", yanchor="bottom", xanchor="left")
        )
    layout = style.layout(
        xaxis=style.axis("frequency [Hz]", range=[0, high]),
        yaxis=style.axis("amplitude [dB of the largest]", range=[-90, 6]),
        shapes=shapes,
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.0),
    )
    words = "Amplitudes where the oscillation was found." if found.oscillation is not None else "Amplitudes over the recording."
    if found.oscillation is not None and found.oscillation.odd == found.oscillation.odd:
        odd, even = (digits(100 * value, "%", 2) for value in (found.oscillation.odd, found.oscillation.even))
        words += f" Harmonics of the torque: odd {odd}, even {even} of the first."
        words += " Clipping and friction make odd ones; a linear loop or a structure makes none."
    narrow = {**style.NARROW, "yaxis.title.text": "[dB]"}
    return figure({"data": traces, "layout": layout}, "Spectrum with harmonics", words, 400, narrow)


def _amplitudes(values: Floats, tick: float, high: float) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and amplitudes of `values` (k,) without trend, the largest of every stretch."""
    from scipy.signal import detrend

    rest = detrend(values)
    sizes = np.abs(np.fft.rfft(rest * np.hanning(len(rest))))
    lines = np.fft.rfftfreq(len(rest), tick)
    sizes, lines = sizes[lines <= high], lines[lines <= high]
    every = max(1, len(sizes) // SPECTRUM_POINTS)
    count = len(sizes) // every * every
    return lines[:count:every], np.maximum(sizes[:count].reshape(-1, every).max(axis=1), 1e-300)


def _inputs(found: Diagnosis, log: str) -> list[tuple[str, str]]:
    record, predicted = found.record, found.predicted
    pairs = [
        ("log", log),
        ("rows", f"{digits(len(record.time), '', 6)} at {digits(1 / record.sample_time, 'Hz')}: the longest part without a gap"),
        ("channels", ", ".join(record.channels)),
    ]
    if predicted is not None:
        pairs.append(
            ("model", f"gain limit {digits(predicted.limit.gain, '', 3)} × the gains in the log, at {frequency(predicted.limit.frequency)}")
        )
        if predicted.growth == predicted.growth:
            pairs.append(("its vibration", f"{frequency(predicted.frequency)}, growing at {digits(predicted.growth, '1/s', 3)}"))
    else:
        pairs.append(("model", "none: --joint joint.yaml was not given"))
    return pairs
