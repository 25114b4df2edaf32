"""The largest scale of gains: against single joints where nothing couples, and against its own definition where everything does."""

from dataclasses import replace
from functools import cache
from math import exp, inf, log, nan

import numpy as np
import pytest

import gainroom as gr
from draws import draw_plant, seeds
from gainroom.analysis.boundary import coupled_delay_margin
from gainroom.analysis.margin_record import GainLimit, Margins, OneLoop
from gainroom.analysis.margins import joint_margins
from gainroom.design.gain_search import PRICES, RAISE, Raised, raised_gains, rounded, stiffer
from gainroom.design.margin_slopes import GainCase, moved
from gainroom.report.margin_columns import margin_value
from gainroom.system.requirements import REQUIREMENTS, TICKS
from independent.quick_margins import quick_margins
from machines import limbs
from refusals import assert_refused

DRIVE = gr.Drive(4000.0, 0.9, 2e-3)
REQUIRED = gr.Requirements.usual()


@pytest.mark.parametrize("gains", [(200.0, 10.0), (3000.0, 40.0), (900.0, 45.0)])
def test_one_joint_keeps_its_margins(gains):
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), DRIVE, gr.PD(*gains))
    kept, exact = quick_margins(loop), gr.margins(loop)
    lower = 1 / exact.lower_gain_margin if exact.lower_gain_margin else inf
    # both polished; the peak by narrowing to a millionth of its width, on which it is flat
    assert kept.least_gain_margin == pytest.approx(min(exact.gain_margin, lower), rel=1e-9)
    assert kept.least_phase_margin == pytest.approx(abs(exact.phase_margin), rel=1e-9)
    assert kept.peak_sensitivity == pytest.approx(exact.peak_sensitivity, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("seed", seeds(2, 3))
def test_coupled_joints_keep_the_least_of_all_their_margins(seed, sample_time):
    """Against the polished uniform margins, and against each loop's own return ratio on a dense grid."""
    rng = np.random.default_rng([44, seed])
    size = int(rng.integers(3, 7))
    loop = gr.build_loop(draw_plant(rng, size), DRIVE, gr.PD(rng.uniform(30, 90, size), rng.uniform(1, 4, size)), sample_time=sample_time)
    whole = joint_margins(loop)
    assert whole.stable
    kept = quick_margins(loop)
    omega = np.geomspace(0.1, 6000.0, 100_000)
    sensitivity = np.diagonal(np.linalg.inv(np.eye(size) + loop.response(omega)), axis1=1, axis2=2)
    own = 1 / sensitivity - 1
    rows, joints = np.nonzero((np.abs(own[:-1]) > 1) != (np.abs(own[1:]) > 1))
    phases = np.abs(np.angle(-own[rows, joints]))
    rows, joints = np.nonzero(((own.imag[:-1] > 0) != (own.imag[1:] > 0)) & (own.real[1:] < 0))
    factors = np.exp(np.abs(np.log(-own.real[rows, joints])))
    lower = 1 / whole.limit.lower_gain if whole.limit.lower_gain else inf
    # the grid's steps are 1.1e-4 of ω, over which a phase near a resonance turns by some thousandths
    assert kept.least_phase_margin == pytest.approx(min(whole.phase_margin, phases.min(initial=inf)), rel=5e-3)
    assert kept.least_phase_margin <= whole.phase_margin * (1 + 1e-9)
    assert kept.least_gain_margin == pytest.approx(min(whole.limit.gain, lower, factors.min(initial=inf)), rel=5e-3)
    assert kept.least_gain_margin <= min(whole.limit.gain, whole.one_loop.gain_margin.min()) * (1 + 1e-9)
    assert kept.peak_sensitivity == pytest.approx(np.abs(sensitivity).max(), rel=1e-4)
    assert kept.peak_sensitivity >= np.abs(sensitivity).max() * (1 - 1e-9)


@pytest.mark.slow
def test_close_crossings_of_near_equal_limbs_are_not_lost():
    """Against the certified margins of all loops together: two loci meet the unit circle, or the axis, side by side."""
    seen = 0
    for number in range(30):
        loop = limbs(2017, number).loop
        kept = quick_margins(loop)
        if not kept.stable:
            continue
        whole = joint_margins(loop)
        lower = 1 / whole.limit.lower_gain if whole.limit.lower_gain else inf
        assert kept.phase_margin == pytest.approx(whole.phase_margin, rel=1e-5)  # ends are counted 1e-6 beside
        assert kept.least_gain_margin <= min(whole.limit.gain, lower) * (1 + 1e-5)
        seen += 1
    assert seen > 10


@pytest.mark.parametrize("number", [10, 13, 20])
@pytest.mark.parametrize("needed", [30.0, 1000.0])
def test_far_gain_margins_are_looked_for_as_far_as_they_are_asked_for(number, needed):
    """Near-equal limbs, whose common limit lies below those of single loops, with a limit just below and just above what is needed."""
    loop = limbs(2017, number).loop
    nearest = gr.gain_limit(loop).gain
    required = gr.Requirements(gain_margin=needed)
    for share, met in ((0.99, False), (1.01, True)):
        found = one_case(loop, required).margins(gains_of(loop) * nearest / (share * needed))
        assert found.limit.gain == pytest.approx(share * needed, rel=1e-6)
        assert required.met_by(found) == met


def gains_of(loop):
    """(3, n) of a PD."""
    controller = loop.parts.controller
    return np.array([np.broadcast_to(gain, loop.size) for gain in (controller.kp, controller.kd, 0.0)])


def one_case(loop, required):
    """A loop of PD-controlled joints as the search for gains sees it."""

    def regained(gains):
        return loop.regained(replace(loop.parts.controller, kp=gains[0], kd=gains[1]))

    eye = np.eye(loop.size)
    return GainCase("", regained, eye, eye, np.zeros(loop.size, dtype=bool), required)


def test_an_unstable_loop_keeps_nothing():
    loop = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), DRIVE, gr.PD(2000.0, 300.0))
    assert not quick_margins(loop).stable
    assert not REQUIRED.met_by(quick_margins(loop))


