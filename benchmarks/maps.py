"""A 1000 × 1000 map of stable gains: exact, and with Padé 3 and eigenvalues cell by cell.

No cell is trusted because gainroom says so: a random sample and every cell next to the boundary in some columns are decided again by an
independent algebraic count (tests/independent: Walton and Marshall's, in exact fractions and 40 digits).
"""

import time
from dataclasses import dataclass

import numpy as np

import gainroom as gr
from tests.independent import delay_roots
from tests.independent.joint import PDJoint

from .measure import Spread, spread
from .table import Table

SIZE = 1000
DRAWN = 3000  # cells
LIMIT = 0.1  # [s]
COLUMNS = 100  # in which both cells at each edge of the region are checked
PADE_ORDER, PADE_STRIDE = 3, 8  # every 8th cell in both directions is given to the eigenvalues


@dataclass(frozen=True)
class Map:
    """A joint and the window of gains, [0, kp] × [0, kd], that is mapped."""

    name: str
    joint: PDJoint
    kp: float
    kd: float

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Cell centres (SIZE,) of kp and kd."""
        share = (np.arange(SIZE) + 0.5) / SIZE
        return self.kp * share, self.kd * share

    def exact(self) -> np.ndarray:
        """(kp, kd) True where stable, from the description of the joint on."""
        joint = self.joint
        described = gr.ElasticJoint(joint.motor_inertia, joint.link_inertia, joint.stiffness, joint.damping)
        kp, kd = self.axes
        return gr.pd_region(described, gr.Drive(joint.bandwidth, joint.damping_ratio, joint.delay)).contains(kp[:, None], kd)

    def truth(self, row: int, column: int) -> bool:
        """The independent verdict on one cell."""
        kp, kd = self.axes
        return delay_roots.count_unstable(_with(self.joint, float(kp[row]), float(kd[column]))) == 0


MAPS = (
    Map("Fig. 9's joint", PDJoint(1.0, 16.0, 1e4, 1.0, 0, 0, delay=2e-3, bandwidth=4000.0), 3e5, 1000.0),
    Map("resonant joint", PDJoint(0.2, 0.8, 1e4, 1.0, 0, 0, delay=20e-3, bandwidth=4000.0), 600.0, 60.0),
)


def run(seed: int) -> Table:
    """One row per joint and tool; `seed` draws the cells that are checked."""
    table = Table(f"Stability map of {SIZE} × {SIZE} gains")
    for chart in MAPS:
        stable = chart.exact()
        ours = spread(chart.exact, 4.0)
        rows, columns = _cells_to_check(stable, np.random.default_rng(seed))
        wrong = sum(chart.truth(i, k) != stable[i, k] for i, k in zip(rows, columns, strict=True))
        table.rows.append(_row(chart, "gainroom", ours.cells("s", LIMIT), 1.0, len(rows), wrong, stable.mean()))
        guess, taken = _pade_map(chart)
        coarse = stable[PADE_STRIDE // 2 :: PADE_STRIDE, PADE_STRIDE // 2 :: PADE_STRIDE]
        whole = Spread(np.array([taken * SIZE**2 / guess.size]))
        table.rows.append(
            _row(
                chart,
                f"Padé {PADE_ORDER}, eigenvalues",
                whole.cells("s"),
                whole.median / ours.median,
                guess.size,
                int(np.sum(guess != coarse)),
                guess.mean(),
            )
        )
    table.notes = [
        f"gainroom's cells are checked by an independent algebraic count: {DRAWN} drawn (seed {seed}) and those at the "
        f"region's edges in {COLUMNS} columns.",
        f"Padé {PADE_ORDER}: one vectorised np.linalg.eigvals over every {PADE_STRIDE}th cell each way; "
        "its time is scaled up to the whole map; its cells are compared with gainroom's.",
    ]
    return table


def _cells_to_check(stable: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Row and column indices: a random sample, and both cells at each change along kd for some kp."""
    drawn = rng.integers(0, SIZE, size=(DRAWN, 2))
    some = np.sort(rng.choice(SIZE, COLUMNS, replace=False))
    place, edge = np.nonzero(stable[some, 1:] != stable[some, :-1])
    return np.concatenate([drawn[:, 0], some[place], some[place]]), np.concatenate([drawn[:, 1], edge, edge + 1])


def _pade_map(chart: Map) -> tuple[np.ndarray, float]:
    """Verdicts of the rational model on the coarse grid, and the time they took [s]."""
    import control as ct

    joint = chart.joint
    start = time.perf_counter()
    drive = ct.tf([joint.bandwidth**2], [1, 2 * joint.damping_ratio * joint.bandwidth, joint.bandwidth**2])
    lag = ct.ss(drive) * ct.ss(ct.tf(*ct.pade(joint.delay, PADE_ORDER)))
    rate = np.array([joint.stiffness, joint.damping, -joint.stiffness, -joint.damping])
    body = np.zeros((4, 4))
    body[0, 1] = body[2, 3] = 1.0
    body[1], body[3] = -rate / joint.motor_inertia, rate / joint.link_inertia
    system = ct.ss(body, [[0], [1 / joint.motor_inertia], [0], [0]], np.eye(2, 4), 0) * lag  # outputs: motor position, velocity
    kp, kd = (axis[PADE_STRIDE // 2 :: PADE_STRIDE] for axis in chart.axes)
    position, velocity = np.outer(system.B, system.C[0]), np.outer(system.B, system.C[1])
    closed = system.A - kp[:, None, None, None] * position - kd[None, :, None, None] * velocity
    stable = np.linalg.eigvals(closed).real.max(axis=-1) < 0
    return stable, time.perf_counter() - start


def _with(joint: PDJoint, kp: float, kd: float) -> PDJoint:
    from dataclasses import replace

    return replace(joint, kp=kp, kd=kd)


def _row(chart: Map, tool: str, times: dict, ratio: float, checked: int, wrong: int, share: float) -> dict:
    return {
        "joint": chart.name,
        "tool": tool,
        **times,
        "ratio": ratio,
        "cells checked": checked,
        "wrong cells": wrong,
        "wrong [%]": 100 * wrong / checked,
        "stable [%]": 100 * float(share),
    }
