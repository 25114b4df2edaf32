"""The gain limit of coupled joints from a cold start: gainroom's certified one, and bisection on a state space with Padé delays."""

import numpy as np

import gainroom as gr

from .disk import PADE_ORDER, coupled_joints
from .measure import once, spread
from .table import Table

ACCURACY = 1e-6  # relative, of the bisection: what gainroom's certificate tells apart
SAMPLE_TIME = 5e-4
LIMITS = {(12, None): 1.0, (32, None): 6.0, (12, SAMPLE_TIME): 4.0, (32, SAMPLE_TIME): 20.0}  # [ms], by joints and sample time


def run(seed: int) -> Table:
    """Two rows per loop: ours and the peer's; `seed` draws the joints."""
    table = Table("Gain limit of coupled joints, cold start")
    for size in (12, 32):
        loop = coupled_joints(size, 2e-3, seed)
        assert loop.parts is not None
        for sample_time in (None, SAMPLE_TIME):
            work = _cold(loop, sample_time)
            ours, limit = spread(work, 2.0), work()
            assert limit.certificate is not None
            name = f"{size} joints, {'continuous' if sample_time is None else f'{1 / sample_time:g} Hz'}"
            certified = "both sides" if limit.certificate.holds else "NO"
            table.rows.append(_row(name, "gainroom", ours.cells(limit=LIMITS[size, sample_time]), 1.0, limit.gain, limit.gain, certified))
            if sample_time is None:
                found = _bisected(loop)
                taken = once(lambda loop=loop: _bisected(loop))
                ratio = taken.median / ours.median
                table.rows.append(_row(name, f"bisection, Padé {PADE_ORDER}", taken.cells(), ratio, found, limit.gain, ""))
    table.notes = [
        "Cold start: loop, samples, limit, mode and certificate, nothing kept.",
        f"The peer halves to {ACCURACY:g} by numpy's eigenvalues; from python-control's state space with the delays in; timed once.",
    ]
    return table


def _cold(loop: gr.Loop, sample_time: float | None):
    parts = loop.parts
    assert parts is not None
    return lambda: gr.gain_limit(gr.build_loop(parts.plant, parts.drives, parts.controller, sample_time=sample_time))


def _bisected(loop: gr.Loop) -> float:
    """The factor at which the Padé model loses stability."""
    from control import append, pade, series, ss, tf

    system, delays = loop.open_loop, loop.delays
    assert system is not None
    assert delays is not None
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
    return high


def _row(loop: str, tool: str, times: dict, ratio: float, answer: float, exact: float, certified: str) -> dict:
    return {
        "loop": loop,
        "tool": tool,
        **times,
        "ratio": ratio,
        "gain limit": round(answer, 6),
        "off by [%]": 100 * (answer / exact - 1),
        "certified": certified,
    }
