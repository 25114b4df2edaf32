"""gainroom log: what is said of a log, to people and in JSON; options; what is wrong in one line."""

import io
import itertools
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.logs import abilities, open_log
from gainroom.identification import (
    Record,
    identify_delay,
    identify_gains,
    identify_joint,
    identify_setpoint_delay,
    identify_stiffness,
)
from gainroom.simulation.run_record import LOGGED
from log_files import WRITERS, Truth


def run(*call: str | Path) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(["log", *map(str, call)])
    return status, out.getvalue(), err.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_json_of_every_format(name: str, tmp_path: Path):
    WRITERS[name](tmp_path / name, Truth())
    status, out, err = run(tmp_path / name, "--json")
    assert (status, err) == (0, "")
    facts = json.loads(out)
    assert set(facts) == {
        *("sentence", "rows", "duration", "sample_rate_hz", "jitter_ms", "complete", "began", "cut", "missing", "gaps", "joints", "time"),
        *("allows", "unused", "warnings"),
    }
    cut = {"not_finite": 0, "duplicate": 0, "backwards": 0, "ahead": 0}
    assert (facts["rows"], facts["complete"], facts["cut"]) == (500, True, cut)
    assert facts["sample_rate_hz"] == pytest.approx(1000, rel=1e-6)
    assert facts["duration"] == pytest.approx(0.499)
    position = facts["joints"][0]["channels"]["motor_position"]
    truth = Truth().motor_position[:, 0]
    assert position["range"] == pytest.approx([truth.min(), truth.max()])
    assert set(position) == {"column", "unit", "factor", "column_from", "unit_from", "range"}
    torque = name not in ("log.json", "log.pt")
    assert facts["allows"]["identify joint"]["possible"] is torque
    assert facts["allows"]["identify delay"] == (
        {"possible": False, "channels": [], "missing": [["actual_torque", "demand_torque"]], "confounded": False, "constant": []}
        if torque
        else {"possible": True, "channels": ["reference", "motor_position"], "missing": [], "confounded": True, "constant": []}
    )


def test_a_log_of_simulate_has_nothing_to_remark(tmp_path: Path):
    for form in ("csv", "parquet", "mcap"):
        with open_log(tmp_path / f"run.{form}", ("hip", "knee")) as log:
            log.write({"time": 5e-4 * np.arange(100)} | {name: np.random.default_rng(0).normal(size=(100, 2)) for name in LOGGED})
        status, out, _ = run(tmp_path / f"run.{form}", "--json")
        facts = json.loads(out)
        assert (status, facts["warnings"]) == (0, [])
        assert [joint["name"] for joint in facts["joints"]] == ["hip", "knee"]
        assert all(each["possible"] and not each["confounded"] for each in facts["allows"].values())


def test_the_terminal_says_what_was_done(tmp_path: Path):
    rows = np.column_stack([500.0 * np.arange(3000), np.degrees(np.sin(np.arange(3000.0))), np.ones(3000)])
    rows[100:103, 0] = rows[99, 0]
    rows[200, 1] = np.nan
    np.savetxt(tmp_path / "log.csv", rows, delimiter="\t", header="stamp\tposition\tnote", comments="")
    status, out, err = run(tmp_path / "log.csv", "--units", "motor_position=deg", "--end", "1.25")
    assert (status, err) == (0, "")
    told = " ".join(out.split())
    for text in (
        "holds 2 497 rows of one joint: 1.25 s at 2 000 Hz",
        "1 row was cut: a number is missing or not finite in position",
        "3 rows were cut: their time stamp is that of the row before",
        "4 ticks are missing in 2 gaps, the longest of 2 ms",
        "Time stamps were read in us",
        "Which side of the gearbox",
        "needs target_torque or actual_torque",
    ):
        assert text in told.replace("\u202f", " "), text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--columns", "torque=x"), ["columns", "'torque'", "target_torque"]),
        (("--columns", "time"), ["--columns", "'time'", ".yaml"]),
        (("--columns", "time=a,time=b"), ["--columns", "time is given twice"]),
        (("--columns", "nowhere.yaml"), ["nowhere.yaml", "no such file"]),
        (("--units", "motor_position=foot"), ["units: motor_position", "'foot'", "deg"]),
        (("--units", "motor_position"), ["--units", "CHANNEL=VALUE"]),
        (("--gear-ratio", "0"), ["gear_ratio", "> 0"]),
        (("--rotor-side", "motor_position"), ["rotor_side", "gear_ratio"]),
        (("--start", "x"), ["--start", "in seconds"]),
        (("--start", "2", "--end", "1"), ["end 1 s", "start 2 s"]),
        (("--rate-hz", "-1"), ["sample_rate", "-1"]),
        (("--joint", "arm"), ["arm", "it has joint"]),
    ],
)
def test_wrong_calls(options: tuple[str, ...], words: list[str], tmp_path: Path):
    (tmp_path / "log.csv").write_text("time,q\n" + "".join(f"{k}e-3,1\n" for k in range(50)), "utf-8")
    status, out, err = run(tmp_path / "log.csv", *options)
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert not [word for word in words if word not in err], err


