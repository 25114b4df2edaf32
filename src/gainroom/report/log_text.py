"""Log as text: contents, how each guess was made, what was cut, and what can be identified from it."""

from collections.abc import Sequence
from typing import Any

from ..errors import listed
from ..files.logs import CHANNELS, Ability, Log, LoggedJoint, Origin, Quality, Survey, unknown_units
from ..identification.record import SHORTEST
from .number_format import digits

READ = {
    "given": "stated",
    "file": "the file",
    "name": "name",
    "values": "numbers",
    "convention": "convention",
    "assumed": "assumed",
    "unknown": "not said",
}
"""Source of a column's or unit's meaning, in a table."""
COARSE = 0.05
"""Jitter in ticks above which it is reported: a twentieth of a tick is the accuracy asked of a delay, within a factor of two."""

UNSURE, UNKNOWN = 0.18, 0.27
"""Deviation of time stamps in ticks (root mean square) above which a gap is uncertain, and above which no gap is certain."""


def sentence(survey: Survey) -> str:
    """Description of the log in one sentence."""
    quality, joints = survey.last.quality, survey.last.joint_names
    rows = digits(quality.rows - quality.cut, significant=6)
    many = f"{len(joints)} joints" if len(joints) > 1 else "one joint"
    return f"{survey.path} holds {rows} rows of {many}: {digits(survey.duration, 's')} at {digits(survey.rate, 'Hz')}."


def remarks(log: Log) -> list[str]:
    """Remarks on repairs, cuts, omissions and possible errors of a log."""
    quality = log.quality
    found = [] if log.complete else ["The file ends in the middle of a record; what came before was read."]
    found += _cuts(quality)
    if quality.sample_time and quality.jitter > COARSE * quality.sample_time:
        found.append(
            f"Time stamps jitter by {digits(1e3 * quality.jitter, 'ms')} around a tick of {digits(1e3 * quality.sample_time, 'ms')}."
        )
    for origin in log.origins:
        if origin.channel == "time" and origin.unit_from == "values":
            found.append(
                f"Time stamps were read in {origin.unit}: in s the rate would be implausible. State it with --units time={origin.unit}."
            )
    assumed = dict.fromkeys(origin.channel for origin in log.origins if origin.unit_from == "assumed" and origin.channel != "time")
    if assumed:
        found.append(f"Units are not stated of {listed([*assumed], most=12)}; SI on the joint side was assumed.")
    if unknown := unknown_units(log):
        found.append(f"{unknown[0].upper()}{unknown[1:]}.")
    if any(_unstated_side(origin) for origin in log.origins):
        found.append(
            "Which side of the gearbox the encoder is on is not stated; motor_position was assumed (else: --columns link_position=…)."
        )
    return found + [f"{note[0].upper()}{note[1:]}." for note in log.notes]


def logged_remarks(logged: LoggedJoint) -> list[str]:
    """Remarks on the log of an identified joint, and on the share of it on even ticks."""
    found = remarks(logged.log)
    breaks = int(logged.record.fresh.sum()) - 1
    if breaks:
        longest = len(logged.record.longest_run().time)
        found.append(
            f"The log has {breaks} gaps of more than 3 ticks; {digits(longest, significant=6)} of "
            f"{digits(len(logged.record.time), significant=6)} rows are in its longest part, which is all that a fit of motion uses."
        )
    return found


def logged_facts(logged: LoggedJoint) -> dict[str, Any]:
    """JSON of the identified joint and rows."""
    record = logged.record
    return {
        "file": str(logged.path),
        "joint": logged.joint.name,
        "channels": list(record.channels),
        "rows": len(record.time),
        "duration": float(record.time[-1] - record.time[0]),
        "sample_rate_hz": 1 / record.sample_time,
        "gaps": int(record.fresh.sum()) - 1,
        "outliers": logged.outliers.count,
    }


def _unstated_side(origin: Origin) -> bool:
    """True if no name tells which side of the gearbox an encoder is on: `position`, `q`."""
    return (origin.channel, origin.column_from) == ("motor_position", "name") and "motor" not in origin.column.lower()


def _rows(count: int) -> str:
    return f"{count} rows were" if count > 1 else "1 row was"


