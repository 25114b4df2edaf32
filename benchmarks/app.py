"""The interactive page as a hand meets it: from the pointer to the redraw, in headless Chromium, while the dot is dragged."""

import contextlib
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from gainroom.cli.example import example_texts

from .served import ANSWERED, browser_path, serving
from .table import Table
from .talos import talos

MOVES = 120
PACE = 1 / 30  # [s] between moves of the pointer
SETTLED = 5.0  # [s] after which recommended gains and the finest curves are computed, too
QUIET = 10.0  # [s] over which processor time at rest is taken
READY = f"{ANSWERED} && document.querySelector('[data-area=stable]')"
DONE = "() => gainroom.certified && !gainroom.busy"
LATENCY = "() => gainroom.latency"


def run(seed: int) -> Table:
    """One row per file that is opened; `seed` is not used. Empty where there is no browser."""
    table = Table("The interactive page: from pointer to redraw")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return table
    texts = example_texts()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        browser = driver.chromium.launch(executable_path=browser_path(), args=["--no-sandbox"])
        cases = [
            ("Fig. 9's joint", texts["fig9"], 50.0, 120.0),
            ("one joint of the 12-joint biped, all others closed", texts["biped"], 50.0, 120.0),
            ("one joint of the 32-joint TALOS, all others closed", talos("{both: [left_sole_link, right_sole_link]}"), 150.0, None),
        ]
        for title, text, median, tail in cases:
            file = folder / f"case{len(table.rows)}.yaml"
            file.write_text(text, "utf-8")
            latency, idle = _dragged(browser, file)
            table.rows.append(
                {
                    "file": title,
                    "drags": len(latency),
                    "median [ms]": round(float(np.median(latency)), 1),
                    "at most [ms]": median,
                    "p95 [ms]": round(float(np.percentile(latency, 95)), 1),
                    "at most [ms] ": tail,
                    "at rest [% of a core]": round(idle, 1),
                    "at most [%]": 5.0,
                }
            )
        browser.close()
    table.notes.append(
        f"{MOVES} moves of the pointer at {1 / PACE:.0f} Hz over the gain map, without a graphics card. From the pointer's event to the "
        "frame in which the verdict of just these gains stands; a move that a later one overtakes has no frame of its own and is not "
        f"counted. At rest: the processor time of server and browser while the page is open and its robot held, from {SETTLED:g} s after "
        "the gains were let go."
    )
    return table


def _dragged(browser, file: Path) -> tuple[list[float], float]:
    """Latencies [ms], and the processor time at rest [%]."""
    with serving(file) as served:
        page = browser.new_page(viewport={"width": 1400, "height": 1000}, reduced_motion="reduce")
        page.goto(served.address)
        page.wait_for_function(READY, timeout=60_000)
        page.wait_for_function(DONE, timeout=120_000)
        box = page.locator("#map svg").bounding_box()
        page.evaluate("() => { gainroom.latency.length = 0; }")
        dot = page.locator("#dot").bounding_box()
        page.mouse.move(dot["x"] + dot["width"] / 2, dot["y"] + dot["height"] / 2)
        page.mouse.down()
        for k in range(MOVES):
            began, angle = time.perf_counter(), 2 * np.pi * k / 50
            page.mouse.move(box["x"] + box["width"] * (0.45 + 0.2 * np.cos(angle)), box["y"] + box["height"] * (0.55 + 0.2 * np.sin(angle)))
            time.sleep(max(0.0, PACE - (time.perf_counter() - began)))
        page.wait_for_function(ANSWERED)
        latency = page.evaluate(LATENCY)
        page.mouse.up()
        page.wait_for_function(DONE, timeout=120_000)
        time.sleep(SETTLED)
        before = _used()
        time.sleep(QUIET)
        idle = 100 * (_used() - before) / QUIET
        page.close()
    return latency, idle


def _used() -> float:
    """Processor time [s] of all that runs below this process: server, browser and its driver."""
    parents, used = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            words = stat.read_text("utf-8", "replace").rpartition(")")[2].split()
            parents[int(stat.parent.name)], used[int(stat.parent.name)] = int(words[1]), int(words[11]) + int(words[12])

    def below(process: int | None) -> bool:
        return process is not None and (process == os.getpid() or below(parents.get(process)))

    return sum(ticks for process, ticks in used.items() if below(parents[process])) / os.sysconf("SC_CLK_TCK")
