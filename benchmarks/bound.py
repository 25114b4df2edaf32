"""Bound that no linear controller beats, with its certificate: its time beside that of transforms, and how near the best known comes."""

from importlib.util import find_spec

import numpy as np

import gainroom as gr
from gainroom.design.comparison.best_known import best_known
from gainroom.design.comparison.bound import lower_bound
from gainroom.design.comparison.ceilings import Ceilings
from gainroom.design.comparison.exact_joint import ExactJoint

from .measure import in_turns, once
from .table import Table

TRANSFORMS, POINTS = 200, 2**16
LIMIT = 5.0  # times those transforms
COUNT = 7.67e-6 / 12**0.5  # rad, deviation of the encoder's quantisation
JOINTS = {  # and delay [s], torque noise [N m], noise of the encoder [rad]
    "Fig. 9's joint": (gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), 2e-3, 1.38, COUNT),
    "testbed": (gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), 2.174e-3, 0.142, COUNT),
    "knee": (gr.ElasticJoint(1.9546e-4 * 144**2, 16.0, 1e4, 20.0), 2e-3, 3.41, COUNT * 100 / 144),
}


def run(seed: int) -> Table:
    """One row per joint; `seed` draws the signal that is transformed."""
    table = Table("Bound of the peak compliance over all linear controllers")
    signal = np.random.default_rng(seed).normal(size=POINTS) + 0j
    for name, (described, delay, noise, deviation) in JOINTS.items():
        loop = gr.build_loop(described, gr.Drive(4000.0, 0.9, delay), gr.PD(1.0, 1.0), sample_time=5e-4)
        assert loop.parts is not None
        joint, ceilings = ExactJoint.of(loop.parts), Ceilings(delay / 2, torque_noise=noise, sensor_noise={"motor": deviation})

        def transforms() -> None:
            for _ in range(TRANSFORMS):
                np.fft.fft(signal)

        taken = in_turns({"ours": lambda joint=joint, ceilings=ceilings: lower_bound(joint, ceilings), "transforms": transforms}, 3.0)
        bound = lower_bound(joint, ceilings)
        row = {"joint": name, "bound [mrad/(N m)]": 1e3 * bound.value, "grids apart": bound.agreement, "median [s]": taken["ours"].median}
        row |= {f"of {TRANSFORMS} transforms of 2^16": taken["ours"].median / taken["transforms"].median, "at most [times]": LIMIT}
        if find_spec("clarabel"):
            known = []
            spent = once(lambda joint=joint, ceilings=ceilings, known=known: known.append(best_known(joint, ceilings)))
            row |= {"best known / bound": known[0].value / bound.value, "found in [s]": spent.median}
        table.rows.append(row)
    table.notes = [
        "Sampled at 2 kHz, exact delay; Ms 2, half of the delay in reserve, the torque noise that PD needs. Best known: a cone programme",
        "with clarabel, timed once.",
    ]
    return table
