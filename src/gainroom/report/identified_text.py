"""Identification as text and columns: joint, gains and stiffness, delay."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from ..identification import Estimate, GainsFit, JointFit, SetpointDelay, StiffnessFit, TorqueDelay
from ..identification.estimate import PARAMETERS
from ..identification.gains import MOST_EXPLAINED
from ..identification.residuals import MOST_LEFT
from .columns import Column
from .estimate_columns import Answer, estimated, interval_text
from .number_format import digits, hertz

HERTZ = ("Hz", 1 / (2 * math.pi))
TITLES = {
    "motor_inertia": "motor inertia J_M",
    "link_inertia": "link inertia J_L",
    "inertia": "inertia",
    "stiffness": "stiffness K",
    "damping": "damping B",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction, motor",
    "link_coulomb": "Coulomb friction, link",
    "weight_sine": "weight along sin q",
    "weight_cosine": "weight along cos q",
    "delay": "delay",
    "resonance": "resonance",
    "antiresonance": "antiresonance",
}
MODELS = {"rigid": "One inertia", "two-mass": "Two masses and a spring", "two-mass with friction": "Two masses and a spring, with friction"}
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
    Column(
        "range of the delays",
        "jitter_range_ms",
        lambda found: None if math.isnan(found.jitter_width) else 1e3 * found.jitter_width,
        "ms",
        "its width for single commands, drive.jitter_ms of a joint.yaml or robot.yaml",
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


def _parameter(name: str) -> Callable[[Any], Estimate | None]:
    return lambda fit: fit.parameters.get(name)


def _parameter_column(name: str) -> Column:
    if name == "delay":
        return estimated(TITLES[name], "delay_ms", _parameter(name), "ms", 1e3)
    if PARAMETERS[name] == "rad/s":
        return estimated(TITLES[name], f"{name}_rad_s", _parameter(name), "rad/s", shown_in=HERTZ)
    return estimated(TITLES[name], name, _parameter(name), PARAMETERS[name])


PARAMETER_COLUMNS = tuple(_parameter_column(name) for name in TITLES)
JOINT_COLUMNS = (
    Column("", "model", lambda fit: fit.model),
    Column("", "adequate", lambda fit: fit.adequate),
    Column(
        "explained residual",
        "residual_explained",
        lambda fit: fit.residuals.explained,
        definition="share of the residual that is coherent with the torque: what the model should have explained",
        shown=lambda fit: digits(100 * fit.residuals.explained, "%", 2),
    ),
    Column("", "torque", lambda fit: fit.torque),
    Column("", "rivals", lambda fit: [asdict(rival) for rival in fit.rivals]),
)
STIFFNESS_COLUMNS = (
    estimated("stiffness K", "stiffness", lambda fit: fit.stiffness, "N·m/rad", definition="slope of torque over deflection"),
    estimated("friction", "friction", lambda fit: fit.friction, "N·m", definition="half the width of the hysteresis in torque"),
    estimated("hysteresis", "hysteresis", lambda fit: fit.hysteresis, "rad", definition="its width in deflection", shown_in=("mrad", 1e3)),
    estimated("hardening", "hardening", lambda fit: fit.hardening, definition="rise of the slope towards the ends", shown_in=("%", 100.0)),
    Column("offset", "offset", lambda fit: fit.offset, "N·m", "torque at deflection 0", significant=3),
    Column("", "rows", lambda fit: len(fit.torque)),
)


def joint_answer(fit: JointFit) -> Answer:
    """Answer of a joint identification: adequacy of the model, and its parameters."""
    first = ""
    if not fit.adequate:
        first = f"Not adequate: {_left_text(fit)}: something in the joint is not in the model, and the intervals do not allow for it. "
    return Answer("Joint", first + _model_text(fit), JOINT_COLUMNS, fit, fit.warnings, PARAMETER_COLUMNS)


def _left_text(fit: JointFit) -> str:
    """Clause with the failed tests of a fit's residuals."""
    tests, balance = fit.residuals, fit.residuals.balance
    if tests.copies:
        return "positions are copies of those a row before, again and again: log what was measured in each row"
    if balance.most >= MOST_LEFT:
        low, high = balance.edges[balance.worst]
        share = "more than all" if balance.most > 1 else digits(100 * balance.most, "%", 2)
        return f"the model misses {share} of the torque's power from {hertz(low)} to {hertz(high)}"
    if tests.follows:
        return f"{digits(100 * tests.explained, '%', 2)} of what the model leaves follows the torque"
    return "what the model leaves repeats itself"


def _model_text(fit: JointFit) -> str:
    found = fit.parameters
    delay = "" if "delay" not in found else f", delay {digits(1e3 * found['delay'].value, 'ms', 3)}"
    if "stiffness" not in found:
        return f"{MODELS[fit.model]} of {digits(found['inertia'].value, 'kg·m²', 3)}{delay}."
    stiffness = found["stiffness"]
    return (
        f"{MODELS[fit.model]}: resonance {hertz(found['resonance'].value)}, stiffness {digits(stiffness.value, 'N·m/rad')} "
        f"({interval_text(stiffness.low, stiffness.high)}){delay}."
    )


