"""State-space models of a loop's components: current loops with plant, and controller.

Roots, margins and simulation all start from these matrices, so that they describe one system.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np

from ..errors import GainroomError
from .controller import PD, Controller
from .drive import Drive
from .feedback import Feedback
from .gain_path import GainPath
from .linear.arrays import Floats
from .linear.state_space import StateSpace, realize
from .linear.transfer_function import Factored, ratio
from .plant import Plant

SYMMETRIC = 1e-12  # relative to the largest gain: asymmetry that is round-off


@dataclass(frozen=True)
class Parts:
    """Components of a loop: plant, drives, controller, encoders, sample time [s]; `kd_path` None: kd closes with all other gains."""

    plant: Plant
    drives: tuple[Drive, ...]
    controller: Controller
    feedback: Feedback
    sample_time: float | None
    kd_path: GainPath | None = None

    @property
    def delays(self) -> Floats:
        """Drive delays (n,) [s]."""
        return np.array([drive.delay for drive in self.drives])

    @property
    def resolution(self) -> Floats | None:
        """Steps of the encoders (n,) [rad]; None where one is not known."""
        found = np.array([drive.resolution for drive in self.drives])
        return found if np.all(found > 0) else None

    def topples(self, factor: float) -> bool:
        """True if PD gains times `factor` are proved too soft to hold the weight; False proves nothing."""
        count = self._toppled(factor) or 0
        return count > 0 if self.sample_time is None else count % 2 == 1  # an odd number cannot leave the real axis in pairs

    def stands(self, factor: float) -> bool:
        """True if PD gains times `factor` are proved stiff enough to hold the weight, or the plant has no gravity stiffness."""
        return self.plant.gravity_stiffness is None or self._toppled(factor) == 0

    def _toppled(self, factor: float) -> int | None:
        """Number of motions in which PD gains times `factor` do not hold the weight; None where static stiffness alone cannot decide."""
        plant, size = self.plant, self.plant.size
        if plant.gravity_stiffness is None or self.kd_path is not None or type(self.controller) is not PD or not self.feedback.motor:
            return None
        gains = self.controller.matrices(size)
        if any(np.abs(gain - gain.T).max() > SYMMETRIC * np.abs(gain).max() for gain in gains.values()):
            return None
        return plant.toppled(factor * gains.get((0, 0), np.zeros((size, size))))


def actuated_state(plant: Plant, drives: tuple[Drive, ...], twists: bool = False) -> StateSpace:
    """Current loops and plant as one state space, without delays.

    Inputs (3n): torque into the current loops, then torques that act on the motors and on the links from outside [N m].
    Outputs (5n): motor positions, link positions, their velocities in the same order, torques behind the current loops.
    The plant's coordinates η and then their rates (plant.mechanism, which has `twists`, too) are the last states. Behind an ideal current
    loop the torque is its input, the one output that does not come through states.
    """
    size, form = plant.size, plant.mechanism(twists)
    states, inverse = len(form.mass), np.linalg.inv(form.mass)
    a = np.block([[np.zeros((states, states)), np.eye(states)], [-inverse @ form.stiffness, -inverse @ form.damping]])
    forces = np.hstack([form.force, form.force, form.link_position.T])  # by the current loops, on the motors, on the links
    b = np.vstack([np.zeros((states, 3 * size)), inverse @ forces])
    positions = np.vstack([form.motor_position, form.link_position])
    nothing = np.zeros_like(positions)
    c = np.vstack([np.block([[positions, nothing], [nothing, positions]]), np.zeros((size, 2 * states))])
    d = np.zeros((5 * size, 3 * size))
    d[4 * size :, :size] = np.eye(size)
    currents = StateSpace.gain(np.zeros((0, 0)))
    for drive in drives:
        currents = currents.beside(StateSpace.gain(np.eye(1)) if drive.is_ideal else realize(current_loop(drive)))
    return StateSpace(a, b, c, d) @ currents.beside(StateSpace.gain(np.eye(2 * size)))


def current_loop(drive: Drive) -> Factored:
    """Current loop C of eq. (3) as a transfer function; 1 for an ideal drive."""
    if drive.is_ideal:
        return ratio([1.0], [1.0])
    w = drive.bandwidth
    return ratio([w * w], [1.0, 2 * drive.damping_ratio * w, w * w])


def controller_state(controller: Controller, size: int, step: float | None) -> StateSpace:
    """D of n = `size` channels, for any filters and gain matrices, sampled every `step` [s] or continuous: two signals (2n) → output (n).

    The first (n) are what position gains act on, the second (n) what velocity is made from: sampled controllers difference positions,
    continuous ones get the velocities themselves. Feeding the negated measurement into both closes the loop; a reference need not
    enter both (eq. (4) has D act on x_d − x, the P/PI cascade of Fig. 13 only position gains on x_d). Where the controller of one joint
    measures the spring's torque, that is a third signal, and in continuous time its rate a fourth.
    """
    if controller.laws and (feedback := Feedback.of_law(controller.laws)).mixed:
        return _state_of_laws(controller, feedback, step)
    terms = controller.matrices(size)
    nothing = np.zeros((size, size))
    velocity = StateSpace.gain(np.eye(1))
    if step is not None:
        velocity = realize(ratio(*controller.velocity(step), step))
    elif controller.velocity_filter is not None:
        velocity = realize(ratio(*controller.velocity_filter.polynomials(None)))
    position = StateSpace.gain(np.hstack([np.eye(size), nothing]))
    motion = StateSpace.gain(np.hstack([nothing, np.eye(size)]))
    signals = _stacked(position, velocity.repeated(size) @ motion)
    direct = np.hstack([terms.get((0, 0), nothing), terms.get((1, 0), nothing)])
    integral = np.hstack([terms.get((0, 1), nothing), terms.get((1, 1), nothing)])
    sum_of_terms = StateSpace.gain(direct)
    if np.any(integral):
        start = 0.0 if step is None else step  # backward Euler passes the newest value through
        memory = StateSpace(np.zeros((size, size)), np.eye(size), np.eye(size), start * np.eye(size))
        sum_of_terms = sum_of_terms + memory @ StateSpace.gain(integral)
    if controller.torque_name:
        sum_of_terms, signals = (
            _beside(sum_of_terms, _torque_state(controller, step)),
            signals.beside(StateSpace.gain(np.eye(1 if step else 2))),
        )
    shaping = controller.shaping(step)
    if shaping.relative_degree >= 0:
        return realize(shaping).repeated(size) @ sum_of_terms @ signals
    return _improper(shaping, sum_of_terms, size)


def _state_of_laws(controller: Controller, feedback: Feedback, step: float | None) -> StateSpace:
    """D of a law that names several sensors of one joint, sampled: the sum of the transfer functions from each."""
    signals, found = feedback.seen, []
    for k, sensor in enumerate(feedback.sensors):
        if (law := controller.law(sensor, feedback, step)).gain:
            picked = np.zeros((1, len(signals)))
            picked[0, int(np.argmax(signals[:, k]))] = 1.0
            found.append(realize(law) @ StateSpace.gain(picked))
    return reduce(lambda one, other: one + other, found, StateSpace.gain(np.zeros((1, len(signals)))))


def _torque_state(controller: Controller, step: float | None) -> StateSpace:
    """State space from the spring's torque, in continuous time with its rate as a second signal, to the torque command without its sign."""
    law = controller.torque_law(step)
    if step is not None:
        return realize(law)
    if law.relative_degree >= 0:
        return realize(law) @ StateSpace.gain(np.array([[1.0, 0.0]]))
    return StateSpace.gain(np.array([[-law.gain * law.zeros[0].real, law.gain]]))  # gain (s − zero)


