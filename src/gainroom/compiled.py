"""numba's compiler with a cache that helps where it can and never stands in the way.

A cache that cannot be written, or a damaged one, costs the seconds of compiling again; numba by itself stops with an error.
"""

import contextlib
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.sigutils import normalize_signature


class _Cache(FunctionCache):
    """What it cannot read it empties, and what it cannot write it leaves."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            found = super().load_overload(sig, target_context)
            # Two processes that fill an empty cache at once may have put one's code under the other's name.
            if found is None or tuple(found.signature.args) == tuple(normalize_signature(sig)[0]):
                return found
        except Exception:  # noqa: BLE001 - pickle and LLVM raise anything where a file ends too early
            pass
        with contextlib.suppress(OSError):
            self.flush()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(Exception):  # full, read-only, taken away, or damaged
            super().save_overload(sig, data)


def cached_njit(**options: Any) -> Callable[[Any], Any]:
    """numba.njit with `options`, cached where there is a place for it."""

    def compiled(function: Any) -> Any:
        dispatcher: Any = njit(**options)(function)
        with contextlib.suppress(RuntimeError, OSError):  # neither the package's folder nor the user's can be written
            dispatcher._cache = _Cache(function)
        return dispatcher

    return compiled
