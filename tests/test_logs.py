"""Logs in three formats: what is written comes back, whoever reads it, however the run ended; nothing that is no number gets in."""

import contextlib
import csv
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.files.logs import Log, LogOptions, log_reader, open_log, read_log
from gainroom.simulation.friction import Friction
from gainroom.simulation.run import simulate, stream
from gainroom.simulation.run_record import LOGGED
from gainroom.simulation.scenario import Scenario
from gainroom.simulation.testbed import Testbed
from gainroom.simulation.trajectories import Spline, Step
from log_files import read_in_this_process
from refusals import assert_refused

FORMATS = ("csv", "parquet", "mcap")
TICK = 5e-4
LOOP = gr.build_loop(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 4.348 * TICK), gr.PD(900.0, 25.0), sample_time=TICK)
SCENARIO = Scenario(Spline.move(0.3, 0.05), 0.1, noise=1e-5)
BED = Testbed(LOOP, Friction(1.0, 1.5), motor_resolution=1e-5)


def block(count: int, joints: int = 1, first: int = 0) -> dict[str, np.ndarray]:
    """Rows of which every number is another, with all its digits."""
    rng = np.random.default_rng([first, count])
    return {"time": TICK * (first + np.arange(count))} | {name: rng.normal(size=(count, joints)) / 3 for name in LOGGED}


def assert_same(log: Log, columns: dict[str, np.ndarray]) -> None:
    assert np.array_equal(log.time, columns["time"])
    assert set(log.signals) == set(columns) - {"time"}
    for name, values in log.signals.items():
        assert np.array_equal(values, columns[name]), name


@pytest.mark.parametrize("form", FORMATS)
def test_a_run_comes_back_to_the_last_digit(form, tmp_path: Path):
    """Written block by block as it is computed, against the run computed at once."""
    path = tmp_path / f"run.{form}"
    with open_log(path, LOOP.parts.plant.joint_names) as log:
        for part in stream(BED, SCENARIO, block=37):
            log.write(part.columns())
    found = read_log(path)
    assert_same(found, simulate(BED, SCENARIO).columns())
    assert found.complete
    assert found.joint_names == ("joint",)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("form", FORMATS)
def test_several_joints(form, tmp_path: Path):
    """Names with underscores, one of which begins like another."""
    names, columns = ("l_knee", "l", "r_knee_pitch"), block(50, 3)
    with open_log(tmp_path / f"robot.{form}", names) as log:
        log.write(columns)
    found = read_log(tmp_path / f"robot.{form}")
    assert found.joint_names == names
    assert_same(found, columns)


def test_csv_is_read_by_the_standard_library(tmp_path: Path):
    columns = block(20, 2)
    with open_log(tmp_path / "log.csv", ("a", "b")) as log:
        log.write(columns)
    rows = list(csv.DictReader((tmp_path / "log.csv").open(encoding="utf-8")))
    assert list(rows[0]) == ["time", *(f"{name}_{joint}" for name in LOGGED for joint in "ab")]
    assert [float(row["actual_torque_b"]) for row in rows] == columns["actual_torque"][:, 1].tolist()


def test_mcap_is_read_by_another_library(tmp_path: Path):
    """pybag's own reader of the format: indexes, checksums, schema, messages in the order of their time."""
    from pybag.mcap.record_reader import McapRecordReaderFactory

    columns = block(500, 2)
    with open_log(tmp_path / "log.mcap", ("l_knee", "r_knee")) as log:
        log.write({name: values[:123] for name, values in columns.items()})
        log.write({name: values[123:] for name, values in columns.items()})
    with McapRecordReaderFactory.from_file(tmp_path / "log.mcap", enable_crc_check=True) as reader:
        channels = {channel.topic: channel for channel in reader.get_channels().values()}
        assert set(channels) == {"/l_knee", "/r_knee"}
        assert reader.get_statistics().message_count == 1000
        for joint, topic in enumerate(("/l_knee", "/r_knee")):
            assert channels[topic].message_encoding == "json"
            schema = reader.get_channel_schema(channels[topic].id)
            assert schema.encoding == "jsonschema"
            assert json.loads(schema.data)["properties"]["motor_position"]["type"] == "number"
            messages = list(reader.get_messages(channels[topic].id))
            assert [message.log_time for message in messages] == [500_000 * k for k in range(500)]
            contents = [json.loads(message.data) for message in messages]
            assert set(contents[0]) == {"time", *LOGGED} == set(json.loads(schema.data)["required"])
            for name in LOGGED:
                assert [content[name] for content in contents] == columns[name][:, joint].tolist()


