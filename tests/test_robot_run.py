"""Whole runs of a simulated robot: it stands, goes where it is told, falls when it must, and says so."""

import math
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom import load_robot
from gainroom.errors import GainroomError
from gainroom.robot import load_model
from gainroom.robot.actuators import Actuators
from gainroom.robot.ground import Ground, Sole
from gainroom.simulation.robot_onset import motionless
from gainroom.simulation.robot_run import RobotStepper, run_robot, stream_robot
from gainroom.simulation.robot_setup import RobotSetup, channel_units, hold, robot_setup, substeps_for
from gainroom.simulation.run_record import LOGGED
from gainroom.simulation.tracking import track
from gainroom.simulation.trajectories import Spline
from gainroom.system.controller import PD
from gainroom.system.drive import Drive
from gainroom.system.elastic_joint import ElasticJoint
from gainroom.system.system import Control
from robot_truths import hinge, joint_setup, link, write_robot

TICK = 5e-4
GROUND = Ground(soles={name: Sole(length=0.28, width=0.15, center=(-0.008, 0.0)) for name in ("left_sole", "right_sole")})


@pytest.fixture(scope="module")
def spec():
    return load_robot(str(files("gainroom") / "files" / "examples" / "biped.yaml")).system


def setup_of(spec, space="task", posture="crouch", contact="double", **options):
    control = replace(spec.control, space=space, sample_time=TICK, controller=spec.control.controller if space == "joint" else None)
    return robot_setup(replace(spec, control=control), posture, contact, **options)


@pytest.mark.parametrize("space", ["joint", "task"])
@pytest.mark.parametrize("contact", ["double", "left"])
def test_it_stands(spec, space, contact):
    """Half a second on real ground; on one foot where that is held, as the weight is between the feet, and with half the gains."""
    both = contact == "double"
    setup = setup_of(spec, space, contact=contact, ground=GROUND if both else None, coulomb=3.0)
    run = run_robot(setup, hold(setup, 0.5), gain=1.0 if both else 0.5)
    assert (run.ending, run.reason) == ("completed", "")
    assert len(run.time) == 1000
    assert np.abs(run.link_position - run.link_position[0]).max() < 0.02
    assert run.slip.max() < 1e-4
    weight = setup.body.gravity_torque(setup.q)
    assert np.abs(run.joint_torque).max() < np.abs(weight).max()
    # What the gearboxes carry in the end is what motors give, less what friction holds.
    assert np.abs(run.joint_torque[-1] - run.actual_torque[-1]).max() < 3.0 + 0.5


def test_links_hang_behind_their_motors(spec):
    """The encoders are before the gearboxes: what they read is off by τ_J/K, and actual values show it."""
    setup = setup_of(spec, "joint")
    run = run_robot(setup, hold(setup, 0.3))
    twist = run.motor_position - run.link_position
    assert_allclose(twist[-1], run.joint_torque[-1] / 1e4, atol=1e-5)  # at rest
    assert np.abs(twist).max() > 3e-3  # knees carry some 60 N m
    assert_allclose(run.actual, run.link_position)
    assert_allclose(run.measured, run.motor_position)


def test_a_small_motion_is_followed(spec):
    """Without friction and delay-free enough, PD with velocity: 1 cm in 2 s is followed to a few mm, at rest to what the gearboxes hide."""
    setup = setup_of(spec, ground=GROUND)
    times = TICK * np.arange(6000)
    share = np.clip(times / 2, 0, 1)
    offsets = np.zeros((6000, 6))
    offsets[:, 2] = 0.01 * (3 * share**2 - 2 * share**3)
    run = run_robot(setup, offsets)
    assert run.ending == "completed"
    assert run.channels[:3] == ("com x", "com y", "com z")
    assert np.abs(run.error[:, :3]).max() < 4e-3
    assert np.abs(run.steady_error()[:3]).max() < 1.5e-3
    rise = run.actual[-1, 2] - run.actual[0, 2]
    assert rise == pytest.approx(0.01, abs=2e-3)


def test_shorter_steps_and_fresher_matrices_change_nothing_to_speak_of(spec):
    setup = setup_of(spec, ground=GROUND, coulomb=4.0)
    offsets = np.zeros((1000, 6))
    offsets[:, 1] = 0.02 * np.linspace(0, 1, 1000)
    runs = [run_robot(replace(setup, **change), offsets) for change in ({}, {"substeps": 4}, {"refresh": 5})]
    for other in runs[1:]:
        assert np.abs(other.measured - runs[0].measured).max() < 1e-4  # of 2 cm


def test_it_falls_and_says_so(spec):
    """Motors too weak for its weight."""
    setup = setup_of(spec, "joint", ground=GROUND, torque_limit=15.0)
    run = run_robot(setup, hold(setup, 3.0))
    assert run.ending in ("fell", "diverged")
    assert run.reason.endswith(" s")
    assert 0.1 < run.time[-1] < 2.9
    assert all(np.isfinite(getattr(run, name)).all() for name in ("measured", "target_torque", "motor_position", "link_position", "base"))
    with pytest.raises(GainroomError, match=f"no steady state: {run.reason}"):
        run.steady_error()


