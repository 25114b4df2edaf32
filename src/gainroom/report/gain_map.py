"""Gain map: stable (kp, kd), those that meet the requirements, lines of equal margin, and vibration frequencies at the boundary."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..analysis.crossings import scan
from ..analysis.gain_region import PDRegion
from ..analysis.margin_record import Margins
from ..errors import at_frequency
from ..studies.joint import JointStudy
from ..system.linear.arrays import Floats
from ..system.margin_units import to_db
from . import style
from .joint_text import made_largest
from .map_labels import MARK, Box, free_side, label_box, overlap
from .map_lines import MapView, contours, opened, outlines, stiffness_lines
from .number_format import digits, frequency, hertz
from .page import Html, figure

BINS = 12  # colours along the boundary


def vibration_edge(
    region: PDRegion, stable: list[Floats], view: MapView, taken: list[Box]
) -> tuple[list[style.Trace], list[style.Annotation]]:
    """Boundary of stability, coloured by the frequency at which the joint vibrates there."""
    pieces = [opened(outline) for outline in stable]
    found = [edge_frequencies(region, piece) for piece in pieces]
    known = np.concatenate([np.zeros(0), *found])
    known = known[np.isfinite(known)]
    if not len(known):
        return [], []
    low, high = float(known.min()), float(known.max())
    start, end = (np.vstack([piece[part] for piece in pieces]) for part in (slice(None, -1), slice(1, None)))
    first, second = (np.concatenate([omega[part] for omega in found]) for part in (slice(None, -1), slice(1, None)))
    height = np.log(0.5 * (first + second) / low) / max(math.log(high / low), 1e-9)  # 0 at the lowest frequency, 1 at the highest
    drawn = []
    for index in range(BINS):
        chosen = np.flatnonzero((height >= index / BINS) & ((height < (index + 1) / BINS) | (index == BINS - 1)))
        if len(chosen):
            x, y = (np.column_stack([start[chosen, axis], end[chosen, axis], np.full(len(chosen), np.nan)]).ravel() for axis in (0, 1))
            ends = np.column_stack([first[chosen], second[chosen], np.full(len(chosen), np.nan)]).ravel()
            text = ["" if math.isnan(omega) else f"vibrates at {frequency(omega)}" for omega in ends.tolist()]
            drawn.append(style.line(x, y, _shade((index + 0.5) / BINS), width=5, text=text, hoverinfo="text"))
    candidates = [(x, y, w) for piece, omega in zip(pieces, found, strict=True) for (x, y), w in zip(piece, omega, strict=True)]
    return drawn, _frequency_labels([one for one in candidates if math.isfinite(one[2])], view, taken)


def edge_frequencies(region: PDRegion, piece: Floats) -> Floats:
    """Frequency ω of the closed-loop root on the imaginary axis at each boundary point [rad/s]; NaN where there is no point."""
    omega = np.full(len(piece), math.nan)
    index = np.flatnonzero(np.isfinite(piece[:, 1]))
    for k in index:
        phases = scan(region.scalar(*piece[k].tolist()), with_peaks=False).phases
        nearest = np.abs(np.log(phases[:, 1]))
        if len(nearest) and nearest.min() < 1e-3:
            omega[k] = phases[int(np.argmin(nearest)), 0]
    omega[omega == 0] = math.nan
    return omega


def _frequency_labels(points: list[tuple[float, float, float]], view: MapView, taken: list[Box]) -> list[style.Annotation]:
    """Frequency labels along the visible boundary, clear of `taken`."""
    notes = []
    for share, lower in ((0.12, False), (0.35, False), (0.6, False), (0.85, False), (0.66, True)):
        near = [p for p in points if abs(p[0] / view.kp - share) < 0.06 and p[1] < 0.97 * view.kd]
        if not near:
            continue
        x, y, omega = min(near, key=lambda p: p[1]) if lower else max(near, key=lambda p: p[1])
        if lower and not 0.07 * view.kd < y < 0.5 * view.kd:
            continue
        side = {"yanchor": "top", "yshift": -5} if lower else {"yanchor": "bottom", "yshift": 5}
        note = style.label(x, y, hertz(omega), style.INK, **side)
        box = label_box(note, view.shown)
        if any(overlap(box, other) > 0 for other in taken):
            continue
        taken = [*taken, box]
        notes.append(note)
    return notes


def _shade(height: float) -> str:
    """Colour from dark blue (slow) to orange (fast), with falling darkness so that it survives a grey print."""
    channels = ((20, 130, 235), (30, 60, 130), (110, 140, 30))
    return "rgb(" + ",".join(str(round(float(np.interp(height, (0, 0.5, 1), channel)))) for channel in channels) + ")"


HOVER = (15, 11)  # points of the map that show their margins
REQUIRED = "rgba(86,180,233,0.38)"


@dataclass(frozen=True)
class GainPoint:
    """Marked pair of gains."""

    name: str
    kp: float
    kd: float
    symbol: str
    color: str


def gain_map(study: JointStudy) -> Html:
    """Figure of the gain map with its caption."""
    spots = gain_points(study)
    view = around(study, spots)
    stable = outlines(study.region, view)
    of = " (nominal joint only)" if study.system.uncertainty.names else ""
    traces, notes = _stable_area(stable, view, f"stable{of}")
    if study.required_region.required.asked:
        traces += _areas(outlines(study.required_region, view), REQUIRED, f"every requirement met{of}")
    names = study.system.control.controller.plane_names
    marks, mark_notes = _marks(spots, view, names)
    taken = [*_mark_boxes(spots, view), *(label_box(note, view.shown) for note in mark_notes)]
    heights, height_notes, height_words = stiffness_lines(study, view, taken)
    taken += [label_box(note, view.shown) for note in height_notes]
    lines, line_notes = contours(study, view, taken)
    taken += [label_box(note, view.shown) for note in line_notes]
    edge, edge_notes = vibration_edge(study.region, stable, view, taken)
    traces += [_hover(study, view), *heights, *lines, *edge, *marks]
    picture = style.layout(
        xaxis=style.axis(f"{names[0]} [N·m/rad]", range=[0, view.kp], constrain="domain"),
        yaxis=style.axis(f"{names[1]} [N·m·s/rad]", range=[0, view.kd]),
        annotations=[*edge_notes, *height_notes, *line_notes, *mark_notes, *notes],
        margin={"l": 72, "r": 24, "t": 44, "b": 84},
        showlegend=True,
        legend=style.switches(-0.12, yanchor="top", itemclick=False, itemdoubleclick=False),
        updatemenus=[_zoom(view)] if view.whole_kp > 1.2 * view.kp else [],
    )
    title, caption = "Stable gains and their margins", _caption(study, height_words)
    drawn = {"data": [{"showlegend": False} | trace for trace in traces], "layout": picture}
    return figure(drawn, title, caption, 620, style.NARROW)


def gain_points(study: JointStudy) -> list[GainPoint]:
    """Marked gains: the file's, the recommended ones and the 10 Hz rule's, if they exist and lie in this plane."""
    found = []
    if study.max_kd is not None:
        kp, kd = study.system.control.controller.plane_gains()
        found.append(GainPoint("this file", float(kp), float(kd), "circle", style.BLACK))
    if study.recommended is not None:
        found.append(GainPoint("recommended", study.recommended.kp, study.recommended.kd, "star", style.BLUE))
    if not study.template.has_held_gain:  # the rule is a plain PD, which is no point of the plane of an integral controller
        found.append(GainPoint("10 Hz rule", study.rule.kp, study.rule.kd, "x", style.VERMILION))
    return found


def around(study: JointStudy, spots: list[GainPoint]) -> MapView:
    """View around the marked gains, no wider than the stable region."""
    outline = np.vstack(study.region.boundary) if study.region.boundary else np.zeros((1, 2))
    widest = max(float(outline[:, 0].max()), 1e-12)
    wanted = max(spot.kp for spot in spots)
    kp = max(1.12 * wanted, min(1.06 * widest, 2.2 * wanted))
    near = outline[outline[:, 0] <= kp]
    top = float(near[:, 1].max()) if len(near) else 0.0
    kd = 1.12 * max([top, *(spot.kd for spot in spots if spot.kd < 4 * top or top <= 0)])
    return MapView(kp, kd, max(kp, 1.04 * widest), max(kd, 1.06 * float(outline[:, 1].max())))


def _zoom(view: MapView) -> dict[str, Any]:
    """Zoom buttons: around the gains, or the whole stable region."""
    ranges = (("Around these gains", view.kp, view.kd), ("All stable gains", view.whole_kp, view.whole_kd))
    buttons = [{"label": text, "method": "relayout", "args": [{"xaxis.range": [0, kp], "yaxis.range": [0, kd]}]} for text, kp, kd in ranges]
    return {"type": "buttons", "direction": "right", "x": 0, "xanchor": "left", "y": 1.02, "yanchor": "bottom", "buttons": buttons}


def _stable_area(stable: list[Floats], view: MapView, name: str) -> tuple[list[style.Trace], list[style.Annotation]]:
    """Hatched background, and on it the stable region, named `name` in the legend."""
    kp, kd = 3 * view.whole_kp, 3 * view.whole_kd
    hatch = {"shape": "/", "fgcolor": "#b5b5b5", "bgcolor": "#efefef", "size": 9, "solidity": 0.18}
    ground = _area(np.array([[0, 0], [kp, 0], [kp, kd], [0, kd], [0, 0]]), "#efefef") | {"fillpattern": hatch}
    word = style.label(0.985, 0.985, "unstable", style.INK, xref="paper", yref="paper", xanchor="right", yanchor="top")
    seen = {"line": {"color": "#b9b28a", "width": 1}}  # in the legend, on white
    return [ground, *(area | seen for area in _areas(stable, "#fffdf3", name))], [word | {"font": {"size": 15, "color": style.INK}}]


def _areas(outlines: list[Floats], color: str, name: str) -> list[style.Trace]:
    """Traces of the parts of one area, as one legend entry."""
    legend = {"name": name, "legendgroup": name}
    return [_area(outline, color) | legend | {"showlegend": place == 0} for place, outline in enumerate(outlines)]


def _area(outline: Floats, color: str) -> style.Trace:
    return style.line(outline[:, 0], outline[:, 1], color, width=0, fill="toself", fillcolor=color, hoveron="points")


def _mark_boxes(spots: list[GainPoint], view: MapView) -> list[Box]:
    return [(spot.kp / view.kp, spot.kd / view.kd, *MARK) for spot in spots]


def _marks(spots: list[GainPoint], view: MapView, names: tuple[str, str]) -> tuple[list[style.Trace], list[style.Annotation]]:
    """Marks (dot, star, cross) with labels that cover no mark or other label; coinciding gains share one label."""
    traces, notes, named = [], [], set()
    taken = _mark_boxes(spots, view)
    for place, spot in enumerate(spots):
        text = f"<b>{spot.name}</b><br>{names[0]} {digits(spot.kp, 'N·m/rad')}<br>{names[1]} {digits(spot.kd, 'N·m·s/rad')}"
        size = 18 - 4 * place if spot.symbol != "star" else 17
        traces.append(style.markers([spot.kp], [spot.kd], spot.symbol, spot.color, size, hoverinfo="text", text=text, cliponaxis=False))
        same = [other for other in spots if math.hypot((other.kp - spot.kp) / view.kp, (other.kd - spot.kd) / view.kd) < 0.005]
        name = " = ".join(other.name for other in same)
        if name in named or spot.kp > view.kp or spot.kd > view.kd:
            continue
        named.add(name)
        others = [box for box, other in zip(taken, spots, strict=False) if other not in same] + taken[len(spots) :]
        box, side = free_side(spot.kp / view.kp, spot.kd / view.kd, len(name), others)
        taken.append(box)
        notes.append(style.label(spot.kp, spot.kd, f"<b>{name}</b>", spot.color, **side))
    return traces, notes


def _hover(study: JointStudy, view: MapView) -> style.Trace:
    """Invisible grid of points that show their margins."""
    kp, kd = ((np.arange(count) + 0.5) / count * end for count, end in zip(HOVER, (view.kp, view.kd), strict=True))
    grid_kp, grid_kd = (part.ravel() for part in np.meshgrid(kp, kd))
    stable = study.region.contains(grid_kp, grid_kd)
    texts = np.full(len(grid_kp), "unstable", dtype=object)
    index = np.flatnonzero(stable)
    felt = [math.inf] * len(index) if study.link is None else study.link.stiffness(grid_kp[index], grid_kd[index]).tolist()
    for k, found, stiffness in zip(index, study.region.margins(grid_kp[index], grid_kd[index]), felt, strict=True):
        texts[k] = _margins_text(found, stiffness)
    kp_name, kd_name = study.system.control.controller.plane_names
    words = [
        f"{kp_name} {digits(x, '', 3)}, {kd_name} {digits(y, '', 3)}<br>{text}" for x, y, text in zip(grid_kp, grid_kd, texts, strict=True)
    ]
    rows = np.array(words, dtype=object).reshape(HOVER[1], HOVER[0]).tolist()
    clear = [[0, "rgba(0,0,0,0)"], [1, "rgba(0,0,0,0)"]]
    return {
        "type": "heatmap",
        "x": kp,
        "y": kd,
        "z": stable.reshape(HOVER[1], HOVER[0]).astype(int),
        "text": rows,
        "hoverinfo": "text",
        "colorscale": clear,
        "showscale": False,
    }


def _margins_text(found: Margins, stiffness: float) -> str:
    if not found.stable:
        return "unstable"
    vibration = at_frequency(found.phase_crossover, ", vibration at ", hertz)
    return (
        f"gain margin {digits(to_db(found.gain_margin), 'dB', 3)}{vibration}"
        f"<br>phase margin {digits(math.degrees(found.phase_margin), '°', 3)}<br>Ms {digits(found.peak_sensitivity, '', 3)}"
        f"<br>dynamic stiffness of the link {digits(stiffness, 'N·m/rad', 3)}"
    )


def _caption(study: JointStudy, heights: str) -> str:
    text = "Hatched: unstable. The thick edge is coloured, and labelled, by the frequency at which the joint vibrates there."
    if study.required_region.required.asked:
        text += " Inside the blue area every requirement is met"
        text += " for the nominal joint, not over the uncertainty." if study.system.uncertainty.names else " for the nominal joint."
    kp_name, kd_name = study.system.control.controller.plane_names
    if study.recommended is not None:
        text += f" The star has the largest {made_largest(study.recommended).removeprefix('largest ')} that meets them"
        within = (
            " everywhere in the uncertain ranges (proved)."
            if study.recommended.proved
            else " in every case examined within the uncertain ranges."
        )
        text += within if study.system.uncertainty.names else "."
    if study.max_kd is not None and math.isfinite(study.max_kd):
        text += f" At this {kp_name}, {kd_name} may reach {digits(study.max_kd, 'N·m·s/rad', 3)}."
    if study.system.requirements.asked:
        text += " Coloured lines: the required margins."
    return f"{text}{heights} Hover over the map for the margins at any point."
