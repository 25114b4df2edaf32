"""The page of an audit: answer first, numbers that are the audit's own, a command that makes it again; and models by a package's name."""

import html
import json
import math
import re
import shlex
from pathlib import Path

import pytest
import yaml
from pytest import approx

import gainroom as gr
from gainroom.cli import main
from gainroom.report.gains_to_use import gain_file, gain_lines, patterns
from gainroom.report.number_format import digits
from gainroom.robot.formats.model_files import load_model
from gainroom.robot.formats.model_names import is_name, locate
from refusals import assert_refused
from robot_truths import hinge, link, write_robot
from test_report import figures, headline, without_library

HARDLY = ("--phase-margin-deg", "1", "--peak-sensitivity", "100")
"""Requirements that nothing here misses, so that gain and delay margin decide."""
GAINS = "hip: {kp: 900, kd: 40, motor_inertia: 0.5}\nknee: {kp: 400, kd: 20, motor_inertia: 0.4}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two links in a plane, and a name that a shell would split."""
    path = tmp_path_factory.mktemp("two words")
    links = link("base", 2.0, inertia=(0.1, 0.1, 0.1)) + link("upper", 4.0, (0, 0, 0.25), (0.1, 0.1, 0.01))
    links += link("lower", 3.0, (0, 0, 0.2), (0.05, 0.05, 0.01)) + link("tip")
    joints = hinge("hip", "base", "upper") + hinge("knee", "upper", "lower", (0, 0, 0.5))
    write_robot(path, links, joints + hinge("end", "lower", "tip", (0, 0, 0.4), kind="fixed"))
    (path / "gains.yaml").write_text(GAINS, "utf-8")
    return path


def call(folder: Path, *options: str) -> list[str]:
    model, gains = folder / "robot.urdf", folder / "gains.yaml"
    return ["audit", str(model), "--gains", str(gains), "--stiffness", "5000", "--damping", "2", "--bandwidth", "3000", *options]


def page_of(folder: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str, dict]:
    """Exit status, page, and what --json tells."""
    report = folder / "out.html"
    status = main(call(folder, *options, "--json", "--report", str(report)))
    return status, report.read_text("utf-8"), json.loads(capsys.readouterr().out)


def cells(page: str, heading: str) -> list[list[str]]:
    """The rows of the table whose first column is called `heading`."""
    (found,) = [text for text in re.findall(r"<table.*?</table>", page, re.S) if f'<th scope="col">{heading}</th>' in text]
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", found, re.S)]
    return [[html.unescape(cell) for cell in row] for row in rows if row]


def test_a_safe_robots_page(folder: Path, capsys: pytest.CaptureFixture[str]):
    status, page, told = page_of(folder, capsys, "--delay-ms", "2", "--rate-hz", "2000", "--contact", "tip", "--base", "floating")
    own = without_library(page)
    assert status == 0
    assert '<body class="good">' in own
    assert "NOT SAFE" not in own
    for outside in ("@import", "url(", "https://", "http://"):
        assert outside not in own
    body = html.unescape(own[own.index("<body") :])
    start = 0
    for part in (
        "Safe",
        "These gains may stay",
        "gain margin",
        "≥ 6 dB",
        "delay margin",
        "Gain margin ",
        "The motion of the vibration",
        "Joint by joint",
        "State by state",
        "Cost of coupling",
        "Inputs and assumptions",
        "Certification",
        "Command",
        gr.__version__,
    ):
        start = body.index(part, start)
    delay = own.partition('class="label">delay margin<')[2].partition("</div>")[0]
    assert "met" not in delay  # nothing is required of it
    assert "≥" not in delay
    value, until = (
        float(found[1]) for found in (re.search(r"([\d.]+)\s*(?:<[^>]*>)*\s*ms", delay), re.search(r"from ([\d.]+) ms", delay)) if found
    )
    assert "of delay, 2 ms given" in delay
    assert until == pytest.approx(2 + value, abs=0.006)  # three digits of each
    joints = cells(own, "joint")
    for row, joint in zip(joints, told["joints"], strict=True):
        gains, factors = (
            map(digits, map(joint.get, keys)) for keys in (("kp", "kd"), ("motor_inertia", "gain_limit", "limit_others_closed"))
        )
        units = {"gain_margin_db": "dB", "phase_margin_deg": "°", "peak_sensitivity": ""}
        margins = [digits(joint["margins"][key], unit, 3) for key, unit in units.items()]
        assert row == [joint["name"], "yes", *gains, *margins, *factors]
    states = cells(own, "contact")
    assert [row[:3] for row in states] == [[state["contact"], "yes", digits(state["gain_limit"])] for state in told["states"]]
    (heat,) = [one for figure in figures(page) for one in figure["data"] if one["type"] == "heatmap"]
    assert [10**value for value in heat["z"][0]] == approx([min(state["gain_limit"], 10.0) for state in told["states"]], rel=1e-5)
    assert own.count("<figure>") == own.count("<figcaption>") + own.count("</tbody></table></div></figure>")


