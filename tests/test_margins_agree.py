"""One joint is n = 1: the certified scan and the characteristic loci, which share no code, tell the same margins."""

import numpy as np
import pytest

import gainroom as gr
from draws import draw_setup
from gainroom.analysis.coupled_margins import coupled_margins
from independent.quick_margins import quick_margins

FOLLOWED = 1e3  # the loci are followed to this factor, down to 1e-4, and those of one loop down to 1e-3


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
def test_scan_and_loci_agree(seed: int, sampled: bool):
    loop = draw_setup(np.random.default_rng([71, seed]), sampled).loop()
    scan = gr.margins(loop)
    loci, quick = coupled_margins(loop), quick_margins(loop)
    assert scan.stable == loci.stable == quick.stable
    if not scan.stable:
        same_limit(loci.limit, scan.limit)
        return

    same_limit(loci.limit, scan.limit)
    if scan.gain_margin < FOLLOWED:
        same(loci.one_loop.gain_margin[0], scan.gain_margin)
    if scan.lower_gain_margin > 1e-3:
        same(loci.one_loop.lower_gain_margin[0], scan.lower_gain_margin)
    same(loci.phase_margin, scan.phase_margin)
    same(loci.gain_crossover, scan.gain_crossover)
    for one in (loci, quick):
        same(one.least_phase_margin, abs(scan.phase_margin))
        if scan.gain_headroom < FOLLOWED:
            same(one.least_gain_margin, scan.gain_headroom)
    same(loci.disk_margin, scan.disk_margin)
    same(quick.peak_sensitivity, loci.peak_sensitivity)
    same(loci.peak_sensitivity, scan.peak_sensitivity, 1e-7)  # flat at its top, which the loci reach by parabolas
    if scan.delay_margin < 1.0:  # longer ones the loci leave out
        same(loci.delay_margin, scan.delay_margin, 1e-9 if loop.sample_time is None else 2e-5)  # a fraction of a tick is not just a phase


def test_an_unstable_loop_with_a_counted_limit_is_certified():
    """Nothing but its limit is claimed of it."""
    plant = gr.Plant(np.array([[1.0, 0.3], [0.3, 2.0]]), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    found = gr.joint_margins(gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(np.full(2, 8000.0), np.full(2, 400.0))))
    assert not found.stable
    assert found.limit.certificate.holds
    assert found.certified
