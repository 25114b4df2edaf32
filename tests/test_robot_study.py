"""What `gainroom robot` and `gainroom audit` tell: limits mean what they say, and a robot of one joint is that joint."""

import json
import math
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import yaml
from pytest import approx

import gainroom as gr
from gainroom.cli import main
from gainroom.design.robot_gains import recommend_robot
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.files.robot_yaml import load_robot_system, parse_robot
from gainroom.files.typed_requirements import margin_factor
from gainroom.report.audit_text import audit_sentence
from gainroom.report.robot_text import notes, sentence, warnings
from gainroom.studies.audit import audit, required_of
from gainroom.studies.robot import RobotStudy, study_robot
from gainroom.studies.state import State
from gainroom.system.requirements import Requirements
from gainroom.system.system import System
from refusals import assert_refused
from robot_truths import hinge, link, write_robot

# Roots found independently of the limits (Chebyshev points and Newton) must lie on either side of the boundary this near to a limit.
NEAR = 1e-3
EXAMPLES = Path(gr.__path__[0]) / "files" / "examples"
ROBOT = """\
model: {file: robot.urdf, base: fixed}
joints: {default: {motor_inertia: 0.5, stiffness: 5e3, damping: 2}}
drive: {bandwidth: 3000, delay_ms: 2}
postures: {bent: {hip: 0.3, knee: -0.8}}
control: {type: pd, feedback: motor, kp: {hip: 900, knee: 400}, kd: {hip: 40, knee: 20}}
tasks:
  - {name: tip, type: position, frame: tip, kp: [200, 200, 200], kd: [20, 20, 20]}
"""
GAINS = "hip: {kp: 900, kd: 40, motor_inertia: 0.5}\nknee: {kp: 400, kd: 20}\n"
STATE_KEYS = {"posture", "contact", "stable", "gain_limit", "limit_frequency_rad_s", "limiting_joints", "disk_margin", "joints", "tasks"}
JOINT_KEYS = {"name", "link_inertia", "single_joint_limit", "limit_others_closed", "kp", "kd", "kp_max", "kd_max"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two links in a plane."""
    path = tmp_path_factory.mktemp("arm")
    links = (
        link("base")
        + link("upper", 4.0, (0, 0, 0.25), (0.1, 0.1, 0.01))
        + link("lower", 3.0, (0, 0, 0.2), (0.05, 0.05, 0.01))
        + link("tip")
    )
    joints = (
        hinge("hip", "base", "upper")
        + hinge("knee", "upper", "lower", (0, 0, 0.5))
        + hinge("end", "lower", "tip", (0, 0, 0.4), kind="fixed")
    )
    write_robot(path, links, joints)
    (path / "robot.yaml").write_text(ROBOT, "utf-8")
    (path / "gains.yaml").write_text(GAINS, "utf-8")
    return path


@pytest.fixture(scope="module")
def spec(folder: Path) -> System:
    return parse_robot(ROBOT, "f", folder)


@pytest.fixture(scope="module")
def study(spec: System) -> RobotStudy:
    return study_robot(spec, recommend=False)


def crosses(inside: gr.Loop, outside: gr.Loop) -> bool:
    return gr.rightmost_roots(inside).roots[0].real < 0 < gr.rightmost_roots(outside).roots[0].real


def test_one_joint_is_the_joint_of_issue_one(tmp_path: Path):
    """An arm of one hinge with inertia I + m l² about its axis."""
    write_robot(tmp_path, link("base") + link("arm", 3.0, (0, 0, 0.4), (0.2, 0.32, 0.1)), hinge("elbow", "base", "arm"))
    lines = (line for line in ROBOT.partition("tasks:")[0].splitlines() if not line.startswith(("postures", "control")))
    text = "\n".join([*lines, "control: {type: pd, feedback: motor, kp: 900, kd: 40}"])
    (state,) = study_robot(parse_robot(text, "f", tmp_path), recommend=False).states
    joint = gr.ElasticJoint(motor_inertia=0.5, link_inertia=0.32 + 3.0 * 0.4**2, stiffness=5e3, damping=2.0)
    loop = gr.build_loop(joint, gr.Drive(3000.0, 0.9, 2e-3), gr.PD(900.0, 40.0))
    margins = gr.margins(loop)
    (row,) = state.joints
    assert state.limit.gain == approx(margins.gain_margin, rel=1e-9)
    assert state.limit.frequency == approx(margins.phase_crossover, rel=1e-9)
    assert state.margins.delay_margin == approx(margins.delay_margin, rel=1e-9)
    assert row.single_joint_limit == approx(margins.gain_margin, rel=1e-9)
    assert row.limit_others_closed == approx(margins.gain_margin, rel=1e-6)
    assert row.link_inertia == approx(joint.link_inertia, rel=1e-12)
    assert state.margins.disk_margin == approx(margins.disk_margin, rel=1e-6)
    assert row.kd_max == approx(gr.pd_region(joint, gr.Drive(3000.0, 0.9, 2e-3)).max_kd(900.0), rel=1e-6)


def test_every_limit_is_where_the_roots_cross(spec: System, study: RobotStudy):
    (state,) = study.states
    model, controller = state.model, spec.control.controller
    assert isinstance(controller, gr.PD)
    assert crosses(*(state.loop.scaled((1 + sign * NEAR) * state.limit.gain) for sign in (-1, 1)))

    def with_gains(**changes: np.ndarray) -> gr.Loop:
        return spec.loop(model, replace(controller, **changes))

    for k, row in enumerate(state.joints):
        one = np.eye(2)[k]
        factors = [1 + (row.limit_others_closed * (1 + sign * NEAR) - 1) * one for sign in (-1, 1)]
        assert crosses(*(with_gains(kp=controller.kp * factor, kd=controller.kd * factor) for factor in factors))
        for name, limit in (("kp", row.kp_max), ("kd", row.kd_max)):
            own = getattr(controller, name)
            assert crosses(*(with_gains(**{name: np.where(one, limit * (1 + sign * NEAR), own)}) for sign in (-1, 1)))
        assert (row.kp, row.kd) == (controller.kp[k], controller.kd[k])
        alone = gr.ElasticJoint(0.5, row.link_inertia, 5e3, 2.0)
        assert row.link_inertia == approx(1 / model.link_inverse_inertia[k, k])
        single = gr.build_loop(alone, spec.drives[k], gr.PD(row.kp, row.kd))
        assert row.single_joint_limit == approx(gr.margins(single).gain_margin, rel=1e-9)


def test_every_task_direction_too(spec: System, study: RobotStudy):
    (state,) = study.states
    found = state.tasks
    assert found is not None
    assert [(row.name, row.direction) for row in found.rows] == [("tip", "x"), ("tip", "y"), ("tip", "z")]
    loop = spec.loop(state.model, found.tasks.controller())
    assert crosses(*(loop.scaled((1 + sign * NEAR) * found.limit.gain) for sign in (-1, 1)))
    for row in found.rows:
        if row.direction == "y":  # the arm moves in the plane of x and z
            assert np.isnan(row.gain_limit)
            assert np.isnan(row.limit_others_closed)
            continue
        ends = (found.tasks.scaled(f"tip {row.direction}", row.limit_others_closed * (1 + sign * NEAR)) for sign in (-1, 1))
        assert crosses(*(spec.loop(state.model, tasks.controller()) for tasks in ends))
    assert any("tip" in text for text in notes(study))


@pytest.mark.parametrize("state", [("crouch", "left"), ("crouch", "right")])
def test_motions_that_no_task_holds_hide_no_direction_s_limit(state: tuple[str, str]):
    """On one leg six motions of the biped drift as 1/s², which the tasks' gains must not be compared with: roots tell where limits are."""
    system = load_robot_system(Path(gr.__path__[0]) / "files" / "examples" / "biped.yaml")
    study = State(system, *state, system.source.linearize(*state)).tasks
    assert study is not None
    for row in study.rows:
        ends = (study.tasks.scaled(f"{row.name} {row.direction}", row.limit_others_closed * (1 + sign * NEAR)) for sign in (-1, 1))
        model = system.source.linearize(*state)
        assert [gr.is_stable(system.loop(model, tasks.controller())) for tasks in ends] == [True, False]


def test_control_in_task_space_is_the_tasks_limit(folder: Path, study: RobotStudy):
    control = "control: {type: pd, feedback: motor, kp: {hip: 900, knee: 400}, kd: {hip: 40, knee: 20}}"
    (state,) = study_robot(
        parse_robot(ROBOT.replace(control, "control: {type: pd, space: task, feedback: motor}"), "f", folder), recommend=False
    ).states
    assert study.states[0].tasks is not None
    assert state.limit.gain == approx(study.states[0].tasks.limit.gain)
    assert state.tasks is not None
    gains = state.tasks.tasks.joint_gains()
    assert [row.kp for row in state.joints] == approx(np.diagonal(gains[0]))
    assert [row.kd for row in state.joints] == approx(np.diagonal(gains[1]))


def test_progress_counts_states(spec: System):
    said: list[tuple[int, int, str]] = []
    study_robot(spec, lambda done, total, what: said.append((done, total, what)), recommend=False)
    assert said == [(0, 1, "state bent/free"), (1, 1, "")]


def test_sentence_and_status(folder: Path, study: RobotStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert sentence(study).startswith("Not decided: the loop's rate is not given, ")
    assert "In continuous time every requirement is met; the tightest is phase margin " in sentence(study)
    assert f"In continuous time vibration starts at {study.states[0].limit.gain:.3g} × these gains, at " in sentence(study)
    text = ROBOT.replace("kd: {hip: 40, knee: 20}", "kd: {hip: 40, knee: 4000}").replace("robot.urdf", str(folder / "robot.urdf"))
    (tmp_path / "robot.yaml").write_text(text, "utf-8")
    assert main(["robot", str(tmp_path / "robot.yaml")]) == 1
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("Not safe: unstable. ")
    assert max(len(line) for line in out.splitlines() if not line.startswith("  gainroom ")) <= 80


def test_unstable_tasks_are_told_first(folder: Path, study: RobotStudy):
    """Tasks that are not what is closed do not change the verdict; the sentence and the first warning tell of them."""
    tasks = study.states[0].tasks
    assert tasks is not None
    assert not any("UNSTABLE" in told or "gains are unstable" in told for told in (sentence(study), *warnings(study)))
    factor = 2 * tasks.limit.gain  # half of which is the limit
    text = ROBOT.replace("[200, 200, 200]", str([200 * factor] * 3)).replace("[20, 20, 20]", str([20 * factor] * 3))
    lost = study_robot(parse_robot(text, "f", folder), recommend=False)
    assert lost.stable
    assert "In continuous time every requirement is met; " in sentence(lost)
    assert "tasks, closed in place of the joints' gains, are UNSTABLE; scale them below 0.5 ×." in sentence(lost)
    assert warnings(lost)[0] == "bent/free: the tasks' gains are unstable; scale them below 0.5 ×"


def test_motions_that_drift_are_told(folder: Path, study: RobotStudy):
    """Two joints, a tip that moves in a plane: both held; with the centre of mass along x alone, one is not."""
    assert not any("drift" in text for text in notes(study))
    text = ROBOT.replace("type: position, frame: tip, kp: [200, 200, 200]", "type: com, kp: [200, 0, 0]")
    (found,) = [text for text in notes(study_robot(parse_robot(text, "f", folder), recommend=False)) if "drift" in text]
    assert found.startswith("In bent/free the tasks leave 1 of 2 joint motions uncontrolled")
    assert "posture task" in found


def answered(*call: str) -> tuple[str, str]:
    """Standard output and error of a command that decides nothing, as the file has no rate."""
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        assert main(list(call)) == 3
    return out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def terminal(folder: Path) -> tuple[str, str]:
    return answered("robot", str(folder / "robot.yaml"), "--verbose")


@pytest.fixture(scope="module")
def answer(folder: Path) -> tuple[dict, str]:
    """JSON and page of one call."""
    report = folder / "out.html"
    out, _ = answered("robot", str(folder / "robot.yaml"), "--json", "--report", str(report))
    return json.loads(out), report.read_text("utf-8")


def test_robot_json(study: RobotStudy, answer: tuple[dict, str]):
    facts, _ = answer
    assert set(facts) >= {"states", "recommended", "warnings"}
    (state,) = facts["states"]
    assert set(state) >= STATE_KEYS
    assert all(set(row) >= JOINT_KEYS for row in state["joints"])
    assert all(set(row) >= {"name", "direction", "kp", "kd", "gain_limit"} for row in state["tasks"])
    assert state["gain_limit"] == approx(study.states[0].limit.gain)
    assert state["limiting_joints"] == list(study.states[0].limiting_joints)


def test_robot_terminal(terminal: tuple[str, str]):
    out, err = terminal
    assert err == ""
    assert "\x1b" not in out
    assert max(len(line) for line in out.splitlines() if not line.startswith("  gainroom ")) <= 80
    for word in ("hip", "knee", "tip x", "bent/free", "Hz", "kp max", "kd max", "part", "Required: gain margin ≥ 6 dB"):
        assert word in out


def test_terminal_has_no_column_without_a_number(folder: Path, tmp_path: Path, terminal: tuple[str, str]):
    (tmp_path / "robot.urdf").write_bytes((folder / "robot.urdf").read_bytes())
    (tmp_path / "robot.yaml").write_text(ROBOT.replace("kd: [20, 20, 20]", "kv: 20, ki: 5"), "utf-8")
    for (out, _), column in ((terminal, False), (answered("robot", str(tmp_path / "robot.yaml"), "--verbose"), True)):
        lines = out.splitlines()
        (head,) = [lines[k + 2].split() for k, line in enumerate(lines) if line.startswith("Tasks, bent/free")]
        assert ("ki" in head) == column


def test_report_is_one_page(answer: tuple[dict, str]):
    assert answer[1].lstrip().lower().startswith("<!doctype html")


def test_audit_agrees_with_the_robot_file(folder: Path, study: RobotStudy):
    """The same arm, standing at 0, from a gains' file and options."""
    options = AuditOptions(2.0, stiffness=5e3, damping=2.0, motor_inertia=0.5, bandwidth=3000.0)
    result = audit(audited(str(folder / "robot.urdf"), folder / "gains.yaml", options).system)
    text = ROBOT.replace("bent: {hip: 0.3, knee: -0.8}", "zero: {hip: 0}")
    (state,) = study_robot(parse_robot(text, "f", folder), recommend=False).states
    assert result.tightest.limit.gain == approx(state.limit.gain, rel=1e-9)
    assert [joint.gain_limit for joint in result.joints] == approx(state.limits_others_open)
    assert [joint.limit_others_closed for joint in result.joints] == approx([row.limit_others_closed for row in state.joints])
    assert result.delay_limit == approx(2e-3 + state.margins.delay_margin)
    assert result.safe == (state.limit.gain >= 2 and all(joint.gain_limit >= 2 for joint in result.joints))


def test_values_of_some_joints_are_those_of_a_robot_file(folder: Path, capsys: pytest.CaptureFixture[str]):
    """JOINT=NUMBER stands for a joint's own entry, over what is said of all; of several the later counts."""
    call = ["audit", str(folder / "robot.urdf"), "--gains", str(folder / "gains.yaml"), "--rate-hz", "2000", "--delay-ms", "2"]
    typed = ["--motor-inertia", "knee=0.3", "--motor-inertia", "0.5", "--stiffness", ".*=9e3", "--stiffness", "knee=5e3", "--damping", "2"]
    main([*call, *typed, "--write-robot", str(folder / "of_joints.yaml"), "--json"])
    joints = {joint["name"]: joint for joint in json.loads(capsys.readouterr().out)["joints"]}
    assert [joints[name]["stiffness"] for name in ("hip", "knee")] == [9e3, 5e3]
    assert [joints[name]["damping"] for name in ("hip", "knee")] == [2, 2]
    written = gr.load_robot(folder / "of_joints.yaml").quantities["motor_inertia"]
    assert written.tolist() == [0.5, 0.3]


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("--motor-inertia", "elbow=1"), ["--motor-inertia elbow=1", "'elbow' matches no joint"]),
        (("--motor-inertia", "knee=-1"), ["--motor-inertia of knee: -1.0 must be > 0"]),
        (("--stiffness", "knee=stiff"), ["--stiffness", "'stiff' must be a number in N m/rad"]),
        (("--damping", "knee=2"), ["--damping 2", "give --stiffness too"]),
    ],
)
def test_wrong_values_of_some_joints(folder: Path, capsys: pytest.CaptureFixture[str], typed: tuple[str, ...], words: list[str]):
    call = ["audit", str(folder / "robot.urdf"), "--gains", str(folder / "gains.yaml"), "--delay-ms", "2", "--motor-inertia", "0.5"]
    assert main([*call, *typed]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert all(word in err for word in words), err


def test_audit_vibrates_from_its_delay_limit(folder: Path):
    def spec_at(delay: float) -> System:
        return audited(str(folder / "robot.urdf"), folder / "gains.yaml", AuditOptions(1e3 * delay, motor_inertia=0.5)).system

    for delay in (2e-3, 30e-3):  # stable, and unstable: then the limit is below
        limit = audit(spec_at(delay)).delay_limit
        assert limit > delay or delay == 30e-3
        loops = []
        for sign in (-1, 1):
            spec = spec_at(limit * (1 + sign * NEAR))
            loops.append(spec.loop(spec.source.linearize()))
        assert crosses(*loops)


def test_audit_margin_decides(folder: Path):
    spec = audited(str(folder / "robot.urdf"), folder / "gains.yaml", AuditOptions(2.0, motor_inertia=0.5)).system
    limit = audit(spec).tightest.limit.gain
    assert audit(spec, required_of(0.99 * limit)).safe
    tighter = audit(spec, required_of(1.01 * limit))
    assert not tighter.safe
    assert {joint.name for joint in tighter.joints if not joint.safe} >= set(tighter.limiting_joints) != set()
    assert audit_sentence(tighter).startswith("Not safe: stable in continuous time, but 1 requirement fails: gain margin ")


@pytest.mark.parametrize(("scale", "words"), [((1, 10), "1 of 2 joints is not safe"), ((10, 10), "2 of 2 joints are not safe")])
def test_unsafe_joints_are_counted_in_english(folder: Path, tmp_path: Path, scale: tuple[float, float], words: str):
    gains = tmp_path / "gains.yaml"
    hip, knee = ({"kp": 20.0 * factor, "kd": 20.0 * factor} for factor in scale)
    gains.write_text(yaml.safe_dump({"hip": hip, "knee": knee}), "utf-8")
    options = AuditOptions(2.0, stiffness=5e3, damping=2.0, motor_inertia=0.5, bandwidth=3000.0)
    assert words in audit_sentence(audit(audited(str(folder / "robot.urdf"), gains, options).system))


def test_joints_without_gains_are_held_still(folder: Path, tmp_path: Path):
    (tmp_path / "hip.yaml").write_text("hip: {kp: 900, kd: 40}", "utf-8")
    result = audit(audited(str(folder / "robot.urdf"), tmp_path / "hip.yaml", AuditOptions(2.0, motor_inertia=0.5)).system)
    assert [joint.name for joint in result.joints] == ["hip"]
    assert any("held, as they have no gains: knee" in warning for warning in result.system.warnings)


def test_audit_json_and_status(folder: Path, capsys: pytest.CaptureFixture[str]):
    call = [
        "audit",
        str(folder / "robot.urdf"),
        "--gains",
        str(folder / "gains.yaml"),
        "--motor-inertia",
        "0.5",
        "--rate-hz",
        "2000",
        "--gearbox",
        "direct",
    ]
    assert main([*call, "--delay-ms", "2", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert set(facts) >= {"safe", "gain_limit", "delay_limit_ms", "limiting_joints", "joints", "warnings"}
    assert all(set(joint) >= {"name", "kp", "kd", "safe", "gain_limit"} for joint in facts["joints"])
    assert facts["model"] == "sampled"
    assert main([*call, "--delay-ms", "30"]) == 1
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("Not safe: ")
    assert max(len(line) for line in out.splitlines() if not line.startswith("  gainroom ")) <= 80


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"delay_ms": -1.0}, ["--delay-ms: -1.0 must be >= 0"]),
        ({"delay_ms": float("nan")}, ["--delay-ms: nan is not a number"]),
        ({"rate_hz": 0.0}, ["--rate-hz: 0.0 must be >= 1"]),
        ({"rate_hz": 1e6, "delay_ms": 5.0}, ["--delay-ms", "5 ms must be <= 1 ms, 1000 ticks"]),
        ({"stiffness": 0.0}, ["--stiffness: 0.0 must be > 0"]),
        ({"motor_inertia": -1.0}, ["--motor-inertia: -1.0 must be > 0"]),
        ({"bandwidth": 0.0}, ["--bandwidth: 0.0 must be > 0"]),
        ({"damping": 1.0}, ["--damping 1", "give --stiffness too"]),
        ({"base": "floor"}, ["--base floor", "fixed or floating"]),
        ({"base": "fixed", "contacts": ("toe",)}, ["--contact: the robot has no frame 'toe'", "frames: base"]),
        ({"base": "fixed", "contacts": ("tip", "tip")}, ["--contact: frame 'tip' is used 2 times"]),
    ],
)
def test_bad_options(folder: Path, options: dict, words: list[str]):
    def make() -> System:
        return audited(str(folder / "robot.urdf"), folder / "gains.yaml", AuditOptions(**{"delay_ms": 2.0, **options})).system

    assert_refused(make, words)


