"""One joint of a robot compared, all others closed: against a chain closed by hand, the margins of the whole robot, and a single joint."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import gainroom as gr
from compared_joints import COUNT, TICK as TICK_OF_JOINTS, joint
from gainroom.cli import main
from gainroom.cli.example import example_texts
from gainroom.design.comparison.catalogue import structure_of
from gainroom.design.comparison.ceilings import Ceilings
from gainroom.design.comparison.certificate import Certificate
from gainroom.design.comparison.closed_loop import curves, is_stable
from gainroom.design.comparison.compared_joint import ComparedJoint, Spot
from gainroom.design.comparison.exact_joint import ExactJoint
from gainroom.design.comparison.joint_responses import HOST, Joint, Opened, opened
from gainroom.design.comparison.objective import Objective
from gainroom.design.comparison.opened_loop import opened_loop
from gainroom.design.comparison.robot_controllers import robot_with
from gainroom.design.comparison.structure_search import Problem
from gainroom.design.comparison.two_rates import largest_root
from gainroom.errors import GainroomError
from gainroom.files.compared_joint import compared_robot_text, gains_section
from gainroom.files.joint_yaml import parse_joint
from gainroom.files.robot_yaml import parse_robot
from gainroom.system.assembly import Parts
from gainroom.system.feedback import feedback_of
from gainroom.system.plant import Plant
from gainroom.system.system import System

TICK = 1e-3
W = np.array([[0.5, -0.3], [-0.3, 0.9]])
MOTORS, STIFFNESS, DAMPING = np.array([0.8, 0.4]), np.array([5e3, 2e3]), np.array([1.0, 0.6])
KP, KD = np.array([600.0, 250.0]), np.array([40.0, 18.0])
PATH = gr.GainPath(1e-4, 5e-5)


def chain(delay: float = 2e-3) -> Parts:
    """Two joints with ideal current loops, PD on the motors."""
    plant, law = Plant(W, MOTORS, STIFFNESS, DAMPING), gr.PD(KP, KD)
    return Parts(plant, (gr.Drive(delay=delay),) * 2, law, feedback_of("motor", law), TICK)


def by_hand(joint: int, z: complex) -> np.ndarray:
    """Responses (motor, link, spring torque) × (own command, own load) of the chain, two ticks late, the other joint's loop closed."""
    k, b = np.diag(STIFFNESS), np.diag(DAMPING)
    motor, zero, eye = np.diag(1 / MOTORS), np.zeros((2, 2)), np.eye(2)
    # θ, q, θ̇, q̇
    a = np.block(
        [[zero, zero, eye, zero], [zero, zero, zero, eye], [-motor @ k, motor @ k, -motor @ b, motor @ b], [W @ k, -W @ k, W @ b, -W @ b]]
    )
    inputs = np.block([[zero, zero], [zero, zero], [motor, zero], [zero, W]])
    whole = expm(TICK * np.block([[a, inputs], [np.zeros((4, 12))]]))
    f, g = whole[:8, :8], whole[:8, 8:]
    other = 1 - joint
    x = np.linalg.solve(z * np.eye(8) - f, g)
    position = x[:2]
    late = z**-2
    law = KP[other] + KD[other] * (1 - 1 / z) / TICK
    # u_other = −law z⁻² θ_other
    closing = -law * late / (1 + law * late * position[other, other])
    full = x + np.outer(x[:, other], closing * position[other])
    spring = STIFFNESS[joint] * (full[joint] - full[2 + joint]) + DAMPING[joint] * (full[4 + joint] - full[6 + joint])
    rows = np.array([full[joint], full[2 + joint], spring])
    return rows[:, [joint, 2 + joint]] * np.array([late, 1.0])


@pytest.mark.parametrize("index", [0, 1])
def test_a_chain_with_its_other_joint_closed_is_that_closed_by_hand(index):
    """Round-off is that of two exponentials, where the response has rolled off."""
    omega = np.geomspace(0.5, 3000.0, 40)
    found = ExactJoint.of(chain(), index).at(omega)
    asked = np.array([by_hand(index, np.exp(1j * one * TICK)) for one in omega])
    np.testing.assert_allclose(found, asked, rtol=1e-8)
    one = Joint(Opened(chain(), index), {HOST: 1e-3}, None).at(omega)
    # of the triangular form, where the response has rolled off (system/linear/triangular.py)
    np.testing.assert_allclose(one.commands[HOST], asked[:, :, 0], rtol=1e-6)
    np.testing.assert_allclose(one.load, asked[:, :, 1], rtol=1e-6)


