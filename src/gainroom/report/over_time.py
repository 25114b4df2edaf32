"""Motion of link and motor over time, of a joint or of a robot's: after a step of the position reference, and under a load on the link."""

import math
from typing import Any

import numpy as np

from ..simulation.step_response import Sides, StepResponse
from ..simulation.tracking import Swing
from ..studies.joint import JointStudy
from ..studies.robot import RobotStudy
from ..system.linear.arrays import Floats
from . import style
from .columns import Column, definitions, tabulated
from .curves import Curve, Panel, stacked
from .number_format import digits, hertz, motion, motion_unit, one_degree
from .page import Html, figure, table

LOAD = 5.0
"""Load on the link [N m]: what a push of the hand makes at an arm's elbow."""
CURVE_POINTS = 1200  # drawn per curve
BEYOND = 1.3  # times the longest settling time: so long is drawn
FAR = 3.0  # times the reference's step: so far an unstable joint's vibration is drawn


def motion_facts(found: StepResponse) -> dict[str, Any]:
    """JSON of the link's motion after a step of the reference, and under a load."""
    step, load = found.link_step, found.link_load
    return {
        "step": {"of": "link", **_swing_facts(step)},
        "disturbance": {
            "of": "link",
            "load_torque": LOAD,
            "peak_deflection": None if found.growth >= 0 else LOAD * load.peak,
            "rest_deflection": LOAD * load.rest,
            **_swing_facts(load),
        },
    }


def _swing_facts(found: Swing) -> dict[str, float]:
    return {"overshoot_percent": 100 * found.overshoot, "settling_s": found.settling_time}


def motion_text(study: JointStudy) -> str:
    """Sentences on the link's motion after a step and under a load, with present and recommended gains; "" where none comes to rest."""
    named = [(name, found) for name, found in _responses(study) if found.growth < 0]
    if not named:
        return ""
    steps = "; ".join(f"with {name} {_step_text(found.link_step)}" for name, found in named)
    loads = "; ".join(f"with {name} {_load_text(found.link_load)}" for name, found in named)
    turns = "; ".join(f"with {name} {one_degree(*felt)}" for name, felt in _felt(study) if one_degree(*felt))
    text = f"Link after a step of the reference: {steps}. Link under {digits(LOAD)} N·m: {loads}."
    return f"{text} To turn the link by 1° takes {turns}." if turns else text


def _felt(study: JointStudy) -> list[tuple[str, tuple[float, float, float]]]:
    """Dynamic stiffness of the link, its frequency and the stiffness at rest, by the name of the gains."""
    best = [] if study.recommended is None or study.recommended_response is None else [("the recommended ones", study.recommended.nominal)]
    return [
        (name, (found.dynamic_stiffness, found.dynamic_stiffness_frequency, float(found.links.static[0])))
        for name, found in [("these gains", study.margins), *best]
    ]


def _responses(study: JointStudy) -> list[tuple[str, StepResponse]]:
    """Responses with this file's gains, and with the recommended ones where they are others."""
    found = [("these gains", study.response)]
    return found if study.recommended_response is None else [*found, ("the recommended ones", study.recommended_response)]


def _step_text(found: Swing) -> str:
    if math.isnan(found.settling_time):
        return "it does not follow"
    return f"{_percent(found.overshoot)} overshoot, {_settled(found)}"


def _load_text(found: Swing) -> str:
    turned = digits(1e3 * LOAD * found.peak, "mrad", 3)
    if math.isnan(found.settling_time):
        return f"it drifts beyond {turned}" if found.peak > 0 else "it does not move"
    over = "" if math.isnan(found.overshoot) else f", {_percent(found.overshoot)} beyond its rest"
    return f"{turned}{over}, {_settled(found)}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 0.995 else digits(100 * share, "%", 3)


def _settled(found: Swing) -> str:
    """Text with the time from which the link stays within 2 % of its final position."""
    if math.isinf(found.settling_time):
        return "not settled in the time computed"
    return f"settled after {digits(found.settling_time, 's', 3)}"


