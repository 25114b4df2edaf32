"""Vocabulary of column names, in lower case, with the meaning of each word."""

from collections.abc import Mapping


def words(text: str) -> tuple[str, ...]:
    """Words of a text."""
    return tuple(text.split())


QUANTITIES: Mapping[str, tuple[str, ...]] = {
    "time": words("time timestamp time_stamp stamp t tout datetime date_time seconds secs elapsed clock utime"),
    "position": words("position pos angle ang q encoder enc theta qpos jointpos"),
    "velocity": words("velocity vel speed qdot q_dot dq qd dtheta theta_dot qvel thetadot omega jointvel"),
    "torque": words("torque tau effort eff moment trq qfrc jointfrc actuatorfrc force frc"),
    "current": words("current curr iq i_q amps"),
}
"""Spellings of each quantity, the surest first; some words have two parts."""
PLURALS = {
    "positions": "position",
    "angles": "angle",
    "encoders": "encoder",
    "velocities": "velocity",
    "speeds": "speed",
    "efforts": "effort",
    "torques": "torque",
    "moments": "moment",
    "forces": "force",
    "currents": "current",
    "times": "time",
    "timestamps": "timestamp",
    "stamps": "stamp",
    "setpoints": "setpoint",
    "targets": "target",
    "commands": "command",
    "cmds": "cmd",
    "references": "reference",
    "goals": "goal",
    "actions": "action",
    "states": "state",
    "joints": "joint",
    "dofs": "dof",
    "motors": "motor",
    "actuators": "actuator",
    "links": "link",
    "sensors": "sensor",
    "limits": "limit",
    "errors": "error",
    "temperatures": "temperature",
    "gains": "gain",
    "values": "value",
}
COMMANDING = frozenset(
    words(
        """command soll commanded cmd target desired des reference ref setpoint set_point goal demand demanded dem setp sp computed
        output_effort"""
    )
)
"""Words that make a quantity beside them, or below them in a path, a command."""
LOCALLY_COMMANDING = frozenset(words("control controlled input in_cmd trajectory traj planned plan nominal pd policy ctrl"))
"""Words that make a command of a quantity right beside them; in a path they name the owner only."""
MEASURING = frozenset(
    words(
        """state hat ist fdb feedback fb fbk measured meas mes actual act status present estimate estimated est applied sensed real response
        net
        observation"""
    )
)
DEMAND = frozenset(words("demand demanded dem"))
"""Words for a torque that has arrived at the drive."""
FEEDFORWARD = frozenset(words("ff feedforward feed_forward fwd"))
BARE_POSITION = frozenset(words("setpoint set_point goal reference"))
"""Words for commands that are positions unless a quantity is named."""
BARE_COMMAND = frozenset(words("command cmd ctrl u action"))
"""Words for commands of an unnamed quantity."""
MOTOR = frozenset(words("motor rotor mot mtr gear"))
LINK = frozenset(words("link load"))
OUTPUT = frozenset(words("output out"))
"""Words for the gearbox's output, or for a controller's."""
NEUTRAL = frozenset(words("joint j dof actuator axis_angle jnt"))
"""Words for the joint without a side of the gearbox."""
SENSOR = frozenset(words("sensor ts"))
FILLERS = frozenset(words("value data signal raw filtered filt lpf smoothed smooth internal reading now"))
"""Words that do not change the quantity."""
QUALIFIERS = frozenset(words("raw filtered filt lpf smoothed smooth internal"))
"""Fillers that make one of two columns the better one."""
OTHER = frozenset(
    words(
        """enable enabled limit max min error err temperature temp volt volts voltage mode flag flags count counter index id norm std cov
        covariance quat orientation integral offset gain kp kd ki kv stiffness damping inertia step rate delta diff bias foot feet base
        imu gyro acc accel acceleration ddq qdd jerk header sec nanosec nsec start gravity coriolis friction external ext contact
        compensate compensated compensation comp residual disturbance predicted prediction model default soft tcp tool pose cartesian ee
        effector com wrench twist scaling fraction ratio percent factor power energy bus tracking following window speedup root odom
        gripper null pwm duty noise latency delay density acceleration decel deceleration dtau home zero constant ft"""
    )
)
"""Words beside a quantity that make it something else."""
ELSEWHERE = frozenset(
    words(
        """base imu foot feet tcp tool ee effector pose odom root com camera wrench ft error limit covariance gravity friction external
        default"""
    )
)
"""Words in a path for things other than joints."""
CONTAINERS = frozenset(
    words(
        """log logs data robot out logsout yout record recording joint_states signals run ans result controller controllers field msg
        message forward group broadcaster position_controllers effort_controllers velocity_controllers broadcaster lowstate lowcmd low
        interface interfaces observation observations stats servo control trajectory dynamic encoder"""
    )
)
"""Parts of a path, and words in a part, that name no joint."""
TIME_BESIDE = frozenset(
    words(
        """from since start sim simulation ros robot pi system log relative rel monotonic unix epoch utc elapsed time stamp recv rx
        local abs field"""
    )
)
"""Words beside one for time that keep its meaning as the time of the rows."""
SIDES = frozenset(
    words(
        """l r left right fl fr rl rr hl hr lf rf lh rh lr bl br front rear back hind upper lower inner outer roll pitch yaw x y z lx rx a
        b c first second"""
    )
)
"""Words after a quantity that belong to the joint's name before it."""
