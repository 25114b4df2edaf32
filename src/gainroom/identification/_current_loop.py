"""Compiled: the current loop's torque predicted row by row, and the commands decoded that must have acted."""

import numpy as np

from ..analysis.compiled import cached_njit


@cached_njit(error_model="numpy")
def predict_torque(command, changes, torque, fresh, tick, parts, noises, gain, offset, noise, unknown, error, variance):
    """Kalman filter of the current loop whose command changes within a tick at uncertain moments, and is read within it.

    command, torque (m,); changes (m, q) of the command in each row by kind of arrival; fresh (m,) behind a gap; tick (3, 3) what a state
    (2,) and the command held before come to at the end of the tick, two rows, and at the torque's reading; parts (q, 3), noises (q, 3, 3)
    mean and covariance of what a unit change adds to these three; gain, offset, noise of the measurement; unknown: variance of the state
    behind a gap [(N m)²]. Fills error and variance (m,) of the torque's prediction.
    """
    x0 = x1 = p00 = p01 = p11 = 0.0
    kinds = changes.shape[1]
    for k in range(len(command)):
        if fresh[k]:
            n0, n1, n2 = command[k], 0.0, command[k]
            c00 = c02 = c11 = c22 = unknown
            c01 = c12 = 0.0
        else:
            held = command[k - 1]
            n0 = tick[0, 0] * x0 + tick[0, 1] * x1 + tick[0, 2] * held
            n1 = tick[1, 0] * x0 + tick[1, 1] * x1 + tick[1, 2] * held
            n2 = tick[2, 0] * x0 + tick[2, 1] * x1 + tick[2, 2] * held
            a00 = tick[0, 0] * p00 + tick[0, 1] * p01
            a01 = tick[0, 0] * p01 + tick[0, 1] * p11
            a10 = tick[1, 0] * p00 + tick[1, 1] * p01
            a11 = tick[1, 0] * p01 + tick[1, 1] * p11
            a20 = tick[2, 0] * p00 + tick[2, 1] * p01
            a21 = tick[2, 0] * p01 + tick[2, 1] * p11
            c00 = a00 * tick[0, 0] + a01 * tick[0, 1]
            c01 = a00 * tick[1, 0] + a01 * tick[1, 1]
            c11 = a10 * tick[1, 0] + a11 * tick[1, 1]
            c02 = a20 * tick[0, 0] + a21 * tick[0, 1]
            c12 = a20 * tick[1, 0] + a21 * tick[1, 1]
            c22 = a20 * tick[2, 0] + a21 * tick[2, 1]
            for q in range(kinds):
                change = changes[k, q]
                n0, n1, n2 = n0 + parts[q, 0] * change, n1 + parts[q, 1] * change, n2 + parts[q, 2] * change
                square = change * change
                c00, c01, c11 = c00 + noises[q, 0, 0] * square, c01 + noises[q, 0, 1] * square, c11 + noises[q, 1, 1] * square
                c02, c12, c22 = c02 + noises[q, 0, 2] * square, c12 + noises[q, 1, 2] * square, c22 + noises[q, 2, 2] * square
        e = torque[k] - gain * n2 - offset
        s = gain * gain * c22 + noise * noise
        error[k], variance[k] = e, s
        k0, k1 = gain * c02 / s, gain * c12 / s
        x0, x1 = n0 + k0 * e, n1 + k1 * e
        p00, p01, p11 = c00 - k0 * gain * c02, c01 - k0 * gain * c12, c11 - k1 * gain * c12


@cached_njit(error_model="numpy")
def decode(target, torque, transition, full, part, gain, offset, noise, first, last, change_cost, age):
    """The likeliest ages (m,) [ticks] of the commands that acted at each row, between `first` and `last`: Viterbi's algorithm.

    The age grows by one where no newer command has arrived. A newer command acts from its row on by `part` (2,) of a full tick's effect.
    change_cost: what one tick of difference from the usual age, the middle, costs, in units of squared errors.
    """
    count, rows = last - first + 1, len(target)
    cost, state = np.zeros(count), np.zeros((count, 2))
    fresh_cost, fresh_state = np.zeros(count), np.zeros((count, 2))
    back = np.zeros((rows, count), dtype=np.int8)
    middle = 0.5 * (first + last)
    for i in range(count):
        state[i, 0] = target[max(0, last - first - i)]
    for k in range(last + 1, rows):
        for i in range(count):
            now, best, choice = target[k - first - i], np.inf, 0
            m0 = m1 = 0.0
            for j in range(max(i - 1, 0), count):  # the age before: at most one tick less, or more where newer commands have arrived
                before = target[k - 1 - first - j]
                change = now - before
                x0 = transition[0, 0] * state[j, 0] + transition[0, 1] * state[j, 1] + full[0] * before + part[0] * change
                x1 = transition[1, 0] * state[j, 0] + transition[1, 1] * state[j, 1] + full[1] * before + part[1] * change
                e = (torque[k] - gain * x0 - offset) / noise
                total = cost[j] + e * e + change_cost * abs(first + i - middle)
                if total < best:
                    best, choice, m0, m1 = total, j, x0, x1
            fresh_cost[i], fresh_state[i, 0], fresh_state[i, 1] = best, m0, m1
            back[k, i] = choice
        least = fresh_cost.min()
        for i in range(count):
            cost[i] = fresh_cost[i] - least
            state[i] = fresh_state[i]
    place = int(np.argmin(cost))
    for k in range(rows - 1, last, -1):
        age[k] = first + place
        place = back[k, place]
    for k in range(min(last + 1, rows)):
        age[k] = first + place