def motion_figure(study: JointStudy) -> Html:
    """Figure of link and motor after a step and under a load: two panels over one time axis."""
    rigid = math.isinf(study.system.source.stiffness)
    own, shown = study.response, [found for _, found in _responses(study)]
    end, traces = drawn_until(own) if own.growth >= 0 else drawn_until(*shown), []
    for found, color, dash in zip(shown, (style.BLACK, style.BLUE), ("solid", "dash"), strict=False):
        short = "this file" if found is own else "recommended"
        for axis, unit, scale, sides in (("y", "", 1.0, found.reference), ("y2", " mrad", 1e3 * LOAD, found.load)):
            for side, width in (("motor", style.MOTOR), ("link", style.LINK)):
                if rigid and side == "motor":
                    continue
                time, moved = _drawn(found.time, scale, sides, side, end)
                title = f"{'joint' if rigid else side}, {short}"
                look = {"dash": dash, "width": width, "name": title, "legendgroup": title, "showlegend": axis == "y", "yaxis": axis}
                hover = f"%{{x:.4g}} ms: %{{y:.4g}}{unit}<extra>{title}</extra>"
                traces.append(style.line(1e3 * time, moved, color, **look, hoverinfo="all", hovertemplate=hover))
                traces[-1]["line"]["simplify"] = False  # which cuts corners off a round top
    span = 1e3 * end
    traces.insert(0, style.line([0, 0, span], [0, 1, 1], style.SOFT, dash="dot", width=1.4, name="commanded", showlegend=True))
    place = {"xref": "paper", "yref": "paper", "xanchor": "right", "yanchor": "bottom", "name": "wide"}
    panels = ((1.0, "step of the position reference, velocity reference 0"), (0.45, f"load of {digits(LOAD)} N·m on the link, from time 0"))
    notes = [style.label(0.995, height, words, style.SOFT, **place) for height, words in panels]
    if own.growth > 0:
        notes.append(_vibration(own))
    picture = style.layout(
        xaxis=style.axis("time [ms]", anchor="y2", range=[-0.01 * span, span]),
        yaxis=style.axis("position / reference step [–]", domain=[0.55, 1]),
        yaxis2=style.axis("position [mrad]", domain=[0, 0.45]),
        annotations=notes,
        showlegend=True,
        legend=style.switches(1.06),
        margin={"l": 78, "r": 24, "t": 64, "b": 52},
    )
    narrow = {**style.NARROW, "yaxis.title.text": "position [–]", "yaxis2.title.text": "position [mrad]"}
    title = "The link after a step of the reference, and under a load"
    return figure({"data": traces, "layout": picture}, title, _caption(study, rigid), 580, narrow)


def drawn_until(*responses: StepResponse) -> float:
    """End [s] of the figure's time axis: BEYOND times the last settling time, or the end of the computation if no link settles.

    If the first response is unstable, the axis ends where its motor or link has moved by FAR.
    """
    far = [np.abs([one.reference.motor, one.reference.link]).max(axis=0) > FAR for one in responses if one.growth >= 0]
    if far and far[0].any():
        return float(responses[0].time[int(np.argmax(far[0]))])
    times = [swing.settling_time for one in responses for swing in (one.link_step, one.link_load)]
    last = max((time for time in times if not math.isnan(time)), default=math.inf)
    return min(BEYOND * last, max(float(one.time[-1]) for one in responses))


