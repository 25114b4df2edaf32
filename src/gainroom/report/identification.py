"""Pages of `gainroom identify`: answer with interval, figures, numbers, and recordings advised."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..identification import Estimate, GainsFit, JointFit, Record, StiffnessFit, TorqueDelay
from ..identification.gains import predicted_torque
from ..identification.residuals import MOST_EXPLAINED, MOST_LEFT
from ..system.linear.arrays import Floats
from . import style
from .curves import Curve, Panel, stacked, thinned
from .estimate_columns import TITLES, Answer, interval_text, warranted_digits
from .identified_text import ASKED_TITLES, asked_rows
from .number_format import digits, hertz
from .page import Card, Html, Lead, Section, figure, page, table

WIDE = 0.03  # relative half-width from which on an inertia or a stiffness is worth another log
WIDE_TICKS = 0.1
REMEDIES = {
    "motor_inertia": "more torque above the resonance, up to a fifth of the tick rate",
    "inertia": "more torque, and less friction beside it",
    "link_inertia": "more torque around the antiresonance, or a link position",
    "stiffness": "more torque around the resonance",
    "delay": "target_torque and actual_torque with steps, or a multisine up to a tenth of the tick rate",
}
BEFORE, AFTER = 2.0, 8.0  # delays and current loops shown before and after the change
LEAST_WINDOW = 12  # ticks
BARS = 25  # most bars of a jitter's distribution
NORMAL = 1.96  # standard errors of a 95 % band
MOST_BEYOND = 1.5  # decades that the fitted response is shown beyond the measured one


def delay_page(found: TorqueDelay, record: Record, answer: Answer, command: str) -> str:
    """HTML page of `identify delay` from torques."""
    cards = [
        _card("delay", found.delay.scaled(1e3), "ms"),
        _card("in ticks", found.ticks, f"of {digits(1e3 * found.sample_time, 'ms')}"),
        _card("current loop ω_c", found.bandwidth, "rad/s"),
        _card("delay + lag", None if found.lag is None else found.lag.scaled(1e3), "ms"),
    ]
    return _page("delay", answer, "warn" if found.confounded else "good", cards, _torques(found, record), delay_advice(found), command)


def _torques(found: TorqueDelay, record: Record) -> list[Section | None]:
    return [Section("Torques", [torques(found, record)]), Section("Jitter", [jitter(found)]) if len(found.jitter.ticks) else None]


def setpoint_delay_page(answer: Answer, command: str) -> str:
    """HTML page of `identify delay` from set-point and position: numbers alone."""
    return _page("delay", answer, "warn" if answer.warnings else "good", [], [], [], command)


def joint_page(fit: JointFit, record: Record, answer: Answer, command: str) -> str:
    """HTML page of `identify joint`."""
    found, delay = fit.parameters, fit.parameters.get("delay")
    cards = [
        _card("stiffness K", found.get("stiffness"), "N·m/rad"),
        _card("motor inertia J_M", found.get("motor_inertia", found.get("inertia")), "kg·m²"),
        _card("link inertia J_L", found.get("link_inertia"), "kg·m²"),
        _card("delay", None if delay is None else delay.scaled(1e3), "ms"),
        Card("model", "adequate" if fit.adequate else "not adequate", met=fit.adequate, note=fit.model),
    ]
    sections = [
        Section("Measured and fitted", [frequency_response(fit)]),
        Section("What the model leaves", [autocorrelation(fit)]),
        *([] if fit.delay is None else _torques(fit.delay, record)),
    ]
    return _page("joint", answer, "good" if fit.adequate and not fit.warnings else "warn", cards, sections, joint_advice(fit), command)


def stiffness_page(fit: StiffnessFit, answer: Answer, command: str) -> str:
    """HTML page of `identify stiffness`."""
    cards = [
        _card("stiffness K", fit.stiffness, "N·m/rad"),
        _card("friction", fit.friction, "N·m"),
        _card("hysteresis", fit.hysteresis.scaled(1e3), "mrad"),
        _card("hardening", fit.hardening.scaled(100.0), "%"),
    ]
    sections = [Section("Torque and deflection", [hysteresis(fit)])]
    return _page("stiffness", answer, "warn" if fit.warnings else "good", cards, sections, stiffness_advice(fit), command)


def gains_page(fit: GainsFit, record: Record, asked: Sequence[tuple[str, float]], answer: Answer, command: str) -> str:
    """HTML page of `identify gains`; `asked`: gains asked for, by name."""
    cards = [
        _card("kp", fit.kp, "N·m/rad"),
        _card("kd", fit.kd, "N·m·s/rad"),
        Card("explained", digits(100 * fit.explained, "", 4), "%", note=f"of {fit.torque}'s power"),
    ]
    sections = [Section("Predicted and logged torque", [predicted(fit, record)])]
    if asked:
        beside = [gains_beside(fit, asked), table(ASKED_TITLES, asked_rows(fit, asked), sorts=False)]
        sections.append(Section("Beside what was asked for", beside))
    state = "warn" if fit.warnings or fit.unit_errors else "good"
    return _page("gains", answer, state, cards, sections, gains_advice(fit), command)


def _page(
    what: str,
    answer: Answer,
    state: str,
    cards: Sequence[Card | None],
    sections: Sequence[Section | None],
    advice: Sequence[str],
    command: str,
) -> str:
    numbers = table(TITLES, answer.rows(), "Intervals contain the true value in 95 of 100 logs.", sorts=False)
    sections = [*sections, Section("What to record next", advice) if advice else None, Section("Parameters", [numbers])]
    lead = Lead(answer.sentence, state, "", answer.warnings)  # type: ignore[arg-type]
    return page(f"gainroom identify {what}", lead, cards, sections, command)


def _card(label: str, estimate: Estimate | None, unit: str) -> Card | None:
    """Card of a value with its interval; None without an estimate."""
    if estimate is None:
        return None
    value = digits(estimate.value, "", warranted_digits(estimate.value, estimate.low, estimate.high))
    return Card(label, value, unit, note=interval_text(estimate.low, estimate.high))


def joint_advice(fit: JointFit) -> list[str]:
    """Advice on the widest interval and its remedy, and on an inadequate model."""
    found = []
    if not fit.adequate:
        found.append(
            "Part of the residual follows the torque: look for a third mass, backlash, a wrong delay or torques of another joint; record a "
            "second log at half the torque: what is linear stays as it is."
        )
    widths = {name: _relative(fit.parameters[name]) for name in REMEDIES if name in fit.parameters}
    if "delay" in widths:  # an error of the delay counts in ticks
        widths["delay"] = fit.parameters["delay"].half_width / fit.sample_time * WIDE / WIDE_TICKS
    widest = max(widths, key=lambda name: widths[name])
    if widths[widest] > WIDE:
        half = _half(fit.parameters[widest])
        found.append(f"The least known is the {widest.replace('_', ' ')}, {half}. Record {REMEDIES[widest]}.")
    if "stiffness" in fit.parameters:
        resonance = hertz(fit.parameters["resonance"].value)
        found.append(f"gainroom identify plan proposes the torque for a sharper log of this joint (resonance {resonance}).")
    return found


def delay_advice(found: TorqueDelay) -> list[str]:
    """Advice on missing channels and excitation."""
    if "actual_torque" not in found.channels:
        return ["Record actual_torque as well: it shows when within a tick a command arrives."]
    if "demand_torque" not in found.channels and found.jitter.deviation > WIDE_TICKS * found.sample_time:
        return ["Record demand_torque as well: it shows the delay of every command."]
    return []


def stiffness_advice(fit: StiffnessFit) -> list[str]:
    """Advice to load the joint further, if K is not well known."""
    if _relative(fit.stiffness) <= WIDE:
        return []
    return [f"The stiffness is known {_half(fit.stiffness)}. Load the joint several times back and forth, further beyond friction."]


def gains_advice(fit: GainsFit) -> list[str]:
    """Advice on motion that determines the less well known gain."""
    found = []
    for name, estimate, remedy in (("kp", fit.kp, "larger set-points"), ("kd", fit.kd, "faster motion, and motor_velocity")):
        if _relative(estimate) > WIDE:
            found.append(f"{name} is known {_half(estimate)}. Record {remedy}.")
    if fit.rate_of_error is None:
        found.append("The set-point hardly moves: whether kd acts on its velocity is not known. Record moving set-points.")
    return found


def _relative(estimate: Estimate) -> float:
    return abs(estimate.half_width / estimate.value) if estimate.value else math.inf


def _half(estimate: Estimate) -> str:
    return f"to ± {digits(100 * _relative(estimate), '%', 2)}"


def torques(found: TorqueDelay, record: Record) -> Html:
    """Figure of target, demand and actual torque about the largest change of the target, with the delay marked."""
    tick, target = record.sample_time, record.channels["target_torque"]
    lag = (found.lag or found.delay).value / tick
    before, after = (max(round(times * max(lag, 1.0)), LEAST_WINDOW // 2) for times in (BEFORE, AFTER))
    changes = np.abs(np.diff(target))
    changes[: min(before, len(changes) // 2)] = changes[len(changes) - min(after, len(changes) // 2) :] = 0.0
    first = int(np.argmax(changes)) + 1
    rows = slice(max(first - before, 0), min(first + after + 1, len(target)))
    time = 1e3 * (record.time[rows] - record.time[first])
    looks = {
        "target_torque": ("target", style.ORANGE, "solid", "hv"),
        "demand_torque": ("demand", style.BLUE, "dash", "hv"),
        "actual_torque": ("actual", style.BLACK, "solid", "linear"),
    }
    traces = []
    for name, (title, color, dash, shape) in looks.items():
        if record.has(name):
            look = {"color": color, "dash": dash, "width": 2.2, "shape": shape}
            traces.append(
                style.line(time, record.channels[name][rows], color, name=title, showlegend=True, hoverinfo="x+y+name") | {"line": look}
            )
    late = 1e3 * found.delay.value
    low, high = sorted((float(target[first - 1]), float(target[first])))
    level = (low + high) / 2
    shapes = [style.upright(0.0, style.SOFT, "dot"), style.upright(late, style.VERMILION, "dash", 1.6)]
    if not found.confounded:
        shapes.append(style.stretch(1e3 * found.delay.low, 1e3 * found.delay.high, style.VERMILION, 0.15))
    words = f"delay at most {digits(1e3 * found.delay.high, 'ms', 3)}" if found.confounded else f"delay {digits(late, 'ms', 3)}"
    notes = [
        style.arrow((0.0, level), (late, level), style.VERMILION),
        style.label(late, 1.0, words, style.VERMILION, yref="paper", xanchor="left", yanchor="bottom", xshift=2),
    ]  # fmt: skip
    layout = style.layout(
        xaxis=style.axis("time after the change of the target [ms]"),
        yaxis=style.axis("torque [N·m]"),
        shapes=shapes,
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.08),
        margin={"l": 78, "r": 24, "t": 64, "b": 52},
    )
    caption = f"The largest change of the target, at {digits(float(record.time[first]), 's')} in the log. "
    caption += "The delay is that of all changes together" + ("; the actual torque follows through the current loop." if found.lag else ".")
    return figure(
        {"data": traces, "layout": layout},
        "Torques, and the delay between them",
        caption,
        420,
        {**style.NARROW, "yaxis.title.text": "[N·m]"},
    )


def jitter(found: TorqueDelay) -> Html:
    """Figure of the distribution of single commands' delays, in ticks."""
    law = found.jitter
    order = np.argsort(-law.probability)[:BARS]
    bars = {
        "type": "bar",
        "x": law.ticks[order],
        "y": 100 * law.probability[order],
        "marker": {"color": style.BLUE},
        "width": 0.8,
        "hovertemplate": "%{x} ticks: %{y:.1f} %<extra></extra>",
    }
    low, high = int(law.ticks[order].min()) - 1, int(law.ticks[order].max()) + 1
    tick = digits(1e3 * found.sample_time, "ms")
    layout = style.layout(
        xaxis=style.axis(
            f"delay of a command, rounded up [ticks of {tick}]", dtick=max(1, (high - low) // 12), range=[low - 0.5, high + 0.5]
        ),
        yaxis=style.axis("commands [%]", rangemode="tozero"),
        margin={"l": 78, "r": 24, "t": 16, "b": 52},
    )
    spread = "The log does not say how much the delays of single commands differ."
    if not math.isnan(law.deviation):
        spread = (
            f"Standard deviation {digits(1e3 * law.deviation, 'ms', 2)}. Commands that were overtaken are counted as if they had not been."
        )
    return figure({"data": [bars], "layout": layout}, "Delays of single commands", spread, 300, style.NARROW)


def frequency_response(fit: JointFit) -> Html:
    """Figure of torque to acceleration, measured and fitted: magnitude, phase, coherence."""
    measured = fit.measured
    used, omega = measured.excited, measured.omega
    around = omega[used] if used.any() else np.array(list(_marks(fit).values()) or omega[[0, -1]])
    low, high = float(around.min()) / 1.5, min(float(around.max()) * 1.6, float(omega[-1]))
    seen = (omega >= low) & (omega <= high)
    fine = np.geomspace(low, high, 600)
    fine = np.unique(np.concatenate([fine, *(value * (1 + 0.2 * np.linspace(-1, 1, 81) ** 3) for value in _marks(fit).values())]))
    fine = fine[(fine >= low) & (fine <= high)]
    curve = fit.response(fine)
    # Bendat and Piersol, Random Data, sec. 9.1: relative error of an averaged response.
    shared = np.clip(measured.coherence, 1e-3, 1.0)
    error = NORMAL * np.sqrt((1 - shared) / (2 * measured.averages * shared))
    size = np.abs(measured.response)
    phase = np.degrees(np.unwrap(np.angle(curve)))
    phase -= 360 * round((phase[0] - 180) / 360) if phase[0] > 200 else 0
    seen_phase = np.degrees(np.angle(measured.response))
    seen_phase += 360 * np.round((np.interp(omega, fine, phase) - seen_phase) / 360)
    chosen, other = seen & used, seen & ~used
    hz: dict[str, Any] = {"hoverinfo": "all", "hovertemplate": "%{x:.4~g} rad/s<br>%{y:.3~g}<extra></extra>"}
    band = _band(omega[chosen], size[chosen] * np.maximum(1 - error[chosen], 0.02), size[chosen] * (1 + error[chosen]))
    traces = [
        band | {"xaxis": "x2", "name": "95 % band", "showlegend": True, "meta": "wide"},
        style.line(fine, np.abs(curve), style.VERMILION, name="fitted", showlegend=True, xaxis="x2", **hz),
        *_points(omega[other], size[other], style.SOFT, "not used", xaxis="x2", **hz),
        *_points(omega[chosen], size[chosen], style.BLUE, "measured", xaxis="x2", **hz),
        style.line(fine, phase, style.VERMILION, yaxis="y2", showlegend=False, **hz),
        *_points(omega[chosen], seen_phase[chosen], style.BLUE, "", yaxis="y2", **hz),
        *_points(omega[other], measured.coherence[other], style.SOFT, "", yaxis="y3", **hz),
        *_points(omega[chosen], measured.coherence[chosen], style.BLUE, "", yaxis="y3", **hz),
    ]
    seen_levels = np.log10(size[chosen if used.any() else seen])  # an undamped resonance of the fit would squeeze them into a line
    fitted_levels = np.clip(np.log10(np.abs(curve)), seen_levels.min() - MOST_BEYOND, seen_levels.max() + MOST_BEYOND)
    levels = np.concatenate([seen_levels, fitted_levels])
    decades, step = [float(levels.min()) - 0.15, float(levels.max()) + 0.15], 1 if np.ptp(levels) > 1.5 else "D2"
    names = [
        style.label(math.log10(value), 0.445, f"{name} {hertz(value)}", yref="paper", yanchor="bottom", xanchor=("right", "left")[k],
                    font={"size": 12, "color": style.SOFT}, name="wide")
        for k, (name, value) in enumerate(_marks(fit).items())
        if low < value < high
    ]  # fmt: skip
    layout = style.layout(
        **style.frequency_axes(low, high) | {"xaxis": style.log_axis("frequency [rad/s]", low, high, anchor="y3")},
        yaxis=style.axis("rad/s² per N·m", type="log", domain=[0.5, 1], anchor="x2", range=decades, dtick=step),
        yaxis2=style.axis("phase [°]", domain=[0.2, 0.44], dtick=90, range=_padded(phase, seen_phase[chosen])),
        yaxis3=style.axis("coherence", domain=[0, 0.15], range=[0, 1.05], dtick=0.5),
        annotations=names,
        shapes=[style.upright(value, "#bbb", "dot") for value in _marks(fit).values() if low < value < high],
        showlegend=True,
        legend=style.switches(1.1),
        margin={"l": 84, "r": 24, "t": 92, "b": 52},
    )  # fmt: skip
    narrow = {**style.NARROW, "xaxis2.title.text": "Hz", "yaxis.title.text": "rad/s²/N·m"}
    narrow |= style.decades("xaxis", low, high) | style.decades("xaxis2", low, high, scale=2 * math.pi)
    caption = (
        f"From {fit.torque} to the acceleration of the measured side. Blue: frequencies that set-points or an added torque excite; grey: "
        "frequencies left out, at which feedback makes the torque or the encoder's noise rules. The fit is of the log row by row, not of "
        "these points; friction lowers the measured response at low frequencies. "
        + ("" if used.any() else "Here nothing excites the joint from outside: the fit rests on the noise that goes round the loop. ")
        + ("Hold, current loop and delay turn the phase." if fit.torque == "target_torque" else "")
    )
    return figure({"data": traces, "layout": layout}, "Frequency response, measured and fitted", caption, 640, narrow)


def _marks(fit: JointFit) -> dict[str, float]:
    return {name: fit.parameters[name].value for name in ("antiresonance", "resonance") if name in fit.parameters}


def _points(x: Floats, y: Floats, color: str, name: str, **parts: Any) -> list[style.Trace]:
    if not len(x):
        return []
    keep = thinned(y, 1200)
    return [
        style.line(x[keep], y[keep], color, mode="markers", marker={"color": color, "size": 6}, name=name, showlegend=bool(name), **parts)
    ]


def _band(x: Floats, low: Floats, high: Floats) -> style.Trace:
    around = {"x": np.concatenate([x, x[::-1]]), "y": np.concatenate([high, low[::-1]])}
    return {
        "type": "scatter",
        "mode": "lines",
        "fill": "toself",
        "fillcolor": "rgba(0,114,178,0.18)",
        "line": {"width": 0},
        "hoverinfo": "skip",
        **around,
    }


def _padded(*values: Floats) -> list[float]:
    every = np.concatenate(values)
    return [max(float(every.min()), -720.0) - 20, min(float(every.max()), 360.0) + 20]


def autocorrelation(fit: JointFit) -> Html:
    """Figure of the prediction errors' autocorrelation over lag, with the bounds of white noise, and its interpretation."""
    tests = fit.residuals
    lags = 1e3 * fit.sample_time * np.arange(1, len(tests.autocorrelation) + 1)
    stems_x, stems_y = np.repeat(lags, 3), np.zeros(3 * len(lags))
    stems_y[1::3], stems_y[2::3] = tests.autocorrelation, np.nan
    hover: dict[str, Any] = {"hoverinfo": "all", "hovertemplate": "%{x:.3~g} ms: %{y:.3f}<extra></extra>"}
    bound = {"type": "rect", "x0": 0, "x1": 1, "xref": "paper", "y0": -tests.chance, "y1": tests.chance, "layer": "below"}
    traces = [
        style.line(stems_x, stems_y, style.BLUE, width=1.6),
        style.line(lags, tests.autocorrelation, style.BLUE, mode="markers", marker={"color": style.BLUE, "size": 5}, **hover),
    ]  # fmt: skip
    least = max(0.3, 1.15 * float(np.abs(tests.autocorrelation).max()))
    layout = style.layout(
        xaxis=style.axis("lag [ms]", range=[0, float(lags[-1]) * 1.02]),
        yaxis=style.axis("autocorrelation", range=[-least, least]),
        shapes=[bound | {"fillcolor": style.ORANGE, "opacity": 0.25, "line": {"width": 0}}],
        margin={"l": 78, "r": 24, "t": 16, "b": 52},
    )
    inside = float(np.mean(np.abs(tests.autocorrelation) <= tests.chance))
    share, most = digits(100 * tests.explained, "%", 2), digits(100 * MOST_EXPLAINED, "%", 2)
    missed, allowed = digits(100 * tests.balance.most, "%", 2), digits(100 * MOST_LEFT, "%", 2)
    summary = (
        "the model misses nothing that the torque does"
        if tests.adequate
        else "the model misses what the torque does, and its intervals do not allow for it"
    )
    caption = (
        "Of the errors of predictions one tick ahead; white noise stays within the band in 95 of 100 lags, "
        f"here {digits(100 * inside, '%', 2)} do. "
        f"What counts is the torque that the model misses in a third octave, {missed} of its power, with at most {allowed} allowed, and "
        f"the share of the residual that follows the torque: {share}, with at most {most}, unless next to no torque is missed: {summary}."
    )
    return figure({"data": traces, "layout": layout}, "Residuals", caption, 320, style.NARROW)


MOST_POINTS = 2500  # most points of a hysteresis loop
SHOWN_SECONDS = 2.0  # [s] of predicted and logged torque in the figure


def hysteresis(fit: StiffnessFit) -> Html:
    """Figure of the hysteresis loop of a locked output: both directions, and the fitted lines."""
    step = max(1, len(fit.torque) // MOST_POINTS)
    traces, span = [], np.array([fit.deflection.min(), fit.deflection.max()])
    for way, name, color, symbol in ((1, "turning forward", style.BLUE, "circle"), (-1, "turning back", style.VERMILION, "x-thin-open")):
        rows = np.flatnonzero(fit.direction == way)[::step]
        points = {"mode": "markers", "marker": {"color": color, "size": 4.5, "symbol": symbol, "line": {"width": 1, "color": color}}}
        hover: dict[str, Any] = {"hoverinfo": "all", "hovertemplate": "%{x:.3~g} mrad<br>%{y:.3~g} N·m<extra></extra>"}
        traces.append(style.line(1e3 * fit.deflection[rows], fit.torque[rows], color, name=name, showlegend=True, **hover) | points)
        branch = fit.stiffness.value * span + fit.offset + way * fit.friction.value
        traces.append(style.line(1e3 * span, branch, style.BLACK, dash="dash", width=1.4, showlegend=False))
    middle = fit.stiffness.value * span + fit.offset
    traces.append(style.line(1e3 * span, middle, style.BLACK, name=f"K = {digits(fit.stiffness.value, 'N·m/rad')}", showlegend=True))
    layout = style.layout(
        xaxis=style.axis("deflection [mrad]"),
        yaxis=style.axis("torque [N·m]"),
        showlegend=True,
        legend=style.switches(1.02),
        margin={"l": 78, "r": 24, "t": 48, "b": 52},
    )
    caption = (
        f"Dashed: the branches, {digits(2 * fit.friction.value, 'N·m', 3)} apart, which is twice friction, and "
        f"{digits(1e3 * fit.hysteresis.value, 'mrad', 3)} wide. The line between them has the stiffness as its slope."
    )
    return figure({"data": traces, "layout": layout}, "Torque over deflection of the locked output", caption, 480, style.NARROW)


def predicted(fit: GainsFit, record: Record) -> Html:
    """Figure of logged and predicted torque, over the most active part of the log."""
    rows, logged, law = predicted_torque(fit, record)
    count = min(len(logged), max(round(SHOWN_SECONDS / rows.sample_time), LEAST_WINDOW))
    power = np.convolve(np.square(np.diff(logged, prepend=logged[0])), np.ones(count), "valid")
    first = int(np.argmax(power))
    shown = slice(first, first + count)
    panels = [
        Panel("torque", "N·m", [Curve("logged", logged[shown], style.BLACK), Curve("predicted", law[shown], style.ORANGE, "dash")], 0.65),
        Panel("difference", "N·m", [Curve("logged − predicted", (logged - law)[shown], style.BLUE)], 0.35),
    ]
    caption = (
        f"{fit.torque} and the torque of the gains found, both up to {hertz(fit.band)}, where most happens in the log. "
        f"The gains explain {digits(100 * fit.explained, '%', 4)} of its power."
    )
    return stacked(rows.time[shown], panels, "Predicted and logged torque", caption, 460)


def gains_beside(fit: GainsFit, asked: Sequence[tuple[str, float]]) -> Html:
    """Figure of applied over requested gains, with intervals, on a logarithmic scale; 1 is correct."""
    traces, names = [], []
    for name, value in reversed(asked):
        if not value:
            continue
        found = getattr(fit, name)
        ratio, low, high = (max(end / value, 1e-6) for end in (found.value, found.low, found.high))
        names.append(name)
        spread = {
            "type": "data",
            "symmetric": False,
            "array": [high - ratio],
            "arrayminus": [ratio - low],
            "color": style.BLUE,
            "thickness": 2.5,
        }
        hover: dict[str, Any] = {"hoverinfo": "all", "hovertemplate": f"{name}: %{{x:.4~g}} × what was asked<extra></extra>"}
        traces.append(style.markers([ratio], [name], "circle", style.BLUE, 12, **hover) | {"error_x": spread})
    ratios = [trace["x"][0] for trace in traces] or [1.0]
    low, high = min(*ratios, 1.0) / 2, max(*ratios, 1.0) * 2
    layout = style.layout(
        xaxis=style.log_axis("applied over asked", low, high),
        yaxis={"type": "category", "automargin": True, "categoryorder": "array", "categoryarray": names, "range": [-0.6, len(names) - 0.4]},
        shapes=[style.upright(1.0, style.BLACK, "dash", 1.5)],
        margin={"l": 60, "r": 24, "t": 16, "b": 52},
    )
    wrong = "; ".join(f"{error.gain}: {digits(error.factor)} × is {error.name}" for error in fit.unit_errors)
    caption = "The dashed line is what was asked for; bars are 95 % intervals." + (f" {wrong}." if wrong else "")
    return figure({"data": traces, "layout": layout}, "Gains found beside gains asked for", caption, 220, style.NARROW)
