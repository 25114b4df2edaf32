"""One file is judged the same by every command: level, findings and exit status; and sentences about safety stand in one module."""

import ast
import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml

pytest.importorskip("pinocchio")

from gainroom.cli import main
from gainroom.cli.example import example_texts
from gainroom.report.words import tone
from gainroom.studies.verdict import STATUS, Finding, Verdict
from robot_truths import hinge, link

SOURCE = Path(main.__code__.co_filename).parents[1]
SAYS = re.compile(r"\b(un)?safe\b|\b(un)?decided\b", re.IGNORECASE)
JOINT = {
    "joint": {"motor_inertia": 0.2, "link_inertia": 0.8, "stiffness": 1e4, "damping": 1.0},
    "drive": {"bandwidth": 4000.0, "damping_ratio": 0.9, "delay_ms": 2.0},
    "control": {"type": "pd", "kp": 300.0, "kd": 20.0, "feedback": "motor", "sample_rate_hz": 2000},
    "scenario": {"duration": 0.4},
}
CHANGES = {
    "safe": {},
    "short": {"control": {"kp": 1500.0, "kd": 30.0}},
    "unstable": {"control": {"kp": 1500.0, "kd": 400.0}},
    "nothing required": {"limits": {}},
    "in its range": {"uncertainty": {"delay_ms": [1.5, 2.5]}},
    "lost in its range": {"uncertainty": {"delay_ms": [2.0, 9.0]}},
}


def changed(base: dict, change: dict) -> dict:
    return {key: {**base.get(key, {}), **change.get(key, {})} if key != "limits" else change[key] for key in {**base, **change}}


def answered(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, dict]:
    """Exit status and what --json prints."""
    status = main([*map(str, words), "--json"])
    return status, json.loads(capsys.readouterr().out)


def decided(facts: dict) -> tuple[str, list]:
    """The level, and every finding but for what a run alone shows."""
    found = [{key: value for key, value in one.items() if key != "state"} for one in facts["findings"]]
    return facts["verdict"], sorted(found, key=lambda one: one["code"])


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_simulate_judges_a_joint_as_joint_does(name: str, tmp_path: Path, capsys):
    file = tmp_path / "joint.yaml"
    file.write_text(yaml.safe_dump(changed(JOINT, CHANGES[name])), "utf-8")
    status, facts = answered(capsys, "joint", file)
    run_status, run = answered(capsys, "simulate", file)
    assert status == run_status == STATUS[facts["verdict"]]
    of_run = [one for one in run["findings"] if one["code"] not in ("vibrates", "diverged")]
    assert decided({**run, "findings": of_run}) == decided(facts)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 1.0, 8.0])
def test_robot_simulate_and_sweep_agree_in_one_state(factor: float, tmp_path: Path, capsys):
    """The shipped biped in one posture and contact state; a sweep about that posture alone looks at the same, to 1e-9 rad."""
    described = yaml.safe_load(example_texts()["biped"])
    described["postures"] = {"stand": described["postures"]["stand"]}
    described["contacts"] = {"double": described["contacts"]["double"]}
    described["control"] |= {name: factor * described["control"][name] for name in ("kp", "kd")}
    del described["tasks"]
    described["scenario"] = {"duration": 0.2}
    file = tmp_path / "robot.yaml"
    file.write_text(yaml.safe_dump(described), "utf-8")
    status, facts = answered(capsys, "robot", file)
    assert status == STATUS[facts["verdict"]]
    run_status, run = answered(capsys, "simulate", file)
    assert run_status == STATUS[run["verdict"]]
    of_run = [one for one in run["findings"] if one["code"] not in ("vibrates", "diverged", "fell")]
    assert decided({**run, "findings": of_run})[1] == decided(facts)[1]
    swept_status, swept = answered(capsys, "sweep", file, "--grid", ".*_knee=0.6:0.600000001:2", "--posture", "stand")
    assert swept_status == STATUS[swept["verdict"]]
    assert swept["verdict"] == facts["verdict"]
    assert {one["code"] for one in swept["findings"]} == {one["code"] for one in facts["findings"]}