def _cuts(quality: Quality) -> list[str]:
    found = []
    if quality.not_finite:
        worst = sorted(quality.missing, key=lambda name: -quality.missing[name])
        found.append(f"{_rows(quality.not_finite)} cut: a number is missing or not finite in {listed(worst)}.")
    if quality.duplicate:
        found.append(f"{_rows(quality.duplicate)} cut: their time stamp is that of the row before.")
    if quality.backwards:
        found.append(f"{_rows(quality.backwards)} cut: their time stamp is earlier than one before.")
    if quality.ahead:
        found.append(f"{_rows(quality.ahead)} cut: their time stamp is far later than all that follow.")
    if quality.gaps:
        longest = digits(1e3 * quality.longest_gap, "ms")
        ticks = f"{quality.dropped} ticks are" if quality.dropped > 1 else "1 tick is"
        found.append(
            f"{ticks} missing in {quality.gaps} gaps, the longest of {longest}."
            if quality.gaps > 1
            else f"{ticks} missing in a gap of {longest}."
        )
    if quality.off_ticks > UNSURE and (quality.gaps or quality.off_ticks > UNKNOWN):
        found.append(
            f"Time stamps lie {digits(quality.off_ticks, significant=2)} ticks off their ticks: which rows are missing is not certain. "
            f"If none is, give the rate of the rows, as --rate-hz {digits(1 / quality.sample_time, significant=3)}."
        )
    return found


def ability_text(ability: Ability) -> str:
    """Channels that answer a question, or those missing."""
    if ability.missing:
        return f"needs {', and '.join(_needed(group, ability.resting) for group in ability.missing)}"
    if ability.too_few:
        return f"needs {SHORTEST} rows"
    text = f"from {listed(ability.channels)}"
    return f"{text}; delays of command and loop may be confounded" if ability.confounded else text


def _needed(group: Sequence[str], resting: Sequence[str]) -> str:
    """One channel of a group: one that exists but never changes, otherwise any."""
    still = [name for name in group if name in resting]
    return f"{listed(still, 'or', 2)} to change" if still else listed(group, "or", 2)


CHANNEL_TITLES = ("", "joint", "column", "by", "unit", "by", "range")


def channel_rows(survey: Survey, most: int | None = None) -> list[tuple[str, ...]]:
    """Table rows (CHANNEL_TITLES) of the channels of the first `most` joints."""
    shown = survey.last.joint_names[:most]
    return [
        (
            origin.channel,
            origin.joint,
            origin.column,
            READ[origin.column_from],
            origin.unit,
            READ[origin.unit_from],
            _range_text(survey, origin),
        )
        for origin in survey.last.origins
        if origin.channel == "time" or origin.joint in shown
    ]


def _range_text(survey: Survey, origin: Origin) -> str:
    if (origin.joint, origin.channel) not in survey.ranges:
        return ""
    least, largest = survey.ranges[origin.joint, origin.channel]
    si = {"angle": "rad", "speed": "rad/s", "torque": "N·m", "current": "A"}[CHANNELS[origin.channel].dimension]
    unit = "" if origin.unit_from == "unknown" else si
    return f"{digits(least, significant=3)} to {digits(largest, unit, 3)}"


def facts(survey: Survey) -> dict[str, Any]:
    """JSON of a log survey."""
    log, quality = survey.last, survey.last.quality
    return {
        "sentence": sentence(survey),
        "rows": quality.rows - quality.cut,
        "duration": survey.duration,
        "sample_rate_hz": survey.rate,
        "jitter_ms": 1e3 * quality.jitter,
        "complete": log.complete,
        "began": log.began,
        "cut": {"not_finite": quality.not_finite, "duplicate": quality.duplicate, "backwards": quality.backwards, "ahead": quality.ahead},
        "missing": dict(quality.missing),
        "gaps": {"count": quality.gaps, "dropped_ticks": quality.dropped, "longest_ms": 1e3 * quality.longest_gap},
        "joints": [{"name": joint, "channels": _channel_facts(survey, joint)} for joint in log.joint_names],
        "unused": [*survey.unused],
        "time": next((_origin_facts(origin) for origin in log.origins if origin.channel == "time"), None),
        "allows": {
            each.question: {key: getattr(each, key) for key in ("possible", "channels", "missing", "confounded")}
            | {"constant": each.resting}
            for each in survey.abilities()
        },
        "warnings": remarks(survey.last),
    }


def _channel_facts(survey: Survey, joint: str) -> dict[str, Any]:
    return {
        origin.channel: {**_origin_facts(origin), "range": survey.ranges.get((joint, origin.channel))}
        for origin in survey.last.origins
        if origin.joint == joint and origin.channel != "time"
    }


def _origin_facts(origin: Origin) -> dict[str, Any]:
    return {key: value for key, value in vars(origin).items() if key not in ("channel", "joint")}
