"""Requirements on a loop: the kinds, the register of all, and the set asked for of one loop.

Another one is a subclass or an instance of Requirement and an entry in REQUIREMENTS: files, analysis, recommendations, JSON, terminal and
pages know it from there (CONTRIBUTING.md, tests/test_extensions.py).
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import GainroomError
from .delay_reserve import delay_reserve, reserve_about, turned
from .excluded_sets import ROUND_OFF, Arc, Disk, ExcludedSet, Segment
from .gain_bounds import BOUNDS
from .jitter_margin import height_at, jitter_margin, speed, weight, width_about
from .linear.arrays import Floats
from .loop_protocols import LoopCurves, MarginRecord, SampledLoops
from .margin_units import from_db, to_db
from .measured_response import Sensed
from .requirement import Requirement, Shown
from .torque_noise import NoisePlane, torque_noise


@dataclass(frozen=True)
class GainMargin(Requirement):
    """Gain margin g > 1: the loop is stable for any common factor in [1/g, g] on all gains, and on those of one loop."""

    def in_unit(self, value: float) -> float:
        return to_db(value)

    def in_si(self, value: float) -> float:
        return from_db(value)

    def of_loops(self, found: Any) -> Floats | None:
        return found.one_loop_gain_margins

    def frequency(self, found: Any) -> float:
        """Frequency [rad/s] of vibration at the nearer limit of all gains together, up or down; NaN if one loop alone has less margin."""
        least = found.least_gain_margin * (1 + ROUND_OFF)
        if found.gain_margin <= least:
            return found.phase_crossover
        return found.lower_phase_crossover if least * found.lower_gain_margin >= 1 else math.nan

    def reach(self, needed: float) -> float:
        return 2 * needed

    def excluded(self, needed: float) -> ExcludedSet:
        return Segment(needed)

    def slopes(self, curves: LoopCurves, needed: float) -> Any:
        return curves.at_axis(self.name, needed)


@dataclass(frozen=True)
class PhaseMargin(Requirement):
    """Phase margin φ [rad]: the loop is stable for any phase in [−φ, φ] in all loops, and in one loop."""

    def in_unit(self, value: float) -> float:
        return math.degrees(value)

    def in_si(self, value: float) -> float:
        return math.radians(value)

    def of_loops(self, found: Any) -> Floats | None:
        return found.one_loop.phase_margin

    def named(self, found: Any) -> str:
        return f"{self.title} of one loop" if found.one_loop_phase_margin < found.common_phase_margin else self.title

    def frequency(self, found: MarginRecord) -> float:
        return super().frequency(found) if self.named(found) == self.title else math.nan

    def facts(self, found: MarginRecord) -> dict[str, Any]:
        return super().facts(found) | {"phase_margin_is": self.named(found)}

    def shortfall(self, needed: float, value: float) -> float:
        """Shortfall (needed − value)/needed of a phase margin; negative if it is met, inf if the value is not known."""
        return math.inf if math.isnan(value) else 1 - value / needed

    def excluded(self, needed: float) -> ExcludedSet:
        return Arc(needed)

    def slopes(self, curves: LoopCurves, needed: float) -> Any:
        return curves.at_circle(self.name, needed)


@dataclass(frozen=True)
class SensitivityBound(Requirement):
    """Bound M on |a S + b|, S = 1/(1 + L) of one loop, the other loops closed; a = `slope`, b = `offset`, M > |b|.

    a = 1, b = 0: peak sensitivity Ms. a = −1, b = 1: peak complementary sensitivity Mt, T = 1 − S.
    """

    slope: float = 1.0
    offset: float = 0.0
    at_most: bool = True
    low: float = 1.0

    @property
    def bounds_each_loop(self) -> bool:
        return True

    def of_loops(self, found: Any) -> Floats | None:
        return found.one_loop.peak_sensitivity if (self.slope, self.offset) == (1.0, 0.0) else None

    def excluded(self, needed: float) -> ExcludedSet:
        return Disk.of_ceiling(needed, self.slope, self.offset)

    def sampled(self, samples: SampledLoops) -> dict[str, float]:
        height, omega = samples.peak(self.slope, self.offset)
        return {self.bounds or self.name: height} | ({self.at_frequency: omega} if self.at_frequency else {})

    def slopes(self, curves: LoopCurves, needed: float) -> Any:
        return curves.at_peaks(self.name, needed, self.slope, self.offset)


@dataclass(frozen=True)
class DelayMargin(Requirement):
    """Delay margin τ [s] > 0: the loop is stable with any extra delay up to τ, equal in all loops."""

    def sampled(self, samples: SampledLoops) -> dict[str, float]:
        delay, omega = samples.delay()
        return {self.name: delay, self.at_frequency: omega}

    def slopes(self, curves: LoopCurves, needed: float) -> Any:
        return curves.at_delays(self.name, needed * (1 + TICKS))


@dataclass(frozen=True)
class VaryingDelays(Requirement):
    """Jitter margin δ [s] > 0: the loop is stable for delays of single commands that vary within a range of that width (jitter_margin.py).

    It is computed from the loop and proved by small gain: the bound is sufficient, so that a loop may tolerate a wider range.
    """

    def measured(self, loop: Any) -> float:
        return jitter_margin(loop).width

    def measured_about(self, loop: Any, near: Any) -> float:
        return width_about(near, jitter_margin(loop))

    def frequency(self, found: MarginRecord) -> float:
        """Frequency [rad/s] of the peak that bounds the jitter margin, in the loop with the least one; NaN if it is not known."""
        value, loops = self.value(found), found.loops if found.stable else ()
        return next((jitter_margin(loop).frequency for loop in loops if self.measured_once(loop) == value), math.nan)

    def weight(self, needed: float, actuated: Any, unsampled: Any) -> Callable[[Floats], Floats]:
        time = actuated.sample_time
        height = height_at(needed, time)
        if not isinstance(actuated, Sensed):
            return lambda omega: weight(actuated, unsampled, omega) / height
        if time is not None:
            actuated.feedback.require_one("the jitter margin of a sampled loop")
        return lambda omega: speed(omega, None) / height


@dataclass(frozen=True)
class ReservedDelay(Requirement):
    """Delay reserve τ [s] > 0: |T| |1 − e^(−jωτ)| ≤ 1, so that the loop is stable with any extra delay up to τ (delay_reserve.py).

    It is no more than the delay margin, and bounds |T| at all frequencies.
    """

    def measured(self, loop: Any) -> float:
        return delay_reserve(loop).width

    def measured_about(self, loop: Any, near: Any) -> float:
        return reserve_about(near, delay_reserve(loop))

    def frequency(self, found: MarginRecord) -> float:
        """Frequency [rad/s] of the peak that bounds the delay reserve, in the loop with the least one; NaN if it is not known."""
        value, loops = self.value(found), found.loops if found.stable else ()
        return next((delay_reserve(loop).frequency for loop in loops if self.measured_once(loop) == value), math.nan)

    def weight(self, needed: float, actuated: Any, unsampled: Any) -> Callable[[Floats], Floats]:
        return lambda omega: turned(omega * needed)


@dataclass(frozen=True)
class TorqueNoise(Requirement):
    """Bound [N m] > 0 on the standard deviation of every joint's torque command that the steps of its encoder make (torque_noise.py)."""

    at_most: bool = True
    shown: Shown = "known"

    def measured(self, loop: Any) -> float:
        return float(torque_noise(loop).max())

    def in_plane(self, loop: Any, first: Any, second: Any) -> Callable[[Floats, Floats], Floats] | None:
        if loop.sample_time is None or loop.resolution is None or loop.sensed is not None:
            return None
        return NoisePlane.of(loop.actuated, first, second, float(loop.resolution[0])).at


