"""The public answers against exact numbers, definitions and the independent checks."""

from dataclasses import replace
from math import degrees, inf, isinf, log10, pi, sqrt

import numpy as np
import pytest
import scipy.signal

import gainroom as gr
from independent import controllers, delay_roots, margins, sampled
from independent.joint import PDJoint, random_joint
from joint_truths import EXAMPLE, FIG9, RIGID, TESTBED, TICK, build, is_stable, parts, rigid_boundary, stable_draw


def db(factor: float) -> float:
    return 20 * log10(factor)


# --- numbers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("joint", "gain_db", "omega"),
    [
        (replace(FIG9, stiffness=inf, delay=0.0), 52.08, 3970),
        (replace(FIG9, delay=0.0), 27.47, 3971),
        (replace(FIG9, stiffness=inf), 31.02, 619),
        (FIG9, 6.20, 620),
    ],
    ids=["neither", "elasticity", "delay", "both"],
)
def test_fig9(joint, gain_db, omega):
    found = gr.margins(build(joint))
    assert db(found.gain_margin) == pytest.approx(gain_db, abs=0.005)  # half the last digit
    assert found.phase_crossover == pytest.approx(omega, abs=0.5)


def test_testbed_limit():
    found = gr.margins(build(TESTBED))
    assert found.phase_crossover == pytest.approx(494.0, abs=0.05)
    assert db(found.gain_margin) == pytest.approx(0.128, abs=0.002)  # 0.1292 here; the delay is given to 1 µs only
    assert gr.is_stable(build(replace(TESTBED, kd=70)))
    assert not gr.is_stable(build(replace(TESTBED, kd=80)))


@pytest.mark.parametrize(("ticks", "largest"), [(4, 86.25), (5, 65.25), (4.348, 78.25)])
def test_testbed_sampled_kd_limit(ticks, largest):
    """These limits are the first unstable kd in steps of 0.25, so the true one lies less than a step below."""
    joint = replace(TESTBED, delay=ticks * TICK)
    limit = gr.pd_region(*parts(joint), sample_time=TICK).max_kd(joint.kp)
    assert largest - 0.25 < limit < largest
    assert sampled.is_stable(replace(joint, kd=limit * (1 - 1e-9)), TICK)
    assert not sampled.is_stable(replace(joint, kd=limit * (1 + 1e-9)), TICK)


def test_example_continuous():
    found = gr.margins(build(EXAMPLE))
    assert found.stable
    assert found.gain_margin == pytest.approx(2.5650059284821042, rel=1e-13)  # every digit, a few roundings of L apart
    assert found.phase_crossover == pytest.approx(491.792866850899, rel=1e-13)
    assert found.delay_margin == pytest.approx(1.378211634562327e-3, rel=1e-12)
    angles = [degrees(c.phase_margin) for c in found.gain_crossings]
    assert angles == pytest.approx([26.7536, -146.151, 25.7489], abs=5e-4)
    assert [c.omega for c in found.gain_crossings] == pytest.approx([45.709, 201.387, 326.076], abs=5e-4)
    assert abs(degrees(found.phase_margin)) == pytest.approx(25.7489, abs=5e-5)
    assert found.gain_crossover == pytest.approx(326.076, abs=5e-4)
    assert gr.gain_limit(build(EXAMPLE)).gain == pytest.approx(2.5650059284821042, rel=1e-12)


def test_example_sampled():
    found = gr.margins(build(EXAMPLE, TICK))
    assert found.gain_margin == pytest.approx(1.8760807, abs=1e-7)
    assert gr.gain_limit(build(EXAMPLE, TICK)).gain == pytest.approx(found.gain_margin, rel=1e-12)
    estimate = gr.margins(build(replace(EXAMPLE, delay=EXAMPLE.delay + TICK)))
    assert estimate.gain_margin == pytest.approx(1.8906, abs=5e-5)


def test_example_rightmost_root():
    roots = gr.rightmost_roots(build(EXAMPLE))
    first = roots.roots[0]
    assert complex(first.real, abs(first.imag)) == pytest.approx(-10.00435468 + 43.00809677j, abs=1e-8)


def test_roots_are_all_the_rightmost_ones():
    box = delay_roots.roots_in_box(delay_roots.characteristic(EXAMPLE), -1200 - 1j, 50 + 6000j)
    expected = box[box.imag >= -1e-6][:5]
    found = gr.rightmost_roots(build(EXAMPLE), count=2 * len(expected)).roots
    for root in expected:
        assert np.abs(found - root).min() < 1e-8 * abs(root)  # Newton on both sides
    beyond = found[found.real > expected[-1].real + 1e-6]
    assert all(np.abs(box - complex(r.real, abs(r.imag))).min() < 1e-6 * abs(r) for r in beyond)  # and no others


