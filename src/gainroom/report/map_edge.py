"""The boundary of stability in the gain map, coloured and labelled by the frequency at which the joint vibrates there."""

import math

import numpy as np

from ..analysis.crossings import scan
from ..analysis.gain_region import PDRegion
from ..system.linear.arrays import Floats
from . import style
from .map_lines import View, opened
from .number_format import frequency, hertz

BINS = 12  # colours along the boundary


def vibration_edge(
    region: PDRegion, stable: list[Floats], view: View, taken: list[style.Annotation]
) -> tuple[list[style.Trace], list[style.Annotation]]:
    """The boundary of stability, coloured by the frequency at which the joint vibrates there."""
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
    """ω of the closed-loop root on the imaginary axis at each point of the boundary; NaN where there is no point."""
    omega = np.full(len(piece), math.nan)
    index = np.flatnonzero(np.isfinite(piece[:, 1]))
    for k in index:
        phases = scan(region.scalar(*piece[k].tolist()), with_peaks=False).phases
        nearest = np.abs(np.log(phases[:, 1]))
        if len(nearest) and nearest.min() < 1e-3:
            omega[k] = phases[int(np.argmin(nearest)), 0]
    omega[omega == 0] = math.nan
    return omega


def _frequency_labels(points: list[tuple[float, float, float]], view: View, taken: list[style.Annotation]) -> list[style.Annotation]:
    """Frequencies written along the visible boundary, clear of the labels in `taken`."""
    notes = []
    for share, lower in ((0.12, False), (0.35, False), (0.6, False), (0.85, False), (0.66, True)):
        near = [p for p in points if abs(p[0] / view.kp - share) < 0.06 and p[1] < 0.97 * view.kd]
        if not near:
            continue
        x, y, omega = min(near, key=lambda p: p[1]) if lower else max(near, key=lambda p: p[1])
        if lower and not 0.07 * view.kd < y < 0.5 * view.kd:
            continue
        if any(-0.12 < (x - note["x"]) / view.kp < 0.24 and abs(y - note["y"]) < 0.08 * view.kd for note in taken):
            continue
        side = {"yanchor": "top", "yshift": -5} if lower else {"yanchor": "bottom", "yshift": 5}
        notes.append(style.label(x, y, hertz(omega), style.INK, **side))
    return notes


def _shade(height: float) -> str:
    """A colour between dark blue (slow) and orange (fast), of falling darkness so that it survives a grey print."""
    channels = ((20, 130, 235), (30, 60, 130), (110, 140, 30))
    return "rgb(" + ",".join(str(round(float(np.interp(height, (0, 0.5, 1), channel)))) for channel in channels) + ")"
