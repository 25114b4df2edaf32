"""Gains with which the search for a robot's recommended gains begins: those of each joint alone, and of tasks at its rates."""

import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..system.controller import PD
from ..system.elastic_joint import ElasticJoint
from ..system.feedback import Feedback
from ..system.gain_bounds import GainBounds
from ..system.linear.arrays import Booleans, Floats
from ..system.plant import Plant
from ..system.system import System
from .joint_gains import recommend_pd
from .margin_slopes import GainCase, Gains

if TYPE_CHECKING:
    from ..robot.model import RobotModel
    from ..robot.tasks import Tasks

UNLIMITED = 100.0  # multiple of the largest beginning stiffness above which nothing limits it
SHARES = (0.5, 0.25, 0.12, 0.9, 0.05)
"""Shares of the damping of each joint alone with which a search may begin: it begins stable, and then meets the requirements."""
SOFT = (0.2, 0.05, 0.8, 0.01)
"""Shares of its stiffness, times that share: a robot without weight may be soft. A very soft beginning often ends soft: requirements
leave some joints a soft and a stiff range, with none between.
"""
WEIGHED = (0.2, 0.4, 0.1, 1.0, 3.0, 10.0, 30.0)
"""Shares of the stiffness where gravity asks for it."""
_JOINT = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")
IMMOBILE = 1e-12
"""Mobility of a joint, relative to the largest, below which the contacts hold it: they leave round-off."""
HEAVIEST = 1e3  # times the motor's inertia: loads beyond this, or a joint that the contacts hold, do not change a PD's limits


@dataclass(frozen=True)
class Beginning:
    """Gains (3, m) with which a search begins, before they are multiplied by a share.

    unit     (m,) unit of stiffness of each direction
    data     arrays (m,) of values that are equal for directions that are alike
    weight   (m,) of each direction, that its user gives it
    bounds   within which gains begin and stay
    names    of the directions, where there are bounds
    """

    gains: Gains
    unit: Floats
    data: list[Floats]
    cascade: Booleans
    weight: Floats
    bounds: GainBounds = field(default_factory=GainBounds)
    names: Sequence[str] = ()

    @property
    def most(self) -> float:
        """Largest stiffness, in units of `unit`, that a search tries; gains that reach it are taken as unlimited."""
        return UNLIMITED * float((self.gains[0] * np.where(self.cascade, self.gains[1], 1.0) / self.unit).max())

    def at(self, share: float, softness: float) -> Gains:
        """Gains (3, m) with a share of the damping, and that share times `softness` of the stiffness."""
        kp, kd, ki = self.gains
        gains = np.array([np.where(self.cascade, softness, share * softness) * kp, share * kd, share * softness * ki])
        return self.bounds.within(gains)

    def even(self) -> Gains:
        """Gains (3, m) of joints with the same rates kp/J and kd/J, below those of the slowest joint alone, and softly."""
        kp, kd, ki = self.gains
        inertia, some = self.unit / self.weight, kd > 0
        slowest = float(np.min(kd[some] / inertia[some], initial=math.inf))
        rates = slowest * float(np.median(kp[some] / kd[some])), slowest
        return replace(self, gains=np.where(some, [rates[0] * inertia, rates[1] * inertia, ki], 0.0)).at(SHARES[1], SOFT[1])

    def first(self, weighed: bool) -> Gains:
        """Gains (3, m) with which a search begins, if they are stable."""
        return self.at(SHARES[0], (WEIGHED if weighed else SOFT)[0])


def joints_that_move(model: Plant, feedback: Feedback) -> Booleans:
    """Mask (n,), False for joints whose gains act on no motion: contacts hold the link, with a rigid gearbox or a link-side encoder."""
    own = np.diagonal(model.link_inverse_inertia)
    free = own > IMMOBILE * np.abs(model.link_inverse_inertia).max()
    return free if feedback.link else free | model.elastic


def link_inertia(model: "RobotModel") -> Floats:
    """Load inertia 1/W_ii (n,), bounded where contacts hold a joint: by its motor's inertia or, without one, by the heaviest load."""
    own = np.diagonal(model.link_inverse_inertia)
    free = own[own > IMMOBILE * own.max()]
    heaviest = HEAVIEST * np.where(model.motor_inertia > 0, model.motor_inertia, 1 / free.min() if len(free) else 1.0)
    return np.minimum(1 / np.maximum(own, 1 / heaviest), heaviest)


class JointsAlone:
    """Recommended kp and kd of single joints, computed once each; may be called from several threads."""

    def __init__(self) -> None:
        self._known: dict[tuple, tuple[float, float]] = {}
        self._lock = threading.Lock()

    def of(self, key: tuple, found: Callable[[], tuple[float, float]]) -> tuple[float, float]:
        """Gains kp and kd stored under `key`; if there are none, those that `found` computes, which are then stored."""
        with self._lock:
            if key not in self._known:
                self._known[key] = found()
            return self._known[key]


