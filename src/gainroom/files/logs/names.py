"""The column names of a log that gainroom writes."""

from collections.abc import Sequence


def column_names(joints: Sequence[str], signals: Sequence[str]) -> list[str]:
    """`time`, then signal by signal; with several joints each with its joint's name."""
    return ["time", *(signal if len(joints) == 1 else f"{signal}_{joint}" for signal in signals for joint in joints)]
