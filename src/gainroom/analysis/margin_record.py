"""Margins of a loop of n >= 1 joints: one record, whatever n is. An unstable loop has no margins: they are NaN."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..errors import GainroomError, at_frequency
from ..system.linear.arrays import Booleans, Complexes, Floats
from ..system.loop import Loop
from ..system.margin_units import to_db
from .dynamic_stiffness import DynamicStiffness, least_damping, stiffness_of

NUDGE = 1e-6
"""Relative distance from a limit, to both sides, at which its certificate counts roots."""


@dataclass(frozen=True)
class Certificate:
    """Certificate of a limit: numbers of unstable closed-loop roots just inside and just outside it; −1: not counted.

    Both numbers are counted; of a proved limit (proved_limit.py) none inside is proved, and `outside` is the roots of the crossings found,
    at least.
    """

    inside: int
    outside: int
    nudge: float = NUDGE

    @property
    def holds(self) -> bool:
        """True when the limit has been confirmed from both sides."""
        return self.inside == 0 and self.outside != 0


@dataclass(frozen=True)
class End:
    """End of stability along a factor or delay: the value `at` which a root reaches jω, ω = `omega` [rad/s], with its mode and certificate.

    mode   (n,) complex, the largest part 1
    """

    at: float
    omega: float
    mode: Complexes
    certificate: Certificate


class PhaseCrossing(NamedTuple):
    """Crossing of the negative real axis by L at `omega` [rad/s]; multiplying the gains by `gain` = −1/Re L puts a root at jω."""

    omega: float
    gain: float


class GainCrossing(NamedTuple):
    """Crossing |L| = 1 at `omega` [rad/s]: its phase_margin [rad] in (−π, π], and delay_margin [s], extra delay that puts a root at jω.

    delay_margin = φ/ω, φ = π + arg L in [0, 2π): the phase margin, or 2π more where that is negative.
    """

    omega: float
    phase_margin: float
    delay_margin: float


@dataclass(frozen=True)
class GainLimit:
    """The stable interval of the common gain factor g.

    stable       at g = 1
    gain         its upper end: > 1 where the loop is stable; < 1 where it is not, and lowering the gains to it would make it so;
                 0 where no lower gain is stable; inf of several joints: above 1000, as factors up to 1000 are looked at; inf of one joint:
                 no higher gain is unstable (in continuous time: none below 1e9)
    lower_gain   its lower end, 0 where every lower gain is stable (coupled loops: down to 1e-4 of them, or 0.1
                 where round-off hides more), NaN where no factor below 1 is
    frequency    of the vibration at the upper end [rad/s], 0 where the robot topples, NaN where there is none
    mode         (n,) complex, the joints' parts in that vibration, the largest 1
    certificate, lower_certificate   of the upper and the lower end, None where there is none
    lower_frequency   at the lower end [rad/s], likewise

    Coupled loops: roots that the gains do not move (joints left free) are not counted.
    """

    stable: bool
    gain: float
    lower_gain: float
    frequency: float
    mode: Complexes
    certificate: Certificate | None
    lower_certificate: Certificate | None = None
    lower_frequency: float = math.nan

    @classmethod
    def unknown(cls, size: int, stable: bool = True) -> "GainLimit":
        """Gain limit of `size` joints of which nothing but `stable` is known: all numbers are NaN."""
        return cls(stable, math.nan, math.nan, math.nan, np.ones(size, dtype=complex), None)

    @property
    def certified(self) -> bool:
        """True where roots were counted on both sides of every end."""
        return all(one.holds for one in (self.certificate, self.lower_certificate) if one is not None)


def interval(loop: Loop, upper: End | None, lower: End | None, stable: bool = True) -> GainLimit:
    """Gain limit of `loop` from the upper and lower end of its stable interval; an end None: there is none."""
    mode = np.ones(loop.size, dtype=complex) if upper is None else upper.mode
    gain, omega, certificate = (math.inf, math.nan, None) if upper is None else (upper.at, upper.omega, upper.certificate)
    if lower is None:
        return GainLimit(stable, gain, 0.0, omega, mode, certificate)
    return GainLimit(stable, gain, lower.at, omega, mode, certificate, lower.certificate, lower.omega)


@dataclass(frozen=True)
class OneLoop:
    """Margins of one loop at a time, the other n − 1 loops closed. Arrays (n,).

    gain_margin, lower_gain_margin   largest and smallest factor on the gains that act on what one joint measures; inf and 0 where none
                   (n > 1: none up to 1000, none above 1e-3)
    phase_margin   [rad] the smallest phase, lag or lead; inf where none
    certified      True where roots were counted on both sides of the factors and of the largest gains; for n = 1 as the scan is
    peak_sensitivity   the largest |S_ii|; None where it was not worked out loop by loop
    largest_kp, largest_kd   largest diagonal gains, the other gains as they are [N m/rad], [N m s/rad]; None where the controller has
                   no such gains, and where they were not asked for (see joint_margins)
    """

    gain_margin: Floats
    lower_gain_margin: Floats
    phase_margin: Floats
    certified: Booleans
    largest_kp: Floats | None = None
    largest_kd: Floats | None = None
    peak_sensitivity: Floats | None = None

    @classmethod
    def unknown(cls, size: int) -> "OneLoop":
        """Record of an unstable loop: NaN for each of `size` joints."""
        nothing = np.full(size, math.nan)
        return cls(nothing, nothing, nothing, np.zeros(size, dtype=bool), nothing, nothing)


@dataclass(frozen=True)
class PathMargins:
    """Margins of each path of a loop whose kd closes on a path of its own: factors on all gains of one path, the other path's as they are.

    others, kd   the smallest factor > 1 at which the loop is lost, inf where none is up to 1e3
    lower_others, lower_kd   the largest factor < 1, 0 where none is down to 1e-3
    certified    roots were counted on both sides of each
    """

    others: float
    lower_others: float
    kd: float
    lower_kd: float
    certified: bool

    @property
    def headroom(self) -> float:
        """Smallest factor, up or down, on either path's gains that makes the loop unstable, as a number > 1."""
        return min(self.others, self.kd, *(1 / low for low in (self.lower_others, self.lower_kd) if low > 0))


