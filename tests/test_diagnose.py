"""gainroom diagnose: what is measured of a vibration against closed forms, causes against recordings of known cause, the command."""

import io
import json
import math
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import gainroom as gr
from gainroom.cli import main
from gainroom.identification.oscillation_search import find_oscillation
from gainroom.identification.record import Record
from gainroom.identification.speed_order import NEAR, _share
from gainroom.report.diagnosis_text import advice, sentence
from gainroom.simulation import Friction, Scenario, Testbed, simulate
from gainroom.studies.diagnosis import diagnose
from gainroom.system.system import System
from identified import multisine
from recordings import CAUSES, MAKERS, Recording, recording

TICK = 1e-3
WHOLE, WHOLE_QUIET, SHARE_QUIET = 20, 50, 4  # recordings of each cause, and quiet ones
SHARE = [("gain_limit", 0), ("gain_limit", 1), ("stick_slip", 1), ("quantisation", 1), ("structural_resonance", 0), ("saturation", 4)]
"""Of every run: those that are soon made."""
LEAST_RIGHT = 0.95


def record(columns: dict[str, np.ndarray]) -> Record:
    return Record(TICK * np.arange(len(next(iter(columns.values())))), columns, TICK)


TIME = TICK * np.arange(4000)


@pytest.mark.parametrize(("rate", "state"), [(0.8, "growing"), (0.0, "sustained"), (-0.8, "decaying")])
def test_frequency_and_growth_of_a_known_oscillation(rate: float, state: str):
    """e^{σt} sin ωt beside white noise of a thousandth: σ over the last 20 periods to 0.02/s, six standard errors of its slope."""
    noise = 1e-6 * np.random.default_rng(0).standard_normal(len(TIME))
    swings = 1e-3 * np.exp(rate * (TIME - TIME[-1])) * np.sin(2 * np.pi * 23 * TIME)
    seen = find_oscillation(record({"motor_position": 0.3 + swings + noise, "reference": np.full(len(TIME), 0.3)})).oscillation
    assert seen is not None
    assert seen.vibrates
    assert seen.state == state
    assert seen.vibration.frequency == pytest.approx(2 * np.pi * 23, rel=1e-4)
    assert seen.vibration.growth_rate == pytest.approx(rate, abs=0.02)
    assert seen.vibration.amplitude == pytest.approx(1e-3, rel=0.02)


def test_harmonics_and_clipping_of_known_waves():
    """A square wave has odd harmonics of 1/3 and 1/5; a sine cut at half its amplitude is at the limit for 2/3 of the time."""
    angle = 2 * np.pi * 7.3 * TIME
    position = 1e-3 * np.sin(angle)
    still = np.zeros(len(TIME))
    square = find_oscillation(record({"motor_position": position, "reference": still, "actual_torque": np.sign(np.sin(angle))})).oscillation
    cut = find_oscillation(
        record({"motor_position": position, "reference": still, "demand_torque": np.clip(np.sin(angle), -0.5, 0.5)})
    ).oscillation
    whole = find_oscillation(record({"motor_position": position, "reference": still, "demand_torque": np.sin(angle)})).oscillation
    assert square is not None
    assert cut is not None
    assert whole is not None
    assert square.odd == pytest.approx(math.hypot(1 / 3, 1 / 5), rel=0.02)  # ticks round the edges
    assert square.even < math.pi / 137  # an edge that comes a tick late
    assert cut.clipped == pytest.approx(2 / 3, abs=0.04)  # two rows at each edge of 137 are between
    assert cut.limit == pytest.approx(0.5)
    assert whole.clipped == 0
    assert whole.odd < 0.01


