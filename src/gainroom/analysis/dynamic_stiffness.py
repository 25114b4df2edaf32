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
AT_REST = 1e-7  # of the highest vibration: slower roots are round-off of motions that drift, √1e-16 of it where two of them meet
ROUNDS = 4  # samples taken at a peak; each parabola of 1/C through the nearest three leaves less than a tenth of the last one's error
NEAR = 1.5  # factor of frequency around an undamped mode within which its root lies
CLOSE = 1e-3  # relative difference of a sample from its parabola, below which a peak is not sampled again
MOST_ABOVE = 1.01  # height of a last parabola above its samples, relative: more is the doing of a zero beside the peak
TRIED = np.linspace(0.0, 1.0, 9)  # places between three samples where their parabola is looked at
UNHELD = 3.0  # growth of compliance from a low frequency to a tenth of it above which nothing holds the joint: 100 where its link drifts


@dataclass(frozen=True)
class Peaks:
    """Local peaks of the links' compliance: joint (p,), frequency (p,) [rad/s] and height (p,) [rad/(N m)] of each of p peaks."""

    joint: Integers
    omega: Floats
    height: Floats


def peaks(response: Callable[[Floats], Complexes], grid: Floats, share: float = 0.5, rounds: int = ROUNDS) -> Peaks:
    """Local peaks of |C| over frequency, joint by joint, that reach `share` of the joint's highest one.

    response   omega (k,) [rad/s] → compliance C (k, n)
    grid       (k,) [rad/s] first samples, rising
    rounds     number of further samples per peak at most

    The first sample is a peak if |C| falls from it: compliance at rest. Near a peak 1/C is interpolated by a parabola in ω, as it is one
    near a resonance, however sharp; each further sample is at the peak of the last parabola. The frequency is that of the highest sample,
    the height that of the last parabola.
    """
    samples = response(grid)
    heights = np.abs(samples)
    padded = np.vstack([np.full(heights.shape[1], -np.inf), heights, np.full(heights.shape[1], -np.inf)])
    tops = (heights >= padded[:-2]) & (heights >= padded[2:]) & (heights > 0)
    rows, joints = np.nonzero(tops)
    inner = np.clip(rows, 1, max(len(grid) - 2, 1))[:, None] + np.array([-1, 0, 1])
    at, softness = grid[inner], samples[inner, joints[:, None]]
    best, found = grid[rows].copy(), heights[rows, joints]
    still = rows == 0
    guess, height = _between(at, softness)
    most = np.zeros(heights.shape[1])
    np.maximum.at(most, joints, found)
    high = np.where(still, found, np.fmax(height, found)) >= share * most[joints]
    joints, at, softness, guess, height = joints[high], at[high], softness[high], guess[high], height[high]
    best, found, still = best[high], found[high], still[high]
    for _ in range(rounds):
        moving = np.flatnonzero(~still & np.isfinite(guess))
        if not len(moving):
            break
        value = np.abs(sampled := response(guess[moving])[np.arange(len(moving)), joints[moving]])
        still[moving] = np.abs(height[moving] - value) < CLOSE * value
        best[moving] = np.where(value >= found[moving], guess[moving], best[moving])
        found[moving] = np.maximum(found[moving], value)
        at[moving], softness[moving] = _nearest_three(at[moving], softness[moving], guess[moving], sampled, best[moving])
        guess[moving], height[moving] = _between(at[moving], softness[moving])
    found = np.where((height > found) & (height < MOST_ABOVE * found) & (best > grid[0]), height, found)
    most = np.zeros(heights.shape[1])
    np.maximum.at(most, joints, found)
    high = found >= share * most[joints]
    return Peaks(joints[high], best[high], found[high])


