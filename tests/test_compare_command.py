"""gainroom compare: the answer for a person and a program, the page, the joint that it writes, and calls that are wrong."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import gainroom as gr
from gainroom.cli import main
from gainroom.cli.example import example_texts
from gainroom.design.comparison.catalogue import structure_of
from gainroom.design.comparison.ceilings import Ceilings
from gainroom.design.comparison.certificate import Certificate
from gainroom.design.comparison.compared_joint import ComparedJoint
from gainroom.design.comparison.structure_search import Problem
from gainroom.files.compared_joint import compared_text
from gainroom.files.joint_yaml import load_joint, parse_comparison
from gainroom.report.comparison_text import winner
from gainroom.studies.comparison import Comparison, Row
from gainroom.system.delay_reserve import delay_reserve

JOINT = """\
# A joint whose load is known well.
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1.0e4, damping: 1.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
control:
  type: pid                 # whatever it is now
  kp: 1.0e3
  ki: 10.0
  kd: 100.0
  feedback: motor
  sample_rate_hz: 2000
limits: {gain_margin_db: 6.0, phase_margin_deg: 50.0, peak_sensitivity: 2.0}
uncertainty: {link_inertia: [8.0, 24.0], stiffness: 20%}
"""


@pytest.fixture
def joint(tmp_path: Path) -> Path:
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT, "utf-8")
    return path


def asked(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any]:
    assert main([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    """The one line of a refusal, exit status 2."""
    assert main([*map(str, words)]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    (line,) = [one for one in told.err.splitlines() if one]
    return line


@pytest.mark.slow
def test_answer_page_and_joint(joint: Path, tmp_path: Path, capsys):
    """One call makes all: every number of the JSON is that of gr.compare, and the written joint is judged as it was compared."""
    page, written = tmp_path / "compare.html", tmp_path / "better.yaml"
    call = ["compare", joint, "--structures", "pd,split", "--no-bound", "--report", page, "--write", written, "--take", "pd"]
    found = asked(capsys, *call)
    pd, split = found["rows"]
    assert [pd["structure"], split["structure"]] == ["pd", "split"]
    assert split["times_pd"] == pytest.approx(pd["worst"] / split["worst"])
    assert split["times_pd"] > 1.5
    assert pd["runs"] == "host"
    assert split["runs"] == "host, kd in the drive"
    assert pd["sensors"] == split["sensors"] == ["motor"]
    assert found["bound"] is None
    assert found["box"] == {"link_inertia": [8.0, 24.0], "stiffness": [pytest.approx(8e3), pytest.approx(1.2e4)]}
    assert found["ceilings"]["peak_sensitivity"] == 2.0
    assert found["ceilings"]["delay_reserve_ms"] == pytest.approx(1.0)  # half of the drive's delay
    assert pd["torque_noise"] == pytest.approx(found["ceilings"]["torque_noise"], rel=0.02)  # what the best PD makes, in the box or nominal
    for row in (pd, split):
        assert row["holds"]
        assert row["broken"] == ""
        assert row["worst"] >= row["nominal"] > 0
        assert row["worst_margins"]["peak_sensitivity"] <= 2.0 + 1e-5
        assert row["delay_reserve_ms"] >= 1.0
        assert row["torque_noise"] <= found["ceilings"]["torque_noise"] * (1 + 1e-5)
        assert row["fragile"]["tried"] == 18  # 3 stiffnesses, 3 loads, 2 delays

    html = page.read_text("utf-8")
    for text in ("kd in the drive", "worst in the box", "Certification", "How far a load moves the link"):
        assert text in html

    system = load_joint(written)
    controller = pd["controller"]
    assert yaml.safe_load(written.read_text("utf-8"))["control"] == controller
    assert "ki" not in controller
    assert system.control.controller.kp == pytest.approx(pd["parameters"]["kp"], rel=1e-6)  # seven digits are written
    worst = [gr.margins(case.system.loop(case.model)) for case in system.cases()]
    assert max(one.peak_sensitivity for one in worst) <= 2.0 + 1e-5
    stiff = 1 / min(one.dynamic_stiffness for one in worst)
    # of the loop's own links, without aliases, which are 3.5e-3 of a peak at most (analysis/link_compliance.py)
    assert stiff == pytest.approx(pd["worst"], rel=4e-3)
    limits = yaml.safe_load(JOINT)["limits"] | {"delay_reserve_ms": 1.0}
    assert yaml.safe_load(written.read_text("utf-8"))["limits"] == limits
    assert "# Of this file's limits it misses: phase margin" in written.read_text("utf-8")
    assert main(["joint", str(written)]) == 1


@pytest.mark.slow
def test_the_delay_reserve_of_the_limits_is_the_ceiling_and_what_joint_reports(joint: Path, tmp_path: Path, capsys):
    """3 ms bind a PD that has 2.2 without: its row has just these, and so has the written joint, where it is required."""
    joint.write_text(JOINT.replace("phase_margin_deg: 50.0", "delay_reserve_ms: 3.0"), "utf-8")
    written = tmp_path / "better.yaml"
    found = asked(capsys, "compare", joint, "--structures", "pd", "--no-bound", "--write", written)
    assert found["ceilings"]["delay_reserve_ms"] == 3.0
    (row,) = found["rows"]
    assert 3.0 <= row["delay_reserve_ms"] < 3.0 * (1 + 1e-3)  # a search keeps 2e-4 of it
    assert yaml.safe_load(written.read_text("utf-8"))["limits"]["delay_reserve_ms"] == 3.0
    (limit,) = row["limited_by"]
    cases = list(load_joint(written).cases())
    reserves = [delay_reserve(case.system.loop(case.model)).width for case in cases]
    assert (limit["ceiling"], limit["at"]) == ("delay_reserve", cases[int(np.argmin(reserves))].place)
    assert 1e3 * min(reserves) == pytest.approx(row["delay_reserve_ms"], rel=1e-6)  # seven digits are written
    judged = asked(capsys, "joint", written)
    assert judged["verdict"] == "safe"  # at all places examined; nothing is proved between them
    assert judged["worst"]["delay_reserve_ms"] == pytest.approx(row["delay_reserve_ms"], rel=1e-6)  # seven digits are written


@pytest.mark.slow
def test_what_a_torque_sensor_buys(joint: Path, tmp_path: Path, capsys):
    """Told against PD and against the best without it; the controller that is written measures the spring's torque."""
    written = tmp_path / "sensed.yaml"
    call = ["compare", joint, "--structures", "pd,torque_feedback", "--torque-sensor", "0.05", "--no-bound"]
    found = asked(capsys, *call, "--write", written, "--take", "torque_feedback")
    _, sensed = found["rows"]
    assert sensed["sensors"] == ["motor", "torque"]
    assert sensed["holds"]
    assert sensed["times_pd"] > 3  # 3.5 by a prototype of its own
    factor = f"{sensed['times_pd']:.2g} ×"
    assert f"Against PD: a torque sensor {factor}, {factor} as stiff as the best of these without it, PD." in found["sentence"]
    system = load_joint(written)
    assert system.control.controller.ktau == pytest.approx(sensed["parameters"]["ktau"], rel=1e-6)
    assert system.control.feedback.written == {"kp": "motor", "kd": "motor", "ktau": "torque"}
    worst = max(gr.margins(case.system.loop(case.model)).peak_sensitivity for case in system.cases())
    assert worst <= 2.0 + 1e-5


