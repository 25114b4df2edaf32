"""The page on public gains: sources, commands that say what was computed, numbers that are recomputed, five rows by other means."""

import importlib.util
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from pytest import approx

from benchmarks.public_gains.measured import Numbers, numbers
from benchmarks.public_gains.page import page
from benchmarks.public_gains.rows import CHECKOUTS, DELAYS, GEARS, HOST, Row, rows
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files import audit_options

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "public_gains.md").read_text("utf-8")
SECTIONS = dict(re.findall(r"^### (.*?)\n(.*?)(?=^### |^## |\Z)", PAGE.partition("## Each row alone")[2], re.MULTILINE | re.DOTALL))
ROWS = {row.name: row for row in rows()}
PACKAGED = [name for name, row in ROWS.items() if row.repository is None]
DIGITS = 6e-3
"""Half of the last of three digits, of a number that begins with 1."""


MIRRORED = re.compile("left_|right_|^[FRH][LR]_")
"""Sides of mirrored limbs, of which either may come first."""


def section(row: Row) -> str:
    return SECTIONS[f"{row.robot}: {row.set}"]


def here(row: Row) -> str:
    """Model of a row in a package; skips where it is not installed."""
    model = row.model_in(None)
    if model is None:
        pytest.skip(f"{row.model}: that package is not installed (pip install example-robot-data)")
    return model


def test_the_page_has_every_row_and_no_other():
    assert sorted(SECTIONS) == sorted(f"{row.robot}: {row.set}" for row in ROWS.values())


@pytest.mark.parametrize("name", ROWS)
def test_a_row_names_its_source_its_date_and_what_is_assumed(name: str):
    row, text = ROWS[name], section(ROWS[name])
    assert re.fullmatch(r"[\w.-]+/[\w.-]+", row.source["repository"])
    assert re.fullmatch(r"\d{4}(-\d\d-\d\d)?", str(row.source["date"]))
    assert f"[{row.source['repository']}: {row.source['path']}](https://github.com/" in text
    assert f"), {row.source['date']}. " in text
    assert f"Motors: {row.inertia}." in text
    assert row.run in ("drive", "host", "simulation")
    said = (row.rate_said is not None) + ("said" in row.drive) + (not row.drive)
    assert text.count("assumed") >= 2 - said, "a rate that no source says is called assumed"


