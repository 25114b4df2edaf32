"""Simulated seconds per second of computing: linear stepping of one joint and of many, and the testbed."""

import numpy as np

import gainroom as gr
from gainroom.simulation import Spline

from .measure import spread
from .table import Table

TICK = 5e-4
DURATION = 10.0  # [s]
AIM = 1000.0  # times faster than real time, one joint stepped exactly


def run(seed: int) -> Table:
    """One row per system; `seed` draws the coupled plant."""
    drive = gr.Drive(4000.0, 0.9, 2.174e-3)
    joint = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0)
    one = gr.build_loop(joint, drive, gr.PD(1600.0, 70.0), sample_time=TICK)
    root = np.random.default_rng(seed).normal(size=(12, 12))
    plant = gr.Plant(np.eye(12) + root @ root.T / 50, 0.2, 1e4, 1.0)
    twelve = gr.build_loop(plant, drive, gr.PD(300.0, 10.0), sample_time=TICK)
    rubbing = gr.Friction(1.0, 1.5, 0.05)
    scenario = gr.Scenario(Spline.move(0.3, 1.0), DURATION)
    rows = []
    for name, system, aim in (
        ("one joint, linear", one, AIM),
        ("12 coupled joints, linear", twelve, None),
        ("testbed without friction", gr.Testbed(one), None),
        ("testbed with friction on both sides and gravity", gr.Testbed(one, rubbing, rubbing, gravity=11.5), None),
    ):
        taken = spread(lambda system=system: gr.simulate(system, scenario))
        rows.append({"system": name, "times real time": DURATION / taken.median, "at least": aim, **taken.cells(limited=False)})
    return Table("Simulation", rows, [f"{DURATION:g} s at {1 / TICK:g} Hz, everything from the scenario to the response included."])
