"""Damaged and hostile logs of every format: an answer or one line, never a traceback; in bounded time and memory, and nothing is run.

A seeded share runs every time, all with `pytest -m population`. Other draws: GAINROOM_SEED=7; other sizes: GAINROOM_POPULATION=500.
"""

import json
import os
import shutil
import signal
import sqlite3
import struct
import traceback
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from bounded_reading import in_bounds
from gainroom.files.logs import read_log
from gainroom.files.logs.table import MOST_PIECE
from log_files import WRITERS, Truth, damaged_file, torch_pickle, write_bag, write_torch
from mutations import mutated_bytes, mutated_data
from refusals import assert_refused

SEED = int(os.environ.get("GAINROOM_SEED", "2017"))
WHOLE = int(os.environ.get("GAINROOM_POPULATION", "1000"))
SHARE = min(30, WHOLE)
IN_THIS_PROCESS = ("log.csv", "log.json", "log.npz", "log.pt")
GUARDED_SHARE = 8
"""Of the other formats, for which a process is started."""
MOST_SECONDS = 10.0
MOST_MEMORY = 600 << 20
"""Bytes beyond what the libraries themselves take."""
LENGTHS = (b"\xff" * 4, b"\xff" * 8, b"\x7f\xff\xff\xff", struct.pack("<Q", 1 << 40), struct.pack("<I", 1 << 30), b"\0" * 8)
"""What stands in a file where it says how much of something follows."""


CELLS = (("messages", "data"), ("topics", "type"), ("message_definitions", "encoded_message_definition"))
"""Of a bag's database: what a reader looks into."""


class TooLong(BaseException):
    """What stops a reading; no handler of errors takes it for one of its own."""


@cache
def content(name: str, folder: Path) -> bytes:
    """A whole file of a format, small, and without checksums where it can do without: damage shall get further than these."""
    place = folder / "whole" / name
    place.parent.mkdir(exist_ok=True)
    if name == "plain.mcap":
        from mcap.writer import CompressionType, Writer

        with place.open("wb") as file:
            writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False, chunk_size=1000)
            writer.start()
            channel = writer.register_channel("/hip", "json", 0)
            for k in range(80):
                writer.add_message(channel, log_time=10**6 * k, publish_time=0, data=b'{"motor_position": %d, "target_torque": 1.5}' % k)
            writer.finish()
    elif name == "plain.mat":
        import scipy.io

        truth = Truth(80)
        scipy.io.savemat(place, {"t": truth.time, "s": {"q": truth.motor_position[:, 0]}, "tau": truth.target_torque})
    else:
        WRITERS[name](place, Truth(80))
    return damaged_file(place).read_bytes()


NAMES = (*WRITERS, "plain.mcap", "plain.mat")


def damage(random: Random, name: str, whole: bytes, path: Path) -> None:
    """Writes a log with one to three places changed: of its bytes, or of what is in it."""
    times = random.choice((1, 1, 2, 3))
    if name == "log.json" and random.random() < 0.7:
        data = json.loads(whole)
        for _ in range(times):
            data = mutated_data(random, data)
        path.write_text(json.dumps(data), "utf-8")
    elif name == "log.pt" and random.random() < 0.7:
        _damage_zip(random, whole, path, times)
    elif name == "bag" and random.random() < 0.7:
        path.write_bytes(whole)
        with sqlite3.connect(path) as database:
            for _ in range(times):
                table, column = random.choice(
                    (("messages", "data"), ("topics", "type"), ("message_definitions", "encoded_message_definition"))
                )
                rows = database.execute(f"SELECT rowid, {column} FROM {table}").fetchall()
                number, value = random.choice(rows)
                raw = _changed(random, value if isinstance(value, bytes) else value.encode(), 1)
                database.execute(
                    f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (raw if column == "data" else raw.decode("latin-1"), number)
                )
    else:
        path.write_bytes(_changed(random, whole, times))


