"""Which column is what: by its name, as stated in flags or in a file; units; what is wrong in one line."""

from pathlib import Path

import numpy as np
import pytest

from gainroom.files.logs import LogOptions, load_options, read_log
from gainroom.files.logs.guessing import channel_of
from gainroom.files.logs.units import UNITS, factor
from refusals import assert_refused

NAMES = {
    "target_torque": ("target_torque", "", ""),
    "motor_position_l_knee": ("motor_position", "l_knee", ""),
    "reference_velocity": ("reference_velocity", "", ""),
    "motor_position_left_foot_max": ("motor_position", "left_foot_max", ""),  # named as this package does: any joint
    "Time [ms]": ("time", "", "ms"),
    "timestamp_us": ("time", "", "us"),
    "t": ("time", "", ""),
    "q_3": ("motor_position", "3", ""),
    "q3": ("motor_position", "3", ""),
    "dq[2]": ("motor_velocity", "2", ""),
    "tau_des_hip": ("target_torque", "hip", ""),
    "hip/tau_des": ("target_torque", "hip", ""),
    "log.hip.q": ("motor_position", "hip", ""),
    "dofPos": ("motor_position", "", ""),
    "des_dof_pos": ("reference", "", ""),
    "goal_position": ("reference", "", ""),
    "velocity_rad_s": ("motor_velocity", "", "rad/s"),
    "elbow_pos_deg": ("motor_position", "elbow", "deg"),
    "Torque (N m)": ("actual_torque", "", "N m"),
    "iq": ("current", "", ""),
    "joint_torque_elbow": ("joint_torque", "elbow", ""),
    "motor_position_target": ("reference", "", ""),
    "knee_target_angle": ("reference", "knee", ""),
    "joint_states/position": ("motor_position", "", ""),
    "joint_commands/effort": ("target_torque", "", ""),
    "desired/knee/effort": ("target_torque", "knee", ""),
    "setpoint/velocity": ("reference_velocity", "", ""),
    "low_cmd/motor_cmd[3].tau": ("target_torque", "motor[3]", ""),
    "low_state/motor_state[3].tau_est": ("actual_torque", "motor[3]", ""),
    "target_controller/state/position": ("motor_position", "", ""),  # the nearest part says what it is
    "effort_controller/commands": ("target_torque", "", ""),
    "knee/time": ("time", "knee", ""),
    "log.knee.t": ("time", "knee", ""),
}
NOTHING = (
    "torque_enable",
    "max_torque",
    "temperature",
    "position_error",
    "base_pos_x",
    "time_step",
    "kp",
    "",
    "[]",
    "q_max",
    "iq_ref",
    "cpu_time",
)


@pytest.mark.parametrize("name", NAMES)
def test_names(name: str):
    guess = channel_of(name)
    assert guess is not None
    assert (guess.channel, guess.joint, guess.unit) == NAMES[name]


@pytest.mark.parametrize("name", NOTHING)
def test_names_that_say_nothing(name: str):
    assert channel_of(name) is None


def test_units():
    """Against their definitions; every unit by its own name, in another spelling, as a bare factor, turned round."""
    assert factor("deg", "angle", "x") == pytest.approx(np.radians(1.0), rel=1e-15)
    assert factor("rpm", "speed", "x") == pytest.approx(2 * np.pi / 60, rel=1e-15)
    assert factor("rev/s", "speed", "x") == pytest.approx(2 * np.pi, rel=1e-15)
    assert factor("ticks/4096", "angle", "x") == pytest.approx(2 * np.pi / 4096, rel=1e-15)
    assert factor("ticks/4096/s", "speed", "x") == pytest.approx(2 * np.pi / 4096, rel=1e-15)
    assert (factor("N·m", "torque", "x"), factor("Nmm", "torque", "x"), factor("NM", "torque", "x")) == (1.0, 1e-3, 1.0)
    assert (factor("0.11", "torque", "x"), factor("-0.11", "torque", "x"), factor("-deg", "angle", "x")) == (0.11, -0.11, -np.pi / 180)
    assert [factor(unit, "time", "x") for unit in ("s", "ms", "µs", "ns", "seconds")] == [1.0, 1e-3, 1e-6, 1e-9, 1.0]
    for dimension, units in UNITS.items():
        assert {unit: factor(unit, dimension, "x") for unit in units} == units


@pytest.mark.parametrize("text", ["", "furlong", "ticks", "ticks/0", "ticks/x", "nan", "inf", "0", "-", "1e300", "Nm", "ticks/4096/s"])
def test_units_that_are_none(text: str):
    assert_refused(lambda: factor(text, "angle", "here"), ["here: unit", "rad", "ticks/4096"])