def test_parquet_is_one_table_of_doubles(tmp_path: Path):
    import pyarrow.parquet

    with open_log(tmp_path / "log.parquet", ("joint",)) as log:
        log.write(block(10))
        log.write(block(10, first=10))
    file = pyarrow.parquet.ParquetFile(tmp_path / "log.parquet")
    assert file.schema_arrow.names == ["time", *LOGGED]
    assert {str(kind) for kind in file.schema_arrow.types} == {"double"}
    assert file.metadata.num_rows == 20


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("ending", [KeyboardInterrupt, gr.GainroomError, MemoryError])
def test_an_interrupted_run_leaves_what_was_done(form, ending, tmp_path: Path):
    """And what ended it is not hidden."""
    path, columns = tmp_path / f"run.{form}", block(30)
    with pytest.raises(ending), open_log(path, ("joint",)) as log:  # noqa: PT012 - the block is what is interrupted
        log.write(columns)
        raise ending
    assert_same(read_log(path), columns)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("ending", [KeyboardInterrupt, gr.GainroomError])
def test_a_run_that_ends_before_its_first_row_leaves_what_was_there(form, ending, tmp_path: Path):
    """An older log as it was; no log where there was none."""
    path = tmp_path / f"run.{form}"

    def begin() -> None:
        with pytest.raises(ending), open_log(path, ("joint",)):
            raise ending

    begin()
    assert list(tmp_path.iterdir()) == []
    with open_log(path, ("joint",)) as log:
        log.write(block(30))
    begin()
    assert_same(read_log(path), block(30))
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("form", FORMATS)
def test_an_empty_run_that_ends_well_is_a_file_without_rows(form, tmp_path: Path):
    path = tmp_path / f"run.{form}"
    with open_log(path, ("joint",)):
        pass
    assert_refused(lambda: read_log(path), [f"run.{form}", "no messages with numbers" if form == "mcap" else "has no row"])


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
def test_a_full_disk_leaves_the_older_log(form, tmp_path: Path):
    """No file of the process may grow beyond 20 kB, which some way into the run is reached."""
    path = tmp_path / f"run.{form}"
    with open_log(path, ("joint",)) as log:
        log.write(block(30))
    program = (
        "import resource, sys, numpy as np; from gainroom.files.logs import open_log\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        "with open_log(sys.argv[1], ('joint',), ('target_torque',)) as log:\n"
        "    for first in range(0, 40_000, 400):\n"
        "        rows = np.random.default_rng(first).normal(size=(400, 1))\n"
        "        log.write({'time': 5e-4 * (first + np.arange(400)), 'target_torque': rows})\n"
    )
    run = subprocess.run([sys.executable, "-c", program, str(path)], check=False, capture_output=True, text=True)
    assert run.stderr.splitlines()[-1].endswith(f"GainroomError: {path}: cannot be written: file too large")
    assert_same(read_log(path), block(30))
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("form", ["csv", "mcap"])
def test_a_killed_run_leaves_what_was_flushed(form, tmp_path: Path):
    """Without any chance to close the file, as after a power cut: under its temporary name. (Parquet cannot: its index comes last.)"""
    path = tmp_path / f"run.{form}"
    path.write_bytes(b"an older log")
    program = (
        "import os, sys, numpy as np; from gainroom.files.logs import open_log\n"
        "with open_log(sys.argv[1], ('joint',), ('target_torque',)) as log:\n"
        "    for first in (0, 40):\n"
        "        log.write({'time': 5e-4 * (first + np.arange(40)), 'target_torque': np.ones((40, 1))})\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", program, str(path)], check=False)
    assert path.read_bytes() == b"an older log"
    (path,) = tmp_path.glob(f".gainroom-*.{form}")
    found = read_log(path)
    assert len(found.time) == 80
    assert found.complete == (form == "csv")  # a text file with its last newline lacks nothing
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])  # and the end of that lost too
    torn = read_log(path)
    assert not torn.complete
    assert 0 < len(torn.time) < 80
    assert np.array_equal(torn.time, found.time[: len(torn.time)])


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_no_number_ends_the_log_and_is_not_in_it(form, bad, tmp_path: Path):
    path, columns = tmp_path / f"run.{form}", block(30, 2)
    columns["actual_torque"][17, 1] = bad

    def run() -> None:
        with open_log(path, ("a", "b")) as log:
            log.write(columns)

    assert_refused(run, [f"run.{form}", "actual_torque", "0.0085 s", "not a finite number"])
    assert_same(read_log(path), {name: values[:17] for name, values in columns.items()})


