"""kd on a path of its own: verdict, limits and margins against a matrix that was built from scratch (independent/multirate.py)."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.optimize import minimize_scalar

import gainroom as gr
from gainroom.analysis.lifted import Lifted
from gainroom.analysis.margin_record import worst_of
from gainroom.analysis.multirate import COARSE_DOWN, Multirate, first_stable
from independent.machine import Machine
from independent.multirate import TwoRates, first_loss
from machines import between, limbs

BUS, DRIVE = 2e-3, 5e-5  # [s] kp at 500 Hz, kd at 20 kHz
NUDGE = 1e-6


def one_joint(
    kp=3000.0, kd=300.0, ki=0.0, motor=1.0, link=16.0, stiffness=1e4, damping=1.0, bandwidth=4000.0, side="motor", low_pass=None, notch=None
):
    def each(value):
        return np.array([float(value)])

    gains = {(0, 0): np.array([[kp]]), (1, 0): np.array([[kd]])} | ({(0, 1): np.array([[ki]])} if ki else {})
    return Machine(
        np.array([[1 / link]]), each(motor), each(stiffness), each(damping), each(0), each(0), None, None, each(bandwidth), each(0.9),
        each(0), gains, low_pass, notch, side, None,
    )  # fmt: skip


def loop_of(two: TwoRates) -> gr.Loop:
    """The same for gainroom."""
    machine, tick = two.machine, two.tick
    plant = gr.Plant(
        machine.inverse_inertia, machine.motor_inertia, machine.stiffness, machine.damping, machine.motor_viscous, machine.link_viscous
    )
    drives = [gr.Drive(w, ratio, tick * two.slow_late) for w, ratio in zip(machine.bandwidth, machine.damping_ratio, strict=True)]
    filters = {
        "velocity_filter": None if machine.low_pass is None else gr.LowPass(*machine.low_pass),
        "notches": () if machine.notch is None else (gr.Notch(*machine.notch),),
    }
    kp, kd, ki = (machine.gains.get(powers) for powers in ((0, 0), (1, 0), (0, 1)))
    controller = gr.PD(kp, kd, **filters) if ki is None else gr.PID(kp, ki, kd, **filters)
    path = gr.GainPath(tick * two.fast_late, tick * two.fast)
    return gr.build_loop(plant, drives, controller, machine.side, tick * two.slow, path)


def issue_loop() -> TwoRates:
    """kd at 20 kHz without delay, kp at 500 Hz with 4 ms."""
    return TwoRates(one_joint(), DRIVE, 40, 80, 1, 0)


@pytest.mark.slow
def test_kd_at_20_khz_without_delay_and_kp_at_500_hz_with_4_ms():
    two = issue_loop()
    loop = loop_of(two)
    found = gr.margins(loop)
    assert found.stable
    assert gr.is_stable(loop)
    assert found.certified
    assert found.gain_margin == approx(first_loss(lambda g: two.scaled(g).radius(), 1, 30), rel=1e-9)
    assert gr.gain_limit(loop).gain == found.gain_margin
    turned = first_loss(lambda phase: two.scaled(np.exp(-1j * phase)).radius(), 0, math.pi)
    assert abs(found.phase_margin) == approx(turned, rel=1e-9)
    assert found.one_loop.largest_kp == approx(3000 * first_loss(lambda g: two.scaled(g, 1).radius(), 1, 30), rel=1e-9)
    assert found.one_loop.largest_kd == approx(300 * first_loss(lambda g: two.scaled(1, g).radius(), 1, 30), rel=1e-9)


@pytest.mark.slow
def test_more_delay_of_both_paths_and_of_kp_alone():
    two, tick = TwoRates(one_joint(kp=20000.0), DRIVE / 5, 200, 400, 5, 0), DRIVE / 5  # both limits lie between two of these ticks
    found = gr.margins(loop_of(two))
    ticks = found.delay_margin / tick
    assert two.later(math.floor(ticks), math.floor(ticks)).radius() < 1 < two.later(math.ceil(ticks), math.ceil(ticks)).radius()
    coarse = TwoRates(two.machine, DRIVE, 40, 80, 1, 0)
    whole = Multirate(loop_of(coarse)).delay_of_others() / DRIVE - 80
    assert coarse.later(math.floor(whole), 0).radius() < 1 < coarse.later(math.ceil(whole), 0).radius()


def test_what_one_path_for_both_would_say():
    """The same gains behind the bus alone are unstable, and with both on the drive stable: the paths decide."""
    two = issue_loop()
    parts = loop_of(two).parts
    assert parts is not None
    host = gr.build_loop(parts.plant, gr.Drive(4000.0, 0.9, 4e-3), parts.controller, "motor", BUS)
    drive = gr.build_loop(parts.plant, gr.Drive(4000.0, 0.9, 0.0), parts.controller, "motor", DRIVE)
    assert [gr.is_stable(one) for one in (host, loop_of(two), drive)] == [False, True, True]


def population():
    """One joint of every sort under two rates, a quarter of them with delays between the samples of both."""
    rng, found = np.random.default_rng(20), []
    while len(found) < 24:
        fast, slow = [(1, 40), (1, 4), (2, 5), (3, 1), (1, 1), (4, 6)][len(found) % 6]
        tick = float(rng.choice([5e-5, 1e-4, 2.5e-4]))
        late = int(rng.integers(0, 3 * slow)), int(rng.integers(0, 2 * fast + 2))
        lag = tick * (slow + late[0]) + 2e-4
        motor, link = between(rng, 0.05, 2), between(rng, 0.1, 10)
        kd = (motor + 0.3 * link) * rng.uniform(0.05, 0.4) / (lag if rng.random() < 0.5 else tick * (fast + late[1]) + 5e-4)
        kp = kd * rng.uniform(0.02, 0.4) / lag
        half = math.pi / (tick * fast)
        machine = one_joint(
            kp, kd, ki=0.5 * kp if rng.random() < 0.3 else 0.0, motor=motor, link=link, stiffness=between(rng, 2e3, 5e4),
            damping=rng.uniform(0.5, 5), bandwidth=math.inf if rng.random() < 0.3 else 4000.0,
            side="link" if rng.random() < 0.2 else "motor", low_pass=(0.2 * half, 1, 0.7) if rng.random() < 0.3 else None,
        )  # fmt: skip
        found.append(TwoRates(machine, tick, slow, late[0], fast, late[1]))
    return found


@pytest.mark.parametrize(("other", "stable"), [(0.8, True), (0.84, False), (0.1, True)])
def test_lower_gains_that_are_stable_are_found_in_a_narrow_pocket_too(other: float, stable: bool):
    """Eigenvalues 1.2 f and other/f: stable for f between `other` and 1/1.2, a pocket of 0.04 in ln f, or nowhere."""
    found = first_stable(lambda factor: np.array([1.2 * factor, other / factor], dtype=complex), math.log(1e-3))
    assert (found is not None) == stable
    if found is not None:
        assert other < math.exp(found) < 1 / 1.2
        assert found > math.log(1 / 1.2) - 2 * COARSE_DOWN  # the first from above, to the steps that are taken


def test_lower_gains_are_not_tried_one_by_one_where_a_root_stays_outside():
    """An eigenvalue that no gain moves: 14 steps of half a unit of ln f and their middles, not the 345 of COARSE_DOWN."""
    asked = []

    def spectrum(factor: float) -> np.ndarray:
        asked.append(factor)
        return np.array([1.01j, 0.5 * factor])

    assert first_stable(spectrum, math.log(1e-3)) is None
    assert len(asked) == 29


@pytest.mark.slow
@pytest.mark.parametrize("two", [two for two in population() if two.scaled(10.0).radius() > 1])
def test_lower_gains_are_found_where_a_fine_grid_has_them(two: TwoRates):
    both = Multirate(loop_of(two))
    found = first_stable(lambda factor: both.values(10 * factor, 10 * factor), math.log(1e-3))
    grid = next((t for t in np.arange(-0.02, math.log(1e-3), -0.02) if two.scaled(10 * math.exp(t)).radius() < 1), None)
    assert (found is None) == (grid is None)
    if found is not None:
        assert found == approx(grid, abs=2 * COARSE_DOWN)


@pytest.mark.slow
@pytest.mark.parametrize("two", population())
def test_any_joint_at_any_two_rates(two: TwoRates):
    loop = loop_of(two)
    limit = gr.gain_limit(loop)
    assert limit.stable == (two.radius() < 1) == (gr.margins(loop).unstable_roots == 0)
    if limit.gain == 0:
        assert all(two.scaled(factor).radius() > 1 for factor in np.geomspace(2e-3, 1, 40))
        return
    if math.isfinite(limit.gain):
        assert two.scaled(limit.gain * (1 - NUDGE)).radius() < 1 < two.scaled(limit.gain * (1 + NUDGE)).radius()
    low, high = max(limit.lower_gain * (1 + NUDGE), 2e-3), min(limit.gain * (1 - NUDGE), 100.0)
    assert all(two.scaled(factor).radius() < 1 for factor in np.geomspace(low, high, 40))
    if limit.lower_gain > 0:
        assert two.scaled(limit.lower_gain * (1 - NUDGE)).radius() > 1


def test_there_are_stable_and_unstable_ones_in_the_population():
    stable = [two.radius() < 1 for two in population()]
    assert 6 <= sum(stable) <= len(stable) - 3


@pytest.mark.slow
@pytest.mark.parametrize("number", [3, pytest.param(7, marks=pytest.mark.population)])
def test_several_coupled_joints(number: int):
    machine = limbs(1, number).machine
    two = TwoRates(machine, 1e-4, 20, 25, 1, 2)
    loop = loop_of(two)
    found = gr.joint_margins(loop)
    assert found.stable == (two.radius() < 1)
    assert two.scaled(found.limit.gain * (1 - NUDGE)).radius() < 1 < two.scaled(found.limit.gain * (1 + NUDGE)).radius()
    if not found.stable:
        return
    turn = abs(found.phase_margin)
    assert two.scaled(np.exp(-1j * turn * (1 - NUDGE))).radius() < 1 < two.scaled(np.exp(-1j * turn * (1 + NUDGE))).radius()
    for joint in (0, loop.size - 1):
        factor = found.one_loop.gain_margin[joint]
        if math.isfinite(factor):
            below, above = (
                TwoRates(machine.with_joint_scaled(joint, factor * (1 + side * NUDGE)), 1e-4, 20, 25, 1, 2).radius() for side in (-1, 1)
            )
            assert below < 1 < above


@pytest.mark.parametrize("delay", [0.0, 1e-3, 1.3e-3])
@pytest.mark.parametrize("controller", [gr.PD(2000.0, 60.0), gr.PID(2000.0, 3000.0, 60.0, velocity_filter=gr.LowPass(800.0, 2))])
def test_two_equal_paths_are_one(delay: float, controller):
    """The certified scan of the single-rate loop shares nothing with the eigenvalues of a period."""
    joint, drive = gr.ElasticJoint(1.0, 4.0, 2e4, 3.0), gr.Drive(4000.0, 0.9, delay)
    one = gr.margins(gr.build_loop(joint, drive, controller, sample_time=1e-3))
    two = gr.margins(gr.build_loop(joint, drive, controller, sample_time=1e-3, kd_path=gr.GainPath(delay, 1e-3)))
    assert one.stable
    for name in ("gain_margin", "phase_crossover", "phase_margin", "gain_crossover", "delay_margin", "delay_crossover"):
        assert getattr(two, name) == approx(getattr(one, name), rel=1e-7), name
    for name in ("peak_sensitivity", "peak_complementary", "disk_margin"):
        assert getattr(two, name) == approx(getattr(one, name), rel=1e-9), name
        assert getattr(two, f"{name}_frequency") == approx(getattr(one, f"{name}_frequency"), rel=1e-6), name
    assert two.disk_certified


def test_two_periods_are_the_square_of_one():
    lifted = Lifted(loop_of(issue_loop()))
    doubled = loop_of(TwoRates(one_joint(), DRIVE, 80, 80, 2, 0))  # another loop: this only shows that the period is the common one
    assert Lifted(doubled).period == approx(2 * lifted.period)
    assert lifted.period == approx(BUS)


def test_a_joint_without_kp_drifts_and_is_not_unstable():
    two = TwoRates(one_joint(kp=0.0), DRIVE, 40, 80, 1, 1)
    limit = gr.gain_limit(loop_of(two))
    assert limit.stable
    matrix = two.scaled(limit.gain * (1 + 1e-4)).matrix()
    assert np.sort(np.abs(np.linalg.eigvals(matrix)))[-1] > 1 + 1e-6
    matrix = two.scaled(limit.gain * (1 - 1e-4)).matrix()
    assert np.sort(np.abs(np.linalg.eigvals(matrix)))[-1] == approx(1, abs=1e-7)  # the drift


@pytest.mark.parametrize("damping", [0.0, 1e-6])
def test_slow_growth_of_soft_gains_is_told(damping: float):
    """A resonance without damping moves by 1e-9 in a period with gains that hardly act on it: unstable where its eigenvalue is outside."""
    said = []
    for scale in (1.0, 1e-2, 1e-3, 1e-4, 1e-5):
        for kp, kd in ((1e3, 30.0), (1e3, 1.0), (10.0, 0.0)):
            for late in (20, 60, 80):
                two = TwoRates(one_joint(kp=kp * scale, kd=kd * scale, damping=damping), DRIVE, 40, late, 10, 10)
                outside = np.abs(np.linalg.eigvals(two.matrix())).max() - 1
                if abs(outside) > 1e-9:  # of Φ's eigenvalues ten digits are sure
                    assert gr.is_stable(loop_of(two)) == (outside < 0), (scale, kp, kd, late, outside)
                    said.append(outside < 0)
    assert {True, False} == set(said)


def test_a_joint_without_gains_beside_others():
    """It drifts at any speed; the other joint's limit is its own, and a resonance that no gain moves rests on the circle."""

    def pair(value):
        return np.array([value, value])

    alone = TwoRates(one_joint(), DRIVE, 40, 80, 1, 0)
    inertia, gains = np.diag([1 / 16.0, 1 / 3.0]), {(0, 0): np.diag([3000.0, 0.0]), (1, 0): np.diag([300.0, 0.0])}
    machine = Machine(
        inertia, pair(1.0), pair(1e4), np.array([1.0, 0.0]), pair(0.0), pair(0.0), None, None, pair(4000.0), pair(0.9), pair(0.0), gains,
        None, None, "motor", None,
    )  # fmt: skip
    limit = gr.gain_limit(loop_of(TwoRates(machine, DRIVE, 40, 80, 1, 0)))
    assert limit.stable
    assert limit.gain == approx(gr.gain_limit(loop_of(alone)).gain, rel=1e-8)


