"""Text of a joint.yaml from an identified joint: values, 95 % intervals as `uncertainty`, gains to start from, and the covariance.

Numbers are written with six digits, intervals rounded outwards. What is written is read again before it takes its place.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..design.joint_gains import recommend_pd
from ..errors import GainroomError
from ..identification import Estimate, JointFit
from ..io.validation import SMALLEST
from ..io.yaml_text import shown
from ..system.drive import Drive
from ..system.system import System
from .identified_section import problem_of
from .joint_yaml import parse_joint

START_HZ = 1.0
"""Natural frequency of the file's gains [Hz] if none meet the usual limits over the intervals, and before they are searched."""
RANGES = {
    "delay_ms": "delay",
    "stiffness": "stiffness",
    "motor_inertia": "motor_inertia",
    "link_inertia": "link_inertia",
    "damping": "damping",
}
"""Keys of `uncertainty`, and the parameters that they hold."""


def identified_text(fit: JointFit, log: Path, known: Drive | None, date: str, version: str) -> tuple[str, System, bool]:
    """Text of a joint.yaml, its system, and True if its gains meet the usual limits over the intervals.

    log     of which only the name is written
    known   the drive as it was given; None: it was identified

    Raises GainroomError where the fit does not tell the delay and none was given, and where it has no covariance.
    """
    ranges = _ranges(fit)
    if known is None and "delay" not in ranges:
        raise GainroomError("the log does not tell the delay, which a joint.yaml needs: give --delay-ms, or record target_torque too")
    if not np.all(np.isfinite(fit.covariance)) or problem_of(fit.covariance):
        raise GainroomError(f"the fit's covariance {problem_of(fit.covariance) or 'must be finite'}: no joint.yaml is written")
    drive = fit.drive if known is None else known
    inertia = fit.joint.motor_inertia + fit.joint.link_inertia
    omega = 2 * math.pi * START_HZ
    start = {"kp": inertia * omega**2, "kd": 2 * inertia * omega}

    def text(gains: Mapping[str, float], met: bool) -> str:
        return "\n".join(_lines(fit, log, drive, ranges, gains, (date, version), met)) + "\n"

    system = parse_joint(text(start, False), "the identified joint.yaml")
    control = system.control
    found = recommend_pd(
        system.source,  # type: ignore[arg-type] - a joint
        system.drives[0],
        system.requirements,
        system.uncertainty,
        control.feedback,
        control.sample_time,
        objective=system.objective,
    )
    gains = start if found is None else {"kp": found.kp, "kd": found.kd}
    written = text(gains, found is not None)
    return written, parse_joint(written, "the identified joint.yaml"), found is not None


def _ranges(fit: JointFit) -> dict[str, Estimate]:
    """Intervals of the file by parameter of joint and drive; a rigid joint has half of its inertia on either side."""
    found = dict(fit.parameters)
    if "inertia" in found:
        half = found.pop("inertia").scaled(0.5)
        found |= {"motor_inertia": half, "link_inertia": half}
    return {name: found[name] for name in RANGES.values() if name in found}


def _lines(
    fit: JointFit, log: Path, drive: Drive, ranges: Mapping[str, Estimate], gains: Mapping[str, float], made: tuple[str, str], met: bool
) -> list[str]:
    """Lines of the joint.yaml, top to bottom."""
    date, version = made
    rigid = "stiffness" not in ranges
    delay = ranges["delay"].value if "delay" in ranges else drive.delay
    units = {name: 1e3 if name == "delay" else 1.0 for name in RANGES.values()}
    boxes = {key: _outwards(ranges[name], units[name]) for key, name in RANGES.items() if name in ranges}
    joint = {name: ranges[name].value for name in ("motor_inertia", "link_inertia", "stiffness", "damping") if name in ranges}
    names = "" if not rigid else "  # no resonance was found: the inertia is half on either side"
    origin = "the stiffest that keep the usual limits over the intervals" if met else f"natural frequency {START_HZ:g} Hz"
    return [
        f"# Identified by gainroom {version} on {date}; model: {fit.model}. SI, joint side; uncertainty: 95 % intervals.",
        *([] if fit.adequate else ["# NOT ADEQUATE: the residuals hold what the torque explains; the intervals do not allow for that."]),
        f"joint:{names}",
        *(f"  {name}: {_six(value)}" for name, value in joint.items()),
        *(["  stiffness: rigid"] if rigid else []),
        "drive:",
        f"  bandwidth: {'.inf' if drive.is_ideal else _six(drive.bandwidth)}",
        f"  damping_ratio: {_six(drive.damping_ratio)}",
        f"  delay_ms: {_six(1e3 * delay)}",
        f"control:  # gains: {origin}",
        "  type: pd",
        *(f"  {name}: {_six(value)}" for name, value in gains.items()),
        "  feedback: motor",
        f"  sample_rate_hz: {_six(1 / fit.sample_time)}  # of the log",
        "uncertainty:",
        *(f"  {key}: [{low}, {high}]" for key, (low, high) in boxes.items()),
        "identified:",
        *(f"  {key}: {value}" for key, value in _identified(fit, log, date, version).items()),
        "  covariance:",
        *(f"    - [{', '.join(_many(value) for value in row)}]" for row in ((fit.covariance + fit.covariance.T) / 2).tolist()),
    ]


def _identified(fit: JointFit, log: Path, date: str, version: str) -> dict[str, Any]:
    return {
        "log": _quoted(log.name),
        "date": _quoted(date),
        "gainroom": _quoted(version),
        "model": fit.model,
        "adequate": "true" if fit.adequate else "false",
        "names": f"[{', '.join(fit.names)}]",
        "values": f"[{', '.join(_many(fit.parameters[name].value) for name in fit.names)}]",
    }


def _quoted(text: str) -> str:
    """YAML string between single quotes; unprintable characters are escaped as in messages."""
    return "'" + (text if text.isprintable() else shown(text)).replace("'", "''") + "'"


def _six(value: float) -> str:
    return _number(f"{value:.6g}") if value >= SMALLEST else "0.0"


def _many(value: float) -> str:
    return _number(f"{value:.12g}")


def _number(text: str) -> str:
    """Number with a decimal point, which some YAML readers require in a float with an exponent."""
    mantissa, sign, exponent = text.partition("e")
    return (mantissa if "." in mantissa or not sign else f"{mantissa}.0") + sign + exponent


def _outwards(found: Estimate, unit: float) -> tuple[str, str]:
    """Ends of an interval with six digits, rounded away from the value, within the bounds of the file format."""
    value = float(_six(unit * found.value))
    low, high = min(unit * found.low, value), max(unit * found.high, value)
    return _number(_rounded(max(low, 0.0), math.floor)), _number(_rounded(high, math.ceil))


def _rounded(value: float, towards: Callable[[float], int]) -> str:
    if value < SMALLEST:
        return "0.0"
    place = math.floor(math.log10(value)) - 5
    return f"{towards(value / 10.0**place * (1 + (1e-12 if towards is math.floor else -1e-12))) * 10.0**place:.6g}"
