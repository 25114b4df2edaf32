"""Docstrings as numpydoc reads them.

In the source they are plain text with aligned lists, `name   what it is`. Those become sections with a heading, and what stands
for itself there (|L|, x*, W_) is kept from meaning something to Sphinx.
"""

import re

from sphinx.application import Sphinx

FIRST = re.compile(r"^\w+(?:, \w+)* {2,}\S")
ROW = re.compile(r"^(\w+(?:, \w+)*) +(\S.*)$")
RAISES = re.compile(r"(?:^|(?<=\. ))Raises (GainroomError)(?:,| |$)")
MARKUP = re.compile(r"(`+[^`]+`+)|([|*]|(?<=\w)_(?!\w))")


def setup(app: Sphinx) -> dict[str, bool]:
    """Run before numpydoc does."""
    app.connect("autodoc-process-docstring", _process, priority=400)
    return {"parallel_read_safe": True}


def _process(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    lines[:] = sections(lines, "Parameters" if what in ("function", "method") else "Attributes")


def sections(lines: list[str], heading: str) -> list[str]:
    """`lines` with their aligned lists under `heading`, and what is raised under its own."""
    text, rows, raised = [], [], []
    for paragraph in re.split(r"\n\s*\n", escaped("\n".join(lines)).strip("\n")):
        if FIRST.match(paragraph):
            rows += _rows(paragraph.splitlines())
        else:
            before, found, after = _raises(paragraph)
            text += [*before, ""] if before else []
            raised += [found, f"    {after}"] if found else []
    result = text
    for title, body in ((heading, rows), ("Raises", raised)):
        result += [title, "-" * len(title), *body, ""] if body else []
    return result


def escaped(text: str) -> str:
    """`text` without meaning to reStructuredText, but for code between backticks."""
    return MARKUP.sub(lambda found: found[1] or "\\" + found[2], text)


def _rows(lines: list[str]) -> list[str]:
    result = []
    for line in lines:
        found = ROW.match(line)
        if not found and not line.startswith(" "):
            raise ValueError(f"neither a row of the list nor indented: {line}")
        result += [found[1], f"    {found[2]}"] if found else [f"    {line.strip()}"]
    return result


def _raises(paragraph: str) -> tuple[list[str], str, str]:
    """What stands before, the exception, and when it is raised."""
    joined = " ".join(line.strip() for line in paragraph.splitlines())
    found = RAISES.search(joined)
    if not found:
        return paragraph.splitlines(), "", ""
    return [joined[: found.start()].strip()] if found.start() else [], found[1], joined[found.end() :].strip()
