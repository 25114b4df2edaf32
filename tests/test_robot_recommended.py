"""Gains to use on a robot: links are dynamically stiffest, or none can be raised by 5 %, whatever gains the file has; it stands on them.

The biped runs every time; TALOS, G1 and a quadruped with `pytest -m population`.
"""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import gainroom as gr
from gainroom.analysis.margins import joint_margins
from gainroom.cli import main
from gainroom.design.gain_sets import GainSet, RobotGains
from gainroom.design.robot_gains import recommend_robot
from gainroom.files.robot_yaml import load_robot_system, parse_robot
from gainroom.report.number_format import typed
from gainroom.report.robot_text import free_joints, sentence, warnings
from gainroom.studies.robot import study_robot
from gainroom.studies.verdict import STATUS
from gainroom.system.system import System
from independent.quick_margins import quick_margins
from robot_files import ROBOT, SOLO, write_arm

BIPED = """\
model: {package: gainroom, file: biped.urdf, base: floating}
joints: {default: {motor_inertia: 1.0, stiffness: 1.0e4, damping: 1.0}}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
postures: {stand: {".*_hip_pitch": -0.3, ".*_knee": 0.6, ".*_ankle_pitch": -0.3}}
contacts: {double: [left_sole, right_sole]}
control: {type: pd, feedback: motor, kp: 2000.0, kd: 100.0}
"""
TALOS = """\
model: {package: example-robot-data, file: talos_data/robots/talos_reduced.urdf, base: floating}
joints:
  default: {motor_inertia: 0.1, stiffness: 1.0e4, damping: 5}
  "leg_.*": {motor_inertia: 2.0}
  "leg_.*_4_joint": {motor_inertia: 4.05}
  "torso_.*": {motor_inertia: 1.0}
  "arm_.*_[1234]_joint": {motor_inertia: 0.5}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
postures: {stand: {"leg_.*_3_joint": -0.3, "leg_.*_4_joint": 0.6, "leg_.*_5_joint": -0.3, "arm_.*_4_joint": -0.5}}
contacts: {double: [left_sole_link, right_sole_link]}
control: {type: pd, feedback: motor, sample_rate_hz: 2000, kp: 2000, kd: 100}
"""
G1 = """\
model: {package: example-robot-data, file: g1_description/urdf/g1_29dof_rev_1_0.urdf, base: floating}
joints:
  default: {motor_inertia: 0.00361}
  ".*_hip_(pitch|yaw)_joint": {motor_inertia: 0.01018}
  "waist_yaw_joint": {motor_inertia: 0.01018}
  ".*_(hip_roll|knee)_joint": {motor_inertia: 0.0251}
  ".*_ankle_.*": {motor_inertia: 0.00722}
  "waist_(roll|pitch)_joint": {motor_inertia: 0.00722}
  ".*_wrist_(pitch|yaw)_joint": {motor_inertia: 0.00425}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 1.0}
postures: {stand: {".*_hip_pitch_joint": -0.2, ".*_knee_joint": 0.4, ".*_ankle_pitch_joint": -0.2}}
contacts: {double: [left_ankle_roll_link, right_ankle_roll_link]}
control: {type: pd, feedback: motor, sample_rate_hz: 1000, kp: 20, kd: 1}
"""
QUADRUPED = """\
model: {package: example-robot-data, file: go2_description/urdf/go2.urdf, base: floating}
joints: {default: {motor_inertia: 0.01}, ".*_calf_joint": {motor_inertia: 0.02}}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 1.0}
postures: {stand: {".*_thigh_joint": 0.8, ".*_calf_joint": -1.6}}
contacts: {all: [FEET]}
control: {type: pd, feedback: motor, sample_rate_hz: 1000, kp: 40, kd: 1}
""".replace("FEET", ", ".join(f"{{frame: {leg}_foot, type: point}}" for leg in ("FL", "FR", "RL", "RR")))


@pytest.fixture(scope="module")
def biped() -> tuple[System, RobotGains]:
    spec = parse_robot(BIPED, "biped")
    return spec, recommend_robot(spec)


def safe(gains: RobotGains) -> GainSet:
    assert gains.everywhere is not None
    return gains.everywhere


