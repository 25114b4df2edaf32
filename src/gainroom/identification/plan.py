"""Experiment for identifying a joint: a torque within bounds, and the accuracy to expect from its log.

The motion is predicted by the sampled linear loop at rough values and at every corner of their intervals; friction is left out there, so
that the motion is an upper bound. As motion is proportional to torque, one run per corner says how large the torque may be.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..analysis.stability import is_stable
from ..errors import GainroomError, require_positive
from ..simulation import Run, Scenario, simulate
from ..system.controller import PD
from ..system.linear.arrays import Floats
from ..system.system import System
from ..system.uncertainty import NOMINAL
from .delay import LONGEST
from .excitation import Excitation, Kind, excitation
from .expected import Hardware, expected_widths
from .joint import LEAST_OVER_FRICTION, LEAST_STEPS, MOST_INERTIA, MOST_RELATIVE

BELOW, ABOVE = 0.4, 2.0  # times the lowest antiresonance and the highest resonance: where a plan begins and ends
DELAY_BAND = 0.1  # of the tick rate: up to there at least, or the delay is not told from the current loop's lag
FASTEST = 0.2  # of the tick rate: faster, a log does not show what happens within a tick
FEWEST_PERIODS = 5  # of the lowest frequency in the duration
SHORTEST, MOST_TICKS = 2000, 1_000_000  # ticks: fewer make no twelve spectra
WELL_OVER_FRICTION = 12.0  # root mean square torque: warned of below
TILTS = (0.0, 1.0, 2.0)  # torque ∝ ω^tilt: where travel or speed binds, less at low frequencies leaves more at high ones
ASSUMED_STEP = 1e-4  # [rad] of an encoder of 16 bit
ASSUMED_NOISE = 0.01  # of the excitation's root mean square
NAMES = ("torque", "speed", "travel")


@dataclass(frozen=True)
class Bounds:
    """Bounds of the experiment: torque [N m], speed [rad/s], travel to either side [rad], of motor and link; inf: not bounded.

    Raises GainroomError for values that are not > 0, and where nothing is bounded.
    """

    torque: float = math.inf
    speed: float = math.inf
    travel: float = math.inf

    def __post_init__(self) -> None:
        for name, unit in zip(NAMES, ("N·m", "rad/s", "rad"), strict=True):
            require_positive("plan", f"max_{name}", getattr(self, name), unit, infinite=True)
        if math.inf == self.torque == self.speed == self.travel:
            raise GainroomError(
                "plan: give at least one of max_torque, max_speed and max_travel (--max-torque, …): without, any torque is allowed"
            )


@dataclass(frozen=True)
class Plan:
    """Excitation and its expected result.

    system        the joint as described
    kind          of the torque
    excitation    of peak 1
    amplitude     its peak [N m]
    bounds        what the joint may do
    binding       the bound that is reached: "torque", "speed" or "travel"
    reached       by the names of Bounds: the largest value in any case; the torque is that of controller and excitation together
    run           predicted at the rough values
    closed        the controller holds the joint meanwhile
    hardware      friction, encoder and torque noise that `expected` rests on
    assumed       which of hardware's values were assumed, by name
    expected      half-width of the 95 % interval by parameter, relative; the worst over the rough values and the ends of the resonance;
                  of the damping with what friction may hide of it, 1 or more where that is all of it
    cases         number of cases that the bounds hold in
    warnings      what the reader should know
    """

    system: System
    kind: Kind
    excitation: Excitation
    amplitude: float
    bounds: Bounds
    binding: str
    reached: Mapping[str, float]
    run: Run
    closed: bool
    hardware: Hardware
    assumed: tuple[str, ...]
    expected: Mapping[str, float]
    cases: int
    warnings: tuple[str, ...] = ()

    @property
    def torque(self) -> Floats:
        """Feed-forward torque (m,) at excitation.time [N m]."""
        return self.amplitude * self.excitation.torque

    def span(self, name: Literal["antiresonance", "resonance"]) -> tuple[float, float]:
        """Lowest and highest frequency over the cases [rad/s]."""
        values = [getattr(case.source, name) for case in _cases(self.system)]
        return min(values), max(values)


def plan_excitation(
    system: System,
    bounds: Bounds,
    kind: Kind = "multisine",
    duration: float = 20.0,
    friction: float | None = None,
    encoder_step: float | None = None,
    torque_noise: float | None = None,
    closed: bool = True,
    link_friction: float = 0.0,
) -> Plan:
    """Largest excitation within `bounds` over the joint's range, of the shape that promises the narrowest intervals.

    system         a joint with rough values; its `uncertainty` is the range that the plan holds for, its controller holds the joint
    duration       [s]
    friction, encoder_step, torque_noise   see Hardware; None: no friction is assumed, an encoder of 16 bit, 1 % of the excitation
    link_friction  [N m]
    closed         False: nothing holds the joint

    Raises GainroomError where there is nothing to plan for, and where no log of this excitation would tell the joint; the message says why.
    """
    tick, first, last = _band(system, duration)
    system = system if closed else system.with_controller(PD(0.0, 0.0))
    cases = _cases(system)
    for case in cases if closed else ():
        if not is_stable(case.loop()):
            raise GainroomError(
                "plan: with the gains of the file the loop is unstable within the stated range: lower kp and kd for the recording, or "
                "hold the joint some other way (--open-loop)"
            )
    shapes = [_shaped(cases, bounds, excitation(kind, first, last, duration, tick, tilt)) for tilt in TILTS]
    if shapes[0].binding == "torque":
        shapes = shapes[:1]
    plans = []
    for shape in shapes:
        size = shape.amplitude * float(np.std(shape.excitation.torque))
        given = {
            "friction": 0.0 if friction is None else friction,
            "encoder_step": ASSUMED_STEP if encoder_step is None else encoder_step,
            "torque_noise": ASSUMED_NOISE * size if torque_noise is None else torque_noise,
            "link_friction": link_friction,
        }
        hardware = Hardware(**given)
        _require_motion(shape, hardware, size)
        plans.append((_expected(cases, shape, hardware), shape, hardware, size))
    expected, shape, hardware, size = min(plans, key=lambda plan: plan[0].get("stiffness", math.inf))
    assumed = tuple(
        name for name, value in (("friction", friction), ("encoder_step", encoder_step), ("torque_noise", torque_noise)) if value is None
    )
    _require_identifiable(shape, expected)
    warnings = _warnings(system, kind, tick, hardware, size, expected["damping"])
    return Plan(
        system, kind, shape.excitation, shape.amplitude, bounds, shape.binding, shape.reached, shape.run, closed, hardware, assumed,
        expected, len(cases), warnings,
    )  # fmt: skip


def _band(system: System, duration: float) -> tuple[float, float, float]:
    """Tick [s], first and last frequency [rad/s]. Raises GainroomError if there is no band."""
    require_positive("plan", "duration", duration, "s")
    joint, tick = system.source, system.control.sample_time
    if tick is None:
        raise GainroomError(
            "plan: control.sample_rate_hz is missing: the controller's rate [Hz], as the excitation has one torque per tick"
        )
    if not math.isfinite(joint.stiffness):
        raise GainroomError(
            "plan: joint.stiffness is .inf: the plan goes around the resonance; give a rough stiffness, its range under uncertainty"
        )
    if not math.isfinite(joint.link_inertia):
        raise GainroomError(
            "plan: joint.link_inertia is .inf: a locked joint has no resonance between two masses; see gainroom identify stiffness"
        )
    if system.drives[0].delay > LONGEST:
        raise GainroomError(f"plan: the delay {system.drives[0].delay:g} s must be <= {LONGEST:g} s")
    if not SHORTEST <= duration / tick <= MOST_TICKS:
        raise GainroomError(
            f"plan: a duration of {duration:g} s is {duration / tick:.0f} ticks; it must be {SHORTEST * tick:g} to {MOST_TICKS * tick:g} s"
        )
    joints = [case.source for case in _cases(system)]
    highest, lowest = FASTEST * 2 * math.pi / tick, min(one.antiresonance for one in joints)
    if joint.resonance > highest:
        raise GainroomError(
            f"plan: the resonance at {joint.resonance / 2 / math.pi:.3g} Hz is above a fifth of the tick rate, "
            f"{highest / 2 / math.pi:.4g} Hz: no log of this rate tells stiffness and link inertia; raise control.sample_rate_hz"
        )
    first = max(BELOW * lowest, 2 * math.pi * FEWEST_PERIODS / duration)
    if first > 0.8 * lowest:
        raise GainroomError(
            f"plan: in {duration:g} s the antiresonance at {lowest / 2 / math.pi:.3g} Hz has {duration * lowest / 2 / math.pi:.2g} "
            f"periods; a duration of at least {FEWEST_PERIODS / 0.8 * 2 * math.pi / lowest:.3g} s is needed"
        )
    return tick, first, min(max(ABOVE * max(one.resonance for one in joints), DELAY_BAND * 2 * math.pi / tick), highest)


def _cases(system: System) -> list[System]:
    """Systems with the rough values, first, and at the corners of their range."""
    return [system.at(corner) for corner in ([NOMINAL, *system.uncertainty.corners] if system.uncertainty.names else [NOMINAL])]


@dataclass(frozen=True)
class _Shape:
    """Excitation scaled to its bounds; `run` at the rough values, as Plan has it."""

    excitation: Excitation
    amplitude: float
    binding: str
    reached: Mapping[str, float]
    run: Run


def _shaped(cases: list[System], bounds: Bounds, shape: Excitation) -> _Shape:
    runs = [_unit_run(case, shape) for case in cases]
    peaks = {name: max(_peaks(run)[name] for run in runs) for name in NAMES}
    amplitude, binding = min((getattr(bounds, name) / peaks[name], name) for name in NAMES)
    run = runs[0]
    positions, torques = ("measured", "motor_position", "link_position"), ("target_torque", "demand_torque", "actual_torque")
    scaled = replace(run, **{name: amplitude * getattr(run, name) for name in (*positions, *torques)})
    return _Shape(shape, amplitude, binding, {name: amplitude * peak for name, peak in peaks.items()}, scaled)


def _unit_run(case: System, shape: Excitation) -> Run:
    """Run under a torque of peak 1 N m, with nothing to end it early."""
    return simulate(case.loop(), Scenario(0.0, float(shape.time[-1]), feedforward=shape.torque[:, None], limit=math.inf))


def _peaks(run: Run) -> dict[str, float]:
    sides = np.hstack([run.motor_position, run.link_position])
    torque = max(float(np.abs(run.target_torque).max()), float(np.abs(run.actual_torque).max()))
    return {"torque": torque, "speed": float(np.abs(np.diff(sides, axis=0)).max()) / run.sample_time, "travel": float(np.abs(sides).max())}


def _expected(cases: list[System], shape: _Shape, hardware: Hardware) -> dict[str, float]:
    """Widest intervals at the rough values and at the lowest and the highest resonance of the range."""
    looked = [cases[0]]
    if len(cases) > 1:
        order = sorted(cases[1:], key=lambda case: case.source.resonance)
        looked += [order[0], order[-1]]
    found = [expected_widths(case, shape.amplitude * shape.excitation.torque, hardware) for case in looked]
    return {name: max(one.get(name, 0.0) for one in found) for name in found[0]}


def _require_motion(shape: _Shape, hardware: Hardware, size: float) -> None:
    """Raise GainroomError if friction or the encoder's steps would hide the motion."""
    if size < LEAST_OVER_FRICTION * hardware.dry:
        raise GainroomError(
            f"plan: the torque of {size:.3g} N·m (root mean square) must be at least {LEAST_OVER_FRICTION:g} times friction, "
            f"{hardware.dry:.3g} N·m, to move the joint: allow more {shape.binding}, which binds"
        )
    span = float(np.ptp(shape.run.motor_position))
    if span < LEAST_STEPS * hardware.encoder_step:
        raise GainroomError(
            f"plan: the joint would move by {span:.3g} rad, {LEAST_STEPS} steps of its encoder ({hardware.encoder_step:.3g} rad) are "
            f"needed: allow more {shape.binding}, which binds"
        )


