"""What is drawn, as numbers: panels of curves and marks above each other over one axis. drawing.py turns them into plotly's format."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..linear.arrays import Complexes, Floats
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

    kind   0, 1, 2 … tells sorts of marks apart
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
    drawn = [(name, *_response(loop)) for name, loop in loops.items()]
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
    """|L(jω)| [dB] of a scalar loop."""
    return float(20 * np.log10(np.abs(loop.response(omega).item())))


def _response(loop: Loop) -> tuple[Floats, Floats, Floats]:
    """omega [rad/s], magnitude [dB] and phase [°]; the phase is the sum of its roots' angles, hence continuous without unwrapping."""
    system = loop.scalar
    assert system is not None
    omega = _grid(np.concatenate([system.zeros, system.poles]), system.delay)
    phase = np.full(len(omega), 0.0 if system.gain > 0 else -np.pi) - omega * system.delay
    for roots, sign in ((system.zeros, 1), (system.poles, -1)):
        phase += sign * np.angle(1j * omega[:, None] - roots).sum(axis=1)
    return omega, 20 * np.log10(np.abs(system.response(omega))), np.degrees(phase)


def _grid(roots: Complexes, delay: float) -> Floats:
    """Frequencies over AXIS, dense around each resonance; past ten turns of the delay's phase the curves are off the paper's axes."""
    parts = [np.geomspace(*AXIS, 400)]
    for root in roots[roots.imag > 0]:
        parts.append(root.imag + max(abs(root.real), 1e-4 * root.imag) * np.sinh(np.linspace(-7, 7, 61)))
    if delay:
        parts.append(np.linspace(0.1 / delay, 20 * np.pi / delay, 300))
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= AXIS[0]) & (omega <= AXIS[1])]
