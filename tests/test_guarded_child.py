"""What a library does to itself with a hostile file stays in the child that reads it: one line about the file, in bounded time."""

import os
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.files.logs import read_log
from gainroom.io import guarded_child as module
from gainroom.io.guarded_child import GuardedChild, guarded_child
from refusals import assert_refused

TITLE = "a strange file"
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such bound")
END = {
    "abort": "is damaged: the library for a strange file fails on it",
    "crash": "is damaged: the library for a strange file fails on it",
    "exit": "is damaged: the library for a strange file fails on it",
    "vast": "is damaged: the library for a strange file fails on it",
    "recursion": "is not a strange file that can be read: maximum recursion depth exceeded",
    "raise": "is not a strange file that can be read: the library's words in two lines",
}
"""Ways to misbehave, and what is said of them."""


@pytest.fixture
def strange(tmp_path: Path) -> Path:
    path = tmp_path / "strange.file"
    path.write_bytes(b"strange")
    return path


def child_of(path: Path, *at_once: str):
    return guarded_child(path, TITLE, "misbehaving_readers", *at_once)


def is_gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.parametrize("what", END)
def test_a_library_that_fails(what: str, strange: Path):
    with child_of(strange) as child:
        pid = child.about["pid"]
        assert_refused(lambda: child.ask(what), [f"{strange}: {END[what]}"])
    assert is_gone(pid)


@pytest.mark.parametrize("what", ["abort", "raise"])
def test_a_library_that_fails_as_it_opens(what: str, strange: Path):
    def read() -> None:
        with child_of(strange, what) as child:
            assert not child.about

    assert_refused(read, [f"{strange}: {END[what]}"])


@pytest.mark.parametrize("what", ["sleep", "half"])
def test_a_library_that_never_answers(what: str, strange: Path, monkeypatch):
    with child_of(strange) as child:
        pid = child.about["pid"]
        monkeypatch.setattr(child, "_seconds", 0.2)
        assert_refused(lambda: child.ask(what), [f"{strange}: is not {TITLE} that can be read in 0 s"])
        with pytest.raises(gr.GainroomError):
            child.ask("more")
    assert is_gone(pid)


@LINUX
def test_more_memory_than_a_file_may_take(strange: Path):
    with child_of(strange) as child:
        assert_refused(lambda: child.ask("memory"), [f"{strange}: reading it takes more than 3 GiB of memory"])


def test_a_refusal_keeps_its_lines(strange: Path):
    with child_of(strange) as child, pytest.raises(gr.GainroomError) as caught:
        child.ask("refuse")
    assert caught.value.problems == (f"{strange}: first", f"{strange}: second")


def test_what_a_library_prints_is_no_answer(strange: Path):
    with child_of(strange) as child:
        for _ in range(2):
            answer, array = child.ask("print")
            assert set(answer) == {"pid", "modules"}
            assert np.array_equal(array, [[0, 1, 2], [3, 4, 5]])


@LINUX
def test_nothing_is_written(strange: Path):
    with child_of(strange) as child:
        assert_refused(lambda: child.ask("write"), [str(strange)])
    assert not (strange.parent / "written").is_file() or not (strange.parent / "written").read_bytes()


@LINUX
def test_no_network(strange: Path):
    """Where the system lets a process give its network up; a container may not."""
    separable = subprocess.run(
        [sys.executable, "-c", f"import ctypes; raise SystemExit(ctypes.CDLL(None).unshare({_own_network()}) != 0)"], check=False
    )
    if separable.returncode:
        pytest.skip("this system gives no process a network of its own")
    with socket.create_server(("127.0.0.1", 0)) as server:
        strange.write_text(str(server.getsockname()[1]))
        with child_of(strange) as child:
            assert child.ask("network")[0]["network"] != "connected"


def _own_network() -> int:
    return module.CLONE_NEWNET if os.geteuid() == 0 else module.CLONE_NEWUSER | module.CLONE_NEWNET


def test_several_at_a_time(strange: Path):
    """One that sleeps holds no other up."""
    found: list[GuardedChild] = []

    def read() -> None:
        with child_of(strange) as child:
            found.append(child)
            child.ask("print")

    with child_of(strange):
        threads = [threading.Thread(target=read) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len({child.about["pid"] for child in found}) == 3


@LINUX
def test_the_child_ends_with_its_parent(strange: Path):
    """Also with one that is killed."""
    code = (
        "import os, signal\nfrom pathlib import Path\nfrom gainroom.io.guarded_child import guarded_child\n"
        f"with guarded_child(Path({str(strange)!r}), 'x', 'misbehaving_readers') as child:\n"
        "    print(child.about['pid'], flush=True)\n    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    paths = os.pathsep.join(folder for folder in sys.path if folder)
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": paths}, check=False
    )
    until = time.monotonic() + 60
    while not is_gone(int(said.stdout)):
        assert time.monotonic() < until
        time.sleep(0.02)


def mcap_brackets(path: Path) -> None:
    """Eight brackets in a definition: rosbags' parser tries all ways out of them."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("a/msg/B", "ros2idl", b"const long X = " + 12 * b"(" + b"1" + 12 * b")" + b";")
        channel = writer.register_channel("/b", "cdr", schema)
        writer.add_message(channel, 0, struct.pack("<4sd", b"\0\1\0\0", 1.0), 0)
        writer.finish()


@pytest.mark.slow
def test_a_definition_that_is_parsed_for_ever(tmp_path: Path, monkeypatch):
    path = tmp_path / "brackets.mcap"
    mcap_brackets(path)
    monkeypatch.setattr(module, "LEAST_SECONDS", 8.0)  # longer than a start takes
    assert_refused(lambda: read_log(path), [f"{path}: is not an MCAP file that can be read in 8 s"])
