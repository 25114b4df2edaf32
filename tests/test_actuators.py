"""Actuators and drives from entries by pattern: what is merged, what wins, what is refused."""

import contextlib
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

from gainroom.errors import GainroomError
from gainroom.robot.actuators import Actuators, actuators_of, drives_of, merge_entries
from gainroom.robot.name_patterns import LONGEST, assign, compile_pattern, select
from gainroom.system.actuator_entry import ActuatorEntry
from gainroom.system.drive import Drive
from refusals import assert_refused

NAMES = ("l_hip", "l_knee", "r_hip", "r_knee")
DEFAULT = ActuatorEntry(rotor_inertia=1e-4, gear_ratio=100.0, stiffness=1e4, damping=1.0)
NO_ARMATURE = np.zeros(4)


def moved() -> np.ndarray:
    return np.array([1.0, 2.0, 3.0, 4.0])


def test_later_entries_win_key_by_key():
    entries = {"default": DEFAULT, ".*_knee": ActuatorEntry(gear_ratio=144.0), "l_.*": ActuatorEntry(stiffness=5e3, link_viscous=0.3)}
    found, warnings = actuators_of(merge_entries(entries, NAMES), NAMES, NO_ARMATURE, moved)
    assert_allclose(found.motor_inertia, [1.0, 1e-4 * 144**2, 1.0, 1e-4 * 144**2], rtol=1e-15)
    assert_allclose(found.stiffness, [5e3, 5e3, 1e4, 1e4])
    assert_allclose(found.damping, 1.0)
    assert_allclose(found.motor_viscous, 0.0)
    assert_allclose(found.link_viscous, [0.3, 0.3, 0.0, 0.0])
    assert warnings == ()


def test_default_comes_first_wherever_it_stands():
    entries = {"l_hip": ActuatorEntry(stiffness=5.0), "default": DEFAULT}
    assert [entry.stiffness for entry in merge_entries(entries, NAMES)] == [5.0, 1e4, 1e4, 1e4]


def test_an_inertia_replaces_a_rotor_with_its_gear_and_back():
    direct = ActuatorEntry(motor_inertia=0.5)
    assert direct.over(DEFAULT).reflected("joint") == 0.5
    assert DEFAULT.over(direct).reflected("joint") == pytest.approx(1.0)
    assert DEFAULT.over(direct).motor_inertia is None


def test_a_name_that_is_also_a_pattern_means_itself():
    names = ("arm.1", "arm-1", "arm(1)")
    assert select("arm.1", names, "joints") == (0,)
    assert select("arm(1)", names, "joints") == (2,)
    assert select("arm[.-]1", names, "joints") == (0, 1)
    assert_refused(lambda: select("arm", names, "joints"), ["joints: 'arm' matches no joint", "did you mean"])  # whole names only


def test_armature_is_used_where_nothing_is_given_and_said():
    entries = merge_entries({"l_.*": ActuatorEntry(motor_inertia=0.2)}, NAMES)
    found, warnings = actuators_of(entries, NAMES, np.array([0.1, 0.1, 0.1, 0.0]), moved)
    assert_allclose(found.motor_inertia, [0.2, 0.2, 0.1, 0.0])
    assert np.all(np.isinf(found.stiffness))
    armature, bare, rigid = warnings
    assert "armature" in armature
    assert "r_hip 0.1" in armature
    assert "l_hip" not in armature
    assert "rigid with motor inertia 0: r_knee" in bare
    assert "rigid, so limits are optimistic: l_hip, l_knee, r_hip;" in rigid


def test_an_elastic_joint_without_an_inertia_has_a_tenth_of_what_it_moves_and_it_is_said():
    entries = merge_entries(
        {"default": ActuatorEntry(damping=1.0), "l_.*": ActuatorEntry(stiffness=1e4), "r_hip": ActuatorEntry(gearbox="belt")}, NAMES
    )
    found, (guess, bare) = actuators_of(entries, NAMES, NO_ARMATURE, moved)
    assert_allclose(found.motor_inertia, [0.1, 0.2, 0.3, 0.0])
    assert found.without_inertia.all()
    assert_allclose(found.guessed, [True, True, True, False])
    assert np.isnan(found.known["motor_inertia"][:3]).all()
    assert "a tenth of what the motor moves [kg m²]: l_hip 0.1, l_knee 0.2, r_hip 0.3; give motor_inertia" in guess
    assert "rigid with motor inertia 0: r_knee" in bare
    found, _ = actuators_of(entries, NAMES, np.full(4, 0.3), moved)
    assert_allclose(found.motor_inertia, 0.3)
    assert not found.without_inertia.any()


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (ActuatorEntry(rotor_inertia=1e-4), ["joint 'l_hip'", "rotor_inertia needs gear_ratio"]),
        (ActuatorEntry(gear_ratio=50.0), ["joint 'l_hip'", "gear_ratio needs rotor_inertia"]),
        (ActuatorEntry(motor_inertia=1.0, gear_ratio=50.0), ["joint 'l_hip'", "gear_ratio has no meaning beside motor_inertia"]),
    ],
)
def test_half_a_motor_is_refused(entry: ActuatorEntry, words: list[str]):
    assert_refused(lambda: actuators_of((entry,) * 4, NAMES, NO_ARMATURE, moved), words)


