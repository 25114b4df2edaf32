"""Mapping from a file's columns to channels, joints and factors: as the user's options say, else by their names."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...errors import GainroomError, first_of_many, listed
from ...io.yaml_text import shown
from .arranging import MEASURED_MOTION, MOTION, Claim, arrange, flag
from .channels import CHANNELS, ONE_JOINT
from .guessing import COMMAND_OF, LESS_SURE, Naming, channel_of
from .options import LogOptions
from .record import Origin
from .table import TIME, Column
from .units import SI, UNKNOWN, known_unit


@dataclass(frozen=True)
class Mapped:
    """Mapped columns.

    time None: rows come at a rate that the user gave. origins: of the channels, joint by joint. notes: texts. unused: columns.
    """

    time: Origin | None
    origins: tuple[Origin, ...]
    notes: tuple[str, ...]
    unused: tuple[str, ...]


def map_columns(columns: Sequence[Column], options: LogOptions, path: Path, left: Sequence[str] = ()) -> Mapped:
    """Mapping of the columns of a file; `left`: parts of the file that are not among them, with reasons.

    Raises GainroomError where there is no time, no channel, a column that was named is not there, or a unit is not known.
    """
    claims = [*_given(columns, options, path)]
    taken = {claim.column.name for claim in claims}
    overruled = {claim.channel for claim in claims}
    guessed = [claim for claim in _guessed(columns) if claim.column.name not in taken and claim.channel not in overruled]
    arranged = arrange([*claims, *guessed])
    claims = arranged.claims
    chosen: dict[tuple[str, str], Claim] = {}
    second = []
    for claim in sorted(claims, key=lambda claim: claim.rank):
        if chosen.setdefault((claim.joint, claim.channel), claim) is not claim:
            second.append(claim)
    notes = [*arranged.notes, *_passed_over(second, chosen)]
    time = chosen.pop(("", "time"), None)
    if time is None and options.sample_rate is None:
        raise GainroomError(
            f"{path}: has no column time; it has {_names(columns)}; name it (--columns time=NAME), or give the sample rate (--rate-hz)"
            + "".join(f"; {text}" for text in left)
        )
    joints, more, used = _joints(chosen, options, path, columns, left)
    used |= set() if time is None else {time.column.name}
    unused = tuple(column.name for column in columns if column.name not in used)
    mentioned = arranged.mentioned | {claim.column.name for claim in (*second, *chosen.values())}
    silent = [name for name in unused if name not in mentioned]
    if silent:
        more.append(f"columns that no channel was found for: {first_of_many(silent)}")
    order = [*CHANNELS]
    origins = [
        _origin(claim, joint, options, path)
        for joint, claims in joints.items()
        for claim in sorted(claims, key=lambda c: order.index(c.channel))
    ]
    found = None if time is None or options.sample_rate is not None else _origin(time, "", options, path)
    return Mapped(found, tuple(origins), (*notes, *more), unused)


def _passed_over(second: Sequence[Claim], chosen: Mapping[tuple[str, str], Claim]) -> list[str]:
    """Texts about channels with several candidate columns, with the option that selects another."""
    notes = []
    for channel in dict.fromkeys(claim.channel for claim in second):
        first, *others = (claim for claim in second if claim.channel == channel)
        taken = chosen[first.joint, channel]
        more = f" and {len(others)} more of its kind were" if others else " was"
        ways = [f"to take it: {flag(channel, first)}"]
        command = COMMAND_OF.get(channel)
        if channel in MOTION:
            ways.append(f"if it is the link's: {flag(MOTION[channel], first)}")
        if command and taken.rank == first.rank and (first.joint, command) not in chosen:
            ways.append(f"if it is the command: {flag(command, first)}")
        notes.append(f"column {first.column.name!r}{more} passed over: {taken.column.name!r} is {channel} ({'; '.join(ways)})")
    return notes


def _names(columns: Sequence[Column]) -> str:
    return first_of_many([column.name for column in columns]) or "no columns of numbers"


def _given(columns: Sequence[Column], options: LogOptions, path: Path) -> list[Claim]:
    claims = []
    for key, text in options.columns.items():
        channel, _, joint = key.partition(".")
        if "{joint}" in text:
            pattern = re.escape(text).replace(re.escape("{joint}"), "(.+)", 1).replace(re.escape("{joint}"), r"\1")
            found = [(column, match[1]) for column in columns if (match := re.fullmatch(pattern, column.name))]
        else:
            found = [(column, joint) for column in _named(columns, text)]
        if not found:
            raise GainroomError(f"{path}: has no column {shown(text)} for {key}; it has {_names(columns)}")
        claims += [Claim(column, channel, "" if channel == "time" else name, -1, True, "") for column, name in found]
    return claims


def _named(columns: Sequence[Column], text: str) -> list[Column]:
    """Columns with that name, or the only one whose name ends in it."""
    exact = [column for column in columns if column.name == text]
    ends = [column for column in columns if column.name.endswith((f"/{text}", f".{text}"))]
    return exact or (ends if len(ends) == 1 else [])


def _guessed(columns: Sequence[Column]) -> list[Claim]:
    claims = []
    naming = Naming.of(column.text for column in columns)
    for column in columns:
        guess = channel_of(column.text, bool(column.joint), column.commanded, naming)
        if guess is not None:
            joint = "" if guess.channel == TIME else column.joint or guess.joint
            later = LESS_SURE if guess.channel == TIME and guess.joint else 0  # the time of one group: that of all where there is none
            claims.append(Claim(column, guess.channel, joint, guess.rank + later, False, guess.unit, guess.side, guess.doubt))
    return claims


def _joints(
    chosen: Mapping[tuple[str, str], Claim], options: LogOptions, path: Path, columns: Sequence[Column], left: Sequence[str]
) -> tuple[dict[str, list[Claim]], list[str], set[str]]:
    """Channels of every wanted joint, by the joint's name in the log; texts about omitted columns; columns used."""
    found: dict[str, list[Claim]] = {}
    named = [joint for joint in dict.fromkeys(joint for joint, _ in chosen) if joint]
    still = any(joint == "" and channel in MEASURED_MOTION and not claim.given for (joint, channel), claim in chosen.items())
    only = named[0] if len(named) == 1 and not still else ""
    for (joint, channel), claim in chosen.items():
        # A column without a joint is the only joint's.
        alone = only if claim.given or (only, channel) not in chosen else ""
        found.setdefault(joint or alone, []).append(claim)
    if not found:
        raise GainroomError(
            f"{path}: has none of the columns {', '.join(name for name in CHANNELS if name != TIME)}; it has {_names(columns)}"
            + "".join(f"; {text}" for text in left)
        )
    notes = []
    moving = {joint for joint, claims in found.items() if any(claim.channel in MEASURED_MOTION or claim.given for claim in claims)}
    measured = moving or {joint for joint, claims in found.items() if any(not CHANNELS[claim.channel].commanded for claim in claims)}
    if measured and len(measured) < len(found):
        unmeasured = [joint for joint in found if joint not in measured]
        claim = found[unmeasured[0]][0]
        name = claim.column.name
        first = next(joint for joint in found if joint in measured)
        what = "nothing" if all(CHANNELS[claim.channel].commanded for joint in unmeasured for claim in found[joint]) else "no motion"
        typed = shlex.quote(f"{claim.channel}.{first or ONE_JOINT}={name}")
        notes.append(
            f"{what} is measured of {listed([joint or ONE_JOINT for joint in unmeasured])}, left out "
            f"(to give a column to a joint: --columns {typed})"
        )
        found = {joint: claims for joint, claims in found.items() if joint in measured}
    places = {column.name: place for place, column in enumerate(columns)}
    order = sorted(found.items(), key=lambda item: min(places[claim.column.name] for claim in item[1]))
    wanted = {joint or ONE_JOINT: claims for joint, claims in order}
    chosen_joints = {joint: claims for joint, claims in wanted.items() if options.wants(joint)}
    if not chosen_joints:
        raise GainroomError(
            f"{path}: none of its joints is {listed([shown(name) for name in options.joints], 'or')}; it has "
            + "; ".join([first_of_many([*wanted]), *left])
        )
    return chosen_joints, notes, {claim.column.name for claims in found.values() for claim in claims}


def _origin(claim: Claim, joint: str, options: LogOptions, path: Path) -> Origin:
    """Origin of a claim's column, with its unit: from the user, the file, the column's name, or SI."""
    channel, column = claim.channel, claim.column
    dimension = CHANNELS[channel].dimension
    owner = f"{path}: column {column.name!r}"
    if channel in options.units:
        unit, source = options.units[channel], "given"
    elif column.unit == UNKNOWN:
        return Origin(channel, joint, column.name, UNKNOWN, 1.0, "given" if claim.given else "name", "unknown")
    elif column.unit:
        unit, source = known_unit(column.unit, dimension), "file"
        if unit is None:
            raise GainroomError(
                f"{owner} says its unit is {shown(column.unit)}, which is none of {dimension}; state it in units: {channel}=…"
            )
    elif claim.unit:
        unit, source = claim.unit, "name"
    else:
        unit, source = SI[dimension], "convention" if claim.rank == 0 and channel != TIME else "assumed"
    return Origin(channel, joint, column.name, unit, options.scale(channel, unit, owner), "given" if claim.given else "name", source)
