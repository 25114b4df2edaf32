"""Outlines of the allowed region in the gain map and lines of equal margin, exact on every drawn line kp = const; equal stiffness."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_region import PDRegion, traced
from ..design.link_gains import LinkCase
from ..errors import listed
from ..studies.joint import JointStudy
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS, Requirements
from . import style
from .map_labels import Box, free_spot, label_box
from .margin_columns import margin_value
from .number_format import digits

COLUMNS = 40  # lines kp = const on which a boundary is computed
LINES = ((style.GREEN, "solid"), (style.BLUE, "dash"), (style.PURPLE, "dot"), (style.VERMILION, "dashdot"))
"""Colour and dash of the requirements, in order."""
HEIGHT = "#8a8a8a"  # of lines of equal stiffness, as of equal height on a map
SHARES = (0.95, 0.8, 0.5)  # of the largest stiffness, at which lines are drawn
GRID = (80, 80)  # values of kp and kd at which the stiffness is worked out
AT_A_TIME = 512  # gains: all frequencies of more would leave the processor's cache


@dataclass(frozen=True)
class MapView:
    """Displayed range, from 0 to kp and kd; `whole_kp`, `whole_kd`: with the whole stable region."""

    kp: float
    kd: float
    whole_kp: float
    whole_kd: float

    @property
    def shown(self) -> tuple[float, float]:
        """Displayed range (kp, kd)."""
        return self.kp, self.kd


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


def contours(study: JointStudy, view: MapView, taken: list[Box]) -> tuple[list[style.Trace], list[style.Annotation]]:
    """Lines of equal gain margin, phase margin and Ms: the required ones, or thinner the usual ones; labels are clear of `taken`."""
    traces, notes, taken = [], [], list(taken)
    for place, (level, text, color, dash, asked) in enumerate(_levels(study.system.requirements)):
        drawn = []
        for outline in outlines(replace(study.region, required=level), view):
            line = opened(outline)
            drawn.append(line)
            hover = {"hoverinfo": "text", "text": text + (" (required)" if asked else "")}
            traces.append(style.line(line[:, 0], line[:, 1], color, dash=dash, width=2.6 if asked else 1.4, **hover))
        points = np.vstack(drawn) if drawn else np.zeros((0, 2))
        spot = free_spot(points, len(text), view.shown, taken, 0.3 + 0.1 * place)
        if spot is not None:
            notes.append(style.label(*spot, text, color, name="" if asked else "wide"))
            taken.append(label_box(notes[-1], view.shown))
    return traces, notes


def stiffness_lines(study: JointStudy, view: MapView, taken: list[Box]) -> tuple[list[style.Trace], list[style.Annotation], str]:
    """Lines of equal dynamic stiffness of the link at SHARES of the largest on the map, labels clear of `taken`, and what they are."""
    best, lines = heights(study, view)
    if not lines:
        return [], [], ""
    traces, notes, taken = [], [], list(taken)
    for share, (text, line) in zip(SHARES, lines, strict=True):
        traces.append(style.line(line[:, 0], line[:, 1], HEIGHT, width=1.2, text=f"dynamic stiffness of the link {text}", hoverinfo="text"))
        spot = free_spot(line[np.isfinite(line[:, 0])], len(text), view.shown, taken, 0.5 * share)
        if spot is not None:
            notes.append(style.label(*spot, text, style.SOFT, name="wide"))
            taken.append(label_box(notes[-1], view.shown))
    shares = listed([f"{100 * share:.0f}" for share in SHARES[::-1]])
    words = f" Grey lines: dynamic stiffness of the link, {shares} % of the largest, {digits(best, 'N·m/rad', 3)}."
    return traces, notes, words


def heights(study: JointStudy, view: MapView) -> tuple[float, list[tuple[str, Floats]]]:
    """The largest dynamic stiffness on the map [N m/rad], and the lines of SHARES of it with their labels; none without a link."""
    if study.link is None:
        return 0.0, []
    kps, kds = _spread(view.kp, view.whole_kp, GRID[0]), _spread(view.kd, view.whole_kd, GRID[1])
    stiffness = stiffness_on(study.region, study.link, kps, kds)
    best = float(stiffness.max(initial=0.0))
    if study.recommended is not None:  # a top between the grid's lines
        best = max(best, float(study.link.stiffness(np.array([study.recommended.kp]), np.array([study.recommended.kd]))[0]))
    if not best > 0:
        return best, []
    return best, [(digits(share * best, "N·m/rad", 3), level_line(kps, kds, stiffness, share * best)) for share in SHARES]


def _spread(shown: float, whole: float, count: int) -> Floats:
    """Grid (m,) over what is shown and a little beyond, and coarser up to `whole`."""
    near = shown * np.linspace(0.002, 1.02, count)
    return near if whole < 1.05 * shown else np.concatenate([near, np.linspace(1.02 * shown, 1.02 * whole, count // 3)[1:]])


def stiffness_on(region: PDRegion, link: LinkCase, kps: Floats, kds: Floats) -> Floats:
    """Dynamic stiffness of the link [N m/rad] on a grid (kd, kp); 0 where the loop is unstable."""
    kp, kd = (part.ravel() for part in np.meshgrid(kps, kds))
    found, stable = np.zeros(len(kp)), np.flatnonzero(region.contains(kp, kd))
    for k in range(0, len(stable), AT_A_TIME):
        some = stable[k : k + AT_A_TIME]
        found[some] = link.stiffness(kp[some], kd[some])
    return found.reshape(len(kds), len(kps))


def level_line(kps: Floats, kds: Floats, values: Floats, level: float) -> Floats:
    """Line (m, 2) on which `values` (kd, kp), straight in each half of a grid's cell, have a level: pieces with NaN between them."""
    spots = np.stack(np.broadcast_arrays(kps[None, :], kds[:, None], values), axis=2)
    low_left, low_right, high_left, high_right = spots[:-1, :-1], spots[:-1, 1:], spots[1:, :-1], spots[1:, 1:]
    halves = np.concatenate([np.stack([low_left, other, high_right], axis=2).reshape(-1, 3, 3) for other in (low_right, high_left)])
    above = halves[:, :, 2] >= level
    halves, above = halves[above.any(axis=1) & ~above.all(axis=1)], above[above.any(axis=1) & ~above.all(axis=1)]
    # The corner that is on its own side; the line runs from one of its edges to the other.
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    every = np.arange(len(halves))
    line = np.full((len(halves), 3, 2), np.nan)
    for end in (0, 1):
        start, stop = halves[every, alone], halves[every, (alone + 1 + end) % 3]
        part = (level - start[:, 2]) / (stop[:, 2] - start[:, 2])
        line[:, end] = start[:, :2] + part[:, None] * (stop - start)[:, :2]
    return line.reshape(-1, 2)