@pytest.mark.parametrize(
    ("name", "position", "reference"),
    [
        ("rest", lambda rng: 1e-5 * rng.standard_normal(4000), np.zeros(4000)),
        ("set-point", lambda rng: 0.01 * np.sin(60 * (TIME - 0.01)), 0.01 * np.sin(60 * TIME)),
        ("settling", lambda rng: np.exp(-20 * TIME) * np.sin(60 * TIME), np.zeros(4000)),
        ("ramp", lambda rng: 1e-4 * np.round((0.3 * TIME - 0.003) / 1e-4), 0.3 * TIME),
    ],
)
def test_what_is_no_vibration(name: str, position, reference: np.ndarray):
    """Noise; a motion that follows its set-point; a step's settling (damping ratio 1/3); an encoder's steps along a ramp."""
    found = diagnose(record({"motor_position": position(np.random.default_rng(1)), "reference": reference}))
    assert not found.vibrates, name
    assert found.causes == ()


@pytest.mark.parametrize(
    ("position", "vibrates"),
    [
        (lambda t: 1.35 * np.sin(2 * np.pi * 0.3 * t), False),
        (lambda t: 0.1 * np.sin(2 * np.pi * 2.5 * t), False),
        (lambda t: 1.35 * np.sin(2 * np.pi * (0.1 * t + 0.05 * t**2)), False),  # from 0.1 to 1.3 Hz
        (lambda t: 5e-3 * np.sin(2 * np.pi * (20 * t - 0.6 * t**2)), False),  # from 20 to 5.6 Hz
        (lambda t: 0.02 * np.sin(2 * np.pi * 0.1 * 12 / np.log(150) * np.exp(t / 12 * np.log(150))), False),  # to 15 Hz, evenly in octaves
        (lambda t: 1e-3 * np.sin(2 * np.pi * 50 * t), True),
        (lambda t: 2e-3 * np.sin(2 * np.pi * 3 * t), True),  # slow, and small
        (lambda t: 0.05 * np.exp(0.3 * (t - 12)) * np.sin(2 * np.pi * 3 * t), True),  # it grows
    ],
)
def test_a_motion_that_may_be_commanded_is_no_vibration(position, vibrates: bool):
    """The set-point is not in the log; the answer asks for it."""
    found = diagnose(record({"motor_position": 2e-5 * np.round(position(TICK * np.arange(12_000)) / 2e-5)}))
    assert found.vibrates == vibrates
    if not vibrates:
        assert "not in the log" in sentence(found)
        assert "Record the set-point" in advice(found)[0]


@pytest.mark.parametrize(
    ("position", "vibrates"),
    [
        (lambda t: 1e-4 * np.exp(2.4 * t), False),  # as with a wrong sign: to 1.5 rad
        (lambda t: 1e-3 * np.exp(2.0 * t) * np.sin(2 * np.pi * 0.8 * t), True),  # three periods
        (lambda t: 1e-4 * np.exp(2.0 * t) * np.sin(2 * np.pi * 10 * t), True),
        (lambda t: 0.3 * (1 - np.exp(-t)) - 0.3, False),
    ],
)
def test_a_joint_that_runs_away_is_said_to(tmp_path: Path, position, vibrates: bool):
    """From a set-point that rests; the last one comes nearer to it instead."""
    values = 2e-5 * np.round(position(TIME) / 2e-5)
    np.savetxt(
        tmp_path / "log.csv", np.column_stack([TIME, values, 0 * TIME]), delimiter=",", header="time,motor_position,reference", comments=""
    )
    status, out, _ = run("diagnose", tmp_path / "log.csv")
    away = abs(values[-1]) > abs(values[0])
    assert status == int(away)
    assert out.startswith("Not safe: vibrates") == vibrates
    assert ("uns away" in out) == away


@pytest.mark.parametrize("rate", [-0.3, -1.0, 0.0])
def test_motion_below_a_step_of_the_encoder_is_no_vibration(rate: float):
    """It shows in means over many rows: a quarter of a step, or what is left of less than one."""
    step, noise = 2e-5, 2e-5 * np.random.default_rng(5).standard_normal(4000)
    true = 0.05 + 0.25 * step * np.exp(rate * TIME) * np.sin(2 * np.pi * 3.4 * TIME)
    position = step * np.round((true + noise) / step)
    assert not diagnose(record({"motor_position": position, "reference": np.full(4000, 0.05)})).vibrates


