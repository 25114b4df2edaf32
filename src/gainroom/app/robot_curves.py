"""Curves of a robot on the page: one channel's plane and return ratio with the other loops closed, the mode, and the heat map."""

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit
from ..analysis.part_region import PartRegion
from ..analysis.part_region_every_state import RegionInEveryState
from ..analysis.part_region_margins import required_columns, unread
from ..analysis.stability import rightmost_roots
from ..errors import GainroomError, at_frequency, digits, listed
from ..files.model_keyframes import model_keyframes
from ..report.margin_columns import margin_value, requirement
from ..report.robot_headroom import Factors, joint_factors, task_factors
from ..robot.robot import Robot
from ..simulation.step_response import step_response
from ..studies.analysis import THIS_STATE
from ..studies.robot import RobotStudy
from ..studies.state import State, limiting_joints
from ..system.linear.arrays import Complexes, Floats, Integers
from ..system.loop_part import LoopPart
from ..system.margin_units import to_db
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import System
from .bench import drawn_line, drawn_response, drawn_step, rounded
from .channels import Channel

BODE_POINTS = 500
NYQUIST_SHOWN = 5.0  # |L| up to which it is in the Nyquist plot
SIZES_SHOWN = 12.0  # ln |L| from top to bottom of the Bode plot: 100 dB
SHOWN_TURNS = 12.0  # of 1/ω at the channel's lowest gain crossover: how long a step is shown
GROWN = 30.0  # steps
GUESS = 4.0
EDGE_COLUMNS = 80
"""Range of the first window as a multiple of a channel's own gains."""


def stand(source: Robot) -> list[dict[str, Any]]:
    """Limits of each joint and its position in each posture."""
    body = source.body
    angles = {name: stance.body.angles(stance.body.configuration(dict(stance.angles))) for name, stance in source.postures.items()}
    return [
        {
            "name": name,
            "low": max(float(body.lower[k]), -3.15),
            "high": min(float(body.upper[k]), 3.15),
            "unit": "m" if body.prismatic[k] else "rad",
            "at": {posture: float(values[k]) for posture, values in angles.items()},
        }
        for k, name in enumerate(source.joint_names)
    ]


def keyframe_angles(source: Robot) -> dict[str, dict[str, float]]:
    """Joint positions of an MJCF's keyframes, by keyframe and joint; empty if they cannot be read."""
    with contextlib.suppress(GainroomError):
        frames = model_keyframes(Path(source.body.source))
        return {name: {joint: one.angles[joint] for joint in source.joint_names if joint in one.angles} for name, one in frames.items()}
    return {}


def span_of(system: System) -> tuple[float, float]:
    """Span of the frequency axis [Hz]."""
    step = system.control.sample_time
    fastest = max(drive.bandwidth for drive in system.drives if not drive.is_ideal) if any(not d.is_ideal for d in system.drives) else 2e3
    return 0.05, 0.5 / step if step is not None else fastest / math.pi


def part_of(state: State, channel: Channel) -> LoopPart:
    """Part of the state's loop that belongs to the channel."""
    system, k = state.system, channel.place
    if system.control.space == "joint":
        return LoopPart.of_joint(state.loop, k)
    tasks = system.source.tasks(state.model, system.control.rotors)
    return LoopPart(tasks.torque[:, k], tasks.jacobian[k], channel.own)


def window_for(channel: Channel) -> tuple[float, float]:
    """Window of gains around the channel's own."""
    kp, kd = channel.point
    return GUESS * max(kp, 1e-3), GUESS * max(kd, 1e-3)


def gain_map(plane: PartRegion, channel: Channel, window: tuple[float, float] | None, asked: Requirements) -> dict[str, Any]:
    """Outlines of the stable gains, and of those with which the channel's own loop meets the requirements `asked`.

    Without a `window` one that shows where the stable ones end.
    """
    window = window or fitted(plane, channel)

    def required(kps: Floats) -> list[Floats]:
        return required_columns(plane, asked, kps)

    required_outlines = plane.outlines(window, required) if asked.asked else ()
    return {
        "stable": [*map(drawn_line, plane.outlines(window))],
        "required": [*map(drawn_line, required_outlines)],
        "unread": list(unread(asked)),
        "edge": _edge(plane, window),
        "lines": [],
        "window": window,
        "channel": channel.name,
    }


