"""Compiled kernel of the testbed: one joint, its drive, its encoders and its controller, tick by tick."""

import math
from typing import NamedTuple

import numpy as np

from ..linear.arrays import Floats, Integers
from ._contact import jit
from ._motion import Body, dot, propagator, substep

MOTOR, LINK, MOTOR_READING, LINK_READING, TARGET, DEMAND, ACTUAL = range(7)  # columns of what comes out
REFERENCE, MOTION, FEEDFORWARD, MOTOR_TORQUE, LINK_TORQUE, MOTOR_NOISE, LINK_NOISE = range(7)  # of what goes in
SAME_INSTANT = 1e-9  # of a tick: two instants closer than this are one


class Control(NamedTuple):
    """The controller, one step a tick, times the loop's gain: x⁺ = a x + b e, u = c x + d e, e = (position error, motion error).

    side   what it measures, 0: motor, 1: link
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats
    side: int


class Hardware(NamedTuple):
    """What is not linear.

    tick             T_s [s]
    cells            substeps per tick
    laws             (2, 5) friction of motor and link, see _contact.py
    gravity          (2,) m g l [N m], where the link hangs [rad]
    torque_limit     [N m]
    resolution       (2,) of the encoders [rad]; 0: exact
    position_limit   [rad] where a run has diverged
    """

    tick: float
    cells: int
    laws: Floats
    gravity: Floats
    torque_limit: float
    resolution: Floats
    position_limit: float


class Memory(NamedTuple):
    """What a block of ticks leaves for the next; its arrays change in place.

    state     (m,) of the body
    bent      (2,) the bristles of motor and link
    control   (r,) the controller's states
    first     (2,) 1 once it is known, and the first reading
    demand    (2,) place in `sent` of the newest command that has arrived, and its torque, limited
    sent      (l + k,) commands of the last l ticks, then of this block's
    whole, fraction   (l + k,) their delays in ticks
    """

    state: Floats
    bent: Floats
    control: Floats
    first: Floats
    demand: Floats
    sent: Floats
    whole: Integers
    fraction: Floats


@jit
def advance(body, control, hardware, memory, given, out):
    """Fill `out` (k, 7) for the ticks of `given` (k, 7); the number of rows made, fewer than k where a position is out of bounds.

    A command is computed from the readings of its tick and arrives its delay later; the newest that has arrived counts.
    """
    size, past = len(memory.state), len(memory.sent) - len(given)
    base, spare = np.empty((size + 3, size + 3)), np.empty((2, size + 3, size + 3))
    widths, fresh, torques, moved = np.zeros(3), np.empty(size), np.empty(3), np.empty(len(memory.control))
    propagator(body.system, hardware.tick / hardware.cells, base)
    for k in range(len(given)):
        for side in range(2):
            out[k, MOTOR + side] = dot(body.positions[side], memory.state)
            if not abs(out[k, MOTOR + side]) <= hardware.position_limit:
                return k
            reading = out[k, MOTOR + side] + given[k, MOTOR_NOISE + side]
            out[k, MOTOR_READING + side] = quantised(reading, hardware.resolution[side])
        memory.sent[past + k] = command(control, memory, moved, out[k, MOTOR_READING + control.side], given[k])
        newest_at(memory, past + k, 0.0, hardware.torque_limit)
        out[k, TARGET], out[k, DEMAND] = memory.sent[past + k], memory.demand[1]
        out[k, ACTUAL] = memory.demand[1] if body.ideal else dot(body.current, memory.state)
        torques[1], torques[2] = given[k, MOTOR_TORQUE], given[k, LINK_TORQUE]
        now, cell = 0.0, 1
        while cell <= hardware.cells:
            end = cell / hardware.cells
            arrival = next_arrival(memory, past + k, now)
            until = min(arrival, end)
            if until - now > SAME_INSTANT:
                torques[0] = memory.demand[1]
                transition, width = base, hardware.tick / hardware.cells
                if abs((until - now) * hardware.cells - 1) > SAME_INSTANT:
                    transition, width = chosen(body, hardware.tick * (until - now), widths, spare), hardware.tick * (until - now)
                substep(memory.state, memory.bent, transition, width, torques, body, hardware.laws, hardware.gravity, fresh)
            now = until
            if arrival <= end:
                newest_at(memory, past + k, arrival, hardware.torque_limit)
            if end - now <= SAME_INSTANT:
                cell += 1
    return len(given)


@jit
def quantised(value, resolution):
    """What an encoder with steps of `resolution` reads; 0: exactly."""
    return resolution * math.floor(value / resolution + 0.5) if resolution > 0 else value


@jit
def command(control, memory, moved, reading, given):
    """The target torque of this tick; moves the controller on, by way of `moved` (r,)."""
    if memory.first[0] == 0:  # the difference's past: it has always read this
        memory.first[0], memory.first[1] = 1.0, reading
    error, motion = given[REFERENCE] - reading, given[MOTION] + memory.first[1] - reading
    target = given[FEEDFORWARD] + dot(control.c, memory.control) + control.d[0] * error + control.d[1] * motion
    for i in range(len(moved)):
        moved[i] = dot(control.a[i], memory.control) + control.b[i, 0] * error + control.b[i, 1] * motion
    for i in range(len(moved)):
        memory.control[i] = moved[i]
    return target


@jit
def newest_at(memory, tick, fraction, limit):
    """The drive takes up the newest command that arrives at `fraction` of the tick at place `tick`, unless it has a newer one."""
    place = int(memory.demand[0])
    for j in range(tick, place, -1):
        if j + memory.whole[j] == tick and abs(memory.fraction[j] - fraction) <= SAME_INSTANT:
            memory.demand[0], memory.demand[1] = j, min(max(memory.sent[j], -limit), limit)
            return


@jit
def next_arrival(memory, tick, now):
    """The first fraction of the tick after `now` at which a command arrives that is newer than the drive's; 2 where none does."""
    first = 2.0
    for j in range(tick, int(memory.demand[0]), -1):
        if j + memory.whole[j] == tick and now + SAME_INSTANT < memory.fraction[j] < first:
            first = memory.fraction[j]
    return first


@jit
def chosen(body, width, widths, spare):
    """The transition over `width` [s]: one of the last two, which with a constant delay are all there are, or a new one."""
    for place in range(2):
        if abs(widths[place] - width) <= 1e-12 * width:
            widths[2] = 1 - place  # the other one is the next to go
            return spare[place]
    place = int(widths[2])
    widths[place], widths[2] = width, 1 - place
    propagator(body.system, width, spare[place])
    return spare[place]


__all__ = ["Body", "Control", "Hardware", "Memory", "advance"]