def required_lines(study: JointStudy, view: MapView) -> list[tuple[str, list[Floats]]]:
    """Line of each required margin, by its label."""
    asked = [(level, text) for level, text, _, _, required in _levels(study.system.requirements) if required]
    return [(text, [opened(outline) for outline in outlines(replace(study.region, required=level), view)]) for level, text in asked]


def _levels(asked: Requirements) -> list[tuple[Requirements, str, str, str, bool]]:
    """Contours to draw: (one requirement, label, colour, dash, True if asked for), at the required or the default level."""
    result = []
    for one, (color, dash) in zip(REQUIREMENTS.values(), itertools.cycle(LINES), strict=False):
        value = asked.needed.get(one.name, one.usual)
        if value is None or not one.in_closed_form(value):  # not asked for, or not known as a line
            continue
        text = f"{one.heading} {margin_value(asked, one.name, value, None, 3)}"
        result.append((Requirements(**{one.name: value}), text, color, dash, one.name in asked.needed))
    return result


def opened(outline: Floats) -> Floats:
    """Outline without its edge along the first line kp = const and along kd = 0, which are no contours."""
    line = outline.copy()
    first = line[:, 0] == line[:, 0].min()
    line[(line[:, 1] <= 0) | (first & np.roll(first, 1) & np.roll(first, -1))] = np.nan
    return line[:-1] if first[0] and first[-1] else line
