"""What a robot.yaml says beside gains goes along with them: the audit of recommended gains is `gainroom robot` of the same robot with them.

And what is typed wins over it, or is an error that names both.
"""

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gainroom.cli import main
from gainroom.files.gain_export import FORMS
from gainroom.files.robot_yaml import load_robot_system, robot_sections
from gainroom.report.next_commands import FOUND, audit_of_found
from test_gains_go_along import told

LEG = """\
<mujoco>
  <worldbody>
    <body name="thigh" pos="0 0 1">BASE<joint name="hip" axis="0 1 0" armature="0.1"/>
      <inertial pos="0 0 -0.1" mass="4" diaginertia="0.02 0.02 0.02"/>
      <body name="shank" pos="0 0 -0.3"><joint name="knee" axis="0 1 0" armature="0.05"/>
        <inertial pos="0 0 -0.2" mass="3" diaginertia="0.01 0.01 0.01"/>
        <body name="toes" pos="0 0 -0.3"><joint name="toe" axis="0 1 0" armature="0.01"/>
          <inertial pos="0.03 0 0" mass="0.5" diaginertia="0.001 0.001 0.001"/></body></body></body>
  </worldbody>
</mujoco>
"""
FIXED, FREE = (
    LEG.replace("BASE", ""),
    LEG.replace(
        '<body name="thigh" pos="0 0 1">BASE',
        '<body name="hips" pos="0 0 1"><freejoint/><inertial pos="0 0 0" mass="6" diaginertia="0.1 0.1 0.1"/><body name="thigh">',
    ).replace("</body></body></body>\n", "</body></body></body></body>\n"),
)
ROBOT: dict[str, Any] = {
    "model": {"file": "leg.xml"},
    "joints": {"default": {"stiffness": 5000, "damping": 2}},
    "drive": {"bandwidth": 2000, "delay_ms": 2},
    "control": {"type": "pd", "feedback": "motor", "sample_rate_hz": 500, "kp": 60, "kd": 3},
}
BENT = {"bent": {"hip": 0.3, "knee": 1.1}}
KINDS: dict[str, dict[str, Any]] = {
    "a posture": {"postures": BENT},
    "several postures": {"postures": {**BENT, "straight": {}, "folded": {"knee": 2.4, "toe": -0.5}}},
    "slow current loops": {"drive": {"bandwidth": 200, "damping_ratio": 0.6}},
    "current loops and delays joint by joint": {"joints": {"knee": {"bandwidth": 300, "delay_ms": 3}, "toe": {"delay_ms": 0.5}}},
    "friction of motors": {"joints": {"hip": {"motor_viscous": 2.0}}},
    "encoders on the links": {"control": {"feedback": "link"}, "joints": {"default": {"stiffness": 20000, "damping": 40}}},
    "filters": {
        "control": {
            "velocity_filter": {"bandwidth_hz": 40, "order": 2},
            "notches": [{"frequency_hz": 90}],
            "biquads": [{"zero_frequency_hz": 20, "zero_damping": 0.7, "pole_frequency_hz": 30, "pole_damping": 0.8}],
        }
    },
    "a payload": {"model": {"payload": {"frame": "toes", "mass": 2.0}}},
    "a joint without a motor": {"joints": {"passive": ["toe"]}},
    "a joint that is locked": {"joints": {"locked": ["toe"]}, "postures": BENT},
    "rate in the delay": {"control": {"sample_rate_hz": None}, "drive": {"delay_ms": 4, "delay_includes_sampling": True}},
    "set-points late": {"drive": {"command_delay_ms": 5}},
    "on the ground": {"contacts": {"flight": [], "stance": ["toes"]}, "postures": BENT},
    "on soft ground": {"contacts": {"stance": [{"frame": "toes", "type": "line", "stiffness": [9e3, 9e3, 9e3, 90, float("inf")],
                                                "damping": [20, 20, 20, 2, 0]}]}},
    "without weight": {"contacts": {"stance": ["toes"]}, "model": {"gravity_stiffness": False}, "postures": BENT},
}  # fmt: skip
QUICK = ("several postures", "current loops and delays joint by joint", "filters", "a joint without a motor")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "leg.xml").write_text(FIXED, "utf-8")
    return tmp_path


