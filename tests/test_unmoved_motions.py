"""Motions that no gain moves: left out of verdict, limit and roots alike, and listed apart; where they grow, they count."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import gainroom as gr
from gainroom.cli import main
from gainroom.cli.example import joint_examples
from gainroom.files import joint_yaml as config
from gainroom.report import joint_text
from gainroom.system.linear.transfer_function import ratio
from gainroom.system.plant import Compliance

DRIVE = gr.Drive(4000.0, 0.9, 2e-3)
JOINT = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0)
TWO = gr.Plant(np.array([[0.9, -0.4], [-0.4, 0.5]]), np.array([0.6, 0.4]), np.full(2, 1e4), np.full(2, 2.0))
HELD = gr.Plant(np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([0.6, 0.4]), np.full(2, 1e4), np.full(2, 2.0))
PUSH = np.array([[1.0], [1.0]])  # a task of one direction of two joints
TOPPLING = gr.Plant(np.diag([0.9, 0.5]), np.array([0.6, 0.4]), np.full(2, 1e4), np.full(2, 2.0), gravity_stiffness=np.diag([50.0, -50.0]))
SPRUNG = gr.Plant(
    np.diag([1.0, 1.0]), np.array([0.6, 0.4]), np.full(2, 1e4), np.full(2, 2.0),
    compliance=Compliance(np.zeros((2, 1)), np.eye(1), np.array([400.0]), np.zeros(1)),
)  # fmt: skip


def gains(kp, kd):
    return gr.PD(np.array(kp, dtype=float), np.array(kd, dtype=float))


# plant, controller, roots at rest or ringing that nothing moves
LEFT_ALONE = {
    "one joint without kp": (JOINT, gr.PD(0.0, 10.0), [0.0]),
    "one of two joints without kp": (TWO, gains([200, 0], [20, 10]), [0.0]),
    "one of two joints without gains": (TWO, gains([200, 0], [20, 0]), [0.0]),
    "a task that moves one direction": (TWO, gr.PD(100 * PUSH @ PUSH.T, 10 * PUSH @ PUSH.T), [0.0]),
    "a spring that no joint feels": (SPRUNG, gains([200, 100], [20, 10]), [20j, -20j]),
}


@pytest.mark.parametrize("sample_time", [None, 1e-3])
@pytest.mark.parametrize("name", LEFT_ALONE)
def test_every_answer_leaves_them_out(name, sample_time):
    plant, controller, still = LEFT_ALONE[name]
    loop = gr.build_loop(plant, DRIVE, controller, sample_time=sample_time)
    found = gr.rightmost_roots(loop, count=6)
    assert gr.is_stable(loop)
    assert gr.gain_limit(loop).stable
    assert gr.joint_margins(loop).stable
    assert found.roots.real.max() < 0
    assert found.unmoved == pytest.approx(still, abs=1e-3)  # a pair at 0 is known to the root of round-off


@pytest.mark.parametrize("sample_time", [None, 1e-3])
def test_what_grows_counts_though_nothing_moves_it(sample_time):
    """The second joint topples, and only the first has gains."""
    loop = gr.build_loop(TOPPLING, DRIVE, gains([200, 0], [20, 0]), sample_time=sample_time)
    limit = gr.gain_limit(loop)
    assert not gr.is_stable(loop)
    assert not limit.stable
    assert limit.gain == 0
    assert gr.rightmost_roots(loop, count=2).roots[0].real > 1


def test_one_joint_and_two_such_joints_agree():
    """A pair of joints that know nothing of each other is as stable as each, kp or none."""
    pair = gr.Plant(np.eye(2) / 0.8, np.full(2, 0.2), np.full(2, 1e4), np.full(2, 1.0))
    for kp, kd in ((0.0, 10.0), (400.0, 10.0), (400.0, 0.01), (0.0, 500.0)):
        single, both = gr.build_loop(JOINT, DRIVE, gr.PD(kp, kd)), gr.build_loop(pair, DRIVE, gr.PD(kp, kd))
        assert gr.is_stable(single) == gr.is_stable(both) == gr.gain_limit(single).stable == gr.gain_limit(both).stable


def test_closed_chains_hold_what_contacts_hold():
    """W is singular: the held motion of the motors is moved by the gains, and counts."""
    loop = gr.build_loop(HELD, DRIVE, gains([200, 100], [20, 10]))
    assert gr.is_stable(loop)
    assert not len(gr.rightmost_roots(loop).unmoved)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_round_off_of_what_contacts_hold_limits_no_joint(seed):
    """Tasks on legs closed by the ground: zero eigenvalues of W are round-off, of either sign; largest gains know nothing of it."""
    random = np.random.default_rng(seed)
    held, joints = 3, 6
    reached = random.normal(size=(joints, joints - held))
    task, kp, kd = np.linalg.pinv(reached).T, np.diag([300.0, 200.0, 100.0]), np.diag([30.0, 20.0, 15.0])
    inertia, stiffness, damping = np.full(joints, 0.6), np.full(joints, 1e4), np.full(joints, 2.0)

    def curve(omega):
        """δ c_i of each joint i, by the textbook's formulas, from W = X Xᵀ: 1 + δ c_i = 0 where kd_i + δ lets the loop vibrate."""
        s = 1j * np.atleast_1d(omega)[:, None, None]
        compliant = reached @ reached.T + s**2 * np.diag(1 / stiffness) / (1 + s * damping[0] / stiffness[0])
        moved = compliant @ np.linalg.inv(np.eye(joints) + np.diag(inertia) @ compliant) / s**2
        moved = moved * 4000.0**2 / (s**2 + 2 * 0.9 * 4000.0 * s + 4000.0**2) * np.exp(-2e-3 * s)
        closed = np.linalg.solve(np.eye(joints) + moved @ (task @ (kp + s * kd) @ task.T), moved)
        return s[:, 0] * np.diagonal(closed, axis1=1, axis2=2)

    omega = np.geomspace(0.05, 2e4, 100_000)
    values = curve(omega)
    expected = np.full(joints, np.inf)
    for row, joint in zip(*np.nonzero((values.imag[1:] * values.imag[:-1] < 0) & (values.real[1:] < 0)), strict=True):
        place = brentq(lambda at, joint=joint: curve(at)[0, joint].imag, omega[row], omega[row + 1], xtol=1e-13)
        expected[joint] = min(expected[joint], -1 / curve(place)[0, joint].real)
    assert np.all(np.isfinite(expected))
    for digit in range(4):
        noise = random.normal(size=(joints, joints)) * 2e-16
        plant = gr.Plant(reached @ reached.T * (1 + 0.5 * (noise + noise.T)), inertia, stiffness, damping)
        controller = gr.PD(task @ kp @ task.T, task @ kd @ task.T)
        found = gr.joint_margins(gr.build_loop(plant, DRIVE, controller))
        assert found.stable
        assert found.certified, digit
        largest = np.diagonal(controller.kd) + expected
        assert found.one_loop.largest_kd == pytest.approx(largest, rel=1e-8)  # of brentq's place, 1e-13 rad/s


