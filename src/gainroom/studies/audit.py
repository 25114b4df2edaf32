"""Gains that a robot already runs with: which are safe, how much room is left, and how much delay would make it vibrate.

A joint is safe where its gains keep the required margin on it alone, its neighbours free, and where it takes no part in the vibration of
a robot that does not keep it as a whole.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..analysis.margins import to_db
from ..errors import GainroomError, beside, computable, listed
from ..linear.arrays import Floats
from ..robot.spec import RobotSpec
from ..system.requirements import enough
from .robot import HELD, Progress, margins_of, moves, single_joint_limits
from .robot_record import JudgedState, by_room
from .robot_text import free_joints, unconfirmed

if TYPE_CHECKING:
    from ..robot.model import RobotModel

MARGIN = 2.0
"""The factor on all gains that safe gains survive where none is asked for: 6 dB."""
SLIGHT = 0.05
"""Damping ratio of a motor on its spring that is proposed for a trial where none was given; gearboxes have more than nothing."""


@dataclass(frozen=True)
class AuditState(JudgedState):
    """One contact state; single (n,): see single_joint_limits. delay_limit [s]: the total delay at which it vibrates, NaN: not known."""

    single: Floats
    delay_limit: float

    @property
    def title(self) -> str:
        """There is one posture only."""
        return self.contact

    def keeps(self, margin: float) -> bool:
        """Whether it is stable with `margin` times its gains."""
        return self.limit.stable and enough(self.limit.gain, margin)


@dataclass(frozen=True)
class AuditedJoint:
    """One joint's gains, and the factor on them that it survives alone and with the others closed, in the worst state."""

    name: str
    kp: float
    kd: float
    ki: float
    motor_inertia: float
    safe: bool
    gain_limit: float
    limit_others_closed: float


@dataclass(frozen=True)
class Audit:
    """What `gainroom audit` tells.

    margin        the factor that was asked for
    states        those in which the gains move something: one or more
    safe          every state and every joint keeps it
    still         (posture, contact) of the other states: contacts hold every joint that has gains
    """

    spec: RobotSpec
    margin: float
    states: tuple[AuditState, ...]
    joints: tuple[AuditedJoint, ...]
    safe: bool
    sentence: str
    warnings: tuple[str, ...]
    still: tuple[tuple[str, str], ...] = ()

    @property
    def worst(self) -> AuditState:
        """The state with the least room."""
        return min(self.states, key=lambda state: by_room(state.limit))

    @property
    def delay_limit(self) -> float:
        """[s], over all states; NaN where none is known."""
        return min((state.delay_limit for state in self.states if not math.isnan(state.delay_limit)), default=math.nan)

    @property
    def limiting_joints(self) -> tuple[str, ...]:
        """Those that vibrate at the worst state's limit, the strongest first."""
        return self.worst.limiting_joints

    @property
    def angles(self) -> dict[str, float]:
        """Where every joint of the model stands, held ones too [rad; m if prismatic]."""
        posture = self.spec.robot.postures[self.worst.posture]
        return {name: posture.angles.get(name, 0.0) for name in posture.body.joint_names} | dict(posture.body.locked)

    @property
    def delay(self) -> float:
        """What it runs with [s]."""
        return max(drive.delay for drive in self.spec.drives)


def audit(spec: RobotSpec, margin: float = MARGIN, progress: Progress | None = None) -> Audit:
    """Every state of `spec`, whose control must be in joint space, against a required gain margin (a factor).

    Raises GainroomError for a state that cannot be linearised, and where the contacts hold every joint in all of them.
    """
    names = spec.robot.states
    found = []
    for index, (posture, contact) in enumerate(names):
        if progress is not None:
            progress(index, len(names), contact)
        found.append(_state(spec, posture, contact))
    if progress is not None:
        progress(len(names), len(names), "")
    states = tuple(state for state in found if state is not None)
    if not states:
        raise GainroomError(f"{spec.robot.name}: {HELD} in any state, so there is nothing to audit")
    still = tuple(name for name, state in zip(names, found, strict=True) if state is None)
    result = Audit(spec, margin, states, (), False, "", (), still)
    joints = _joints(result)
    safe = all(state.keeps(margin) for state in states) and all(joint.safe for joint in joints)
    result = replace(result, joints=joints, safe=safe)
    return replace(result, sentence=_sentence(result), warnings=_warnings(result))


def _state(spec: RobotSpec, posture: str, contact: str) -> AuditState | None:
    """One state; None where the gains move nothing. Raises GainroomError where its numbers are too far apart to compute with."""
    model = spec.robot.linearize(posture, contact)
    with computable(f"{spec.robot.name}: contact {contact!r}"):
        return _audited(spec, model, posture, contact)


