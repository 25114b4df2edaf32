"""The loop: plant, drive, delay and controller closed around n joints; continuous or sampled.

Return ratio at the motor torque, motor-side feedback:  L(s) = P_M C e^{−sT} D   (link-side: P_L). For n = 1 the loop is stored as zeros,
poles and exact delay; for any n it also has a state space with the delayed channels apart, from which roots come.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainroomError, one_line, require_count, require_finite, require_positive
from ..native import _core
from .assembly import Parts, controller_state
from .controller import Compensator, Controller
from .drive import Drive
from .elastic_joint import ElasticJoint
from .feedback import MISFIT, Feedback, GivenFeedback, feedback_of
from .gain_path import GainPath, samples_in_common
from .linear.arrays import Booleans, Complexes, Floats, Integers, are_diagonal
from .linear.lti import factored_from, is_lti
from .linear.state_space import StateSpace, hold, realize, split_delay
from .linear.transfer_function import Factored, ratio
from .linear.triangular import TriangularForm
from .measured_response import Sensed, measured_signals, measured_state, sampled_scalar, unsampled_scalar
from .mode_functions import mode_functions
from .modes import Corners
from .plant import Plant

EXACT_MODES = 1e-12  # relative: a sum over modes that is off by no more has all digits that polishing and counting need
ABOUT_AXIS = 1e-7  # |Re s| of Im s up to which sums over modes serve
FAR_APART = 1e5
"""Largest ratio of Plant.units between joints that gain matrices couple: up to it limits of random robots were off by 3e-10 at most, beyond
it by up to a fifth."""
ANYWHERE = np.array([0.7, 1.3, 2.1])  # [rad/s]: a loop that acts on any motion is not 0 at all of them
NO_GAIN = 1e-11  # relative to the largest singular value of the gains: less is round-off, and spoils eigenvectors


@dataclass(frozen=True)
class Loop:
    """Return ratio L with the data that analysis needs.

    size          n; 1 for a scalar loop
    sample_time   T_s [s]; None: continuous
    actuated      from torque command to measured position, P C e^{−sT}; n = 1 only
    control       D; n = 1 only
    delays        (n,) [s] of the channels, not contained in open_loop
    given         state space of a loop that was not built from parts, strictly proper where that alone is known of it
    function      callable L(s), for loops given so
    unstable_poles   number of unstable poles of L; poles on the stability boundary are not counted
    parts         components that build_loop joined; None for other loops
    gain          common factor on all controller gains
    unsampled     `actuated` in continuous time, for one joint built from parts
    sensed        of one joint whose gains measure several quantities, in place of `actuated`, `control` and `unsampled`
    resolution    (n,) steps of the encoders [rad]; None where one is not known
    """

    size: int
    sample_time: float | None
    actuated: Factored | None = None
    control: Factored | None = None
    delays: Floats | None = None
    function: Callable[[Complexes], Any] | None = None
    unstable_poles: int = 0
    parts: Parts | None = None
    given: StateSpace | None = None
    gain: float = 1.0
    unsampled: Factored | None = None
    sensed: Sensed | None = None
    resolution: Floats | None = None

    def __repr__(self) -> str:
        time = "continuous" if self.sample_time is None else f"sample_time {self.sample_time:g} s"
        made = "" if self.parts is None else f", {type(self.parts.controller).__name__}, {self.parts.feedback} feedback"
        made += "" if self.kd_path is None else ", kd on a path of its own"
        scale = "" if self.gain == 1 else f", gains times {self.gain:g}"
        return f"Loop({self.size} joint{'s' * (self.size > 1)}, {time}{made}{scale})"

    def __getstate__(self) -> dict[str, Any]:
        """State for pickling, without cached values: the core's objects cannot go to another process."""
        return {name: vars(self)[name] for name in self.__dataclass_fields__}

    @cached_property
    def measurements(self) -> dict[Any, Any]:
        """Cache of what requirements measured on this loop, by requirement, and of what they measured it from."""
        return {}

    @cached_property
    def scalar(self) -> Factored | None:
        """Return ratio L of a scalar loop as zeros, poles, gain and delay; None for several joints and for callables."""
        if self.sensed is not None:
            assert self.parts is not None
            return self.sensed.closed_by(self.parts.controller).scaled(self.gain)
        if self.actuated is None or self.control is None:
            return None
        return (self.actuated * self.control).scaled(self.gain)

    @property
    def is_given(self) -> bool:
        """True if a scalar loop is known by a sampled state space alone, whose zeros many states do not let be found."""
        return self.given is not None and self.actuated is None

    @cached_property
    def _given_form(self) -> TriangularForm:
        assert self.given is not None
        return TriangularForm.of(self.given)

    @property
    def kd_path(self) -> GainPath | None:
        """Separate path of kd; None: all gains close together."""
        return None if self.parts is None else self.parts.kd_path

    def require_one_side(self, what: str) -> None:
        """Raise GainroomError if the gains measure more than one quantity, for which `what` is not known."""
        if self.parts is not None:
            self.parts.feedback.require_one(what)

    def require_one_path(self, what: str) -> None:
        """Raise GainroomError if kd closes on a separate path, for which `what` is not defined."""
        if self.kd_path is not None:
            raise GainroomError(f"kd_path: {what} is not known where kd closes at another rate or delay than the other gains")

    @cached_property
    def open_loop(self) -> StateSpace | None:
        """State space from torque command to controller output, without `delays` (in sampled time they are states); None for callables."""
        if self.parts is None:
            return self.given
        self.require_one_path("one state space")
        return controller_state(self.parts.controller, self.size, self.sample_time) @ self._signals

    @cached_property
    def _signals(self) -> StateSpace:
        assert self.parts is not None
        return measured_signals(self.parts)

    def with_signals(self, signals: StateSpace) -> "Loop":
        """The loop with `signals`, its measured_signals: of other gains on the same plant they are the same."""
        vars(self)["_signals"] = signals
        return self

    @cached_property
    def corner_frequencies(self) -> Corners:
        """Corner frequencies of plant, current loops and filters; the poles of a loop given as state space."""
        if self.parts is None:
            assert self.given is not None
            poles = np.linalg.eigvals(self.given.a).astype(complex)
            if (time := self.sample_time) is not None:
                poles = np.log([z for z in 1 + time * poles if abs(z) > 1e-6]) / time
            return Corners(poles, np.zeros(0, dtype=complex))
        plant, own = self.parts.plant.corners(), self.parts.controller.corners(self.sample_time)
        currents = [-drive.bandwidth + 0j for drive in self.parts.drives if not drive.is_ideal]
        return Corners(np.concatenate([plant.poles, currents, own.poles]), np.concatenate([plant.zeros, own.zeros]))

    def at(self, s: ArrayLike) -> Complexes:
        """Return ratio L at complex s [1/s] (k,), in sampled time at z = e^{s T_s}: shape (k,) for n = 1, else (k, n, n)."""
        self.require_one_path("a frequency response")
        points = np.atleast_1d(np.asarray(s, dtype=complex))
        if self.scalar is not None:
            return self.scalar.at(points)
        if self.is_given:
            return self.gain * self._given_form.at(self.variable(points))[:, 0, 0]
        if self.function is not None:
            return self.gain * np.exp(-points * self._delays[0]) * _called(self.function, points)
        assert self.parts is not None
        v = self.variable(points)
        actuated = self._actuated_at(points, v)
        return self.parts.controller.after(actuated if self.gain == 1 else self.gain * actuated, points, v, self.sample_time)

    def variable(self, s: Complexes) -> Complexes:
        """Variable v at complex s (k,): s itself, or (e^{s T_s} − 1)/T_s in sampled time."""
        return s if self.sample_time is None else np.expm1(s * self.sample_time) / self.sample_time

    def actuated_at(self, s: Complexes) -> Complexes:
        """Response P C e^{−sT} from torque command to measured position (k, n, n) [rad/(N m)] at complex s (k,)."""
        self.require_one_path("a frequency response")
        self.require_one_side("the response to one measured position")
        if self.actuated is not None:
            return self.actuated.at(s).reshape(-1, 1, 1)
        return self._actuated_at(s, self.variable(s))

    def control_at(self, s: Complexes) -> Complexes:
        """Controller D times `gain`, position error → torque command (k, n, n), at complex s (k,), for loops from build_loop.

        Raises GainroomError for other loops, and where kd has a separate path.
        """
        self.require_one_path("a frequency response")
        self.require_one_side("a controller of one measured position")
        if self.control is not None:
            return self.gain * self.control.at(s).reshape(-1, 1, 1)
        if self.parts is None:
            raise GainroomError("loop: the controller of a return ratio that was not built with build_loop is not known")
        return self.gain * self.parts.controller.matrix(s, self.variable(s), self.size, self.sample_time)

    @cached_property
    def _controlled(self) -> tuple[Floats, Floats] | None:
        """Orthonormal U (n, r), V (n, r) with every gain matrix = U M Vᵀ, 1 <= r < n; None where the gains reach all n motions."""
        gains = [] if self.parts is None or self.size == 1 else list(self.parts.controller.matrices(self.size).values())
        if not gains:
            return None
        if are_diagonal(gains):  # of joints in whatever units
            acts = np.any([np.diagonal(gain) != 0 for gain in gains], axis=0)
            acts[0] |= not acts.any()
            own = np.eye(self.size)[:, acts]
            return None if acts.all() else (own, own)
        assert self.parts is not None
        unit = self.parts.plant.units
        spans, rank = [], 1
        for turned in (gains, [gain.T for gain in gains]):
            sizes = np.linalg.svd(np.hstack([gain / (unit[:, None] * unit) for gain in turned]), compute_uv=False)
            rank = max(rank, int(np.count_nonzero(sizes > NO_GAIN * sizes[0])))
            spans.append(np.linalg.svd(np.hstack(turned), full_matrices=False)[0])
        return None if rank == self.size else (spans[0][:, :rank], spans[1][:, :rank])

    @property
    def seen(self) -> Floats:
        """Orthonormal combinations of positions (n, r) that the gains act on."""
        return np.eye(self.size) if self._controlled is None else self._controlled[1]

    def core(self, s: Complexes) -> Complexes:
        """Return ratio (k, r, r) at complex s (k,) on the subspace that the gains reach.

        L without its n − r eigenvalues that are always 0.
        """
        if self._controlled is None:
            return self.at(s).reshape(len(s), self.size, self.size)
        return self._controlled[1].T @ self._partly(s)

    def lifted(self, s: complex, vectors: Complexes) -> Complexes:
        """Measured positions (n, m) that belong to eigenvectors (r, m) of `core`."""
        return vectors if self._controlled is None else self._partly(np.array([s]))[0] @ vectors

    def _partly(self, s: Complexes) -> Complexes:
        """Product P C e^{−sT} D V (k, n, r)."""
        assert self._controlled is not None
        return self.at(s) @ self._controlled[1]

    def _actuated_at(self, s: Complexes, v: Complexes) -> Complexes:
        """Response P C e^{−sT} (k, n, n) of several joints."""
        assert self.parts is not None
        quick = self.exact_modes is not None and np.all(np.abs(s.real) < ABOUT_AXIS * s.imag)
        if self.sample_time is not None:
            if quick:
                return self._mobility(s) * np.exp(-s[:, None, None] * (self.ticks * self.sample_time))
            return self.held.at(v) * np.exp(-s[:, None, None] * (self.ticks * self.sample_time))
        bandwidth = np.array([drive.bandwidth for drive in self.parts.drives])
        damping = np.array([drive.damping_ratio for drive in self.parts.drives])
        lag = s[:, None] / bandwidth  # 0 where the current loop is ideal
        currents = 1 / (lag * lag + 2 * damping * lag + 1)  # eq. (3)
        mobility = self._mobility(s) if quick else self.parts.plant.response(s, self.parts.feedback.position)
        return mobility * (currents * np.exp(-s[:, None] * self._delays))[:, None, :]

    @cached_property
    def exact_modes(self) -> "_core.ModalLoop | None":
        """Plant response as a sum over modes; None if there is none, it is not exact enough, or a pole is on the imaginary axis."""
        assert self.parts is not None
        known = self.parts.plant.modes
        if known is None or known.inexact > EXACT_MODES:
            return None
        poles = np.concatenate([known.poles, known.partners])
        return None if np.any(np.abs(np.real(poles)) <= ABOUT_AXIS * np.abs(poles)) else mode_functions(self.parts)

    def _mobility(self, s: Complexes) -> Complexes:
        """Response torque → position (k, n, n) by modes, at s (k,) near jω; sampled: with hold, current loop and fractional delay."""
        assert self.exact_modes is not None
        return self.exact_modes.mobility(s).reshape(len(s), self.size, self.size)

    @cached_property
    def ticks(self) -> Integers:
        """Whole ticks of delay (n,) in sampled time."""
        assert self.parts is not None
        assert self.sample_time is not None
        return split_delay(self.parts.delays, self.sample_time)[0]

    @cached_property
    def held(self) -> StateSpace:
        """State space from torque command to measured positions, with hold, current loops and the fractional part of the delays."""
        assert self.parts is not None
        assert self.sample_time is not None
        self.require_one_path("one sampled plant")
        _, fraction = split_delay(self.parts.delays, self.sample_time)
        return hold(measured_state(self.parts), fraction * self.sample_time, self.sample_time)

    @cached_property
    def topples(self) -> bool:
        """True if its gains are proved too soft to hold the weight (Parts.topples)."""
        return self.parts is not None and self.parts.topples(self.gain)

    @property
    def stands(self) -> bool:
        """True if its gains are proved stiff enough to hold the weight (Parts.stands)."""
        return self.parts is not None and self.parts.stands(self.gain)

    def response(self, omega: ArrayLike) -> Complexes:
        """Frequency response L(jω), or L(e^{jωT_s}), at omega [rad/s] (k,): shape (k,) for n = 1, else (k, n, n)."""
        return self.at(1j * np.atleast_1d(np.asarray(omega, dtype=float)))

    @property
    def acts(self) -> bool:
        """True if the gains act on some motion."""
        parts, path = self.parts, self.kd_path
        if parts is not None and path is not None:  # which they act on is the same at any rate
            return build_loop(parts.plant, parts.drives, parts.controller, parts.feedback, path.sample_time).acts
        return bool(np.any(self.response(ANYWHERE)))

    def scaled(self, factor: float) -> "Loop":
        """Loop with every controller gain multiplied by `factor`. Raises GainroomError where it is not finite."""
        require_finite("loop", "factor", factor)
        return replace(self, gain=self.gain * factor)

    def regained(self, controller: Any) -> "Loop":
        """Loop of the same plant and drives with other gains; `controller` must keep filters, notches and type."""
        assert self.parts is not None
        if self.size == 1:
            return build_loop(self.parts.plant, self.parts.drives, controller, self.parts.feedback, self.sample_time, self.kd_path)
        found = replace(self, parts=replace(self.parts, controller=controller))
        vars(found)["corner_frequencies"] = self.corner_frequencies  # of plant, drives and filters
        vars(found)["exact_modes"] = self.exact_modes
        if self.sample_time is not None and self.kd_path is None:
            vars(found)["held"] = self.held
        return found

    def regeared(self, stiffness: Floats, damping: Floats) -> "Loop":
        """Loop with other gearbox stiffness [N m/rad] and damping [N m s/rad], (n,) each; needs `parts`."""
        assert self.parts is not None
        parts, plant = self.parts, self.parts.plant.regeared(stiffness, damping)
        return build_loop(plant, parts.drives, parts.controller, parts.feedback, parts.sample_time, parts.kd_path).scaled(self.gain)

    def delayed(self, extra: float) -> "Loop":
        """Loop with `extra` [s] more delay in every drive, and on the path of kd; needs `parts`."""
        assert self.parts is not None
        path = None if self.kd_path is None else replace(self.kd_path, delay=self.kd_path.delay + extra)
        drives = tuple(replace(drive, delay=drive.delay + extra) for drive in self.parts.drives)
        parts = replace(self.parts, drives=drives, kd_path=path)
        if self.size == 1 and path is None and self.sensed is None:  # the controller stays, and a delay moves no pole
            assert self.unsampled is not None
            later = replace(self.unsampled, delay=parts.drives[0].delay)
            return replace(self, actuated=sampled_scalar(later, self.sample_time), unsampled=later, parts=parts)
        found = build_loop(parts.plant, parts.drives, parts.controller, parts.feedback, parts.sample_time, path).scaled(self.gain)
        vars(found)["corner_frequencies"] = self.corner_frequencies  # a delay moves no pole
        return found

    @property
    def _delays(self) -> Floats:
        return np.zeros(self.size) if self.delays is None else self.delays


