"""What somebody feels who pushes a robot: its softest link, and how far a force moves the hand of an arm."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..analysis.dynamic_stiffness import frequencies, vibrations
from ..analysis.link_compliance import LinkCompliance
from ..design.gain_cases import own_case
from ..design.gain_sets import GainSet
from ..system.linear.arrays import Floats
from ..system.loop import Loop
from ..system.system import System
from .state import State


@dataclass(frozen=True)
class SoftestLink:
    """Joint whose link is softest, of those whose stiffness the gains decide.

    joint      its index
    stiffness  dynamic stiffness of its link [N m/rad; N/m if prismatic]
    omega      its frequency [rad/s], 0 at rest
    title      the state
    """

    joint: int
    stiffness: float
    omega: float
    title: str


@dataclass(frozen=True)
class Hand:
    """Compliance of a frame of an arm, all loops closed, in the direction and at the frequency where it is largest.

    frame      its name
    softness   displacement per force [m/N]
    omega      the frequency [rad/s]
    title      the state
    """

    frame: str
    softness: float
    omega: float
    title: str


def softest_now(states: Iterable[State]) -> SoftestLink | None:
    """The softest link with the robot's present gains, over its stable states; None where no link is held."""
    found = []
    for state in states:
        if not (state.moves and state.limit.stable):
            continue
        own = own_case(state.title, state.system, state.model)
        if own is None:
            links = state.margins.links
            rows = zip(range(len(links.stiffness)), links.stiffness.tolist(), links.omega.tolist(), strict=True)
        else:
            each, peaks, geared = own[0].peaks(own[1]).softest(len(own[1][0]))
            kept = np.flatnonzero(~np.isnan(each) & ~geared).tolist()
            rows = zip(kept, each[kept].tolist(), peaks[kept].tolist(), strict=True)
        found += [SoftestLink(joint, one, omega, state.title) for joint, one, omega in rows if 0 < one < math.inf]
    return min(found, key=lambda one: one.stiffness, default=None)


def softest_of(found: GainSet) -> SoftestLink | None:
    """The softest link with a recommended set; None where none has a stiffness."""
    j, state = found.softest, found.softest_in[found.softest]
    if state < 0:
        return None
    one = found.links[state]
    return SoftestLink(j, float(one.stiffness[j]), float(one.omega[j]), one.title)


def hand_of(system: System, loops: Iterable[tuple[str, str, Loop]]) -> Hand | None:
    """The hand of an arm with a payload: its frame, which the file names. None of other robots, and without a stable loop.

    loops   (posture, contact state, stable loop with some gains)
    """
    body = system.source.body
    if body.base != "fixed" or len(body.payload) != 1:
        return None
    (frame,) = body.payload
    found = []
    for posture, contact, loop in loops:
        stance = system.source.postures[posture]
        jacobian = stance.body.frame_jacobian(stance.body.configuration(dict(stance.angles)), frame)[:3]
        softness, omega = _softest_at(loop, jacobian)
        found.append(Hand(frame, softness, omega, f"{posture}/{contact}"))
    return max(found, key=lambda one: one.softness, default=None)


def _softest_at(loop: Loop, jacobian: Floats) -> tuple[float, float]:
    """max over ω of σ_max(J C Jᵀ) [m/N] and its ω, on the frequencies from which peaks are looked for: dense about every root.

    C answers to torques on the joints, of which a force f on a frame of a fixed base is Jᵀ f.
    """
    links = LinkCompliance.of(loop)
    omega = frequencies(links, vibrations(loop))
    assert loop.parts is not None
    moved = jacobian @ links.at(1j * omega, links.feedback(1j * omega, loop.parts.controller, loop.gain)) @ jacobian.T
    heights = np.linalg.svd(moved, compute_uv=False)[:, 0]
    k = int(np.argmax(heights))
    return float(heights[k]), float(omega[k])
