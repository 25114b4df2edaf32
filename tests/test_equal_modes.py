"""Limbs that vibrate at the same limit: all are named, and round-off, which differs from machine to machine, decides nothing."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.analysis.equal_modes import common_mode
from gainroom.studies.critical_joints import critical_joints
from gainroom.studies.state import limiting_joints
from gainroom.system.linear.arrays import first_least, rank
from independent.loci.limit import limit_from_loci

DRIVE = gr.Drive(4000.0, 0.9, 2e-3)
LEG = np.array([[0.9, -0.3, 0.1], [-0.3, 0.5, -0.2], [0.1, -0.2, 2.0]])
NAMES = ("left_hip", "left_knee", "left_ankle", "right_hip", "right_knee", "right_ankle", "neck")
BOTH = {"left_ankle", "right_ankle"}


def legs(digit: int, sample_time: float | None = None, apart: float = 0.0) -> gr.Loop:
    """Two legs on a base that is held, and a neck; `apart`: how much more the right leg has of W."""
    inverse = np.zeros((7, 7))
    inverse[:3, :3], inverse[3:6, 3:6], inverse[6, 6] = LEG, (1 + digit * 2e-16 + apart) * LEG, 0.5
    plant = gr.Plant(inverse, np.tile([0.6, 0.4, 0.1], 3)[:7], np.full(7, 1e4), np.full(7, 2.0), joint_names=NAMES)
    kp, kd = np.tile([400.0, 400.0, 400.0], 3)[:7], np.tile([20.0, 20.0, 20.0], 3)[:7]
    return gr.build_loop(plant, DRIVE, gr.PD(kp, kd), sample_time=sample_time)


@pytest.mark.parametrize("limit_of", [gr.gain_limit, limit_from_loci])
@pytest.mark.parametrize("sample_time", [None, 1e-3])
@pytest.mark.parametrize("digit", range(-2, 3))
def test_equal_legs_are_both_named(limit_of, sample_time, digit):
    loop = legs(digit, sample_time)
    limit = limit_of(loop)
    assert set(limiting_joints(limit, NAMES)) == BOTH
    response = loop.response(np.array([limit.frequency]))[0]
    assert_allclose(limit.gain * response @ limit.mode, -limit.mode, atol=1e-7)  # eigenvalues within 1e-9, times what W's condition adds


def test_of_legs_that_differ_the_first_to_vibrate_is_named():
    limit = gr.gain_limit(legs(0, apart=0.01))
    assert len(limiting_joints(limit, NAMES)) == 1


@pytest.mark.parametrize("digit", range(-2, 3))
def test_equal_legs_are_both_named_where_delay_or_phase_is_lost(digit):
    loop = legs(digit)
    found = gr.joint_margins(loop)
    for name in ("delay_margin", "phase_margin"):
        named = critical_joints(loop, found, NAMES, name)
        assert {one.removeprefix("left_") for one in named if "left" in one} == {
            one.removeprefix("right_") for one in named if "right" in one
        }


def test_the_vectors_that_an_algorithm_finds_do_not_matter():
    """Any that span the same space have the same common mode."""
    random = np.random.default_rng(3)
    for _ in range(50):
        vectors = random.normal(size=(6, 2)) + 1j * random.normal(size=(6, 2))
        mixed = vectors @ (random.normal(size=(2, 2)) + 1j * random.normal(size=(2, 2)))
        assert_allclose(common_mode(mixed), common_mode(vectors), atol=1e-12)
        assert np.abs(common_mode(vectors)).max() == pytest.approx(1, rel=1e-5)  # of parts that are equal to 1e-6 the first is 1


def test_one_vector_is_its_own_mode():
    vector = np.array([[0.1j], [-2.0], [1.0]])
    assert_allclose(common_mode(vector), [-0.05j, 1.0, -0.5], atol=1e-15)


def test_legs_apart_move_alike():
    """The sum of what each has by itself, in phase."""
    left, right = np.array([0.2, 1, 0, 0]), np.array([0, 0, 0.2, 1])
    assert_allclose(common_mode(np.column_stack([left + right, 1j * (left - right)])), left + right, atol=1e-15)


def test_the_first_of_the_least_but_for_round_off():
    assert first_least(np.array([np.nan, 2.0, 1.0 + 1e-13, 1.0])) == 2
    assert first_least(np.array([2.0, 1.0 + 1e-7, 1.0])) == 2
    assert first_least(np.array([np.nan, np.inf])) == first_least(np.full(2, np.nan)) == 0  # nothing is known: any, without an error
    assert rank(1.0 + 1e-13) == rank(1.0) < rank(1.0 + 1e-7)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_limbs_of_which_every_mode_has_equals(count: int):
    """Each limb's limit by itself, whatever the others do."""

    def limit(limbs: int) -> float:
        inverse = np.kron(np.eye(limbs), [[0.9, -0.4], [-0.4, 0.5]])
        plant = gr.Plant(inverse, np.tile([0.6, 0.4], limbs), np.full(2 * limbs, 1e4), np.tile([2.0, 7.0], limbs))
        return gr.gain_limit(gr.build_loop(plant, DRIVE, gr.PD(np.full(2 * limbs, 200.0), np.full(2 * limbs, 20.0)))).gain

    assert limit(count) == pytest.approx(limit(1), rel=1e-9)
