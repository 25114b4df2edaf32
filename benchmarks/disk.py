"""The multi-loop disk margin: gainroom over all frequencies, python-control with slycot (AB13MD) on a grid."""

import time
from importlib.util import find_spec

import numpy as np

import gainroom as gr
from gainroom.analysis.disk_margin import TOLERANCE, disk_margin

from .measure import Spread, spread
from .table import Table

POINTS = 300  # frequencies of the grid, over the five decades in which S − T moves
PADE_ORDER = 5
LIMIT = 5.0  # [ms] for 7 loops


def coupled_joints(size: int, delay: float, seed: int) -> gr.Loop:
    """A chain of joints of like size, each moved by all motors before it; gains about half of what the delay allows."""
    rng = np.random.default_rng(seed)
    mass = 0.3 * np.eye(size) + sum(np.outer(ones, ones) for ones in np.triu(rng.uniform(0.3, 0.7, (size, size)))) / size
    plant = gr.Plant(np.linalg.inv(mass), rng.uniform(0.5, 2.0, size), rng.uniform(7e3, 15e3, size), rng.uniform(0.5, 2.0, size))
    return gr.build_loop(plant, gr.Drive(4000.0, 0.9, delay), gr.PD(rng.uniform(1000, 3000, size), rng.uniform(50, 150, size)))


def run(seed: int) -> Table:
    """One row per loop and tool; `seed` draws the joints."""
    table = Table("Disk margin of several loops at once")
    for size, delay in ((7, 0.0), (7, 2e-3), (12, 2e-3), (32, 2e-3)):
        loop = coupled_joints(size, delay, seed)
        found = disk_margin(loop)
        ours = spread(lambda loop=loop: disk_margin(loop), 2.0)
        name = f"{size} joints, T {1e3 * delay:g} ms"
        table.rows.append(
            _row(name, "gainroom", ours.cells(limit=LIMIT if size == 7 else None), 1.0, found.margin, found.lower_margin, found.margin)
        )
        if size < 32 and find_spec("slycot"):  # 32 joints would take it a quarter of an hour
            answer, taken = _peer(loop)
            tool = f"control, slycot, {POINTS} points" + (f", Padé {PADE_ORDER}" if delay else "")
            table.rows.append(_row(name, tool, taken.cells(), taken.median / ours.median, answer, None, found.margin))
    table.notes = [
        f"gainroom's answer is certified to {100 * TOLERANCE:g} % over all frequencies, delay exact: no lower margin than “proved”.",
        "The grid's least value proves nothing between its points. Its states are handed over balanced: as they come, slycot's frequency",
        "response loses digits. Timed once, without the Padé step.",
    ]
    return table


def _peer(loop: gr.Loop) -> tuple[float, Spread]:
    """python-control's least disk margin on the grid, and the time that it took [s]; the loop is put together beforehand."""
    import control as ct
    from scipy.linalg import matrix_balance

    system = loop.open_loop
    assert system is not None
    assert loop.delays is not None
    opened = ct.ss(system.a, system.b, system.c, system.d)
    if loop.delays.any():
        opened = ct.series(ct.append(*[ct.ss(ct.tf(*ct.pade(delay, PADE_ORDER))) for delay in loop.delays]), opened)
    scale = matrix_balance(opened.A - opened.B @ opened.C, permute=False, separate=True)[1][0]
    balanced = ct.ss(opened.A * scale / scale[:, None], opened.B / scale[:, None], opened.C * scale, opened.D)
    omega = np.geomspace(0.1, 1e4, POINTS)
    start = time.perf_counter()
    least = ct.disk_margins(balanced, omega)[0]
    return float(least), Spread(np.array([time.perf_counter() - start]))


def _row(loop: str, tool: str, times: dict, ratio: float, margin: float, proved: float | None, exact: float) -> dict:
    return {
        "loop": loop,
        "tool": tool,
        **times,
        "ratio": ratio,
        "disk margin": round(margin, 6),
        "proved": proved,
        "off by [%]": 100 * (margin / exact - 1),
    }
