"""Reader of gain arrays in C, C++ or plain text: `std::array<float, 29> Kp{60, 60.0f, …};`, `kp = [60, 60]`, or `kp: 60 60` on a line.

Only numbers and names in quotes are understood in an array; comments are passed over.
"""

import re
from functools import partial
from typing import Any

from ...errors import GainroomError, all_of, refuse_all
from ...io.yaml_text import shown
from .gain_arrays import KP, ArrayNames, OrderedGains, part_of, read_arrays

COMMENT = re.compile(r"/\*.*?(?:\*/|\Z)|//[^\n]*|#[^\n]*", re.DOTALL)
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?[fF]?")
NAME = r"(?<![\w.>])([A-Za-z_]\w{0,80})\b[ \t]{0,40}"
ARRAY = re.compile(rf"{NAME}(?:\[\w{{0,40}}\][ \t]{{0,40}})?(?:[=:]\s{{0,40}}[{{\[(]|{{)([^{{}}\[\]();]*)[}}\])]", re.IGNORECASE)
LINE = re.compile(rf"^[ \t]{{0,40}}{NAME}[=:]?[ \t]{{0,40}}([-+.\d\"'][^\n]*)$", re.IGNORECASE | re.MULTILINE)
"""Pattern of an array that is the rest of a line, in plain text."""
ENUM = re.compile(r"\benum\b[^{};]{0,200}\{([^{}]*)\}")
ENUMERATOR = re.compile(r"([A-Za-z_]\w{0,199})\s*(?:=\s*(\d{1,4}))?")


def read_array_text(text: str, source: str, is_code: bool) -> OrderedGains:
    """Arrays of kp and kd in a text that messages call `source`; `is_code`: an array needs brackets. Raises GainroomError."""
    bare = COMMENT.sub(lambda found: re.sub(r"[^\n]", " ", found.group()), text)  # places stay
    data: dict[str, Any] = {}
    lines: dict[str, int] = {}

    def read(found: re.Match[str]) -> None:
        name, content = found.groups()
        if part_of(name) is None or not content.strip():
            return  # a member's initialiser: kp = {}
        line = bare.count("\n", 0, found.start(1)) + 1
        if name in lines:
            raise GainroomError(f"{source}: line {line}: {name} is given twice, first in line {lines[name]}; leave one in the file")
        lines[name] = line
        data[name] = _items(content, f"{source}: line {line}: {name}")

    all_of(partial(read, found) for pattern in ((ARRAY,) if is_code else (ARRAY, LINE)) for found in pattern.finditer(bare))
    if not any(name.lower() in KP for name in data):
        raise GainroomError(f"{source}: holds no array of kp: Kp{{60, 60, …}}, or kp: 60 60, with one number per joint")
    return read_arrays(data, ArrayNames.of(data, _enumerated(bare, data)), source, lines)


def _items(content: str, owner: str) -> list[Any]:
    items, wrong = [], []
    for part in content.replace(",", " ").split():
        if NUMBER.fullmatch(part):
            items.append(float(part.rstrip("fF")))
        elif re.fullmatch(r"\"[^\"]{1,200}\"|'[^']{1,200}'", part):
            items.append(part[1:-1])
        else:
            wrong.append(f"{owner}: {shown(part)} must be a number, or a name in quotes")
    refuse_all(wrong)
    return items


def _enumerated(text: str, data: dict[str, Any]) -> dict[int, tuple[str, ...]]:
    """Names by number in the enumeration with as many entries as there are gains."""
    count = next(len(value) for name, value in data.items() if name.lower() in KP)
    for found in ENUM.finditer(text):
        numbers: dict[int, tuple[str, ...]] = {}
        value = -1
        for name, given in ENUMERATOR.findall(found.group(1)):
            value = int(given) if given else value + 1
            numbers[value] = (*numbers.get(value, ()), name)
        if len(numbers) == count:
            return numbers
    return {}
