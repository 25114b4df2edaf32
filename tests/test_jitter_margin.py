"""The jitter margin: closed forms, the small-gain bound on dense grids, and delays that vary in exact simulations."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.design.margin_slopes import GainCase, moved
from gainroom.files.joint_yaml import parse_joint
from gainroom.system.jitter_margin import TOLERANCE, height_at, width_below
from independent.joint import PDJoint, polynomials
from independent.varying_delay import PARTS, Sampled, adversaries, drawn, growth, random_loop


def built(one: PDJoint, tick: float | None) -> gr.Loop:
    joint = gr.ElasticJoint(one.motor_inertia, one.link_inertia, one.stiffness, one.damping)
    return gr.build_loop(joint, gr.Drive(one.bandwidth, one.damping_ratio, one.delay), gr.PD(one.kp, one.kd), sample_time=tick)


def test_an_integrator_with_a_delay():
    """L = k e^{−sT}/s: |T| ω = k/|1 + k e^{−jωT}/(jω)|, at its peak over a dense grid; without a delay k, as ω → ∞."""
    k, delay = 20.0, 0.02
    loop = gr.loop_from(_lti([k], [1.0, 0.0]), delay=delay)
    omega = np.linspace(1e-3, 1e3, 400_001)  # above, |T| ω is below k/(1 − k/ω)
    height = (k / np.abs(1 + k * np.exp(-1j * omega * delay) / (1j * omega))).max()
    found = gr.jitter_margin(loop)
    assert found.certified
    assert found.width == pytest.approx(1 / height, rel=1e-6)  # the grid's step is 1e-4 of the peak's width
    plain = gr.jitter_margin(gr.loop_from(_lti([k], [1.0, 0.0])))
    assert plain.width == pytest.approx(1 / k, rel=1e-9)
    assert plain.certified
    assert math.isinf(plain.frequency)


def _lti(numerator: list[float], denominator: list[float], dt: float | None = None):
    from scipy import signal

    return signal.TransferFunction(numerator, denominator) if dt is None else signal.TransferFunction(numerator, denominator, dt=dt)


def test_a_sampled_integrator():
    """L = a/(z − 1): T = a/(z − 1 + a), so that |z − 1||T| is a |z − 1|/|z − 1 + a|, largest at z = −1: 2a/(2 − a) per tick."""
    tick, a = 0.01, 0.4
    found = gr.jitter_margin(gr.loop_from(_lti([a], [1.0, -1.0], tick)))
    ticks = (2 - a) / (2 * a)  # 2: delays may vary by two whole ticks
    assert found.certified
    assert found.width == pytest.approx(ticks * tick, rel=1e-9)
    assert found.frequency == pytest.approx(math.pi / tick)


def test_width_and_height_are_inverse():
    """At whole ticks N, and below one, the weight is N itself; between them its square is linear."""
    tick = 1e-3
    for ticks, weight in ((1.0, 1.0), (3.0, 3.0), (0.25, 0.25), (2.5, math.sqrt(0.5 * (4 + 9)))):
        assert height_at(ticks * tick, tick) == pytest.approx(1 / (weight * tick), rel=1e-12)
        assert width_below(1 / (weight * tick), tick) == pytest.approx(ticks * tick, rel=1e-12)
    assert width_below(250.0, None) == 1 / 250
    assert height_at(0.004, None) == 250.0


def pulse_response(one: PDJoint, omega: np.ndarray) -> np.ndarray:
    """P C at jω, from the equations of motion."""
    below, above, _ = polynomials(one)
    s = 1j * omega
    return np.polyval(above[::-1], s) / np.polyval(below[::-1], s)


def height_on_a_grid(loop: Sampled, omega: np.ndarray) -> np.ndarray:
    """The weighted complementary sensitivity by its definition: sums over 2·100 + 1 aliases."""
    one, tick = loop.joint, loop.tick
    shifted = omega[:, None] + 2 * np.pi / tick * np.arange(-100, 101)
    plant = pulse_response(one, shifted)
    held = (1 - np.exp(-1j * shifted * tick)) / (1j * shifted * tick)
    sampled = (plant * held * np.exp(-1j * shifted * one.delay)).sum(axis=1)
    control = one.kp + one.kd * (1 - np.exp(-1j * omega * tick)) / tick
    alias = np.sqrt(np.abs(plant).sum(axis=1) ** 2 + tick**2 / 32 * (np.abs(shifted * plant) ** 2).sum(axis=1))
    return np.abs(np.exp(1j * omega * tick) - 1) / tick * alias * np.abs(control / (1 + sampled * control))


def test_the_bound_on_a_dense_grid():
    """Random sampled joints: the peak is that of the definition, and nothing is above it by more than is certified."""
    rng = np.random.default_rng(7)
    tried = 0
    while tried < 6:
        loop = random_loop(rng)
        own = built(loop.joint, loop.tick)
        if not gr.is_stable(own):
            continue
        tried += 1
        found = gr.jitter_margin(own)
        assert found.certified
        omega = np.geomspace(1e-3, np.pi / loop.tick, 1001)
        height = height_on_a_grid(loop, omega)
        peak = height_at(found.width, loop.tick)
        assert height.max() <= peak * (1 + TOLERANCE)
        # The aliases beyond those summed are bounded from above: at half the sample rate by up to 1 %
        assert height_on_a_grid(loop, np.array([found.frequency]))[0] == pytest.approx(peak, rel=1e-2)


def test_a_continuous_joint_with_an_undamped_resonance():
    """A pole on the axis is no obstacle to the proof, and the peak is that of a dense grid."""
    one = PDJoint(0.448, 0.35, 900.0, 0.0, 628.0, 37.9, delay=3e-3, bandwidth=4000.0)
    found = gr.jitter_margin(built(one, None))
    omega = np.geomspace(1.0, 1e5, 400_001)
    value = pulse_response(one, omega) * np.exp(-1j * omega * one.delay) * (one.kp + 1j * omega * one.kd)
    assert found.certified
    assert found.width == pytest.approx(1 / (omega * np.abs(value / (1 + value))).max(), rel=1e-6)


def test_a_narrow_peak_between_samples_is_found():
    """Two integrators, damped so little that the peak is 1e-6 of its frequency wide: T = ω₀²/(s² + 2ζω₀ s + ω₀²) + …, |T| ω ≈ ω₀/(2ζ)."""
    omega, damping = 7.3519, 1e-6
    found = gr.jitter_margin(gr.loop_from(_lti([omega**2], [1.0, 2 * damping * omega, 0.0])))
    assert found.certified
    assert found.width == pytest.approx(2 * damping / omega, rel=1e-5)  # of the closed form, ζ² is left out


def test_where_kd_closes_apart_it_is_not_known():
    joint, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    loop = gr.build_loop(joint, drive, gr.PD(1600.0, 64.0), sample_time=1e-3, kd_path=gr.GainPath(5e-4, 2.5e-4))
    with pytest.raises(gr.GainroomError, match="the jitter margin is not known"):
        gr.jitter_margin(loop)


def test_loops_that_are_not_coupled_have_the_least_of_their_margins():
    """In continuous time, and sampled up to what few aliases leave out, below 1 %."""
    drive = gr.Drive(4000.0, 0.9, 2e-3)
    for tick, share in ((None, 1e-6), (1e-3, 1e-2)):
        alone = []
        for inertia, kp, kd in ((1.0, 1600.0, 64.0), (0.02, 40.0, 1.2)):
            joint = gr.ElasticJoint(inertia, 4 * inertia, 1e4 * inertia, inertia)
            alone.append(gr.jitter_margin(gr.build_loop(joint, drive, gr.PD(kp, kd), sample_time=tick)))
        inertia = np.array([1.0, 0.02])
        plant = gr.Plant(np.diag(1 / (4 * inertia)), inertia, 1e4 * inertia, inertia)
        loop = gr.build_loop(plant, drive, gr.PD(np.array([1600.0, 40.0]), np.array([64.0, 1.2])), sample_time=tick)
        found = gr.jitter_margin(loop)
        assert found.width == pytest.approx(min(one.width for one in alone), rel=share)
        assert not found.certified


def test_coupled_loops_in_other_units_have_the_same_margin():
    """Torques of each joint have a scaling of their own; at the best one, units do not matter, and near it they hardly do."""
    inverse, drive = np.array([[1.0, 0.6], [0.6, 1.0]]), gr.Drive(4000.0, 0.9, 2e-3)
    found = []
    for unit in (np.ones(2), np.array([1.0, 30.0])):  # the second joint's angle counted in 1/30 rad
        plant = gr.Plant(inverse * unit[:, None] * unit, 0.5 / unit**2, 2e4 / unit**2, 4 / unit**2)
        loop = gr.build_loop(plant, drive, gr.PD(900 / unit**2, 30 / unit**2), sample_time=1e-3)
        assert gr.is_stable(loop)
        found.append(gr.jitter_margin(loop).width)
    assert found[1] == pytest.approx(found[0], rel=0.02)


def trial(loop: Sampled, width: float, count: int, seed: int) -> float:
    """Largest growth over random and adversarial sequences of delays within `width` [s], above the constant one or to both sides."""
    steps = math.floor(PARTS * width / loop.tick * (1 + 1e-9))
    period = 2 * np.pi / max(gr.jitter_margin(built(loop.joint, loop.tick)).frequency, 1e-9) / loop.tick
    lags, ticks, worst = {0, min(steps // 2, loop.steps)}, loop.ticks, 0.0
    for lag in lags:
        delays, several = adversaries(steps, period, lag)
        worst = max(worst, float(growth(loop, delays, several, ticks, seed).max()))
    if count:
        worst = max(worst, float(growth(loop, drawn(steps, count, ticks, seed), count, ticks, seed).max()))
    return worst


def stable_loops(seed: int, count: int) -> list[Sampled]:
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        loop = random_loop(rng)
        if loop.ticks <= 4000 and gr.is_stable(built(loop.joint, loop.tick)):  # longer runs take too long
            found.append(loop)
    return found


@pytest.mark.slow
def test_delays_that_vary_within_the_margin_do_not_destabilise():
    """A few loops; three times the margin of the last one does, so that the simulation can tell."""
    for loop in stable_loops(3, 3):
        width = gr.jitter_margin(built(loop.joint, loop.tick)).width
        assert trial(loop, width, 45, 1) < 1
    assert trial(loop, 3 * width, 0, 1) > 1


@pytest.mark.population
def test_delays_of_many_loops():
    """200 loops, each with 1,000 random and 40 adversarial sequences of delays as wide as its margin: none grows."""
    for number, loop in enumerate(stable_loops(11, 200)):
        own = gr.jitter_margin(built(loop.joint, loop.tick))
        assert own.certified
        assert trial(loop, own.width, 1000, number) < 1, loop


@pytest.mark.parametrize("tick", [None, 1e-3])
def test_gains_that_keep_it_are_known_in_closed_form(tick: float | None):
    """The region of gains is that of the margin itself, on both sides of its edge: where |T|'s weight is above and below the ceiling."""
    joint, drive, needed = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3), 4e-3
    region = gr.pd_region(joint, drive, jitter_margin=needed, sample_time=tick)
    met = []
    for kp in np.geomspace(100.0, 6000.0, 5).tolist():
        for low, high in region.columns(kp)[0].tolist():
            for kd, inside in ((low * 1.001, True), (high * 0.999, True), (low * 0.999, False), (high * 1.001, False)):
                loop = gr.build_loop(joint, drive, gr.PD(kp, kd), sample_time=tick)
                assert (gr.is_stable(loop) and gr.jitter_margin(loop).width >= needed) is inside
                met.append(inside)
    assert len(met) >= 8


