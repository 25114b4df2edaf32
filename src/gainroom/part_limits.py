"""How far one part of a controller can be scaled while the rest stays closed: one direction of a task, one joint of a matrix of gains.

With D = D_0 + g D_k and L_k = P C D_k of rank one, det(I + L + (g − 1) L_k) = det(I + L) (1 + (g − 1) tr((I + L)⁻¹ L_k)), so the limit
lies where that trace first meets the negative real axis.
"""

from collections.abc import Sequence

import numpy as np

from .arrays import Complexes, Floats
from .coupled import room
from .loop import Loop
from .sweep import Sweep


def part_limits(loop: Loop, parts: Sequence[Loop]) -> Floats:
    """(len(parts),) largest factor on each part of a stable loop's controller, everything else as it is; inf where there is none.

    parts   the same plant and drives under a part of the controller alone, of rank one
    """
    size = loop.size

    def traces(omega: Floats) -> Complexes:
        difference = np.eye(size) + loop.response(omega).reshape(len(omega), size, size)
        columns = [
            np.trace(np.linalg.solve(difference, part.response(omega).reshape(difference.shape)), axis1=1, axis2=2) for part in parts
        ]
        return np.stack(columns, axis=1)

    return 1 + room(Sweep(loop), traces) if parts else np.zeros(0)
