"""gainroom.audit and load_robot of what a program holds: models and gains in memory have the numbers of the command line's files."""

import json
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.joint_yaml import parse_joint

mujoco = pytest.importorskip("mujoco")
pin = pytest.importorskip("pinocchio")

LEG = """
<mujoco model="leg">
  <option gravity="0 0 -9.81" timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="base" pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1" mass="5"/>
    <body name="thigh" pos="0 .1 -.1" euler="10 20 30">
      <joint name="hip" axis="0 1 0" armature=".02" damping=".5" range="-90 90" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".04" mass="2"/>
      <body name="shank" pos="0 0 -.3"><joint name="knee" axis="0 1 0" armature=".03" ref="20" pos="0.01 0 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1"/><site name="foot" pos="0 0 -.3"/>
        <body name="toe" pos="0 0 -.3">
          <joint name="slide" type="slide" axis="0 0 1" range="-1 1" armature="0.1" stiffness="10" springref="0.1"/>
          <geom type="sphere" size=".03" mass="0.2"/></body></body></body></body></worldbody>
  <actuator><position name="h" joint="hip" kp="100" kv="4" forcerange="-50 50"/><position name="k" joint="knee" kp="80" kv="3"/>
    <position name="s" joint="slide" kp="500" kv="20"/></actuator>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 .3 -.5 .05"/></keyframe>
</mujoco>
"""
CALL = {"delay": 3e-3, "rate": 500.0, "stiffness": 2000.0, "damping": 1.0, "posture": "home"}
TYPED = ["--delay-ms", "3", "--rate-hz", "500", "--stiffness", "2000", "--damping", "1", "--posture", "home"]
NAMES = ("robot", "system")
"""Keys of --json that name the file."""


def without_names(found: dict) -> dict:
    return {key: value for key, value in found.items() if key not in NAMES}


