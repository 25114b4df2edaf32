"""Where the gains run: `kd_path` and `command_delay_ms` in files, `--gains-run` in audit; and what a delay of set-points alone is worth."""

import json
from pathlib import Path

import numpy as np
import pytest
from pytest import approx

import gainroom as gr
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.joint_yaml import parse_joint, parse_simulation
from gainroom.files.robot_yaml import load_robot_system
from robot_files import ROBOT, write_arm

JOINT = """\
joint: {motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1.0e4, damping: 1.0}
drive: {bandwidth: 4000.0, delay_ms: 4.0, command_delay_ms: 7.0}
control: {type: pd, kp: 3000.0, kd: 300.0, feedback: motor, sample_rate_hz: 500, kd_path: {delay_ms: 0.0, sample_rate_hz: 20000}}
"""
SPLIT = ("--rate-hz", "500", "--gains-run", "split", "--drive-rate-hz", "20000", "--drive-delay-ms", "0.05")
ON_DRIVE = ("--gains-run", "drive", "--drive-rate-hz", "20000", "--drive-delay-ms", "0.05")


def test_the_paths_of_a_joint_arrive_in_si():
    system = parse_joint(JOINT, "knee.yaml", two_paths=True)
    assert system.control.kd_path == gr.GainPath(0.0, 1 / 20000)
    assert system.control.command_delay == approx(7e-3)
    assert system.drives[0].delay == approx(4e-3)
    loop = system.loop()
    assert loop.kd_path == system.control.kd_path
    assert gr.is_stable(loop)
    assert not gr.is_stable(parse_joint(JOINT.replace(", kd_path: {delay_ms: 0.0, sample_rate_hz: 20000}", ""), "knee.yaml").loop())


def test_the_paths_of_a_robot_arrive_in_si(tmp_path: Path):
    text = ROBOT.replace("kd: 30.0}", "kd: 30.0, kd_path: {delay_ms: 0.1, sample_rate_hz: 10000}}").replace(
        "delay_ms: 2.0}", "delay_ms: 2.0, command_delay_ms: 3.0}"
    )
    system = load_robot_system(write_arm(tmp_path, text), two_paths=True)
    assert system.control.kd_path == gr.GainPath(1e-4, 1e-4)
    assert system.control.command_delay == approx(3e-3)
    assert system.loop().kd_path == system.control.kd_path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "sample_rate_hz: 20000}}",
            "sample_rate_hz: 20001}}",
            "control.kd_path.sample_rate_hz: the rates of kd, 20001 Hz, and of the other gains, 500 Hz",
        ),
        ("delay_ms: 0.0, sample_rate_hz: 20000", "delay_ms: 0.0", "control.kd_path.sample_rate_hz is missing"),
        ("delay_ms: 0.0, sample_rate_hz: 20000", "sample_rate_hz: 20000", "control.kd_path.delay_ms is missing"),
        ("{delay_ms: 0.0,", "{delay_ms: -1.0,", "control.kd_path.delay_ms: -1.0 must be >= 0"),
        ("{delay_ms: 0.0,", "{delay_ms: 51.0,", "control.kd_path.delay_ms: 51 ms must be <= 50 ms, 1000 ticks at 20000 Hz"),
        ("{delay_ms: 0.0,", "{delay_ms: 0.0, rate: 3,", "control.kd_path.rate"),
        ("sample_rate_hz: 500, ", "", "control.sample_rate_hz is missing: the rate of the other gains"),
        ("type: pd, kp: 3000.0, kd: 300.0", "type: ppi, kp: 3.0, kv: 300.0, ki: 1.0", "control.kd_path has no meaning for type ppi"),
        ("command_delay_ms: 7.0", "command_delay_ms: 7 ms", "drive.command_delay_ms"),
        ("command_delay_ms: 7.0", "command_delay_ms: -7", "drive.command_delay_ms: -7 must be >= 0"),
        ("feedback: motor,", "feedback: motor, velocity_filter: {bandwidth_hz: 10001},", "control.velocity_filter.bandwidth_hz: 10001 Hz"),
        ("feedback: motor,", "feedback: motor, notches: [{frequency_hz: 251}],", "control.notches[0].frequency_hz: 251 Hz"),
    ],
)
def test_bad_input_is_named_in_one_line(old: str, new: str, said: str):
    assert old in JOINT
    with pytest.raises(GainroomError) as caught:
        parse_joint(JOINT.replace(old, new), "knee.yaml", two_paths=True)
    message = str(caught.value)
    assert message.startswith(f"knee.yaml: {said}")
    assert "\n" not in message


