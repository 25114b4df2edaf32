"""Robot files from anywhere: found where they are said to be, and refused in one line where they are wrong."""

import importlib.metadata
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from gainroom.errors import GainroomError
from gainroom.robot import load_model
from gainroom.robot.formats.model_names import locate
from refusals import assert_refused

THREADED_LOADS = 60
"""Of each file: with standard error caught for the whole process, 4 bad files in 360 loads came out good."""
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
MJCF_BODY = '<body name="{0}"><joint name="{0}"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'


def link(name: str, inertial: str = INERTIAL) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(name: str, parent: str, child: str, kind: str = "continuous", more: str = "") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'


def urdf(*parts: str) -> str:
    return f'<robot name="r">{"".join(parts)}</robot>'


def mjcf(body: str = MJCF_BODY.format("a"), before: str = "", after: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{body}</worldbody>{after}</mujoco>"


ARM = urdf(link("base"), link("upper"), link("lower"), joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower"))


def fixed(inertial: str = INERTIAL, more: str = "") -> str:
    """An arm of one joint with a link 'c' that the fixed joint 'k' holds on it."""
    return urdf(link("a"), link("b"), link("c", inertial), joint("j", "a", "b"), joint("k", "b", "c", "fixed", more))


DEEP = "<a>" * 500 + "</a>" * 500
BOMB = '<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;"/>'
BAD: dict[str, tuple[str | bytes, list[str]]] = {
    "empty": ("  \n", ["is empty"]),
    "binary": (b"\x7fELF\0\0", ["binary"]),
    "latin": ("<robot name='é'/>".encode("latin-1"), ["UTF-8"]),
    "cut off": (ARM[:200], ["line 1, column"]),
    "not XML": ("joint: {motor_inertia: 1}", ["line 1, column 1"]),
    "another root": ("<sdf version='1.7'/>", ["<sdf>", "<robot>", "<mujoco>"]),
    "entities": (BOMB, ["document types and entities"]),
    "remote document type": ('<!DOCTYPE robot SYSTEM "http://example.org/x.dtd"><robot name="r"/>', ["document types"]),
    "entities in an MJCF": (BOMB.replace("robot", "mujoco"), ["document types"]),
    "too deep": (f"<robot name='r'>{DEEP}</robot>", ["nested more than"]),
    "too many elements": (f"<robot name='r'>{'<a/>' * 100_001}</robot>", ["more than 100000 elements"]),
    "too many attributes": ("<robot " + " ".join(f"a{k}='1'" for k in range(201)) + "/>", ["more than 200 attributes"]),
    "xacro": ('<robot name="r" xmlns:xacro="x"><xacro:include filename="x"/></robot>', ["xacro", "expand"]),
    "no name": ("<robot><link name='a'/></robot>", ["No name"]),
    "no links": (urdf(), ["No link"]),
    "no joints": (urdf(link("a")), ["no actuated joint", "no joints"]),
    "unknown parent": (urdf(link("base"), link("b"), joint("j", "bse", "b")), ["'j'", "'bse'", "did you mean 'base'"]),
    "no child": (urdf(link("a"), '<joint name="j" type="fixed"><parent link="a"/></joint>'), ["'j'", "child link ''"]),
    "two roots": (urdf(link("a"), link("b")), ["Two root links"]),
    "two parents": (urdf(*map(link, "abc"), joint("j", "a", "c"), joint("k", "b", "c")), ["'c'", "child of 2"]),
    "a loop": (urdf(*map(link, "abcd"), joint("j", "a", "b"), joint("k", "b", "a"), joint("m", "c", "d")), ["'a'", "loop"]),
    "same link twice": (urdf(link("a"), link("a")), ["'a' is not unique"]),
    "same joint twice": (urdf(*map(link, "abc"), joint("j", "a", "b"), joint("j", "b", "c")), ["'j' is not unique"]),
    "no axis": (urdf(*map(link, "ab"), joint("j", "a", "b", more='<axis xyz="0 0 0"/>')), ["'j'", "axis '0 0 0'"]),
    "axis in words": (urdf(*map(link, "ab"), joint("j", "a", "b", more='<axis xyz="0 z 0"/>')), ["'j'", "axis"]),
    "unknown kind": (urdf(*map(link, "ab"), joint("j", "a", "b", "ball")), ["no known type [ball]"]),
    "no limits": (urdf(*map(link, "ab"), joint("j", "a", "b", "revolute")), ["does not specify limits"]),
    "mass in words": (urdf(link("a"), link("b", INERTIAL.replace('value="1"', 'value="1,5"')), joint("j", "a", "b")), ["mass", "1,5"]),
    "mass not a number": (urdf(link("a"), link("b", INERTIAL.replace('value="1"', 'value="nan"')), joint("j", "a", "b")), ["'nan'"]),
    "negative mass": (urdf(link("a"), link("b", INERTIAL.replace('value="1"', 'value="-1"')), joint("j", "a", "b")), ["mass -1 kg"]),
    "no mass": (urdf(link("a"), link("b", ""), link("c", ""), joint("j", "a", "b"), joint("k", "a", "c")), ["joints 'j', 'k'", "inertia"]),
    "negative mass on a fixed link": (fixed(INERTIAL.replace('value="1"', 'value="-0.1"')), ["link 'c'", "mass -0.1 kg", ">= 0"]),
    "huge mass": (fixed(INERTIAL.replace('value="1"', 'value="1e200"')), ["link 'c'", "mass 1e+200 kg", "<= 1e+12 kg"]),
    "negative inertia": (fixed(INERTIAL.replace('ixx="1"', 'ixx="-1"')), ["link 'c'", "inertia ixx -1 kg·m²", ">= 0"]),
    "huge inertia": (fixed(INERTIAL.replace('ixy="0"', 'ixy="1e200"')), ["link 'c'", "inertia ixy 1e+200 kg·m²", "<= 1e+12"]),
    "inertia without a moment": (fixed(INERTIAL.replace('iyz="0" ', "")), ["link 'c'", "<inertia> iyz is missing"]),
    "inertia of no number": (fixed(INERTIAL.replace('iyz="0"', 'iyz="1_0"')), ["link 'c'", "inertia iyz '1_0'", "a finite number"]),
    "far origin": (fixed(more='<origin xyz="0 1e200 0"/>'), ["joint 'k'", "origin xyz '0 1e200 0'", "<= 1e+06 m"]),
    "origin of two numbers": (fixed(more='<origin xyz="0 1"/>'), ["joint 'k'", "origin xyz '0 1'", "3 finite numbers"]),
    "infinite origin": (fixed(more='<origin xyz="0 1e999 0"/>'), ["joint 'k'", "origin xyz", "finite"]),
    "huge axis": (urdf(*map(link, "ab"), joint("j", "a", "b", more='<axis xyz="0 1e200 0"/>')), ["'j'", "axis '0 1e200 0'", "up to 1e+06"]),
    "inertial twice": (fixed(2 * INERTIAL), ["link 'c'", "<inertial> 2 times"]),
    "mass twice": (fixed(INERTIAL.replace("<mass", '<mass value="3"/><mass')), ["link 'c'", "<mass> 2 times"]),
    "inertia twice": (fixed(INERTIAL.replace("<inertia ", '<inertia ixx="3"/><inertia ')), ["link 'c'", "<inertia> 2 times"]),
    "origin twice": (fixed(more=2 * '<origin xyz="0 0 1"/>'), ["joint 'k'", "<origin> 2 times"]),
    "origin of the inertia twice": (
        fixed(INERTIAL.replace("<mass", 2 * '<origin xyz="0 0 1"/>' + "<mass")),
        ["link 'c'", "<origin> 2 times"],
    ),
    "axis twice": (fixed(more=2 * '<axis xyz="0 0 1"/>'), ["joint 'k'", "<axis> 2 times"]),
    "parent twice": (fixed(more='<parent link="b"/>'), ["joint 'k'", "<parent> 2 times"]),
    "child twice": (fixed(more='<child link="b"/>'), ["joint 'k'", "<child> 2 times"]),
    "limit twice": (fixed(more=2 * '<limit lower="0" upper="1"/>'), ["joint 'k'", "<limit> 2 times"]),
    "misspelt inertial": (fixed(INERTIAL.replace("inertial", "inertail")), ["link 'c'", "<inertail>", "did you mean <inertial>"]),
    "mass outside": (fixed('<mass value="3"/>'), ["link 'c'", "<mass>", "belongs in <inertial>"]),
    "misspelt mass": (fixed(INERTIAL.replace("<mass", "<mas")), ["link 'c'", "<mas>", "did you mean <mass>"]),
    "other attribute of mass": (fixed(INERTIAL.replace('value="1"', 'value="1" kg="2"')), ["link 'c'", "attribute kg"]),
    "misspelt attribute of origin": (
        fixed(more='<origin xyz="0 0 0" rpyy="1 0 0"/>'),
        ["'k'", "attribute rpyy", "did you mean attribute rpy?"],
    ),
    "misspelt axis": (urdf(*map(link, "ab"), joint("j", "a", "b", more='<axes xyz="0 1 0"/>')), ["'j'", "<axes>", "did you mean <axis>"]),
    "misspelt joint": (
        ARM.replace('<joint name="elbow"', '<Joint name="elbow"').replace("</joint></robot>", "</Joint></robot>"),
        ["<Joint>", "<joint>"],
    ),
    "reserved joint": (ARM.replace('"elbow"', '"universe"'), ["joint 'universe'", "rename"]),
    "joint without a name": (ARM.replace('name="elbow"', ""), ["a joint has no name"]),
    "planar joint": (urdf(*map(link, "ab"), joint("j", "a", "b", "planar")), ["'j'", "3 degrees of freedom", "lock"]),
    "too many joints": (
        urdf(link("0"), *(link(str(k)) + joint(f"j{k}", "0", str(k)) for k in range(1, 152))),
        ["151 joints", "at most 150"],
    ),
    "a long chain": (
        urdf(link("0"), *(link(str(k)) + joint(f"j{k}", str(k - 1), str(k), "fixed") for k in range(1, 5000))),
        ["5000 links", "at most 2000"],
    ),
    "MJCF without joints": (mjcf("<body><geom size='1'/></body>"), ["no actuated joint"]),
    "MJCF element": (mjcf('<body><jont/><geom size="1"/></body>'), ["not a valid MJCF", "jont"]),
    "MJCF without mass": (mjcf('<body name="b"><joint/></body>'), ["not a valid MJCF", "'b'"]),
    "MJCF inertia": (mjcf(MJCF_BODY.format("a").replace("1 1 1", "1 1 5")), ["'a'", "inertia"]),
    "MJCF reference infinite": (mjcf(MJCF_BODY.format("a").replace("<joint ", '<joint ref="inf" ')), ["orientation", "finite"]),
    "MJCF mass not a number": (mjcf(MJCF_BODY.format("a").replace('mass="1"', 'mass="nan"')), ["'nan'", "finite"]),
    "MJCF out of range": (mjcf(MJCF_BODY.format("a").replace('pos="0 0 0"', 'pos="1e400 0 0"')), ["MJCF"]),
    "MJCF section": (mjcf(before="<defaults/>"), ["<defaults> is no section", "did you mean <default>?"]),
    "MJCF section unlike any": (mjcf(before="<xyzzy/>"), ["<xyzzy> is no section", "worldbody"]),
    "MJCF far body": (mjcf(MJCF_BODY.format("a").replace('name="a">', 'name="a" pos="0 1e200 0">')), ["'a'", "1e+200", "<= 1e+06 m"]),
    "MJCF far site": (
        mjcf(MJCF_BODY.format("a").replace("<joint", '<site name="far" pos="0 1e7 0"/><joint')),
        ["frame 'far'", "<= 1e+06 m"],
    ),
    "MJCF heavy body": (mjcf(MJCF_BODY.format("a").replace('mass="1"', 'mass="1e200"')), ["'a'", "mass 1e+200 kg", "<= 1e+12 kg"]),
    "MJCF armature": (mjcf(MJCF_BODY.format("a").replace("<joint", '<joint armature="1e200"')), ["'a'", "armature", "1e+200", "<= 1e+12"]),
    "MJCF negative armature": (mjcf(MJCF_BODY.format("a").replace("<joint", '<joint armature="-1"')), ["'a'", "armature -1", ">= 0"]),
    "MJCF infinite shape": (mjcf('<body name="b"><joint/><geom size="1e200"/></body>'), ["'b'", "finite"]),
    "MJCF reserved joint": (mjcf(MJCF_BODY.replace('"{0}"', '"universe"')), ["joint 'universe'", "rename"]),
    "MJCF joint like an unnamed one": (
        mjcf('<body><joint/><geom size="1"/><body><joint name="joint#0"/><geom size="1"/></body></body>'),
        ["joint 'joint#0'", "2 joints have this name"],
    ),
    "MJCF inertial twice": (mjcf(MJCF_BODY.format("a").replace("</body>", '<inertial pos="0 0 0" mass="2"/></body>')), ["inertial"]),
    "ball joint": (mjcf('<body><joint name="j" type="ball"/><geom size="1"/></body>'), ["'j'", "3 degrees of freedom", "lock"]),
    "replicate": (mjcf(f'<replicate count="1000000000">{MJCF_BODY.format("a")}</replicate>'), ["<replicate>"]),
    "composite": (mjcf('<body><composite type="cable" count="100000 1 1"/></body>'), ["<composite>"]),
    "attach": (mjcf('<body><attach model="m" prefix="p"/></body>', '<asset><model name="m" file="m.xml"/></asset>'), ["<attach>"]),
    "many bodies": (mjcf("<body/>" * 2001), ["2001 of <body>", "at most 2000"]),
    "mesh missing": (
        mjcf('<body name="b"><joint/><geom type="mesh" mesh="m"/></body>', '<asset><mesh name="m" file="m.stl"/></asset>'),
        ["'b'", "<inertial>", "'m.stl'", "missing"],
    ),
    "mesh elsewhere": (
        mjcf('<body name="b"><joint/><geom type="mesh" mesh="m"/></body>', '<asset><mesh name="m" file="../../m.stl"/></asset>'),
        ["'../../m.stl'", "outside"],
    ),
    "mesh unknown": (mjcf('<body name="b"><joint/><geom type="mesh" mesh="m"/></body>'), ["MJCF", "m"]),
    "include missing": (mjcf(before='<include file="gone.xml"/>'), ["'gone.xml'", "no such file"]),
    "include of itself": (mjcf(before='<include file="robot.xml"/>'), ["'robot.xml'", "includes itself"]),
    "include outside": (mjcf(before='<include file="../secret.xml"/>'), ["'../secret.xml'", "outside"]),
    "absolute include": (mjcf(before='<include file="/etc/passwd"/>'), ["'/etc/passwd'", "outside"]),
    "include of nothing": (mjcf(before="<include/>"), ["file"]),
    "two robots": (
        mjcf("".join(f'<body name="{k}"><freejoint/><geom size="1"/>{MJCF_BODY.format(k + "1")}</body>' for k in "ab")),
        ["more than one floating base", "'a', 'b'"],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_gives_one_line_that_names_it(case: str, tmp_path: Path, capfd: Any, monkeypatch: pytest.MonkeyPatch):
    """And nothing else: nothing printed, nothing left behind."""
    content, words = BAD[case]
    path = tmp_path / "robot.xml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    monkeypatch.chdir(tmp_path)
    assert_refused(lambda: load_model(path), ["robot.xml", *words])
    assert capfd.readouterr() == ("", "")
    assert [each.name for each in tmp_path.iterdir()] == ["robot.xml"]


def test_a_path_that_is_no_file(tmp_path: Path):
    assert_refused(lambda: load_model(tmp_path / "gone.urdf"), ["gone.urdf", "no such file"])
    assert_refused(lambda: load_model(tmp_path), [str(tmp_path), "directory"])
    assert_refused(lambda: load_model("/dev/zero"), ["/dev/zero", "not a regular file"])
    assert_refused(lambda: load_model(tmp_path / "x\0.urdf"), ["cannot be read"])


def test_a_huge_file_is_not_read(tmp_path: Path):
    path = tmp_path / "robot.urdf"
    with path.open("wb") as file:
        file.truncate(60 * 2**20)  # sparse
    assert_refused(lambda: load_model(path), ["robot.urdf", "larger than"])


def test_links_of_the_file_system_do_not_lead_out(tmp_path: Path):
    (tmp_path / "secret.xml").write_text("<mujocoinclude/>", "utf-8")
    home = tmp_path / "robot"
    home.mkdir()
    (home / "inside.xml").symlink_to(tmp_path / "secret.xml")
    (home / "robot.xml").write_text(mjcf(before='<include file="inside.xml"/>'), "utf-8")
    assert_refused(lambda: load_model(home / "robot.xml"), ["'inside.xml'", "outside"])


def test_includes_are_put_in_place_as_mujoco_does(tmp_path: Path):
    """Names are relative to the model; where that is no file, to the file that includes."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "robot.xml").write_text(mjcf(MJCF_BODY.format("first") + '<include file="parts/arm.xml"/>'), "utf-8")
    arm = f'<include file="hand.xml"/>{MJCF_BODY.format("arm")}'
    (tmp_path / "parts" / "arm.xml").write_text(f"<mujocoinclude>{arm}</mujocoinclude>", "utf-8")
    (tmp_path / "parts" / "hand.xml").write_text(f"<mujocoinclude>{MJCF_BODY.format('hand')}</mujocoinclude>", "utf-8")
    assert load_model(tmp_path / "robot.xml").joint_names == ("first", "hand", "arm")
    (tmp_path / "hand.xml").write_text(f"<mujocoinclude>{MJCF_BODY.format('other')}</mujocoinclude>", "utf-8")
    assert load_model(tmp_path / "robot.xml").joint_names == ("first", "other", "arm")


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM, "utf-8")
    return path


CALLS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "locked, none": ({"locked": ["sholder"]}, ["arm.urdf", "locked", "'sholder'", "did you mean 'shoulder'"]),
    "locked, malformed": ({"locked": ["elbow("]}, ["locked", "'elbow('", "regular expression"]),
    "selected, none": ({"selected": ["leg_.*"]}, ["selected", "'leg_.*'", "joints: shoulder, elbow"]),
    "all locked": ({"locked": [".*"]}, ["no actuated joint", "all 2 joints are locked"]),
    "none selected": ({"selected": []}, ["no actuated joint"]),
    "base": ({"base": "free"}, ["base 'free'", "fixed or floating"]),
    "posture, unknown": ({"posture_for_locked": {"elbw": 1.0}}, ["'elbw'", "did you mean 'elbow'"]),
    "posture, infinite": ({"posture_for_locked": {"elbow": float("inf")}}, ["'elbow'", "finite"]),
}


@pytest.mark.parametrize("case", CALLS)
def test_a_bad_call_gives_one_line(arm: Path, case: str):
    options, words = CALLS[case]
    assert_refused(lambda: load_model(arm, **options), words)


def test_a_body_refuses_what_it_does_not_have(arm: Path):
    body = load_model(arm)
    q = body.neutral()
    assert_refused(lambda: body.configuration({"elbows": 1.0}), ["arm.urdf", "'elbows'", "did you mean 'elbow'"])
    assert_refused(lambda: body.configuration({"elbow": float("nan")}), ["'elbow'", "finite"])
    assert_refused(lambda: body.frame_placement(q, "uper"), ["'uper'", "did you mean 'upper'"])
    assert_refused(lambda: body.frame_jacobian(q, "shoulder"), ["no frame 'shoulder'"])  # a joint is no link
    assert_refused(lambda: body.mass_matrix(q[:1]), ["shape (1,)", "(4,)"])
    assert_refused(lambda: body.gravity_torque(q + float("inf")), ["finite"])
    assert_refused(lambda: body.integrate(q, [1.0]), ["shape (1,)", "(2,)"])


def test_a_ball_joint_may_be_locked(tmp_path: Path):
    path = tmp_path / "robot.xml"
    path.write_text(mjcf(f'<body><joint name="ball" type="ball"/><geom size="1"/>{MJCF_BODY.format("a")}</body>'), "utf-8")
    assert load_model(path, locked=["ball"]).joint_names == ("a",)


def test_a_link_and_its_joint_may_share_a_name_and_a_joint_may_be_called_root(tmp_path: Path):
    path = tmp_path / "robot.urdf"
    joints = joint("root_joint", "a", "root_joint") + joint("j", "root_joint", "c")
    path.write_text(urdf(*map(link, ("a", "root_joint", "c")), joints), "utf-8")
    body = load_model(path, "floating", locked=["j"])
    assert (body.joint_names, body.frames, body.nv) == (("root_joint",), ("a", "root_joint", "c"), 7)
    assert body.total_mass == pytest.approx(3.0)


@pytest.mark.slow
def test_models_in_packages():
    path = locate({"package": "example-robot-data", "file": "solo12.urdf"})
    assert path.name == "solo12.urdf"
    assert path.is_file()
    refusals = {
        ("example-robot-dat", "x.urdf"): ["'example-robot-dat'", "did you mean 'example-robot-data'"],
        ("no-such-robots", "x.urdf"): ["'no-such-robots'", "pip install no-such-robots"],
        ("example-robot-data", "talos_data/robots/talos_reducd.urdf"): ["talos_data/robots/talos_reduced.urdf"],
        ("example-robot-data", "anymal.urdf"): ["may be", "anymal_b_simple_description", "more of the path"],
        ("example-robot-data", "../../../../etc/passwd"): ["has no"],
        ("numpy", "x.urdf"): ["numpy has no 'x.urdf'", "0 files"],
        ("", "x.urdf"): ["''"],
        ("../robots", "x.urdf"): ["'../robots' is not installed"],
        ("a b; rm", "x.urdf"): ["'a b; rm' is not installed"],
    }
    for (package, file), words in refusals.items():
        assert_refused(lambda package=package, file=file: load_model({"package": package, "file": file}), words)
    assert_refused(lambda: load_model({"pakage": "numpy"}), ["package: …, file: …"])


def test_names_of_robot_descriptions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arm: Path):
    assert_refused(lambda: load_model("arm_description"), ["'arm_description'", "pip install robot_descriptions"])
    package = tmp_path / "robot_descriptions"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "arm_description.py").write_text(f"print('downloading')\nURDF_PATH = {str(arm)!r}\n", "utf-8")
    (package / "far_description.py").write_text("raise OSError('no\\nnetwork')\n", "utf-8")
    (package / "odd_description.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    try:
        assert load_model("arm_description").joint_names == ("shoulder", "elbow")
        assert capsys.readouterr().out == ""
        assert_refused(lambda: load_model("armm_description"), ["did you mean 'arm_description'"])
        assert_refused(lambda: load_model("far_description"), ["'far_description'", "no network"])
        assert_refused(lambda: load_model("odd_description"), ["neither a URDF nor an MJCF"])
    finally:
        for name in [name for name in sys.modules if name.split(".")[0] == "robot_descriptions"]:
            del sys.modules[name]


def test_what_is_not_installed_is_said(arm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "robot.xml").write_text(mjcf(), "utf-8")
    with monkeypatch.context() as missing:
        missing.setitem(sys.modules, "mujoco", None)
        assert_refused(lambda: load_model(tmp_path / "robot.xml"), ["Pinocchio and MuJoCo: pip install 'gainroom[robot]'"])
        assert load_model(arm).size == 2
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert_refused(lambda: load_model(arm), ["robot models need Pinocchio: pip install 'gainroom[robot]'"])


@pytest.mark.slow
def test_every_public_robot_loads_or_says_why_not():
    """All URDFs of example-robot-data, on either base; those refused are malformed, have massless or impossible links, or no joints."""
    reasons = {
        "ur3.urdf": "No name",
        "quadrotor_base.urdf": "it has no joints",
        "iris_simple.urdf": "it has no joints",
        "romeo.urdf": "'LHand', 'RHand'",
        "romeo_laas_small.urdf": "'body': its least principal inertia",
    }
    robots = [file for file in importlib.metadata.files("example-robot-data") or () if file.suffix == ".urdf"]
    assert len(robots) > 60
    for file in robots:
        for base in ("fixed", "floating"):
            if file.name in reasons:
                assert_refused(lambda file=file, base=base: load_model(str(file.locate()), base), [file.name, reasons[file.name]])
                continue
            body = load_model(str(file.locate()), base)
            passive = sum(body.model.joints[body.model.getJointId(name)].nv for name in body.passive)
            assert body.nv == body.size + passive + (6 if base == "floating" else 0)
            assert body.mass_matrix(body.neutral()).shape == (body.nv, body.nv)


def test_a_joint_may_be_called_as_a_marked_frame(tmp_path: Path):
    path = tmp_path / "robot.xml"
    path.write_text(mjcf(MJCF_BODY.format("a") + MJCF_BODY.format("link:a")), "utf-8")
    body = load_model(path, locked=["link:a"])
    assert (body.joint_names, body.frames) == (("a",), ("a", "link:a"))


def test_what_bears_on_nothing_may_stand_in_a_urdf(tmp_path: Path):
    """Sections of simulators, pictures, effort limits, and a link's own origin."""
    extra = '<gazebo reference="a"><mass/></gazebo><transmission name="t"><joint name="x"/></transmission><material name="m"/>'
    seen = '<visual><origin xyz="x"/></visual><collision/><origin xyz="0 0 0"/>'
    turning = joint("j", "a", "b", "revolute", '<limit lower="-1" upper="1" effort="-inf" velocity="x"/><hardwareInterface/>')
    path = tmp_path / "robot.urdf"
    path.write_text(urdf(link("a", INERTIAL + seen), link("b"), turning, extra), "utf-8")
    body = load_model(path)
    assert (body.joint_names, body.lower[0], body.upper[0]) == (("j",), -1.0, 1.0)


@pytest.mark.slow
def test_eight_threads_read_good_and_bad_files_alike(tmp_path: Path):
    """Every bad one is refused, every good one read, and standard error is where it was."""
    texts = {
        "good.urdf": ARM,
        "good.xml": mjcf(MJCF_BODY.format("a")),
        "mass.urdf": ARM.replace('value="1"', 'value="1,5"'),
        "limit.urdf": ARM.replace("continuous", "revolute"),
        "type.urdf": ARM.replace("continuous", "ball"),
        "twice.urdf": fixed(2 * INERTIAL),
        "name.xml": mjcf("<body><jont/></body>"),
        "class.xml": mjcf(MJCF_BODY.format("a").replace("<joint", "<joint class='no'")),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, "utf-8")
    before = os.fstat(2)

    def outcome(name: str) -> tuple[str, str]:
        try:
            return name, " ".join(load_model(tmp_path / name).joint_names)
        except GainroomError as error:
            return name, str(error)

    alone = dict(map(outcome, texts))
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(outcome, list(texts) * THREADED_LOADS))
    assert [found for found in together if alone[found[0]] != found[1]] == []
    assert (alone["good.urdf"], alone["good.xml"]) == ("shoulder elbow", "a")
    assert all(str(tmp_path / name) in said for name, said in alone.items() if not name.startswith("good"))
    assert os.path.samestat(before, os.fstat(2))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("http://example.org/robot.urdf", "is an address; download it"),
        ("https://example.org/robot", "is an address; download it"),
        ("package://my_robot/robot.urdf", "is an address"),
        ("my_robot:/robot.urdf", "no such file"),
        ("some:text", "no such file"),
        ("what is this?", "no such file"),
        ("C:\\robots\\arm.urdf", "no such file"),
        ("../robots:arm.urdf", "no such file"),
    ],
)
def test_nobody_is_told_to_install_what_is_no_package(name: str, says: str):
    with pytest.raises(GainroomError, match=says) as caught:
        load_model(name)
    assert "pip" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("package", ["../robots", "a b; rm", "", "-r", "x", "a" * 100, "http://example.org"])
def test_nobody_is_told_to_install_what_is_no_name(package: str):
    with pytest.raises(GainroomError, match="is not installed") as caught:
        locate({"package": package, "file": "x.urdf"})
    assert "pip" not in str(caught.value)