def test_recommended_gains_keep_it_and_would_not_without():
    joint, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    usual = gr.Requirements.usual().needed
    for asked, least, most in ((usual, 0.0, 3.5e-3), ({**usual, "jitter_margin": 4e-3}, 4e-3, 4.1e-3)):
        found = gr.recommend_pd(joint, drive, gr.Requirements(**asked), sample_time=1e-3)
        assert found is not None
        width = gr.jitter_margin(gr.build_loop(joint, drive, found.controller, sample_time=1e-3)).width
        assert least * (1 - 1e-6) <= width < most


def test_a_file_s_jitter_asks_for_the_margin():
    """And so do its limits; the larger of both is required."""
    text = "joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1e4, damping: 1.0}\n"
    text += "drive: {bandwidth: .inf, delay_ms: 2%s}\ncontrol: {type: pd, feedback: motor, kp: 1600, kd: 64}\n%s"
    usual = gr.Requirements.usual().needed
    for jitter, limits, needed in (
        ("", "", usual),
        (", jitter_ms: 0.5", "", {**usual, "jitter_margin": 0.5e-3}),
        (", jitter_ms: 0", "limits: {peak_sensitivity: 2}\n", {"peak_sensitivity": 2.0}),
        (", jitter_ms: 0.5", "limits: {peak_sensitivity: 2, jitter_margin_ms: 0.8}\n", {"peak_sensitivity": 2.0, "jitter_margin": 0.8e-3}),
        (", jitter_ms: 0.9", "limits: {peak_sensitivity: 2, jitter_margin_ms: 0.8}\n", {"peak_sensitivity": 2.0, "jitter_margin": 0.9e-3}),
    ):
        assert parse_joint(text % (jitter, limits), "joint.yaml").requirements.needed == pytest.approx(needed)


