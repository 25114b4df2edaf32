"""Assignment of a file's columns to channels from all their names together: columns used, columns dropped, questions to the user.

A column is never guessed where its name leaves open what it is, and a joint is never made of words that are not known: such columns are
left out, with the option that decides.
"""

import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ...errors import first_of_many
from .guessing import COMMAND_DOUBT, COMMAND_OF, INPUT_DOUBT, ROLE_DOUBT
from .table import TIME, Column

NUMBERED = re.compile(r"(?:joint|j|q|dof|motor|m|axis)_?([0-9]+)")
MOTION = {"motor_position": "link_position", "motor_velocity": "link_velocity"}
"""Channels of motion on the motor side, each with its channel on the link side."""
POSITIONS = ("motor_position", "link_position")
LONG = 6
"""Number of entries from which on an array belongs to a whole robot."""
KIND = {"motor_position": "position", "motor_velocity": "velocity", "actual_torque": "torque"}
OUTPUT_DOUBT = "at the gearbox's output, but measured there or computed from the motor's is not said"
MEASURED_MOTION = {*MOTION, *MOTION.values()}


@dataclass(frozen=True)
class Claim:
    """Column that may be a channel of a joint; of several candidates the one with the smallest `rank` is used.

    given   the user said so
    side, doubt   as in Guess
    """

    column: Column
    channel: str
    joint: str
    rank: int
    given: bool
    unit: str
    side: str = ""
    doubt: str = ""


@dataclass(frozen=True)
class Arranged:
    """Accepted claims, and texts about the others; `mentioned`: the columns that these texts name."""

    claims: list[Claim]
    notes: list[str]
    mentioned: set[str]


def arrange(claims: Iterable[Claim]) -> Arranged:
    """Arrangement of the claims of one file."""
    every = _outputs(_one_name(list(claims)))
    notes, mentioned = [], set()
    doubtful = [claim for claim in every if claim.doubt]
    standing = [claim for claim in every if not claim.doubt]
    standing, sided = _sides(standing)
    standing, strangers = _joints_that_are_none(standing)
    standing, uneven = _uneven(standing)
    strangers += uneven
    joints = {claim.joint for claim in standing}
    for doubt in dict.fromkeys(claim.doubt for claim in doubtful):
        notes.append(_asked([claim for claim in doubtful if claim.doubt == doubt], doubt, joints))
    mentioned = {claim.column.name for claim in (*doubtful, *sided, *(claim for claims, _ in strangers for claim in claims))}
    for claim in sided[:1]:
        other = flag(_other_side(claim.channel), claim)
        notes.append(f"column {claim.column.name!r} was taken as {claim.channel}: others are the motor's (else: {other})")
    notes += [_asked(claims, why, joints) for claims, why in strangers]
    return Arranged(standing, notes, mentioned)


def flag(channel: str, claim: Claim) -> str:
    """Option that assigns a column, and the columns of other joints with the same name pattern, to a channel."""
    name, joint = claim.column.name, claim.joint
    name = name.replace(joint, "{joint}") if joint else name
    return f"--columns {shlex.quote(f'{channel}={name}')}"


def _other_side(channel: str) -> str:
    return next(motor for motor, link in MOTION.items() if link == channel)


def _asked(claims: Sequence[Claim], why: str, joints: set[str]) -> str:
    """Note about unused columns with the option that would use the first of them.

    The joint is left out of the option if it is none of `joints`.
    """
    names = [claim.column.name for claim in claims]
    first = claims[0] if claims[0].joint in joints else replace(claims[0], joint="")
    verb = "columns" if len(names) > 1 else "column"
    channel = claims[0].channel
    ways = [flag(channel, first)]
    other = COMMAND_OF.get(channel) or next((measured for measured, command in COMMAND_OF.items() if command == channel), "")
    if why == COMMAND_DOUBT:
        ways.append(flag("reference", first))
    elif why == OUTPUT_DOUBT and channel in MOTION:
        ways = [flag(MOTION[channel], first)]
    elif why in (ROLE_DOUBT, INPUT_DOUBT) and other:
        ways.append(flag(other, first))
    return f"{verb} {first_of_many(names)} not used: {why} (to take it: {' or '.join(ways)})"


def _one_name(claims: list[Claim]) -> list[Claim]:
    """Claims with one joint name for joints that are numbered in two ways, such as `q1` and `tau_joint1`."""
    joints = {claim.joint for claim in claims}
    again = {joint: found[1] for joint in joints if (found := NUMBERED.fullmatch(joint)) and found[1] in joints}
    return [replace(claim, joint=again.get(claim.joint, claim.joint)) for claim in claims]