def case_of(plant, required=REQUIRED, delay=2e-3, torque=None, sample_time=None) -> GainCase:
    """Gains per joint or, with `torque` (n, m), along directions whose motion is measured in the same way."""
    torque = np.eye(plant.size) if torque is None else torque

    def loop(gains):
        kp, kd = ((torque * gain) @ torque.T for gain in gains[:2])
        return gr.build_loop(plant, gr.Drive(4000.0, 0.9, delay), gr.PD(kp, kd), sample_time=sample_time)

    return GainCase(f"{1e3 * delay} ms", loop, torque, torque.T, np.zeros(torque.shape[1], dtype=bool), required)


def soft(size):
    return np.array([np.full(size, 0.02), np.full(size, 1.0), np.zeros(size)])


def holds(case: GainCase, gains) -> bool:
    return case.required.met_by(case.margins(gains))


def found_for(cases, groups=None, **kwargs):
    size = cases[0].torque.shape[1]
    groups = [[j] for j in range(size)] if groups is None else groups
    return raised_gains(cases, soft(size), np.ones(size), groups, 1e9, **kwargs)


@cache
def searched(seed: int, sample_time: float | None) -> tuple[list[GainCase], Raised]:
    """Random coupled joints, and directions across them, in two cases at once; with the gains found for both."""
    rng = np.random.default_rng([41, seed])
    size = int(rng.integers(2, 5))
    torque = np.eye(size) if seed != 1 else np.linalg.qr(rng.standard_normal((size, size)))[0][:, : size - 1]
    plant = draw_plant(rng, size)
    required = REQUIRED if seed != 1 else gr.Requirements(gain_margin=2.0, peak_sensitivity=2.0)  # what no direction moves has no phase
    cases = [case_of(plant, required, delay, torque, sample_time) for delay in (2e-3, 3e-3)]
    return cases, found_for(cases)