def _audited(spec: RobotSpec, model: "RobotModel", posture: str, contact: str) -> AuditState | None:
    controller = spec.controller(model)
    loop = spec.loop(model, controller)
    if not moves(loop):
        return None
    margins = margins_of(loop)
    longest = max(drive.delay for drive in spec.drives)
    if margins.stable:
        limit = longest + margins.delay_margin
    else:
        at_once = replace(spec, drives=tuple(replace(drive, delay=0.0) for drive in spec.drives))
        without = margins_of(at_once.loop(model, controller))
        limit = without.delay_margin if without.stable else 0.0
    return AuditState(posture, contact, model, margins, single_joint_limits(spec, model, controller), limit)


def _joints(result: Audit) -> tuple[AuditedJoint, ...]:
    """Joint by joint, each in its worst state."""
    spec = result.spec
    controller = spec.control.joints
    assert controller is not None
    gains = {name: getattr(controller, name, 0.0) for name in ("kp", "kd", "ki")}
    columns = {name: np.broadcast_to(gain, len(spec.robot.joint_names)) for name, gain in gains.items()}
    alone = np.min([state.single for state in result.states], axis=0)
    closed = np.min([state.margins.one_loop.gain_margin for state in result.states], axis=0)
    vibrating = {name for state in result.states if not state.keeps(result.margin) for name in state.limiting_joints}
    return tuple(
        AuditedJoint(
            name=name,
            **{key: float(column[k]) for key, column in columns.items()},
            motor_inertia=float(spec.robot.actuators.motor_inertia[k]),
            safe=enough(float(alone[k]), result.margin) and name not in vibrating,
            gain_limit=float(alone[k]),
            limit_others_closed=float(closed[k]),
        )
        for k, name in enumerate(spec.robot.joint_names)
    )


def _sentence(result: Audit) -> str:
    """The answer in one sentence."""
    worst, count = result.worst, sum(not joint.safe for joint in result.joints)
    limit = worst.limit
    delays = f"it vibrates from {1e3 * result.delay_limit:.3g} ms of delay" if math.isfinite(result.delay_limit) else "no delay does"
    delays = "without delay, too" if result.delay_limit == 0 else delays
    delays = "from which delay is not known" if math.isnan(result.delay_limit) else delays
    given = f"{1e3 * result.delay:.3g} ms"
    if not limit.stable:
        room = (
            f"multiply them by less than {limit.gain:.3g}"
            if limit.gain > 0
            else f"no lower gains in the same ratio help{_undamped(result)}"
        )
        room = "whether lower gains help is not known" if math.isnan(limit.gain) else room
        return f"Not safe: the robot vibrates with these gains at {given} of delay ({delays}); {room}; {_count(count, result)}."
    unknown = [state.contact for state in result.states if math.isnan(state.limit.gain)]
    if unknown:
        return f"Not safe: it is stable, but how far these gains may go in {listed(unknown)} is not known; {_count(count, result)}."
    at = f" at {limit.frequency / (2 * math.pi):.3g} Hz" if math.isfinite(limit.frequency) else ""
    factors, levels = (limit.gain, result.margin), (to_db(limit.gain), to_db(result.margin))
    kept = worst.keeps(result.margin)
    factor, level = (f"{pair[0]:.3g}" if kept else beside(*pair) for pair in (factors, levels))
    room = f"all gains can be multiplied by {factor} ({level} dB) before it vibrates{at}"
    room = "no common factor on all gains makes it vibrate" if math.isinf(limit.gain) else room
    asked = f"{result.margin:.3g} ({to_db(result.margin):.2g} dB)"
    if not result.safe:
        short = f"but a joint by itself has less than the {asked} asked for" if kept else f"less than the {asked} asked for"
        return f"Not safe: {room}, {short}; {delays}; {_count(count, result)}."
    return f"Safe: {room}; {delays}, and has {given}."


def _undamped(result: Audit) -> str:
    """Why no lower gains help where gearboxes were given no damping, and a number to try: a twentieth of the critical damping."""
    actuators = result.spec.robot.actuators
    bare = np.isfinite(actuators.stiffness) & (actuators.damping == 0)
    if not np.any(bare):
        return ""
    try_it = 2 * SLIGHT * np.sqrt(np.median(actuators.stiffness[bare] * actuators.motor_inertia[bare]))
    return (
        " while the gearboxes' damping is taken as 0: measure it, or try a little: "
        f"--damping {try_it:.1g} is {100 * SLIGHT:.0f} % of critical"
    )


def _count(unsafe: int, result: Audit) -> str:
    return f"{unsafe} of {len(result.joints)} joints {'is' if unsafe == 1 else 'are'} not safe"


def _warnings(result: Audit) -> tuple[str, ...]:
    """What was assumed, and what a user should do about it."""
    spec = result.spec
    warnings = list(spec.warnings)
    if spec.control.sample_time is None:
        warnings.append("continuous model: hold and velocity difference of a real controller cost about one more tick; give --rate-hz")
    if result.still:
        contacts = listed([contact for _, contact in result.still])
        warnings.append(f"{contacts}: {HELD} in this contact state: nothing is judged there; check the contacts")
    return (*warnings, *free_joints(spec), *unconfirmed(result.states))