@dataclass(frozen=True)
class SwayDamping(Requirement):
    """Damping ratio ζ > 0 of a floating base's least damped sway; ∞ where nothing sways."""

    def value(self, found: MarginRecord) -> float:
        """Damping ratio of the least damped sway; inf of a stable loop in which nothing sways."""
        ratio = super().value(found)
        return math.inf if found.stable and math.isnan(ratio) else ratio

    def shortfall(self, needed: float, value: float) -> float:
        """Shortfall relative to the required ratio, which a loop may have on either side of 0; inf where the value is not known."""
        return math.inf if math.isnan(value) else 1 - value / needed

    def slopes(self, curves: LoopCurves, needed: float) -> Any:
        return curves.at_sway(self.name, needed)


TICKS = 0.01
"""Search beyond a required delay margin, relative to it, because a fraction of a tick is not exactly a phase."""

REQUIREMENTS: dict[str, Requirement] = {
    one.name: one
    for one in (
        GainMargin(
            "gain_margin",
            "gain margin",
            "gain_margin_db",
            "dB",
            bounds="least_gain_margin",
            low=1.0,
            most=100.0,
            usual=10 ** (6 / 20),
            meaning="the smallest factor, above or below 1, at which the robot starts to vibrate, on all gains at once or on the gains "
            "of one joint.",
        ),
        PhaseMargin(
            "phase_margin",
            "phase margin",
            "phase_margin_deg",
            "°",
            bounds="least_phase_margin",
            at_frequency="gain_crossover",
            high=math.pi,
            most=120.0,
            usual=math.pi / 6,
            of_several="phase margin of all loops",
            meaning="the smallest phase lag or lead at which the robot starts to vibrate, in all loops at once or in one loop. It belongs "
            "to the robot, not to a joint: where legs and ground couple the loops, it may be far less than that of every joint by itself.",
        ),
        SensitivityBound(
            "peak_sensitivity",
            "peak sensitivity",
            "peak_sensitivity",
            symbol="Ms",
            at_frequency="peak_sensitivity_frequency",
            most=1000.0,
            usual=2.0,
            of_several="Ms of one loop",
            meaning="the largest amplification of disturbances by one loop, other loops closed, at any frequency; 1/Ms is the least "
            "distance of its return ratio from −1.",
        ),
        DelayMargin(
            "delay_margin",
            "delay margin",
            "delay_margin_ms",
            "ms",
            scale=1e3,
            at_frequency="delay_crossover",
            most=1000.0,
            meaning="the smallest extra delay, in all loops at once, at which the robot starts to vibrate.",
        ),
        VaryingDelays(
            "jitter_margin",
            "jitter margin",
            "jitter_margin_ms",
            "ms",
            scale=1e3,
            most=1000.0,
            of_one=True,
            meaning="the width of the range within which the delay of every single command may vary, from joint to joint and tick to tick, "
            "with a proof that the robot does not start to vibrate.",
        ),
        ReservedDelay(
            "delay_reserve",
            "delay reserve",
            "delay_reserve_ms",
            "ms",
            scale=1e3,
            most=1000.0,
            shown="asked",
            meaning="the extra delay, constant and of each joint its own, up to which the robot provably does not start to vibrate.",
        ),
        TorqueNoise(
            "torque_noise",
            "torque noise",
            "torque_noise",
            "N·m",
            most=1e9,
            meaning="the largest standard deviation of a joint's torque command that the steps of its encoder make, all loops closed.",
        ),
        Requirement(
            "dynamic_stiffness",
            "dynamic stiffness",
            "dynamic_stiffness",
            "N·m/rad",
            at_frequency="dynamic_stiffness_frequency",
            of_one=True,
            meaning="the least stiffness that a load torque on a joint's link meets at any frequency, the least of all joints.",
        ),
        Requirement(
            "least_damping_ratio",
            "least damping ratio",
            "least_damping_ratio",
            at_frequency="least_damping_frequency",
            high=1.0,
            of_one=True,
            meaning="the damping ratio of the least damped vibration of motors and links, with all loops closed.",
        ),
    )
}
"""All requirements, by name. Defaults: 6 dB, 30°, Ms 2 (Åström and Murray 2021, sec. 12.3), none of delay, jitter and noise."""


