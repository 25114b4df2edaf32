"""Spans in which no locus meets the negative real axis: against eigenvalues of random passive joints, and the joint that is tight."""

from math import inf

import numpy as np
import pytest

import gainroom as gr
from draws import draw_plant, log_uniform
from gainroom.analysis.gain_limit import coupled_limit
from gainroom.analysis.loci import Sweep
from gainroom.analysis.passive_intervals import PER_DECADE, passive_intervals
from gainroom.system.plant import Compliance


def draw_controller(rng: np.random.Generator, size: int):
    kd = 10 ** rng.uniform(-0.5, 1.5, size)
    kp = kd * 10 ** rng.uniform(0.3, 1.8, size)
    kind = rng.integers(3)
    if kind == 0:
        return gr.PD(np.where(rng.random(size) < 0.2, 0.0, kp), np.append(kd[:-1], 0.0) if rng.random() < 0.2 else kd)
    return gr.PID(kp, kp * rng.uniform(0, 0.5), kd) if kind == 1 else gr.PPI(kp / kd, kd, rng.uniform(0, 0.5) * kd)


def draw_loop(seed: int) -> gr.Loop:
    """Two to five joints, some closed into a loop or on springs, each with its own drive."""
    rng = np.random.default_rng([41, seed])
    size = int(rng.integers(2, 6))
    plant = draw_plant(rng, size, rank=size - int(rng.integers(0, 2)), rigid=int(rng.integers(0, 2)))
    if rng.random() < 0.3:
        root = rng.normal(size=(size + 1, size + 1))
        whole = root @ root.T / size
        soft = Compliance(whole[:size, size:], whole[size:, size:], np.array([2e4]), np.array([20.0]))
        plant = gr.Plant(whole[:size, :size], plant.motor_inertia, plant.stiffness, plant.damping, compliance=soft)
    drives = [gr.Drive(log_uniform(rng, 500, 6000), rng.uniform(0.2, 1.1), log_uniform(rng, 1e-4, 5e-3)) for _ in range(size)]
    return gr.build_loop(plant, drives, draw_controller(rng, size))


def test_draws_are_worth_looking_at():
    """Most of the loops below are passive somewhere, and none is passive everywhere."""
    spans = [passive_intervals(draw_loop(seed), 1e-2, 1e4) for seed in range(60)]
    assert sum(len(span) > 0 for span in spans) > 40
    assert all(np.sum(np.log10(span[:, 1] / span[:, 0])) < 5.9 for span in spans)


@pytest.mark.parametrize("seed", range(60))
def test_no_eigenvalue_is_negative_where_it_is_passive(seed):
    loop = draw_loop(seed)
    for low, high in passive_intervals(loop, 1e-2, 1e4):
        omega = np.geomspace(low, high, 400)
        values = np.linalg.eigvals(loop.response(omega))
        values = values[np.abs(values) > 1e-9 * np.abs(values).max(axis=1, keepdims=True)]  # zeros come with the sign of round-off
        assert np.all(np.abs(np.angle(-values[values.real < 0])) > 1e-9)
        assert np.angle(values).max(initial=0.0) < np.pi / 2 + 1e-6  # up to 90°, which a locus without resistance reaches: passive_angle


@pytest.mark.parametrize("seed", range(30))
def test_round_off_near_rest_is_no_turn(seed):
    """Without friction loci of PD lie below the negative real axis there by less than digits tell; put above it, they have not turned."""
    rng = np.random.default_rng([42, seed])
    size = int(rng.integers(2, 6))
    root = rng.normal(size=(size, size))
    plant = gr.Plant(root @ root.T, log_uniform(rng, 0.1, 2.0), log_uniform(rng, 1e3, 1e5), 1.0)
    kd = 10 ** rng.uniform(-0.5, 1.5, size)
    drive = gr.Drive(log_uniform(rng, 500, 6000), rng.uniform(0.2, 1.1), log_uniform(rng, 1e-4, 5e-3))
    sweep = Sweep(gr.build_loop(plant, drive, gr.PD(5 * kd, kd)), for_limit=True)
    counts = [sweep.unstable(gain) for gain in (0.1, 1.0)]
    assert sweep.passive[0]
    assert near_the_axis(sweep).any()
    sweep.loci[:1] = np.where(near_the_axis(sweep), sweep.loci[:1].conj(), sweep.loci[:1])
    assert [sweep.unstable(gain) for gain in (0.1, 1.0)] == counts


def near_the_axis(sweep: Sweep):
    """Loci of the lowest sample that are, to 0.05 rad, on the negative real axis."""
    return np.abs(np.angle(-sweep.loci[:1])) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_factors_of_passive_frequencies_are_no_limit(seed):
    """With the span's samples in place and without, the same limit: found from the loci alone, followed through every frequency."""
    loop = draw_loop(seed)
    lean, full = gr.gain_limit(loop), coupled_limit(Sweep(loop))
    assert lean.stable == full.stable
    assert lean.gain == pytest.approx(full.gain, rel=1e-9)
    assert lean.lower_gain == pytest.approx(full.lower_gain, rel=1e-9, abs=1e-12, nan_ok=True)
    if 0 < lean.gain < inf:
        assert lean.frequency == pytest.approx(full.frequency, rel=1e-7)
        assert not any(low < lean.frequency < high for low, high in passive_intervals(loop, 1e-2, 1e4))


def test_the_span_of_rigid_joints_ends_at_their_crossover():
    """A rigid free joint turns by exactly −90° in A: its locus is on the axis where ψ = −90°, so no wider span is true."""
    drive, law = gr.Drive(3000.0, 0.8, 2e-3), gr.PD(400.0, 20.0)
    crossover = gr.margins(gr.build_loop(gr.ElasticJoint(0.3, 0.9), drive, law)).phase_crossover
    loop = gr.build_loop(gr.Plant(np.diag([1 / 0.9, 2.0]), np.array([0.3, 0.2]), inf), drive, law)
    ((low, high),) = passive_intervals(loop, 1e-2, 1e4)
    assert low == 1e-2
    assert crossover * 10 ** (-1.5 / PER_DECADE) < high < crossover


@pytest.mark.parametrize(
    "change",
    [
        {"controller": gr.PD(np.array([[300.0, 9.0], [9.0, 300.0]]), 20.0)},
        {"controller": gr.PD(300.0, 20.0, notches=(gr.Notch(300.0),))},
        {"controller": gr.PD(300.0, 20.0, velocity_filter=gr.LowPass(900.0))},
        {"feedback": "link"},
        {"sample_time": 1e-3},
        {"joint": gr.Plant(np.eye(2), np.full(2, 0.3), 5e3, 1.0, gravity_stiffness=np.diag([5.0, -5.0]))},
    ],
    ids=["full gains", "notch", "velocity filter", "link side", "sampled", "gravity"],
)
def test_nothing_is_claimed_beyond_the_proof(change):
    setup = {"joint": gr.Plant(np.eye(2), np.full(2, 0.3), 5e3, 1.0), "drive": gr.Drive(3000.0), "controller": gr.PD(300.0, 20.0)}
    assert len(passive_intervals(gr.build_loop(**setup), 1e-2, 1e4)) == 1
    assert len(passive_intervals(gr.build_loop(**(setup | change)), 1e-2, 1e4)) == 0
