"""The paper, row by row.

Jung, Hwang, Lee, Sim and Park, "Analysis of Position Tracking in Torque Control of Humanoid Robots Considering Joint Elasticity and
Time Delay", Humanoids 2017.

Every number is computed when it is asked for. One module per figure, each with `rows()` and `pictures()`; a further figure is one
more module, and its name in FIGURES.
"""

from dataclasses import dataclass

from . import fig4, fig5, fig7, fig9, testbed
from .picture import Picture
from .row import Row

FIGURES = (fig4, fig5, fig7, fig9, testbed)


@dataclass(frozen=True)
class Reproduction:
    """All rows and all pictures, in the paper's order."""

    rows: tuple[Row, ...]
    pictures: tuple[Picture, ...]


def run_reproduction() -> Reproduction:
    """Compute every figure."""
    return Reproduction(
        rows=tuple(row for figure in FIGURES for row in figure.rows()),
        pictures=tuple(picture for figure in FIGURES for picture in figure.pictures()),
    )


__all__ = ["Picture", "Reproduction", "Row", "run_reproduction"]