@pytest.mark.parametrize("name", ROWS)
def test_its_commands_are_read_as_what_was_computed(name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Every command of the page, as the command line reads it, is the model, the gains and the options that made the numbers."""
    row, seen = ROWS[name], []

    def caught(*call: object) -> None:
        seen.append(call)
        raise GainroomError("read")

    monkeypatch.setattr(audit_options, "audited", caught)
    monkeypatch.chdir(ROOT)
    commands = re.search(r"^```sh\n(.*?)^```", section(row), re.MULTILINE | re.DOTALL)
    assert commands is not None
    for line in commands[1].splitlines():
        program, *words = shlex.split(line)
        assert program == "gainroom"
        assert main(words) == 2
    assert capsys.readouterr().err.splitlines() == ["gainroom: error: read"] * len(row.readings)
    for (model, gains, options), reading in zip(seen, row.readings, strict=True):
        assert model == (row.model if row.repository is None else f"{CHECKOUTS}/{row.in_checkout}")
        assert ROOT / gains == row.gains
        assert options == row.options(reading)


def shown(row: Row) -> dict[str, list[str]]:
    """Cells of the table of a row, by reading."""
    lines = re.findall(r"^\| (.*) \|$", section(row), re.MULTILINE)[1:]
    return {line.split(" | ")[0]: line.split(" | ")[1:] for line in lines}


def leading(cell: str) -> float:
    return {"none": np.inf, "never": np.inf}.get(cell) or float(cell.split()[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", PACKAGED)
def test_the_page_shows_what_is_computed_now(name: str):
    row = ROWS[name]
    model = here(row)
    for reading in row.readings:
        now, (word, factor, _, delay, first) = numbers(row, model, reading), shown(row)[row.title(reading)]
        assert leading(factor) == approx(now.factor, rel=DIGITS)
        assert leading(delay) == approx(now.delay, rel=DIGITS)
        assert (word == "vibrates") == (now.factor < 1)
        assert {MIRRORED.sub("", each) for each in re.findall("`(.*?)`", first)} <= {MIRRORED.sub("", each) for each in now.joints}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "reading"), [("panda-libfranka", HOST), ("solo8", HOST), ("bolt", GEARS)])
def test_the_command_prints_the_same_numbers(name: str, reading: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    row = ROWS[name]
    found = numbers(row, here(row), reading)
    monkeypatch.chdir(ROOT)
    main([*shlex.split(row.command(reading))[1:], "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["gain_limit"] == approx(found.factor, rel=1e-6)  # the same search in the same loop, over gearboxes to the same place
    assert told["delay_limit_ms"] == approx(found.delay, rel=1e-6)


def test_what_is_left_out_is_said():
    row = ROWS["go1-mjlab"]
    text = page([(row, dict.fromkeys(row.readings, Numbers(1.5, 40.0, ("a",), 4.0, dict.fromkeys(DELAYS, 1.5))))], ["another robot: why"])
    assert "## Left out\n\n- another robot: why\n" in text
    assert "Here are 1 public sets of gains of 1 public robots" in text


SMALL, HIP, KNEE, WRIST = 0.003609725, 0.010177520, 0.025101925, 0.00425  # G1: mjlab's g1_constants.py [kg m²]
GO1 = 0.000111842  # rotor, mjlab's go1_constants.py
ODRI = 4.5e-6 * 9**2  # rotor and ratio, robot_properties_solo's config.py
TALOS = {1: (8.60398e-5, 150), 2: (2.07288e-4, 101), 3: (2.07288e-4, 100), 4: (1.95461e-4, 144), 5: (2.07288e-4, 100), 6: (8.60398e-5, 101)}
INDEPENDENT = {
    "g1-mjlab": {
        r".*_hip_(pitch|yaw)_joint|waist_yaw_joint": (40.1792, 2.55789, HIP),
        r".*_(hip_roll|knee)_joint": (99.0984, 6.3088, KNEE),
        r".*_ankle_.*|waist_(pitch|roll)_joint": (28.5012, 1.81445, 2 * SMALL),
        r".*_(shoulder_.*|elbow|wrist_roll)_joint": (14.2506, 0.907223, SMALL),
        r".*_wrist_(pitch|yaw)_joint": (16.7783, 1.06814, WRIST),
    },
    "go1-mjlab": {r".*_(hip|thigh)_joint": (35, 0.5, 6**2 * GO1), r".*_calf_joint": (35, 0.5, 9**2 * GO1)},
    "solo12": {r".*": (5, 0.1, ODRI)},
    "panda-libfranka": {
        r"panda_joint[1-4]": (600, 50, 0.195),  # armatures of mujoco_menagerie's FR3
        r"panda_joint5": (250, 30, 0.074),
        r"panda_joint6": (150, 25, 0.074),
        r"panda_joint7": (50, 15, 0.074),
    },
    "so101-p32": {r".*": (17.8, 0, 0.028403)},  # Rhoban/bam's fit of the STS3215 at 7.4 V
    "talos-sim": {rf"leg_.*_{k}_joint": (5000, 20, rotor * ratio**2) for k, (rotor, ratio) in TALOS.items()},
}


def inverse_inertia(row: Row, values: dict[str, tuple[float, float, float]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse inertia (n, n) of the joints with gains, the base free where it floats, from Pinocchio's mass matrix; kp and kd (n,)."""
    pin = pytest.importorskip("pinocchio", reason="Pinocchio is not installed (pip install pin)")
    from gainroom.robot.formats.model_names import locate  # a path only

    path = str(locate(row.model))
    floating = row.base == "floating"
    whole = pin.buildModelFromUrdf(path, pin.JointModelFreeFlyer()) if floating else pin.buildModelFromUrdf(path)
    own = {name: next((each for pattern, each in values.items() if re.fullmatch(pattern, name)), None) for name in whole.names}
    locked = [whole.getJointId(name) for name, each in own.items() if each is None and name not in ("universe", "root_joint")]
    model = pin.buildReducedModel(whole, locked, pin.neutral(whole))
    position = pin.neutral(model)
    for pattern, angle in row.audit.get("posture", {}).items():
        for joint, name in enumerate(model.names):
            if re.fullmatch(pattern, name):
                position[model.joints[joint].idx_q] = angle
    mass = np.array(pin.crba(model, model.createData(), position))
    mass = np.triu(mass) + np.triu(mass, 1).T
    start = 6 if floating else 0
    kp, kd, inertia = np.array([own[name] for name in list(model.names)[2 if floating else 1 :]], float).T
    mass[start:, start:] += np.diag(inertia)
    return np.linalg.inv(mass)[start:, start:], kp, kd


def radius(mobility: np.ndarray, kp: np.ndarray, kd: np.ndarray, period: float, delay: float, viscous: float = 0.0) -> float:
    """Spectral radius of rigid joints over a tick: torque held, `delay` late, velocity by backward difference; friction `viscous` each."""
    n, whole = len(kp), int(delay / period)
    late = delay - whole * period
    zero, one = np.zeros((n, n)), np.eye(n)
    plant = np.block([[zero, one, zero], [zero, -viscous * mobility, mobility], [zero, zero, zero]])
    earlier, later = (scipy.linalg.expm(duration * plant) for duration in (late, period - late))
    # states: position, velocity, position a tick ago, torques of the last whole + 1 ticks, the newest first
    count = 3 + whole + 1
    block = [slice(n * k, n * (k + 1)) for k in range(count)]
    torque, old = np.zeros((n, n * count)), np.zeros((n, n * count))
    torque[:, block[0]], torque[:, block[2]] = -np.diag(kp + kd / period), np.diag(kd / period)
    old[:, block[3 + whole]] = one
    new = torque if whole == 0 else np.eye(n * count)[block[2 + whole]]
    motion = np.eye(n * count)[: 2 * n]
    for held, duration in ((old, earlier), (new, later)):
        motion = duration[: 2 * n, : 2 * n] @ motion + duration[: 2 * n, 2 * n :] @ held
    shifted = [np.eye(n * count)[block[k - 1]] for k in range(4, count)]
    step = np.vstack([motion, np.eye(n * count)[block[0]], torque, *shifted])
    return float(abs(np.linalg.eigvals(step)).max())


def first_vibration(mobility: np.ndarray, kp: np.ndarray, kd: np.ndarray, *loop: float) -> float:
    """Factor on all gains at which the spectral radius passes 1, by bisection between a calm and a vibrating factor."""
    low, high = 1e-3, 1e-3
    assert radius(mobility, low * kp, low * kd, *loop) < 1
    while radius(mobility, high * kp, high * kd, *loop) < 1:
        low, high = high, 1.5 * high
    for _ in range(20):  # 1.5 of a factor, to a millionth of it
        middle = (low * high) ** 0.5
        calm = radius(mobility, middle * kp, middle * kd, *loop) < 1
        low, high = (middle, high) if calm else (low, middle)
    return low


@pytest.mark.slow
@pytest.mark.parametrize("name", INDEPENDENT)
def test_a_row_by_a_mass_matrix_and_a_spectral_radius(name: str):
    """Nothing of gainroom but the row's posture: Pinocchio's mass matrix, inertias as the sources have them, numpy's eigenvalues."""
    row = ROWS[name]
    here(row)
    mobility, kp, kd = inverse_inertia(row, INDEPENDENT[name])
    cells = shown(row)["host"]
    found = first_vibration(mobility, kp, kd, 1 / row.rate, 3e-3, 0.6 if name == "so101-p32" else 0.0)
    assert found == approx(float(cells[1]), rel=DIGITS)
    assert found == approx(numbers(row, here(row), HOST).factor, rel=5e-4)  # three digits


def test_the_spectral_radius_is_right_about_a_double_integrator():
    """Undelayed PD on a unit mass, a tick T: with position alone kd/T (q − q') the characteristic polynomial is Jury's by hand."""
    period, kp, kd = 1e-2, 3.0, 0.7
    # q+ = q + T v + T²/2 u, v+ = v + T u, u = −kp q − kd (q − q')/T
    own = np.array(
        [
            [1 - period**2 / 2 * (kp + kd / period), period, period**2 / 2 * kd / period],
            [-period * (kp + kd / period), 1, period * kd / period],
            [1, 0, 0],
        ]
    )
    found = radius(np.eye(1), np.array([kp]), np.array([kd]), period, 0.0)
    assert found == approx(abs(np.linalg.eigvals(own)).max(), rel=1e-12)


def test_matplotlib_draws_the_picture_of_the_page():
    assert importlib.util.find_spec("matplotlib") is not None
    picture = (ROOT / "docs" / "images" / "public-gains.svg").read_text("utf-8")
    assert [
        row.name for row in ROWS.values() if f"{row.robot}: {row.set}" not in picture.replace("&#39;", "'").replace("&quot;", '"')
    ] == []


def test_the_page_on_evidence_counts_as_the_rows_do():
    """Its numbers about the rows: where they run, with less than 6 dB there, and what a drive of 2 ms would do."""
    text = re.sub(r"\s+", " ", (ROOT / "docs" / "evidence.md").read_text("utf-8"))
    run = {row.name: row.run for row in ROWS.values()}
    there = {name: shown(ROWS[name])[place] for name, place in run.items() if place != "simulation"}
    drives, hosts = ([cells for name, cells in there.items() if run[name] == place] for place in ("drive", "host"))
    assert f"{len(drives)} sets that run in drives, {len(hosts)} that run on hosts" in text
    assert min(leading(cells[1]) for cells in there.values()) > 1
    assert [cells[0] for cells in there.values()].count("tight") == 3
    assert "three have less than 6 dB there" in text
    assert sum(leading(cells[3]) < 2 for cells in drives) == 3
    assert sum(2 <= leading(cells[3]) < 2.02 for cells in drives) == 4
    assert "three of the 27 would vibrate, and the four YAMs stand at their limit" in text
    assert f"No file of the {len(ROWS)} public sets" in text