def test_drives_differ_where_an_entry_says_so():
    entries = merge_entries({".*_knee": ActuatorEntry(delay=3e-3), "l_knee": ActuatorEntry(bandwidth=math.inf, damping_ratio=0.7)}, NAMES)
    drives = drives_of(entries, Drive(4000.0, 0.9, 2e-3))
    assert drives[0] == drives[2] == Drive(4000.0, 0.9, 2e-3)
    assert drives[1] == Drive(math.inf, 0.7, 3e-3)
    assert drives[3] == Drive(4000.0, 0.9, 3e-3)


def test_actuators_are_checked():
    good = np.ones(2)
    assert_refused(lambda: Actuators(good, good, good, good, np.ones(3)), ["must all be (n,)"])
    assert_refused(lambda: Actuators(good, -good, good, good, good), ["stiffness -1 must be a number > 0"])
    assert_refused(lambda: Actuators(0 * good, good, good, good, good), ["motor_inertia 0", "elastic"])
    assert Actuators(0 * good, np.inf * good, good, good, good).motor_inertia[0] == 0


@pytest.mark.parametrize(
    ("pattern", "words"),
    [
        ("l_.*)", ["is not a regular expression"]),
        ("[", ["is not a regular expression"]),
        ("[[a]", ["is not a regular expression"]),
        ("(a+)+", ["too many ways"]),
        ("(l|r)*", ["too many ways"]),
        ("(a?){20}", ["too many ways"]),
        (".*.*.*.*", ["too many ways"]),
        ("a?" * 60 + "a" * 60, ["too many ways"]),
        ("(a|a)" * 40, ["too many ways"]),
        ("(?P<side>l|r)_.*", ["no other extensions"]),
        ("(?i)L_HIP", ["no other extensions"]),
        ("x" * (LONGEST + 1), [f"at most {LONGEST}"]),
        ("elbow", ["matches no joint", "joints: l_hip, l_knee, r_hip, r_knee"]),
        ("l_kne", ["did you mean 'l_knee'?"]),
    ],
)
def test_bad_patterns(pattern: str, words: list[str]):
    assert_refused(lambda: select(pattern, NAMES, "joints"), ["joints: ", *words])


def test_classes_and_escapes_are_no_repeats():
    assert select(r"[)*+]?[lr]_(hip|knee)", NAMES, "joints") == (0, 1, 2, 3)
    assert compile_pattern(r"a\)*", "joints").fullmatch("a))")
    assert select("(?:l|r)_(?!knee).*", NAMES, "joints") == (0, 2)
    assert select("(ab)*l_.*|r_hip", NAMES, "joints") == (0, 1, 2)


def test_many_patterns_are_bounded_together():
    """Each is tried in a moment; thousands of them on many joints are not."""
    names = tuple(f"joint_{k}_of_an_arm" for k in range(150))
    slow = {f".*{k}.*.*x|joint_{k}_.*": k for k in range(150)}
    assert_refused(lambda: assign(slow, names, "joints"), ["joints: these patterns", "too many ways together"])
    usual = {f".*_{k}_(of|in)_.*": k for k in range(100)}
    assert [found[-1] for found in assign(usual, names, "joints")[:100]] == list(range(100))
    long = ("a" * LONGEST, "b")
    assert_refused(lambda: assign({".*.*.*|b": 1}, long, "joints"), ["too many ways"])  # a name's own length counts


@pytest.mark.timeout(60)
@settings(max_examples=400, deadline=None)
@given(st.text("ab.*+?()[]{}|\\^$1,", max_size=60))
def test_no_pattern_takes_long(pattern: str):
    """What is accepted answers at once on names made to mislead it; a pattern that backtracks freely would take hours."""
    with contextlib.suppress(GainroomError):
        assert any(assign({pattern: 1}, ("a" * LONGEST, "ab" * (LONGEST // 2)), "joints"))