def test_bad_margin():
    assert margin_factor(20.0) == approx(10.0)
    for value in (-1.0, 0.0):  # as limits.gain_margin_db: 0 dB is no requirement
        assert_refused(lambda value=value: margin_factor(value), [f"--margin-db: {value} must be > 0 dB"])


def test_bad_calls_are_one_line(folder: Path, capsys: pytest.CaptureFixture[str]):
    for call in (
        ["audit", str(folder / "robot.urdf")],
        ["audit", str(folder / "robot.urdf"), "--delay-ms", "2"],
        ["audit", str(folder / "gains.yaml"), "--delay-ms", "2", "--gains", str(folder / "gains.yaml")],
        ["audit", str(folder / "nowhere.xml"), "--delay-ms", "2"],
        ["audit", str(folder), "--delay-ms", "2"],
        ["robot", str(folder / "gains.yaml")],
        ["robot", str(folder / "robot.urdf")],
    ):
        assert main(call) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("gainroom: error: ")
        assert all(line.startswith("gainroom: error: ") for line in err.splitlines())


def test_a_poor_kd_in_the_file_costs_little(folder: Path):
    """Recommended task gains depend on the kp of the file; a kd ten times too low, or too high, leaves them nearly as stiff."""
    stiffness = []
    for kd in ("[20, 20, 20]", "[2, 2, 2]", "[200, 200, 200]"):
        gains = recommend_robot(parse_robot(ROBOT.replace("kd: [20, 20, 20]", f"kd: {kd}"), "f", folder), "task")
        assert gains.everywhere is not None
        stiffness.append(gains.everywhere.kp[0])
    # Dampings are tried in steps of 1.5, and stiffness changes by less than that between two of them.
    assert min(stiffness) > max(stiffness) / 1.5


