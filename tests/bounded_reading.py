"""Reading a log within bounds of memory and time, in a process that has loaded the libraries and nothing else."""

import importlib
import multiprocessing
import resource
from multiprocessing.connection import Connection
from pathlib import Path

LIBRARIES = ["h5py", "lz4.frame", "mcap.stream_reader", "numpy", "pyarrow.parquet", "zstandard", "gainroom.files.logs"]
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(LIBRARIES)


def in_bounds(path: Path, memory: int, seconds: int) -> str:
    """The shape of the log, or why it is refused; `memory` [bytes] beside what the libraries take, processor time [s]."""
    theirs, ours = PROCESSES.Pipe(duplex=False)
    process = PROCESSES.Process(target=_say, args=(ours, path, memory, seconds))
    process.start()
    ours.close()
    with theirs:
        said = theirs.recv()  # EOFError where the process died of it
    process.join()
    assert process.exitcode == 0
    return said


def _say(answer: Connection, path: Path, memory: int, seconds: int) -> None:
    for name in LIBRARIES:
        importlib.import_module(name)
    from gainroom.errors import GainroomError
    from gainroom.files.logs import read_log

    most = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    try:
        said = f"answer {read_log(path).time.shape}"
    except GainroomError as error:
        said = str(error)
    answer.send(said)
