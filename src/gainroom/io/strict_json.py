"""Strict JSON: what is not finite (infinite margin, margin of an unstable loop) becomes null."""

import math
from collections.abc import Mapping
from typing import Any


def strict(value: Any) -> Any:
    """`value` in what strict JSON knows: dicts, lists, texts, finite numbers, null; numpy's scalars and arrays included."""
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [strict(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
