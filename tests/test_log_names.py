"""Names of columns as they stand together in a file: all words count, a command and a measurement are one joint's, the rest is asked."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from gainroom.files.logs import LogOptions, LogReader, log_reader
from gainroom.files.logs.options import assignments
from refusals import assert_refused


def header_of(path: Path, header: str, rows: int = 40) -> Path:
    """A log with these columns: the first is time, the others are numbers of their own."""
    count = header.count(",") + 1
    table = np.column_stack([1e-3 * np.arange(rows), *(k + 0.01 * np.arange(rows) for k in range(1, count))])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def found(reader: LogReader) -> dict[str, str]:
    """By column: the channel, behind its joint where there is a name."""
    return {
        origin.column: origin.channel if origin.joint in ("", "joint") else f"{origin.joint}:{origin.channel}" for origin in reader.origins
    }


SCHEMES: dict[str, dict[str, str]] = {
    # What a column is by the documentation of whoever writes it; "" where it is no channel, or only the user can say.
    "libfranka": {
        "time": "time",
        "q[0]": "0:motor_position",
        "q_d[0]": "0:reference",
        "dq[0]": "0:motor_velocity",
        "dq_d[0]": "0:reference_velocity",
        "tau_J[0]": "0:joint_torque",
        "tau_J_d[0]": "0:target_torque",
        "dtau_J[0]": "",
        "tau_ext_hat_filtered[0]": "",
        "ddq_d[0]": "",
    },
    "franka friction": {
        "time": "time",
        "q3": "3:motor_position",
        "dq3": "3:motor_velocity",
        "q3_tau_J": "3:joint_torque",
        "q3_tau_J_compensate": "",
    },
    "isaac": {
        "time": "time",
        "joint_pos": "motor_position",
        "joint_pos_target": "reference",
        "joint_vel": "motor_velocity",
        "computed_torque": "target_torque",
        "applied_torque": "actual_torque",
        "default_joint_pos": "",
        "joint_acc": "",
    },
    "moteus": {
        "timestamp": "time",
        "position": "motor_position",
        "velocity": "motor_velocity",
        "torque": "actual_torque",
        "control_position": "reference",
        "control_velocity": "reference_velocity",
        "control_torque": "target_torque",
        "position_error": "",
    },
    "odrive": {
        "t": "time",
        "axis0.controller.input_pos": "",
        "axis0.controller.pos_setpoint": "axis0:reference",
        "axis0.controller.torque_setpoint": "axis0:target_torque",
        "axis0.encoder.pos_estimate": "axis0:motor_position",
        "axis0.encoder.vel_estimate": "axis0:motor_velocity",
        "axis0.motor.current_control.Iq_measured": "axis0:current",
        "axis0.motor.current_control.Iq_setpoint": "",
    },
    "series elastic": {
        "t": "time",
        "theta_m": "motor_position",
        "theta_l": "link_position",
        "tau_cmd": "target_torque",
        "tau_meas": "actual_torque",
    },
    "ethercat": {
        "Time": "time",
        "Position actual value": "motor_position",
        "Target position": "reference",
        "Position demand value": "",
        "Torque actual value": "actual_torque",
        "Target torque": "target_torque",
        "Velocity actual value": "motor_velocity",
        "Following error actual value": "",
    },
    "damiao": {
        "t": "time",
        "p_des": "reference",
        "v_des": "reference_velocity",
        "t_ff": "",
        "p_fb": "motor_position",
        "v_fb": "motor_velocity",
        "t_fb": "actual_torque",
    },
    "ros2_control": {
        "time": "time",
        "knee/position/actual": "knee:motor_position",
        "knee/position/desired": "knee:reference",
        "knee/effort/actual": "knee:actual_torque",
        "knee/effort/desired": "knee:target_torque",
    },
    "set-points": {
        "time_ms": "time",
        "setpoint_deg": "reference",
        "angle_deg": "motor_position",
        "torque_Nm": "actual_torque",
        "torque_setpoint_Nm": "target_torque",
    },
    # relatives of the same kinds
    "plural": {"timestamps": "time", "positions": "motor_position", "velocities": "motor_velocity", "efforts": "actual_torque"},
    "both sides": {"t": "time", "motor_angle": "motor_position", "joint_angle": "link_position", "joint_velocity": "link_velocity"},
    "coordinates": {
        "t": "time",
        "theta[0]": "0:motor_position",
        "q[0]": "0:link_position",
        "dq[0]": "0:link_velocity",
        "tau_J_d[0]": "0:target_torque",
    },
    "left and right": {
        "t": "time",
        "pos_l": "l:motor_position",
        "pos_r": "r:motor_position",
        "vel_l": "l:motor_velocity",
        "vel_r": "r:motor_velocity",
    },
    "own names, commanded": {
        "time": "time",
        "motor_position": "motor_position",
        "motor_position_target": "reference",
        "actual_torque": "actual_torque",
        "reference_torque": "target_torque",
        "link_position_error": "",
    },
    "the current position": {"t": "time", "current_position": "motor_position", "goal_position": "reference", "motor_current": "current"},
    "camel case": {
        "t": "time",
        "motorState[2].tauEst": "motor[2]:actual_torque",
        "motorState[2].q": "motor[2]:motor_position",
        "motorCmd[2].q": "motor[2]:reference",
    },
    "sides in the path": {"t": "time", "knee/motor/position": "knee:motor_position", "knee/link/position": "knee:link_position"},
    "units within": {"t_s": "time", "angle_deg_ref": "reference", "angle_deg": "motor_position", "torque_Nm_cmd": "target_torque"},
    "words between": {
        "t": "time",
        "measured_joint_torque_raw": "joint_torque",
        "desired_motor_torque": "target_torque",
        "q": "motor_position",
    },
    "a strange word": {"t": "time", "position": "motor_position", "torque": "actual_torque", "gizmo_position": "", "gizmo_torque": ""},
    "torques that are none": {
        "t": "time",
        "q": "motor_position",
        "tau": "actual_torque",
        "tau_friction": "",
        "gravity_torque": "",
        "tau_ext": "",
        "tau_spring": "",
    },
    "one with a name": {"t": "time", "knee_pos": "knee:motor_position", "velocity": "knee:motor_velocity", "torque": "knee:actual_torque"},
    "written as one": {
        "utime": "time",
        "qdes": "reference",
        "qact": "motor_position",
        "taucmd": "target_torque",
        "motorvel": "motor_velocity",
    },
    "estimated": {"time_from_start": "time", "theta_hat": "motor_position", "tau_hat": "actual_torque", "theta_ref": "reference"},
    "a speed that is no joint's": {"time": "time", "q1": "1:motor_position", "qd1": "1:motor_velocity", "omega_x": ""},
    "units behind a stroke": {"t/s": "time", "q/rad": "motor_position", "tau_soll/Nm": "target_torque", "tau_ist/Nm": "actual_torque"},
    "numbered twice": {
        "t": "time",
        "q1": "1:motor_position",
        "q2": "2:motor_position",
        "joint1_tau": "1:actual_torque",
        "joint2_tau": "2:actual_torque",
    },
}


@pytest.mark.parametrize("name", SCHEMES)
def test_naming_schemes(name: str, tmp_path: Path):
    """Every column is what it should be; every column that no channel has is named somewhere."""
    scheme = SCHEMES[name]
    path = header_of(tmp_path / "log.csv", ",".join(scheme))
    with log_reader(path) as reader:
        assert found(reader) == {column: what for column, what in scheme.items() if what}
        assert set(reader.unused) == {column for column, what in scheme.items() if not what}
        said = " ".join(reader.notes)
        assert [column for column, what in scheme.items() if not what and column not in said] == []


ASKED = {
    "t,q,dq,u": ("u", "target_torque=u", "reference=u"),
    "t,pos_m,vel,tau": ("pos_m", "metres", "motor_position=pos_m"),
    "t,q,tau_ff": ("tau_ff", "kp and kd are 0", "target_torque=tau_ff"),
    "t,q,target_torque_measured": ("target_torque_measured", "says both"),
    "t,servo_stats.position,servo_control.torque_Nm": ("servo_control.torque_Nm", "target_torque=servo_control.torque_Nm"),
    "t,motor_state[0].q,motor_cmd[0].tau,motor_cmd[0].kp": ("motor_cmd[0].tau", "kp and kd are 0"),
    "t,knee_pos,knee_tau_odd,knee_vel": ("knee_tau_odd", "'odd'"),
    "t,hip_pos,hip_vel,hip_tau,hip_left_pos": ("hip_left_pos", "joint of its own"),
    "t,q,tau,reference_encoder": ("reference_encoder", "says both"),
    "t,input_torque,output_torque,q": ("input_torque", "gearbox's", "target_torque=input_torque", "actual_torque=input_torque"),
    "t,motor_pos,output_pos": ("output_pos", "measured there", "link_position=output_pos"),
    "t,motor_pos,q": ("q", "link_position=q"),
}


@pytest.mark.parametrize("header", ASKED)
def test_what_a_name_leaves_open_is_asked(header: str, tmp_path: Path):
    column, *words = ASKED[header]
    with log_reader(header_of(tmp_path / "log.csv", header)) as reader:
        assert column not in found(reader)
        assert any(column in note and all(word in note for word in words) for note in reader.notes), reader.notes


@pytest.mark.parametrize("header", ASKED)
def test_what_is_asked_can_be_typed(header: str, tmp_path: Path):
    """The options of the note, each typed: the column is then used, as that channel."""
    column, path = ASKED[header][0], header_of(tmp_path / "log.csv", header)
    with log_reader(path) as reader:
        (note,) = (note for note in reader.notes if column in note)
    typed = [shlex.split(text)[0] for text in re.findall(r"--columns ('[^']*'|[^ );]+)", note)]
    assert typed
    for each in typed:
        with log_reader(path, LogOptions(columns=assignments([each], "columns"))) as reader:
            assert found(reader)[column].endswith(each.partition("=")[0].partition(".")[0])


def test_nothing_but_what_is_asked_is_an_error(tmp_path: Path):
    assert_refused(lambda: read(header_of(tmp_path / "log.csv", "t,u,foo")), ["log.csv", "t, u, foo"])


def read(path: Path) -> None:
    with log_reader(path):
        pass