def require_loop(owner: str, given: Any) -> None:
    """Raise GainroomError, its message beginning with `owner`, if `given` is not a Loop."""
    if not isinstance(given, Loop):
        raise GainroomError(f"{owner}: {one_line(repr(given), 60)} must be a Loop, as build_loop and loop_from make it")


def _called(function: Callable[[Complexes], Any], points: Complexes) -> Complexes:
    value = np.asarray(function(points), dtype=complex)
    if value.shape != points.shape:
        raise GainroomError(f"loop: the callable must return one value per s: shape {points.shape}, not {value.shape}")
    return value


def build_loop(
    joint: ElasticJoint | Plant,
    drive: Drive | Sequence[Drive],
    controller: Any,
    feedback: GivenFeedback = "motor",
    sample_time: float | None = None,
    kd_path: GainPath | None = None,
) -> Loop:
    """Feedback loop of one joint or of n joints.

    joint        ElasticJoint, or a Plant of n joints
    drive        one for all joints, or one per joint
    controller   PD, PID, PPI, Compensator, or any scalar LTI of python-control or scipy.signal
    feedback     "motor" or "link": the side of the gearbox the encoder is on; of one joint also what each gain measures, as
                 {"kp": "link", "kd": "motor"} or {"kp": "motor", "kd": "motor", "ktau": "torque"}
    sample_time  [s]; None: continuous. Sampled: torque held between ticks, any delay, exact
    kd_path      for a sampled PD or PID whose kd closes at a rate and delay of its own; None: with the other gains. Its margins are
                 those of the loop lifted over a common period (multirate.py); it has no frequency response

    Raises GainroomError for input that does not fit together, and for a negative gain on one of several joints. Of one joint it is taken as
    it is, for a verdict on signs that are wrong: kp < 0 is unstable. Files refuse both.
    """
    plant = joint.plant() if isinstance(joint, ElasticJoint) else joint
    if not isinstance(plant, Plant):
        raise GainroomError(f"joint {type(joint).__name__} must be an ElasticJoint or a Plant")
    drives = _drives(drive, plant.size)
    if sample_time is not None:
        require_positive("loop", "sample_time", sample_time, "s")
    if not isinstance(controller, Controller):
        controller = Compensator(system=factored_from(controller))
    sides = _sides(feedback, controller, plant, kd_path)
    if plant.size > 1:
        controller.require_size(plant.size)
        _require_alike(plant, controller)
    parts = Parts(plant, drives, controller, sides, sample_time, kd_path)
    if kd_path is not None:
        return _split_loop(parts)
    delays = parts.delays if sample_time is None else np.zeros(plant.size)
    resolution = parts.resolution
    if plant.size > 1:
        loop = Loop(plant.size, sample_time, delays=delays, parts=parts, resolution=resolution)
        if plant.toppling is not None and controller.shaping(sample_time).unstable_poles == 0:
            return replace(loop, unstable_poles=plant.toppling)  # springs, dampers and masses alone are passive
        assert loop.open_loop is not None
        return replace(loop, unstable_poles=np.count_nonzero(_unstable(np.linalg.eigvals(loop.open_loop.a), sample_time)))
    if sides.mixed:
        loop = Loop(1, sample_time, delays=delays, parts=parts, sensed=Sensed.of(parts), resolution=resolution)
        assert loop.scalar is not None
        if sample_time is None and loop.scalar.relative_degree <= 0:
            raise GainroomError(
                "controller: the rate of the torque would act on itself at once: give velocity_filter, or the drive's bandwidth"
            )
        return replace(loop, unstable_poles=loop.scalar.unstable_poles)
    unsampled, control = unsampled_scalar(parts), controller.transfer(sample_time)
    actuated = sampled_scalar(unsampled, sample_time)
    unstable = (actuated * control).unstable_poles
    return Loop(1, sample_time, actuated, control, delays, unstable_poles=unstable, parts=parts, unsampled=unsampled, resolution=resolution)


