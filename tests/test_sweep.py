"""Sweeps: which postures, the same bytes however they are computed, and nothing lost when something breaks."""

import json
import math
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from faults import environment
from gainroom.analysis.margin_record import NUDGE
from gainroom.cli import main
from gainroom.files.robot_yaml import load_robot_system
from gainroom.studies.sweep import cluster, plan as plans
from gainroom.studies.sweep.checksums import own_digest
from gainroom.studies.sweep.limits import Limits, StateLimits
from gainroom.studies.sweep.plan import SweepPlan, drawn
from gainroom.studies.sweep.postures import Grid, Samples, Trajectory
from gainroom.studies.sweep.search import searched
from gainroom.studies.sweep.store import Store, open_sweep
from gainroom.studies.sweep.summary import STEP, summarized
from robot_files import write_arm
from sweep_runs import CHUNK, Deadly, contents, ran, small_plan
from test_report import without_library

RUNS = Path(__file__).with_name("sweep_runs.py")
BIPED = files("gainroom") / "files" / "examples" / "biped.yaml"
POSTURES = 5 * CHUNK + 7
UNSURE = "uncertainty: {delay_ms: [1.0, 2.5], stiffness: [6000.0, 9000.0]}\n"


@pytest.fixture
def arm(tmp_path):
    from robot_files import ROBOT

    return write_arm(tmp_path, ROBOT + UNSURE)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A file, and what its sweep is in one process."""
    from robot_files import ROBOT

    folder = tmp_path_factory.mktemp("undisturbed")
    file = write_arm(folder, ROBOT + UNSURE)
    ran(small_plan(file, POSTURES), folder / "one.zarr", workers=1)
    return file, contents(folder / "one.zarr")


def test_a_grid_has_every_combination_once_and_neighbours_differ_by_one_step():
    low, high = np.array([0.0, -1.0, 5.0, 2.0]), np.array([1.0, 1.0, 5.0, 3.0])
    grid = Grid(low, high, (3, 4, 1, 2))
    found = grid.at(0, grid.count)
    assert grid.count == 24 == len({tuple(row) for row in found.tolist()})
    assert np.array_equal(found.min(axis=0), low)
    assert np.array_equal(found.max(axis=0), high)
    steps = np.abs(np.diff(found, axis=0)) / np.array([0.5, 2 / 3, 1.0, 1.0])
    assert np.allclose(np.sort(steps, axis=1), [0, 0, 0, 1])
    assert np.array_equal(grid.at(5, 17), found[5:17])


def test_samples_fill_the_box_evenly_and_by_number():
    """Of 256 points of Sobol's sequence each of 256 equal slices of an axis has one."""
    low, high = np.array([-1.0, 0.5, 2.0]), np.array([1.0, 0.5, 6.0])
    samples = Samples(low, high, 256, seed=3)
    found = samples.at(0, 256)
    assert np.all(found[:, 1] == 0.5)
    for axis in (0, 2):
        slices = np.floor(256 * (found[:, axis] - low[axis]) / (high[axis] - low[axis]))
        assert np.array_equal(np.sort(slices), np.arange(256))
    assert np.array_equal(np.concatenate([samples.at(0, 100), samples.at(100, 101), samples.at(101, 256)]), found)
    assert not np.array_equal(Samples(low, high, 256, seed=4).at(0, 9), found[:9])


@pytest.mark.slow
def test_the_same_bytes_for_any_number_of_workers(undisturbed, tmp_path):
    file, expected = undisturbed
    done = ran(small_plan(file, POSTURES), tmp_path / "more.zarr", workers=3)
    assert (done.finished, done.at_start) == (POSTURES, 0)
    assert contents(tmp_path / "more.zarr") == expected