def _between(at: Floats, softness: Complexes) -> tuple[Floats, Floats]:
    """Frequencies (p,) [rad/s] of peaks of |C|, and |C| there, if 1/C is a parabola through 1/softness (p, 3) at `at` (p, 3) [rad/s]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return _least_parabola(at, 1 / softness)


def _least_parabola(at: Floats, stiffness: Complexes) -> tuple[Floats, Floats]:
    middle, width = at[:, 1], at[:, 2] - at[:, 0]
    before, after = (at[:, 0] - middle) / width, (at[:, 2] - middle) / width
    low, high = (stiffness[:, 0] - stiffness[:, 1]) / before, (stiffness[:, 2] - stiffness[:, 1]) / after
    bend = (high - low) / (after - before)
    slope = high - bend * after
    x = before[:, None] + (after - before)[:, None] * TRIED
    sizes = np.abs(stiffness[:, 1:2] + x * (slope[:, None] + x * bend[:, None]))
    x = x[np.arange(len(x)), np.argmin(np.where(np.isfinite(sizes), sizes, np.inf), axis=1)]
    for _ in range(3):  # Newton's steps on the square of the size
        value, change = stiffness[:, 1] + x * (slope + x * bend), slope + 2 * x * bend
        rise = (value.conj() * change).real
        curve = np.abs(change) ** 2 + 2 * (value.conj() * bend).real
        step = np.where(curve > 0, -rise / curve, 0.0)
        x = np.clip(x + np.clip(step, -TRIED[1] * (after - before), TRIED[1] * (after - before)), before, after)
    return middle + x * width, 1 / np.abs(stiffness[:, 1] + x * (slope + x * bend))


def _nearest_three(at: Floats, softness: Complexes, more: Floats, value: Complexes, best: Floats) -> tuple[Floats, Complexes]:
    """Three neighbouring of four samples of C: frequencies (p, 3) and values (p, 3), around `best` (p,) [rad/s].

    The four are `softness` at `at` (p, 3), and `value` at `more` (p,); if two have one frequency, the former three.
    """
    every, values = np.column_stack([at, more]), np.column_stack([softness, value])
    order = np.argsort(every, axis=1, kind="stable")
    every, values = (np.take_along_axis(each, order, axis=1) for each in (every, values))
    first = np.where(np.argmin(np.abs(every - best[:, None]), axis=1) <= 1, 0, 1)[:, None] + np.arange(3)
    again = np.any(np.diff(every, axis=1) == 0, axis=1)  # the same frequency twice tells no parabola
    kept = np.where(again[:, None], at, np.take_along_axis(every, first, axis=1))
    return kept, np.where(again[:, None], softness, np.take_along_axis(values, first, axis=1))


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
        """Frequency [rad/s] of `least`; 0 if that is the static stiffness."""
        return float(self.omega[int(np.argmin(self.stiffness))])


def stiffness_of(loop: Loop, stable: bool) -> DynamicStiffness:
    """Dynamic stiffness of the links of `loop`, from build_loop, and its least damping ratio; all NaN if it is not `stable`.

    Raises GainroomError for a loop given as a transfer function: it has no link.
    """
    links = LinkCompliance.of(loop)
    if not stable:
        return DynamicStiffness.unknown(loop.size)
    roots = vibrations(loop)
    grid = frequencies(links, roots)
    controller = links.parts.controller

    def response(omega: Floats) -> Complexes:
        s = 1j * omega
        if loop.size == 1:
            return links.closed(s, controller, loop.gain)[:, None]
        return np.diagonal(links.at(s, links.feedback(s, controller, loop.gain)), axis1=1, axis2=2)

    found = peaks(response, grid)
    low = np.abs(response(np.array([grid[0], 0.1 * grid[0]])))
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
    """Highest undamped natural frequency [rad/s] of the plant with free motors; for a rigid plant, with the position gains as springs."""
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
    """Closed-loop roots s (m,) [1/s] with Im s > 0 and |s| up to ELASTIC times `highest_mode`."""
    most = ELASTIC * highest_mode(loop)
    if loop.kd_path is not None:
        lifted = Lifted(loop)
        values = np.linalg.eigvals(lifted.matrix()).astype(complex)
        roots = np.log(values[np.abs(values) > 0]) / lifted.period
    else:
        roots = roots_within(loop, most)
    return roots[(roots.imag > 0) & (np.abs(roots) <= most) & (np.abs(roots) >= AT_REST * most)]


def least_damping(loop: Loop, roots: Complexes | None = None) -> tuple[float, float]:
    """Least damping ratio −Re s/|s| of `vibrations`, and |s| [rad/s] there; 1 and NaN where nothing vibrates."""
    fastest = LinkCompliance.of(loop).fastest
    found = vibrations(loop) if roots is None else roots
    found = found[np.abs(found.imag) < (1 - 1e-9) * fastest]  # real and negative in z: no pair
    if not len(found):
        return 1.0, math.nan
    k = int(np.argmin(_damping(found)))
    return float(_damping(found)[k]), float(abs(found[k]))


def damping_by_kind(loop: Loop, sway: Floats, gears: Floats) -> dict[str, tuple[float, float]]:
    """Least damping ratio of each kind of vibration, and |s| [rad/s] there: "sway", "gearbox" and "loop", those that there are.

    sway    frequencies (k,) [rad/s] of sway; a root within NEAR of one is its
    gears   frequencies (k,) [rad/s] of peaks that the gearboxes limit: the root nearest to each is theirs
    """
    roots = vibrations(loop)
    roots = roots[np.abs(roots.imag) < (1 - 1e-9) * LinkCompliance.of(loop).fastest]
    kinds = np.full(len(roots), "loop", dtype=object)
    for omega in gears.tolist() if len(roots) else ():
        kinds[int(np.argmin(np.abs(roots - 1j * omega)))] = "gearbox"
    for omega in sway.tolist():
        kinds[np.abs(np.log(np.abs(roots) / omega)) < math.log(NEAR)] = "sway"
    found = {}
    for kind in ("sway", "loop", "gearbox"):
        own = roots[kinds == kind]
        if len(own):
            k = int(np.argmin(_damping(own)))
            found[kind] = float(_damping(own)[k]), float(abs(own[k]))
    return found


def _damping(roots: Complexes) -> Floats:
    return -roots.real / np.abs(roots)


def frequencies(links: LinkCompliance, roots: Complexes) -> Floats:
    """Frequencies (k,) [rad/s], rising, at which peaks of the compliance are searched: over all decades, and near each closed-loop root."""
    plant, controller = links.parts.plant, links.parts.controller
    corners = np.abs(plant.corners().every)
    sizes = np.concatenate([np.abs(roots), corners[corners > 1e-6 * corners.max(initial=0.0)], [controller.slowest(plant.size)]])
    sizes = sizes[np.isfinite(sizes)]
    low, high = (float(sizes.min()), float(sizes.max())) if len(sizes) else (1.0, 1.0)
    low, high = SLOWEST * low, min(FASTEST * high, links.fastest)
    wide = np.geomspace(low, high, max(2, math.ceil(PER_DECADE * math.log10(high / low))))
    beside = (roots.imag[:, None] - roots.real[:, None] * BESIDE).ravel()
    return distinct(np.concatenate([wide, beside[(beside > low) & (beside < high)]]))
