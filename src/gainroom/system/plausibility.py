"""Plausibility ranges: warnings for values far outside the range of real actuators, most often a slip of units.

The ranges are wide: from the joints of small hands to the legs of a humanoid of 500 kg, an order of magnitude beyond public actuators on
either side. A value outside is not refused: a warning names it with its unit. Some slips stay inside and cannot be detected (N m/deg, Hz
for rad/s).
"""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import digits, first_of_many
from .drive import Drive
from .system import System
from .uncertainty import OF_GEARBOXES

if TYPE_CHECKING:
    from .requirements import Requirements

TURN = 2 * math.pi
FAR = "far outside the usual"
"""Marker text of warnings about implausible values."""
DEGREES = "were degrees meant?"
"""Marker at the end of warnings about angles."""
NO_ROBOT = "no robot has such a link"
"""Marker of warnings about link masses, lengths and inertias that make every number doubtful."""
NO_SOLID = "no solid has the inertia"
"""Beginning of warnings about link inertias that no solid can have."""
NO_DATA = "joints without actuator data"
NO_STIFFNESS = "gearboxes whose stiffness is not given are rigid"
NO_INERTIA = "motor inertias that are not given are a tenth of what the motor moves"
"""Beginning of the assumption about missing motor inertias, which decides every number."""


class Usual(NamedTuple):
    """Usual range `low` to `high` of a quantity in `unit`, and the likely slips. 0 and inf mean "none" and pass."""

    low: float
    high: float
    unit: str
    slips: str
    scale: float = 1.0  # from SI to `unit`


GIVEN = {
    "motor_inertia": Usual(1e-7, 100, "kg·m²", "g·m², kg·cm² or kg·mm²?"),
    "rotor_inertia": Usual(1e-10, 0.05, "kg·m²", "g·cm² or kg·cm²?"),
    "gear_ratio": Usual(0.5, 1000, "", "its inverse?"),
    "link_inertia": Usual(1e-7, 2000, "kg·m²", "g·m², kg·cm² or kg·mm²?"),
    "stiffness": Usual(1e-3, 5e6, "N·m/rad", "N·mm/rad?"),
    "damping": Usual(1e-9, 1e4, "N·m·s/rad", "N·mm·s/rad?"),
    "motor_viscous": Usual(1e-9, 1e3, "N·m·s/rad", "N·mm·s/rad?"),
    "link_viscous": Usual(1e-9, 1e3, "N·m·s/rad", "N·mm·s/rad?"),
    "bandwidth": Usual(30, 2e5, "rad/s", "kHz?"),
    "damping_ratio": Usual(0.05, 10, "", "percent?"),
    "delay": Usual(0.005, 200, "ms", "seconds, or µs?", 1e3),
    "sample_rate_hz": Usual(20, 1e5, "Hz", "kHz, or a period?"),
    "kp": Usual(1e-6, 1e7, "N·m/rad", "N·mm/rad?"),
    "kd": Usual(1e-8, 1e6, "N·m·s/rad", "N·mm·s/rad?"),
    "velocity_filter.bandwidth": Usual(3, 2e5, "rad/s", "kHz?"),
    "notch frequency": Usual(1, 2e5, "rad/s", "kHz?"),
    "biquad frequency": Usual(1, 2e5, "rad/s", "kHz?"),
    "gain_margin_db": Usual(2.5, 40, "dB", "a factor?"),
    "phase_margin_deg": Usual(5, 90, "°", "rad?"),
    "peak_sensitivity": Usual(1.1, 5, "", "dB?"),
}
"""Plausible ranges of values that a user enters, by key."""
FORMED = {
    "resonance": Usual(0.3, 5000, "Hz", "the units of stiffness and inertias", 1 / TURN),
    "swing": Usual(0.7, 1e4, "Hz", "the units of stiffness and link_inertia", 1 / TURN),
    "mode damping": Usual(0, 5, "", "the units of damping and stiffness"),
    "delay in ticks": Usual(0, 200, "ticks", "the units of delay and sample_rate_hz"),
    "kp over stiffness": Usual(0, 30, "", "the units of kp and stiffness"),
    "kd over kp": Usual(1e-4, 1000, "s", "the units of kp and kd"),
    "kd over motor_inertia": Usual(0, 2e4, "rad/s", "the units of kd and motor_inertia"),
}
"""Plausible ranges of quantities derived from entered values."""
NAMES = {
    "resonance": "the resonance √(K (1/J_M + 1/J_L))",
    "swing": "the swing of the load on the gearbox, √(K/J_L),",
    "mode damping": "the damping ratio of the resonance",
    "delay in ticks": "the delay",
}