@pytest.mark.parametrize(
    ("options", "kind", "banner", "says"),
    [
        (["--delay-ms", "20"], "bad", "UNSTABLE: do not run these gains", "Not safe: unstable with 20 ms of delay"),
        (["--delay-ms", "2", "--margin-db", "40"], "bare", "", "Not safe: stable in continuous time, but 1 requirement fails: gain margin"),
    ],
)
def test_what_is_not_safe_says_so_first(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], kind: str, banner: str, says: str
):
    options = [*options, *HARDLY]
    status, page, told = page_of(folder, capsys, *options)
    body = html.unescape(without_library(page))
    body = body[body.index("<body") :]
    assert status == 1
    assert body.startswith(f'<body class="{kind}">')
    assert re.findall('class="banner"[^>]*>(.*?)<', body) == [banner] * bool(banner)
    said = headline(body)
    assert said.startswith(says)
    assert told["sentence"].startswith(said)
    why = told["sentence"].removeprefix(said).strip()  # the limits, which nobody is to use, after what to use
    assert f"<p>{why}</p>" in body[body.index("Do this") : body.index('class="cards"')]
    assert "×" not in said
    assert (
        body.index("<h1>")
        < body.index("Do this")
        < body.index('class="cards"')
        < body.index("What fails")
        < body.index('<details class="section"')
    )
    assert "✗ not met" in body
    assert [row[1] for row in cells(page, "joint")] == ["yes" if joint["safe"] else "no" for joint in told["joints"]]
    assert not re.search(r">nan\b|\bnan<", body)