@dataclass(frozen=True)
class Margins:
    """All margins of one loop of n joints: of all loops together and, in `one_loop`, of one at a time.

    limit                        stable interval of the common factor on all gains; reported for unstable loops, too
    unstable_roots               the verdict: 0 where the loop is stable; −1: unstable, roots not counted
    phase_margin, gain_crossover [rad] the smallest common phase in size, with its sign (> 0: lag), and its frequency [rad/s]; inf: none
    delay_margin, delay_crossover   the smallest extra delay in all loops [s], and its frequency [rad/s]; inf: none (n > 1: up to 1 s)
    peak_sensitivity             Ms = max |S_ii|, S = (I + L)⁻¹, at peak_sensitivity_frequency [rad/s]: for n > 1 the largest of one loop,
                                 the other loops closed
    peak_complementary           Mt = max |T_ii|, T = I − S, at peak_complementary_frequency [rad/s], likewise
    disk_margin                  balanced disk margin (Seiler, Packard and Gahinet 2020; for n = 1 min 2|1+L|/|1−L|), at
                                 disk_margin_frequency [rad/s]: every motor's torque multiplied by its own factor, the loops opened at the
                                 torques. With gains per joint the measured positions give the same number, with tasks another;
                                 disk_certified: proved between frequencies
    one_loop                     (n,) arrays
    certified                    n = 1: nothing between the evaluated frequencies was missed (False for loops given as callables);
                                 n > 1: roots were counted on both sides of every limit, phase, delay and factor on one loop
    phase_certificate, delay_certificate   roots counted on both sides; None where there is no such margin, and for n = 1
    paths                        where kd closes on a path of its own; else None
    phase_crossings, gain_crossings   all of them for n = 1; in continuous time down to |L| = 0.001, or to where no nearer one can follow
    sway_damping_ratio           least damping ratio of a floating base's sway; NaN where nothing sways, or nobody asked (design/swaying.py)
    loops                        whose margins these are: one, or all of which they are the worst; () where they are not known. Requirements
                                 on what is no margin are measured there
    """

    limit: GainLimit
    one_loop: OneLoop
    unstable_roots: int = 0
    phase_margin: float = math.nan
    gain_crossover: float = math.nan
    delay_margin: float = math.nan
    delay_crossover: float = math.nan
    peak_sensitivity: float = math.nan
    peak_sensitivity_frequency: float = math.nan
    peak_complementary: float = math.nan
    peak_complementary_frequency: float = math.nan
    disk_margin: float = math.nan
    disk_margin_frequency: float = math.nan
    disk_certified: bool | None = None
    certified: bool = False
    phase_certificate: Certificate | None = None
    delay_certificate: Certificate | None = None
    paths: PathMargins | None = None
    sway_damping_ratio: float = math.nan
    phase_crossings: tuple[PhaseCrossing, ...] = ()
    gain_crossings: tuple[GainCrossing, ...] = ()
    loops: tuple[Loop, ...] = field(default=(), repr=False, compare=False)

    @classmethod
    def unknown(cls, limit: GainLimit) -> "Margins":
        """Margins of which nothing is known but the stability and gain limit in `limit`; all others are NaN."""
        return cls(limit, OneLoop.unknown(len(limit.mode)), unstable_roots=0 if limit.stable else -1)

    def __repr__(self) -> str:
        size = len(self.one_loop.gain_margin)
        joints = f"{size} joints, " if size > 1 else ""

        def level(factor: float) -> str:
            return "above 60" if size > 1 and math.isinf(factor) else f"{to_db(factor):.4g}"

        if not self.stable:
            lower = f", gain limit {self.limit.gain:.4g} times the gains" if 0 < self.limit.gain < 1 else ""
            return f"Margins({joints}unstable{lower})"
        texts = [
            f"gain margin {level(self.gain_margin)} dB{at_frequency(self.phase_crossover)}",
            f"lower gain margin {to_db(self.lower_gain_margin):.4g} dB" if self.lower_gain_margin > 0 else "",
            f"phase margin {math.degrees(self.phase_margin):.4g}°{at_frequency(self.gain_crossover)}",
            f"delay margin {1e3 * self.delay_margin:.4g} ms",
            f"Ms {self.peak_sensitivity:.4g}",
        ]
        if size > 1:
            one_loop = level(float(np.min(self.one_loop_gain_margins)))
            texts.append(f"one loop at a time {one_loop} dB and {math.degrees(self.one_loop_phase_margin):.4g}°")
        return f"Margins({joints}stable, {', '.join(filter(None, texts))})"

    @cached_property
    def links(self) -> DynamicStiffness:
        """Links of `loops`: of each joint the least dynamic stiffness of all, and the least damping ratio; NaN where it is not known."""
        size = len(self.one_loop.gain_margin)
        try:
            found = [stiffness_of(loop, self.stable) for loop in self.loops]
        except GainroomError:  # of a transfer function, or of gains without their joint
            found = []
        return DynamicStiffness.least_of(found) if found and self.stable else DynamicStiffness.unknown(size)

    @property
    def dynamic_stiffness(self) -> float:
        """Least dynamic stiffness of all joints that a load moves [N m/rad]; NaN if it is not known."""
        return self.links.least

    @property
    def dynamic_stiffness_frequency(self) -> float:
        """Frequency [rad/s] of `dynamic_stiffness`; 0 if that is the static stiffness."""
        return self.links.least_frequency

    @cached_property
    def _least_damped(self) -> tuple[float, float]:
        """Damping ratio and frequency [rad/s] of the least damped vibration of `loops`; NaN where it is not known."""
        try:
            found = [least_damping(loop) for loop in self.loops] if self.stable else []
        except GainroomError:  # of a transfer function, or of gains without their joint
            found = []
        return min(found, default=(math.nan, math.nan))

    @property
    def least_damping_ratio(self) -> float:
        """Least damping ratio of the vibrations of motors and links, all loops closed; 1 if nothing vibrates, NaN if it is not known."""
        return self._least_damped[0]

    @property
    def least_damping_frequency(self) -> float:
        """Frequency |s| [rad/s] of the least damped vibration; NaN where there is none."""
        return self._least_damped[1]

    @property
    def stable(self) -> bool:
        """True if the loop is stable at its present gains."""
        return self.limit.stable

    @property
    def gain_margin(self) -> float:
        """Factor > 1 on all gains at which the loop becomes unstable; inf if there is none, for several joints none up to 1000."""
        return self.limit.gain if self.stable else math.nan

    @property
    def phase_crossover(self) -> float:
        """The frequency of the vibration at the gain margin [rad/s]; NaN where there is none."""
        return self.limit.frequency if self.stable else math.nan

    @property
    def lower_gain_margin(self) -> float:
        """Factor < 1 on all gains at which a conditionally stable loop becomes unstable; 0 if there is none."""
        return self.limit.lower_gain if self.stable else math.nan

    @property
    def lower_phase_crossover(self) -> float:
        """The frequency at the lower gain margin [rad/s]; NaN where there is none."""
        return self.limit.lower_frequency if self.stable else math.nan

    @property
    def gain_headroom(self) -> float:
        """Smallest factor, up or down, on all gains that makes the loop unstable, as a number > 1."""
        return min(self.gain_margin, 1 / self.lower_gain_margin if self.lower_gain_margin > 0 else math.inf)

    @property
    def least_gain_margin(self) -> float:
        """Smallest factor > 1, up or down, on all gains or on those of one loop or path, that makes it unstable: the bounded value."""
        whole = [self.gain_headroom, math.inf if self.paths is None else self.paths.headroom]
        return float(np.min(np.append(self.one_loop_gain_margins, whole)))

    @property
    def one_loop_gain_margins(self) -> Floats:
        """Smallest factor (n,), up or down, on the gains of each loop alone that makes it unstable, as numbers > 1."""
        with np.errstate(divide="ignore"):
            return np.minimum(self.one_loop.gain_margin, 1 / self.one_loop.lower_gain_margin)

    @property
    def common_phase_margin(self) -> float:
        """Size [rad] of the smallest phase, lag or lead, in all loops at once that makes the loop unstable."""
        return abs(self.phase_margin)

    @property
    def one_loop_phase_margin(self) -> float:
        """Size [rad] of the smallest phase, lag or lead, in one loop alone that makes it unstable."""
        return float(self.one_loop.phase_margin.min())

    @property
    def least_phase_margin(self) -> float:
        """Size [rad] of the smallest phase, lag or lead, in all loops or in one, that makes it unstable: what requirements bound."""
        return min(self.common_phase_margin, self.one_loop_phase_margin)


