"""Numbers of one joint's controller that the page moves: its gains, and those of its filters."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..files.edited_text import Keys
from ..report.number_format import own_gains
from ..system.controller import DisturbanceObserver
from ..system.system import System

WIDE = 10.0
"""Factor by which a slider goes beyond the file's value, and below it where it cannot be 0."""
BELOW_HALF = 0.98
"""Highest frequency of a filter's slider as part of half the sample rate, below which files must have it."""
FARTHER = {"nominal_inertia": 300.0, "bandwidth": 3000.0}
"""Factors by which sliders go beyond the values of a disturbance observer, which may start without effect."""
FROM_ZERO = {"zero_damping": 2.0, "depth": 1.0}
"""Numbers of filters that may be 0, with the least end of their sliders."""
FILTERS = {"velocity_filter": "velocity filter", "notches": "notch", "biquads": "biquad"}
"""Keys of filters, and what one of them is called."""


@dataclass(frozen=True)
class Tunable:
    """Number of the section `control`; `path`: its keys there.

    field    name of the controller's field, for a gain; "": it is changed in the text alone
    ends     of its slider, in even steps from 0 or below, else in equal factors; None: the map moves it, or it is typed
    least    smallest value that may be typed; None: any
    """

    path: Keys
    value: float
    title: str
    unit: str
    field: str
    ends: tuple[float, float] | None
    least: float | None = 0.0

    @property
    def name(self) -> str:
        """Name in a view: its keys with dots between, so that a gain has its own."""
        return ".".join(map(str, self.path))

    def described(self) -> dict[str, Any]:
        """Description for the page."""
        return {"name": self.name, "title": self.title, "unit": self.unit, "value": self.value, "ends": self.ends, "least": self.least}


def tunables(system: System, control: Mapping[str, Any]) -> list[Tunable]:
    """Numbers of `system`'s controller that the page moves; `control`: the file's section."""
    return [*_gains(system, control), *_others(system, control)]


def _gains(system: System, control: Mapping[str, Any]) -> Iterator[Tunable]:
    controller = system.control.controller
    keys = {key.name: key for key in controller.gain_keys()}
    kp = getattr(controller, "kp", 1.0)
    for name, value, unit in own_gains(controller):
        if isinstance(controller, DisturbanceObserver) and name == "delay_ticks" and name not in control:
            continue  # it is the drive's delay, and follows it
        in_hertz = name not in control and f"{name}_hz" in control
        moved_by_map = controller.has_plane and name in controller.plane_names
        given = control[f"{name}_hz"] if in_hertz else value
        if moved_by_map or name == "delay_ticks":  # whole ticks are typed
            ends = None
        elif keys[name].signed:
            most = max({"kstau": 0.1}.get(name, 1.0), 2 * abs(value))
            ends = (-most, most)
        elif name in FARTHER:  # a new observer is slow, and takes the motor to be alone
            ends = (given / WIDE, given * FARTHER[name])
        elif keys[name].positive:
            ends = (given / WIDE, given * WIDE)
        else:  # kd and ki: the number of kp over a tenth of a second
            ends = (0.0, max(2.5 * value, {"kd": 0.1, "ki": 10.0}.get(name, 0.0) * kp, 2.0 if name == "gain" else 0.0))
        path, own_unit, field = ((f"{name}_hz",), "Hz", "") if in_hertz else ((name,), unit, name)
        yield Tunable(path, float(given), name, own_unit, field, ends, None if keys[name].signed else 0.0)


def _others(system: System, control: Mapping[str, Any]) -> Iterator[Tunable]:
    for name, one in FILTERS.items():
        given = control.get(name) or []
        for k, each in enumerate(given) if isinstance(given, list) else [(None, given)]:
            where: Keys = (name,) if k is None else (name, k)
            owner = one if k is None or len(given) < 2 else f"{one} {k + 1}"
            for key, value in each.items():
                if key != "order":  # a choice, which no slider has
                    yield _of_filter(system, (*where, key), float(value), owner)


def _of_filter(system: System, path: Keys, value: float, owner: str) -> Tunable:
    key, time = str(path[-1]), system.control.sample_time
    hertz, is_frequency = key.endswith("_hz"), "frequency" in key or "bandwidth" in key
    unit = "" if not is_frequency else "Hz" if hertz else "rad/s"
    ends = value / WIDE, value * WIDE
    if key in FROM_ZERO:
        ends = 0.0, 1.0 if key == "depth" else max(FROM_ZERO[key], 2 * value)
    elif is_frequency and time is not None:
        ends = ends[0], max(value, min(ends[1], BELOW_HALF * (0.5 if hertz else math.pi) / time))
    return Tunable(path, value, f"{owner} {key.removesuffix('_hz').replace('_', ' ')}", unit, "", ends)
