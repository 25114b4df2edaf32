"""What happens at every tick besides rigid-body dynamics, compiled: at 2 kHz a dozen small array operations would cost more than MuJoCo."""

from numba import njit

_jit = njit(cache=True, error_model="numpy")


@_jit
def line_tick(maps, commands, newest, late, limit, command, states, over, means, step):
    """One tick of TorqueLine: takes `command` in at `newest`, moves `states` (n, 2) and `over` (n,), fills `means` (substeps, n)."""
    length, size = commands.shape
    substeps = means.shape[0]
    for j in range(size):
        commands[newest, j] = min(max(command[j], -limit[j]), limit[j])
        now = (newest - late[j]) % length
        first, second = states[j, 0], states[j, 1]
        before, acting = commands[(now - 1) % length, j], commands[now, j]
        for row in range(substeps + 3):
            part = maps[j, row]
            value = part[0] * first + part[1] * second + part[2] * before + part[3] * acting
            if row < 2:
                states[j, row] = value
            elif row == 2:
                means[0, j] = (over[j] + value) / step
            elif row < substeps + 2:
                means[row - 2, j] = value / step
            else:
                over[j] = value


@_jit
def filter_tick(a, b, c, d, state, value, output):
    """One tick of one scalar system on every channel: `state` (k, m) moves on, `output` (m,) is filled."""
    order, channels = state.shape
    for j in range(channels):
        total = d * value[j]
        for i in range(order):
            total += c[i] * state[i, j]
        output[j] = total
    for j in range(channels):
        if order == 1:
            state[0, j] = a[0, 0] * state[0, j] + b[0] * value[j]
        else:
            moved = a @ state[:, j].copy()
            for i in range(order):
                state[i, j] = moved[i] + b[i] * value[j]


@_jit
def sum_terms(gains, position, velocity, integral, sample_time, output):
    """Σ G_ab V^a I^b for a, b in {0, 1}, gains (4, m, m) in the order 00, 10, 01, 11; `integral` (m,) moves on by backward Euler."""
    size = len(position)
    for i in range(size):
        direct, integrated = 0.0, 0.0
        for j in range(size):
            direct += gains[0, i, j] * position[j] + gains[1, i, j] * velocity[j]
            integrated += gains[2, i, j] * position[j] + gains[3, i, j] * velocity[j]
        integral[i] += sample_time * integrated
        output[i] = direct + integral[i]
