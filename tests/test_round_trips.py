"""Advice goes round, for six robots and every form: what was audited is judged the same after it went through a file.

What is known of a robot is drawn at random, with a seed, for each pair of robot and form. What a form does not hold is in the flags that
export names.
"""

import itertools
import json
import math
import random
import re
from pathlib import Path
from typing import Any

import pytest

from gainroom.cli import main
from gainroom.files.gain_export import FORMS
from gainroom.files.robot_yaml import load_robot_system
from gainroom.studies.analysis import analyze
from gainroom.studies.audit import NUMBERS
from six_robots import ROBOTS, as_mjcf, asked
from test_gains_go_along import told

QUICK = 8
"""Ways that are tried every time, of all the others that are there."""
WAYS = [*itertools.product(ROBOTS, FORMS)]
DRAWN = random.Random(57).sample([way for way in WAYS if way[0] in ("arm", "panda", "go1")], QUICK)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def drawn_options(name: str, seed: str) -> list[str]:
    """What is said of a robot beside its model and gains: rate and place, gearboxes, current loops, posture, joints' own damping."""
    draw, robot = random.Random(seed), ROBOTS[name]
    stiffness, damping = robot.stiffness
    place = draw.choice(
        [
            ["--rate-hz", "1000", "--gains-run", "host"],
            ["--rate-hz", "512.5", "--gains-run", "host"],
            ["--gains-run", "drive", "--drive-rate-hz", "8000", "--drive-delay-ms", "0.4"],
        ]
    )
    gearbox = draw.choice([["--stiffness", stiffness, "--damping", damping], ["--stiffness", "inf"], ["--gearbox", "direct"], []])
    loops = draw.choice([["--bandwidth", "3000"], []])
    posture = draw.choice([["--posture", f"{robot.bends[0]}={robot.bends[1]}"], []])
    own = draw.choice([["--joint-damping", "controller"], ["--joint-damping", "friction"], []])
    return [*place, *gearbox, *loops, *posture, *own]


def call_of(folder: Path, name: str, options: list[str], factor: float = 1.0) -> list[str]:
    """An audit with these options in place of the one that the robot has for where gains run."""
    call = asked(folder, name, factor)
    return [*call[: call.index("--gains-run")], *options]


LITTLE = ["--phase-margin-deg", "1", "--peak-sensitivity", "60"]
"""Nearly the gain margin alone."""


def typed_again(call: list[str]) -> list[str]:
    """What the reader of a file has to say himself: the model and its delay."""
    return [*call[:2], "--delay-ms", call[call.index("--delay-ms") + 1]]


def assert_same(second: dict[str, Any], first: dict[str, Any], rel: float = 0.0):
    """The same verdict, state by state the same limits, joint by joint the same gains; `rel` 0: bit for bit."""
    near = (lambda value: pytest.approx(value, rel=rel)) if rel else lambda value: value
    for key in ("safe", "decided", "requirements_met", "unmet", "rigid_gearboxes", "base"):
        assert second[key] == first[key], key
    for key in ("gain_limit", "delay_limit_ms", "limit_frequency_rad_s", "phase_margin_deg", "peak_sensitivity", "sample_rate_hz"):
        assert second[key] == (near(first[key]) if first[key] is not None else None), key
    assert [state["contact"] for state in second["states"]] == [state["contact"] for state in first["states"]]
    for mine, other in zip(second["joints"], first["joints"], strict=True):
        for key in ("name", "safe"):
            assert mine[key] == other[key], (other["name"], key)
        for key in ("kp", "kd", "motor_inertia", "gain_limit"):
            assert mine[key] == (near(other[key]) if other[key] is not None else None), (other["name"], key)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "form"),
    [pytest.param(*way, marks=() if way in DRAWN else pytest.mark.slow) for way in WAYS],
    ids=["-".join(way) for way in WAYS],
)
def test_an_audit_goes_through_a_form(folder: Path, capsys: pytest.CaptureFixture[str], name: str, form: str):
    options = drawn_options(name, f"{name} {form}")
    call = call_of(folder, name, options)
    onto: list[str] = []
    if form == "mjcf":
        model = as_mjcf(folder, name)
        call = ["audit", model, *(text for k, text in enumerate(call[2:]) if "--base" not in call[k + 1 : k + 3])]
        call = [text for k, text in enumerate(call) if text != "--contact" and call[k - 1] != "--contact"]
        onto = ["--onto", model]
    first = told(capsys, *call, "--gains", "gains.json")
    (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    if first["to_use"] is not None:  # which export would write in place of these
        first |= {"to_use": None}
        (folder / "answer.json").write_text(json.dumps(first), "utf-8")
    target = f"out{FORMS[form].ending}"
    said = told(capsys, "export", "answer.json", "--to", form, *onto, "--output", target, "--write")
    again = typed_again(call)
    if form == "mjcf":  # the file is the model itself
        again[1], given = target, []
    else:
        given = ["--gains", target]
    second = told(capsys, *again, *given, *said["audit_with"])
    # Armature of an MJCF is a sum, a gain a quotient by gear²: a few units in the last place, of which limits may show ten thousand times
    # as much.
    assert_same(second, first, 1e-9 if form == "mjcf" else 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in ("arm", "panda") else pytest.mark.slow) for name in ROBOTS])