def test_slopes_of_coupled_loops():
    """What a search goes by: at the samples, and predicted a little away from them."""
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    drive, eye = gr.Drive(4000.0, 0.9, 2e-3), np.eye(2)

    def loop(gains):
        return gr.build_loop(plant, drive, gr.PD(gains[0], gains[1]), sample_time=1e-3)

    case = GainCase("bench", loop, eye, eye, np.zeros(2, dtype=bool), gr.Requirements(jitter_margin=5e-3))
    gains, step = np.array([[900.0, 700.0], [40.0, 30.0], [0.0, 0.0]]), np.array([[0.002, -0.001], [-0.003, 0.001]])
    after = moved(gains, step, case.cascade)
    here, there = (np.log(5e-3 / gr.jitter_margin(loop(one)).width) for one in (gains, after))
    slopes = case.slopes(gains)
    assert slopes is not None
    assert slopes.name == ("jitter_margin",)
    assert slopes.missed[0] == pytest.approx(here, abs=1e-6)
    assert there - here == pytest.approx(float((slopes.slope[0] * step).sum()), rel=0.05)  # second order: 0.003² beside 6e-4
    case.anchor(gains)
    assert case.follows(after)
    assert case.followed(after).missed[0] == pytest.approx(there, abs=0.02 * abs(there - here))
    assert case.breaks(moved(gains, np.full((2, 2), 0.1), case.cascade)) == "jitter_margin"