def write(path: Path, header: str, rows: int = 50) -> Path:
    count = header.count(",") + 1
    table = np.column_stack([1e-3 * np.arange(rows), *(k + np.arange(rows) for k in range(1, count))])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def test_what_is_stated_overrules_what_is_guessed(tmp_path: Path):
    path = write(tmp_path / "log.csv", "clock,target_torque,cmd,enc,dq")
    options = LogOptions(
        columns={"target_torque": "cmd", "motor_position": "enc", "time": "clock"},
        units={"motor_position": "ticks/4096", "target_torque": "-Nmm"},
        rotor_side=("motor_position", "target_torque"),
        gear_ratio=50.0,
    )
    log = read_log(path, options=options)
    joint, rows = log.joint(), np.arange(50)
    assert set(joint.channels) == {"target_torque", "motor_position", "motor_velocity"}
    assert joint.channels["target_torque"] == pytest.approx(-1e-3 * 50 * (2 + rows), rel=1e-14)
    assert joint.channels["motor_position"] == pytest.approx(2 * np.pi / 4096 / 50 * (3 + rows), rel=1e-14)
    known = {origin.channel: (origin.column_from, origin.unit_from) for origin in log.origins}
    assert known == {
        "time": ("given", "assumed"),
        "target_torque": ("given", "given"),
        "motor_position": ("given", "given"),
        "motor_velocity": ("name", "assumed"),
    }


def test_columns_by_joint(tmp_path: Path):
    path = write(tmp_path / "log.csv", "t,enc_hip,enc_knee,x1,x2")
    log = read_log(path, {"link_position": "enc_{joint}", "joint_torque.hip": "x1", "joint_torque.knee": "x2"})
    assert [(joint, *channels) for joint, channels in log.joints.items()] == [
        (joint, "joint_torque", "link_position") for joint in ("hip", "knee")
    ]
    assert log.joints["knee"]["joint_torque"][0] == 4
    assert read_log(path, {"link_position": "enc_{joint}"}, LogOptions(joints=("kn.*",))).joint_names == ("knee",)


def test_a_file_that_says_how_to_read(tmp_path: Path):
    (tmp_path / "how.yaml").write_text(
        "columns: {target_torque: cmd, motor_position: 3}\nunits: {time: us, motor_position: deg}\nrotor_side: [motor_position]\n"
        "gear_ratio: 100\nsample_rate_hz: 2000\nstart: 0.5\nend: 2\njoints: [hip, 'l_.*']\n",
        "utf-8",
    )
    assert LogOptions(**load_options(tmp_path / "how.yaml")) == LogOptions(
        {"target_torque": "cmd", "motor_position": "3"},
        {"time": "us", "motor_position": "deg"},
        ("motor_position",),
        100.0,
        2000.0,
        0.5,
        2.0,
        ("hip", "l_.*"),
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("columns: {torque: cmd}", ["columns", "'torque'", "target_torque"]),
        ("columns: [cmd]", ["columns", "section"]),
        ("columns: {time: [1]}", ["columns.time", "name"]),
        ("units: {motor_position: furlong}", ["units: motor_position", "furlong", "deg"]),
        ("unit: {time: us}", ["unit", "units"]),
        ("gear_ratio: 0", ["gear_ratio", "> 0"]),
        ("rotor_side: [motor_position]", ["rotor_side", "gear_ratio"]),
        ("rotor_side: [time]\ngear_ratio: 2", ["rotor_side", "time"]),
        ("start: 3\nend: 2", ["end 2 s", "start 3 s"]),
        ("joints: ['(']", ["joints", "'('"]),
        ("sample_rate_hz: 1e9", ["sample_rate_hz", "1e+06"]),
        ("columns: &a {}", ["anchors"]),
    ],
)
def test_a_file_that_says_it_wrongly(text: str, words: list[str], tmp_path: Path):
    (tmp_path / "how.yaml").write_text(text, "utf-8")
    assert_refused(lambda: load_options(tmp_path / "how.yaml"), ["how.yaml", *words])


@pytest.mark.parametrize(
    ("columns", "options", "words"),
    [
        ({"time": "nowhere"}, {}, ["no column", "nowhere", "for time", "t, q"]),
        ({"actual_torque": "{joint}_tau"}, {}, ["{joint}_tau"]),
        ({}, {"joints": ("arm",)}, ["arm", "it has joint"]),
        ({}, {"start": 100.0}, ["no row", "100"]),
    ],
)
def test_what_is_stated_and_not_there(columns: dict[str, str], options: dict, words: list[str], tmp_path: Path):
    path = write(tmp_path / "log.csv", "t,q,x")
    assert_refused(lambda: read_log(path, columns, LogOptions(**options)), ["log.csv", *words])


def test_units_that_the_file_states_and_nobody_knows(tmp_path: Path):
    (tmp_path / "log.csv").write_text("t;q\ns;furlong\n" + "".join(f"{k}e-3;1\n" for k in range(30)), "utf-8")
    assert_refused(lambda: read_log(tmp_path / "log.csv"), ["log.csv", "'q'", "furlong", "motor_position"])
    log = read_log(tmp_path / "log.csv", options=LogOptions(units={"motor_position": "201.168"}))
    assert log.joint().channels["motor_position"][0] == pytest.approx(201.168)
