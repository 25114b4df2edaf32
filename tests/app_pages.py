"""A running `gainroom app` and a browser in front of it, for the tests of the page."""

import contextlib
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from benchmarks import served
from benchmarks.served import Served, browser_path
from faults import environment, heard

PATIENCE = 300.0
"""[s] within which anything answers, on a loaded machine, too; none of it is waited for where the answer comes."""
QUICK, CERTIFIED = served.ANSWERED, served.CERTIFIED


def serve(file: Path | None, port: int = 0, *options: str) -> Served:
    """`gainroom app FILE`, or without one, once it listens; `options` are further words."""
    return served.serve(file, port, *options, **_alone())


def serving(file: Path | None, *options: str) -> contextlib.AbstractContextManager[Served]:
    """The same, ended behind the block."""
    return served.serving(file, *options, **_alone())


def _alone() -> dict[str, Any]:
    return {"stderr": subprocess.PIPE, "env": environment(PYTHONUNBUFFERED="1"), "preexec_fn": heard}


@contextlib.contextmanager
def a_browser() -> Iterator[Any]:
    """Headless Chromium; skips the test where none can be had."""
    sync = pytest.importorskip("playwright.sync_api", reason="no browser: playwright is not installed")
    path = browser_path()
    with sync.sync_playwright() as driver:
        try:
            options = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
            found = driver.chromium.launch(executable_path=path, timeout=1000 * PATIENCE, args=options)
        except sync.Error as error:
            pytest.skip(f"no browser: {str(error).splitlines()[0]}")
        yield found
        found.close()


@dataclass
class Tab:
    """An open page, what it complained of, and what it asked for."""

    page: Any
    said: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def settle(self, what: str = QUICK) -> None:
        """Until the answers are there."""
        self.page.wait_for_function(what, timeout=1000 * PATIENCE)

    def text(self, selector: str) -> str:
        return self.page.locator(selector).inner_text()

    def view(self) -> dict[str, Any]:
        return self.page.evaluate("() => structuredClone(gainroom.view)")

    def drag(self, *steps: tuple[float, float]) -> None:
        """The gain map's dot by the mouse, to places in the map's box, each a part of its width and height from the left and from below."""
        self.page.locator("#map svg").scroll_into_view_if_needed()
        box = self.page.locator("#map svg").bounding_box()
        dot = self.page.locator("#dot").bounding_box()
        mouse = self.page.mouse
        mouse.move(dot["x"] + dot["width"] / 2, dot["y"] + dot["height"] / 2)
        mouse.down()
        for across, up in steps:
            mouse.move(box["x"] + across * box["width"], box["y"] + (1 - up) * box["height"], steps=4)
        mouse.up()


def open_tab(browser: Any, address: str, width: int = 1400, height: int = 1000, moving: bool = False) -> Tab:
    """A new page at `address` in a context of its own; `moving`: the robot does, which without a graphics card takes a core."""
    motion = "no-preference" if moving else "reduce"
    context = browser.new_context(viewport={"width": width, "height": height}, reduced_motion=motion)
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    context.set_default_timeout(1000 * PATIENCE)
    return tab_in(context, address)


def tab_in(context: Any, address: str) -> Tab:
    page = context.new_page()
    tab = Tab(page)
    page.on("console", lambda message: tab.said.append(f"{message.type}: {message.text}") if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: tab.said.append(str(error)))
    page.on("request", lambda request: tab.asked.append(request.url))
    page.on("websocket", lambda socket: tab.asked.append(socket.url))
    page.goto(address)
    tab.settle()
    return tab