@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("seed", seeds(2, 3))
def test_none_can_be_raised(seed, sample_time):
    """The definition."""
    cases, found = searched(seed, sample_time)
    assert all(holds(case, found.gains) for case in cases)
    assert list(found.margins) == [case.all_margins(found.gains) for case in cases]  # the very records
    assert found.gains.tolist() == rounded(found.gains).tolist()  # what is typed in is what was looked at
    for j in range(found.gains.shape[1]):
        for power in (0.0, 1.0):
            more = found.gains.copy()
            more[:2, j] *= 1.05, 1.05**power
            assert not all(holds(case, more) for case in cases), f"direction {j} can be raised"
        assert found.margin[j] in (*cases[0].required.asked, "stability")
        assert not holds(cases[found.case[j]], stiffer(found.gains, j, RAISE, 0.0, cases[0].cascade))


def stiffest(joint: gr.ElasticJoint, reserve: float = 0.0) -> float:
    """The largest kp at which some kd keeps what is required and `reserve` more: the edge of the exact region of one joint."""
    required = REQUIRED
    return gr.pd_region(
        joint,
        DRIVE,
        gain_margin=required.gain_margin * exp(reserve),
        phase_margin=required.phase_margin * (1 + reserve),
        peak_sensitivity=required.peak_sensitivity * exp(-reserve),
    ).max_kp()


def assert_as_stiff_as_alone(kp: float, joint: gr.ElasticJoint):
    """Between the edges of two exact regions: with the stated reserve, along an edge that is flat there, and without any."""
    assert stiffest(joint, PRICES[0][1]) * (1 - 1e-3) <= kp <= stiffest(joint) * (1 + 1e-6)


def test_one_joint_is_as_stiff_as_by_itself():
    """Against the exact gain region of one joint, by another method."""
    joint = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0)
    ((kp,), _, _) = found_for([case_of(joint.plant())]).gains
    assert_as_stiff_as_alone(kp, joint)


@pytest.mark.slow
def test_uncoupled_joints_take_nothing_from_each_other():
    """Joints without coupling, one of them a hundred times lighter: each as stiff as alone."""
    heavy, light = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.ElasticJoint(0.002, 0.008, 1e2, 0.01)
    share = np.array([1.0, 0.01])
    both = gr.Plant(np.diag([1 / 0.8, 1 / 0.008]), 0.2 * share, 1e4 * share, 1.0 * share)
    start = soft(2) * [1.0, 0.01]
    kp = raised_gains([case_of(both)], start, np.array([1.0, 0.01]), [[0], [1]], 1e9).gains[0]
    for one, found in zip((heavy, light), kp, strict=True):
        assert_as_stiff_as_alone(found, one)


def test_a_weight_makes_a_joint_stiffer_and_others_softer():
    """Two joints that take from each other: the sum that is made small trades one for the other."""
    plant = gr.Plant(np.array([[2.0, 0.5], [0.5, 1.0]]), np.full(2, 0.05), np.full(2, 1e4), np.full(2, 1.0))
    light, heavy = (raised_gains([case_of(plant)], soft(2), np.array([weight, 1.0]), [[0], [1]], 1e9).gains[0] for weight in (0.04, 25.0))
    assert heavy[0] > 1.1 * light[0]
    assert heavy[1] < light[1] / 1.1


def test_alike_directions_get_equal_gains():
    """Two limbs on one base: symmetric, and no stiffer one by one."""
    coupling = np.array([[2.0, 0.3], [0.3, 2.0]])
    plant = gr.Plant(coupling, np.full(2, 0.2), np.full(2, 1e4), np.full(2, 1.0))
    gains = found_for([case_of(plant)], groups=[[0, 1]]).gains
    assert gains[:2, 0] == pytest.approx(gains[:2, 1], rel=1e-12)


def margins_missed(case: GainCase, gains) -> dict[str, float]:
    """What is missed of each requirement at its worst, by definition."""
    kept = case.margins(gains)
    assert kept.stable
    return {
        "gain_margin": log(REQUIRED.gain_margin / kept.least_gain_margin),
        "common phase": 1 - kept.common_phase_margin / REQUIRED.phase_margin,
        "phase of one loop": 1 - kept.one_loop_phase_margin / REQUIRED.phase_margin,
        "peak_sensitivity": log(kept.peak_sensitivity / REQUIRED.peak_sensitivity),
    }


