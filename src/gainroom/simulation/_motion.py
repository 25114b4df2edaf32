"""Compiled: one joint with its current loop over a substep in which the demanded torque does not change.

Plant and current loop are linear and are propagated by their matrix exponential; friction and gravity are torques that are constant over
the substep and obey their laws on its average (see _contact.py): gravity does exactly the work by which the potential falls. With both
off nothing is approximated.
"""

import math
from typing import NamedTuple

import numpy as np

from ..linear.arrays import Floats
from ._contact import dry, jit, lugre

SWEEPS = 60  # over motor, gravity and link, which couple weakly within a substep
MOTOR_INPUT, LINK_INPUT = 1, 2  # places among the body's inputs, behind the demand
TAYLOR_TERMS = 22  # of the Taylor series at norm <= 1/2: 0.5^22/22! is 1e-28


class Body(NamedTuple):
    """Plant and current loop in continuous time.

    system          (m + 3, m + 3) d/dt of states and of the inputs, which stay: demand, torques from outside on motor and link
    positions, rates   (2, m) of motor and link
    entries         (2, m) how a torque on motor or link accelerates
    current         (m,) the actual torque; not used behind an ideal current loop
    ideal           the current loop is ideal
    coordinates     c: the last 2c states are the plant's coordinates, then their rates
    """

    system: Floats
    positions: Floats
    rates: Floats
    entries: Floats
    current: Floats
    ideal: bool
    coordinates: int


@jit
def propagator(system, width, transition):
    """Fill `transition` (m, m) with e^{system · width}: Taylor series, scaled and squared (scipy is out of reach of compiled code)."""
    size, norm = len(system), 0.0
    for i in range(size):
        row = 0.0
        for j in range(size):
            row += abs(system[i, j])
        norm = max(norm, row * width)
    scale = width
    while norm > 0.5:
        norm *= 0.5
        scale *= 0.5
    term, other = np.zeros((size, size)), np.zeros((size, size))
    for i in range(size):
        for j in range(size):
            term[i, j] = transition[i, j] = 1.0 if i == j else 0.0
    for k in range(1, TAYLOR_TERMS):
        product(term, system, scale / k, other)
        for i in range(size):
            for j in range(size):
                term[i, j] = other[i, j]
                transition[i, j] += other[i, j]
    while scale < 0.75 * width:
        product(transition, transition, 1.0, other)
        for i in range(size):
            for j in range(size):
                transition[i, j] = other[i, j]
        scale *= 2


@jit
def product(left, right, factor, result):
    """Fill `result` (m, m) with factor · left @ right."""
    for i in range(len(left)):
        for j in range(len(right)):
            result[i, j] = 0.0
        for k in range(len(right)):
            value = factor * left[i, k]
            for j in range(len(right)):
                result[i, j] += value * right[k, j]


@jit
def dot(row, column):
    """Sum of products."""
    total = 0.0
    for k in range(len(row)):
        total += row[k] * column[k]
    return total


@jit
def mean_gravity(moment, angle, turn):
    """m g l (cos a − cos(a + d))/d: the gravity torque that does the work of the potential over a turn of d."""
    half = 0.5 * turn
    share = 1 - half * half / 6 if abs(half) < 1e-4 else math.sin(half) / half
    return moment * math.sin(angle + half) * share


@jit
def substep(state, bent, transition, width, torques, body, laws, gravity, fresh):
    """Move `state` (m,) and the bristles' deflections (2,) by one substep of `width` [s].

    transition (m + 3, m + 3) of state and inputs; torques (3,): demand, outside torques on motor and link; body: see `Body`; laws (2, 5);
    gravity: m g l, where it hangs; fresh (m,): work space.
    """
    positions, rates, entries, coordinates = body.positions, body.rates, body.entries, body.coordinates
    size = len(state)
    for i in range(size):
        total = 0.0
        for j in range(size):
            total += transition[i, j] * state[j]
        for j in range(3):
            total += transition[i, size + j] * torques[j]
        fresh[i] = total
    rubs = laws[0, 1] > 0, laws[1, 1] > 0
    if not (rubs[0] or rubs[1] or gravity[0] != 0):
        for i in range(size):
            state[i] = fresh[i]
        return
    moved, angle = np.empty(2), dot(positions[1], state) - gravity[1]
    answer = np.empty((2, 2))  # displacement per torque
    for side in range(2):
        moved[side] = dot(positions[side], fresh) - dot(positions[side], state)
        for other in range(2):
            answer[side, other] = 0.0
            for i in range(size):
                answer[side, other] += positions[side, i] * transition[i, size + MOTOR_INPUT + other]
    torque, weight = np.zeros(2), 0.0
    stuck, velocity, end = np.zeros(2), np.empty(2), np.empty(2)
    for side in range(2):
        velocity[side], end[side] = dot(rates[side], state), bent[side]
    for _sweep in range(SWEEPS):
        change = 0.0
        for side in range(2):
            if side == 1 and gravity[0] != 0 and answer[1, 1] > 0:
                turn = moved[1] - answer[1, 0] * torque[0] - answer[1, 1] * (torque[1] + weight)
                fresher = mean_gravity(gravity[0], angle, turn)
                change = max(change, abs(fresher - weight))
                weight = fresher
            if not rubs[side] or answer[side, side] <= 0:  # a locked link does not move
                continue
            others = answer[side, 1] * weight + answer[side, 1 - side] * torque[1 - side]
            free, gain, before = (moved[side] - others) / width, answer[side, side] / width, torque[side]
            if math.isinf(laws[side, 3]):
                torque[side], velocity[side], stuck[side] = dry(laws[side], free, gain)
            else:
                torque[side], velocity[side], end[side] = lugre(laws[side], bent[side], free, gain, width, velocity[side])
            change = max(change, abs(torque[side] - before))
        if change <= 1e-13 * (abs(torque[0]) + abs(torque[1]) + abs(weight)):
            break
    for i in range(size):
        fresh[i] -= transition[i, size + MOTOR_INPUT] * torque[0] + transition[i, size + LINK_INPUT] * (torque[1] + weight)
    for side in range(2):
        bent[side] = end[side]
        if stuck[side] > 0:
            hold(state, fresh, positions[side], rates[side], entries[side], coordinates)
    for i in range(size):
        state[i] = fresh[i]


@jit
def hold(state, fresh, position, rate, entry, coordinates):
    """A side whose mean velocity over a substep was 0: remove its remaining velocity, and the rounding of its position."""
    unit = dot(rate, entry)
    push, slip = dot(rate, fresh) / unit, (dot(position, fresh) - dot(position, state)) / unit
    for i in range(len(state) - coordinates, len(state)):
        fresh[i] -= entry[i] * push
        fresh[i - coordinates] -= entry[i] * slip
