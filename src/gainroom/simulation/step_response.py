"""Step responses of motor and link in the closed loop: one joint, or one joint or task direction of a coupled loop, all others closed.

The position reference steps and the velocity reference stays 0, as where a host sends positions to u = kp (x_d − x) − kd ẋ, and as
in Fig. 13 of Jung et al. 2017: D = D_p + D_v of the controller answers with D_p alone. A step w added at the torque command moves either
side by x_w, with all loops closed, and a step of the reference by D_p x_w, as the order of linear parts is free.
Of a part l c rᵀ of n joints' controller (system/loop_part.py) w is l, and rᵀ reads the positions. The load is l on the links.

Sampled: the exact discrete state space, stepped. Continuous without delay: exact (matrix exponential; the input is constant). Continuous
with delay: method of steps. The least delay is a whole number of steps, others may be any; each step integrates the plant exactly with
the delayed commands taken as straight between two points. The error falls with the square of the step, which is halved until the result
converges.
"""

import math
from dataclasses import dataclass

import numpy as np
from typing_extensions import Self

from ..analysis.stability import rightmost_roots
from ..errors import GainroomError
from ..native import _core
from ..system.assembly import actuated_state, controller_state
from ..system.feedback import SIDES
from ..system.linear.arrays import Complexes, Floats
from ..system.linear.state_space import StateSpace, hold
from ..system.loop import Loop
from ..system.loop_part import LoopPart
from ..system.measured_response import spring_signals
from .tracking import Swing, swing

SETTLE = 8.0  # time constants of the slowest root: what swings 60 times as far as 2 % of its rest has then come to it
GROW = 7.0  # growth times of the fastest root of an unstable loop: a factor of 1000, as a link may vibrate little beside its motor
TURNS = 100.0  # most turns of an unstable loop that grows slowly
MOST_STEPS = 40_000  # steps
UNDELAYED_POINTS = 2400  # without delay and sampling
LARGEST_TURN = 0.25  # [rad] largest turn of the fastest shown root within the first, coarsest step
CONVERGED = 3e-4  # relative change by halving the step that ends the halving
MOST_STEPS_PER_DELAY = 200  # steps per delay after which it ends anyway
STILL = 1e-6  # of the slowest root's decay: the frequency that stands for rest
DRIFTS = 1e3  # times the largest position: a rest farther away is a drift, as with kp 0, which is 1e5 times as far at that frequency
RETURNED = 1e-6  # of the motor's largest deflection: a motor that integral action turns back to the reference


@dataclass(frozen=True)
class Sides:
    """Position (k,) of motor and link over time, and where each comes to rest; NaN where it does not, or of a part, is not known."""

    motor: Floats
    link: Floats
    motor_rest: float
    link_rest: float

    @classmethod
    def of(cls, moved: Floats, rest: Complexes) -> Self:
        """Positions `moved` (k, 2) of motor and link with their `rest` (2,), from _rest."""
        drifts = not np.abs(rest).max() <= DRIFTS * np.abs(moved).max()
        return cls(moved[:, 0], moved[:, 1], *(math.nan if drifts else float(side.real) for side in rest))


@dataclass(frozen=True)
class StepResponse:
    """Responses to unit steps at t = 0.

    time         (k,) [s]
    reference    positions for a unit step of the reference
    load         positions for a load of 1 N m on the link [rad]
    change       largest change of the measured `reference` by the last halving of the step, relative to its largest value; 0 where
                 stepping is exact
    growth, frequency   real and imaginary part of the rightmost root [1/s], [rad/s]; of a part as it is given, and NaN
    """

    time: Floats
    reference: Sides
    load: Sides
    change: float
    growth: float
    frequency: float

    @property
    def link_step(self) -> Swing:
        """Swing of the link after a step of the reference."""
        return swing(self.time, self.reference.link, self.reference.link_rest)

    @property
    def link_load(self) -> Swing:
        """Swing of the link under a load; without overshoot where integral action turns the motor back, so that little or nothing rests."""
        returns = abs(self.load.motor_rest) < RETURNED * np.abs(self.load.motor).max()
        return swing(self.time, self.load.link, self.load.link_rest, returns)


