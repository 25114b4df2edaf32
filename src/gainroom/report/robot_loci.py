"""The characteristic loci of a state near the critical point −1."""

import math
from collections.abc import Sequence

import numpy as np

from ..analysis.loci import Sweep
from ..native import _core
from ..studies.state import State
from ..system.linear.arrays import Complexes, Floats, Integers
from . import style
from .number_format import digits, frequency
from .page import Html, figure

WIDEST = 6.0  # |Re L| beyond which nothing is drawn; crossings outside are labelled
TO_DRAW = 0.012  # longest step between samples, relative to the window
TO_WRITE = 0.007  # points closer than this along a locus are not written into the page
AROUND = math.log(3)  # of the frequency at the limit: the part of the critical locus that is drawn bold
MOST = 40_000  # eigenvalues in one sweep


def loci_window(states: Sequence[State]) -> tuple[float, float]:
    """(left end, half the height) of a window that shows −1 and where the loci cross, the same for every state."""
    crossings = [1 / state.limit.gain for state in states if 0 < state.limit.gain < math.inf]
    left = -min(max([1.25, *(1.2 * one for one in crossings)]), WIDEST)
    return left, 0.4 * (0.35 - left)


def loci(state: State, window: tuple[float, float]) -> Html:
    """The loci for ω > 0; the one that sets the limit bold near it."""
    left, half = window
    right = left + 1.15 * (0.35 - left)
    sweep = _fine(state, window)
    curves, omega = _followed(sweep), sweep.omega
    critical = _critical(state, omega, curves)
    others: Complexes = np.concatenate([np.append(_drawn(curve, window)[1], np.nan) for curve in curves.T])
    traces = [style.line(others.real, others.imag, "#9a9a9a", width=1.3, name="other loci")]
    if critical is not None:
        near = np.abs(np.log(omega / state.limit.frequency)) < AROUND
        traces.append(_bold(omega[near], curves[near, critical], window))
    traces.append(style.markers([-1], [0], "x", style.VERMILION, 13, hoverinfo="text", text="the critical point −1", cliponaxis=False))
    notes = [style.label(-1, 0, "−1", style.VERMILION, xanchor="right", yanchor="top", xshift=-5, yshift=-4)]
    crossing, crossing_notes = _crossing(state, window)
    wide = {"zeroline": True, "zerolinecolor": "#999", "fixedrange": True}
    picture = style.layout(
        xaxis=style.axis("Re λ(L)", range=[left, right], constrain="domain", **wide),
        yaxis=style.axis("Im λ(L)", range=[-half, half], scaleanchor="x", constrain="domain", **wide),
        annotations=[*notes, *crossing_notes],
        shapes=[_beyond(left)],
        plot_bgcolor="white" if state.limit.stable else style.UNSTABLE_GROUND,
        margin={"l": 62, "r": 8, "t": 8, "b": 48},
    )
    return figure({"data": [*traces, *crossing], "layout": picture}, _title(state), _caption(state, critical), 370, style.NARROW)


def _fine(state: State, window: tuple[float, float]) -> Sweep:
    """The sweep of the state's loop with samples close enough to be joined by straight lines inside the window."""
    sweep = Sweep(state.loop)
    longest = -TO_DRAW * window[0]
    for _ in range(8):
        steps = sweep.steps()
        near = np.minimum(np.abs(steps.start), np.abs(steps.end)) < -1.6 * window[0]
        rough = np.any(near & (np.abs(steps.end - steps.start) > longest), axis=1) & (np.diff(sweep.omega) > 1e-6 * sweep.omega[1:])
        if not rough.any() or sweep.loci.size > MOST:
            break
        places = np.flatnonzero(rough)
        sweep.add(0.5 * (sweep.omega[places] + sweep.omega[places + 1]))
    return sweep


def _followed(sweep: Sweep) -> Complexes:
    """(k, r) the eigenvalues, each column one locus: the next one is that closest to where the last two point."""
    omega, curves = sweep.omega, sweep.loci.copy()
    for k in range(1, len(omega)):
        ahead = curves[k - 1]
        if k > 1:
            ahead = ahead + (curves[k - 1] - curves[k - 2]) * min((omega[k] - omega[k - 1]) / (omega[k - 1] - omega[k - 2]), 2.0)
        distance = np.abs(ahead[:, None] - curves[k])
        order = np.argmin(distance, axis=1)
        curves[k] = curves[k, order if len(set(order.tolist())) == len(order) else _core.assigned(distance)]
    return curves