@pytest.mark.slow
def test_results_are_labelled_and_are_those_of_gain_limit(arm, tmp_path):
    system = load_robot_system(arm)
    plan = small_plan(arm, 70, places=drawn(system, 3))
    ran(plan, tmp_path / "sweep.zarr", workers=1)
    found = open_sweep(tmp_path / "sweep.zarr")
    assert list(found.sizes.items()) == [("draw", 4), ("contact", 1), ("posture", 70), ("joint", 2)]
    assert list(found.data_vars) == [
        "gain", "lower_gain", "frequency", "limiting_joint", "certified", "angles", "draw_delay", "draw_stiffness",
    ]  # fmt: skip
    assert found.frequency.attrs["units"] == "rad/s"
    assert found.joint.values.tolist() == ["shoulder", "elbow"]
    assert found.attrs["gainroom"] == gr.__version__
    assert bool(found.certified.all())
    for draw, posture in ((0, 3), (2, 69), (3, 40)):
        angles = dict(zip(("shoulder", "elbow"), found.angles[posture].values.tolist(), strict=True))
        one = system.with_values(delay=found.draw_delay[draw].values, stiffness=found.draw_stiffness[draw].values)
        source = replace(one.source, postures={"here": replace(next(iter(one.source.postures.values())), angles=angles)})
        alone = gr.gain_limit(one.loop(source.linearize("here", "free")))
        assert float(found.gain[draw, 0, posture]) == pytest.approx(alone.gain * (1 - NUDGE), rel=1e-9)


def test_draws_lie_within_the_uncertainty(arm):
    system = load_robot_system(arm)
    for place in drawn(system, 20)[1:]:
        values = system.uncertainty.values(place)
        assert 1e-3 <= values["delay"].min() <= values["delay"].max() <= 2.5e-3
        assert 6000 <= values["stiffness"].min() <= values["stiffness"].max() <= 9000


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on(undisturbed, tmp_path):
    file, expected = undisturbed
    plan, path = small_plan(file, POSTURES), tmp_path / "stopped.zarr"
    turns = iter(range(100))
    done = ran(plan, path, workers=1, stop=lambda: next(turns) == 2)
    assert (done.finished, done.total) == (2 * CHUNK, POSTURES)
    assert ran(plan, path, workers=1).at_start == 2 * CHUNK
    assert contents(path) == expected


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(undisturbed, tmp_path):
    file, expected = undisturbed
    plan = small_plan(file, POSTURES)
    deadly = Deadly(**{one: getattr(plan, one) for one in plan.__dataclass_fields__}, deadly=3, once=str(tmp_path / "killed"))
    assert ran(deadly, tmp_path / "sweep.zarr", workers=2).finished == POSTURES
    assert (tmp_path / "killed").exists()
    assert contents(tmp_path / "sweep.zarr") == expected


@pytest.mark.slow
def test_postures_that_kill_every_worker_are_named(undisturbed, tmp_path):
    file, expected = undisturbed
    plan = small_plan(file, POSTURES)
    deadly = Deadly(**{one: getattr(plan, one) for one in plan.__dataclass_fields__}, deadly=3)
    path = tmp_path / "sweep.zarr"
    with pytest.raises(
        gr.GainroomError, match=r"ended 3 times on postures 96 to 127 \(signal 9; out of memory\?\); what was finished is kept"
    ):
        ran(deadly, path, workers=2)
    assert ran(plan, path, workers=1).at_start > 0
    assert contents(path) == expected


@pytest.mark.slow
def test_killed_at_random_moments(undisturbed, tmp_path):
    """Whatever is left after SIGKILL, SIGTERM or SIGINT, the same command goes on to the same bytes; and no worker is left over."""
    assert_killed(undisturbed, tmp_path, 2)


@pytest.mark.population
def test_killed_at_many_random_moments(undisturbed, tmp_path):
    assert_killed(undisturbed, tmp_path, 40)


def assert_killed(undisturbed, tmp_path, moments: int) -> None:
    file, expected = undisturbed
    rng = np.random.default_rng(7)
    for moment in range(moments):
        path = tmp_path / f"sweep{moment}.zarr"
        command = [sys.executable, str(RUNS), str(file), str(path), str(POSTURES), "2"]
        process = subprocess.Popen(command, env=environment(), start_new_session=True, stderr=subprocess.DEVNULL)
        while process.poll() is None and not path.exists():
            time.sleep(0.01)  # however long that takes
        time.sleep(float(rng.uniform(0, 2.5)))
        process.send_signal((signal.SIGKILL, signal.SIGTERM, signal.SIGINT)[moment % 3])
        process.wait()
        kept = contents(path)
        assert kept.items() <= expected.items()
        ran(small_plan(file, POSTURES), path, workers=1)
        assert contents(path) == expected


