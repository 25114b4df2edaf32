"""Which channel of which joint a column holds, by its name."""

import re
from dataclasses import dataclass
from functools import cache

from ...simulation.run_record import REFERENCE_SIGNAL
from .channels import CHANNELS, words
from .units import known_unit

OTHER = frozenset(
    words(
        """enable enabled limit limits max min error err temperature temp volt volts voltage status state mode flag flags count counter
        index id norm std cov covariance quat orientation integral offset gain kp kd ki step rate delta diff bias foot base imu gyro acc
        header stamp sec nanosec start"""
    )
)
"""Words beside a channel's name that make it something else."""
CONTAINERS = frozenset(
    words(
        """log logs data robot out logsout yout record recording states joint_states signals values run ans result sensors controller
        controllers"""
    )
)
"""Parts of a path that name no joint."""
COMMANDING = frozenset(words("command commands commanded cmd cmds target targets desired des reference ref setpoint setpoints goal goals"))
"""Words that make what they stand beside, and what is below them in a path, a command."""
MEASURING = frozenset(words("state states feedback measured actual status"))
"""The same of what is measured."""
COMMAND_OF = {"motor_position": REFERENCE_SIGNAL, "motor_velocity": "reference_velocity", "actual_torque": "target_torque"}
"""What a channel's name is beside such a word: `/joint_commands` has an `effort`, as `/joint_states` has."""
LESS_SURE = 100
"""Ranks that a name found so is behind one that says it itself."""
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
PLURALS = {"positions": "position", "velocities": "velocity", "efforts": "effort", "torques": "torque", "currents": "current"}
BRACKETED = re.compile(r"[\s_]*[\[(<{]([^\])>}]*)[\])>}]\s*$")


@dataclass(frozen=True)
class Guess:
    """What a column's name says.

    channel   one of CHANNELS
    joint     "" where it names none
    unit      "" where it names none
    rank      place of the words found among those that mean this channel; 0 is its own name
    """

    channel: str
    joint: str
    unit: str
    rank: int


@cache
def _spellings() -> dict[tuple[str, ...], tuple[str, int]]:
    """Words → channel and rank; a name written in one word (`dofpos`) is not looked for."""
    found: dict[tuple[str, ...], tuple[str, int]] = {}
    for channel in CHANNELS.values():
        for rank, name in enumerate((channel.name, *channel.names)):
            found.setdefault(tuple(name.split("_")), (channel.name, rank))
    return found


def channel_of(text: str, whole: bool = False, commanded: bool = False) -> Guess | None:
    """What a column called `text` holds; None where the name says nothing.

    whole       the joint is known otherwise: what stands before the channel's name is no joint's, and nothing may stand behind it
    commanded   it stands among commands
    """
    if whole:
        above, _, text = text.rpartition("/")
        commanded = is_commanding(above, commanded)
    own = None if whole else _own(text)
    if own is not None:
        return own
    text, unit = _without_unit(text)
    for dimension_unit, spans in _readings(text, unit):
        found = _match(text, spans, whole)
        if found is None:
            continue
        channel, rank, left = found
        joint = "" if whole else joint_in(left)
        dimension = CHANNELS[channel].dimension
        if dimension_unit and known_unit(dimension_unit, dimension) is None:
            if dimension_unit != unit:
                continue  # the last word was no unit of this channel: read it as part of a name
            dimension_unit = ""
        if channel == "time" and joint and not left.endswith(("/", ".")):
            continue
        if is_commanding(left, commanded and rank > 0) and not CHANNELS[channel].commanded:
            if channel not in COMMAND_OF:
                return None
            channel, rank = COMMAND_OF[channel], rank + LESS_SURE
        return Guess(channel, joint, dimension_unit, rank)
    return None