def test_a_log_without_rows_is_an_error(tmp_path: Path):
    """Its header was once enough for "yes", and the rest a traceback."""
    (tmp_path / "log.csv").write_text("time,target_torque,actual_torque,motor_position,reference\n", "utf-8")
    calls = (["log"], ["identify", "joint"], ["identify", "delay"], ["identify", "gains"], ["identify", "stiffness"], ["diagnose"])
    for call in calls:
        said = io.StringIO()
        with redirect_stderr(said):
            assert main([*call, str(tmp_path / "log.csv")]) == 2
        assert "log.csv: has no row" in said.getvalue()


@pytest.mark.parametrize(
    ("columns", "rows", "possible", "words"),
    [
        ({"motor_position": 0.3, "target_torque": None}, 500, ("diagnose",), "needs motor_position to change"),
        ({"motor_position": None, "target_torque": 0.0}, 500, ("diagnose",), "needs target_torque to change"),
        ({"motor_position": None, "target_torque": None}, 40, (), "needs 50 rows"),
        ({"motor_position": None, "target_torque": None, "reference": 0.0}, 500, (
            "identify joint", "identify gains", "identify stiffness", "diagnose"), "needs actual_torque or demand_torque"),
    ],
)  # fmt: skip
def test_rows_that_tell_nothing_are_no_yes(columns: dict, rows: int, possible: tuple[str, ...], words: str, tmp_path: Path):
    """Channels that never change, and too few rows; a set-point may rest. What is refused here the command refuses, too."""
    path, noise = tmp_path / "log.csv", np.random.default_rng(1)
    table = [noise.normal(size=rows).cumsum() if value is None else np.full(rows, value) for value in columns.values()]
    np.savetxt(path, np.column_stack([1e-3 * np.arange(rows), *table]), delimiter=",", header=",".join(["time", *columns]), comments="")
    _, out, _ = run(path, "--json")
    allowed = {name for name, each in json.loads(out)["allows"].items() if each["possible"]}
    assert allowed == {*possible}
    assert words in " ".join(run(path)[1].split())
    for question in ("identify joint", "identify gains", "identify stiffness"):
        if question not in allowed:
            said = io.StringIO()
            with redirect_stderr(said):
                assert main([*question.split(), str(path)]) == 2
            assert said.getvalue().count("\n") == 1


def test_what_channels_allow():
    can = {each.question: each for each in abilities({"target_torque", "actual_torque", "link_position", "reference"})}
    assert can["identify delay"].channels == ("target_torque", "actual_torque")
    assert can["identify joint"].missing == (("motor_position",),)
    assert can["identify gains"].possible
    assert can["identify stiffness"].missing == (("motor_position",),)
    assert not any(each.possible for each in abilities(()))


def test_what_channels_allow_is_what_identification_asks_for():
    """With every set of the channels that matter: what it lacks is said before anything else."""
    signal = np.cumsum(np.random.default_rng(3).normal(size=400))
    ways = {"delay": (identify_delay, identify_setpoint_delay), "joint": (identify_joint,), "gains": (identify_gains,)}
    names = ("target_torque", "demand_torque", "actual_torque", "motor_position", "link_position", "reference")
    for size in range(len(names) + 1):
        for channels in itertools.combinations(names, size):
            can = {each.question: each.possible for each in abilities(channels)}
            record = Record(1e-3 * np.arange(400), dict.fromkeys(channels, 0 * signal), 1e-3)  # nothing moves: no fit is begun
            for question, calls in {**ways, "stiffness": (identify_stiffness,)}.items():
                lacking = []
                for call in calls:
                    with pytest.raises(GainroomError) as refused:
                        call(record)
                    lacking.append(str(refused.value).startswith(f"{question}: needs "))
                assert can[f"identify {question}"] is not all(lacking), (question, channels)