SWAY_DAMPING = SwayDamping("sway_damping_ratio", "damping ratio of sway", "sway_damping_ratio", high=1.0)
"""What recommended gains keep where a balance controller damps sway (design/swaying.py). No file asks for it: it judges no gains."""

NOISE_SHARE = 0.02
"""Torque noise of a joint that is allowed by default, as a share of the peak torque."""


def reported(asked: "Requirements | None", several: bool, *found: MarginRecord) -> list[Requirement]:
    """Requirements whose margins are reported.

    For `several` joints, requirements defined for one loop alone are reported only if `asked` for. A requirement that is not `shown`
    always needs to be asked for, or, where it is shown once known, to have a known value in one of `found`.
    """

    def is_reported(one: Requirement) -> bool:
        if asked is not None and one.name in asked.needed:
            return True
        if one.shown == "asked" or (several and one.of_one):
            return False
        return one.shown == "always" or not all(math.isnan(one.value(margins)) for margins in found)

    return list(filter(is_reported, REQUIREMENTS.values()))


def title_of(name: str) -> str:
    """Title of the requirement or of the bound of gains `name`; `name` itself where there is none ("stability")."""
    titles = {one.name: one.title for one in (*REQUIREMENTS.values(), SWAY_DAMPING)} | {bound: f"bound {bound}" for bound in BOUNDS}
    return titles.get(name, name)


