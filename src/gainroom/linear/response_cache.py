"""Responses that are asked for again and again at the same points, computed once."""

from collections.abc import Callable

import numpy as np

from .arrays import Complexes

ENTRIES = 4_000_000
"""Complex numbers that are held at a time; then the half that was not asked for longest is forgotten."""


class Remembered:
    """A function of complex s (k,) → (k, …), with what it gave at the points asked for last."""

    def __init__(self, function: Callable[[Complexes], Complexes]) -> None:
        self._function = function
        self._row: dict[complex, int] = {}  # in the order of when they were asked for last
        self._free: list[int] = []
        self._values: Complexes = np.zeros(0, dtype=complex)

    def __call__(self, s: Complexes) -> Complexes:
        points = s.tolist()
        distinct = list(dict.fromkeys(points))
        if not self._values.size:
            entries = self._function(s[:1])[0]
            self._values = np.empty((ENTRIES // entries.size, *entries.shape), dtype=complex)
            self._free = list(range(len(self._values)))
        if 2 * len(distinct) > len(self._values):
            return self._function(s)
        for point in distinct:
            if point in self._row:
                self._row[point] = self._row.pop(point)
        fresh = [point for point in distinct if point not in self._row]
        if fresh:
            self._add(fresh)
        return self._values[[self._row[point] for point in points]]

    def _add(self, fresh: list[complex]) -> None:
        if len(self._free) < len(fresh):
            for point in list(self._row)[: (len(self._row) + 1) // 2]:
                self._free.append(self._row.pop(point))
        rows = [self._free.pop() for _ in fresh]
        self._values[rows] = self._function(np.array(fresh))
        self._row.update(zip(fresh, rows, strict=True))
