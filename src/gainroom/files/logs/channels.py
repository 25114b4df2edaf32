"""The channels of a log: `time` and identification's SIGNALS, in which unit, and what others call each."""

from collections.abc import Mapping
from dataclasses import dataclass

from ...simulation.run_record import REFERENCE_SIGNAL

ONE_JOINT = "joint"
"""The name of the joint of a log that names none."""


@dataclass(frozen=True)
class Channel:
    """One quantity, joint side, SI.

    dimension    of its unit: a key of UNITS in units.py
    names        what other software calls it, as lower-case words, the surest first; without a joint's name and without a unit
    largest      where half of the rows are beyond, they are in another unit, or damaged [SI]
    commanded    True: holds from one command to the next; False: measured, and goes on in between
    """

    name: str
    dimension: str
    names: tuple[str, ...]
    largest: float
    commanded: bool = False


def words(text: str) -> tuple[str, ...]:
    """As a list of them."""
    return tuple(text.split())


_ANGLE, _SPEED, _TORQUE, _CURRENT = 1e5, 1e6, 1e9, 1e6
"""[rad, rad/s, N m, A] A wheel that turns at 20 rad/s for an hour is at 0.7e5 rad; a simulation that diverges asks for 1e7 N m."""

_ALL = (
    Channel("time", "time", words("time timestamp time_stamp stamp t tout seconds secs elapsed clock"), 1e12),
    Channel(
        "target_torque",
        "torque",
        words(
            """torque_target tau_target desired_torque torque_desired torque_des tau_desired tau_des commanded_torque command_torque
            torque_command torque_cmd cmd_torque tau_cmd reference_torque torque_reference torque_ref tau_ref torque_setpoint desired_effort
            effort_desired effort_command effort_cmd command_effort output_effort pd_torque control_torque tau_d cmd command ctrl u"""
        ),
        _TORQUE,
        commanded=True,
    ),
    Channel("demand_torque", "torque", words("torque_demand demanded_torque tau_demand drive_torque"), _TORQUE, commanded=True),
    Channel(
        "actual_torque",
        "torque",
        words(
            """torque_actual measured_torque torque_measured torque_meas tau_measured tau_meas tau_actual tau_act torque_feedback
            estimated_torque torque_estimated torque_est tau_est applied_torque torque_applied motor_torque net_torque tau_m effort torque
            tau"""
        ),
        _TORQUE,
    ),
    Channel("joint_torque", "torque", words("torque_sensor sensor_torque link_torque output_torque load_torque tau_j"), _TORQUE),
    Channel(
        "motor_position",
        "angle",
        words(
            """motor_pos motor_angle position_motor rotor_position theta_m q_motor q_m joint_position joint_pos actual_position
            position_actual actual_pos measured_position position_measured measured_pos feedback_position present_position dof_pos
            dof_position joint_angle encoder theta position pos angle q"""
        ),
        _ANGLE,
    ),
    Channel(
        "link_position",
        "angle",
        words("link_pos link_angle position_link load_position output_position output_encoder load_encoder q_link q_l"),
        _ANGLE,
    ),
    Channel(
        REFERENCE_SIGNAL,
        "angle",
        words(
            """reference_position position_reference goal_position desired_position position_desired target_position position_target
            commanded_position command_position position_command position_cmd cmd_position position_setpoint pos_cmd cmd_pos pos_des des_pos
            pos_ref pos_target target_pos des_dof_pos dof_pos_target target_dof_pos joint_pos_target q_desired q_target q_des q_ref q_cmd
            q_d setpoint set_point goal"""
        ),
        _ANGLE,
        commanded=True,
    ),
    Channel(
        "motor_velocity",
        "speed",
        words(
            """motor_vel motor_speed joint_velocity joint_vel actual_velocity velocity_actual measured_velocity velocity_measured
            feedback_velocity present_velocity dof_vel dof_velocity theta_dot q_dot qdot dq qd velocity vel speed omega"""
        ),
        _SPEED,
    ),
    Channel("link_velocity", "speed", words("link_vel link_speed load_velocity output_velocity velocity_link dq_link"), _SPEED),
    Channel(
        "reference_velocity",
        "speed",
        words(
            """velocity_reference goal_velocity desired_velocity velocity_desired target_velocity velocity_target commanded_velocity
            command_velocity velocity_command velocity_cmd cmd_velocity vel_cmd vel_des vel_ref dq_des dq_ref dq_cmd dq_d qd_des
            dof_vel_target"""
        ),
        _SPEED,
        commanded=True,
    ),
    Channel(
        "current",
        "current",
        words("motor_current actual_current current_actual measured_current current_measured present_current iq_measured i_q iq amps"),
        _CURRENT,
    ),
)
CHANNELS: Mapping[str, Channel] = {channel.name: channel for channel in _ALL}
"""By name, in the order of a log's columns."""
