"""Rows of a sensor that cannot be: found wherever they are and however large, reported and left out; what a joint does is none."""

import json
from pathlib import Path

import numpy as np
import pytest

from gainroom.identification.outliers import without_outliers
from gainroom.identification.record import Record
from gainroom.studies.diagnosis import diagnose
from test_diagnose import run

TICK = 1e-3
TIME = TICK * np.arange(4000)
STEP = 2e-5
SWING = STEP * np.round((0.05 + 7e-4 * np.sin(2 * np.pi * 90.6 * TIME)) / STEP)
"""A vibration of 0.7 mrad at 90.6 Hz, in steps of the encoder."""


def record(position: np.ndarray, **more: np.ndarray) -> Record:
    return Record(TICK * np.arange(len(position)), {"motor_position": position, **more}, TICK)


def replaced(rows: list[int], values: float | list[float], of: np.ndarray = SWING) -> np.ndarray:
    position = of.copy()
    position[rows] = values
    return position


@pytest.mark.parametrize(
    ("rows", "value"),
    [
        ([2500], 2 * np.pi + 0.05),  # a turn of the encoder
        ([2500], 0.0),  # a word that was lost
        ([2500, 2501, 2502], -1.0),  # for three rows
        ([2500, 2501], [3.0, -2.0]),
        ([2496, 2500, 2503], 0.06),  # near each other, by 14 amplitudes
        ([0], 0.0),
        ([0, 1], 1.0),
        ([3999], -4.0),
        ([10, 1200, 3990], 1e4),
        ([2500], 1e6),
        ([2500], 65535.0),
    ],
)
def test_outliers_are_found_and_the_vibration_beside_them(rows: list[int], value: float | list[float]):
    """As without them: a row between two others is off by at most the amplitude, one of thousands."""
    log = record(replaced(rows, value), reference=np.full(4000, 0.05))
    cleaned, found = without_outliers(log)
    assert np.flatnonzero(found.rows).tolist() == rows
    assert found.channels == {"motor_position": len(rows)}
    assert np.abs(cleaned.channels["motor_position"] - SWING).max() <= 2 * 7e-4 + STEP  # what lies between two rows of a swing
    seen = diagnose(log)
    assert seen.outliers.count == len(rows)
    assert seen.vibrates
    assert seen.oscillation is not None
    assert seen.oscillation.vibration.frequency == pytest.approx(2 * np.pi * 90.6, rel=1e-3)
    assert seen.oscillation.vibration.amplitude == pytest.approx(7e-4, rel=0.05)


@pytest.mark.parametrize("channel", ["motor_velocity", "actual_torque", "link_position"])
def test_every_sensor_has_them(channel: str):
    rng = np.random.default_rng(3)
    values = np.sin(2 * np.pi * 20 * TIME) + 0.01 * rng.standard_normal(4000)
    for rows, value in (([777], 40.0), ([1500, 1501], -65.0)):
        _, found = without_outliers(record(SWING, **{channel: replaced(rows, value, values)}))
        assert found.channels == {channel: len(rows)}
        assert np.flatnonzero(found.rows).tolist() == rows


def test_what_a_joint_does_is_no_outlier():
    rng = np.random.default_rng(1)
    steps = np.where(TIME < 2, 0.0, 0.4)
    fast = 1e-3 * np.cos(np.pi * 0.98 * np.arange(4000))  # nearly from row to row
    rare = STEP * (rng.random(4000) < 0.01)  # between two steps of the encoder
    burst = 0.01 * np.exp(-(((TIME - 2) / 0.004) ** 2)) * np.sin(2 * np.pi * 300 * TIME)
    cases = {"step": steps, "corner": np.abs(TIME - 2), "fast": fast, "rare": rare, "burst": burst, "noise": rng.standard_normal(4000)}
    for name, position in cases.items():
        assert without_outliers(record(position))[1].count == 0, name
    grows = np.exp(20 * TIME[:1000]) * np.sin(2 * np.pi * 200 * TIME[:1000])
    assert without_outliers(record(grows))[1].count == 0