@pytest.mark.parametrize(("torque", "vibrates"), [(31.0, True), (6.0, True), (0.3, False)])
def test_a_torque_that_swings_strongly_is_not_quiet(torque: float, vibrates: bool):
    """The encoder shows two steps; the log also holds a move, of 39 N m. A swing by less than a hundredth of that is none."""
    step = 3.07e-3
    angle = 2 * np.pi * 61.4 * TIME
    position = np.where(TIME < 0.3, 0.0, step * (16 + (np.sin(angle) > 0)))
    torques = np.where(TIME < 0.3, 39.0 * np.sin(2 * np.pi * TIME / 0.3), -torque * np.sin(angle + 0.1))
    log = {"motor_position": position, "reference": np.where(TIME < 0.3, 0.0, 0.05), "actual_torque": torques}
    assert diagnose(record(log)).vibrates == vibrates


def test_a_growing_loop_is_measured_as_its_root_says_and_the_advice_gives_the_margin_asked_for():
    """Recording against the rightmost root of the true loop; the advised factor against the gain margin of the file's loop."""
    made = recording("gain_limit", 1)
    found = diagnose(made.record, made.system)
    assert found.oscillation is not None
    assert found.oscillation.vibration.frequency == pytest.approx(made.frequency, rel=2e-3)
    assert found.cause is not None
    assert found.cause.name == "gain_limit"
    assert gr.margins(made.system.loop().scaled(found.factor)).limit.gain == pytest.approx(found.required, rel=1e-6)
    blind = diagnose(made.record)
    assert blind.vibrates
    assert blind.cause is None  # a structural resonance looks alike without a model


def _judged(made: Recording) -> str:
    found = diagnose(made.record, made.system)
    return found.causes[0].name if found.vibrates else "quiet"


@pytest.mark.parametrize(("cause", "index"), SHARE)
def test_the_cause_of_a_recording(cause: str, index: int):
    assert _judged(recording(cause, index)) == cause


@pytest.mark.slow
@pytest.mark.parametrize("index", range(SHARE_QUIET))
def test_a_quiet_recording(index: int):
    assert _judged(recording("quiet", index)) == "quiet"


@pytest.mark.population
@pytest.mark.timeout(3600)
def test_causes_of_a_population():
    """Of 100 recordings of one cause each at least 95 are told; of 50 quiet ones none vibrates. Without a model hardly any is wrong."""
    right, wrong, blind = Counter(), [], Counter()
    for cause in CAUSES:
        for index in range(WHOLE):
            made = recording(cause, index)
            judged = _judged(made)
            right[cause] += judged == cause
            if judged != cause:
                wrong.append((cause, index, made.kind, judged))
            alone = diagnose(made.record).cause
            blind["Its cause is not known" if alone is None else "right" if alone.name == cause else "wrong"] += 1
    loud = [index for index in range(WHOLE_QUIET) if _judged(recording("quiet", index)) != "quiet"]
    shares = f"{sum(right.values())} of {WHOLE * len(CAUSES)} right: {dict(right)}; without a model {dict(blind)}"
    print(f"\n{shares}; wrong: {wrong}; loud: {loud}")
    assert sum(right.values()) >= LEAST_RIGHT * WHOLE * len(CAUSES)
    assert loud == []
    assert blind["wrong"] <= (1 - LEAST_RIGHT) * WHOLE * len(CAUSES)


def test_every_maker_has_a_cause():
    assert set(MAKERS) == {*CAUSES, "quiet"}