def arm(tmp_path: Path, **joint: object) -> Path:
    """A pendulum of 1 kg m² about its pivot as a URDF, described by `joint` in a robot.yaml; motor kp 60, kd 8 at 1 kHz and 2 ms."""
    body = link("upper", 1.0, (0.0, 0.0, -0.9), (0.19, 0.19, 0.01))
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="root"/>{body}{hinge("hip", "root", "upper")}</robot>', "utf-8")
    described = {
        "model": {"file": "arm.urdf", "base": "fixed"},
        "joints": {"default": joint},
        "drive": {"bandwidth": 4000.0, "damping_ratio": 0.9, "delay_ms": 2.0},
        "control": {"type": "pd", "space": "joint", "feedback": "motor", "kp": 60.0, "kd": 8.0, "sample_rate_hz": 1000},
    }
    file = tmp_path / "robot.yaml"
    file.write_text(yaml.safe_dump(described), "utf-8")
    return file


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unknown", "given", "code"),
    [
        ({"motor_inertia": 0.2}, {"motor_inertia": 0.2, "stiffness": "rigid"}, "gearbox_unknown"),
        ({"motor_inertia": 0.2}, {"motor_inertia": 0.2, "stiffness": 2e4, "damping": 3.0}, "gearbox_unknown"),
        ({"stiffness": "rigid"}, {"motor_inertia": 0.2, "stiffness": "rigid"}, ""),
    ],
)
def test_what_decides_and_is_not_given_is_not_decided(unknown: dict, given: dict, code: str, tmp_path: Path, capsys):
    """One joint of 1 kg m²: at kd 8 it crosses at about 8 rad/s, where 4 ms of lag take 2°: safe however stiff the gearbox is."""
    status, facts = answered(capsys, "robot", arm(tmp_path, **unknown))
    assert (status, facts["verdict"]) == ((3, "undecided") if code else (0, "safe"))
    found = {one["code"]: one for one in facts["findings"]}
    assert code in found or not code
    if code:
        assert found[code]["joints"] == ["hip"]
        assert "stiffness" in found[code]["remedy"]
    status, facts = answered(capsys, "robot", arm(tmp_path, **given))
    assert (status, facts["verdict"]) == (0, "safe")


@pytest.mark.parametrize(("inertia", "level"), [(None, "undecided"), (1e-3, "unsafe"), (1.0, "safe")])
def test_unsafe_gains_of_a_motor_without_inertia_are_not_decided_where_more_of_it_helps(
    inertia: float | None, level: str, tmp_path, capsys
):
    """By hand: with some 3.7 ms of lag the phase is −180° at π/2/3.7 ms = 424 rad/s, where kd/(J ω) is 5.3 dB for kd 230 on 1 kg m².

    On 2 kg m², with a motor like its link, it is 11 dB.
    """
    file = arm(tmp_path, stiffness="rigid", **({} if inertia is None else {"motor_inertia": inertia}))
    described = yaml.safe_load(file.read_text("utf-8"))
    described["control"] |= {"kp": 2000.0, "kd": 230.0}
    file.write_text(yaml.safe_dump(described), "utf-8")
    status, facts = answered(capsys, "robot", file)
    assert (status, facts["verdict"]) == (STATUS[level], level)


def test_a_verdict_is_that_of_its_worst_finding():
    findings = {level: Finding(level, level) for level in STATUS}
    assert Verdict.of([]).level == "safe"
    for levels, worst in ((["safe"], "safe"), (["safe", "undecided"], "undecided"), (["undecided", "unsafe"], "unsafe")):
        found = Verdict.of(findings[one] for one in levels)
        assert (found.level, found.status) == (worst, STATUS[worst])
    assert Verdict.of(findings.values()).open(Finding("why", "undecided")).level == "undecided"
    assert Verdict.of([findings["unsafe"]]).with_findings(findings["safe"]).level == "unsafe"
    assert [one.code for one in Verdict.of([findings["safe"], findings["unsafe"]]).deciding] == ["unsafe"]


