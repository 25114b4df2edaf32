"""Figures as numbers: panels of curves and marks above each other over one axis. drawing.py turns them into plotly's format."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..report.bode import response
from ..system.linear.arrays import Floats
from ..system.loop import Loop

AXIS = (1.0, 1e5)  # [rad/s] of every Bode plot in the paper


@dataclass(frozen=True)
class Curve:
    """y over x, both (k,); its name is in the legend. `filled`: what it encloses is shaded."""

    name: str
    x: Floats
    y: Floats
    filled: bool = False


@dataclass(frozen=True)
class Mark:
    """A point with its name on a `side` of it: "left", "right", "above", "below", or two of them.

    kind   0, 1, 2 … selects the marker
    stem   height that a bar runs to from the point
    """

    x: float
    y: float
    name: str = ""
    kind: int = 0
    side: str = "right"
    stem: float | None = None


@dataclass(frozen=True)
class Panel:
    """Curves and marks between two heights.

    band     heights between which a claim holds
    levels   heights with a line across the panel
    step     between ticks; None: any
    """

    title: str
    heights: tuple[float, float]
    curves: tuple[Curve, ...] = ()
    marks: tuple[Mark, ...] = ()
    band: tuple[float, float] | None = None
    levels: tuple[float, ...] = ()
    step: float | None = None
    logarithmic: bool = False


@dataclass(frozen=True)
class Picture:
    """Panels over one axis.

    kinds         names of the sorts of marks
    logarithmic   the axis; `hertz`: it is in rad/s, and stands above the panels in Hz as well
    places        names of x = 0, 1, 2 … instead of numbers
    """

    title: str
    caption: str
    x_title: str
    x_range: tuple[float, float]
    panels: tuple[Panel, ...]
    kinds: tuple[str, ...] = ()
    logarithmic: bool = False
    hertz: bool = False
    places: tuple[str, ...] = ()


def bode(
    title: str,
    caption: str,
    loops: Mapping[str, Loop],
    magnitudes: tuple[float, float],
    phases: tuple[float, float],
    marks: tuple[Mark, ...] = (),
) -> Picture:
    """Magnitude [dB] and phase [°] of scalar continuous loops by their names, over AXIS; `marks` are on the magnitudes."""
    drawn = [(name, *response(loop, *AXIS)) for name, loop in loops.items()]
    panels = (
        Panel("magnitude [dB]", magnitudes, tuple(Curve(name, omega, size) for name, omega, size, _ in drawn), marks, levels=(0.0,)),
        Panel(
            "phase [°]",
            phases,
            tuple(Curve(name, omega, phase) for name, omega, _, phase in drawn),
            levels=(-180.0,),
            step=90 if phases[1] - phases[0] < 400 else 180,
        ),
    )
    return Picture(title, caption, "frequency [rad/s]", AXIS, panels, logarithmic=True, hertz=True)


def decibels(loop: Loop, omega: float) -> float:
    """Magnitude |L(jω)| [dB] of a scalar loop."""
    return float(20 * np.log10(np.abs(loop.response(omega).item())))
