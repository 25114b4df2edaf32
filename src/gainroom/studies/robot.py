"""Study of a whole robot: every posture in every contact state, all joints together, each joint, and task space; and recommended gains."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit, Margins
from ..design.gain_cases import case_of
from ..design.gain_sets import GainSet, RobotGains
from ..design.parallel import Job, each, in_parallel
from ..design.robot_gains import delay_margin_in_all, margins_at_rate, recommend_robot
from ..design.set_search import gains_of
from ..design.starting_gains import JointsAlone
from ..errors import computable
from ..system.controller import PD, Controller
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS
from ..system.system import System
from ..system.uncertainty import Place, Uncertainty
from .analysis import Analysis, analyze
from .critical_joints import most_sensitive
from .link_motion import LinkMotion, link_motion
from .progress import Progress, after, quiet
from .softest_link import Hand, SoftestLink, hand_of, softest_now
from .state import USUAL_RATE, State, task_headroom
from .study_record import StudyRecord
from .worst_place import try_places

EXPECTED_LOOKS = 250
"""Rough number of sampled loops that the search for gains takes per state and corner of the uncertainty, for the progress bar."""
NUMBERS = ("margins", "worst_case", "joints", "tasks")
ROUNDS = 4
"""Most searches for gains, each with the places in the ranges at which the previous gains fail."""
HELD = 4
"""Number of failing places kept from one search to the next, the worst ones."""


@dataclass(frozen=True)
class MarginMotion:
    """Motion of the joints at a margin in one state; `limit` holds its frequency and mode.

    place   in the uncertainty, as text; "" at the nominal values
    joint   name of the joint whose own loop has the margin; "": all loops together
    """

    state: State
    place: str
    limit: GainLimit
    joint: str = ""

    @property
    def title(self) -> str:
        """State and place in the uncertainty, as text."""
        return f"{self.state.title} ({self.place})" if self.place else self.state.title


@dataclass(frozen=True)
class RobotStudy(Analysis, StudyRecord):
    """Results of `gainroom robot`.

    recommended   recommended gains by space
    exact   recommended gains of the file's own space for every state without uncertainty; None without uncertainty or recommendation
    """

    recommended: tuple[RobotGains, ...] = ()
    exact: RobotGains | None = None

    @cached_property
    def to_use(self) -> tuple[RobotGains, GainSet] | None:
        """Recommended gains of the file's own space that are safe in every state; None if there are none, or they act on no motion."""
        for gains in self.recommended:
            if gains.space == self.system.control.space and gains.everywhere is not None and gains.everywhere.moves:
                return gains, gains.everywhere
        return None

    @cached_property
    def margins_to_use(self) -> Margins | None:
        """Margins of `to_use`, the delay margin at the corners of the uncertainty; None if there are no such gains."""
        if self.to_use is None:
            return None
        gains, found = self.to_use
        if self.system.uncertainty.names and not math.isnan(found.margins.delay_margin):  # required, and so looked at in between, too
            return found.margins
        return replace(found.margins, delay_margin=delay_margin_in_all(self.system, found, gains.space))

    @property
    def uncertainty_cost(self) -> Floats | None:
        """Share (n,) of what gains make largest, the links' dynamic stiffness or kp, that the uncertainty costs each joint or direction.

        NaN where nothing moves it. None: not known.
        """
        exact = None if self.exact is None else self.exact.everywhere
        if self.to_use is None or exact is None:
            return None
        name = "kp" if self.system.objective == "largest_kp" else "stiffness"
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.maximum(1 - getattr(self.to_use[1], name) / getattr(exact, name), 0.0)

    @cached_property
    def softest_now(self) -> SoftestLink | None:
        """The softest link with the file's gains; None where no link is held, or no state is stable."""
        return softest_now(self.states)

    @cached_property
    def link_motion(self) -> LinkMotion | None:
        """Motion of the links over time, with the file's gains, in the state with the softest one; None where it is not known."""
        softest = self.softest_now
        return None if softest is None else link_motion(next(state for state in self.states if state.title == softest.title))

    @cached_property
    def hands(self) -> tuple[Hand | None, Hand | None]:
        """The hand of an arm with a payload, with the file's gains and with recommended ones; None where there is none."""
        states = [state for state in self.states if state.moves]
        stable = [(state.posture, state.contact, state.loop) for state in states if state.limit.stable]
        if self.to_use is None or self.to_use[0].space != "joint":
            return hand_of(self.system, stable), None
        gains = gains_of(self.to_use[1])
        new = [(state.posture, state.contact, case_of(state.case, "joint").loop(gains)) for state in states]
        return hand_of(self.system, stable), hand_of(self.system, new)

    @property
    def most_raised(self) -> float:
        """Largest ratio of a recommended gain to the present one; 1 at least, of gains per joint only, and where there is a present one."""
        if self.to_use is None or self.system.control.space != "joint":
            return 1.0
        found = self.to_use[1]
        present = self.system.control.controller.matrices(len(found.kp))
        pairs = ((found.kp, present.get((0, 0))), (found.kd, present.get((1, 0))))  # a P/PI's kp is no torque per angle
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.array([gain / np.diagonal(now) for gain, now in pairs if now is not None])
        return float(np.max(ratios, initial=1.0, where=np.isfinite(ratios)))

    @property
    def raised(self) -> bool:
        """True if a recommended gain exceeds its present value times the limit of the common factor on all gains."""
        limit = self.tightest.limit
        return limit.stable and self.most_raised > limit.gain

    @cached_property
    def controllers_to_use(self) -> tuple[Controller, ...]:
        """Recommended gains of each joint or task direction as a controller of its own; 0 where nothing moves.

        They have the type of the file, or are PDs if no gains of that type make the loop of a PD.
        """
        assert self.to_use is not None
        gains, found = self.to_use
        kp, kd = np.nan_to_num(found.kp), np.nan_to_num(found.kd)
        control, source = self.system.control, self.system.source
        if gains.space == "joint":
            own = [control.controller.on_joint(k, len(kp)) for k in range(len(kp))]
            made = tuple(one.of_pd(float(p), float(d)) for one, p, d in zip(own, kp, kd, strict=True))
            alike = len({type(one) for one in made}) == 1  # a file has one type for all joints
            return made if alike else tuple(one.plain_pd(float(p), float(d)) for one, p, d in zip(own, kp, kd, strict=True))
        tasks = source.tasks(self.states[0].model, control.rotors)
        tasks = replace(tasks, kp=kp, kd=kd, ki=np.zeros(len(kp)) if found.ki is None else np.nan_to_num(found.ki))
        return tuple(tasks.of_direction(k) for k in range(len(kp)))

    @cached_property
    def recommended_at_usual_rate(self) -> Margins | None:
        """Margins of `to_use` at USUAL_RATE; None if the file has a rate, or there are no such gains."""
        if self.to_use is None or not self.system.rate_is_missing:
            return None
        gains, found = self.to_use
        return margins_at_rate(self.system, found, gains.space, USUAL_RATE)

    @cached_property
    def decisive_motion(self) -> MarginMotion | None:
        """Motion at the worst value of the decisive requirement; None if that is the gain limit, or has no frequency.

        All loops together: the eigenvector of L whose eigenvalue is nearest to −1. One loop: the column of S, the response to a disturbance
        of its joint.
        """
        if self.decisive not in ("phase_margin", "peak_sensitivity"):
            return None
        state, place = self._worst_case(self.decisive)
        found, one = state.counted, REQUIREMENTS[self.decisive]
        omega = one.frequency(found)
        if not math.isfinite(omega) or omega <= 0:
            return None
        size = state.loop.size
        response = state.loop.response(np.array([omega])).reshape(size, size)
        if self.decisive == "phase_margin":
            values, vectors = np.linalg.eig(response)
            mode, joint = vectors[:, int(np.argmin(np.abs(values + 1)))], ""
        else:
            sensitivity, k = most_sensitive(response)
            mode, joint = sensitivity[:, k], state.model.joint_names[k]
        return MarginMotion(state, place, replace(found.limit, frequency=omega, mode=mode / mode[np.argmax(np.abs(mode))]), joint)

    def _worst_case(self, name: str) -> tuple[State, str]:
        """Worst state of a requirement at its worst place in the uncertainty; and that place, as text."""
        state, place = self.worst[name], self.case_of(name)
        for case in state.uncertain_cases if place else ():
            if case.place == place:
                return State(case.system, case.posture, case.contact, case.model), place
        return state, ""

    @cached_property
    def topples(self) -> tuple[str, ...]:
        """Titles of stable states that become unstable with the weight, where the file does not say whether it counts."""
        return tuple(itertools.compress((state.title for state in self.states), each(lambda state: state.topples_with_weight, self.states)))

    @property
    def softest(self) -> State | None:
        """State that gravity topples at these and all lower gains and that needs the highest gains to stand.

        None if the tightest state is not such a state, or for some such state no sufficient gains are known.
        """
        toppled = [state for state in self.states if state.toppled_below is not None]
        known = not any(math.isnan(state.lower_gain) for state in toppled)
        return max(toppled, key=lambda state: state.lower_gain) if known and self.tightest in toppled else None

    @property
    def unstable_tasks(self) -> list[State]:
        """States in which the tasks' own gains, which the file does not close, are unstable."""
        return [state for state in self._open_tasks if state.task_limit is not None and not state.task_limit.stable]

    @property
    def weakest_tasks(self) -> State | None:
        """State in which the tasks' gains, stable in every state, have the least gain margin; None if that is enough."""
        if self.unstable_tasks or not self._open_tasks:
            return None
        state, asked = min(self._open_tasks, key=task_headroom), self.system.requirements
        return state if state.task_limit is not None and asked.met("gain_margin", state.task_limit.gain) is False else None

    @property
    def _open_tasks(self) -> list[State]:
        """States in which the file has tasks that act but are not closed."""
        return [] if self.system.control.space == "task" else [state for state in self.states if state.task_limit is not None]


