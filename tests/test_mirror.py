"""Contact states that mirror each other: told from plants alone, and only where the loops are the same."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from gainroom.analysis.stability import unstable_roots
from gainroom.design.gain_cases import case_of, joint_state
from gainroom.design.gain_sets import GainSet, StateStiffness
from gainroom.design.mirror import mirror_image, mirror_of
from gainroom.design.robot_gains import recommend_robot
from gainroom.files.robot_yaml import parse_robot
from gainroom.system.drive import Drive
from gainroom.system.requirements import Requirements
from gainroom.system.system import StateCase, System

OMEGA = np.array([3.0, 40.0, 300.0])


@pytest.fixture(scope="module")
def biped() -> System:
    text = files("gainroom").joinpath("files", "examples", "biped.yaml").read_text("utf-8")
    return parse_robot(text.replace("  crouch:", "  # crouch:"), "biped.yaml")


def states(system: System, contact: str, space: str) -> list[tuple[StateCase, object]]:
    return [(case, case_of(case, space)) for case in system.cases(weight=space == "joint") if case.contact == contact]


@pytest.mark.parametrize("space", ["joint", "task"])
def test_mirrored_loops_have_the_same_characteristic_polynomial(biped: System, space: str):
    """det(I + L) of random gains in one state is that of the same gains in the other order in the other state, at any frequency."""
    left, right = (states(biped, contact, space) for contact in ("left", "right"))
    order = mirror_of(left, right)
    assert order is not None
    np.testing.assert_array_equal(order, [*range(6, 12), *range(6)])
    gains = np.random.default_rng(3).uniform(0.5, 2.0, (3, len(left[0][1].cascade))) * np.array([[800.0], [60.0], [0.0]])
    mirrored = gains[:, order] if space == "joint" else gains
    for (_, one), (_, other) in zip(left, right, strict=True):
        truth, found = (np.linalg.det(np.eye(12) + case.loop(own).response(OMEGA)) for case, own in ((one, gains), (other, mirrored)))
        np.testing.assert_allclose(found, truth, rtol=1e-7)  # round-off of 12 joints' loops of size 1e3


def test_what_is_not_the_same_is_no_mirror_image(biped: System):
    left, right = (states(biped, contact, "joint") for contact in ("left", "right"))
    ((case, loops),) = right
    heavier = case.model.link_inverse_inertia * np.outer(scale := np.where(np.arange(12) == 3, 1 + 1e-6, 1.0), scale)
    stiffer = np.where(np.arange(12) == 8, 1 + 1e-6, 1.0) * case.model.stiffness
    for change in ({"link_inverse_inertia": heavier}, {"stiffness": stiffer}, {"gravity_stiffness": 1.01 * case.model.gravity_stiffness}):
        assert mirror_of(left, [(replace(case, model=replace(case.model, **change)), loops)]) is None
    drives = (*case.system.drives[:-1], Drive(4000.0, 0.9, 2.1e-3))
    assert mirror_of(left, [(replace(case, system=replace(case.system, drives=drives)), loops)]) is None
    assert mirror_of(left, states(biped, "flight", "joint")) is None
    assert mirror_of(left, []) is None


@pytest.mark.slow
def test_mirrored_states_get_the_same_gains_in_the_other_order(biped: System):
    """And every margin of the image is looked at in its own state."""
    found = recommend_robot(biped, "task").per_contact
    left, right = found["left"], found["right"]
    assert isinstance(left, GainSet)
    assert isinstance(right, GainSet)
    np.testing.assert_array_equal(left.kp, right.kp)
    assert {one.partition("/")[2] for one in right.case if one} == {"right"}
    assert {one.partition("/")[2] for one in left.case if one} == {"left"}
    ((_, case),) = states(biped, "right", "task")
    own = case.all_margins(np.nan_to_num(np.array([right.kp, right.kd, np.zeros(6)])))
    assert biped.requirements.met_by(own)
    assert own.gain_margin == pytest.approx(right.margins.gain_margin, rel=1e-9)


def test_an_image_without_the_weight_says_where_it_topples(biped: System):
    """Gains too soft to hold the weight: what topples is counted in the state of the image, and what came nearest speaks of it."""
    left, right = ([joint_state(case) for case in biped.cases(weight=True) if case.contact == contact] for contact in ("left", "right"))
    kp, kd, none = np.linspace(150.0, 250.0, 12), np.linspace(40.0, 60.0, 12), ("",) * 12
    soft = np.array([kp, kd, np.zeros(12)])
    assert unstable_roots(left[0].with_weight.loop(soft)) > 0
    margins = left[0].without.all_margins(soft)
    near = "gain margin 2 dB of 6 dB in stand/left"
    stand = ("stand/left",)
    links = StateStiffness("stand/left", "left", 0.5 * kp, 1 / kp, np.arange(12) == 4)
    found = GainSet("left", kp, kd, None, margins, "stand/left", 1, (links,), none, 12 * stand, 12 * (False,), 3, True, near, stand)
    image = mirror_image(found, left, right, Requirements(gain_margin=1.05))
    assert image is not None
    assert image.without_weight
    assert image.nearest == "gain margin 2 dB of 6 dB in stand/right"
    assert image.topples == ("stand/right",)
    assert unstable_roots(right[0].with_weight.loop(np.array([image.kp, image.kd, np.zeros(12)]))) > 0
    assert image.softest == 9
    np.testing.assert_array_equal(image.kp, [*kp[6:], *kp[:6]])
    (turned,) = image.links
    assert (turned.title, turned.contact) == ("stand/right", "right")
    np.testing.assert_array_equal(turned.stiffness, 0.5 * image.kp)
    assert np.flatnonzero(turned.gear_limited).tolist() == [10]
