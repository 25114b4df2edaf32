"""Compiled kernel of the linear recursion."""

import numpy as np

from ..analysis.compiled import cached_njit
from .run_record import OVERFLOWING

SPARSE = 4
"""A matrix with fewer nonzero entries than one in so many is gone through entry by entry: a delay of many ticks is a line of ones."""


@cached_njit()
def recur(transposed, forcing, states):
    """As stepping.recur, step by step."""
    size = len(transposed)
    places, values, ends = _entries(transposed)
    sparse = SPARSE * len(values) < size * size
    for k in range(len(forcing)):
        for i in range(size):
            states[k + 1, i] = forcing[k, i]
        for j in range(size):
            value = states[k, j]
            if sparse:
                for entry in range(ends[j], ends[j + 1]):
                    states[k + 1, places[entry]] += values[entry] * value
            else:  # columns outside: the inner loop is a vector instruction
                for i in range(size):
                    states[k + 1, i] += transposed[j, i] * value
        for i in range(size):
            if not abs(states[k + 1, i]) < OVERFLOWING:
                return k
    return len(forcing)


@cached_njit()
def _entries(matrix):
    """The nonzero entries of a square matrix, row by row: columns, values, and where each row's begin; one more than rows."""
    size = len(matrix)
    ends = np.zeros(size + 1, dtype=np.int64)
    for j in range(size):
        ends[j + 1] = ends[j] + np.count_nonzero(matrix[j])
    columns, values = np.empty(ends[size], dtype=np.int64), np.empty(ends[size])
    entry = 0
    for j in range(size):
        for i in range(size):
            if matrix[j, i] != 0.0:
                columns[entry], values[entry] = i, matrix[j, i]
                entry += 1
    return columns, values, ends