def test_the_worst_of_two_loops_has_the_worst_of_their_paths():
    near, far = (gr.margins(loop_of(TwoRates(one_joint(kp=kp), DRIVE, 40, 80, 1, 0))) for kp in (40000.0, 3000.0))
    both = worst_of([far, near])
    assert both.least_gain_margin == near.least_gain_margin < far.least_gain_margin
    assert near.paths is not None
    assert both.least_gain_margin == approx(1 / near.paths.lower_kd)  # kd may fall less than kp may rise
    assert both.least_gain_margin < 2 < both.gain_margin  # what a common factor alone would hide


def test_gains_times_a_factor():
    loop = loop_of(issue_loop())
    assert gr.gain_limit(loop.scaled(2)).gain == approx(gr.gain_limit(loop).gain / 2, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kd_path": gr.GainPath(0.0, 1 / 20001)}, "must have a ratio of small whole numbers"),
        ({"kd_path": gr.GainPath(0.0, BUS / 1001)}, "must have a ratio of small whole numbers"),
        ({"sample_time": None}, "needs sample_time"),
        ({"controller": gr.PPI(1.0, 2.0, 3.0)}, "for controllers with a kd, PD and PID, not for P/PI"),
        ({"controller": gr.PD(1.0, 2.0, velocity_filter=gr.LowPass(1e5))}, "must be below half the sample rate"),
    ],
)
def test_what_cannot_be_is_refused(change: dict, said: str):
    given = {"controller": gr.PD(1e3, 30.0), "sample_time": BUS, "kd_path": gr.GainPath(0.0, DRIVE)} | change
    with pytest.raises(gr.GainroomError) as caught:
        gr.build_loop(gr.ElasticJoint(1.0, 1.0, 1e4, 1.0), gr.Drive(delay=4e-3), **given)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_number_of_a_single_rate_is_given():
    loop = loop_of(issue_loop())
    for ask in (lambda: loop.response([1.0]), lambda: gr.rightmost_roots(loop), lambda: gr.closed_loop(loop), lambda: loop.open_loop):
        with pytest.raises(gr.GainroomError):
            ask()


