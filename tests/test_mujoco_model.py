"""The robot in MuJoCo against Pinocchio's rigid bodies and against the linear plant, by two roads that share no code."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.errors import GainroomError
from gainroom.robot import load_model
from gainroom.robot.actuators import Actuators
from gainroom.robot.contact import Contact
from gainroom.robot.ground import Ground, Sole
from gainroom.robot.linearize import linearize
from gainroom.simulation.mujoco_model import build_mujoco
from robot_truths import BOTH, GRAVITY, actuators, any_posture, biped, biped_posture, feet, hinge, link, write_robot

mujoco = pytest.importorskip("mujoco")

STEP = 1.25e-4


@pytest.fixture(scope="module")
def body():
    return biped()


def catalogue(name: str):
    """A robot of which no joint follows another: simulations do not carry that."""
    locked = ["panda_finger_joint2"] if "panda" in name else []
    return load_model({"package": "example-robot-data", "file": name}, base="fixed", locked=locked)


def mass_matrix(robot, data):
    """MuJoCo's M in the coordinates of the body's velocity and the springs'."""
    mujoco.mj_forward(robot.model, data)
    whole = np.zeros((robot.model.nv, robot.model.nv))
    try:
        mujoco.mj_fullM(robot.model, data, whole)
    except TypeError:  # before MuJoCo 4
        mujoco.mj_fullM(robot.model, whole, data.qM)
    mapped = velocity_map(robot, data)
    return mapped.T @ whole @ mapped


def velocity_map(robot, data):
    """(nv, N + e) from the body's velocity (N,), followed by that of the e springs, to MuJoCo's, in the present posture."""
    body = robot.body
    free = body.nv - body.size
    whole = np.zeros((robot.model.nv, body.nv + len(robot.spring_v)))
    if free:  # MuJoCo has the base's linear velocity in world axes, Pinocchio in the base's own
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        whole[:3, :3], whole[3:6, 3:6] = rotation.reshape(3, 3), np.eye(3)
    whole[robot.motor_v, free + np.arange(body.size)] = 1.0
    whole[robot.spring_v, body.nv + np.arange(len(robot.spring_v))] = 1.0
    return whole


def random_posture(body, seed):
    draw = np.random.default_rng(seed)
    return body.integrate(body.neutral(), draw.uniform(-0.7, 0.7, body.nv))


def slider_on_a_wheel(folder: Path):
    """A continuous joint, a slide with an oblique axis, and a link whose inertia no solid has (which MuJoCo's compiler refuses)."""
    wheel = link("base") + link("wheel", 2.0, (0.1, 0.02, -0.3), (0.03, 0.05, 0.04)) + link("tool", 0.7, (0, 0.1, 0), (0.001, 0.001, 0.09))
    spin = hinge("spin", "base", "wheel", (0, 0, 0.5), "1 0 0", "continuous")
    slide = hinge("slide", "wheel", "tool", (0.2, 0, 0), "0.6 0 0.8", "prismatic")
    return load_model(write_robot(folder, wheel, spin + slide), base="fixed")


MJCF = """<mujoco><worldbody>
<body name="trunk" pos="0 0 1"><freejoint/><inertial pos="0.1 0 0.05" mass="5" fullinertia="0.3 0.2 0.25 0.02 0.01 -0.03"/>
  <body name="leg" pos="0 0.1 -0.2" quat="0.9 0.1 0.3 -0.2">
    <joint name="roll" axis="1 0 0" pos="0.02 0 0.03"/><joint name="pitch" axis="0 1 0.2" ref="0.3"/>
    <inertial pos="0 0.01 -0.2" mass="2" diaginertia="0.03 0.04 0.01"/>
    <body name="foot" pos="0 0 -0.4"><joint name="shift" type="slide" axis="0 0 1"/>
      <inertial pos="0.05 0 0" mass="1" diaginertia="0.01 0.02 0.02"/><site name="sole" pos="0 0 -0.05"/></body>
  </body>
</body></worldbody></mujoco>"""


def from_mjcf(folder: Path):
    """Two joints in one body, off its origin, one with a reference position, and a slide."""
    path = folder / "robot.xml"
    path.write_text(MJCF, "utf-8")
    return load_model(path)


