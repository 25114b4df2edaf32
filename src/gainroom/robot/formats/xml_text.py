"""Reading XML with bounds: any file costs little time and memory, and an error is one line.

Document types and entities have no use in a robot file and are refused before they are read, so nothing expands. Namespace prefixes are
part of a name, bound or not, as robot files have them.
"""

import re
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from ...errors import GainroomError
from ...io.bounded_text import bounded_text

MAX_BYTES = 50 * 2**20
MAX_ELEMENTS = 100_000
MAX_ATTRIBUTES = 200
MAX_DEPTH = 400
"""Below tinyxml2's own limit of 500, at which MuJoCo and Pinocchio stop with a message of theirs."""

WORDED = "mechanicalReduction"
"""The one element of a URDF that holds its number as text."""


def read_xml(path: Path) -> Element:
    """The root element of a UTF-8 XML file. Raises GainroomError, one line that names the file."""
    return parse_xml(bounded_text(path, MAX_BYTES, "a robot file"), str(path))


def parse_xml(text: str, source: str) -> Element:
    """The root element of an XML text, of character data only that of WORDED; messages call it `source`. Raises GainroomError."""
    if not text.strip():
        raise GainroomError(f"{source}: is empty; a robot is a URDF (<robot>) or an MJCF (<mujoco>)")
    reader = _Reader(source)
    try:
        reader.parser.Parse(text, True)
    except expat.ExpatError as error:
        problem = expat.ErrorString(error.code)
        if not text.lstrip().startswith("<"):
            problem = "is no XML; a robot is a URDF (<robot>) or an MJCF (<mujoco>)"
        elif problem in ("unclosed token", "no element found"):
            problem = "the file ends within an element: was it cut off?"
        raise GainroomError(f"{source}: line {error.lineno}, column {error.offset + 1}: {problem}") from error
    return reader.builder.close()


class _Reader:
    """Builder of the element tree from expat's events, within bounds on depth and number of elements."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.builder = TreeBuilder()
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.StartDoctypeDeclHandler = self._doctype
        self._depth = 0
        self._elements = 0

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        self._elements += 1
        if self._depth > MAX_DEPTH:
            raise self._refusal(f"elements are nested more than {MAX_DEPTH} deep")
        if self._elements > MAX_ELEMENTS:
            raise self._refusal(f"more than {MAX_ELEMENTS} elements")
        if len(attributes) > MAX_ATTRIBUTES:
            raise self._refusal(f"<{tag}> has more than {MAX_ATTRIBUTES} attributes")
        for key, value in attributes.items():
            # The libraries behind read on with it, or drop the whole element.
            if "nan" in value.lower() and re.search(r"(?i)(?<!\S)[-+]?nan(?!\S)", value):
                raise self._refusal(f"<{tag}> has {key}={value[:60]!r}; numbers must be finite")
        self.builder.start(tag, attributes)
        self.parser.CharacterDataHandler = self.builder.data if tag == WORDED else None

    def _end(self, tag: str) -> None:
        self._depth -= 1
        self.builder.end(tag)
        self.parser.CharacterDataHandler = None

    def _doctype(self, *_: object) -> None:
        raise self._refusal("document types and entities (<!DOCTYPE, <!ENTITY) are not allowed in a robot file")

    def _refusal(self, problem: str) -> GainroomError:
        return GainroomError(f"{self.source}: line {self.parser.CurrentLineNumber}: {problem}")
