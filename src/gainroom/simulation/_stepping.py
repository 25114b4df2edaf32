"""Compiled kernel of the linear recursion."""

from ..compiled import cached_njit
from .stepping import HUGE


@cached_njit()
def recur(transposed, forcing, states):
    """As stepping.recur, step by step."""
    size = len(transposed)
    for k in range(len(forcing)):
        for i in range(size):
            states[k + 1, i] = forcing[k, i]
        for j in range(size):  # columns outside: the inner loop is a vector instruction
            value = states[k, j]
            for i in range(size):
                states[k + 1, i] += transposed[j, i] * value
        for i in range(size):
            if not abs(states[k + 1, i]) < HUGE:
                return k
    return len(forcing)