@pytest.mark.parametrize("seed", range(3))
def test_mass_matrix_of_the_links_is_pinocchios(body, tmp_path, seed):
    """With the springs stiffly named but still (q̇ = θ̇), the links' share of M is A; the rotors add J_m."""
    for robot_body in (body, catalogue("panda_description/urdf/panda.urdf"), slider_on_a_wheel(tmp_path), from_mjcf(tmp_path)):
        size = robot_body.size
        q = random_posture(robot_body, seed)
        rotors = np.linspace(0.2, 1.4, size)
        motors = Actuators(rotors, np.where(np.arange(size) % 3 == 1, math.inf, 1e4), np.ones(size), np.zeros(size), np.zeros(size))
        robot = build_mujoco(robot_body, motors, q, timestep=STEP)
        found = mass_matrix(robot, robot.new_data(q))
        links = robot_body.mass_matrix(q)
        free = robot_body.nv - size
        expected = links.copy()
        expected[free:, free:] += np.diag(rotors)
        scale = np.abs(expected).max()
        assert_allclose(found[: robot_body.nv, : robot_body.nv], expected, atol=1e-12 * scale)  # round-off of two recursions
        springs = free + np.flatnonzero(robot.elastic)
        # A spring turns the link alone: rows and columns of A without the rotor.
        assert_allclose(found[robot_body.nv :, : robot_body.nv], links[springs], atol=1e-12 * scale)
        assert_allclose(found[robot_body.nv :, robot_body.nv :], links[np.ix_(springs, springs)], atol=1e-12 * scale)


@pytest.mark.parametrize("seed", range(2))
def test_positions_and_weight_are_the_bodys(body, seed):
    q = random_posture(body, seed)
    robot = build_mujoco(body, actuators(12), q, timestep=STEP)
    torque = np.linspace(-30.0, 40.0, 12)
    data = robot.new_data(q, torque)
    assert_allclose(data.qpos[[0, 1, 2, 4, 5, 6, 3]], q[:7], atol=1e-14)  # MuJoCo's quaternions begin with w
    assert_allclose(robot.link_position(data.qpos), body.angles(q), atol=1e-14)
    assert_allclose(robot.motor_position(data.qpos) - robot.link_position(data.qpos), torque / 1e4, atol=1e-14)  # wound up by τ_J/K
    assert_allclose(robot.joint_torque(data.qpos, data.qvel), torque, rtol=1e-9)
    mujoco.mj_forward(robot.model, data)
    mapped = velocity_map(robot, data)[:, : body.nv]
    assert_allclose(mapped.T @ data.qfrc_bias, body.gravity_torque(q), atol=1e-11 * np.abs(body.gravity_torque(q)).max())
    mujoco.mj_comPos(robot.model, data)
    assert_allclose(data.subtree_com[0], body.com(q), atol=1e-13)
    none = build_mujoco(body, actuators(12), q, timestep=STEP, gravity=False)
    still = none.new_data(q)
    mujoco.mj_forward(none.model, still)
    assert not np.any(still.qfrc_bias)


def motor_response(robot, q, omega):
    """Motor torque → motor position of the linearised MuJoCo model stepping at h, at z = e^{jωh}."""
    data = robot.new_data(q)
    size, h = 2 * robot.model.nv, robot.model.opt.timestep
    transition, torque = np.zeros((size, size)), np.zeros((size, robot.model.nu))
    mujoco.mjd_transitionFD(robot.model, data, 1e-6, True, transition, torque, None, None)
    z = np.exp(1j * omega * h)
    states = np.linalg.solve(z * np.eye(size) - transition, torque[:, : robot.body.size])
    return states[robot.motor_v]


def leapfrog(omega, h):
    """Where the leapfrog rule puts a vibration at ω: z − 2 + 1/z = −(h Ω)²."""
    return 2 / h * np.sin(omega * h / 2)


FREQUENCIES = (30.0, 200.0, 500.0, 900.0)
# Leapfrog is exact for masses and springs at Ω; the gearbox's damping is taken half a step late, which counts as B h/2 ≈ 6e-5 of the
# motor's inertia and as 1e-3 of the response near resonances of 1 % damping; held contacts give way by about 1e-4 (see CLOSEST).
CLOSE_RESPONSE = 8e-3