def test_gearboxes_without_damping(folder: Path, capsys: pytest.CaptureFixture[str]):
    """Sampled slowly enough, a joint on an undamped spring rings at any gain: sentence and page say so, and draw nothing that is empty."""
    report = folder / "bare.html"
    gains = folder / "low.yaml"
    gains.write_text("'.*': {kp: 20, kd: 1.3, motor_inertia: 0.01}", "utf-8")
    model = ["audit", str(folder / "robot.urdf"), "--gains", str(gains), "--delay-ms", "5", "--rate-hz", "200", "--stiffness", "300"]
    assert main([*model, "--json", "--report", str(report)]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["gain_limit"] == 0
    proposed = re.search(
        r"With gearbox damping at 0 .* Measure the damping; --damping (\S+) \(5 % of critical\) is a first guess", told["sentence"]
    )
    assert proposed is not None
    assert float(proposed[1]) == approx(0.05 * 2 * (300 * 0.01) ** 0.5, rel=0.3)  # one digit of it
    page = report.read_text("utf-8")
    own = html.unescape(without_library(page))
    assert {joint["gain_limit"] for joint in told["joints"]} == {0.0}
    assert "No joint is stable by itself" in own
    assert "Measure the gearboxes' damping" in own[own.index("Do this") : own.index('class="cards"')]
    assert "Nothing limits these gains" not in own
    assert "no vibration to tell" not in own
    assert "would vibrate at" not in own
    for figure in figures(page):
        assert all(trace["type"] != "bar" for trace in figure["data"])
        axis = figure["layout"]["xaxis"]
        if axis.get("type") == "log":
            assert len(axis["tickvals"]) >= 3
    assert main([*model, "--damping", proposed[1], "--json"]) == 1
    assert 0 < json.loads(capsys.readouterr().out)["gain_limit"] < 1


def test_safe_is_told_as_it_was_asked(folder: Path, capsys: pytest.CaptureFixture[str]):
    _, page, told = page_of(folder, capsys, "--delay-ms", "2")
    assert told["margin_db"] == 6
    assert without_library(page).count("1.995 (6 dB) or more") == 1  # of states; the table of joints has it in a heading
    assert ">gain ≥ 6 dB</th>" in page


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        ["--delay-ms", "20", "--delay-margin-ms", "10"],
        ["--delay-ms", "6", "--rate-hz", "500", "--delay-margin-ms", "3"],
        ["--delay-ms", "4", "--margin-db", "12", "--delay-margin-ms", "2"],
    ],
)
def test_the_gains_to_copy_are_safe(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]):
    """Audited in place of the file's, which are not; three in a thousand more of them are too many, as the factor has three digits."""
    options = [*options, *HARDLY]
    status, page, told = page_of(folder, capsys, *options)
    assert status == 1
    copied = html.unescape(re.findall(r'class="copied"><pre>(.*?)</pre>', page, re.S)[-1])
    for factor, safe in ((1.0, True), (1 + 1.5e-3 / told["scale"], False)):
        gains = yaml.safe_load(GAINS)
        for name, values in gains.items():
            (found,) = [new for pattern, new in yaml.safe_load(copied).items() if re.fullmatch(pattern, name)]
            gains[name] = values | {key: factor * found[key] if key in ("kp", "kd", "ki") else found[key] for key in found}
        changed = tmp_path / "changed.yaml"
        changed.write_text(yaml.safe_dump(gains), "utf-8")
        again = call(folder, *options, "--json")
        main([str(changed) if word == str(folder / "gains.yaml") else word for word in again])
        assert json.loads(capsys.readouterr().out)["requirements_met"] is safe


def test_the_picture_has_every_joint_and_state_and_marks_what_decides(folder: Path, capsys: pytest.CaptureFixture[str]):
    """Two states: with the tip free and on the ground."""
    _, page, told = page_of(folder, capsys, "--delay-ms", "6", "--contact", "tip", "--base", "floating", *HARDLY)
    picture = figures(page)[0]
    marks = [one for one in picture["data"] if one["marker"]["symbol"] != "circle-open"]
    (star,) = [one for one in marks if one["marker"]["symbol"] == "star"]
    assert star["x"] == [approx(told["gain_limit"], rel=1e-5)]
    (worst,) = [state for state in told["states"] if state["gain_limit"] == told["gain_limit"]]
    assert worst["contact"] in star["hovertext"][0]
    names = picture["layout"]["yaxis"]["ticktext"]
    assert names[0] == "<b>all together</b>"
    least = {name: one["x"][0] for name, one in zip(names[1:], marks[1:], strict=True)}
    assert least == {joint["name"]: approx(joint["limit_others_closed"], rel=1e-5) for joint in told["joints"]}
    assert f" in {worst['contact']}" in told["sentence"]
    numbers = picture["layout"]["annotations"][: len(marks)]
    assert [number["text"] for number in numbers] == [digits(mark["x"][0], "×", 3) for mark in marks]
    assert {number["xanchor"] for number in numbers} == {"right"}  # left of the least of each row: no other mark is there


def test_a_verdict_on_rigid_gearboxes_is_no_plain_safe(folder: Path, capsys: pytest.CaptureFixture[str]):
    """What it rests on stands in headline, advice and a card, and the page is not marked good."""
    report = folder / "rigid.html"
    model = [
        "audit",
        str(folder / "robot.urdf"),
        "--gains",
        str(folder / "gains.yaml"),
        "--delay-ms",
        "2",
        "--json",
        "--report",
        str(report),
    ]
    assert main(model) == 3
    told = json.loads(capsys.readouterr().out)
    text = html.unescape(without_library(report.read_text("utf-8")))
    assert '<body class="warn">' in text
    said = headline(text)
    assert told["sentence"].startswith(said)
    assert said.startswith(
        "Not decided: the loop's rate is not given, and any rate costs margin (--rate-hz); the stiffness of the gearboxes"
    )
    assert "In continuous time and with rigid gearboxes every requirement is met" in said
    assert "<code>--stiffness</code> and <code>--damping</code>" in text[text.index("Do this") : text.index('class="cards"')]