@pytest.mark.slow
def test_a_full_disk_is_told_and_nothing_finished_is_lost(undisturbed, tmp_path):
    """A file system of 100 kB, as an unprivileged user may have one in a name space of his own."""
    file, expected = undisturbed
    disk, saved = tmp_path / "disk", tmp_path / "saved"
    disk.mkdir()
    code = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[4]); import sweep_runs\n"
        "try: sweep_runs.ran(sweep_runs.small_plan(Path(sys.argv[1]), int(sys.argv[3])), Path(sys.argv[2]), workers=1)\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    run = f'"{sys.executable}" -c "$CODE" "{file}" "{disk}/sweep.zarr" {POSTURES} "{RUNS.parent}"'
    script = f'mount -t tmpfs -o size=120k tmpfs "{disk}" && {run}; cp -r "{disk}/sweep.zarr" "{saved}"'
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-Urm", "true"], capture_output=True, check=False).returncode:
        pytest.skip("no name spaces here")
    done = subprocess.run(
        ["unshare", "-Urm", "sh", "-c", script], env={**environment(), "CODE": code}, capture_output=True, text=True, check=False
    )
    assert "GainroomError" in done.stdout, done.stderr
    assert "cannot be written: no space left on device" in done.stdout
    assert len(done.stdout.splitlines()) == 1
    kept = contents(saved)
    assert kept.items() <= expected.items()
    assert any("/c/" in name for name in kept)
    ran(small_plan(file, POSTURES), saved, workers=1)
    assert contents(saved) == expected


@pytest.mark.slow
def test_the_summary_is_that_of_all_numbers(arm, tmp_path):
    """Against the whole arrays; quantiles to the histogram's step."""
    system = load_robot_system(arm)
    plan = small_plan(arm, 200, places=drawn(system, 2))
    store = Store.of(tmp_path / "sweep.zarr", plan)
    ran(plan, tmp_path / "sweep.zarr", workers=1)
    found = summarized(plan, store.finished())
    gain = open_sweep(tmp_path / "sweep.zarr").gain.values
    assert found.complete
    worst = found.worst_posture
    assert worst.gain == gain.min()
    assert (worst.draw, worst.contact, worst.number) == np.unravel_index(gain.argmin(), gain.shape)
    assert [one.gain for one in found.contacts[0].worst] == np.sort(gain.ravel())[: len(found.contacts[0].worst)].tolist()
    for share in (0.1, 0.5, 0.9):
        assert found.contacts[0].quantile(share) == pytest.approx(np.quantile(gain, share, method="inverted_cdf"), rel=STEP)
    assert found.contacts[0].joints.sum() == gain.size
    assert found.scale == pytest.approx(gain.min() / found.margin)
    assert found.margin == pytest.approx(10 ** (6 / 20))
    assert found.rarer_than == pytest.approx(1 - 0.05 ** (1 / 200))


def test_gains_that_may_not_be_lowered_either_have_no_margin(arm):
    """A gain margin of 6 dB allows half of the gains: a robot that falls below 0.6 of them has 4.4 dB."""
    plan = small_plan(arm, 3)
    limits = Limits(
        np.array([10.0, 9.0, 8.0]), np.array([0.6, 0.0, 0.4]), np.ones(3), np.zeros(3, dtype=int), np.array([True, True, False])
    )
    found = summarized(plan, [(plan.task(0), limits)], margin=2.0)
    (one,) = found.contacts
    assert found.stable
    assert not found.margin_held
    assert (one.short, one.uncertified, one.unsafe, one.lower) == (1, 1, 2, 0.6)
    sure = summarized(plan, [(plan.task(0), limits._replace(certified=np.ones(3, dtype=bool)))], margin=2.0)
    assert sure.scale == 8.0 / 2.0  # at four times these gains the lower end is at 0.15 of them
    narrow = limits._replace(gain=np.array([2.2, 9.0, 8.0]), certified=np.ones(3, dtype=bool))
    assert math.isnan(summarized(plan, [(plan.task(0), narrow)], margin=2.0).scale)  # 1.1 × would be 5.3 dB above the lower end


