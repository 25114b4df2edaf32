"""The second witness: where vibration begins in MuJoCo, against the predicted limit of the sampled loop.

Nothing is shared but the input. Leapfrog steps of T_s/4 move what is heard by (ω h)²/24 = 2e-4, MuJoCo's held contacts by about 1e-4;
the factor is searched to 1e-3; near-equal legs make twin vibrations that half a second tells apart only roughly. One percent in gain
and frequency, where two are asked; most come within a tenth of that.
"""

import math
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from gainroom import load_robot
from gainroom.analysis.gain_limit import gain_limit
from gainroom.errors import GainroomError
from gainroom.files.robot_yaml import parse_robot
from gainroom.robot import load_model
from gainroom.robot.actuators import Actuators
from gainroom.robot.contact import Contact
from gainroom.robot.ground import Ground, Sole
from gainroom.robot.linearize import linearize
from gainroom.robot.tasks import Task, tasks_of
from gainroom.simulation.robot_onset import motionless, robot_onset, robot_vibration
from gainroom.simulation.robot_run import run_robot
from gainroom.simulation.robot_setup import RobotSetup, hold, robot_setup
from gainroom.system.controller import PD, PPI
from gainroom.system.drive import Drive
from gainroom.system.elastic_joint import ElasticJoint
from gainroom.system.filters import LowPass, Notch
from gainroom.system.loop import build_loop
from gainroom.system.system import Control
from robot_files import SOLO
from robot_truths import BOTH, actuators, any_posture, feet, hinge, joint_setup, link, write_robot

TICK = 5e-4
CLOSE = 1e-2
TESTBED = ElasticJoint(motor_inertia=0.2, link_inertia=0.8, stiffness=1e4, damping=1.0)
DRIVE = Drive(4000.0, 0.9, 2.174e-3)  # 4.35 ticks


def assert_witnessed(limit, setup, near=None):
    onset = robot_onset(setup, limit.gain if near is None else near)
    assert onset.gain == pytest.approx(limit.gain, rel=CLOSE)
    assert onset.frequency == pytest.approx(limit.frequency, rel=CLOSE)
    assert onset.stable < onset.gain < onset.growing <= onset.stable * 1.0011


@pytest.fixture(scope="module")
def spec():
    return load_robot(str(files("gainroom") / "files" / "examples" / "biped.yaml")).system


