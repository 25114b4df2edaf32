"""Differences between two recordings of a case, for a developer to read, and a summary of them by kind."""

import difflib
import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from .running import MARK, as_json

NEAR = 1e-6
"""Relative: numbers in JSON that differ by less are the same."""
IDENTIFIED = 1e-3
"""Bound like NEAR of numbers that `identify` finds, ends of a least-squares search: another processor's round-off moved one by 4e-4."""
JUDGED = {
    *("verdict", "safe", "stable", "stable_in_range", "requirements_met", "unmet", "agrees", "diverged", "fell", "vibrates", "unstable"),
    *("held_by", "adequate", "gain_margin_met", "certified", "ready", "proved", "range_proved"),
}
"""Keys of JSON whose values are verdicts, as lists of words, words, or yes and no."""
SHOWN = 12
"""Lines of each kind in a summary."""


def sections(text: str) -> dict[str, str]:
    """The parts of a recording by their headings, each behind the command line that it belongs to."""
    found: dict[str, str] = {}
    command = ""
    for part in text.split(MARK)[1:] if text.startswith(MARK) else ():
        heading, _, content = part.partition("\n")
        if heading.startswith("$ "):
            command = heading
        elif heading.startswith("exit status "):
            found[f"{command}: exit status"] = heading.removeprefix("exit status ")
        else:
            found[f"{command}: {heading}"] = content
    return found


def settled(old: str, new: str) -> str:
    """`new` with the old digits of JSON's numbers that are near the old ones."""
    before, parts = sections(old), new.split(MARK)
    command = ""
    for index, part in enumerate(parts):
        heading, _, content = part.partition("\n")
        command = heading if heading.startswith("$ ") else command
        was, now = (_json(text) for text in (before.get(f"{command}: {heading}", ""), content))
        if was is not None and now is not None:
            near = IDENTIFIED if command.startswith("$ gainroom identify") else NEAR
            lines = as_json(_nearest(was, now, near)).split("\n")
            parts[index] = heading + "\n" + "".join(f"  {line}\n" for line in lines)
    return MARK.join(parts)


def _json(text: str) -> Any:
    """What stands under a heading as JSON; None where that is none."""
    try:
        return json.loads(text) if text.lstrip().startswith("{") else None
    except ValueError:
        return None


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _nearest(old: Any, new: Any, near: float, of_difference: bool = False) -> Any:
    """`new` with the numbers of `old` that are near and stand in the same place: of relative differences, as near as what they compare."""
    if isinstance(old, dict) and isinstance(new, dict):
        return {key: _nearest(old[key], value, near, key.endswith("_difference")) if key in old else value for key, value in new.items()}
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return [_nearest(one, other, near) for one, other in zip(old, new, strict=True)]
    if is_number(old) and is_number(new) and math.isclose(old, new, rel_tol=near, abs_tol=near if of_difference else 0.0):
        return old
    return new


def difference(name: str, old: str, new: str) -> list[str]:
    """The lines of a unified diff; none where the two are the same."""
    lines = old.splitlines(), settled(old, new).splitlines()
    return [*difflib.unified_diff(*lines, f"recorded/{name}", f"now/{name}", n=2, lineterm="")]


@dataclass
class Summary:
    """Of all cases that differ: what changed, by kind."""

    cases: list[str] = field(default_factory=list)
    statuses: list[str] = field(default_factory=list)
    verdicts: list[str] = field(default_factory=list)
    gone: Counter[str] = field(default_factory=Counter)
    added: Counter[str] = field(default_factory=Counter)
    numbers: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    words: Counter[str] = field(default_factory=Counter)

    def count(self, name: str, old: str, new: str) -> None:
        """Add one case that differs."""
        self.cases.append(name)
        before, after = sections(old), sections(new)
        for heading in [heading for heading in before if heading in after and before[heading] != after[heading]]:
            was, now = before[heading], after[heading]
            if heading.endswith(": exit status"):
                self.statuses.append(f"{name}: {was.strip()} → {now.strip()} ({heading.removesuffix(': exit status')})")
            elif (one := _json(was)) is not None and (other := _json(now)) is not None:
                self._count_json(name, dict(leaves(one)), dict(leaves(other)))
            else:
                self.words[heading.rpartition(": ")[2]] += 1
                if (one := first_words(was)) != (other := first_words(now)):
                    self.verdicts.append(f"{name}: {heading.rpartition(': ')[2]}: “{one}” → “{other}”")
        self.gone.update(kind(heading) for heading in before if heading not in after)
        self.added.update(kind(heading) for heading in after if heading not in before)

    def _count_json(self, name: str, old: dict[str, Any], new: dict[str, Any]) -> None:
        keys = [{without_places(path) for path in found} for found in (old, new)]
        self.gone.update(keys[0] - keys[1])
        self.added.update(keys[1] - keys[0])
        for path in [path for path in old if path in new and old[path] != new[path]]:
            was, now = old[path], new[path]
            if is_number(was) and is_number(now):
                if not math.isclose(was, now, rel_tol=NEAR):
                    self.numbers[without_places(path)].append(abs(now - was) / max(abs(was), abs(now)))
            elif not JUDGED.isdisjoint(re.split(r"[.\[]", path)):
                self.verdicts.append(f"{name}: {path}: {was} → {now}")
            elif is_number(was) or is_number(now):
                self.numbers[without_places(path)].append(math.inf)  # to or from null

    def text(self, total: int) -> str:
        """The summary as it is printed."""
        if not self.cases:
            return f"All {total} cases are as recorded."
        numbers = {key: f"{len(changes)} ×, by up to {max(changes):.2g}" for key, changes in self.numbers.items()}
        kinds = {
            "Exit statuses changed": self.statuses,
            "Verdict words changed": self.verdicts,
            "JSON keys and parts gone": [f"{key} ({count} cases)" for key, count in self.gone.most_common()],
            "JSON keys and parts added": [f"{key} ({count} cases)" for key, count in self.added.most_common()],
            f"Numbers changed by more than {NEAR:g}, relative": [f"{key}: {text}" for key, text in sorted(numbers.items())],
            "Texts changed": [f"{key}: {count} times" for key, count in self.words.most_common()],
        }
        lines = [f"{len(self.cases)} of {total} cases differ."]
        for title, found in kinds.items():
            lines += [f"{title}: {len(found) or 'none'}", *(f"  {each}" for each in found[:SHOWN])]
            lines += [f"  … {len(found) - SHOWN} more"] if len(found) > SHOWN else []
        return "\n".join(lines)


def kind(heading: str) -> str:
    """A part of a recording without its file."""
    command, _, part = heading.rpartition(": ")
    return f"{' '.join(command.split()[1:3])}: {part}"


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every number, word and empty list of JSON with the path to it."""
    if isinstance(value, dict) and value:
        for key, each in value.items():
            yield from leaves(each, f"{path}.{key}" if path else key)
    elif isinstance(value, list) and value:
        for index, each in enumerate(value):
            yield from leaves(each, f"{path}[{index}]")
    else:
        yield path, value


def without_places(path: str) -> str:
    return re.sub(r"\[\d+\]", "[]", path)


def first_words(text: str) -> str:
    """The beginning of an answer or a page, up to the first number: where a verdict stands; of a page with the mark of its body."""
    lines = [line.strip() for line in text.strip().splitlines()]
    start = " ".join(lines[:3] if lines and lines[0].startswith("body:") else lines[:1])
    return re.split(r"\d|: (?!good|bad|warn|bare)|\. |;", start)[0].strip()
