"""A whole robot: every posture in every contact state, all joints at once, joint by joint, and in task space; and recommended gains."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit, Margins
from ..design.gain_sets import GainSet, RobotGains
from ..design.robot_gains import delay_margin_in_all, margins_at_rate, recommend_robot
from ..design.side_by_side import Job, each, side_by_side
from ..design.starting_gains import JointsAlone
from ..errors import computable
from ..system.controller import PD, Controller
from ..system.linear.arrays import Floats
from ..system.requirements import REQUIREMENTS
from ..system.system import System
from ..system.uncertainty import Place, Uncertainty
from .analysis import Analysis, analyze
from .deciding_joints import most_sensitive
from .progress import Progress, after, quiet
from .state import USUAL_RATE, State, task_headroom
from .worst_place import try_places

EXPECTED_LOOKS = 250
"""Looks that the search for gains takes per state and corner of the uncertainty, roughly: for the progress bar."""
NUMBERS = ("margins", "worst_case", "joints", "tasks")
ROUNDS = 4
"""Searches for gains, each with the places in the ranges at which those of the one before fail."""
HELD = 4
"""Places that are taken from one search to the next, the worst of it."""


@dataclass(frozen=True)
class Motion:
    """How joints move where a margin is: in a state, `limit` with its frequency and mode.

    place   where in the uncertainty, as text; "" at the nominal values
    joint   of one loop by itself: whose; else ""
    """

    state: State
    place: str
    limit: GainLimit
    joint: str = ""

    @property
    def title(self) -> str:
        """Where it is."""
        return f"{self.state.title} ({self.place})" if self.place else self.state.title


@dataclass(frozen=True)
class RobotStudy(Analysis):
    """What `gainroom robot` reports.

    recommended   by space
    exact   those of the file's own space for every state, if nothing were uncertain; None where nothing is, or none are looked for
    """

    recommended: tuple[RobotGains, ...] = ()
    exact: RobotGains | None = None

    @cached_property
    def to_use(self) -> tuple[RobotGains, GainSet] | None:
        """Recommended gains of the file's own space that are safe in every state; None where there are none, or they move nothing."""
        for gains in self.recommended:
            if gains.space == self.system.control.space and gains.everywhere is not None and gains.everywhere.moves:
                return gains, gains.everywhere
        return None

    @cached_property
    def margins_to_use(self) -> Margins | None:
        """What those keep, the delay margin at the corners of what is uncertain; None where there are none."""
        if self.to_use is None:
            return None
        gains, found = self.to_use
        if self.system.uncertainty.names and not math.isnan(found.margins.delay_margin):  # required, and so looked at in between, too
            return found.margins
        return replace(found.margins, delay_margin=delay_margin_in_all(self.system, found, gains.space))

    @property
    def uncertainty_cost(self) -> Floats | None:
        """(n,) the part of each joint's or direction's kp that the uncertainty takes; NaN where nothing moves it. None: not known."""
        exact = None if self.exact is None else self.exact.everywhere
        if self.to_use is None or exact is None:
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.maximum(1 - self.to_use[1].kp / exact.kp, 0.0)

    @property
    def raised(self) -> bool:
        """Whether a recommended gain is above the limit of all gains by one factor times what it is now."""
        limit, control = self.tightest.limit, self.system.control
        if self.to_use is None or control.space != "joint" or not (limit.stable and math.isfinite(limit.gain)):
            return False
        found = self.to_use[1]
        present = control.controller.matrices(len(found.kp))
        pairs = ((found.kp, present.get((0, 0))), (found.kd, present.get((1, 0))))  # a P/PI's kp is no torque per angle
        return any(now is not None and bool(np.any(gain > limit.gain * np.diagonal(now))) for gain, now in pairs)

    @cached_property
    def controllers_to_use(self) -> tuple[Controller, ...]:
        """Those gains, of each joint or task direction as a controller of its own; 0 where nothing moves.

        Of the type that the file has, or PDs where no gains of that type make the loop of a PD.
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
        """What those keep at USUAL_RATE; None where the file has a rate, or there are none."""
        if self.to_use is None or not self.system.rate_is_missing:
            return None
        gains, found = self.to_use
        return margins_at_rate(self.system, found, gains.space, USUAL_RATE)

    @cached_property
    def decisive_motion(self) -> Motion | None:
        """Where the requirement that decides is worst; None where that is the gain limit, or has no frequency.

        All loops together: the eigenvector of L whose value is nearest to −1. One loop: S's column, the answer to what disturbs its joint.
        """
        if self.decisive not in ("phase_margin", "peak_sensitivity"):
            return None
        state, place = self._worst_case(self.decisive)
        found, one = state.counted, REQUIREMENTS[self.decisive]
        omega = one.frequency(found)
        if not math.isfinite(omega) or omega <= 0:
            return None
        response = state.loop.response(np.array([omega]))[0]
        if self.decisive == "phase_margin":
            values, vectors = np.linalg.eig(response)
            mode, joint = vectors[:, int(np.argmin(np.abs(values + 1)))], ""
        else:
            sensitivity, k = most_sensitive(response)
            mode, joint = sensitivity[:, k], state.model.joint_names[k]
        return Motion(state, place, replace(found.limit, frequency=omega, mode=mode / mode[np.argmax(np.abs(mode))]), joint)

    def _worst_case(self, name: str) -> tuple[State, str]:
        """The worst state at the place in the uncertainty where it has least left of a requirement; and that place, as text."""
        state, place = self.worst[name], self.case_of(name)
        for case in state.uncertain_cases if place else ():
            if case.place == place:
                return State(case.system, case.posture, case.contact, case.model), place
        return state, ""

    @cached_property
    def topples(self) -> tuple[str, ...]:
        """The stable states in which the weight, of which the file does not say whether it counts, makes the joints' gains unstable."""
        return tuple(itertools.compress((state.title for state in self.states), each(lambda state: state.topples_with_weight, self.states)))

    @property
    def softest(self) -> State | None:
        """The state in which gravity, which topples the robot at these and all lower gains, takes the highest.

        None where the tightest state is not such a one, or some such state has no higher ones that are known to hold it.
        """
        toppled = [state for state in self.states if state.toppled_below is not None]
        known = not any(math.isnan(state.lower_gain) for state in toppled)
        return max(toppled, key=lambda state: state.lower_gain) if known and self.tightest in toppled else None

    @property
    def unstable_tasks(self) -> list[State]:
        """The states in which the tasks' own gains, which the file does not close, are unstable."""
        return [state for state in self._open_tasks if state.task_limit is not None and not state.task_limit.stable]

    @property
    def weakest_tasks(self) -> State | None:
        """Where those gains are stable in every state, the one in which they have the least gain margin; None where that is enough."""
        if self.unstable_tasks or not self._open_tasks:
            return None
        state, asked = min(self._open_tasks, key=task_headroom), self.system.requirements
        return state if state.task_limit is not None and asked.met("gain_margin", state.task_limit.gain) is False else None

    @property
    def _open_tasks(self) -> list[State]:
        """The states in which the file has tasks that act but are not closed."""
        return [] if self.system.control.space == "task" else [state for state in self.states if state.task_limit is not None]


