"""Recordings in which nothing vibrates, and rows that a bus or an encoder spoils.

The joint's own loop is well damped, and the motion differs from that of the same run without noise, encoder steps and torque from
outside by less than one step of the encoder.
"""

import math
from dataclasses import replace

import numpy as np

from .drawn import healthy, joint_yaml, log_uniform
from .joint_run import run
from .shaking import Recording, encoder, log_of, noisy, rows, stepped

KINDS = (
    "holding",
    "creeping",
    "slow sweep",
    "sweep without set-point",
    "noise",
    "below one step",
    "steps",
    "moves without set-point",
    "policy",
    "ramp",
)


def calm_draw(rng: np.random.Generator, index: int) -> Recording | None:
    """Of the kind of that index, or None where the draw is not as it should be."""
    kind = KINDS[index % len(KINDS)]
    drawn = healthy(rng, margin=2.2, least=0.1, dampings=(0.02, 0.2))
    setup, seed = drawn.setup, int(rng.integers(1e6))
    tick, law = setup.tick, setup.law
    count = rows(setup, float(rng.uniform(4, 12)))
    time, size = np.arange(count) * tick, float(rng.uniform(0.05, 0.4))
    wanted, outside, step = np.zeros(count), None, min(encoder(rng), size / 50)
    if kind == "holding":
        wanted = stepped(count, tick, float(rng.choice([0.0, 0.05])))
    elif kind == "creeping":  # to rest, as a filtered set-point does
        wanted = size * (1 - np.exp(-time / (count * tick) * float(rng.uniform(2, 12))))
    elif kind in ("slow sweep", "sweep without set-point"):
        low, high = log_uniform(rng, 0.05, 0.3), log_uniform(rng, 0.5, 1.5)
        wanted = size * np.sin(2 * np.pi * low * time * (1 + (high / low - 1) * time / time[-1] / 2))
    elif kind == "moves without set-point":
        held = int(float(rng.uniform(0.8, 2.0)) / tick)  # between two points, without jerk at either
        part = np.minimum((np.arange(count) % held) / held * float(rng.uniform(1, 2)), 1.0)
        points, turn = rng.uniform(-size, size, count // held + 2), np.arange(count) // held
        wanted = points[turn] + (points[turn + 1] - points[turn]) * part**3 * (10 - 15 * part + 6 * part**2) - points[0]
    elif kind == "steps":
        held = int(float(rng.uniform(0.5, 1.2)) / tick)
        wanted = np.repeat(rng.uniform(-size, size, count // held + 1), held)[:count]
    elif kind == "policy":
        held = max(1, int(0.02 / tick))
        wanted = np.repeat(np.cumsum(rng.normal(0, 0.02, count // held + 1)), held)[:count]
    elif kind == "ramp":
        wanted = size * time / time[-1] * float(rng.uniform(0.3, 5))
    elif kind == "below one step":
        step = log_uniform(rng, 1e-4, 3e-3)
        most = float(rng.uniform(0.2, 0.9))  # peak to peak, of a step
        outside = np.sin(2 * np.pi * log_uniform(rng, 0.8, 0.1 / tick) * time)
        wanted = wanted + step * float(rng.uniform(-0.5, 0.5))
        alone = run(setup, np.zeros(count), outside=outside, seed=seed)
        outside *= most * step / np.ptp(alone.last)
    drawn = noisy(rng, drawn, step)
    if kind == "noise":
        drawn = drawn.with_(noise=step * float(rng.uniform(0.3, 1.0)), shaken=law.kp * step * log_uniform(rng, 0.1, 3.0))
    coulomb = float(rng.choice([0.0, 0.02])) * law.kp * size * (kind not in ("ramp", "creeping", "below one step"))
    drawn = drawn.with_(joint=replace(setup.joint, coulomb=coulomb, gravity=float(rng.choice([0.0, 0.2])) * law.kp * size))
    made = run(drawn.setup, wanted, outside=outside, seed=seed)
    plain = run(replace(drawn.setup, step=0.0, noise=0.0, shaken=0.0), wanted, seed=seed)
    if np.ptp((made.true - plain.true)[count // 3 :]) >= step:
        return None
    columns = log_of(rng, made)
    if "without" in kind:
        del columns["reference"]
    return Recording(columns, joint_yaml(rng, drawn), "quiet", kind, {"step": step})


def calm(index: int, seed: int) -> Recording:
    """The first draw of its kind that is calm."""
    rng = np.random.default_rng([seed, 2, index])
    while True:
        made = calm_draw(rng, index)
        if made is not None:
            return made


BAD = ("turn", "zeros", "spike", "nan", "repeated")


def with_bad_rows(recording: Recording, index: int, seed: int) -> Recording:
    """One to three rows spoiled, anywhere: a turn added to the position, zeros, a spike, no numbers, or the row before again."""
    rng = np.random.default_rng([seed, 3, index])
    columns = {name: values.copy() for name, values in recording.columns.items()}
    count = len(columns["time"])
    others = [name for name in columns if name != "time"]
    positions = [name for name in others if name.endswith("_position")]
    done = []
    for row in rng.choice(np.arange(3, count - 3), int(rng.integers(1, 4)), replace=False):
        kind = str(rng.choice(BAD))
        done.append(kind)
        for name in others:
            values, span = columns[name], float(np.ptp(recording.columns[name])) + 1e-6
            if kind == "zeros":
                values[row] = 0.0
            elif kind == "nan":
                values[row] = math.nan
            elif kind == "repeated":
                values[row] = values[row - 1]
            elif kind == "turn" and name in positions:
                values[row] += 2 * math.pi * float(rng.choice([-1, 1]))
            elif kind == "spike" and name == others[int(rng.integers(len(others)))]:
                values[row] += float(rng.choice([-1, 1])) * log_uniform(rng, 2, 100) * span
    return replace(recording, columns=columns, kind=f"{recording.kind}; {', '.join(done)}")
