"""All margins of coupled loops, and limits of unstable ones, from a cold start; the peer reads what it can from eigenvalues on a grid."""

import math
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np

import gainroom as gr
from gainroom.files.robot_yaml import load_robot_system

from .disk import coupled_joints
from .measure import once, spread
from .table import Table

POINTS = 20_000  # frequencies of the grid, over six decades: between two of them phases of the biped err by up to 0.1 degree
SAMPLE_TIME = 5e-4
TOO_HIGH = 8.0  # factor on stable gains: how far a loop is beyond its limit


def run(seed: int) -> Table:
    """One row per loop and tool; `seed` draws the joints."""
    table = Table("All margins of coupled loops, and limits of unstable ones")
    biped = load_robot_system(Path(str(files("gainroom").joinpath("files", "examples", "biped.yaml"))))
    states = [biped.loop(biped.source.linearize(*state)) for state in biped.source.states]
    joints = coupled_joints(12, 2e-3, seed)
    apart = [replace(drive, delay=drive.delay * (1 + 0.1 * k)) for k, drive in enumerate(_parts(joints).drives)]
    cases = {
        f"biped, {len(states)} states": states,
        "12 joints, continuous": [joints],
        "12 joints, a delay per joint": [_rebuilt(joints, drives=apart)],
        "12 joints, 2000 Hz": [_rebuilt(joints, sample_time=SAMPLE_TIME)],
    }
    for name, loops in cases.items():
        taken = spread(lambda loops=loops: [gr.margins(_rebuilt(one)) for one in loops], 3.0)
        found = [gr.margins(one) for one in loops]
        phase, peak = min(abs(one.phase_margin) for one in found), max(one.peak_sensitivity for one in found)
        certified = "yes" if all(one.certified for one in found) else "NO"
        table.rows.append(_row(name, "gainroom", taken.cells(), 1.0, phase, peak, certified))
        on_grid = [_on_grid(one) for one in loops]
        other = once(lambda loops=loops: [_on_grid(one) for one in loops])
        phase, peak = min(one[0] for one in on_grid), max(one[1] for one in on_grid)
        table.rows.append(_row(name, f"numpy, {POINTS} points", other.cells(), other.median / taken.median, phase, peak, ""))
    for name, loop in {"12 joints": joints, "12 joints, 2000 Hz": _rebuilt(joints, sample_time=SAMPLE_TIME)}.items():
        high = loop.scaled(TOO_HIGH * gr.gain_limit(loop).gain)
        taken = spread(lambda high=high: gr.gain_limit(high), 3.0)
        limit = gr.gain_limit(high)
        row = _row(
            f"limit below unstable gains, {name}", "gainroom", taken.cells(), 1.0, math.nan, math.nan, "yes" if limit.certified else "NO"
        )
        table.rows.append(row)
    table.notes = [
        "gainroom: every margin of `gr.margins`, each polished and counted on both sides, with the disk margin; loops are built anew.",
        "The peer: eigenvalues of L and the diagonal of (I + L)⁻¹ on a grid of frequencies, the nearest phase at |λ| = 1 and the highest",
        "|S_ii| read off; no gain or delay margins of single loops, no disk margin, nothing between the points. Timed once.",
    ]
    return table


def _parts(loop: gr.Loop):
    assert loop.parts is not None
    return loop.parts


def _rebuilt(loop: gr.Loop, drives=None, sample_time: float | None = None) -> gr.Loop:
    """The loop, or one that differs in what is named, built from its plant, drives and controller."""
    parts = _parts(loop)
    step = loop.sample_time if sample_time is None else sample_time
    return gr.build_loop(parts.plant, parts.drives if drives is None else drives, parts.controller, parts.feedback, step)


def _on_grid(loop: gr.Loop) -> tuple[float, float]:
    """The least phase [rad] at which an eigenvalue of L passes the unit circle, and the highest |S_ii|, on a grid."""
    last = 1e5 if loop.sample_time is None else math.pi / loop.sample_time
    omega = np.geomspace(1e-6 * last, last, POINTS)
    response = loop.response(omega).reshape(POINTS, loop.size, loop.size)
    loci = np.linalg.eigvals(response)
    near = np.abs(np.log(np.abs(loci))) < 3 * math.log(omega[1] / omega[0])
    phase = np.abs(np.angle(-loci[near])).min(initial=math.inf)
    sensitivity = np.linalg.inv(np.eye(loop.size) + response)
    return float(phase), float(np.abs(np.diagonal(sensitivity, axis1=1, axis2=2)).max())


def _row(name: str, tool: str, cells: dict, ratio: float, phase: float, peak: float, certified: str) -> dict:
    figures = {"phase margin [°]": None if math.isnan(phase) else math.degrees(phase), "Ms": None if math.isnan(peak) else peak}
    return {"loop": name, "tool": tool, **cells, "ratio": ratio, **figures, "certified": certified}