def study_robot(system: System, progress: Progress = quiet, recommend: bool = True) -> RobotStudy:
    """Everything about one robot; `recommend`: with recommended gains, which takes longest. Raises as analyze does."""
    jobs = _recommended(system) if recommend and system.requirements.asked else []
    expected, looked = EXPECTED_LOOKS * len(system.source.states) * 2 ** len(system.uncertainty.names) * len(jobs), itertools.count()

    def analysis(checkpoint: Callable[[], None]) -> Analysis:
        found = analyze(system, after(checkpoint, progress), NUMBERS)
        found.missed_at_usual_rate  # noqa: B018 - beside the search for gains; its states remember
        return found

    def count() -> None:
        progress(min(next(looked), expected), expected, "gains")

    every: list[Job[Any]] = [analysis, *jobs]
    found, *recommended = side_by_side(every, count if jobs else lambda: None)
    exact = recommended.pop() if jobs and system.uncertainty.names else None
    return RobotStudy(system, found.every, tuple(recommended), exact)


def _over_ranges(system: System, space: str, search: Callable[[Sequence[Place], RobotGains | None], RobotGains]) -> RobotGains:
    """Gains that hold at every place of the ranges that is tried of them; a set that does not after ROUNDS is left out, and said to fail.

    search   finds gains that hold at some places, too, from those that are known
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
    """Places in the ranges at which a set of gains per joint misses something in its states, the worst ones first."""
    geared = system.with_controller(system.filtered(PD(np.nan_to_num(found.kp), np.nan_to_num(found.kd))))
    every = [
        State(geared, posture, contact, system.source.linearize(posture, contact))
        for posture, contact in system.source.states
        if found.contact in ("", contact)
    ]
    states = [state for state in every if state.moves]
    return try_places(geared, states).unsafe(HELD) if states else []


def _recommended(system: System) -> list[Job[RobotGains]]:
    """Recommended gains in joint space and, where there are tasks, in task space; where something is uncertain, then RobotStudy.exact."""
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
