"""What may go wrong around a run: outputs over inputs, full disks, closed streams, narrow terminals, Ctrl-C while it loads."""

import contextlib
import errno
import fcntl
import os
import pty
import resource
import shutil
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from faults import BIPED, COMMANDS, EXAMPLES, GAINS, OLD, SHORT, environment, furnish, gainroom, heard, undisturbed
from gainroom.cli import main
from gainroom.files.logs import read_log
from robot_files import write_arm

PLAYED = EXAMPLES["testbed-sampled"] + SHORT


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    furnish(tmp_path, old=True)
    (tmp_path / "played.yaml").write_text(PLAYED, "utf-8")
    return tmp_path


def refused(call: list[str | Path], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which `call` is refused, with nothing computed."""
    status = main(list(map(str, call)))
    out, err = capsys.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1)
    return err


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


# What is there already


def test_a_scenario_that_is_refused_leaves_the_older_log(folder: Path, capsys: pytest.CaptureFixture[str]):
    """A gearbox too stiff for its link: found out once the robot is put together, with the log open."""
    robot = folder / "robot.yaml"
    robot.write_text(EXAMPLES["biped-simulated"].replace("stiffness: 1.0e4", "stiffness: 1.0e11", 1), "utf-8")
    before = contents(folder)
    said = refused(["simulate", robot, "--log", folder / "run.csv", "--report", folder / "page.html"], capsys)
    assert "steps per tick" in said
    assert contents(folder) == before


@pytest.mark.parametrize("ways", ["same", "link", "hard link", "around"])
@pytest.mark.parametrize("option", ["--log", "--report"])
def test_no_output_takes_the_place_of_an_input(folder: Path, capsys: pytest.CaptureFixture[str], option: str, ways: str):
    file, other = folder / "input.csv", folder / "other.csv"
    file.write_text(PLAYED, "utf-8")
    {
        "same": lambda: other.symlink_to(file),
        "link": lambda: other.symlink_to(file),
        "hard link": lambda: other.hardlink_to(file),
        "around": lambda: None,
    }[ways]()
    output = {"same": file, "around": folder / ".." / folder.name / file.name}.get(ways, other)
    assert "would overwrite the input" in refused(["simulate", file, option, output], capsys)
    assert file.read_text("utf-8") == PLAYED
    assert not list(folder.glob(".gainroom-*"))


def test_no_report_takes_the_place_of_a_file_behind_the_input(folder: Path, capsys: pytest.CaptureFixture[str]):
    """The model of a robot.yaml, the model and the gains of an audit, and what an MJCF includes and takes its shapes from."""
    model, robot = folder / "arm.urdf", folder / "robot.yaml"
    shutil.copy(BIPED, model)
    robot.write_text(EXAMPLES["biped"].replace("{package: gainroom, file: biped.urdf", f"{{file: {model}", 1), "utf-8")
    assert str(model) in robot.read_text("utf-8")
    refused(["robot", robot, "--report", model], capsys)
    audit = ["audit", model, "--delay-ms", "2", "--gains", folder / "gains.yaml"]
    refused([*audit, "--report", model], capsys)
    refused([*audit, "--report", folder / "gains.yaml"], capsys)
    assert model.read_bytes() == BIPED.read_bytes()
    assert (folder / "gains.yaml").read_text("utf-8") == GAINS
    (folder / "leg.stl").write_bytes(tetrahedron())
    (folder / "leg.xml").write_text('<mujoco><asset><mesh name="leg" file="leg.stl"/></asset></mujoco>', "utf-8")
    (folder / "arm.xml").write_text(
        '<mujoco><include file="leg.xml"/><worldbody><body name="a"><joint name="a" axis="0 1 0"/><geom type="mesh" mesh="leg"/></body>'
        '</worldbody><actuator><position joint="a" kp="10" kv="1"/></actuator></mujoco>',
        "utf-8",
    )
    before = contents(folder)
    for name in ("arm.xml", "leg.xml", "leg.stl"):
        refused(["audit", folder / "arm.xml", "--delay-ms", "2", "--report", folder / name], capsys)
    assert contents(folder) == before


def tetrahedron() -> bytes:
    """A mesh of four triangles, as a binary STL."""
    corners = [(0.0, 0, 0), (1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *(x for k in face for x in corners[k]), 0) for face in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + triangles


def test_the_report_does_not_take_the_place_of_the_log(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "link.csv").symlink_to(folder / "new.csv")
    said = refused(["simulate", folder / "played.yaml", "--log", folder / "new.csv", "--report", folder / "link.csv"], capsys)
    assert "would overwrite another file that this command writes" in said


def test_a_file_read_by_an_earlier_run_may_be_written(folder: Path, capsys: pytest.CaptureFixture[str]):
    """What counts are the inputs of this run."""
    file = folder / "joint.yaml"
    assert main(["joint", str(file), "--exit-zero"]) == 0
    assert main(["simulate", str(folder / "played.yaml"), "--report", str(file), "--exit-zero"]) == 0
    capsys.readouterr()
    assert "</html>" in file.read_text("utf-8")


# Disks and streams


def limited(size: int):
    """In a new process: no file may grow beyond `size` bytes, as on a full disk; signals are heard."""

    def prepare() -> None:
        heard()
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return prepare


@pytest.mark.slow
@pytest.mark.parametrize("command", ["joint", "simulate csv"])
def test_a_full_disk_costs_the_report_and_not_the_answer(folder: Path, command: str):
    """The page is beyond 3 MB; the answer is the same as without a report."""
    words = [word for word in COMMANDS[command] if not word.startswith(("run.", "--log"))]
    plain = gainroom(folder, *words[:2], "--json")
    before = contents(folder)
    run = gainroom(folder, *words, "--json", preexec_fn=limited(1_000_000))
    assert run.stdout == plain.stdout != ""
    assert run.stderr == f"gainroom: error: page.html: cannot be written: {os.strerror(errno.EFBIG).lower()}\n"
    assert run.returncode == 2
    assert contents(folder) == before


def test_a_full_disk_leaves_the_older_log(folder: Path):
    before = contents(folder)
    run = gainroom(folder, "simulate", "played.yaml", "--log", "run.csv", preexec_fn=limited(10_000))
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == f"gainroom: error: run.csv: cannot be written: {os.strerror(errno.EFBIG).lower()}\n"
    assert contents(folder) == before


CALLS = (["joint", "joint.yaml"], ["joint", "joint.yaml", "--json"], ["example"], ["--help"], ["joint", "-h"], ["--version"])


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS, ids=" ".join)
@pytest.mark.parametrize("number", [1, 2])
def test_a_closed_stream_changes_nothing_else(folder: Path, call: list[str], number: int):
    def prepare() -> None:
        heard()
        os.close(number)

    run = gainroom(folder, *call, preexec_fn=prepare)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout == ("" if number == 1 else undisturbed(*call)[0].stdout)


@pytest.mark.slow
def test_with_streams_closed_nothing_is_written_into_the_report(folder: Path):
    """A file takes the lowest number that is free, and what others print to standard output would go there."""

    def prepare() -> None:
        heard()
        os.closerange(0, 3)

    assert gainroom(folder, *COMMANDS["joint"], preexec_fn=prepare).returncode == 0
    page = (folder / "page.html").read_text("utf-8")
    assert page.startswith("<!DOCTYPE html")
    assert page.rstrip().endswith("</html>")
    wrong = gainroom(folder, "joint", "none.yaml", preexec_fn=prepare)
    assert (wrong.returncode, wrong.stdout, wrong.stderr) == (2, "", "")


@pytest.mark.slow
@pytest.mark.parametrize("call", CALLS, ids=" ".join)
def test_a_reader_that_has_left_and_a_full_disk_behind_the_answer(folder: Path, call: list[str]):
    read, write = os.pipe()
    os.close(read)
    run = gainroom(folder, *call, stdout=write)
    os.close(write)
    assert (run.returncode, run.stderr) == (0, "")
    with open("/dev/full", "w") as full:
        run = gainroom(folder, *call, stdout=full)
    assert run.returncode == 2
    assert run.stderr == f"gainroom: error: standard output: {os.strerror(errno.ENOSPC).lower()}\n"


def test_an_error_that_nobody_can_be_told_is_still_an_error(folder: Path):
    with open("/dev/full", "w") as full:
        run = gainroom(folder, "joint", "none.yaml", stderr=full)
    assert (run.returncode, run.stdout) == (2, "")
    run = gainroom(folder, "joint", "none.yaml", stderr=None, preexec_fn=lambda: (heard(), os.close(2)))
    assert (run.returncode, run.stdout) == (2, "")


# Places


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own with room for 1 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", place], capture_output=True, check=False)
    if made.returncode:
        pytest.skip("mounting is not allowed here")
    yield place
    subprocess.run(["umount", place], check=True)


@pytest.mark.slow
def test_a_disk_that_is_full_and_then_read_only(folder: Path, disk: Path):
    furnish(disk, old=True)
    before = contents(disk)
    run = gainroom(disk, *COMMANDS["joint"])
    assert run.stdout == undisturbed(*COMMANDS["joint"])[0].stdout
    assert (run.returncode, run.stderr) == (2, f"gainroom: error: page.html: cannot be written: {os.strerror(errno.ENOSPC).lower()}\n")
    assert contents(disk) == before
    subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
    for command in ("joint", "simulate csv"):
        run = gainroom(disk, *COMMANDS[command])
        assert (run.returncode, run.stdout, run.stderr.count("\n")) == (2, "", 1)
        assert "read-only" in run.stderr
    assert contents(disk) == before


@pytest.mark.parametrize("words", [["--report", "/proc/page.html"], ["--log", "/proc/run.csv"]])
def test_a_folder_that_takes_no_files(folder: Path, capsys: pytest.CaptureFixture[str], words: list[str]):
    assert "takes no new files" in refused(["simulate", folder / "played.yaml", *words], capsys)


@pytest.mark.slow
def test_a_folder_that_is_gone(folder: Path):
    """Full paths still work; a name alone is refused in one line."""
    gone = folder / "gone"

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        gone.mkdir()
        return gainroom(gone, *arguments, preexec_fn=lambda: (heard(), gone.rmdir()))

    for words in (["--report", "page.html"], ["--log", "run.csv"]):
        wrong = run("simulate", str(folder / "played.yaml"), *words)
        assert (wrong.returncode, wrong.stdout, wrong.stderr.count("\n")) == (2, "", 1)
        assert words[1] in wrong.stderr
    good = run("simulate", str(folder / "played.yaml"), "--log", str(folder / "run.csv"), "--exit-zero")
    assert (good.returncode, good.stderr) == (0, "")
    assert read_log(folder / "run.csv").complete


@pytest.mark.slow
@pytest.mark.parametrize("command", ["robot.yaml", str(BIPED)])
def test_no_place_for_temporary_files_is_needed(folder: Path, command: str):
    write_arm(folder)
    call = ["robot", command] if command.endswith("yaml") else ["audit", command, "--delay-ms", "2", "--gains", "gains.yaml", "--json"]
    run = gainroom(folder, *call, env=environment(TMPDIR="/proc/none", HOME="/proc/none"))
    assert run.stderr == ""
    assert run.returncode in (0, 1)
    assert run.stdout


@pytest.mark.slow
@pytest.mark.parametrize("columns", [0, 1, 39])
@pytest.mark.parametrize("told", ["by the environment", "by the terminal"])
def test_a_narrow_terminal_still_gets_the_answer(folder: Path, columns: int, told: str):
    variables = environment(COLUMNS=str(columns))
    if told == "by the terminal":
        del variables["COLUMNS"]
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    command = [sys.executable, "-m", "gainroom", "joint", "joint.yaml"]
    process = subprocess.Popen(command, cwd=folder, env=variables, stdout=follower, stderr=follower)
    os.close(follower)
    shown = b""
    with contextlib.suppress(OSError):  # EIO: the other end is closed
        while part := os.read(leader, 65536):
            shown += part
    os.close(leader)
    assert process.wait() == 0
    assert b"Traceback" not in shown
    words = b" ".join(shown.split())
    assert b"peak sensitivity" in words
    assert b"Safe" in words


# Signals

WHILE_LOADING = """
import os, sys
module, number, sys.argv = sys.argv[1], int(sys.argv[2]), ["gainroom", *sys.argv[3:]]
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            os.kill(os.getpid(), number)
sys.meta_path.insert(0, Finder())
from gainroom.cli import main
sys.exit(main())
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    "module",
    ["typer", "gainroom.cli.robot", "numpy", "gainroom.studies.joint", "pydantic", "gainroom.report.joint", "gainroom.report.page"],
)
def test_a_signal_while_it_loads_is_one_line(folder: Path, module: str, number: int):
    """The moment is the import of a module: no library on the way can swallow the signal or make an error of its own of it."""
    before = contents(folder)
    program = [sys.executable, "-c", WHILE_LOADING, module, str(int(number)), *COMMANDS["joint"]]
    run = subprocess.run(program, cwd=folder, capture_output=True, text=True, env=environment(), preexec_fn=heard, check=False)
    assert run.stderr == "gainroom: interrupted\n"
    assert run.returncode == 128 + number
    assert contents(folder) == before


def test_a_fault_of_the_program_is_not_unstable(folder: Path):
    """Status 1 is an answer; an exception that nobody foresaw is none."""
    program = "import gainroom.studies.joint as s; s.study_joint = None\nimport sys; from gainroom.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "joint", "joint.yaml"]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment(), check=False)
    assert run.returncode == 2
    assert "TypeError" in run.stderr


@pytest.mark.slow
def test_what_was_there_is_told_from_what_is_new(folder: Path):
    """The texts that the tests above compare are those that an undisturbed run replaces."""
    assert (folder / "page.html").read_text("utf-8") == OLD
    assert gainroom(folder, *COMMANDS["simulate csv"], "--exit-zero").returncode == 0
    assert (folder / "page.html").read_text("utf-8").rstrip().endswith("</html>")
    assert read_log(folder / "run.csv").complete