@pytest.mark.slow
def test_a_search_that_exact_margins_outdo_is_tightened_until_it_holds(joint: Path, capsys):
    """On the link's encoder the resonance is so sharp that the search sees Ms 2.000 where the exact loop has 2.006."""
    joint.write_text(JOINT.replace("feedback: motor", "feedback: link"), "utf-8")
    (pd,) = asked(capsys, "compare", joint, "--structures", "pd", "--no-bound")["rows"]
    assert pd["holds"]
    assert 1.995 < pd["worst_margins"]["peak_sensitivity"] <= 2.0 * (1 + 1e-6)


@pytest.mark.slow
def test_a_law_in_plain_numbers_is_written_and_read_back(joint: Path, tmp_path: Path, capsys):
    """A Kalman filter with state feedback has no gains: zeros and poles are written, and its loop is the one that was compared."""
    joint.write_text(JOINT.replace("link_inertia: [8.0, 24.0], stiffness: 20%", "link_inertia: [15.0, 17.0]"), "utf-8")
    system, settings = parse_comparison(joint.read_text("utf-8"), "joint.yaml")
    structure = structure_of("observer").scaled_to(system, gr.GainPath(1e-4, 5e-5))
    low, high = structure.box
    found = structure.system((low + high) / 2, system, None)
    row = Row("observer", found, {}, *(math.nan, math.nan, "", None, None, 0, math.nan, math.nan), ("motor",), "host", math.nan, None)
    compared = ComparedJoint.of(system)
    comparison = Comparison((row,), None, None, system, Ceilings(delay_reserve=1e-3), settings.objective, joint=compared, settings=settings)
    again = parse_comparison(compared_text(comparison, row, joint.read_text("utf-8"), "joint.yaml", "0"), "again.yaml")[0]
    omega = np.geomspace(1.0, 6000.0, 50)
    # 16 digits of every zero and pole: near z = 1, where they gather, the response keeps about 10 of them
    np.testing.assert_allclose(again.loop().response(omega), found.loop().response(omega), rtol=1e-8)


