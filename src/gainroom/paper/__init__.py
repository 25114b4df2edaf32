"""The paper, row by row.

Jung, Hwang, Lee, Sim and Park, "Analysis of Position Tracking in Torque Control of Humanoid Robots Considering Joint Elasticity and
Time Delay", Humanoids 2017.

Every number is computed when it is asked for. One module per figure, table or claim, each with `rows()` and `pictures()`; a further one
is one more module, and its name in FIGURES, and in ON_THE_ROBOT where it needs the robot's libraries.
"""

from dataclasses import dataclass
from types import ModuleType

from ..errors import GainroomError
from ..robot.body import library
from . import claim2, claim2_biped, claim3, claim4, com_motion, eq4, eq10, fig4, fig5, fig6, fig7, fig9, fig11, table1, testbed
from .picture import Picture
from .row import Row

FIGURES = (fig4, fig5, fig6, fig7, eq4, fig9, testbed, fig11, com_motion, eq10, table1, claim2, claim2_biped, claim3, claim4)
ON_THE_ROBOT = (com_motion, eq10, table1, claim2_biped, claim3, claim4)
IN_MUJOCO = (com_motion,)


@dataclass(frozen=True)
class Reproduction:
    """All rows and all pictures, in the paper's order; `warnings` say what was left out, and what to do about it."""

    rows: tuple[Row, ...]
    pictures: tuple[Picture, ...]
    warnings: tuple[str, ...] = ()


def run_reproduction() -> Reproduction:
    """Compute every figure; those of the whole robot only where Pinocchio is installed, those in time where MuJoCo is, too."""
    left_out, warnings = _left_out()
    figures = [figure for figure in FIGURES if figure not in left_out]
    return Reproduction(
        rows=tuple(row for figure in figures for row in figure.rows()),
        pictures=tuple(picture for figure in figures for picture in figure.pictures()),
        warnings=warnings,
    )


def _left_out() -> tuple[tuple[ModuleType, ...], tuple[str, ...]]:
    """What cannot be computed here, and why in one warning."""
    try:
        library("pinocchio", "Pinocchio")
    except GainroomError as error:
        return ON_THE_ROBOT, (f"Figs. 12 and 14, eqs. (5) to (10), Table I and what the claims say about the biped are left out: {error}",)
    try:
        library("mujoco", "MuJoCo")
    except GainroomError as error:
        return IN_MUJOCO, (f"Figs. 12 and 14 are left out: {error}",)
    return (), ()


__all__ = ["Picture", "Reproduction", "Row", "run_reproduction"]
