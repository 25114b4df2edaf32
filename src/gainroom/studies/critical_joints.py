"""Joints that decide a margin of a state."""

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
    """Names of the joints that decide a missed requirement, then of all whose own loop misses it, the other loops closed."""
    own = one.of_loops(state.counted)
    values = [] if own is None else own.tolist()
    short = [name for name, value in zip(state.model.joint_names, values, strict=False) if not one.met(needed, value)]
    return tuple(dict.fromkeys([*critical_joints_in(state, one.name), *short]))


def margins_by_joint(state: State, one: Requirement, together: float, deciding: tuple[str, ...]) -> Floats:
    """Values (n,) of a requirement per joint in a state: of its loop, the other loops closed, or of all loops together if that is worse.

    together   value of all loops together [SI], which counts for the joints that decide it
    NaN        not known; also for a joint that decides nothing, if the requirement is not defined for single loops
    """
    names, own = state.model.joint_names, one.of_loops(state.counted)
    values = np.full(len(names), math.nan) if own is None else np.array(own, dtype=float)
    decides = np.array([name in deciding for name in names]) | (len(names) == 1)
    if own is None:
        return np.where(decides, together, values)
    return np.where(decides, (np.maximum if one.at_most else np.minimum)(values, together), values)


def critical_joints_in(state: State, name: str) -> tuple[str, ...]:
    """Names of the joints that decide the margin `name` of a state."""
    return critical_joints(state.loop, state.counted, state.model.joint_names, name)


def critical_joints(loop: Loop, found: Margins, names: tuple[str, ...], name: str) -> tuple[str, ...]:
    """Names of the joints that move at the frequency of a margin: in the vibration at the gain limit, or at the delay or phase margin.

    A margin of one loop at a time (peak sensitivity, or a single-loop margin below that of all loops together) has a single joint. Empty
    for a requirement without a frequency that is not defined for single loops.
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
    """Sensitivity S = (I + L)⁻¹ of a response L (n, n), and the index of the loop with the largest |slope S_ii + offset|."""
    found = np.linalg.inv(np.eye(len(response)) + response)
    return found, first_least(-np.abs(slope * np.diagonal(found) + offset))
