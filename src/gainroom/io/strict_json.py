"""Strict JSON: values that are not finite (infinite margin, margin of an unstable loop) become null."""

import math
from collections.abc import Mapping
from typing import Any


def strict(value: Any, significant: int | None = None) -> Any:
    """Value in types of strict JSON: dicts, lists, texts, finite numbers, null; numpy's scalars and arrays are converted.

    significant   digits of every float; None: all
    """
    if isinstance(value, Mapping):
        return {str(key): strict(item, significant) for key, item in value.items()}
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [strict(item, significant) for item in value]
    if not isinstance(value, float):
        return value
    return None if not math.isfinite(value) else value if significant is None else float(f"{value:.{significant}g}")