def unusual(values: Mapping[str, float]) -> dict[str, str]:
    """Warnings about implausible `values` (SI, names of GIVEN) and quantities derived from them, by quantity.

    A derived quantity is left out where one of its sources has a warning itself, which names the slip better.
    """
    warnings = {}
    for name, value in values.items():
        if name in GIVEN and not _is_usual(value, GIVEN[name]):
            usual = GIVEN[name]
            warnings[name] = f"{name} {_with_unit(value, usual)} is {FAR}, {_span(usual)}: {usual.slips}"
    for name, (value, sources) in _formed(values).items():
        if not _is_usual(value, FORMED[name]) and warnings.keys().isdisjoint(sources):
            usual = FORMED[name]
            warnings[name] = f"{NAMES.get(name, name)} is {_with_unit(value, usual)}, {FAR}, {_span(usual)}: check {usual.slips}"
    return warnings


def unusual_values(system: System) -> tuple[str, ...]:
    """Warnings about implausible values in a system, those of one quantity on several joints merged.

    Ends of ranges are checked where the nominal value is usual; on a prismatic joint, in kg and N, drive and rate alone are checked.
    """
    source, size = system.source, len(system.drives)
    common = of_control(system.control.controller, system.control.sample_time) | of_limits(system.requirements)
    shared = {key: value for key, value in common.items() if not np.ndim(value)}
    found: dict[str, list[tuple[str, str]]] = {}
    for k, (joint, drive) in enumerate(zip(source.joint_names, system.drives, strict=True)):
        values: dict[str, float] = of_drive(drive) | shared
        if not source.prismatic[k]:
            values = {**system.entered, **{key: float(each[k]) for key, each in source.quantities.items()}, **values}
            values |= {key: _of_joint(gain, k, size) for key, gain in common.items() if np.ndim(gain)}
        warnings = unusual(values)
        if not warnings.keys().isdisjoint(system.entered):
            warnings.pop("motor_inertia", None)  # their product
        for name in [
            name for name in system.uncertainty.names if name not in OF_GEARBOXES and (not source.prismatic[k] or name == "delay")
        ]:
            for end in getattr(system.uncertainty, name):
                for text in unusual({name: _of_joint(end, k, size)}).values() if name not in warnings else ():
                    warnings[f"uncertainty.{name}"] = f"uncertainty.{text}"
        for quantity, text in warnings.items():
            found.setdefault(quantity, []).append((joint, text))
    texts = []
    for quantity, cases in found.items():
        owners = (
            "" if quantity in shared or size == 1 else f"joint{'s' * (len(cases) > 1)} {first_of_many([repr(name) for name, _ in cases])}: "
        )
        texts.append(owners + cases[0][1])
    return tuple(texts)


def by_doubt(warnings: Sequence[str]) -> tuple[list[str], list[str]]:
    """Warnings that make every number doubtful (implausible values, angles, missing data), which are shown first; and the others."""
    first = (NO_DATA, NO_STIFFNESS, NO_INERTIA, NO_SOLID)
    doubts = [text for text in warnings if FAR in text or NO_ROBOT in text or text.endswith(DEGREES) or text.startswith(first)]
    return doubts, [text for text in warnings if text not in doubts]


