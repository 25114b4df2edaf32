"""Whatever comes in: exit status 0, 1 or 2, one clear line for 2, never a traceback, and the old report left alone.

`main` raises what it does not expect, so a call that returns is a call without a traceback.
"""

import contextlib
import os
import socket
from pathlib import Path
from random import Random

import pytest
import yaml
from hypothesis import HealthCheck, given, settings

from gainroom.cli import main
from gainroom.cli.example import joint_examples
from gainroom.errors import GainroomError
from gainroom.files.joint_yaml import parse_joint
from gainroom.io.yaml_text import MAX_BYTES, parse_yaml
from mutations import RANDOMS, mutated_bytes, mutated_data

EXAMPLES = joint_examples()
TESTBED = EXAMPLES["testbed"]
QUICK = """\
joint: {motor_inertia: 1.0, link_inertia: 0.8, stiffness: 1.0e+4}
drive: {bandwidth: 4000.0, delay_ms: 2.0}
control: {type: pd, feedback: motor, sample_rate_hz: 1000, kp: 1600.0, kd: 70.0, FILTER}
"""


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """The one line on standard error of a call that must end with status 2."""
    status = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    assert status == 2
    assert out == ""
    assert err.startswith("gainroom: error: ")
    assert err.count("\n") == 1
    return err


@pytest.fixture
def joint_file(tmp_path: Path) -> Path:
    path = tmp_path / "joint.yaml"
    path.write_text(TESTBED, "utf-8")
    return path


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (b"\n\n# nothing\n", "empty"),
        (b"\x7fELF\x02\x01\x01\x00\x00", "binary"),
        (b"joint: \xff\xfe", "UTF-8"),
        (TESTBED.encode("utf-16"), "binary"),
        (b"x" * (MAX_BYTES + 1), "larger than"),
        (b"joint: [", "line 1"),
        (TESTBED.replace("link_inertia: 0.8", "link_inertia: -0.8").encode(), "joint.link_inertia: -0.8 must be > 0"),
        (TESTBED.replace("link_inertia: 0.8", "link_inertia: 0").encode(), "joint.link_inertia: 0 must be > 0"),
        (TESTBED.replace("gear_ratio: 100", "gear_ratio: .nan").encode(), "joint.gear_ratio: nan is not a number"),
        (TESTBED.replace("stiffness:", "stifness:").encode(), "did you mean stiffness?"),
        (TESTBED.replace("delay_ms: 2.674", "delay_ticks: 4").encode(), "needs sample_rate_hz"),
        (TESTBED.replace("delay_ms: 2.674", "delay_s: 2e-3").encode(), "did you mean delay_ms?"),
        (
            QUICK.replace("FILTER", "velocity_filter: {bandwidth_hz: 500}").encode(),
            "control.velocity_filter.bandwidth_hz: 500 Hz must",
        ),
        (
            QUICK.replace("FILTER", "notches: [{frequency: 9}, {frequency: 4e3}]").encode(),
            "control.notches[1].frequency: 4000 rad/s",
        ),
        (
            QUICK.replace("FILTER", "biquads: [{zero_frequency_hz: 500, zero_damping: 0.1, pole_frequency: 9, pole_damping: 1}]").encode(),
            "control.biquads[0].zero_frequency_hz: 500 Hz must be below half the sample rate",
        ),
        (TESTBED.replace("kp: 1600.0", "kp: 1600 Nm").encode(), "control.kp: '1600 Nm' is text"),
    ],
)
def test_content(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, says: str):
    path = tmp_path / "joint.yaml"
    path.write_bytes(content)
    line = complaint(capsys, "joint", path)
    assert str(path) in line
    assert says in line


def test_byte_order_mark_is_no_content(tmp_path: Path):
    assert parse_joint("\ufeff".encode().decode("utf-8-sig") + TESTBED, "f") is not None


def test_not_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert "no such file" in complaint(capsys, "joint", tmp_path / "nowhere.yaml")
    assert "directory" in complaint(capsys, "joint", tmp_path)
    os.mkfifo(tmp_path / "pipe")
    assert "regular file" in complaint(capsys, "joint", tmp_path / "pipe")
    assert "regular file" in complaint(capsys, "joint", "/dev/null")
    assert "cannot be read" in complaint(capsys, "joint", "x" * 5000)
    assert "null byte" in complaint(capsys, "joint", "nul\0byte")
    with contextlib.chdir(tmp_path), socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        assert "socket" in complaint(capsys, "joint", "socket")


