"""What is drawn, as numbers: curves and marks. page.py turns them into pictures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..system.loop import Loop

Array = NDArray[np.float64]

AXIS = (1.0, 1e5)  # [rad/s] of every Bode plot in the paper


@dataclass(frozen=True)
class BodeCurve:
    """A response over omega [rad/s] (k,): magnitude [dB] (k,), phase by continuity [deg] (k,)."""

    label: str
    omega: Array
    magnitude: Array
    phase: Array


@dataclass(frozen=True)
class Mark:
    """A named frequency on curve number `curve`: at `magnitude` [dB], with a `stem` up to 0 dB where it shows a margin.

    above   whether there is room for the label above the curve rather than below
    """

    curve: int
    omega: float
    magnitude: float
    label: str
    stem: bool = False
    above: bool = True


@dataclass(frozen=True)
class BodePicture:
    """Magnitude and phase over one frequency axis, in the paper's ranges [dB], [deg]."""

    id: str
    title: str
    caption: str
    curves: tuple[BodeCurve, ...]
    marks: tuple[Mark, ...]
    magnitude_range: tuple[float, float]
    phase_range: tuple[float, float]


@dataclass(frozen=True)
class GainPoint:
    """A pair of gains and what was seen there."""

    kp: float
    kd: float
    label: str
    stable: bool


@dataclass(frozen=True)
class GainPicture:
    """Stability boundaries in the kp–kd plane: (label, outline (m, 2)) each, the first one's inside shaded; and points."""

    id: str
    title: str
    caption: str
    outlines: tuple[tuple[str, Array], ...]
    points: tuple[GainPoint, ...]
    kp_range: tuple[float, float]
    kd_range: tuple[float, float]


@dataclass(frozen=True)
class Curve:
    """y over x, both (k,), with its name, if it needs one, at x = `named_at` on one `side` of the line as with Spot."""

    label: str
    x: Array
    y: Array
    named_at: float
    side: str = "above"


@dataclass(frozen=True)
class Spot:
    """A point of interest with its name to the "left", "right", "above" or "below"; `kind` 0, 1, 2 … tells sorts of points apart."""

    x: float
    y: float
    label: str
    kind: int = 0
    side: str = "right"


@dataclass(frozen=True)
class Panel:
    """One picture of several above each other; `band`: heights between which a claim holds."""

    title: str
    heights: tuple[float, float]
    curves: tuple[Curve, ...]
    spots: tuple[Spot, ...] = ()
    band: tuple[float, float] | None = None
    logarithmic: bool = False


@dataclass(frozen=True)
class CurvePicture:
    """Panels over one logarithmic axis, or a linear one; `kinds` names the sorts of spots."""

    id: str
    title: str
    caption: str
    x_title: str
    x_range: tuple[float, float]
    panels: tuple[Panel, ...]
    kinds: tuple[str, ...] = ()
    logarithmic: bool = True


@dataclass(frozen=True)
class Dots:
    """One sort of dots, one value per line of the picture, NaN where it has none."""

    label: str
    values: Array


@dataclass(frozen=True)
class DotPicture:
    """Factors, line by line, on a logarithmic axis with 1 marked; `band`: what counts as agreeing."""

    id: str
    title: str
    caption: str
    x_title: str
    x_range: tuple[float, float]
    lines: tuple[str, ...]
    series: tuple[Dots, ...]
    band: tuple[float, float] | None = None


Picture = BodePicture | GainPicture | CurvePicture | DotPicture


def bode_curve(label: str, loop: Loop) -> BodeCurve:
    """The curve of a scalar continuous loop; its phase is the sum of its roots' angles, hence continuous without unwrapping."""
    system = loop.scalar
    assert system is not None
    omega = _grid(np.concatenate([system.zeros, system.poles]), system.delay)
    value = np.abs(system.response(omega))
    phase = np.full(len(omega), 0.0 if system.gain > 0 else -np.pi) - omega * system.delay
    for roots, sign in ((system.zeros, 1), (system.poles, -1)):
        phase += sign * np.angle(1j * omega[:, None] - roots).sum(axis=1)
    return BodeCurve(label, omega, 20 * np.log10(value), np.degrees(phase))


def _grid(roots: NDArray[np.complex128], delay: float) -> Array:
    """Frequencies over AXIS, dense around each resonance; past ten turns of the delay's phase the curves are off the paper's axes."""
    parts = [np.geomspace(*AXIS, 400)]
    for root in roots[roots.imag > 0]:
        parts.append(root.imag + max(abs(root.real), 1e-4 * root.imag) * np.sinh(np.linspace(-7, 7, 61)))
    if delay:
        parts.append(np.linspace(0.1 / delay, 20 * np.pi / delay, 300))
    omega = np.unique(np.concatenate(parts))
    return omega[(omega >= AXIS[0]) & (omega <= AXIS[1])]