def _require_identifiable(shape: _Shape, expected: Mapping[str, float]) -> None:
    """Raise GainroomError if identification would refuse the log, or find no stiffness in it."""
    # A half-width of a 95 % interval is 2 standard errors of a normal law.
    for name, most in (("stiffness", 2 * MOST_RELATIVE), ("motor_inertia", 4 * MOST_INERTIA), ("link_inertia", 4 * MOST_INERTIA)):
        if not expected[name] < most:
            raise GainroomError(
                f"plan: the log would tell {name.replace('_', ' ')} to ± {100 * expected[name]:.0f} % only: allow more {shape.binding}, "
                "which binds, a longer duration, or a finer encoder"
            )


def _warnings(system: System, kind: Kind, tick: float, hardware: Hardware, size: float, damping: float) -> tuple[str, ...]:
    found, highest = [], FASTEST * 2 * math.pi / tick
    fastest = max(case.source.resonance for case in _cases(system))
    if fastest > highest:
        found.append(
            f"the resonance may lie at {fastest / 2 / math.pi:.3g} Hz, above a fifth of the tick rate, {highest / 2 / math.pi:.4g} Hz: "
            "there the log would not tell the stiffness"
        )
    if hardware.dry and size < WELL_OVER_FRICTION * hardware.dry:
        found.append(
            f"the torque is {size / hardware.dry:.2g} times friction (root mean square); below {WELL_OVER_FRICTION:g} times errors "
            "were up to twice as large as promised in virtual logs, as no law of friction is exact"
        )
    if hardware.dry and damping >= 1 and system.source.damping:
        found.append("friction hides the damping, which the log will say may be 0: allow more torque, or record on top of slow motion")
    if hardware.dry and kind == "chirp":
        found.append(
            "friction holds a joint where a chirp moves it little, and the log then tells less than is promised: prefer a multisine"
        )
    return tuple(found)