def loops(spec: System, kp: np.ndarray, kd: np.ndarray, weight: bool) -> dict[str, gr.Loop]:
    """Built from the file anew."""
    states = [(spec.source.linearize(posture, contact, weight=weight), f"{posture}/{contact}") for posture, contact in spec.source.states]
    return {title: gr.build_loop(model, spec.drives, gr.PD(kp, kd), "motor", spec.control.sample_time) for model, title in states}


def assert_keeps_what_is_required(spec: System, found: GainSet) -> None:
    for loop in loops(spec, found.kp, found.kd, not found.without_weight).values():
        assert spec.requirements.met_by(quick_margins(loop))
        whole = joint_margins(loop)  # certified, by other code
        assert spec.requirements.met("phase_margin", whole.phase_margin) is not False
        assert spec.requirements.met("gain_margin", whole.limit.gain) is not False


def assert_none_can_be_raised(spec: System, found: GainSet) -> None:
    """The definition of the largest kp: kp alone, and kp with kd, of every joint and its image.

    Gains that hold with the robot's weight have to hold without it, too.
    """
    weight = not found.without_weight
    assert_keeps_what_is_required(spec, found)
    size = len(found.kp)
    for j in range(size):
        more = np.where(found.kp == found.kp[j], 1.05, 1.0)
        for kd in (found.kd, found.kd * more):
            raised = [(title, loop) for each in {weight, False} for title, loop in loops(spec, found.kp * more, kd, each).items()]
            broken = any(not spec.requirements.met_by(quick_margins(loop)) for _, loop in raised)
            assert broken, f"{spec.source.joint_names[j]} can be raised"
        assert found.case[j] in dict(raised)


@pytest.mark.slow
def test_none_can_be_raised():
    spec = replace(parse_robot(BIPED, "biped"), objective="largest_kp")
    found = safe(recommend_robot(spec))
    assert not found.without_weight
    assert_none_can_be_raised(spec, found)
    assert found.binding == "stand/double"
    assert found.margin[found.softest] in spec.requirements.asked


@pytest.mark.slow
def test_what_is_typed_is_what_was_judged(biped: tuple[System, RobotGains]):
    """Four digits would do here, and every set keeps what is required with exactly the gains that are printed."""
    spec, gains = biped
    for found in gains.per_contact.values():
        assert found is not None
        for gain in (found.kp, found.kd):
            assert [float(typed(one)) for one in gain.tolist()] == gain.tolist()
            assert [float(f"{one:.4g}") for one in gain.tolist()] == gain.tolist()
        assert spec.requirements.met_by(found.margins)


@pytest.mark.slow
def test_gains_typed_back_meet_what_is_judged_then():
    """The file says nothing of gravity, so that its own gains are judged without the weight, while recommended ones stand under it."""
    spec = parse_robot(BIPED.replace("double: [left_sole, right_sole]", "left: [left_sole], flight: []"), "biped")
    found = safe(recommend_robot(spec))
    control = replace(spec.control, controller=gr.PD(kp=found.kp, kd=found.kd))
    for posture, contact in spec.source.states:
        for weight in (False, True):
            model = spec.source.linearize(posture, contact, weight=weight)
            margins = joint_margins(replace(spec, control=control).loop(model, control.controller))
            assert spec.requirements.met_by(margins), (contact, weight)


@pytest.mark.slow
def test_legs_get_equal_gains(biped: tuple[System, RobotGains]):
    _, gains = biped
    for found in gains.sets:
        np.testing.assert_array_equal(found.kp[:6], found.kp[6:])
        np.testing.assert_array_equal(found.kd[:6], found.kd[6:])


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["dynamic_stiffness", "largest_kp"])
def test_images_have_equal_gains_also_where_only_one_stands(objective: Any):
    spec = replace(parse_robot(BIPED.replace("double: [left_sole, right_sole]", "left: [left_sole]"), "biped"), objective=objective)
    found = safe(recommend_robot(spec))
    np.testing.assert_array_equal(found.kp[:6], found.kp[6:])
    np.testing.assert_array_equal(found.kd[:6], found.kd[6:])


