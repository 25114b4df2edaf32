"""Readings of missing data: plausible values for everything that is not given, and the verdict that they decide.

Values are sets that nobody stated, so a single unsafe one among safe ones decides nothing:

- loop rate: USUAL_RATES; continuous time, in which a system without a rate is computed, is none of them
- gearbox stiffness: rigid, down to the softest known type, with its least damping (robot/gearbox_types.py)
- motor inertia: from none, or a tenth on an elastic gearbox, to that of what it moves; it grows with the square of the gear ratio

Unsafe in all readings is unsafe, safe in all is safe, anything else undecided. Only as many readings as needed are computed: first one
quantity after the other, then all together; margins are sampled as at corners of an uncertainty.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..analysis.margin_record import Margins
from ..design.gain_cases import bounded_margins, own_case
from ..errors import GainroomError
from ..robot.gearbox_types import TYPES
from ..system.excluded_sets import ROUND_OFF
from ..system.linear.arrays import Floats
from ..system.system import StateCase, System
from ..system.uncertainty import Uncertainty
from .loop_numbers import margins_of
from .over_uncertainty import uncertain_cases
from .state import USUAL_RATE, State, state_of
from .sway import without_sway
from .verdict import Level, Read, Reading
from .worst_place import FEW, try_places

USUAL_RATES = (USUAL_RATE, 4e4, 1e4, 5e3, 1e3, 500.0, 200.0)
"""Usual rates [Hz] of loops that close kp and kd, from 200 Hz of slow buses to 40 kHz inside a drive (Katz 2018, the Mini Cheetah).

