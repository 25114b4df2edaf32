"""The robot's shapes and its mode on the page: read from its own files and no others, moving as the contacts let it."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gainroom.app.bench import Opened
from gainroom.app.messages import View
from gainroom.app.robot_bench import RobotBench
from gainroom.app.robot_shapes import mesh_file, shapes_of
from gainroom.cli.example import example_texts
from gainroom.robot.formats.model_files import load_model

pytest.importorskip("pinocchio")

TRIANGLE = """solid a
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 2 0
endloop
endfacet
endsolid a
"""
ROBOT = """<robot name="r"><link name="base">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/><geometry><mesh filename="{mesh}" scale="2 2 2"/></geometry></visual>
<visual><geometry><cylinder radius="0.1" length="0.7"/></geometry></visual></link></robot>
"""


def robot(folder: Path, mesh: str) -> Path:
    (folder / "robot.urdf").write_text(ROBOT.replace("{mesh}", mesh), "utf-8")
    return folder / "robot.urdf"


def test_meshes_and_simple_shapes_of_a_urdf(tmp_path: Path):
    (tmp_path / "part.stl").write_text(TRIANGLE, "utf-8")
    mesh, cylinder = shapes_of(load_model(robot(tmp_path, "part.stl")))
    assert (mesh.frame, mesh.kind, cylinder.kind, cylinder.size) == ("arm", "mesh", "cylinder", (0.1, 0.7))
    assert mesh.corners is not None
    placed = mesh.corners @ mesh.place[:3, :3].T + mesh.place[:3, 3]
    # a quarter turn about z: (2, 0, 0) comes to (0, 2, 0), and (0, 4, 0) to (−4, 0, 0); half a metre up
    assert sorted(map(tuple, np.round(placed, 9).tolist())) == [(-4.0, 0.0, 0.5), (0.0, 0.0, 0.5), (0.0, 2.0, 0.5)]
    count, faces = np.frombuffer(mesh.packed()[:8], "<u4")
    assert len(mesh.packed()) == 8 + 12 * count + 12 * faces


def test_a_mirrored_mesh_shows_its_outside(tmp_path: Path):
    (tmp_path / "part.stl").write_text(TRIANGLE, "utf-8")
    file = robot(tmp_path, "part.stl")
    file.write_text(file.read_text("utf-8").replace('scale="2 2 2"', 'scale="2 -2 2"'), "utf-8")
    mesh = shapes_of(load_model(file))[0]
    assert mesh.corners is not None
    first, second, third = mesh.corners[mesh.faces[0]]
    assert np.cross(second - first, third - first)[2] > 0  # the facet's normal, which a mirror along y leaves


OUTSIDE = (
    "../secret.stl",
    "/etc/passwd",
    "link.stl",
    "package://../secret.stl",
    "package://up/../../secret.stl",
    "file:///etc/passwd",
    "part.txt",
    "\0",
    "a/../../secret.stl",
)


@pytest.mark.parametrize("name", OUTSIDE)
def test_no_mesh_outside_the_models_folder_is_read(tmp_path: Path, name: str):
    """By .., by absolute names, by links; nor what is no mesh."""
    home = tmp_path / "up" / "model"
    home.mkdir(parents=True)
    (tmp_path / "secret.stl").write_text(TRIANGLE, "utf-8")
    (home / "part.txt").write_text(TRIANGLE, "utf-8")
    (home / "link.stl").symlink_to(tmp_path / "secret.stl")
    assert mesh_file(home / "robot.urdf", name) is None


def test_a_package_around_the_model_is_searched(tmp_path: Path):
    (tmp_path / "pack" / "urdf").mkdir(parents=True)
    (tmp_path / "pack" / "part.stl").write_text(TRIANGLE, "utf-8")
    model = tmp_path / "pack" / "urdf" / "robot.urdf"
    assert mesh_file(model, "package://pack/part.stl") == (tmp_path / "pack" / "part.stl").resolve()
    assert mesh_file(model, "package://other/part.stl") is None


def test_shapes_of_an_mjcf(tmp_path: Path):
    pytest.importorskip("mujoco")
    text = """<mujoco><worldbody><body name="arm"><joint name="j" axis="0 1 0"/><geom type="box" size="1 2 3" pos="0 0 1"/>
<geom type="capsule" size="0.1 0.5" mass="0"/></body></worldbody></mujoco>"""
    (tmp_path / "robot.xml").write_text(text, "utf-8")
    box, capsule = shapes_of(load_model(tmp_path / "robot.xml"))
    assert (box.frame, box.kind, box.size, box.place[2, 3]) == ("arm", "box", (2.0, 4.0, 6.0), 1.0)
    assert (capsule.kind, capsule.size) == ("capsule", (0.1, 1.0))


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (2.0, -1.0, 3.0)])
def test_shapes_are_turned_as_the_model_says(tmp_path: Path, axis: tuple[float, float, float]):
    """By 0.7 rad about an axis in an MJCF, and by roll, pitch and yaw about fixed axes in a URDF: SciPy has both."""
    pytest.importorskip("mujoco")
    turn = Rotation.from_rotvec(0.7 * np.array(axis) / np.linalg.norm(axis))
    x, y, z, w = turn.as_quat()
    text = f"""<mujoco><worldbody><body name="arm"><joint name="j" axis="0 1 0"/>