PEAKS = {"peak_sensitivity": (-1, 1), "peak_complementary": (1, 0), "disk_margin": (-2, 1)}
"""a and b of the margin that σ_max of a T + b I decides."""


def same_at_one_rate(plant, drive, controller, side: str, step: float) -> bool:
    """Whether a loop is stable; if so, kd on a path of its own at the same rate and delay leaves every peak as it is."""
    loop = gr.build_loop(plant, drive, controller, side, step)
    if not gr.is_stable(loop):
        return False
    one, two = gr.margins(loop), gr.margins(gr.build_loop(plant, drive, controller, side, step, gr.GainPath(drive.delay, step)))
    for name in ("peak_sensitivity", "peak_complementary"):
        assert getattr(two, name) == approx(getattr(one, name), rel=1e-9), name
    # of several joints both search for D, until ln σ_max is within 1e-7 of its least
    assert two.disk_margin == approx(one.disk_margin, rel=1e-9 if loop.size == 1 else 1e-7)
    if one.one_loop.peak_sensitivity is not None:
        assert two.one_loop.peak_sensitivity == approx(one.one_loop.peak_sensitivity, rel=1e-9)
    return True


@pytest.mark.slow
def test_peaks_at_one_rate_are_those_of_one_path():
    """The lemma of multirate.py, over random joints: σ_max of a system of one hold in a period is |1/(1 + L)|."""
    rng, stable = np.random.default_rng(58), 0
    for _ in range(60):
        step, late = float(rng.choice([2.5e-4, 1e-3, 2e-3])), rng.choice([0.0, 1.0, 1.37, 2.5])
        lag, motor, link = step * (1.5 + late) + 2e-4, between(rng, 0.05, 2), between(rng, 0.1, 10)
        kd = (motor + 0.3 * link) * rng.uniform(0.05, 0.4) / lag
        kp, filtered = kd * rng.uniform(0.02, 0.4) / lag, gr.LowPass(0.2 * math.pi / step, 2) if rng.random() < 0.4 else None
        controller = gr.PID(kp, kp, kd, velocity_filter=filtered) if rng.random() < 0.4 else gr.PD(kp, kd, velocity_filter=filtered)
        plant = gr.ElasticJoint(motor, link, between(rng, 2e3, 5e4), 10 ** rng.uniform(-4, 0.7)).plant()
        drive = gr.Drive(math.inf if rng.random() < 0.3 else 4000.0, 0.9, step * late)
        stable += same_at_one_rate(plant, drive, controller, "link" if rng.random() < 0.2 else "motor", step)
    assert stable >= 20


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 3, 12])
def test_peaks_of_coupled_joints_at_one_rate_are_those_of_one_path(number: int):
    loop = loop_of(TwoRates(limbs(1, number).machine, 1e-4, 10, 13, 10, 13))
    assert loop.parts is not None
    controller = loop.parts.controller.scaled(0.4 * gr.gain_limit(loop).gain)
    assert same_at_one_rate(loop.parts.plant, loop.parts.drives[0], controller, loop.parts.feedback, 1e-3)