The commonest first, then those that cost least margin.
"""
KINDS = sorted(TYPES.values(), key=lambda one: one.resonance)
STIFFEST = 1e4
"""Highest resonance [rad/s] of a motor on its gearbox, 1.6 kHz: six times that of the stiffest known type; a higher one counts as rigid."""
SHARES = (1.0, 0.1)
"""Assumed motor inertias as shares of the inertia moved: the most, and the middle of the logarithmic range of geared robots."""
AROUND = np.geomspace(0.8, 1.25, 7)
"""Frequencies at which a reading is compared with the required peak sensitivity first, relative to that of the peak as computed."""
Change = Callable[[System], System]


def read(system: System, states: Sequence[State], level: Level, ranges: Uncertainty | None = None) -> Read:
    """Decision over all readings of a system whose `level` was computed in continuous time, rigid, with motor inertias of actuators.py.

    states   those in which the gains act, unsafe ones first
    ranges   uncertainty whose worst place the system is at
    """
    if not states:  # nothing moves in any, so that nothing can be looked at
        return Read("undecided", dict.fromkeys(system.source.unknown, ()))
    peaks = {state.title: state.margins.peak_sensitivity_frequency for state in states} if level == "unsafe" else {}
    if not system.rate_is_missing:
        return _Readings(system, states, level, ranges, peaks).read()
    rates, every = list[Reading](), list[_Readings]()
    for rate in USUAL_RATES:
        at_rate = [replace(state, system=_at_rate(state.system, rate)) for state in states]
        sampled = _Readings(_at_rate(system, rate), at_rate, level, ranges, peaks)
        try:
            found = sampled.level_with()
        except GainroomError:  # no such loop, as with a filter that is faster than the rate
            continue
        rates.append(Reading(f"a rate of {rate:.0f} Hz", found))
        every.append(replace(sampled, level=found))
        if found != "unsafe":
            break
    if not rates or rates[-1].level != "unsafe":  # safe at no rate is known: whatever else decides at that one, the rate does
        more = every[-1].read().deciding if rates and rates[-1].level == "safe" else {}
        return Read("undecided", {"rate_unknown": tuple(rates), **more})
    others = (one.read() for one in every)
    found = next((found for found in others if found.level != "unsafe"), None)
    return Read("unsafe") if found is None else Read("undecided", {"rate_unknown": (), **found.deciding})  # nothing is safe without a rate


@dataclass(frozen=True)
class _Readings:
    """Readings of a system with a rate, over its other missing data; `level` as computed, see `read`.

    peaks   frequency of the peak sensitivity as computed, by state [rad/s]; {} where it does not matter
    """

    system: System
    states: Sequence[State]
    level: Level
    ranges: Uncertainty | None
    peaks: Mapping[str, float]

    def read(self) -> Read:
        """Decision over all readings, as far as they are needed."""
        ways, flips = self.ways, dict[str, tuple[Reading, ...]]()
        for code, own in ways.items():
            found = self._other([own])
            if found is not None:
                flips[code] = (found,)
        if not flips and len(ways) > 1:
            found = self._other([*ways.values()])
            flips = {} if found is None else dict.fromkeys(ways, (found,))
        if not flips and self.level == "safe" and "gearbox_unknown" in ways and (unsafe := self._unsafe_between) is not None:
            flips = {"gearbox_unknown": (unsafe,)}
        return Read("undecided", flips) if flips else Read(self.level)

    @cached_property
    def ways(self) -> dict[str, list[tuple[str, Change]]]:
        """Possible values of each missing quantity, by the code of the finding: each as text, with the change of the system.

        The value that the system was computed with is left out.
        """
        unknown, found = self.system.source.unknown, dict[str, list[tuple[str, Change]]]()
        if "motor_inertia_unknown" in unknown:
            shares = [(f"motor inertias of {share:g} × what they move", self._with_motors(share)) for share in SHARES]
            found["motor_inertia_unknown"] = shares
        if "gearbox_unknown" in unknown:
            soft = KINDS[0]
            ends = [(soft, soft.resonance[0], soft.damping_ratio[0])]
            if self.level == "unsafe":  # then one that is safe is looked for
                ends = [(one, end, one.damping_ratio[1]) for one in KINDS for end in one.resonance]
            found["gearbox_unknown"] = [
                (f"{one.name} gearboxes of {end / (2 * math.pi):.3g} Hz and {100 * ratio:g} % of critical damping", _geared(end, ratio))
                for one, end, ratio in ends
            ]
        return found

    def _other(self, ways: Sequence[Sequence[tuple[str, Change]]]) -> Reading | None:
        """First reading, with one value of each, whose level differs from the computed one; None if there is none."""
        for chosen in itertools.product(*ways):
            try:
                level = self.level_with(*(change for _, change in chosen))
            except GainroomError:  # not known
                level = "undecided"
            if level != self.level:
                return Reading(", ".join(text for text, _ in chosen), level)
        return None

    def level_with(self, *changes: Change) -> Level:
        """Level of one reading over all states. Raises GainroomError if it makes no loop."""
        levels = set[Level]()
        worst = self._worst_of_range(changes)
        for state in self.states:
            system = state.system
            for change in (*changes, *worst):
                system = change(system)
            if self.level == "unsafe" and not system.balance:  # that sway decides may help
                system = replace(system, balance="controller")
            if _misses_evidently(system, state, self.peaks.get(state.title, math.nan)):
                return "unsafe"
            levels.add(_level_in(system, state.posture, state.contact))
            if "unsafe" in levels:
                return "unsafe"
        return "undecided" if "undecided" in levels else "safe"

    def _worst_of_range(self, changes: Sequence[Change]) -> Sequence[Change]:
        """Change to the worst place in the ranges with other motors, on whose inertia a resonance range depends; () without ranges."""
        if self.ranges is None or not changes:
            return ()
        system = replace(self.system, uncertainty=self.ranges)
        for change in changes:
            system = change(system)
        states = [state_of(system, state.posture, state.contact) for state in self.states]
        worst = try_places(system, states, tries=replace(FEW, until_unsafe=False)).worst.place
        return (lambda system: replace(replace(system, uncertainty=self.ranges).at(worst), uncertainty=Uncertainty()),)

    def _with_motors(self, share: float) -> Change:
        """Change that gives motors of unknown inertia a share of the inertia they move, the largest over all states."""

        def change(system: System) -> System:
            actuators = system.source.actuators  # type: ignore[attr-defined] - a robot's
            moved = self.system.source.moved_inertia  # type: ignore[attr-defined] - a robot's
            return system.with_values(motor_inertia=np.where(actuators.without_inertia, share * moved, actuators.motor_inertia))

        return change

    @property
    def _unsafe_between(self) -> Reading | None:
        """Reading with gearboxes between the softest type and rigid that is not safe; None if none was found."""
        actuators = self.system.source.actuators  # type: ignore[attr-defined] - a robot's
        varied = actuators.assumed_rigid & (actuators.motor_inertia > 0)
        if not varied.any():
            return None
        if self.system.control.kd_path is not None:
            return Reading("gearboxes between the softest type and rigid ones", "undecided")
        softest, damped = KINDS[0].resonance[0], KINDS[0].damping_ratio

        def where(value: float) -> Floats:
            return np.where(varied, value, math.nan)

        least, most = map(where, damped)
        between = Uncertainty(resonance=(where(softest), where(STIFFEST)), damping_ratio=(least, most))
        system = replace(self.system, uncertainty=between)
        states = sorted(self.states, key=lambda state: state.sway is not None)  # margins without sway take longest
        tried = (try_places(system, [state], tries=FEW) for state in states)
        over = next((one for one in tried if not one.safe), None)
        if over is None:
            return None
        spring, damper = (_span(over.worst.system.source.quantities[name][varied]) for name in ("stiffness", "damping"))
        slides = self.system.source.prismatic[varied]
        units = ("N/m", "N·s/m") if slides.all() else ("N·m/rad", "N·m·s/rad")
        also = " (N/m, N·s/m of prismatic joints)" if slides.any() and not slides.all() else ""
        return Reading(f"gearboxes of {spring} {units[0]} and {damper} {units[1]}{also}", "unsafe")


def _span(values: Floats) -> str:
    """Range of values as text; one number if they are equal."""
    low, high = (f"{float(f'{value:.3g}'):.12g}" for value in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"


def _at_rate(system: System, rate: float) -> System:
    return replace(system, control=replace(system.control, sample_time=1 / rate))


def _geared(resonance: float, ratio: float) -> Change:
    """Change that gives gearboxes of unknown stiffness the resonance [rad/s] and damping ratio.

    Those of motors without inertia stay rigid.
    """

    def change(system: System) -> System:
        actuators = system.source.actuators  # type: ignore[attr-defined] - a robot's
        inertia, soft = actuators.motor_inertia, actuators.assumed_rigid & (actuators.motor_inertia > 0)
        stiffness = np.where(soft, inertia * resonance**2, actuators.stiffness)
        return system.with_values(stiffness=stiffness, damping=np.where(soft, 2 * ratio * inertia * resonance, actuators.damping))

    return change


def _misses_evidently(system: System, state: State, omega: float) -> bool:
    """True if `system`, a reading of `state`, misses the required peak sensitivity about ω = `omega` [rad/s], that of the state's own peak.

    One |S_ii| above Ms is proof: the loop is unstable, or its Ms is missed. It takes a tenth of the time of all margins. Where the base may
    sway, which may not count, it is left to them.
    """
    needed, body = system.requirements.needed.get("peak_sensitivity"), system.source.body
    if needed is None or not (0 < omega < math.inf) or system.control.kd_path is not None or (body is not None and body.base == "floating"):
        return False
    loop = system.loop(system.source.linearize(state.posture, state.contact))
    ratio = loop.response(omega * AROUND)
    inverse = np.linalg.inv(np.eye(loop.size) + ratio.reshape(len(AROUND), loop.size, loop.size))
    return bool(np.abs(np.diagonal(inverse, axis1=1, axis2=2)).max() > needed * (1 + ROUND_OFF))


def _level_in(system: System, posture: str, contact: str) -> Level:
    """Level of one state of a reading, over the uncertainty that the user states."""
    nominal = StateCase(posture, contact, "", system, system.source.linearize(posture, contact))
    found: Level = "safe"
    for case in (nominal, *(uncertain_cases(system, posture, contact, None) if system.uncertainty.names else ())):
        margins = without_sway(case, _margins(case))
        values = [one.met(needed, one.value(margins)) for one, needed in system.requirements.asked_for]
        unknown = [math.isnan(one.value(margins)) for one, _ in system.requirements.asked_for]
        if not margins.stable or any(not met and not nan for met, nan in zip(values, unknown, strict=True)):
            return "unsafe"
        found = "undecided" if any(unknown) else found
    return found


def _margins(case: StateCase) -> Margins:
    if case.system.control.space == "task" or own_case(case.title, case.system, case.model) is not None:
        return bounded_margins(case)
    return margins_of(case.system.loop(case.model))
