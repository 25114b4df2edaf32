"""What every command says first: whether the gains are safe, and each requirement that fails with its value and place."""

import html
import json
import math
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
import yaml

import gainroom as gr
from gainroom.cli import main
from gainroom.errors import THIN
from gainroom.files.joint_yaml import parse_joint
from gainroom.files.robot_yaml import load_robot_system, parse_robot
from gainroom.report.gain_advice import joint_to_use, robot_to_use
from gainroom.report.joint_text import notes, warnings
from gainroom.report.number_format import UNITS
from gainroom.report.words import headline as headline_of
from gainroom.studies.joint import study_joint
from gainroom.studies.robot import study_robot
from gainroom.system.requirements import REQUIREMENTS
from robot_files import ROBOT, write_arm
from test_report import headline as top_of, without_library

EXAMPLES = Path(__import__("gainroom").__path__[0]) / "files" / "examples"
JOINTS = sorted(path.stem for path in EXAMPLES.glob("*.yaml") if "biped" not in path.stem)
LEG = Path(__file__).parents[1] / "examples" / "robot.xml"
RATELESS = (EXAMPLES / "fig9.yaml").read_text("utf-8").replace("clock: continuous", "#")
WITHOUT_RATE = re.sub(r"sample_rate_hz: [\d.]+,? ?", "", ROBOT)


def said(capsys: pytest.CaptureFixture[str], tmp_path: Path, *call: str) -> tuple[str, str, dict, str]:
    """The terminal's first 25 lines on one, the page's headline, what --json says, and the page's marks."""
    page = tmp_path / "page.html"
    main([*call, "--report", str(page)])
    lines = capsys.readouterr().out.splitlines()
    main([*call, "--json"])
    own = without_library(page.read_text("utf-8"))
    return " ".join(" ".join(lines[:25]).split()), top_of(own), json.loads(capsys.readouterr().out), own


def assert_one_verdict(terminal: str, headline: str, own: str):
    """The same words and the colour that belongs to them."""
    verdict = re.match(r"Safe|Not safe: stable(?=.*?, but \d+ requirements? fails?)|Not safe|Not decided", headline)
    assert verdict is not None
    assert terminal.startswith(verdict[0])
    colours = {"Safe": {"good"}, "Not safe: stable": {"bare"}, "Not safe": {"bare", "bad"}, "Not decided": {"warn"}}[verdict[0]]
    assert set(re.findall('<body class="(.*?)">', own)) <= colours


@pytest.mark.slow
@pytest.mark.parametrize("name", JOINTS)
def test_every_requirement_that_a_joint_misses_is_in_both_headlines(capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str):
    terminal, headline, told, own = said(capsys, tmp_path, "joint", str(EXAMPLES / f"{name}.yaml"))
    assert_one_verdict(terminal, headline, own)
    assert told["unmet"]
    assert re.match(rf"Not safe: stable( in continuous time)?, but {len(told['unmet'])} requirement", headline)
    for missed in told["unmet"]:
        one = REQUIREMENTS[missed]
        value = f"{one.heading} {told['worst'][one.key]:.3g}{'' if one.unit in ('', '°') else ' '}{one.unit} ({one.sign} "
        assert value in headline
        assert value in terminal.partition(" at to use")[0]