def assert_same_response(robot, model, q, bound=CLOSE_RESPONSE):
    for omega in FREQUENCIES:
        found = motor_response(robot, q, omega)
        expected = model.response(np.array([1j * leapfrog(omega, STEP)]), "motor")[0]
        assert np.abs(found - expected).max() < bound * np.abs(expected).max(), omega


CONTACTS = {
    "double": BOTH,
    "left": feet("left_sole"),
    "flight": (),
    "line": [Contact("left_sole", "line"), Contact("right_sole", "point")],
    "springs": [Contact("left_sole", "flat", (2e5, 2e3), (200.0, 2.0)), Contact("right_sole", "point", 1e5)],
    "mixed": [Contact("left_sole"), Contact("right_sole", "line", (1e5, 500.0), (100.0, 1.0))],
}


@pytest.mark.parametrize("held", CONTACTS)
def test_linearised_it_is_the_plant(body, held):
    """In general posture, with friction on both sides of some gearboxes and some rigid joints."""
    motors = Actuators(
        motor_inertia=np.linspace(0.5, 1.5, 12),
        stiffness=np.where(np.arange(12) % 5 == 2, math.inf, 1e4),
        damping=np.full(12, 4.0),
        motor_viscous=np.linspace(0, 6, 12),
        link_viscous=np.linspace(5, 0, 12),
    )
    q = any_posture(body, 4)
    robot = build_mujoco(body, motors, q, CONTACTS[held], timestep=STEP, gravity=False)
    assert_same_response(robot, linearize(body, motors, q, CONTACTS[held]), q)


def test_a_robot_from_mjcf_is_its_plant(tmp_path):
    small = from_mjcf(tmp_path)
    motors, q = actuators(3, 0.5, 2e3, 1.0), random_posture(small, 5)
    robot = build_mujoco(small, motors, q, feet("sole"), timestep=STEP, gravity=False)
    assert_same_response(robot, linearize(small, motors, q, feet("sole")), q)


def test_springs_of_the_joints_themselves_are_in_the_plant(tmp_path):
    """As in the plant, on rigid and on elastic joints; without them the two differ."""
    small = from_mjcf(tmp_path)
    sprung = replace(small, springs=dict(zip(small.joint_names, (900.0, 500.0, 0.0), strict=True)))
    motors = Actuators(np.full(3, 0.5), np.array([2e3, math.inf, math.inf]), np.full(3, 1.0), np.zeros(3), np.zeros(3))
    q = random_posture(sprung, 5)
    robot = build_mujoco(sprung, motors, q, feet("sole"), timestep=STEP, gravity=False)
    assert_same_response(robot, linearize(sprung, motors, q, feet("sole")), q)
    with pytest.raises(AssertionError):
        assert_same_response(robot, linearize(small, motors, q, feet("sole")), q)


def test_a_fixed_base_arm_is_its_plant():
    arm = catalogue("panda_description/urdf/panda.urdf")
    motors = actuators(arm.size, 0.6, 1e4, 2.0)
    q = random_posture(arm, 7)
    robot = build_mujoco(arm, motors, q, timestep=STEP, gravity=False)
    assert_same_response(robot, linearize(arm, motors, q), q)


def test_the_wrong_plant_is_noticed(body):
    """The comparison above tells 3 % of the motors' inertia, and a foot in the air."""
    q = any_posture(body, 4)
    robot = build_mujoco(body, actuators(12), q, BOTH, timestep=STEP, gravity=False)
    for wrong in (linearize(body, actuators(12, 1.03), q, BOTH), linearize(body, actuators(12), q, feet("left_sole"))):
        with pytest.raises(AssertionError):
            assert_same_response(robot, wrong, q)


