"""State space in complex Schur form, whose response at a frequency takes as many steps as the square of its states, not their cube."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Complexes
from .state_space import StateSpace

TOGETHER = 2048
"""Frequencies that are solved at a time."""


@dataclass(frozen=True)
class TriangularForm:
    """System v x = a x + b u, y = c x with `a` (m, m) upper triangular; b (m, inputs), c (outputs, m); the poles are on the diagonal.

    The form is that of the balanced system under a unitary matrix. Its round-off is that of the largest entry: 1e-9 of a response, and
    where that has rolled off, near half the rate, 2e-7.
    """

    a: Complexes
    b: Complexes
    c: Complexes

    @classmethod
    def of(cls, system: StateSpace) -> "TriangularForm":
        """Form of a system without feedthrough."""
        from scipy.linalg import matrix_balance, schur

        balanced, (scale, _) = matrix_balance(system.a, permute=False, separate=True)
        found: Any = schur(balanced, output="complex")
        a, turn = found
        return cls(a, turn.conj().T @ (system.b / scale[:, None]), (system.c * scale) @ turn)

    def at(self, v: Complexes) -> Complexes:
        """Transfer matrix (k, outputs, inputs) at complex v (k,)."""
        if len(v) > TOGETHER:
            return np.concatenate([self.at(v[k : k + TOGETHER]) for k in range(0, len(v), TOGETHER)])
        size, inputs = self.b.shape
        x = np.empty((size, len(v) * inputs), dtype=complex)
        points, b = np.repeat(v, inputs), np.tile(self.b, len(v))
        for k in range(size - 1, -1, -1):
            x[k] = (b[k] + self.a[k, k + 1 :] @ x[k + 1 :]) / (points - self.a[k, k])
        return np.moveaxis((self.c @ x).reshape(len(self.c), len(v), inputs), 0, 1)