def test_a_strange_file_name_stays_on_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "two\nlines\x1b[31m.yaml"
    path.write_text("", "utf-8")
    line = complaint(capsys, "joint", path)
    assert line.rstrip("\n").isprintable()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["joint"], "FILE"),
        (["joint", "a", "b"], "(b)"),
        (["join", "a"], "'join'"),
        (["joint", "--jsn", "a"], "--jsn"),
        (["joint", "a", "--report"], "--report"),
        (["example", "nope"], "'nope'"),
        (["--verbose"], "--verbose"),
    ],
)
def test_wrong_calls(capsys: pytest.CaptureFixture[str], arguments: list[str], named: str):
    assert named in complaint(capsys, *arguments)


@pytest.mark.parametrize(
    "kind", ["directory", "no folder", "device", "the input itself", "read-only", "folder is a file", "long", "takes no files"]
)
def test_a_report_that_cannot_be_written(tmp_path: Path, joint_file: Path, capsys: pytest.CaptureFixture[str], kind: str):
    report = {
        "directory": tmp_path,
        "no folder": tmp_path / "nowhere" / "out.html",
        "device": Path("/dev/null"),
        "the input itself": joint_file,
        "read-only": tmp_path / "old.html",
        "folder is a file": joint_file / "out.html",
        "long": tmp_path / ("x" * 300),
        "takes no files": Path("/proc/gainroom.html"),
    }[kind]
    if kind == "read-only":
        report.write_text("the old report", "utf-8")
        report.chmod(0o444)
        if os.access(report, os.W_OK):
            pytest.skip("root may write everything")
    before = sorted(os.listdir(tmp_path)), joint_file.read_text("utf-8")
    line = complaint(capsys, "joint", joint_file, "--report", report)
    assert str(report) in line
    assert "written" in line or "overwrite" in line
    assert (sorted(os.listdir(tmp_path)), joint_file.read_text("utf-8")) == before
    if kind == "takes no files":
        assert "the directory /proc takes no new files" in line
    if kind == "read-only":
        assert report.read_text("utf-8") == "the old report"


def test_a_failed_run_leaves_the_old_report(tmp_path: Path, joint_file: Path, capsys: pytest.CaptureFixture[str]):
    report = tmp_path / "out.html"
    report.write_text("the old report", "utf-8")
    joint_file.write_text(TESTBED.replace("kp: 1600.0", "kp: -1"), "utf-8")
    complaint(capsys, "joint", joint_file, "--report", report)
    assert report.read_text("utf-8") == "the old report"
    assert sorted(os.listdir(tmp_path)) == ["joint.yaml", "out.html"]


INSERTS = (b"\0", b"&a ", b"*a", b"- ", b"{", b"]", b"\t", b": ", b"!!", b"1e400", b"\xff")


def mutated_file(random: Random) -> bytes:
    text = random.choice(sorted(EXAMPLES.values()))
    if random.random() < 0.5:
        data = parse_yaml(text, "f")
        for _ in range(random.randint(1, 3)):
            data = mutated_data(random, data)
        return yaml.safe_dump(data, allow_unicode=True).encode("utf-8", "surrogatepass")
    bare = (line.partition("#")[0].rstrip() for line in text.splitlines())  # damage to a comment tests nothing
    raw = bytes("\n".join(line for line in bare if line), "utf-8")
    for _ in range(random.randint(1, 4)):
        raw = mutated_bytes(random, raw, INSERTS) or b" "
    return raw


@pytest.mark.slow
@settings(max_examples=1000, deadline=None, suppress_health_check=list(HealthCheck))
@given(random=RANDOMS)
def test_mutated_files_are_read_or_refused_in_one_line(random: Random):
    content = mutated_file(random)
    problems = ()
    with contextlib.suppress(UnicodeDecodeError):  # test_content has that case
        text = content.decode("utf-8")
        try:
            parse_joint(text, "knee.yaml")
        except GainroomError as error:
            problems = error.problems
    assert all(message.startswith("knee.yaml") and "\n" not in message for message in problems)


def runs_to_an_answer_or_a_line(random: Random, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "joint.yaml"
    path.write_bytes(mutated_file(random))
    status = main(["joint", str(path), "--json"])
    out, err = capsys.readouterr()
    assert status in (0, 1, 2)
    assert (out == "") == (status == 2)
    assert all(line.startswith("gainroom: error: ") for line in err.splitlines())
    assert err or status != 2


@pytest.mark.slow
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(random=RANDOMS)
def test_mutated_files_run_to_an_answer_or_a_line(random: Random, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    runs_to_an_answer_or_a_line(random, tmp_path, capsys)


@pytest.mark.population
@pytest.mark.timeout(0)
@settings(max_examples=3000, deadline=None, suppress_health_check=list(HealthCheck))
@given(random=RANDOMS)
def test_many_mutated_files_run_to_an_answer_or_a_line(random: Random, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    runs_to_an_answer_or_a_line(random, tmp_path, capsys)
