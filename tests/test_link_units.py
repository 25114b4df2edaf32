"""Links whose masses, lengths or inertias are in the wrong unit: never a verdict, and never a false alarm on a robot that exists."""

import json
import re
from dataclasses import replace
from importlib.metadata import files
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gainroom.cli import main
from gainroom.robot import load_model
from gainroom.robot.formats.urdf import Urdf
from gainroom.robot.formats.xml_text import read_xml
from gainroom.robot.plausible_links import link_doubts
from refusals import assert_refused

ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.18"/><mass value="3.6"/>
<inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.008"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0.01 -0.17"/><mass value="2.4"/>
<inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.004"/></inertial></link>
<link name="hand"><inertial><origin xyz="0 0 -0.05"/><mass value="0.6"/>
<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.0008"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1.1"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.36"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="grip" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0 0 -0.34"/></joint></robot>"""


def scaled(text: str, mass: float = 1.0, length: float = 1.0, inertia: float = 1.0, centre: float = 1.0) -> str:
    """The same URDF with its numbers times these: lengths of joints, and of centres of mass both `length` and `centre`."""
    root = ElementTree.fromstring(text)
    for joint in root.iter("joint"):
        for origin in joint.findall("origin"):
            origin.set("xyz", " ".join(repr(length * float(x)) for x in origin.get("xyz", "0 0 0").split()))
    for one in root.iter("inertial"):
        for origin in one.findall("origin"):
            origin.set("xyz", " ".join(repr(length * centre * float(x)) for x in origin.get("xyz", "0 0 0").split()))
        for each in one.iter("mass"):
            each.set("value", repr(mass * float(each.get("value", "0"))))
        for each in one.iter("inertia"):
            for key, value in list(each.attrib.items()):
                each.set(key, repr(inertia * float(value)))
    return ElementTree.tostring(root, "unicode")


FINGER = scaled(ARM, mass=0.01, length=0.1, inertia=1e-4)
SLIPS = {
    "masses in g": ({"mass": 1e3}, "g?"),
    "masses and inertias in g and g·m²": ({"mass": 1e3, "inertia": 1e3}, "g?"),
    "masses in t": ({"mass": 1e-3}, " in t"),
    "masses and inertias in t and t·m²": ({"mass": 1e-3, "inertia": 1e-3}, " in t"),
    "lengths in mm": ({"length": 1e3}, "mm?"),
    "lengths in cm": ({"length": 1e2}, " in cm"),
    "lengths in mm, inertias in kg·mm²": ({"length": 1e3, "inertia": 1e6}, "mm?"),
    "centres of mass in mm": ({"centre": 1e3}, "mm?"),
    "inertias in g·m²": ({"inertia": 1e3}, "g·m²"),
    "inertias in kg·cm²": ({"inertia": 1e4}, "kg·cm²"),
    "inertias in kg·mm²": ({"inertia": 1e6}, "kg·mm²"),
    "inertias in t·m²": ({"inertia": 1e-3}, "t·m²"),
}


def doubts(folder: Path, text: str) -> tuple[str, ...]:
    path = folder / "robot.urdf"
    path.write_text(text, "utf-8")
    return load_model(path).doubts


@pytest.mark.parametrize("robot", [ARM, FINGER], ids=["an arm of 6.6 kg", "a finger of 66 g and 9 cm"])
@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_units_is_named_with_its_link(tmp_path: Path, slip: str, robot: str):
    factors, meant = SLIPS[slip]
    assert not doubts(tmp_path, robot)
    (text,) = doubts(tmp_path, scaled(robot, **factors))
    assert re.search("link '(upper|lower|hand)'", text)
    assert "no robot has such a link" in text
    assert meant in text


def test_an_arm_of_40_g_is_too_light(tmp_path: Path):
    (text,) = doubts(tmp_path, scaled(ARM, mass=0.04 / 6.6, inertia=0.04 / 6.6))
    assert "all links have 0.04 kg" in text
    assert "link 'upper' most of it" in text


def test_one_link_of_a_robot_alone(tmp_path: Path):
    """The elbow's inertia alone in kg·cm²: a radius of gyration of 11 m."""
    text = ARM.replace('ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.004"', 'ixx="300" ixy="0" ixz="0" iyy="300" iyz="0" izz="40"')
    (told,) = doubts(tmp_path, text)
    assert told.startswith("link 'lower': 2.4 kg and 300 kg·m²")


