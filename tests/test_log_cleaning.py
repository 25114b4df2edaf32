"""Rows out of order, doubled, missing or not finite: what is cut is counted, and nothing else is lost; clocks; parts without gaps."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from gainroom.files.logs import JointLog, Log, LogOptions, read_log
from gainroom.files.logs.cleaning import Cleaner
from refusals import assert_refused

ALL = (-np.inf, np.inf)
stamps = st.lists(st.one_of(st.integers(-5, 40).map(float), st.just(float("nan")), st.just(float("inf"))), max_size=60)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(stamps, st.lists(st.integers(1, 9), max_size=12), st.data())
def test_what_is_kept_rises_and_every_row_is_counted(times: list[float], sizes: list[int], data: st.DataObject):
    """Whatever the stamps, however they are cut into blocks: the rows that are left are those a slow loop would leave."""
    values = data.draw(st.lists(st.sampled_from([1.0, 2.0, float("nan")]), min_size=len(times), max_size=len(times)))
    cleaner, found, first = Cleaner(Path("log"), ["q"]), [], 0
    for size in [*sizes, len(times)]:
        time, (kept,) = cleaner.clean(np.array(times[first : first + size]), [np.array(values[first : first + size])], ALL)
        found += list(zip(time.tolist(), kept.tolist(), strict=True))
        first += size
    wanted, latest, not_finite, duplicate, backwards = [], -np.inf, 0, 0, 0
    for time, value in zip(times, values, strict=True):
        if not np.isfinite([time, value]).all():
            not_finite += 1
        elif time > latest:
            wanted.append((time, value))
            latest = time
        elif time == latest:
            duplicate += 1
        else:
            backwards += 1
    assert found == wanted
    quality = cleaner.quality
    assert (quality.rows, quality.not_finite, quality.duplicate, quality.backwards) == (len(times), not_finite, duplicate, backwards)
    assert quality.rows - quality.cut == len(found)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(1, 6), min_size=30, max_size=200), st.integers(1, 50))
def test_gaps_are_counted_whatever_the_blocks(steps: list[int], size: int):
    """Most steps are one tick: of the others each is a gap, with as many ticks missing as it is longer."""
    ticks = np.concatenate([[0], np.cumsum([1 if k % 4 else step for k, step in enumerate(steps)])])
    first = Cleaner(Path("log"), [])
    first.clean(1e-3 * np.arange(5), [], ALL)  # the tick is known from the first rows
    for k in range(0, len(ticks), size):
        first.clean(1e-3 * (5 + ticks[k : k + size]), [], ALL)
    quality = first.quality
    long = np.diff(ticks)[np.diff(ticks) > 1]
    assert (quality.gaps, quality.dropped) == (len(long), int((long - 1).sum()))
    assert quality.longest_gap == pytest.approx(1e-3 * (long.max() if len(long) else 0), rel=1e-9)
    assert quality.sample_time == pytest.approx(1e-3, rel=1e-9)


def test_jitter_is_the_standard_deviation_of_the_steps():
    rng = np.random.default_rng(1)
    time = 1e-3 * np.arange(20_000) + 2e-5 * rng.normal(size=20_000)
    cleaner = Cleaner(Path("log"), [])
    for part in np.array_split(time, 7):
        cleaner.clean(part, [], ALL)
    assert cleaner.quality.jitter == pytest.approx(np.diff(time).std(), rel=1e-9)
    assert cleaner.quality.sample_time == pytest.approx(np.diff(time).mean(), rel=1e-12)


def csv(path: Path, header: str, *columns: np.ndarray, form: str = "%.17g") -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt=form)
    return path


def test_a_log_with_everything_wrong(tmp_path: Path):
    time = 5e-4 * np.arange(2000)
    q = np.sin(9 * time)
    bad = np.column_stack([time, q])
    bad[100, 1] = np.nan
    bad[200:205, 0] = bad[199, 0]  # the clock stands
    bad[[300, 301]] = bad[[301, 300]]  # exchanged
    bad = np.delete(bad, slice(500, 520), axis=0)
    log = read_log(csv(tmp_path / "log.csv", "time,q", *bad.T))
    assert (log.quality.rows, log.quality.not_finite, log.quality.duplicate, log.quality.backwards) == (1980, 1, 5, 1)
    assert log.quality.missing == {"q": 1}
    assert (log.quality.gaps, log.quality.dropped) == (4, 1 + 5 + 1 + 20)
    assert log.quality.longest_gap == pytest.approx(21 * 5e-4)
    kept = log.joint()
    assert np.array_equal(kept.channels["motor_position"], q[np.rint(kept.time / 5e-4).astype(int)])
    assert len(kept.time) == 1980 - 7


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
@pytest.mark.parametrize("rate", [30.0, 500.0, 2000.0])
def test_the_unit_of_time_is_found(factor: float, unit: str, rate: float, tmp_path: Path):
    """From the numbers alone: the one that makes the rate that of a log."""
    time = np.arange(400) / rate
    log = read_log(csv(tmp_path / "log.csv", "stamp,q", factor * (time + 3.0), time))
    assert log.origins[0].unit == unit
    assert log.sample_time == pytest.approx(1 / rate, rel=1e-9)
    assert log.time[0] == pytest.approx(3.0)
    stated = read_log(tmp_path / "log.csv", options=LogOptions(units={"time": unit}))
    assert np.array_equal(stated.time, log.time)
    assert stated.origins[0].unit_from == "given"


def test_stamps_from_an_epoch_begin_at_zero(tmp_path: Path):
    log = read_log(csv(tmp_path / "log.csv", "time,q", 1.7e9 + 1e-3 * np.arange(100), np.arange(100.0)))
    assert log.time[0] == 0
    assert log.began == 1.7e9
    assert np.abs(log.time - 1e-3 * np.arange(100)).max() < 3e-7  # what a float of 1.7e9 can hold


def test_a_rate_instead_of_stamps(tmp_path: Path):
    """Stamps in whole milliseconds at 2 kHz say nothing; the rate does."""
    path = csv(tmp_path / "log.csv", "t_ms,q", np.arange(400) // 2, np.arange(400.0), form="%d")
    assert_refused(lambda: read_log(path), ["log.csv", "200 of 400 rows", "sample rate"])
    log = read_log(path, options=LogOptions(sample_rate=2000.0))
    assert np.array_equal(log.time, np.arange(400) / 2000)
    assert np.array_equal(read_log(path, options=LogOptions(sample_rate=2000.0, start=0.1, end=0.15)).time, np.arange(200, 301) / 2000)


@pytest.mark.parametrize(("row", "stamp"), [(700, 1e8), (700, 90.0), (0, 1e7), (1998, 50.0)])
def test_a_stamp_from_the_future_costs_one_row(row: int, stamp: float, tmp_path: Path):
    """Those behind it are not late; where a clock begins again, they are, and the log is refused."""
    time = 1e-3 * np.arange(2000)
    time[row] = stamp
    log = read_log(csv(tmp_path / "log.csv", "time,q", time, np.arange(2000.0)))
    assert (log.quality.ahead, log.quality.backwards) == (1, 0)
    assert len(log.time) == 1999
    again = np.concatenate([1e-3 * np.arange(1000)] * 2)
    assert_refused(lambda: read_log(csv(tmp_path / "again.csv", "time,q", again, np.arange(2000.0))), ["again.csv", "earlier"])


def joint_log(ticks: np.ndarray, jitter: float = 0.0) -> JointLog:
    rng = np.random.default_rng(0)
    time = 1e-3 * (ticks + jitter * rng.uniform(-1, 1, len(ticks)))
    return JointLog(time, {"motor_position": 5 * time, "target_torque": np.floor(ticks / 10)}, 1e-3)


def test_even_parts_keep_numbers_where_they_can():
    whole = joint_log(np.arange(1000))
    (part,) = whole.even_parts()
    assert part.channels["motor_position"].tolist() == whole.channels["motor_position"].tolist()
    jittered = joint_log(np.arange(1000), 0.1)
    (part,) = jittered.even_parts()
    assert np.array_equal(part.channels["motor_position"], jittered.channels["motor_position"])
    assert np.abs(np.diff(part.time) - 1e-3).max() < 1e-12


def test_even_parts_fill_short_gaps_and_end_at_long_ones():
    ticks = np.concatenate([np.arange(0, 100), np.arange(103, 300), np.arange(330, 400)])
    first, second = joint_log(ticks).even_parts(longest_gap=3)
    assert (len(first.time), len(second.time)) == (300, 70)
    for part in (first, second):
        assert np.abs(part.channels["motor_position"] - 5 * part.time).max() < 1e-12  # a line, however it is interpolated
    assert first.channels["target_torque"][99:104].tolist() == [9, 9, 9, 9, 10]  # a command holds until the next
    assert len(joint_log(ticks).even_parts(longest_gap=2)) == 3
    assert len(joint_log(ticks).even_parts(longest_gap=2, least=100)) == 2


def test_one_joint_of_several():
    log = Log(np.arange(3.0), {"a": {"current": np.ones(3)}, "b": {"current": np.zeros(3), "joint_torque": np.ones(3)}})
    assert set(log.joint("b").channels) == {"current", "joint_torque"}
    assert log.signals["current"].tolist() == [[1, 0]] * 3
    assert "joint_torque" not in log.signals
    assert_refused(lambda: log.joint(), ["2 joints", "one must be chosen", "a, b"])
    assert_refused(lambda: log.joint("c"), ["'c'", "a, b"])