@pytest.mark.slow
def test_a_search_may_begin_where_another_ended(biped: tuple[System, RobotGains]):
    """Then it gets at least as far by what it makes small, but for the digits that gains are rounded to, and meets the same."""
    spec, gains = biped
    again = safe(recommend_robot(spec, start=gains))
    assert again.times_stiffer(safe(gains)) > 1 - 1e-3
    assert all(spec.requirements.met_by(quick_margins(loop)) for loop in loops(spec, again.kp, again.kd, weight=True).values())


@pytest.mark.slow
def test_no_contact_state_has_softer_gains_than_all_together(biped: tuple[System, RobotGains]):
    """Its own search begins elsewhere, and gains for all states hold in it too; gains are rounded to digits that move them by 1e-3."""
    spec = parse_robot(BIPED.replace("double: [left_sole, right_sole]", "left: [left_sole], flight: []"), "biped")
    found = recommend_robot(spec)
    for contact, one in found.per_contact.items():
        assert one is not None
        assert one.times_stiffer(safe(found)) > 1 - 1e-3, contact


def standing(text: str, gains: RobotGains, folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any]]:
    """Status and facts of two seconds in MuJoCo, on the ground, held by nothing but its gains."""
    found, data = safe(gains), yaml.safe_load(text)
    for name, values in (("kp", found.kp), ("kd", found.kd)):
        data["control"][name] = dict(zip(gains.names, values.tolist(), strict=True))
    (contacts,) = data["contacts"].values()
    soles = {frame: {"length": 0.2, "width": 0.1} for frame in contacts if isinstance(frame, str)}
    data["scenario"] = {"duration": 2.0, "ground": {"friction": 0.8, "soles": soles}}
    (folder / "robot.yaml").write_text(yaml.safe_dump(data), "utf-8")
    status = main(["simulate", str(folder / "robot.yaml"), "--json"])
    return status, json.loads(capsys.readouterr().out)