@pytest.mark.parametrize("other", [1.0, 40.0], ids=["calm", "unstable while this one is open"])
def test_turns_and_roots_count_what_the_whole_robot_counts(other):
    """Of random gains in one joint, the other's as they are: the whole chain's roots are those of the core's other mechanism."""
    parts = chain()
    parts = replace(parts, controller=gr.PD(KP * [1.0, other], KD * [1.0, other]))
    system = gr.System.of_joint(
        gr.ElasticJoint(MOTORS[0], 1 / W[0, 0], STIFFNESS[0], DAMPING[0]), parts.drives[0], gr.PD(1.0, 1.0), sample_time=TICK
    )
    structure = structure_of("pd").scaled_to(system, PATH)
    low, high = structure.box
    x = low - 1 + (high - low + 2) * np.random.default_rng(0).random((60, 2))
    one = Joint(Opened(parts, 0), {HOST: 1e-3}, None)
    assert (np.abs(1 + TICK * one.opened.poles).max() > 1 + 1e-4) == (other > 1)
    omega = one.grid(3.0)
    found = curves(structure, x, one, one.at(omega), Ceilings(1e-3))
    turned = is_stable(structure, x, one.turns(omega), found.returned)
    roots, exact = [], []
    for kp, kd in structure.values(x).tolist():
        controller = gr.PD(np.array([kp, other * KP[1]]), np.array([kd, other * KD[1]]))
        exact.append(gr.is_stable(gr.build_loop(parts.plant, parts.drives, controller, sample_time=TICK)))
        roots.append(gr.margins(opened_loop(one.opened, system.with_controller(gr.PD(kp, kd)))).stable)
    assert roots == exact
    clear = 2 * found.sensitivity.max(axis=1) < 10
    np.testing.assert_array_equal(turned[clear], np.array(exact)[clear])
    assert any(exact) or other > 1
    assert not all(exact)


@pytest.mark.parametrize("seed", [1, 2])
def test_roots_of_two_rates_are_those_of_the_lifted_loop(seed):
    """Of one joint, and of a chain whose other joint has no kd, as kd_path is of all joints; viscous friction holds that one."""
    rng = np.random.default_rng(seed)
    single = joint(0.2, 0.8, 1e4, 1.0, 2.174e-3)
    plant, gains = Plant(W, MOTORS, STIFFNESS, DAMPING, motor_viscous=np.array([0.0, 30.0])), np.array([0.0, 250.0])
    drives, at = (gr.Drive(4000.0, 0.9, 1.7e-3),) * 2, feedback_of("motor", gr.PD(1.0, 1.0))
    one = System.of_joint(gr.ElasticJoint(MOTORS[0], 1 / W[0, 0], STIFFNESS[0], DAMPING[0]), drives[0], gr.PD(1.0, 1.0), sample_time=5e-4)
    counted = []
    for system, parts in ((single, None), (one, Parts(plant, drives, gr.PD(gains, np.zeros(2)), at, 5e-4))):
        structure = structure_of("split").scaled_to(system, PATH)
        low, high = structure.box
        for x in low - 1 + (high - low + 2) * rng.random((12, 3)):
            alone = structure.system(x, system, PATH)
            if parts is None:
                lifted, found = alone.loop(), largest_root(opened(system), alone)
            else:
                own = alone.control.controller
                law = replace(own, kp=np.array([own.kp, gains[1]]), kd=np.array([own.kd, 0.0]))
                lifted = gr.build_loop(plant, drives, law, sample_time=5e-4, kd_path=PATH)
                found = largest_root(Opened(parts, 0), alone)
            counted.append(found < 1)
            assert gr.is_stable(lifted) == counted[-1]
        assert any(counted[-12:])
        assert not all(counted[-12:])


@pytest.fixture(scope="module")
def biped():
    return parse_robot(example_texts()["biped"], "biped.yaml")


