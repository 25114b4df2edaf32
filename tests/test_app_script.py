"""The page's own JavaScript: short, checked, and without ways for a name out of a file to become script; `make lint` checks it."""

import re
from pathlib import Path

import pytest

import gainroom

STATIC = Path(gainroom.__path__[0]) / "app" / "static"
PLOTLY = STATIC.parents[1] / "report" / "vendor" / "plotly.js"
OWN = sorted(STATIC.glob("*.js"))


def test_it_is_short():
    assert sum(len(path.read_text("utf-8").splitlines()) for path in OWN) < 1600
    assert all(len(path.read_text("utf-8").splitlines()) <= 400 for path in OWN)


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_text_never_becomes_markup_or_script(path: Path):
    text = path.read_text("utf-8")
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|\.srcdoc|setAttribute\([\"']on", text
    )
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", text)
    assert "// @ts-check" in text.splitlines()[1]
    for imported in re.findall(r"from \"([^\"]+)\"", text):
        assert (path.parent / imported).is_file()


def test_vendored_files_say_what_they_are():
    for script in (STATIC / "vendor" / "uplot.js", STATIC / "vendor" / "three.js", PLOTLY):
        name, head = script.stem, script.read_text("utf-8").splitlines()[1]
        assert re.fullmatch(rf"// {name} \d+\.\d+\.\d+, MIT: see {name}\.LICENSE; made by scripts/vendor\.sh", head)
        assert "MIT" in script.with_suffix(".LICENSE").read_text("utf-8")
