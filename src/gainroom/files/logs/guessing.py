"""Which channel of which joint a column holds, by its name."""

import re
from dataclasses import dataclass
from functools import cache

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
    words("log logs data robot out logsout yout record recording states joint_states signals values run ans result sensors")
)
"""Parts of a path that name no joint."""
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


def channel_of(text: str, whole: bool = False) -> Guess | None:
    """What a column called `text` holds; None where the name says nothing.

    whole   the joint is known otherwise: what stands before the channel's name is no joint's, and nothing may stand behind it
    """
    if whole:
        text = text.rsplit("/", 1)[-1]
    own = None if whole else _own(text)
    if own is not None:
        return own
    text, unit = _without_unit(text)
    for dimension_unit, spans in _readings(text, unit):
        found = _match(text, spans, whole)
        if found is None:
            continue
        channel, rank, joint = found
        dimension = CHANNELS[channel].dimension
        if dimension_unit and known_unit(dimension_unit, dimension) is None:
            if dimension_unit != unit:
                continue  # the last word was no unit of this channel: read it as part of a name
            dimension_unit = ""
        if channel == "time" and joint:
            continue
        return Guess(channel, joint, dimension_unit, rank)
    return None


def _own(text: str) -> Guess | None:
    """A column as logs of this package name it, whatever the joint is called."""
    for name in sorted(CHANNELS, key=len, reverse=True):
        rest = text[len(name) + 1 :]
        if text == name or (name != "time" and rest and text.startswith(f"{name}_")):
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
    """Channel, rank and joint: the longest name of a channel at either end of the words, the surer one of two as long."""
    words = [PLURALS.get(span[0].lower(), span[0].lower()) for span in spans]
    best: tuple[tuple[int, int, int], str, int, str] | None = None
    for count in range(min(len(words), 4), 0, -1):
        for at_end in (False, True):
            start = len(words) - count if at_end else 0
            known = _spellings().get(tuple(words[start : start + count]))
            if known is None or (whole and start + count != len(words)):
                continue
            others = words[:start] + words[start + count :]
            if OTHER.intersection(words[start - 1 : start] if whole else others):
                return None
            left = text[: spans[start].start()] if at_end else text[spans[count - 1].end() : spans[-1].end()]
            key = (count, -known[1] if count == len(words) else 0, int(not at_end))
            if best is None or key > best[0]:
                best = (key, *known, "" if whole else _joint(left))
        if best is not None:
            break
    return best[1:] if best is not None else None


def _joint(text: str) -> str:
    """The joint's name in what is left of a column's: the last part of a path that is no container's."""
    parts = [part for part in re.split(r"[/.]", text.strip("_ ./-[](){}<>:")) if part and part.lower() not in CONTAINERS]
    return parts[-1] if parts else ""
