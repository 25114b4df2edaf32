"""Step responses of the closed loop: one joint, or one joint or task direction of a coupled loop with all others closed.

With a unit step w added at the torque command, the loop L obeys  z = L (w − z): z is the measured position after a unit step of
the reference (L/(1+L), eq. (4) of Jung et al. 2017), and the position under that step of torque is P C e^{−sT} (w − z).
Of a part l c rᵀ of n joints' controller (system/loop_part.py) w is l, and c rᵀ (position) is ℓ/(1 + ℓ) after a step, with ℓ the part's
return ratio, all others closed: (I + G D)⁻¹ with D = D_0 + l c rᵀ, by the matrix determinant lemma.

Sampled: the exact discrete state space, stepped. Continuous without delay: exact (matrix exponential; the input is constant). Continuous
with delay: method of steps. The least delay is a whole number of steps, others may be any; each step integrates the plant exactly with
the delayed commands taken as straight between two points. The error falls with the square of the step, which is halved until the result
converges.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..analysis.stability import rightmost_roots
from ..errors import GainroomError
from ..native import _core
from ..system.assembly import controller_state
from ..system.linear.arrays import Complexes, Floats
from ..system.linear.state_space import StateSpace
from ..system.loop import Loop
from ..system.loop_part import LoopPart
from ..system.measured_response import measured_signals

SETTLE = 4.0  # time constants of the slowest root that are shown
GROW = 3.4  # growth times of the fastest root of an unstable loop: a factor of 30
MOST_STEPS = 20_000  # steps
UNDELAYED_POINTS = 1200  # without delay and sampling
LARGEST_TURN = 0.25  # [rad] largest turn of the fastest shown root within the first, coarsest step
CONVERGED = 3e-4  # relative change by halving the step that ends the halving
MOST_STEPS_PER_DELAY = 200  # steps per delay after which it ends anyway


@dataclass(frozen=True)
class StepResponse:
    """Responses to unit steps at t = 0.

    time         (k,) [s]
    reference    (k,) measured position for a unit step of its reference
    disturbance  (k,) measured position for 1 N m added to the torque command [rad]
    change       largest change of `reference` by the last halving of the step, relative to its largest value; 0 where stepping is exact
    growth, frequency   real and imaginary part of the rightmost root [1/s], [rad/s]; NaN of a part, whose loop has many
    """

    time: Floats
    reference: Floats
    disturbance: Floats
    change: float
    growth: float
    frequency: float


def step_response(loop: Loop, end: float | None = None, part: LoopPart | None = None) -> StepResponse:
    """Step responses to reference and torque up to `end` [s] (None, of one joint: until settled, or the vibration has grown thirtyfold).

    part   of a loop of several joints, with an `end`; its disturbance is 1 of its output (a joint's: 1 N m), in its own combination
           of positions

    Raises GainroomError for loops that were not built with build_loop, and for several joints without a part.
    """
    if loop.parts is None or (part is None and loop.size > 1):
        raise GainroomError("step_response needs a loop of one joint built with build_loop, or a part of one of several")
    system = _responding(loop, part or LoopPart.of_joint(loop, 0))
    entry = np.ones(1) if part is None else part.left
    roots = rightmost_roots(loop, count=8).roots if part is None else np.full(4, complex(math.nan, math.nan))
    end = _horizon(roots) if end is None else end
    growth, frequency = float(roots[0].real), float(abs(roots[0].imag))
    fastest = float(np.abs(roots[:4]).max()) if part is None else 0.0
    delays = loop.parts.delays
    if loop.sample_time is not None or not delays.any():
        step = end / UNDELAYED_POINTS if loop.sample_time is None else loop.sample_time
        count = UNDELAYED_POINTS if loop.sample_time is None else min(math.ceil(end / step), MOST_STEPS)
        return StepResponse(step * np.arange(count + 1), *_undelayed(system, entry, step, count, loop.sample_time), 0.0, growth, frequency)
    delay = float(delays[delays > 0].min())
    late = max(8, math.ceil(delay * fastest / LARGEST_TURN))
    steps = min(math.ceil(end / delay), MOST_STEPS // late + 1) * late
    reference, disturbance = _delayed(system, entry, delays, delay / late, steps)
    while True:
        coarse, late, steps = reference, 2 * late, 2 * steps
        reference, disturbance = _delayed(system, entry, delays, delay / late, steps)
        change = float(np.abs(reference[::2] - coarse).max() / np.abs(reference).max())
        if change < CONVERGED or late > MOST_STEPS_PER_DELAY:
            return StepResponse(delay / late * np.arange(steps + 1), reference, disturbance, change, growth, frequency)


def _responding(loop: Loop, part: LoopPart) -> StateSpace:
    """State space from torque commands (n) to all controller outputs (n), that of the part (1), and its measured position (1).

    Continuous ones are without delay.
    """
    assert loop.parts is not None
    step, nothing = loop.sample_time, np.zeros_like(part.right)
    both = StateSpace.gain(np.array([[*part.right, *nothing], [*nothing, *part.right]]))
    read = StateSpace.gain(np.array([[*part.right, *nothing]]))
    every, own = controller_state(loop.parts.controller, loop.size, step), controller_state(part.own, 1, step) @ both
    scale = StateSpace.gain(np.diag([*np.full(loop.size + 1, loop.gain), 1.0]))
    split = StateSpace.gain(np.vstack([np.eye(2 * loop.size)] * 3))
    return scale @ every.beside(own).beside(read) @ split @ measured_signals(loop.parts)


def _horizon(roots: Complexes) -> float:
    """Simulated time [s], from the rightmost roots."""
    growth = float(roots[0].real)
    fastest = float(np.abs(roots).max()) or 1.0
    if growth > 0:
        turn = 2 * math.pi / abs(roots[0]) if roots[0] != 0 else 0.0
        return min(max(GROW / growth, 4 * turn), max(40 * turn, 0.5 / growth))
    return min(SETTLE / max(-growth, 1e-9 * fastest), 2000 * 2 * math.pi / fastest)


def _delayed(system: StateSpace, entry: Floats, delays: Floats, step: float, count: int) -> tuple[Floats, Floats]:
    """Responses (z, position) (count + 1,) of a continuous loop with `delays` (n,) in `count` steps; each delay is 0 or at least one step.

    A delayed command is the unit step, integrated from its arrival, minus the delayed outputs, which are continuous and straight between
    two points. Commands without delay close their loops inside the plant.
    """
    inputs = len(entry)
    late = np.flatnonzero(delays > 0)
    outputs, at_once = system.c[:inputs], np.flatnonzero(delays == 0)
    assert not system.d.any(), "torque moves neither position nor velocity at once"
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
    table = states @ system.c[inputs:].T
    return table[:, 0], table[:, 1]


def _recur(transposed: Floats, forcing: Floats, states: Floats) -> None:
    """Fill states (k + 1, m) from the first row by recursion; NaN where they overflow."""
    states[_core.recur(transposed, forcing, states, math.inf) + 1 :] = np.nan


def _undelayed(system: StateSpace, entry: Floats, step: float, count: int, sample_time: float | None) -> tuple[Floats, Floats]:
    """Responses (z, position) of a sampled loop, or of a continuous one without delay; exact, since the input is constant."""
    inputs = len(entry)
    # u = (I + D)⁻¹ (w − C x); the constant 1 is the last state
    row = np.linalg.solve(np.eye(inputs) + system.d[:inputs], np.column_stack([-system.c[:inputs], entry]))
    total = np.vstack([np.column_stack([system.a, np.zeros(len(system.a))]) + system.b @ row, np.zeros(len(system.a) + 1)])
    transition = _core.exponential(total * step) if sample_time is None else np.eye(len(total)) + step * total
    table = np.zeros((count + 1, len(total)))
    table[0, -1] = 1.0
    _recur(transition.T.copy(), np.zeros((count, len(total))), table)
    output = table[:, :-1] @ system.c[inputs:].T + table @ row.T @ system.d[inputs:].T
    return output[:, 0], output[:, 1]


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