@pytest.mark.parametrize("state", [("stand", "left"), ("crouch", "double"), ("stand", "flight")])
def test_margins_of_one_joint_are_those_of_the_whole_robot_one_loop_at_a_time(biped, state):
    """Its gain and phase margins and Ms, found from samples of the core with all twelve joints: both polish what they find to 1e-8."""
    knee = ComparedJoint.of(biped, 3, [state])
    alone = knee.alone.with_controller(gr.PD(5000.0, 150.0))
    robot = robot_with(knee, alone)
    assert robot is not None
    whole = gr.margins(robot.loop(robot.source.linearize(*state)))
    found = gr.margins(opened_loop(knee.opened(Spot()), alone))
    assert found.peak_sensitivity == pytest.approx(whole.one_loop.peak_sensitivity[3], rel=1e-7)
    assert found.gain_margin == pytest.approx(whole.one_loop.gain_margin[3], rel=1e-7)
    assert abs(found.phase_margin) == pytest.approx(whole.one_loop.phase_margin[3], rel=1e-7)
    # the link under a load: held over a tick here, and not there; the peak between two frequencies
    problem = Problem(knee, Ceilings(1e-3), Objective(), PATH)
    structure = structure_of("pd").scaled_to(knee.alone, PATH)
    merits = problem.corners(structure, [Spot()], 12.0).all(structure.coordinates({"kp": 5000.0, "kd": 150.0})[None])
    assert merits.stable[0]
    assert math.exp(-merits.objective[0]) == pytest.approx(whole.links.stiffness[3], rel=2e-3)


ARM = """\
<robot name="arm">
  <link name="base"/>
  <link name="arm">
    <inertial>
      <mass value="4.0"/><origin xyz="0 0 2"/><inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
  </joint>
</robot>
"""
ROBOT = """\
model: {file: arm.urdf, base: fixed}
joints: {default: {motor_inertia: 1.0, stiffness: 1.0e4, damping: 1.0}}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
postures: {up: {}}
control: {type: pd, space: joint, kp: 2000.0, kd: 200.0, feedback: motor, sample_rate_hz: 2000}
uncertainty: {stiffness: 20%}
"""
JOINT = """\
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1.0e4, damping: 1.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
control: {type: pd, kp: 2000.0, kd: 200.0, feedback: motor, sample_rate_hz: 2000}
uncertainty: {stiffness: 20%}
"""


def test_a_robot_of_one_joint_is_that_joint(tmp_path: Path):
    """A mass of 4 kg on an arm of 2 m is a load of 16 kg m²: the same search ends at the same gains, and the same peak."""
    (tmp_path / "arm.urdf").write_text(ARM, "utf-8")
    robot = parse_robot(ROBOT, "robot.yaml", tmp_path)
    compared = gr.compare(robot, ["pd"], nominal=False, bound=False)
    first = compared.row("pd")
    second = gr.compare(parse_joint(JOINT, "joint.yaml"), ["pd"], nominal=False, bound=False).row("pd")
    assert first.holds
    assert second.holds
    assert first.parameters == pytest.approx(second.parameters, rel=2e-3)  # a flat optimum
    assert first.worst == pytest.approx(second.worst, rel=1e-4)
    assert first.worst_margins is not None
    assert second.worst_margins is not None
    assert first.worst_margins.peak_sensitivity == pytest.approx(second.worst_margins.peak_sensitivity, rel=1e-4)
    written = parse_robot(compared_robot_text(compared, first, ROBOT, str(tmp_path / "robot.yaml"), "0"), "better.yaml", tmp_path)
    assert written.control.controller.kp == pytest.approx(first.parameters["kp"], rel=1e-6)  # seven digits are written
    assert written.requirements == robot.requirements


def test_gains_of_one_joint_are_written_beside_those_of_the_others(biped, tmp_path: Path):
    joint = ComparedJoint.of(biped, 3)
    robot = robot_with(joint, joint.alone.with_controller(gr.PID(5000.0, 70.0, 150.0)))
    assert robot is not None
    assert gains_section("left_knee", robot) == {
        "type": "pid",
        "kp": {"default": 2000.0, "left_knee": 5000.0},
        "ki": {"default": 0.0, "left_knee": 70.0},
        "kd": {"default": 100.0, "left_knee": 150.0},
    }
    assert robot_with(joint, joint.alone.with_controller(gr.PD(1.0, 1.0, biquads=(gr.Biquad(10.0, 0.5, 20.0, 0.5),)))) is None


