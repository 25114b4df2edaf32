"""gainroom identify: from a log in any format to numbers with intervals; what is wrong in one line."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy import stats

import gainroom as gr
from gainroom.cli import main
from gainroom.cli.example import example_texts
from gainroom.errors import GainroomError
from gainroom.files.identified_section import problem_of
from gainroom.files.joint_yaml import load_joint, parse_joint
from gainroom.files.logs import JointLog, open_log, read_log
from identified import joint_case, setpoint_case
from log_files import WRITERS, Truth

TICK = 1e-3
RNG = np.random.default_rng(20171117)


def run(*call: str | Path) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(["identify", *map(str, call)])
    return status, out.getvalue(), err.getvalue()


def steps(rows: int, held: int = 20) -> np.ndarray:
    """[N m]"""
    return RNG.uniform(-10, 10, rows // held + 1).repeat(held)[:rows]


def delayed(path: Path, ticks: int, rows: int = 3000) -> None:
    """A log of torques whose demand is the target some whole ticks later."""
    target = steps(rows)
    demand = np.concatenate([np.zeros(ticks), target])[:rows]
    columns = np.column_stack([TICK * np.arange(rows), target, demand])
    np.savetxt(path, columns, delimiter=",", header="time,target_torque,demand_torque", comments="")


def test_the_delay_of_a_demand_torque(tmp_path: Path):
    """Seen at tick 4, it arrived after tick 3: the truth is between, and nothing says where."""
    delayed(tmp_path / "log.csv", 4)
    status, out, err = run("delay", tmp_path / "log.csv", "--json")
    facts = json.loads(out)
    assert (status, err) == (0, "")
    assert {"delay_ms", "delay_ticks", "jitter_ms", "bandwidth", "damping_ratio", "warnings"} <= set(facts)
    assert (facts["delay_ms"]["low"], facts["delay_ms"]["high"]) == pytest.approx((3.0, 4.0), abs=1e-6)
    assert facts["bandwidth"] is None
    assert any("demand_torque alone" in text for text in facts["warnings"])
    status, out, err = run("delay", tmp_path / "log.csv")
    assert (status, err) == (0, "")
    assert "3 to 4" in out


def test_a_gap_is_a_gap():
    """100 rows, a gap of 10.4 ticks, 60 rows: on whole ticks, each part evenly."""
    time = TICK * np.concatenate([np.arange(100), 109.4 + np.arange(60)])
    channels = {"reference": np.arange(160.0)}
    record = JointLog(time, channels, TICK).record()
    assert np.flatnonzero(record.fresh).tolist() == [0, 100]
    assert record.ticks[[99, 100, 159]].tolist() == [99, 109, 168]
    assert np.array_equal(record.channels["reference"], np.arange(160.0))


def test_a_part_that_begins_half_a_tick_late_keeps_its_rows():
    time = TICK * np.concatenate([np.arange(100), 109.5 + np.arange(60)])
    record = JointLog(time, {"reference": time}, TICK).record()
    assert np.all(np.diff(record.ticks)[100:] == 1)


def test_several_joints_need_a_choice(tmp_path: Path):
    target = np.stack([steps(2000), steps(2000)], axis=1)
    demand = np.vstack([np.zeros((3, 2)), target])[:2000]
    with open_log(tmp_path / "log.parquet", ("hip", "knee"), ("target_torque", "demand_torque")) as log:
        log.write({"time": TICK * np.arange(2000), "target_torque": target, "demand_torque": demand})
    status, out, err = run("delay", tmp_path / "log.parquet")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "--joint NAME: hip, knee" in err
    status, out, _ = run("delay", tmp_path / "log.parquet", "--joint", "knee", "--json")
    assert (status, json.loads(out)["log"]["joint"]) == (0, "knee")


class DelayedTruth(Truth):
    """What looks like a velocity is the target torque four ticks later; positions follow set-points as a loop would, late by 6 ticks."""

    def __init__(self) -> None:
        super().__init__(4000)
        self.target_torque = np.stack([steps(4000), steps(4000)], axis=1)
        self.motor_velocity = np.vstack([np.zeros((4, 2)), self.target_torque])[:4000]
        rng = np.random.default_rng(4)
        frequencies, phases = rng.uniform(0.3, 20, 30), rng.uniform(0, 2 * np.pi, (30, 1, 2))
        waves = np.sin(2 * np.pi * frequencies[:, None, None] * self.time[:, None] + phases)
        self.reference = 0.05 * waves.sum(axis=0)
        self.motor_position = followed(self.reference, natural=2 * np.pi * 6, damping=0.5, loop=2, command=4)


def followed(reference: np.ndarray, natural: float, damping: float, loop: int, command: int) -> np.ndarray:
    """θ̈ = ω² (x_d(t − T_c − T_l) − θ(t − T_l)) − 2ζω θ̇(t − T_l) in steps of a tenth of a tick; (m, n)."""
    fine, positions = 10, np.zeros_like(reference)
    position, velocity = reference[0].copy(), np.zeros(reference.shape[1])
    past = [(position.copy(), velocity.copy())] * (loop * fine)
    for k in range(len(reference) * fine):
        late_position, late_velocity = past[k % (loop * fine)]
        if k % fine == 0:
            positions[k // fine] = position
        past[k % (loop * fine)] = (position.copy(), velocity.copy())
        wanted = reference[max(k // fine - loop - command, 0)]
        velocity += TICK / fine * (natural**2 * (wanted - late_position) - 2 * damping * natural * late_velocity)
        position += TICK / fine * velocity
    return positions


@pytest.mark.slow
def test_a_sampled_loop_s_hold_is_no_delay_once_its_rate_is_given(tmp_path: Path):
    """Hold and backward difference are half a tick each; the rate is on the page's command line, and refused where torques tell."""
    case, log = setpoint_case(3), tmp_path / "log.csv"
    columns = np.column_stack([case.record.time, case.record.channels["reference"], case.record.channels["motor_position"]])
    np.savetxt(log, columns, delimiter=",", header="time,reference,motor_position", comments="")
    rate = f"{1 / case.record.sample_time:g}"
    ticks = {}
    for given in ((), ("--loop-rate-hz", rate)):
        status, out, err = run("delay", log, *given, "--json", "--report", tmp_path / "page.html")
        assert status == 0
        ticks[given], warnings = json.loads(out)["delay_ticks"]["value"], json.loads(out)["warnings"]
        assert any("--loop-rate-hz" in text for text in warnings) == (not given)
    assert ticks[("--loop-rate-hz", rate)] == pytest.approx(case.truth["loop"], abs=0.1)
    assert ticks[()] == pytest.approx(case.truth["loop"] + 1, abs=0.1)
    assert f"--loop-rate-hz {rate} " in (tmp_path / "page.html").read_text("utf-8")
    delayed(tmp_path / "torques.csv", 4)
    for file, value, words in ((tmp_path / "torques.csv", "500", "is for logs without torques"), (log, "-5", "must be a number > 0")):
        status, out, err = run("delay", file, "--loop-rate-hz", value)
        assert (status, out) == (2, "")
        assert words in err