@pytest.fixture(scope="module")
def excited() -> tuple[System, Record, np.ndarray]:
    """A stable loop with a multisine of torque from 8 to 60 Hz beside its own, friction and an encoder; and the loop's lines [Hz]."""
    system = System.of_joint(gr.ElasticJoint(0.2, 0.8, 1e4, 2.0), gr.Drive(2500.0, 0.8, 2e-3), gr.PD(40.0, 9.0), sample_time=TICK)
    lines, time = np.geomspace(8, 60, 40), TICK * np.arange(12_000)
    torque = 10 * multisine(np.random.default_rng(4), time, lines)
    bed = Testbed(system.loop(), motor_friction=Friction(1.0, 1.5, 0.05), motor_resolution=1e-5, substep=TICK / 4)
    run_ = simulate(bed, Scenario(0.0, float(time[-1]), feedforward=torque[:, None], noise=5e-6, seed=3, limit=50.0))
    columns = {"target_torque": run_.target_torque, "actual_torque": run_.actual_torque, "motor_position": run_.motor_reading}
    return system, record({name: values[:, 0] for name, values in columns.items()}), lines


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("still", [False, True])
def test_an_excitation_in_the_torque_is_no_vibration(excited: tuple[System, Record, np.ndarray], known: bool, still: bool):
    """With the set-point in the log and without, with the joint's file and without. Its band holds the lines that were given."""
    system, log, lines = excited
    log = replace(log, channels={**log.channels, **({"reference": np.zeros(len(log.time))} if still else {})})
    found = diagnose(log, system if known else None)
    assert not found.vibrates
    assert found.search.excited is not None
    low, high = found.search.excited
    assert 2 * np.pi * lines[0] == pytest.approx(low, rel=0.1)  # 2 % of the power may lie beyond either end: a line of 40
    assert 2 * np.pi * lines[-1] == pytest.approx(high, rel=0.1)


def test_a_vibration_beside_an_excitation_is_found(excited: tuple[System, Record, np.ndarray]):
    """Of a loop 10 % beyond its gain limit, which outgrows a small multisine."""
    system, log, lines = excited
    loop = system.loop()
    torque = 0.2 * multisine(np.random.default_rng(4), log.time, lines)
    bed = Testbed(loop.scaled(1.1 * gr.gain_limit(loop).gain), torque_limit=40.0, substep=TICK / 4)
    run_ = simulate(bed, Scenario(0.0, 4.0, feedforward=torque[:4001, None], limit=50.0))
    columns = {"target_torque": run_.target_torque, "actual_torque": run_.actual_torque, "motor_position": run_.motor_reading}
    found = diagnose(record({name: values[:, 0] for name, values in columns.items()}))
    assert found.vibrates
    assert found.search.excited is None


def test_stick_slip_is_no_excitation():
    """Its torque is of many frequencies, too, and all of it is the controller's."""
    made = recording("stick_slip", 1)
    assert made.record.has("target_torque")
    found = diagnose(made.record, made.system)
    assert found.search.excited is None
    assert found.causes[0].name == "stick_slip"


JOINT = """
joint: {rotor_inertia: 0.2e-4, gear_ratio: 100, link_inertia: 0.8, stiffness: 1.0e4, damping: 1.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.174}
control: {type: pd, kp: 1600.0, kd: 70.0, feedback: motor, sample_rate_hz: 2000}
scenario: {duration: 1.5, reference: {type: step, by: 0.05, start: 0.2}, torque_limit: 60.0, motor_resolution: 1.0e-5}
"""


def run(*call: str | Path) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main([*map(str, call)])
    return status, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """joint.yaml, and logs of simulate at its gains and at 1.4 times them: 1.14 times is the limit."""
    place = tmp_path_factory.mktemp("logs")
    (place / "joint.yaml").write_text(JOINT, "utf-8")
    for name, gain in (("quiet", "0.5"), ("loud", "1.4")):
        run("simulate", place / "joint.yaml", "--gain", gain, "--log", place / f"{name}.csv")
    return place


