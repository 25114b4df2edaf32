"""The gain limit of coupled joints from a cold start: gainroom's certified one, and bisection on a state space with Padé delays."""

import time

import numpy as np

import gainroom as gr

from .disk import PADE_ORDER, coupled_joints
from .measure import seconds
from .table import Table

ACCURACY = 1e-6  # relative, of the bisection: what gainroom's certificate tells apart
SAMPLE_TIME = 5e-4


def run(seed: int) -> Table:
    """Two rows per loop: ours and the peer's; `seed` draws the joints."""
    table = Table("Gain limit of coupled joints, cold start")
    for size in (12, 32):
        loop = coupled_joints(size, 2e-3, seed)
        assert loop.parts is not None
        for sample_time in (None, SAMPLE_TIME):
            work = _cold(loop, sample_time)
            ours, limit = seconds(work), work()
            assert limit.certificate is not None
            name = f"{size} joints, {'continuous' if sample_time is None else f'{1 / sample_time:g} Hz'}"
            certified = "both sides" if limit.certificate.holds else "NO"
            table.rows.append(_row(name, "gainroom", ours, ours, limit.gain, limit.gain, certified))
            if sample_time is None:
                taken, found = _bisected(loop)
                table.rows.append(_row(name, f"bisection, Padé {PADE_ORDER}", taken, ours, found, limit.gain, ""))
    table.notes = [
        "Cold start: loop, samples, limit, mode and certificate, nothing kept. Aims: 12 joints under 10 ms, 32 under 100 ms (continuous).",
        f"The peer halves to {ACCURACY:g} by numpy's eigenvalues; from python-control's state space with the delays in; timed once.",
    ]
    return table


def _cold(loop: gr.Loop, sample_time: float | None):
    parts = loop.parts
    assert parts is not None
    return lambda: gr.gain_limit(gr.build_loop(parts.plant, parts.drives, parts.controller, sample_time=sample_time))


def _bisected(loop: gr.Loop) -> tuple[float, float]:
    """Seconds, and the factor at which the Padé model loses stability."""
    from control import append, pade, series, ss, tf

    system, delays = loop.open_loop, loop.delays
    assert system is not None
    assert delays is not None
    start = time.perf_counter()
    opened = ss(system.a, system.b, system.c, system.d)
    opened = series(append(*[ss(tf(*pade(delay, PADE_ORDER))) for delay in delays]), opened)
    a, b, c = opened.A, opened.B, opened.C

    def stable(factor: float) -> bool:
        return bool(np.linalg.eigvals(a - factor * b @ c).real.max() < 0)

    low, high = 0.0, 1.0
    while stable(high):
        low, high = high, 2 * high
    while high - low > ACCURACY * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return time.perf_counter() - start, high


def _row(loop: str, tool: str, taken: float, ours: float, answer: float, exact: float, certified: str) -> dict:
    return {
        "loop": loop,
        "tool": tool,
        "time [ms]": 1e3 * taken,
        "ratio": taken / ours,
        "limit": round(answer, 6),
        "off by [%]": 100 * (answer / exact - 1),
        "certified": certified,
    }
