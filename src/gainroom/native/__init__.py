"""C++ core: the performance-critical computations, and nothing else. Headers in include/gainroom, bound by nanobind as `_core`."""

from pathlib import Path


def include_dir() -> Path:
    """Folder of the C++ headers, for a compiler's -I."""
    return Path(__file__).with_name("include")


def warmup() -> None:
    """Function without effect, for callers of earlier versions: the core is compiled before it is installed."""