def _sides(given: GivenFeedback, controller: Controller, plant: Plant, kd_path: GainPath | None) -> Feedback:
    """Sensors of the gains. Raises GainroomError for one per gain of several joints, with kd on a path of its own, and without a spring."""
    found = feedback_of(given, controller)
    if found.torque and plant.size > 1:
        raise GainroomError(
            f"feedback: the torque of a spring is for single joints, not for {plant.size}: {type(controller).__name__} must be of one"
        )
    if found.both and plant.size > 1:
        raise GainroomError(f"feedback: {found}: must be motor or link: {MISFIT}, not for {plant.size}")
    if found.torque and not np.isfinite(plant.stiffness[0]):
        raise GainroomError("feedback: torque: a rigid gearbox has no spring whose torque could be measured: give its stiffness")
    if found.torque and plant.compliance is not None:
        raise GainroomError("feedback: torque: is not known of a joint whose links rest on springs")
    if kd_path is not None:
        found.require_one("kd_path, kd at a rate of its own,")
    return found


def _require_alike(plant: Plant, controller: Controller) -> None:
    """Raise GainroomError if gain matrices couple joints whose units differ by more than FAR_APART: round-off of one would hide others."""
    least, most = plant.units.min(), plant.units.max()
    if most > FAR_APART * least and any(np.any(gain != np.diag(np.diagonal(gain))) for gain in controller.matrices(plant.size).values()):
        raise GainroomError(
            f"gain matrices: joints with inertias from {least**2:.3g} to {most**2:.3g} kg·m² (or kg) must be at most {FAR_APART**2:.0e} "
            "apart; choose units in which they are alike"
        )