def test_energy_of_a_free_robot_is_kept(body):
    """No gravity, no damping: leapfrog's energy swings with (ω h)² and does not drift."""
    q = biped_posture(body)
    robot = build_mujoco(body, actuators(12, damping=0.0), q, timestep=STEP, gravity=False)
    robot.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = robot.new_data(q)
    data.qvel[robot.motor_v] = np.linspace(-0.3, 0.3, 12)
    energies = []
    for _ in range(4000):
        mujoco.mj_step(robot.model, data)
        energies.append(sum(data.energy))
    first, last = np.mean(energies[:1000]), np.mean(energies[-1000:])
    assert abs(last / first - 1) < 2e-3  # Coriolis forces are half a step late
    assert np.ptp(energies) < 0.1 * first  # fastest vibration 1100 rad/s: ω h = 0.14


def test_coulomb_friction_holds_a_joint_and_lets_it_go(body):
    """A motor on a locked output under less than the Coulomb torque stays where it is, under more it moves."""
    arm = catalogue("panda_description/urdf/panda.urdf")
    q = arm.neutral()
    robot = build_mujoco(arm, actuators(arm.size, 0.5), q, timestep=2.5e-4, coulomb=10.0, gravity=False)
    data = robot.new_data(q)
    data.ctrl[0] = 9.5
    for _ in range(4000):
        mujoco.mj_step(robot.model, data)
    assert abs(robot.motor_position(data.qpos)[0]) < 1e-5  # creep of (1 − 0.9999) a h² per step: 1.2e-8 rad × 4000 at most
    data.ctrl[0] = 10.5
    for _ in range(400):
        mujoco.mj_step(robot.model, data)
    assert robot.motor_position(data.qpos)[0] > 1e-3


def test_feet_stand_on_real_ground(body):
    """Joints as stiff as honey hold the robot up; the ground carries its weight, on boxes and on cylinders, and it sinks by micrometres."""
    q = biped_posture(body)
    honey = Actuators(np.ones(12), np.full(12, math.inf), np.zeros(12), np.full(12, 1e6), np.zeros(12))
    for kind, count in (("flat", 8), ("line", 4)):
        soles = {name: Sole(length=0.28, width=0.15, center=(-0.008, 0.0)) for name in ("left_sole", "right_sole")}
        held = feet("left_sole", "right_sole", kind=kind)
        robot = build_mujoco(body, honey, q, held, timestep=2.5e-4, ground=Ground(soles=soles))
        data = robot.new_data(q)
        for _ in range(800):
            mujoco.mj_step(robot.model, data)
        assert data.ncon == count
        forces = np.zeros((count, 6))
        for index in range(count):
            mujoco.mj_contactForce(robot.model, data, index, forces[index])
        # On cylinders it rocks about their axis, far slower than 0.2 s; honey gives way by 1e-3 of the weight.
        assert forces[:, 0].sum() == pytest.approx(body.total_mass * GRAVITY, rel=0.02)
        assert -2e-5 < data.qpos[2] < 0
    ball = build_mujoco(body, actuators(12), q, feet("left_sole", kind="point"), timestep=2.5e-4, ground=Ground())
    data = ball.new_data(q)
    mujoco.mj_step(ball.model, data, 2)  # at first it only touches
    assert data.ncon == 1
    assert_allclose(data.contact[0].pos, body.frame_placement(q, "left_sole")[1], atol=2e-6)  # g t² of two steps


def test_refusals(body):
    q = biped_posture(body)
    with pytest.raises(GainroomError, match="no frame 'left_foott'; did you mean 'left_foot'"):
        build_mujoco(body, actuators(12), q, feet("left_foott"), timestep=STEP)
    with pytest.raises(GainroomError, match="all held directions or in none"):
        build_mujoco(body, actuators(12), q, [Contact("left_sole", "flat", (math.inf, 1e3))], timestep=STEP)
    with pytest.raises(GainroomError, match="coulomb friction -1 N·m must be >= 0"):
        build_mujoco(body, actuators(12), q, timestep=STEP, coulomb=-1.0)
    with pytest.raises(GainroomError, match="timestep 0 s must be a number > 0"):
        build_mujoco(body, actuators(12), q, timestep=0.0)
    with pytest.raises(GainroomError, match=r"length -0\.1 m must be a number > 0"):
        Sole(length=-0.1)
    with pytest.raises(GainroomError, match="friction 0 must be a number > 0"):
        Ground(friction=0.0)
