"""What a user describes: a source of plants, drives, control, what is required, and what is not known exactly."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..errors import case_text
from .assembly import Feedback
from .controller import PD
from .drive import Drive
from .elastic_joint import ElasticJoint
from .filters import LowPass, Notch
from .gain_path import GainPath
from .linear.arrays import Booleans, Floats
from .loop import Loop, build_loop
from .plant import Plant
from .requirements import Requirements
from .uncertainty import NOMINAL, Place, Share, Uncertainty, is_end

Balance = Literal["joints", "controller", ""]
INSIDE = 8
"""Places between the corners of an uncertainty, beside its centre: more delay or stiffness may do harm in the middle of a range alone."""
SHOWN = 3
"""Joints whose place in a range is said."""
MIXED = 4
"""Draws of joints that lie each somewhere else in their ranges, beside the two of every other joint low."""


class PlantSource(Protocol):
    """What plants come from: one joint (elastic_joint.py) or a robot (robot/robot.py) in its postures and contact states.

    name, joint_names (n,)   for messages and tables
    prismatic   (n,) True where a joint is prismatic: its numbers are in m and N
    states      (posture, contact state) by name; of one joint a single one without names
    body        the links; None for one joint
    stack       tasks by falling priority
    quantities  of the actuators by name in Uncertainty and plausibility.py, each (n,), SI
    unknown     what decides and nobody gave, by a finding's code (studies/verdict.py): the joints or links that it is of
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
        """The plant in one state, without names the first; `weight`: with gravity stiffness where nothing is said of gravity."""
        ...

    def tasks(self, model: Any, rotors: bool = False) -> Any:
        """The operational space at a linearised state."""
        ...

    def with_quantities(self, **values: ArrayLike) -> Self:
        """The same with other actuators: `values` by name in `quantities`, a number or (n,)."""
        ...


Source = TypeVar("Source", bound=PlantSource)


@dataclass(frozen=True)
class Control:
    """The controller: gains in joint space, or filters around the tasks' own gains.

    space       "joint" or "task"
    controller  of n joints, with gains () or (n,); None in task space
    feedback    "motor" or "link": the side of the gearbox the encoders are on
    sample_time [s]; None: continuous
    rotors      the tasks' model of the robot counts the motors' inertia
    weight      (n,) how much each joint's stiffness counts when gains are recommended
    kd_path     where kd closes when not with the other gains; None: with them
    command_delay   [s] of set-points on their way to the controller: it delays the motion, and no margin depends on it
    sampling_in_delay   the drives' delay contains hold and velocity difference of the loop: continuous time is the loop that runs
    continuous          the loop is said to have no rate, so that none is missing
    """

    space: str
    controller: Any
    feedback: Feedback
    sample_time: float | None = None
    velocity_filter: LowPass | None = None
    notches: tuple[Notch, ...] = ()
    rotors: bool = False
    weight: Floats | None = None
    kd_path: GainPath | None = None
    command_delay: float = 0.0
    sampling_in_delay: bool = False
    continuous: bool = False


