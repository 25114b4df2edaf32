"""Dynamic stiffness of the links, and the damping of what vibrates: what a person feels who pushes the robot.

k_dyn = 1 / max_ω |q/τ_L|, the least stiffness that a load torque on a joint's link meets at any frequency, all loops closed
(link_compliance.py). It is at most 1/(1/kp + 1/K), the static stiffness, and near 0 where nothing damps the link.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..system.linear.arrays import Complexes, Floats, Integers, distinct
from ..system.loop import Loop
from ..system.modes import undamped
from .characteristic import roots_within
from .lifted import Lifted
from .link_compliance import LinkCompliance

PER_DECADE = 40  # frequencies per decade from which peaks are looked for, beside those near the closed loop's roots
BESIDE = np.sinh(np.linspace(-3.0, 3.0, 25)) / 2  # in units of a root's decay rate: a peak is within one of its root's frequency
SLOWEST = 1e-3  # lowest frequency, times the slowest corner's
FASTEST = 10.0  # highest frequency, times the highest elastic mode's
ELASTIC = 1.5  # roots up to this times the highest elastic mode count as vibrations; above, delays have roots of their own without end
POINTS = 7  # frequencies between neighbours of a peak's sample, of which the highest is next
ROUNDS = 7  # each narrows the bracket to a third: the height is then off by less than 1e-7 of it, a parabola's (3⁻⁷)²
UNHELD = 3.0  # growth of compliance from a low frequency to a tenth of it above which nothing holds the joint: 100 where its link drifts


@dataclass(frozen=True)
class Peaks:
    """Local peaks of the links' compliance: p of them, by joint (p,), frequency (p,) [rad/s] and height (p,) [rad/(N m)]."""

    joint: Integers
    omega: Floats
    height: Floats


def peaks(height: Callable[[Floats], Floats], grid: Floats, share: float = 0.5, rounds: int = ROUNDS) -> Peaks:
    """Local peaks of `height`, omega (k,) → (k, n), that reach `share` of each column's highest, between samples on `grid` (k,).

    The first sample counts where heights fall from it: compliance at rest.
    """
    samples = height(grid)
    padded = np.vstack([np.full(samples.shape[1], -np.inf), samples, np.full(samples.shape[1], -np.inf)])
    tops = (samples >= padded[:-2]) & (samples >= padded[2:]) & (samples >= share * samples.max(axis=0)) & (samples > 0)
    rows, joints = np.nonzero(tops)
    low, high = grid[np.maximum(rows - 1, 0)], grid[np.minimum(rows + 1, len(grid) - 1)]
    best, found = grid[rows].copy(), samples[rows, joints]
    every, split = np.arange(len(rows)), np.linspace(0.0, 1.0, POINTS)
    for _ in range(rounds if len(rows) else 0):
        tried = low[:, None] + (high - low)[:, None] * split
        heights = height(tried.ravel()).reshape(len(rows), POINTS, -1)[every, :, joints]
        k = heights.argmax(axis=1)
        better = heights[every, k] > found
        best, found = np.where(better, tried[every, k], best), np.maximum(found, heights[every, k])
        low, high = tried[every, np.maximum(k - 1, 0)], tried[every, np.minimum(k + 1, POINTS - 1)]
    return Peaks(joints, best, found)


@dataclass(frozen=True)
class DynamicStiffness:
    """Dynamic stiffness of each joint's link, all loops closed, and the least damped vibration.

    stiffness   (n,) [N m/rad]; 0 where nothing holds the joint, inf where no load moves its link, NaN of an unstable loop
    omega       (n,) its frequency [rad/s]: 0 where the static stiffness is the least
    static      (n,) 1/|C| at rest [N m/rad]
    damping_ratio, damping_frequency   least damping ratio of the closed-loop pole pairs up to 1.5 times the highest elastic mode, and
                that pair's frequency |s| [rad/s]; ratio 1 where none vibrates, NaN of an unstable loop
    """

    stiffness: Floats
    omega: Floats
    static: Floats
    damping_ratio: float
    damping_frequency: float

    @classmethod
    def unknown(cls, size: int) -> "DynamicStiffness":
        """Record of an unstable loop of `size` joints."""
        nothing = np.full(size, math.nan)
        return cls(nothing, nothing, nothing, math.nan, math.nan)

    @classmethod
    def least_of(cls, found: "Sequence[DynamicStiffness]") -> "DynamicStiffness":
        """Of each joint the least of several records, with its frequency, and of all the least damping ratio."""
        joints = np.arange(len(found[0].stiffness))
        softest = np.argmin([one.stiffness for one in found], axis=0)
        stiffness, omega = (np.array([getattr(one, name) for one in found])[softest, joints] for name in ("stiffness", "omega"))
        calmest = min(found, key=lambda one: one.damping_ratio)
        static = np.min([one.static for one in found], axis=0)
        return cls(stiffness, omega, static, calmest.damping_ratio, calmest.damping_frequency)

    @property
    def least(self) -> float:
        """Least stiffness of a joint that a load moves [N m/rad]; inf where there is none."""
        return float(self.stiffness.min(initial=math.inf))

    @property
    def least_frequency(self) -> float:
        """Its frequency [rad/s]; 0 where it is that at rest."""
        return float(self.omega[int(np.argmin(self.stiffness))])


