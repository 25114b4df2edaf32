"""Gearboxes by type: an audit at the worst of their range, against a dense scan with another formula; and what is said of it."""

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

import gainroom as gr
from gainroom.cli import main
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.files.robot_yaml import parse_robot
from gainroom.robot.gearbox_types import TYPES, ranges_of
from gainroom.studies.state import State
from gainroom.studies.worst_place import OverRange, Tried, try_places
from gearbox_truths import MARGIN, continuous_limit, has_margin

LEG = str(Path(__file__).parents[1] / "examples" / "robot.xml")


def looked_over(joint: gr.ElasticJoint, kp: float, kd: float, delay: float, step: float | None, kind: str) -> OverRange:
    drive = gr.Drive(bandwidth=math.inf, damping_ratio=1.0, delay=delay)
    required, ranges = gr.Requirements(gain_margin=MARGIN), gr.Uncertainty(**ranges_of((kind,), (joint.motor_inertia,), (0.0,)))
    system = gr.System.of_joint(joint, drive, gr.PD(kp, kd), "motor", step, requirements=required, uncertainty=ranges)
    return try_places(system, [State(system, "", "", system.source.linearize())])


def limit_of(tried: Tried) -> float:
    """The factor on all gains: the shortfall is of the gain margin alone."""
    return MARGIN / math.exp(tried.shortfall)


def geared(rigid: gr.ElasticJoint, resonance: float, ratio: float) -> gr.ElasticJoint:
    inertia = rigid.motor_inertia
    return gr.ElasticJoint(inertia, rigid.link_inertia, inertia * resonance**2, 2 * ratio * inertia * resonance)


def population(step: float | None, seed: int, count: int) -> list[tuple]:
    random, found = np.random.default_rng(seed), []
    for _ in range(count):
        inertia, load = 10 ** random.uniform(-2.5, 0.5), 10 ** random.uniform(-0.7, 1.5)
        delay = 1e-3 * int(random.integers(1, 6))
        kd = inertia * 10 ** random.uniform(0.5, 2.2)
        joint = gr.ElasticJoint(motor_inertia=inertia, link_inertia=inertia * load)
        found.append((joint, kd * 10 ** random.uniform(0, 1.3), kd, delay, step, random.choice([*TYPES])))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("count", [7, pytest.param(14, marks=pytest.mark.population)])
def test_nothing_in_the_range_is_worse_than_what_was_found(count: int):
    """A population, 40 resonances with three dampings each by the loop's closed form. Between looks the limit may lie 1 % lower."""
    unsafe = 0
    for joint, kp, kd, delay, step, kind in population(None, 3, count):
        over = looked_over(joint, kp, kd, delay, step, kind)
        scanned = [
            continuous_limit(geared(joint, resonance, ratio), kp, kd, delay)
            for resonance in np.geomspace(*TYPES[kind].resonance, 40)
            for ratio in np.geomspace(*TYPES[kind].damping_ratio, 3)
        ]
        assert limit_of(over.worst) == pytest.approx(min(scanned), rel=0.01), (joint, kp, kd, delay, kind)
        assert limit_of(over.worst) == pytest.approx(continuous_limit(over.worst.system.source, kp, kd, delay), rel=1e-3)
        assert over.safe == all(limit_of(one) >= MARGIN for one in over.tried)
        unsafe += not over.safe
    assert count / 7 < unsafe < 6 * count / 7  # or this shows nothing


@pytest.mark.slow
def test_sampled_ranges_that_are_safe_are():
    """By the eigenvalues of a tick, with 1 % less than the margin."""
    safe = 0
    for joint, kp, kd, delay, step, kind in population(1e-3, 5, 16):
        over = looked_over(joint, kp, kd, delay, step, kind)
        if over.safe:
            safe += 1
            for resonance in np.geomspace(*TYPES[kind].resonance, 40):
                for ratio in TYPES[kind].damping_ratio:
                    assert has_margin(geared(joint, resonance, ratio), kp, kd, delay, step, 0.99 * MARGIN)
        else:
            assert not has_margin(over.worst.system.source, kp, kd, delay, step, MARGIN)
    assert 2 < safe < 14


