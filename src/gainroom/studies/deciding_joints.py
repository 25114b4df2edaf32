"""The joints that decide a margin of a state."""

import math

import numpy as np

from ..analysis.equal_modes import common_mode, equal_to
from ..analysis.margin_record import Margins
from ..system.excluded_sets import ROUND_OFF
from ..system.linear.arrays import Complexes, Floats, first_least
from ..system.loop import Loop
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS, SensitivityBound
from .state import STRONG, State, limiting_joints, strongest_first


def joints_that_miss(state: State, one: Requirement, needed: float) -> tuple[str, ...]:
    """The joints that decide a requirement that a state misses, then all whose own loop misses it, the others as they are."""
    own = one.of_loops(state.counted)
    values = [] if own is None else own.tolist()
    short = [name for name, value in zip(state.model.joint_names, values, strict=False) if not one.met(needed, value)]
    return tuple(dict.fromkeys([*deciding_joints_in(state, one.name), *short]))


def margins_by_joint(state: State, one: Requirement, together: float, deciding: tuple[str, ...]) -> Floats:
    """(n,) of what a requirement bounds, each joint's own in a state: of its loop, the other loops closed, or, where that is worse, of all.

    together   the value of all loops together [SI], which counts for the joints that decide it
    NaN        not known; also of a joint that decides nothing, where the requirement tells nothing of single loops
    """
    names, own = state.model.joint_names, one.of_loops(state.counted)
    values = np.full(len(names), math.nan) if own is None else np.array(own, dtype=float)
    decides = np.array([name in deciding for name in names]) | (len(names) == 1)
    if own is None:
        return np.where(decides, together, values)
    return np.where(decides, (np.maximum if one.at_most else np.minimum)(values, together), values)


def deciding_joints_in(state: State, name: str) -> tuple[str, ...]:
    """The joints that decide a margin of a state."""
    return deciding_joints(state.loop, state.counted, state.model.joint_names, name)


def deciding_joints(loop: Loop, found: Margins, names: tuple[str, ...], name: str) -> tuple[str, ...]:
    """The joints that move where a margin is: in the vibration at the gain limit, or where the loop is lost to delay or phase.

    The one joint whose loop has the margin, where that is of one loop at a time: the peak sensitivity, and what is less than that of all
    loops together. None for a requirement that has no frequency, and tells nothing of single loops.
    """
    if name == "gain_margin" and found.least_gain_margin < found.gain_headroom * (1 - ROUND_OFF) and loop.kd_path is None:
        return (names[first_least(found.one_loop_gain_margins)],)
    one = REQUIREMENTS[name]
    own = one.of_loops(found)
    if name != "gain_margin" and one.at_most and own is not None and loop.kd_path is not None:
        return (names[first_least(-own)],)
    if name == "gain_margin" or loop.kd_path is not None:
        return limiting_joints(found.limit, names)
    if name == "phase_margin" and found.one_loop_phase_margin < found.common_phase_margin:
        return (names[first_least(found.one_loop.phase_margin)],)
    if not one.at_frequency:
        return () if own is None else (names[first_least(-own if one.at_most else own)],)
    omega = one.frequency(found)
    if not (math.isfinite(omega) and omega > 0):
        return limiting_joints(found.limit, names)
    response = loop.response(np.array([omega])).reshape(len(names), len(names))
    if isinstance(one, SensitivityBound):
        return (names[most_sensitive(response, one.slope, one.offset)[1]],)
    values, vectors = np.linalg.eig(response)
    mode = common_mode(vectors[:, equal_to(values[np.argmin(np.abs(np.abs(values) - 1))], values)])
    return tuple(names[k] for k in strongest_first(mode) if np.abs(mode[k]) >= STRONG)


def most_sensitive(response: Complexes, slope: float = 1.0, offset: float = 0.0) -> tuple[Complexes, int]:
    """S = (I + L)⁻¹ of a response L (n, n), and the loop with the largest |slope S_ii + offset|."""
    found = np.linalg.inv(np.eye(len(response)) + response)
    return found, first_least(-np.abs(slope * np.diagonal(found) + offset))
