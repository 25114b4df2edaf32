"""The delay reserve: closed forms, dense grids of the textbook's |T|, and loops that are given the extra delay."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.margins import margins
from gainroom.cli import main
from gainroom.design.margin_slopes import GainCase, moved
from gainroom.files.joint_yaml import parse_joint
from gainroom.system.delay_reserve import delay_reserve, reserve_about
from independent.varying_delay import random_loop

JOINT = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0)
DRIVE = gr.Drive(4000.0, 0.9, 2e-3)
TEXT = """\
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1.0e+4, damping: 1.0}
drive: {bandwidth: 4000, damping_ratio: 0.9, delay_ms: 2.0}
control: {type: pd, kp: 1600, kd: 150, feedback: motor, sample_rate_hz: 2000}
limits: {peak_sensitivity: 2, delay_reserve_ms: %s}
"""


def on_a_grid(complementary: np.ndarray, omega: np.ndarray) -> float:
    """The largest τ with |T| times the worst |1 − e^(−jωt)| of all t up to τ at most 1, by bisection over the definition."""
    low, high = 0.0, 100.0
    for _ in range(45):
        middle = 0.5 * (low + high)
        factor = np.where(omega * middle < math.pi, np.abs(1 - np.exp(-1j * omega * middle)), 2.0)
        low, high = (middle, high) if (complementary * factor).max() <= 1 else (low, middle)
    return low


def test_an_integrator_with_a_delay():
    """L = k e^{−sT}/s, whose T has |T|² = k²/(ω² + k² − 2 k ω sin ωT)."""
    from scipy import signal

    k, delay = 20.0, 0.02
    found = delay_reserve(gr.loop_from(signal.TransferFunction([k], [1.0, 0.0]), delay=delay))
    omega = np.linspace(1e-3, 200.0, 400_001)  # beyond, |T| < ½
    size = k / np.sqrt(omega**2 + k**2 - 2 * k * omega * np.sin(omega * delay))
    assert found.certified
    assert found.width == pytest.approx(on_a_grid(size, omega), rel=1e-7)  # second order in the grid's step, 5e-4 of a rad/s beside 30


def test_without_a_delay_an_integrator_has_the_closed_form():
    """L = k/s: |T| = 1/√(1 + x²), x = ω/k; |T| ≥ ½ up to x = √3, and k τ is the least of (2/x) arcsin(√(1 + x²)/2)."""
    from scipy import signal

    x = np.linspace(0.5, math.sqrt(3), 4_000_001)
    least = (2 / x * np.arcsin(np.minimum(np.sqrt(1 + x**2) / 2, 1.0))).min()
    found = delay_reserve(gr.loop_from(signal.TransferFunction([5.0], [1.0, 0.0])))
    assert found.width == pytest.approx(least / 5.0, rel=1e-8)
    assert found.certified


def test_a_loop_that_no_delay_disturbs_has_an_endless_one():
    """|T| of L = 0.3/(s + 1) is below ½ everywhere; of L = 3/(s + 1) it is not."""
    from scipy import signal

    small, large = (delay_reserve(gr.loop_from(signal.TransferFunction([gain], [1.0, 1.0]))) for gain in (0.3, 3.0))
    assert math.isinf(small.width)
    assert math.isnan(small.frequency)
    assert 0 < large.width < math.inf


@pytest.mark.slow
def test_random_joints_on_a_dense_grid_and_with_the_extra_delay():
    """Continuous and sampled: the certified value is that of 2·10⁵ frequencies, and no more than the delay margin."""
    rng, tried = np.random.default_rng(5), 0
    while tried < 20:
        drawn = random_loop(rng)
        one, tick = drawn.joint, drawn.tick
        joint = gr.ElasticJoint(one.motor_inertia, one.link_inertia, one.stiffness, one.damping)
        drive = gr.Drive(one.bandwidth, one.damping_ratio, one.delay)
        for step in (None, tick):
            loop = gr.build_loop(joint, drive, gr.PD(one.kp, one.kd), sample_time=step)
            if not gr.is_stable(loop):
                continue
            tried += 1
            found = delay_reserve(loop)
            omega = np.geomspace(1e-2, 1e5 if step is None else math.pi / step, 200_000)
            value = loop.response(omega)
            assert found.certified
            assert found.width == pytest.approx(on_a_grid(np.abs(value / (1 + value)), omega), rel=1e-4)  # (4e-5/ζ)², ζ ≥ 0.005
            assert found.width <= margins(loop).delay_margin * (1 + 1e-9)


def test_loops_that_are_not_coupled_have_the_least():
    """And coupled ones are stable with delays of their own up to it; in other units of a joint it is the same."""
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    law = gr.PD(np.array([900.0, 700.0]), np.array([40.0, 30.0]))
    both = delay_reserve(gr.build_loop(plant, DRIVE, law, sample_time=1e-3)).width
    for one, other in ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0), (0.4, 1.0)):
        late = [gr.Drive(4000.0, 0.9, 2e-3 + share * 0.999 * both) for share in (one, other)]
        assert gr.is_stable(gr.build_loop(plant, late, law, sample_time=1e-3))
    apart = gr.Plant(np.diag([1.0, 2.0]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    alone = [
        delay_reserve(gr.build_loop(gr.ElasticJoint(0.5, 1 / w, 1e4, 2.0), DRIVE, gr.PD(kp, kd), sample_time=1e-3)).width
        for w, kp, kd in ((1.0, 900.0, 40.0), (2.0, 700.0, 30.0))
    ]
    found = delay_reserve(gr.build_loop(apart, DRIVE, law, sample_time=1e-3)).width
    assert found == pytest.approx(min(alone), rel=1e-5)  # sampled to 1e-3 of a frequency about its peak: second order


def test_two_paths_of_one_delay_and_rate():
    """Σ |L_p S| on a grid, by the textbook's hold: e^(−jω(T + h/2)) sin(ωh/2)/(ωh/2), each path at its own h and T."""
    host, drive, kp, kd = (5e-4, 2e-3), (5e-5, 1e-4), 2400.0, 150.0
    loop = gr.build_loop(JOINT, DRIVE, gr.PD(kp, kd), sample_time=host[0], kd_path=gr.GainPath(drive[1], drive[0]))
    omega = np.geomspace(1e-1, math.pi / drive[0], 400_000)
    s = 1j * omega
    spring = 1e4 + s
    plant = (16 * s**2 + spring) / (s**2 * (16 * s**2 + 17 * spring)) / ((s / 4000) ** 2 + 1.8 * s / 4000 + 1)
    held = [np.exp(-s * (late + step / 2)) * np.sinc(omega * step / 2 / math.pi) for step, late in (host, drive)]
    parts = [kp * plant * held[0], kd * (1 - np.exp(-s * drive[0])) / drive[0] * plant * held[1]]
    shares = [np.abs(part / (1 + parts[0] + parts[1])) for part in parts]
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        late = [np.minimum(omega * middle * rate, math.pi) for rate in (1.0, drive[1] / host[1])]
        most = np.sum([share * np.abs(1 - np.exp(-1j * angle)) for share, angle in zip(shares, late, strict=True)], axis=0).max()
        low, high = (middle, high) if most <= 1 else (low, middle)
    assert delay_reserve(loop).width == pytest.approx(low, rel=1e-5)  # the grid's step is 3e-5 of a frequency
    with pytest.raises(gr.GainroomError, match="drive has none"):
        delay_reserve(gr.build_loop(JOINT, gr.Drive(4000.0, 0.9, 0.0), gr.PD(kp, kd), sample_time=5e-4, kd_path=gr.GainPath(1e-4, 5e-5)))