def _drawn(time: Floats, scale: float, sides: Sides, side: str, end: float) -> tuple[Floats, Floats]:
    """Points of a curve up to `end` [s], thinned; one that was computed for a shorter time goes on at its rest."""
    position, rest = getattr(sides, side), getattr(sides, f"{side}_rest")
    shown = int(np.searchsorted(time, end, side="right"))
    pick = slice(None, shown, max(1, shown // CURVE_POINTS))
    if time[-1] < end and math.isfinite(rest):
        return np.append(time[pick], end), scale * np.append(position[pick], rest)
    return time[pick], scale * position[pick]


def _vibration(response: StepResponse) -> style.Annotation:
    """Label of a growing vibration's frequency, at the top of the figure."""
    words = f"vibrates at {hertz(response.frequency)}" if response.frequency > 0 else "diverges"
    doubling = math.log(2) / response.growth
    text = f"<b>{words}</b>, doubling every {digits(1e3 * doubling, 'ms', 3)}"
    return style.label(0.01, 0.99, text, style.VERMILION, xref="paper", yref="paper", xanchor="left", yanchor="top")


def _caption(study: JointStudy, rigid: bool) -> str:
    own = study.response
    text = "Motor and link are one, as the gearbox is rigid. " if rigid else "Thick: the link; thin: the motor. "
    if own.growth > 0:
        text += f"This file's gains: the response grows at {digits(own.growth, '1/s', 3)}, at {hertz(own.frequency)}: do not run them. "
    text += f"{motion_text(study)} " if motion_text(study) else ""
    text += "All at the nominal values. " if study.system.uncertainty.names else ""
    if study.system.control.sample_time is not None:
        return text + "Stepped exactly from tick to tick; torque is held between ticks."
    if study.system.delay == 0:
        return text + "Stepped exactly (matrix exponential)."
    share = f"{digits(100 * own.change, '', 1)} %" if own.change >= 1e-5 else "less than 0.001 %"
    return text + f"Stepped with the exact delay; halving the step changes the curve by {share}."


def robot_motion_facts(study: RobotStudy) -> dict[str, Any] | None:
    """JSON of the motion of a robot's links in the state with the softest; None where it is not known."""
    found = study.link_motion
    if found is None:
        return None
    rows = zip(found.joints, found.responses, strict=True)
    return {"state": found.title, "joints": [{"joint": name, **motion_facts(one)} for name, one in rows]}


MOTION = (
    Column("link of", "", lambda row: row[0]),
    Column(
        "overshoot", "", lambda row: 100 * row[1].link_step.overshoot, "%", "of the link over its rest, after a step of its reference", 2
    ),
    Column("settles in", "", lambda row: None, definition="until it stays within 2 %", shown=lambda row: _time(row[1], row[1].link_step)),
    Column("moves by", "", lambda row: None, definition="the link at most, under the load", shown=lambda row: motion(row[2], row[3])),
    Column("beyond its rest", "", lambda row: 100 * row[1].link_load.overshoot, "%", "how far it swings over where the load leaves it", 2),
    Column("then settles in", "", lambda row: None, shown=lambda row: _time(row[1], row[1].link_load)),
)
"""Columns of a robot's links over time; a row: joint, its StepResponse, its largest motion under the load, the unit of that."""


def _time(response: StepResponse, found: Swing) -> str:
    late = math.isinf(found.settling_time)
    return f"> {digits(float(response.time[-1]), 's', 2)}" if late else digits(found.settling_time, "s", 2)


def robot_motion(study: RobotStudy) -> list[Html]:
    """Figure of a robot's softest link over time, and a table of all; [] where it is not known."""
    found, softest = study.link_motion, study.softest_now
    if found is None or softest is None:
        return []
    names = study.system.source.joint_names
    unit = {name: "m" if straight else "rad" for name, straight in zip(names, study.system.source.body.prismatic.tolist(), strict=True)}
    first = names[softest.joint]
    one = found.responses[found.joints.index(first)]
    scale, shown = motion_unit(LOAD * one.link_load.peak, unit[first])
    step, load = (
        tuple(
            Curve(side, factor * getattr(sides, side), style.BLACK, width=width, named=named)
            for side, width in (("motor", style.MOTOR), ("link", style.LINK))
        )
        for sides, factor, named in ((one.reference, 1.0, True), (one.load, scale * LOAD, False))
    )
    pushed = f"{digits(LOAD)} {'N' if unit[first] == 'm' else 'N·m'}"
    panels = [Panel("position / step", "–", step, 0.5), Panel(f"under {pushed}", shown, load, 0.5)]
    words = (
        f"{first} in {found.title}, all other loops closed: a step of its reference, and {pushed} on its link from time 0. Thick: the link."
    )
    picture = stacked(one.time, panels, f"The softest link over time: {first}", words, 460)
    rows = [(name, each, LOAD * each.link_load.peak, unit[name]) for name, each in zip(found.joints, found.responses, strict=True)]
    headings, texts = tabulated(MOTION, rows)
    caption = f"{found.title}, {digits(float(one.time[-1]), 's', 2)}; load: {digits(LOAD)} N·m, N where a joint is prismatic. "
    return [picture, table(headings, texts, caption + definitions(MOTION, headings))]