@pytest.fixture(scope="module")
def truth() -> Truth:
    return DelayedTruth()


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_the_delay_from_every_format(name: str, tmp_path: Path, truth: Truth):
    """Where a format's log has torques, the four ticks; the others tell set-point and position."""
    path = tmp_path / name
    WRITERS[name](path, truth)
    columns = {origin.channel: origin.column for origin in read_log(path).origins if origin.joint == "knee"}
    if "target_torque" not in columns:
        status, out, err = run("delay", path, *(() if name == "log.json" else ("--joint", "knee")), "--json")
        assert (status, err) == (0, "")
        assert json.loads(out)["total_delay_ms"]["value"] == pytest.approx(6.0, abs=0.5)  # the integration alone is late by 0.05
        return
    status, out, err = run("delay", path, "--joint", "knee", "--columns", f"demand_torque.knee={columns['motor_velocity']}", "--json")
    assert (status, err) == (0, "")
    delay = json.loads(out)["delay_ms"]
    assert (delay["low"], delay["high"]) == pytest.approx((3.0, 4.0), abs=1e-6)


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    """A folder with run.csv and the knee.yaml that was made of it; what --json said; and what is true."""
    folder, case = tmp_path_factory.mktemp("identified"), joint_case(2)
    names, rows = [*case.record.channels], slice(0, 6000)
    columns = np.column_stack([case.record.time[rows], *(case.record.channels[name][rows] for name in names)])
    np.savetxt(folder / "run.csv", columns, delimiter=",", header=",".join(("time", *names)), comments="")
    status, out, err = run("joint", folder / "run.csv", "--output", folder / "knee.yaml", "--json")
    assert (status, err) == (0, "")
    return folder, json.loads(out), case.truth