@pytest.mark.slow
def test_the_bound_and_its_certificate(joint: Path, capsys):
    """It is proved by weights that the JSON has, below what is found, and at least the largest of the corners' that a prototype had."""
    found = asked(capsys, "compare", joint, "--structures", "pd")
    certificate = Certificate.from_json(json.dumps(found["bound"]["certificate"]))
    assert certificate.check() >= found["bound"]["value"] * (1 - 1e-9)
    assert found["bound"]["at"] == "stiffness 8000 N·m/rad, link inertia 8 kg·m²"  # where it is 0.190, elsewhere 0.171 at most
    assert 0.187e-3 < found["bound"]["value"] < found["rows"][0]["worst"]
    assert found["bound"]["times_pd"] == pytest.approx(found["rows"][0]["worst"] / found["bound"]["value"])


@pytest.mark.slow
def test_the_best_known_controller_stands_beside_the_bound(joint: Path, tmp_path: Path, capsys):
    """It lies between bound and every structure, keeps the ceilings, and is a line of text, table and page."""
    pytest.importorskip("clarabel")
    page = tmp_path / "page.html"
    found = asked(capsys, "compare", joint, "--structures", "pd", "--best-known", "--report", page)
    known, bound = found["best_known"], found["bound"]
    assert bound["value"] <= known["value"] < found["rows"][0]["worst"]
    assert known["value"] <= 1.15 * bound["value"]  # what 95 % of random joints reach
    assert known["at"] == bound["at"]
    assert known["peak_sensitivity"] <= 2.0
    assert known["delay_share"] <= 1.0
    assert known["torque_noise"] <= found["ceilings"]["torque_noise"]
    assert known["times_pd"] == pytest.approx(found["rows"][0]["worst"] / known["value"])
    html = page.read_text("utf-8")
    assert html.count("best known, any linear controller") >= 2  # the line and the caption
    assert "best known, one corner" in html


