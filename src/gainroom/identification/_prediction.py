"""Compiled: one-step predictions of a linear system with a constant Kalman gain."""

import numpy as np

from ..analysis.compiled import cached_njit


@cached_njit(error_model="numpy")
def predict(a, b, c, gains, regime, inputs, outputs, state, errors):
    """Fill errors (m, o) of x⁺ = a x + b u + gain e, e = y − c x, from `state` (n,), which is changed.

    a (n, n); b (n, i); c (o, n); gains (r, n, o), of which each row takes the one that `regime` (m,) says; inputs (m, i) over the tick that
    begins with each row; outputs (m, o).
    """
    size, count, seen = len(a), inputs.shape[1], len(c)
    fresh = np.empty(size)
    for k in range(len(inputs)):
        gain = gains[regime[k]]
        for j in range(seen):
            value = outputs[k, j]
            for i in range(size):
                value -= c[j, i] * state[i]
            errors[k, j] = value
        for i in range(size):
            value = 0.0
            for j in range(size):
                value += a[i, j] * state[j]
            for j in range(count):
                value += b[i, j] * inputs[k, j]
            for j in range(seen):
                value += gain[i, j] * errors[k, j]
            fresh[i] = value
        for i in range(size):
            state[i] = fresh[i]
