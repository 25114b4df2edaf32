"""Compiled: the current loop's torque predicted row by row, and the commands decoded that must have acted."""

import numpy as np

from ..analysis.compiled import cached_njit


@cached_njit(error_model="numpy")
def predict_torque(command, changes, torque, fresh, transition, full, parts, slope, spread, gain, offset, noise, unknown, error, variance):
    """Kalman filter of the current loop whose command changes within a tick at uncertain moments.

    command, torque (m,); changes (m, q) of the command in each row by kind of arrival; fresh (m,) behind a gap; transition (2, 2) and full
    (2,) over a whole tick; parts (3, q, 2) what a change of a row adds one row before it, in it, and one row after it, slope (q, 2) the
    derivative of their sum by the moment of arrival, spread (q,) that moment's standard deviation [ticks]; gain, offset, noise of the
    measurement; unknown: variance of the state behind a gap [(N m)²]. Fills error and variance (m,) of the torque's prediction.
    """
    x0 = x1 = p00 = p01 = p11 = 0.0
    kinds = changes.shape[1]
    for k in range(len(command)):
        if fresh[k]:
            x0, x1 = command[k], 0.0
            p00, p01, p11 = unknown, 0.0, unknown
        else:
            n0 = transition[0, 0] * x0 + transition[0, 1] * x1 + full[0] * command[k - 1]
            n1 = transition[1, 0] * x0 + transition[1, 1] * x1 + full[1] * command[k - 1]
            a00 = transition[0, 0] * p00 + transition[0, 1] * p01
            a01 = transition[0, 0] * p01 + transition[0, 1] * p11
            a10 = transition[1, 0] * p00 + transition[1, 1] * p01
            a11 = transition[1, 0] * p01 + transition[1, 1] * p11
            p00 = a00 * transition[0, 0] + a01 * transition[0, 1]
            p01 = a00 * transition[1, 0] + a01 * transition[1, 1]
            p11 = a10 * transition[1, 0] + a11 * transition[1, 1]
            for q in range(kinds):
                change = changes[k, q]
                n0, n1 = n0 + parts[1, q, 0] * change, n1 + parts[1, q, 1] * change
                r0, r1 = spread[q] * change * slope[q, 0], spread[q] * change * slope[q, 1]
                p00, p01, p11 = p00 + r0 * r0, p01 + r0 * r1, p11 + r1 * r1
                if not fresh[k - 1]:
                    n0, n1 = n0 + parts[2, q, 0] * changes[k - 1, q], n1 + parts[2, q, 1] * changes[k - 1, q]
                if k + 1 < len(command) and not fresh[k + 1]:
                    n0, n1 = n0 + parts[0, q, 0] * changes[k + 1, q], n1 + parts[0, q, 1] * changes[k + 1, q]
            x0, x1 = n0, n1
        e = torque[k] - gain * x0 - offset
        s = gain * gain * p00 + noise * noise
        error[k], variance[k] = e, s
        k0, k1 = gain * p00 / s, gain * p01 / s
        x0, x1 = x0 + k0 * e, x1 + k1 * e
        p11 -= k1 * gain * p01
        p01 -= k0 * gain * p01
        p00 *= noise * noise / s


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