def test_of_two_paths_the_card_and_the_star_are_the_one_that_fails_first(folder: Path, capsys: pytest.CaptureFixture[str]):
    """kd on the drive: its factors, up and one over those down, are in JSON."""
    split = ["--gains-run", "split", "--drive-rate-hz", "2000", "--drive-delay-ms", "0.1", "--rate-hz", "500", "--delay-ms", "4"]
    _, page, told = page_of(folder, capsys, *split, "--margin-db", "20")
    ends = told["path_gain_limits"].values()
    nearest = min(factor for low, high in ends for factor in (math.inf if high is None else high, 1 / low if low else math.inf))
    assert nearest < told["gain_limit"]
    assert nearest < 10 ** (20 / 20)  # dB: what fails, and is starred
    (star,) = [one for one in figures(page)[0]["data"] if one["marker"]["symbol"] == "star"]
    assert star["x"] == [approx(nearest, rel=1e-5)]
    first = without_library(page).partition('<p class="label">gain margin</p>')[2]
    assert f'<p class="value">{digits(20 * math.log10(nearest), "", 3)} ' in first[:100]


def test_what_is_not_known_is_not_said_to_fail(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """The peak sensitivity where kd closes on a path of its own: judged as any, but where a period has too many holds for it."""
    split = ["--gains-run", "split", "--drive-rate-hz", "2000", "--drive-delay-ms", "0.1", "--rate-hz", "500", "--delay-ms", "4"]
    status, page, told = page_of(folder, capsys, *split)
    assert (status, told["verdict"], told["findings"]) == (0, "safe", [])
    assert 1 < told["peak_sensitivity"] < 2
    monkeypatch.setattr("gainroom.analysis.multirate.MOST_HOLDS", 1)
    status, page, told = page_of(folder, capsys, *split)
    assert (status, told["verdict"], told["peak_sensitivity"]) == (3, "undecided", None)
    own = html.unescape(without_library(page))
    assert headline(own).startswith("Not decided: the peak sensitivity is not known")
    assert "The peak sensitivity is not known" in own
    assert "What fails" not in own
    (row,) = [row for row in cells(own, "at 500 Hz") if row[0] == "Ms of one loop"]
    assert row[-1] == "not known"


@pytest.mark.parametrize(
    ("asked", "missed"), [(["--phase-margin-deg", "85"], "phase_margin"), (["--delay-margin-ms", "40"], "delay_margin")]
)
def test_what_fails_is_named_where_it_is_not_the_gain_margin(
    folder: Path, capsys: pytest.CaptureFixture[str], asked: list[str], missed: str
):
    status, page, told = page_of(folder, capsys, "--delay-ms", "2", *asked)
    assert (status, told["unmet"]) == (1, [missed])
    own = html.unescape(without_library(page))
    assert f"What fails: {missed.replace('_', ' ')}" in own
    delay = own.partition('class="label">delay margin<')[2].partition("</div>")[0]
    assert ("not met" in delay) == (missed == "delay_margin")


def test_patterns_match_their_group_alone_and_once():
    """Of every pair of groups of a humanoid's joints, and where names share nothing."""
    names = load_model(locate("example-robot-data:g1_29dof_rev_1_0.urdf")).joint_names
    legs = [name for name in names if "hip" in name or "knee" in name]
    for group in (legs, [name for name in names if "left" in name], names[:1], names[3:20], list(names)):
        found = patterns(group, names)
        for name in names:
            assert sum(bool(re.fullmatch(pattern, name)) for pattern in found) == (name in group), (name, found)
    assert len(patterns(legs, names)) == 2
    assert patterns(["a", "b"], ["a", "b", "ab"]) == ["a", "b"]


def test_gains_to_type_are_in_the_robots_order_whatever_is_alike():
    """kp and kd, which differ in what is alike, and a file of both: arm and wrist do not go before hip as they have the same kp."""
    names, kp, kd = ("arm", "hip", "wrist", "knee"), [1.0, 2.0, 1.0, 3.0], [5.0, 4.0, 4.0, 5.0]
    assert gain_lines("kp", names, kp) == ["kp: {arm: 1, hip: 2, wrist: 1, knee: 3}"]
    assert gain_lines("kd", names, kd) == ["kd: {arm: 5, hip: 4, wrist: 4, knee: 5}"]
    assert [line.partition(":")[0] for line in gain_file(names, {"kp": kp, "kd": [1.0] * 4})] == list(names)


@pytest.mark.slow
def test_the_command_on_the_page_makes_it_again(folder: Path, capsys: pytest.CaptureFixture[str]):
    options = [
        "--delay-ms",
        "2.5",
        "--rate-hz",
        "1000",
        "--motor-inertia",
        ".*=0.3",
        "--base",
        "fixed",
        "--contact",
        "lower",
        "--margin-db",
        "3",
    ]
    _, page, told = page_of(folder, capsys, *options)
    text = html.unescape(re.findall(r"<pre>(.*?)</pre>", without_library(page), re.S)[-1])
    command = shlex.split(text)
    assert command[0] == "gainroom"
    main([*command[1:], "--json"])
    assert json.loads(capsys.readouterr().out) == told
    again = (folder / "out.html").read_text("utf-8")
    assert re.sub(r"\d{4}-\d\d-\d\d</p>", "", again) == re.sub(r"\d{4}-\d\d-\d\d</p>", "", page)


def test_the_terminal_names_the_page_and_inputs_stay(folder: Path, capsys: pytest.CaptureFixture[str]):
    report = folder / "other.html"
    assert main(call(folder, "--delay-ms", "2", "--report", str(report))) == 3
    out = capsys.readouterr().out
    assert f"Report: {report}\n" in out
    assert max(len(line) for line in out.splitlines() if not line.startswith("  gainroom ")) <= max(100, len(f"Report: {report}"))
    for name in ("robot.urdf", "gains.yaml"):
        before = (folder / name).read_bytes()
        assert main(call(folder, "--delay-ms", "2", "--report", str(folder / name))) == 2
        assert "would overwrite the input" in capsys.readouterr().err
        assert (folder / name).read_bytes() == before
    assert main(call(folder, "--delay-ms", "2", "--report", str(folder / "page.pdf"))) == 2
    assert "page.pdf: --report writes a web page, whose name must end in .html" in capsys.readouterr().err
    assert not (folder / "page.pdf").exists()


@pytest.mark.slow
def test_models_by_a_packages_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert locate("example-robot-data:solo12.urdf") == locate({"package": "example-robot-data", "file": "solo12.urdf"})
    assert load_model("gainroom:biped.urdf").size == 12
    assert not is_name(str(tmp_path))
    assert not is_name("C:/robot.urdf")
    assert not is_name("folder/we:ird.urdf")
    assert_refused(lambda: locate("no-such-robots:x.urdf"), ["'no-such-robots' is not installed"])
    assert_refused(lambda: locate("gainroom:bipd.urdf"), ["gainroom ships no 'bipd.urdf'; did you mean 'biped.urdf'?"])
    gains = tmp_path / "gains.yaml"
    gains.write_text('".*": {kp: 2000, kd: 100, motor_inertia: 1.0}', "utf-8")
    assert (
        main(["audit", "gainroom:biped.urdf", "--gains", str(gains), "--delay-ms", "2", "--contact", "left_sole", "--json"]) == 3
    )  # neither rate nor gearboxes are given
    told = json.loads(capsys.readouterr().out)
    assert [joint["name"] for joint in told["joints"]] == list(load_model("gainroom:biped.urdf").joint_names)