def highest(two: TwoRates, slope: float, offset: float, joint: int = 0) -> float:
    """The largest σ_max of slope T + offset I of one joint over the circle: on a grid, then halved around the highest of it."""

    def heights(angles: np.ndarray) -> np.ndarray:
        every = two.complementary(np.exp(1j * angles), [joint])
        return np.array([np.linalg.norm(slope * one + offset * np.eye(len(one)), 2) for one in every])

    angles = np.unique(np.concatenate([np.geomspace(1e-4, math.pi, 300), np.linspace(1e-4, math.pi, 300)]))
    for _ in range(9):
        values = heights(angles)
        at = int(np.argmax(values))
        angles = np.linspace(angles[max(at - 1, 0)], angles[min(at + 1, len(angles) - 1)], 13)
    return float(values.max())


@pytest.mark.slow
@pytest.mark.parametrize("two", [two for two in population() if two.radius() < 1])
def test_peaks_at_two_rates_are_those_of_an_independent_lifting(two: TwoRates):
    found = gr.margins(loop_of(two))
    for name, (slope, offset) in PEAKS.items():
        peak = highest(two, slope, offset)
        assert getattr(found, name) == approx(min(2 / peak, 2.0) if name == "disk_margin" else peak, rel=1e-7), name
    assert found.disk_certified