def _beside(first: StateSpace, second: StateSpace) -> StateSpace:
    """Sum of the outputs of two systems with inputs of their own, those of the first first."""
    both = first.beside(second)
    return StateSpace.gain(np.hstack([np.eye(len(first.d)), np.eye(len(second.d))])) @ both


def _stacked(first: StateSpace, second: StateSpace) -> StateSpace:
    """Two systems driven by the same input, their outputs stacked."""
    split = StateSpace.gain(np.vstack([np.eye(first.b.shape[1]), np.eye(first.b.shape[1])]))
    return first.beside(second) @ split


def _improper(shaping: Factored, sum_of_terms: StateSpace, size: int) -> StateSpace:
    """State space of a continuous controller with one more zero than poles: a multiple of the velocity plus a proper remainder."""
    if shaping.relative_degree < -1 or shaping.sample_time is not None or len(sum_of_terms.a):
        raise GainroomError(
            f"controller: {len(shaping.zeros)} zeros and {len(shaping.poles)} poles; at most one zero more than poles is allowed in "
            "continuous time, and none more in sampled time"
        )
    # D = gain·Π(s − z)/Π(s − p) = gain·s + rest; `rest` has its numerator one degree lower
    numerator, denominator = np.real(np.poly(shaping.zeros)), np.real(np.poly(shaping.poles))
    rest = shaping.gain * np.polysub(numerator, np.polymul([1.0, 0.0], denominator))
    proper = realize(ratio(rest, denominator)).repeated(size)
    direct = sum_of_terms.d[:, :size]
    nothing = np.zeros((size, size))
    by_position = StateSpace.gain(direct) @ proper @ StateSpace.gain(np.hstack([np.eye(size), nothing]))
    return by_position + StateSpace.gain(np.hstack([nothing, shaping.gain * direct]))
