"""The commands that an answer prints to go on from: typed one after the other they judge the gains that were found as the search did."""

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from gainroom.cli import main
from gainroom.studies.verdict import STATUS
from test_gains_go_along import LEG
from test_robot_goes_along import ROBOT

GAINS = {"hip": {"kp": 1234.0, "kd": 1.1, "motor_inertia": 0.2}, "knee": {"kp": 600.0, "kd": 0.5}}
ELASTIC = ["--stiffness", "9000", "--damping", "3"]
STIFF = {"default": {"motor_inertia": 0.2, "stiffness": "rigid"}}
CALLS = {
    "host": ["--rate-hz", "1000", *ELASTIC],
    "damping in kd": ["--rate-hz", "1000", *ELASTIC, "--joint-damping", "controller"],
    "damping as friction": ["--rate-hz", "1000", *ELASTIC, "--joint-damping", "friction"],
    "drive": ["--gains-run", "drive", "--drive-rate-hz", "8000", "--drive-delay-ms", "0.3", *ELASTIC],
    "other limits": ["--rate-hz", "1000", *ELASTIC, "--margin-db", "8", "--require", "phase_margin_deg=40", "--posture", "knee=1.1"],
    "a range": ["--rate-hz", "1000", "--gearbox", "harmonic"],
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    (tmp_path / "leg.xml").write_text(LEG, "utf-8")
    (tmp_path / "gains.yaml").write_text(yaml.safe_dump({"gains": GAINS}), "utf-8")
    return tmp_path


def printed(text: str) -> list[str]:
    """The commands of a terminal's answer."""
    return [line.strip() for line in text.splitlines() if line.startswith("  gainroom ")]


def typed(capsys: pytest.CaptureFixture[str], command: str) -> str:
    """A command's output, written into a file where the command says so, as a shell does."""
    call, _, target = command.partition(" > ")
    assert main(shlex.split(call)[1:]) != 2, capsys.readouterr().err
    out = capsys.readouterr().out
    if target:
        Path(target).write_text(out, "utf-8")
    return out


def found() -> dict[str, Any]:
    """The set of gains in the file, with its margins."""
    (space,) = json.loads(Path("found.json").read_text("utf-8"))["recommended"]
    return next(one for one in space["sets"] if one["contact"] == "everywhere")


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=() if kind in ("host", "drive") else pytest.mark.slow) for kind in CALLS])
def test_what_an_audit_prints_finds_gains_and_audits_them(capsys: pytest.CaptureFixture[str], kind: str):
    first = typed(capsys, shlex.join(["gainroom", "audit", "leg.xml", "--delay-ms", "3", "--gains", "gains.yaml", *CALLS[kind]]))
    *search, again = printed(first)
    assert len(search) == 2
    for command in search:
        typed(capsys, command)
    told, gains = json.loads(typed(capsys, f"{again} --json")), found()
    assert [joint["kp"] for joint in told["joints"]] == gains["kp"]
    if kind != "a range":  # of which the gains are found at one point
        assert told["verdict"] == "safe"
        assert told["phase_margin_deg"] == pytest.approx(gains["phase_margin_deg"], rel=1e-7)
        assert told["peak_sensitivity"] == pytest.approx(gains["peak_sensitivity"], rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits",
    [{}, {"limits": {"gain_margin_db": 8.0, "phase_margin_deg": 40.0, "peak_sensitivity": 1.9}}, {"limits": {"gain_margin_db": 5.0}}],
)
def test_what_a_search_prints_audits_its_gains(folder: Path, capsys: pytest.CaptureFixture[str], limits: dict[str, Any]):
    """From another folder than the model's, with the limits of the file."""
    (folder / "here").mkdir()
    (folder / "here" / "leg.xml").write_text(LEG, "utf-8")
    (folder / "here" / "robot.yaml").write_text(yaml.safe_dump({**ROBOT, **limits}), "utf-8")
    search, again = printed(typed(capsys, "gainroom robot here/robot.yaml"))
    typed(capsys, search)
    told, gains = json.loads(typed(capsys, f"{again} --json")), found()
    assert told["verdict"] == "safe"
    assert told["unmet"] == []
    if limits:
        assert {key: value for key, value in told["required"].items() if value is not None} == limits["limits"]
    assert told["phase_margin_deg"] == pytest.approx(gains["phase_margin_deg"], rel=1e-7)


