"""What somebody feels who pushes a robot: its softest link, and the hand of an arm, in the answer and by hand."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("pinocchio")

import gainroom
import gainroom as gr
from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.simulation.step_response import step_response
from gainroom.studies.robot import study_robot
from robot_truths import hinge, link

LENGTH, MASS, LOAD, ROTOR, SPRING, DAMPING = 0.6, 2.0, 3.0, 0.1, 2000.0, 1.0
INERTIA = 0.05 + MASS * 0.3**2 + LOAD * LENGTH**2
"""[kg m²] of forearm and payload about the elbow."""


def arm(folder: Path, **top) -> Path:
    """A forearm on one elbow, level, with a payload at its hand."""
    bodies = link("base", 1.0, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)) + link("forearm", MASS, (0.3, 0.0, 0.0), (0.01, 0.05, 0.05))
    hand = '<link name="hand"/><joint name="grip" type="fixed"><parent link="forearm"/><child link="hand"/><origin xyz="0.6 0 0"/></joint>'
    (folder / "arm.urdf").write_text(f'<robot name="arm">{bodies}{hand}{hinge("elbow", "base", "forearm")}</robot>', "utf-8")
    described = {
        "model": {"file": "arm.urdf", "base": "fixed", "payload": {"frame": "hand", "mass": LOAD}},
        "joints": {"default": {"motor_inertia": ROTOR, "stiffness": SPRING, "damping": DAMPING}},
        "drive": {"bandwidth": 4000.0, "damping_ratio": 0.9, "delay_ms": 2.0},
        "control": {"type": "pd", "space": "joint", "feedback": "motor", "kp": 300.0, "kd": 12.0, "sample_rate_hz": 1000.0},
        **top,
    }
    file = folder / "arm.yaml"
    file.write_text(yaml.safe_dump(described), "utf-8")
    return file


def stiffness(kp: float, kd: float) -> float:
    """Dynamic stiffness of the elbow's link, as one joint [N m/rad]."""
    joint, drive = gr.ElasticJoint(ROTOR, INERTIA, SPRING, DAMPING), gr.Drive(4000.0, 0.9, 2e-3)
    return gr.dynamic_stiffness(gr.build_loop(joint, drive, gr.PD(kp, kd), sample_time=1e-3)).least


def test_links_move_over_time_as_that_of_the_same_joint_by_itself(tmp_path: Path):
    study = study_robot(load_robot_system(arm(tmp_path)), recommend=False)
    found = study.link_motion
    assert found is not None
    assert found.joints == ("elbow",)
    joint, drive = gr.ElasticJoint(ROTOR, INERTIA, SPRING, DAMPING), gr.Drive(4000.0, 0.9, 2e-3)
    own = step_response(gr.build_loop(joint, drive, gr.PD(300.0, 12.0), sample_time=1e-3))
    for name in ("link_step", "link_load"):
        swing, alone = getattr(found.responses[0], name), getattr(own, name)
        assert swing.overshoot == pytest.approx(alone.overshoot, rel=1e-6)  # its inertia comes out of the model to 9 digits
        assert swing.settling_time == pytest.approx(alone.settling_time, abs=1.01e-3)  # a tick
    assert found.responses[0].load.link_rest == pytest.approx(1 / 300 + 1 / SPRING, rel=1e-6)


@pytest.mark.slow
def test_links_of_a_robot_rest_where_gains_and_gearboxes_let_them():
    """Under a load between its two links alone a joint with its own gains gives way by 1/kp + 1/K, others by nothing."""
    study = study_robot(load_robot_system(Path(gainroom.__path__[0]) / "files/examples/biped.yaml"), recommend=False)
    found = study.link_motion
    assert found is not None
    assert len(found.joints) == 12
    for one in found.responses:
        assert one.load.link_rest == pytest.approx(1 / 2000 + 1 / 1e4, rel=1e-6)
        assert one.load.motor_rest == pytest.approx(1 / 2000, rel=1e-6)
        assert one.reference.link_rest == pytest.approx(1.0, rel=1e-6)


def test_the_hand_of_one_joint_is_its_link_times_the_square_of_its_length(tmp_path: Path):
    study = study_robot(load_robot_system(arm(tmp_path)))
    now, new = study.hands
    assert now is not None
    assert new is not None
    assert study.to_use is not None
    kp, kd = (float(gain[0]) for gain in (study.to_use[1].kp, study.to_use[1].kd))
    for hand, gains in ((now, (300.0, 12.0)), (new, (kp, kd))):
        # 1/50 of a peak's width between the frequencies leaves 1e-3 of its height, and lets the peak be missed by 1 % at most
        assert hand.softness == pytest.approx(LENGTH**2 / stiffness(*gains), rel=0.01)
        assert hand.frame == "hand"
    assert study.softest_now is not None
    assert study.softest_now.stiffness == pytest.approx(stiffness(300.0, 12.0), rel=5e-3)  # of a search's frequencies


def test_the_answer_tells_what_somebody_feels(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = arm(tmp_path)
    main(["robot", str(file), "--json"])
    (gains,) = json.loads(capsys.readouterr().out)["recommended"]
    kp, kd = gains["sets"][0]["kp"][0], gains["sets"][0]["kd"][0]
    main(["robot", str(file), "--report", str(tmp_path / "arm.html")])
    text = " ".join(capsys.readouterr().out.split())
    least = stiffness(kp, kd)
    told = re.search(r"Softest link: elbow, (\S+) N·m/rad at .*? \((\S+) N·m turn it by 1°\) with the new gains; elbow", text)
    moved = re.search(r"50 N at hand move it (\S+) mm at most", text)
    assert told is not None
    assert moved is not None
    # three digits, and what a search's frequencies may miss of a peak
    assert [float(one) for one in told.groups()] == pytest.approx([least, math.radians(least)], rel=0.01)
    assert float(moved.group(1)) == pytest.approx(5e4 * LENGTH**2 / least, rel=0.015)
    assert "50 N at hand move it" in (tmp_path / "arm.html").read_text("utf-8")


@pytest.mark.slow
def test_where_no_gains_meet_everything_the_nearest_miss_stands_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A dynamic stiffness of 1800 N·m/rad at a gearbox of 2000: nothing comes near, and no gains are advised."""
    file = arm(tmp_path, limits={"gain_margin_db": 6.0, "phase_margin_deg": 30.0, "dynamic_stiffness": 1800.0})
    main(["robot", str(file)])
    text = " ".join(capsys.readouterr().out.split())
    assert "Use instead" not in text
    assert "Do this: No gains meet everything that is required in every state; the nearest miss: dynamic stiffness" in text


def test_no_hand_without_a_payload_or_on_a_floating_base(tmp_path: Path):
    study = study_robot(load_robot_system(arm(tmp_path, model={"file": "arm.urdf", "base": "fixed"})))
    assert study.hands == (None, None)
    assert study.softest_now is not None
    assert np.isfinite(study.softest_now.stiffness)


def test_links_that_contacts_lock_have_gains_and_no_softness(tmp_path: Path):
    file = arm(tmp_path, contacts={"held": ["hand"]})  # six rows on one joint: the motor turns on its gearbox, the link does not
    study = study_robot(load_robot_system(file))
    assert all(one.everywhere is not None for one in study.recommended)
    assert study.softest_now is None
