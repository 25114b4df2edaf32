"""The ground under feet: level where the contact leaves that open, and told where a flat foot makes it slope."""

import math
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.report.simulation_text import warnings
from gainroom.robot.contact import Contact
from gainroom.robot.ground import Ground, footings, ground_axes
from gainroom.simulation.mujoco_model import build_mujoco
from gainroom.simulation.robot_simulation import RobotSimulation
from gainroom.studies.simulation import Outcome, simulate_study
from robot_files import SOLO, written
from robot_truths import actuators, biped, biped_posture, feet

mujoco = pytest.importorskip("mujoco")

UP = np.array([0.0, 0.0, 1.0])


def normals(robot) -> np.ndarray:
    """(c, 3) of the compiled planes."""
    planes = [k for k in range(robot.model.ngeom) if robot.model.geom_type[k] == mujoco.mjtGeom.mjGEOM_PLANE]
    data = mujoco.MjData(robot.model)
    mujoco.mj_forward(robot.model, data)
    return np.array([data.geom_xmat[k].reshape(3, 3)[:, 2] for k in planes])


@pytest.fixture(scope="module")
def body():
    return biped()


@pytest.fixture(scope="module")
def tilted(body):
    """The biped's posture with rolled hips and pitched ankles: its soles slope about both axes."""
    return biped_posture(body, {"hip_roll": 0.2, "hip_pitch": -0.5, "knee": 1.0})


def test_point_feet_stand_on_level_ground(body, tilted):
    robot = build_mujoco(body, actuators(12), tilted, feet("left_sole", "right_sole", kind="point"), timestep=2.5e-4, ground=Ground())
    assert_allclose(normals(robot), [UP, UP], atol=1e-12)  # round-off of a few rotations
    data = robot.new_data(tilted)
    mujoco.mj_forward(robot.model, data)
    for name in ("left_sole", "right_sole"):  # the ball's lowest point is where the frame is
        ball = robot.model.geom(f"{name}/sole")
        lowest = data.geom_xpos[ball.id] - ball.size[0] * UP
        assert_allclose(lowest, body.frame_placement(tilted, name)[1], atol=1e-12)


def test_a_line_lies_in_ground_as_level_as_it_can_be(body, tilted):
    robot = build_mujoco(body, actuators(12), tilted, feet("left_sole", kind="line"), timestep=2.5e-4, ground=Ground())
    along = body.frame_placement(tilted, "left_sole")[0][:, 1]
    (normal,) = normals(robot)
    assert abs(normal @ along) < 1e-12
    turned = [math.cos(angle) * np.cross(along, normal) + math.sin(angle) * normal for angle in np.linspace(0, math.pi, 181)]
    assert normal @ UP >= max(one @ UP for one in turned) - 1e-12  # no plane through the line is more level


def test_a_flat_foot_says_itself_how_its_ground_slopes(body, tilted):
    robot = build_mujoco(body, actuators(12), tilted, feet("left_sole"), timestep=2.5e-4, ground=Ground())
    assert_allclose(normals(robot)[0], body.frame_placement(tilted, "left_sole")[0][:, 2], atol=1e-12)


def test_without_gravity_nothing_is_level(body, tilted):
    robot = build_mujoco(body, actuators(12), tilted, feet("left_sole", kind="point"), timestep=2.5e-4, ground=Ground(), gravity=False)
    assert_allclose(normals(robot)[0], body.frame_placement(tilted, "left_sole")[0][:, 2], atol=1e-12)


def test_an_upright_line_keeps_its_own_axes():
    frame = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # its y is the vertical
    assert_allclose(ground_axes(Contact("foot", "line"), frame, UP), frame)


def test_springs_under_a_foot_are_no_ground(body):
    soft = Contact("left_sole", "flat", 1e5)
    assert [footing.frame for footing in footings(body, biped_posture(body), [soft, Contact("right_sole")])] == ["right_sole"]


def test_a_quadruped_stands_still_on_point_feet(tmp_path: Path):
    """At half the limit; friction 0.3 would not hold it on slopes of 46 degrees, nor on any beyond 16.7."""
    spec = load_robot_system(written(tmp_path, SOLO))
    play = simulate_study(RobotSimulation.of(spec), 0.33)
    assert play.completed
    assert play.slip.max() < 5e-4  # soft contacts creep a little
    # The weight is compensated and friction holds the motors: what is left is the ground's softness and rolling on balls of 2 cm.
    assert np.abs(play.run.base[-1, :3] - play.run.base[0, :3]).max() < 2e-3
    assert not any("slope" in warning or "height" in warning for warning in warnings(play))


def uneven(tmp_path: Path, text: str) -> Outcome:
    spec = load_robot_system(written(tmp_path, text))
    return simulate_study(RobotSimulation.of(spec))


@pytest.mark.slow
def test_a_sloping_sole_and_feet_at_two_heights_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Half a radian of pelvis against soles: -0.5 + 1.0 with the ankles at 0."""
    example = (
        (resources.files("gainroom.files.examples") / "biped-simulated.yaml").read_text("utf-8").replace("duration: 3.0", "duration: 0.02")
    )
    poses = example[example.index("  bent:") :].splitlines()[0]
    play = uneven(tmp_path, example.replace(poses, '  bent: {".*_hip_pitch": -0.5, ".*_knee": 1.0}'))
    told = " ".join(warnings(play))
    assert "slopes by 28.6° under left_sole and right_sole" in told
    assert "heights" not in told
    page = tmp_path / "page.html"
    path = written(tmp_path, example.replace(poses, '  bent: {".*_hip_pitch": -0.5, ".*_knee": 1.0, "left_knee": 0.9}'))
    main(["simulate", str(path), "--report", str(page)])
    capsys.readouterr()
    play = simulate_study(RobotSimulation.of(load_robot_system(path)))
    body, q = play.spec.setup.body, play.spec.setup.q
    apart = 1e3 * abs(body.frame_placement(q, "left_sole")[1][2] - body.frame_placement(q, "right_sole")[1][2])
    assert any(f"{apart:.3g} mm" in warning for warning in warnings(play))
    assert f"{apart:.3g} mm" in page.read_text("utf-8")
    assert "22.9°" in page.read_text("utf-8")  # 0.4 rad
    level = uneven(tmp_path, example)
    assert not any("slope" in warning or "height" in warning for warning in warnings(level))
