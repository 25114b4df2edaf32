"""Clocks and facts about the machine."""

import gc
import os
import platform
import statistics
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("numpy", "scipy", "control")


def machine_facts() -> str:
    """One line: processor, cores, system, Python and packages."""
    model = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    packages = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return (
        f"{model}, {os.cpu_count()} cores, {platform.system()} {platform.release()}, "
        f"Python {platform.python_version()}, {packages}, one BLAS thread"
    )


def seconds(work: Callable[[], object], budget: float = 0.6, batches: int = 5) -> float:
    """Best of `batches` medians, so that other work on the machine hardly counts; the first, unmeasured call warms caches."""
    work()
    start = time.perf_counter()
    work()
    once = time.perf_counter() - start
    repeats = max(1, min(200, round(budget / batches / max(once, 1e-7))))
    medians = []
    gc.collect()
    for _ in range(batches):
        taken = []
        for _ in range(repeats):
            start = time.perf_counter()
            work()
            taken.append(time.perf_counter() - start)
        medians.append(statistics.median(taken))
    return min(medians)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(none)"