def _changed(random: Random, raw: bytes, times: int) -> bytes:
    for _ in range(times):
        if not raw:
            return raw
        if random.random() < 0.3:
            place, value = random.randrange(len(raw)), random.choice(LENGTHS)
            raw = raw[:place] + value + raw[place + len(value) :]
        else:
            raw = mutated_bytes(random, raw, LENGTHS)
    return raw


def _damage_zip(random: Random, whole: bytes, path: Path, times: int) -> None:
    path.write_bytes(whole)
    with zipfile.ZipFile(path) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    name = random.choice(["log/data.pkl", "log/data.pkl", *entries])
    entries[name] = _changed(random, entries[name], times)
    with zipfile.ZipFile(path, "w") as archive:
        for entry, data in entries.items():
            archive.writestr(entry, data)


def outcome(path: Path) -> tuple[str, str]:
    """How reading ended: "answer", "refusal", or what must not be, with its words."""

    def stop(*_: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
    try:
        log = read_log(path)
    except gr.GainroomError as error:
        text = str(error)
        lines = path.name in text and all("\n" not in line and len(line) < 900 for line in error.problems)
        return ("refusal" if lines else "not one line", text)
    except TooLong:
        return "too long", "".join(traceback.format_exc().splitlines(keepends=True)[-6:])
    except BaseException:  # noqa: BLE001 - counted and reported with its traceback
        return "traceback", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    arrays = [log.time, *(values for channels in log.joints.values() for values in channels.values())]
    if not all(np.isfinite(values).all() and len(values) == len(log.time) for values in arrays) or np.any(np.diff(log.time) <= 0):
        return "no log", repr(log)
    return "answer", ""


def population(name: str, indices: range, folder: Path) -> None:
    counts: Counter[str] = Counter()
    wrong = []
    whole = content(name, folder)
    for index in indices:
        random = Random(f"{SEED} {name} {index}")
        path = folder / (f"damaged.{'db3' if name == 'bag' else 'mcap' if name == 'bag_mcap' else name.rsplit('.', 1)[-1]}")
        damage(random, name, whole, path)
        what, text = outcome(path)
        counts[what] += 1
        if what not in ("answer", "refusal"):
            wrong.append(f"number {index}, {what}: {text}")
    print(f"{len(indices)} damaged {name}, seed {SEED}: " + ", ".join(f"{count} {what}" for what, count in counts.most_common()))
    assert not wrong, f"{len(wrong)} of {len(indices)} ({dict(counts)}):\n" + "\n".join(wrong[:5])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_share_of_the_damaged_logs(name: str, tmp_path: Path):
    population(name, range(SHARE if name in IN_THIS_PROCESS else min(GUARDED_SHARE, SHARE)), tmp_path)


@pytest.mark.population
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", NAMES)
def test_all_damaged_logs(name: str, tmp_path: Path):
    population(name, range(WHOLE), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_file_that_ends_too_early(name: str, tmp_path: Path):
    """Wherever it ends: one line, or the rows up to there, and then it is said that the file is not complete."""
    whole = content(name, tmp_path)
    suffix = "db3" if name == "bag" else "mcap" if name == "bag_mcap" else name.rsplit(".", 1)[-1]
    for part in (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
        path = tmp_path / f"short.{suffix}"
        path.write_bytes(whole[: int(part * len(whole))])
        what, text = outcome(path)
        assert what in ("answer", "refusal"), text
        if what == "answer" and suffix in ("csv", "mcap"):
            assert not read_log(path).complete


@cache
def packed_zeros(head: bytes = b"", parts: int = 64) -> bytes:
    """1 GB, and something before them, by deflate: 16 MB packed once, as many times over."""
    packer, zeros = zlib.compressobj(6), bytes(1 << 24)
    start = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH)
    packed = packer.compress(zeros) + packer.flush(zlib.Z_FULL_FLUSH)  # refers to nothing before it
    low, high = zlib.adler32(head) & 0xFFFF, zlib.adler32(head) >> 16
    checksum = (high + parts * len(zeros) * low) % 65521 << 16 | low
    return start + parts * packed + b"\x03\0" + struct.pack(">I", checksum)


def test_packed_zeros():
    """Two such parts, unpacked: 64 are as good."""
    assert zlib.decompress(packed_zeros(b"head", 2)) == b"head" + bytes(1 << 25)


def hdf5_bomb(path: Path) -> None:
    """A chunk of 8 kB whose 1 MB unpack to 1 GB."""
    import h5py

    with h5py.File(path, "w") as file:
        file["time"] = 1e-3 * np.arange(1024)
        data = file.create_dataset("q", (1024,), "f8", chunks=(1024,), compression="gzip")
        data.id.write_direct_chunk((0,), packed_zeros())


def hdf5_wide(path: Path) -> None:
    """8 TB announced, none of it there."""
    import h5py

    with h5py.File(path, "w") as file:
        for name in ("time", "q"):
            file.create_dataset(name, (10**12,), "f8", chunks=(1024,), compression="gzip")


def hdf5_chunk(path: Path) -> None:
    """One chunk of 3 GB."""
    import h5py

    with h5py.File(path, "w") as file:
        for name in ("time", "q"):
            data = file.create_dataset(name, (10**6,), "f8", chunks=(4 * 10**8,), maxshape=(None,), compression="gzip")
            data.id.write_direct_chunk((0,), zlib.compress(bytes(1 << 20)))


def _matlab(*elements: bytes) -> bytes:
    return b"MATLAB 5.0".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49) + b"".join(elements)


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def _array(kind: int, shape: tuple[int, int], *rest: bytes) -> bytes:
    head = _element(6, struct.pack("<II", kind, 0)) + _element(5, struct.pack("<2i", *shape)) + _element(1, b"q")
    return _element(14, head + b"".join(rest))


def mat_bomb(path: Path) -> None:
    """1 MB that unpack to 1 GB, though they announce 8 kB."""
    packed = packed_zeros(struct.pack("<II", 14, 8192))
    path.write_bytes(_matlab(struct.pack("<II", 15, len(packed)) + packed))


def mat_cells(path: Path) -> None:
    """A cell array of 2^28 entries in 184 bytes: scipy takes 2 GiB for it."""
    path.write_bytes(_matlab(_array(1, (2**28, 1))))


def mat_letters(path: Path) -> None:
    path.write_bytes(_matlab(_array(4, (2**28, 1), _element(4, b""))))


def mat_numbers(path: Path) -> None:
    path.write_bytes(_matlab(_array(6, (2**28, 1), _element(2, b"\1"))))


def mcap_announces(path: Path) -> None:
    """A chunk that would be a terabyte."""
    path.write_bytes(b"\x89MCAP0\r\n\x06" + struct.pack("<Q", 1 << 40) + bytes(100))


def _chunk(compression: bytes, data: bytes, size: int) -> bytes:
    body = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression + struct.pack("<Q", len(data)) + data
    return b"\x89MCAP0\r\n\x06" + struct.pack("<Q", len(body)) + body


def mcap_zstd(path: Path) -> None:
    """A chunk that announces 1 kB and unpacks to 1 GB."""
    import zstandard

    packer = zstandard.ZstdCompressor(level=1).compressobj()
    zeros = bytes(1 << 24)
    path.write_bytes(_chunk(b"zstd", b"".join(packer.compress(zeros) for _ in range(64)) + packer.flush(), 1000))


def mcap_zstd_honest(path: Path) -> None:
    import zstandard

    packer = zstandard.ZstdCompressor(level=1).compressobj()
    zeros = bytes(1 << 24)
    path.write_bytes(_chunk(b"zstd", b"".join(packer.compress(zeros) for _ in range(64)) + packer.flush(), 1 << 30))


def mcap_lz4(path: Path) -> None:
    import lz4.frame

    packer = lz4.frame.LZ4FrameCompressor()
    zeros = bytes(1 << 24)
    data = packer.begin() + b"".join(packer.compress(zeros) for _ in range(64)) + packer.flush()
    path.write_bytes(_chunk(b"lz4", data, 1000))


def torch_bomb(path: Path) -> None:
    """An entry that unpacks to 1 GB."""
    arrays = {"time": np.arange(10.0), "dof_pos": np.zeros((10, 2))}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("log/data.pkl", torch_pickle(arrays))
        with archive.open("log/data/0", "w", force_zip64=True) as entry:
            for _ in range(65):
                entry.write(bytes(1 << 24))


def torch_overlap(path: Path) -> None:
    """Tensors that all look at one number, a thousand million times."""
    arrays = {"time": np.arange(10.0), "dof_pos": np.zeros((10, 2))}
    wide = torch_pickle({"time": arrays["time"], "dof_pos": np.lib.stride_tricks.as_strided(np.zeros(1), (10**9, 2), (0, 0))})
    write_torch(path, arrays, wide)


def parquet_bomb(path: Path) -> None:
    """A page of 0.2 MB that is, and announces, a little over 0.25 GB."""
    import pyarrow
    import pyarrow.parquet

    rows = (1 << 25) + 1000
    table = pyarrow.table({name: pyarrow.array(np.zeros(rows)) for name in ("time", "motor_position")})
    pages: dict[str, Any] = {"data_page_size": 1 << 31, "row_group_size": rows, "write_batch_size": rows, "max_rows_per_page": rows}
    pyarrow.parquet.write_table(table, path, compression="zstd", use_dictionary=False, **pages)


def csv_line(path: Path) -> None:
    """A header that does not end: a sparse file of 4 GB."""
    with path.open("wb") as file:
        file.write(b"time,motor_position")
        file.seek(1 << 32)
        file.write(b"\n0,1\n")


def json_deep(path: Path) -> None:
    path.write_text('{"entries": ' + "[" * 10**6, "utf-8")


BOMBS: dict[str, tuple[Callable[[Path], None], tuple[str, ...]]] = {
    "packed.h5": (hdf5_bomb, ("q", "packed chunk", "must be at most")),
    "wide.h5": (hdf5_wide, ("must be at most",)),
    "chunk.h5": (hdf5_chunk, ("chunk", "must be at most")),
    "packed.mat": (mat_bomb, ()),
    "cells.mat": (mat_cells, ()),
    "letters.mat": (mat_letters, ()),
    "numbers.mat": (mat_numbers, ("1 numbers",)),
    "announces.mcap": (mcap_announces, ("1099511627776",)),
    "zstd.mcap": (mcap_zstd, ("1000 bytes", "more")),
    "honest.mcap": (mcap_zstd_honest, ("must be at most", str(MOST_PIECE))),
    "lz4.mcap": (mcap_lz4, ("1000 bytes", "more")),
    "packed.pt": (torch_bomb, ("must be at most",)),
    "overlap.pt": (torch_overlap, ("dof_pos",)),
    "page.parquet": (parquet_bomb, ("page", "must be at most")),
    "line.csv": (csv_line, ("line 1",)),
    "deep.json": (json_deep, ("JSON",)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BOMBS)
def test_bombs(name: str, tmp_path: Path):
    """Files that unpack to more than there is, or announce it."""
    write, words = BOMBS[name]
    write(tmp_path / name)
    said = in_bounds(tmp_path / name, MOST_MEMORY, int(MOST_SECONDS))
    assert said.startswith(str(tmp_path / name)), said
    assert not [word for word in words if word not in said], said


CALLS = {
    "reduce": b"\x80\x02cos\nsystem\nX\x09\x00\x00\x00touch RUN\x85R.",
    "inst": b"(X\x09\x00\x00\x00touch RUNios\nsystem\n.",
    "obj": b"(cos\nsystem\nX\x09\x00\x00\x00touch RUNo.",
    "stack": b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x09touch RUN\x85R.",
    "build": b"\x80\x02}(X\x04\x00\x00\x00timectorch._utils\n_rebuild_tensor_v2\n}b.",
    "eval": b"\x80\x02c__builtin__\neval\nX\x12\x00\x00\x00open('RUN','w')    \x85R.",
    "tensor": b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\nX\x01\x00\x00\x00a\x85R.",
    "memory": b"\x80\x02}r\xff\xff\xff\xff.",
    "numbers": b"\x80\x02\x8b\xff\xff\xff\x7f.",
    "endless": b"\x80\x02}",
    "nothing": b".",
}


@pytest.mark.parametrize("name", CALLS)
def test_a_pickle_calls_nothing(name: str, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arrays = {"time": np.arange(10.0), "dof_pos": np.zeros((10, 2))}
    write_torch(tmp_path / "log.pt", arrays, CALLS[name])
    assert_refused(lambda: read_log(tmp_path / "log.pt"), ["log.pt"])
    assert not (tmp_path / "RUN").exists()


def test_nested_tuples_as_a_key(tmp_path: Path):
    """2^60 entries in 150 bytes: nobody counts them, compares them or writes them into a message."""
    nest = b"".join(b"q" + bytes([k]) + b"h" + bytes([k]) + b"\x86" for k in range(60))
    for end in (b"NsR.", b"Ns.", b"QN.", b"\x85ctorch\nFloatStorage\nR."):
        write_torch(tmp_path / "log.pt", {}, b"\x80\x02}N\x85" + nest + end)
        assert outcome(tmp_path / "log.pt")[0] == "refusal"


def test_hdf5_that_leads_elsewhere(tmp_path: Path):
    """External links, raw data in other files, virtual data sets and soft links are not followed."""
    import h5py

    numbers = np.arange(100.0)
    numbers.tofile(tmp_path / "raw")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["q"] = numbers
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"], file["tau"] = 1e-3 * numbers, numbers
        file["q"] = h5py.ExternalLink("other.h5", "q")
        file["velocity"] = h5py.SoftLink("/tau")
        file.create_dataset("motor_position", (100,), "f8", external=[(str(tmp_path / "raw"), 0, 800)])
        layout = h5py.VirtualLayout((100,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "q", (100,))
        file.create_virtual_dataset("link_position", layout)
        group = file.create_group("loop")
        group["loop"] = group
    log = read_log(tmp_path / "log.h5")
    assert set(log.joint().channels) == {"actual_torque"}
    assert [word for word in ("q (a link)", "velocity (a link)", "motor_position", "link_position") if word not in log.notes[0]] == []


def test_a_filter_that_would_load_code(tmp_path: Path):
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"], file["tau"] = 1e-3 * np.arange(100), np.arange(100.0)
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((100,))
        plist.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
        h5py.h5d.create(file.id, b"q", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((100,)), plist)
    log = read_log(tmp_path / "log.h5")
    assert set(log.joint().channels) == {"actual_torque"}
    assert "filter 32015" in log.notes[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT * FROM m",
        "DROP TABLE messages; CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "data AS (zeroblob(1000000000)))",
        "DROP TABLE topics",
        "UPDATE messages SET data = zeroblob(200000000) WHERE id < 3",
        "UPDATE topics SET type = 'no_msgs/msg/Such'; UPDATE message_definitions SET topic_type = 'x'",
    ],
)
def test_a_hostile_database(change: str, tmp_path: Path):
    write_bag(tmp_path / "bag", Truth(80))
    (file,) = (tmp_path / "bag").glob("*.db3")
    with sqlite3.connect(file) as database:
        database.executescript(change)
    assert in_bounds(file, MOST_MEMORY, int(MOST_SECONDS)).startswith(
        (str(file), "answer (7")
    )  # one message of 80 that is too long costs nothing


def test_things_that_are_no_files(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "folder.h5").mkdir()
    (tmp_path / "empty.mat").touch()
    shutil.copy(__file__, tmp_path / "source.parquet")
    for name in ("pipe.csv", "folder.h5", "empty.mat", "source.parquet"):
        assert_refused(lambda name=name: read_log(tmp_path / name), [name])