def test_a_pulse_of_the_command_makes_one_of_the_torque():
    """As where an encoder's step is differenced; beside a command at rest the same pulse is an outlier."""
    pulse = np.where(np.arange(4000) % 500 == 250, 7.0, 0.0)
    measured = pulse + 0.01 * np.random.default_rng(2).standard_normal(4000)
    assert without_outliers(record(SWING, actual_torque=measured, target_torque=pulse))[1].count == 0
    calm = 0.01 * np.random.default_rng(2).standard_normal(4000)
    _, found = without_outliers(record(SWING, actual_torque=replaced([90], 7.0, calm), target_torque=0.01 * np.sin(9 * TIME)))
    assert found.channels == {"actual_torque": 1}


def test_many_are_what_a_sensor_is_like():
    position = replaced(list(range(20, 3980, 40)), 1.0)  # 2.5 % of the rows
    assert without_outliers(record(position))[1].count == 0


def test_the_command_reports_them(tmp_path: Path):
    """Vibrates (1) as without the row, and says which row it was; in JSON too, and so does every command on logs."""
    np.savetxt(
        tmp_path / "log.csv",
        np.column_stack([TIME, replaced([2500], 6.33), np.full(4000, 0.05)]),
        delimiter=",",
        header="time,motor_position,reference",
        comments="",
    )
    status, out, err = run("diagnose", tmp_path / "log.csv")
    assert status == 1
    assert out.startswith("Not safe: vibrates at 90.6 Hz")
    assert "1 row was left out" in (out + err).replace("\n", " ")
    facts = json.loads(run("diagnose", tmp_path / "log.csv", "--json")[1])
    assert facts["log"]["outliers"] == 1
    assert any("motor_position" in text and "2.5 s" in text for text in facts["warnings"])


def test_a_row_of_nonsense_in_a_command_hides_no_vibration():
    """Target and actual torque are spoilt in the same row, as by a lost frame: 100 times as large as ever."""
    torque = -20 * np.sin(2 * np.pi * 90.6 * TIME)
    log = {"target_torque": replaced([1234], 1800.0, torque), "actual_torque": replaced([1234], -900.0, torque)}
    found = diagnose(record(SWING, reference=np.full(4000, 0.05), **log))
    assert found.vibrates
    assert np.flatnonzero(found.outliers.rows).tolist() == [1234]
    pulses = np.where(np.arange(4000) % 400 == 100, 5.0, 0.0)  # an excitation
    assert without_outliers(record(SWING, target_torque=pulses), commands=True)[1].count == 0
    kick = np.where(np.arange(4000) == 300, 3000.0, torque)  # of a differenced error, where the set-point steps
    stepped = record(SWING, reference=np.where(np.arange(4000) < 300, 0.0, 0.05), target_torque=kick)
    assert without_outliers(stepped, commands=True)[1].count == 0


@pytest.mark.parametrize("last", [2508, 4000])
def test_turns_of_an_encoder_are_taken_off(last: int):
    """For some rows, or from there on; the set-point may be counted likewise. A step of the set-point by a turn stays."""
    shifted = SWING + np.where((np.arange(4000) >= 2500) & (np.arange(4000) < last), 2 * np.pi, 0.0)
    for reference in (np.full(4000, 0.05), 0.05 + np.where((np.arange(4000) >= 2495) & (np.arange(4000) < last), 2 * np.pi, 0.0)):
        log = record(shifted, reference=reference)
        cleaned, found = without_outliers(log)
        assert found.turned[0] == "motor_position"
        assert np.abs(cleaned.channels["motor_position"] - SWING).max() < 1e-9
        assert diagnose(log).vibrates
    smooth = 2 * np.pi / (1 + np.exp(-(TIME - 2) / 0.01))
    assert without_outliers(record(smooth, reference=np.where(TIME < 2, 0.0, 2 * np.pi)))[1].turned == ()