@dataclass(frozen=True, init=False, repr=False)
class Requirements:
    """Required margins of a loop in SI, each an attribute by its name; None: not required.

     gain_margin        a factor > 1: 2 is 6.02 dB; files have `gain_margin_db`
     phase_margin       [rad], > 0 and < π: numpy.radians(30) is 30°; files have `phase_margin_deg`
     peak_sensitivity   Ms > 1, upper bound; without a unit
     delay_margin       [s], > 0; files have `delay_margin_ms`
     asked_for          required ones, each with its value

    Requirements() requires stability alone, Requirements.usual() 6 dB, 30° and Ms 2. Raises GainroomError for an unknown name and for
    values that are not admissible.
    """

    asked_for: tuple[tuple[Requirement, float], ...]

    def __init__(
        self,
        gain_margin: float | None = None,
        phase_margin: float | None = None,
        peak_sensitivity: float | None = None,
        **others: float | None,
    ) -> None:
        given = {"gain_margin": gain_margin, "phase_margin": phase_margin, "peak_sensitivity": peak_sensitivity, **others}
        for name, value in given.items():
            if name not in REQUIREMENTS:
                raise GainroomError(f"requirements: {name} is unknown; there are {', '.join(REQUIREMENTS)}")
            if value is not None:
                REQUIREMENTS[name].check(value)
        asked_for = tuple((one, value) for name, one in REQUIREMENTS.items() if (value := given.get(name)) is not None)
        object.__setattr__(self, "asked_for", asked_for)

    @classmethod
    def usual(cls) -> "Requirements":
        """Default requirements, where a file names none: 6 dB, 30° and Ms 2."""
        return cls(**{name: one.usual for name, one in REQUIREMENTS.items()})

    def __getattr__(self, name: str) -> float | None:
        if name not in REQUIREMENTS:
            raise AttributeError(name)
        return self.needed.get(name)

    def __repr__(self) -> str:
        return f"Requirements({', '.join(f'{name}={value!r}' for name, value in self.needed.items())})"

    def __str__(self) -> str:
        """Requirements as text: "gain margin ≥ 6 dB, phase margin ≥ 30°, Ms ≤ 2"."""
        return ", ".join(f"{one.heading} {one.sign} {one.text(needed)}" for one, needed in self.asked_for) or "stability alone"

    @property
    def needed(self) -> Mapping[str, float]:
        """Required values by name."""
        return {one.name: needed for one, needed in self.asked_for}

    @property
    def asked(self) -> tuple[str, ...]:
        """Names of the requirements asked for."""
        return tuple(self.needed)

    def asked_by(self, name: str) -> tuple[Requirement, float]:
        """The requirement `name`, which is asked for, and its value."""
        return next(pair for pair in self.asked_for if pair[0].name == name)

    def only(self, *names: str) -> "Requirements":
        """Requirements restricted to `names`."""
        return self._of((one, needed) for one, needed in self.asked_for if one.name in names)

    def also(self, one: Requirement, needed: float) -> "Requirements":
        """Requirements with one more."""
        return self._of((*self.asked_for, (one, needed)))

    def tightened(self, share: float) -> "Requirements":
        """Requirements with every bound stricter by `share` of it."""
        return self._of((one, one.tightened(needed, share)) for one, needed in self.asked_for)

    @staticmethod
    def _of(asked_for: Iterable[tuple[Requirement, float]]) -> "Requirements":
        found = Requirements()
        object.__setattr__(found, "asked_for", tuple(asked_for))
        return found

    def met(self, name: str, value: float) -> bool | None:
        """True if `value` meets the requirement `name` within ROUND_OFF; None where it is not asked for, False for NaN."""
        if name not in self.needed:
            return None
        one, needed = self.asked_by(name)
        return one.met(needed, value)

    def met_by(self, found: MarginRecord) -> bool:
        """True if the loop of `found` is stable and meets every requirement."""
        return found.stable and all(one.met(needed, one.value(found)) for one, needed in self.asked_for)

    def missed(self, found: MarginRecord) -> str:
        """Name of the requirement with the largest shortfall, or "stability"; "" where all are met."""
        if not found.stable:
            return "stability"
        short = self.shortfalls(found)
        missed = [one.name for one, needed in self.asked_for if not one.met(needed, one.value(found))]
        return max(missed, key=lambda name: short[name], default="")

    def shortfall(self, found: MarginRecord) -> float:
        """Largest shortfall over all requirements: a log ratio of gain or sensitivity, or a share of the phase.

        Negative where all are met; inf where the loop is unstable or a value is not known.
        """
        return max(self.shortfalls(found).values(), default=-math.inf) if found.stable else math.inf

    def shortfalls(self, found: MarginRecord) -> dict[str, float]:
        """Shortfall of each requirement, by name; inf where the loop is unstable."""
        return {one.name: one.shortfall(needed, one.value(found)) if found.stable else math.inf for one, needed in self.asked_for}
