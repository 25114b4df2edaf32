"""Text as spreadsheets, drives and `rostopic echo -p` write it: times of day, no header, UTF-16, names of joints beside their numbers."""

import csv
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gainroom.files.logs import LogOptions, log_reader, read_log
from refusals import assert_refused

ROWS = 300
TICK = timedelta(microseconds=500)
ANGLE = np.random.default_rng(0).normal(size=(ROWS, 2))


def log_of(path: Path, stamps: list[str], encoding: str = "utf-8", delimiter: str = ",") -> Path:
    with path.open("w", encoding=encoding, newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(["time", "motor_position"])
        writer.writerows(zip(stamps, map(repr, ANGLE[:, 0].tolist()), strict=True))
    return path


def begun(text: str) -> list[datetime]:
    start = datetime.fromisoformat(text)
    return [start + k * TICK for k in range(ROWS)]


def clock(times: list[datetime], form: str) -> list[str]:
    return [time.strftime(form) for time in times]


WRITTEN = {
    # The last digits of a microsecond clock; a midnight, an hour and a time zone between.
    "iso": (begun("2024-05-01T00:00:00"), "%Y-%m-%dT%H:%M:%S.%f", 1_714_521_600),
    "iso with a space": (begun("2024-12-31T23:59:59.9"), "%Y-%m-%d %H:%M:%S.%f", 1_735_689_599.9),
    "iso in Greenwich": (begun("2024-05-01T10:00:00"), "%Y-%m-%dT%H:%M:%S.%fZ", 1_714_557_600),
    "iso east of it": (begun("2024-05-01T10:00:00"), "%Y-%m-%dT%H:%M:%S.%f+02:00", 1_714_550_400),
    "slashes": (begun("2024-05-01T10:00:00"), "%Y/%m/%d %H:%M:%S.%f", 1_714_557_600),
    "clock": (begun("2024-05-01T08:15:00"), "%H:%M:%S.%f", 29_700),
    "clock over midnight": (begun("2024-05-01T23:59:59.95"), "%H:%M:%S.%f", 86_399.95),
    "twelve hours": (begun("2024-05-01T12:59:59.95"), "%I:%M:%S.%f %p", 46_799.95),
    "day first": (begun("2024-05-13T23:59:59.95"), "%d.%m.%Y %H:%M:%S.%f", 86_399.95),
    "month first": (begun("2024-05-13T23:59:59.95"), "%m/%d/%Y %H:%M:%S.%f", 86_399.95),
    "minutes over the hour": (begun("2024-05-01T08:59:59.95"), "%M:%S.%f", 3_599.95),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_times_of_day(name: str, tmp_path: Path):
    """Against the calendar of the standard library; half a microsecond is half a digit of what is written."""
    times, form, began = WRITTEN[name]
    log = read_log(log_of(tmp_path / "log.csv", clock(times, form)))
    assert log.time - log.time[0] == pytest.approx(5e-4 * np.arange(ROWS), abs=5e-7)
    assert log.began + log.time[0] == pytest.approx(began, abs=1e-3)
    if form.startswith("%Y-%m-%dT%H:%M:%S.%fZ"):
        assert began == times[0].replace(tzinfo=UTC).timestamp()
    assert np.array_equal(log.joint().channels["motor_position"], ANGLE[:, 0])


def test_a_time_that_is_none_costs_its_row(tmp_path: Path):
    times = clock(begun("2024-05-01T00:00:00"), "%H:%M:%S.%f")
    times[7], times[9], times[11] = "25 o'clock", "", "99:99:99.0"
    log = read_log(log_of(tmp_path / "log.csv", times))
    assert (log.quality.not_finite, len(log.time)) == (3, ROWS - 3)


@pytest.mark.parametrize("stamp", ["2024-13-45T00:00:00", "99:99:99", "1" * 5000 + ":00:00", "00:00:00." + "9" * 40, "24:00:00-99:99"])
def test_hostile_times(stamp: str, tmp_path: Path):
    """In a column of good ones: an answer, or one line."""
    times = clock(begun("2024-05-01T00:00:00"), "%Y-%m-%dT%H:%M:%S.%f")
    times[11] = stamp
    assert len(read_log(log_of(tmp_path / "log.csv", times)).time) >= ROWS - 2


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_encodings(encoding: str, tmp_path: Path):
    """With a mark and without; tabs, as a spreadsheet's "Unicode text" has them."""
    path = log_of(tmp_path / "log.txt", [repr(5e-4 * k) for k in range(ROWS)], encoding, "\t")
    assert np.array_equal(read_log(path).joint().channels["motor_position"], ANGLE[:, 0])
    path.write_bytes(path.read_bytes()[:-1])  # half a letter
    if encoding != "utf-8-sig":
        assert_refused(lambda: read_log(path), ["log.txt"])


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("comment", ["", "# made by a drive, at night\n"])
def test_columns_by_number(delimiter: str, comment: str, tmp_path: Path):
    path = tmp_path / "log.txt"
    rows = np.column_stack([5e-4 * np.arange(ROWS), ANGLE])
    path.write_text(comment + "".join(delimiter.join(map(repr, row)) + "\n" for row in rows.tolist()), "utf-8")
    assert_refused(lambda: read_log(path), ["log.txt", "no header", "1, 2, 3", "--columns time=1,motor_position=2"])
    log = read_log(path, {"time": "1", "motor_position": "3", "target_torque": "2"})
    assert np.array_equal(log.joint().channels["motor_position"], ANGLE[:, 1])
    assert np.array_equal(log.time, rows[:, 0])  # no row is lost to a header
    assert len(read_log(path, {"motor_position": "3"}, LogOptions(sample_rate=2000)).time) == ROWS


def test_rostopic_echo(tmp_path: Path):
    """`rostopic echo -p /joint_states`: the header behind a %, stamps in ns, names in every row."""
    path = tmp_path / "log.csv"
    fields = ("header.seq", "header.stamp", "name0", "name1", "position0", "position1", "velocity0", "velocity1")
    lines = ["%time," + ",".join(f"field.{name}" for name in fields)]
    began = 1_486_559_106_139_796_569
    for k, (hip, knee) in enumerate(ANGLE.tolist()):
        stamp = began + 500_000 * k
        lines.append(f"{stamp},{k},{stamp},hip,knee,{hip!r},{knee!r},0.0,0.5")
    path.write_text("\n".join(lines) + "\n", "utf-8")
    log = read_log(path)
    assert {joint: [*channels] for joint, channels in log.joints.items()} == {
        name: ["motor_position", "motor_velocity"] for name in ("hip", "knee")
    }
    assert np.array_equal(log.joints["knee"]["motor_position"], ANGLE[:, 1])
    assert log.time == pytest.approx(5e-4 * np.arange(ROWS), abs=3e-7)  # 19 digits in a float: 256 ns
    assert log.began == pytest.approx(began / 1e9, abs=1e-3)


@pytest.mark.parametrize(
    "text",
    ["# time q tau\n", "#time,q,tau\n", "% time\tq\ttau\n", "# a drive\n# time, q, tau\n"],
)
def test_headers_behind_a_comment_sign(text: str, tmp_path: Path):
    delimiter = "\t" if "\t" in text else " " if "," not in text else ","
    path = tmp_path / "log.txt"
    path.write_text(text + "".join(delimiter.join(map(repr, (5e-4 * k, *row))) + "\n" for k, row in enumerate(ANGLE.tolist())), "utf-8")
    assert np.array_equal(read_log(path).joint().channels["motor_position"], ANGLE[:, 0])


def test_columns_that_only_look_like_names(tmp_path: Path):
    """A word that changes from row to row, and two joints of one name, are no names."""
    path = tmp_path / "log.csv"
    for words in (("a", "b"), ("same", "same")):
        rows = "".join(f"{k}e-3,{words[k % 2]},{words[1]},{k},{-k}\n" for k in range(ROWS))
        path.write_text("time,name0,name1,position0,position1\n" + rows, "utf-8")
        with log_reader(path) as reader:
            assert reader.joint_names in {("0", "1"), ("0", "b")}


@pytest.mark.parametrize("name", ["entries.json", "lists.json", "log.npz", "dates.npz", "log.parquet"])
def test_times_of_day_in_other_formats(name: str, tmp_path: Path):
    """The same texts, and numpy's own dates; a float of seconds since 1970 has 0.24 us."""
    times = clock(begun("2024-05-01T00:00:00"), "%Y-%m-%dT%H:%M:%S.%f")
    angle, path = ANGLE[:, 0], tmp_path / name
    if name == "entries.json":
        path.write_text(json.dumps([{"time": time, "position": each} for time, each in zip(times, angle.tolist(), strict=True)]), "utf-8")
    elif name == "lists.json":
        path.write_text(json.dumps({"time": times, "position": angle.tolist()}), "utf-8")
    elif name == "log.npz":
        np.savez(path, time=np.array(times), position=angle)
    elif name == "dates.npz":
        np.savez(path, time=np.array(times, "M8[us]"), position=angle)
    else:
        import pyarrow
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table({"time": times, "position": angle, "mode": ["run"] * ROWS}), path)
    log = read_log(path)
    assert log.time - log.time[0] == pytest.approx(5e-4 * np.arange(ROWS), abs=5e-7)
    assert log.began + log.time[0] == pytest.approx(1_714_521_600, abs=1e-3)
    assert np.array_equal(log.joint().channels["motor_position"], angle)