@pytest.mark.parametrize("form", FORMATS)
def test_a_diverging_run_has_a_whole_log(form, tmp_path: Path):
    path = tmp_path / f"run.{form}"
    last = None
    with open_log(path, ("joint",)) as log:
        for part in stream(LOOP.scaled(10.0), Scenario(Step(0.1), 10.0), block=50):
            log.write(part.columns())
            last = part
    assert last is not None
    assert last.diverged
    found = read_log(path)
    assert found.time[-1] == pytest.approx(last.diverged_at - TICK)


def test_logs_of_others(tmp_path: Path):
    """Other names, fewer columns, columns of no concern, a byte order mark, Windows line ends."""
    path = tmp_path / "drive.csv"
    path.write_bytes(b"\xef\xbb\xbfstamp,cmd,temperature,motor_position\r\n0.0,1.5,40,0.1\r\n0.0005,1.6,41,0.2\r\n")
    found = read_log(path, {"time": "stamp", "target_torque": "cmd"})
    assert_same(
        found, {"time": np.array([0.0, 5e-4]), "target_torque": np.array([[1.5], [1.6]]), "motor_position": np.array([[0.1], [0.2]])}
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["empty"]),
        ("\n\n", ["empty"]),
        ("time,target_torque\n0,1\n1\n", ["row 2 has 1 fields", "2"]),
        (
            "time,target_torque\n0,1\n1,one\n2,3\n",
            ["row 2: target_torque: 'one' is not a number", "1 of the first 3 rows", "up to 2% are left out"],
        ),
        ("time,target_torque\n0,one\n", ["none of the columns", "it has time"]),
        ("time,target_torque\n0,nan\n", ["target_torque", "no number"]),
        ("time,colour\n0,1\n", ["none of the columns", "colour"]),
        ("when,target_torque\n0,1\n", ["no column time", "when", "sample rate"]),
        ("time,time\n0,1\n", ["'time'", "twice"]),
        ("0,1\n1,2\n", ["no column time", "it has 1, 2", "no header", "--columns time=1,motor_position=2"]),
        ("time,target_torque\n0,1\n1e300,2\n", ["time between first and last row"]),
        ("time,target_torque\n0,1e200\n1,1e200\n", ["target_torque", "1e+200", "unit"]),
        ("time,motor_position\n" + "".join(f"{k / 1e3},{3e5 + k}\n" for k in range(50)), ["motor_position", "rad", "unit"]),
        ("time,target_torque\n" + "0,1\n" * 50, ["49 of 50 rows", "time stamp of the row before", "sample rate"]),
        ("time,target_torque\n" + "".join(f"{k % 20},1\n" for k in range(50)), ["of 50 rows", "earlier"]),
        ("time,target_torque\n" + "".join(f"{k},{1 if k % 3 else ''}\n" + f"{k}.5,\n" for k in range(50)), ["of 100 rows lack a number"]),
    ],
)
def test_bad_csv_is_told_in_one_line(text, words, tmp_path: Path):
    path = tmp_path / "log.csv"
    path.write_text(text, "utf-8")
    assert_refused(lambda: read_log(path), ["log.csv", *words])