@pytest.mark.slow
def test_the_present_gains_at_the_usual_rate_are_those_of_the_file_with_that_rate(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Fig. 9's joint: everything that is too little there, with its value."""
    file = yaml.safe_load(RATELESS)
    (tmp_path / "joint.yaml").write_text(yaml.safe_dump(file), "utf-8")
    _, headline, _, _ = said(capsys, tmp_path, "joint", str(tmp_path / "joint.yaml"))
    file["control"]["sample_rate_hz"] = 2000
    (tmp_path / "joint.yaml").write_text(yaml.safe_dump(file), "utf-8")
    _, _, told, _ = said(capsys, tmp_path, "joint", str(tmp_path / "joint.yaml"))
    assert set(told["unmet"]) == {"gain_margin", "phase_margin", "peak_sensitivity"}
    values = f"gain margin {told['gain_margin_db']:.3g} dB (≥ 6 dB), phase margin {told['phase_margin_deg']:.3g}° (≥ 30°)"
    assert f"At a rate of 2 kHz, for example, these gains have {values}, Ms {told['peak_sensitivity']:.3g} (≤ 2)." in headline


@pytest.mark.parametrize(
    ("rate", "limits", "verdict"),
    [
        ("", "", "Not decided: the loop's rate is not given"),
        ("sample_rate_hz: 2000, ", "", "Safe: every requirement is met"),
        ("sample_rate_hz: 2000, ", "limits: {peak_sensitivity: 1.1}\n", "Not safe: stable, but 1 requirement fails: Ms "),
    ],
)
def test_a_robots_verdict_has_one_word_and_one_colour(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rate: str, limits: str, verdict: str
):
    monkeypatch.setattr("gainroom.studies.robot._recommended", lambda system: [])  # which take longest
    text = WITHOUT_RATE.replace("control: {", f"control: {{{rate}").replace("kp: 400.0, kd: 30.0", "kp: 400.0, kd: 60.0") + limits
    terminal, headline, _, own = said(capsys, tmp_path, "robot", str(write_arm(tmp_path, text)))
    assert_one_verdict(terminal, headline, own)
    assert headline.startswith(verdict)


@pytest.mark.slow
def test_gains_of_a_robot_that_fail_at_the_usual_rate_are_not_shown(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Those for continuous time: folded on the page, with --verbose in the terminal; the command that finds others is there in full."""
    path = write_arm(tmp_path, WITHOUT_RATE)
    terminal, _, told, own = said(capsys, tmp_path, "robot", str(path))
    usual = told["at_usual_rate"]
    shown = re.search(r"(Use instead|may stay\.).*?under control", terminal) is not None
    assert shown == usual["requirements_met"]
    first = own.partition("Do this</h2>")[2].partition("</section>")[0].partition("<details")[0]
    assert ("<pre>kp:" in first) == usual["requirements_met"]
    if not usual["requirements_met"]:
        assert f"gainroom robot {path}" in terminal
        assert "; at 2 kHz they have " in own


@pytest.mark.slow
@pytest.mark.parametrize("delay", ["0.5", "2", "4"])
@pytest.mark.parametrize("more", [(), ("--rate-hz", "2000"), ("--phase-margin-deg", "45", "--peak-sensitivity", "1.3")])
def test_every_row_that_an_audit_does_not_meet_is_in_both_headlines(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, delay: str, more: tuple[str, ...]
):
    terminal, headline, told, own = said(capsys, tmp_path, "audit", str(LEG), "--delay-ms", delay, *more)
    assert_one_verdict(terminal, headline, own)
    assert told["requirements_met"] == (not headline.startswith("Not safe"))
    assert told["decided"] == (not headline.startswith("Not decided"))
    assert told["safe"] == (told["requirements_met"] and told["decided"])
    rows = [
        re.findall("<td.*?>(.*?)</td>", row) for row in re.findall("<tr>(.*?)</tr>", own.partition("Do this")[2].partition("</table>")[0])
    ]
    missed = [row for row in rows if "no" in row]
    assert bool(missed) == (not told["requirements_met"]) or not told["stable"]
    for row in missed if told["stable"] else []:
        for text in (headline, terminal.partition("Do this")[0]):
            assert row[1] in text


WIDE = "uncertainty: {stiffness: 20%, delay_ms: [1, 2], link_inertia: [4, 40]}\n"


@pytest.mark.slow
def test_gains_for_the_usual_rate_say_how_they_hold_over_the_ranges():
    """And not how those of continuous time do, which are not the ones shown."""
    study = study_joint(parse_joint(RATELESS + WIDE, ""))
    assert study.at_usual_rate is not None
    shown = study.at_usual_rate.recommended
    assert shown is not None
    assert shown.reserve > 0.01  # else nothing is to be said
    assert "between all frequencies, with 2 % of each requirement in reserve; " in shown.certificate  # for --verbose and the page
    assert not any("roved" in remark for remark in joint_to_use(study).remarks)  # what is proved changes no decision
    vars(study.at_usual_rate)["recommended"] = replace(shown, proved=False, reserve=0.002)
    why = "of those in between there is no proof for such requirements."
    told = joint_to_use(study).remarks[1]
    assert told == f"Not proved: the requirements are met in all cases within the ranges that were checked; {why}"
    vars(study.at_usual_rate)["recommended"] = replace(shown, proved=False)
    told = joint_to_use(study).remarks[1]
    assert told.startswith("Not proved: the requirements are met with 2 % of each requirement to spare in all cases")
    assert told.endswith("the proof for those in between did not finish.")
    assert "proved" not in told.removeprefix("Not proved").lower()


@pytest.mark.slow
@pytest.mark.parametrize("name", JOINTS)
def test_a_shipped_joint_has_its_clock_and_ends_in_gains_that_meet_its_limits(name: str):
    """As they are shown, put where they belong: nothing is missed, in the worst of the file's ranges either."""
    text = (EXAMPLES / f"{name}.yaml").read_text("utf-8")
    study = study_joint(parse_joint(text, name))
    assert not study.system.rate_is_missing
    file = yaml.safe_load(text)
    file["control"] |= yaml.safe_load("\n".join(joint_to_use(study).lines))
    again = study_joint(parse_joint(yaml.safe_dump(file), name))
    assert again.stable_in_range
    assert again.unmet == {}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "states"), [("biped", 8), ("biped-simulated", 2)])