@pytest.mark.parametrize("tick", [None, 1e-3])
def test_gains_that_keep_it_are_known_in_closed_form(tick: float | None):
    """The region of gains is that of the reserve itself, on both sides of its edge."""
    needed = 4e-3
    region = gr.pd_region(JOINT, DRIVE, delay_reserve=needed, sample_time=tick)
    met = []
    for kp in np.geomspace(100.0, 6000.0, 5).tolist():
        for low, high in region.columns(kp)[0].tolist():
            for kd, inside in ((low * 1.001, True), (high * 0.999, True), (low * 0.999, False), (high * 1.001, False)):
                loop = gr.build_loop(JOINT, DRIVE, gr.PD(kp, kd), sample_time=tick)
                assert (gr.is_stable(loop) and delay_reserve(loop).width >= needed) is inside
                met.append(inside)
    assert len(met) >= 8


def test_slopes_of_coupled_loops():
    """What a search goes by, against the reserve of the gains after a small step."""
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    eye = np.eye(2)

    def loop(gains):
        return gr.build_loop(plant, DRIVE, gr.PD(gains[0], gains[1]), sample_time=1e-3)

    gains, step = np.array([[900.0, 700.0], [40.0, 30.0], [0.0, 0.0]]), np.array([[0.002, -0.001], [-0.003, 0.001]])
    needed = delay_reserve(loop(gains)).width
    case = GainCase("bench", loop, eye, eye, np.zeros(2, dtype=bool), gr.Requirements(delay_reserve=needed))
    after = loop(moved(gains, step, case.cascade))
    slopes = case.slopes(gains)
    assert slopes is not None
    assert slopes.missed[0] == pytest.approx(0.0, abs=1e-9)
    change = math.log(needed / delay_reserve(after).width)
    assert change == pytest.approx(float((slopes.slope[0] * step).sum()), rel=0.05)  # second order: 0.003² beside 1e-3
    assert reserve_about(after, delay_reserve(loop(gains))) == pytest.approx(delay_reserve(after).width, rel=1e-4)  # second order


def test_a_file_asks_for_it_and_joint_simulate_and_recommendation_keep_it(tmp_path: Path, capsys):
    """The reserve of these gains is 4.1 ms: 3 ms are met, 8 ms are not, and gains with 8 ms are recommended."""
    for needed, status in ((3.0, 0), (8.0, 1)):
        path = tmp_path / "joint.yaml"
        path.write_text(TEXT % needed, "utf-8")
        assert main(["joint", str(path), "--json"]) == status
        found = json.loads(capsys.readouterr().out)
        own = parse_joint(TEXT % needed, "joint.yaml")
        assert own.requirements.needed == pytest.approx({"peak_sensitivity": 2.0, "delay_reserve": 1e-3 * needed})
        assert found["required"]["delay_reserve_ms"] == needed
        assert found["delay_reserve_ms"] == pytest.approx(1e3 * delay_reserve(own.loop()).width)
        assert found["recommended"]["margins"]["delay_reserve_ms"] >= needed * (1 - 1e-6)
        assert ("delay_reserve" in found["unmet"]) is bool(status)
        assert main(["simulate", str(path), "--json"]) == status
        assert ("delay_reserve" in capsys.readouterr().out) is bool(status)
