"""Draws docs/images/app.webp: `gainroom app` as its dot is dragged, its delay slid, and the recommended gains taken. Needs a Chromium."""

import io
import itertools
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from gainroom.cli.example import example_texts

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.served import ANSWERED, CERTIFIED, browser_path, serving  # noqa: E402 - beside this folder, not installed

TARGET = ROOT / "docs" / "images" / "app.webp"
SIZE, SHOWN = {"width": 1240, "height": 800}, (930, 600)
PATH = [(0.45, 0.42), (0.42, 0.6), (0.4, 0.78), (0.38, 0.92), (0.4, 0.7), (0.3, 0.42), (0.24, 0.33)]
"""Path of the dot, across and up, as shares of the map's size."""


def main() -> None:
    """Open the page on an example, act, and take a picture after each step."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "joint.yaml"
        file.write_text(example_texts()["fig9"], "utf-8")
        with serving(file) as served, sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=browser_path(), args=["--no-sandbox"])
            page = browser.new_page(viewport=SIZE)
            page.goto(served.address)
            frames = [Image.open(io.BytesIO(picture)).resize(SHOWN, Image.Resampling.LANCZOS) for picture in _acted(page)]
            browser.close()
    times = [1200, *[160] * (len(frames) - 2), 2500]
    frames[0].save(TARGET, save_all=True, append_images=frames[1:], duration=times, loop=0, quality=70, method=6)
    print(f"{TARGET}: {TARGET.stat().st_size / 1e3:.0f} kB, {len(frames)} frames")


def _acted(page: Page) -> Iterator[bytes]:
    page.wait_for_function(CERTIFIED)
    yield page.screenshot()
    box, dot = page.locator("#map svg").bounding_box(), page.locator("#dot").bounding_box()
    assert box is not None
    assert dot is not None
    page.mouse.move(dot["x"] + dot["width"] / 2, dot["y"] + dot["height"] / 2)
    page.mouse.down()
    for start, end in itertools.pairwise(PATH):
        for part in np.linspace(0, 1, 4)[1:]:
            across, up = (a + part * (b - a) for a, b in zip(start, end, strict=True))
            page.mouse.move(box["x"] + across * box["width"], box["y"] + (1 - up) * box["height"])
            page.wait_for_function(ANSWERED)
            page.wait_for_timeout(80)
            yield page.screenshot()
    page.mouse.up()
    for delay in (2.5, 3.0, 3.5, 4.0):
        page.locator("#delay_ms").fill(str(delay))
        page.wait_for_function(CERTIFIED)
        page.wait_for_timeout(150)
        yield page.screenshot()
    page.locator("#snap").click()
    page.wait_for_function(CERTIFIED)
    page.wait_for_timeout(300)
    yield page.screenshot()


if __name__ == "__main__":
    main()
