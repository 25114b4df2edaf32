"""Joint names chosen by regular expression: a pattern must match a whole name, or be one, and later patterns win.

Patterns come from files, and Python's matcher may try exponentially many ways. They are counted beforehand: the ways of a sequence
multiply, those of alternatives add up, and what can be matched in several ways must not be repeated.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

from ..errors import GainroomError, Together, nearest

DEFAULT = "default"
"""The key that stands for every joint, before all patterns."""
LONGEST = 200
"""Characters of a pattern or of a name."""
MOST_WAYS = 1e5
"""Of one pattern, tried in about a millisecond."""
MOST_TRIES = 1e8
"""Ways of all patterns of one section, times names."""
TYPICAL = 40
"""Characters of a name at least, for counting what a repeat may try."""
_CLASS_OR_ESCAPE = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]", re.DOTALL)
_OPEN_CLASS = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*", re.DOTALL)
_NESTED = re.compile(r"\[\^?\[|\[.*(?:--|&&|~~|\|\|)", re.DOTALL)
"""Classes whose meaning is to change, of which Python warns; its filters of warnings are the whole process's."""
_TOKEN = re.compile(r"\(\?(?:[:=!]|<[=!])|[*+?]\??|\{[0-9]*,?[0-9]*\}\??|.", re.DOTALL)

Value = TypeVar("Value")


def compile_pattern(pattern: str, owner: str, length: int = TYPICAL) -> re.Pattern[str]:
    """`pattern` ready to match names of up to `length` characters, bounded in time. Raises GainroomError that names `owner`."""
    if len(pattern) > LONGEST:
        raise GainroomError(f"{owner}: a pattern of {len(pattern)} characters must have at most {LONGEST}")
    if any(map(_NESTED.match, _OPEN_CLASS.findall(pattern))):
        raise GainroomError(f"{_about(pattern, owner)} is not a regular expression: a class [ ] inside a class, or --, &&, ~~ or || in one")
    try:
        compiled = re.compile(pattern)
    except (re.error, OverflowError) as error:
        raise GainroomError(f"{_about(pattern, owner)} is not a regular expression: {error}") from error
    if re.search(r"\((?!\?(?:[:=!]|<[=!]))\?", _bare(pattern)):
        raise GainroomError(f"{_about(pattern, owner)} may have groups ( ) and (?: ), and no other extensions (?…)")
    if _ways(pattern, length) > MOST_WAYS:
        raise GainroomError(f"{_about(pattern, owner)} can match in too many ways; use fewer *, + and |, and repeat no group of them")
    return compiled


def _about(pattern: str, owner: str) -> str:
    """How a message about a pattern begins; `owner` may be the pattern's own key."""
    return owner if owner.endswith(repr(pattern)) else f"{owner}: {pattern!r}"


def _bare(pattern: str) -> str:
    """`pattern` with plain characters for classes and escapes."""
    return _CLASS_OR_ESCAPE.sub("x", pattern)


def _ways(pattern: str, length: int) -> float:
    """In how many ways a matcher may try a well-formed pattern on a name of `length` characters."""
    # for each open group: of finished alternatives, of the sequence so far, of its last part
    groups = [[0.0, 1.0, 1.0]]
    for token in _TOKEN.findall(_bare(pattern)):
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
            group[2] = length if group[2] == 1 else math.inf
        else:
            group[1:] = [group[1] * group[2], 1.0]
    done, sequence, last = groups[0]
    return done + sequence * last


def select(pattern: str, names: Sequence[str], owner: str) -> tuple[int, ...]:
    """Indices of the joint `names` that `pattern` matches from end to end; a pattern that is itself one of the names means that one.

    Raises GainroomError, naming `owner`, where the pattern is malformed or matches none.
    """
    found = _matches(pattern, names, owner)
    if not found:
        raise GainroomError(f"{_about(pattern, owner)} matches no joint; {_instead(pattern, names)}")
    return found


def _matches(pattern: str, names: Sequence[str], owner: str) -> tuple[int, ...]:
    """As select, and none where it matches none."""
    if pattern in names:
        return (names.index(pattern),)
    matcher = compile_pattern(pattern, owner, _length(names))
    if any(len(name) > LONGEST for name in names):
        raise GainroomError(f"{owner}: a joint's name must have at most {LONGEST} characters to be matched with patterns")
    return tuple(index for index, name in enumerate(names) if matcher.fullmatch(name))


def _instead(pattern: str, names: Sequence[str]) -> str:
    """What may have been meant by a pattern that matches no whole name: a part of names, or a name in other letters."""
    inner = f"(?:{pattern})" if "|" in pattern else pattern
    loose = f"{'' if inner.startswith('.*') else '.*'}{inner}{'' if inner.endswith('.*') else '.*'}"
    try:
        matcher = compile_pattern(loose, "", _length(names))
    except GainroomError:  # matches in too many ways to be tried
        matcher = None
    parts = [name for name in names if matcher and matcher.fullmatch(name)]
    more = f" and {len(parts) - 1} more" if len(parts) > 1 else ""
    hint = f": try {loose!r} ({parts[0]}{more})" if parts else ""
    return f"it must match a whole name{hint}{nearest(pattern, names, 'joint')}"


def _length(names: Sequence[str]) -> int:
    """Of the longest name that is matched."""
    return max([TYPICAL, *(min(len(name), LONGEST) for name in names)])


def select_all(
    patterns: Iterable[str], names: Sequence[str], owner: str, each: Callable[[str], str] | None = None, all_match: bool = True
) -> list[tuple[int, ...]]:
    """As select, for every pattern; `each` makes the owner of one pattern's message. Raises GainroomError where they would take long.

    all_match   whether every pattern must match; or else one that matches nothing has no index
    """
    found, tries, length, chosen = [], 0.0, _length(names), select if all_match else _matches
    with Together() as together:
        for pattern in patterns:
            found.append(together.step(lambda pattern=pattern: chosen(pattern, names, owner if each is None else each(pattern))))
            tries += 0.0 if pattern in names or not found[-1].is_made else len(names) * _ways(pattern, length)
            if tries > MOST_TRIES:
                raise GainroomError(f"{owner}: these patterns can match in too many ways together; use fewer, or fewer * in them")
        return [indices() for indices in found]


def assign(values: Mapping[str, Value], names: Sequence[str], owner: str) -> list[list[Value]]:
    """For each name, the values of the patterns that match it, weakest first: `default`, then in the order given.

    Raises GainroomError where a pattern is malformed or matches nothing, and where they would take too long to match.
    """
    result: list[list[Value]] = [[values[DEFAULT]] if DEFAULT in values else [] for _ in names]
    patterns = [pattern for pattern in values if pattern != DEFAULT]
    for pattern, found in zip(patterns, select_all(patterns, names, owner, lambda pattern: f"{owner}.{pattern!r}"), strict=True):
        for index in found:
            result[index].append(values[pattern])
    return result


def strongest(values: Mapping[str, Value], names: Sequence[str], owner: str) -> list[Value | None]:
    """For each name, the value of the last pattern that matches it, None where none does. Raises GainroomError as assign."""
    return [found[-1] if found else None for found in assign(values, names, owner)]
