"""What a log of a joint does not tell: a delay beside the current loop's lag, and a weight beside slow drift. The intervals say so."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification.joint import identify_joint
from gainroom.identification.record import Record
from gainroom.simulation import Friction, Scenario, Testbed, simulate
from identified import coverage_bounds, holds, multisine, soft_loop
from independent.chain import Chain, multisine as chain_multisine, record

TICK = 1e-3
WIDER = 1.7  # times the half-width of a 95 % interval: 99.9 %, as a few logs show no coverage


@pytest.mark.slow
@pytest.mark.parametrize(("bandwidth", "ratio", "late"), [(900.0, 1.0, 3), (1700.0, 0.6, 1), (2500.0, 0.9, 0)])
def test_a_delay_without_a_torque_log_is_as_wide_as_the_current_loop_s_lag_leaves_it(bandwidth: float, ratio: float, late: int):
    """Nothing knows the loop's damping ratio beforehand, and where all of a delay may be the loop's lag, its interval begins at 0."""
    rows = 5000
    chain = Chain([0.1, 0.15], [600.0], [0.3], 0.1, 0.02, bandwidth=bandwidth, damping_ratio=ratio, resolution=5e-6)
    torque = 3 * chain_multisine(np.geomspace(5, 60, 50), rows, TICK, 2)
    columns = record(chain, lambda k, reading: torque[k] - 2.0 * reading, rows, TICK, late, 6)
    log = Record(np.arange(rows) * TICK, {name: columns[name] for name in ("target_torque", "motor_position")}, TICK)
    delay = identify_joint(log).parameters["delay"]
    assert delay.low >= 0
    assert delay.half_width > 0.01 * TICK
    assert abs(late * TICK - delay.value) < WIDER * delay.half_width


WEIGHT = 0.5
SEEDS = 100


def weighted(resonance: float, ratio: float, seed: int) -> tuple[gr.ElasticJoint, Record]:
    """A soft joint with a weight, on slow motion of 0.3 rad for 5 s, and its log."""
    motor = 0.05
    stiffness = (2 * math.pi * resonance) ** 2 * motor * ratio / (1 + ratio)
    joint = gr.ElasticJoint(motor, motor * ratio, stiffness, 0.04 * stiffness / (2 * math.pi * resonance))
    time = np.arange(5000) * TICK
    torque = 15 * motor * (1 + ratio) * multisine(np.random.default_rng(seed), time, np.geomspace(0.4 * resonance, 2 * resonance, 50))
    loop = soft_loop(joint, gr.Drive(2000.0, 0.9, 2 * TICK), 0.4, 0.7, TICK)
    bed = Testbed(loop, motor_friction=Friction(0.03, 0.035, 0.05), gravity=WEIGHT, motor_resolution=4e-6, substep=TICK / 4)
    run = simulate(bed, Scenario(0.3 * np.sin(2 * np.pi * 0.4 * time)[:, None], time[-1], feedforward=torque[:, None], limit=50.0))
    return joint, Record(run.time, {"actual_torque": run.actual_torque[:, 0], "motor_position": run.motor_reading[:, 0]}, TICK)


@pytest.mark.slow
@pytest.mark.parametrize(("resonance", "ratio", "seed"), [(9.0, 5.9, 1), (14.0, 0.7, 2), (7.0, 2.0, 3)])
def test_a_weight_is_told_by_slow_motion_alone(resonance: float, ratio: float, seed: int):
    """In fast motion the weight is a spring; taken for none it puts link inertia and stiffness off by 2 and 1 W/K, here 0.3 to 0.8 %."""
    joint, log = weighted(resonance, ratio, seed)
    found = identify_joint(log).parameters
    assert abs(found["weight_sine"].value - WEIGHT) < WIDER * found["weight_sine"].half_width
    for name in ("link_inertia", "stiffness"):
        assert abs(found[name].value - getattr(joint, name)) < WIDER * found[name].half_width
        assert found[name].value == pytest.approx(getattr(joint, name), rel=WEIGHT / joint.stiffness / 2)


@pytest.mark.population
@pytest.mark.timeout(3600)
def test_a_weight_s_interval_holds_as_often_as_it_says():
    """The interval held in 98 of 99 logs made so; with a weight that was no spring in fast motion, and bent no gearbox, hardly any did."""
    held = [holds(identify_joint(weighted(14.0, 0.7, seed)[1]).parameters["weight_sine"], WEIGHT) for seed in range(SEEDS)]
    assert np.mean(held) >= coverage_bounds(SEEDS)[0]
