"""Habits in place of a computed limit, on random joints: how often they vibrate, and how far their limits are from the exact ones."""

import math

import numpy as np

import gainroom as gr
from gainroom.analysis.gain_limit import gain_limit
from gainroom.system.linear.transfer_function import Factored

from .table import Table

JOINTS, TICK = 200, 1e-3
OMEGA, DAMPING = 2 * math.pi * 10, 2.0
"""Natural frequency [rad/s] and damping ratio of the 10 Hz rule (glossary)."""


def run(seed: int, count: int = JOINTS) -> Table:
    """One row per habit, over `count` joints with motors of 0.02 to 2 kg·m²."""
    from control import pade

    rng = np.random.default_rng(seed)
    kept, ratios = [], {"rigid links": [], "Padé 1": [], "Padé 3": []}
    for _ in range(count):
        motor, load, resonance, delay = (_log_uniform(rng, *ends) for ends in ((0.02, 2.0), (0.1, 30.0), (3.0, 100.0), (5e-4, 1e-2)))
        link, omega = motor * load, 2 * math.pi * resonance
        together = motor * link / (motor + link)
        joint = gr.ElasticJoint(motor, link, omega**2 * together, 2 * rng.uniform(0, 0.05) * omega * together)
        drive, rule = gr.Drive(4000.0, 0.9, delay), gr.PD(motor * OMEGA**2, 2 * DAMPING * motor * OMEGA)
        loop = gr.build_loop(joint, drive, rule, sample_time=TICK)
        found, exact = gr.margins(loop), gain_limit(loop).gain
        kept.append((found.stable, bool(gr.Requirements.usual().met_by(found))))
        ratios["rigid links"].append(gain_limit(gr.build_loop(gr.ElasticJoint(motor, link), drive, rule, sample_time=TICK)).gain / exact)
        bare = gr.build_loop(joint, drive, rule).scalar
        assert bare is not None
        for order in (1, 3):  # half a tick of hold and half of difference, as a continuous model has them
            above, below = pade(bare.delay + TICK, order)
            zeros, poles = np.concatenate([bare.zeros, np.roots(above)]), np.concatenate([bare.poles, np.roots(below)])
            late = Factored(zeros, poles, bare.gain * above[0] / below[0], 0.0, None)
            ratios[f"Padé {order}"].append(gain_limit(gr.loop_from(late)).gain / exact)
    stable, met = np.mean(kept, axis=0)
    table = Table("What people do instead")
    table.rows.append(
        {
            "habit": "10 Hz rule of the motor's inertia",
            "what happens": f"{100 * (1 - stable):.0f} % vibrate, {100 * met:.0f} % keep the usual margins",
        }
    )
    for habit, each in ratios.items():
        low, middle, high = np.percentile(each, [0, 50, 100])
        text = f"{low:.2g} to {high:.3g} × the exact limit, in half of the joints more than {middle:.3g} ×"
        table.rows.append({"habit": HABITS[habit], "what happens": text})
    table.notes = [
        f"{count} random joints at 1 kHz: resonance 3 to 100 Hz, delay 0.5 to 10 ms, load 0.1 to 30 × the motor's inertia, damping 0 to",
        "5 %. The exact limit is a root count's on both sides.",
    ]
    return table


HABITS = {
    "rigid links": "a model without the gearbox's spring",
    "Padé 1": "the delay by Padé of order 1, continuous",
    "Padé 3": "the delay by Padé of order 3, continuous",
}


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))