def test_a_damaged_mcap_is_told_in_one_line(tmp_path: Path, monkeypatch):
    """One byte changed, in a hundred places: rows that come back are right, and what is wrong is told as an error of this package."""
    read_in_this_process(monkeypatch)
    path = tmp_path / "log.mcap"
    with open_log(path, ("joint",)) as log:
        log.write(block(60))
    whole = path.read_bytes()
    for place in range(8, len(whole), len(whole) // 100):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        with contextlib.suppress(gr.GainroomError):
            found = read_log(path)
            assert np.array_equal(found.signals["target_torque"], block(60)["target_torque"][: len(found.time)])


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("content", [b"", b"\x00\xff\xfe" * 50, b"PAR1 and nothing else", b"\x89MCAP0\r\n\x01\x02\x03"])
def test_other_files_are_told_from_logs(form, content, tmp_path: Path):
    path = tmp_path / f"log.{form}"
    path.write_bytes(content)
    assert_refused(lambda: read_log(path), [f"log.{form}"])


def test_paths_that_cannot_be(tmp_path: Path):
    def write(name: str, joints: tuple[str, ...] = ("joint",), signals: tuple[str, ...] = LOGGED) -> None:
        with open_log(tmp_path / name, joints, signals):
            pass

    (tmp_path / "folder.csv").mkdir()
    assert_refused(lambda: write("run.txt"), ["run.txt", ".csv, .parquet, .mcap"])
    assert_refused(lambda: write("folder.csv"), ["folder.csv", "directory"])
    for form in FORMATS:
        assert_refused(lambda form=form: write(f"none/run.{form}"), ["run.", "no directory"])
    assert_refused(lambda: write("run.csv", ("a", "a")), ["'a'", "differ"])
    assert_refused(lambda: write("run.csv", ()), ["one or more"])
    assert_refused(lambda: write("run.csv", ("a",), ("speed",)), ["'speed'", "target_torque"])
    assert_refused(lambda: read_log(tmp_path / "none.csv"), ["none.csv", "no such file"])
    assert_refused(lambda: read_log(tmp_path / "folder.csv"), ["folder.csv", "directory"])
    assert_refused(lambda: read_log(tmp_path / "run.log"), ["run.log", ".csv"])
    good = tmp_path / "good.csv"
    good.write_text("time,target_torque\n0,1\n", "utf-8")
    assert_refused(lambda: read_log(good, {"actual_torque": "iq"}), ["good.csv", "'iq'", "target_torque"])


def test_blocks_that_do_not_fit(tmp_path: Path):
    def write(columns: dict[str, np.ndarray]) -> None:
        with open_log(tmp_path / "run.csv", ("joint",)) as log:
            log.write(columns)

    assert_refused(lambda: write(block(5, 2)), ["target_torque of shape (5, 2)", "(5, 1)"])
    assert_refused(lambda: write({"time": np.zeros(3)}), ["no target_torque"])


def test_a_missing_library_is_named(tmp_path: Path, monkeypatch):
    read_in_this_process(monkeypatch)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (tmp_path / "run.parquet").write_bytes(b"")
    assert_refused(lambda: read_log(tmp_path / "run.parquet"), ["pyarrow", "pip install 'gainroom[logs]'"])


def test_a_link_stays_a_link(tmp_path: Path):
    for form in FORMATS:
        target, link = tmp_path / f"target.{form}", tmp_path / f"link.{form}"
        os.symlink(target, link)
        with open_log(link, ("joint",)) as log:
            log.write(block(3))
        assert link.is_symlink()
        assert_same(read_log(target), block(3))


def damaged_csv(path: Path, count: int, edits: dict[int, str]) -> Path:
    """A log of `count` rows, of which those of these numbers, from 1, are replaced."""
    rows = [f"{k * 1e-3!r},{k % 7},{k % 5 / 10}\n" for k in range(count)]
    for row, text in edits.items():
        rows[row - 1] = text + "\n"
    path.write_text("time,target_torque,motor_position\n" + "".join(rows), "utf-8")
    return path


def test_a_few_garbled_rows_are_left_out_and_each_is_named(tmp_path: Path):
    """As rows without a number are: a byte lost on a serial line must not cost the whole recording."""
    edits = {7: "0.006,0.3x,0.1", 100: "0.099,#", 412: "0.4a,1,0.2", 413: "0.412,¿,x"}
    log = read_log(damaged_csv(tmp_path / "log.csv", 500, edits))
    whole = read_log(damaged_csv(tmp_path / "whole.csv", 500, {}))
    left = np.delete(np.arange(500), [row - 1 for row in edits])
    np.testing.assert_array_equal(log.time, whole.time[left])
    np.testing.assert_array_equal(log.signals["target_torque"], whole.signals["target_torque"][left])
    assert log.quality.not_finite == len(edits)
    assert log.notes == (
        "4 damaged rows left out: row 7: target_torque: '0.3x' is not a number; row 100 has 2 fields, not the 3 of the first line; "
        "row 412: time: '0.4a' is not a number; row 413: target_torque: '¿', motor_position: 'x' is not a number",
    )


def test_two_in_a_hundred_are_left_out_and_more_are_refused_by_name(tmp_path: Path):
    bad = dict.fromkeys(range(3, 1000, 50), "x,1,1")
    assert len(bad) == 20
    assert len(read_log(damaged_csv(tmp_path / "log.csv", 1000, bad)).time) == 980
    with pytest.raises(gr.GainroomError) as caught:
        read_log(damaged_csv(tmp_path / "log.csv", 1000, bad | dict.fromkeys(range(5, 205, 20), "x,1,1")))
    problems = caught.value.problems
    assert problems[0] == f"{tmp_path / 'log.csv'}: 30 of the first 1000 rows are damaged; up to 2% are left out, more are refused"
    assert problems[1] == f"{tmp_path / 'log.csv'}: row 3: time: 'x' is not a number"
    assert problems[-1] == "and 12 more"
    assert len(problems) == 20


def test_damage_is_counted_over_blocks_and_anew_at_every_reading(tmp_path: Path):
    path = damaged_csv(tmp_path / "log.csv", 70_000, {10: "bad,1,1", 69_000: "69,1"})  # BLOCK_ROWS are 65,536
    for _ in range(2):
        log = read_log(path)
        assert len(log.time) == 69_998
        assert [note.partition(":")[0] for note in log.notes] == ["2 damaged rows left out"]
        assert "row 69000 has 2 fields" in log.notes[0]


def test_other_columns_may_hold_anything(tmp_path: Path):
    path = damaged_csv(tmp_path / "log.csv", 200, {5: "0.004,1,x"})
    assert len(read_log(path, options=LogOptions(columns={"target_torque": "target_torque"})).time) == 199
    path.write_text("time,target_torque,state\n" + "".join(f"{k * 1e-3!r},{k % 3},{'ok' if k % 3 else 7}\n" for k in range(200)), "utf-8")
    assert len(read_log(path).time) == 200


def test_reading_tells_how_much_of_a_text_it_has_passed(tmp_path: Path):
    """By bytes: of three blocks of rows of nearly equal length a little more and less than a third."""
    told: list[tuple[int, int, str]] = []
    path = damaged_csv(tmp_path / "log.csv", 3 * 65_536, {})
    with log_reader(path, None, lambda *each: told.append(each)) as reader:
        assert sum(len(block.time) for block in reader.blocks()) == 3 * 65_536
    assert [total for _, total, _ in told] == [1000] * 3
    assert [done / 1000 for done, _, _ in told] == pytest.approx([1 / 3, 2 / 3, 1], abs=0.05)  # rows grow with their time's digits
    assert {what for *_, what in told} == {"reading log.csv"}
