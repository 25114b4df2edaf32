"""How far one part of a controller can be scaled while the rest stays closed: one direction of a task, one joint of a matrix of gains.

With D = D_0 + g D_k and L_k = P C D_k of rank one, det(I + L + (g − 1) L_k) = det(I + L) (1 + (g − 1) tr((I + L)⁻¹ L_k)), so the limit
lies where that trace first meets the negative real axis. All D act on the combinations Vᵀ q of positions alone, V orthonormal: the trace is
that of (I + Vᵀ L V)⁻¹ Vᵀ L_k V. The other motions drift as 1/s², and would leave as much round-off in it as the gains move.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from ..system.controller import gain_matrix
from ..system.linear.arrays import Floats
from ..system.loop import NO_GAIN, Loop
from .coupled_margins import inverted
from .curve_distances import Summed, distances
from .loci import Sweep


def part_limits(loop: Loop, parts: Sequence[Loop]) -> Floats:
    """(len(parts),) largest factor on each part of a stable loop's controller, everything else as it is; inf where there is none.

    parts   the same plant and drives under a part of the controller alone, of rank one
    """
    if not parts:
        return np.zeros(0)
    controllers = [part.parts.controller for part in parts if part.parts is not None]
    assert loop.parts is not None
    own, sweep = loop.parts.controller, Sweep(loop)
    seen = _row_space(gain_matrix("gain", gain, loop.size) for one in (own, *controllers) for gain in one.terms().values())

    def traces(omega: Floats) -> Summed:
        s = sweep.boundary.points(omega)
        v = loop.variable(s)
        actuated = loop.actuated_at(s)
        reached = seen.T @ actuated
        core, *cores = (reached @ (one.matrix(s, v, loop.size, loop.sample_time) @ seen) for one in (own, *controllers))
        inverse = inverted(np.eye(seen.shape[1]) + loop.gain * core)
        terms = [np.einsum("kij,kji->k", np.abs(inverse), np.abs(one)) for one in cores]
        return Summed(np.stack([np.einsum("kij,kji->k", inverse, one) for one in cores], axis=1), np.stack(terms, axis=1))

    return 1 + distances(sweep, traces)[0]


def _row_space(gains: Iterable[Floats]) -> Floats:
    """V (n, r), orthonormal: the combinations of positions that gain matrices (n, n) act on."""
    rows = [gain / size for gain in gains if (size := np.abs(gain).max())]
    _, sizes, right = np.linalg.svd(np.vstack(rows), full_matrices=False)
    return right[: np.count_nonzero(sizes > NO_GAIN * sizes[0])].T
