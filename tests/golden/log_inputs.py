"""Inputs that are logs: of a joint of two masses on a spring, stepped here and not by the package; and hostile ones."""

import math

import numpy as np

TICK, STEPS = 1e-3, 10
MOTOR, LINK, STIFFNESS, DAMPING = 0.2, 0.8, 3000.0, 1.0
LATE = 2
"""Ticks from the command to the torque."""


def two_masses(seconds: float, kp: float, kd: float, feedforward: np.ndarray | None = None, moved: float = 0.0) -> dict[str, np.ndarray]:
    """The columns of a log: PD control with delay on the motor's position, `feedforward` torque, a set-point that goes `moved` rad."""
    count = round(seconds / TICK)
    time = np.arange(count) * TICK
    reference = moved * np.clip((time - 0.2) / 0.5, 0.0, 1.0)
    added = np.zeros(count) if feedforward is None else feedforward
    target, motor, link = np.zeros(count), np.zeros(count), np.zeros(count)
    q, v, p, w, before, step = 1e-4, 0.0, 0.0, 0.0, 0.0, TICK / STEPS
    for tick in range(count):
        motor[tick], link[tick] = q, p
        speed = (motor[tick] - before) / TICK if tick else 0.0
        before = motor[tick]
        target[tick] = kp * (reference[tick] - motor[tick]) - kd * speed + added[tick]
        torque = target[tick - LATE] if tick >= LATE else 0.0
        for _ in range(STEPS):
            spring = STIFFNESS * (q - p) + DAMPING * (v - w)
            v += step * (torque - spring) / MOTOR
            w += step * spring / LINK
            q, p = q + step * v, p + step * w
    noise = np.random.default_rng(1)
    actual = np.concatenate([np.zeros(LATE), target[:-LATE]])
    actual = actual + 1e-3 * (np.std(actual) + 1e-6) * noise.standard_normal(count)
    measured = {"motor_position": motor, "link_position": link}
    encoders = {name: 1e-6 * np.round((values + 1e-6 * noise.standard_normal(count)) / 1e-6) for name, values in measured.items()}
    return {"time": time, "reference": reference, "target_torque": target, "actual_torque": actual, **encoders}


def multisine(seconds: float, size: float) -> np.ndarray:
    """A torque of forty frequencies from 0.5 to 80 Hz, with phases of Schroeder's kind."""
    time = np.arange(round(seconds / TICK)) * TICK
    lines = np.unique(np.rint(np.geomspace(0.5, 80.0, 40) * seconds)) / seconds
    return size * sum(np.sin(2 * math.pi * hz * time + math.pi * k * k / len(lines)) for k, hz in enumerate(lines)) / math.sqrt(len(lines))


def as_csv(columns: dict[str, np.ndarray], only: str = "") -> str:
    """A log's text; `only`: names of the columns that it has."""
    names = only.split() or [*columns]
    rows = (",".join(f"{columns[name][row]:.9g}" for name in names) for row in range(len(columns["time"])))
    return "\n".join([",".join(names), *rows]) + "\n"


def written() -> dict[str, str]:
    """All logs by file name."""
    calm = two_masses(2.0, 300.0, 20.0, moved=0.2)
    shaky = two_masses(1.0, 600.0, 105.0)
    excited = two_masses(4.0, 60.0, 4.0, multisine(4.0, 8.0))
    calm_text = as_csv(calm)
    return {
        "calm.csv": calm_text,
        "shaky.csv": as_csv(shaky),
        "shaky_bare.csv": as_csv(shaky, "time motor_position"),
        "excited.csv": as_csv(excited),
        "excited_motor.csv": as_csv(excited, "time target_torque motor_position"),
        "renamed.csv": as_csv(calm).replace("target_torque", "iq_cmd", 1).replace("motor_position", "enc", 1),
        "log_two_rows.csv": "\n".join(calm_text.splitlines()[:3]) + "\n",
        "log_no_numbers.csv": "time,motor_position\na,b\nc,d\n",
        "log_nan.csv": "time,motor_position\n" + "".join(f"{k * TICK:.3f},nan\n" for k in range(500)),
        "log_no_time.csv": "weight,colour\n1,2\n3,4\n",
        "log_cut.csv": calm_text[: len(calm_text) // 2],
        "log_empty.csv": "",
    }


JOINT = f"""\
joint: {{motor_inertia: {MOTOR}, link_inertia: {LINK}, stiffness: {STIFFNESS}, damping: {DAMPING}}}
drive: {{bandwidth: .inf, delay_ms: {1e3 * LATE * TICK}}}
control: {{type: pd, kp: 600.0, kd: 105.0, feedback: motor, sample_rate_hz: {1 / TICK:g}}}
"""
"""The joint.yaml of shaky.csv."""
