"""Joints at the edge of the model: rigid, undamped, output locked, nothing that rolls off, gains of zero, free to drift."""

import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from independent.joint import PDJoint
from wide_joints import Case

JOINTS = {
    "rigid": gr.ElasticJoint(0.025, 0.15),
    "undamped": gr.ElasticJoint(0.025, 0.15, 400.0),
    "locked": gr.ElasticJoint(0.025, math.inf, 400.0, 0.5),
    "locked, undamped": gr.ElasticJoint(0.025, math.inf, 400.0),
    "ordinary": gr.ElasticJoint(0.025, 0.15, 400.0, 0.5),
    "viscous": gr.ElasticJoint(0.025, 0.15, 400.0, 0.5, 0.01, 0.02),
}
DRIVES = {
    "ideal": gr.Drive(),
    "current loop": gr.Drive(4000.0),
    "delay": gr.Drive(delay=3e-3),
    "both": gr.Drive(4000.0, 0.9, 3e-3),
}
CONTROLLERS = {"PD": gr.PD(60.0, 1.5), "PID": gr.PID(60.0, 100.0, 1.5), "PPI": gr.PPI(40.0, 1.5, 9.0)}


@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("joint", JOINTS)
def test_region_is_the_certified_count(joint, drive, controller, sample_time):
    """Carried across crossings, the count must be what the Nyquist count of each loop alone says, over nine decades of gains."""
    rng = np.random.default_rng(len(joint) + 7 * len(drive) + 31 * len(controller))
    for feedback in ("motor",) if "locked" in joint else ("motor", "link"):
        region = gr.pd_region(JOINTS[joint], DRIVES[drive], controller=CONTROLLERS[controller], sample_time=sample_time, feedback=feedback)
        kp = np.append(10 ** rng.uniform(-3, 5, 3), [-1.0, 1e-6])
        kd = rng.choice([-1, 1], 5, p=[0.2, 0.8]) * 10 ** rng.uniform(-4, 3, 5)
        expected = [gr.is_stable(gr.loop_from(region.scalar(p, d))) for p, d in zip(kp, kd, strict=True)]
        assert region.contains(kp, kd).tolist() == expected


def test_nothing_limits_an_ideal_rigid_joint():
    region = gr.pd_region(JOINTS["rigid"], DRIVES["ideal"])
    assert region.max_kp() == math.inf
    assert region.max_kd(60.0) == math.inf
    assert gr.recommend_pd(JOINTS["rigid"], DRIVES["ideal"]) is None


def test_zero_gains_have_no_margins_and_are_not_stable():
    loop = gr.build_loop(JOINTS["ordinary"], DRIVES["both"], gr.PD(0, 0))
    found = gr.margins(loop)
    assert (found.stable, found.unstable_roots) == (False, 2)  # the two integrators
    assert not gr.is_stable(loop)
    with pytest.raises(gr.GainroomError, match="zero"):
        gr.gain_limit(loop)


@pytest.mark.parametrize("sample_time", [None, 5e-4], ids=["continuous", "sampled"])
@pytest.mark.parametrize("kp", [(1000, 1000), (1000, 0), (0, 0), (1000, 1e-3)])
def test_two_joints_one_of_them_slow(kp, sample_time):
    """A joint with kp = 0 stays where it is pushed, with kp slightly above 0 it creeps back: at 1e-5 among others at 1e3."""
    plant = gr.Plant(np.array([[1 / 16, 0.01], [0.01, 1 / 8]]), np.ones(2), np.full(2, 1e4), np.ones(2))
    loop = gr.build_loop(plant, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(np.array(kp, float), 100.0), sample_time=sample_time)
    assert gr.is_stable(loop)
    assert gr.rightmost_roots(loop).lost == 0


def test_what_topples_within_a_tick_is_refused():
    """Held upright by nothing against 1e11 N m/rad: e^300 per millisecond, of which no sampled model keeps a digit."""
    plant = gr.Plant(np.array([[1.0]]), np.array([0.1]), np.array([math.inf]), gravity_stiffness=np.array([[-1e11]]))
    with pytest.raises(gr.GainroomError, match=r"grows by itself at .*too fast to be sampled every 1 ms"):
        gr.build_loop(plant, gr.Drive(), gr.PD(100.0, 1.0), sample_time=1e-3)


@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
@pytest.mark.parametrize("damping", [0.0, 1.0])
@pytest.mark.parametrize("factor", [1e-12, 1e-9, 1.0, 1e9, 1e12])
def test_roots_on_the_boundary_under_any_gain(factor, damping, sample_time):
    """L is 0 at the notch and infinite at an undamped resonance, however large or small a relative 2e-12 beside them."""
    delay = 2e-3 if factor < 1e12 else 1e-4  # with which |L| > 1 for some 3000 turns of L, rather than 60 000
    joint = PDJoint(0.2, 0.8, 1e4, damping, kp=0.0, kd=0.0, delay=delay, bandwidth=4000.0)
    case = Case(joint, "PD", (1600.0 * factor, 70.0 * factor), notches=((300.0, 0.5, 0.0),), sample_time=sample_time)
    assert gr.margins(case.loop()).unstable_roots == case.truth().count()


def test_values_beyond_all_reckoning_are_unstable_and_what_is_not_known_is_said(tmp_path, capsys):
    """Each is allowed by itself; together |L| is 1e18 at 1 rad/s, and arg L turns fifty thousand times before |L| < 1."""
    path = tmp_path / "joint.yaml"
    path.write_text(
        "joint: {motor_inertia: 1.0e-12, link_inertia: 1.0e12, stiffness: 1.0e-12}\n"
        "drive: {bandwidth: 4000, delay_ms: 2}\ncontrol: {type: pd, kp: 1.0e6, kd: 1.0e6, feedback: motor}\n",
        "utf-8",
    )
    assert main(["joint", str(path)]) == 1
    printed = capsys.readouterr().out
    doubts, verdict = " ".join(printed.split()).split(" Not safe: ", 1)
    assert doubts.startswith("Warning: motor_inertia 1·10⁻¹² kg·m² is far outside the usual")
    assert verdict.startswith("unstable. Whether lower gains in the same ratio are stable is not known.")
    assert "could not be certified" in printed.replace("\n", " ")
