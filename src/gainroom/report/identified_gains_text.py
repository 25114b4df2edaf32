"""The gains that `gainroom identify gains` finds, beside those asked for."""

import math
from collections.abc import Sequence
from dataclasses import asdict

from ..identification import Estimate, GainsFit
from ..identification.gains import MOST_EXPLAINED
from .columns import Column
from .estimates import Answer, estimated
from .number_format import digits

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
    """The gains, what of the torque they do not explain, and errors of units."""
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
    """As ASKED_TITLES says."""
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
