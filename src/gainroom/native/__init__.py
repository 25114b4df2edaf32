"""The C++ core: what is hot, and nothing else. Headers in include/gainroom, bound by nanobind as `_core`."""

from pathlib import Path


def include_dir() -> Path:
    """The folder of the C++ headers, for a compiler's -I."""
    return Path(__file__).with_name("include")


def warmup() -> None:
    """Nothing is left to do: the core is compiled before it is installed. Kept for callers of earlier versions."""
