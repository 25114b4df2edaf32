"""Robots' files that keep MuJoCo busy, make it take memory, or end it: one line about the file, in bounded time, and exit status 2."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gainroom.app.robot_shapes import shapes_of
from gainroom.cli import main
from gainroom.io import guarded_child as module
from gainroom.robot import load_model
from gainroom.robot.formats import mjcf_file
from gainroom.robot.formats.model_files import keyframes, position_gains
from refusals import assert_refused

pytest.importorskip("mujoco")
pytest.importorskip("pinocchio")

ARM = '<body name="arm"><joint name="hinge" armature="0.1"/><geom size="0.1"/></body>'
CUBE = "0 0 0  1 0 0  0 1 0  0 0 1  1 1 0  1 0 1  0 1 1  1 1 1"


def written(path: Path, worldbody: str, rest: str = "") -> Path:
    path.write_text(f"<mujoco>{rest}<worldbody>{worldbody}</worldbody></mujoco>", "utf-8")
    return path


def sphere(path: Path, count: int) -> Path:
    """A mesh whose every corner is one of its hull: `count` points on a sphere, on a spiral."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn, radius = np.pi * (3 - np.sqrt(5)) * np.arange(count), np.sqrt(1 - height**2)
    corners = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)
    mesh = f'<asset><mesh name="ball" inertia="convex" vertex="{" ".join(f"{each:.5f}" for each in corners.ravel())}"/></asset>'
    return written(path, '<body name="arm"><joint name="hinge"/><geom type="mesh" mesh="ball"/></body>', mesh)


@pytest.mark.slow
def test_a_hull_that_takes_too_long(tmp_path: Path, monkeypatch, capsys):
    path = sphere(tmp_path / "ball.xml", 400_000)
    monkeypatch.setattr(module, "LEAST_SECONDS", 5.0)
    monkeypatch.setattr(module, "SECONDS_PER_BYTE", 0.0)
    assert main(["audit", str(path), "--delay-ms", "1"]) == 2
    assert capsys.readouterr().err.strip() == f"gainroom: error: {path}: is not an MJCF that can be read in 5 s"


def test_the_same_hull_of_fewer_corners_is_read(tmp_path: Path):
    assert load_model(sphere(tmp_path / "ball.xml", 100)).joint_names == ("hinge",)


@pytest.mark.parametrize(
    ("rest", "said"),
    [
        ('<size nuser_body="1000000000" memory="900G"/>', ""),
        ('<default class="main">' + "".join(f'<default class="c{k}">' for k in range(380)) + "</default>" * 381, ""),
        ('<include file="../other.xml"/>', "lies outside the model's folder"),
        ('<include file="robot.xml"/>', "is included twice, or includes itself"),
    ],
)
def test_sizes_and_names_in_a_file(rest: str, said: str, tmp_path: Path):
    """What does not bear on the robot is never seen by MuJoCo; what leads elsewhere is refused."""
    (tmp_path / "other.xml").write_text("<mujoco/>", "utf-8")
    (tmp_path / "in").mkdir()
    path = written(tmp_path / "in" / "robot.xml", ARM, rest)
    if said:
        assert_refused(lambda: load_model(path), [str(path), said])
    else:
        assert load_model(path).joint_names == ("hinge",)


@pytest.mark.parametrize("rest", ['<replicate count="1000000000"><geom size="1"/></replicate>', '<geom type="hfield" hfield="h"/>'])
def test_shapes_that_are_too_many(rest: str, tmp_path: Path, monkeypatch):
    """The page shows the whole file, and MuJoCo reads it as it stands: in the child, and the page draws its own shapes."""
    monkeypatch.setattr(module, "LEAST_SECONDS", 5.0)
    field = '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'
    path = written(tmp_path / "robot.xml", ARM.replace("</body>", f"{rest}</body>"), field)
    assert shapes_of(SimpleNamespace(source=str(path), frames=("arm",))) == ()  # type: ignore[arg-type]
    assert not list(tmp_path.glob("MUJOCO_LOG*"))


def test_a_model_is_compiled_once_as_long_as_its_files_stay(tmp_path: Path, monkeypatch):
    """With its keyframes and actuators; anew where the text or a mesh changes."""
    started = []
    monkeypatch.setattr(mjcf_file, "_sent", lambda *args: started.append(args[0]) or sent(*args))
    servo = '<actuator><position joint="hinge" kp="3"/></actuator><keyframe><key name="up" qpos="0.5"/></keyframe>'
    path = written(tmp_path / "robot.xml", ARM, servo)
    load_model(path)
    assert position_gains(path).joints["hinge"].kp == 3
    assert keyframes(path) == {"up": {"hinge": 0.5}}
    assert len(started) == 1
    path.write_text(path.read_text("utf-8").replace('kp="3"', 'kp="4"'), "utf-8")
    assert position_gains(path).joints["hinge"].kp == 4
    assert len(started) == 2

    mesh = tmp_path / "m.obj"
    corners = np.array(CUBE.split(), dtype=float).reshape(-1, 3)
    faces = (
        (1, 3, 5),
        (1, 5, 2),
        (1, 2, 6),
        (1, 6, 4),
        (1, 4, 7),
        (1, 7, 3),
        (8, 5, 3),
        (8, 3, 7),
        (8, 7, 4),
        (8, 4, 6),
        (8, 6, 2),
        (8, 2, 5),
    )
    path = written(
        tmp_path / "meshed.xml",
        '<body name="arm"><joint name="hinge"/><geom type="mesh" mesh="m"/></body>',
        '<asset><mesh name="m" file="m.obj"/></asset>',
    )
    masses = []
    for scale in (1.0, 1.0, 2.0):
        text = [f"v {x} {y} {z}" for x, y, z in scale * corners] + [f"f {a} {b} {c}" for a, b, c in faces]
        if not masses or masses[-1] != scale:
            mesh.write_text("\n".join(text), "utf-8")
            os.utime(mesh, ns=(0, int(scale)))
        masses.append(scale)
        assert float(load_model(path).model.inertias[1].mass) == pytest.approx(1000 * scale**3)  # MuJoCo's density is that of water
    assert len(started) == 4


sent = mjcf_file._sent


def test_keyframes_that_are_wrong_do_not_keep_the_robot_from_being_read(tmp_path: Path):
    path = written(tmp_path / "robot.xml", ARM, '<keyframe><key name="up" qpos="0.5 1 2"/></keyframe>')
    assert load_model(path).joint_names == ("hinge",)
    assert_refused(lambda: keyframes(path), [str(path), "not a valid MJCF", "up"])
    path = written(tmp_path / "many.xml", ARM, "<keyframe>" + 1001 * "<key/>" + "</keyframe>")
    assert load_model(path).joint_names == ("hinge",)
    assert_refused(lambda: keyframes(path), [str(path), "1001", "<keyframe>", "at most 1000"])
