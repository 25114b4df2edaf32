"""Filters in exports: C that is compiled and run, chains of ros2_control and tables of coefficients, against scipy."""

import json
import math
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy import signal

import gainroom as gr
from gainroom.cli import main
from gainroom.files.export_forms import pasted_gains
from gainroom.files.gain_files import gains_of, parse_file
from gainroom.files.gain_formats.gain_record import Gain
from refusals import assert_refused

TICK = 5e-4
GAINS = """\
sample_rate_hz: 2000
system:
  control:
    velocity_filter: {bandwidth: 900, order: 2, damping_ratio: 0.6}
    notches: [{frequency: 330, width: 0.5, depth: 0.2}]
    biquads: [{zero_frequency: 160, zero_damping: 0.15, pole_frequency: 420, pole_damping: 0.6}]
gains:
  hip: {kp: 60.5, kd: 3.25, ki: 7.0}
  knee: {kp: 40, kd: 2}
"""
FORMS = {"c": "out.h", "markdown": "out.md", "ros2_control": "out.yaml"}


def warped(num: list[float], den: list[float], frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """Tustin's rule with one frequency kept, by scipy."""
    return signal.bilinear(num, den, frequency / (2 * math.tan(frequency * TICK / 2)))


EXPECTED = {
    "velocity filter": warped([1.0], [1 / 900.0**2, 2 * 0.6 / 900.0, 1.0], 900.0),
    "notch 1": warped([1.0, 0.1 * 330.0, 330.0**2], [1.0, 0.5 * 330.0, 330.0**2], 330.0),
    "biquad 1": warped([1 / 160.0**2, 0.3 / 160.0, 1.0], [1 / 420.0**2, 1.2 / 420.0, 1.0], 420.0),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gains.yaml").write_text(GAINS, "utf-8")
    return tmp_path


def exported(capsys: pytest.CaptureFixture[str], form: str, source: str = "gains.yaml", target: str = "") -> dict[str, Any]:
    assert main(["export", source, "--to", form, "--output", target or FORMS[form], "--write", "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def assert_coefficients(found: list[float], name: str) -> None:
    num, den = EXPECTED[name]
    assert found == pytest.approx([*num, *den[1:]], rel=1e-11)  # both lose (ω T_s)² = 0.01 of their digits


@pytest.mark.parametrize(
    ("one", "name"),
    [(gr.LowPass(900.0, 2, 0.6), "velocity filter"), (gr.Notch(330.0, 0.5, 0.2), "notch 1"), (gr.Biquad(160, 0.15, 420, 0.6), "biquad 1")],
)
def test_coefficients_are_those_of_scipy(one, name):
    assert_coefficients(one.coefficients(TICK), name)


def test_coefficients_of_first_order():
    num, den = warped([1.0], [1 / 700.0, 1.0], 700.0)
    assert gr.LowPass(700.0).coefficients(TICK) == pytest.approx((*num, 0.0, den[1], 0.0), rel=1e-12)


@pytest.mark.parametrize("language", ["c", "c++"])
@pytest.mark.parametrize("kind", ["all", "no velocity filter", "no filter"])
def test_c_runs_the_law_of_scipy(folder: Path, capsys: pytest.CaptureFixture[str], language: str, kind: str):
    """A random error through the compiled function, joint by joint: difference, filters and integral as scipy filters them."""
    compiler = shutil.which("cc") if language == "c" else os.environ.get("CXX") or shutil.which("c++")
    if compiler is None:
        pytest.skip("no compiler")
    data = yaml.safe_load(GAINS)
    if kind != "all":
        del data["system"]["control"]["velocity_filter"]
    if kind == "no filter":
        del data["system"]
    (folder / "gains.yaml").write_text(yaml.safe_dump(data), "utf-8")
    exported(capsys, "c")
    main_text = """
    #include <stdio.h>
    #include "out.h"
    int main(void) {
        gainroom_state states[2] = {{0}};
        double error;
        while (scanf("%lf", &error) == 1)
            printf("%.17g %.17g\\n", gainroom_torque(&states[0], 0, error), gainroom_torque(&states[1], 1, error));
        return 0;
    }
    """
    if language == "c++":
        main_text = main_text.replace("{{0}}", "{}")
    source = folder / ("main.c" if language == "c" else "main.cpp")
    source.write_text(main_text, "utf-8")
    flags = ["-std=c99", "-pedantic"] if language == "c" else ["-std=c++17"]
    subprocess.run([compiler, *flags, "-Wall", "-Wextra", "-Werror", str(source), "-o", "run"], check=True)
    error = np.random.default_rng(3).normal(size=300).cumsum()
    out = subprocess.run(["./run"], input="\n".join(map(repr, error.tolist())), capture_output=True, text=True, check=True).stdout
    found = np.array([list(map(float, line.split())) for line in out.splitlines()])
    rate = np.diff(error, prepend=error[0]) / TICK
    if kind == "all":
        rate = signal.lfilter(*EXPECTED["velocity filter"], rate)
    for column, (kp, kd, ki) in zip(found.T, ((60.5, 3.25, 7.0), (40.0, 2.0, 0.0)), strict=True):
        torque = kp * error + kd * rate + ki * TICK * error.cumsum()
        if kind != "no filter":
            torque = signal.lfilter(*EXPECTED["biquad 1"], signal.lfilter(*EXPECTED["notch 1"], torque))
        assert column == pytest.approx(torque, rel=1e-9, abs=1e-9 * np.abs(torque).max())  # coefficients to 1e-11, memory of 30 samples


def test_ros2_control_filters_what_its_controller_reads(folder: Path, capsys: pytest.CaptureFixture[str]):
    """A chain for each interface, in the parameters of chained_filter_controller and of the package filters; see there for their names."""
    said = exported(capsys, "ros2_control")
    data = yaml.safe_load((folder / "out.yaml").read_text("utf-8"))
    assert data["controller_manager"]["ros__parameters"]["joint_filters"] == {"type": "chained_filter_controller/ChainedFilter"}
    chains = data["joint_filters"]["ros__parameters"]
    control = data["effort_joint_trajectory_controller"]["ros__parameters"]
    exports = {f"joint_filters/{name}" for name in chains["output_interfaces"]}
    assert {f"{joint}/{measured}" for joint in control["joints"] for measured in control["state_interfaces"]} == exports
    assert control["command_joints"] == ["hip", "knee"]
    assert control["gains"]["joint_filters/hip"] == {"p": 60.5, "i": 7.0, "d": 3.25}
    for name in chains["input_interfaces"]:
        chain = chains[name]["filter_chain"]
        names = [*(["velocity filter"] if "velocity" in name else []), "notch 1", "biquad 1"]
        assert [each["name"] for each in chain.values()] == [each.replace(" ", "_") for each in names]
        for title, each in zip(names, chain.values(), strict=True):
            assert each["type"] == "filters/TransferFunctionFilterDouble"
            assert all(isinstance(value, float) for value in (*each["params"]["a"], *each["params"]["b"]))  # parameters have types
            assert each["params"]["a"][0] == 1.0
            assert_coefficients([*each["params"]["b"], *each["params"]["a"][1:]], title)
    notes = " ".join(said["notes"])
    settled = float(re.search(r"activate joint_filters (\S+) s or more", notes)[1])  # type: ignore[index]
    # of all filters the notch is slowest: its poles decay with ζω = 0.25 · 330, to 1e-3
    assert settled == pytest.approx(math.log(1e3) / (0.25 * 330.0), rel=0.05)
    assert "filters have no place" not in notes


def test_ros2_control_passes_positions_on_where_only_the_velocity_is_filtered(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "gains.yaml").write_text(re.sub(r"\n    (notches|biquads).*", "", GAINS), "utf-8")
    exported(capsys, "ros2_control")
    chains = yaml.safe_load((folder / "out.yaml").read_text("utf-8"))["joint_filters"]["ros__parameters"]
    (only,) = chains["hip/position"]["filter_chain"].values()
    assert only["params"] == {"a": [1.0], "b": [1.0]}
    (only,) = chains["hip/velocity"]["filter_chain"].values()
    assert only["name"] == "velocity_filter"


def test_ros2_control_file_takes_gains_for_its_filters_and_no_others(folder: Path, capsys: pytest.CaptureFixture[str]):
    exported(capsys, "ros2_control")
    (folder / "stiffer.yaml").write_text(GAINS.replace("60.5", "99.5"), "utf-8")
    assert main(["export", "stiffer.yaml", "--to", "ros2_control", "--onto", "out.yaml", "--write", "--json"]) == 0
    assert not any("filters" in note for note in json.loads(capsys.readouterr().out)["notes"])
    found = parse_file((folder / "out.yaml").read_text("utf-8"), Path("out.yaml"))
    assert (found.gains["hip"].kp, len(found.origin.system["control"]["biquads"])) == (99.5, 1)
    (folder / "others.yaml").write_text(GAINS.replace("420", "430"), "utf-8")
    assert main(["export", "others.yaml", "--to", "ros2_control", "--onto", "out.yaml", "--write"]) == 2
    assert "its joint_filters are not those of these gains; export a new file" in capsys.readouterr().err


def test_markdown_has_a_table_of_coefficients(folder: Path, capsys: pytest.CaptureFixture[str]):
    exported(capsys, "markdown")
    text = (folder / "out.md").read_text("utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    assert ["hip", "60.5", "3.25", "7.0"] in rows
    head = rows.index(["filter", "b0", "b1", "b2", "a1", "a2"])
    assert [row[0] for row in rows[head + 2 :]] == list(EXPECTED)
    for name, *numbers in rows[head + 2 :]:
        assert_coefficients(list(map(float, numbers)), name)
    assert "Every 0.0005 s" in text


@pytest.mark.parametrize("form", FORMS)
def test_filters_are_read_back(folder: Path, capsys: pytest.CaptureFixture[str], form: str):
    """Gains, rate and filters through a form and back into plain YAML are what they were."""
    said = exported(capsys, form)
    assert not any("filters have no place" in note for note in said["notes"])
    exported(capsys, "yaml", FORMS[form], "again.yaml")
    before, after = (yaml.safe_load(Path(name).read_text("utf-8")) for name in ("gains.yaml", "again.yaml"))
    assert (after["sample_rate_hz"], after["system"]) == (before["sample_rate_hz"], before["system"])
    assert after["gains"] == before["gains"]


@pytest.mark.parametrize("form", FORMS)
def test_coefficients_that_were_edited_are_refused(folder: Path, capsys: pytest.CaptureFixture[str], form: str):
    text = exported(capsys, form)["text"]
    b0 = repr(gr.Biquad(160, 0.15, 420, 0.6).coefficients(TICK)[0])
    assert b0 in text
    assert_refused(
        lambda: parse_file(text.replace(b0, b0.replace(".", ".1")), Path(FORMS[form])), ["biquad 1", "no coefficient", b0, "export it anew"]
    )
    line = next(each for each in text.splitlines() if "gainroom control:" in each)
    for strange in ("{", '{"sample_rate_hz": 2000.0, "kp": 3}', '{"sample_rate_hz": "fast"}', "{}"):
        broken = text.replace(line, line.partition("{")[0] + strange + "}")
        assert_refused(lambda broken=broken: parse_file(broken, Path(FORMS[form])), [FORMS[form], "gainroom control"])


def test_rate_that_was_edited_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]):
    text = exported(capsys, "ros2_control")["text"].replace("update_rate: 2000", "update_rate: 1000")
    assert_refused(lambda: parse_file(text, Path("out.yaml")), ["coefficients are for 2000 Hz", "rate is 1000 Hz"])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("sample_rate_hz: 2000", "", "says no rate"),
        ("sample_rate_hz: 2000", "sample_rate_hz: 2000\ngains_run: split\ndrive_rate_hz: 8000\ndrive_delay_ms: 0.1", "a rate of its own"),
    ],
)
def test_no_coefficients_without_one_rate(folder: Path, capsys: pytest.CaptureFixture[str], form: str, old: str, new: str, why: str):
    (folder / "gains.yaml").write_text(GAINS.replace(old, new), "utf-8")
    said = exported(capsys, form)
    assert why in " ".join(said["notes"])
    assert "filters have no place" in " ".join(said["notes"])
    assert "gainroom control" not in said["text"]
    assert "gainroom_torque" not in said["text"]  # a law without its filters is another


@pytest.mark.parametrize("form", FORMS)
def test_a_filter_above_half_the_rate_is_refused(folder: Path, capsys: pytest.CaptureFixture[str], form: str):
    (folder / "gains.yaml").write_text(GAINS.replace("2000", "100"), "utf-8")
    assert main(["export", "gains.yaml", "--to", form]) == 2
    assert "control.biquads[0].pole_frequency: 420 rad/s must be below half the sample rate, 314.159 rad/s" in capsys.readouterr().err


def test_gains_that_run_on_the_drive_have_filters_at_its_rate(folder: Path, capsys: pytest.CaptureFixture[str]):
    drive = "gains_run: drive\ndrive_rate_hz: 8000\ndrive_delay_ms: 0.1"
    (folder / "gains.yaml").write_text(GAINS.replace("sample_rate_hz: 2000", drive), "utf-8")
    text = exported(capsys, "c")["text"]
    assert "gainroom_sample_time = 0.000125;" in text
    assert repr(gr.Biquad(160, 0.15, 420, 0.6).coefficients(1 / 8000)[0]) in text
    found = parse_file(text, Path("out.h")).origin
    assert (found.sample_rate_hz, "biquads" in found.system["control"]) == (None, True)


@pytest.mark.parametrize("form", [*FORMS, "arrays", "mjcf"])
def test_the_page_copies_filters_or_says_that_they_are_missing(form: str):
    control = yaml.safe_load(GAINS)["system"]["control"]
    text = pasted_gains({"knee": Gain(40.0, 2.0)}, form, "margins", 2000.0, control)
    held = repr(gr.Biquad(160, 0.15, 420, 0.6).coefficients(TICK)[0]) in text
    assert held == (form in FORMS)
    assert ("without the loop's filters" in text) == (not held)
    plain = pasted_gains({"knee": Gain(40.0, 2.0)}, form, "margins", 2000.0, {"kp": 40.0})
    assert "filters" not in plain.replace("gainroom_filter", "")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("kis[2] = {7.0, 0.0}", "kis[2] = {7.0}", ["one entry for each joint"]),
        ("kis[2] = {7.0, 0.0}", "kis[2] = {7.0, -1.0}", ["kis", "-1", ">= 0"]),
        ("kps[2] = {60.5, 40.0}", "kps[2] = {60.5, KNEE}", ["kps", "must be numbers"]),
        ("static const double kds", "static const float kds", ["kds is missing"]),
    ],
)
def test_c_header_that_was_broken_is_refused(folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: list[str]):
    text = exported(capsys, "c")["text"]
    assert old in text
    assert_refused(lambda: parse_file(text.replace(old, new), Path("out.h")), ["out.h", *words])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# Gains\n", ["no table of gains", "| joint |"]),
        ("| joint | kp [N·m/rad] |\n| --- | --- |\n| hip | 3 | 4 |\n", ["line 3", "3 cells", "must have 2"]),
        ("| joint | kp [N·m/rad] |\n| --- | --- |\n| hip | stiff |\n", ["line 3", "kp", "'stiff'", ">= 0"]),
        ("| joint | kp [N·m/rad] |\n| --- | --- |\n| hip | -3 |\n", ["line 3", "kp", "-3", ">= 0"]),
    ],
)
def test_markdown_without_gains_is_refused(text: str, words: list[str]):
    assert_refused(lambda: parse_file(text, Path("out.md")), ["out.md", *words])


