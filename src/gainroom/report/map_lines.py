"""Outlines of the allowed region in the gain map, and lines of equal margin, exact on every drawn line kp = const."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_region import PDRegion, traced
from ..studies.joint import JointStudy
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS, Requirements
from . import style
from .margin_columns import margin_value

COLUMNS = 40  # lines kp = const on which a boundary is computed
LINES = ((style.GREEN, "solid"), (style.BLUE, "dash"), (style.PURPLE, "dot"), (style.VERMILION, "dashdot"))
"""Colour and dash of the requirements, in order."""


@dataclass(frozen=True)
class MapView:
    """Displayed range, from 0 to kp and kd; `whole_kp`, `whole_kd`: with the whole stable region."""

    kp: float
    kd: float
    whole_kp: float
    whole_kd: float


def outlines(region: PDRegion, view: MapView) -> list[Floats]:
    """Closed outlines (m, 2) of the allowed gains within kp >= 0, kd >= 0."""
    kps, columns = _columns(region, view)
    if not len(kps):
        return []
    ceiling = 4 * view.whole_kd
    return [np.clip(outline, 0.0, [np.inf, ceiling]) for outline in traced(kps, [np.clip(c, -ceiling, ceiling) for c in columns])]


def _columns(region: PDRegion, view: MapView) -> tuple[Floats, list[Floats]]:
    """Lines kp = const up to the region's tip, closer together near it, and the allowed kd on each."""
    tip = _tip(region, view.whole_kp)
    if tip <= 0:
        return np.zeros(0), []
    inner = min(tip, view.kp)
    kps = inner * 0.5 * (1 - np.cos(np.linspace(0, math.pi, COLUMNS)))
    kps[0] = 1e-6 * inner
    if tip > view.kp:
        kps = np.append(kps, np.linspace(inner, tip, 12)[1:])
    kps[-1] = min(kps[-1], tip * (1 - 1e-7))
    return kps, region.columns(kps)


def _tip(region: PDRegion, widest: float) -> float:
    """Largest allowed kp within [0, widest], to about 0.1 %; 0: none. For drawing: the ends are not polished."""
    inside, outside = 0.0, widest
    kps = np.concatenate([np.geomspace(1e-3, 0.1, 9), np.linspace(0.13, 1, 16)]) * widest
    for _ in range(3):
        free = region.stable_columns(kps, polish=False)
        free = region.excluding(region.required, kps, free, polish=False)
        filled = np.flatnonzero([len(intervals) > 0 for intervals in free])
        if len(filled):
            inside = float(kps[filled[-1]])
            outside = float(kps[min(filled[-1] + 1, len(kps) - 1)])
        if outside <= inside:
            break
        kps = np.linspace(inside, outside, 12)[1:]
    return inside


def contours(study: JointStudy, view: MapView, taken: list[style.Annotation]) -> tuple[list[style.Trace], list[style.Annotation]]:
    """Lines of equal gain margin, phase margin and Ms; required levels are thicker."""
    traces, notes = [], []
    for place, (level, text, color, dash, asked) in enumerate(_levels(study.system.requirements)):
        drawn = []
        for outline in outlines(replace(study.region, required=level), view):
            line = opened(outline)
            drawn.append(line)
            hover = {"hoverinfo": "text", "text": text + (" (required)" if asked else "")}
            traces.append(style.line(line[:, 0], line[:, 1], color, dash=dash, width=2.6 if asked else 1.4, **hover))
        spot = _label_spot(drawn, view, place, taken + notes)
        if spot is not None:
            notes.append(style.label(*spot, text, color, name="" if asked else "wide"))
    return traces, notes


def required_lines(study: JointStudy, view: MapView) -> list[tuple[str, list[Floats]]]:
    """Line of each required margin, by its label."""
    asked = [(level, text) for level, text, _, _, required in _levels(study.system.requirements) if required]
    return [(text, [opened(outline) for outline in outlines(replace(study.region, required=level), view)]) for level, text in asked]


def _levels(asked: Requirements) -> list[tuple[Requirements, str, str, str, bool]]:
    """Contours to draw: (one requirement, label, colour, dash, True if asked for), each default or required level and a stricter one."""
    result = []
    for one, (color, dash) in zip(REQUIREMENTS.values(), itertools.cycle(LINES), strict=False):
        value = asked.needed.get(one.name, one.usual)
        if value is None or not one.in_closed_form(value):  # not asked for, or not known as a line
            continue
        for level in (value, one.stricter(value)):
            text = f"{one.heading} {margin_value(asked, one.name, level, None, 3)}"
            result.append((Requirements(**{one.name: level}), text, color, dash, level == asked.needed.get(one.name)))
    return result


def opened(outline: Floats) -> Floats:
    """Outline without its edge along the first line kp = const and along kd = 0, which are no contours."""
    line = outline.copy()
    first = line[:, 0] == line[:, 0].min()
    line[(line[:, 1] <= 0) | (first & np.roll(first, 1) & np.roll(first, -1))] = np.nan
    return line[:-1] if first[0] and first[-1] else line


def _label_spot(lines: list[Floats], view: MapView, place: int, taken: list[style.Annotation]) -> tuple[float, float] | None:
    """Point of a line farthest from existing labels, and not too near the frame; None: none."""
    points = np.vstack(lines) if lines else np.zeros((0, 2))
    scaled = points / [view.kp, view.kd]
    good = np.flatnonzero(np.all((scaled > [0.1, 0.04]) & (scaled < [0.9, 0.95]), axis=1))
    if not len(good):
        return None
    others = np.array([[note["x"] / view.kp, note["y"] / view.kd] for note in taken] or [[0.0, 2.0]])
    # A label is about three times as wide as it is high: distance across counts a third
    gap = np.abs(scaled[good][:, None] - others) * [1 / 0.3, 1 / 0.06]
    clear = np.minimum(gap.max(axis=2).min(axis=1), 1.6)
    best = good[int(np.argmax(clear + 0.6 * scaled[good, 1] - 0.2 * np.abs(scaled[good, 0] - (0.3 + 0.1 * place))))]
    return float(points[best, 0]), float(points[best, 1])
