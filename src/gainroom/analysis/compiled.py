"""numba's compiler with a cache on disk that may fail without an error.

A cache that cannot be written, or a damaged one, costs the seconds of compiling again; numba by itself stops with an error.
"""

import contextlib
import pickle
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.sigutils import normalize_signature


class _Summed(IndexDataCacheFile):
    """Code with a checksum before it: one flipped bit in it could crash the process or change a number."""

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(sha256(content).digest() + content)

    def _load_data(self, name: str) -> Any:
        content = Path(self._data_path(name)).read_bytes()
        checksum, content = content[:32], content[32:]
        if sha256(content).digest() != checksum:
            raise ValueError(f"{name} is damaged")
        return pickle.loads(content)


def _stamp(file: Path) -> list[tuple[str, float, int]]:
    """Of a kernel's file and the kernels beside it: they call each other, and numba by itself looks at the caller's file alone."""
    return [(path.name, path.stat().st_mtime, path.stat().st_size) for path in sorted({file, *file.parent.glob("_*.py")})]


class _Cache(FunctionCache):
    """What it cannot read it empties, and what it cannot write it leaves."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = _Summed(self._cache_path, self._impl.filename_base, _stamp(Path(function.__code__.co_filename)))

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
