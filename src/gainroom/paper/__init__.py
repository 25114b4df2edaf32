"""The paper, row by row.

Jung, Hwang, Lee, Sim and Park, "Analysis of Position Tracking in Torque Control of Humanoid Robots Considering Joint Elasticity and
Time Delay", Humanoids 2017.

Every number is computed when it is asked for. A further figure, table or claim is one more module, and its line in FIGURES.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from ..errors import GainroomError
from ..robot.body import library
from ..studies.progress import Progress, quiet
from . import claim2, claim3, claim4, com_motion, eq4, eq10, fig4, fig5, fig6, fig7, fig9, fig11, fig13, locked_output, table1, testbed
from .picture import Picture
from .row import Row

LIBRARIES = {"pinocchio": "Pinocchio", "mujoco": "MuJoCo"}


@dataclass(frozen=True)
class Figure:
    """A figure, table, equation or claim: what computes its rows and its pictures, and the LIBRARIES that this needs."""

    title: str
    rows: Callable[[], Iterable[Row]]
    pictures: Callable[[], Iterable[Picture]] = tuple
    needs: tuple[str, ...] = ()


ROBOT, IN_TIME = ("pinocchio",), ("pinocchio", "mujoco")
FIGURES = (
    Figure("Fig. 4: elasticity", fig4.rows, fig4.pictures),
    Figure("Fig. 5: load inertia", fig5.rows, fig5.pictures),
    Figure("Fig. 6: the delay in a log of torque steps, simulated", fig6.rows, fig6.pictures),
    Figure("Fig. 7: delay", fig7.rows, fig7.pictures),
    Figure("Eq. (4): reference, noise and disturbance", eq4.rows),
    Figure("Fig. 9: the open loop with PD control", fig9.rows, fig9.pictures),
    Figure("Testbed: the stiffness by locked output, simulated", locked_output.rows, locked_output.pictures),
    Figure("Testbed: how large the gains can be", testbed.rows, testbed.pictures),
    Figure("Fig. 11: the two trials, simulated", fig11.rows, fig11.pictures),
    Figure("Fig. 12: the centre of mass under PD, in MuJoCo", com_motion.pd_rows, partial(com_motion.pictures, "pd"), IN_TIME),
    Figure("Fig. 13: what P/PI buys at equal robustness", fig13.rows),
    Figure("Fig. 14: the centre of mass under P/PI, in MuJoCo", com_motion.ppi_rows, partial(com_motion.pictures, "ppi"), IN_TIME),
    Figure("Eqs. (5) to (10): gains between joints and operational space", eq10.rows, needs=ROBOT),
    Figure("Table I: joint gains of centre-of-mass control", table1.rows, table1.pictures, ROBOT),
    Figure("Claim 2: the motor's inertia decides", claim2.rows, claim2.pictures),
    Figure("Claim 2 on the biped: every joint by itself", claim2.biped_rows, needs=ROBOT),
    Figure("Claim 3: a large load cannot track", claim3.rows, claim3.pictures, ROBOT),
    Figure("Claim 4: limits in operational space", claim4.rows, claim4.pictures, ROBOT),
)
"""Figures in the paper's order."""


@dataclass(frozen=True)
class Reproduced:
    """Figure as reproduced here."""

    title: str
    rows: tuple[Row, ...]
    pictures: tuple[Picture, ...]


@dataclass(frozen=True)
class Reproduction:
    """Reproduction of all figures, in the paper's order; `warnings` name omissions and their remedies."""

    figures: tuple[Reproduced, ...]
    warnings: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[Row, ...]:
        return tuple(row for figure in self.figures for row in figure.rows)


def run_reproduction(progress: Progress = quiet) -> Reproduction:
    """Compute every figure; those of the whole robot only where Pinocchio is installed, those in time where MuJoCo is, too.

    progress   is given figures done, figures in all, the next one's title
    """
    warnings, wanted = [], FIGURES
    for name, title in LIBRARIES.items():
        try:
            library(name, title)
        except GainroomError as error:
            left_out = ", ".join(figure.title.partition(":")[0] for figure in wanted if name in figure.needs)
            warnings += [f"{left_out} left out: {error}"] if left_out else []
            wanted = tuple(figure for figure in wanted if name not in figure.needs)
    found = []
    for index, figure in enumerate(wanted):
        progress(index, len(wanted), figure.title.partition(":")[0])
        found.append(Reproduced(figure.title, (*figure.rows(),), (*figure.pictures(),)))
    return Reproduction(tuple(found), tuple(warnings))


__all__ = ["Picture", "Reproduction", "Row", "run_reproduction"]
