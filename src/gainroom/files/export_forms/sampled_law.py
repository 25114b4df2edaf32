"""Filters of exported gains as coefficients at the rate at which they run, and the line of a text from which `audit` has them again."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import GainroomError
from ...io.validation import checked, validate
from ...system.filters import FILTERS
from ..gain_context import read_gain_context
from ..gain_formats.gain_record import GainFile, Origin
from ..system_sections import RATE, FiltersSection
from .form import ExportedGains, number_text

MARK = "gainroom control:"
LINE = re.compile(rf"{MARK} (\{{.*\}})")
RATES = ("sample_rate_hz", "drive_rate_hz")
"""Keys of the rate of gains that run on the host and on the drive."""
SETTLED = 1e-3
"""Part of a step that a filter has left when it counts as settled."""


@dataclass(frozen=True)
class SampledFilter:
    """Filter at one rate: y[k] = b0 x[k] + b1 x[k−1] + b2 x[k−2] − a1 y[k−1] − a2 y[k−2].

    name          "velocity filter", "notch 1", "biquad 1"
    coefficients  b0, b1, b2, a1, a2, as texts that hold all digits
    """

    name: str
    coefficients: tuple[str, ...]


@dataclass(frozen=True)
class SampledLaw:
    """Filters of exported gains at the rate at which they run.

    sample_time  [s]
    velocity     filter of the velocity; None: none
    shaping      notches and biquads, through which the torque goes
    line         text from which they are read again
    """

    sample_time: float
    velocity: SampledFilter | None
    shaping: tuple[SampledFilter, ...]
    line: str

    @property
    def filters(self) -> tuple[SampledFilter, ...]:
        """All filters, that of the velocity first."""
        return (*(() if self.velocity is None else (self.velocity,)), *self.shaping)

    @property
    def settling(self) -> float:
        """Time [s] in which the slowest filter forgets where it began, to SETTLED."""
        slowest = max(float(np.abs(np.roots([1.0, *map(float, one.coefficients[3:])])).max()) for one in self.filters)
        return self.sample_time * math.log(SETTLED) / math.log(slowest) if slowest else 0.0


def rate_of(origin: Origin) -> float | None:
    """Rate at which gains run [Hz]; None where it is not said, or kd has one of its own."""
    return None if origin.gains_run == "split" else origin.drive_rate_hz if origin.gains_run == "drive" else origin.sample_rate_hz


def sampled_law(goal: ExportedGains) -> SampledLaw | None:
    """Filters of `goal` at its rate; None if it has no filters, or not one rate.

    Raises GainroomError for a filter that is not below half the rate.
    """
    control, rate = goal.origin.system.get("control") or {}, rate_of(goal.origin)
    if rate is None or not {*FILTERS} & control.keys():
        return None
    return _sampled(control, RATES[goal.origin.gains_run == "drive"], rate)


def filter_notes(goal: ExportedGains, text: str, onto: Path | None) -> list[str]:
    """Note on filters that have no coefficients for want of one rate."""
    if MARK in text or onto is not None or not {*FILTERS} & (goal.origin.system.get("control") or {}).keys():
        return []
    why = "kd runs at a rate of its own" if goal.origin.gains_run == "split" else "what was exported says no rate (sample_rate_hz)"
    return [f"filters are written as coefficients at one rate, and {why}"]


def with_sampled_law(found: GainFile, text: str) -> GainFile:
    """Gains read from `text` with filters and rate of the line in it. Raises GainroomError where the text's coefficients are others."""
    line = LINE.search(text)
    if line is None:
        return found
    where = f"{found.source}: {MARK[:-1]}"
    try:
        said = json.loads(line[1])
    except ValueError:
        raise GainroomError(f"{where}: must be the line of JSON that gainroom export wrote") from None
    key = next((key for key in RATES if key in said), "sample_rate_hz")
    rate = checked(f"{where}: {key}", said.pop(key, None), RATE)
    control = read_gain_context({"control": said}, found.source, MARK[:-1])["control"]
    law, other = _sampled(control, key, rate), rate_of(found.origin)
    code = text[: line.start()] + text[line.end() :]
    for one in law.filters:
        if missing := [each for each in one.coefficients if each not in code]:
            raise GainroomError(f"{where}: the {one.name} has no coefficient {missing[0]} in this file, so it is another; export it anew")
    if other is not None and round(other) != round(rate):  # update_rate of ros2_control is whole
        raise GainroomError(f"{where}: the filters' coefficients are for {rate:g} Hz, and the file's rate is {other:g} Hz; export it anew")
    known = {"sample_rate_hz": rate} if key == "sample_rate_hz" else {}
    return replace(found, origin=replace(found.origin, system={**found.origin.system, "control": control}, **known))


def _sampled(control: Mapping[str, Any], key: str, rate: float) -> SampledLaw:
    """Filters of a context's section `control` at a rate [Hz]. Raises GainroomError."""
    section = validate(FiltersSection, {name: control[name] for name in FILTERS if name in control}, "control")
    section.require_below(math.pi * rate, math.pi * rate)
    found, names = section.filters(), {"notches": "notch", "biquads": "biquad"}
    every = {f"{title} {k}": one for name, title in names.items() for k, one in enumerate(found[name], 1)}
    low_pass = found["velocity_filter"]
    return SampledLaw(
        1 / rate,
        None if low_pass is None else _texts("velocity filter", low_pass, rate),
        tuple(_texts(name, one, rate) for name, one in every.items()),
        f"{MARK} {json.dumps({key: rate, **control})}",
    )


def _texts(name: str, one: Any, rate: float) -> SampledFilter:
    return SampledFilter(name, tuple(map(number_text, one.coefficients(1 / rate))))
