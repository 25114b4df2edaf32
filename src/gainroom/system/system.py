"""System: source of plants, drives, control, requirements and uncertainty, as described by a joint or robot file."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import Self

from ..errors import case_text
from .controller import PD
from .drive import Drive
from .elastic_joint import ElasticJoint
from .feedback import GivenFeedback, feedback_of
from .filters import FILTERS, Biquad, LowPass, Notch
from .gain_bounds import GainBounds
from .gain_path import GainPath
from .linear.arrays import Booleans, Floats
from .loop import Loop, build_loop
from .plant import Plant
from .requirements import Requirements
from .uncertainty import NOMINAL, Place, Share, Uncertainty, is_end

Balance = Literal["joints", "controller", ""]
Objective = Literal["dynamic_stiffness", "largest_kp"]
"""What recommended gains make largest."""
INSIDE = 8
"""Number of sampled places between the corners of an uncertainty, beside its centre: delay or stiffness may be worst inside a range."""
SHOWN = 3
"""Number of joints whose place in a range is spelled out."""
MIXED = 4
"""Number of random draws in which each joint has its own place in its ranges, beside the two alternating cases."""


class PlantSource(Protocol):
    """Source of plants: one joint (elastic_joint.py) or a robot (robot/robot.py) in its postures and contact states.

    name, joint_names (n,)   for messages and tables
    prismatic   (n,) True where a joint is prismatic: its values are in m and N
    states      (posture, contact state) names; a joint has a single state without names
    body        the links; None for one joint
    stack       tasks by falling priority
    quantities  actuator quantities by name in Uncertainty and plausibility.py, each (n,), SI
    unknown     missing data that decides results: joints or links, by the code of the finding (studies/verdict.py)
    """

    @property
    def name(self) -> str: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def prismatic(self) -> Booleans: ...
    @property
    def states(self) -> tuple[tuple[str, str], ...]: ...
    @property
    def body(self) -> Any: ...
    @property
    def stack(self) -> tuple[Any, ...]: ...
    @property
    def quantities(self) -> Mapping[str, Floats]: ...
    @property
    def unknown(self) -> Mapping[str, tuple[str, ...]]: ...

    def linearize(self, posture: str | None = None, contact: str | None = None, weight: bool = False) -> Plant:
        """Plant in one state, by default the first; `weight`: with gravity stiffness even where gravity is not described."""
        ...

    def tasks(self, model: Any, rotors: bool = False) -> Any:
        """Operational space of the tasks at the linearised state `model`."""
        ...

    def with_quantities(self, **values: ArrayLike) -> Self:
        """Source with other actuator `values`, by name in `quantities`, each a number or (n,)."""
        ...


Source = TypeVar("Source", bound=PlantSource)


@dataclass(frozen=True)
class Control:
    """Control law: gains in joint space, or filters around the tasks' own gains.

    space       "joint" or "task"
    controller  of n joints, with gains () or (n,); None in task space
    feedback    the side of the gearbox the encoders are on, or of one joint a side per gain
    sample_time [s]; None: continuous
    rotors      True: the tasks' model of the robot includes the motors' inertia
    weight      (n,) weight of each joint's stiffness when gains are recommended
    kd_path     separate path of kd; None: kd closes with the other gains
    command_delay   [s] of set-points on their way to the controller: it delays the motion, and no margin depends on it
    sampling_in_delay   True: the drives' delay includes hold and velocity difference, so the continuous loop is the one that runs
    continuous          True: the loop is stated to be continuous, so that no rate is missing
    """

    space: str
    controller: Any
    feedback: Any  # of GivenFeedback; a Feedback from then on
    sample_time: float | None = None
    velocity_filter: LowPass | None = None
    notches: tuple[Notch, ...] = ()
    biquads: tuple[Biquad, ...] = ()
    rotors: bool = False
    weight: Floats | None = None
    kd_path: GainPath | None = None
    command_delay: float = 0.0
    sampling_in_delay: bool = False
    continuous: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "feedback", feedback_of(self.feedback, self.controller))  # frozen

    @property
    def filters(self) -> dict[str, Any]:
        """The filters around the tasks' gains, by argument of a controller's constructor."""
        return {name: getattr(self, name) for name in FILTERS}


@dataclass(frozen=True)
class System(Generic[Source]):
    """One joint or a whole robot with its control, as a file describes it.

    source        source of plants
    drives        one per joint
    balance       which controller damps sway of a floating base: "joints", the joint gains; "controller", one above them; "": not stated
    objective     what recommended gains make largest
    bounds        of recommended gains, per joint
    groups        joints with equal recommended gains, by index; None: those that are images of each other by name
    asks          True: the file has no gains, and asks which may be used; those of `control` are placeholders
    scenario      motion that `gainroom simulate` runs; None where the file has none, or it was not asked for
    entered       values given in place of a source's quantities, by key: rotor_inertia, gear_ratio
    assumptions   assumptions made where the file gives no value
    warnings      warnings for the user
    """

    source: Source
    drives: tuple[Drive, ...]
    control: Control
    requirements: Requirements = field(default_factory=Requirements.usual)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    balance: Balance = ""
    objective: Objective = "dynamic_stiffness"
    bounds: GainBounds = field(default_factory=GainBounds)
    groups: tuple[tuple[int, ...], ...] | None = None
    asks: bool = False
    scenario: Any = None
    entered: Mapping[str, float] = field(default_factory=dict)
    assumptions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @classmethod
    def of_joint(
        cls,
        joint: ElasticJoint,
        drive: Drive,
        controller: Any,
        feedback: GivenFeedback = "motor",
        sample_time: float | None = None,
        requirements: Requirements | None = None,
        uncertainty: Uncertainty | None = None,
        **others: Any,
    ) -> "System":
        """System of one joint with its drive and controller; requirements None: the default ones; `others`: fields of System."""
        return cls(
            joint,  # type: ignore[arg-type] - a source like any other
            (drive,),
            Control("joint", controller, feedback, sample_time),
            Requirements.usual() if requirements is None else requirements,
            Uncertainty() if uncertainty is None else uncertainty,
            **others,
        )

    def __repr__(self) -> str:
        return f"System({self.source!r}, control in {self.control.space} space)"

    @property
    def delay(self) -> float:
        """Longest drive delay [s]."""
        return max(drive.delay for drive in self.drives)

    @property
    def lag(self) -> float:
        """Longest drive delay with its current loop's lag, plus one tick for hold and velocity difference [s]."""
        longest = max(drive.delay + 2 * drive.damping_ratio / drive.bandwidth for drive in self.drives)
        return longest + (self.control.sample_time or 0.0)

    @property
    def torque_lags(self) -> list[float]:
        """Lag [s] of each joint's torque behind a slow motion: drive delay, current loop and half a tick of hold."""
        held = (self.control.sample_time or 0.0) / 2
        return [held + drive.delay + 2 * drive.damping_ratio / drive.bandwidth for drive in self.drives]

    @property
    def rate_is_missing(self) -> bool:
        """True if no sample rate is given though the drives have a delay: a delay typical of sampled loops, without the lag of sampling."""
        control = self.control
        return control.sample_time is None and self.delay > 0 and not (control.sampling_in_delay or control.continuous)

    def controller(self, model: Any) -> Any:
        """Controller of n joints in the state `model`: that of the file in joint space, that of the tasks in task space."""
        if self.control.controller is not None:
            return self.control.controller
        return self.filtered(self.source.tasks(model, self.control.rotors).controller())

    def filtered(self, controller: PD) -> PD:
        """`controller` with this system's filters."""
        return replace(controller, **self.control.filters)

    def with_controller(self, controller: Any) -> "System":
        """System with `controller` in joint space."""
        return replace(self, control=replace(self.control, space="joint", controller=controller))

    def scaled(self, factor: float) -> Self:
        """The system with all gains times `factor`."""
        if self.control.controller is not None:
            return replace(self, control=replace(self.control, controller=self.control.controller.scaled(factor)))
        return replace(self, source=replace(self.source, stack=tuple(task.scaled(factor) for task in self.source.stack)))  # type: ignore[type-var]

    def loop(self, model: Plant | None = None, controller: Any = None) -> Loop:
        """Loop of one state, by default the first; `controller` None: that of the system."""
        model = self.source.linearize() if model is None else model
        controller = self.controller(model) if controller is None else controller
        control = self.control
        return build_loop(model, self.drives, controller, control.feedback, control.sample_time, control.kd_path)

    def with_values(
        self,
        delay: ArrayLike | None = None,
        resonance: ArrayLike | None = None,
        damping_ratio: ArrayLike | None = None,
        **values: ArrayLike,
    ) -> "System":
        """System with other drive delays [s] and source quantities, each a number or (n,).

        resonance, damping_ratio   of gearboxes, as in Uncertainty; NaN keeps stiffness or damping
        """
        if resonance is not None or damping_ratio is not None:
            known = {**self.source.quantities, **values}
            inertia, stiffness, damping = (np.asarray(known[name], dtype=float) for name in ("motor_inertia", "stiffness", "damping"))
            omega, ratio = (np.asarray(math.nan if given is None else given, dtype=float) for given in (resonance, damping_ratio))
            stiffness = np.where(np.isnan(omega), stiffness, inertia * omega**2)
            damping = np.where(np.isnan(ratio), damping, 2 * ratio * np.sqrt(stiffness * inertia))
            values = {**values, "stiffness": stiffness, "damping": damping}
        delays = np.broadcast_to([drive.delay for drive in self.drives] if delay is None else delay, len(self.drives))
        drives = tuple(replace(drive, delay=float(one)) for drive, one in zip(self.drives, delays, strict=True))
        return replace(self, source=self.source.with_quantities(**values) if values else self.source, drives=drives)

    def at(self, place: Place) -> "System":
        """System at a place in its uncertainty; itself at NOMINAL."""
        return self if place == NOMINAL else self.with_values(**self.uncertainty.values(place))

    def cases(self, weight: bool = False, inside: bool = False) -> Iterator["StateCase"]:
        """Cases of every state: nominal, then every corner of the uncertainty; `weight`: see PlantSource.linearize.

        inside   True: also at places between the corners, and with joints at different places
        """
        for posture, contact in self.source.states:
            yield from self.cases_of(posture, contact, weight, inside)

    def cases_of(self, posture: str, contact: str, weight: bool = False, inside: bool = False) -> Iterator["StateCase"]:
        """Cases of one state: nominal, then every corner of the uncertainty; arguments as `cases`."""
        uncertain, places = self.uncertainty, [NOMINAL]
        if uncertain.names:
            between = [*uncertain.inside(INSIDE), *uncertain.mixed(len(self.source.joint_names), MIXED)] if inside else []
            places += [*uncertain.corners, *between]
        for place in places:
            yield self.case_at(place, posture, contact, weight)

    def case_at(self, place: Place, posture: str, contact: str, weight: bool = False) -> "StateCase":
        """Case of one state at one place in the uncertainty."""
        moved = self.at(place)
        text, between = _place_text(self.uncertainty, place), any(not is_end(share) for share in place)
        return StateCase(posture, contact, text, moved, moved.source.linearize(posture, contact, weight), between)