def test_rightmost_root_of_s_plus_exp():
    loop = gr.loop_from(scipy.signal.TransferFunction([1.0], [1.0, 0.0]), delay=1.0)
    first = gr.rightmost_roots(loop).roots[0]
    assert first.real == pytest.approx(-0.3181315052047641, abs=1e-14)
    assert abs(first.imag) == pytest.approx(1.337235701430689, abs=1e-14)
    assert gr.margins(loop).gain_margin == pytest.approx(pi / 2, rel=1e-14)  # s + g e^{-s}: ω = g = π/2
    assert gr.margins(loop).delay_margin == pytest.approx(pi / 2 - 1, rel=1e-14)  # s + e^{-sT}: T = π/2


@pytest.mark.parametrize("flavour", ["scipy tf", "scipy ss", "scipy zpk", "control tf", "control ss", "callable"])
def test_textbook_third_order(flavour):
    """25/(s³ + 10 s² + 10 s + 10): gain margin (10·10 − 10)/25 at √10."""
    num, den = [25.0], [1.0, 10.0, 10.0, 10.0]
    if flavour.startswith("control"):
        control = pytest.importorskip("control")
        system = control.tf(num, den) if flavour.endswith("tf") else control.ss(control.tf(num, den))
    elif flavour == "callable":
        system = lambda s: 25 / (s**3 + 10 * s**2 + 10 * s + 10)  # noqa: E731
    else:
        system = scipy.signal.TransferFunction(num, den)
        system = {"tf": system, "ss": system.to_ss(), "zpk": system.to_zpk()}[flavour[6:]]
    found = gr.margins(gr.loop_from(system))
    assert found.stable
    assert found.gain_margin == pytest.approx(3.6, rel=1e-12)
    assert found.phase_crossover == pytest.approx(sqrt(10), rel=1e-12)
    assert degrees(found.phase_margin) == pytest.approx(29.1104, abs=5e-5)
    assert found.delay_margin == pytest.approx(0.2847, abs=5e-5)


def test_delay_margin_over_all_crossings():
    """The smallest phase margin belongs to another crossing; dividing it by its own ω gives 71.300 ms."""
    motor, link, stiffness, spring = 1.0, 3.7, 100.0, np.array([0.73, 100.0])
    free_motor, free_link = np.array([motor, 3.7, 0.0]), np.array([link, 1.1, 0.0])
    numerator = 141 * np.polyadd(free_link, spring)
    denominator = np.polyadd(np.polymul(free_motor, free_link), np.polymul(spring, np.polyadd(free_motor, free_link)))
    system = scipy.signal.TransferFunction(numerator, np.polymul(denominator, [2e-3, 1.0]))
    found = gr.margins(gr.loop_from(system))
    assert stiffness == spring[1]
    assert found.delay_margin == pytest.approx(32.5945e-3, abs=5e-8)
    assert found.delay_crossover == pytest.approx(15.309, abs=5e-4)
    smallest = min(found.gain_crossings, key=lambda c: abs(c.phase_margin))
    assert abs(smallest.phase_margin) / smallest.omega == pytest.approx(71.300e-3, abs=5e-7)


# --- closed forms -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", np.linspace(0.05, 1.55, 12))
def test_rigid_delay_boundary(angle):
    """kp = Jω² cos ωT, kd = Jω sin ωT is both a phase and a gain crossing, at factor one."""
    omega = angle / RIGID.delay
    kp, kd = rigid_boundary(omega)
    loop = build(replace(RIGID, kp=kp, kd=kd))
    found = gr.margins(loop.scaled(0.5)), gr.margins(loop.scaled(2.0))
    nearest = [min((c for c in m.phase_crossings), key=lambda c: abs(c.omega - omega)) for m in found]
    assert [c.omega for c in nearest] == pytest.approx([omega, omega], rel=1e-10)
    assert [c.gain for c in nearest] == pytest.approx([2.0, 0.5], rel=1e-10)


# --- definitions ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=range(40), ids=lambda seed: f"draw{seed}")
def drawn(request):
    joint, sample_time = stable_draw(request.param)
    loop = build(joint, sample_time)
    return joint, sample_time, loop, gr.margins(loop)