def test_the_search_ends_no_higher_and_in_the_box(arm, tmp_path):
    plan = small_plan(arm, 40)
    store = Store.of(tmp_path / "sweep.zarr", plan)
    ran(plan, tmp_path / "sweep.zarr", workers=1)
    found = summarized(plan, store.finished())
    near = searched(found)
    assert near.gain <= found.worst_posture.gain
    assert np.all((plan.postures.low <= near.angles) & (near.angles <= plan.postures.high))
    dense = StateLimits(plan.system, "free").limits(
        plan.postures.at(0, 2000)
        if plan.postures.count > 2000
        else Samples(plan.postures.low, plan.postures.high, 2000, seed=9).at(0, 2000)
    )
    assert near.gain <= dense.gain.min() * (1 + 1e-3)


CHANGED = {
    "robot, control or drive": lambda plan: replace(plan, system=plan.system.with_values(delay=1e-3)),
    "other postures": lambda plan: replace(plan, postures=replace(plan.postures, seed=9)),
    "other draws": lambda plan: replace(plan, places=drawn(plan.system, 1)),
}


@pytest.mark.parametrize("what", CHANGED)
def test_the_store_of_another_sweep_is_left_alone(undisturbed, tmp_path, what):
    file, _ = undisturbed
    plan, path = small_plan(file, CHUNK), tmp_path / "sweep.zarr"
    ran(plan, path, workers=1)
    before = contents(path)
    with pytest.raises(gr.GainroomError, match=what):
        Store.of(path, CHANGED[what](plan))
    assert contents(path) == before


def test_the_store_of_another_version_is_left_alone(undisturbed, tmp_path, monkeypatch):
    file, _ = undisturbed
    plan, path = small_plan(file, CHUNK), tmp_path / "sweep.zarr"
    ran(plan, path, workers=1)
    monkeypatch.setattr(gr, "__version__", "99.0")
    with pytest.raises(gr.GainroomError, match=f"was computed by gainroom {plan.identity['version']}; this is 99.0"):
        Store.of(path, small_plan(file, CHUNK))


def test_a_store_in_another_form_is_left_alone(undisturbed, tmp_path):
    file, _ = undisturbed
    plan, path = small_plan(file, CHUNK), tmp_path / "sweep.zarr"
    ran(plan, path, workers=1)
    about = path / "zarr.json"
    group = json.loads(about.read_text())
    group["attributes"]["format"] = "gainroom sweep 99"
    group["attributes"]["checksum"] = own_digest(group)
    about.write_text(json.dumps(group))
    before = contents(path)
    with pytest.raises(gr.GainroomError, match="sweep by another version of gainroom, and stays as it is"):
        Store.of(path, plan)
    assert contents(path) == before


def test_the_same_robot_elsewhere_is_the_same(tmp_path):
    """Neither a file's name nor remarks in it tell sweeps apart."""
    from robot_files import ROBOT

    for name, text in (("a", ROBOT), ("b", "# a remark\n" + ROBOT)):
        (tmp_path / name).mkdir()
        write_arm(tmp_path / name, text)
    one, two = (small_plan(tmp_path / name / "robot.yaml", 10) for name in "ab")
    assert one.identity == two.identity


def test_a_damaged_store_is_told(undisturbed, tmp_path):
    file, _ = undisturbed
    plan, path = small_plan(file, CHUNK), tmp_path / "sweep.zarr"
    ran(plan, path, workers=1)
    chunk = path / "gain" / "c" / "0" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-9])
    with pytest.raises(gr.GainroomError, match="is damaged"):
        list(Store.of(path, plan).finished())


