"""The boundary of stability in the gain map, coloured and labelled by the frequency at which the joint vibrates there."""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from ..analysis.crossings import scan_many
from ..analysis.gain_region import PDRegion
from ..linear.arrays import Floats
from . import style
from .map_lines import View, opened
from .number_format import frequency, hertz

BINS = 12  # colours along the boundary


def vibration_edge(
    region: PDRegion, stable: list[Floats], view: View, taken: list[style.Annotation]
) -> tuple[list[style.Trace], list[style.Annotation]]:
    """The boundary of stability, coloured by the frequency at which the joint vibrates there."""
    pieces = [opened(outline) for outline in stable]
    table = [(piece, _frequencies(region, piece)) for piece in pieces]
    known = np.concatenate([omega[np.isfinite(omega)] for _, omega in table]) if table else np.zeros(0)
    if not len(known):
        return [], []
    low, high = float(known.min()), float(known.max()) * (1 + 1e-9)
    traces: dict[int, tuple[list[Any], list[Any], list[Any]]] = {}
    candidates = []
    for piece, omega in table:
        for k in range(len(piece) - 1):
            pair = omega[k : k + 2]
            if not np.isfinite(pair).all():
                continue
            share = math.log(float(pair.mean()) / low) / max(math.log(high / low), 1e-9)
            xs, ys, texts = traces.setdefault(min(int(share * BINS), BINS - 1), ([], [], []))
            xs += [piece[k, 0], piece[k + 1, 0], None]
            ys += [piece[k, 1], piece[k + 1, 1], None]
            texts += [f"vibrates at {frequency(float(w))}" for w in pair] + [""]
        candidates += [(x, y, w) for (x, y), w in zip(piece, omega, strict=True) if math.isfinite(w)]
    drawn = [
        style.line(xs, ys, _shade((index + 0.5) / BINS), width=5, text=texts, hoverinfo="text")
        for index, (xs, ys, texts) in sorted(traces.items())
    ]
    return drawn, _frequency_labels(candidates, view, taken)


def _frequencies(region: PDRegion, piece: Floats) -> Floats:
    """ω of the closed-loop root on the imaginary axis at each point of the boundary; NaN where there is no point."""
    omega = np.full(len(piece), math.nan)
    index = np.flatnonzero(np.isfinite(piece[:, 1]))
    if not len(index):
        return omega
    scans = scan_many([region.scalar(*piece[k]) for k in index], with_peaks=False)
    for k, scan in zip(index, scans, strict=True):
        nearest = np.abs(np.log(scan.phases[:, 1])) if len(scan.phases) else np.zeros(0)
        if len(nearest) and nearest.min() < 1e-3:
            omega[k] = scan.phases[int(np.argmin(nearest)), 0]
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


def _shade(share: float) -> str:
    """A colour between dark blue (slow) and orange (fast), of falling darkness so that it survives a grey print."""
    stops = ((0.0, (20, 30, 110)), (0.5, (130, 60, 140)), (1.0, (235, 130, 30)))
    for (start, low), (end, high) in pairwise(stops):
        if share <= end:
            part = (share - start) / (end - start)
            return "rgb(" + ",".join(str(round(a + part * (b - a))) for a, b in zip(low, high, strict=True)) + ")"
    return "rgb(235,130,30)"