@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("seed", seeds(2, 3))
def test_slopes_are_the_changes_of_margins(seed, across, sample_time):
    """What margins miss is among what slopes say is missed, and changes with every gain as they say: central differences of full looks."""
    rng = np.random.default_rng([47, seed])
    size = int(rng.integers(2, 5))
    torque = np.linalg.qr(rng.standard_normal((size, size)))[0] if across else np.eye(size)
    case = case_of(draw_plant(rng, size), torque=torque, sample_time=sample_time)
    start = soft(size) * rng.uniform(0.7, 1.4, (1, size))
    tried = (start * np.array([[scale**2], [scale], [0.0]]) for scale in np.geomspace(1.0, 300.0, 60))
    gains = next(gains for gains in tried if max(margins_missed(case, gains).values()) > -0.1)
    slopes, missed, step = case.slopes(gains), margins_missed(case, gains), 1e-4
    near = {name: value for name, value in missed.items() if value > -0.3}
    for name, value in near.items():
        k = int(np.argmin(np.abs(slopes.missed - value)))
        assert slopes.missed[k] == pytest.approx(value, abs=1e-5)  # a crossing is polished, a peak interpolated
        for place in np.ndindex(2, size):
            way = np.zeros((2, size))
            way[place] = step
            more, less = (margins_missed(case, moved(gains, sign * way, case.cascade))[name] for sign in (1, -1))
            # how the curve runs at a crossing is taken between two points of it, which may be as far apart as samples
            assert slopes.slope[(k, *place)] == pytest.approx((more - less) / (2 * step), rel=2e-2, abs=2e-4)


TWINS = 14  # the seed of two crossings that are close


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("seed", seeds(4, 40))
def test_delay_margins_and_their_slopes(seed, sample_time):
    """Against the certified delay margin, which samples the loop anew for every share of a tick, and its central differences.

    Where two crossings are close, as of equal limbs, the later one may be seen alone: 6 % later in one of 80. About to vanish, they move
    so unevenly that a difference is 3 % off.
    """
    rng = np.random.default_rng([53, seed])
    size = int(rng.integers(2, 5))
    plant, share = draw_plant(rng, size), rng.uniform(0.3, 2.0, (2, size))
    gains = np.vstack([soft(size)[:2] * share * [[9.0], [3.0]], np.zeros((1, size))])
    while not joint_margins(case_of(plant, sample_time=sample_time).loop(gains)).stable:
        gains = gains * [[0.5], [0.7], [1.0]]
    case = case_of(plant, sample_time=sample_time)

    def exact(gains) -> float:
        return coupled_delay_margin(case.loop(gains))

    here = exact(gains)
    case = replace(case, required=gr.Requirements(delay_margin=1.1 * here))
    found = case.margins(gains)
    # a share of a tick is nearly a phase: what requirements ask beyond what is needed is more than that is off
    assert here * (1 - TICKS) < found.delay_margin < 1.1 * here
    if found.delay_margin > here * (1 + TICKS):
        assert seed == TWINS
        return
    assert sample_time is not None or found.delay_margin == pytest.approx(here, rel=1e-6)
    slopes, step = case.slopes(gains), 1e-4
    k = int(np.argmax(slopes.missed))
    assert slopes.missed[k] == pytest.approx(log(1.1 * (1 + TICKS) * here / found.delay_margin), abs=1e-5)
    for place in np.ndindex(2, size):
        way = np.zeros((2, size))
        way[place] = step
        more, less = (exact(moved(gains, sign * way, case.cascade)) for sign in (1, -1))
        change = -(log(more) - log(less)) / (2 * step)
        assert slopes.slope[(k, *place)] == pytest.approx(
            change, rel=(0.05 if seed == TWINS else 0.02) if sample_time is None else 0.1, abs=2e-3
        )