def _outputs(claims: list[Claim]) -> list[Claim]:
    """Claims, with doubt added to columns of the gearbox's output beside columns of the motor: measured on their own, or computed."""
    motors = {(claim.joint, KIND[claim.channel]) for claim in claims if claim.channel in KIND and claim.side == "motor" and not claim.given}
    return [
        replace(claim, doubt=OUTPUT_DOUBT) if claim.side == "output" and (claim.joint, KIND.get(claim.channel)) in motors else claim
        for claim in claims
    ]


def _uneven(claims: list[Claim]) -> tuple[list[Claim], list[tuple[list[Claim], str]]]:
    """Claims without arrays whose number of entries differs from that of the positions, and the removed ones with the reason.

    Of a robot on a free base entry 7 of `qpos` and entry 7 of `qvel` are two joints.
    """
    arrays: dict[str, list[Claim]] = {}
    for claim in claims:
        if claim.joint.isdigit() and not claim.given:
            arrays.setdefault(re.sub(r"[0-9]+", "#", claim.column.name), []).append(claim)
    whole = {name: array for name, array in arrays.items() if {int(claim.joint) for claim in array} == {*range(len(array))}}
    first = next((array for array in whole.values() if array[0].channel in POSITIONS), None)
    count = len(first or ())
    odd = [claim for array in whole.values() if min(len(array), count) >= LONG and len(array) != count for claim in array]
    if not odd:
        return claims, []
    gone = {id(claim) for claim in odd}
    why = f"they are not as many as the {count} positions, and which belongs to which joint is not known"
    return [claim for claim in claims if id(claim) not in gone], [(odd, why)]


def _sides(claims: list[Claim]) -> tuple[list[Claim], list[Claim]]:
    """Claims in which `joint_angle` beside `motor_angle` is the link's, and `q` beside `theta` too; and those that were changed."""
    changed: dict[int, Claim] = {}
    joints: dict[str, list[tuple[int, Claim]]] = {}
    for k, claim in enumerate(claims):
        if not claim.given:
            joints.setdefault(claim.joint, []).append((k, claim))
    for own in joints.values():
        motor = any(claim.channel in MOTION and claim.side == "motor" for _, claim in own)
        both = {"theta", "q"} <= {claim.side for _, claim in own if claim.channel == "motor_position"}
        for channel, other in MOTION.items():
            there = {claim.channel for _, claim in own}
            neutral = {"joint"} if motor else {"q"} if both else set()
            if other not in there:
                changed |= {k: replace(claim, channel=other) for k, claim in own if claim.channel == channel and claim.side in neutral}
    return [changed.get(k, claim) for k, claim in enumerate(claims)], [*changed.values()]


def _joints_that_are_none(claims: list[Claim]) -> tuple[list[Claim], list[tuple[list[Claim], str]]]:
    """Claims of certain joints, and the removed ones: without a name beside named ones, or with a name that extends another's."""
    channels: dict[str, set[str]] = {}
    for claim in claims:
        if claim.channel != TIME:
            channels.setdefault(claim.joint, set()).add(claim.channel)
    moving = [joint for joint, there in channels.items() if there & MEASURED_MOTION]
    named = [joint for joint in moving if joint]
    if "" in moving and len(named) == 1 and not channels[""] & channels[named[0]]:
        return [claim if claim.joint or claim.channel == TIME else replace(claim, joint=named[0]) for claim in claims], []
    gone: list[tuple[set[str], str]] = []
    if "" in moving and named:
        most = max(len(channels[joint]) for joint in named)
        if len(named) > 1 or most > len(channels[""]):
            gone.append(({""}, f"they name no joint, and others do ({first_of_many(named)})"))
        else:
            gone.append(({*named}, f"{first_of_many(named)} may be another joint, or something else of the only one"))
    placed = {joint for joint in named if channels[joint] & {*POSITIONS}}
    doubtful = {joint for joint in named if (placed and joint not in placed) or _holds_another(joint, channels)}
    if doubtful:
        gone.append((doubtful, "whether that is a joint of its own is not known"))
    return _without(claims, gone)


def _holds_another(joint: str, channels: Mapping[str, set[str]]) -> bool:
    """True if a joint's name extends another's and has fewer channels: `hip_left` beside `hip`."""
    parts = re.split(r"([_\W]+)", joint)
    shorter = {"".join(parts[first:last]) for first in range(0, len(parts), 2) for last in range(first + 1, len(parts) + 1, 2)}
    return any(channels[joint] < channels[other] for other in shorter - {joint, ""} if other in channels)


def _without(claims: list[Claim], gone: list[tuple[set[str], str]]) -> tuple[list[Claim], list[tuple[list[Claim], str]]]:
    left = []
    is_gone: Callable[[Claim, set[str]], bool] = lambda claim, joints: claim.joint in joints and claim.channel != TIME and not claim.given  # noqa: E731
    for joints, why in gone:
        out = [claim for claim in claims if is_gone(claim, joints)]
        claims = [claim for claim in claims if not is_gone(claim, joints)]
        if out:
            left.append((out, why))
    return claims, left