def step_response(loop: Loop, end: float | None = None, part: LoopPart | None = None, growth: float = math.nan) -> StepResponse:
    """Step responses to reference and load up to `end` [s] (None, of one joint: until settled, or the vibration has grown a thousandfold).

    part     of a loop of several joints, with an `end`; its load is 1 of its output on the links (a joint's: 1 N m), in its own
             combination of positions
    growth   real part of its loop's rightmost root [1/s]; NaN: not known, and so no rest of a part

    Raises GainroomError for loops not built with build_loop, for kd with a path of its own, and for several joints without a part.
    """
    if loop.parts is None or (part is None and loop.size > 1):
        raise GainroomError("step_response needs a loop of one joint built with build_loop, or a part of one of several")
    loop.require_one_path("a step response")
    system = _responding(loop, part or LoopPart.of_joint(loop, 0))
    left = np.ones(1) if part is None else part.left
    command, load = np.append(left, 0.0), np.append(np.zeros(loop.size), 1.0)
    roots = rightmost_roots(loop, count=8).roots if part is None else np.full(4, complex(growth, math.nan))
    end = _horizon(roots) if end is None else end
    growth, frequency = float(roots[0].real), float(abs(roots[0].imag))
    fastest = float(np.abs(roots[:4]).max()) if part is None else 0.0
    delays = np.append(loop.parts.delays, 0.0)
    if loop.sample_time is not None or not delays.any():
        step = end / UNDELAYED_POINTS if loop.sample_time is None else loop.sample_time
        count = UNDELAYED_POINTS if loop.sample_time is None else min(math.ceil(end / step), MOST_STEPS)
        moved, pushed = (_undelayed(system, entry, step, count, loop.sample_time) for entry in (command, load))
        time, change = step * np.arange(count + 1), 0.0
    else:
        delay, side = float(delays[delays > 0].min()), SIDES.index(loop.parts.feedback.position)
        late = max(8, math.ceil(delay * fastest / LARGEST_TURN))
        steps = min(math.ceil(end / delay), MOST_STEPS // late + 1) * late
        moved, change = _delayed(system, command, delays, delay / late, steps), math.inf
        while change >= CONVERGED and late <= MOST_STEPS_PER_DELAY:
            coarse, late, steps = moved[:, side], 2 * late, 2 * steps
            moved = _delayed(system, command, delays, delay / late, steps)
            change = float(np.abs(moved[::2, side] - coarse).max() / np.abs(moved[:, side]).max())
        pushed = _delayed(system, load, delays, delay / late, steps)
        time = delay / late * np.arange(steps + 1)
    rests = [_rest(system, entry, -growth) if growth < 0 else np.full(4, math.nan) for entry in (command, load)]
    return StepResponse(time, Sides.of(moved[:, :2], rests[0][:2]), Sides.of(pushed[:, 2:], rests[1][2:]), change, growth, frequency)


def _responding(loop: Loop, part: LoopPart) -> StateSpace:
    """State space from torque commands (n) and the part's load (1) to what is subtracted from them (n + 1), then four outputs.

    Controller outputs are subtracted from commands, nothing from the load. The four: the part's answer to the positions of motor and link
    as to a reference, then those positions themselves. Continuous ones are without delay.
    """
    assert loop.parts is not None
    parts, size, step = loop.parts, loop.size, loop.sample_time
    every, own = controller_state(parts.controller, size, step), controller_state(part.own, 1, step)
    torques = np.zeros((3 * size, size + 1))  # on current loops, motors and links, see actuated_state
    torques[:size, :size] = np.eye(size)
    torques[2 * size :, size] = part.left
    motors, links, rate = np.eye(size, 5 * size), np.eye(size, 5 * size, size), 2 * size
    # What velocity is made from: itself in continuous time, in sampled time the position, which the controller differences.
    read, moved = (motors if side == "motor" else links for side in (parts.feedback.position, parts.feedback.velocity))
    own_sides = [part.right @ motors, part.right @ links]
    state = actuated_state(parts.plant, parts.drives, twists=True)
    body = StateSpace.gain(np.vstack([read, np.roll(moved, 0 if step is not None else rate, axis=1)])) @ state
    if parts.feedback.torque:
        body = body.stacked(spring_signals(parts.plant, state, step))
    body = body.stacked(StateSpace.gain(np.vstack(own_sides)) @ state) @ StateSpace.gain(torques)
    if step is not None:
        body = hold(body, np.append(parts.delays, 0.0), step)
    count = every.d.shape[1]
    by_position = own @ StateSpace.gain(np.eye(count if size == 1 else 2, 1))
    split = StateSpace.gain(np.vstack([np.eye(count + 2), np.eye(2, count + 2, count)]))
    control = every.beside(StateSpace.gain(np.zeros((1, 0)))).beside(by_position.repeated(2)).beside(StateSpace.gain(np.eye(2))) @ split
    scale = StateSpace.gain(np.diag([*np.full(size + 3, loop.gain), 1.0, 1.0]))
    return scale @ control @ body


def _horizon(roots: Complexes) -> float:
    """Simulated time [s], from the rightmost roots."""
    growth = float(roots[0].real)
    fastest = float(np.abs(roots).max()) or 1.0
    if growth > 0:
        turn = 2 * math.pi / abs(roots[0]) if roots[0] != 0 else 0.0
        return min(max(GROW / growth, 4 * turn), max(TURNS * turn, 0.5 / growth))
    return min(SETTLE / max(-growth, 1e-9 * fastest), 2000 * 2 * math.pi / fastest)


def _delayed(system: StateSpace, entry: Floats, delays: Floats, step: float, count: int) -> Floats:
    """Outputs (count + 1, 4) of a continuous loop with `delays` (n + 1,) in `count` steps; each delay is 0 or at least one step.

    A delayed command is its entry's step, integrated from its arrival, minus the delayed outputs, which are continuous and straight between
    two points. Commands without delay close their loops inside the plant.
    """
    inputs = len(entry)
    late = np.flatnonzero(delays > 0)
    outputs, at_once = system.c[:inputs], np.flatnonzero(delays == 0)
    assert not system.d[:, :-1].any(), "torque moves neither position nor velocity at once"
    entry = entry - system.d[:inputs, -1] * entry[-1]  # a load changes the torque of a damped spring at once, and what its gains command
    closed = system.a - system.b[:, at_once] @ outputs[at_once]
    b = np.column_stack([system.b[:, late], system.b[:, at_once] @ entry[at_once]])  # the last input is 1 from the start
    transition, before, after = _held(closed, b, step)
    whole = np.floor(delays[late] / step + 1e-9).astype(np.int64)
    part = np.clip(delays[late] / step - whole, 0.0, 1.0)
    forcing = np.tile((before + after)[:, -1], (count, 1))
    for k, joint in enumerate(late.tolist()):
        _, start, end = _held(closed, b[:, [k]], (1 - part[k]) * step)
        forcing[whole[k] : whole[k] + 1] += (start + end)[:, 0] * entry[joint]
        forcing[whole[k] + 1 :] += (before + after)[:, k] * entry[joint]
    states = np.zeros((count + 1, len(closed)))
    made = _core.recur_late(
        transition.T.copy(), forcing, outputs[late], before[:, :-1].T.copy(), after[:, :-1].T.copy(), whole, part, states
    )
    states[made + 1 :] = np.nan
    return states @ system.c[inputs:].T


def _recur(transposed: Floats, forcing: Floats, states: Floats) -> None:
    """Fill states (k + 1, m) from the first row by recursion; NaN where they overflow."""
    states[_core.recur(transposed, forcing, states, math.inf) + 1 :] = np.nan


def _undelayed(system: StateSpace, entry: Floats, step: float, count: int, sample_time: float | None) -> Floats:
    """Outputs (count + 1, 4) of a sampled loop, or of a continuous one without delay; exact, since the input is constant."""
    inputs, row = len(entry), _closing(system, entry)
    total = np.vstack([np.column_stack([system.a, np.zeros(len(system.a))]) + system.b @ row, np.zeros(len(system.a) + 1)])
    transition = _core.exponential(total * step) if sample_time is None else np.eye(len(total)) + step * total
    table = np.zeros((count + 1, len(total)))
    table[0, -1] = 1.0
    _recur(transition.T.copy(), np.zeros((count, len(total))), table)
    return table[:, :-1] @ system.c[inputs:].T + table @ row.T @ system.d[inputs:].T


def _closing(system: StateSpace, entry: Floats) -> Floats:
    """Inputs by states and by the constant 1, (n + 1, states + 1): u = (I + D)⁻¹ (w − C x)."""
    inputs = len(entry)
    return np.linalg.solve(np.eye(inputs) + system.d[:inputs], np.column_stack([-system.c[:inputs], entry]))


def _rest(system: StateSpace, entry: Floats, decay: float) -> Complexes:
    """Outputs (4,) at rest of a loop whose slowest root decays at `decay` [1/s]; large where they drift. Delays do not change them.

    It is their response far below that root, whose real part is off by its square: at 0 itself an integrator has no rest of its own.
    """
    inputs, row = len(entry), _closing(system, entry)
    closed = system.a + system.b @ row[:, :-1]
    moved = np.append(np.linalg.solve(1j * STILL * decay * np.eye(len(closed)) - closed, system.b @ row[:, -1]), 1.0)
    return system.c[inputs:] @ moved[:-1] + system.d[inputs:] @ (row @ moved)


def _held(a: Floats, b: Floats, step: float) -> tuple[Floats, Floats, Floats]:
    """Matrices p, q, r of x⁺ = p x + q u + r u⁺: one step of ẋ = a x + b u with inputs straight in between.

    First-order hold; Franklin, Powell and Workman, sec. 6.3.
    """
    states, inputs = b.shape
    total = np.zeros((states + 2 * inputs,) * 2)
    total[:states, :states] = step * a
    total[:states, states : states + inputs] = step * b
    total[states : states + inputs, states + inputs :] = np.eye(inputs)
    over = _core.exponential(total)
    after = over[:states, states + inputs :]
    return over[:states, :states], over[:states, states : states + inputs] - after, after
