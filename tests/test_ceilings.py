"""Ceilings of a comparison: the disk that a delay reserve is."""

import numpy as np
import pytest

from gainroom.design.comparison.ceilings import Ceilings
from gainroom.errors import GainroomError


def test_the_delay_weight_is_the_distance_that_a_delay_turns():
    """|1 − e^(−jωτ)| up to half a turn; beyond it every smaller delay counts, too, and half a turn is the farthest."""
    ceilings = Ceilings(delay_reserve=1e-3)
    omega = np.linspace(0.0, 9e3, 500)
    smaller = np.abs(1 - np.exp(-1j * np.outer(np.linspace(0, 1, 4001), omega * 1e-3))).max(axis=0)  # largest of the delays up to τ
    assert ceilings.delay_weight(omega) == pytest.approx(smaller, abs=1e-6)  # 4001 delays: second order in 2.2e-3 rad, 6e-7


def test_noise_is_a_share_of_its_ceiling():
    ceilings = Ceilings(1e-3, torque_noise=2.0, sensor_noise={"motor": 3e-6})
    assert ceilings.noise_of("motor") == 1.5e-6
    assert Ceilings(1e-3).noise_of("motor") is None
    with pytest.raises(GainroomError, match="no entry for the sensor 'link'"):
        ceilings.noise_of("link")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"delay_reserve": -1e-3}, "delay_reserve"),
        ({"delay_reserve": float("nan")}, "delay_reserve"),
        ({"delay_reserve": 1e-3, "peak_sensitivity": 1.0}, "peak_sensitivity"),
        ({"delay_reserve": 1e-3, "torque_noise": 0.0}, "torque_noise"),
        ({"delay_reserve": 1e-3, "sensor_noise": {"moter": 1e-6}}, "'moter' is no sensor"),
        ({"delay_reserve": 1e-3, "sensor_noise": {"motor": -1e-6}}, "sensor_noise of motor"),
    ],
)
def test_what_is_no_ceiling_is_refused(given: dict, message: str):
    with pytest.raises(GainroomError, match=message):
        Ceilings(**given)