def alike(one, other) -> bool:
    """The same, with numbers to 1e-9: a model's frames are turned once more on the way through MJCF."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(alike, one, other))
    return one == pytest.approx(other, rel=1e-9, abs=1e-12) if isinstance(one, float) else one == other


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("leg") / "leg.xml"
    path.write_text(LEG, "utf-8")
    return path


@pytest.mark.slow
def test_a_model_in_memory_has_the_command_lines_numbers(file: Path, capsys):
    main(["audit", str(file), *TYPED, "--json"])
    command = json.loads(capsys.readouterr().out)
    for model in (str(file), file, mujoco.MjModel.from_xml_string(LEG), mujoco.MjSpec.from_string(LEG)):
        found = gr.audit(model, **CALL)
        assert alike(without_names(found.to_dict()), without_names(command)), type(model)
        assert "/tmp" not in json.dumps(found.to_dict()) or isinstance(model, str | Path)
    record = gr.audit(file, **CALL)
    assert record.verdict.level == command["verdict"] == "unsafe"
    assert command["sentence"][:40] in record._repr_html_()
    assert "plotly" in record.plot().html
    assert "<iframe" in record.plot()._repr_html_()


@pytest.mark.slow
def test_pinocchios_model_is_the_urdfs(capsys):
    """Its rotors count as armature; the numbers are those of the file that it was read from."""
    path = Path(gr.__path__[0]) / "robot" / "models" / "biped.urdf"
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    call = {"delay": 2e-3, "rate": 2000.0, "gearbox": "direct", "motor_inertia": 1.0, "contact": "left_sole"}
    expected = gr.audit("gainroom:biped.urdf", {".*": {"kp": 2000, "kd": 100}}, base="floating", **call).to_dict()
    assert alike(without_names(gr.audit(model, {".*": (2000, 100)}, **call).to_dict()), without_names(expected))
    del call["motor_inertia"]
    model.armature = np.concatenate([np.zeros(6), np.ones(model.nv - 6)])
    found = gr.audit(model, (2000.0, np.full(model.nv - 6, 100.0)), **call).to_dict()
    assert [joint["gain_limit"] for joint in found["joints"]] == pytest.approx([joint["gain_limit"] for joint in expected["joints"]])


def test_a_continuous_joint_of_pinocchio_has_no_limits():
    """Its position is a cosine and a sine, of which the limits are."""
    from gainroom.robot.formats.in_memory import mjcf_of

    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRUBY(), pin.SE3.Identity(), "wheel")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(2.0, 0.1, 0.2, 0.4), pin.SE3.Identity())
    compiled = mujoco.MjModel.from_xml_string(mjcf_of(model))
    assert not compiled.jnt_limited[0]
    assert compiled.jnt_axis[0] == pytest.approx([0, 1, 0])


def test_every_joint_type_of_pinocchio_keeps_its_dynamics():
    """Mass matrices of a sample of joint types, at random positions, beside those of the text that MuJoCo compiles."""
    from gainroom.robot.formats.in_memory import mjcf_of

    model, place, rng = pin.Model(), 0, np.random.default_rng(0)
    axis = np.array([0.6, 0.0, 0.8])
    kinds = [
        pin.JointModelRX(),
        pin.JointModelPY(),
        pin.JointModelRZ(),
        pin.JointModelRevoluteUnaligned(axis),
        pin.JointModelPrismaticUnaligned(axis),
    ]
    for k, kind in enumerate(kinds):
        place = model.addJoint(place, kind, pin.SE3.Random(), f"joint{k}")
        model.appendBodyToJoint(place, pin.Inertia.FromBox(2.0, 0.1, 0.2, 0.4), pin.SE3.Random())
    links, model.armature = model.copy(), rng.random(model.nv)
    compiled = mujoco.MjModel.from_xml_string(mjcf_of(model))
    data, mass = mujoco.MjData(compiled), np.zeros((model.nv, model.nv))
    for _ in range(5):
        q = rng.uniform(-1, 1, model.nq)
        data.qpos[:] = q
        mujoco.mj_forward(compiled, data)
        for k in range(model.nv):
            mujoco.mj_mulM(compiled, data, mass[k], np.eye(model.nv)[k])
        half = pin.crba(links, links.createData(), q)
        expected = np.triu(half) + np.triu(half, 1).T + np.diag(model.armature)
        assert mass == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.slow
def test_gains_are_taken_as_people_hold_them(file: Path):
    own = gr.audit(file, **CALL).tightest.limit.gain
    kp, kd = np.array([100.0, 80.0, 500.0]), np.array([4.0, 3.0, 20.0])
    by_name = {"hip": (100, 4), "knee": {"kp": 80, "kd": 3}, "slide": [500, 20]}
    for gains in ((kp, kd), np.array([kp, kd]), by_name):
        assert gr.audit(file, gains, **CALL).tightest.limit.gain == pytest.approx(own, rel=1e-9)
    stiff = {**CALL, "stiffness": {"hip": 2000.0, "knee|slide": 2000.0}}
    assert gr.audit(file, **stiff).tightest.limit.gain == pytest.approx(own, rel=1e-9)
    asked = gr.audit(file, **CALL, require={"gain_margin_db": 8.0, "peak_sensitivity": None})
    assert asked.required.gain_margin == pytest.approx(10 ** (8 / 20))
    assert "peak_sensitivity" not in asked.required.asked


@pytest.mark.parametrize(
    ("model", "gains", "words"),
    [
        ("<mujoco><worldbody/></mujoco>", (1, 1), ["model: is XML text", "MjModel.from_xml_string"]),
        (3, None, ["model: a builtins.int must be a path, mujoco.MjModel, mujoco.MjSpec or pinocchio.Model"]),
        ("leg", 5, ["gains: must be a path", "(kp, kd)", "3 each, one per joint: hip, knee, slide"]),
        ("leg", ([1, 2], [1, 2]), ["3 each"]),
        ("leg", {"hip": 3}, ["gains: 'hip': 3 must be {'kp': …, 'kd': …} or (kp, kd)"]),
        ("leg", {"hpi": (3, 1)}, ["hpi"]),
        ("leg", {"hip": (-3, 1)}, ["hip", "-3"]),
        ("leg", {"hip": {"kp": None}}, ["gains: 'hip'", "must be"]),
        ("leg", {"hip": (1, 2, 3)}, ["gains: 'hip'", "must be"]),
        ("leg", (None, 5), ["gains: must be"]),
    ],
)
def test_what_is_not_taken_is_one_line(file: Path, model, gains, words: list[str]):
    with pytest.raises(gr.GainroomError) as error:
        gr.audit(file if model == "leg" else model, gains, **CALL)
    assert "\n" not in str(error.value)
    assert all(word in str(error.value) for word in words), str(error.value)
    assert "/tmp" not in str(error.value).replace(str(file), "")


def test_a_delay_in_the_wrong_unit_is_one_line_and_a_record_prints_its_sentence(file: Path):
    with pytest.raises(gr.GainroomError, match="5000 ms must be <= 1000 ms, without a rate"):
        gr.audit(file, (40.0, 2.0), delay=5)
    found = gr.audit(file, (40.0, 2.0), **CALL)
    assert str(found) == found.to_dict()["sentence"]


SECTIONS = {
    "drive": {"delay_ms": 3, "bandwidth": 4000},
    "control": {"type": "pd", "feedback": "motor", "kp": 100, "kd": 4, "sample_rate_hz": 500},
    "joints": {"default": {"stiffness": 2000, "damping": 1}},
}


def test_a_robot_of_a_model_and_sections(file: Path, tmp_path: Path):
    """A path, a mapping and a model in memory make the same robot; what is missing is told as in a file."""
    text = f"model: {{file: {file}}}\n" + "".join(f"{key}: {json.dumps(value)}\n" for key, value in SECTIONS.items())
    (tmp_path / "robot.yaml").write_text(text, "utf-8")
    sources = [
        gr.load_robot(tmp_path / "robot.yaml"),
        gr.load_robot({"model": {"file": str(file)}, **SECTIONS}),
        gr.load_robot(file, **SECTIONS),
        gr.load_robot(mujoco.MjModel.from_xml_string(LEG), **SECTIONS),
    ]
    limits = [gr.analyze(robot.system).every[0].limit.gain for robot in sources]
    assert limits == pytest.approx([limits[0]] * 4, rel=1e-9)
    assert sources[-1].name == "MjModel"
    with pytest.raises(gr.GainroomError, match="MjModel: drive is missing"):
        gr.load_robot(mujoco.MjModel.from_xml_string(LEG))


def test_other_records_have_numbers_card_and_picture():
    study = gr.study_joint(parse_joint((Path(gr.__path__[0]) / "files" / "examples" / "testbed.yaml").read_text("utf-8"), "testbed.yaml"))
    found = study.to_dict()
    assert found["verdict"] == study.verdict.level
    assert found["gain_limit"] == pytest.approx(study.limit.gain)
    json.dumps(found, allow_nan=False)
    assert found["sentence"][:30] in study._repr_html_()
    assert "plotly" in study.plot().html
