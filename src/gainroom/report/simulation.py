"""The page of a played scenario: answer, numbers, commanded and actual with the torque under them, the vibration close up."""

import math
from itertools import pairwise

import numpy as np

from ..arrays import Floats, Integers
from ..io.numbers import digits, frequency, hertz, typed_gains
from ..simulation.response import Response
from ..simulation_study import SimulationStudy
from . import style
from .page import Card, Html, Lead, Section, block, facts, figure, page, table
from .shared import filters, footer

MOST_POINTS = 2400  # of a curve
CLOSE_PERIODS = 12  # of the vibration in its own picture
RUNAWAY = 3.0  # times the reference's range: what a run that diverges is shown up to


def simulation_page(study: SimulationStudy, command: str) -> str:
    """The report of a run as one HTML page; `command` is what a reader types to get it again."""
    sections = [Section("In time", [_traces(study)])]
    if study.vibration is not None and study.vibrates:
        sections.append(Section("The vibration", [_close_up(study)]))
    sections += [
        *([] if study.response.diverged else [Section("Numbers", [_numbers(study)])]),
        Section("Inputs and assumptions", [_inputs(study), "Keys and units are those of the file.", _assumptions(study)]),
        Section("This page again", [block(command)]),
    ]
    kind = "linear sampled model" if study.spec.is_linear else "virtual testbed"
    return page(f"gainroom simulate: one joint, {kind}", _lead(study), _cards(study), sections, footer())


def _lead(study: SimulationStudy) -> Lead:
    if study.sound:
        return Lead(study.sentence, "good", "", study.warnings)
    headline = "DIVERGES: do not run these gains" if study.response.diverged else "VIBRATES: do not run these gains"
    return Lead(study.sentence, "bad", headline, study.warnings)


def _cards(study: SimulationStudy) -> list[Card]:
    found, vibration, limit = study.tracking, study.vibration, study.limit
    ran = study.response.diverged_at
    cards = (
        [Card("runs away within", digits(ran, "", 3), "s", "never", met=False)]
        if ran is not None
        else [
            Card(f"{name} error", _milli(float(np.abs(value).max())), "mrad", note=note)
            for name, value, note in (
                ("largest", found.peak, "over the whole run"),
                ("RMS", found.rms, "over the whole run"),
                ("steady-state", found.steady_state, "mean of the last tenth"),
            )
        ]
    )
    if ran is None:
        cards.append(Card("torque peak", digits(float(study.torque_peak.max()), "", 3), "N m", note="of the actual torque"))
    seen = ("none", "") if vibration is None else (digits(vibration.frequency / (2 * math.pi), "", 3), "Hz")
    note = f"linear limit: {digits(limit.gain, '', 3)} × these gains, {hertz(limit.frequency)}" if 0 < limit.gain < math.inf else ""
    cards.append(Card("vibration", *seen, requirement="none that lasts", met=not study.vibrates, note=note))
    return cards


def _traces(study: SimulationStudy) -> Html:
    """Commanded and both sides; the error; target and actual torque."""
    response, end = study.response, _shown_ticks(study)
    note = []
    if study.vibration is not None and study.vibrates:
        words = f"<b>vibrates at {hertz(study.vibration.frequency)}</b> ({digits(study.vibration.frequency, 'rad/s')})"
        note = [style.label(0.01, 0.995, words, style.VERMILION, xref="paper", yref="paper", xanchor="left", yanchor="top")]
    picture = _picture(response, slice(0, end), note)
    cut = end < len(response.time)
    caption = (
        f"Positions on the joint side of the gearbox, error of the {response.feedback} side, which is fed back; torques at the ticks. "
        + (f"Cut at {digits(response.time[end - 1], 's', 3)}, where the joint is already out of the picture. " if cut else "")
        + _conclusion(study)
    )
    narrow = {**style.NARROW, "yaxis.title.text": "[rad]", "yaxis2.title.text": "[mrad]", "yaxis3.title.text": "[N m]"}
    return figure(picture, "Commanded and actual position, tracking error, torque", caption, 680, narrow)


def _close_up(study: SimulationStudy) -> Html:
    """The last periods of the vibration."""
    assert study.vibration is not None
    response, end = study.response, _shown_ticks(study)
    ticks = max(24, math.ceil(CLOSE_PERIODS * 2 * math.pi / study.vibration.frequency / response.sample_time))
    picture = _picture(response, slice(max(0, end - ticks), end), [])
    period = 2 * math.pi / study.vibration.frequency
    caption = (
        f"One period is {digits(1e3 * period, 'ms', 3)}. The linear loop predicts {hertz(study.limit.frequency)} where vibration begins; "
        "above the limit the frequency rises with the gains."
    )
    return figure(
        picture,
        f"The last {CLOSE_PERIODS} periods of the picture above: {frequency(study.vibration.frequency)}",
        caption,
        600,
        style.NARROW,
    )