@dataclass(frozen=True)
class System(Generic[Source]):
    """One joint or a whole robot, as a file describes it.

    source        what its plants come from
    drives        one per joint
    balance       who damps sway of a floating base on its contacts: "joints", by their gains; "controller", one above them; "": not said
    scenario      what `gainroom simulate` does with it; None where the file has none, or it was not asked for
    entered       values that a file gives in place of a source's quantities, by key: rotor_inertia, gear_ratio
    assumptions   what was assumed where nothing was said
    warnings      what a user should look at
    """

    source: Source
    drives: tuple[Drive, ...]
    control: Control
    requirements: Requirements = field(default_factory=Requirements.usual)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    balance: Balance = ""
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
        feedback: Feedback = "motor",
        sample_time: float | None = None,
        requirements: Requirements | None = None,
        uncertainty: Uncertainty | None = None,
        **others: Any,
    ) -> "System":
        """One joint with its drive and controller; requirements None: the usual ones; `others`: fields of System."""
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
        """The longest of its drives' [s]."""
        return max(drive.delay for drive in self.drives)

    @property
    def lag(self) -> float:
        """The longest of its drives' delays with their current loops, and a tick of hold and velocity difference [s]."""
        longest = max(drive.delay + 2 * drive.damping_ratio / drive.bandwidth for drive in self.drives)
        return longest + (self.control.sample_time or 0.0)

    @property
    def rate_is_missing(self) -> bool:
        """Continuous time that nobody asked for, and a delay as only a sampled loop has one, without what sampling adds to it."""
        control = self.control
        return control.sample_time is None and self.delay > 0 and not (control.sampling_in_delay or control.continuous)

    def controller(self, model: Any) -> Any:
        """The controller of n joints in one state: the file's own in joint space, that of its tasks in task space."""
        if self.control.controller is not None:
            return self.control.controller
        return self.filtered(self.source.tasks(model, self.control.rotors).controller())

    def filtered(self, controller: PD) -> PD:
        """A controller with this system's filters."""
        return replace(controller, velocity_filter=self.control.velocity_filter, notches=self.control.notches)

    def with_controller(self, controller: Any) -> "System":
        """The same with another controller in joint space."""
        return replace(self, control=replace(self.control, space="joint", controller=controller))

    def scaled(self, factor: float) -> Self:
        """The system with all gains times `factor`."""
        if self.control.controller is not None:
            return replace(self, control=replace(self.control, controller=self.control.controller.scaled(factor)))
        return replace(self, source=replace(self.source, stack=tuple(task.scaled(factor) for task in self.source.stack)))  # type: ignore[type-var]

    def loop(self, model: Plant | None = None, controller: Any = None) -> Loop:
        """The loop of one state, by default the first, with another controller where one is given."""
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
        """The same with other delays [s] and other quantities of the source, each a number or (n,).

        resonance, damping_ratio   of gearboxes, as Uncertainty has them; NaN where stiffness or damping stay
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
        """The system at a place in its uncertainty; at NOMINAL itself."""
        return self if place == NOMINAL else self.with_values(**self.uncertainty.values(place))

    def cases(self, weight: bool = False, inside: bool = False) -> Iterator["StateCase"]:
        """Every state, nominal and then at every corner of the uncertainty; `weight`: see PlantSource.linearize.

        inside   at places between the corners, too, and where joints differ
        """
        for posture, contact in self.source.states:
            yield from self.cases_of(posture, contact, weight, inside)

    def cases_of(self, posture: str, contact: str, weight: bool = False, inside: bool = False) -> Iterator["StateCase"]:
        """The same of one state."""
        uncertain, places = self.uncertainty, [NOMINAL]
        if uncertain.names:
            between = [*uncertain.inside(INSIDE), *uncertain.mixed(len(self.source.joint_names), MIXED)] if inside else []
            places += [*uncertain.corners, *between]
        for place in places:
            yield self.case_at(place, posture, contact, weight)

    def case_at(self, place: Place, posture: str, contact: str, weight: bool = False) -> "StateCase":
        """One state at one place in the uncertainty."""
        moved = self.at(place)
        text, between = _place_text(self.uncertainty, place), any(not is_end(share) for share in place)
        return StateCase(posture, contact, text, moved, moved.source.linearize(posture, contact, weight), between)


@dataclass(frozen=True)
class StateCase:
    """One posture and contact state at one place in the uncertainty.

    place          as text; "" for the nominal case
    system, model  there
    between        whether it is no corner
    """

    posture: str
    contact: str
    place: str
    system: System
    model: Any
    between: bool = False

    @property
    def title(self) -> str:
        """For messages."""
        return f"{self.posture}/{self.contact}" + (f" ({self.place})" if self.place else "")


def _place_text(uncertainty: Uncertainty, place: Place) -> str:
    """Each quantity by its value, or where joints differ by how far up its range it is."""
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
"""The system of one joint, by the name that it had."""