def test_without_clarabel_the_best_known_controller_is_refused_at_once(joint: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "needs clarabel: pip install 'gainroom[compare]'" in refused(capsys, "compare", joint, "--structures", "pd", "--best-known")


def test_corners_with_other_delays_are_looked_at_together():
    """As many frequencies at each: a range of delays ended in a traceback, as grids reach as far down as the delay is long."""
    system, settings = parse_comparison(example_texts()["talos-knee"], "knee.yaml")
    assert "delay" in system.uncertainty.names
    structure = structure_of("pd").scaled_to(system, gr.GainPath(1e-4, 5e-5))
    ceilings = Ceilings(delay_reserve=1e-3, torque_noise=3.0, sensor_noise=settings.sensor_noise)
    compared = ComparedJoint.of(system)
    problem = Problem(compared, ceilings, settings.objective, gr.GainPath(1e-4, 5e-5))
    corners = problem.corners(structure, compared.corners, 1.0)
    assert len({len(problem.spot(structure, spot).grid(1.0)) for spot in compared.corners}) > 1
    x = structure.coordinates({"kp": 2000.0, "kd": 400.0})[None]
    alone = [problem.corners(structure, [spot], 1.0).one(x, 0) for spot in compared.corners]
    together = [corners.one(x, k) for k in range(len(alone))]
    for one, other in zip(alone, together, strict=True):
        # added frequencies can only find more of a peak, by what lies between two of the coarse grid
        assert 0 <= other.objective[0] - one.objective[0] < 0.01
        assert one.stable[0] == other.stable[0]


@pytest.mark.slow
def test_a_person_reads_the_verdict_first(joint: Path, capsys):
    assert main(["compare", str(joint), "--structures", "pd", "--no-bound"]) == 0
    told = capsys.readouterr().out
    found = gr.compare(*[parse_comparison(JOINT, "")[0], ["pd"]], settings=parse_comparison(JOINT, "")[1])
    (pd,) = found.rows
    assert f"With PD a load moves the link by up to {1e3 * pd.worst:.3g} mrad/N·m" in " ".join(told.split())
    assert winner(found) is pd
    assert "Use PD, in" in told
    assert f"kp: {pd.parameters['kp']:.7g}" in told
    assert "--torque-sensor 0.05" in told
    assert "Assumed: the encoder's step is 7.67·10⁻⁶ rad" in told  # 2π/2¹³ behind 100:1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("--structures", "pd,spilt"),
            "--structures: structure 'spilt' must be one of pd, pid, ppi, dob, split, torque_feedback, observer; the nearest is split",
        ),
        (("--structures", "h-infinity"), "'h-infinity' must be one of pd, pid, ppi, dob, split, torque_feedback, observer\n"),
        (("--structures", "pd+lead"), "--structures: structure 'pd+lead': 'lead' must be biquad or 2biquads"),
        (
            ("--structures", "torque_feedback"),
            "needs compare.sensors.torque_noise, or --torque-sensor: the noise of the joint's torque sensor [N·m]",
        ),
        (("--torque-sensor", "0"), "--torque-sensor: noise 0 N·m must be a number > 0"),
        (("--noise", "-1"), "--noise: torque noise -1 N·m must be a number > 0"),
        (("--noise", "loud"), "'loud' must be a number in N·m, without the unit"),
        (("--objective", "stiffness"), "--objective stiffness: must be dynamic_stiffness, white_load or step_load"),
        (("--best-known", "--no-bound"), "the best known controller stands beside the bound: it needs that"),
        (("--take", "pd"), "--take pd: is for --write, which names the file"),
        (("--write", "better.yaml", "--take", "pid", "--structures", "pd"), "--take pid: must be one of --structures pd"),
        (("--write", "better.txt"), "better.txt: --write must end in .yaml"),
        (("--joint", "knee"), "joint 'knee': names one of a robot's joints, and this is a single joint"),
    ],
)
def test_calls_that_are_wrong(words: tuple[str, ...], message: str, joint: Path, capsys):
    assert message in refused(capsys, "compare", joint, *words) + "\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  sample_rate_hz: 2000\n", "", "control.sample_rate_hz is missing: structures are compared as they run, sampled"),
        ("link_inertia: 16.0", "link_inertia: .inf", "a comparison needs a link that a load can move"),
        ("limits:", "compare: {structures: [pd, obsever]}\nlimits:", "compare.structures[1]: structure 'obsever' must be one of"),
        ("limits:", "compare: {sensors: {torque: 0.1}}\nlimits:", "compare.sensors.torque: unknown key; did you mean torque_noise?"),
        ("limits:", "compare: {objective: stiffness}\nlimits:", "compare.objective: 'stiffness' must be dynamic_stiffness"),
        ("limits:", "compare: {objective: low_frequency_compliance}\nlimits:", "compare.below_hz is missing: the highest frequency [Hz]"),
        ("limits:", "compare: {below_hz: 3}\nlimits:", "compare.below_hz: is for the objective low_frequency_compliance only"),
    ],
)
def test_files_that_do_not_fit(old: str, new: str, message: str, joint: Path, capsys):
    assert old in JOINT
    joint.write_text(JOINT.replace(old, new).replace("uncertainty: {link_inertia: [8.0, 24.0], stiffness: 20%}", ""), "utf-8")
    assert message in refused(capsys, "compare", joint).replace(" is for the objective", ": is for the objective").replace("::", ":")


def test_the_section_is_read(tmp_path: Path):
    """Steps of encoders become standard deviations, frequencies rad/s, and what the file has is not assumed."""
    section = """\
compare:
  objective: low_frequency_compliance
  below_hz: 3
  structures: [pd, {pd: {biquads: 1}}]
  sensors: {motor_resolution: 1.2e-5, torque_noise: 0.05}
  drive_path: {delay_ms: 0.2, sample_rate_hz: 10000}
"""
    _, settings = parse_comparison(JOINT + section, "joint.yaml")
    assert settings.objective.name == "low_frequency_compliance"
    assert settings.objective.below == pytest.approx(2 * math.pi * 3)
    assert settings.sensor_noise == {"motor": pytest.approx(1.2e-5 / math.sqrt(12)), "torque": 0.05}
    assert settings.structures == ("pd", {"pd": {"biquads": 1}})
    assert settings.path == gr.GainPath(2e-4, 1e-4)
    _, assumed = parse_comparison(JOINT, "joint.yaml")
    assert assumed.sensor_noise == {"motor": pytest.approx(2 * math.pi / 8192 / 100 / math.sqrt(12))}
    assert parse_comparison(JOINT.replace("delay_ms: 2.0", "delay_ms: 2.0, encoder_resolution: 1.0e-5"), "")[1].sensor_noise == {}