def doubts_first(warnings: Sequence[str]) -> list[str]:
    """All warnings, doubts (see by_doubt) first."""
    return [text for part in by_doubt(warnings) for text in part]


def _of_joint(value: Any, joint: int, size: int) -> float:
    """Value of joint `joint` out of per-joint values (scalar, (n,) or a matrix's diagonal)."""
    return float(np.diagonal(value)[joint] if np.ndim(value) == 2 else np.broadcast_to(value, size)[joint])


def of_drive(drive: Drive) -> dict[str, Any]:
    """A drive's values by name."""
    return {"bandwidth": drive.bandwidth, "damping_ratio": drive.damping_ratio, "delay": drive.delay}


def of_control(controller: Any, sample_time: float | None) -> dict[str, Any]:
    """A controller's values by name."""
    values: dict[str, Any] = {} if sample_time is None else {"sample_rate_hz": 1 / sample_time}
    if not hasattr(controller, "gain_names"):  # none, or any other system
        return values
    names = controller.gain_names()
    # kp of a cascade is in 1/s: only its kv means what kd means elsewhere.
    gains = {"kd": "kv"} if "kv" in names else {name: name for name in ("kp", "kd") if name in names}
    values |= {quantity: getattr(controller, name) for quantity, name in gains.items()}
    if controller.velocity_filter is not None:
        values["velocity_filter.bandwidth"] = controller.velocity_filter.bandwidth
    frequencies = {
        "notch frequency": [notch.frequency for notch in controller.notches],
        "biquad frequency": [frequency for one in controller.biquads for frequency in (one.zero_frequency, one.pole_frequency)],
    }
    for name, found in frequencies.items():
        if unusual := [frequency for frequency in found if not _is_usual(frequency, GIVEN[name])]:
            values[name] = unusual[-1]
    return values


def of_limits(requirements: "Requirements | None") -> dict[str, float]:
    """Required margins by name, in dB and degrees."""
    return {} if requirements is None else {one.key: one.in_unit(needed) for one, needed in requirements.asked_for}


def _formed(values: Mapping[str, float]) -> dict[str, tuple[float, tuple[str, ...]]]:
    """Quantities derived from `values`, each with the names of its sources."""
    formed: dict[str, tuple[float, tuple[str, ...]]] = {}

    def form(name: str, sources: tuple[str, ...], formula: Any) -> None:
        taken = [float(values.get(source, 0.0)) for source in sources]
        if all(0 < value < math.inf for value in taken):
            formed[name] = (formula(*taken), sources)

    form("swing", ("stiffness", "link_inertia"), lambda stiffness, link: math.sqrt(stiffness / link))
    if "link_inertia" in values:
        sources = ("stiffness", "motor_inertia", "link_inertia")
        form("resonance", sources, lambda stiffness, motor, link: math.sqrt(stiffness * (1 / motor + 1 / link)))
        if "resonance" in formed:
            resonance = formed["resonance"][0]
            form("mode damping", ("damping", "stiffness"), lambda damping, stiffness: damping * resonance / (2 * stiffness))
    form("delay in ticks", ("delay", "sample_rate_hz"), lambda delay, rate: delay * rate)
    form("kp over stiffness", ("kp", "stiffness"), lambda kp, stiffness: kp / stiffness)
    form("kd over kp", ("kp", "kd"), lambda kp, kd: kd / kp)
    if values.get("stiffness") != math.inf:  # through a rigid gearbox kd moves the load, too
        form("kd over motor_inertia", ("kd", "motor_inertia"), lambda kd, inertia: kd / inertia)
    return formed


def _is_usual(value: float, usual: Usual) -> bool:
    size = abs(value) * usual.scale
    return size == 0 or math.isinf(size) or usual.low <= size <= usual.high


def _with_unit(value: float, usual: Usual) -> str:
    return digits(value * usual.scale, usual.unit)


def _span(usual: Usual) -> str:
    return f"{digits(usual.low)} to {digits(usual.high, usual.unit)}" if usual.low else f"at most {digits(usual.high, usual.unit)}"
