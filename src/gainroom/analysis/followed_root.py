"""One closed-loop root of coupled loops, followed right of the stability boundary as all gains rise from where it crosses.

det(I + g L(s)) = 0 where an eigenvalue λ of L(s) is −1/g. With its vectors x and yᵀ, yᵀx = 1, dλ/ds = yᵀ L' x. The equation is 1/λ = −g:
beside a pole of L, as of a resonance, 1/λ is nearly linear in s.
"""

import numpy as np

from ..system.loop import Loop

STEP = 1.5  # first relative step of g
LEAST_STEP = 1e-3
ASIDE = 1e-5  # relative distance from s of the second point that gives the slope of L
ROUNDS, CLOSE, CLEAR = 6, 1e-3, 0.03  # steps of Newton's method; its last step relative to |s|, and to the distance from the boundary
EXACT = 1e-9  # last step relative to |s| that leaves a root with the digits that L has
DEVIATION = 0.3  # part of a step by which its end may miss the place that the slopes predict: farther off, it may be another root


def stays_unstable(loop: Loop, omega: float, gain: float) -> bool:
    """True if the root that crosses jω outwards at the factor `gain` < 1 on all gains stays right of the boundary for all factors up to 1.

    False says nothing: the root comes back, or could not be followed.
    """
    s, slope = 1j * omega, _inverse(loop, 1j * omega, gain)[1]
    step = STEP
    while gain < 1:
        following = min(1.0, gain * (1 + step))
        rise = gain - following
        found = _corrected(loop, s + rise / slope, following)
        if found is None or abs(found[0] - s - 0.5 * rise * (1 / slope + 1 / found[1])) > DEVIATION * abs(found[0] - s):
            step /= 2
            if step < LEAST_STEP:
                return False
            continue
        s, slope = found
        if s.real <= 0:
            return False
        gain, step = following, 2 * step
    return True


def root_near(loop: Loop, s: complex) -> complex | None:
    """The closed-loop root that Newton's method finds from `s` [rad/s], to 1e-9 of its size; None where it finds none."""
    found = _corrected(loop, s, 1.0, EXACT, 2 * ROUNDS)
    return None if found is None else complex(found[0])


def _corrected(loop: Loop, s: complex, gain: float, close: float = CLOSE, rounds: int = ROUNDS) -> tuple[complex, complex] | None:
    """The root near s with all gains times `gain`, and the slope of 1/λ there; None where there is none nearby."""
    for _ in range(rounds):
        inverse, slope = _inverse(loop, s, gain)
        move = -(gain + inverse) / slope
        if not np.isfinite(move) or s.imag + move.imag <= 0:
            return None
        s += move
        if abs(move) < min(close * abs(s), CLEAR * abs(s.real)):
            return s, slope
    return None


def _inverse(loop: Loop, s: complex, gain: float) -> tuple[complex, complex]:
    """Inverse 1/λ of the eigenvalue of L(s) for which it is nearest to −`gain`, and its derivative by s."""
    here, beside = loop.core(np.array([s, s * (1 + ASIDE)]))
    values, vectors = np.linalg.eig(here)
    nearest = int(np.argmin(np.abs(1 / values + gain)))
    left, right = np.linalg.inv(vectors)[nearest], vectors[:, nearest]
    return 1 / values[nearest], -(left @ (beside - here) @ right) / (s * ASIDE * values[nearest] ** 2)