def refused(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    """The one line of a refusal, exit status 2."""
    assert main([*map(str, words)]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    (line,) = [one for one in told.err.splitlines() if one]
    return line


@pytest.mark.parametrize(
    ("old", "new", "words", "message"),
    [
        ("", "", ("--joint", "left_kne"), "joint 'left_kne': the robot has no such joint; did you mean 'left_knee'?"),
        ("  sample_rate_hz: 2000", "  # rate", (), "control.sample_rate_hz is missing: structures are compared as they run, sampled"),
        (
            "  space: joint",
            "  space: task",
            (),
            "control.space: a comparison needs joint, as gains of tasks close the loops of all joints together",
        ),
    ],
)
def test_calls_and_files_that_are_wrong(old, new, words, message, tmp_path: Path, capsys):
    text = example_texts()["biped"]
    assert old in text
    changed = text.replace(old, new)
    if "task" in new:
        changed = changed.replace("  kp: 2000.0 ", "  # kp").replace("  kd: 100.0 ", "  # kd")
    path = tmp_path / "robot.yaml"
    path.write_text(changed, "utf-8")
    assert message in refused(capsys, "compare", path, *words)


def test_a_bound_does_not_depend_on_what_holds_the_joint():
    """The same weights prove the same, with every controller made around an observer or around a PD: two maps of one theory."""
    system = joint(1.0, 16.0, 1e4, 1.0, 2e-3)
    parts = system.loop().parts
    limits = Ceilings(1e-3, torque_noise=1.4, sensor_noise={"motor": COUNT / math.sqrt(12)})
    observed, held = ExactJoint.of(parts), ExactJoint.of(parts, 0, (3500.0, 300.0))
    frequency = np.append(np.geomspace(10.0, 3000.0, 40), math.pi / TICK_OF_JOINTS)
    frequency = np.insert(frequency, 0, 0.0)
    table = np.array([1 / (1 + (frequency / 20) ** 2), 1e-9 / (1 + (frequency / 200) ** 2), np.full(len(frequency), 1e-13)])
    values = []
    for one in (observed, held):
        certificate = Certificate(one, limits, "motor", frequency, table, 1e-11, 2**15, 0.0)
        values.append(certificate.values[1])
        again = Certificate.from_json(certificate.to_json())
        assert again.joint.held == one.held
        assert again.check() == pytest.approx(certificate.check(), rel=1e-12)
    assert values[0] > 1e-5
    assert values[1] == pytest.approx(values[0], rel=1e-5)  # round-off of responses, 1e-8, against a difference of terms of one size


def test_a_pd_that_does_not_hold_is_refused():
    parts = joint(1.0, 16.0, 1e4, 1.0, 2e-3).loop().parts
    certificate = Certificate(
        ExactJoint.of(parts, 0, (1e5, 1.0)),
        Ceilings(1e-3),
        "motor",
        np.array([0.0, math.pi / TICK_OF_JOINTS]),
        np.ones((3, 2)),
        0.0,
        2**13,
        0.0,
    )
    with pytest.raises(GainroomError, match="is not stabilised by kp 100000 and kd 1 on motor"):
        certificate.check()


@pytest.mark.slow
def test_a_joint_of_the_biped(biped):
    """Structures hold every state, and the bound is below them; PD's objective is the inverse of the robot's own dynamic stiffness."""
    settings = gr.ComparisonSettings(sensor_noise={"motor": COUNT / math.sqrt(12)})
    found = gr.compare(biped, ["pd", "split"], joint="left_knee", settings=settings, nominal=False)
    assert found.joint.states[0] == ("stand", "left")
    assert found.bound is not None
    for row in found.rows:
        assert row.holds
        assert row.worst >= row.objective > found.bound
        assert (row.robot is not None) == (row.structure == "pd")
    pd = found.row("pd")
    stiff = []
    for state in biped.source.states:
        for place in pd.robot.uncertainty.corners:
            robot = pd.robot.at(place)
            margins = gr.margins(robot.loop(robot.source.linearize(*state)))
            assert margins.one_loop.peak_sensitivity[3] <= 2 * (1 + 1e-5)
            stiff.append(margins.links.stiffness[3])
    # the link's load held over a tick, or not; peaks between frequencies
    assert 1 / min(stiff) == pytest.approx(pd.worst, rel=3e-3)