def study_robot(system: System, progress: Progress = quiet, recommend: bool = True) -> RobotStudy:
    """Study of one robot; `recommend`: with recommended gains, which takes longest. Raises as analyze."""
    jobs = _recommended(system) if recommend and system.requirements.asked else []
    expected, looked = EXPECTED_LOOKS * len(system.source.states) * 2 ** len(system.uncertainty.names) * len(jobs), itertools.count()

    def analysis(checkpoint: Callable[[], None]) -> Analysis:
        found = analyze(system, after(checkpoint, progress), NUMBERS)
        found.missed_at_usual_rate  # noqa: B018 - beside the search for gains; its states remember
        return found

    def count() -> None:
        progress(min(next(looked), expected), expected, "gains")

    every: list[Job[Any]] = [analysis, *jobs]
    found, *recommended = in_parallel(every, count if jobs else lambda: None)
    exact = recommended.pop() if jobs and system.uncertainty.names else None
    return RobotStudy(system, found.every, tuple(recommended), exact)


def _over_ranges(system: System, space: str, search: Callable[[Sequence[Place], RobotGains | None], RobotGains]) -> RobotGains:
    """Gains that hold at every tried place of the ranges; a set that fails after ROUNDS is left out and reported as failing.

    search   function that finds gains that also hold at given places, starting from known gains
    """
    found, places, failing = search((), None), list[Place](), dict[str, list[Place]]()
    for count in range(ROUNDS if system.uncertainty.names and space == "joint" and len(system.source.joint_names) > 1 else 0):
        failing = {one.contact: short for one in found.sets if (short := _short_at(system, one))}
        if not failing:
            return found
        if count < ROUNDS - 1:
            places += [place for short in failing.values() for place in short if place not in places]
            found = search(places, found)
    return found.without(
        {contact: f"gains that miss something at {len(short)} or more places in the ranges" for contact, short in failing.items()}
    )