def assert_stands(text: str, gains: RobotGains, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, facts = standing(text, gains, folder, capsys)
    assert status == STATUS[facts["verdict"]]  # sampled, they keep a little less than what they were found for
    assert not facts["fell"]
    assert facts["vibration"] is None or not facts["vibration"].get("vibrates", False)
    assert facts["ended_at"] is None or facts["ended_at"] == pytest.approx(2.0, abs=1e-2)


@pytest.mark.slow
def test_the_robot_stands_on_them(biped: tuple[System, RobotGains], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A joint of the robot sampled at 2 kHz keeps a little less than the continuous one."""
    assert_stands(BIPED.replace("feedback: motor,", "feedback: motor, sample_rate_hz: 2000,"), biped[1], tmp_path, capsys)


@pytest.mark.slow
def test_the_gains_of_the_file_play_no_part(tmp_path: Path):
    found = []
    for kp, kd in ((400.0, 30.0), (4.0, 30.0), (40000.0, 3.0)):
        path = write_arm(tmp_path)
        text = path.read_text("utf-8").replace("kp: 400.0, kd: 30.0", f"kp: {kp}, kd: {kd}")
        found.append(safe(recommend_robot(parse_robot(text, "arm", tmp_path))))
    for other in found[1:]:
        np.testing.assert_array_equal(other.kp, found[0].kp)
        np.testing.assert_array_equal(other.kd, found[0].kd)


@pytest.mark.slow
@pytest.mark.parametrize(("ranges", "said"), [("stiffness: [20, 100000]", True), ("stiffness: [7900, 8100]", False), ("", None)])
def test_what_a_wide_range_costs_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str], ranges: str, said: bool | None):
    """By the gains of the same file without the range."""
    text = ROBOT[: ROBOT.index("tasks:")]
    system = parse_robot(write_arm(tmp_path, text).read_text("utf-8"), "arm", tmp_path)
    path = write_arm(tmp_path, text + f"uncertainty: {{{ranges}}}\n")
    assert main(["robot", str(path), "--json"]) in (0, 1)
    told = json.loads(capsys.readouterr().out)
    if said is None:
        assert told["uncertainty_cost"] is None
        return
    exact = safe(recommend_robot(system))
    over = next(one for one in told["recommended"][0]["sets"] if one["contact"] == "everywhere")
    cost = 1 - np.array(over["dynamic_stiffness"]) / exact.stiffness
    np.testing.assert_allclose(told["uncertainty_cost"]["cost"], np.maximum(cost, 0.0), atol=1e-7)  # JSON has eight digits
    main(["robot", str(path)])
    shown = " ".join(capsys.readouterr().out.split())
    k = int(np.argmax(cost))
    assert (f"The range of stiffness costs {system.source.joint_names[k]} {100 * cost[k]:.0f} % of its dynamic stiffness" in shown) == said


@pytest.mark.slow
def test_without_weight_where_it_cannot_be_kept():
    """Gains that motors and springs so light allow cannot hold it: what is told is without the weight, and says so."""
    spec = parse_robot(SOLO, "solo")
    gains = recommend_robot(spec)
    found = safe(gains)
    assert found.without_weight
    assert found.nearest
    assert found.topples == ("stand/all",)
    assert not quick_margins(loops(spec, found.kp, found.kd, True)["stand/all"]).stable
    assert_keeps_what_is_required(spec, found)


@pytest.mark.slow
def test_where_the_file_counts_the_weight_no_gains_are_found_without_it():
    """The same robot: gains on which it topples are no answer then, and are not called safe alone where nothing is said of the weight."""
    spec = parse_robot(SOLO, "solo")
    found = safe(recommend_robot(spec))
    counted = recommend_robot(replace(spec, source=replace(spec.source, gravity=True)))
    assert counted.everywhere is None
    assert counted.nearest[""]
    own = replace(spec, control=replace(spec.control, controller=gr.PD(found.kp, found.kd)))
    for gravity, toppling in ((None, ("stand/all",)), (False, ())):
        study = study_robot(replace(own, source=replace(own.source, gravity=gravity)), recommend=False)
        assert study.stable
        assert study.topples == toppling
        assert ("with its weight the robot topples on these gains in stand/all" in sentence(study)) == bool(toppling)
        assert (study.verdict.level == "undecided") == bool(toppling)
        assert any("topples on these gains in stand/all" in one for one in warnings(study)) == bool(toppling)
    lost = study_robot(replace(own, source=replace(own.source, gravity=True)), recommend=False)
    assert not lost.stable
    assert "too soft to hold the robot against gravity" in sentence(lost)
    assert lost.tightest.loop.topples


@pytest.mark.population
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("text", [TALOS, G1, QUADRUPED], ids=["TALOS", "G1", "Go2"])
def test_larger_robots(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """They keep what is required with the weight, and the simulated robot stands on them.

    But for G1: its ankles' gains are those of feet that cannot tilt, as a flat rigid contact says, and a sole of 10 cm tilts at them. Then
    `simulate` says so.
    """
    spec = parse_robot(text, "robot")
    gains = recommend_robot(spec)
    found = safe(gains)
    with capsys.disabled():
        for name, j, value in zip(gains.names, range(len(gains.names)), found.kp.tolist(), strict=True):
            print(f"{name}: kp {value:.4g}, kd {found.kd[j]:.4g}, {found.margin[j]} in {found.case[j]}")
    assert not found.without_weight
    assert_keeps_what_is_required(spec, found)
    if text is not G1:
        assert_stands(text, gains, tmp_path, capsys)
        return
    status, facts = standing(text, gains, tmp_path, capsys)
    assert status == 1
    assert facts["diverged"]
    assert "ankle_roll" in facts["sentence"]


@pytest.mark.population
def test_none_can_be_raised_where_one_set_holds_in_several_states():
    spec = parse_robot(BIPED.replace("[left_sole, right_sole]}", "[left_sole, right_sole], flight: []}"), "robot")
    spec = replace(spec, objective="largest_kp")
    assert_none_can_be_raised(spec, safe(recommend_robot(spec)))


@pytest.mark.slow
def test_one_name_one_number(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """Terminal, JSON and page tell the same phase margin under the same name, and the same least one of a single loop."""
    path = write_arm(tmp_path)
    study = study_robot(load_robot_system(path))
    monkeypatch.setattr("gainroom.studies.robot.study_robot", lambda *_: study)
    report = tmp_path / "page.html"
    main(["robot", str(path), "--verbose", "--report", str(report)])
    words = capsys.readouterr().out
    main(["robot", str(path), "--json"])
    (state,) = json.loads(capsys.readouterr().out)["states"]
    (row,) = (line.split() for line in words.splitlines() if line.lstrip().startswith("bent/") and line.count("°") == 2)
    page = report.read_text("utf-8")
    common, single = state["phase_margin_deg"], state["single_loop_phase_margin_deg"]
    assert common != pytest.approx(single, rel=0.01)  # else nothing is told apart
    degrees = [f"{common:.3g}°", f"{single:.3g}°"]
    assert [cell for cell in row if cell.endswith("°")] == degrees
    cells = page[page.index("<td>bent/free</td>") :].split("</tr>")[0]
    assert [cell for cell in cells.replace("</td>", "<td>").split("<td>") if cell.endswith("°")] == degrees
    least = min(common, single)
    assert state["kept"]["phase_margin_deg"] == pytest.approx(least, rel=1e-12)
    assert state["kept"]["phase_margin_is"] == ("phase margin" if common <= single else "phase margin of one loop")


def test_phases_are_the_margins_of_their_names(tmp_path: Path):
    """Against the roots: all loops delayed in phase by it, or one of them, vibrate."""
    (state,) = study_robot(parse_robot(write_arm(tmp_path).read_text("utf-8"), "arm", tmp_path), recommend=False).states
    omega = np.geomspace(1.0, math.pi * 2000, 20_000)
    response = state.loop.response(omega)

    def least(values: np.ndarray) -> float:
        size = np.abs(values)
        rows, columns = np.nonzero((size[1:] > 1) != (size[:-1] > 1))
        return float(np.abs(np.angle(-values[rows, columns])).min())

    own = 1 / np.diagonal(np.linalg.inv(np.eye(2) + response), axis1=1, axis2=2) - 1
    loci = np.sort_complex(np.linalg.eigvals(response))
    # the grid's steps are 5e-4 of ω, over which a phase turns by as much
    assert state.margins.one_loop_phase_margin == pytest.approx(least(own), abs=3e-3)
    assert state.margins.common_phase_margin == pytest.approx(least(loci), abs=3e-3)


def test_a_joint_without_kp_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = write_arm(tmp_path)
    text = path.read_text("utf-8")
    assert free_joints(parse_robot(text, "arm", tmp_path)) == []
    path.write_text(text.replace("kp: 400.0", "kp: {shoulder: 400.0, elbow: 0.0}"), "utf-8")
    study = study_robot(parse_robot(path.read_text("utf-8"), "arm", tmp_path), recommend=False)
    assert any(warning.startswith("elbow: kp is 0: this joint is free and drifts") for warning in warnings(study))
    (tmp_path / "gains.yaml").write_text("shoulder: {kp: 400, kd: 30}\nelbow: {kp: 0, kd: 30}\n", "utf-8")
    call = ["audit", str(tmp_path / "robot.urdf"), "--gains", str(tmp_path / "gains.yaml"), "--delay-ms", "2", "--motor-inertia", "0.5"]
    main([*call, "--base", "fixed", "--json"])
    assert any("elbow: kp is 0" in warning for warning in json.loads(capsys.readouterr().out)["warnings"])


def test_names_do_not_drive_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Escape sequences in names of postures, contacts, tasks and joints are shown, not obeyed."""
    path = write_arm(tmp_path)
    bad = "\u001b[31mred\u0007"
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(urdf.read_text("utf-8").replace('"elbow"', '"elbow\u009b31m"'), "utf-8")
    text = (
        path.read_text("utf-8")
        .replace("bent:", '"bent\\e[31m\\a":')
        .replace("elbow: 0.9", '"elbow\\x9b31m": 0.9')
        .replace("name: com", 'name: "com\\e[1m"')
    )
    path.write_text(text + 'contacts: {"free\\e[2J": []}\n', "utf-8")
    assert main(["robot", str(path)]) in (0, 1)
    out, err = capsys.readouterr()
    assert bad not in out
    for stream in (out, err):
        assert not [c for c in stream if (ord(c) < 32 and c != "\n") or 127 <= ord(c) < 160]
    assert "bent?[31m?" in out
