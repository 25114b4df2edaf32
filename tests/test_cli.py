"""The command line's contract: keys, exit status, what goes to which stream, reports that are whole or absent."""

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from gainroom.cli import main
from gainroom.cli.example import example_texts, joint_examples
from gainroom.cli.front import app
from gainroom.cli.identify import identify
from gainroom.cli.output import emit_json, render, table
from gainroom.files.joint_yaml import load_joint
from gainroom.report.number_format import digits, frequency
from gainroom.studies import joint as studies_of_joints
from gainroom.studies.joint import JointStudy, study_joint
from gainroom.system.system import JointSpec

EXAMPLES = joint_examples()
# Fixed names: scripts outside the project read them.
JOINT_KEYS = {
    "stable", "gain_margin_db", "phase_crossover_rad_s", "phase_margin_deg", "gain_crossover_rad_s", "delay_margin_ms",
    "peak_sensitivity", "disk_margin", "max_kp", "max_kd", "recommended", "warnings", "model",
}  # fmt: skip
MARGIN_KEYS = {"gain_margin_db", "phase_margin_deg", "delay_margin_ms", "peak_sensitivity", "disk_margin"}
UNSTABLE = EXAMPLES["testbed"].replace("kd: 70.0", "kd: 80.0")


class Said(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli")
    for name, text in {**EXAMPLES, "unstable": UNSTABLE}.items():
        (path / f"{name}.yaml").write_text(text, "utf-8")
    return path


@pytest.fixture(scope="module")
def said(folder: Path) -> Callable[..., Said]:
    """What `gainroom joint` says about a file of `folder`, which is studied once for all its outputs."""
    studies = {}

    def studied(name: str, system: JointSpec) -> JointStudy:
        if name not in studies:
            studies[name] = study_joint(system)
        return studies[name]

    @cache
    def ask(name: str, *options: str) -> Said:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.MonkeyPatch.context() as patch:
            patch.setattr(studies_of_joints, "study_joint", lambda system: studied(name, system))
            status = main(["joint", str(folder / f"{name}.yaml"), *options])
        return Said(status, out.getvalue(), err.getvalue())

    return ask


def reject_constant(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


def strict_json(text: str) -> dict:
    return json.loads(text, parse_constant=reject_constant)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_joint_json(said: Callable[..., Said], name: str):
    status, out, err = said(name, "--json")
    facts = strict_json(out)
    assert (status, err, facts["verdict"]) == (1, "", "unsafe")  # every shipped joint has gains to improve
    assert set(facts) >= JOINT_KEYS
    assert facts["stable"] is True
    assert facts["model"] == ("sampled" if "sample_rate_hz: " in EXAMPLES[name] else "continuous")
    assert set(facts["recommended"]) >= {"kp", "kd", "margins"}
    assert set(facts["recommended"]["margins"]) >= MARGIN_KEYS
    assert facts["max_kp"] > facts["recommended"]["kp"] > 0


def test_unstable_is_status_1_and_says_so_first(said: Callable[..., Said]):
    assert said("unstable", "--json").status == 1
    facts = strict_json(said("unstable", "--json").out)
    assert facts["stable"] is False
    assert facts["unstable_roots"] >= 1
    assert facts["gain_margin_db"] is None
    assert said("unstable").status == 1
    assert "unstable" in said("unstable").out.splitlines()[0].lower()


@pytest.mark.slow
@pytest.mark.parametrize("name", [*sorted(EXAMPLES), "unstable"])
def test_joint_terminal(said: Callable[..., Said], name: str):
    _, out, err = said(name, "--verbose")
    assert err == ""
    assert max(map(len, out.splitlines())) <= 80
    assert "\x1b" not in out
    for word in ("gain margin", "phase margin", "delay margin", "recommended", "rad/s", "Hz"):
        assert word in out


def test_requirements_are_met_or_not(said: Callable[..., Said]):
    lines = said("fig9").out.splitlines()  # 6.2 dB against 6 dB
    row = next(line for line in lines if line.startswith(" gain margin"))  # of the table
    assert row.split()[7] == "yes"


def test_a_gain_that_may_hardly_fall_has_no_gain_margin(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """6 dB means a factor of 2 up and down: with much integral action the first is kept and the second is not."""
    path = tmp_path / "joint.yaml"
    edits = (("type: pd", "type: pid"), ("kp: 1600.0", "ki: 6000.0\n  kp: 400.0"), ("kd: 70.0", "kd: 20.0"))
    text = EXAMPLES["testbed"]
    for old, new in edits:
        text = text.replace(old, new, 1)
    path.write_text(text, "utf-8")
    main(["joint", str(path), "--json"])
    facts = strict_json(capsys.readouterr().out)
    assert facts["gain_margin_db"] > 6
    assert -6 < facts["lower_gain_margin_db"] < 0
    main(["joint", str(path)])
    row = next(line for line in capsys.readouterr().out.splitlines() if line.strip().startswith("gain margin"))
    assert "≥ 6 dB    no" in row


@pytest.mark.slow
@pytest.mark.parametrize("beyond", [False, True])
def test_gains_are_judged_over_the_stated_ranges(tmp_path: Path, capsys: pytest.CaptureFixture[str], beyond: bool):
    """The delay margin says exactly which longest delay is still stable: a range that ends a thousandth before or after it."""
    text = EXAMPLES["testbed"].partition("uncertainty:")[0].replace("sample_rate_hz", "# sample_rate_hz")  # continuous: any delay
    file = tmp_path / "joint.yaml"
    file.write_text(text, "utf-8")
    assert main(["joint", str(file), "--json", "--exit-zero"]) == 0
    stated = strict_json(capsys.readouterr().out)
    assert (stated["stable_in_range"], stated["unstable_at"]) == (True, None)
    delay = load_joint(file).delay
    longest = 1e3 * delay + (1.001 if beyond else 0.999) * stated["delay_margin_ms"]
    file.write_text(f"{text}\nuncertainty: {{delay_ms: [{0.9e3 * delay:.12g}, {longest:.12g}]}}\n", "utf-8")
    report = tmp_path / "joint.html"
    assert main(["joint", str(file), "--json", "--report", str(report)]) == 1
    facts = strict_json(capsys.readouterr().out)
    assert facts["stable"] is True
    assert facts["stable_in_range"] is not beyond
    assert facts["unstable_at"] == (pytest.approx({"delay": 1e-3 * longest}) if beyond else None)
    case = f"unstable at delay {longest:.4g} ms"
    assert (f"not everywhere in the uncertainty ranges: {case}" in facts["sentence"]) is beyond
    assert any("recommended gains" in text and "uncertainty ranges" in text for text in facts["warnings"]) is beyond
    assert ("UNSTABLE within the uncertainty ranges" in report.read_text("utf-8")) is beyond


@pytest.mark.parametrize("longest", [40, 46, 50])
def test_a_wide_table_moves_together_before_it_breaks_lines(capsys: pytest.CaptureFixture[str], longest: int):
    """Five columns of 5 need 3 blanks between them, or 2: the first column stays whole up to 80 columns in all."""
    name = f"crouch, {'x' * (longest - 8)}"
    text = render(table("title", ("", "a", "b", "c", "d"), [(name, *4 * ("12.34",)), ("short", *4 * ("1",))]))
    lines = text.splitlines()
    assert max(map(len, lines)) <= 80
    assert [line for line in lines if name in line]
    assert [len(line.split()) for line in lines[-3:] if line] == [6, 5]


PPI = EXAMPLES["testbed"].replace("type: pd", "type: ppi").replace("kp: 1600.0 ", "kp: 20.0 ").replace("kd: 70.0 ", "ki: 30.0\n  kv: 10.0 ")


@pytest.mark.slow
def test_recommended_controller_can_be_typed_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "ppi.yaml"
    file.write_text(PPI, "utf-8")
    assert main(["joint", str(file), "--json", "--exit-zero"]) == 0
    best = strict_json(capsys.readouterr().out)["recommended"]
    assert best["controller"] == {"type": "ppi", "kp": best["kp"], "kv": best["kv"], "ki": best["ki"]}
    assert best["plane"] == {"kp": pytest.approx(best["kp"] * best["kv"]), "kd": best["kv"]}
    assert main(["joint", str(file), "--verbose", "--exit-zero"]) == 0
    out = capsys.readouterr().out
    line = next(line for line in out.splitlines() if line.startswith("Recommended controller: "))
    kp, kv, ki = (float(gain.split()[1]) for gain in line.partition(": ")[2].split(", "))
    assert "kv·kp" in out
    file.write_text(PPI.replace("kp: 20.0", f"kp: {kp}").replace("kv: 10.0", f"kv: {kv}").replace("ki: 30.0", f"ki: {ki}"), "utf-8")
    assert main(["joint", str(file), "--json"]) == 0
    typed = strict_json(capsys.readouterr().out)
    for name in ("gain_margin_db", "phase_margin_deg", "peak_sensitivity"):
        assert typed[name] == pytest.approx(best["margins"][name], rel=1e-4)


@pytest.mark.slow
def test_uncertain_rows_keep_cases_apart(said: Callable[..., Said]):
    out = said("talos-knee", "--verbose").out
    assert "recommended (worst case)" in out
    assert "recommended (nominal)" in out
    assert "(worst case: delay 3 ms, stiffness 12\u202f000 N·m/rad" in " ".join(out.split("\n"))
    assert "sampled model, 2\u202f000 Hz" in out
    best = strict_json(said("talos-knee", "--json").out)["recommended"]
    worst, stated = best["margins"], best["nominal"]
    assert worst["gain_margin_db"] <= stated["gain_margin_db"]
    assert abs(worst["phase_margin_deg"]) <= abs(stated["phase_margin_deg"])
    assert worst["peak_sensitivity"] >= stated["peak_sensitivity"]
    costs = {name: cost for name, cost in best["costs"].items() if name != "uncertainty"}
    if max(costs.values()) > 1.01 * best["kp"]:
        assert best["binding"] == max(costs, key=costs.__getitem__)


@pytest.mark.slow
def test_report_is_one_page_and_keeps_stdout_pure(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    report = tmp_path / "out.html"
    assert main(["joint", str(folder / "testbed.yaml"), "--json", "--report", str(report), "--exit-zero"]) == 0
    strict_json(capsys.readouterr().out)
    page = report.read_text("utf-8")
    assert page.lstrip().lower().startswith("<!doctype html")
    assert "gainroom joint" in page
    assert len(page) < 6e6
    assert os.listdir(tmp_path) == ["out.html"]


@pytest.mark.slow
def test_report_replaces_the_old_one_only_when_whole(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    report = tmp_path / "out.html"
    report.write_text("the old report", "utf-8")
    call = ["joint", str(folder / "testbed.yaml"), "--report", str(report), "--exit-zero"]

    def broken_page(*_: object) -> str:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("gainroom.report.joint.joint_page", broken_page)
        assert main(call) == 130
    assert report.read_text("utf-8") == "the old report"
    assert os.listdir(tmp_path) == ["out.html"]
    report.chmod(0o640)
    assert main(call) == 0
    assert report.read_text("utf-8") != "the old report"
    assert report.stat().st_mode & 0o777 == 0o640
    capsys.readouterr()


@pytest.mark.slow
def test_report_through_a_link_keeps_the_link(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "link.html").symlink_to("true.html")
    assert main(["joint", str(folder / "testbed.yaml"), "--report", str(tmp_path / "link.html"), "--exit-zero"]) == 0
    assert (tmp_path / "link.html").is_symlink()
    assert (tmp_path / "true.html").is_file()
    capsys.readouterr()


def test_example(capsys: pytest.CaptureFixture[str]):
    assert main(["example"]) == 0
    listing = capsys.readouterr().out
    assert [line.split()[0] for line in listing.splitlines()] == sorted(example_texts())
    assert max(map(len, listing.splitlines())) <= 100
    assert {"testbed", "fig9", "talos-knee"} <= set(EXAMPLES)
    for name, text in example_texts().items():
        assert main(["example", name]) == 0
        assert capsys.readouterr().out == text
        assert main(["example", name, "--json"]) == 0
        assert strict_json(capsys.readouterr().out)["text"] == text


def test_every_command_has_help_with_an_example(capsys: pytest.CaptureFixture[str]):
    commands = [info.name for info in app.registered_commands]
    assert commands == [
        "joint",
        "robot",
        "audit",
        "sweep",
        "export",
        "compare",
        "simulate",
        "verify",
        "log",
        "diagnose",
        "app",
        "actuators",
        "example",
        "reproduce",
    ]
    groups = [["identify"], *(["identify", info.name] for info in identify.registered_commands)]
    for command in ([], *([name] for name in commands), *groups):
        assert main([*command, "--help"]) == 0
        assert f"Example:\n{' ' * 4}gainroom {' '.join(command)}".rstrip() in capsys.readouterr().out


def test_front(capsys: pytest.CaptureFixture[str]):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("gainroom 0.")
    assert main([]) == 2
    assert "Usage: gainroom" in capsys.readouterr().out


def loaded_by(*arguments: str) -> set[str]:
    """Names of all modules that a process has loaded after one command."""
    code = f"import sys; from gainroom.cli import main; main({list(arguments)!r}); print(*sys.modules, file=sys.stderr)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stderr.split())


def test_help_loads_nothing_heavy():
    loaded = {name.partition(".")[0] for name in loaded_by("--help")}
    assert not loaded & {"numpy", "scipy", "pydantic", "plotly", "yaml", "control"}


def test_a_joint_without_a_scenario_loads_no_simulation_of_files(folder: Path):
    """What only simulate, a robot or a report need is not waited for."""
    loaded = loaded_by("joint", str(folder / "testbed.yaml"))
    assert "gainroom.studies.joint" in loaded
    packages = {name.partition(".")[0] for name in loaded}
    assert not packages & {"scipy", "plotly", "control", "mujoco", "pinocchio"}
    others = "simulation.simulation_spec", "simulation.robot_run"  # its step response is part of the answer
    assert not loaded & {f"gainroom.{name}" for name in (*others, "files.joint_scenario", "robot", "files.robot_yaml", "report.joint")}


def test_a_reader_that_leaves_early_does_no_harm():
    read, write = os.pipe()
    os.close(read)
    run = subprocess.run([sys.executable, "-m", "gainroom", "example", "fig9"], stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (run.returncode, run.stderr) == (0, "")


def test_a_terminal_without_the_characters_still_gets_the_answer(folder: Path):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    call = [sys.executable, "-m", "gainroom", "joint", str(folder / "testbed.yaml")]
    run = subprocess.run(call, capture_output=True, text=True, env=environment)
    assert (run.returncode, run.stderr) == (1, "")  # a requirement fails


def test_numbers_that_are_not_finite_become_null(capsys: pytest.CaptureFixture[str]):
    emit_json({"a": float("nan"), "b": [float("inf"), 1.5], "c": {"d": -float("inf")}, "e": True})
    assert strict_json(capsys.readouterr().out) == {"a": None, "b": [None, 1.5], "c": {"d": None}, "e": True}


def test_numbers_for_people():
    assert digits(0.12344321) == "0.1234"
    assert digits(16000.8, "N") == "16\u202f000 N"
    assert digits(156.3, "×", 2) == "160 ×"
    assert digits(float("nan")) == "–"
    assert digits(float("inf")) == "∞"
    assert digits(1.234e-7) == "1.234·10⁻⁷"
    assert frequency(620.0) == "98.7 Hz (620 rad/s)"


def test_colour_is_for_terminals_that_want_it(monkeypatch: pytest.MonkeyPatch):
    rows = [("gain margin", "yes")]
    assert "\x1b" not in render(table("T", ("", "met"), rows))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\x1b[1;34m" in render(table("T", ("", "met"), rows))
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[1;34m" not in render(table("T", ("", "met"), rows))