@pytest.mark.slow
def test_the_command_on_logs_of_simulate(folder: Path):
    """The file has the gains without the factor 1.4: it is read from the log."""
    status, out, _ = run("diagnose", folder / "loud.csv", "--joint", folder / "joint.yaml", "--json")
    facts = json.loads(out)
    assert status == 1
    assert facts["cause"] == facts["causes"][0]["cause"] == "gain_limit"
    assert facts["vibration"]["state"] == "sustained"  # the torque limit bounds it
    assert facts["vibration"]["frequency_rad_s"] == pytest.approx(facts["predicted"]["frequency_rad_s"], rel=0.1)
    single = json.loads(run("joint", folder / "joint.yaml", "--json")[1])["gain_limit"]
    assert facts["predicted"]["gain_limit"] == pytest.approx(single / 1.4, rel=0.02)
    assert facts["gain_factor"] == pytest.approx(single / 1.4 / 10**0.3, rel=0.02)
    assert sum(one["likelihood"] for one in facts["causes"]) == pytest.approx(1)
    assert any("1.4 times those of the file" in text for text in facts["warnings"])
    status, out, _ = run("diagnose", folder / "quiet.csv", "--joint", folder / "joint.yaml")
    assert status == 0
    assert out.startswith("No vibration.")


def test_the_page(folder: Path):
    given = ("--units", "motor_position=rad", "--start", "0.5", "--joint", folder / "joint.yaml")
    status, out, _ = run("diagnose", folder / "loud.csv", *given, "--report", folder / "page.html")
    assert status == 1
    text = (folder / "page.html").read_text("utf-8")
    assert all(words in text for words in ("--units motor_position=rad", "--start 0.5", "--joint"))  # so that it runs again as it ran
    for words in ("Spectrogram", "Spectrum with harmonics", "predicted by the model", "the loop is at its gain limit", "What to do"):
        assert words in text
    assert "page.html" in out


def test_what_cannot_be_told_is_said_with_what_to_record(folder: Path):
    rows = np.loadtxt(folder / "loud.csv", delimiter=",", skiprows=1)
    names = (folder / "loud.csv").read_text("utf-8").splitlines()[0].split(",")
    kept = [names.index(next(name for name in names if name.startswith(start))) for start in ("time", "motor_position")]
    np.savetxt(folder / "bare.csv", rows[:, kept], delimiter=",", header="time,motor_position", comments="")
    status, out, _ = run("diagnose", folder / "bare.csv", "--start", "0.5")
    assert status == 1
    for words in ("Its cause is not known", "Record the set-point", "Record the torque", "--joint joint.yaml"):
        assert words in out


def test_what_is_wrong_is_one_line(folder: Path):
    for call, words in (
        (("diagnose", folder / "none.csv"), "none.csv"),
        (("diagnose", folder / "loud.csv", "--joint", folder / "none.yaml"), "none.yaml"),
        (("diagnose", folder / "loud.csv", "--joint", "elbow"), "elbow"),
        (("diagnose", folder / "loud.csv", "--joint", "a.yaml", "--joint", "b.yaml"), "b.yaml"),
    ):
        status, out, err = run(*call)
        assert (status, out) == (2, "")
        assert words in err
        assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("seed", range(4))
def test_the_share_of_a_vibration_is_that_in_scipys_periodogram(seed: int):
    """Under a Hann window, of what a straight line leaves: a vibration on a bent drift, beside a slow swing and noise."""
    rng, tick, omega, above = np.random.default_rng(seed), 2e-3, 90.0, 30.0
    time = tick * np.arange(401)
    values = np.sin(omega * time) + rng.normal(0, 0.5, len(time)) + rng.normal() * time**2 + np.sin(12.0 * time)
    window = signal.get_window("hann", len(time), fftbins=False)
    lines, power = signal.periodogram(values, 1 / tick, window, detrend="linear")
    near = np.abs(2 * math.pi * lines - omega) < max(NEAR * omega, 2.5 * 2 * math.pi * lines[1])
    share = power[near].sum() / power[2 * math.pi * lines > above].sum()
    assert _share(values, tick, omega, above) == pytest.approx(share, rel=1e-9)
