"""Joint names chosen by regular expression: a pattern must match a whole name, or be one, and later patterns win.

Patterns come from files, and Python's matcher may try exponentially many ways. They are counted beforehand: the ways of a sequence
multiply, those of alternatives add up, and what can be matched in several ways must not be repeated.
"""

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import TypeVar

from ..errors import GainroomError
from ..messages import nearest

DEFAULT = "default"
"""The key that stands for every joint, before all patterns."""
LONGEST = 200
"""Characters of a pattern or of a name."""
MOST_WAYS = 1e5
TYPICAL = 40
"""Characters of a name, for counting what a repeat may try."""
_CLASS_OR_ESCAPE = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]", re.DOTALL)
_TOKEN = re.compile(r"\(\?(?:[:=!]|<[=!])|[*+?]\??|\{[0-9]*,?[0-9]*\}\??|.", re.DOTALL)

Value = TypeVar("Value")


def compile_pattern(pattern: str, owner: str) -> re.Pattern[str]:
    """`pattern` ready to match, bounded in time. Raises GainroomError that names `owner`."""
    if len(pattern) > LONGEST:
        raise GainroomError(f"{owner}: a pattern of {len(pattern)} characters must have at most {LONGEST}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", FutureWarning)  # "possible nested set": what it means will change
            compiled = re.compile(pattern)
    except (re.error, OverflowError, FutureWarning) as error:
        raise GainroomError(f"{owner}: {pattern!r} is not a regular expression: {error}") from error
    bare = _CLASS_OR_ESCAPE.sub("x", pattern)
    if re.search(r"\((?!\?(?:[:=!]|<[=!]))\?", bare):
        raise GainroomError(f"{owner}: pattern {pattern!r} may have groups ( ) and (?: ), and no other extensions (?…)")
    if _ways(bare) > MOST_WAYS:
        raise GainroomError(f"{owner}: pattern {pattern!r} can match in too many ways; use fewer *, + and |, and repeat no group of them")
    return compiled


def _ways(bare: str) -> float:
    """In how many ways a matcher may try a well-formed pattern whose classes and escapes have become plain characters."""
    # for each open group: of finished alternatives, of the sequence so far, of its last part
    groups = [[0.0, 1.0, 1.0]]
    for token in _TOKEN.findall(bare):
        group = groups[-1]
        if token[0] == "(":
            groups.append([0.0, 1.0, 1.0])
        elif token == ")" and len(groups) > 1:
            done, sequence, last = groups.pop()
            groups[-1][1:] = [groups[-1][1] * groups[-1][2], done + sequence * last]
        elif token == "|":
            group[:] = [group[0] + group[1] * group[2], 1.0, 1.0]
        elif token[0] == "?":
            group[2] += 1
        elif token[0] in "*+{":
            group[2] = TYPICAL if group[2] == 1 else math.inf
        else:
            group[1:] = [group[1] * group[2], 1.0]
    done, sequence, last = groups[0]
    return done + sequence * last


def select(pattern: str, names: Sequence[str], owner: str) -> tuple[int, ...]:
    """Indices of the joint `names` that `pattern` matches from end to end; a pattern that is itself one of the names means that one.

    Raises GainroomError, naming `owner`, where the pattern is malformed or matches none.
    """
    if pattern in names:
        return (names.index(pattern),)
    matcher = compile_pattern(pattern, owner)
    if any(len(name) > LONGEST for name in names):
        raise GainroomError(f"{owner}: a joint's name must have at most {LONGEST} characters to be matched with patterns")
    found = tuple(index for index, name in enumerate(names) if matcher.fullmatch(name))
    if not found:
        raise GainroomError(f"{owner}: {pattern!r} matches no joint{nearest(pattern, names, 'joint')}")
    return found


def assign(values: Mapping[str, Value], names: Sequence[str], owner: str) -> list[list[Value]]:
    """For each name, the values of the patterns that match it, weakest first: `default`, then in the order given.

    Raises GainroomError where a pattern is malformed or matches nothing.
    """
    result: list[list[Value]] = [[] for _ in names]
    if DEFAULT in values:
        for found in result:
            found.append(values[DEFAULT])
    for pattern, value in values.items():
        if pattern != DEFAULT:
            for index in select(pattern, names, f"{owner}.{pattern!r}"):
                result[index].append(value)
    return result