def written(folder: Path, kind: str) -> dict[str, Any]:
    """The robot.yaml of a kind of robot."""
    robot = json.loads(json.dumps(ROBOT))
    for name, section in KINDS[kind].items():
        robot[name] = {**robot.get(name, {}), **section}
    robot["control"] = {key: value for key, value in robot["control"].items() if value is not None}
    (folder / "leg.xml").write_text(FREE if "contacts" in robot else FIXED, "utf-8")
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot), "utf-8")
    return robot


def recommended(capsys: pytest.CaptureFixture[str], folder: Path, robot: dict[str, Any]) -> tuple[dict[str, Any], str]:
    """What `robot` says of the gains that it recommends, and its answer's name; the file is left with these gains."""
    answer = told(capsys, "robot", "robot.yaml")
    (folder / "answer.json").write_text(json.dumps(answer), "utf-8")
    space = answer["recommended"][0]
    best = next(one for one in space["sets"] if one["contact"] == "everywhere")
    gains = {key: dict(zip(space["names"], best[key], strict=True)) for key in ("kp", "kd")}
    (folder / "robot.yaml").write_text(yaml.safe_dump({**robot, "control": {**robot["control"], **gains}}), "utf-8")
    again = told(capsys, "robot", "robot.yaml")
    for key in ("gain_margin_db", "phase_margin_deg", "peak_sensitivity"):
        # The same gains, followed on two ways: Ms lies on a flat top, where the frequency's round-off costs half of the digits.
        assert again["worst"][key.rpartition("_")[0] if key != "peak_sensitivity" else key][key] == pytest.approx(best[key], rel=1e-7)
    return again, "answer.json"


def same(audit: dict[str, Any], robot: dict[str, Any], named: bool = True) -> None:
    """State by state the same limits, bit for bit: both follow the same loop."""
    keys = (
        "gain_limit",
        "limit_frequency_rad_s",
        *(["contact"] if named else []),
    )  # one posture has the name of the file that it went through
    assert [[state[key] for key in keys] for state in audit["states"]] == [[state[key] for key in keys] for state in robot["states"]]
    for one, value in (("phase_margin", "phase_margin_deg"), ("peak_sensitivity", "peak_sensitivity")):
        assert audit[value] == robot["worst"][one][value]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [pytest.param(kind, marks=() if kind in QUICK else pytest.mark.slow) for kind in KINDS])
def test_an_audit_of_recommended_gains_is_of_the_same_robot(folder: Path, capsys: pytest.CaptureFixture[str], kind: str):
    robot = written(folder, kind)
    again, answer = recommended(capsys, folder, robot)
    printed = audit_of_found(robot_sections(Path("robot.yaml")), Path(), load_robot_system(Path("robot.yaml")))
    call = shlex.split(printed.removesuffix(f"--gains {FOUND}"))[1:]
    delay = robot["drive"]["delay_ms"] if "delays" not in kind else 3
    assert call == ["audit", "leg.xml", "--delay-ms", str(robot["drive"].get("command_delay_ms", delay))]
    judged = told(capsys, *call, "--gains", answer, "--margin-db", "6")
    same(judged, again)
    (folder / "second.json").write_text(json.dumps(judged), "utf-8")
    same(told(capsys, *call, "--gains", "second.json"), again)
    told(capsys, "export", answer, "--to", "yaml", "--output", "gains.yaml", "--write")
    same(told(capsys, *call, "--gains", "gains.yaml"), again)