JOINT_LOOPS = {
    "testbed": (TESTBED, PD(1600.0, 70.0)),
    "rigid": (ElasticJoint(motor_inertia=0.2, link_inertia=0.8), PD(1600.0, 70.0)),
    "cascade with filters": (TESTBED, PPI(20.0, 15.0, 30.0, velocity_filter=LowPass(800.0), notches=(Notch(500.0),))),
    "friction": (replace(TESTBED, motor_viscous=8.0, link_viscous=3.0), PD(1600.0, 70.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", JOINT_LOOPS)
def test_one_joint(name):
    """Looked for from factor 1, with no hint."""
    joint, controller = JOINT_LOOPS[name]
    limit = gain_limit(build_loop(joint, DRIVE, controller, "motor", TICK))
    assert_witnessed(limit, joint_setup(joint, DRIVE, controller, sample_time=TICK), near=1.0)


@pytest.mark.slow
def test_link_side_feedback():
    joint, controller = replace(TESTBED, damping=10.0), PD(500.0, 10.0)
    limit = gain_limit(build_loop(joint, DRIVE, controller, "link", TICK))
    assert_witnessed(limit, joint_setup(joint, DRIVE, controller, "link", TICK), near=1.0)


SPACES = (("joint", "double"), ("joint", "left"), ("joint", "flight"), ("task", "double"), ("task", "left"))


@pytest.mark.slow
@pytest.mark.parametrize("posture", ["stand", pytest.param("crouch", marks=pytest.mark.population)])
@pytest.mark.parametrize(("space", "contact"), SPACES)
def test_biped(spec, space, contact, posture):
    control = replace(spec.control, space=space, sample_time=TICK, controller=spec.control.controller if space == "joint" else None)
    asked = replace(spec, control=control)
    limit = gain_limit(asked.loop(asked.source.linearize(posture, contact)))
    assert_witnessed(limit, robot_setup(asked, posture, contact))


@pytest.mark.slow
@pytest.mark.parametrize("held", [BOTH, feet("left_sole"), [Contact("left_sole"), Contact("right_sole", "line", (2e5, 2e3), (200.0, 2.0))]])
def test_biped_in_general_posture_with_a_cascade(spec, held):
    """P/PI for the centre of mass, PD for the pelvis; legs that are not alike, and one foot on soft ground."""
    body = spec.source.body
    q = any_posture(body, 0)
    com = Task(name="com", kind="com", kp=[10, 15, 20], kd=[3, 4, 5], ki=[0.5, 0.2, 1.0])
    stack = (com, Task(name="pelvis", kind="orientation", frame="pelvis", kp=100, kd=20))
    model = linearize(body, spec.source.actuators, q, held)
    limit = gain_limit(build_loop(model, spec.drives, tasks_of(model, stack).controller(), "motor", TICK))
    control = replace(spec.control, space="task", controller=None, sample_time=TICK)
    setup = RobotSetup(
        body=body, actuators=spec.source.actuators, drives=spec.drives, control=control, q=q, contacts=tuple(held), stack=stack
    )
    assert_witnessed(limit, setup)


@pytest.mark.slow
def test_talos():
    """Another robot with feet: arms and head locked, centre of mass and base under a posture task, the catalogue's gearboxes."""
    body = load_model(
        {"package": "example-robot-data", "file": "talos_data/robots/talos_reduced.urdf"},
        base="floating",
        locked=["arm_.*", "head_.*", "gripper_.*"],
    )
    q = body.configuration(
        {f"leg_{side}_{k}_joint": angle for side in ("left", "right") for k, angle in ((3, -0.45), (4, 0.9), (5, -0.45))}
    )
    motors, drives = actuators(body.size, 2.0, 1e4, 20.0), (Drive(4000.0, 0.9, 1.5e-3),) * body.size
    com = Task(name="com", kind="com", kp=30, kd=8)
    stack = (com, Task(name="base", kind="orientation", frame="base_link", kp=40, kd=10), Task(name="rest", kind="posture", kp=20, kd=5))
    model = linearize(body, motors, q, feet("left_sole_link", "right_sole_link"))
    limit = gain_limit(build_loop(model, drives, tasks_of(model, stack).controller(), "motor", TICK))
    control = Control("task", None, "motor", TICK)
    setup = RobotSetup(body=body, actuators=motors, drives=drives, control=control, q=q, contacts=model.contacts, stack=stack)
    assert_witnessed(limit, setup)
    soles = {contact.frame: Sole(length=0.2, width=0.12) for contact in model.contacts}
    run = run_robot(replace(setup, ground=Ground(soles=soles)), hold(setup, 0.5))
    assert run.ending == "completed"
    assert run.slip.max() < 1e-3


def arm_setup(arm, motors, q, controller, drive):
    control = Control("joint", controller, "motor", TICK)
    return RobotSetup(body=arm, actuators=motors, drives=(drive,) * arm.size, control=control, q=q)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_panda(seed):
    """A fixed-base arm with public inertias of its rotors; gearboxes soft enough for the links they carry (about 600 rad/s)."""
    arm = load_model({"package": "example-robot-data", "file": "panda_description/urdf/panda.urdf"}, "fixed", ["panda_finger_joint2"])
    q = arm.integrate(arm.neutral(), np.random.default_rng(seed).uniform(-1, 1, arm.nv))
    rotors = np.array([0.6057, 0.6057, 0.4625, 0.4625, 0.2055, 0.2055, 0.2055, 0.1])
    stiffness = np.minimum(1e4, 600.0**2 / np.diag(np.linalg.inv(arm.mass_matrix(q))))
    motors = Actuators(rotors, stiffness, 1e-4 * stiffness, np.zeros(8), np.zeros(8))
    controller, drive = PD(400 * rotors, 20 * rotors), Drive(4000.0, 0.9, 1.3e-3)
    limit = gain_limit(build_loop(linearize(arm, motors, q), drive, controller, "motor", TICK))
    assert_witnessed(limit, arm_setup(arm, motors, q, controller, drive))


def two_links(folder):
    links = link("base") + link("upper", 3.0, (0, 0, -0.2), (0.05, 0.05, 0.01)) + link("lower", 2.0, (0, 0, -0.15), (0.03, 0.03, 0.01))
    return load_model(
        write_robot(folder, links, hinge("shoulder", "base", "upper") + hinge("elbow", "upper", "lower", (0, 0, -0.4))), base="fixed"
    )


@pytest.mark.slow
def test_two_link_arm_with_full_gain_matrices(tmp_path):
    arm, motors, q = two_links(tmp_path), actuators(2, 0.4, 8e3, 2.0), np.array([0.4, 1.1])
    controller = PD(np.array([[900.0, 300.0], [200.0, 500.0]]), np.array([[40.0, 10.0], [12.0, 25.0]]))
    limit = gain_limit(build_loop(linearize(arm, motors, q), DRIVE, controller, "motor", TICK))
    assert_witnessed(limit, arm_setup(arm, motors, q, controller, DRIVE), near=1.0)


def test_a_slow_vibration_beside_its_own_harmonics(tmp_path):
    """Below 2 Hz, which half a second holds less than once; a bent arm makes harmonics that grow twice as fast as it."""
    arm, motors, q = two_links(tmp_path), actuators(2, 0.4, 8e3, 2.0), np.array([0.4, 1.1])
    controller, drive = PD(np.array([12.0, 4.0]), np.array([2.5, 0.8])), Drive(4000.0, 0.9, 0.1)
    limit = gain_limit(build_loop(linearize(arm, motors, q), drive, controller, "motor", 5e-3))
    assert limit.frequency < 2 * math.pi * 2
    setup = replace(arm_setup(arm, motors, q, controller, drive), control=Control("joint", controller, "motor", 5e-3))
    onset = robot_onset(setup, limit.gain, limit.frequency)
    assert (onset.gain, onset.frequency) == (pytest.approx(limit.gain, rel=CLOSE), pytest.approx(limit.frequency, rel=CLOSE))


@pytest.mark.slow
def test_the_witness_contradicts_a_wrong_prediction():
    """A tenth of a millisecond more in the drive, or the continuous model in place of the sampled one, and the two no longer agree."""
    controller = PD(1600.0, 70.0)
    setup = joint_setup(TESTBED, DRIVE, controller, sample_time=TICK)
    for loop in (
        build_loop(TESTBED, replace(DRIVE, delay=2.274e-3), controller, "motor", TICK),
        build_loop(TESTBED, DRIVE, controller, "motor"),
    ):
        with pytest.raises(AssertionError):
            assert_witnessed(gain_limit(loop), setup)


@pytest.mark.slow
def test_no_onset_is_told():
    """Without delay worth the name, PD on a rigid joint would have to be a thousand times harder."""
    setup = joint_setup(ElasticJoint(motor_inertia=1.0, link_inertia=1.0), Drive(), PD(1e-3, 1e-2), sample_time=TICK)
    with pytest.raises(GainroomError, match="decays at every factor up to"):
        robot_onset(setup)


def test_running_away_counts_as_growing():
    """Gains so hard that a motor passes 50 rad/s within a few ticks."""
    setup = motionless(joint_setup(TESTBED, DRIVE, PD(1600.0, 70.0), sample_time=TICK))
    found = robot_vibration(setup, 1e6)
    assert found is not None
    assert found.growth_rate > 100


@pytest.mark.slow
def test_a_quadruped_of_light_links_at_1_khz():
    """Solo12 on four points: its vibration at 160 Hz is fast beside a tick of 1 ms, so steps must be a fraction of it.

    Within 1 %, half of what verify allows: what is left is the contacts' giving way, which steps four times finer do not change.
    """
    spec = parse_robot(SOLO, "solo.yaml")
    loop = spec.loop(spec.source.linearize("stand", "all"))
    limit = gain_limit(loop)
    found = robot_onset(robot_setup(spec, "stand", "all"), limit.gain)
    assert found.gain == pytest.approx(limit.gain, rel=0.01)
    assert found.frequency == pytest.approx(limit.frequency, rel=0.01)