def _split_loop(parts: Parts) -> Loop:
    """Loop whose kd closes on a separate path. Raises GainroomError if the ratio of the rates or a filter does not allow it."""
    assert parts.kd_path is not None
    if parts.sample_time is None:
        raise GainroomError("kd_path: needs sample_time, the other gains' own: where kd closes apart, both are sampled")
    samples_in_common(parts.sample_time, parts.kd_path.sample_time)
    for controller, step in ((parts.controller.without_kd(), parts.sample_time), (parts.controller.kd_alone(), parts.kd_path.sample_time)):
        controller_state(controller, parts.plant.size, step)  # refuses filters that are too fast for their rate
    return Loop(parts.plant.size, parts.sample_time, delays=np.zeros(parts.plant.size), parts=parts)


def _drives(drive: Any, size: int) -> tuple[Drive, ...]:
    """Drives as a tuple, one per joint. Raises GainroomError for other counts and types."""
    if isinstance(drive, Drive):
        return (drive,) * size
    drives = tuple(drive) if isinstance(drive, Iterable) else (drive,)
    strange = [one for one in drives if not isinstance(one, Drive)]
    if strange:
        raise GainroomError(f"drive {one_line(repr(strange[0]), 60)} must be a Drive, or a list with one for each of {size} joints")
    if len(drives) != size:
        raise GainroomError(f"{len(drives)} drives must be one, or one for each of {size} joints")
    return drives