def test_response_is_the_equations_of_motion(drawn):
    joint, sample_time, loop, _ = drawn
    omega = margins.frequency_grid(joint, sample_time, points=500)[::7]
    expected = margins.response(joint, omega, sample_time)
    # Continuous: a few roundings, and ωT more from the delay. Sampled: our (z − 1)² cancels, 1e-16/(ωT_s)².
    tolerance = 1e-12 if sample_time is None else 1e-12 + 1e-14 / (omega * sample_time) ** 2
    keep = np.broadcast_to(tolerance, omega.shape) < 1e-6
    # Margins of 40 dB and less are what matters: an error is judged against |L| or 0.01, whichever is larger.
    error = np.abs(loop.response(omega) - expected) / np.maximum(np.abs(expected), 0.01)
    assert np.all((error < np.maximum(tolerance, 1e-11))[keep])


def test_crossings_meet_their_definitions(drawn):
    _, _, loop, found = drawn
    assert found.stable
    for crossing in found.phase_crossings:
        value = loop.response(np.array([crossing.omega]))[0]
        assert abs(value.imag) < 1e-9 * abs(value)
        assert value.real < 0
        assert crossing.gain == pytest.approx(-1 / value.real, rel=1e-9)
    for crossing in found.gain_crossings:
        value = loop.response(np.array([crossing.omega]))[0]
        assert abs(abs(value) - 1) < 1e-10
        assert crossing.phase_margin == pytest.approx(np.angle(-value), abs=1e-9)
        assert crossing.delay_margin == pytest.approx(np.angle(-value) % (2 * pi) / crossing.omega, rel=1e-9)


def test_no_crossing_is_missed(drawn):
    """Every change of sign on a dense grid has its own crossing in the lists."""
    joint, sample_time, _, found = drawn
    omega = margins.frequency_grid(joint, sample_time)
    value = margins.response(joint, omega, sample_time)
    # A delay gives infinitely many phase crossings; those 34 dB weaker than the margin's need not be listed.
    strong = np.abs(value) > 0.02 * (1 if isinf(found.gain_margin) else 1 / found.gain_margin)
    left = (value.real < 0) & strong
    turns = (np.sign(value.imag[:-1]) != np.sign(value.imag[1:])) & left[:-1] & left[1:]
    listed = np.array([c.omega for c in found.phase_crossings])
    for i in np.flatnonzero(turns):
        assert np.any((listed >= omega[i] * (1 - 1e-9)) & (listed <= omega[i + 1] * (1 + 1e-9)))
    steps = np.sign(np.abs(value[:-1]) - 1) != np.sign(np.abs(value[1:]) - 1)
    listed = np.array([c.omega for c in found.gain_crossings])
    for i in np.flatnonzero(steps):
        assert np.any((listed >= omega[i] * (1 - 1e-9)) & (listed <= omega[i + 1] * (1 + 1e-9)))


def test_gain_margins_bound_the_stable_gains(drawn):
    joint, sample_time, loop, found = drawn
    assert found.gain_margin > 1
    assert found.lower_gain_margin < 1
    inside, outside = 1 - 1e-9, 1 + 1e-9
    if not isinf(found.gain_margin):
        assert is_stable(joint.scaled(found.gain_margin * inside), sample_time)
        assert not is_stable(joint.scaled(found.gain_margin * outside), sample_time)
    if found.lower_gain_margin:
        assert is_stable(joint.scaled(found.lower_gain_margin * outside), sample_time)
        assert not is_stable(joint.scaled(found.lower_gain_margin * inside), sample_time)
    else:
        assert is_stable(joint.scaled(1e-6), sample_time)
    limit = gr.gain_limit(loop)
    assert limit.stable
    assert limit.gain == pytest.approx(found.gain_margin, rel=1e-9)
    assert limit.lower_gain == pytest.approx(found.lower_gain_margin, rel=1e-9)
    if found.phase_crossover == found.phase_crossover and not isinf(found.gain_margin):
        assert limit.frequency == pytest.approx(found.phase_crossover, rel=1e-6)


def test_delay_margin_is_the_delay_that_can_be_added(drawn):
    joint, sample_time, _, found = drawn
    first = min((c.delay_margin for c in found.gain_crossings), default=inf)
    # Sampled, a fraction of a tick is not quite the phase that it costs: the crossings' own figures are an estimate there.
    assert found.delay_margin == pytest.approx(first, rel=1e-12 if sample_time is None else 1e-2)
    if not isinf(found.delay_margin):
        slower = [replace(joint, delay=joint.delay + found.delay_margin * f) for f in (1 - 1e-8, 1 + 1e-8)]
        assert is_stable(slower[0], sample_time)
        assert not is_stable(slower[1], sample_time)