@pytest.mark.parametrize("gain", [8.0, 1e5])
def test_gains_beyond_the_limit_stop_the_run(spec, gain, tmp_path, monkeypatch):
    """Twice the limit vibrates until a motor runs away; absurd gains blow up in a few ticks. Nothing is left lying about."""
    monkeypatch.chdir(tmp_path)
    setup = setup_of(spec, "joint")
    run = run_robot(setup, hold(setup, 1.0), gain=gain, initial_speed=1e-3)
    assert run.ending == "diverged"
    assert "moves faster than 50 rad/s after" in run.reason
    assert run.time[-1] < 0.9
    assert np.isfinite(run.target_torque).all()
    assert not list(tmp_path.iterdir())


def test_encoders_and_feedback_side(spec):
    setup = setup_of(spec, "joint", encoder_step=1e-3)
    run = run_robot(setup, hold(setup, 0.02))
    assert_allclose(run.measured / 1e-3, np.round(run.measured / 1e-3), atol=1e-9)
    linkside = replace(setup, encoder_step=0.0, control=replace(setup.control, feedback="link"))
    run = run_robot(linkside, hold(setup, 0.005), gain=0.01)
    assert_allclose(run.measured, run.link_position)


def test_one_joint_is_a_robot_too():
    """A step of a slow PD loop on a stiff joint: the closed form of a double integrator under PD, delay aside."""
    joint = ElasticJoint(motor_inertia=0.5, link_inertia=0.5, stiffness=1e6, damping=50.0, name="elbow")
    setup = joint_setup(joint, Drive(), PD(100.0, 20.0), sample_time=TICK)
    assert substeps_for(setup) > 1
    offsets = np.full((2000, 1), 0.01)
    offsets[0] = 0.0  # the first tick is where it starts
    run = run_robot(setup, offsets)
    time = run.time - TICK
    # θ̈ = 100 (0.01 − θ) − 20 θ̇ with the differentiated step: θ = 0.01 (1 − e^{−10 t} (1 − 10 t)), s(s)/(s+10)² for the zero
    expected = 0.01 * (1 - np.exp(-10 * time) * (1 - 10 * time))
    assert np.abs(run.measured[2:, 0] - expected[2:]).max() < 2e-4  # hold and difference: 0.5 ms of 0.1 s, of 0.01
    assert run.channels == ("elbow",)


def test_viscous_friction_of_both_sides_slows_a_coasting_joint():
    """No gains to speak of: a kicked rigid joint coasts down with (D_m + D_l)/(J_m + J_L)."""
    joint = ElasticJoint(motor_inertia=0.3, link_inertia=0.7, motor_viscous=2.0, link_viscous=1.0)
    setup = joint_setup(joint, Drive(), PD(1e-9, 0.0), sample_time=TICK, substeps=8)
    run = run_robot(setup, hold(setup, 0.5), initial_speed=0.4)
    assert run.measured[-1, 0] == pytest.approx(0.4 / 3 * (1 - math.exp(-3 * run.time[-1])), rel=1e-3)


def test_parts_are_the_run(spec):
    """Taken part by part, cut anywhere, the rows are those of the whole; a part knows when it is, and a log can be made of it."""
    setup = setup_of(spec, "joint", ground=GROUND, coulomb=3.0)
    offsets = 0.01 * np.random.default_rng(0).uniform(-1, 1, (250, 12)).cumsum(axis=0) / 50
    whole = run_robot(setup, offsets)
    parts = list(stream_robot(setup, offsets, block=77))
    assert [len(part.time) for part in parts] == [77, 77, 77, 19]
    assert_allclose(np.concatenate([part.time for part in parts]), whole.time, atol=1e-15)
    for name, values in whole.columns().items():
        assert_allclose(np.concatenate([part.columns()[name] for part in parts]), values, atol=0, rtol=0)
    assert set(whole.columns()) == {"time", *LOGGED}
    tracking = track(whole)
    assert_allclose(tracking.rms, np.sqrt(np.mean(whole.error**2, axis=0)))
    assert_allclose(tracking.steady_state, whole.steady_error())


def test_demand_is_the_target_late_and_limited(spec):
    """2 ms are 4 ticks; before the first command it is what held the robot."""
    setup = setup_of(spec, "joint", torque_limit=20.0)
    run = run_robot(setup, hold(setup, 0.02))
    limited = np.clip(run.target_torque, -20, 20)
    assert_allclose(run.demand_torque[4:], limited[:-4], atol=1e-12)
    assert_allclose(run.demand_torque[:4], np.tile(run.demand_torque[0], (4, 1)))


