"""One joint is n = 1: the certified scan and the characteristic loci, which share no code, tell the same margins."""

import math

import numpy as np
import pytest

import gainroom as gr
from draws import draw_setup
from gainroom.analysis.coupled_margins import joint_margins
from gainroom.analysis.coupled_robustness import kept_by

FOLLOWED = 1e3  # the loci are followed to this factor; round-off under integrators may hide what lies below 1e-4


@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", range(12))
def test_scan_and_loci_agree(seed: int, sampled: bool):
    loop = draw_setup(np.random.default_rng([71, seed]), sampled).loop()
    scan = gr.margins(loop)
    loci, kept = joint_margins(loop), kept_by(loop)
    assert scan.stable == loci.stable == kept.stable
    if not scan.stable:
        return

    def same(found: float, truth: float, rel: float = 1e-9) -> None:
        assert found == pytest.approx(truth, rel=rel)  # both are polished to round-off of the loop's own response

    if scan.gain_margin < FOLLOWED:
        same(loci.limit.gain, scan.gain_margin)
        same(loci.limit.frequency, scan.phase_crossover)
        same(loci.others_closed[0], scan.gain_margin)
    if scan.lower_gain_margin > 1e-4:
        same(loci.limit.lower_gain, scan.lower_gain_margin)
    same(loci.phase_margin, abs(scan.phase_margin))
    same(kept.phase_margin, abs(scan.phase_margin))
    if math.isfinite(scan.phase_margin):
        same(loci.phase_frequency, scan.gain_crossover)
    if scan.gain_room < FOLLOWED:
        same(kept.gain_margin, scan.gain_room)
    same(kept.peak_sensitivity, scan.peak_sensitivity, 1e-7)  # flat at its top, which the loci reach by parabolas
    if scan.delay_margin < 1.0:  # longer ones the loci leave out
        same(loci.delay_margin, scan.delay_margin, 1e-9 if loop.sample_time is None else 2e-5)  # a fraction of a tick is not just a phase
