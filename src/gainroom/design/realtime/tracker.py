"""The gain limit of a robot at every control tick, rigid-body terms included.

The C++ core does the work, rigid-body terms included (native/include/gainroom/posture_tracker.hpp); here a robot, its control and limits
become the core's numbers.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...analysis.gain_limit import gain_limit
from ...errors import GainroomError, first_of_many, nearest
from ...io.atomic import write_text
from ...native import _core
from ...robot.rigid_tree import held_frames, tree_rows, tree_tasks
from ...robot.tasks import MOVABLE
from ...system.controller import PD, Controller
from ...system.linear.arrays import Floats
from ...system.requirements import Requirements
from ...system.system import Control, System
from .c_header import provenance
from .cpp_header import Tracked, tracked_header
from .trackable import joint_gains, joint_table, require_leads, require_trackable

if TYPE_CHECKING:
    from ...robot.robot import Robot

ALIASED = 5e-8
"""Largest share of the motors' mobility that aliases of other motion may add.

Limits err by less than that; beside a sharp resonance 12 times as much was seen, which is less than safe_gain stays below them.
"""
HOLDING = 6
"""Directions that have to be held for a floating base to stand."""
FLAGS = ("", "posture", "contact", "too few constraints")
WEAK = 0.05
"""Factors on the gains of tasks below which directions may act on each other so slowly that nobody minds."""
DOUBLE = np.dtype(float)
PIECE = 1000
"""Ticks of a motion after which Python hears of signals, and other threads get their turn."""


class TrackedLimit(NamedTuple):
    """The limit at one tick; gains are common factors on all gains of the control.

    gain        the lowest known factor at which the loop loses stability; NaN where none is known
    frequency   at which it then vibrates [rad/s]
    certified   whether `gain` is the loop's limit now: see GainTracker
    age_ticks   since the limit of this contact state was certified, 0: now; −1: not known
    safe_gain   1e-6 below `gain` where that is certified. Else what was certified last in this contact state, or in joint space the
                lowest of all states where there is none, 10 % below it and more the farther the robot is from there, with tasks
                the more it has moved since: no proof; 0 where nothing is known. Never above `gain`, and where `flag` is set never
                above the last answer's; in a contact state with too few constraints also 10 % below its limit at the first posture
    allowed     safe_gain over the gain margin that the limits ask for
    flag        what was wrong with the call, one of FLAGS; "": nothing
    """

    gain: float
    frequency: float
    certified: bool
    age_ticks: int
    safe_gain: float
    allowed: float
    flag: str


class TrackedMotion(NamedTuple):
    """The limits at T ticks, one after the other: arrays (T,) of what TrackedLimit has at each, flags as text.

    seconds     how long each tick took in the core [s], as in a controller written in C++
    """

    gain: Floats
    frequency: Floats
    certified: NDArray[np.bool_]
    age_ticks: NDArray[np.int64]
    safe_gain: Floats
    allowed: Floats
    flag: NDArray[np.str_]
    seconds: Floats


class GainTracker:
    """Tracker of the gain limit of a robot's PD control from tick to tick, in joint or in task space, continuous or sampled.

    robot      as load_robot gives it, N velocities and n joints; the links are those of its first posture
    control    a Control or a PD; None: the robot's own. In task space (`Control.space`) the robot's tasks with their own gains, of which
               all are multiplied: joint gain matrices follow from posture and contact at every tick
    limits     of which the gain margin counts, for `allowed`; None: the robot's own
    contacts   names of contact states; None: all of the robot's

    A certified gain has been followed to convergence at this tick's posture. A little above it the loop's unstable roots have been counted,
    frequency by frequency, and known crossings explain all of them. Since that count began W has moved too little to bring an unknown
    crossing below the gain, were it to move three times as fast as the fastest of those did lately. In joint space roots that are near
    the limit's in frequency are stable at gains up to 10 % below it.

    It is not a proof. The steps of the count are chosen so that phase and slope of the closed loop's determinant agree; each frequency is
    evaluated in the posture of its own tick; and gains below the limit are not examined one by one, so that an interval of instability
    that opens farther below it, or at another frequency, without passing through it is not detected. At construction the first limits are
    compared with gain_limit.

    In task space joint gains are matrices that prove nothing about energy, and tasks that act on each other may be unstable slowly, at
    gains however low. Certified then says as well that at frequencies below those of the limits nothing crosses, at this gain and lower
    ones down to WEAK; that is looked at anew before the robot has moved by 0.3 of its inverse inertia and gains, and at every tick at
    the lowest frequency, where it is seen first near singular postures. Counts also look at three factors below the gain. Where it is
    found that something does cross, and where a contact state was never certified, safe_gain is 0.

    Raises GainroomError for what cannot be tracked: gravity stiffness, springs under contacts, encoders on the link's side, controllers
    other than PD with one gain per joint, or tasks' PD, filters, elastic joints without damping, rigid among elastic joints where control
    is sampled, loops without delay, loops that are not stable from small gains up to the limit, contacts in which joints can move no task.
    """

    def __init__(
        self, robot: "Robot", control: Control | PD | None = None, limits: Requirements | None = None, contacts: Sequence[str] | None = None
    ):
        system = _system(robot, control)
        if not isinstance(limits, Requirements | None):
            raise GainroomError(f"gain tracker: limits of type {type(limits).__name__} must be Requirements")
        names = _contact_names(robot, contacts)
        body, rotors = robot.body, system.control.rotors
        body.require_tree("gain tracker")
        require_trackable(robot, system, names)
        self.space = system.control.space
        """"joint" or "task"."""
        tasks = robot.tasks(robot.linearize(next(iter(robot.postures)), names[0]), rotors) if self.space == "task" else None
        require_leads(robot, system, tasks)
        self.gains = np.array(joint_gains(system) if tasks is None else (tasks.kp, tasks.kd))
        """(2, n) kp and kd that the limits are factors on; (2, m) K'p and K'v of the directions of tasks."""
        self._shape, self._floating = (body.nq,), body.base == "floating"
        self._share = 1.0 / ((system.requirements if limits is None else limits).gain_margin or 1.0)
        stack = () if tasks is None else tasks.tasks
        tracked = Tracked(
            robot.joint_names,
            joint_table(robot, system),
            system.control.sample_time or 0.0,
            tree_rows(body),
            {name: held_frames(body, robot.contacts[name]) for name in names},
            [len(task.directions(robot.joint_names)) for task in stack],
            tree_tasks(body, stack),
            self.gains.copy(),
            rotors,
        )
        rows = [int(np.count_nonzero(held)) for _, held in tracked.contacts.values()]
        machine = tracked.joints, tracked.sample_time, body.nv, max(rows, default=0), len(names)
        if tasks is None:
            self._core = _core.GainTracker(*machine, 0.0, 0.0)
        else:
            self._core = _core.GainTracker(*machine, tracked.sizes, tracked.gains, rotors, MOVABLE)
        self._states = {name: index for index, name in enumerate(names) if not self._falls(rows[index])}
        self._core.set_body(_core.RigidTree(*tracked.tree), list(tracked.contacts.values()), list(self._states.values()), tracked.tasks)
        self._loose = {name: _limit_at_first(robot, system, name) for name in names if name not in self._states}
        first = self._loose | self._settle(robot, system)
        posture = body.configuration(dict(next(iter(robot.postures.values())).angles))
        self._written = tracked, [(name, name in self._states, first[name]) for name in names], posture, Path(robot.name).name

    def update(self, q: ArrayLike, contact: str) -> TrackedLimit:
        """One tick at posture `q` (nq,), as body.configuration gives it, in contact state `contact`. Raises nothing: see `flag`."""
        state = self._state(contact)
        if state is None:
            return self._without(contact)
        if not (type(q) is np.ndarray and q.dtype is DOUBLE and q.shape == self._shape):
            try:
                if np.iscomplexobj(q):
                    return self._lost(1, state)
                q = np.array(q, dtype=float)
            except Exception:  # noqa: BLE001 - whatever objects of others do, a control loop goes on
                return self._lost(1, state)
            if q.shape != self._shape:
                return self._lost(1, state)
        return self._answer(self._core.update_posture(q, state))

    def replay(self, q: ArrayLike, contacts: str | Sequence[str]) -> TrackedMotion:
        """The ticks of a motion that was planned or recorded: `update` at each of q (T, nq), in one contact state or in one for each tick.

        Goes on from where the tracker is; postures that are none, as quaternions of another size, are flagged. Raises GainroomError for
        arrays of other shapes, numbers that are not finite, and contact states that are not tracked.
        """
        try:
            postures = np.asarray(q)
        except (TypeError, ValueError):  # rows of different lengths
            postures = np.array(None)
        if postures.dtype.kind not in "fiu":
            raise GainroomError("gain tracker: q must be an array of real numbers")
        if postures.ndim != 2 or postures.shape[1:] != self._shape:
            raise GainroomError(f"gain tracker: q of shape {postures.shape} must have the shape (ticks, {self._shape[0]})")
        if len(wrong := np.flatnonzero(~np.isfinite(postures).all(axis=1))):
            raise GainroomError(f"gain tracker: q of tick {wrong[0]} must be finite")
        if not (isinstance(contacts, str | Sequence | np.ndarray) and all(isinstance(name, str) for name in contacts)):
            raise GainroomError("gain tracker: contacts must be the name of a contact state or one name for each posture")
        names = [contacts] * len(postures) if isinstance(contacts, str) else list(contacts)
        if len(names) != len(postures):
            raise GainroomError(f"gain tracker: {len(names)} contact states for {len(postures)} postures; there must be one for each")
        for name in dict.fromkeys(names):
            if name not in self._states:
                raise GainroomError(f"gain tracker: contact {name!r} is not one of those tracked{nearest(name, self.contacts, 'contact')}")
        states = [self._states[name] for name in names]
        pieces = [self._core.replay(postures[k : k + PIECE], states[k : k + PIECE]) for k in range(0, len(states), PIECE)]
        gain, frequency, certified, age, safe, flag, seconds = np.concatenate(pieces or [np.empty((0, 7))]).T.copy()
        allowed = safe * self._share
        return TrackedMotion(gain, frequency, certified > 0, age.astype(int), safe, allowed, np.array(FLAGS)[flag.astype(int)], seconds)

    def update_dynamics(self, mass: Floats, jacobians: Sequence[Floats], contact: str, tasks: Sequence[Floats] = ()) -> TrackedLimit:
        """Limit at one tick, see `update`, with mass matrix (N, N) and contact Jacobians, each (c, N), of another dynamics library.

        The arrays are float, of the links without rotors. Velocities are in the order of the robot's body: base, then joints. `tasks`:
        the Jacobians (m_i, N) of tasks, along the world's axes, the first one first; none in joint space. `contact` names the state whose
        crossings are followed; the Jacobians say what is held. Raises nothing: see `flag`.
        """
        state = self._state(contact)
        if state is None:
            return self._without(contact)
        try:
            held = list(jacobians)
            if self._falls(sum(len(rows) for rows in held)):
                return self._lost(3, state)
            return self._answer(self._core.update(mass, held, state, list(tasks)))
        except (TypeError, ValueError):
            return self._lost(1, state)

    def prepare(self, jacobians: Sequence[Floats], contact: str) -> None:
        """After update_dynamics: the contact Jacobians of another contact state in this tick's posture.

        A switch to it then finds its limit certified, or nearly. Each state every tenth tick is enough. `update` does it by itself.
        """
        state = self._state(contact)
        if state is not None:
            with contextlib.suppress(TypeError, ValueError):
                self._core.prepare(list(jacobians), state)

    def crossings(self, contact: str) -> Floats:
        """(k, 4) the crossings that are followed in a contact state, by rising gain.

        Columns: gain; frequency [rad/s]; ±1 as roots become unstable or stable; how much ln gain moves with W, relative to W + 1/J.
        """
        return self._core.crossings(self._states[contact])

    @property
    def contacts(self) -> tuple[str, ...]:
        """Contact states that are tracked; floating bases held in fewer than 6 directions are not."""
        return tuple(self._states)

    def to_header(self, path: str | Path, name: str, date: str | None = None) -> None:
        """Write what is tracked as a C++17 header for a controller: links, actuators, drives, gains, contact states and tasks, as numbers.

        Its one function is called `name`_robot. Of what that returns `gainroom::GainTracker` (native/include/gainroom/gain_tracker.hpp)
        makes a tracker like this one. Its `settle` finds the first limits and compares them with those of gain_limit, which are in the
        header. `date`: as it shall say, None: today.

        Raises GainroomError where `name` is no identifier, or `path` cannot be written: the file is whole or not there.
        """
        tracked, limits, posture, model = self._written
        write_text(Path(path), tracked_header(name, provenance(model, date), tracked, 1.0 / self._share, limits, posture))

    def warmup(self) -> None:
        """Does nothing: the tracker is ready once constructed. Present so that trackers have one interface."""

    def _settle(self, robot: "Robot", system: System) -> dict[str, float]:
        """Gain limit in the first posture of every contact state that is tracked, by gain_limit, once the core has found it too."""
        limits = {}
        for name, state in self._states.items():
            model = robot.linearize(next(iter(robot.postures)), name)
            if self.space == "task" and not robot.tasks(model, system.control.rotors).movable.any():
                raise GainroomError(f"gain tracker: contact {name!r}: the joints can move no task; name contact states in which they can")
            rows = [] if self.space == "joint" else [task.jacobian(model) for task in robot.stack]
            here = model.inertia, [model.contact_jacobian], state, rows
            inverse = np.ascontiguousarray(model.link_inverse_inertia)
            left = self._core.alias_left(inverse, self._core.passive_frequency)
            if left > ALIASED:
                raise GainroomError(
                    f"gain tracker: contact {name!r}: motion faster than the ticks takes part by {left:.1g}, more than {ALIASED:g}; "
                    "shorten the sample time"
                )
            limit = gain_limit(system.loop(model))
            if self.space == "task" and limit.frequency <= self._core.passive_frequency:
                raise GainroomError(
                    f"gain tracker: contact {name!r}: the limit lies at {limit.frequency:.3g} rad/s, "
                    f"below {self._core.passive_frequency:.3g} rad/s, up to where tasks take energy out"
                )
            weakest = 0.0 if self.space == "joint" else WEAK
            if not np.isfinite(limit.gain) or limit.gain == 0 or limit.lower_gain > weakest:
                raise GainroomError(
                    f"gain tracker: contact {name!r}: the loop is stable from a gain factor of {limit.lower_gain:g} to {limit.gain:g}; "
                    "it has to be stable from 0 to a finite one"
                )
            settled, found = self._core.settle(*here, limit.gain)
            if not settled:
                raise GainroomError(f"gain tracker: contact {name!r}: {found:.7g} was found as gain limit, not {limit.gain:.7g}")
            limits[name] = limit.gain
        return limits

    def _answer(self, found: "tuple[float, float, bool, int, float, int]") -> TrackedLimit:
        gain, frequency, certified, age, safe, flag = found
        return TrackedLimit(gain, frequency, certified, age, safe, safe * self._share, FLAGS[flag])

    def _falls(self, rows: int) -> bool:
        """True if contacts hold a floating base in fewer than 6 of `rows` directions, so that it falls."""
        return self._floating and 0 < rows < HOLDING

    def _state(self, contact: str) -> int | None:
        """Number of the contact state in the core; None for one that is not tracked."""
        return self._states.get(contact) if isinstance(contact, str) else None

    def _without(self, contact: str) -> TrackedLimit:
        """Answer for a contact state that is not tracked: no `gain`, a flag, and `safe_gain` as TrackedLimit explains it."""
        limit = self._loose.get(contact) if isinstance(contact, str) else None
        return self._lost(2) if limit is None else self._lost(3, limit=limit)

    def _lost(self, flag: int, state: int = -1, limit: float = np.inf) -> TrackedLimit:
        return self._answer(self._core.lost(flag, state, limit))


def _system(robot: "Robot", control: Control | PD | None) -> System:
    """The robot's system with the control that is tracked."""
    system = getattr(robot, "system", None)
    if system is None:
        raise GainroomError("gain tracker: the robot has to come from load_robot, which reads drives and control")
    system = replace(system, source=robot)  # which may have other actuators or tasks than its file
    if isinstance(control, Controller):
        return system.with_controller(control)
    if control is not None and not isinstance(control, Control):
        raise GainroomError(f"gain tracker: control of type {type(control).__name__} must be a Control or a PD")
    return system if control is None else replace(system, control=control)


def _limit_at_first(robot: "Robot", system: System, contact: str) -> float:
    """The gain limit of a contact state in the first posture; 0 where none is known, or lower gains are not stable."""
    try:
        limit = gain_limit(system.loop(robot.linearize(next(iter(robot.postures)), contact)))
    except GainroomError:
        return 0.0
    return limit.gain if np.isfinite(limit.gain) and limit.lower_gain == 0 else 0.0


def _contact_names(robot: "Robot", names: Sequence[str] | None) -> tuple[str, ...]:
    known: Mapping[str, Any] = robot.contacts
    names = tuple(known) if names is None else tuple(names)
    for name in names:
        if name not in known:
            raise GainroomError(f"gain tracker: contact {name!r} is not one of this robot's{nearest(name, tuple(known), 'contact')}")
    if not names:
        raise GainroomError(f"gain tracker: contacts must name some of {first_of_many(tuple(known))}")
    return names
