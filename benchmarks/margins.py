"""All margins of one loop: gainroom, python-control on 2000 exact frequency points, and python-control with Padé 5 for the delay."""

import math
from collections.abc import Callable

import control as ct
import numpy as np

import gainroom as gr
from gainroom.system.margin_units import to_db

from .measure import in_turns
from .table import Table

POINTS = 2000  # over the four decades around the crossings
PADE_ORDER = 5
CONTINUOUS, SAMPLED = 0.2, 0.5  # [ms] limits


def example_loops() -> dict[str, gr.Loop]:
    """theory.md's worked example first; then other kinds of loop."""
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2.5e-3)
    heavy = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0)
    soft = gr.ElasticJoint(1.0, 3.7, 100.0, 0.73, motor_viscous=3.7, link_viscous=1.1)
    filtered = gr.PD(2000.0, 20.0, velocity_filter=gr.LowPass(1500.0, order=2), notches=(gr.Notch(250.0),))
    return {
        "testbed-like, T 2.5 ms": gr.build_loop(joint, drive, gr.PD(2000.0, 30.0)),
        "Fig. 9, T 2 ms": gr.build_loop(heavy, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(1e4, 300.0)),
        "soft, P only, T 2 ms": gr.build_loop(soft, gr.Drive(delay=2e-3), gr.PD(141.0, 0.0)),
        "PID, T 2.5 ms": gr.build_loop(joint, drive, gr.PID(1500.0, 2000.0, 25.0)),
        "filter and notch, T 2.5 ms": gr.build_loop(joint, drive, filtered),
        "testbed-like, 2 kHz": gr.build_loop(joint, gr.Drive(4000.0, 0.9, 2.2e-3), gr.PD(2000.0, 30.0), sample_time=5e-4),
        "filter and notch, 2 kHz": gr.build_loop(joint, gr.Drive(4000.0, 0.9, 2.2e-3), filtered, sample_time=5e-4),
    }


def run(seed: int) -> Table:
    """One row per loop and tool; `seed` is not used."""
    table = Table("All margins of one loop")
    for name, loop in example_loops().items():
        exact = gr.margins(loop)
        peers = _peers(loop, exact)
        times = in_turns({"gainroom": lambda loop=loop: gr.margins(loop), **peers})
        ours = times["gainroom"]
        limit = CONTINUOUS if loop.sample_time is None else SAMPLED
        table.rows.append(
            _row(name, "gainroom", ours.cells(limit=limit), 1.0, exact.gain_margin, exact.phase_margin, exact.delay_margin, exact)
        )
        for tool, work in peers.items():
            gain_margin, phase_degrees, _, _, gain_crossover, _ = work()
            phase = math.radians(phase_degrees)
            ratio = times[tool].median / ours.median
            table.rows.append(_row(name, tool, times[tool].cells(), ratio, gain_margin, phase, phase / gain_crossover, exact))
    table.notes = [
        "Delay margin of python-control: its phase margin over that crossing's frequency. gainroom's time also holds Ms, Mt, disk margin,",
        "every crossing and the proof that none is missed; sampled, the delay margin for any fraction of a tick, confirmed on both sides.",
        "Errors are relative to gainroom's value, in percent. Each loop is as it was built; its responses are not kept between calls.",
    ]
    return table


def _peers(loop: gr.Loop, exact: gr.Margins) -> dict[str, Callable[[], tuple]]:
    """Margins of python-control from equal zeros, poles and delay in its own types; only the margins are timed, with the Padé step."""
    system = loop.scalar
    assert system is not None
    places = [c.omega for c in (*exact.phase_crossings, *exact.gain_crossings) if c.omega > 0]
    middle = math.sqrt(min(places) * max(places))
    omega = np.geomspace(middle / 100, middle * 100, POINTS)
    if loop.sample_time is not None:
        omega = omega[omega < math.pi / loop.sample_time]
    points = ct.frd(loop.response(omega), omega)
    peers: dict[str, Callable[[], tuple]] = {f"control, {POINTS} points": lambda: ct.stability_margins(points)}
    if loop.sample_time is not None:
        return peers
    rational = ct.zpk(system.zeros, system.poles, system.gain)

    def with_pade() -> tuple:
        return ct.stability_margins(ct.series(rational, ct.tf(*ct.pade(system.delay, PADE_ORDER))))

    return {**peers, f"control, Padé {PADE_ORDER}": with_pade}


def _row(loop: str, tool: str, times: dict, ratio: float, gain: float, phase: float, delay: float, exact: gr.Margins) -> dict:
    return {
        "loop": loop,
        "tool": tool,
        **times,
        "ratio": ratio,
        "gain margin [dB]": to_db(gain),
        "error [%]": 100 * abs(gain / exact.gain_margin - 1) if math.isfinite(exact.gain_margin) else None,
        "phase margin [deg]": math.degrees(phase),
        "delay margin [ms]": 1e3 * delay,
        "error [%] ": 100 * abs(delay / exact.delay_margin - 1),
    }