def worst_of(found: Sequence[Margins]) -> Margins:
    """Every margin, with its frequency, from the loop where it is smallest; no lists of crossings, and no certificates.

    A margin that is not known of one loop (NaN) is not known of the worst.
    """

    def least(size: Callable[[Margins], float]) -> Margins:
        return min(found, key=lambda one: -math.inf if math.isnan(size(one)) else size(one))

    closest = {
        "phase_margin gain_crossover": least(lambda one: abs(one.phase_margin)),
        "delay_margin delay_crossover": least(lambda one: one.delay_margin),
        "peak_sensitivity peak_sensitivity_frequency": least(lambda one: -one.peak_sensitivity),
        "peak_complementary peak_complementary_frequency": least(lambda one: -one.peak_complementary),
        "disk_margin disk_margin_frequency": least(lambda one: one.disk_margin),
    }
    upper, lower = (least(lambda one: one.limit.gain).limit, least(lambda one: -one.limit.lower_gain).limit)
    low = {"lower_gain": lower.lower_gain, "lower_frequency": lower.lower_frequency}
    limit = replace(upper, stable=all(one.stable for one in found), certificate=None, **low)
    loops = [one.one_loop for one in found]
    one_loop = OneLoop(
        gain_margin=np.min([one.gain_margin for one in loops], axis=0),
        lower_gain_margin=np.max([one.lower_gain_margin for one in loops], axis=0),
        phase_margin=np.min([one.phase_margin for one in loops], axis=0),
        certified=np.all([one.certified for one in loops], axis=0),
    )
    values = {name: getattr(case, name) for names, case in closest.items() for name in names.split()}
    values["sway_damping_ratio"] = float(np.fmin.reduce([one.sway_damping_ratio for one in found]))
    paths = [one.paths for one in found if one.paths is not None]
    of_paths = PathMargins(
        others=min(one.others for one in paths),
        lower_others=max(one.lower_others for one in paths),
        kd=min(one.kd for one in paths),
        lower_kd=max(one.lower_kd for one in paths),
        certified=all(one.certified for one in paths),
    ) if paths else None  # fmt: skip
    judged = tuple(loop for one in found for loop in one.loops) if all(one.loops for one in found) else ()
    return Margins(limit, one_loop, **values, certified=all(one.certified for one in found), paths=of_paths, loops=judged)