def stiffness_answer(fit: StiffnessFit) -> Answer:
    """Answer of a stiffness identification: slope, and width of the hysteresis."""
    sentence = (
        f"The stiffness is {digits(fit.stiffness.value, 'N·m/rad')} ({interval_text(fit.stiffness.low, fit.stiffness.high)}); friction of "
        f"{digits(fit.friction.value, 'N·m', 3)} makes a hysteresis of {digits(1e3 * fit.hysteresis.value, 'mrad', 3)}."
    )
    assumed = "the output is taken as locked: on a joint whose link moves, this is not its stiffness"
    return Answer("Locked output", sentence, STIFFNESS_COLUMNS, fit, (assumed, *fit.warnings))


LAWS = {True: "; kd acts on the error of the velocity", False: "; kd acts on the velocity alone", None: ""}
GAIN_COLUMNS = (
    estimated("kp", "kp", lambda fit: fit.kp, "N·m/rad"),
    estimated("kd", "kd", lambda fit: fit.kd, "N·m·s/rad"),
    Column("lag", "lag_ms", lambda fit: 1e3 * fit.lag, "ms", "of the torque behind the positions", significant=3),
    Column("offset", "offset", lambda fit: fit.offset, "N·m", "constant torque", significant=3),
    Column(
        "explained",
        "explained",
        lambda fit: fit.explained,
        definition="share of the torque's power",
        shown=lambda fit: digits(100 * fit.explained, "%"),
    ),
    Column(
        "up to",
        "band_rad_s",
        lambda fit: fit.band,
        definition="frequencies used",
        shown=lambda fit: digits(fit.band / (2 * math.pi), "Hz", 3),
    ),
    Column("", "rate_of_error", lambda fit: fit.rate_of_error),
    Column("", "velocity", lambda fit: fit.velocity),
    Column("", "torque", lambda fit: fit.torque),
    Column("", "unit_errors", lambda fit: [asdict(each) for each in fit.unit_errors]),
)
ASKED_TITLES = ("", "asked for", "applied", "applied/asked", "")


def gains_answer(fit: GainsFit) -> Answer:
    """Answer of a gain identification: gains, unexplained torque, and errors of units."""
    explained = digits(100 * fit.explained, "%", 3)
    adequate = fit.explained >= MOST_EXPLAINED
    first = (
        "" if adequate else f"Not adequate: kp and kd explain {explained} of {fit.torque} only; the intervals do not allow for the rest. "
    )
    verb = "The firmware applies" if adequate else "They would be"
    gains = f"{verb} kp = {_gain(fit.kp, 'N·m/rad')} and kd = {_gain(fit.kd, 'N·m·s/rad')}{LAWS[fit.rate_of_error]}."
    wrong = "".join(f" {error.gain} is off by {digits(error.factor, '', 4)} ({error.name})." for error in fit.unit_errors)
    return Answer("Gains", first + gains + wrong, GAIN_COLUMNS, fit, fit.warnings)


def _gain(estimate: Estimate, unit: str) -> str:
    return digits(estimate.value, unit)


def asked_rows(fit: GainsFit, asked: Sequence[tuple[str, float]]) -> list[tuple[str, ...]]:
    """Table rows (ASKED_TITLES) of requested and identified gains."""
    named = {error.gain: error.name for error in fit.unit_errors}
    rows = []
    for name, value in asked:
        found: Estimate = getattr(fit, name)
        ratio = found.value / value if value else math.nan
        rows.append((name, digits(value), digits(found.value), digits(ratio), named.get(name) or _verdict(found, value)))
    return rows


def _verdict(found: Estimate, asked: float) -> str:
    if found.low <= asked <= found.high:
        return "within the interval"
    return f"differs by {digits(100 * abs(found.value / asked - 1), '%', 2)}" if asked else ""


def torque_delay_answer(found: TorqueDelay) -> Answer:
    """Answer on the delay from target to actual torque, identified from a log's torques."""
    tick = digits(1e3 * found.sample_time, "ms")
    low, high = (digits(1e3 * end, "", 4) for end in (found.delay.low, found.delay.high))
    if not found.confounded or "actual_torque" not in found.channels:
        value = digits(1e3 * found.delay.value, "ms")
        sentence = f"The torque is {value} late ({low} to {high} ms), {digits(found.ticks.value)} ticks of {tick}."
    else:
        sentence = f"The log bounds the delay only: {low} to {high} ms, in ticks of {tick}."
    return Answer("Delay", sentence, TORQUE_COLUMNS, found, found.warnings)


def setpoint_delay_answer(found: SetpointDelay) -> Answer:
    """Answer on loop delay and command delay, identified from a log's set-points and positions."""
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