def _picture(response: Response, rows: slice, notes: list[style.Annotation]) -> dict:
    time = response.time[rows]
    panels = (
        ("y", (("motor", response.motor_position, style.BLUE, "solid"), ("link", response.link_position, style.VERMILION, "dash"))),
        ("y2", (("error", 1e3 * response.error, style.BLUE, "solid"),)),
        (
            "y3",
            (
                ("target torque", response.target_torque, style.ORANGE, "dash"),
                ("actual torque", response.actual_torque, style.BLACK, "solid"),
            ),
        ),
    )
    traces = []
    for axis, curves in panels:
        for name, values, color, dash in curves:
            traces.append(_curve(time, values[rows, 0], name, color, dash, axis))
    traces.insert(2, _curve(time, response.reference[rows, 0], "commanded", style.BLACK, "dot", "y"))
    layout = style.layout(
        xaxis=style.axis("time [s]", anchor="y3", range=[float(time[0]), float(time[-1])]),
        yaxis=style.axis("position [rad]", domain=[0.62, 1]),
        yaxis2=style.axis("error [mrad]", domain=[0.33, 0.57]),
        yaxis3=style.axis("torque [N m]", domain=[0, 0.28]),
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.02),
        margin={"l": 78, "r": 24, "t": 40, "b": 52},
    )
    return {"data": traces, "layout": layout}


def _curve(time: Floats, values: Floats, name: str, color: str, dash: str, axis: str) -> style.Trace:
    keep = thinned(values)
    return style.line(
        time[keep], values[keep], color, dash=dash, width=1.8, name=name, hoverinfo="x+y+name", yaxis=axis, showlegend=axis != "y2"
    )


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


def _shown_ticks(study: SimulationStudy) -> int:
    """All of them; of a run that diverges those until the joint is far out of the picture."""
    response = study.response
    if not response.diverged:
        return len(response.time)
    room = RUNAWAY * max(float(np.ptp(response.reference)), 0.01)
    far = np.abs(response.error).max(axis=1) > room
    return max(2, min(len(far), int(np.argmax(far)) + 1)) if far.any() else len(far)


def _conclusion(study: SimulationStudy) -> str:
    if study.response.diverged:
        return "These gains must not be run."
    if study.vibrates:
        return "The vibration does not die away: lower all gains together, or shorten the delay."
    return "Nothing lasts but the error itself: what ends a move short of its goal is friction, gravity or a lasting torque on the joint."


def _numbers(study: SimulationStudy) -> Html:
    found = study.tracking
    columns = ("", "RMS [mrad]", "peak [mrad]", "steady state [mrad]", "overshoot", "settles in", "torque peak [N m]")
    rows = [
        (
            name,
            *(_milli(float(value[k])) for value in (found.rms, found.peak, found.steady_state)),
            digits(100 * float(found.overshoot[k]), "%", 3),
            "never" if math.isinf(found.settling_time[k]) else digits(float(found.settling_time[k]), "s", 3),
            digits(float(study.torque_peak[k]), "", 4),
        )
        for k, name in enumerate(study.response.joint_names)
    ]
    caption = "Error: reference less position. Settled: within 2 % of the move for good; only a move has an overshoot."
    return table(columns, rows, caption)


def _milli(angle: float) -> str:
    return digits(0.0 if abs(angle) < 1e-9 else 1e3 * angle, "", 3)


def _inputs(study: SimulationStudy) -> Html:
    spec = study.spec.joint
    joint, drive = spec.joint, spec.drive
    pairs = [
        (
            "joint",
            f"J_M {joint.motor_inertia:g}, J_L {joint.link_inertia:g} kg m², K {joint.stiffness:g} N m/rad, B {joint.damping:g} N m s/rad",
        ),
        ("drive", f"current loop {drive.bandwidth:g} rad/s, ζ {drive.damping_ratio:g}, delay {1e3 * drive.delay:g} ms"),
        ("control", f"{typed_gains(spec.controller)}, all × {study.gain:g}; {spec.feedback} side; {filters(spec.controller)}"),
        (
            "ticks",
            f"{digits(1 / study.spec.sample_time, 'Hz')}, {len(study.response.time)} rows over {digits(study.response.time[-1], 's')}",
        ),
    ]
    return facts([*pairs, *study.spec.described.items()])


def _assumptions(study: SimulationStudy) -> str:
    if study.spec.is_linear:
        return (
            "Linear two-mass joint, stepped exactly from tick to tick: the torque is held in between, velocity is differenced as the "
            "controller does it, the delay is exact. No friction, gravity, torque limit or encoder steps: the file's scenario adds them."
        )
    return (
        "The same loop on a virtual testbed. Between ticks linear parts are exact; friction and gravity are constant over substeps of "
        "25 µs and can create no energy. No backlash, no thermal effects."
    )