def test_a_shipped_robot_has_its_clock_and_ends_in_gains_that_meet_its_limits(name: str, states: int):
    """The same in every posture and contact state."""
    pytest.importorskip("pinocchio")
    text = (EXAMPLES / f"{name}.yaml").read_text("utf-8")
    study = study_robot(parse_robot(text, name))
    assert not study.system.rate_is_missing
    found, file = yaml.safe_load("\n".join(robot_to_use(study).lines)), yaml.safe_load(text)
    if file["control"].get("space") == "task":
        file["tasks"] = [task | found[task["name"]] for task in file["tasks"]]
    else:
        file["control"] |= found
    again = study_robot(parse_robot(yaml.safe_dump(file), name), recommend=False)
    assert again.stable_in_range
    assert (len(again.states), again.unmet) == (states, {})


def test_a_rate_that_is_assumed_is_told_where_the_gains_are():
    """What is assumed, where to write another, and what that changes: by the margins of the very loop at half the rate."""
    study = study_joint(parse_joint(RATELESS, ""))
    use = joint_to_use(study, "gainroom joint knee.yaml")
    assert use.heading == "The file has no rate, so 2 kHz is assumed. For that rate alone, in knee.yaml under `control`:"
    assert use.lines[0] == "sample_rate_hz: 2000  # assumed"
    kp, kd = (yaml.safe_load(line)[name] for line, name in zip(use.lines[1:], ("kp", "kd"), strict=True))
    system = study.system
    half = gr.margins(gr.build_loop(system.source, system.drives[0], gr.PD(kp, kd), sample_time=1e-3))
    short = f"Ms {half.peak_sensitivity:.3g} (≤ 2)"
    assert half.peak_sensitivity > 2
    assert "run `gainroom joint knee.yaml` again: at 1 kHz these gains have " in use.remarks[0]
    assert short in use.remarks[0]
    (said,) = [note for note in notes(study) if "recommended is for continuous time, and at 2 kHz those gains have" in note]
    assert said.endswith("; at_usual_rate has gains for 2 kHz, which is assumed")  # as `use` has


LINK = """\
joint: {{motor_inertia: 1.0, link_inertia: 1.0, stiffness: 1.0e4, damping: {damping}}}
drive: {{bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: {delay}}}
control: {{type: pd, kp: 100.0, kd: 10.0, feedback: link, sample_rate_hz: 2000}}
"""


@pytest.mark.parametrize(("delay", "damping"), [(2.0, 0.0), (0.5, 0.0), (10.0, 0.0), (2.0, 20.0)])
def test_the_encoder_on_the_link_without_damping_is_told_as_bad_as_it_is(delay: float, damping: float):
    """That almost any gain vibrates only where a hundredth of the gains does, too; where lag damps the resonance it says that."""
    study = study_joint(parse_joint(LINK.format(delay=delay, damping=damping), "f"))
    joint, drive = study.system.source, study.system.drives[0]
    lower = (1.0, 0.3, 0.1, 0.01)
    held = [gr.is_stable(gr.build_loop(joint, drive, gr.PD(100 * k, 10 * k), feedback="link", sample_time=5e-4)) for k in lower]
    told = [text for text in warnings(study) if "encoder on the link" in text]
    if damping:
        assert told == []
        return
    assert all(held) or not any(held)
    assert ("vibrates at almost any gain" in told[0], "only the lag of delay and drive damps" in told[0]) == (not any(held), all(held))
    assert told[0].endswith("feed back the motor's velocity (feedback: motor), or measure the damping")


