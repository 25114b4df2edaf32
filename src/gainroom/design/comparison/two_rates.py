"""Roots of a robot one joint of which has kd in its drive: two rates, followed sample by sample over a period of the host.

The drive's own loop runs a whole number of times per period, with its delay; the position gain of the joint and the laws of all others run
once, over the drives' delays. What a period makes of the state is one matrix, whose eigenvalues are the roots, with nothing left out.
"""

import numpy as np

from ...errors import GainroomError
from ...system.assembly import controller_state
from ...system.gain_path import samples_in_common
from ...system.linear.state_space import StateSpace, hold, split_delay
from ...system.system import System
from .exact_joint import OWN, SENSORS, others_of, sensed_state
from .joint_responses import Opened


def largest_root(opened: Opened, alone: System) -> float:
    """Largest |z| over one period of the host, z = e^(s T), closed by the controller of `alone`, whose kd has a path of its own.

    Raises GainroomError where the drive's rate is no multiple of the host's.
    """
    parts, joint, slow = opened.parts, opened.joint, opened.sample_time
    path, controller = alone.control.kd_path, alone.control.controller
    assert path is not None
    few, count = samples_in_common(slow, path.sample_time)
    if few != 1:
        raise GainroomError("the drive's rate must be a multiple of the host's, to be followed sample by sample in a robot")
    sensed, others, size = sensed_state(parts, joint), others_of(parts, joint), parts.plant.size
    sides = [SENSORS.index(parts.feedback.position), *(range(len(sensed.c) - size, len(sensed.c)) if others else ())]
    hosts = [joint, *others]
    whole, fraction = split_delay(parts.delays[hosts], slow)
    # Inputs: the joint's command by the host, those of the others, then its command by the drive.
    columns = [0, *range(OWN, sensed.b.shape[1]), 0]
    system = StateSpace(sensed.a, sensed.b[:, columns], sensed.c[sides], np.zeros((len(sides), len(columns))))
    fast = hold(system, np.array([*(fraction * slow), path.delay]), path.sample_time)
    step = path.sample_time
    on_host, in_drive = controller_state(controller.without_kd(), 1, slow), controller_state(controller.kd_alone(), 1, step)
    law = controller_state(parts.controller, size, slow) if others else StateSpace.gain(np.zeros((0, 0)))
    sizes = [len(fast.a), len(on_host.a), len(law.a), len(in_drive.a), int(whole.sum())]
    x, host, every, drive, queue = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])

    def told(one: StateSpace, states: np.ndarray, signal: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Output −y, and the states a step later, of a law that hears a position twice."""
        heard = np.vstack([signal, signal])
        return -(one.c @ states + one.d @ heard), states + time * (one.a @ states + one.b @ heard)

    seen = fast.c @ x
    own, host = told(on_host, host, seen[:1], slow)
    sent = [own]
    if others:
        commands, every = told(law, every, seen[1:], slow)
        sent += [commands[k : k + 1] for k in others]
    held, left, waiting = [], [], list(np.split(queue, np.cumsum(whole)[:-1])) if queue.size else [queue] * len(hosts)
    for ticks, command, old in zip(whole.tolist(), sent, waiting, strict=True):
        line = np.vstack([command, old]) if ticks else command  # the newest first
        held.append(line[-1:])
        left.append(line[:ticks])
    constant = np.vstack(held)
    for _ in range(count):
        driven, drive = told(in_drive, drive, (fast.c @ x)[:1], step)
        x = x + step * (fast.a @ x + fast.b @ np.vstack([constant, driven]))
    period = np.vstack([x, host, every, drive, *left])
    return float(np.abs(np.linalg.eigvals(period)).max())
