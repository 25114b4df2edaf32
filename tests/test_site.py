"""The documentation site: offline, complete, and docstrings as it shows them (`make docs` builds all of it, warnings as errors)."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import gainroom as gr

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "site"))

from docstrings import sections  # noqa: E402
from offline import loaded  # noqa: E402


def test_every_page_is_in_the_contents():
    blocks = re.findall(r"```\{toctree\}\n(.*?)```", (DOCS / "index.md").read_text("utf-8"), re.DOTALL)
    listed = [line for block in blocks for line in block.splitlines() if line and not line.startswith(":")]
    assert sorted(listed) == sorted(path.stem for path in DOCS.glob("*.md") if path.stem != "index")


def test_every_public_name_is_in_the_reference():
    text = (DOCS / "api.md").read_text("utf-8")
    assert sorted(re.findall(r"^\.\. auto\w+:: (\w+)$", text, re.MULTILINE)) == sorted(gr.__all__)


def test_every_public_name_has_an_example():
    """Blocks of Python run in tests/test_docs.py."""
    pages = [path.read_text("utf-8") for path in DOCS.glob("*.md")]
    code = "\n".join(block for page in pages for block in re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL))
    assert [name for name in gr.__all__ if not re.search(rf"\bgr\.{name}\b", code)] == []


PAGE = """# A page

Stable while $L(j\\omega) \\ne -1$, and

$$ P = \\frac{1}{J s^2}. $$

<img src="https://example.org/picture.png" alt="a picture">
"""


@pytest.mark.slow
def test_a_page_with_formulas_needs_no_host_and_one_with_a_hosts_picture_is_refused(tmp_path: Path):
    (tmp_path / "index.md").write_text(PAGE, "utf-8")
    call = [sys.executable, "-m", "sphinx", "-q", "-c", str(DOCS), str(tmp_path), str(tmp_path / "site")]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode != 0
    assert re.findall(r"^\s*index\.html: (\S+)$", done.stderr, re.MULTILINE) == ["https://example.org/picture.png"]
    built = (tmp_path / "site" / "index.html").read_text("utf-8")
    assert built.count("<math") == 2
    assert "<mfrac>" in built


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.html", '<script src="//cdn.example.org/a.js"></script>'),
        ("a.html", '<link rel="stylesheet" href="https://cdn.example.org/a.css">'),
        ("a.html", "<style>@import 'https://cdn.example.org/a.css';</style>"),
        ("a.html", '<p style="background: url(https://cdn.example.org/a.png)">a</p>'),
        ("a.html", "<script>fetch('https://cdn.example.org/a')</script>"),
        ("a.svg", '<svg xmlns="http://www.w3.org/2000/svg"><image href="https://cdn.example.org/a.png"/></svg>'),
        ("a.css", "@font-face { src: url(https://cdn.example.org/a.woff2) }"),
        ("a.js", 'import("https://cdn.example.org/a.js")'),
    ],
)
def test_what_loads_from_a_host_is_found(tmp_path: Path, name: str, text: str):
    (tmp_path / name).write_text(text, "utf-8")
    (found,) = loaded(tmp_path / name)
    assert "cdn.example.org/a" in found


def test_links_that_a_reader_follows_are_none(tmp_path: Path):
    page = tmp_path / "a.html"
    page.write_text('<svg xmlns="http://www.w3.org/2000/svg"></svg><a href="https://example.org">there</a><img src="here.png">', "utf-8")
    assert loaded(page) == []


def test_aligned_lists_become_sections():
    shown = sections(
        ["The size |x| of x*.", "", "x, y    positions [m]", "        of both", "", "Raises GainroomError for `y_`."], "Parameters"
    )
    assert shown == [
        *("The size \\|x\\| of x\\*.", ""),
        *("Parameters", "----------", "x, y", "    positions [m]", "    of both", ""),
        *("Raises", "------", "GainroomError", "    for `y_`.", ""),
    ]


def test_a_list_that_is_not_aligned_is_an_error():
    with pytest.raises(ValueError, match="neither a row"):
        sections(["x   a position", "(y) another"], "Parameters")