@pytest.mark.slow
def test_the_joint_and_its_file(identified: tuple[Path, dict[str, Any], dict[str, Any]]):
    """A wrong unit or channel would be off by a factor; how exact the numbers are is test_identify_joint's affair."""
    folder, facts, truth = identified
    assert set(facts) >= {"model", "parameters", "adequate", "warnings", "output"}
    found = facts["parameters"]
    for name in ("motor_inertia", "link_inertia", "stiffness"):
        assert found[name]["value"] == pytest.approx(truth[name], rel=0.1)
        assert found[name]["low"] < found[name]["value"] < found[name]["high"]
    assert found["delay_ms"]["value"] == pytest.approx(1e3 * truth["delay"], rel=0.1)
    system = load_joint(folder / "knee.yaml")
    assert system.source.stiffness == pytest.approx(found["stiffness"]["value"], rel=1e-5)
    assert system.uncertainty.names == ("delay", "stiffness", "link_inertia", "motor_inertia", "damping")
    for name, unit in {"stiffness": 1.0, "motor_inertia": 1.0, "link_inertia": 1.0, "damping": 1.0, "delay_ms": 1e-3}.items():
        low, high = getattr(system.uncertainty, name.removesuffix("_ms"))
        ends = unit * found[name]["low"], unit * found[name]["high"]
        assert ends[0] * (1 - 1e-5) - 1e-12 <= low <= ends[0]  # outwards, and by no more than the digits that are written
        assert ends[1] <= high <= ends[1] * (1 + 1e-5) + 1e-12


@pytest.mark.slow
def test_the_covariance_in_the_file_is_that_of_the_delay_beside_it(identified: tuple[Path, dict[str, Any], dict[str, Any]]):
    """Which the torques tell: its variance is that of its interval (t with 39 degrees of freedom), and it moves with no other."""
    section = yaml.safe_load((identified[0] / "knee.yaml").read_text("utf-8"))["identified"]
    place, delay = section["names"].index("delay"), identified[1]["parameters"]["delay_ms"]
    row = np.array(section["covariance"][place])
    assert section["values"][place] == pytest.approx(1e-3 * delay["value"])
    assert np.sqrt(row[place]) == pytest.approx(1e-3 * (delay["high"] - delay["low"]) / 2 / stats.t.ppf(0.975, 39), rel=1e-6)
    assert not np.delete(row, place).any()


@pytest.mark.slow
def test_the_gains_in_the_file_keep_the_limits_over_its_intervals(identified: tuple[Path, dict[str, Any], dict[str, Any]]):
    """By another way than they were found: random joints within the box, their margins one by one."""
    system = load_joint(identified[0] / "knee.yaml")
    rng, low = np.random.default_rng(1), 0.999
    for place in rng.uniform(size=(12, len(system.uncertainty.names))):
        moved = system.at(tuple(place))
        margins = gr.margins(moved.loop())
        assert margins.stable
        assert margins.gain_margin >= low * 10 ** (6 / 20)
        assert margins.phase_margin >= low * np.radians(30)
        assert margins.peak_sensitivity <= 2 / low