MJCF = """<mujoco><worldbody><body name="thigh" pos="0 0 1"><joint name="hip" axis="0 1 0"/>
<inertial pos="0 0 {c}" mass="{m}" diaginertia="{i} {i} 0.01"/><body name="shank" pos="0 0 {l}"><joint name="knee" axis="0 1 0"/>
<inertial pos="0 0 {c}" mass="{m}" diaginertia="{i} {i} 0.01"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("values", "meant"),
    [
        ({"m": 3, "c": -0.2, "l": -0.4, "i": 0.05}, ""),
        ({"m": 3000, "c": -0.2, "l": -0.4, "i": 0.05}, "its mass in g?"),
        ({"m": 3, "c": -200, "l": -400, "i": 0.05}, "lengths in mm?"),
        ({"m": 0.003, "c": -0.2, "l": -0.4, "i": 0.05}, "its mass in t?"),
    ],
)
def test_an_mjcf_likewise(tmp_path: Path, values: dict[str, float], meant: str):
    path = tmp_path / "leg.xml"
    path.write_text(MJCF.format(**values), "utf-8")
    found = load_model(path).doubts
    assert len(found) == bool(meant)
    assert all(re.search("link '(thigh|shank)'", text) and meant in text for text in found)


def audited(capsys: pytest.CaptureFixture[str], folder: Path, text: str, gains: str) -> tuple[int, dict]:
    (folder / "robot.urdf").write_text(text, "utf-8")
    (folder / "gains.yaml").write_text(gains, "utf-8")
    call = ["audit", str(folder / "robot.urdf"), "--gains", str(folder / "gains.yaml"), "--delay-ms", "5", "--motor-inertia", "0.01"]
    return main([*call, "--json"]), json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("slip", [{}, {"mass": 1e3}, {"length": 1e3}, {"inertia": 1e3}])
def test_such_a_model_gets_no_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str], slip: dict[str, float]):
    """Gains that are unstable on the robot as it is: of heavier links they were said to be safe, exit status 0."""
    status, told = audited(capsys, tmp_path, scaled(ARM, **slip), "{default: {kp: 400, kd: 40}}")
    assert (status, told["safe"]) == (3 if slip else 1, False)
    assert told["verdict"] == ("undecided" if slip else "unsafe")
    assert told["sentence"].startswith("Not decided: link '" if slip else "Not safe: unstable")
    assert told["decided"] is not bool(slip)
    assert (told["to_use"] is None) is bool(slip)
    assert told["gain_limit"] is None or (told["gain_limit"] > 1) is bool(slip)


def test_the_page_gets_no_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "robot.urdf").write_text(scaled(ARM, mass=1e3), "utf-8")
    (tmp_path / "gains.yaml").write_text("{default: {kp: 400, kd: 40}}", "utf-8")
    page = tmp_path / "page.html"
    call = ["audit", str(tmp_path / "robot.urdf"), "--gains", str(tmp_path / "gains.yaml"), "--delay-ms", "5"]
    assert main([*call, "--report", str(page)]) == 3
    assert "Not decided: link 'upper'" in " ".join(capsys.readouterr().out.split())
    assert '<body class="warn">' in page.read_text("utf-8")


def thin(xx: float, yy: float, zz: float, xy: float = 0.0) -> str:
    """The arm with another inertia of its hand."""
    old = 'ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.0008"'
    return ARM.replace(old, f'ixx="{xx}" ixy="{xy}" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"')


@pytest.mark.parametrize(
    ("inertia", "said"),
    [((0.02, 0.001, 0.001), True), ((0.001, 0.001, 0.003), True), ((0.001, 0.001, 0.002), False), ((0.002, 0.001, 0.001001), False)],
)
def test_an_inertia_that_no_solid_has_is_said_in_every_audit(tmp_path: Path, capsys: pytest.CaptureFixture[str], inertia, said: bool):
    """One principal moment beyond the sum of the others; a plate has just that sum, and files have few digits."""
    _, told = audited(capsys, tmp_path, thin(*inertia), "{default: {kp: 40, kd: 2}}")
    assert any(text.startswith("no solid has the inertia of these links") and "'hand'" in text for text in told["warnings"]) is said


@pytest.mark.parametrize("product", [2e12, -2e12, 1e300])
def test_an_inertia_beyond_all_products_is_refused_by_its_own_name(tmp_path: Path, product: float):
    """At most 1e12 kg·m², whose products stay within a double; a product of inertia may be negative, as long as it is no larger."""
    (tmp_path / "robot.urdf").write_text(thin(0.001, 0.001, 0.001, product), "utf-8")
    words = ["link 'hand'", f"inertia ixy {product:g} kg·m² must be >= -1e+12 and <= 1e+12"]
    assert_refused(lambda: load_model(tmp_path / "robot.urdf"), words)


def test_a_negative_principal_inertia_is_refused(tmp_path: Path):
    """[[a, b], [b, a]] has a − b; round-off of files is none, and dummies that count for nothing are taken as given."""
    path = tmp_path / "robot.urdf"
    path.write_text(thin(0.001, 0.001, 0.001, 0.0015), "utf-8")
    assert_refused(lambda: load_model(path), ["link 'hand'", "least principal inertia -0.0005 kg·m²", ">= 0"])
    path.write_text(thin(0.001, 0.001, 0.001, 0.001 + 1e-12), "utf-8")
    load_model(path)
    path.write_text(thin(1e-9, 1e-9, 1e-9, 2e-9).replace('value="0.6"', 'value="1e-6"'), "utf-8")
    assert any("negative about some axis" in note for note in load_model(path).notes)


def urdfs() -> list[Path]:
    """Those of the package example-robot-data that are robots with joints, each once."""
    found = {Path(str(each.locate())) for each in files("example-robot-data") or () if each.name.endswith(".urdf")}
    return sorted(found)


# Toys and faulty files: a base that floats with 0.1 kg and 1 kg·m², joints none, an inertia of −0.021 kg·m², no name.
NO_ROBOTS = ("double_pendulum_simple.urdf", "quadrotor_base.urdf", "iris_simple.urdf", "romeo_laas_small.urdf", "ur3.urdf")


@pytest.mark.slow
def test_no_public_robot_is_doubted_and_each_slip_of_each_is_seen():
    """Of hands, arms, legs, humanoids and drones. Where a robot hangs in one body, lengths are few, and slips of them may stay inside."""
    count, missed = 0, []
    for path in urdfs():
        if path.name in NO_ROBOTS:
            continue
        description = Urdf().describe(read_xml(path), path, None)
        assert link_doubts(description.model, description.solids) == (), path
        count += 1
        for mass, inertia in ((1e3, 1.0), (1.0, 1e3), (1e3, 1e3), (1e-3, 1.0)):
            slipped = [replace(one, mass=mass * one.mass, moments=inertia * one.moments) for one in description.solids]
            if not link_doubts(description.model, slipped):
                missed.append((path.name, mass, inertia))
    assert count > 50
    assert len(missed) <= 0.03 * 4 * count, missed