@pytest.mark.parametrize("sample_time", [None, 5e-4])
@pytest.mark.parametrize("seed", seeds(2, 3))
def test_what_is_seen_to_break_breaks(seed, sample_time):
    """Near gains that were looked at, without a full look; some steps break something, others nothing."""
    rng = np.random.default_rng([49, seed])
    (*_, case), found = searched(seed, sample_time)  # with the longer delay, which limits the gains
    size = found.gains.shape[1]
    said = []
    for k in range(20):
        way = rng.uniform(-0.1, 0.06, (2, size)) if k % 2 else np.array([rng.uniform(-0.1, -0.02, size), np.full(size, -0.01)])
        gains = moved(found.gains, way, case.cascade)
        case.slopes(found.gains)
        name = case.breaks(gains)
        said.append(bool(name))
        assert not name or not case.required.met(name, REQUIREMENTS[name].value(case.margins(gains)))
    assert True in said
    assert False in said


def test_what_cannot_begin_is_refused():
    case = case_of(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0).plant())
    assert_refused(lambda: raised_gains([], soft(1), np.ones(1), [[0]], 1e9), ["at least one case"])
    assert_refused(lambda: raised_gains([case], 1e4 * soft(1), np.ones(1), [[0]], 1e9), ["to begin with"])


def test_what_nothing_limits_says_so():
    """A rigid joint without any lag: a passive loop."""
    plant = gr.Plant(np.eye(1), np.full(1, 0.1))
    case = GainCase(
        "", lambda gains: gr.build_loop(plant, gr.Drive(), gr.PD(*gains[:2])), np.eye(1), np.eye(1), np.zeros(1, dtype=bool), REQUIRED
    )
    found = raised_gains([case], soft(1), np.ones(1), [[0]], 1e3)
    assert found.margin == ("",)
    assert found.gains[0, 0] > 1e3 / 1.05**2


def margins_with(gain_margin: float, phase_margin: float, peak_sensitivity: float) -> Margins:
    """Of one joint."""
    one_loop = replace(OneLoop.unknown(1), gain_margin=np.array([inf]), lower_gain_margin=np.zeros(1), phase_margin=np.array([inf]))
    limit = replace(GainLimit.unknown(1), gain=gain_margin, lower_gain=0.0)
    return Margins(limit, one_loop, phase_margin=phase_margin, peak_sensitivity=peak_sensitivity)


@pytest.mark.parametrize("name", ["gain_margin", "phase_margin", "peak_sensitivity"])
def test_met_to_round_off_and_no_further(name: str):
    """A margin that misses its requirement by less than 1e-6 of it is met, one that misses it by more is not and does not read as if."""
    asked = REQUIRED
    needed = getattr(asked, name)
    worse = 1.0 if name == "peak_sensitivity" else -1.0  # towards what is not allowed
    for miss, met in ((0.9e-6, True), (1.2e-6, False), (2e-5, False)):
        value = needed * (1 + worse * miss)
        found = margins_with(**({"gain_margin": 10.0, "phase_margin": 2.0, "peak_sensitivity": 1.2} | {name: value}))
        assert asked.met(name, value) is met
        assert asked.met_by(found) is met
        shown = margin_value(asked, name, value, met, 3)
        assert (shown == margin_value(asked, name, needed, True, 3)) is met
    assert asked.met(name, nan) is False
    assert gr.Requirements(**{other: getattr(asked, other) for other in asked.asked if other != name}).met(name, needed) is None


@pytest.mark.parametrize("mended", [True, False])
def test_gains_that_fail_a_closer_look_are_searched_once_more(monkeypatch, mended):
    """Where the second search is no better the case is named: it is that for which none were found."""
    case, careful, exact = case_of(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0).plant()), [], GainCase.all_margins

    def closer(self: GainCase, gains: np.ndarray) -> Margins:
        found = exact(self, gains)
        return found if mended and careful else replace(found, phase_margin=0.1)

    monkeypatch.setattr(GainCase, "all_margins", closer)
    monkeypatch.setattr(GainCase, "be_careful", lambda self: careful.append(self))
    found = raised_gains([case], soft(1), np.ones(1), [[0]], 1e9)
    assert careful == [case]
    assert (found.holds, found.failed) == ((True, ()) if mended else (False, (0,)))