def test_an_answer_goes_back(folder: Path, capsys: pytest.CaptureFixture[str], name: str):
    """With nothing but the model and its delay typed again, bit for bit."""
    for k in range(2):
        call = call_of(folder, name, drawn_options(name, f"{name} answer {k}"))
        first = told(capsys, *call, "--gains", "gains.json")
        (folder / "answer.json").write_text(json.dumps(first), "utf-8")
        assert_same(told(capsys, *typed_again(call), "--gains", "answer.json"), first)


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in ("arm", "panda") else pytest.mark.slow) for name in ROBOTS])
def test_a_written_robot_is_the_audited_one(folder: Path, capsys: pytest.CaptureFixture[str], name: str):
    """Its states have the same limits and margins, bit for bit."""
    call = call_of(folder, name, drawn_options(name, f"{name} robot"))
    first = told(capsys, *call, "--gains", "gains.json", "--write-robot", "robot.yaml")
    study = analyze(load_robot_system(folder / "robot.yaml"), numbers=NUMBERS)
    assert [state.limit.gain for state in study.states] == [state["gain_limit"] or math.inf for state in first["states"]]
    margins = [study.worst[one].margins for one in ("phase_margin", "peak_sensitivity")]
    assert math.degrees(margins[0].phase_margin) == pytest.approx(first["phase_margin_deg"], rel=1e-15)  # radians in degrees
    assert margins[1].peak_sensitivity == first["peak_sensitivity"]


def printed_file(text: str, names: list[str]) -> str:
    """The file of gains that an audit prints as its advice, as a reader copies it."""
    lines, found = [line[2:] for line in text.splitlines()], []
    for line in lines:
        begins = re.match(r"(joint_damping|posture|gains|sample_rate_hz|gains_run|drive_\w+|system):|['\w.*|()\\-]+: \{kp:|  ", line)
        if begins and (found or not line.startswith("  ")):
            found.append(line)
        elif found:
            break
    assert found, names
    return "\n".join(found)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.7, pytest.param(4.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in ("arm", "panda") else pytest.mark.slow) for name in ROBOTS])
def test_gains_to_use_are_safe_in_one_round(folder: Path, capsys: pytest.CaptureFixture[str], name: str, factor: float):
    """The advice of an audit of gains that are too high meets its own audit, as the file that it prints and as what export writes of it."""
    stiffness, damping = ROBOTS[name].stiffness
    options = ["--gains-run", "host", "--rate-hz", "1000", "--stiffness", stiffness, "--damping", damping]
    if "--contact" in asked(folder, name, factor):  # no lower gains would damp a leg that swings in flight, nor sway
        options += LITTLE
    first = told(capsys, *(call := call_of(folder, name, options)), "--gains", "gains.json")
    factor = factor * 2.0 * (first["gain_limit"] or 1.0)
    first = told(capsys, *(call := call_of(folder, name, options, factor)), "--gains", "gains.json")
    assert not first["requirements_met"]
    assert first["to_use"] is not None
    main([*call, "--gains", "gains.json", "--verbose"])
    (folder / "use.yaml").write_text(printed_file(capsys.readouterr().out, [joint["name"] for joint in first["joints"]]), "utf-8")
    again = told(capsys, *call, "--gains", "use.yaml")
    assert again["requirements_met"], again["sentence"]
    assert again["to_use"] is None
    gains = {joint["name"]: (joint["kp"], joint["kd"]) for joint in again["joints"]}
    assert gains == {joint["name"]: (joint["kp"], joint["kd"]) for joint in first["to_use"]["joints"]}
    if first["to_use"]["ready"]:
        (folder / "answer.json").write_text(json.dumps(first), "utf-8")
        told(capsys, "export", "answer.json", "--to", "yaml", "--output", "out.yaml", "--write")
        assert_same(told(capsys, *typed_again(call), *(LITTLE if LITTLE[0] in call else ()), "--gains", "out.yaml"), again)


MIRRORED = {"biped": ("left_", "right_"), "g1": ("left_", "right_"), "go1": ("FL_", "FR_")}


@pytest.mark.slow
@pytest.mark.parametrize("name", MIRRORED)
@pytest.mark.parametrize("factor", [1.3, 3.0])
def test_left_and_right_get_the_same_advice(folder: Path, capsys: pytest.CaptureFixture[str], name: str, factor: float):
    """Also where one foot alone is on the ground, so that limits differ."""
    options = ["--gains-run", "host", "--rate-hz", "1000", "--stiffness", ROBOTS[name].stiffness[0], "--damping", ROBOTS[name].stiffness[1]]
    options += ["--phase-margin-deg", "1", "--peak-sensitivity", "100"]  # the gain margin decides, which factors on the gains mend
    limit = told(capsys, *call_of(folder, name, options), "--gains", "gains.json")["gain_limit"]
    found = told(capsys, *call_of(folder, name, options, factor * limit), "--gains", "gains.json")["to_use"]
    factors = {joint["name"]: joint["factor"] for joint in found["joints"]}
    left, right = MIRRORED[name]
    for joint, value in factors.items():
        if joint.startswith(left):
            assert factors[joint.replace(left, right, 1)] == value, joint
