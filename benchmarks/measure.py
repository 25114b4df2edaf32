"""Clocks and facts about the machine."""

import gc
import math
import os
import platform
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np

PACKAGES = ("gainroom", "numpy", "scipy", "control", "mujoco", "pin")
ROUNDS = 5


@dataclass(frozen=True)
class Spread:
    """Repeated durations of one piece of work [s]."""

    taken: np.ndarray

    @property
    def median(self) -> float:
        return float(np.median(self.taken))

    def cells(self, unit: str = "ms", limit: float | None = None, *, limited: bool = True) -> dict[str, float | None]:
        """Columns of a table: median with its limit [unit], least, 99th percentile (of fewer than 100 the greatest)."""
        scale = {"s": 1.0, "ms": 1e3, "µs": 1e6}[unit]
        found = {f"median [{unit}]": scale * self.median}
        if limited:
            found[f"at most [{unit}]"] = limit
        high = np.max(self.taken) if len(self.taken) < 100 else np.quantile(self.taken, 0.99)
        return found | {f"least [{unit}]": scale * float(np.min(self.taken)), f"p99 [{unit}]": scale * float(high)}


def in_turns(works: dict[str, Callable[[], object]], budget: float = 0.6) -> dict[str, Spread]:
    """Durations of every piece of work, repeated for `budget` [s] each, in turns, so that other load meets all of them.

    An unmeasured call or two warm caches; a piece that takes longer than its budget is measured once.
    """
    repeats, taken = {}, {name: [] for name in works}
    for name, work in works.items():
        once = math.inf
        for _ in range(2):
            start = time.perf_counter()
            work()
            once = min(once, time.perf_counter() - start)
            if once > budget:
                break
        repeats[name] = min(200, max(1, round(budget / ROUNDS / max(once, 1e-7))))
    gc.collect()
    longest = max(repeats.values())
    for turn in range(ROUNDS if longest > 1 else 1):
        for name, work in works.items():
            for _ in range(repeats[name] if repeats[name] > 1 or turn == 0 else 0):
                start = time.perf_counter()
                work()
                taken[name].append(time.perf_counter() - start)
    return {name: Spread(np.array(all_of_it)) for name, all_of_it in taken.items()}


def spread(work: Callable[[], object], budget: float = 0.6) -> Spread:
    """Durations of one piece of work alone."""
    return in_turns({"": work}, budget)[""]


def once(work: Callable[[], object]) -> Spread:
    """Duration of work that is too long to be repeated."""
    start = time.perf_counter()
    work()
    return Spread(np.array([time.perf_counter() - start]))


@contextmanager
def no_collection() -> Iterator[None]:
    """Python looks for no garbage meanwhile, as in timeit, and in a control loop."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def waited(lengths: np.ndarray) -> np.ndarray:
    """Durations [s] of busy waits of `lengths` [s]: the excess is what the machine adds to any work."""
    taken = np.empty_like(lengths)
    with no_collection():
        for k, length in enumerate(lengths.tolist()):
            begun = time.perf_counter()
            while time.perf_counter() - begun < length:
                pass
            taken[k] = time.perf_counter() - begun
    return taken


def machine_facts() -> dict[str, str]:
    """Processor, cores, system, Python, packages, linear algebra and compiler."""
    model = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    algebra = np.show_config(mode="dicts")["Build Dependencies"]["blas"]  # pyright: ignore[reportOptionalSubscript]
    return {
        "processor": f"{model}, {os.cpu_count()} cores, one used (one thread of linear algebra)",
        "other work": f"load average {os.getloadavg()[0]:.1f} as the run began: the machine is shared, and times wander with it",
        "system": f"{platform.system()} {platform.release()}",
        "Python": f"{platform.python_version()}; {', '.join(f'{name} {_version(name)}' for name in PACKAGES)}",
        "linear algebra": f"{algebra['name']} {algebra['version']}",
        "C++ compiler": _compiler(),
    }


def _compiler() -> str:
    """The first line of what the compiler of the core says of itself."""
    for command in (os.environ.get("CXX", "c++"), "build/native/c++"):
        try:
            return subprocess.run([command, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
        except (OSError, subprocess.CalledProcessError, IndexError):
            continue
    return "(none found)"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(none)"