JOINT = """\
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1.0e4, damping: 1}
drive: {bandwidth: 4000.0, delay_ms: 2.5}
control: {type: pid, kp: 2000, ki: 30, kd: 170, feedback: link, sample_rate_hz: 2000,
  biquads: [{zero_frequency: 160, zero_damping: 0.15, pole_frequency: 420, pole_damping: 0.6}]}
limits: {gain_margin_db: 6.0, phase_margin_deg: 30.0, peak_sensitivity: 2.2}
"""


@pytest.mark.parametrize("form", ["ros2_control", "yaml"])
def test_a_joint_yaml_is_exported_with_its_filters(folder: Path, capsys: pytest.CaptureFixture[str], form: str):
    (folder / "knee.yaml").write_text(JOINT, "utf-8")
    target = FORMS.get(form, "out.yaml")
    said = exported(capsys, form, "knee.yaml", target)
    found = parse_file(said["text"], Path(target))
    gains = gains_of(found, ("knee",))
    assert [float(getattr(gains, key)[0]) for key in ("kp", "ki", "kd")] == [2000.0, 30.0, 170.0]
    control = yaml.safe_load(JOINT)["control"]
    assert found.origin.system["control"] == {"feedback": "link", "biquads": control["biquads"]}
    assert found.origin.sample_rate_hz == 2000.0
    assert "delay: 2.5 ms; controller at 2000 Hz" in said["text"]
    assert said["audit_with"][-2:] == ["--require", "peak_sensitivity=2.2"]


