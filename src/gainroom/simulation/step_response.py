"""The closed loop in time, scalar loops only.

With a unit step w added at the torque command, the loop L obeys  z = L (w − z): z is the measured position after a unit step of
the reference (L/(1+L), eq. (4) of Jung et al. 2017), and the position under that step of torque is P C e^{−sT} (w − z).

Sampled: the exact discrete state space, stepped. Continuous without delay: exact (matrix exponential; the input is constant). Continuous
with delay: method of steps. One delay is a whole number of steps, each step integrates the plant exactly with the delayed command
taken as straight between two points. The error falls with the square of the step, which is halved until the result converges.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..analysis.stability import rightmost_roots
from ..errors import GainroomError
from ..linear.arrays import Complexes, Floats
from ..linear.state_space import StateSpace, realize
from ..native import _core
from ..system.loop import Loop
from .run import simulate
from .scenario import Scenario
from .trajectories import Step

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
    growth, frequency   real and imaginary part of the rightmost root [1/s], [rad/s]
    """

    time: Floats
    reference: Floats
    disturbance: Floats
    change: float
    growth: float
    frequency: float


def step_response(loop: Loop, end: float | None = None) -> StepResponse:
    """Both step responses up to `end` [s] (None: until settled, or until the vibration has grown thirtyfold).

    Raises GainroomError for loops that were not built from a joint, and for several joints.
    """
    if loop.scalar is None or loop.open_loop is None or loop.actuated is None or loop.delays is None:
        raise GainroomError("step_response needs a loop of one joint built with build_loop")
    roots = rightmost_roots(loop, count=8).roots
    end = _horizon(roots) if end is None else end
    growth, frequency = float(roots[0].real), float(abs(roots[0].imag))
    if loop.sample_time is not None:
        step, count = loop.sample_time, min(math.ceil(end / loop.sample_time), MOST_STEPS)
        return StepResponse(step * np.arange(count + 1), *_sampled(loop, step, count), 0.0, growth, frequency)
    delay = float(loop.delays[0])
    if delay == 0:
        return StepResponse(
            np.linspace(0, end, UNDELAYED_POINTS + 1), *_undelayed(loop, end / UNDELAYED_POINTS, UNDELAYED_POINTS), 0.0, growth, frequency
        )
    late = max(8, math.ceil(delay * float(np.abs(roots[:4]).max()) / LARGEST_TURN))
    steps = min(math.ceil(end / delay), MOST_STEPS // late + 1) * late
    reference, disturbance = _delayed(loop, delay / late, late, steps)
    while True:
        coarse, late, steps = reference, 2 * late, 2 * steps
        reference, disturbance = _delayed(loop, delay / late, late, steps)
        change = float(np.abs(reference[::2] - coarse).max() / np.abs(reference).max())
        if change < CONVERGED or late > MOST_STEPS_PER_DELAY:
            return StepResponse(delay / late * np.arange(steps + 1), reference, disturbance, change, growth, frequency)


def _horizon(roots: Complexes) -> float:
    """The time that is simulated."""
    growth = float(roots[0].real)
    fastest = float(np.abs(roots).max()) or 1.0
    if growth > 0:
        turn = 2 * math.pi / abs(roots[0]) if roots[0] != 0 else 0.0
        return min(max(GROW / growth, 4 * turn), max(40 * turn, 0.5 / growth))
    return min(SETTLE / max(-growth, 1e-9 * fastest), 2000 * 2 * math.pi / fastest)


def _sampled(loop: Loop, step: float, count: int) -> tuple[Floats, Floats]:
    """`count` ticks of the exact discrete loop: (z, position), (count + 1,) each."""
    reference = simulate(loop, Scenario(Step(1.0), count * step, reference_velocity=True, limit=math.inf))
    disturbance = simulate(loop, Scenario(0.0, count * step, feedforward=1.0, limit=math.inf))
    return reference.measured[:, 0], disturbance.measured[:, 0]


def _delayed(loop: Loop, step: float, late: int, count: int) -> tuple[Floats, Floats]:
    """`count` steps of a continuous loop whose delay is `late` of them: (z, position), (count + 1,) each."""
    system, before, after = _joined(loop, step)
    states, sent, rows = np.zeros((late + 1, len(system.a))), np.zeros(late), []
    direct, transposed = system.d.sum(axis=1), system.a.T.copy()
    for turn in range(count // late + 1):  # in one delay the commands are those that were sent in the one before
        forcing = np.outer(sent, before) + np.outer(np.append(sent[1:], 0.0), after)
        states[0] = states[-1]
        _recur(transposed, forcing, states)
        rows.append(states[:-1] @ system.c.T + np.outer(sent, direct))
        # The point that follows the last one is this delay's own first command, known only when its outputs are.
        # In the first delay it is the unit step itself, which does not ramp up inside the interval before it.
        sent = 1.0 - rows[-1][:, 0]
        states[-1] += after * (sent[0] if turn else 0.0)
    table = np.vstack(rows)[: count + 1]
    return table[:, 0], table[:, 1]


def _recur(transposed: Floats, forcing: Floats, states: Floats) -> None:
    """Fill states (k + 1, m) from the first row; with NaN where they overflow."""
    states[_core.recur(transposed, forcing, states, math.inf) + 1 :] = np.nan


def _undelayed(loop: Loop, step: float, count: int) -> tuple[Floats, Floats]:
    """Closed in continuous time, then sampled exactly: with constant input nothing is approximated. (z, position) as above."""
    assert loop.open_loop is not None
    assert loop.actuated is not None
    part, plant = loop.open_loop, realize(loop.actuated)
    c, d = loop.gain * part.c[0], loop.gain * part.d[0, 0]
    # u = (1 − c x)/(1 + d) drives loop and plant alike; the constant 1 is the last state
    states, moving = len(part.a), len(plant.a)
    row = np.concatenate([-c, np.zeros(moving), [1.0]]) / (1 + d)
    total = np.zeros((states + moving + 1,) * 2)
    total[:states, :states] = part.a
    total[states:-1, states:-1] = plant.a
    total[:-1] += np.vstack([part.b, plant.b]) @ row[None]
    transition = _core.exponential(total * step)
    table = np.zeros((count + 1, len(total)))
    table[0, -1] = 1.0
    _recur(transition.T, np.zeros((count, len(total))), table)
    return 1.0 - table @ row, table[:, states:-1] @ plant.c[0]


def _joined(loop: Loop, step: float) -> tuple[StateSpace, Floats, Floats]:
    """Loop (command → z) and plant (command → position) side by side, both fed the same: x⁺ = a x + before u + after u⁺, y = c x + d u.

    One step of a continuous system whose inputs are straight in between (first-order hold; Franklin, Powell and Workman, sec. 6.3).
    """
    assert loop.open_loop is not None
    assert loop.actuated is not None
    part = loop.open_loop
    system = StateSpace(part.a, part.b, loop.gain * part.c, loop.gain * part.d).beside(realize(loop.actuated))
    states, inputs = system.b.shape
    total = np.zeros((states + 2 * inputs,) * 2)
    total[:states, :states] = step * system.a
    total[:states, states : states + inputs] = step * system.b
    total[states : states + inputs, states + inputs :] = np.eye(inputs)
    over = _core.exponential(total)
    after = over[:states, states + inputs :]
    before = over[:states, states : states + inputs] - after
    return StateSpace(over[:states, :states], before, system.c, system.d), before.sum(axis=1), after.sum(axis=1)
