"""A whole robot's predicted limits against simulation, state by state, in joint space and in task space.

Two witnesses: the sampled linear loop in time, which shares the model; and MuJoCo with drives and running controller, which shares only
the file.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

from ..analysis.gain_limit import gain_limit
from ..errors import GainroomError
from ..robot.body import library
from ..robot.spec import RobotSpec
from ..simulation.onset import FURTHEST
from ..simulation.robot_onset import robot_onset
from ..simulation.robot_run import RobotSimulation
from ..simulation.robot_setup import robot_setup
from ..system.loop import Loop
from .robot import moves
from .verification import Case, Progress, Verification, linear_case, sentence_of

MOST_STATES = 4
"""More postures in contact states than this: only the posture of each contact state that vibrates first is simulated."""

Job = tuple[str, Callable[[], Case]]
"""A case's name, and what makes it."""


def require_sampled(spec: RobotSpec) -> None:
    """Raises GainroomError for a continuous controller, which has no ticks to simulate."""
    if spec.control.sample_time is None:
        raise GainroomError(f"{spec.robot.name}: control.sample_rate_hz: is missing; the simulation runs a sampled controller")


def verify_robot(spec: RobotSpec, progress: Progress = lambda done, total, what: None) -> Verification:
    """Where all gains together begin to vibrate, predicted and simulated, in every contact state.

    Raises GainroomError for continuous control, and where the gains move nothing in any state.
    """
    require_sampled(spec)
    warnings: list[str] = []
    jobs = [job for space in spaces(spec) for job in _jobs(space, warnings)]
    if not jobs:
        raise GainroomError(f"{spec.robot.name}: the gains move nothing in any posture and contact state, so there is nothing to verify")
    cases = []
    for index, (name, make) in enumerate(jobs):
        progress(index, len(jobs), name)
        cases.append(make())
    progress(len(jobs), len(jobs), "")
    return Verification(tuple(cases), sentence_of(tuple(cases), "the robot"), tuple(warnings))


def spaces(spec: RobotSpec) -> Iterator[RobotSpec]:
    """The file's control in joint space, where it has such gains, and in task space, where it has tasks."""
    control = spec.control
    if control.space == "joint":
        yield spec
    if spec.robot.stack:
        yield replace(spec, control=replace(control, space="task", joints=None))


def _jobs(spec: RobotSpec, warnings: list[str]) -> Iterator[Job]:
    """The cases of one space; what is left out goes to `warnings`."""
    space = spec.control.space
    for posture, contact, loop in _states(spec):
        name = f"{posture}, {contact}: {space} space"
        yield name, lambda name=name, loop=loop: linear_case(name, loop)
        try:
            make = _mujoco(name, spec, posture, contact, loop)
        except GainroomError as error:
            told = f"{name}: {error}" if _has_mujoco() else f"MuJoCo as a witness: {error}"
            if told not in warnings:
                warnings.append(told)
            continue
        if make is not None:
            yield name, make


def _has_mujoco() -> bool:
    try:
        library("mujoco", "MuJoCo")
    except GainroomError:
        return False
    return True


def _states(spec: RobotSpec) -> list[tuple[str, str, Loop]]:
    """Posture, contact state and loop of what is simulated."""
    loops = [(posture, contact, spec.loop(spec.robot.linearize(posture, contact))) for posture, contact in spec.robot.states]
    loops = [state for state in loops if moves(state[2])]
    if len(loops) <= MOST_STATES:
        return loops
    tightest: dict[str, tuple[float, tuple[str, str, Loop]]] = {}
    for state in loops:
        limit = gain_limit(state[2]).gain
        if state[1] not in tightest or limit < tightest[state[1]][0]:
            tightest[state[1]] = limit, state
    return [state for _, state in tightest.values()]


def _mujoco(name: str, spec: RobotSpec, posture: str, contact: str, loop: Loop) -> Callable[[], Case] | None:
    """What makes the case; None where nothing is predicted that a search could find.

    Raises GainroomError where MuJoCo is not there, or cannot simulate this.
    """
    limit = gain_limit(loop)
    if not (1 / FURTHEST < limit.gain < FURTHEST and limit.frequency > 0):
        return None
    if spec.robot.gravity:
        raise GainroomError("gravity stiffness counts in the prediction; the simulated limit is without gravity")
    setup = robot_setup(spec, posture, contact)
    RobotSimulation(setup)  # refuses now what it cannot simulate

    def make() -> Case:
        try:
            onset = robot_onset(setup, limit.gain)
        except GainroomError:  # no factor that was tried changes the verdict
            return Case(name, "mujoco", limit.gain, math.nan, limit.frequency, math.nan)
        return Case(name, "mujoco", limit.gain, onset.gain, limit.frequency, onset.frequency, onset.runs)

    return make
