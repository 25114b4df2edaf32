"""Files of every kind, drawn with a seed, are judged the same by every command that judges them: level, findings, exit status.

A finding is the same where its code, level, joints and numbers are, to 1e-6 of a number: commands reach it on different ways, but the
limits and margins that they end with are found to 1e-8 or better.
"""

import csv
import json
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pinocchio")

from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.studies.verdict import RISING, STATUS
from judged_files import AUDITS, JOINTS, ROBOTS, as_robot, drawn_audit, drawn_joint, drawn_robot, written

OF_A_RUN = ("vibrates", "diverged", "fell", "ran_away")
"""Findings that a simulated run adds, by code."""
QUICK = 4
"""Joints, robots and audits each that are judged every time, drawn from all."""


def drawn(kinds: Mapping[str, Any], seed: int) -> list[Any]:
    """All kinds, of which a share is not slow."""
    share = random.Random(seed).sample([*kinds], QUICK)
    return [pytest.param(kind, marks=() if kind in share else pytest.mark.slow) for kind in kinds]


def judged(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any] | None:
    """What --json says, where the exit status is that of the verdict; None where the command does not take the file."""
    status = main([*map(str, words), "--json"])
    out, err = capsys.readouterr()
    if status == 2:
        assert err.startswith("gainroom:"), err
        return None
    facts = json.loads(out)
    assert status == STATUS[facts["verdict"]]
    return facts


NUDGED = 2e-6
"""Relative: a sweep's limits lie a millionth below what was found, as far as they are proved; others are found to 1e-8 or better."""


def same(first: dict[str, Any], second: dict[str, Any]):
    """Two findings of one code."""
    assert first["level"] == second["level"], (first, second)
    assert first["joints"] == second["joints"], (first, second)
    for key in first.keys() & second.keys() - {"code", "level", "joints", "state", "remedy"}:
        one, other = first[key], second[key]
        assert one == other or (one is not None and other is not None and other == pytest.approx(one, rel=NUDGED)), (key, first, second)


def agree(first: dict[str, Any], second: dict[str, Any], without: tuple[str, ...] = ()):
    """Two answers about one state: finding by finding the same but for codes `without`, so the same level where there are none of those."""
    ours, theirs = ([one for one in facts["findings"] if one["code"] not in without] for facts in (first, second))
    assert sorted(one["code"] for one in ours) == sorted(one["code"] for one in theirs)
    for one in ours:
        same(one, next(other for other in theirs if other["code"] == one["code"]))
    if len(theirs) == len(second["findings"]):
        assert first["verdict"] == second["verdict"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", drawn(JOINTS, 57))
def test_a_joint(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = written(tmp_path, drawn_joint(kind), "joint.yaml")
    found = judged(capsys, "joint", file)
    assert found is not None
    run = judged(capsys, "simulate", file)
    control = drawn_joint(kind)["control"]
    assert (run is None) == ("sample_rate_hz" not in control)
    if run is not None:
        agree(found, run, OF_A_RUN)
    described = as_robot(drawn_joint(kind), tmp_path)
    if described is not None:
        robot = judged(capsys, "robot", written(tmp_path, described, "robot.yaml"))
        assert robot is not None
        agree(nameless(found), nameless(robot), ("range_sampled",))  # of a joint alone ranges are proved


def nameless(facts: dict[str, Any]) -> dict[str, Any]:
    """Without names of joints: a joint.yaml has none."""
    return facts | {"findings": [one | {"joints": []} for one in facts["findings"]]}


def trajectory(file: Path) -> Path:
    """The postures of a robot.yaml as a log, so that a sweep looks at them alone."""
    source = load_robot_system(file, two_paths=True).source
    rows = [source.body.angles(source.body.configuration(dict(one.angles))).tolist() for one in source.postures.values()]
    path = file.with_suffix(".csv")
    with path.open("w", newline="") as text:
        table = csv.writer(text)
        table.writerow(["time", *(f"link_position_{name}" for name in source.joint_names)])
        table.writerows([0.001 * k, *row] for k, row in enumerate([*rows, rows[-1]]))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("kind", drawn(ROBOTS, 113))
def test_a_robot(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    sections = drawn_robot(kind, tmp_path)
    file = written(tmp_path, sections, "robot.yaml")
    found = judged(capsys, "robot", file)
    assert found is not None
    swept = judged(capsys, "sweep", file, "--trajectory", trajectory(file))
    if "kd_path" in sections["control"]:
        assert swept is None
    else:
        assert swept is not None
        assert RISING.index(swept["verdict"]) >= RISING.index(found["verdict"])
    for posture in sections["postures"]:
        for contact in sections.get("contacts", {"free": []}):
            one = {**sections, "postures": {posture: sections["postures"][posture]}}
            one |= {"contacts": {contact: sections["contacts"][contact]}} if "contacts" in sections else {}
            part = written(tmp_path, one, "part.yaml")
            alone = judged(capsys, "robot", part)
            whole = judged(capsys, "simulate", part)
            if alone is None:
                assert whole is None
                continue
            if whole is not None:
                agree(alone, whole, OF_A_RUN)
            swept = judged(capsys, "sweep", part, "--trajectory", trajectory(part))
            if swept is not None:
                agree(alone, swept)


@pytest.mark.slow
@pytest.mark.parametrize("kind", drawn(AUDITS, 59))
def test_an_audit(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """And the robot.yaml that it writes."""
    file = tmp_path / "written.yaml"
    found = judged(capsys, *drawn_audit(kind, tmp_path), "--write-robot", file)
    robot = judged(capsys, "robot", file)
    assert found is not None
    assert robot is not None
    agree(found, robot)


SERVOS = {
    "with kd": ('kp="12" kv="0.5"', ()),
    "too stiff": ('kp="4000" kv="6"', ()),
    "damping is kd": ('kp="12"', ("--joint-damping", "controller")),
    "damping is friction": ('kp="12"', ("--joint-damping", "friction")),
    "damping is either": ('kp="12"', ()),
    "gearbox unknown": ('kp="12" kv="0.5"', ()),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", SERVOS)
def test_an_mjcf_with_servos(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Where its damping may be read in two ways the robot.yaml is of one of them, which may be decided."""
    pytest.importorskip("mujoco")
    from test_open_readings import leg

    servo, said = SERVOS[kind]
    (tmp_path / "leg.xml").write_text(leg(servo), "utf-8")
    file = tmp_path / "written.yaml"
    gearbox = () if kind == "gearbox unknown" else ("--gearbox", "direct")
    call = ("audit", tmp_path / "leg.xml", "--delay-ms", "2", "--rate-hz", "500", *gearbox, *said)
    found, robot = judged(capsys, *call, "--write-robot", file), judged(capsys, "robot", file)
    assert found is not None
    assert robot is not None
    if kind == "damping is either":
        assert found["verdict"] == "undecided"
        assert robot["verdict"] in {one["verdict"] for one in found["findings"][0]["readings"]}
    else:
        agree(found, robot)