def test_a_filter_of_the_velocity_runs_at_the_rate_of_kd():
    text = JOINT.replace("feedback: motor,", "feedback: motor, velocity_filter: {bandwidth_hz: 2000},")
    assert gr.is_stable(parse_joint(text, "knee.yaml", two_paths=True).loop())


def test_what_knows_one_path_only_refuses_two(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Reading it as one path for all would be a wrong answer."""
    path = tmp_path / "knee.yaml"
    path.write_text(JOINT, "utf-8")
    assert main(["identify", "plan", str(path)]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "control.kd_path: is known to" in message
    for read in (parse_joint, parse_simulation):
        with pytest.raises(GainroomError, match="kd_path"):
            read(JOINT, "knee.yaml")
    with pytest.raises(GainroomError, match="kd_path"):
        gr.load_robot(write_arm(tmp_path, ROBOT.replace("kd: 30.0}", "kd: 30.0, kd_path: {delay_ms: 0.1, sample_rate_hz: 10000}}")))


def test_a_joint_of_two_paths_vibrates_in_simulation_where_it_is_predicted(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The lifted loop's limit against runs of the testbed, which knows nothing of it."""
    path = tmp_path / "knee.yaml"
    path.write_text(JOINT, "utf-8")
    assert main(["verify", str(path), "--json"]) == 0
    (case,) = json.loads(capsys.readouterr().out)["cases"]
    assert case["simulated_gain"] == pytest.approx(case["predicted_gain"], rel=1e-4)
    assert case["simulated_frequency_rad_s"] == pytest.approx(case["predicted_frequency_rad_s"], rel=1e-4)


def test_no_margin_depends_on_the_delay_of_set_points():
    text = JOINT.replace(", kd_path: {delay_ms: 0.0, sample_rate_hz: 20000}", "").replace("kd: 300", "kd: 60")
    late, at_once = (gr.margins(parse_joint(text.replace("7.0", delay), "knee.yaml").loop()) for delay in ("50.0", "0.0"))
    assert late.stable
    assert repr(late) == repr(at_once)


@pytest.fixture
def told(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """What `audit --json` says of the arm, and its exit status."""
    write_arm(tmp_path)

    def run(*options: str, kp: float = 2000.0, kd: float = 120.0) -> tuple[dict, int]:
        gains = tmp_path / "gains.yaml"
        gains.write_text(f'".*": {{kp: {kp}, kd: {kd}, motor_inertia: 0.5}}', "utf-8")
        machine = ("--stiffness", "8000", "--damping", "4", "--bandwidth", "4000")
        status = main(["audit", str(tmp_path / "robot.urdf"), "--gains", str(gains), *machine, *options, "--json"])
        return json.loads(capsys.readouterr().out), status

    return run


@pytest.mark.slow
def test_the_three_cases_of_one_robot(told):
    """The same gains, the same 4 ms of bus: lost on the host, safe where kd or both run on the drive."""
    (host, bad), (split, good), (drive, fine) = (told("--delay-ms", "4", *options) for options in (("--rate-hz", "500"), SPLIT, ON_DRIVE))
    assert (bad, good, fine) == (1, 0, 0)
    assert (host["stable"], split["stable"], drive["stable"]) == (False, True, True)
    assert (host["delay_ms"], split["delay_ms"], drive["delay_ms"]) == approx((4.0, 4.0, 0.05))
    assert (host["command_delay_ms"], split["command_delay_ms"], drive["command_delay_ms"]) == (0.0, 0.0, 4.0)
    assert split["kd_path"] == approx({"delay_ms": 0.05, "sample_rate_hz": 20000.0})
    assert [one["assumptions"][0].partition(":")[0].partition(" at ")[0] for one in (host, split, drive)] == [
        "kp and kd run on the host",
        "kd runs on the drives",
        "kp and kd run on the drives",
    ]
    assert "--gains-run drive, or split" in host["assumptions"][0]  # it was not said, so it is asked


def test_on_the_drive_the_bus_costs_nothing(told):
    """As gains on a host with the drive's own delay and rate would be, whatever the bus has."""
    (drive, _), (slow, _) = (told("--delay-ms", bus, *ON_DRIVE) for bus in ("4", "400"))
    host, _ = told("--delay-ms", "0.05", "--rate-hz", "20000")
    for key in ("gain_limit", "limit_frequency_rad_s", "delay_limit_ms", "joints", "states"):
        assert drive[key] == slow[key] == host[key], key


@pytest.mark.slow
def test_a_split_audit_is_that_of_the_loop(told, tmp_path: Path):
    split, _ = told("--delay-ms", "4", *SPLIT)
    text = ROBOT.replace("sample_rate_hz: 2000, kp: 400.0, kd: 30.0", "sample_rate_hz: 500, kp: 2000.0, kd: 120.0")
    text = text.replace("delay_ms: 2.0", "delay_ms: 4.0").replace("bent: {shoulder: 0.4, elbow: 0.9}", "straight: {}")
    text = text.replace("control: {", "control: {kd_path: {delay_ms: 0.05, sample_rate_hz: 20000}, ")
    text = text.replace("{file: robot.urdf, base: fixed}", "{file: robot.urdf, base: fixed, gravity_stiffness: false}")
    system = load_robot_system(write_arm(tmp_path, text), two_paths=True)
    found = gr.joint_margins(system.loop())
    assert split["gain_limit"] == approx(found.limit.gain, rel=1e-9)
    assert found.paths is not None
    assert split["path_gain_limits"]["kp"] == approx([found.paths.lower_others, found.paths.others], rel=1e-9)
    below, above = (system.with_values(delay=1e-3 * split["delay_limit_ms"] * (1 + side * 1e-6)).loop() for side in (-1, 1))
    assert (gr.is_stable(below), gr.is_stable(above)) == (True, False)


@pytest.mark.population
def test_a_kp_near_its_limit_is_not_safe_though_both_gains_together_may_rise(told):
    """Scaled together the gains may rise 18 times: kd carries kp. Alone kp may not rise by half."""
    (near, status), (low, _) = (told("--delay-ms", "4", *SPLIT, kp=kp) for kp in (18000.0, 6000.0))
    assert near["stable"]
    assert near["gain_limit"] > 10
    assert near["path_gain_limits"]["kp"][1] < 1.5
    assert not near["requirements_met"]
    assert status == 1
    assert "kp alone" in near["sentence"] or "kd alone" in near["sentence"]
    assert near["path_gain_limits"]["kp"][1] * 18000 == approx(
        low["path_gain_limits"]["kp"][1] * 6000, rel=1e-6
    )  # the same kp is the limit
    assert low["requirements_met"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--gains-run", "bus"), "--gains-run bus: must be host, drive or split"),
        (("--gains-run", "split", "--rate-hz", "500", "--drive-rate-hz", "20000"), "--gains-run split: needs --drive-delay-ms"),
        (("--gains-run", "drive", "--drive-delay-ms", "0.1"), "--gains-run drive: needs --drive-rate-hz"),
        (("--drive-delay-ms", "0.1"), "--drive-delay-ms 0.1: is of gains that run on the drive"),
        (("--gains-run", "host", "--drive-rate-hz", "1000"), "--drive-rate-hz 1000: is of gains that run on the drive"),
        ((*ON_DRIVE, "--rate-hz", "500"), "--rate-hz 500: no gain runs on the host"),
        (SPLIT[2:], "--gains-run split: needs --rate-hz"),
        (
            (*SPLIT[:4], "--drive-rate-hz", "20001", "--drive-delay-ms", "0"),
            "--drive-rate-hz: the rates of kd, 20001 Hz, and of the other gains, 500 Hz, must have a ratio of small whole numbers",
        ),
        ((*SPLIT[:4], "--drive-rate-hz", "2e7", "--drive-delay-ms", "0"), "--drive-rate-hz: 20000000.0 must be <= 1e+06 Hz"),
        ((*SPLIT[:4], "--drive-rate-hz", "20000", "--drive-delay-ms", "-1"), "--drive-delay-ms: -1.0 must be >= 0 ms"),
        ((*ON_DRIVE[:4], "--drive-delay-ms", "80"), "--drive-delay-ms: 80 ms must be <= 50 ms, 1000 ticks at 20000 Hz"),
    ],
)
def test_wrong_calls_are_named_in_one_line(options: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_arm(tmp_path)
    (tmp_path / "gains.yaml").write_text('".*": {kp: 400, kd: 30, motor_inertia: 0.5}', "utf-8")
    call = ["audit", str(tmp_path / "robot.urdf"), "--gains", str(tmp_path / "gains.yaml"), "--delay-ms", "4", *options]
    assert main(call) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert said in captured.err


def told_of(call: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[dict, int]:
    status = main([*call, "--json"])
    return json.loads(capsys.readouterr().out), status


@pytest.mark.slow
def test_a_joint_of_two_paths_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "knee.yaml"
    path.write_text(JOINT, "utf-8")
    facts, status = told_of(["joint", str(path)], capsys)
    found = gr.margins(parse_joint(JOINT, "knee.yaml", two_paths=True).loop())
    assert found.paths is not None
    assert (status, facts["verdict"], facts["not_known"]) == (0, "safe", [])
    assert facts["required"]["peak_sensitivity"] == 2  # as of any joint
    assert facts["worst"]["peak_sensitivity"]["value"] == found.peak_sensitivity
    assert facts["gain_limit"] == found.gain_margin
    (state,) = facts["states"]
    assert state["margins"]["peak_sensitivity"] == found.peak_sensitivity
    assert state["kp_gain_limits"] == [found.paths.lower_others, found.paths.others]
    assert state["kd_gain_limits"] == [found.paths.lower_kd, found.paths.kd]
    assert state["phase_margin_deg"] == approx(np.degrees(abs(found.phase_margin)))
    assert main(["joint", str(path)]) == 0
    terminal = " ".join(capsys.readouterr().out.split())
    assert terminal.startswith("Safe: every requirement is met. Vibration starts at 17.9 × kp and kd together")
    assert "peak sensitivity 1." in terminal
    path.write_text(f"{JOINT}limits: {{gain_margin_db: 6, peak_sensitivity: 1.1}}\n", "utf-8")
    facts, status = told_of(["joint", str(path)], capsys)
    assert found.peak_sensitivity > 1.1
    assert (status, facts["verdict"], facts["unmet"]) == (1, "unsafe", ["peak_sensitivity"])
    assert main(["joint", str(path), "--report", str(tmp_path / "page.html")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "page.html").exists()


@pytest.mark.slow
def test_a_period_too_long_for_ms_leaves_the_answer_open(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch):
    """What is asked for and not known is not decided."""
    monkeypatch.setattr("gainroom.analysis.multirate.MOST_HOLDS", 10)
    path = tmp_path / "knee.yaml"
    path.write_text(JOINT, "utf-8")
    facts, status = told_of(["joint", str(path)], capsys)
    assert (status, facts["verdict"], facts["not_known"]) == (3, "undecided", ["peak_sensitivity"])
    assert facts["requirements_met"] is None
    assert main(["joint", str(path)]) == 3
    assert " ".join(capsys.readouterr().out.split()).startswith("Not decided: peak sensitivity not known. The gains are stable.")


@pytest.mark.slow
def test_the_range_of_a_joint_of_two_paths_is_judged_at_its_worst(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "knee.yaml"
    stiff = JOINT.replace("kp: 3000", "kp: 20000").replace("sample_rate_hz: 20000", "sample_rate_hz: 4000")  # fewer ticks in a period
    limits = "limits: {phase_margin_deg: 11.0}\nuncertainty: {delay_ms: [4.0, 5.0]}\n"
    path.write_text(stiff + limits, "utf-8")
    facts, status = told_of(["joint", str(path)], capsys)
    late = parse_joint(stiff.replace("delay_ms: 4.0, ", "delay_ms: 5.0, "), "knee.yaml", two_paths=True)
    worst = np.degrees(abs(gr.margins(late.loop()).phase_margin))
    assert status == 1
    assert worst < 11 < facts["states"][0]["phase_margin_deg"]  # nominally met
    assert facts["worst"]["phase_margin"]["value"] == approx(worst)
    assert facts["unmet"] == ["phase_margin"]
    assert facts["requirements_met"] is False
    assert facts["sentence"].startswith("Not safe: stable, but 1 requirement fails: phase margin ")
    path.write_text(stiff + "uncertainty: {delay_ms: [4.0, 15.0]}\n", "utf-8")  # past kp's own delay limit
    facts, status = told_of(["joint", str(path)], capsys)
    assert (facts["stable"], facts["stable_in_range"], status) == (True, False, 1)


def test_a_joint_of_two_paths_that_is_unstable(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "knee.yaml"
    path.write_text(JOINT.replace("kp: 3000", "kp: 90000"), "utf-8")
    facts, status = told_of(["joint", str(path)], capsys)
    assert (facts["stable"], status) == (False, 1)
    assert facts["sentence"].startswith("Not safe: unstable")
    assert facts["unmet"] == []


@pytest.mark.population
def test_a_robot_of_two_paths_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = ROBOT.replace("sample_rate_hz: 2000", "sample_rate_hz: 500").replace(
        "kd: 30.0}", "kd: 30.0, kd_path: {delay_ms: 0.1, sample_rate_hz: 10000}}"
    )
    path = write_arm(tmp_path, text)
    facts, status = told_of(["robot", str(path)], capsys)
    system = load_robot_system(path, two_paths=True)
    assert facts["gain_limit"] == gr.gain_limit(system.loop()).gain
    assert facts["stable"] == (status == 0)
    assert [state["state"] for state in facts["states"]] == [f"{posture}/{contact}" for posture, contact in system.source.states]
    assert main(["robot", str(path)]) == status
    assert "kp alone" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--rate-hz", "500"), "kp and kd run on the host (--gains-run)"),
        (SPLIT, "kd runs on the drives, kp on the host (--gains-run)"),
        (ON_DRIVE, "kp and kd run on the drives (--gains-run)"),
    ],
    ids=["host", "split", "drive"],
)
def test_the_first_screen_says_where_the_gains_run(options: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_arm(tmp_path)
    (tmp_path / "gains.yaml").write_text('".*": {kp: 400, kd: 30, motor_inertia: 0.5}', "utf-8")
    main(["audit", str(tmp_path / "robot.urdf"), "--gains", str(tmp_path / "gains.yaml"), "--delay-ms", "0", *options])
    assert said in " ".join(capsys.readouterr().out.split())


RANGES = "uncertainty: {stiffness: [8000, 12000], link_inertia: [8, 24]}\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gains", "ranges"),
    [
        ("3000.0, kd: 300.0", ""),
        ("3000.0, kd: 1.0", RANGES),
        pytest.param("3800.0, kd: 200.0", RANGES, marks=pytest.mark.slow),
        pytest.param("20000.0, kd: 3000.0", "", marks=pytest.mark.slow),
    ],
    ids=["safe", "unstable", "missed in the ranges", "missed"],
)
def test_a_joint_of_two_paths_is_judged_alike_by_joint_and_simulate(gains, ranges, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Level and findings; a run that vibrates is one more."""
    path = tmp_path / "knee.yaml"
    path.write_text(JOINT.replace("3000.0, kd: 300.0", gains) + ranges, "utf-8")
    judged = {}
    for command in ("joint", "simulate"):
        status = main([command, str(path), "--json"])
        facts = json.loads(capsys.readouterr().out)
        judged[command] = status, facts["verdict"], {one["code"] for one in facts["findings"]} - {"vibrates"}
    assert judged["joint"] == judged["simulate"]