def _short_at(system: System, found: GainSet) -> list[Place]:
    """Places in the ranges at which a set of gains per joint misses a requirement in its states, worst first."""
    geared = system.with_controller(system.filtered(PD(np.nan_to_num(found.kp), np.nan_to_num(found.kd))))
    every = [
        State(geared, posture, contact, system.source.linearize(posture, contact))
        for posture, contact in system.source.states
        if found.contact in ("", contact)
    ]
    states = [state for state in every if state.moves]
    return try_places(geared, states).unsafe(HELD) if states else []


def _recommended(system: System) -> list[Job[RobotGains]]:
    """Jobs for recommended gains in joint space and, with tasks, in task space; with uncertainty, then for RobotStudy.exact."""
    spaces, alone = ("joint", "task") if system.source.stack else ("joint",), JointsAlone()

    def of(space: str, system: System = system, by_contact: bool = True) -> Job[RobotGains]:
        def job(checkpoint: Callable[[], None]) -> RobotGains:
            def search(places: Sequence[Place], start: RobotGains | None) -> RobotGains:
                return recommend_robot(system, space, checkpoint, start, alone, by_contact, places)

            with computable(f"{system.source.name}: recommended gains, {space} space"):
                return _over_ranges(system, space, search)

        return job

    exact = [of(system.control.space, replace(system, uncertainty=Uncertainty()), False)] if system.uncertainty.names else []
    return [*(of(space) for space in spaces), *exact]