def joints_alone(system: System, model: "RobotModel", lightest: Floats, known: JointsAlone | None = None) -> Beginning:
    """Recommended gains of each joint alone, with its lightest load and its longest delay.

    known   results of earlier calls for the same system
    """
    size = model.size
    latest = [drive.delay for drive in system.drives] if system.uncertainty.delay is None else system.uncertainty.delay[1].tolist()
    heaviest = float(lightest.max())
    known = known or JointsAlone()
    gains, unit = np.zeros((3, size)), np.zeros(size)
    for k in range(size):
        link = float(f"{lightest[k] / heaviest:.3g}") * heaviest  # legs that differ by round-off are one joint
        unit[k] = float(model.motor_inertia[k]) + link
        # The joint is scaled to inertia 1, so that rounding does not depend on units.
        parts: dict[str, Any] = {name: float(getattr(model, name)[k]) / unit[k] for name in _JOINT}
        joint, drive = ElasticJoint(link_inertia=link / unit[k], **parts), replace(system.drives[k], delay=latest[k])
        key = (*parts.values(), joint.link_inertia, drive)
        gains[:2, k] = unit[k] * np.array(known.of(key, partial(_alone, system, joint, drive)))
    data = [*(np.asarray(getattr(model, name), dtype=float) for name in _JOINT), np.array(latest)]
    data += [np.array([getattr(drive, name) for drive in system.drives]) for name in ("bandwidth", "damping_ratio")]
    weight = np.ones(size) if system.control.weight is None else system.control.weight
    alike = [*data, weight] if system.groups is None else [np.zeros(size)]  # else the file says which joints are
    return Beginning(gains, unit * weight, alike, np.zeros(size, dtype=bool), weight, system.bounds, model.joint_names)


def tasks_alike(tasks: "Tasks", joints: Beginning) -> Beginning:
    """Gains of all task directions at the rates of the slowest joint alone; P/PI ones in the file's proportions."""
    kp, kd, _ = joints.gains
    rate, quotient = float(np.min(kd / joints.unit)), float(np.median(kp / kd))
    given = (tasks.kp != 0) | (tasks.kd != 0) | (tasks.ki != 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = np.where(tasks.cascade & (tasks.kd > 0), tasks.ki / tasks.kd, 0.0)
    outer = np.where(tasks.cascade, quotient, rate * quotient * (tasks.kp != 0))
    gains = np.where(given, np.array([outer, np.full(len(outer), rate), rate * inner]), 0.0)
    return Beginning(gains, tasks.weight, [], tasks.cascade, tasks.weight)


def stable_starts(
    cases: Sequence[GainCase], beginning: Beginning, weighed: bool, progress: Callable[[], None], known: Gains | None, only: bool
) -> Iterator[Gains]:
    """Gains that are stable in every case: shares of what each joint alone is recommended; `known` ones come after the first such.

    known   (3, m), NaN where there are none
    only    True: none but those that are known
    """
    order, tried = list(cases), set[bytes]()  # bounds make different shares alike

    def stable(gains: Gains) -> bool:
        progress()
        for case in order:
            if not case.stable(gains):
                order.remove(case)
                order.insert(0, case)  # in which others fail, too, most likely
                return False
        return all(case.known(gains) for case in cases)

    def parts(share: float) -> Iterator[Gains]:
        """Stable gains at one share of the damping; above a stiffness at which they vibrate none is tried: those vibrate, too."""
        stiffest = math.inf
        for soft in WEIGHED if weighed else SOFT:
            gains = beginning.at(share, soft)
            if (key := gains.tobytes()) in tried:
                continue
            tried.add(key)
            if soft < stiffest and stable(gains):
                yield gains
            elif soft < stiffest and order[0].vibrates(gains):
                stiffest = soft

    likely = parts(SHARES[0])
    if known is not None:
        if not only:
            yield from itertools.islice(likely, 1)
        yield from filter(stable, [beginning.bounds.within(np.where(np.isnan(known), beginning.first(weighed), known))])
    if not only:
        yield from likely
        yield from itertools.chain.from_iterable(map(parts, SHARES[1:]))


def _alone(system: System, joint: ElasticJoint, drive) -> tuple[float, float]:
    """Recommended kp and kd of one joint; a critically damped guess where nothing limits it."""
    template = PD(1.0, 1.0, **system.control.filters)
    place = {
        "feedback": system.control.feedback,
        "sample_time": system.control.sample_time,
        "controller": template,
        "objective": "largest_kp",
    }
    found = recommend_pd(joint, drive, system.requirements, **place)
    if found is not None:
        return found.kp, found.kd
    inertia, crossover = joint.motor_inertia + joint.link_inertia, 0.2 / max(drive.delay + 2 / drive.bandwidth, 1e-3)
    return inertia * crossover**2, 2 * inertia * crossover
