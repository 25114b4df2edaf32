"""One joint is n = 1: its certified scan and the samples of coupled loops, which share no code, tell the same margins."""

from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from draws import draw_setup
from gainroom.analysis.boundary import coupled_margins
from gainroom.analysis.gain_limit import sampled_limit
from gainroom.analysis.margin_record import Certificate, PathMargins, worst_of

FOLLOWED = 1e3  # samples are followed to this factor, down to 1e-4, and those of one loop down to 1e-3


def same(found: float, truth: float, rel: float = 1e-9) -> None:
    """Both are polished to round-off of the loop's own response."""
    assert found == pytest.approx(truth, rel=rel, nan_ok=True)


def same_limit(found: gr.GainLimit, truth: gr.GainLimit) -> None:
    if truth.gain < FOLLOWED:
        same(found.gain, truth.gain)
        same(found.frequency, truth.frequency)
    if truth.lower_gain > 1e-4:
        same(found.lower_gain, truth.lower_gain)
        same(found.lower_frequency, truth.lower_frequency)


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", range(12))
def test_scan_and_samples_agree(seed: int, sampled: bool):
    loop = draw_setup(np.random.default_rng([71, seed]), sampled).loop()
    scan, limit = gr.margins(loop), sampled_limit(loop)
    if limit is None:  # no lower gains are stable
        assert scan.limit.gain == 0
        return
    assert limit.stable == scan.stable
    same_limit(limit, scan.limit)
    if not scan.stable:
        return

    found = coupled_margins(loop)
    if scan.gain_margin < FOLLOWED:
        same(found.one_loop.gain_margin[0], scan.gain_margin)
    if scan.lower_gain_margin > 1e-3:
        same(found.one_loop.lower_gain_margin[0], scan.lower_gain_margin)
    same(found.phase_margin, scan.phase_margin)
    same(found.gain_crossover, scan.gain_crossover)
    same(found.least_phase_margin, abs(scan.phase_margin))
    if scan.gain_headroom < FOLLOWED:
        same(found.least_gain_margin, scan.gain_headroom)
    same(found.disk_margin, scan.disk_margin)
    same(found.peak_sensitivity, scan.peak_sensitivity, 1e-7)  # flat at its top
    if scan.delay_margin < 1.0:  # longer ones are left out
        same(found.delay_margin, scan.delay_margin, 1e-9 if loop.sample_time is None else 2e-5)  # a fraction of a tick is not just a phase


@pytest.mark.parametrize(
    ("inside", "outside", "holds"), [(0, 1, True), (0, 4, True), (0, -1, True), (0, 0, False), (1, 2, False), (-1, 1, False)]
)
def test_a_certificate_needs_none_inside_and_some_outside(inside: int, outside: int, holds: bool):
    """−1 stands for unstable, not counted. Where nothing is lost outside either, it is no end."""
    assert Certificate(inside, outside).holds == holds


def test_lower_margins_are_part_of_the_headroom():
    """PID that a lower gain loses first: the loop is stable just inside 1 over the headroom and unstable beyond, by its roots."""
    joint = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0)
    loop = gr.build_loop(joint, gr.Drive(4000.0, 0.9, 5e-4), gr.PID(60.0, 500.0, 12.0), sample_time=1e-3)
    found = gr.margins(loop)
    assert 1.01 < 1 / found.lower_gain_margin < found.gain_margin
    factor = 1 / found.gain_headroom
    assert gr.is_stable(loop.scaled(1.001 * factor))
    assert not gr.is_stable(loop.scaled(0.999 * factor))
    assert found.least_gain_margin == found.gain_headroom
    paths = PathMargins(others=3.0, lower_others=0.8, kd=4.0, lower_kd=0.5, certified=True)
    assert paths.headroom == 1 / 0.8
    assert replace(paths, lower_others=0.0).headroom == 1 / 0.5
    assert replace(paths, lower_others=0.0, lower_kd=0.0).headroom == 3.0
    assert replace(found, paths=replace(paths, lower_kd=0.999)).least_gain_margin == 1 / 0.999


@pytest.mark.parametrize(
    ("common", "alone", "least"), [(-0.5, (0.3, 0.9), 0.3), (0.2, (0.3, 0.9), 0.2), (-0.2, (0.3, 0.9), 0.2), (np.inf, (0.7, 0.6), 0.6)]
)
def test_the_least_phase_is_of_all_loops_together_and_of_each_alone(common: float, alone: tuple[float, float], least: float):
    """Of either sign, in radians; what requirements bound."""
    found = two_margins()
    changed = replace(found, phase_margin=common, one_loop=replace(found.one_loop, phase_margin=np.array(alone)))
    assert changed.least_phase_margin == least


def two_margins() -> gr.Margins:
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    return gr.joint_margins(gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(np.full(2, 80.0), np.full(2, 4.0))))


@pytest.mark.parametrize(
    ("upper", "lower", "certified"),
    [(True, True, True), (True, False, False), (False, True, False), (True, None, True), (None, None, True)],
)
def test_a_limit_is_certified_where_every_end_is(upper: bool | None, lower: bool | None, certified: bool):
    """None: there is no such end."""
    ends = [None if holds is None else Certificate(0, 1 if holds else 0) for holds in (upper, lower)]
    assert replace(two_margins().limit, certificate=ends[0], lower_certificate=ends[1]).certified == certified


def test_the_worst_of_loops_has_every_margin_of_the_one_that_has_least():
    """Each number of one of two loops is the worse one; what is not certified of one is not of both."""
    one = two_margins()
    ranges = {
        "gain_margin": ([3.0, 9.0], [4.0, 8.0]),
        "lower_gain_margin": ([0.2, 0.0], [0.1, 0.3]),
        "phase_margin": ([0.5, 0.9], [0.6, 0.4]),
    }
    pair = [replace(one.one_loop, **{name: np.array(values[k]) for name, values in ranges.items()}) for k in (0, 1)]
    pair[1] = replace(pair[1], certified=np.array([True, False]))
    paths = [PathMargins(3.0, 0.2, 5.0, 0.0, True), PathMargins(4.0, 0.1, 2.0, 0.3, False)]
    both = [replace(one, one_loop=loop, paths=path, phase_margin=sign * 0.3) for loop, path, sign in zip(pair, paths, (1, -2), strict=True)]
    for given in (both, both[::-1]):
        worst = worst_of(given)
        assert worst.one_loop.gain_margin.tolist() == [3.0, 8.0]
        assert worst.one_loop.lower_gain_margin.tolist() == [0.2, 0.3]
        assert worst.one_loop.phase_margin.tolist() == [0.5, 0.4]
        assert worst.one_loop.certified.tolist() == [True, False]
        assert worst.paths == PathMargins(3.0, 0.2, 2.0, 0.3, False)
        assert worst.phase_margin == 0.3  # of the loop whose smallest phase is smallest, with its sign


def test_an_unstable_loop_with_a_counted_limit_is_certified():
    """Nothing but its limit is claimed of it."""
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    found = gr.joint_margins(gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(np.full(2, 8000.0), np.full(2, 400.0))))
    assert not found.stable
    assert found.limit.certificate.holds
    assert found.certified