@pytest.mark.parametrize(("form", "flags"), [("yaml", []), ("ros2_control", ["--bandwidth", "4000.0"])])
def test_the_current_loop_of_a_joint_yaml_goes_along(folder: Path, capsys: pytest.CaptureFixture[str], form: str, flags: list[str]):
    (folder / "knee.yaml").write_text(JOINT, "utf-8")
    said = exported(capsys, form, "knee.yaml", target := FORMS.get(form, "out.yaml"))
    kept = parse_file(said["text"], Path(target)).origin.system.get("drive", {})
    assert kept == ({} if flags else {"bandwidth": 4000.0, "damping_ratio": 0.9})  # the form holds it, or a flag does
    given = said["audit_with"]
    assert [given[k : k + 2] for k, word in enumerate(given) if word == "--bandwidth"] == ([flags] if flags else [])


def test_kd_on_the_drive_goes_along(folder: Path, capsys: pytest.CaptureFixture[str]):
    path = "2000, kd_path: {delay_ms: 0.1, sample_rate_hz: 8000},"
    split = JOINT.replace("pid, kp: 2000, ki: 30", "pd, kp: 2000").replace("2000,\n", f"{path}\n")
    (folder / "knee.yaml").write_text(split, "utf-8")
    text = exported(capsys, "yaml", "knee.yaml", "out.yaml")["text"]
    found = parse_file(text, Path("out.yaml")).origin
    assert "delay: 0.1 ms in the drive at 8000 Hz for kd; 2.5 ms for kp; controller at 2000 Hz" in text
    assert (found.gains_run, found.drive_rate_hz, found.sample_rate_hz) == ("split", 8000.0, 2000.0)
    assert found.drive_delay_ms == pytest.approx(0.1, rel=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "pid, kp: 2000, ki: 30, kd: 170",
            "ppi, kp: 20, kv: 170, ki: 0",
            "control.type: ppi has other gains than this form holds",
        ),
        (
            "feedback: link",
            "feedback: {kp: link, kd: motor, ki: link}",
            "control.feedback: this form holds gains on one encoder",
        ),
        ("link_inertia: 16.0", "link_inertia: -16.0", "joint.link_inertia: -16.0 must be > 0"),
        ("kp: 2000, ki: 30, kd: 170, ", "", "control.kp"),
    ],
)
def test_a_joint_yaml_whose_gains_have_no_place_is_refused(folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, says: str):
    assert old in JOINT
    (folder / "knee.yaml").write_text(JOINT.replace(old, new), "utf-8")
    assert main(["export", "knee.yaml", "--to", "ros2_control"]) == 2
    assert f"knee.yaml: {says}" in capsys.readouterr().err


def test_an_audit_sends_a_joint_yaml_to_its_command(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "knee.yaml").write_text(JOINT, "utf-8")
    assert_refused(lambda: parse_file(JOINT, Path("knee.yaml")), ["knee.yaml", "must be a file of gains", "gainroom joint knee.yaml"])