@dataclass(frozen=True)
class StateCase:
    """One posture and contact state at one place in the uncertainty.

    place          as text; "" for the nominal case
    system, model  system and linearised plant at that place
    between        True: the place is no corner
    """

    posture: str
    contact: str
    place: str
    system: System
    model: Any
    between: bool = False

    @property
    def title(self) -> str:
        """Posture, contact state and place, for messages."""
        return f"{self.posture}/{self.contact}" + (f" ({self.place})" if self.place else "")


def _place_text(uncertainty: Uncertainty, place: Place) -> str:
    """Place as text: each quantity's value, or its share of the range where joints differ; "" at NOMINAL."""
    if place == NOMINAL:
        return ""
    values = {name: np.atleast_1d(value) for name, value in uncertainty.values(place).items()}
    shares = {name: _share_text(share) for name, share in zip(values, place, strict=True)}
    return ", ".join(
        case_text({name: float(each[0])}) if np.all(each == each[0]) else f"{name.replace('_', ' ')} {shares[name]}"
        for name, each in values.items()
    )


def _share_text(share: Share) -> str:
    if isinstance(share, tuple):
        rest = " …" if len(share) > SHOWN else ""
        return f"by joint at {' '.join(f'{100 * one:.0f}' for one in share[:SHOWN])}{rest} % of its range"
    return {0.0: "low", 1.0: "high"}.get(share, f"{100 * share:.3g} % up")


JointSpec = System.of_joint
"""Former name of System.of_joint."""