def is_commanding(path: str, otherwise: bool = False) -> bool:
    """Whether a path, as of a topic, is that of commands: its last part that says so decides."""
    for part in reversed(re.split(r"[/.]", path)):
        said = {word[0].lower() for word in WORD.finditer(part)}
        if said & COMMANDING:
            return True
        if said & MEASURING:
            return False
    return otherwise


def _own(text: str) -> Guess | None:
    """A column as logs of this package name it, whatever the joint is called."""
    for name in sorted(CHANNELS, key=len, reverse=True):
        rest = text[len(name) + 1 :]
        if text == name or (name != "time" and rest and text.startswith(f"{name}_")):
            if rest.lower() in COMMANDING:
                return None
            unit = rest if len(rest) > 1 and known_unit(rest, CHANNELS[name].dimension) else ""
            return Guess(name, "" if unit else rest, unit, 0)
    return None


def _without_unit(text: str) -> tuple[str, str]:
    """`torque [Nm]` as its name and unit. An index, `q[3]`, stays."""
    found = BRACKETED.search(text)
    if found and not found[1].strip().isdigit() and any(known_unit(found[1], channel.dimension) for channel in CHANNELS.values()):
        return text[: found.start()], found[1]
    return text, ""


def _readings(text: str, unit: str) -> list[tuple[str, list[re.Match[str]]]]:
    """Words of a name, and its unit: its last one or two words may be one (`pos_deg`, `vel_rad_s`), or not."""
    words = list(WORD.finditer(text))
    readings = [(unit, words)]
    if not unit:
        if len(words) > 2:
            readings.insert(0, (f"{words[-2][0]}/{words[-1][0]}", words[:-2]))
        if len(words) > 1:
            readings.insert(0, (words[-1][0], words[:-1]))
        readings = [each for each in readings if not each[0] or any(known_unit(each[0], c.dimension) for c in CHANNELS.values())]
    return readings


def _match(text: str, spans: list[re.Match[str]], whole: bool) -> tuple[str, int, str] | None:
    """Channel, rank and what else the name says: the longest name of a channel at either end of the words, the surer one of two as long."""
    words = [PLURALS.get(span[0].lower(), span[0].lower()) for span in spans]
    above = max(text.rfind("/"), text.rfind("."))  # words before are of what the column is in
    best: tuple[tuple[int, int, int], str, int, str] | None = None
    for count in range(min(len(words), 4), 0, -1):
        for at_end in (False, True):
            start = len(words) - count if at_end else 0
            known = _spellings().get(tuple(words[start : start + count]))
            if known is None or (whole and start + count != len(words)):
                continue
            others = [
                word for k, word in enumerate(words) if not (start <= k < start + count or (spans[k].end() <= above and word in MEASURING))
            ]
            if OTHER.intersection(words[start - 1 : start] if whole else others):
                return None
            left = text[: spans[start].start()] if at_end else text[spans[count - 1].end() : spans[-1].end()]
            key = (count, -known[1] if count == len(words) else 0, int(at_end == (above > 0)))
            if best is None or key > best[0]:
                best = (key, *known, left)
        if best is not None:
            break
    return best[1:] if best is not None else None


def joint_in(path: str) -> str:
    """The joint's name in what is left of a column's, or in a topic's: the last part of a path that names one."""
    parts = (_joint_part(part) for part in re.split(r"[/.]", path.strip("_ ./-[](){}<>:")))
    return ([part for part in parts if part] or [""])[-1]


def _joint_part(part: str) -> str:
    """Without the words for commands and states: `l_knee_cmd` as l_knee, `joint_states` as nothing."""
    if part.lower() in CONTAINERS:
        return ""
    name, bracket, index = part.partition("[")
    kept = [piece for piece in name.split("_") if piece.lower() not in COMMANDING | MEASURING]
    name = "" if {piece.lower() for piece in kept} <= CONTAINERS | {"joint", "joints"} else "_".join(kept).strip("_ -](){}<>:")
    return f"{name}[{index.rstrip(']')}]" if name and bracket else name or index.rstrip("]")
