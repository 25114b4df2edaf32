"""The built site makes no request off the machine: the build fails where a page, a style or a script would load something from a host."""

import re
from html.parser import HTMLParser
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

LOADING = {"src", "srcset", "data", "poster", "action", "xlink:href", "background"}  # and href, but for links that a reader follows
IN_STYLE = re.compile(r"""(?:url\(\s*|@import\s+)["']?((?:https?:|wss?:)?//[^"')\s]+)""", re.IGNORECASE)
IN_SCRIPT = re.compile(r"""["'`]((?:https?:|wss?:)?//[^"'`\s]+)["'`]""", re.IGNORECASE)
NAMESPACE = re.compile(r"http://www\.w3\.org/")


def setup(app: Sphinx) -> dict[str, bool]:
    """Look at the site when it has been written."""
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True}


def _check(app: Sphinx, exception: Exception | None) -> None:
    if exception is None and app.builder.format == "html" and (found := requests(Path(app.outdir))):
        raise ExtensionError("the site would load:\n" + "\n".join(found))


def requests(folder: Path) -> list[str]:
    """What the files in `folder` would load from a host, as `file: address`."""
    return [f"{path.relative_to(folder)}: {address}" for path in sorted(folder.rglob("*")) for address in loaded(path)]


def loaded(path: Path) -> list[str]:
    """Addresses on a host that a page, a picture, a style or a script loads when it is shown."""
    if path.suffix in (".html", ".svg"):
        page = _Page()
        page.feed(path.read_text("utf-8"))
        return page.found
    if path.suffix == ".css":
        return IN_STYLE.findall(path.read_text("utf-8"))
    return [each for each in IN_SCRIPT.findall(path.read_text("utf-8")) if not NAMESPACE.match(each)] if path.suffix == ".js" else []


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self._inside = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside = tag
        for name, value in attrs:
            loads = name in LOADING or (name in ("href", "content") and tag not in ("a", "meta"))
            if loads and re.match(r"(?:https?:|wss?:)?//", value or ""):
                self.found.append(value or "")
            if name == "style":
                self.found += IN_STYLE.findall(value or "")

    def handle_data(self, data: str) -> None:
        self.found += IN_STYLE.findall(data) if self._inside == "style" else []
        self.found += IN_SCRIPT.findall(data) if self._inside == "script" else []