def _critical(state: State, omega: Floats, curves: Complexes) -> int | None:
    """The locus that crosses the negative real axis at the limit; None where there is no limit."""
    if not math.isfinite(state.limit.frequency):
        return None
    k = int(np.clip(np.searchsorted(omega, state.limit.frequency), 1, len(omega) - 1))
    share = (state.limit.frequency - omega[k - 1]) / (omega[k] - omega[k - 1])
    there = curves[k - 1] + share * (curves[k] - curves[k - 1])
    return int(np.argmin(np.abs(there + 1 / state.limit.gain)))


def _drawn(curve: Complexes, window: tuple[float, float]) -> tuple[Integers, Complexes]:
    """Samples to draw and their values: what the window may show and its neighbours, none nearly on another; −1 and NaN break the line."""
    reach, close = -1.6 * window[0], -TO_WRITE * window[0]
    inside = np.abs(curve) <= reach
    edge = np.convolve(inside, [1, 1, 1], "same").astype(bool) & ~inside
    travelled = np.append(0.0, np.cumsum(np.minimum(np.abs(np.diff(curve)), reach)))
    index = np.flatnonzero(edge | (inside & np.append(True, np.diff(np.floor(travelled / close)) > 0)))
    leaves = np.flatnonzero(edge[index][1:] & edge[index][:-1]) + 1
    index = np.insert(index, leaves, -1)
    return index, np.where(index < 0, np.nan, np.round(curve[index], 4))


def _bold(omega: Floats, curve: Complexes, window: tuple[float, float]) -> style.Trace:
    """A locus near the limit, with its frequencies."""
    index, values = _drawn(curve, window)
    text = ["" if k < 0 else frequency(float(omega[k])) for k in index]
    return style.line(values.real, values.imag, style.BLACK, width=2.8, hoverinfo="text", text=text)


def _crossing(state: State, window: tuple[float, float]) -> tuple[list[style.Trace], list[style.Annotation]]:
    """The crossing that sets the limit, with its frequency."""
    limit = state.limit
    if not math.isfinite(limit.frequency):
        return [], []
    at = -1 / limit.gain
    text = (
        f"λ = {digits(at, '', 3)} at {frequency(limit.frequency, 3)}<br>limit 1/{digits(-at, '', 3)} = <b>{digits(limit.gain, '', 3)} ×</b>"
    )
    half = window[1]
    inside = at > window[0]
    place = {"axref": "x", "ayref": "y", "showarrow": True, "arrowhead": 2, "arrowwidth": 1.4, "arrowcolor": style.INK, "standoff": 6}
    reach = 0.62 * window[0] if at > 0.4 * window[0] else 0.3 * window[0]
    note = style.label(max(at, window[0]), 0, text, style.INK, ax=reach, ay=0.72 * half, **place)
    if not inside:
        note["text"] = f"left of the picture:<br>{text}"
    return [style.markers([at], [0], "circle", style.BLACK, 10)] if inside else [], [note]


def _beyond(left: float) -> dict:
    """From −1 to the left: a locus that crosses there is beyond its limit."""
    line = {"color": style.VERMILION, "width": 4}
    return {"type": "line", "x0": left, "x1": -1, "y0": 0, "y1": 0, "line": line, "opacity": 0.55, "layer": "below"}


def _title(state: State) -> str:
    verdict = "" if state.limit.stable else "UNSTABLE; "
    if math.isnan(state.limit.gain):
        return f"{state.title}: {verdict}limit not known"
    if not math.isfinite(state.limit.frequency):
        return f"{state.title}: {verdict}no crossing sets a limit"
    return f"{state.title}: {verdict}{'crosses' if state.limit.stable else 'crossed'} at {digits(-1 / state.limit.gain, '', 3)}"


def _caption(state: State, critical: int | None) -> str:
    limit = state.limit
    if math.isnan(limit.gain):
        return "These loci could not be followed to a limit; the drawing may be incomplete."
    if critical is None:
        return "No locus crosses the negative real axis where it would set a limit."
    if limit.stable:
        return f"At {digits(limit.gain, '', 3)} × these gains the bold locus passes through −1."
    return f"The loci encircle −1; below {digits(limit.gain, '', 3)} × these gains they do not."