def asked(capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, dict]:
    status = main(["audit", LEG, "--delay-ms", "0.5", "--rate-hz", "2000", *options, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_the_audit_is_one_of_the_worst_gearboxes(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Typed joint by joint, they give the same answer; headline and assumptions say what it is of."""
    status, told = asked(capsys, "--gearbox", "harmonic", "--gearbox", "ankle=planetary", "--gearbox", "hip_.*=direct")
    found = told["gearbox_range"]
    assert (status, told["safe"]) == (1, False)
    assert {row["name"]: row["type"] for row in found["joints"]} == {"knee": "harmonic", "ankle": "planetary"}
    assert told["sentence"].startswith("Not safe: unstable in the range of harmonic and planetary gearboxes with 0.5 ms of delay")
    assert " not safe. With the worst of these gearboxes (K " in told["sentence"]
    for kind in ("harmonic", "planetary"):
        assert any(text.startswith(f"{kind} gearboxes: ") and TYPES[kind].source in text for text in told["assumptions"])
    rows = {}
    for joint in told["joints"]:
        rows[joint["name"]] = {name: joint[name] for name in ("kp", "kd", "motor_inertia")}
    for row in found["joints"]:
        inertia = rows[row["name"]]["motor_inertia"]
        kind = TYPES[row["type"]]
        assert row["stiffness"] == pytest.approx([inertia * end**2 for end in kind.resonance])
        assert row["stiffness"][0] <= row["worst_stiffness"] * (1 + 1e-12)
        assert row["worst_stiffness"] <= row["stiffness"][1] * (1 + 1e-12)
        rows[row["name"]] |= {"stiffness": row["worst_stiffness"], "damping": row["worst_damping"]}
    gains = tmp_path / "gains.yaml"
    gains.write_text(yaml.safe_dump(rows), "utf-8")
    _, again = asked(capsys, "--gains", str(gains))
    for key in ("gain_limit", "delay_limit_ms", "safe", "limiting_joints"):
        assert again[key] == told[key]


@pytest.mark.slow
def test_stiffness_that_is_known_stays(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """A type of all joints that the file knows better of one is an error; of the others by name it is their range alone."""
    gains = tmp_path / "gains.yaml"
    gains.write_text(
        "{default: {kp: 98.7, kd: 6.28, motor_inertia: 0.025}, knee: {kp: 98.7, kd: 6.28, stiffness: 900, damping: 3}}", "utf-8"
    )
    assert main(["audit", LEG, "--delay-ms", "2", "--gains", str(gains), "--gearbox", "harmonic"]) == 2
    assert f"--gearbox harmonic: {gains} has the stiffness of knee: leave one out" in capsys.readouterr().err
    _, told = asked(capsys, "--gains", str(gains), "--gearbox", "hip.*=harmonic")
    assert "knee" not in {row["name"] for row in told["gearbox_range"]["joints"]}
    assert not any("--gearbox has no effect" in text for text in told["warnings"])


@pytest.mark.slow
def test_advice_over_a_range_ends_in_one_round(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The robot that is written has the types; what is recommended for it is judged over them, and the same audit calls it safe."""
    monkeypatch.chdir(tmp_path)
    call = ("--gearbox", "harmonic", "--delay-ms", "1")
    status, told = asked(capsys, *call, "--write-robot", "robot.yaml")
    assert (status, told["to_use"]) == (1, None)  # no common factor is enough
    assert {yaml.safe_load(Path("robot.yaml").read_text("utf-8"))["joints"][row["name"]]["gearbox"] for row in told["joints"]} == {
        "harmonic"
    }
    assert main(["robot", "robot.yaml", "--json"]) == 1
    Path("found.json").write_text(answer := capsys.readouterr().out, "utf-8")
    ranges = json.loads(answer)["gearbox_range"]["joints"]
    assert [{**row, **end} for row, end in zip(told["gearbox_range"]["joints"], ranges, strict=True)] == told["gearbox_range"]["joints"]
    assert main(["robot", "robot.yaml"]) == 1
    assert "--gearbox '.*=harmonic' --gains found.json" in " ".join(capsys.readouterr().out.split())
    for given in (call, ("--delay-ms", "1")):  # the types go along
        status, again = asked(capsys, *given, "--gains", "found.json")
        assert (status, again["verdict"]) == (0, "safe")
        assert again["gearbox_range"]["mixed_looks"] > 12
        assert "range_sampled" in {one["code"] for one in again["findings"]}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--gearbox", "harmnic"), ["--gearbox harmnic", "did you mean 'harmonic'", "direct"]),
        (("--gearbox", "nee=belt"), ["--gearbox nee=belt", "'nee'"]),
        (("--gearbox", "belt", "--stiffness", "3000"), ["--gearbox", "--stiffness"]),
    ],
)
def test_what_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], words: list[str]
):
    monkeypatch.chdir(tmp_path)
    assert main(["audit", LEG, "--delay-ms", "0.5", *options]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert all(word in line for word in words), line


@pytest.mark.slow
def test_a_range_is_safe_at_its_corners_where_it_is_called_safe(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Every gearbox at an end of its own, by certified limits: one that differs from all others may be the worst."""
    gains, verdicts = tmp_path / "gains.yaml", set()
    names = [joint["name"] for joint in asked(capsys)[1]["joints"]]
    for scale in (0.4, 1.6, 3.2, 6.4):
        rows = {name: {"kp": scale * 300, "kd": scale * 12, "motor_inertia": 0.05} for name in names}
        gains.write_text(yaml.safe_dump(rows), "utf-8")
        _, told = asked(capsys, "--gains", str(gains), "--gearbox", "harmonic", "--phase-margin-deg", "1", "--peak-sensitivity", "100")
        verdicts.add(told["safe"])
        if not told["safe"]:
            continue
        ends = [row["stiffness"] for row in told["gearbox_range"]["joints"]]
        system = audited(LEG, gains, AuditOptions(0.5, rate_hz=2000.0, stiffness=1.0, damping=1.0)).system
        for stiffness in itertools.product(*ends):
            damping = [2 * TYPES["harmonic"].damping_ratio[0] * math.sqrt(0.05 * one) for one in stiffness]
            geared = system.with_values(stiffness=np.array(stiffness), damping=np.array(damping))
            assert gr.gain_limit(geared.loop(geared.source.linearize(*geared.source.states[0]))).gain > MARGIN * (1 - 0.01)
    assert verdicts == {True, False}


def test_a_joint_that_fails_elsewhere_than_at_the_worst_place_is_not_safe(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """The hips are worst on the softest gearboxes; the ankle fails on the stiffest alone, by the audit of those."""
    rows = "{kp: 20, kd: 1.5, stiffness: %s, damping: %s, motor_inertia: 0.0072}"
    (tmp_path / "soft.yaml").write_text("default: {kp: 20, kd: 1.5}", "utf-8")
    _, told = asked(capsys, "--delay-ms", "1.5", "--gains", str(tmp_path / "soft.yaml"), "--gearbox", "harmonic")
    ankle = next(row for row in told["joints"] if row["name"] == "ankle")
    assert (ankle["safe"], ankle["unmet"]) == (False, [])
    stiff, damped = 0.0072 * 270.0**2, 2 * 0.005 * 0.0072 * 270.0
    others = 0.025 * 270.0**2, 2 * 0.005 * 0.025 * 270.0
    text = f"default: {(rows % others).replace('0.0072', '0.025')}\nankle: {rows % (stiff, damped)}"
    (tmp_path / "stiff.yaml").write_text(text, "utf-8")
    _, there = asked(capsys, "--delay-ms", "1.5", "--gains", str(tmp_path / "stiff.yaml"))
    assert "peak_sensitivity" in next(row for row in there["joints"] if row["name"] == "ankle")["unmet"]


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        ("{gearbox: rubber}", ["joints.default.gearbox", "harmonic", "direct"]),
        ("{gearbox: belt, stiffness: 100}", ["joints.default.gearbox", "stiffness", "either"]),
    ],
)
def test_a_type_in_a_robot_yaml_is_one_of_those_and_no_number(joint: str, words: list[str]):
    text = f"model: {{file: {LEG}}}\njoints: {{default: {joint}}}\ndrive: {{bandwidth: .inf, delay_ms: 1}}\n"
    with pytest.raises(gr.GainroomError) as caught:
        parse_robot(text + "control: {type: pd, feedback: motor, kp: 20, kd: 1.5, sample_rate_hz: 2000}", "robot.yaml")
    assert all(word in str(caught.value) for word in words), caught.value