def test_the_joint_in_a_terminal_and_a_file_that_stays_where_the_log_cannot_tell(
    identified: tuple[Path, dict[str, Any], dict[str, Any]], tmp_path: Path
):
    log, old = identified[0] / "run.csv", tmp_path / "joint.yaml"
    old.write_text("old", "utf-8")
    delayed(tmp_path / "torques.csv", 4)
    for call, words in (
        ((tmp_path / "torques.csv", "--output", old), "joint: needs motor_position"),
        ((log, "--output", log), "would overwrite the input"),
        ((log, "--output", tmp_path / "no" / "joint.yaml"), "there is no directory"),
        ((log, "--output", tmp_path / "joint.txt"), "must end in .yaml"),
        ((log, "--output", old, "--end", "0.2"), "joint:"),
        ((log, "--output", old, "--columns", "target_torque=nothing"), "nothing"),
        ((log, "--bandwidth", "100"), "needs --delay-ms"),
        ((log, "--delay-ms", "-1"), "delay -0.001 s"),
        ((log, "--start", "2.98"), "too few"),
    ):
        status, out, err = run("joint", *call)
        assert (status, out, err.count("\n")) == (2, "", 1), call
        assert words in err, (call, err)
        assert old.read_text("utf-8") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["joint.yaml", "torques.csv"]


@pytest.mark.parametrize(
    ("found", "wrong", "words"),
    [
        ("names: [motor", "names: [rotor", "names[0]: 'rotor_inertia' must be one of"),
        ("names: [motor_inertia, link", "names: [link_inertia, link", "names[1]: 'link_inertia' is there twice"),
        ("values: [", "values: [1.0, ", "values: 11 values must be 10"),
        ("values: [", "values: [.nan, ", "values[0]: nan must be finite"),
        ("    - [", "    - [-", "covariance: variance -"),
        ("    - [", "    - [1e-9, ", "covariance: must have 10 rows of 10"),
        ("  model: two", "  model: three", "identified.model"),
        ("  adequate:", "  adequat:", "did you mean adequate?"),
    ],
)
def test_what_is_wrong_with_an_identified_section(
    found: str, wrong: str, words: str, identified: tuple[Path, dict[str, Any], dict[str, Any]]
):
    text = (identified[0] / "knee.yaml").read_text("utf-8")
    assert found in text
    with pytest.raises(GainroomError) as refused:
        parse_joint(text.replace(found, wrong, 1), "knee.yaml")
    assert words in str(refused.value)
    assert str(refused.value).startswith("knee.yaml: identified")


@pytest.mark.parametrize(
    ("matrix", "problem"),
    [
        ([[1.0, 0.5], [0.5, 1.0]], ""),
        ([[1e-20, 0.0], [0.0, 0.0]], ""),
        ([[1.0, 0.5], [0.4, 1.0]], "symmetric"),
        ([[1.0, 1.1], [1.1, 1.0]], "correlation"),
        ([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]], "eigenvalue"),
    ],
)
def test_what_a_covariance_is(matrix: list[list[float]], problem: str):
    assert problem in problem_of(np.array(matrix))
    assert bool(problem) == bool(problem_of(np.array(matrix)))


def gains_log(path: Path, kp: float, kd: float) -> None:
    """Set-point, position and the torque that a law makes of them."""
    time = TICK * np.arange(4000)
    reference, position = 0.3 * np.sin(9 * time) + 0.1 * np.sin(31 * time + 1), 0.28 * np.sin(9 * time - 0.2) + 0.06 * np.sin(31 * time)
    torque = kp * (reference - position) + kd * np.diff(reference - position, prepend=0) / TICK
    columns = np.column_stack([time, reference, position, torque])[1:]
    np.savetxt(path, columns, delimiter=",", header="time,reference,motor_position,target_torque", comments="")


