"""Figs. 12 and 14 in MuJoCo: the robot stays up on flat feet, PD leaves what the paper prints, P/PI less."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.paper.biped import MOVE
from gainroom.paper.com_motion import LAWS, MOTION, ComMotion, motion, pd_rows, ppi_rows, setup


@pytest.mark.slow
@pytest.mark.parametrize("controller", LAWS)
def test_it_stays_balanced(controller):
    found = motion(controller)
    assert found.run.ending == "completed"
    # Both soles end where they stood; on the way one may rock by a few mm on its edge, but it does not slide away.
    assert found.run.slip[::50].max() < 8e-3
    assert found.run.slip[-1].max() < 2e-3
    assert_allclose((found.run.reference[-1] - found.run.reference[0])[:3], MOVE, atol=1e-12)
    travelled = found.run.actual[-1, :3] - found.run.actual[0, :3]
    assert np.abs(travelled - MOVE).max() < 0.02
    assert np.abs(found.run.error[:, 3:]).max() < 0.1  # the pelvis, rad


@pytest.mark.slow
def test_pd_leaves_what_the_paper_prints():
    """Friction was set for this."""
    assert_allclose(1e3 * np.abs(motion("pd").steady), (14.0, 5.1, 13.0), atol=1.0)


def on_the_way(found: ComMotion) -> np.ndarray:
    """(3,) root mean square of the error over the motion."""
    moving = (found.time >= 0) & (found.time < MOTION)
    return np.sqrt(np.mean(found.error[moving] ** 2, axis=0))


def test_ppi_leaves_less_in_every_direction_and_improves_less_on_the_way():
    pd, ppi = motion("pd"), motion("ppi")
    assert (np.abs(ppi.steady) < np.abs(pd.steady)).all()
    improved = 1 - np.abs(ppi.steady) / np.abs(pd.steady)
    assert (1 - on_the_way(ppi) / on_the_way(pd) < improved).all()


def test_it_stands_still_in_the_end():
    """PD sticks: what is called its steady-state error does not move any more."""
    late = motion("pd").error[-400:]
    assert np.ptp(late, axis=0).max() < 1e-5


def test_friction_is_what_holds_it():
    """The ankles' pitch and every other joint rub by the stated torques, on the motors' side, and the drives are the example's."""
    asked = setup("pd")
    assert sorted(set(np.asarray(asked.coulomb).tolist())) == [4.5, 21.0]
    assert set(asked.actuators.motor_viscous.tolist()) == {10.0}
    assert {drive.delay for drive in asked.drives} == {2e-3}
    assert asked.sample_time == 5e-4


def test_rows_are_told_as_they_are():
    found = {row.id: row for row in (*pd_rows(), *ppi_rows())}
    for key, printed in (("fig12.x", 14.0), ("fig12.y", 5.1), ("fig12.z", 13.0), ("fig14.x", 5.6), ("fig14.y", 2.9), ("fig14.z", 1.0)):
        assert found[f"{key}.steady_error_mm"].paper == printed
    assert all(found[f"fig12.{k}.steady_error_mm"].agrees for k in "xyz")
    assert all(found[f"fig14.{k}.below_pd"].agrees for k in "xyz")