<geom type="box" size="1 2 3" pos="4 5 6" quat="{w} {x} {y} {z}"/></body></worldbody></mujoco>"""
    (tmp_path / "robot.xml").write_text(text, "utf-8")
    (box,) = shapes_of(load_model(tmp_path / "robot.xml"))
    assert box.place[:3, :3] == pytest.approx(turn.as_matrix(), abs=1e-12)
    assert box.place[:3, 3].tolist() == [4, 5, 6]
    roll, pitch, yaw = turn.as_euler("xyz")
    visual = f'<visual><origin xyz="4 5 6" rpy="{roll} {pitch} {yaw}"/><geometry><box size="1 2 3"/></geometry></visual>'
    (tmp_path / "robot.urdf").write_text(ROBOT.split("<visual>")[0] + visual + "</link></robot>", "utf-8")
    (box,) = shapes_of(load_model(tmp_path / "robot.urdf"))
    assert box.place[:3, :3] == pytest.approx(turn.as_matrix(), abs=1e-12)
    assert box.place[:3, 3].tolist() == [4, 5, 6]


def test_the_mode_moves_the_joints_as_the_limit_says_and_no_contact():
    """Feet that the contacts hold stand still; the knee's bone turns by the mode's part."""
    bench = RobotBench(Opened(example_texts()["biped"], "biped.yaml", Path()))
    view = View(contact="double")
    part = dict(bench.curves(view, None, "", False))["mode"]
    state = bench.state(view)
    moved = {name: np.array(part["re"][k + 1]).reshape(3, 4) for k, name in enumerate(part["frames"])}
    still, most = (max(np.abs(moved[name]).max() for name in names) for names in (("left_foot", "right_foot"), moved))
    assert most > 0.05
    assert still < 1e-3 * most  # differences over a ten-thousandth of the mode
    assert {one["name"] for one in part["contacts"]} == {"left_sole", "right_sole"}
    sizes = np.hypot(part["mode_re"], part["mode_im"])
    first = sizes[part["names"].index(state.limiting_joints[0])]
    assert first == pytest.approx(sizes.max(), rel=1e-5)  # both knees move alike but for round-off
    assert bench.mesh(0) is None
    assert bench.mesh(10**6) is None


PARTS = '<mujoco><asset><mesh name="m" file="part.obj"/></asset></mujoco>'
WHOLE = """<mujoco><compiler meshdir="assets"/><include file="{0}"/><worldbody><body name="arm"><inertial pos="0 0 0" mass="1"
diaginertia="1 1 1"/><joint name="j" axis="0 1 0"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def shapes_with(home: Path, included: str):
    (home / "robot.xml").write_text(WHOLE.format(included), "utf-8")
    return shapes_of(SimpleNamespace(source=str(home / "robot.xml"), frames=("arm",)))  # type: ignore[arg-type]


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A model's folder with a mesh that an included file names; the same mesh and file outside of it."""
    pytest.importorskip("mujoco")
    home = tmp_path / "up" / "model"
    (home / "assets").mkdir(parents=True)
    for folder in (home, tmp_path / "up"):
        (folder / "parts.xml").write_text(PARTS, "utf-8")
    (tmp_path / "up" / "part.obj").write_text(OBJ, "utf-8")
    (home / "assets" / "part.obj").write_text(OBJ, "utf-8")
    return home


def test_meshes_of_included_files_are_shown(home: Path):
    (home / "more.xml").write_text('<mujoco><include file="parts.xml"/></mujoco>', "utf-8")
    for included in ("parts.xml", "more.xml"):
        (mesh,) = shapes_with(home, included)
        assert (mesh.kind, len(mesh.corners)) == ("mesh", 4)


def test_nothing_outside_the_folder_is_shown_of_included_files(home: Path):
    """By .., by an absolute name, by a link that is included, by a link in the folder of meshes; nor where files include each other."""
    assert shapes_with(home, "../parts.xml") == ()
    assert shapes_with(home, str(home.parent / "parts.xml")) == ()
    (home / "link.xml").symlink_to(home.parent / "parts.xml")
    assert shapes_with(home, "link.xml") == ()
    (home / "round.xml").write_text('<mujoco><include file="round.xml"/></mujoco>', "utf-8")
    assert shapes_with(home, "round.xml") == ()
    assert shapes_with(home, "parts.xml")
    (home / "assets" / "part.obj").unlink()
    (home / "assets" / "part.obj").symlink_to(home.parent / "part.obj")
    assert shapes_with(home, "parts.xml") == ()
