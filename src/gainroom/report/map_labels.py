"""Labels on the gain map: where each covers no mark and no other label."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..system.linear.arrays import Floats
from . import style

PLOT = (700.0, 480.0)  # [px] that the picture has, about; on wider ones names are farther from others
LETTER, LINE = 8.0, 20.0  # [px] of a name's bold letter, and of its line
MARK = (24 / PLOT[0], 24 / PLOT[1])  # width and height of a mark, in shares of the picture
FREE = 0.03  # farthest from a frame's edge, in shares of the picture, at which nothing is labelled
HIGHER = 0.6  # what a place's height counts against its distance from where it is wanted: below, lines run together
Box = tuple[float, float, float, float]
"""Box as centre x, y, width and height, in shares of the picture."""


def overlap(one: Box, other: Box) -> float:
    """Common area of two boxes."""
    low, high = (np.array([box[:2] for box in (one, other)]) + sign * np.array([box[2:] for box in (one, other)]) for sign in (-0.5, 0.5))
    return float(np.prod(np.maximum(high.min(axis=0) - low.max(axis=0), 0.0)))


def outside(box: Box) -> float:
    """Area of a box outside the picture."""
    return box[2] * box[3] - overlap(box, (0.5, 0.5, 1.0, 1.0))


def label_box(note: style.Annotation, wide: tuple[float, float]) -> Box:
    """Box of a label in data coordinates on a picture that shows 0 to `wide` (kp, kd)."""
    width, height = len(re.sub("<[^>]*>", "", note["text"])) * LETTER, LINE
    right = note.get("xshift", 0) + {"left": 0.5, "right": -0.5}.get(note.get("xanchor", ""), 0.0) * width
    up = note.get("yshift", 0) + {"bottom": 0.5, "top": -0.5}.get(note.get("yanchor", ""), 0.0) * height
    return (note["x"] / wide[0] + right / PLOT[0], note["y"] / wide[1] + up / PLOT[1], width / PLOT[0], height / PLOT[1])


def free_side(x: float, y: float, letters: int, taken: Sequence[Box]) -> tuple[Box, dict[str, Any]]:
    """Position of a label beside its mark at (x, y), in shares of the picture: right, or where it covers least of `taken`."""
    width, height = letters * LETTER / PLOT[0], LINE / PLOT[1]
    beside, over = 11 / PLOT[0] + width / 2, 12 / PLOT[1] + height / 2
    sides = [
        ((x + beside, y, width, height), {"xanchor": "left", "xshift": 11}),
        ((x - beside, y, width, height), {"xanchor": "right", "xshift": -11}),
        ((x, y + over, width, height), {"yanchor": "bottom", "yshift": 12}),
        ((x, y - over, width, height), {"yanchor": "top", "yshift": -12}),
    ]
    return min(sides, key=lambda side: round(outside(side[0]) + sum(overlap(side[0], other) for other in taken), 6))


def free_spot(points: Floats, letters: int, wide: tuple[float, float], taken: Sequence[Box], wanted: float) -> tuple[float, float] | None:
    """Point of a line (m, 2) at which a label covers nothing of `taken` and stays in the picture, near kp = `wanted` · wide, rather high.

    None: there is none.
    """
    scaled = points / np.array(wide)
    width, height = letters * LETTER / PLOT[0], LINE / PLOT[1]
    frame = np.array([width, height]) / 2 + FREE
    good = np.flatnonzero(np.all((scaled > frame) & (scaled < 1 - frame), axis=1))
    for k in good[np.argsort(np.abs(scaled[good, 0] - wanted) - HIGHER * scaled[good, 1], kind="stable")].tolist():
        box = (float(scaled[k, 0]), float(scaled[k, 1]), width, height)
        if not any(overlap(box, other) > 0 for other in taken):
            return float(points[k, 0]), float(points[k, 1])
    return None
