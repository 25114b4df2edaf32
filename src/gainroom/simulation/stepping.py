"""Exact stepping of the sampled linear loop, tick by tick: the motion between two ticks is a matrix exponential.

Plant, current loops and delays are sampled exactly (state_space.hold), whatever the delay; with the controller they make one matrix A, and
a run is x_{k+1} = A x_k + f_k. The reference enters by the controller's equation:

    u = D (x_d − x)                          eq. (4) of Jung et al. 2017, PD and PID: velocity gains act on the velocity error
    u = (Kv + Ki/s)(Kp (x_d − x) − ẋ)        Fig. 13, P/PI

with velocities formed from positions by the controller's own difference and filter, the reference's likewise.
"""

import numpy as np

from ..native import _core
from ..system.assembly import actuated_state, controller_state
from ..system.feedback import SIDES, Feedback
from ..system.linear.arrays import Floats
from ..system.linear.state_space import StateSpace, hold, split_delay
from ..system.loop import Loop
from ..system.measured_response import spring_signals
from .run_record import OVERFLOWING, Run
from .scenario import Inputs, ScenarioInputs, noise_by_side


class LinearStepper:
    """Simulation state of a sampled loop of n joints. Raises GainroomError if it cannot start in the scenario's state."""

    def __init__(self, loop: Loop, signals: ScenarioInputs) -> None:
        parts, step = loop.parts, loop.sample_time
        assert parts is not None
        assert step is not None
        loop.require_one_path("a simulation of several joints")
        self.loop, self.size = loop, loop.size
        size, delays = self.size, parts.delays
        body = hold(actuated_state(parts.plant, parts.drives), np.concatenate([delays, np.zeros(2 * size)]), step)
        control = controller_state(parts.controller, size, step)
        control = StateSpace(control.a, control.b, loop.gain * control.c, loop.gain * control.d)
        self._sides = _sides(parts.feedback, size)
        spring = spring_signals(parts.plant, body, step).c if parts.feedback.torque else np.zeros((0, len(body.a)))
        self._system = _closed(body, control, *self._sides, spring, size)
        self._transition = np.eye(len(self._system.a)) + step * self._system.a
        self._entry = step * self._system.b
        self.ideal = np.array([drive.is_ideal for drive in parts.drives])
        whole, fraction = split_delay(delays, step)
        self.late = whole + (fraction > 0)  # a torque that comes between two ticks is there at the second
        self._sent = np.zeros((max(self.late), size))
        self._state = np.zeros(len(self._system.a))
        start = signals.start()
        self._state[len(body.a) - len(start) : len(body.a)] = start  # the plant's states are the body's last
        self._offset: Floats | None = None

    def advance(self, inputs: Inputs, first: int) -> Run:
        """Run over the next ticks, numbered from `first`; rows after the first value that is not finite are left out."""
        assert self.loop.parts is not None
        assert self.loop.sample_time is not None
        if self._offset is None:  # the difference's first past is the first reading
            self._offset = (self._system.c @ self._state)[self._sides[1]] + inputs.noise[0, -self.size :]
        entering = np.hstack(
            [
                inputs.reference - inputs.noise[:, : self.size],
                inputs.motion - inputs.noise[:, -self.size :] + self._offset,
                inputs.feedforward,
                inputs.motor_torque,
                inputs.link_torque,
                *([-inputs.torque_noise[:, None]] if self.loop.parts.feedback.torque else []),
            ]
        )
        states = np.empty((len(entering) + 1, len(self._state)))
        states[0] = self._state
        count = _core.recur(self._transition.T, entering @ self._entry.T, states, OVERFLOWING)
        self._state = states[count]
        return self._rows(states[: min(count + 1, len(entering))], entering, inputs, first)

    def _rows(self, states: Floats, entering: Floats, inputs: Inputs, first: int) -> Run:
        """Run record from states (k, m)."""
        parts, step, size, count = self.loop.parts, self.loop.sample_time, self.size, len(states)
        assert parts is not None
        assert step is not None
        output = states @ self._system.c.T + entering[:count] @ self._system.d.T
        motor, link, actual, target = (output[:, k * size : (k + 1) * size] for k in (0, 1, 4, 5))
        demand = self._delayed(target)
        noises = noise_by_side(inputs.noise[:count], parts.feedback)
        motors, links = (position + noises.get(side, 0.0) for side, position in zip(SIDES, (motor, link), strict=True))
        return Run(
            time=step * (first + np.arange(count)),
            reference=inputs.reference[:count],
            measured=motors if parts.feedback.position == "motor" else links,
            motor_position=motor,
            link_position=link,
            motor_reading=motors,
            link_reading=links,
            target_torque=target,
            demand_torque=demand,
            actual_torque=np.where(self.ideal, demand, actual),
            sample_time=step,
            feedback=parts.feedback.position,
            joint_names=parts.plant.joint_names,
            channels=parts.plant.joint_names,
        )

    def _delayed(self, target: Floats) -> Floats:
        """Commands (k, n) that arrive at each tick, from `target` (k, n) and commands in transit."""
        longest = len(self._sent)
        history = np.vstack([self._sent, target])
        self._sent = history[len(history) - longest :]
        return np.column_stack([history[longest - late : len(history) - late, joint] for joint, late in enumerate(self.late)])


def _sides(feedback: Feedback, size: int) -> tuple[slice, slice]:
    """Rows among the outputs of actuated_state of what position gains measure, and of what velocity is made from."""
    first, second = (size * SIDES.index(side) for side in (feedback.position, feedback.velocity))
    return slice(first, first + size), slice(second, second + size)


def _closed(body: StateSpace, control: StateSpace, position: slice, velocity: slice, spring: Floats, size: int) -> StateSpace:
    """State space of the closed loop, which measures these rows of the body's outputs, and `spring` of its states, the torque of a spring.

    Inputs (5n): values that position gains act on and that velocity is made from, both without the measurement; torque added to the target;
    torques on motors and links; where a spring's torque is measured, a value like the first two for it. Outputs (6n): those of
    actuated_state, then the target torque. The body's states come first.
    """
    measured = np.vstack([body.c[position], body.c[velocity], spring])
    nothing, own = np.zeros((size, size)), 2 * size
    # target = C x_c + D (signals − measured) + feedforward
    target_state = np.hstack([-control.d @ measured, control.c])
    target_input = np.hstack([control.d[:, :own], np.eye(size), nothing, nothing, control.d[:, own:]])
    torques = np.zeros((2 * size, 5 * size + len(spring)))
    torques[:, 3 * size : 5 * size] = np.eye(2 * size)
    to_body_input = np.vstack([target_input, torques])
    body_a = np.hstack([body.a, np.zeros((len(body.a), len(control.a)))]) + body.b[:, :size] @ target_state
    control_a = np.hstack([-control.b @ measured, control.a])
    signals = np.zeros((len(measured), 5 * size + len(spring)))
    signals[:own, :own], signals[own:, 5 * size :] = np.eye(own), np.eye(len(spring))
    # Behind an ideal current loop the actual torque is the demanded one, which the delay makes; it has no row here.
    c = np.vstack([np.hstack([body.c, np.zeros((len(body.c), len(control.a)))]), target_state])
    d = np.vstack([np.zeros((len(body.c), target_input.shape[1])), target_input])
    return StateSpace(np.vstack([body_a, control_a]), np.vstack([body.b @ to_body_input, control.b @ signals]), c, d)
