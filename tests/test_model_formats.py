"""A new format of robot files is one class and its line in FORMATS: everything that takes a model takes it then."""

import json
from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import gainroom as gr
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.files.robot_yaml import load_robot
from gainroom.robot import load_model
from gainroom.robot.assemble import Description
from gainroom.robot.body import Base
from gainroom.robot.formats.model_files import FORMATS
from gainroom.robot.formats.model_format import ActuatorGain, ActuatorGains, ModelFormat
from refusals import assert_refused

LENGTH = 0.5


class Chain(ModelFormat):
    """<chain><rod mass="…"/>…</chain>: rods of one length with their mass at the end, one hinge about y each."""

    title = "a chain"

    def describe(self, root: Element, path: Path, base: Base | None) -> Description:
        model = pin.Model()
        for index, rod in enumerate(root):
            mass = float(rod.get("mass", "nan"))
            place = pin.SE3(np.eye(3), np.array([0.0, 0.0, LENGTH * (index > 0)]))
            joint = model.addJoint(index, pin.JointModelRY(), place, f"hinge{index}")
            model.addJointFrame(joint)
            model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([0.0, 0.0, LENGTH]), np.zeros((3, 3))), pin.SE3.Identity())
            model.addBodyFrame(f"rod{index}", joint, pin.SE3.Identity(), -1)
        return Description(str(path), model)

    def keyframes(self, root: Element, path: Path) -> Mapping[str, Mapping[str, float]]:
        return {"bent": {"hinge1": 0.5 * np.pi}}

    def position_gains(self, root: Element, path: Path) -> ActuatorGains:
        return ActuatorGains({f"hinge{index}": ActuatorGain(200.0, 10.0) for index in range(len(root))})


@pytest.fixture
def chain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setitem(FORMATS, "chain", Chain())
    path = tmp_path / "two.xml"
    path.write_text('<chain><rod mass="3"/><rod mass="2"/></chain>', "utf-8")
    return path


def test_a_robot_yaml_takes_it(chain: Path):
    (chain.parent / "robot.yaml").write_text(
        "model: {file: two.xml}\njoints: {default: {motor_inertia: 0.1}}\ndrive: {bandwidth: .inf, delay_ms: 2}\n"
        "control: {type: pd, feedback: motor, kp: 200, kd: 10}\npostures: {bent: {hinge1: 1.5707963267948966}}\n",
        "utf-8",
    )
    model = load_robot(chain.parent / "robot.yaml").linearize()
    # Two point masses, the outer rod at a right angle: A = [[(m1 + 2 m2) L², m2 L²], [m2 L², m2 L²]].
    expected = LENGTH**2 * np.array([[7.0, 2.0], [2.0, 2.0]])
    assert_allclose(np.linalg.inv(model.link_inverse_inertia), expected, rtol=1e-12)


@pytest.mark.slow
def test_its_robot_is_analysed_recommended_for_and_shown(chain: Path, capsys: pytest.CaptureFixture[str]):
    """The gain limit of one joint alone is that of the joint that it is; gains to use are found; terminal and page name its joints."""
    file, page = chain.parent / "robot.yaml", chain.parent / "robot.html"
    file.write_text(
        "model: {file: two.xml}\njoints: {default: {motor_inertia: 0.1}}\ndrive: {bandwidth: .inf, delay_ms: 2}\n"
        "control: {type: pd, feedback: motor, kp: 200, kd: 10}\npostures: {bent: {hinge1: 1.5707963267948966}}\n",
        "utf-8",
    )
    assert main(["robot", str(file), "--json", "--report", str(page), "--exit-zero"]) == 0
    facts = json.loads(capsys.readouterr().out)
    (state,) = facts["states"]
    inverse = np.linalg.inv(LENGTH**2 * np.array([[7.0, 2.0], [2.0, 2.0]]))
    for k, joint in enumerate(state["joints"]):
        alone = gr.build_loop(gr.ElasticJoint(0.1, 1 / inverse[k, k]), gr.Drive(delay=2e-3), gr.PD(200.0, 10.0))
        assert joint["name"] == f"hinge{k}"
        assert joint["single_joint_limit"] == pytest.approx(gr.gain_limit(alone).gain, rel=1e-9)
    assert min(facts["recommended"][0]["sets"][0]["kp"]) > 0
    assert "hinge1" in page.read_text("utf-8")
    assert main(["robot", str(file), "--exit-zero"]) == 0
    assert "hinge1" in capsys.readouterr().out


def test_audit_takes_its_gains_and_keyframes(chain: Path):
    spec = audited(str(chain), None, AuditOptions(2.0, motor_inertia=0.1, posture=("bent",))).system
    assert spec.control.controller is not None
    assert_allclose(spec.control.controller.kp, [200.0, 200.0])
    assert spec.source.postures["bent"].angles == {"hinge1": 0.5 * np.pi}


def test_what_is_the_same_for_all_formats_is_checked_for_it_too(chain: Path):
    for mass, words in (("-1", ["joint 'hinge0'", "mass -1 kg"]), ("1e13", ["<= 1e+12 kg"]), ("0", ["no mass moves"])):
        chain.write_text(f'<chain><rod mass="{mass}"/></chain>', "utf-8")
        assert_refused(lambda: load_model(chain), words)
    chain.write_text("<chain/>", "utf-8")
    assert_refused(lambda: load_model(chain), ["it has no joints"])
    chain.write_text("<sdf/>", "utf-8")
    with pytest.raises(GainroomError, match=r"<robot> \(URDF\) or <mujoco> \(MJCF\) or <chain> \(a chain\)"):
        load_model(chain)