@pytest.mark.slow
def test_peaks_of_coupled_joints_at_two_rates_are_those_of_an_independent_lifting():
    two = TwoRates(limbs(1, 12).machine, 2.5e-4, 8, 9, 2, 1)
    found = gr.margins(loop_of(two))
    assert found.stable
    assert found.one_loop.peak_sensitivity is not None
    for joint in (0, two.machine.size - 1):
        assert found.one_loop.peak_sensitivity[joint] == approx(highest(two, -1, 1, joint), rel=1e-7)
    assert found.peak_sensitivity == found.one_loop.peak_sensitivity.max()


PER_JOINT = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous", "bandwidth", "damping_ratio", "delay")


@pytest.mark.slow
def test_the_disk_of_two_joints_has_the_best_scaling_at_every_frequency():
    """D of two joints is one number: the least of σ_max over it is found by trying all, at each z of a grid."""
    machine = replace(
        one_joint(), inverse_inertia=np.array([[0.3, 0.12], [0.12, 0.2]]),
        **{name: np.repeat(getattr(one_joint(), name), 2) for name in PER_JOINT},
        gains={(0, 0): np.diag([3000.0, 1000.0]), (1, 0): np.diag([200.0, 60.0])},
    )  # fmt: skip
    two = TwoRates(machine, 2.5e-4, 8, 10, 2, 1)
    found = gr.margins(loop_of(two))
    assert found.stable
    assert found.disk_certified
    angles = np.concatenate([np.geomspace(1e-3, math.pi, 400), np.linspace(1e-3, math.pi, 400)])
    every = [np.eye(len(one)) - 2 * one for one in two.complementary(np.exp(1j * angles))]
    ratio = np.repeat([1.0, 0.0], len(every[0]) // 2)

    def height(matrix: np.ndarray, x: float) -> float:
        return float(np.linalg.norm(matrix * np.exp(x * (ratio[:, None] - ratio)), 2))

    least = max(minimize_scalar(lambda x, one=one: height(one, x), bounds=(-8, 8), method="bounded").fun for one in every)
    assert found.disk_margin == approx(2 / least, rel=1e-3)  # the grid, not the peak
    assert found.disk_margin < 2 / least * (1 + 1e-6)


def test_no_torque_in_time_is_amplified_by_more_than_ms():
    """Random and sinusoidal disturbance torques over many periods: ∫ (d + u)² dt ≤ Ms² ∫ d² dt, and near Ms for the worst of them."""
    two = TwoRates(one_joint(kp=20000.0), 2.5e-4, 8, 9, 2, 1)
    found, (a, b, c, d) = gr.margins(loop_of(two)), two.lifted()
    rng, periods = np.random.default_rng(7), 20000
    ends = np.sort([k % two.period for k in (9, 1, 3, 5, 7)])  # arrivals of kp's torque and of kd's, in ticks
    hold = np.searchsorted(ends, np.arange(two.period), side="right") - 1  # the first ticks belong to the last hold of the period before

    def gain(wave: Callable[[int], np.ndarray]) -> float:
        x, last, before, after = np.zeros(len(a)), np.zeros(len(ends)), 0.0, 0.0
        for k in range(periods):
            own = wave(k) if k < periods - 2000 else np.zeros(len(ends))  # then let it fade
            torque = np.where(hold < 0, last[-1], own[hold])
            taken, x, last = c @ x + d @ torque, a @ x + b @ torque, own
            before, after = before + torque @ torque, after + (torque - taken) @ (torque - taken)
        return math.sqrt(after / before)

    for _ in range(3):
        assert gain(lambda k: rng.standard_normal(len(ends))) < found.peak_sensitivity
    omega, middles = found.peak_sensitivity_frequency, (ends + np.diff([*ends, ends[0] + two.period]) / 2) * two.tick
    worst = gain(lambda k: np.cos(omega * (k * two.period * two.tick + middles)))
    assert 0.95 * found.peak_sensitivity < worst < found.peak_sensitivity


@pytest.mark.slow
@pytest.mark.parametrize("two", [two for two in population() if two.radius() < 1])
def test_peaks_bound_what_a_factor_or_a_phase_may_be(two: TwoRates):
    found = gr.margins(loop_of(two))
    ms, disk, turn = found.peak_sensitivity, found.disk_margin, abs(found.phase_margin)
    assert found.gain_margin >= ms / (ms - 1) * (1 - 1e-9)
    assert found.gain_margin * (1 + 1e-9) >= ((2 + disk) / (2 - disk) if disk < 2 else math.inf)
    assert 2 * math.sin(min(turn, math.pi) / 2) >= (1 - 1e-9) / ms
    assert turn >= 2 * math.atan(disk / 2) * (1 - 1e-9)


def test_a_path_without_gains_leaves_the_sampled_loop_of_the_other():
    """kd alone at 20 kHz, the joint adrift, and kp's path at 500 Hz with nothing on it."""
    joint, drive, fast = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 4e-3), gr.Drive(4000.0, 0.9, 1.3 * DRIVE)
    two = gr.margins(gr.build_loop(joint, drive, gr.PD(0.0, 300.0), sample_time=BUS, kd_path=gr.GainPath(1.3 * DRIVE, DRIVE)))
    one = gr.margins(gr.build_loop(joint, fast, gr.PD(0.0, 300.0), sample_time=DRIVE))
    for name in PEAKS:
        assert getattr(two, name) == approx(getattr(one, name), rel=1e-8), name  # beside an eigenvalue at 1 that drifts