@pytest.mark.slow
def test_peaks_and_disk_margin(drawn):
    joint, sample_time, loop, found = drawn
    at_peak = loop.response(np.array([found.peak_sensitivity_frequency]))[0]
    assert 1 / abs(1 + at_peak) == pytest.approx(found.peak_sensitivity, rel=1e-9)
    for reported, measure in (
        (found.peak_sensitivity, lambda value: 1 / np.abs(1 + value)),
        (found.peak_complementary, lambda value: np.abs(value / (1 + value))),
        (1 / found.disk_margin, lambda value: np.abs(1 - value) / (2 * np.abs(1 + value))),
    ):
        # A narrow peak magnifies the rounding of L (1e-12 sampled) by its own height, at most 1e3 here.
        assert reported == pytest.approx(margins.peak(joint, measure, sample_time), rel=1e-8)


def test_phase_margin_is_the_smallest(drawn):
    *_, found = drawn
    if found.gain_crossings:
        smallest = min(found.gain_crossings, key=lambda c: abs(c.phase_margin))
        assert found.phase_margin == smallest.phase_margin
        assert found.gain_crossover == smallest.omega


def test_unstable_loop_has_no_margins():
    found = gr.margins(build(EXAMPLE.scaled(3.0)))
    assert not found.stable
    assert found.unstable_roots == delay_roots.count_unstable(EXAMPLE.scaled(3.0))
    assert all(np.isnan(v) for v in (found.gain_margin, found.phase_margin, found.delay_margin, found.peak_sensitivity))
    assert any(c.gain == pytest.approx(2.5650059284821042 / 3, rel=1e-12) for c in found.phase_crossings)


@pytest.mark.parametrize("seed", range(60))
def test_number_of_unstable_roots(seed):
    rng = np.random.default_rng([21, seed])
    joint = random_joint(rng).scaled(10 ** rng.uniform(-3, 1))
    if seed % 3 == 0:
        joint = replace(joint, motor_viscous=float(rng.uniform(0, 3)), link_viscous=float(rng.uniform(0, 3)))
    if seed % 10 == 0:
        joint = replace(joint, stiffness=inf)
    loop = build(joint)
    expected = delay_roots.count_unstable(joint)
    assert gr.margins(loop).unstable_roots == expected
    assert gr.is_stable(loop) == (expected == 0)
    roots = gr.rightmost_roots(loop, count=max(6, expected + 2)).roots
    assert np.sum(roots.real > 0) == expected


@pytest.mark.parametrize("seed", range(30))
def test_sampled_roots_are_eigenvalues(seed):
    rng = np.random.default_rng([22, seed])
    joint, sample_time = random_joint(rng).scaled(10 ** rng.uniform(-3, 1)), float(rng.uniform(0.25e-3, 2e-3))
    eigenvalues = np.linalg.eigvals(sampled.closed_loop_matrix(joint, sample_time))
    loop = build(joint, sample_time)
    assert gr.is_stable(loop) == sampled.is_stable(joint, sample_time)
    assert gr.margins(loop).unstable_roots == np.sum(np.abs(eigenvalues) > 1)
    # Roots of a sampled loop may be given in z or as log(z)/T_s; the largest |z| is the same.
    largest = np.abs(eigenvalues).max()
    first = gr.rightmost_roots(loop).roots[0]
    assert min(abs(abs(first) - largest), abs(np.exp(first.real * sample_time) - largest)) < 1e-9


# --- other controllers ------------------------------------------------------------------------------------------------


def controller_pair(kind: str, joint: PDJoint, sample_time: float | None) -> tuple[object, controllers.Ratio]:
    """One controller near the joint's PD gains: as gainroom has it, and as an independent ratio of polynomials."""
    kp, kd, resonance = joint.kp, joint.kd, sqrt(joint.stiffness * (1 / joint.motor_inertia + 1 / joint.link_inertia))
    corner = kp / kd  # kp and kd s are equally large here
    differ, integrate = controllers.derivative(sample_time), controllers.integral(sample_time)
    proportional, rate = controllers.gain(kp), controllers.times(controllers.gain(kd), differ)
    if kind == "PID":
        ki = 0.05 * kp * corner
        parts = proportional, rate, controllers.times(controllers.gain(ki), integrate)
        return gr.PID(kp, ki, kd), controllers.plus(*parts)
    if kind == "P/PI":
        ki = 0.05 * kp
        inner = controllers.plus(controllers.gain(kd), controllers.times(controllers.gain(ki), integrate))
        return gr.PPI(corner, kd, ki), controllers.times(inner, controllers.plus(controllers.gain(corner), differ))
    if kind == "notch":
        hole = controllers.mapped(controllers.notch(resonance, 0.4, 0.2), resonance, sample_time)
        both = controllers.times(controllers.plus(proportional, rate), hole)
        return gr.PD(kp, kd, notches=(gr.Notch(resonance, 0.4, 0.2),)), both
    order = int(kind[-1])
    bandwidth = 1200.0  # below every Nyquist frequency drawn
    smooth = controllers.mapped(controllers.low_pass(bandwidth, order, 0.8), bandwidth, sample_time)
    filtered = controllers.plus(proportional, controllers.times(rate, smooth))
    return gr.PD(kp, kd, velocity_filter=gr.LowPass(bandwidth, order, 0.8)), filtered