@dataclass(frozen=True)
class EveryState:
    """Gains of a channel in every state at once, up to `window`; `checkpoint` is called between its loops, and may end it by raising."""

    states: Iterable[State]
    channel: Channel
    window: tuple[float, float]
    checkpoint: Callable[[], None]

    def parts(self, final: bool) -> Iterator[dict[str, Any]]:
        """Outlines of the gains that are stable everywhere, and if `final` of those that meet the requirements; `next`: part to come."""
        try:
            moving = [state for state in self.states if state.moves]
            together = RegionInEveryState([(state.loop, part_of(state, self.channel)) for state in moving], self.window, self.checkpoint)
            asked = moving[0].system.requirements
            more, left_out = final and bool(asked.asked), list(unread(asked))
            first = {"every": [*map(drawn_line, together.stable())], "safe": [], "whole": None, "missing": ""}
            yield first | {"next": "safe" if more else "", "last": final and not more}
            if more:
                safe = {"safe": [*map(drawn_line, together.required(asked))], "unread": left_out}
                yield safe | {"next": "" if left_out else "whole", "last": bool(left_out)}
            if more and not left_out:  # else what meets every requirement is not known
                yield {"whole": [*map(drawn_line, together.required(asked, others=True))], "next": "", "last": True}
        except GainroomError as error:
            yield {"every": [], "safe": [], "whole": None, "missing": str(error), "next": "", "last": final}


def fitted(plane: PartRegion, channel: Channel) -> tuple[float, float]:
    """Window wide enough to show the upper end of kd."""
    guess = window_for(channel)
    columns = plane.columns(np.linspace(0.05, 1, 12) * guess[0])
    tops = [one[-1, 1] for one in columns if len(one) and math.isfinite(one[-1, 1])]
    return guess[0], max(1.15 * max(tops, default=guess[1]), 1.5 * channel.point[1])


def _edge(plane: PartRegion, window: tuple[float, float]) -> list[dict[str, Any]]:
    """Ends of the stable gains within the window, with the frequencies that vibrate there."""
    kp, kd, omega = plane.edge(np.linspace(0.002, 1, EDGE_COLUMNS) * window[0])
    pick = (kd >= 0) & (kd <= window[1])
    return [{"line": [rounded(kp[pick]), rounded(kd[pick])], "hz": rounded(omega[pick] / (2 * math.pi), 6)}]


def bode(plane: PartRegion, channel: Channel) -> dict[str, Any]:
    """Return ratio of the channel with all other loops closed."""
    value = plane.ratio(*channel.point)
    sound = np.isfinite(value) & (np.abs(value) > 0)
    omega, value = plane.omega[sound], value[sound]
    phase = np.degrees(np.unwrap(np.angle(value)))
    phase -= 360 * math.ceil((phase[0] - 1) / 360)
    pick = _drawn(omega, value)
    return drawn_response(omega[pick], value[pick], phase[pick])


def _drawn(omega: Floats, value: Complexes) -> Integers:
    """Indices of about BODE_POINTS samples, evenly along the curves: the Bode plot by frequency and size, the Nyquist plot by length."""
    low, high = np.log(omega[[0, -1]])
    turn = np.where(np.minimum(np.abs(value[1:]), np.abs(value[:-1])) < NYQUIST_SHOWN, np.abs(np.diff(value)), 0.0)
    length = np.diff(np.log(omega)) / (high - low) + np.abs(np.diff(np.log(np.abs(value)))) / SIZES_SHOWN + turn / NYQUIST_SHOWN
    along = np.append(0.0, np.cumsum(length))
    return np.unique(np.searchsorted(along, np.linspace(0, along[-1], BODE_POINTS)))


