"""The gain limit of coupled joints from a cold start: gainroom's proved one, its loci, and bisection on a state space with Padé delays."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np

import gainroom as gr
from gainroom.analysis.gain_limit import sampled_limit
from gainroom.system.controller import Controller

from .disk import PADE_ORDER, coupled_joints
from .measure import in_turns, once, spread
from .startup import g1_robot
from .table import Table

ACCURACY = 1e-6  # relative, of the bisection: what gainroom's certificate tells apart
SAMPLE_TIME = 5e-4
LIMITS = {(12, None): 1.0, (32, None): 6.0, (12, SAMPLE_TIME): 4.0, (32, SAMPLE_TIME): 20.0}  # [ms], by joints and sample time
G1_LIMIT = 40.0  # [ms]


def run(seed: int) -> Table:
    """Two rows per loop, and the peer's; `seed` draws the joints."""
    table = Table("Gain limit of coupled joints, cold start")
    for size in (12, 32):
        loop = coupled_joints(size, 2e-3, seed)
        for sample_time in (None, SAMPLE_TIME):
            name = f"{size} joints, {_rate(sample_time)}"
            ours, gain = _ours(table, name, loop, sample_time, LIMITS[size, sample_time])
            if sample_time is None:
                found = _bisected(loop)
                taken = once(lambda loop=loop: _bisected(loop))
                table.rows.append(_row(name, f"bisection, Padé {PADE_ORDER}", taken.cells(), taken.median / ours, found, gain, ""))
        if size == 12:
            _proof_beside_samples(table, loop, seed)
    if find_spec("pinocchio"):
        _ours(table, f"G1 in flight, {_rate(SAMPLE_TIME)}", _g1_in_flight(), SAMPLE_TIME, G1_LIMIT)
    table.notes = [
        "Cold start: loop, samples, limit, mode and certificate, nothing kept but the modes of a known plant, which no gains change;",
        "“new plant”: with those too. The G1: 29 elastic joints as under “Command line”.",
        f"The peer halves to {ACCURACY:g} by numpy's eigenvalues; from python-control's state space with the delays in; timed once.",
    ]
    return table


def _ours(table: Table, name: str, loop: gr.Loop, sample_time: float | None, limit: float) -> tuple[float, float]:
    """Adds two rows; median [s] of the first, and the limit."""
    parts = loop.parts
    assert parts is not None

    def work(new: bool) -> gr.GainLimit:
        plant = replace(parts.plant) if new else parts.plant
        return gr.gain_limit(gr.build_loop(plant, parts.drives, parts.controller, sample_time=sample_time))

    found = work(False)
    assert found.certificate is not None
    certified = "both sides" if found.certificate.holds else "NO"
    taken = {new: spread(lambda new=new: work(new), 2.0) for new in (False, True)}
    for new, tool in ((False, "gainroom"), (True, "gainroom, new plant")):
        ratio = taken[new].median / taken[False].median
        table.rows.append(_row(name, tool, taken[new].cells(limit=None if new else limit), ratio, found.gain, found.gain, certified))
    return taken[False].median, found.gain


def _proof_beside_samples(table: Table, loop: gr.Loop, seed: int) -> None:
    """Two rows per controller, in turns: integrators, gravity and gain matrices, whose proof begins at the gains themselves."""
    parts = loop.parts
    assert parts is not None
    for name, (plant, controller) in _harder(parts.plant, parts.controller, seed).items():
        for sample_time in (None,) if name == "gravity" else (None, SAMPLE_TIME):  # sampled, it hardly damps what swings: left to samples

            def build(plant=plant, controller=controller, sample_time=sample_time) -> gr.Loop:
                return gr.build_loop(replace(plant), parts.drives, controller, sample_time=sample_time)

            works = {
                "gainroom, new plant": lambda build=build: gr.gain_limit(build()),
                "samples": lambda build=build: sampled_limit(build()),
            }
            taken = in_turns(works, 2.0)
            found = {tool: work() for tool, work in works.items()}
            ours = found["gainroom, new plant"]
            for tool, one in found.items():
                certified = "both sides" if one.certified else "NO"
                ratio = taken[tool].median / taken["gainroom, new plant"].median
                what = f"{loop.size} joints, {name}, {_rate(sample_time)}"
                table.rows.append(_row(what, tool, taken[tool].cells(), ratio, one.gain, ours.gain, certified))


def _harder(plant: gr.Plant, controller: gr.PD, seed: int) -> dict[str, tuple[gr.Plant, Controller]]:
    """Plants and controllers by name; gains of the matrices and of the task are such that the loop is stable."""
    rng, size = np.random.default_rng([seed, 1]), plant.size
    kp, kd = (np.asarray(gain) for gain in (controller.kp, controller.kd))
    slope, jacobian = rng.normal(size=(size, size)) / np.sqrt(size), rng.normal(size=(3, size))
    inner = np.linalg.inv(np.linalg.inv(plant.link_inverse_inertia) + np.diag(plant.motor_inertia))
    torque, rates = jacobian.T @ np.linalg.inv(jacobian @ inner @ jacobian.T), np.array([0.6, 1.0, 1.4])
    shared = jacobian.T @ jacobian / size
    return {
        "PID": (plant, gr.PID(kp, 2 * kp, kd)),
        "P/PI": (plant, gr.PPI(kp / kd, kd, 2 * kd)),
        "gravity": (replace(plant, gravity_stiffness=0.05 * float(kp.min()) * (slope + slope.T)), controller),
        "gain matrices": (plant, gr.PD(1e3 * (np.eye(size) + 0.3 * shared), 70.0 * (np.eye(size) + 0.3 * shared))),
        "task of 3 directions": (plant, gr.PD(torque @ np.diag(300 * rates) @ jacobian, torque @ np.diag(15 * np.sqrt(rates)) @ jacobian)),
    }


def _rate(sample_time: float | None) -> str:
    return "continuous" if sample_time is None else f"{1 / sample_time:g} Hz"


def _g1_in_flight() -> gr.Loop:
    from gainroom.files.robot_yaml import parse_robot

    system = parse_robot(g1_robot(), "g1.yaml")
    return system.loop(system.source.linearize("stand", "flight"))


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