def test_refusals(spec):
    setup = setup_of(spec)
    assert len(channel_units(setup)) == 6
    with pytest.raises(GainroomError, match=r"offsets of shape \(10, 3\) must be \(ticks, 6\)"):
        run_robot(setup, np.zeros((10, 3)))
    with pytest.raises(GainroomError, match=r"offsets .* must be finite"):
        run_robot(setup, np.full((10, 6), np.nan))
    with pytest.raises(GainroomError, match="give sample_rate_hz"):
        run_robot(replace(setup, control=replace(setup.control, sample_time=None)), np.zeros((10, 6)))
    stiff = ElasticJoint(motor_inertia=1e-6, link_inertia=1e-6, stiffness=1e6)
    with pytest.raises(GainroomError, match=r"needs .* steps per tick, at most 64"):
        RobotStepper(joint_setup(stiff, Drive(), PD(1.0, 1.0)))
    with pytest.raises(GainroomError, match="duration 0 s must be"):
        hold(setup, 0.0)


def test_a_fixed_base_cannot_fall():
    control = Control("joint", PD(1.0, 1.0), "motor", TICK)
    setup = replace(joint_setup(ElasticJoint(motor_inertia=1.0, link_inertia=1.0), Drive(), PD(1.0, 1.0)), control=control)
    assert RobotStepper(setup).problem() is None


def small(folder, kind="revolute"):
    """Two links without gears or weight, fast at 1 kHz."""
    links = link("root") + link("upper", 1.0, (0, 0, 0), (0.01, 0.01, 0.01)) + link("lower", 1.0, (0, 0, 0), (0.01, 0.01, 0.01))
    joints = hinge("first", "root", "upper", kind=kind) + hinge("second", "upper", "lower", kind=kind)
    body = load_model(write_robot(folder, links, joints), base="fixed")
    motors = Actuators(*(np.full(2, value) for value in (0.1, math.inf, 0.0, 0.0, 0.0)))
    law = Control("joint", PD(400.0 * np.ones(2), 40.0 * np.ones(2)), "motor", 1e-3)
    return RobotSetup(body=body, actuators=motors, drives=(Drive(),) * 2, control=law, q=body.neutral(), gravity=False)


def test_a_fast_planned_move_is_no_divergence(tmp_path):
    """40 rad/s of each of two motors are 57 together, and 60 of one more than any robot's joint; both were asked for."""
    setup = small(tmp_path)
    for fastest in (40.0, 60.0):
        way = fastest * 0.5 / 1.875  # a quintic's fastest speed is 15/8 of the mean one
        run = run_robot(setup, Spline.move([way, way], 0.5, order=5).position(1e-3 * np.arange(700)))
        assert run.ending == "completed"
        assert np.abs(np.diff(run.motor_position, axis=0)).max() / 1e-3 == pytest.approx(fastest, rel=0.05)


@pytest.mark.parametrize(("kind", "says"), [("revolute", "moves faster than 50 rad/s"), ("prismatic", "moves faster than 50 m/s")])
def test_the_joint_that_runs_away_is_named_with_its_unit(tmp_path, kind, says):
    run = run_robot(small(tmp_path, kind), hold(small(tmp_path, kind), 0.1), gain=1e-6, initial_speed=[0.0, 60.0])
    assert run.ending == "diverged"
    assert f"joint 'second' {says} after" in run.reason


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="asks Linux how much address space a process has")
def test_a_simulation_gives_its_memory_back(tmp_path):
    """Robots put together one after the other: twenty need no more address space than two, where MuJoCo's own work space is 15 MiB each."""
    robot = tmp_path / "talos.yaml"
    robot.write_text(
        """
model: {package: example-robot-data, file: talos_data/robots/talos_reduced.urdf, base: floating}
joints: {default: {motor_inertia: 1.0, stiffness: 1.0e4, damping: 5}}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
contacts: {double: [left_sole_link, right_sole_link]}
control: {type: pd, feedback: motor, sample_rate_hz: 2000, kp: 2000, kd: 100}
""",
        "utf-8",
    )

    def address_space() -> int:
        lines = Path("/proc/self/status").read_text("utf-8").splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmSize:"))

    setup = motionless(robot_setup(load_robot(str(robot)).system))
    sizes = []
    for _ in range(20):
        run_robot(setup, hold(setup, 8 * setup.sample_time))
        sizes.append(address_space())
    assert sizes[-1] - sizes[1] < 15e6


def test_mujocos_warnings_make_no_file(spec, tmp_path, monkeypatch):
    """Numbers too large for its solver: the run ends and says so; MuJoCo alone would write MUJOCO_LOG.TXT, and to standard error."""
    import mujoco

    monkeypatch.chdir(tmp_path)
    heard: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(heard.append)
    try:
        setup = setup_of(spec, "joint")
        simulation = RobotStepper(setup)
        simulation.data.qvel[:] = 1e12
        assert simulation.part(hold(setup, 2 * setup.sample_time), 0).ending == "diverged"
        assert heard == []
        mujoco.mj_step(simulation.robot.model, simulation.data)  # the user's own again
        assert any("simulation is unstable" in text for text in heard)
    finally:
        mujoco.set_mju_user_warning(before)
    assert list(tmp_path.iterdir()) == []