def raised(controller, joint, which, more):
    """`more` of one joint's gain on itself."""
    gain = np.diag(getattr(controller, which)) if np.ndim(getattr(controller, which)) < 2 else getattr(controller, which).copy()
    gain[joint, joint] += more
    return replace(controller, **{which: gain})


@pytest.mark.parametrize("sample_time", [None, 1e-3])
@pytest.mark.parametrize("friction", [0.3, 1e-3])
@pytest.mark.parametrize("side", ["motor_viscous", "link_viscous"])
def test_a_joint_that_drifts_has_a_largest_kp(side, friction, sample_time):
    """Without gains, and braked by friction: its curve rises without bound towards rest, beside which the crossing is small."""
    plant, controller = replace(TWO, **{side: np.full(2, friction)}), gains([200, 0], [20, 0])
    found = gr.joint_margins(gr.build_loop(plant, DRIVE, controller, sample_time=sample_time)).one_loop
    for share, stable in ((0.99, True), (1.01, False)):
        changed = raised(controller, 1, "kp", share * found.largest_kp[1])
        assert gr.is_stable(gr.build_loop(plant, DRIVE, changed, sample_time=sample_time)) is stable


@pytest.mark.parametrize("sample_time", [None, 1e-3])
@pytest.mark.parametrize("joint", [0, 1])
def test_kp_of_one_joint_beside_a_task_that_leaves_it_adrift(joint, sample_time):
    """What the task does not move swings on that kp alone, and on the delay: hardly any is stable, and kd has its limit far above."""
    controller = gr.PD(100 * PUSH @ PUSH.T, 10 * PUSH @ PUSH.T)
    one = gr.joint_margins(gr.build_loop(TWO, DRIVE, controller, sample_time=sample_time)).one_loop

    def stable(which, more):
        return gr.is_stable(gr.build_loop(TWO, DRIVE, raised(controller, joint, which, more), sample_time=sample_time))

    assert one.certified[joint]
    room = one.largest_kp[joint] - 100
    assert room == pytest.approx(0, abs=1e-6) or (stable("kp", 0.99 * room) and not stable("kp", 1.01 * room))
    room = one.largest_kd[joint] - 10
    assert stable("kd", 0.99 * room)
    assert not stable("kd", 1.01 * room)


HOLDS_OR_DRIFTS = [
    (gr.PD(0.0, 10.0), True),
    (gr.PID(0.0, 0.0, 10.0), True),
    (gr.PPI(0.0, 10.0), True),
    (gr.PD(1e-3, 10.0), False),
    (gr.PPI(0.0, 10.0, 5.0), False),  # the integral of a velocity is a position
]


@pytest.mark.slow
@pytest.mark.parametrize(("controller", "drifts"), HOLDS_OR_DRIFTS)
def test_one_joint_that_drifts_is_told_so(controller, drifts, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """A file's kp must be above 0; a script's may be 0."""
    spec = config.parse_joint(joint_examples()["testbed"], "testbed")
    monkeypatch.setattr(config, "load_joint", lambda file, **options: spec.with_controller(controller))
    for as_json in (False, True):
        assert main(["joint", "testbed", *(["--json"] if as_json else [])]) == 0
        out = capsys.readouterr().out
        told = " ".join(json.loads(out)["warnings"]) if as_json else " ".join(out.split())
        assert ("no torque holds the joint's position, so it drifts" in told) is drifts


@pytest.mark.parametrize("last", [0.0, 1.0])
def test_a_compensator_that_passes_no_standing_error_drifts(last):
    spec = config.parse_joint(joint_examples()["testbed"], "testbed")
    warnings = joint_text.warnings(gr.study_joint(spec.with_controller(gr.Compensator(ratio([10.0, last], [1e-3, 1.0])))))
    assert any("against a constant error: no torque holds the joint's position" in warning for warning in warnings) is (last == 0)


def test_a_file_may_not_leave_kp_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "joint.yaml"
    file.write_text(joint_examples()["testbed"].replace("kp: 1600.0", "kp: 0"), "utf-8")
    assert main(["joint", str(file)]) == 2
    assert "control.kp: 0 must be > 0" in capsys.readouterr().err
