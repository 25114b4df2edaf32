"""Random joints that are not known exactly, and a search for the case in which gains break what they should keep.

The search knows nothing of how the gains were found: inner points at random, the corners, and a local minimisation (Nelder-Mead) from the
worst of them, for each requirement by itself. Each case is judged by the certified scan of that one loop, which has tests of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import inf, radians
from typing import Any

import numpy as np
from scipy.optimize import minimize

import gainroom as gr
from draws import draw_setup, log_uniform
from gainroom.analysis.margins import margins_from_scan
from gainroom.analysis.stability import scan_loop
from gainroom.system.requirements import Requirements

NAMES = ("delay", "stiffness", "link_inertia", "motor_inertia", "damping")
MET = 1e-6  # relative: gains set right on a requirement come back with the round-off of dB and degrees


@dataclass(frozen=True)
class Uncertain:
    """A joint with its drive and ranges, and what its loop has to keep."""

    joint: gr.ElasticJoint
    drive: gr.Drive
    ranges: dict[str, tuple[float, float]]
    controller: Any
    feedback: str
    sample_time: float | None
    requirements: Requirements

    @property
    def uncertainty(self) -> gr.Uncertainty:
        return gr.Uncertainty(**self.ranges)

    def recommended(self) -> Any:
        from gainroom.design.joint_gains import recommend_pd

        return recommend_pd(self.joint, self.drive, self.requirements, self.uncertainty, self.feedback, self.sample_time, self.controller)

    def loop(self, controller: Any, shares: np.ndarray) -> gr.Loop:
        """The loop at a place in the ranges, `shares` (n,) in [0, 1], equally spaced between the ends."""
        values = {name: low + share * (high - low) for (name, (low, high)), share in zip(self.ranges.items(), shares.tolist(), strict=True)}
        drive = replace(self.drive, delay=values.pop("delay", self.drive.delay))
        return gr.build_loop(replace(self.joint, **values), drive, controller, feedback=self.feedback, sample_time=self.sample_time)

    def slacks(self, controller: Any, shares: np.ndarray) -> dict[str, float]:
        """How far each requirement is kept, relative to it; < 0: broken; −inf: unstable."""
        loop, asked = self.loop(controller, shares), self.requirements
        found = margins_from_scan(loop, scan_loop(loop))  # gr.margins without the delay margin, which nothing here asks for
        if not found.stable:
            return dict.fromkeys(asked.asked, -inf)
        slacks = {}
        if asked.gain_margin is not None:
            slacks["gain_margin"] = found.gain_headroom / asked.gain_margin - 1
        if asked.phase_margin is not None:
            slacks["phase_margin"] = abs(found.phase_margin) / asked.phase_margin - 1
        if asked.peak_sensitivity is not None:
            slacks["peak_sensitivity"] = asked.peak_sensitivity / found.peak_sensitivity - 1
        return slacks


def draw_uncertain(rng: np.random.Generator) -> Uncertain:
    """Any controller, either side, continuous or sampled; one to five quantities uncertain by 2 % to a factor of 5."""
    while True:
        setup = draw_setup(rng, sampled=rng.random() < 0.4, controller=str(rng.choice(["PD", "PD", "PID", "PPI"])))
        if setup.drive.delay > 0 or setup.sample_time is not None:
            break
    joint, drive = setup.joint, setup.drive
    possible = [name for name in NAMES if not (name in ("stiffness", "damping") and np.isinf(joint.stiffness))]
    count = min(int(rng.choice([1, 2, 3, 4, 5], p=[0.2, 0.3, 0.3, 0.15, 0.05])), len(possible))
    ranges = {}
    for name in possible:
        if name not in rng.choice(possible, count, replace=False):
            continue
        value = drive.delay if name == "delay" else getattr(joint, name)
        spread = log_uniform(rng, 1.02, 5.0) if rng.random() < 0.3 else log_uniform(rng, 1.02, 1.5)
        ranges[name] = (value / spread ** rng.random(), value * spread ** rng.random())
    if not ranges:
        return draw_uncertain(rng)
    kept = Requirements.usual()
    if rng.random() < 0.3:
        kept = Requirements(10 ** (rng.uniform(3, 10) / 20), radians(rng.uniform(20, 50)), rng.uniform(1.5, 2.5))
    controller = setup.controller
    kp = abs(controller.plane_gains()[0]) or 1.0
    if isinstance(controller, gr.PID):  # ki/kp is held: slow enough for the delay that there is
        controller = replace(controller, kp=kp, ki=0.02 * kp * rng.random() / max(drive.delay, 1e-3), kd=abs(controller.kd))
    elif isinstance(controller, gr.PPI):
        controller = replace(controller, ki=0.02 * controller.kv * rng.random() / max(drive.delay, 1e-3))
    return Uncertain(joint, drive, ranges, controller, setup.feedback, setup.sample_time, kept)


def worst_found(
    slacks: Callable[[np.ndarray], dict[str, float]], size: int, rng: np.random.Generator, inner: int = 200, polished: int = 2
) -> tuple[dict[str, float], np.ndarray]:
    """The least slack of each requirement that the search finds, and the place of the least of all."""
    places = [np.array(corner) for corner in product((0.0, 1.0), repeat=size)] + list(rng.random((inner, size)))
    table = [slacks(place) for place in places]
    least: dict[str, tuple[float, np.ndarray]] = {}
    for name in table[0]:
        order = np.argsort([row[name] for row in table])[:polished]
        best = (table[order[0]][name], places[order[0]])
        for k in order if best[0] > -inf else []:
            start = np.clip(places[k], 0.02, 0.98)
            found = minimize(
                lambda place, name=name: max(slacks(np.clip(place, 0.0, 1.0))[name], -1.0), start, method="Nelder-Mead",
                options={"maxfev": 40 + 20 * size, "initial_simplex": np.vstack([start, start + 0.05 * np.eye(size)])},
            )  # fmt: skip
            if found.fun < best[0]:
                best = (float(found.fun), np.clip(found.x, 0.0, 1.0))
        least[name] = best
    return {name: value for name, (value, _) in least.items()}, min(least.values(), key=lambda one: one[0])[1]
