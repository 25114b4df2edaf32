"""kd on a path of its own: verdict, limits and margins against a matrix that was built from scratch (independent/multirate.py)."""

import math

import numpy as np
import pytest
from pytest import approx

import gainroom as gr
from gainroom.analysis.margin_record import worst_of
from gainroom.analysis.period_map import PeriodMap
from gainroom.analysis.two_paths import COARSE_DOWN, TwoPaths, first_stable
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
    whole = TwoPaths(loop_of(coarse)).delay_of_others() / DRIVE - 80
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
    both = TwoPaths(loop_of(two))
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
    assert math.isnan(two.peak_sensitivity)
    assert math.isnan(two.disk_margin)


def test_two_periods_are_the_square_of_one():
    period_map = PeriodMap(loop_of(issue_loop()))
    doubled = loop_of(TwoRates(one_joint(), DRIVE, 80, 80, 2, 0))  # another loop: this only shows that the period is the common one
    assert PeriodMap(doubled).period == approx(2 * period_map.period)
    assert period_map.period == approx(BUS)


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