REFUSED = {
    ("--samples", "0"): "--samples: 0 postures; from 1 to",
    ("--range", "elbow=1:1"): "'elbow=1:1': low must be below high",
    ("--range", "elbow=1"): "must be JOINT=LOW:HIGH, in rad",
    ("--range", "wrist=0:1"): "'wrist' matches no joint",
    ("--grid", "elbow=0:1:1"): "1 points must be a whole number, 2 or more",
    ("--grid", "elbow=0:1:5", "--samples", "5"): "--samples and --grid: only one of them",
    ("--grid", "elbow=0:1:40000", "--grid", "shoulder=0:1:40000"): "--grid: 1600000000 postures; from 1 to",
    ("--contact", "hands"): "--contact: 'hands' is not one of this robot's",
    ("--posture", "lying"): "--posture: 'lying' is not one of this robot's",
    ("--draws", "-1"): "-1 draws; from 0",
    ("--seed", "-1"): "--seed -1 must be >= 0",
    ("--workers", "0"): "--workers 0 must be 1 or more",
    ("--trajectory", "wrong.csv"): "joint 'wrist' is not one of this robot's",
    ("--trajectory", "none.csv"): "none.csv",
    ("--scheduler", "tcp://127.0.0.1:9"): "does not answer",
    ("--scheduler", "nonsense://x"): "does not answer",
    ("--output", "robot.urdf"): "is not the store of a sweep, and stays as it is",
    ("--output", "nowhere/sweep.zarr"): "there is no directory",
}


@pytest.mark.parametrize("arguments", REFUSED)
def test_a_wrong_call_is_refused_in_one_line(arm, tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    time_of_flight = "\n".join(f"{0.001 * k},{0.1 * math.sin(0.1 * k)}" for k in range(50))
    (tmp_path / "wrong.csv").write_text(f"time,motor_position_wrist\n{time_of_flight}\n")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    monkeypatch.setattr(cluster, "CONNECTING", 0.5)
    assert main(["sweep", str(arm), *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert REFUSED[arguments] in said.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


@pytest.mark.slow
def test_the_command_prints_and_keeps_its_results(arm, tmp_path, capsys):
    store = tmp_path / "sweep.zarr"
    call = ["sweep", str(arm), "--samples", "300", "--output", str(store), "--json", "--workers", "1"]
    assert main(call) == 0
    first = json.loads(capsys.readouterr().out)
    before = contents(store)
    assert main(call) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert contents(store) == before
    assert first["limits"] == first["count"] == 300
    assert first["worst"]["gain_limit"] == pytest.approx(float(open_sweep(store).gain.min()))
    assert set(first["worst"]["angles"]) == {"shoulder", "elbow"}
    assert main(call[:-3]) == 0
    assert "vibration starts at" in capsys.readouterr().out


def test_unstable_gains_are_status_1(arm, tmp_path, capsys):
    text = arm.read_text().replace("kp: 400.0, kd: 30.0", "kp: 4000.0, kd: 300.0")
    arm.write_text(text)
    assert main(["sweep", str(arm), "--samples", "50", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["stable"] is False
    assert found["worst"]["gain_limit"] < 1


def test_long_sweeps_have_long_tasks(arm):
    system = load_robot_system(arm)
    for count, chunk in ((10**6, plans.CHUNK), (10**9, plans.LONG_CHUNK)):
        plan = SweepPlan(system, Samples(np.zeros(2), np.ones(2), count), ("free",))
        assert plan.chunk == chunk
        assert plan.task(plan.tasks - 1).stop == count
    assert Trajectory(np.zeros((3, 2))).count == 3


@pytest.mark.slow
def test_the_page_is_whole_and_says_what_the_terminal_says(arm, tmp_path, capsys):
    page = tmp_path / "sweep.html"
    assert main(["sweep", str(arm), "--samples", "400", "--draws", "1", "--report", str(page), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    text = page.read_text("utf-8")
    assert found["sentence"] in text
    assert "http" not in without_library(text)
    maps = json.loads(text.partition('class="maps">')[2].partition("</script>")[0])
    assert min(value for row in maps["maps"]["0,1"] for value in row if value is not None) == pytest.approx(
        found["worst"]["gain_limit"], rel=1e-4
    )
    assert "--draws 1" in text
