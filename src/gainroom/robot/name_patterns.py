"""Joint selection by regular expression: a pattern matches a whole name, or equals one, and later patterns win.

Patterns come from files, and Python's matcher may need exponential time. The number of ways is bounded beforehand: the ways of a sequence
multiply, those of alternatives add up, and a part that can be matched in several ways must not be repeated.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

from ..errors import GainroomError, Together, nearest

DEFAULT = "default"
"""Key that stands for every joint and is applied before all patterns."""
LONGEST = 200
"""Most characters of a pattern or of a name."""
MOST_WAYS = 1e5
"""Most ways to match one pattern; the matcher tries so many in about a millisecond."""
MOST_TRIES = 1e8
"""Most ways of all patterns of one section, times names."""
TYPICAL = 40
"""Least name length that is assumed when the ways of a repeat are counted."""
_CLASS_OR_ESCAPE = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*\]", re.DOTALL)
_OPEN_CLASS = re.compile(r"\\.|\[\^?\]?(?:\\.|[^\]\\])*", re.DOTALL)
_NESTED = re.compile(r"\[\^?\[|\[.*(?:--|&&|~~|\|\|)", re.DOTALL)
"""Character classes whose meaning Python is about to change and warns of; warning filters are global to the process."""
_TOKEN = re.compile(r"\(\?(?:[:=!]|<[=!])|[*+?]\??|\{[0-9]*,?[0-9]*\}\??|.", re.DOTALL)

Value = TypeVar("Value")


def compile_pattern(pattern: str, owner: str, length: int = TYPICAL) -> re.Pattern[str]:
    """Compiled pattern for names of up to `length` characters, bounded in time. Raises GainroomError, naming `owner`."""
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
    """Beginning of a message about a pattern; `owner` may be the pattern's own key."""
    return owner if owner.endswith(repr(pattern)) else f"{owner}: {pattern!r}"


def _bare(pattern: str) -> str:
    """Pattern with plain characters in place of classes and escapes."""
    return _CLASS_OR_ESCAPE.sub("x", pattern)


def _ways(pattern: str, length: int) -> float:
    """Number of ways in which a matcher may try a well-formed pattern on a name of `length` characters."""
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
    """Indices of the joint `names` that `pattern` matches from end to end; a pattern equal to a name selects that joint.

    Raises GainroomError, naming `owner`, if the pattern is malformed or matches none.
    """
    found = _matches(pattern, names, owner)
    if not found:
        raise GainroomError(f"{_about(pattern, owner)} matches no joint; {_instead(pattern, names)}")
    return found


def _matches(pattern: str, names: Sequence[str], owner: str) -> tuple[int, ...]:
    """Indices of `names` that `pattern` matches, possibly none; see select."""
    if pattern in names:
        return (names.index(pattern),)
    matcher = compile_pattern(pattern, owner, _length(names))
    if any(len(name) > LONGEST for name in names):
        raise GainroomError(f"{owner}: a joint's name must have at most {LONGEST} characters to be matched with patterns")
    return tuple(index for index, name in enumerate(names) if matcher.fullmatch(name))


def _instead(pattern: str, names: Sequence[str]) -> str:
    """Hint for a pattern that matches no whole name: a looser pattern, or a name with similar letters."""
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
    """Length of the longest name that can be matched, at least TYPICAL."""
    return max([TYPICAL, *(min(len(name), LONGEST) for name in names)])


def select_all(
    patterns: Iterable[str], names: Sequence[str], owner: str, each: Callable[[str], str] | None = None, all_match: bool = True
) -> list[tuple[int, ...]]:
    """Indices for every pattern, see select; `each` makes the owner in the message of one pattern.

    all_match   True: every pattern must match; False: one that matches nothing gets ()

    Raises GainroomError if matching would take too long.
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
    """Values of the patterns that match each name, weakest first: `default`, then in the order given.

    Raises GainroomError if a pattern is malformed or matches nothing, or if matching would take too long.
    """
    result: list[list[Value]] = [[values[DEFAULT]] if DEFAULT in values else [] for _ in names]
    patterns = [pattern for pattern in values if pattern != DEFAULT]
    for pattern, found in zip(patterns, select_all(patterns, names, owner, lambda pattern: f"{owner}.{pattern!r}"), strict=True):
        for index in found:
            result[index].append(values[pattern])
    return result


def strongest(values: Mapping[str, Value], names: Sequence[str], owner: str) -> list[Value | None]:
    """Value of the last pattern that matches each name; None where none does. Raises GainroomError as assign."""
    return [found[-1] if found else None for found in assign(values, names, owner)]