def test_gains_beside_those_asked_for(tmp_path: Path):
    gains_log(tmp_path / "log.csv", 200.0, 5.0)
    asked = f"kp={200 / (2 * np.pi):.6f},kd=5"
    status, out, err = run("gains", tmp_path / "log.csv", "--asked", asked, "--json")
    facts = json.loads(out)
    assert (status, err) == (0, "")
    assert (facts["kp"]["value"], facts["kd"]["value"]) == pytest.approx((200.0, 5.0), rel=1e-3)
    assert facts["asked"] == pytest.approx({"kp": 200 / (2 * np.pi), "kd": 5.0}, rel=1e-6)
    assert [(each["gain"], each["factor"]) for each in facts["unit_errors"]] == [("kp", pytest.approx(2 * np.pi))]
    status, out, err = run("gains", tmp_path / "log.csv", "--asked", asked)
    assert "2π: revolutions taken for radians" in " ".join(out.split())
    (tmp_path / "testbed.yaml").write_text(example_texts()["testbed-simulated"], "utf-8")
    _, out, _ = run("gains", tmp_path / "log.csv", "--asked", tmp_path / "testbed.yaml", "--json")
    assert json.loads(out)["asked"] == {"kp": 1600.0, "kd": 70.0}
    for wrong, words in (("kp=x", "kp: 'x'"), ("ki=1", "'ki' must be kp or kd"), ("kp=0", "must be > 0"), ("none.yaml", "no such file")):
        status, out, err = run("gains", tmp_path / "log.csv", "--asked", wrong)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert words in err


def test_the_stiffness_of_a_locked_output(tmp_path: Path):
    """τ = K θ ± F, back and forth."""
    time = TICK * np.arange(8000)
    position = 5e-3 * np.sin(2 * np.pi * time / 2)
    torque = 4000 * position + 1.5 * np.sign(np.gradient(position)) + 1e-2 * RNG.normal(size=8000)
    np.savetxt(
        tmp_path / "log.csv", np.column_stack([time, position, torque]), delimiter=",", header="time,motor_position,torque", comments=""
    )
    status, out, err = run("stiffness", tmp_path / "log.csv", "--json")
    facts = json.loads(out)
    assert (status, err) == (0, "")
    assert facts["stiffness"]["value"] == pytest.approx(4000, rel=5e-3)
    assert facts["friction"]["value"] == pytest.approx(1.5, rel=2e-2)
    status, out, _ = run("stiffness", tmp_path / "log.csv")
    assert "The stiffness is 4" in out.replace("\u202f", "")
    status, out, err = run("stiffness", tmp_path / "log.csv", "--motor-inertia", "-1")
    assert (status, err.count("\n")) == (2, 1)


@pytest.mark.parametrize("command", ["delay", "joint", "gains", "stiffness"])
def test_what_cannot_be_read_is_one_line(command: str, tmp_path: Path):
    (tmp_path / "empty.csv").touch()
    (tmp_path / "words.csv").write_text("a,b\nx,y\n" * 30, "utf-8")
    (tmp_path / "short.csv").write_text("time,target_torque,actual_torque,motor_position,reference\n0,1,1,1,1\n1e-3,1,1,1,1\n", "utf-8")
    still = np.column_stack([TICK * np.arange(500), np.ones((500, 4))])
    header = "time,target_torque,actual_torque,motor_position,reference"
    np.savetxt(tmp_path / "still.csv", still, delimiter=",", header=header, comments="")
    for name in ("nowhere.csv", "empty.csv", "words.csv", "short.csv", "still.csv"):
        status, out, err = run(command, tmp_path / name)
        assert (status, out, err.count("\n")) == (2, "", 1), (name, err)
        assert name in err


def test_front():
    status, out, _ = run()
    assert status == 2
    assert "Usage: gainroom identify" in out