@pytest.mark.parametrize(
    ("motor", "link", "delay", "kp", "kd", "filtered", "gain", "more"),
    [(1.0, 16.0, 2e-3, 3776.8, 634.4, 3169.0, 11.32, 1.604), (0.2, 0.8, 2.174e-3, 3324.3, 126.4, 1115.9, 9.97, 1.118)],
    ids=["Fig. 9", "testbed"],
)
def test_the_best_split_gains_of_two_joints(motor, link, delay, kp, kd, filtered, gain, more):
    """Tuned for Ms 2 and half of each delay in continuous time with half ticks for hold and difference, kd in the drive."""
    joint, drive = gr.ElasticJoint(motor, link, 1e4, 1.0), gr.Drive(4000.0, 0.9, delay)
    controller = gr.PD(kp, kd, velocity_filter=gr.LowPass(filtered))
    found = gr.margins(gr.build_loop(joint, drive, controller, sample_time=5e-4, kd_path=gr.GainPath(1e-4, 5e-5)))
    assert 20 * math.log10(found.gain_margin) == approx(gain, abs=5e-3)
    assert 1e3 * found.delay_margin == approx(more, abs=5e-4)
    assert 1.5 < found.peak_sensitivity < 2.0
    assert found.certified


@pytest.mark.slow
def test_largest_gains_of_one_joint_alone_leave_all_other_gains_as_they_are():
    """ki stays where kp is raised; of coupled joints each diagonal gain, also where it is 0."""
    two = TwoRates(one_joint(ki=2000.0), 2.5e-4, 8, 9, 2, 1)
    kp = float(gr.joint_margins(loop_of(two)).one_loop.largest_kp[0])

    def with_kp(value: float) -> float:
        return replace(two, machine=replace(two.machine, gains=two.machine.gains | {(0, 0): np.array([[value]])})).radius()

    assert with_kp(kp * (1 - NUDGE)) < 1 < with_kp(kp * (1 + NUDGE))
    coupled = TwoRates(limbs(1, 12).machine, 2.5e-4, 8, 9, 2, 1)
    gains = coupled.machine.gains | {(0, 0): coupled.machine.gains[0, 0] * np.diag([0.0, 1.0, 1.0, 1.0])}
    coupled = replace(coupled, machine=replace(coupled.machine, gains=gains))
    found = gr.joint_margins(loop_of(coupled)).one_loop
    for power, largest in ((0, found.largest_kp), (1, found.largest_kd)):
        for joint in (0, 2):

            def radius(value: float, power=power, joint=joint) -> float:
                gain = np.array(gains[power, 0])
                gain[joint, joint] = value
                return replace(coupled, machine=replace(coupled.machine, gains=gains | {(power, 0): gain})).radius()

            assert radius(largest[joint] * (1 - NUDGE)) < 1 + 1e-7  # a joint without kp drifts at 1
            assert radius(largest[joint] * (1 + NUDGE)) > 1


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_a_delay_next_to_its_crossing_is_the_first_of_all(seed: int, monkeypatch: pytest.MonkeyPatch):
    """Followed from the crossing of kp's return ratio, and from no delay on, step by step: the same first delay that loses the loop."""
    rng = np.random.default_rng([seed, 60])
    while True:
        inertia, step = rng.uniform(0.1, 2.0), rng.choice([5e-4, 1e-3])
        kd = inertia / 2e-4 * rng.uniform(0.02, 0.2)
        joint = gr.ElasticJoint(inertia, rng.uniform(0.5, 20) * inertia, 10 ** rng.uniform(3, 4.5), 1.0)
        gains = gr.PD(kd * rng.uniform(2, 20), kd, velocity_filter=gr.LowPass(3000.0))
        drive, path = gr.Drive(4000.0, 0.9, rng.uniform(5e-4, 4e-3)), gr.GainPath(1e-4, step / rng.choice([5, 10]))
        loop = gr.build_loop(joint, drive, gains, sample_time=step, kd_path=path)
        if gr.is_stable(loop) and math.isfinite(near := Multirate(loop).delay_of_others()):
            break
    monkeypatch.setattr(Multirate, "_lag_at_crossing", lambda self: math.nan)
    assert near == approx(Multirate(loop).delay_of_others(), rel=1e-9)  # both are polished to 1e-13 of eigenvalues that have 1e-12
