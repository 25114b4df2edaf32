"""Step and disturbance response of the file's gains and the recommended ones."""

import math

import numpy as np

from ..simulation.step_response import StepResponse, step_response
from ..studies.joint import JointStudy
from . import style
from .number_format import digits, hertz
from .page import Html, figure

CURVE_POINTS = 1200  # drawn per curve


def time_response(study: JointStudy) -> Html:
    """Two panels over one time axis."""
    own = step_response(study.loop)
    shown = [("this file", own, style.BLACK, "solid", 2.6)]
    recommended = study.recommended
    if recommended is not None:
        loop = study.system.loop(controller=recommended.controller)
        shown.append(("recommended", step_response(loop, float(own.time[-1])), style.BLUE, "dash", 2.0))
    traces, notes = [], []
    for name, response, color, dash, width in shown:
        pick = slice(None, None, max(1, len(response.time) // CURVE_POINTS))
        time = 1e3 * response.time[pick]
        shape = "hv" if study.system.control.sample_time is not None and len(time) < 150 else "linear"
        parts = {"dash": dash, "width": width, "name": name, "hoverinfo": "x+y+name"}
        for values, axis in ((response.reference, "y"), (1e6 * response.disturbance, "y2")):
            trace = style.line(time, values[pick], color, **parts, yaxis=axis, legendgroup=name, showlegend=axis == "y")
            trace["line"]["shape"] = shape
            traces.append(trace)
    end = 1e3 * float(own.time[-1])
    traces.insert(0, style.line([0, 0, end], [0, 1, 1], style.SOFT, dash="dot", width=1.4, name="commanded", showlegend=True))
    if own.growth > 0:
        notes.append(_vibration(own))
    picture = style.layout(
        xaxis=style.axis("time [ms]", anchor="y2", range=[-0.01 * end, end]),
        yaxis=style.axis("position / reference step [–]", domain=[0.55, 1]),
        yaxis2=style.axis("position for 1 N·m [µrad]", domain=[0, 0.45]),
        annotations=[*notes, *_panel_names()],
        showlegend=True,
        legend=style.switches(1.03),
        margin={"l": 78, "r": 24, "t": 40, "b": 52},
    )
    narrow = {**style.NARROW, "yaxis.title.text": "position [–]", "yaxis2.title.text": "position [µrad]"}
    return figure(
        {"data": traces, "layout": picture}, "Step of the reference, and step of a disturbance torque", _caption(study, own), 560, narrow
    )


def _panel_names() -> list[style.Annotation]:
    place = {"xref": "paper", "yref": "paper", "xanchor": "right", "yanchor": "bottom", "name": "wide"}
    return [
        style.label(0.995, 1.0, "unit step of the reference", style.SOFT, **place),
        style.label(0.995, 0.45, "1 N·m added to the torque command", style.SOFT, **place),
    ]


def _vibration(response: StepResponse) -> style.Annotation:
    """The frequency of a growing vibration, at the top of the figure."""
    words = f"vibrates at {hertz(response.frequency)}" if response.frequency > 0 else "diverges"
    doubling = math.log(2) / response.growth
    text = f"<b>{words}</b>, doubling every {digits(1e3 * doubling, 'ms', 3)}"
    return style.label(0.01, 0.99, text, style.VERMILION, xref="paper", yref="paper", xanchor="left", yanchor="top")


def _caption(study: JointStudy, own: StepResponse) -> str:
    side = study.system.control.feedback
    text = f"Position of the {side} side. "
    if own.growth > 0:
        rate = f"{digits(own.growth, '1/s', 3)}"
        text += f"The response grows at {rate}, at {hertz(own.frequency)}: do not run these gains. "
    else:
        overshoot = 100 * (float(own.reference.max()) - 1)
        last = 1e6 * float(np.abs(own.disturbance[-1]))
        text += f"These gains overshoot by {digits(max(overshoot, 0.0), '%', 3)}; the controller differentiates the step, "
        text += "as in eq. (4) of the paper. "
        text += f"A constant torque of 1 N·m deflects the joint by {digits(last, 'µrad', 3)} at the end of the figure. "
    if study.system.control.sample_time is not None:
        return text + "Stepped exactly from tick to tick; torque is held between ticks."
    if study.system.delay == 0:
        return text + "Stepped exactly (matrix exponential)."
    return text + f"Stepped with the exact delay; halving the step changes the curve by {_share(own.change)}."


def _share(change: float) -> str:
    return f"{digits(100 * change, '', 1)} %" if change >= 1e-5 else "less than 0.001 %"
