"""Arrays of numpy.savez: read without numpy's reader, and without unpickling."""

import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gainroom.files.logs import log_reader, read_log
from log_files import Truth
from refusals import assert_refused


def test_records_and_what_is_no_array_of_numbers(tmp_path: Path):
    truth = Truth(80)
    record = np.zeros(80, [("time", "f8"), ("q", "f4"), ("mode", "U3"), ("tau", ">f8")])
    record["time"], record["q"], record["tau"] = truth.time, truth.motor_position[:, 0], truth.target_torque[:, 0]
    np.savez(tmp_path / "log.npz", log=record, objects=np.array([{}, None]), picture=np.zeros((2, 3, 4)), scalar=np.float64(3))
    with log_reader(tmp_path / "log.npz") as reader:
        log = reader.whole()
        assert any("objects" in note for note in reader.notes)
    assert np.array_equal(log.joint().channels["actual_torque"], truth.target_torque[:, 0])
    assert np.array_equal(log.joint().channels["motor_position"], truth.motor_position[:, 0].astype("f4"))


class Touch:
    """Unpickled, it would write a file."""

    def __reduce__(self):
        return (open, ("RUN", "w"))


def entry(described: str, shape: str = "(80,)", data: bytes = bytes(640), order: str = "False") -> bytes:
    header = f"{{'descr': {described}, 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


HOSTILE = {
    "objects": entry("'|O'", "()", pickle.dumps(Touch())),
    "bare pickle": pickle.dumps(Touch()),
    "objects in a record": entry("[('a', '|O')]", "(1,)", pickle.dumps(Touch())),
    "wide": entry("'<f8'", "(1000000000000,)"),
    "negative": entry("'<f8'", "(-1,)"),
    "no tuple": entry("'<f8'", "80"),
    "call": entry("__import__('os').system('touch RUN')"),
    "deep": entry("'<f8'", "(" * 5000),
    "long header": b"\x93NUMPY\x02\x00\xff\xff\xff\x7f",
    "no kind": entry("'nothing'"),
    "empty numbers": entry("'<U0'"),
    "many axes": entry("'<f8'", "(" + "1," * 100 + ")"),
    "cut": entry("'<f8'")[:-300],
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_arrays(name: str, tmp_path: Path, monkeypatch):
    """One line, and nothing is run: the working folder stays empty."""
    monkeypatch.chdir(tmp_path)
    whole = io.BytesIO()
    np.savez(whole, time=np.arange(80.0))
    path = tmp_path / "log.npz"
    path.write_bytes(whole.getvalue())
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("motor_position.npy", HOSTILE[name])
    assert_refused(lambda: read_log(path), ["log.npz"])
    assert not (tmp_path / "RUN").exists()
