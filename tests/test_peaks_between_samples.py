"""Peaks between samples are found to their top where they are steep on one side, where parabolas alone creep from the other."""

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.look import Reach, joint_loops, look
from gainroom.analysis.sampled_curves import polished_peaks


@pytest.mark.parametrize("steep", [10.0, 30.0, 300.0])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_peak_that_is_steep_on_one_side(steep, mirrored):
    def height(omega):
        beyond = (2.0 - omega if mirrored else omega) - 1.0
        return np.exp(-0.05 * beyond) / (1 + np.exp(-steep * beyond))

    highest = np.log(steep / 0.05 - 1) / steep  # where the slope is 0
    omega = np.array([0.4, 1.6, 2.0])
    omega = 2.0 - omega[::-1] if mirrored else omega
    place, top = polished_peaks(omega, height(omega)[:, None], np.array([1]), np.array([0]), lambda omega, columns: height(omega))
    truth = 1.0 - highest if mirrored else 1.0 + highest
    assert top[0] == pytest.approx(height(truth), rel=1e-12)
    assert place[0] == pytest.approx(truth, rel=1e-6)


@pytest.mark.parametrize("mirrored", [False, True])
def test_peaks_of_any_steepness_on_one_side(mirrored):
    """Parabolas approach some of them by a tenth of the way each."""
    rng, compared = np.random.default_rng(5), 0
    for _ in range(4000):
        steep, slope, width = 10 ** rng.uniform(1, 5), 10 ** rng.uniform(-3, 0), 10 ** rng.uniform(-3, 0)
        highest = np.log(steep / slope - 1) / steep  # where the slope of the height is 0

        def height(omega, columns=None, steep=steep, slope=slope):
            beyond = (10.0 - omega) * (-1 if mirrored else 1)
            return np.exp(slope * beyond - np.logaddexp(0.0, steep * beyond))

        middle = highest + width * rng.uniform(-0.5, 0.5)
        beyond = np.array([middle - width * rng.uniform(0.1, 1), middle, middle + width * rng.uniform(0.1, 1)])
        omega = 10.0 + (-beyond[::-1] if mirrored else beyond)
        sizes = height(omega)
        if np.argmax(sizes) != 1 or np.ptp(sizes) > 0.3:  # not what sampling leaves
            continue
        compared += 1
        _, top = polished_peaks(omega, sizes[:, None], np.array([1]), np.array([0]), height)
        assert top[0] >= height(10.0 + (-highest if mirrored else highest)) * (1 - 1e-6)
    assert compared > 300


@pytest.mark.parametrize("shift", [0.0, 0.001, 0.1, 0.3, 1 / 3, 0.7, 5.0, 17.3])
def test_a_parabola_that_has_its_top_at_the_highest_sample_by_chance_does_not_end_the_search(shift):
    """To the last bit, or the last but one."""

    def height(omega):
        beyond = omega - shift
        return 2.0 - (beyond - 1.1) ** 2 * (1.0 + (beyond - 1.0) * 0.4 / 2.02)  # as high at 0 as at 2; nowhere higher than at 1.1

    omega = shift + np.array([0.0, 1.0, 2.0])
    assert height(omega[0]) == pytest.approx(height(omega[2]), abs=1e-14)
    place, top = polished_peaks(omega, height(omega)[:, None], np.array([1]), np.array([0]), lambda omega, columns: height(omega))
    assert top[0] == pytest.approx(2.0, rel=1e-14)
    assert place[0] == pytest.approx(shift + 1.1, abs=1e-6)


def test_peaks_of_resonances_are_no_lower_than_any_point_about_them():
    rng = np.random.default_rng(11)
    compared = 0
    for _ in range(500):
        omega, damping = rng.uniform(1, 100), 10 ** rng.uniform(-4, -0.3)
        turn, gain = np.exp(1j * rng.uniform(-1.5, 1.5)), 10 ** rng.uniform(-1, 1)

        def height(at, omega=omega, damping=damping, size=gain * turn):
            return np.abs(size * omega**2 / (omega**2 - at**2 + 2j * damping * omega * at) + 1)

        around = omega * (1 + damping * np.linspace(-3, 3, 20_001))
        width = damping * omega * 10 ** rng.uniform(-1.5, 0.3) * rng.uniform((-1, -0.25, 0.3), (-0.3, 0.25, 1))
        samples = around[np.argmax(height(around))] + width
        if samples[0] <= 0 or np.argmax(height(samples)) != 1:
            continue
        compared += 1
        _, top = polished_peaks(samples, height(samples)[:, None], np.array([1]), np.array([0]), lambda at, columns: height(at))
        within = around[(around > samples[0]) & (around < samples[2])]
        assert top[0] >= height(within).max() * (1 - 1e-13)
    assert compared > 300


@pytest.mark.parametrize(
    ("height", "most"),
    [(np.ones_like, 1), (lambda omega: np.minimum(1.0, 2.0 - np.abs(omega - 1.0)), 1), (lambda omega: 2.0 - (omega - 1.0) ** 2, 6)],
    ids=["flat", "plateau", "symmetric"],
)
def test_a_peak_at_the_middle_sample_stays_there_and_takes_few_points(height, most):
    def counted(omega, columns):
        asked.append(len(omega))
        return height(omega)

    asked, omega = [], np.array([0.0, 1.0, 2.0])
    place, top = polished_peaks(omega, height(omega)[:, None], np.array([1]), np.array([0]), counted)
    assert (place[0], top[0]) == (1.0, height(np.array([1.0]))[0])
    assert sum(asked) <= most


def test_peaks_are_each_polished_as_if_they_were_alone_and_no_longer_than_they_need():
    middles, widths = np.linspace(1.3, 8.7, 12), np.geomspace(0.02, 1.0, 12)

    def heights(omega, columns):
        asked.append(len(omega))
        return 1 / np.hypot(1.0, (omega - middles[columns]) / widths[columns] * (1 + 0.3 * np.tanh(omega - middles[columns])))

    asked = []
    columns, omega = np.arange(12), np.linspace(0.0, 10.0, 41)
    sizes = np.array([heights(np.full(12, at), columns) for at in omega])
    rows, asked = np.argmax(sizes, axis=0), []
    together = np.array(polished_peaks(omega, sizes, rows, columns, heights))
    assert sum(asked) < 15 * 12
    alone = [np.ravel(polished_peaks(omega, sizes, rows[k : k + 1], columns[k : k + 1], heights)) for k in columns]
    np.testing.assert_array_equal(together.T, alone)
    np.testing.assert_allclose(together[1], 1.0, rtol=1e-12)


def test_looks_find_it_as_well():
    """A stiff gearbox that is held back by friction on its link: sensitivity falls steeply below its peak, and hardly above."""
    plant = gr.Plant(np.array([[1 / 1.32]]), 0.078, 3420.0, 7.3, link_viscous=0.79)
    loop = gr.build_loop(plant, gr.Drive(789.0, 0.79, 7.4e-3), gr.PD(0.15, 1.05))
    truth = gr.margins(loop)
    peak, _ = look(joint_loops(loop), np.array([[0.15], [1.05], [0.0]]), Reach(2.0, 0.5)).peak(1.0, 0.0)
    assert peak == pytest.approx(truth.peak_sensitivity, rel=1e-8)