@pytest.mark.slow
def test_tasks_that_are_not_closed_are_warned_of_where_they_lack_gain_margin(tmp_path: Path):
    """The limit of the same tasks, closed, decides; nothing is said where they have enough, and nothing of tasks that are closed."""
    text = yaml.safe_load((EXAMPLES / "biped.yaml").read_text("utf-8"))
    del text["control"]["sample_rate_hz"]  # at 2 kHz these tasks have less than a decibel
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(text), "utf-8")
    file = load_robot_system(tmp_path / "robot.yaml")
    asked = replace(file, requirements=Requirements(gain_margin=2.0))
    study = study_robot(asked, recommend=False)
    text["control"] = {"type": "pd", "space": "task", "feedback": "motor"}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(text), "utf-8")
    closed = study_robot(replace(load_robot_system(tmp_path / "robot.yaml"), requirements=asked.requirements), recommend=False)
    limit, state = closed.tightest.limit.gain, study.weakest_tasks
    assert 1 < limit < 2
    assert state is not None
    assert state.title == closed.tightest.title
    said = sentence(study).partition("If you run the file's task-space gains instead (control.space: task): ")[2]
    assert f"{20 * math.log10(limit):.3g} dB (≥ 6.02 dB) in {state.title}" in said
    free = replace(asked, requirements=Requirements(gain_margin=0.9 * limit))
    assert not any("task-space gains instead" in sentence(one) for one in (replace(study, system=free), closed))