def stiffness_of(loop: Loop, stable: bool) -> DynamicStiffness:
    """Dynamic stiffness of the links of `loop`, from build_loop, and its least damping ratio; `stable`: its verdict.

    Raises GainroomError for a loop given as a transfer function: it has no link.
    """
    links = LinkCompliance.of(loop)
    if not stable:
        return DynamicStiffness.unknown(loop.size)
    roots = vibrations(loop)
    grid = frequencies(links, roots)
    controller = links.parts.controller

    def height(omega: Floats) -> Floats:
        s = 1j * omega
        fed = links.feedback(s, controller, loop.gain)
        if loop.size == 1:
            return np.abs(links.of_one(s, fed[:, 0, 0]))[:, None]
        return np.abs(np.diagonal(links.at(s, fed), axis1=1, axis2=2))

    found = peaks(height, grid)
    low = height(np.array([grid[0], 0.1 * grid[0]]))
    stiffness, omega = np.full(loop.size, math.inf), np.full(loop.size, math.nan)
    for joint, at, top in zip(found.joint.tolist(), found.omega.tolist(), found.height.tolist(), strict=True):
        if 1 / top < stiffness[joint]:
            stiffness[joint], omega[joint] = 1 / top, 0.0 if at <= grid[1] else at
    with np.errstate(divide="ignore"):
        static = np.where(low[1] > UNHELD * low[0], 0.0, 1 / low[1])
    stiffness, omega = np.where(static == 0, 0.0, stiffness), np.where(static == 0, 0.0, omega)
    damping, at = least_damping(loop, roots)
    return DynamicStiffness(stiffness, omega, static, damping, at)


def highest_mode(loop: Loop) -> float:
    """Highest frequency [rad/s] of the plant's modes on its springs, motors free; of a rigid one, that of its gains as springs."""
    assert loop.parts is not None
    form = loop.parts.plant.mechanism()
    elastic = _highest(form.mass, form.stiffness)
    if elastic > 0:
        return elastic
    gains = loop.parts.controller.matrices(loop.size)
    kp, kd = (loop.gain * gains.get(powers, np.zeros((loop.size, loop.size))) for powers in ((0, 0), (1, 0)))
    held, damped = (_highest(form.mass, form.force @ ((gain + gain.T) / 2) @ form.motor_position) for gain in (kp, kd))
    return max(held, damped**2)


def _highest(mass: Floats, stiffness: Floats) -> float:
    """Square root of the largest eigenvalue of mass⁻¹ stiffness, both symmetric; 0 where it is round-off of motions without a spring."""
    squares = undamped(mass, stiffness)[0]
    return math.sqrt(max(float(squares.max(initial=0.0)), 0.0))


def vibrations(loop: Loop) -> Complexes:
    """Closed-loop roots s, Im s > 0, up to ELASTIC times the highest mode of the plant."""
    most = ELASTIC * highest_mode(loop)
    if loop.kd_path is not None:
        lifted = Lifted(loop)
        values = np.linalg.eigvals(lifted.matrix()).astype(complex)
        roots = np.log(values[np.abs(values) > 0]) / lifted.period
    else:
        roots = roots_within(loop, most)
    return roots[(roots.imag > 0) & (np.abs(roots) <= most)]


def least_damping(loop: Loop, roots: Complexes | None = None) -> tuple[float, float]:
    """Least damping ratio −Re s/|s| of `vibrations`, and |s| [rad/s] there; 1 and NaN where nothing vibrates."""
    fastest = LinkCompliance.of(loop).fastest
    found = vibrations(loop) if roots is None else roots
    found = found[np.abs(found.imag) < (1 - 1e-9) * fastest]  # real and negative in z: no pair
    if not len(found):
        return 1.0, math.nan
    k = int(np.argmin(_damping(found)))
    return float(_damping(found)[k]), float(abs(found[k]))


def _damping(roots: Complexes) -> Floats:
    return -roots.real / np.abs(roots)


def frequencies(links: LinkCompliance, roots: Complexes) -> Floats:
    """Frequencies (k,) [rad/s], ascending, from which peaks of the compliance are looked for: over all decades, and about each root."""
    plant, controller = links.parts.plant, links.parts.controller
    corners = np.abs(plant.corners().every)
    sizes = np.concatenate([np.abs(roots), corners[corners > 1e-6 * corners.max(initial=0.0)], [controller.slowest(plant.size)]])
    sizes = sizes[np.isfinite(sizes)]
    low, high = (float(sizes.min()), float(sizes.max())) if len(sizes) else (1.0, 1.0)
    low, high = SLOWEST * low, min(FASTEST * high, links.fastest)
    wide = np.geomspace(low, high, max(2, math.ceil(PER_DECADE * math.log10(high / low))))
    beside = (roots.imag[:, None] - roots.real[:, None] * BESIDE).ravel()
    return distinct(np.concatenate([wide, beside[(beside > low) & (beside < high)]]))