def loop_from(lti: Any, delay: float = 0.0, unstable_poles: int | None = None) -> Loop:
    """Loop around a scalar return ratio.

    lti             a python-control or scipy.signal LTI, continuous or discrete, or a callable L(s), vectorised over complex s
    delay           [s], exact; in sampled time a whole number of sample times
    unstable_poles  of L; counted where None is given with an LTI, taken as 0 for a callable
    """
    require_positive("loop", "delay", delay, "s", zero=True)
    if unstable_poles is not None:
        require_count("loop", "unstable_poles", unstable_poles, 0)
    if not is_lti(lti):
        if not callable(lti):
            raise GainroomError(f"{type(lti).__name__} must be a python-control or scipy.signal LTI system, or a callable L(s)")
        if hasattr(lti, "omega"):  # an interpolated one answers at any frequency, and called a stable loop unstable
            raise GainroomError(
                f"{type(lti).__name__} is known at its own frequencies alone, and roots are counted at all: fit an LTI to it"
            )
        return Loop(1, None, function=lti, delays=np.array([delay]), unstable_poles=unstable_poles or 0)
    system = factored_from(lti)
    step = system.sample_time
    if step is not None:
        ticks = round(delay / step)
        if abs(delay / step - ticks) > 1e-9:
            raise GainroomError(f"loop: delay {delay:g} s must be a whole number of sample times of {step:g} s")
        delay = ticks * step
    if system.relative_degree < 0:
        raise GainroomError("loop: the return ratio has more zeros than poles and cannot be closed")
    if system.relative_degree == 0 and system.delay + delay > 0 and step is None and abs(system.gain) >= 1:
        raise GainroomError(f"loop: with a delay, |L(∞)| = {abs(system.gain):g} must be < 1 (else infinitely many roots are unstable)")
    total = Factored(system.zeros, system.poles, system.gain, system.delay + delay, step)
    open_loop, late = realize(total), np.array([total.delay])
    if step is not None:
        open_loop, late = open_loop @ hold(StateSpace.gain(np.eye(1)), late, step), np.zeros(1)  # a chain of whole ticks before it
    count = total.unstable_poles if unstable_poles is None else unstable_poles
    return Loop(1, step, total, ratio([1.0], [1.0], step), late, unstable_poles=count, given=open_loop)


def _unstable(poles: Complexes, sample_time: float | None) -> Booleans:
    """True where a pole in v grows by more than the round-off of an eigenvalue solver on repeated roots."""
    rate = poles.real if sample_time is None else poles.real + np.abs(poles) ** 2 * sample_time / 2
    return rate > 1e-7 * np.abs(poles).max(initial=0.0)
