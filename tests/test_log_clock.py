"""Ticks from time stamps that jitter, with rows missing and without, against the ticks that the rows were made at."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from gainroom.files.logs import read_joint, read_log
from gainroom.files.logs.clock import tick_of, ticks_of
from gainroom.identification import identify_delay, identify_joint
from gainroom.report.log_text import remarks
from identified import holds

TICK, TRUE = 1e-3, {"motor_inertia": 0.35, "link_inertia": 1.2, "stiffness": 1.6e4, "delay": 3.37e-3}


def stamped(seed: int, jitter: float, missing: float, count: int = 8000) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the rows' ticks, and their stamps [s]."""
    rng = np.random.default_rng(seed)
    numbers = np.flatnonzero(rng.random(count) >= missing)
    return numbers, TICK * (numbers + jitter * rng.standard_normal(count)[numbers])


@pytest.mark.parametrize("missing", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("jitter", [0.0, 0.02, 0.1, 0.15])
def test_each_row_is_found_at_its_tick(jitter, missing):
    """Jitter of 0.15 ticks once made 80 gaps where no row is missing, and a tick of 0.9944 ms."""
    for seed in range(4):
        numbers, stamps = stamped(seed, jitter, missing)
        tick = tick_of(stamps)
        assert abs(tick / TICK - 1) < 1e-5  # the slope's standard error: jitter · √12/8000^1.5 = 7e-7
        found = ticks_of(stamps, tick)
        assert found.even
        # Beside a gap, a stamp that is half a tick off may be of either side; elsewhere it is not.
        assert np.mean(found.numbers != numbers - numbers[0]) < 1e-3
        assert found.numbers[-1] == numbers[-1] - numbers[0]


def test_a_clock_that_drifts_and_one_that_begins_anew():
    """100 ppm faster at the end than at the start, 8 ticks in all; and half a tick behind a pause of 2 s."""
    rng, count = np.random.default_rng(1), 80_000
    drifting = TICK * np.cumsum(1 + 1e-4 * np.arange(count) / count * 2) + TICK * 0.1 * rng.standard_normal(count)
    assert np.array_equal(ticks_of(drifting, tick_of(drifting)).numbers, np.arange(count))
    paused = TICK * np.concatenate([np.arange(4000), np.arange(4000) + 6000.5])
    numbers = ticks_of(paused, tick_of(paused)).numbers
    assert np.all(np.diff(numbers)[:3999] == 1)
    assert np.all(np.diff(numbers)[4000:] == 1)
    assert 2000 <= numbers[4000] - numbers[3999] <= 2002


def test_stamps_in_whole_milliseconds_of_another_tick():
    """2 and 3 ms by turns: a tick of 2.5 ms, and no gap."""
    stamps = np.round(2.5 * np.arange(4000)) * 1e-3
    assert tick_of(stamps) == pytest.approx(2.5e-3, rel=1e-6)
    assert np.array_equal(ticks_of(stamps, 2.5e-3).numbers, np.arange(4000))


def test_a_log_says_where_its_clock_is_not_certain(tmp_path: Path):
    for jitter, missing, said in ((0.15, 0.0, False), (0.15, 0.03, False), (0.22, 0.03, True), (0.3, 0.0, True)):
        _, stamps = stamped(3, jitter, missing)
        np.savetxt(tmp_path / "log.csv", np.column_stack([stamps, stamps]), delimiter=",", header="time,q", comments="", fmt="%.9g")
        log = read_log(tmp_path / "log.csv")
        assert any("--rate-hz" in remark for remark in remarks(log)) == said
        if not said:
            assert log.quality.sample_time == pytest.approx(TICK, rel=5e-5)
            assert log.quality.dropped == pytest.approx(8000 * missing, abs=40)
        if not missing and not said:
            assert log.quality.gaps == 0


def simulated(seed: int, jitter: float, missing: float, path: Path) -> None:
    """8 s of a two-mass joint with viscous friction, exactly from tick to tick, 3.37 ms late behind a current loop of 900 rad/s."""
    rng, count, late = np.random.default_rng(seed), 8000, 0.37 * TICK
    system, push = np.zeros((6, 6)), np.zeros((6, 1))
    motor, link, stiffness, damping, viscous, bandwidth, ratio = 0.35, 1.2, 1.6e4, 4.0, 1.0, 900.0, 0.7
    system[0, 2] = system[1, 3] = system[4, 5] = 1
    system[2] = [-stiffness / motor, stiffness / motor, -(damping + viscous) / motor, damping / motor, 1 / motor, 0]
    system[3] = [stiffness / link, -stiffness / link, damping / link, -damping / link, 0, 0]
    system[5, 4:], push[5] = [-(bandwidth**2), -2 * ratio * bandwidth], bandwidth**2
    moves = [expm(np.block([[system, push], [np.zeros((1, 7))]]) * time) for time in (late, TICK - late)]
    time, lines = TICK * np.arange(count), np.geomspace(3, 180, 70)
    target = np.cos(2 * np.pi * np.outer(time, lines) + rng.uniform(0, 2 * np.pi, 70)).sum(axis=1)
    target *= 15 / target.std() * np.clip(time / 0.2, 0, 1)
    state, states = np.zeros(6), np.zeros((count, 6))
    for k in range(count):
        states[k] = state
        for move, row in zip(moves, (k - 4, k - 3), strict=True):
            state = move[:6, :6] @ state + move[:6, 6] * (target[row] if row >= 0 else 0.0)
    step = 2 * np.pi / 2**17
    position = step * np.round((states[:, 0] + 5e-6 * rng.standard_normal(count)) / step)
    columns = [time + TICK * jitter * rng.standard_normal(count), target, states[:, 4] + 0.3 * rng.standard_normal(count), position]
    kept = rng.random(count) >= missing
    header = "time,target_torque,actual_torque,motor_position"
    np.savetxt(path, np.column_stack(columns)[kept], delimiter=",", header=header, comments="", fmt="%.9g")


def held(path: Path) -> dict[str, bool]:
    """Which 95 % intervals of joint and delay contain the truth."""
    record = read_joint(path).record
    fit, delay = identify_joint(record), identify_delay(record)
    return {name: holds(fit.parameters[name], value) for name, value in TRUE.items() if name != "delay"} | {
        "delay": holds(delay.delay, TRUE["delay"])
    }


@pytest.mark.slow
def test_a_joint_is_found_from_stamps_that_jitter(tmp_path: Path):
    """0.15 ticks, no row missing: 80 ticks were said to be missing, and one interval of six held."""
    simulated(0, 0.15, 0.0, tmp_path / "log.csv")
    logged = read_joint(tmp_path / "log.csv")
    assert logged.log.quality.gaps == 0
    assert logged.record.sample_time == pytest.approx(TICK, rel=2e-5)
    assert all(held(tmp_path / "log.csv").values())


@pytest.mark.population
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("jitter", "missing"), [(0.0, 0.0), (0.15, 0.0), (0.0, 0.03), (0.15, 0.03)])
def test_intervals_hold_with_jitter_and_missing_rows(jitter, missing, tmp_path, capsys):
    """Of 12 logs with four intervals each, at least 42 hold: by chance one in two thousand would have fewer."""
    inside = []
    for seed in range(12):
        simulated(seed, jitter, missing, tmp_path / "log.csv")
        inside.append(list(held(tmp_path / "log.csv").values()))
    with capsys.disabled():
        print(f"\njitter {jitter}, {missing:.0%} missing: of 12 hold {dict(zip(TRUE, np.sum(inside, axis=0).tolist(), strict=True))}")
    assert np.sum(inside) >= 42