def quick_verdict(state: State, limit: GainLimit | None, channel: Channel, plane: PartRegion | None = None) -> dict[str, Any]:
    """Verdict on one state: stability and the limit of all gains together, certified; phase margin and Ms of the channel, from samples."""
    if limit is None:
        text = f"In {state.title} {state.reason}."
        return {"basis": "quick", "sentence": text, "tone": "warn", "rows": [], "stable": None, "met": None}
    at = at_frequency(limit.frequency, ", at ")
    most = limiting_joints(limit, state.model.joint_names)
    mainly = f", mainly {listed(most[:3])}" if most else ""
    here = f"In {THIS_STATE}: stable"
    if math.isnan(limit.gain):
        text = f"{here if limit.stable else f'Unstable in {state.title}'}; the gain limit is not known."
    elif limit.stable:
        text = f"{here}. Vibration starts at {digits(limit.gain, '×', 3)} all gains ({to_db(limit.gain):.3g} dB){at}{mainly}."
        text = text if math.isfinite(limit.gain) else f"{here}. No common factor up to 1000 on all gains makes it vibrate."
    else:
        text = f"Unstable in {state.title}" + (
            f"{at}: stable below {digits(limit.gain, '×', 3)} all gains{mainly}." if limit.gain > 0 else "."
        )
    asked = state.system.requirements
    rows = []
    if limit.stable and math.isfinite(limit.gain):
        met = asked.met("gain_margin", limit.gain)
        rows.append(_row("gain_margin", "gain margin, all loops", margin_value(asked, "gain_margin", limit.gain, met, 3), asked, met))
    if plane is not None and limit.stable:
        value = plane.ratio(*channel.point)
        circle = np.flatnonzero((np.abs(value[1:]) > 1) != (np.abs(value[:-1]) > 1))
        phase = float(np.abs(np.angle(-value[circle])).min()) if len(circle) else math.inf
        peak = float((1 / np.abs(1 + value)).max())
        for name, found in (("phase_margin", phase), ("peak_sensitivity", peak)):
            one = REQUIREMENTS[name]
            rows.append(_row(name, f"{one.label}, {channel.name}", f"≈ {one.text(found)}", asked, None))
    tone = "wait" if limit.stable else "bad"  # never "good" before every requirement has been judged in every state
    tone = "bare" if limit.stable and asked.met("gain_margin", limit.gain) is False else tone
    return {"basis": "quick", "sentence": text, "tone": tone, "rows": rows, "stable": limit.stable, "met": None}


def _row(name: str, title: str, value: str, asked: Any, met: bool | None) -> dict[str, Any]:
    return {"name": name, "title": title, "worst": value, "required": requirement(asked, name, 3), "met": met, "where": "", "to_use": ""}


def mode(state: State, limit: GainLimit) -> dict[str, Any]:
    """Mode shape of the vibration at the limit; its parts are empty if there is no limit."""
    known = math.isfinite(limit.frequency)
    return {
        "hz": limit.frequency / (2 * math.pi) if known else None,
        "stable": limit.stable,
        "gain": limit.gain,
        "names": state.model.joint_names,
        "mode_re": limit.mode.real if known else [],
        "mode_im": limit.mode.imag if known else [],
        "state": [state.posture, state.contact],
    }


def slowest_root(state: State) -> dict[str, Any]:
    """Rightmost oscillating closed-loop root at these gains: growth rate [1/s] and frequency [Hz]."""
    roots = rightmost_roots(state.loop, count=6).roots
    swinging = roots[np.abs(roots.imag) > 1e-6 * np.abs(roots)]
    if not len(swinging):
        return {"growth": None, "hz": None}
    return {"growth": float(swinging[0].real), "hz": float(abs(swinging[0].imag)) / (2 * math.pi)}


def settling(plane: PartRegion, channel: Channel) -> float:
    """Duration for which a step of the channel is shown [s]."""
    value = np.abs(plane.ratio(*channel.point))
    below = np.flatnonzero((value[1:] <= 1) & (value[:-1] > 1))
    return SHOWN_TURNS / float(plane.omega[below[0]] if len(below) else plane.omega[0])


def step(state: State, channel: Channel, duration: float, scale: float) -> dict[str, Any]:
    """Channel after a step of its reference and under a load of a unit of its output on the links, others closed; cut beyond GROWN steps.

    scale   of what is shown of the second
    """
    try:
        found = step_response(state.loop, duration, part_of(state, channel))
    except GainroomError as error:
        return {"note": str(error)}
    reference = found.reference.link
    large = np.flatnonzero(~(np.abs(reference) < GROWN))
    pick = slice(None, int(large[0]) if len(large) else None, max(1, len(reference) // 500))
    return drawn_step(found, pick, scale) | {"growth": None, "hz": None}


def heat(study: RobotStudy) -> dict[str, Any]:
    """Data of the heat map: factors on the present gains at which the robot starts to vibrate, state by state.

    states   posture and contact of each
    parts    joints, or task directions
    together (states,) all gains scaled; stable (states,) bool; closed (states, parts) one of the parts scaled, other loops closed

    Empty lists where no task can move anything.
    """
    factors: Factors | None = task_factors(study) if study.system.control.space == "task" else joint_factors(study)
    if factors is None:
        return {"states": [], "parts": [], "together": [], "stable": [], "closed": []}
    return {
        "states": [[state.posture, state.contact] for state in factors.states],
        "parts": factors.parts,
        "together": factors.together,
        "stable": factors.stable,
        "closed": factors.other_loops_closed,
    }
