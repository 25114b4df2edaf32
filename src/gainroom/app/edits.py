"""Edits of a file by a view: its delay and sample rate, ranges widened to hold a new value, and gains for other files."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GainroomError, listed, printable
from ..files.edited_text import Keys
from ..files.export_forms import FORMS
from ..files.gain_formats.gain_record import Gain
from ..report.number_format import own_gains, typed
from ..system.controller import PID, Controller, type_of
from ..system.uncertainty import Uncertainty
from .bench import rounded
from .messages import View

NO_GAINS = ("delay_ms", "stiffness", "link_inertia", "sample_rate_hz", "payload", "payload_at")
"""Fields of a view that change values of the file other than gains."""


def timing(data: Mapping[str, Any], delay: float, view: View) -> dict[Keys, Any]:
    """Changes of delay and sample rate in the `data` of a joint.yaml or robot.yaml, whose delay is `delay` [s].

    Raises GainroomError for a delay in ticks without a rate.
    """
    changes: dict[Keys, Any] = {}
    control, drive = data["control"], data["drive"]
    old = drive.get("sample_rate_hz", control.get("sample_rate_hz"))
    rate = control.get("sample_rate_hz") if view.sample_rate_hz is None else view.sample_rate_hz or None
    if rate != control.get("sample_rate_hz"):
        changes["control", "sample_rate_hz"] = rate
        if "sample_rate_hz" in drive:
            changes["drive", "sample_rate_hz"] = rate or old
        if rate and "clock" in drive:
            changes["drive", "clock"] = None
    ticks = rate or old
    if "delay_ticks" in drive:
        if not ticks:
            raise GainroomError("sample rate: the file gives its delay in ticks, which need a rate")
        wanted = 1e3 * delay if view.delay_ms is None else view.delay_ms
        put(changes, data, ("drive", "delay_ticks"), drive["delay_ticks"], wanted * ticks / 1e3)
    elif view.delay_ms is not None:
        put(changes, data, ("drive", "delay_ms"), drive["delay_ms"], view.delay_ms)
    return changes


def put(changes: dict[Keys, Any], data: Mapping[str, Any], path: Keys, old: Any, value: float) -> None:
    """Adds a changed value to `changes`, and its range if that does not contain it."""
    if isinstance(old, int | float) and abs(value - old) <= 1e-12 * abs(old):
        return
    changes[path] = value
    given = (data.get("uncertainty") or {}).get(path[-1])
    if isinstance(given, list) and not given[0] <= value <= given[1]:
        changes["uncertainty", path[-1]] = [min(given[0], value), max(given[1], value)]


def ranges(stated: Uncertainty, stiffness: Any = 1.0) -> dict[str, list[float | None]]:
    """Ranges (low, high) by field of the page, in its unit; `stiffness`: the value that counts as 1 there."""
    found = {}
    for field, span, unit in (
        ("delay_ms", stated.delay, 1e-3),
        ("stiffness", stated.stiffness, stiffness),
        ("link_inertia", stated.link_inertia, 1.0),
    ):
        if span is not None:
            ends = [np.asarray(end, dtype=float)[np.isfinite(end)] / np.asarray(unit)[np.isfinite(unit)] for end in span]
            found[field] = rounded([ends[0].min(), ends[1].max()], 4)
    return found


def conditions(source: str, own: Mapping[str, Any], view: View) -> str:
    """Comment above copied gains: their file, and the values other than gains that differ from it; `own`: the file's view."""
    now = {name: getattr(view, name) for name in NO_GAINS}
    text = {
        name: [each if isinstance(each, str) else typed(each) for each in (now[name], own[name])]
        for name in NO_GAINS
        if None not in (now[name], own.get(name))
    }
    other = [f"{name} {here} (opened with {there})" for name, (here, there) in text.items() if here != there]
    return printable(f"# for {Path(source).name}{' with ' if other else ''}{listed(other)}") + "\n"


def other_formats_hold(own: Controller) -> bool:
    """True if other formats hold all gains of the controller: those of a PD or PID."""
    return set(own.gain_keys()) <= set(PID.GAINS)


def form_titles(others_hold: bool) -> dict[str, str]:
    """Titles by name of the forms in which gains are copied; those of other programs where these hold the gains."""
    return {form.name: form.title for form in FORMS.values() if form.name == "yaml" or (others_hold and form.text_to_paste is not None)}


def gain_of(own: Controller, form: str) -> Gain:
    """Gain of one joint for other formats. Raises GainroomError for a controller with gains other than those of a PD or PID."""
    if not other_formats_hold(own):
        raise GainroomError(
            f"{form}: holds kp and kd in N·m/rad and N·m·s/rad, not the gains of a controller of type {type_of(own)}; copy as yaml"
        )
    gains: dict[str, Any] = {name: value for name, value, _ in own_gains(own)}
    return Gain(**gains)


def at_point(own: Controller, point: tuple[float, float]) -> Controller:
    """Controller at a point of its gain map, with gains of few digits."""
    there = own.from_plane(*point)
    rounded: dict[str, Any] = {name: float(typed(value)) for name, value, _ in own_gains(there)}
    return replace(there, **rounded)