@pytest.mark.slow
def test_bounds_and_equal_gains_go_into_the_robot_that_an_audit_writes(folder: Path, capsys: pytest.CaptureFixture[str]):
    """By way of the answer and of the gains exported from it; none equal is something else than nothing said."""
    robot = written(folder, "a posture") | {
        "gain_bounds": {"default": {"kd_max": 30}, "k.*": {"kp_max": 40, "kp_min": 2}},
        "groups": [["hip", "toe"]],
    }
    for groups in (robot["groups"], []):
        (folder / "robot.yaml").write_text(yaml.safe_dump({**robot, "groups": groups}), "utf-8")
        before = load_robot_system(Path("robot.yaml"))
        (folder / "answer.json").write_text(json.dumps(told(capsys, "robot", "robot.yaml")), "utf-8")
        told(capsys, "export", "answer.json", "--to", "yaml", "--output", "gains.yaml", "--write")
        for gains in ("answer.json", "gains.yaml"):
            told(capsys, "audit", "leg.xml", "--delay-ms", "2", "--gains", gains, "--write-robot", "again.yaml")
            after = load_robot_system(Path("again.yaml"))
            assert after.groups == before.groups == ((0, 2),)[: len(groups)]
            for end in ("min", "max"):
                for gain in ("kp", "kd"):
                    expected = getattr(before.bounds, f"{gain}_{end}")
                    np.testing.assert_array_equal(getattr(after.bounds, f"{gain}_{end}"), expected)
        said = told(capsys, "export", "answer.json", "--to", "ros2_control", "--output", "out.yaml", "--write")
        assert "bounds of recommended gains" in " ".join(said["notes"])


LOST = {
    "slow current loops": ({"--rate-hz", "--stiffness", "--damping"}, "the current loops have no place"),
    "several postures": ({"--rate-hz", "--stiffness", "--damping", "--bandwidth"}, "several postures have no place"),
    "encoders on the links": ({"--rate-hz", "--stiffness", "--damping", "--bandwidth"}, "the encoders' side have no place"),
    "on the ground": ({"--rate-hz", "--stiffness", "--damping", "--bandwidth", "--contact", "--posture"}, ""),
    "on soft ground": ({"--rate-hz", "--stiffness", "--damping", "--bandwidth"}, "the contact states have no place"),
}


@pytest.mark.slow
@pytest.mark.parametrize("form", [form for form in FORMS if form not in ("yaml", "mjcf")])
@pytest.mark.parametrize("kind", LOST)
def test_a_form_names_what_it_loses(folder: Path, capsys: pytest.CaptureFixture[str], kind: str, form: str):
    """And the flags that give back the rest; where there is nothing else, the audit is the same."""
    again, answer = recommended(capsys, folder, written(folder, kind))
    target = f"out{FORMS[form].ending}"
    said = told(capsys, "export", answer, "--to", form, "--output", target, "--write")
    flags, note = LOST[kind]
    posture = {name: {"--posture"} for name in ("mjlab", "isaaclab", "legged_gym")}
    held = (posture | {"ros2_control": {"--rate-hz"}, "markdown": {"--stiffness", "--damping"}}).get(form, set())
    assert {each for each in said["audit_with"] if each.startswith("--")} - {"--motor-inertia"} == flags - held
    assert note in " ".join(said["notes"]).replace("has no place", "have no place")
    if not note:
        same(
            told(capsys, "audit", "leg.xml", "--delay-ms", "2", "--gains", target, *said["audit_with"]), again, named=False
        )  # --contact names none


def answer_of(folder: Path, capsys: pytest.CaptureFixture[str], kind: str) -> list[str]:
    """A file of gains with stiffness and inertia, as an answer, an export, or by hand."""
    (folder / "gains.yaml").write_text(
        "hip: {kp: 60, kd: 3, stiffness: 5000, damping: 2, motor_inertia: 0.1}\n"
        "knee: {kp: 60, kd: 3, stiffness: 5000, damping: 2, motor_inertia: 0.05}\n", "utf-8"
    )  # fmt: skip
    call = ["audit", "leg.xml", "--delay-ms", "2", "--rate-hz", "500", "--gains"]
    if kind == "by hand":
        return [*call, "gains.yaml"]
    (folder / "answer.json").write_text(json.dumps(told(capsys, *call, "gains.yaml")), "utf-8")
    if kind == "answer":
        return [*call, "answer.json"]
    told(capsys, "export", "answer.json", "--to", "yaml", "--output", "out.yaml", "--write")
    return [*call, "out.yaml"]


