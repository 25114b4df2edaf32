"""How far one part of a controller can be scaled while the rest stays closed: one direction of a task, one joint of a matrix of gains.

With D = D_0 + g D_k and L_k = P C D_k of rank one, det(I + L + (g − 1) L_k) = det(I + L) (1 + (g − 1) tr((I + L)⁻¹ L_k)), so the limit
lies where that trace first meets the negative real axis.
"""

from collections.abc import Sequence

import numpy as np

from ..linear.arrays import Complexes, Floats
from ..system.loop import Loop
from .coupled_margins import distances, sensitivity
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

    def traces(omega: Floats) -> Complexes:
        s = sweep.boundary.points(omega)
        v = loop.variable(s)
        actuated = loop.actuated_at(s)
        law, *laws = (one.matrix(s, v, loop.size, loop.sample_time) for one in (own, *controllers))
        sensitive = sensitivity(loop, loop.gain * actuated @ law) @ actuated
        return np.stack([np.einsum("kij,kji->k", sensitive, one) for one in laws], axis=1)

    return 1 + distances(sweep, traces)[0]
