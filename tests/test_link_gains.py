"""Recommended gains of a joint: no gains that meet the requirements have a dynamically stiffer link, on grids worked out here."""

import math

import numpy as np
import pytest

import gainroom as gr

BANDWIDTH, CURRENT_DAMPING = 4000.0, 0.9
GM, PM, MS = 2.0, math.pi / 6, 2.0  # 6 dB, 30°, 2


def torque_per_position(s, delay, step):
    """What kp and kd of a PD put on the motor per position, each (k,)."""
    late = BANDWIDTH**2 / (s * s + 2 * CURRENT_DAMPING * BANDWIDTH * s + BANDWIDTH**2) * np.exp(-s * delay)
    if step is None:
        return late, late * s
    late = late * (1 - np.exp(-s * step)) / (s * step)
    return late, late * (1 - np.exp(-s * step)) / step


def random_joint(rng):
    """Joint with resonance 3 to 100 Hz, inertia ratio 0.1 to 30, damping 0 to 5 %, delay 0.5 to 10 ms, continuous or sampled."""
    link, ratio = 1.0, 10 ** rng.uniform(-1, math.log10(30))
    motor, mode = link / ratio, 2 * math.pi * 10 ** rng.uniform(math.log10(3), 2)
    stiffness = mode**2 / (1 / link + 1 / motor)
    damping = 2 * rng.choice([0.0, rng.uniform(0, 0.05)]) * stiffness / mode
    delay, step = 10 ** rng.uniform(math.log10(5e-4), -2), rng.choice([None, 5e-4, 1e-3, 2e-3])
    return {"motor_inertia": motor, "link_inertia": link, "stiffness": stiffness, "damping": damping}, delay, step


def on_grid(joint, delay, step, kp, kd):
    """Dynamic stiffness and least distance of L from −1 at gains (g,), from frequencies alone."""
    k, b = joint["stiffness"], joint["damping"]
    held, free = math.sqrt(k / joint["link_inertia"]), math.sqrt(k * (1 / joint["link_inertia"] + 1 / joint["motor_inertia"]))
    fine = np.concatenate([np.linspace(-0.08, 0.08, 80), -np.geomspace(1e-7, 0.01, 40), np.geomspace(1e-7, 0.01, 40)])
    omega = np.concatenate([np.geomspace(1e-3 * held, max(30 * free, 30 / delay), 700), held * (1 + fine), free * (1 + fine)])
    omega = np.sort(omega if step is None else omega[omega < math.pi / step])
    s = 1j * omega
    a, c = torque_per_position(s, delay, step)
    fed = kp[:, None] * a + kd[:, None] * c
    spring = k + s * b
    motor, link = joint["motor_inertia"] * s * s + spring, joint["link_inertia"] * s * s + spring
    held_load = 1.0 if step is None else np.abs((1 - np.exp(-s * step)) / (s * step))
    compliance = np.abs((motor + fed) / ((motor + fed) * link - spring**2)) * held_load
    distance = np.abs(1 + fed * link / (motor * link - spring**2))
    return 1 / compliance.max(axis=1), distance.min(axis=1)


def check(joint, delay, step):
    found = gr.recommend_pd(gr.ElasticJoint(**joint), gr.Drive(BANDWIDTH, CURRENT_DAMPING, delay), sample_time=step)
    if found is None:
        nothing_meets(joint, delay, step)
        return
    assert found.certificate.startswith("exact")

    def loop(kp, kd):
        return gr.build_loop(gr.ElasticJoint(**joint), gr.Drive(BANDWIDTH, CURRENT_DAMPING, delay), gr.PD(kp, kd), sample_time=step)

    asked, own = gr.Requirements.usual(), gr.dynamic_stiffness(loop(found.kp, found.kd)).least
    assert asked.met_by(gr.margins(loop(found.kp, found.kd)))
    assert own == pytest.approx(found.stiffness, rel=5e-3)  # what the search may miss of a peak between its frequencies, 3e-3, and more
    kp, kd = (part.ravel() for part in np.meshgrid(found.kp * np.geomspace(0.02, 20, 70), found.kd * np.geomspace(0.05, 8, 70)))
    stiffness, distance = on_grid(joint, delay, step, kp, kd)  # of a peak narrower than its frequencies too large
    better = np.flatnonzero((stiffness > 1.01 * own) & (distance > 0.999 / MS))
    drive = gr.Drive(BANDWIDTH, CURRENT_DAMPING, delay)
    allowed = gr.pd_region(gr.ElasticJoint(**joint), drive, GM, PM, MS, sample_time=step).contains(kp[better], kd[better])
    for k in better[allowed][np.argsort(-stiffness[better[allowed]])].tolist():
        one = loop(kp[k], kd[k])
        if asked.met_by(gr.margins(one)):
            assert gr.dynamic_stiffness(one).least <= 1.01 * own, (joint, delay, step, found.kp, found.kd, kp[k], kd[k])


def nothing_meets(joint, delay, step):
    """No gains down to 1e-4 of J/T² meet the requirements: an undamped gearbox that the delay turns. Less is as good as none."""
    scale = joint["motor_inertia"] / delay
    kp, kd = (part.ravel() for part in np.meshgrid(scale / delay * np.geomspace(1e-4, 10, 61), scale * np.geomspace(1e-4, 10, 61)))
    _, distance = on_grid(joint, delay, step, kp, kd)
    for k in np.flatnonzero(distance > 1 / MS).tolist():
        loop = gr.build_loop(gr.ElasticJoint(**joint), gr.Drive(BANDWIDTH, CURRENT_DAMPING, delay), gr.PD(kp[k], kd[k]), sample_time=step)
        assert not (gr.is_stable(loop) and gr.Requirements.usual().met_by(gr.margins(loop)))


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 300))])
def test_no_gains_on_a_grid_have_a_stiffer_link(seed):
    check(*random_joint(np.random.default_rng(seed)))


def test_a_region_beside_an_undamped_resonance():
    """Between two samples the shadow of the disk breaks off and begins again, where the resonance turns L past it."""
    parts = gr.ElasticJoint(2.3915386, 1.0, 191629.66, 0.0), gr.Drive(BANDWIDTH, CURRENT_DAMPING, 1.42622e-3)
    region = gr.pd_region(*parts, peak_sensitivity=2.0)
    omega = np.concatenate([np.linspace(300.0, 700.0, 15_000), np.geomspace(1.0, 3000.0, 5000)])
    for kp in (3000.0, 3700.0, 4130.0):
        for kd in np.linspace(150.0, 270.0, 25):
            height = float((1 / np.abs(1 + gr.build_loop(*parts, gr.PD(kp, kd)).response(omega))).max())
            if abs(height - 2) > 2e-4:  # what lies between the frequencies
                assert region.contains(kp, kd) == (height < 2), (kp, kd, height)
