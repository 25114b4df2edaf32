"""Roots of a robot one or several joints of which have kd in their drives: two rates, followed sample by sample over a period of the host.

The drives' own loops run a whole number of times per period, with their delay; the position gains of the joints and the laws of all others
run once, over the drives' delays. What a period makes of the state is one matrix, whose eigenvalues are the roots, with nothing left out.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from ...errors import GainroomError
from ...system.assembly import controller_state
from ...system.controller import Controller
from ...system.gain_path import samples_in_common
from ...system.linear.state_space import StateSpace, hold, split_delay
from ...system.system import System
from .exact_joint import OWN, SENSORS, others_of, sensed_state
from .joint_responses import Opened


def laws_beside(controllers: Sequence[Controller], step: float) -> StateSpace:
    """Laws of joints (n), each with one controller of its own, sampled every `step` [s]: two signals (2n) → output (n)."""
    laws = [controller_state(one, 1, step) for one in controllers]
    both = reduce(lambda first, second: first.beside(second), laws)
    order = [2 * k + signal for signal in range(2) for k in range(len(laws))]  # of the stacked laws' inputs, as controller_state has them
    return StateSpace(both.a, both.b[:, order], both.c, both.d[:, order])


def largest_root(opened: Opened, *alone: System) -> float:
    """Largest |z| over one period of the host, z = e^(s T), closed by the controllers of `alone`, one a joint of `opened`.

    The kd of all of them has the same path of its own. Raises GainroomError where the drive's rate is no multiple of the host's.
    """
    parts, slow, path = opened.parts, opened.sample_time, alone[0].control.kd_path
    assert path is not None
    few, count = samples_in_common(slow, path.sample_time)
    if few != 1:
        raise GainroomError("the drive's rate must be a multiple of the host's, to be followed sample by sample in a robot")
    sensed, others, size = sensed_state(parts, opened.joints), others_of(parts, opened.joints), parts.plant.size
    open_ = list(range(opened.size))
    sides = [opened.size * SENSORS.index(parts.feedback.position) + k for k in open_]
    sides += list(range(len(sensed.c) - size, len(sensed.c))) if others else []
    hosts = [*opened.joints, *others]
    whole, fraction = split_delay(parts.delays[hosts], slow)
    # Inputs: the joints' commands by the host, those of the others, then their commands by the drives.
    columns = [*open_, *range(OWN * opened.size, sensed.b.shape[1]), *open_]
    system = StateSpace(sensed.a, sensed.b[:, columns], sensed.c[sides], np.zeros((len(sides), len(columns))))
    fast = hold(system, np.array([*(fraction * slow), *([path.delay] * opened.size)]), path.sample_time)
    step = path.sample_time
    on_host = laws_beside([one.control.controller.without_kd() for one in alone], slow)
    in_drive = laws_beside([one.control.controller.kd_alone() for one in alone], step)
    law = controller_state(parts.controller, size, slow) if others else StateSpace.gain(np.zeros((0, 0)))
    sizes = [len(fast.a), len(on_host.a), len(law.a), len(in_drive.a), int(whole.sum())]
    x, host, every, drive, queue = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])

    def told(one: StateSpace, states: np.ndarray, signal: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Output −y, and the states a step later, of a law that hears a position twice."""
        heard = np.vstack([signal, signal])
        return -(one.c @ states + one.d @ heard), states + time * (one.a @ states + one.b @ heard)

    seen = fast.c @ x
    own, host = told(on_host, host, seen[: opened.size], slow)
    sent = [*np.split(own, opened.size)]
    if others:
        commands, every = told(law, every, seen[opened.size :], slow)
        sent += [commands[k : k + 1] for k in others]
    held, left, waiting = [], [], list(np.split(queue, np.cumsum(whole)[:-1])) if queue.size else [queue] * len(hosts)
    for ticks, command, old in zip(whole.tolist(), sent, waiting, strict=True):
        line = np.vstack([command, old]) if ticks else command  # the newest first
        held.append(line[-1:])
        left.append(line[:ticks])
    constant = np.vstack(held)
    for _ in range(count):
        driven, drive = told(in_drive, drive, (fast.c @ x)[: opened.size], step)
        x = x + step * (fast.a @ x + fast.b @ np.vstack([constant, driven]))
    period = np.vstack([x, host, every, drive, *left])
    return float(np.abs(np.linalg.eigvals(period)).max())
