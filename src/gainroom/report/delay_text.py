"""The delay that `gainroom identify delay` finds, in numbers and in a sentence."""

import math

from ..identification import SetpointDelay, TorqueDelay
from .columns import Column
from .estimates import Answer, estimated
from .number_format import digits

CONFOUNDED = (
    Column("", "told", lambda found: not found.confounded),
    Column("", "confounded", lambda found: found.confounded),
)
TORQUE_COLUMNS = (
    estimated("delay", "delay_ms", lambda found: found.delay, "ms", 1e3, "from target to demand torque, mean over commands"),
    estimated("delay in ticks", "delay_ticks", lambda found: found.ticks, "", 1.0, "the same in ticks of the log"),
    estimated("delay in the loop", "effective_delay_ms", lambda found: found.effective, "ms", 1e3, "mean age of the command that acts"),
    Column(
        "jitter",
        "jitter_ms",
        lambda found: None if math.isnan(found.jitter.deviation) else 1e3 * found.jitter.deviation,
        "ms",
        "standard deviation of the delays of single commands",
        significant=3,
    ),
    estimated("current loop ω_c", "bandwidth", lambda found: found.bandwidth, "rad/s", 1.0, "bandwidth of the current loop"),
    estimated("current loop ζ", "damping_ratio", lambda found: found.damping_ratio, "", 1.0, "damping ratio of the current loop"),
    estimated("gain", "gain", lambda found: found.gain, "", 1.0, "actual over demand torque"),
    estimated("delay + lag", "lag_ms", lambda found: found.lag, "ms", 1e3, "delay + 2ζ/ω_c, from target to actual torque"),
    *CONFOUNDED,
    Column("", "from", lambda found: list(found.channels)),
)
SETPOINT_COLUMNS = (
    estimated("loop delay", "delay_ms", lambda found: found.loop, "ms", 1e3, "from position to the torque made from it: costs stability"),
    estimated(
        "loop delay in ticks",
        "delay_ticks",
        lambda found: found.loop.scaled(1 / found.sample_time),
        "",
        1.0,
        "the same in ticks of the log",
    ),
    estimated("command delay", "command_delay_ms", lambda found: found.command, "ms", 1e3, "age of the set-point that is acted on"),
    estimated("both together", "total_delay_ms", lambda found: found.total, "ms", 1e3, "from set-point to torque"),
    Column("", "jitter_ms", lambda found: None),
    Column("", "bandwidth", lambda found: None),
    Column("", "damping_ratio", lambda found: None),
    estimated("natural frequency", "natural_frequency_rad_s", lambda found: found.natural_frequency, "rad/s", 1.0, "√(kp/J) of the loop"),
    Column("loop ζ", "loop_damping_ratio", lambda found: found.damping_ratio, "", "damping ratio of the loop without delay", significant=3),
    *CONFOUNDED,
    Column("", "from", lambda found: ["reference", "position"]),
)


def torque_delay_answer(found: TorqueDelay) -> Answer:
    """From torques."""
    tick = digits(1e3 * found.sample_time, "ms")
    low, high = (digits(1e3 * end, "", 4) for end in (found.delay.low, found.delay.high))
    if not found.confounded or "actual_torque" not in found.channels:
        value = digits(1e3 * found.delay.value, "ms")
        sentence = f"The torque is {value} late ({low} to {high} ms), {digits(found.ticks.value)} ticks of {tick}."
    else:
        sentence = f"The log bounds the delay only: {low} to {high} ms, in ticks of {tick}."
    return Answer("Delay", sentence, TORQUE_COLUMNS, found, found.warnings)


def setpoint_delay_answer(found: SetpointDelay) -> Answer:
    """From set-point and position."""
    total = f"{digits(1e3 * found.total.value, 'ms')} ({digits(1e3 * found.total.low)} to {digits(1e3 * found.total.high)} ms)"
    if found.confounded:
        sentence = f"Command delay and loop delay are confounded: together they are {total}; which part acts in the loop is not known."
    else:
        sentence = (
            f"The loop's delay is {digits(1e3 * found.loop.value, 'ms')} ({digits(1e3 * found.loop.low)} to "
            f"{digits(1e3 * found.loop.high)} ms), and with that of the set-point {total}."
        )
    source = "no pair of torques is in the log: the delay is from set-point and position, and includes the current loop's lag"
    if found.loop_sample_time is None:
        source += "; if the loop is sampled, about one of its ticks is hold and velocity difference (--loop-rate-hz takes it off)"
    return Answer("Delay", sentence, SETPOINT_COLUMNS, found, (source, *found.warnings))