def answered(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    status = main([*words, "--json"])
    facts = json.loads(capsys.readouterr().out)
    assert status == STATUS[facts["verdict"]]
    return facts


GOES_ALONG = {
    "a requirement": ["--rate-hz", "1000", *ELASTIC, "--require", "delay_margin_ms=50"],
    "no requirement": ["--rate-hz", "1000", *ELASTIC, "--require", "phase_margin_deg=none", "--require", "peak_sensitivity=none"],
    "a type": ["--rate-hz", "1000", "--gearbox", "harmonic"],
    "none": ["--rate-hz", "1000", "--gearbox", "direct"],
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", GOES_ALONG)
@pytest.mark.parametrize("kd", [1.1, 12.0])
def test_an_answer_is_judged_again_as_it_was(capsys: pytest.CaptureFixture[str], kind: str, kd: float):
    """With what was required and the gearboxes' types, which go along in an answer, and which an export names by their flags."""
    gains = {name: {**gain, "kd": kd * gain["kd"]} for name, gain in GAINS.items()}
    Path("gains.yaml").write_text(yaml.safe_dump({"gains": gains}), "utf-8")
    call = ["audit", "leg.xml", "--delay-ms", "3"]
    first = answered(capsys, *call, "--gains", "gains.yaml", *GOES_ALONG[kind])
    Path("answer.json").write_text(json.dumps(first), "utf-8")
    again = answered(capsys, *call, "--gains", "answer.json")
    same = ("verdict", "findings", "required", "gain_limit", "phase_margin_deg", "rigid_gearboxes")
    assert {key: again[key] for key in same} == {key: first[key] for key in same}
    for form in ("yaml", "mjlab"):
        assert main(["export", "answer.json", "--to", form, "--json"]) == 0
        written = json.loads(capsys.readouterr().out)
        target = f"exported.{'py' if form == 'mjlab' else form}"
        Path(target).write_text(written["text"], "utf-8")
        third = answered(capsys, *call, "--gains", target, *written["audit_with"])
        assert {key: third[key] for key in ("verdict", "required")} == {key: first[key] for key in ("verdict", "required")}
        assert third["gain_limit"] == pytest.approx(first["gain_limit"], rel=1e-9)


def test_a_rigid_gearbox_of_a_robot_goes_along_in_its_answer(capsys: pytest.CaptureFixture[str]):
    (Path("robot.yaml")).write_text(yaml.safe_dump({**ROBOT, "model": {**ROBOT["model"], "file": "leg.xml"}, "joints": STIFF}), "utf-8")
    first = answered(capsys, "robot", "robot.yaml")
    assert first["rigid_gearboxes"] == []
    Path("answer.json").write_text(json.dumps(first), "utf-8")
    again = answered(capsys, "audit", "leg.xml", "--delay-ms", "2", "--gains", "answer.json")
    assert again["verdict"] == "safe"  # of the recommended ones
    assert again["rigid_gearboxes"] == []
    assert "gearbox_unknown" not in {one["code"] for one in again["findings"]}


def test_gains_that_rest_on_a_guessed_inertia_are_not_ready(capsys: pytest.CaptureFixture[str]):
    Path("bare.xml").write_text(re.sub(r' armature="[^"]*"', "", LEG), "utf-8")
    Path("gains.yaml").write_text("{hip: {kp: 1234.0, kd: 1.1}, knee: {kp: 600.0, kd: 0.5}}", "utf-8")
    call = ["audit", "bare.xml", "--delay-ms", "3", "--rate-hz", "1000", *ELASTIC, "--gains", "gains.yaml"]
    first = answered(capsys, *call)
    assert "motor_inertia_unknown" in {one["code"] for one in first["findings"]}
    assert first["to_use"] is None or first["to_use"]["ready"] is False
    main(call)
    assert "Do this: " in (out := capsys.readouterr().out)
    assert "--motor-inertia" in out.partition("Do this: ")[2]


def test_the_page_of_a_model_asks_for_what_goes_along_too(capsys: pytest.CaptureFixture[str]):
    call = ["audit", "leg.xml", "--delay-ms", "3", "--gains", "gains.yaml", *GOES_ALONG["a requirement"]]
    Path("answer.json").write_text(json.dumps(answered(capsys, *call)), "utf-8")
    page = ["app", "leg.xml", "--delay-ms", "3", "--gains", "answer.json", "--export", "view.html", "--write-robot", "robot.yaml"]
    assert main(page) == 0
    assert yaml.safe_load(Path("robot.yaml").read_text("utf-8"))["limits"]["delay_margin_ms"] == 50.0
