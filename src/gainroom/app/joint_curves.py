"""Curves of one joint for the page, from the functions that the report draws with."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..report.bode import BodeLoop, frequency_span, response
from ..report.gain_map import around, edge_frequencies, gain_points
from ..report.map_lines import MapView as Window, opened, outlines, required_lines
from ..simulation.step_response import step_response
from ..studies.joint import JointStudy
from .bench import drawn_line, drawn_response, drawn_step, rounded

WIDER = 2.0
"""Factor by which the frequency axis exceeds that of the report, as gains move."""
STEP_POINTS = 500


def sweep_span(study: JointStudy) -> tuple[float, float]:
    """Span of the frequency axis [rad/s], constant while gains move."""
    low, high = frequency_span(study, [BodeLoop("", study.loop, study.margins)])
    return low / WIDER, high if study.system.control.sample_time is not None else high * WIDER


def map_window(study: JointStudy) -> tuple[float, float]:
    """Largest gains (kp, kd) of the map."""
    window = around(study, gain_points(study))
    return window.kp, window.kd


def bode(study: JointStudy, span: tuple[float, float]) -> dict[str, Any]:
    """Magnitude, phase and the Nyquist plot of the open loop, with the crossings that decide; frequencies in Hz."""
    low, high = span
    if study.system.control.sample_time is not None:
        high = math.pi / study.system.control.sample_time
    omega, _, phase = response(study.loop, min(low, 0.1 * high), high)
    found = study.margins
    marks = {"gain": found.phase_crossover, "phase": found.gain_crossover, "Ms": found.peak_sensitivity_frequency}
    return drawn_response(omega, study.loop.response(omega), phase, marks)


def stable_gains(study: JointStudy, window: tuple[float, float]) -> dict[str, Any]:
    """Outlines of the stable gains."""
    return {"stable": [drawn_line(outline) for outline in outlines(study.region, Window(*window, *window))], "window": window}


def required_gains(study: JointStudy, window: tuple[float, float]) -> Iterator[dict[str, Any]]:
    """Outlines of the gains that meet the requirements at the nominal values; then the frequencies along the edge of the stable ones."""
    view = Window(*window, *window)
    asked = study.system.requirements.asked
    yield {"required": [drawn_line(outline) for outline in outlines(study.required_region, view)] if asked else []}
    pieces = [opened(outline) for outline in outlines(study.region, view)]
    edge = [(piece, edge_frequencies(study.region, piece)) for piece in pieces]
    yield {
        "edge": [{"line": drawn_line(piece), "hz": rounded(omega / (2 * math.pi))} for piece, omega in edge if np.isfinite(omega).any()],
        "last": True,
    }


def limits(study: JointStudy, window: tuple[float, float]) -> dict[str, Any]:
    """Line of each required margin."""
    view = Window(*window, *window)
    return {"lines": [{"text": text, "parts": [drawn_line(part) for part in parts]} for text, parts in required_lines(study, view)]}


def step(study: JointStudy) -> dict[str, Any]:
    """Measured position after a step of its reference, and under 1 N m added to the command."""
    found = step_response(study.loop)
    pick = slice(None, None, max(1, len(found.time) // STEP_POINTS))
    return drawn_step(found, pick, 1e6) | {"growth": found.growth, "hz": found.frequency / (2 * math.pi)}