def test_a_page_keeps_units_with_their_numbers_as_the_terminal_does():
    assert f"/{UNITS.pattern}/g" in files("gainroom").joinpath("report", "page.js").read_text("utf-8")
    text = "Ms 2.28 (≤ 2) at 77.4 Hz, 5 N·m/rad, 3 ms later: 2.04 × these, 4 m and 3 more"
    assert UNITS.sub("_", text) == "Ms 2.28 (≤_2) at 77.4_Hz, 5_N·m/rad, 3_ms later: 2.04_× these, 4_m and 3 more"


def exported(told: dict[str, Any], folder: Path, capsys: pytest.CaptureFixture[str]) -> bool:
    """Whether `export` writes the gains to use of an audit's answer; where it does not, it says why in a line and writes nothing."""
    answer = folder / "answer.json"
    answer.write_text(json.dumps(told), "utf-8")
    status = main(["export", str(answer), "--to", "yaml"])
    out, err = capsys.readouterr()
    assert (status, bool(out), err.count("\n")) in ((0, True, 0), (2, False, 1))
    assert status == 0 or "not to use these gains yet" in err
    return status == 0


@pytest.mark.slow
def test_an_audit_without_a_rate_shows_no_gains_to_use(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """They have what is required in continuous time alone; with a rate they are shown, and are safe there."""
    terminal, _, told, own = said(capsys, tmp_path, "audit", str(LEG), "--delay-ms", "2")
    lowered = next(joint["kp"] for joint in told["to_use"]["joints"] if joint["name"] in told["to_use"]["scaled"])
    first = own.partition("Do this</h2>")[2].partition("</section>")[0].partition("<details")[0]
    assert f"{lowered:.4g}" not in terminal
    assert f"{lowered:.4g}" not in first
    assert told["to_use"]["ready"] is False
    assert not exported(told, tmp_path, capsys)
    (command,) = re.findall(r"<pre>gainroom (audit .*?)</pre>", html.unescape(first))
    assert f"gainroom {command}" in terminal
    main([*command.split(), "--json"])
    again = json.loads(capsys.readouterr().out)
    assert again["sample_rate_hz"] == 2000
    assert math.isfinite(again["to_use"]["factor"])
    assert exported(again, tmp_path, capsys) == again["to_use"]["ready"]
    assert again["to_use"]["factor"] < told["to_use"]["factor"]  # a rate costs margin


@pytest.mark.slow
def test_gains_that_would_hardly_damp_are_not_to_be_used_yet(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Too high for the gain margin, with too little kd: lower ones have that margin and still ring. Headline and advice say it."""
    gains = tmp_path / "gains.yaml"
    gains.write_text("gains: {'.*': {kp: 2000, kd: 5, motor_inertia: 0.02}}\n", "utf-8")
    call = ("audit", str(LEG), "--delay-ms", "0.3", "--delay-margin-ms", "0.05", "--rate-hz", "5000", "--gains", str(gains))
    for kd in (1, 2, 3, 5, 8):
        gains.write_text(f"gains: {{'.*': {{kp: 2000, kd: {kd}, motor_inertia: 0.02}}}}\n", "utf-8")
        terminal, headline, told, _ = said(capsys, tmp_path, *call)
        if told["safe"] or told["to_use"] is None:
            continue
        rings = "Do not use × " in terminal
        assert told["to_use"]["ready"] is not rings
        assert exported(told, tmp_path, capsys) is not rings
        assert rings == (" --peak-sensitivity 2 --write-robot robot.yaml" in terminal)
        assert not rings or f"Ms {told['peak_sensitivity']:.3g}" in headline or not told["stable"]
        assert rings != ("Multiply " in terminal)


@pytest.mark.slow
@pytest.mark.parametrize("ranges", ["", "uncertainty: {delay_ms: [2.0, 2.5], stiffness: 10%}\n"])
def test_the_delay_margin_of_gains_to_use_is_what_the_robot_has_with_them(tmp_path: Path, ranges: str):
    """Typed into the file, the smallest of all states and corners is the one that was shown; every digit that is typed was used."""
    study = study_robot(load_robot_system(write_arm(tmp_path, ROBOT + ranges)))
    assert study.to_use is not None
    assert study.margins_to_use is not None
    file = yaml.safe_load(ROBOT + ranges)
    for name in ("kp", "kd"):
        file["control"][name] = dict(zip(study.to_use[0].names, getattr(study.to_use[1], name).tolist(), strict=True))
    typed = study_robot(load_robot_system(write_arm(tmp_path, yaml.safe_dump(file))), recommend=False)
    assert math.isfinite(study.margins_to_use.delay_margin)
    # 1e-6: how near to the limit a certificate is asked for
    assert study.margins_to_use.delay_margin == pytest.approx(min(typed.least(state, "delay_margin") for state in typed.states), rel=1e-6)


@pytest.mark.slow
def test_large_numbers_have_no_exponent(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Of a huge joint with soft gains: factors of thousands, gains of tens of millions; on the terminal and on the page."""
    page = tmp_path / "joint.html"
    path = tmp_path / "joint.yaml"
    path.write_text(
        "joint: {motor_inertia: 4.0e6, link_inertia: 9.0e7, stiffness: 9.0e11, damping: 1.0e8}\n"
        "drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}\n"
        "control: {type: pd, kp: 2.0e3, kd: 1000.0, feedback: motor, sample_rate_hz: 2000}\n"
        "limits: {gain_margin_db: 6.0, phase_margin_deg: 30.0, peak_sensitivity: 2.0}\n",
        "utf-8",
    )
    main(["joint", str(path), "--verbose", "--report", str(page)])
    out = re.sub("[ \n]+", " ", capsys.readouterr().out)  # not at thin spaces
    main(["joint", str(path), "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["recommended"]["kp"] > 1e7
    assert f"kp: {told['recommended']['kp']:.0f} " in out  # as it is typed
    own = re.sub("<script.*?</script>|<style.*?</style>", "", page.read_text("utf-8"), flags=re.DOTALL)
    text = html.unescape(re.sub("<[^>]+>", " ", own))
    for words in (out, text):
        assert not re.search(r"\d[eE][+-]?\d", words)
        assert not re.search(r"\d{5}\.0\b", words)
    limit = f"{told['gain_limit']:.3g}"
    assert f"at {float(limit):,.0f} × these gains".replace(",", THIN) in out


def swing(kd: float, delay_ms: float) -> str:
    """Sentence on a rigid joint of 1 kg·m² in continuous time, kp 100, of which L(s) = (100 + kd s)/s² e^(−s T)."""
    text = f"""\
joint: {{motor_inertia: 0.5, link_inertia: 0.5, stiffness: rigid}}
drive: {{bandwidth: .inf, delay_ms: {delay_ms}, clock: continuous}}
control: {{type: pd, kp: 100, kd: {kd}, feedback: motor}}
limits: {{phase_margin_deg: 30}}
"""
    study = study_joint(parse_joint(text, "joint.yaml"))
    crossover = math.sqrt((kd**2 + math.sqrt(kd**4 + 4e4)) / 2)  # |L| = 1: ω⁴ = kd² ω² + 100²
    ideal = math.degrees(math.atan(kd * crossover / 100))
    assert study.margins.phase_margin == pytest.approx(math.radians(ideal) - crossover * 1e-3 * delay_ms, abs=1e-6)
    return headline_of(study)


def test_a_slow_swing_that_no_delay_makes_is_said_to_be_none_of_its_vibrations():
    """atan(kd ω/kp) is the phase margin without a delay: of kd 4 22.6° at 1.66 Hz, of which 5 ms take 3.0°; of kd 6 33.3°."""
    hint = "This is no vibration of the delay, which costs 3° there: these gains hardly damp a swing at 1.66 Hz."
    assert hint in swing(4.0, 5.0)
    assert "no vibration of the delay" not in swing(6.0, 10.0)  # 30° but for the delay
    assert "no vibration of the delay" not in swing(6.0, 0.5)  # none is missed