def literals(path: Path) -> list[tuple[int, str]]:
    """Every text in a module that is no docstring and not the help of an option, with its line."""
    tree = ast.parse(path.read_text("utf-8"))
    docs, helps = set[int](), set[int]()
    for node in ast.walk(tree):
        if isinstance(getattr(node, "body", None), list):
            docs |= {id(one.value) for one in node.body if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant)}
        if isinstance(node, ast.Call):
            option = node.args[2:] if ast.unparse(node.func) == "number_option" else []
            helps |= {id(one) for one in (*option, *(each.value for each in node.keywords if each.arg in ("help", "short_help")))}
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs | helps
    ]


def modules(*folders: str) -> Sequence[Path]:
    return sorted(path for folder in folders for path in (SOURCE / folder).rglob("*.py"))


def test_sentences_about_safety_stand_in_one_module():
    """In what commands, pages and the app answer; names of JSON keys, one word each, are none."""
    said = [
        f"{path.relative_to(SOURCE)}:{line}: {text[:60]!r}"
        for path in modules("report", "app", "studies", "cli")
        if path.name != "words.py"
        for line, text in literals(path)
        if " " in text.strip() and SAYS.search(text)
    ]
    assert said == []


def test_exit_statuses_stand_in_one_table():
    """No command makes a status of its own but verify, whose 1 is a disagreement."""
    made = [
        path.name
        for path in modules("cli")
        for line in path.read_text("utf-8").splitlines()
        if re.search(r"return .*\b(else|and|or) [013]\b|return [13]\b", line)
    ]
    assert set(made) <= {"verify.py", "options.py"}


def looked_at(page: Path) -> tuple[str, str]:
    """The class of a page's body, and its text."""
    text = page.read_text("utf-8")
    return re.findall(r'<body class="(.*?)">', text)[0], re.sub(r"<[^>]+>", " ", text)


def test_a_page_looks_as_its_verdict_says():
    """One look for each level, on every page; unstable and short of a requirement are both unsafe, and look differently."""
    looks = {"unstable": "bad", "vibrates": "bad", "phase_margin": "bare", "unsafe_in_gearbox_range": "bare"}
    for code, look in looks.items():
        found = Verdict.of([Finding(code, "unsafe"), Finding("rate_unknown", "undecided")])
        assert tone(found) == look
        assert tone(found.open(Finding("implausible", "undecided"))) == "warn"
    assert tone(Verdict.of([Finding("range_sampled", "safe")])) == "good"


def test_unstable_gains_that_are_not_decided_are_in_no_red_box(tmp_path: Path, capsys):
    """Of an arm whose motor has no inertia in its file: what is not known decides, so that the box is as the level is, on both pages."""
    file = arm(tmp_path, stiffness="rigid")
    described = yaml.safe_load(file.read_text("utf-8"))
    described["control"] |= {"kp": 3000.0, "kd": 500.0}
    file.write_text(yaml.safe_dump(described), "utf-8")
    page, swept = tmp_path / "robot.html", tmp_path / "sweep.html"
    status, facts = answered(capsys, "robot", file, "--report", page)
    assert not facts["stable"]
    look, text = looked_at(page)
    assert (status, look) == {"unsafe": (1, "bad"), "undecided": (3, "warn")}[facts["verdict"]]
    assert ("UNSTABLE" in text) is (facts["verdict"] == "unsafe")
    swept_status, swept_facts = answered(capsys, "sweep", file, "--samples", "2", "--margins", "1", "--report", swept)
    assert (swept_status, swept_facts["verdict"], looked_at(swept)[0]) == (status, facts["verdict"], look)
