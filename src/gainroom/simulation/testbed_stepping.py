"""Testbed simulation by the C++ core (testbed.hpp), tick by tick.

Where kd has a path of its own, the core's ticks are those of a clock that both rates share. Its damping acts on the measured velocity
alone, as in a drive: no reference goes there.
"""

import math
from dataclasses import replace

import numpy as np

from ..native import _core
from ..system.assembly import actuated_state, controller_state
from ..system.controller import Controller
from ..system.feedback import SIDES
from ..system.gain_path import samples_in_common
from ..system.linear.arrays import Floats, Integers
from ..system.linear.state_space import split_delay
from ..system.loop import Loop
from ..system.measured_response import spring_signals
from .run_record import Run
from .scenario import Inputs, ScenarioInputs, noise_by_side
from .testbed import Testbed


class TestbedStepper:
    """Simulation state of a testbed."""

    __test__ = False  # not a test class, whatever its name

    def __init__(self, testbed: Testbed, signals: ScenarioInputs) -> None:
        loop = testbed.loop
        assert loop.parts is not None
        assert loop.sample_time is not None
        self.testbed, self.sample_time = testbed, loop.sample_time
        self.feedback = loop.parts.feedback
        self.joint_names = loop.parts.plant.joint_names
        self._delays = np.random.default_rng([signals.scenario.seed, 1])
        body, back = _body(testbed)
        state = np.zeros(len(back))
        start = signals.start()
        state[len(state) - len(start) :] = start
        own, path, second, self._every = loop.parts.controller, loop.kd_path, None, 1
        if path is not None:  # in their common period the drive takes `_every` samples and the host `every`
            self._every, every = samples_in_common(path.sample_time, self.sample_time)
            whole, fraction = split_delay(path.delay, self.sample_time / self._every)
            second = _core.SecondPath(_control(loop, own.kd_alone(), path.sample_time, back), every, int(whole), float(fraction))
            own = own.without_kd()
        self._tick = self.sample_time / self._every
        longest = math.ceil((loop.parts.drives[0].delay + testbed.jitter) / self._tick) + 1
        hardware = _hardware(testbed, self._tick, signals.scenario.limit)
        host = _control(loop, own, self.sample_time, back)
        self._bed = _core.Testbed(body, host, hardware, np.linalg.solve(back, state), longest, self._every, second)

    def advance(self, inputs: Inputs, first: int) -> Run:
        """Run over the next ticks, numbered from `first`; rows after the first out of bounds are left out."""
        count = len(inputs.reference)
        nothing = np.zeros(count)
        known = noise_by_side(inputs.noise, self.feedback)
        noises = [known[side][:, 0] if side in known else nothing for side in SIDES]
        columns = (inputs.reference, inputs.motion, inputs.feedforward, inputs.motor_torque, inputs.link_torque)
        given = np.column_stack([*(column[:, 0] for column in columns), *noises])
        out = self._bed.advance(given, *self._drawn(count), *([inputs.torque_noise] if self.feedback.torque else []))
        made = len(out)
        rows = [out[:, [k]] for k in range(7)]
        return Run(
            time=self.sample_time * (first + np.arange(made)),
            reference=inputs.reference[:made],
            measured=rows[2 + SIDES.index(self.feedback.position)],
            motor_position=rows[0],
            link_position=rows[1],
            motor_reading=rows[2],
            link_reading=rows[3],
            target_torque=rows[4],
            demand_torque=rows[5],
            actual_torque=rows[6],
            sample_time=self.sample_time,
            feedback=self.feedback.position,
            joint_names=self.joint_names,
            channels=self.joint_names,
        )

    def _drawn(self, count: int) -> tuple[Integers, Floats]:
        """Delays of `count` commands of the host: whole ticks of the core and fractions of one."""
        assert self.testbed.loop.parts is not None
        delays = self.testbed.loop.parts.drives[0].delay + self.testbed.jitter * self._delays.uniform(-1, 1, count)
        if self.testbed.whole_ticks:
            delays = self.sample_time * np.round(delays / self.sample_time)
        whole, fraction = split_delay(np.maximum(delays, 0.0), self._tick)
        return whole.astype(np.int64), fraction


def _body(testbed: Testbed) -> tuple[_core.Body, Floats]:
    """Plant with viscous friction and current loop, for the core; and the matrix from its states to those of actuated_state."""
    parts = testbed.loop.parts
    assert parts is not None
    plant = replace(
        parts.plant,
        motor_viscous=parts.plant.motor_viscous + testbed.motor_friction.viscous,
        link_viscous=parts.plant.link_viscous + testbed.link_friction.viscous,
    )
    state = actuated_state(plant, parts.drives)
    form = plant.mechanism()
    coordinates = form.mass.shape[0]
    # Coordinates that are the positions themselves, where that is all there is: a side that friction holds then stays to the last digit.
    sides = np.vstack([form.motor_position, form.link_position])[: min(coordinates, 2)]
    turn = np.linalg.inv(sides) if len(sides) == coordinates and np.linalg.matrix_rank(sides) == coordinates else np.eye(coordinates)
    size = len(state.a)
    back = np.eye(size)
    for first in (size - 2 * coordinates, size - coordinates):
        back[first : first + coordinates, first : first + coordinates] = turn
    a, b, c = np.linalg.solve(back, state.a @ back), np.linalg.solve(back, state.b), state.c @ back
    system = np.zeros((size + 3, size + 3))
    system[:size] = np.hstack([a, b])
    return _core.Body(system, c[0:2], c[2:4], b[:, 1:3].T, c[4], parts.drives[0].is_ideal, coordinates), back


def _control(loop: Loop, controller: Controller, sample_time: float, back: Floats) -> _core.Control:
    """Difference equation of `controller`, part of the loop's, for the core; `back`: from the body's states to those of actuated_state."""
    assert loop.parts is not None
    state = controller_state(controller, loop.size, sample_time)
    transition = np.eye(len(state.a)) + sample_time * state.a
    side, velocity = (SIDES.index(one) for one in (loop.parts.feedback.position, loop.parts.feedback.velocity))
    law = (transition, sample_time * state.b, loop.gain * state.c[0], loop.gain * state.d[0], side, velocity)
    if not loop.parts.feedback.torque:
        return _core.Control(*law)
    spring = spring_signals(loop.parts.plant, actuated_state(loop.parts.plant, loop.parts.drives), sample_time)
    return _core.Control(*law, spring.c[0] @ back)


def _hardware(testbed: Testbed, tick: float, limit: float) -> _core.Hardware:
    """Hardware effects of the testbed, for the core, whose clock ticks every `tick` [s]."""
    return _core.Hardware(
        tick,
        max(1, math.ceil(tick / testbed.substep * (1 - 1e-9))),
        np.stack([testbed.motor_friction.law(), testbed.link_friction.law()]),
        np.array([float(testbed.gravity), float(testbed.hanging_at)]),
        float(testbed.torque_limit),
        np.array([testbed.motor_resolution, testbed.link_resolution]),
        float(min(limit, 1e150)),
    )