@pytest.mark.parametrize("kind", ["answer", "export", "by hand"])
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--gearbox", "harmonic"], "--gearbox harmonic: FILE has the stiffness of hip, knee"),
        (["--gearbox", "hip=direct", "--gearbox", "belt"], "--gearbox belt: FILE has the stiffness of hip, knee"),
        (["--gearbox", "direct"], "--gearbox direct: FILE has the stiffness of hip, knee"),
        (["--stiffness", "300", "--damping", "2"], "--stiffness 300: FILE has hip 5000, knee 5000"),
        (["--stiffness", "hip=300", "--stiffness", "400"], "--stiffness 400: FILE has knee 5000"),
        (["--stiffness", "5000", "--damping", "7"], "--damping 7: FILE has hip 2, knee 2"),
        (["--motor-inertia", "0.3"], "--motor-inertia 0.3: FILE has hip 0.1, knee 0.05"),
    ],
)
def test_what_is_typed_of_all_joints_contradicts_a_file(
    folder: Path, capsys: pytest.CaptureFixture[str], kind: str, options: list[str], says: str
):
    call = answer_of(folder, capsys, kind)
    assert main([*call, *options]) == 2
    said = capsys.readouterr().err
    assert says.replace("FILE", call[-1]) in said
    assert "which wins" in said


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["answer", "export", "by hand"])
@pytest.mark.parametrize(
    "options",
    [
        ("--stiffness", "5000", "--damping", "2"),
        ("--stiffness", ".*=300", "--damping", ".*=1"),
        ("--gearbox", ".*=harmonic"),
        ("--gearbox", "hip=harmonic", "--gearbox", "knee=belt"),
        ("--motor-inertia", "hip=0.3"),
    ],
)
def test_what_is_typed_by_name_wins_over_a_file(folder: Path, capsys: pytest.CaptureFixture[str], kind: str, options: tuple[str, ...]):
    """As if the file had not said it: the same options with a file that says nothing of the gearboxes."""
    call = answer_of(folder, capsys, kind)
    found = told(capsys, *call, *options)
    bare = "hip: {kp: 60, kd: 3, motor_inertia: 0.1}\nknee: {kp: 60, kd: 3, motor_inertia: 0.05}\n"
    gearboxes = () if "--stiffness" in options or "--gearbox" in options else ("--stiffness", "5000", "--damping", "2")
    (folder / "bare.yaml").write_text(bare, "utf-8")
    wanted = told(capsys, *call[:-1], "bare.yaml", *options, *gearboxes)
    for key in ("safe", "gain_limit", "delay_limit_ms", "joints", "gearbox_range"):
        assert found[key] == wanted[key], key


@pytest.mark.parametrize(
    ("system", "says"),
    [
        ({"control": {"feedback": "far"}}, "system.control.feedback: 'far'"),
        ({"control": {"kp": 3}}, "system.control.kp: must be one of feedback, velocity_filter, notches, biquads"),
        ({"postures": {"bent": {"hip": "far"}}}, "system.postures.bent"),
        ({"limits": {}}, "system.limits: must be one of model, joints"),
        ([1], "system: "),
    ],
)
def test_a_changed_system_is_refused(folder: Path, capsys: pytest.CaptureFixture[str], system: Any, says: str):
    answer = {"states": [], "delay_limit_ms": 3.0, "joints": [{"name": "hip", "kp": 1.0, "kd": 1.0}], "system": system}
    (folder / "answer.json").write_text(json.dumps(answer), "utf-8")
    (folder / "plain.yaml").write_text(yaml.safe_dump({"gains": {"hip": [1, 1]}, "system": system}), "utf-8")
    for name in ("answer.json", "plain.yaml"):
        assert main(["audit", "leg.xml", "--delay-ms", "2", "--gains", name]) == 2
        assert says in capsys.readouterr().err
