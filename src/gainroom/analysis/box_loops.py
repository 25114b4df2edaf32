"""The return ratio of one joint in boxes of frequency and uncertain parameters: a sector that contains L everywhere in each box.

The sectors are computed in native/include/gainroom/box_loop.hpp. This module holds the ranges, and the bounds of L beyond the frequencies
that the boxes cover.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..native import _core
from ..system.assembly import current_loop
from ..system.drive import Drive
from ..system.elastic_joint import ElasticJoint
from ..system.feedback import GivenFeedback, feedback_of
from ..system.linear.arrays import Complexes, Floats
from ..system.linear.transfer_function import Factored
from ..system.uncertainty import Uncertainty

FEWEST_ALIASES = 3
TURN = 2 * math.pi
QUANTITIES = ("delay", "stiffness", "link_inertia", "motor_inertia", "damping")  # in the order of the core


@dataclass(frozen=True)
class Sectors:
    """Bounds of the return ratio L over each of n boxes: intervals of log|L| and of arg L, the latter known up to full turns. Arrays (n,).

    center   (n,) L in the middle of each box
    score    (n, p) how much each parameter's width moves L: the widest is split first
    """

    log_low: Floats
    log_high: Floats
    phase_low: Floats
    phase_high: Floats
    center: Complexes
    score: Floats

    def apart(self) -> Floats:
        """Least distance (n,) [rad] between arg L and arg(−1) over each box; 0 where L may be real and negative."""
        nearest = math.pi * (2 * np.floor((self.phase_low + self.phase_high) / (4 * math.pi)) + 1)
        return np.maximum(0.0, np.maximum(self.phase_low - nearest, nearest - self.phase_high))


class BoxLoop:
    """One joint's loop over ranges. `names`: the parameters beside the frequency, which is number 0, in the order of the boxes."""

    def __init__(
        self,
        joint: ElasticJoint,
        drive: Drive,
        uncertainty: Uncertainty,
        controller: Any,
        feedback: GivenFeedback,
        sample_time: float | None,
    ) -> None:
        self.feedback, self.sample_time = feedback_of(feedback, controller), sample_time
        self.feedback.require_one("a bound over ranges")
        values = {name: drive.delay if name == "delay" else getattr(joint, name) for name in QUANTITIES}
        self.viscous = float(joint.motor_viscous), float(joint.link_viscous)
        self.ranges = {name: getattr(uncertainty, name) for name in uncertainty.names}
        self.nominal = values | {name: low for name, (low, high) in self.ranges.items() if low == high}
        self.names = tuple(name for name, (low, high) in self.ranges.items() if low < high)
        self.low = np.array([self.ranges[name][0] for name in self.names])
        self.high = np.array([self.ranges[name][1] for name in self.names])
        self.rigid, self.locked = (name not in self.names and math.isinf(self.nominal[name]) for name in ("stiffness", "link_inertia"))
        self.currents = current_loop(drive)
        self.control = controller.transfer(sample_time)
        self.aliases = 0 if sample_time is None else self._aliases()
        self._core = self._compiled()

    def _compiled(self) -> _core.BoxLoop:
        columns = [1 + self.names.index(name) if name in self.names else 0 for name in QUANTITIES]
        return _core.BoxLoop(
            values=np.array([*(self.nominal[name] for name in QUANTITIES), *self.viscous]),
            columns=np.array(columns),
            motor_side=self.feedback.motor,
            current_poles=self.currents.poles,
            current_gain=self.currents.gain,
            zeros=self.control.zeros,
            poles=self.control.poles,
            gain=self.control.gain,
            control_delay=self.control.delay,
            sample_time=self.sample_time or 0.0,
            aliases=self.aliases,
            rest=self._rest(),
        )

    def _rest(self) -> float:
        """Upper bound, divided by ω, of the terms that the sum over aliases leaves out: there |P C|/ω falls at least as 1/ω³."""
        if not self.aliases:
            return 0.0
        count, rate = self.aliases + 0.5, TURN / (self.sample_time or 1.0)
        return 2 * self.roll_off(count * rate) / (count * rate) * (1 + count / 2)

    def _ends(self, name: str) -> tuple[float, float]:
        return self.ranges.get(name, (self.nominal[name], self.nominal[name]))

    @property
    def nyquist(self) -> float | None:
        """Half the sample rate [rad/s]; None in continuous time."""
        return None if self.sample_time is None else math.pi / self.sample_time

    def resonances_in(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Lowest and highest resonance [rad/s] within each box, as `at` takes them; for an elastic joint."""
        ends = []
        for soft, heavy in ((low, high), (high, low)):
            inverse_inertia = 1 / self._end("motor_inertia", heavy) + 1 / self._end("link_inertia", heavy)
            ends.append(np.sqrt(self._end("stiffness", soft) * inverse_inertia))
        return ends[0], ends[1]

    def _end(self, name: str, corners: Floats) -> Any:
        return corners[:, 1 + self.names.index(name)] if name in self.names else self.nominal[name]

    @property
    def resonances(self) -> tuple[float, float]:
        """Lowest and highest resonance [rad/s] within the ranges; (inf, inf) for a rigid joint."""
        ends = [self._ends(name) for name in ("stiffness", "motor_inertia", "link_inertia")]
        (soft, stiff), (light, heavy), (least, most) = ends
        if self.rigid:
            return math.inf, math.inf
        return math.sqrt(soft * (1 / heavy + 1 / most)), math.sqrt(stiff * (1 / light + 1 / least))

    def roll_off(self, omega: float) -> float:
        """A bound of |P C| at `omega` [rad/s] that also holds at every ω beyond, times (omega/ω)²; inf where there is none yet."""
        (soft, _), (light, _), (least, most), (_, lossy) = (
            self._ends(name) for name in ("stiffness", "motor_inertia", "link_inertia", "damping")
        )
        plant = 1 / (omega**2 * (light + (0.0 if self.locked else least)))
        if not self.rigid:
            swing = (omega / self.resonances[1]) ** 2
            spring = math.hypot(1.0, omega * lossy / soft) / swing
            motor, link = self.viscous
            held = spring if self.locked else spring * math.hypot(1.0, (motor + link) / (omega * (light + least)))
            if held >= 0.9:
                return math.inf
            above = 1.0 if self.locked else spring
            if self.feedback.motor and not self.locked:
                above += (1 + most / light) * math.hypot(1.0, link / (omega * least))
            plant *= above / (1 - held)
        return plant * _beyond(self.currents, omega)

    def silent_above(self, size: float) -> float:
        """A frequency [rad/s] beyond which |L| < `size` everywhere in the ranges; continuous time."""
        omega = 2 * max([1.0, *np.abs(np.concatenate([self.currents.poles, self.control.zeros, self.control.poles])).tolist()])
        for _ in range(200):
            if self.roll_off(omega) * _beyond(self.control, omega) < size:
                return omega
            omega *= 2
        return math.inf

    @property
    def boundable(self) -> bool:
        """True if |L| beyond the sampled frequencies is bounded for every joint of the ranges, so that a proof can come to an end."""
        return self.aliases > 0 if self.sample_time is not None else math.isfinite(self.silent_above(1e-3))

    def _aliases(self) -> int:
        """Number of terms of the sum to either side that are added up; 0 where the rest cannot be bounded."""
        assert self.sample_time is not None
        rate = TURN / self.sample_time
        counts = range(FEWEST_ALIASES, _core.MOST_ALIASES + 1)
        return next((count for count in counts if math.isfinite(self.roll_off((count + 0.5) * rate))), 0)

    def at(self, low: Floats, high: Floats, scaled: bool) -> Sectors:
        """Sectors of boxes `low` to `high` (n, p); column 0: ω [rad/s], or ν where `scaled`."""
        (log_low, log_high, phase_low, phase_high), (center,), score = self._core.at(low, high, scaled)
        return Sectors(log_low, log_high, phase_low, phase_high, center, score)


def _beyond(system: Factored, omega: float) -> float:
    """A bound of |system(jω)| at `omega` that beyond it falls or grows no quicker than the power of ω of its roots."""
    size = abs(system.gain) * omega ** (len(system.zeros) - len(system.poles))
    for sign, roots in ((1, system.zeros), (-1, system.poles)):
        for root in np.abs(roots).tolist():
            if root >= omega:
                return math.inf
            size *= 1 + root / omega if sign > 0 else 1 / (1 - root / omega)
    return size