@pytest.mark.parametrize("kind", ["PID", "P/PI", "notch", "low-pass 1", "low-pass 2"])
@pytest.mark.parametrize("seed", range(8))
def test_other_controllers(kind, seed):
    """The response is the formula's, and the gain limits are confirmed by the independent count."""
    joint, sample_time = stable_draw(seed)
    joint = joint.scaled(0.5)
    described, (above, below) = controller_pair(kind, joint, sample_time)
    loop = gr.build_loop(*parts(joint), described, feedback=joint.feedback, sample_time=sample_time)
    omega = np.geomspace(1.0, 1200.0, 30)
    ratio = controllers.response((above, below), omega, sample_time)
    plant = margins.response(replace(joint, kp=1.0, kd=0.0), omega, sample_time)
    assert loop.response(omega) == pytest.approx(ratio * plant, rel=1e-7)  # z-polynomials near z = 1 lose eight digits

    def truly_stable(factor: float) -> bool:
        if sample_time is None:
            return delay_roots.count_unstable_with(joint, [c * factor for c in above], list(below)) == 0
        return sampled.is_stable_with(joint, sample_time, [c * factor for c in above], list(below))

    found = gr.margins(loop)
    assert found.stable == truly_stable(1.0)
    if found.stable:
        # The independent coefficients are rounded to doubles, which moves their limit by up to 1e-9.
        inside, outside = 1 - 1e-7, 1 + 1e-7
        assert truly_stable(found.gain_margin * inside)
        assert not truly_stable(found.gain_margin * outside)
        if found.lower_gain_margin:
            assert truly_stable(found.lower_gain_margin * outside)
            assert not truly_stable(found.lower_gain_margin * inside)
        assert gr.gain_limit(loop).gain == pytest.approx(found.gain_margin, rel=1e-9)


# --- eq. (4) ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_closed_loop_responses(feedback):
    """P = L/(1+L) P_d − L/(1+L) n + C P e^{−sT}/(1+L) d."""
    joint = replace(EXAMPLE, feedback=feedback, damping=60.0 if feedback == "link" else 1.0)
    omega = np.array([0.5, 10.0, 118.0, 250.0, 480.0, 2000.0])
    loop, closed = margins.response(joint, omega), gr.closed_loop(build(joint))
    path = loop / (joint.kp + 1j * omega * joint.kd)
    assert closed.reference(omega) == pytest.approx(loop / (1 + loop), rel=1e-12)
    assert closed.noise(omega) == pytest.approx(-loop / (1 + loop), rel=1e-12)
    assert closed.disturbance(omega) == pytest.approx(path / (1 + loop), rel=1e-12)


def test_sampled_closed_loop_is_the_state_space():
    """Reference and torque disturbance through the closed-loop matrix: both enter where the command is formed."""
    joint = replace(EXAMPLE, delay=2.2e-3)
    matrix = sampled.closed_loop_matrix(joint, TICK)
    states = len(sampled.state_space(joint)[0])
    enter, leave = np.zeros(len(matrix)), np.zeros(len(matrix))
    enter[states + 1], leave[0] = 1.0, 1.0
    omega = np.array([1.0, 45.0, 201.0, 480.0, 3000.0])
    z = np.exp(1j * omega * TICK)
    path = np.array([leave @ np.linalg.solve(v * np.eye(len(matrix)) - matrix, enter.astype(complex)) for v in z])
    closed = gr.closed_loop(build(joint, TICK))
    # (z − 1)² near zero costs seven digits at 1 rad/s.
    assert closed.disturbance(omega) == pytest.approx(path, rel=1e-8)
    assert closed.reference(omega) == pytest.approx((joint.kp + joint.kd * (1 - 1 / z) / TICK) * path, rel=1e-8)
